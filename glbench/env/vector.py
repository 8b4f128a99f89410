"""The vector environment: many greenhouses of one task, stepped as one batch in one process."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from glbench.env import spaces
from glbench.env.greenhouse import GreenhouseEnv
from glbench.env.info import InfoWriter, add_failures, add_objects
from glbench.env.kernels import SCORING_PRESET, check_kernel
from glbench.env.rendering import PICTURES, Camera, checked_render_mode, panel
from glbench.env.simulation import Simulation, check_runs
from glbench.errors import GlbenchError, ShapeError, UnknownNameError, did_you_mean, refuse, whole_number
from glbench.kernel import make_kernel
from glbench.tasks import Normalisation

if TYPE_CHECKING:
    from glbench.env.kernels import Stepper
    from glbench.env.simulation import StepResult
    from glbench.env.snapshot import Snapshot
    from glbench.tasks import TaskSpec

Observations = NDArray[np.float32]
Actions = NDArray[np.floating[Any]]
Step = tuple[Observations, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]


class GreenhouseVectorEnv(spaces.WithHorizon, VectorEnv[Observations, Actions, NDArray[Any]]):
    """``num_envs`` greenhouses of one task; row i behaves, to the bit, like a ``GreenhouseEnv`` with the seed of row i.

    ``gymnasium.make_vec("glbench:glbench/Schiphol2010-Delta10-v1", num_envs=8)`` makes one.

    Spaces, reward, episodes and the numbers in ``info`` are those of ``GreenhouseEnv``; each entry of ``info`` is an array
    with one value a row and comes with a mask ``_name`` of the rows it holds for.

    ``reset(seed=s)`` gives row i the seed s + i; a list gives each row its own (``None``: drawn). ``reset_mask`` resets some rows only.

    Parameters
    ----------
    task
        Id, path of a task file, or the task itself.
    num_envs
        Number of rows.
    kernel
        Name of a preset or a ``Kernel``, as for ``GreenhouseEnv``. ``"standard"`` and ``"fast"`` trade accuracy for speed in
        training; scores are made with the default, ``"reference"``.
    workers
        Cores that share the rows, to the same bits: threads of the compiled kernel (CasADi steps on one core). Goes
        with a preset, not with a ``Kernel``, which has its own.
    autoreset_mode
        What happens to a row whose episode ended. ``NEXT_STEP`` (the default, as in Gymnasium): the next step ignores its
        action, starts a new episode and returns its first observation with reward 0. ``SAME_STEP``: a new episode starts
        at once; the last observation and info of the old one are in ``info["final_obs"]`` and ``info["final_info"]``.
        ``DISABLED``: the row must be reset with the option ``reset_mask`` before the next step.
    render_mode
        As for ``GreenhouseEnv``; ``render`` returns one text or picture for each row.
    split, overrides, normalise
        As for ``GreenhouseEnv``.
    """

    def __init__(
        self,
        task: TaskSpec | str,
        num_envs: int = 1,
        *,
        kernel: Stepper | str | None = None,
        workers: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        split: str | None = None,
        overrides: Mapping[str, Any] | None = None,
        normalise: bool = False,
    ) -> None:
        check_runs(num_envs)
        self.task = spaces.task_of_environment(task, split, overrides)
        self._normalisation = Normalisation.of(self.task.observed()) if normalise else None
        check_kernel(kernel, self.task)
        if whole_number(workers, "The number of workers") != 1 and not isinstance(kernel, str | None):
            msg = "Give the vector environment a Kernel or a number of workers, not both; a preset's name goes with workers."
            raise GlbenchError(msg)
        self.num_envs = num_envs
        self.render_mode = checked_render_mode(render_mode)
        if not isinstance(autoreset_mode, AutoresetMode):
            modes = {mode.value: mode for mode in AutoresetMode}
            if autoreset_mode not in modes:
                refuse(f"There is no autoreset mode {autoreset_mode!r}.{did_you_mean(str(autoreset_mode), modes)}", UnknownNameError)
            autoreset_mode = modes[autoreset_mode]
        self.autoreset_mode = autoreset_mode
        self.metadata = {**GreenhouseEnv.metadata, "autoreset_mode": self.autoreset_mode}
        self.single_observation_space = spaces.observation_space(self.task, self._normalisation)
        self.single_action_space = spaces.action_space(self.task)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        if workers != 1:
            preset = str(kernel or SCORING_PRESET)
            kernel = make_kernel(self.task.model_value, self.task.step_seconds, workers=workers, preset=preset)
        self.simulation = Simulation(self.task, num_envs, kernel)
        self._info = InfoWriter(self.task)
        self._camera = Camera(self.simulation) if render_mode == PICTURES else None
        self._generators: list[np.random.Generator] = []
        self._generator_seeds: list[int] = []
        self._result: StepResult | None = None

    @property  # type: ignore[misc]  # read-only, one for each row, as in SyncVectorEnv
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """The generators that draw the seeds of the next episodes, one for each row."""
        self._make_generators()
        return tuple(self._generators)

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """What these were seeded with."""
        self._make_generators()
        return tuple(self._generator_seeds)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Start an episode in every row, or in those of the option ``reset_mask``, or continue from the option ``state``.

        Raises ``GlbenchError`` for impossible seeds or options.
        """
        options = dict(spaces.check_names(options, (spaces.STATE, spaces.RESET_MASK)))
        snapshot = spaces.state_option(options, seed)
        if snapshot is not None:
            return self.restore(snapshot)
        mask = spaces.mask_option(options, self.num_envs)
        seeds: list[int | None] = [None] * self.num_envs
        if isinstance(seed, Sequence | np.ndarray):
            if len(seed) != self.num_envs:
                refuse(f"reset got {len(seed)} seeds for {self.num_envs} environments. Give one seed an environment.", ShapeError)
            seeds = [None if one is None else spaces.checked_seed(one) for one in seed]
        elif seed is not None:
            first = spaces.checked_seed(seed)
            seeds = [spaces.checked_seed(first + row) for row in range(self.num_envs)]
        self._start(np.flatnonzero(mask), seeds)
        self._result = None
        return self._normalise(self.simulation.observe()), self._reset_info(mask)

    def step(self, actions: Actions) -> Step:
        """Take one step in every row.

        Raises ``ActionError`` for actions of the wrong shape, not finite, or out of bounds (in rows that are not being reset). Raises
        ``GlbenchError`` when no episode was started, or in mode ``DISABLED`` a row has ended and was not reset. Returns observations,
        rewards, terminations, truncations and infos, with one entry a row.
        """
        any_over = self.simulation.over > 0
        over = self.simulation.ended
        if any_over:
            if self.autoreset_mode is not AutoresetMode.NEXT_STEP:
                rows = np.flatnonzero(over).tolist()
                refuse(f"The episodes of rows {rows} have ended. Reset them with the option 'reset_mask'.", GlbenchError)
            if over.all():  # every row starts a new episode
                observations = self._start(np.arange(self.num_envs))
                self._result = None
                terminated = np.zeros(self.num_envs, dtype=np.bool_)
                return self._normalise(observations), np.zeros(self.num_envs), terminated, terminated.copy(), self._reset_info(~terminated)
        result = self._result = self.simulation.step(actions)
        if self._camera is not None:
            self._camera.follow(result, np.flatnonzero(~over).tolist())
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self.simulation.over:
            ended = result.terminated  # new episodes in these rows, the end of the old ones in the info
            final = self._info.masked(self._info.columns(self.simulation, result), ended, ended)
            add_failures(final, result)
            last = {row: self._normalise(result.observations[row]) for row in np.flatnonzero(ended).tolist()}
            observations = self._start(np.flatnonzero(ended))
            everywhere = np.ones(self.num_envs, dtype=np.bool_)
            info = self._info.masked(self._info.columns(self.simulation, result), everywhere, ~ended)
            add_objects(info, "final_obs", last, self.num_envs)
            info["final_info"], info["_final_info"] = final, ended.copy()
            terminated = ended.copy()
        else:
            terminated = result.terminated & ~over if any_over else result.terminated.copy()
            observations = self._start(np.flatnonzero(over)) if any_over else result.observations
            columns = self._info.columns(self.simulation, result)
            if any_over:
                info = self._info.masked(columns, np.ones(self.num_envs, dtype=np.bool_), ~over)
            else:
                info = self._info.everywhere(columns, self.num_envs)
            add_failures(info, result)
        return (self._normalise(observations), result.rewards.copy(), terminated, np.zeros(self.num_envs, dtype=np.bool_), info)

    def render(self) -> tuple[str, ...] | tuple[NDArray[np.uint8], ...] | None:
        """A text or a picture ``(480, 640, 3)`` for each row, or ``None`` without a render mode.

        Raises ``GlbenchError`` for pictures without matplotlib, or before the first reset.
        """
        if self._camera is not None:
            return tuple(self._camera.picture(row) for row in range(self.num_envs))
        if self.render_mode is None:
            return None
        return tuple(panel(self.simulation, row, self._result) for row in range(self.num_envs))

    def snapshot(self) -> Snapshot:
        """Everything needed to continue all rows, and draw the same seeds for their next episodes, with the same bits."""
        generators = np.stack([spaces.pack_generator(generator) for generator in self.np_random])
        return replace(self.simulation.snapshot(), generators=generators)

    def restore(self, snapshot: Snapshot) -> tuple[Observations, dict[str, Any]]:
        """Continue from ``snapshot``; observations and infos as after a reset. Raises ``GlbenchError`` for another task or row count."""
        observations = self.simulation.restore(snapshot)
        if len(snapshot.generators):
            self._generators = [spaces.unpack_generator(words) for words in snapshot.generators]
            self._generator_seeds = [-1] * self.num_envs
        self._result = None
        if self._camera is not None:
            self._camera.begin()
        return self._normalise(observations), self._reset_info(np.ones(self.num_envs, dtype=np.bool_))

    def _normalise(self, observations: Observations) -> Observations:
        return observations if self._normalisation is None else self._normalisation(observations)

    def _make_generators(self) -> None:
        if not self._generators:
            pairs = [seeding.np_random() for _ in range(self.num_envs)]
            self._generators = [generator for generator, _ in pairs]
            self._generator_seeds = [seed for _, seed in pairs]

    def _start(self, rows: NDArray[np.intp], seeds: Sequence[int | None] | None = None) -> Observations:
        """Start episodes in ``rows`` with their entries of ``seeds``, or seeds drawn from their generators."""
        self._make_generators()
        numbers = []
        for row in rows.tolist():
            seed = None if seeds is None else seeds[row]
            if seed is None:
                seed = spaces.draw_seed(self._generators[row])
            else:
                self._generators[row], self._generator_seeds[row] = seeding.np_random(seed)
            numbers.append(seed)
        observations = self.simulation.reset(numbers, None if len(rows) == self.num_envs else rows)
        if self._camera is not None:
            self._camera.begin(None if len(rows) == self.num_envs else rows.tolist())
        return observations

    def _reset_info(self, rows: NDArray[np.bool_]) -> dict[str, Any]:
        """Info of ``rows``, which begin an episode."""
        return self._info.masked(self._info.columns(self.simulation, None), rows, rows)
