"""What is recorded and shown of a run, as one description: columns, MCAP channels, curves, pages and words all follow from it.

``Signals`` is handed in; no other file of this room names a state, a control, a cost, or counts them. The second half of this file is
the description for the greenhouse with tomatoes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from glbench.env import QUANTITIES
from glbench.model import CONTROLS, DISTURBANCES, STATES
from glbench.tasks import task_card
from glbench.tasks.quantities import LIMITED

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec

Floats = NDArray[np.float64]
Columns = Mapping[str, Floats]
"""Columns of an episode by name, each ``(steps,)``."""
Moment = Literal["start", "end"]
Source = Literal["control", "disturbance", "air", "state", "quantity"]
"""Where a simulation has a number: the vectors u, d and x, the climate measured in the air, or the table of a step's quantities."""
_ACTS: frozenset[Source] = frozenset({"control", "disturbance"})
"""Sources of what acts during a step; all others are measured at its end."""
_BEGUN: frozenset[Source] = frozenset({"air", "state"})
"""Sources that also have values at step 0, before anything was done."""

TOPICS: dict[Moment, str] = {"start": "/inputs", "end": "/outcome"}
"""Topics of a record: what acts during a step, and the result at its end."""
MESSAGES = {"/inputs": "Inputs", "/outcome": "Outcome"}
"""Message type of each topic."""
ACTION = "action"
"""Group of what the agent answered."""
_PARTS = {ACTION: ("agent_action", "AgentAction"), "state": ("model_state", "ModelState")}
"""Part and message type of the groups that are not called like them."""


@dataclass(frozen=True)
class Column:
    """One column: ``name``, ``unit``, and ``meaning`` in words."""

    name: str
    unit: str
    meaning: str


@dataclass(frozen=True)
class Group:
    """Columns that belong together: a message type of their own, which is a part of the message of their topic.

    Steps are numbered from 1; step k lasts from t(k-1) to t(k). Groups of the moment ``"start"`` act during the whole step and carry the
    time of its start; groups of the moment ``"end"`` are measured when it is over and carry the time of its end. ``field`` is the name of
    the part. ``at_start`` is true for groups that also have a sample at step 0. A column's name occurs once among all groups.

    All groups of one moment are parts of one message, because MCAP keeps an uncompressed index entry of 16 bytes for each message: with a
    message for each group it was a quarter of a file.
    """

    name: str
    field: str
    message: str
    moment: Moment
    at_start: bool
    columns: tuple[Column, ...]

    @property
    def topic(self) -> str:
        """Topic of the record in which the group stands."""
        return TOPICS[self.moment]

    @property
    def path(self) -> str:
        """Where Foxglove finds the group: topic and part, as in ``/outcome.climate``."""
        return f"{self.topic}.{self.field}"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns, in order."""
        return tuple(column.name for column in self.columns)


def make_group(name: str, columns: Iterable[Column], moment: Moment, *, at_start: bool) -> Group:
    """A group; its part and message type are called like it, but for the two of ``_PARTS``."""
    field, message = _PARTS.get(name, (name, name.capitalize()))
    return Group(name, field, message, moment, at_start, tuple(columns))


@dataclass(frozen=True)
class Signal:
    """One number of every step: a column of the record's ``group``, which the simulation has at ``index`` of ``source``."""

    name: str
    unit: str
    meaning: str
    group: str
    source: Source
    index: int


@dataclass(frozen=True)
class Curve:
    """One curve for each controller. Nothing is recomputed but sums over time, differences, and factors of units.

    Attributes
    ----------
    path
        Place in the recording, ``group/quantity``; the controller's name follows, unless the curve is ``shared``.
    title, unit
        As shown.
    columns
        Names of the columns that it is made of.
    form
        ``value`` of the column; its ``sum`` from the first step on, in the order of the steps, so that the last value is the run's
        metric; ``beyond``: the second of two columns minus the first, of which one is 0 in every step; ``any``: the sum of the largest
        of several columns, such as the hours with at least one limit broken.
    factor
        From the column's unit to the one shown.
    moment
        Whether a value belongs to the ``start`` of its step, from where it holds, or to its ``end``.
    limits
        The task's constraint that belongs to it, if any.
    shared
        Whether it is the same for all controllers, such as the weather.
    slow
        Whether it is first shown over the whole episode, as sums are, and not over a few days.
    span
        Range of values shown first; ``None``: as the values are.
    """

    path: str
    title: str
    unit: str
    columns: tuple[str, ...]
    form: Literal["value", "sum", "beyond", "any"] = "value"
    factor: float = 1.0
    moment: Moment = "end"
    limits: str | None = None
    shared: bool = False
    slow: bool = False
    span: tuple[float, float] | None = None

    @property
    def summed(self) -> bool:
        """Whether it is a sum, which begins at 0."""
        return self.form in ("sum", "any")

    @property
    def whole(self) -> bool:
        """Whether it is first shown over the whole episode."""
        return self.slow or self.summed

    @property
    def heading(self) -> str:
        """Title with unit."""
        return f"{self.title} [{self.unit}]"

    def values(self, columns: Columns) -> Floats:
        """The curve ``(steps,)`` from the columns of a record, in ``unit``."""
        found = [columns[name] for name in self.columns]
        if self.form == "beyond":
            return found[1] - found[0]
        curve: Floats = np.max(found, axis=0) if self.form == "any" else found[0] * self.factor
        return np.cumsum(curve) if self.summed else curve


@dataclass(frozen=True)
class Page:
    """A page of plots in the viewer."""

    title: str
    curves: tuple[Curve, ...]


@dataclass(frozen=True)
class Signals:
    """What is recorded and shown of runs of one kind of task.

    Attributes
    ----------
    recorded
        Every column but the agent's actions, in the order of the record.
    pages
        The curves, page by page.
    overview
        Paths of the curves of the overview, column by column: outcome, climate, controls.
    worst
        Column that tells the days to look at closely: those with its largest sum.
    names
        How the card calls a constraint.
    prices
        The task's prices in words: price, unit and what it is of.
    income, costs, harvest, total, reward
        Columns whose sums the card tells of every controller.
    """

    recorded: tuple[Signal, ...]
    pages: tuple[Page, ...]
    overview: tuple[tuple[str, ...], ...]
    worst: str
    names: Mapping[str, str]
    prices: tuple[tuple[str, str, str], ...]
    total: str
    income: str
    costs: tuple[str, ...]
    harvest: str
    reward: str

    @property
    def curves(self) -> tuple[Curve, ...]:
        """All curves."""
        return tuple(curve for page in self.pages for curve in page.curves)

    @property
    def needed(self) -> tuple[str, ...]:
        """Columns that a record must have to be shown."""
        shown = (name for curve in self.curves for name in curve.columns)
        return tuple(
            dict.fromkeys((*shown, self.worst, self.total, self.income, *self.costs, self.harvest, self.reward))
        )

    def vector(self, source: Source) -> tuple[Signal, ...]:
        """The signals of a source, in the order of its vector."""
        return tuple(sorted((one for one in self.recorded if one.source == source), key=lambda one: one.index))

    @property
    def width(self) -> int:
        """Numbers that a run has in a step, the weather not counted: it is the task's."""
        return sum(signal.source != "disturbance" for signal in self.recorded)

    def groups(self, agent_columns: Iterable[str], *, controls: bool) -> tuple[Group, ...]:
        """All groups, in the order of the record: what acts during a step, then its result.

        ``agent_columns`` are the controls that the agent drives; ``controls`` is true for privileged ones, which set the controls
        themselves.
        """
        what = "control asked for" if controls else "action"
        meaning = {signal.name: signal.meaning for signal in self.vector("control")}
        actions = (Column(f"action_{name}", "-", f"{what}: {meaning[name]}") for name in agent_columns)
        members: dict[str, list[Signal]] = {}
        for signal in self.recorded:
            members.setdefault(signal.group, []).append(signal)
        return (
            make_group(ACTION, actions, "start", at_start=False),
            *(
                make_group(
                    name,
                    (Column(one.name, one.unit, one.meaning) for one in listed),
                    "start" if listed[0].source in _ACTS else "end",
                    at_start=listed[0].source in _BEGUN,
                )
                for name, listed in members.items()
            ),
        )

    def tables(self, vectors: Mapping[Source, Floats]) -> dict[str, Floats]:
        """Values ``(steps, columns)`` by group, of the sources ``(steps, entries)`` that are given."""
        places: dict[str, tuple[Source, list[int]]] = {}
        for signal in self.recorded:
            if signal.source in vectors:
                places.setdefault(signal.group, (signal.source, []))[1].append(signal.index)
        return {name: vectors[source][:, chosen] for name, (source, chosen) in places.items()}


def signals_of(task: TaskSpec | None = None) -> Signals:
    """The description for ``task``: so far all tasks have the greenhouse with tomatoes."""
    return GREENHOUSE


def price_words(task: TaskSpec, signals: Signals) -> str:
    """The prices of ``task``, as in ``heat 0.09 EUR/kWh``."""
    prices = task_card(task).prices
    return "; ".join(f"{what} {getattr(prices, name):g} EUR/{unit}" for name, unit, what in signals.prices)


# The greenhouse with tomatoes.

_CROP = ("tCan", "tCan24", "cBuf", "cLeaf", "cStem", "cFruit", "tCanSum")
"""States of the group ``crop``; all others stand in ``state``, so that no number stands in a file twice."""
_COSTS = ("cost_heat", "cost_electricity", "cost_co2")
_ECONOMICS = ("reward", "epi", "revenue", *_COSTS, "heat", "electricity", "co2_dosed", "fruit_fresh")
"""Amounts of one step, not sums since the start."""
_AIR = {
    "air_temperature": "air temperature",
    "co2": "CO2 of the indoor air",
    "relative_humidity": "relative humidity of the indoor air",
}
_CELSIUS, _PERCENT, _PPM, _ONE = "°C", "%", "ppm", "–"
_EUR, _KG, _GRAM, _HOURS = "EUR m⁻²", "kg m⁻²", "g m⁻²", "h"
_HOURS_OUTSIDE = tuple(quantity.name for quantity in QUANTITIES if quantity.name.startswith("hours_outside_"))
_SHUT_TO_OPEN = (-5.0, 105.0)
"""Range of the controls [%], with room for lines at its ends."""


def _recorded() -> tuple[Signal, ...]:
    states = [
        Signal(s.name, s.unit, s.meaning, "crop" if s.name in _CROP else "state", "state", i)
        for i, s in enumerate(STATES)
    ]
    amounts = {q.name: Signal(q.name, q.unit, q.meaning, "economics", "quantity", i) for i, q in enumerate(QUANTITIES)}
    broken = ("penalty", *(name for name in amounts if name.startswith(("violation_", "hours_outside_"))))
    return (
        *(Signal(c.name, "-", c.meaning, "controls", "control", i) for i, c in enumerate(CONTROLS)),
        *(Signal(d.name, d.unit, d.meaning, "weather", "disturbance", i) for i, d in enumerate(DISTURBANCES)),
        *(Signal(name, LIMITED[name], meaning, "climate", "air", i) for i, (name, meaning) in enumerate(_AIR.items())),
        *sorted((one for one in states if one.group == "crop"), key=lambda one: _CROP.index(one.name)),
        *(one for one in states if one.group == "state"),
        *(amounts[name] for name in _ECONOMICS),
        *(replace(amounts[name], group="violations") for name in broken),
    )


def _climate(path: str, title: str, unit: str, column: str, limits: str | None = None) -> Curve:
    return Curve(f"climate/{path}", title, unit, (column,), limits=limits)


def _crop(path: str, title: str, column: str, unit: str = _GRAM, factor: float = 1e-3) -> Curve:
    return Curve(f"crop/{path}", title, unit, (column,), factor=factor, slow=True)


def _total(path: str, title: str, unit: str, column: str) -> Curve:
    return Curve(path, f"{title}, summed", unit, (column,), "sum")


def _control(path: str, title: str, column: str) -> Curve:
    return Curve(f"controls/{path}", title, _PERCENT, (column,), factor=100.0, moment="start", span=_SHUT_TO_OPEN)


def _weather(path: str, title: str, unit: str, column: str) -> Curve:
    return Curve(f"weather/{path}", title, unit, (column,), moment="start", shared=True)


def _violation(name: str, title: str, unit: str) -> Curve:
    columns = (f"violation_{name}_low", f"violation_{name}_high")
    return Curve(f"violations/{name}", f"{title} beyond its limits, − below, + above", unit, columns, "beyond")


_PAGES = (
    Page("Climate", (
        _climate("air_temperature", "Air temperature", _CELSIUS, "air_temperature", "air_temperature"),
        _climate("relative_humidity", "Relative humidity", _PERCENT, "relative_humidity", "relative_humidity"),
        _climate("co2", "CO₂", _PPM, "co2", "co2"),
        _climate("canopy_temperature", "Canopy temperature", _CELSIUS, "tCan"),
        _climate("pipe_temperature", "Rail pipe temperature", _CELSIUS, "tPipe"),
    )),
    Page("Crop and harvest", (
        _total("crop/fruit_fresh", "Fruit grown, fresh", _KG, "fruit_fresh"),
        _crop("fruit", "Carbohydrates in the fruit", "cFruit"),
        _crop("leaves", "Carbohydrates in the leaves", "cLeaf"),
        _crop("stems", "Carbohydrates in stems and roots", "cStem"),
        _crop("buffer", "Carbohydrate buffer", "cBuf"),
        _crop("canopy_temperature_24h", "Canopy temperature, 24 h mean", "tCan24", _CELSIUS, 1.0),
    )),
    Page("Controls", (
        _control("boiler", "Boiler valve (heating)", "uBoil"),
        _control("vents", "Roof vents open", "uVent"),
        _control("lamps", "Lamps", "uLamp"),
        _control("co2_dosing", "CO₂ dosing valve", "uCo2"),
        _control("thermal_screen", "Thermal screen closed", "uThScr"),
        _control("blackout_screen", "Blackout screen closed", "uBlScr"),
    )),
    Page("Weather", (
        _weather("global_radiation", "Sun outside (global radiation)", "W m⁻²", "iGlob"),
        _weather("temperature", "Outside temperature", _CELSIUS, "tOut"),
        _weather("wind", "Wind", "m s⁻¹", "wind"),
        _weather("vapour_pressure", "Outside vapour pressure", "Pa", "vpOut"),
    )),
    Page("Money", (
        _total("money/epi", "Economic performance (EPI)", _EUR, "epi"),
        _total("money/revenue", "Revenue of the fruit", _EUR, "revenue"),
        _total("money/cost_heat", "Cost of heat", _EUR, "cost_heat"),
        _total("money/cost_electricity", "Cost of electricity", _EUR, "cost_electricity"),
        _total("money/cost_co2", "Cost of CO₂", _EUR, "cost_co2"),
        _total("money/reward", "Reward", _ONE, "reward"),
    )),
    Page("Violations", (
        _violation("air_temperature", "Air temperature", _CELSIUS),
        _violation("relative_humidity", "Relative humidity", _PERCENT),
        _violation("co2", "CO₂", _PPM),
        Curve("violations/hours", "Time outside the limits, summed", _HOURS, _HOURS_OUTSIDE, "any"),
        _total("violations/penalty", "Penalty", _ONE, "penalty"),
    )),
)  # fmt: skip
_OVERVIEW = (
    ("money/epi", "crop/fruit_fresh", "money/cost_electricity", "violations/hours"),
    ("climate/air_temperature", "climate/relative_humidity", "climate/co2", "weather/global_radiation"),
    ("controls/boiler", "controls/vents", "controls/lamps", "controls/co2_dosing"),
)

GREENHOUSE = Signals(
    recorded=_recorded(),
    pages=_PAGES,
    overview=_OVERVIEW,
    worst="penalty",
    names={"air_temperature": "air temperature", "co2": "CO₂", "relative_humidity": "relative humidity"},
    prices=(
        ("fruit", "kg", "tomatoes"),
        ("heat", "kWh", "heat"),
        ("electricity", "kWh", "electricity"),
        ("co2", "kg", "CO₂"),
    ),
    total="epi",
    income="revenue",
    costs=_COSTS,
    harvest="fruit_fresh",
    reward="reward",
)
"""The greenhouse with tomatoes."""
