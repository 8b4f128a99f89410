"""The task card: what an agent may know of its task. It holds no weather values and no seeds.

In a sandbox there are no task files. An evaluation passes the public definition of its task to the agent's process, which calls
``set_task`` with it. From then on ``get_task`` finds that task there, and no other. The definition is as public as the card: models,
parameters, limits, prices and how widely things are drawn. Weather that it names is not there, so whatever needs weather fails.
"""

from __future__ import annotations

import datetime as dt
import json
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from glbench.errors import TaskError, refuse
from glbench.tasks.ledger import LIMITED, LedgerItem
from glbench.tasks.quantities import PAPER_MODEL, Action, Capacity, Quantity

if TYPE_CHECKING:
    from glbench.tasks.spec import TaskSpec


@dataclass(frozen=True)
class Place:
    """Where the greenhouse stands: degrees north and east, metres above sea level, time zone (IANA name)."""

    station: str
    latitude: float
    longitude: float
    altitude: float
    timezone: str


@dataclass(frozen=True)
class Constraint:
    """A quantity that should stay between ``low`` and ``high``.

    ``scale`` is the violation that costs 1 a step; where violations have prices, 1 EUR m-2, and ``price`` is that of a unit and hour. Where
    values below ``low`` have another price, it is ``lower_price``, and both others are of values above ``high``.
    """

    name: str
    unit: str
    low: float
    high: float
    scale: float
    price: float | None = None
    lower_price: float | None = None


@dataclass(frozen=True)
class Prices:
    """Prices [EUR per kg fresh fruit, kg CO2, kWh heat, kWh electricity] and dry matter content [kg dry per kg fresh]."""

    fruit: float
    dry_matter_content: float
    co2: float
    heat: float
    electricity: float


@dataclass(frozen=True)
class TaskCard:
    """Public information about a task.

    ``observations`` and ``actions`` are in the order of the arrays; ``controls`` are all controls of the model with what each
    delivers at 1. An action of kind ``rate`` in [-1, 1] moves its control by ``max_change`` times the action; one
    of kind ``set_point`` in [0, 1] is the control asked for, reached by at most ``max_change`` a step; one of kind
    ``process_computer`` in [-1, 1] stands for a set point between ``lowest`` and ``highest`` in its own unit: ``Action.of`` turns set
    points into actions, ``Action.value`` actions into set points. ``delta`` and ``half_width``: how widely uncertain parameters are drawn.
    ``ledger`` says what is earned and paid; ``prices`` are those of a task of schema 1. ``task`` reads ``definition``, the public one.
    """

    id: str
    title: str
    steps: int
    step_seconds: float
    start: dt.date
    clock: str
    place: Place
    observations: tuple[Quantity, ...]
    timing: str
    forecast_steps: int
    actions: tuple[Action, ...]
    actuation: str
    max_change: float
    controls: tuple[Capacity, ...]
    constraints: tuple[Constraint, ...]
    prices: Prices | None
    reward_modules: tuple[str, ...]
    delta: float
    half_width: float
    redraw: str
    model: str = PAPER_MODEL
    ledger: tuple[LedgerItem, ...] = ()
    definition: str = ""

    def task(self) -> TaskSpec:
        """The task itself, without seeds and salts, for agents that compute with its model or its reward.

        Raises ``TaskError`` when the card was made of a task that no file can say.
        """
        from glbench.tasks.spec import TaskSpec  # a card is read without the model

        if not self.definition:
            refuse(f"The card of {self.id} does not hold its task: it was changed in a way that no file can say.", TaskError)
        return TaskSpec.from_tables(json.loads(self.definition))

    @cached_property
    def action_bounds(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Lowest and highest action, each ``(m,)``."""
        bounds = np.array([(action.low, action.high) for action in self.actions]).reshape(-1, 2).T
        bounds.flags.writeable = False
        return bounds[0], bounds[1]

    @property
    def observation_names(self) -> tuple[str, ...]:
        """Names of the observed columns."""
        return tuple(quantity.name for quantity in self.observations)

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the entries of an action: the controls that they drive, or set points."""
        return tuple(action.name for action in self.actions)


def task_card(task: TaskSpec) -> TaskCard:
    """Card of ``task``."""
    record, scales, prices, lower = task.record(), task.penalty_scales, task.violation_prices, task.lower_prices
    return TaskCard(
        id=task.id,
        title=task.title,
        steps=task.steps,
        step_seconds=task.step_seconds,
        start=task.weather.start,
        clock="UTC" if task.weather.preprocessing == "paper" else record.timezone,
        place=Place(record.station, record.latitude, record.longitude, record.altitude, record.timezone),
        observations=task.observed(),
        timing=task.observation.timing,
        forecast_steps=task.observation.forecast_steps,
        actions=task.actions,
        actuation=task.actuation.kind,
        max_change=task.actuation.max_change,
        controls=task.capacities(),
        constraints=tuple(
            Constraint(name, LIMITED[name], limits.low, limits.high, scales[name], prices.get(name), lower.get(name))
            for name, limits in task.constraints.items()
        ),
        prices=None if task.file.prices is None else Prices(**task.file.prices.model_dump()),
        reward_modules=task.reward.modules,
        delta=task.uncertainty.delta,
        half_width=task.uncertainty.half_width,
        redraw=task.uncertainty.redraw,
        model=task.model_id,
        ledger=task.ledger.items,
        definition=public_definition(task),
    )


_DEFINITION: list[str] = []


def public_definition(task: TaskSpec) -> str:
    """The definition of ``task`` for its agents as text: without the first seed and the salt; "" for a task that has no file.

    A round's secret, the split and where the file lies are not part of it.
    """
    try:
        tables: dict[str, Any] = task.as_tables()
    except TaskError:
        return ""
    tables["evaluation"]["first_seed"] = 0
    tables.get("scenario", {}).pop("salt", None)
    return json.dumps(tables)


def set_task(definition: str) -> None:
    """Let ``get_task`` find the task of a ``public_definition``, in the life of this process."""
    _DEFINITION[:] = [definition] if definition else []


def injected_task(task_id: str) -> TaskSpec | None:
    """The injected task, if it has that id or short form. Raises ``TaskError`` when its parts are registered in another process."""
    if not _DEFINITION:
        return None
    task = _task_of(_DEFINITION[0])
    return task if task_id in (task.id, task.short_id) else None


@lru_cache(maxsize=1)
def _task_of(definition: str) -> TaskSpec:
    from glbench.tasks.spec import TaskSpec

    try:
        return TaskSpec.from_tables(json.loads(definition))
    except ValueError as error:
        refuse(f"The task cannot be read in this process: {error}", TaskError, error)
