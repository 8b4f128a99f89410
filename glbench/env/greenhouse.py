"""The Gymnasium environment: one greenhouse, one task, one episode at a time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from glbench.arrays import real_numbers, unknown_type
from glbench.env import rendering, spaces
from glbench.env.actuation import TO_NUMBERS
from glbench.env.info import FAILURE, STEP_REWARD, InfoWriter
from glbench.env.simulation import Simulation
from glbench.errors import ActionError
from glbench.tasks import Normalisation

if TYPE_CHECKING:
    from glbench.env.kernels import Stepper
    from glbench.env.snapshot import Snapshot
    from glbench.tasks import TaskSpec


class GreenhouseEnv(spaces.WithHorizon, gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """A greenhouse under control, as a task defines it.

    ``gymnasium.make("glbench:glbench/Schiphol2010-Delta10-v1")`` makes one.

    ## Description

    The GreenLight model simulates climate and crop of a Dutch greenhouse. In each step (15 minutes in the shipped tasks)
    the agent moves boiler, CO2 supply, screens, vents and lamps, or those of them that the task grants. It earns and pays what the
    task's ledger says, such as fruit grown, heat, electricity and CO2, and loses reward for every limit of the climate that was broken.
    All numbers are per m2 of floor.

    ## Action space

    ``Box(-1, 1, (m,), float32)`` for the actuation kind ``rate``: the share of the largest change allowed in a step, for each
    control of the task. ``Box(0, 1, (m,), float32)`` for ``set_point``: the target of each control. ``Box(-1, 1, (m,), float32)``
    for ``process_computer``: set points, from the lowest at -1 to the highest at 1; ``env.unwrapped.task.actions`` has their ranges and
    units, and converts (``Action.of``, ``Action.value``). An action that is not finite,
    or outside its bounds by more than 1e-6, raises ``ActionError``: nothing is clipped on the way in.

    ## Observation space

    ``Box`` of float32 with finite bounds; ``env.unwrapped.task.observed()`` names the columns with their units, bounds and typical
    ranges. The bounds are limits that no observation can exceed, far beyond what occurs. ``normalise=True`` maps typical ranges to -1 to 1.

    ## Reward

    The sum of the task's reward modules, without unit. Violations are judged by the true state after the step.

    ## Episodes

    An episode ends (``terminated``) after exactly ``task.steps`` steps (``spec.max_episode_steps``): the season is over, so there is
    no value to bootstrap from. ``truncated`` is always false. A step that cannot be integrated ends the
    episode at once with the reward of a failed step, and ``info["failure"]`` says why.

    ``reset(seed=s)`` starts the episode of seed s, the same on every day and in every batch. ``reset()`` draws the next
    episode's seed from ``np_random``, which the last given seed determines; ``info["seed"]`` tells it.

    ## Info

    Flat, plain numbers; ``glbench.env.info_quantities(task)`` lists names, units and meanings.

    Parameters
    ----------
    task
        Id, path of a task file, or the task itself.
    kernel
        Name of a preset or a ``Kernel``. Scores are made with ``"reference"``, the default; ``"standard"`` and ``"fast"`` are
        for training, ``"tight"`` checks the others. Environments of a thread share a preset's kernel, made at the first reset.
    render_mode
        ``"ansi"``: ``render`` returns a few lines of text. ``"rgb_array"``: a picture of the last two days, ``(480, 640, 3)`` uint8,
        which needs the extra ``video``. ``None``: nothing.
    split
        Of a task with splits, which scenarios episodes are drawn from: "training", which is meant when none is named, "validation" or
        "test". A task with only a test split, such as those of the suite ``transfer``, gives seasons that are not scored ("preview"), to
        look at and to try an agent in, not to train on. ``split="test"`` gives its scored seasons.
    overrides
        What differs from the task, such as ``{"weather.days": 30, "sensors": None}``, as for ``TaskSpec.replace``.
    normalise
        Scale the typical range of every column to -1 to 1, without clipping (``glbench.tasks.Normalisation``).

    ## Version History

    * v1: first version (glbench 0.1.0). The version at the end of an id is the task's: a published task never changes.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  # as Gymnasium declares it
        "render_modes": list(rendering.drawable_modes()),
        "render_fps": rendering.FRAMES_PER_SECOND,
    }

    def __init__(
        self,
        task: TaskSpec | str,
        kernel: Stepper | str | None = None,
        render_mode: str | None = None,
        split: str | None = None,
        overrides: Mapping[str, Any] | None = None,
        normalise: bool = False,
    ) -> None:
        self.task = spaces.task_of_environment(task, split, overrides)
        self._normalisation = Normalisation.of(self.task.observed()) if normalise else None
        self.render_mode = rendering.checked_render_mode(render_mode)
        if render_mode == rendering.PICTURES:  # Gymnasium would refuse to render, before ``render`` can say what to install
            self.metadata = {**self.metadata, "render_modes": list(rendering.RENDER_MODES)}
        self.observation_space = spaces.observation_space(self.task, self._normalisation)
        self.action_space = spaces.action_space(self.task)
        self.simulation = Simulation(self.task, 1, kernel)
        self._info = InfoWriter(self.task)
        self._camera = rendering.Camera(self.simulation) if render_mode == rendering.PICTURES else None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode.

        Raises ``GlbenchError`` for an impossible seed or option, or a snapshot of another task. ``seed``, 0 to 2**64 - 1, also seeds
        ``np_random``; without one the next seed is drawn. The option ``{"state": snapshot}`` continues from a snapshot instead; no seed
        goes with it. Returns the observation ``(columns,)`` float32, and the numbers of ``info_quantities`` but those of a step.
        """
        snapshot = spaces.state_option(spaces.check_names(options, (spaces.STATE,)), seed)
        if snapshot is not None:
            return self.restore(snapshot)
        number = None if seed is None else spaces.checked_seed(seed)
        super().reset(seed=number)
        observation = self.simulation.reset([spaces.draw_seed(self.np_random) if number is None else number])[0]
        if self._camera is not None:
            self._camera.begin()
        return self._normalise(observation), self._info.standing(self.simulation)

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Take one step.

        Raises ``ActionError`` for an action of the wrong shape, not finite, or out of bounds. Raises ``GlbenchError`` when the episode has
        ended or none was started. Returns the observation ``(columns,)`` float32, reward, ``terminated``, ``truncated``, which is always
        ``False``, and the numbers of ``info_quantities``.
        """
        try:
            observation, values, terminated = self.simulation.step_single(action)
        except ActionError:  # speak of one action, not of a row of a batch
            numbers = real_numbers(action)
            expected = f"Expected shape {self.action_space.shape}: {', '.join(one.name for one in self.task.actions)}."
            if numbers is None:
                kind = f"array of {action.dtype}" if type(action) is np.ndarray else type(action).__name__
                problem = unknown_type(action) or "Its entries are not real numbers."
                msg = f"The action ({kind}) cannot be read. {problem} {expected} {TO_NUMBERS}"
            elif numbers.shape != self.action_space.shape:
                msg = f"The action has shape {numbers.shape}. {expected}"
            else:
                raise
            raise ActionError(msg) from None
        info = self._info.stepped(self.simulation, values)
        if self._camera is not None:
            self._camera.follow_only(values, info["epi"])
        if terminated:
            result = self.simulation.result
            if result is not None and result.failed:
                info[FAILURE] = result.failed[0].reason
        return self._normalise(observation), info[STEP_REWARD], terminated, False, info

    def _normalise(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        return observation if self._normalisation is None else self._normalisation(observation)

    def render(self) -> str | NDArray[np.uint8] | None:
        """Climate, controls and money as text or as a picture ``(480, 640, 3)``, or ``None`` without a render mode.

        Raises ``GlbenchError`` for a picture without matplotlib, or before the first reset.
        """
        if self._camera is not None:
            return self._camera.picture(0)
        return None if self.render_mode is None else rendering.panel(self.simulation, 0, self.simulation.result)

    def snapshot(self) -> Snapshot:
        """Everything needed to continue this episode, and draw the same seeds for the next, with the same bits."""
        return replace(self.simulation.snapshot(), generators=spaces.pack_generator(self.np_random)[None])

    def restore(self, snapshot: Snapshot) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Continue from a snapshot of one row; observation and info as after a reset. Raises ``GlbenchError`` for another task or more."""
        observation = self.simulation.restore(snapshot)[0]
        if len(snapshot.generators):
            self.np_random = spaces.unpack_generator(snapshot.generators[0])
        if self._camera is not None:
            self._camera.begin()
        return self._normalise(observation), self._info.standing(self.simulation)
