"""Built-in controllers: how to declare one, and the base class of those that act on observations.

``@controller`` above a class declares a controller, and ``MODULES`` names the module that contains it. A folder of
``baselines/`` names the controller in its card, together with settings or weights (``baselines.py``).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from glbench.agents.identity import OBSERVATIONS_ONLY
from glbench.agents.protocol import Agent, PrivilegedController, ScenarioController, Sight, check_runs
from glbench.arrays import Floats
from glbench.errors import SubmissionError

if TYPE_CHECKING:
    from glbench.tasks import TaskCard

Maker = TypeVar("Maker", bound=Callable[..., Any])

MODULES = {
    "actor": "network_policy", "grower": "grower", "mpc": "predictive", "mpc_lettuce": "lettuce", "mpc_true_state": "predictive",
    "network": "network_policy", "plans": "plans", "recording": "plans", "rule_based": "rules", "rule_based_energy": "energy_rules",
    "rule_based_fair": "rules", "rule_based_harvest": "harvest_rules", "rule_based_lettuce": "lettuce", "rule_based_tuned": "tuned_rules",
}  # fmt: skip
"""Module of ``glbench.agents`` that declares a controller, by the controller's name: a process loads only the modules it needs."""


@dataclass(frozen=True)
class Controller:
    """A built-in controller, as ``controller`` declares it."""

    read: Callable[[Path], Any]
    make: Callable[[Any], Agent | PrivilegedController | ScenarioController]
    version: str
    sees: Sight
    information: str


CONTROLLERS: dict[str, Controller] = {}  # The controllers declared so far; ``find_controller`` loads the others


def controller(
    name: str, *, read: Callable[[Path], Any], version: str, sees: Sight = "observations", information: str = OBSERVATIONS_ONLY
) -> Callable[[Maker], Maker]:
    """Declare the class below as the controller called ``name``; the class is called with what ``read`` returns.

    ``name`` is what cards call it. ``read`` reads what a card calls the settings (a file or folder): rules, a grower's page, trained
    policies, recorded actions. ``sees`` is what the controller is shown, and ``information`` the same in words, for results.

    ``version`` is part of the digest of every agent of this controller. The source may change as long as the actions stay the same;
    ``baselines/lock.toml`` records the actions of the shipped baselines, and a test compares them. If the actions change, the version must
    change. The first version of older controllers is the SHA-256 of their source when their first results were released.
    """

    def declare(make: Maker) -> Maker:
        CONTROLLERS[name] = Controller(read, make, version, sees, information)
        return make

    return declare


def find_controller(name: str) -> Controller:
    """The controller called ``name``, one of ``CONTROLLERS`` or ``MODULES``."""
    if name not in CONTROLLERS:
        import_module(f"glbench.agents.{MODULES[name]}")
    return CONTROLLERS[name]


_SECONDS_AN_HOUR = 3600.0
_SECONDS_A_DAY = 86400.0
_DAYS_A_YEAR = 365.0  # as the observation counts
CLOCK = ("sin_hour_of_day", "cos_hour_of_day", "sin_day_of_year", "cos_day_of_year")  # Observations that tell the time


def clock_from(readings: Mapping[str, Floats]) -> tuple[Floats, Floats]:
    """Hour of day [h] and day of year [day] from their sines and cosines.

    The hour is rounded to whole seconds: float32 blurs it by milliseconds, and rules compare it with full hours.
    """
    turn = np.arctan2(readings["sin_hour_of_day"], readings["cos_hour_of_day"]) / (2.0 * math.pi)
    seconds = np.mod(np.rint(turn * _SECONDS_A_DAY), _SECONDS_A_DAY)
    year = np.arctan2(readings["sin_day_of_year"], readings["cos_day_of_year"]) / (2.0 * math.pi)
    return seconds / _SECONDS_AN_HOUR, np.mod(year, 1.0) * _DAYS_A_YEAR


class ObservedController(ABC):
    """Base class of controllers that act on observations; an ``Agent``.

    It passes ``decide`` the readings and the positions of controls by name, each an array (n,) with one number per run.
    ``towards`` turns the wanted controls into actions. A subclass calls ``begin`` in its ``reset``.
    """

    title: ClassVar[str]
    """What messages call it."""
    actuations: ClassVar[tuple[str, ...]] = ("rate", "set_point")
    """Kinds of actuation that it supports."""

    runs = 0

    @abstractmethod
    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """Clear all memory; ``n_runs`` runs of ``task`` begin."""

    @abstractmethod
    def decide(self, readings: dict[str, Floats], positions: dict[str, Floats], /) -> Floats:
        """Actions (n_runs, actions) for the observations."""

    def act(self, observations: NDArray[np.float32], /) -> Floats:
        """Actions (n_runs, actions). Raises ``ShapeError`` when the number of rows differs from the number of runs passed to ``reset``."""
        check_runs(observations, self.runs)
        # Rows of an array of their own: numpy may take another path, with another last bit, through the columns of a larger one.
        rows = observations.T[self._places].astype(np.float64, order="C")
        positions = rows[len(self._names) :] / self._at_one
        return self.decide(dict(zip(self._names, rows, strict=False)), dict(zip(self._position_names, positions, strict=True)))

    def begin(
        self, task: TaskCard, n_runs: int, needed: Sequence[str], optional: Iterable[str] = (), positions: Iterable[str] = ()
    ) -> None:
        """Find the columns of a task.

        ``needed`` and ``optional`` are observations; ``positions`` are controls whose positions are needed. If actions are changes, the
        positions of the controls that they change are read as well. Raises ``SubmissionError`` when the task has another kind of actuation,
        or does not show what is needed.
        """
        self.check_actuation(task)
        controls = {control.name: control for control in task.controls}
        changed = task.action_names if task.actuation == "rate" else ()
        read = [controls[name] for name in dict.fromkeys([*positions, *changed])]
        columns = {name: index for index, name in enumerate(task.observation_names)}
        required = dict.fromkeys([*needed, *(control.quantity for control in read)])
        missing = [name for name in required if name not in columns]
        if missing:
            msg = f"{task.id} does not show the observations {', '.join(missing)}, without which {self.title} cannot act."
            raise SubmissionError(msg)
        self._names = [*needed, *(name for name in optional if name in columns and name not in needed)]
        self._position_names = [control.name for control in read]
        self._places = [columns[name] for name in (*self._names, *(control.quantity for control in read))]
        # Where nothing is installed the observation is 0, whatever it is divided by.
        self._at_one = np.array([[one.at_one if one.at_one > 0.0 else 1.0] for one in read]).reshape(-1, 1)
        self.task, self.runs = task, n_runs

    def check_actuation(self, task: TaskCard) -> None:
        """Refuse a kind of actuation that is not one of ``actuations``. Raises ``SubmissionError`` when it is none of them."""
        if task.actuation not in self.actuations:
            names = " or ".join(f"'{name}'" for name in self.actuations)
            msg = f"The actuation of {task.id} is '{task.actuation}', and {self.title} can act through {names} only."
            if task.actuation == "process_computer":
                msg += " The baseline 'grower' works at a process computer."
            raise SubmissionError(msg)

    def towards(self, controls: Mapping[str, Floats], positions: Mapping[str, Floats]) -> Floats:
        """Actions (n, actions) towards controls, by name: at once, or as fast as the actuation allows."""
        names = self.task.action_names
        actions = np.stack([controls[name] for name in names])
        if self.task.actuation == "rate":
            change = (actions - np.stack([positions[name] for name in names])) / self.task.max_change
            actions = np.minimum(np.maximum(change, -1.0), 1.0)
        return actions.T
