"""What an agent is: four small protocols, the adapter between an agent for one run and an evaluation of many, and checks of actions.

An agent sees observations and the public task card, nothing else: no states, no coming weather, no seeds. Only controllers that
are part of glbench may be privileged; every result says so.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import Floats, real_numbers, unknown_type
from glbench.errors import ActionError, ShapeError, refuse

if TYPE_CHECKING:
    from glbench.tasks import TaskCard, TaskSpec

Observations = NDArray[np.float32]  # What agents see: shape (n, observations of the task), in the units of the task card
Actions = Floats  # What agents return: shape (n, actions of the task), within the bounds of the task card
ROUNDING = 1e-6  # How far an action may lie outside its bounds: what float32 arithmetic loses
Sight = Literal["observations", "state", "scenario"]
"""What an agent sees: what the task shows, the true state (``PrivilegedController``), or everything (``ScenarioController``)."""


@runtime_checkable
class Agent(Protocol):
    """An agent that decides for all runs of an evaluation at once: one row a run.

    Row i of the observations is the same run throughout; runs do not know of each other. A run that ended early keeps its row,
    and what is decided for it is ignored.
    """

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """Forget everything; ``n_runs`` runs of ``task`` begin."""

    def act(self, observations: Observations, /) -> Actions:
        """Actions (n_runs, actions) for ``observations`` (n_runs, observations), called once a control step."""


def check_runs(rows: NDArray[Any], n_runs: int, what: str = "observations") -> None:
    """Refuse ``rows`` of another number of runs than an agent was reset for. Raises ``ShapeError`` when it is another."""
    if len(rows) != n_runs:
        refuse(f"act got {what} of {len(rows)} runs, reset was called with {n_runs}. Call reset first.", ShapeError)


@runtime_checkable
class SingleRunAgent(Protocol):
    """An agent that knows one run only; ``make_agent(task)`` is called once a run, so each run has an instance of its own.

    The class says ``single_run = True``. Such an agent is easier to write and slower to run than ``Agent``.
    """

    @property
    def single_run(self) -> bool:
        """True: one instance a run."""

    def reset(self, task: TaskCard, /) -> None:
        """Forget everything; a run of ``task`` begins."""

    def act(self, observation: NDArray[np.float32], /) -> Floats:
        """Action (actions,) for the ``observation`` (observations,) of this run."""


@runtime_checkable
class PrivilegedController(Protocol):
    """A controller of glbench itself that sees the model's state and disturbances and sets controls directly.

    ``controls`` is asked at the start of every control step and its answer bypasses the task's actuation: no rate limit.
    """

    @property
    def privileged(self) -> bool:
        """True: it sees more than observations."""

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """``n_runs`` runs of ``task`` begin."""

    def controls(self, x: Floats, d: Floats, hour_of_day: float | Floats, day_of_year: float | Floats, /) -> Floats:
        """Controls (n, controls), fractions of capacity, for the coming step.

        ``x`` (n, states) is the state now, ``d`` (n, disturbances) or (disturbances,) the disturbance acting in the coming step,
        ``hour_of_day`` [h] and ``day_of_year`` [day] the clock now, one number or one a run (n,).
        """


@runtime_checkable
class ScenarioController(Protocol):
    """A controller of glbench itself that knows everything that is given in its runs, and acts through the task's actuation.

    What it earns is what could be reached with the draws and the weather to come known.
    """

    def reset(self, task: TaskSpec, seeds: Sequence[int], /) -> None:
        """Runs of ``task`` with ``seeds`` begin; ``glbench.control.Scenario`` tells what is given in each."""

    def act(self, x: Floats, /) -> Actions:
        """Actions (n, actions) for the coming step, given the true states ``x`` (n, states)."""


class PerRunAgent:
    """Makes an ``Agent`` of single-run agents: one instance a run, each sees its own row.

    ``make`` gives a new single-run agent for a task card. ``first`` is one that was made already and becomes the first run's, so that
    ``make`` is called exactly once a run.
    """

    def __init__(self, make: Callable[[TaskCard], SingleRunAgent], first: SingleRunAgent | None = None) -> None:
        self._make = make
        self._first = first
        self.agents: tuple[SingleRunAgent, ...] = ()
        """The agents of the runs, in the order of the rows; empty before the first reset."""

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """Make and reset one agent a run."""
        waiting, self._first = ([self._first] if self._first is not None else []), None
        self.agents = (*waiting[:n_runs], *(self._make(task) for _ in range(n_runs - len(waiting))))
        for agent in self.agents:
            agent.reset(task)

    def act(self, observations: Observations, /) -> Actions:
        """Ask every agent for its row.

        Raises ``ActionError`` when an agent returns something other than one row of numbers, as long as the other agents' rows, and
        ``ShapeError`` when there are not as many rows as runs were announced to ``reset``.
        """
        check_runs(observations, len(self.agents))
        # Own copies: an agent that changes its observation in place must not change what others see or what is recorded.
        rows = []
        for run, agent in enumerate(self.agents):
            answer: object = agent.act(observations[run].copy())
            row = real_numbers(answer)
            if row is None:
                what = f"an array of {answer.dtype}" if type(answer) is np.ndarray else type(answer).__name__
                expected = unknown_type(answer) or "Expected a row of real numbers, one for each action."
                refuse(f"act returned {what} in run {run}. {expected}", ActionError)
            if row.ndim != 1:
                msg = f"act returned an array of shape {row.shape} in run {run}, expected one row of numbers, one for each action."
                raise ActionError(msg)
            with np.errstate(over="ignore"):  # of a longdouble
                rows.append(row.astype(np.float64))
        lengths = {row.shape[0] for row in rows}
        if len(lengths) > 1:
            refuse(f"The agents of different runs returned actions of different lengths: {sorted(lengths)}.", ActionError)
        return np.stack(rows)


def action_problems(returned: object, task: TaskCard, n_runs: int) -> dict[int, str]:
    """Reasons, by run, why what ``act`` returned cannot be used; empty when all is well.

    Expected is an array of shape (n_runs, actions of the task) of numbers, finite and within the bounds of the task card. A
    wrong shape or type is reported for every run, a bad value for its own run only.
    """
    whole = _problem_of_the_whole(returned, task, n_runs)
    if whole is not None:
        return dict.fromkeys(range(n_runs), whole)
    with np.errstate(over="ignore"):  # of a longdouble
        return value_problems(np.asarray(returned, dtype=np.float64), task)


def value_problems(actions: Floats, task: TaskCard) -> dict[int, str]:
    """Reasons, by row, why ``actions`` (n, actions of the task) are not finite or not within the bounds of the task card."""
    low, high = task.action_bounds
    good = (actions >= low - ROUNDING) & (actions <= high + ROUNDING)  # False for nan too
    if good.all():
        return {}
    problems = {}
    for run in np.flatnonzero(~good.all(axis=1)):
        column = int(np.flatnonzero(~good[run])[0])
        value, action = float(actions[run, column]), task.actions[column]
        if np.isfinite(value):
            reason = f"{value:.9g}, outside its bounds {action.low:g} to {action.high:g}"
            if action.stands_for is not None:
                reason += f", which stand for {action.lowest:g} to {action.highest:g} {action.unit} (Action.of converts)"
        else:
            reason = f"{value}, which is not a finite number"
        problems[int(run)] = f"the action for {action.name} is {reason}"
    return problems


def read_actions(returned: object, card: TaskCard, n: int) -> tuple[Floats, dict[int, str]]:
    """Own copy ``(n, m)`` float64 of what ``act`` returned, and the reasons, by row, why its shape or type is wrong; such rows are zero.

    Something of the wrong shape as a whole is wrong in every row; a list of rows of which one has another length is wrong in that row
    only. Values are not looked at: ``value_problems`` does that where the agent cannot reach.
    """
    # As an array of numbers, if it is one: what converts itself may look different every time. What is none is refused below.
    array = returned if type(returned) is np.ndarray else real_numbers(returned)
    once = returned if array is None else array
    whole = _problem_of_the_whole(once, card, n)
    if whole is None:
        with np.errstate(over="ignore"):  # of a longdouble
            return np.array(once, dtype=np.float64), {}
    actions = np.zeros((n, len(card.actions)))
    if n == 1 or not isinstance(returned, list | tuple) or len(returned) != n:
        return actions, dict.fromkeys(range(n), whole)
    problems: dict[int, str] = {}
    for row, part in enumerate(returned):
        one, wrong = read_actions([part], card, 1)
        actions[row] = one[0]
        if wrong:
            problems[row] = wrong[0]
    return actions, problems


def _problem_of_the_whole(returned: object, task: TaskCard, n_runs: int) -> str | None:
    array = real_numbers(returned)
    if array is None:
        parts = returned if isinstance(returned, list | tuple) else ()
        rows = (isinstance(row, list | tuple) or (isinstance(row, np.ndarray) and row.ndim > 0) for row in parts)
        if len({len(row) if is_row else -1 for row, is_row in zip(parts, rows, strict=True)}) > 1:
            return f"act returned a {type(returned).__name__} of rows that differ in length; {_expected(task, n_runs)}"
        what = f"an array of {returned.dtype}" if type(returned) is np.ndarray else f"a {type(returned).__name__}"
        unknown = unknown_type(returned)
        if unknown:
            return f"act returned {what}. {unknown}"
        return f"act returned {what}, which are no plain numbers; {_expected(task, n_runs)}"
    if array.shape != (n_runs, len(task.actions)):
        return f"act returned an array of shape {array.shape}; {_expected(task, n_runs)}"
    return None


def _expected(task: TaskCard, n_runs: int) -> str:
    return f"expected ({n_runs}, {len(task.actions)}): one row a run, in it {', '.join(task.action_names)}"
