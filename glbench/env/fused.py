"""Steps in one call: the compiled kernel does everything of a step, from the check of the actions to the observation.

The bits are those of ``glbench.env.reference``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glbench.env.actuation import ActionReader
from glbench.env.program import HEAD
from glbench.env.quantities import REWARD
from glbench.env.step_result import StepResult, read_only
from glbench.env.uncertainty import draw_key

if TYPE_CHECKING:
    from glbench.kernel.environment import Environments
    from glbench.tasks import TaskSpec

Floats = NDArray[np.float64]

_PLAIN = "fd"
"""Codes of the types that are copied without a look at them: float32 and float64."""
_AIR = slice(3, 6)


class FusedRuns:
    """The runs of a simulation, stepped by compiled environments; attributes and methods as ``glbench.env.runs.Runs`` says.

    The environments overwrite their arrays in every step. What is handed out is a copy, made when it is first asked for.
    """

    def __init__(self, task: TaskSpec, n: int, environments: Environments) -> None:
        self.n = n
        self._task_id = task.id
        self._certain = task.uncertainty.delta == 0.0
        self._all = environments
        self._readers = {"given": ActionReader.of_task(task), "given_controls": ActionReader.of_controls()}
        self.over = 0
        """How many runs have ended."""
        self._failed = 0
        self._stepped = False
        self._copies: dict[str, Any] = {}
        self._only = environments.table[0], environments.observations[0], environments.given[0]
        self._one_action = self._only[2].shape

    @property
    def x(self) -> Floats:
        """States ``(n, 28)``."""
        return self._copy("x")

    @property
    def u(self) -> Floats:
        """Controls in force ``(n, 6)``."""
        return self._copy("u")

    @property
    def k(self) -> NDArray[np.int64]:
        """Steps taken ``(n,)``."""
        return self._copy("k")

    @property
    def ended(self) -> NDArray[np.bool_]:
        """Whether a run has ended ``(n,)``."""
        return self._copy("ended")

    @property
    def air(self) -> Floats:
        """Air inside ``(3, n)``."""
        found: Floats | None = self._copies.get("air")
        if found is None:
            found = self._copies["air"] = read_only(self.head[_AIR].copy())
        return found

    @property
    def head(self) -> Floats:
        """What ``info`` tells of every run besides the step's quantities, ``(12, n)``."""
        return self._table()[:HEAD]

    @property
    def result(self) -> StepResult | None:
        """What the last step gave; ``None`` when the runs were started or placed since."""
        if not self._stepped:
            return None
        found: StepResult | None = self._copies.get("result")
        if found is None:
            table = self._table()[HEAD:]
            found = self._copies["result"] = StepResult(
                self._all.observations.copy(),
                table[REWARD],
                self.ended,
                self._all.failures() if self._failed else [],
                table,
            )
        return found

    def start(self, rows: NDArray[np.intp], seeds: Sequence[int], state: Floats) -> None:
        """Start the runs in ``rows`` with ``seeds`` from ``state``."""
        a = self._all
        a.x[rows], a.u[rows], a.k[rows], a.ended[rows] = state, 0.0, 0, False
        self._take_keys(rows, seeds)
        self._look()

    def restore(
        self,
        x: Floats,
        u: Floats,
        k: NDArray[np.int64],
        ended: NDArray[np.bool_],
        seeds: Sequence[int],
        result: StepResult | None = None,
    ) -> None:
        """Continue all runs from where a snapshot left them."""
        a = self._all
        a.x[:], a.u[:], a.k[:], a.ended[:] = x, u, k, ended
        self._take_keys(np.arange(self.n), seeds)
        self._look()
        if result is not None:
            self._copies["result"], self._stepped = result, True

    def end(self, rows: NDArray[np.intp]) -> None:
        """End the runs in ``rows`` where they stand."""
        self._all.ended[rows] = True
        self.over = int(np.count_nonzero(self._all.ended))
        self._copies.pop("ended", None)

    def observe(self) -> NDArray[np.float32]:
        """Observations of all runs as they stand."""
        return self._all.observations.copy()

    def step(self, actions: ArrayLike) -> StepResult:
        """One step with actions."""
        self._give("given", actions)
        return self._finished("given", self._all.step())

    def step_controls(self, controls: ArrayLike) -> StepResult:
        """One step with controls, without actuation."""
        self._give("given_controls", controls)
        return self._finished("given_controls", self._all.step_controls())

    def step_single(self, action: ArrayLike) -> tuple[NDArray[np.float32], list[float], bool]:
        """One step of the only run."""
        table, observation, given = self._only
        if type(action) is np.ndarray and action.shape == self._one_action and action.dtype.char in _PLAIN:
            given[:] = action
        else:
            self._give("given", np.asarray(action)[None])
        failed = self._all.step()
        if failed:
            self._refuse("given", failed)
        self._failed, self._stepped, self.over = failed, True, self._all.over
        self._copies.clear()
        return observation.copy(), table.tolist(), self.over == 1

    def _give(self, name: str, values: ArrayLike) -> None:
        to: Floats = getattr(self._all, name)
        if type(values) is np.ndarray and values.shape == to.shape and values.dtype.char in _PLAIN:
            to[:] = values
        else:
            to[:] = self._readers[name].read(values, self.n)

    def _finished(self, name: str, failed: int) -> StepResult:
        self._refuse(name, failed)
        self._failed, self._stepped, self.over = failed, True, self._all.over
        self._copies.clear()
        result = self.result
        assert result is not None
        return result

    def _refuse(self, name: str, failed: int) -> None:
        """Raise for values that the environments did not accept, in the words of their reader."""
        if failed < 0:
            self._readers[name](getattr(self._all, name), self.n, self._all.ended)

    def _look(self) -> None:
        self._copies.clear()
        self._stepped = False
        self._all.look()
        self.over = self._all.over

    def _take_keys(self, rows: NDArray[np.intp], seeds: Sequence[int]) -> None:
        if not self._certain:
            self._all.keys[rows] = [draw_key(self._task_id, seed) for seed in seeds]

    def _table(self) -> Floats:
        found: Floats | None = self._copies.get("table")
        if found is None:
            found = self._copies["table"] = self._all.table.copy().T
        return found

    def _copy(self, name: str) -> NDArray[Any]:
        found: NDArray[Any] | None = self._copies.get(name)
        if found is None:
            found = self._copies[name] = read_only(getattr(self._all, name).copy())
        return found
