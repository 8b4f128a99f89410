"""Predictive control as baselines: one that sees the true state, and one that estimates it from what a task shows.

Both plan with ``glbench.control.PredictiveController`` and settings from a YAML file, and act through the task's actuation.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from glbench.agents.controllers import controller
from glbench.agents.protocol import check_runs
from glbench.agents.views import visible_columns
from glbench.arrays import Floats
from glbench.control import Climatology, EndValue, Outlook, PredictiveController, Scenario, StateEstimator, actions_of
from glbench.env.actuation import make_actuation
from glbench.errors import GlbenchError, SubmissionError, UnknownNameError, refuse
from glbench.quantities import AIR
from glbench.resources import data_folder, write_atomically
from glbench.settings import Table, read_settings

if TYPE_CHECKING:
    from glbench.tasks import TaskCard, TaskSpec


_Count = Annotated[int, Field(ge=1, le=10_000)]

PREDICTIVE_BASELINES = ("mpc", "mpc_greenhouse", "mpc_energy")
"""The shipped settings of the controller "mpc": each has end values for models of its own."""
_PLANNED = ("rate", "set_point")
"""Kinds of actuation whose actions move single controls."""


class PredictiveSettings(Table):
    """What ``baselines/mpc_true_state/settings.yml`` explains: how far, how often and how carefully is planned.

    ``sees`` is the view of ``mpc`` (``glbench.agents.views``): all other readings count as missing. Without it, it sees all of them.
    ``parameters`` is the set of parameters that ``mpc`` plans and estimates with, such as "benchmark"; without it, the task's own.
    ``restart`` is that of ``StateEstimator``. ``end_values`` are by id of a model, or of a task, which goes before its model.
    """

    horizon_hours: Annotated[float, Field(gt=0.0, le=240.0)]
    plan_every: _Count
    iterations: _Count
    first_iterations: _Count
    ascent_steps: _Count
    renew_every: _Count
    margin: dict[str, Annotated[float, Field(ge=0.0)]]
    end_values: dict[str, dict[str, Any]]
    sees: tuple[str, ...] | None = None
    parameters: str | None = None
    restart: bool = False

    def check(self, task: TaskSpec) -> None:
        """Raise ``SubmissionError`` when the actions are not about single controls, or there is no end value for the task's model."""
        if self.end_value(task) is None:
            able = predictive_baseline(task)
            msg = (
                f"There is no end value for the model of {task.id}, {task.model_id}; there are some for {', '.join(self.end_values)}. "
                "In a checkout, python baselines/end_values.py makes them for other tasks (docs/control.md)."
                + (f" The baseline {able} has one for {task.model_id}." if able != PREDICTIVE_BASELINES[0] else "")
            )
            raise SubmissionError(msg)
        if task.actuation.kind not in _PLANNED:
            refuse(f"{task.id} has a process computer at the actuators. Predictive control plans single controls.", SubmissionError)

    def end_value(self, task: TaskSpec) -> dict[str, Any] | None:
        """The end value for a task: its own, or that of its model."""
        return self.end_values.get(task.id, self.end_values.get(task.model_id))

    def controller(self, task: TaskSpec) -> PredictiveController:
        """A controller for a task. Raises ``SubmissionError`` as for ``check``, or when it cannot be planned for."""
        self.check(task)
        try:
            return PredictiveController(
                task,
                horizon=max(round(self.horizon_hours * 3600.0 / task.step_seconds), self.plan_every),
                iterations=self.iterations,
                first_iterations=self.first_iterations,
                end_value=EndValue.read(self.end_value(task) or {}),
                margin={name: by for name, by in self.margin.items() if name not in AIR or name in dict(task.constraints.items())},
                ascent_steps=self.ascent_steps,
                renew_every=self.renew_every,
            )
        except GlbenchError as error:
            refuse(f"{task.id} cannot be planned for: {error}", SubmissionError, error)


def read_predictive_settings(path: Path) -> PredictiveSettings:
    """Read the settings. Raises ``SubmissionError`` when the file cannot be read, lacks a setting, or has an unknown or impossible one."""
    settings = read_settings(PredictiveSettings, path, "the settings of predictive control")
    try:
        for value in settings.end_values.values():
            EndValue.read(value)
    except GlbenchError as error:
        refuse(f"The settings of predictive control {path} cannot be used: {error}", SubmissionError, error)
    return settings


def predictive_baseline(task: TaskSpec) -> str:
    """The baseline of ``PREDICTIVE_BASELINES`` with an end value for the task's model; the first where none has one."""
    return next((name for name in PREDICTIVE_BASELINES if _shipped_settings(name).end_value(task) is not None), PREDICTIVE_BASELINES[0])


def can_be_planned(task: TaskSpec) -> bool:
    """Whether a shipped baseline of predictive control can play the task."""
    try:
        _shipped_settings(predictive_baseline(task)).check(task)
    except SubmissionError:
        return False
    return True


def _shipped_settings(name: str) -> PredictiveSettings:
    return read_predictive_settings(data_folder("baselines") / name / "settings.yml")


def write_predictive_agent(folder: Path, view: str, task: TaskSpec) -> None:
    """Write the baseline that plans for a task, with a view (``glbench.agents.views``), to ``folder``, as an agent."""
    shipped = data_folder("baselines") / predictive_baseline(task)
    settings = f"{(shipped / 'settings.yml').read_text(encoding='utf-8')}\nsees: [{view}]\n"
    card = (shipped / "card.toml").read_text(encoding="utf-8").replace('title = "', f'title = "View {view}: ', 1)
    for name, text in (("settings.yml", settings), ("card.toml", card)):
        write_atomically(folder / name, text)


class _Steering:
    """The controls in force in some runs, as they follow from the actions that were taken."""

    def __init__(self, task: TaskSpec, runs: int) -> None:
        self._task, self._move = task, None if task.on_off else make_actuation(task)
        self.controls = np.tile(task.initial_controls, (runs, 1))

    def towards(self, controls: Floats) -> Floats:
        """Actions that bring about controls ``(runs, controls)``, of which the scheduled ones come about by themselves."""
        actions = actions_of(self._task, self.controls, controls)
        # Plans keep to the loads and hold times of machines, so what is planned for these comes about.
        self.controls = controls.copy() if self._move is None else np.clip(self._move(self.controls, actions), 0.0, 1.0)
        self.controls[:, [*self._task.scheduled_places.values()]] = controls[:, [*self._task.scheduled_places.values()]]
        return actions


@controller(
    "mpc_true_state",
    read=read_predictive_settings,
    version=(
        "bbd462e65f9c85feeb5dd0e56292bdbe07adaaf95fccb7736293c77bec062442 c9c4998d8192f4ffa4551be3802850d2ba3bf26ea79904fc849cf112ef9afa2f"
    ),
    sees="scenario",
    information=(
        "privileged: true states, all weather to come, the parameters of the run in every step to come; acts through the task's actuation"
    ),
)
class TrueStateController:
    """Predictive control with perfect information: a ``ScenarioController``."""

    def __init__(self, settings: PredictiveSettings) -> None:
        self.settings = settings

    def reset(self, task: TaskSpec, seeds: Sequence[int], /) -> None:
        """Learn everything about the runs that begin. Raises ``SubmissionError`` when the task cannot be planned for."""
        self._task, self._step = task, 0
        self._scenarios = [Scenario.of(task, seed) for seed in seeds]
        self._controller = self.settings.controller(task)
        self._controller.reset(len(seeds))
        self._steering = _Steering(task, len(seeds))

    def act(self, x: Floats, /) -> Floats:
        """Actions for the coming step. Raises ``ShapeError`` when there are not as many rows as runs."""
        check_runs(x, len(self._scenarios), "states")
        k = self._step
        self._step += 1
        if k % self.settings.plan_every:
            return self._steering.towards(self._controller.follow())
        ahead = slice(k, min(k + self._controller.horizon, self._task.steps))
        scenarios = self._scenarios
        controls = self._controller.decide(
            x,
            self._steering.controls,
            np.stack([one.d[ahead] for one in scenarios]),
            np.stack([one.p if one.p.ndim == 1 else one.p[ahead] for one in scenarios]),
            np.stack([one.calendar[ahead.start : ahead.stop + 1] for one in scenarios]),
            (self._task.steps - k) / self._task.steps_per_day,
        )
        return self._steering.towards(controls)


@controller(
    "mpc",
    read=read_predictive_settings,
    version=(
        "bbd462e65f9c85feeb5dd0e56292bdbe07adaaf95fccb7736293c77bec062442 89f3d6f9cd3064159e1a8013ac4e48bf5340ebb6788e92ff418da40687dab753"
    ),
    information="observations, the public definition of the task, and the mean days of its training years",
)
class PredictiveAgent:
    """Predictive control that knows what an agent knows; an ``Agent``.

    States and parameters are estimated from what is observed, and the weather to come is what the forecast and the time of the year say.
    What is out of its view (``sees``) counts as missing: with nothing measured inside, states follow from the model alone.
    """

    def __init__(self, settings: PredictiveSettings) -> None:
        self.settings = settings

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """``n_runs`` runs of ``task`` begin. Raises ``SubmissionError`` when the task cannot be planned for, or has no such view."""
        spec, sees = task.task(), self.settings.sees
        if self.settings.parameters is not None:
            try:
                changes = {"model.parameters": self.settings.parameters} | ({"model.overrides": None} if spec.model.overrides else {})
                spec = spec.replace(changes)
            except GlbenchError as error:
                refuse(f"'parameters': {error}", SubmissionError, error)
        try:
            self._hidden = None if sees is None else ~visible_columns(spec, sees)
        except UnknownNameError as error:
            refuse(f"'sees': {error}", SubmissionError, error)
        self._controller = self.settings.controller(spec)
        self._controller.reset(n_runs)
        self._outlook, self._estimator = Outlook(spec, Climatology.of(spec)), StateEstimator(spec, restart=self.settings.restart)
        self._outlook.reset(n_runs)
        self._estimator.reset(n_runs)
        self._steering = _Steering(spec, n_runs)
        self._task, self._step = spec, 0

    def act(self, observations: NDArray[np.float32], /) -> Floats:
        """Actions for the coming step. Raises ``TaskError`` when there are not as many rows as runs, or other columns than the task's."""
        k, controls = self._step, self._steering.controls
        self._step += 1
        if self._hidden is not None:
            observations = np.where(self._hidden, np.float32(np.nan), observations)
        self._outlook.update(observations)
        states = self._estimator.update(observations, self._outlook.past, controls)
        if k % self.settings.plan_every:
            return self._steering.towards(self._controller.follow())
        steps = min(self._controller.horizon, self._task.steps - k)
        ahead = self._outlook.ahead(steps)
        off = self._estimator.weather_errors(steps, ahead.d)
        days_left = (self._task.steps - k) / self._task.steps_per_day
        return self._steering.towards(
            self._controller.decide(
                states, controls, ahead.d + off, self._estimator.parameters, ahead.calendar, days_left, self._estimator.delivery(steps)
            )
        )
