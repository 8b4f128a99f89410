"""Names, units and bounds of what a task can show to an agent, whatever the model: the clock, the weather, the controls, all states.

``Action`` is an entry of what the agent does.

What a model shows besides (the climate inside, the crop) is its own, with its bounds (``Model.observed``, ``Model.bounds``).
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from glbench.errors import TaskError, UnknownNameError, did_you_mean, refuse
from glbench.quantities import CLOCK, OUTDOOR
from glbench.tasks.ledger import LIMITED

if TYPE_CHECKING:
    from glbench.model import Horizon, Model
    from glbench.quantities import Entry
    from glbench.vision.library import Library

PAPER_MODEL = "greenlight-tomato-1.0.0"
"""The model of every task of schema 1."""

_WIDEST = 1e12


@dataclass(frozen=True)
class Quantity:
    """One column of an observation: its name, unit and finite bounds."""

    name: str
    unit: str
    low: float
    high: float
    meaning: str

    @property
    def typical(self) -> tuple[float, float]:
        """Typical range: 0.5 to 99.5 percentile, rounded outwards, in training seasons of rule-based agents.

        It never changes for a column. A forecast has the range of its quantity; columns without an entry in ``typical_ranges.csv``
        (clock, controls, whole states) have their bounds. ``python baselines/typical_ranges.py`` measures missing columns.
        """
        return _typical_ranges().get((_AHEAD.sub("", self.name), self.unit), (self.low, self.high))


_AHEAD = re.compile(r"_in_\d+h$")


@cache
def _typical_ranges() -> Mapping[tuple[str, str], tuple[float, float]]:
    """Lowest and highest typical value by name and unit."""
    lines = files("glbench.tasks").joinpath("typical_ranges.csv").read_text(encoding="utf-8").splitlines()
    rows = csv.DictReader(lines)
    return {(row["name"], row["unit"]): (float(row["low"]), float(row["high"])) for row in rows}


Observations = TypeVar("Observations", bound=Any)


@dataclass(frozen=True, eq=False)
class Normalisation:
    """Scales observations: each column's typical range becomes -1 to 1, without clipping."""

    middle: NDArray[np.float32]
    scale: NDArray[np.float32]
    """``middle`` and ``scale``: of each column ``(columns,)`` float32: an observation becomes ``(observation - middle) * scale``."""

    @classmethod
    def of(cls, columns: Iterable[Quantity]) -> Self:
        """Normalisation of ``task.observed()`` or, in an agent that was trained with ``normalise=True``, of ``card.observations``."""
        low, high = np.array([column.typical for column in columns]).reshape(-1, 2).T
        return cls(((low + high) / 2.0).astype(np.float32), (2.0 / (high - low)).astype(np.float32))

    def __call__(self, observations: Observations) -> Observations:
        """Observations ``(..., columns)`` float32, of NumPy or JAX, normalised."""
        return (observations - self.middle) * self.scale  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Capacity:
    """What a control is and what it delivers at 1."""

    name: str
    """Name in the model."""
    quantity: str
    """Name in observations."""
    unit: str
    at_one: float
    meaning: str


def capacities(model: Model, parameters: Mapping[str, float]) -> tuple[Capacity, ...]:
    """Installed capacities: the controls in the model's order, and what each delivers at 1."""
    return tuple(Capacity(c.name, c.quantity, c.unit, c.capacity, c.meaning) for c in model.capacities(parameters))


@dataclass(frozen=True)
class ObservationContext:
    """What the bounds of an observed quantity may depend on."""

    steps: int
    """Control steps of the horizon."""
    step_seconds: float
    """Length of a control step [s]."""
    forecast_steps: int
    """Rows of coming weather that the task grants."""
    parameters: Mapping[str, float]
    """All model parameters by name, nominal values."""
    model: Model
    """The model whose quantities are shown."""
    forecast_hours: tuple[int, ...] = ()
    """Hours ahead of the forecast by the hour."""
    holds: tuple[tuple[str, float], ...] = ()
    """Controls that stay on or off for a while, and for how long [min]."""
    prices: tuple[tuple[str, str, float, float], ...] = ()
    """Name, unit, lowest and highest price of each price table."""
    day_ahead: tuple[str, ...] = ()
    """Price tables of which coming hours are shown."""
    day_ahead_hours: tuple[int, ...] = ()
    """Hours ahead of their prices."""
    scheduled_controls: tuple[str, ...] = ()
    """Controls that follow a schedule."""
    library: Library | None = None
    """The pictures that a camera takes."""

    @property
    def days(self) -> float:
        """Length of the horizon [day]."""
        return self.steps * self.step_seconds / 86400.0

    @property
    def horizon(self) -> Horizon:
        """The same for the model."""
        from glbench.model import Horizon

        return Horizon(self.steps, self.step_seconds, self.parameters)


@dataclass(frozen=True)
class Action:
    """One entry of an action: what it is called, its bounds, and the quantity that it stands for.

    Raises ``TaskError`` when there is ``stands_for``, and it or the bounds are not finite and in order.
    """

    name: str
    """A control of the task, or a set point."""
    low: float
    high: float
    """``low`` and ``high``: bounds of what an agent gives."""
    unit: str = "-"
    meaning: str = ""
    """``unit`` and ``meaning``: of the quantity that it stands for; "-" for a share."""
    idle: float = 0.0
    """What an agent gives to ask for nothing: no change, no heat beyond frost protection, vents shut, screens open."""
    stands_for: tuple[float, float] | None = None
    """Values [unit] that ``low`` and ``high`` stand for, in a straight line between them; ``None``: what is given is the value."""

    def __post_init__(self) -> None:
        if self.stands_for is None:
            return
        for low, high in ((self.low, self.high), self.stands_for):
            if not (math.isfinite(high - low) and low < high):
                msg = (
                    f"The action '{self.name}' from {self.low:g} to {self.high:g} cannot stand for values from {self.lowest:g} to "
                    f"{self.highest:g} {self.unit}. Give finite bounds, the lower one first."
                )
                raise TaskError(msg)

    @property
    def lowest(self) -> float:
        """Value [unit] that ``low`` stands for."""
        return self.low if self.stands_for is None else self.stands_for[0]

    @property
    def highest(self) -> float:
        """Value [unit] that ``high`` stands for."""
        return self.high if self.stands_for is None else self.stands_for[1]

    def of(self, value: Any) -> Any:
        """What to give for ``value`` [unit]: a number, or an array of any shape. Nothing is clipped."""
        return value if self.stands_for is None else (value - self.lowest) / self._slope + self.low

    def value(self, entry: Any) -> Any:
        """The value [unit] that ``entry`` of an action stands for: a number or an array of any shape, also a recorded value."""
        return entry if self.stands_for is None else (entry - self.low) * self._slope + self.lowest

    @property
    def _slope(self) -> float:
        return (self.highest - self.lowest) / (self.high - self.low)


QuantityTable = Callable[[ObservationContext], tuple[Quantity, ...]]
"""The columns of an observation module in a given task, in the order observed."""


def of_model(module: str) -> QuantityTable:
    """The columns of a module that the model supplies; UnknownNameError where it has no such module."""

    def columns(context: ObservationContext) -> tuple[Quantity, ...]:
        model = context.model
        shown_columns = model.observed(module, context.horizon)
        if shown_columns is None:
            refuse(f"{model.id} has no observation module '{module}'.{did_you_mean(module, model.observation_modules)}", UnknownNameError)
        return tuple(Quantity(column.name, column.unit, column.low, column.high, column.meaning) for column in shown_columns)

    return columns


def _of_catalogue(entries: Mapping[str, Entry], *names: str) -> tuple[Quantity, ...]:
    """Entries of the catalogue as columns: all, or those of these names."""
    return tuple(Quantity(e.name, e.unit, e.low, e.high, e.meaning) for e in (entries[name] for name in names or entries))


def _cycle(name: str, period: str) -> tuple[Quantity, Quantity]:
    return (
        Quantity(f"sin_{name}", "-", -1.0, 1.0, f"sine of the {period}, one turn a cycle"),
        Quantity(f"cos_{name}", "-", -1.0, 1.0, f"cosine of the {period}, one turn a cycle"),
    )


def time(context: ObservationContext) -> tuple[Quantity, ...]:
    """Sine and cosine of the hour of day (24 h), then of the day of year (365 days)."""
    return _cycle("hour_of_day", "hour of day") + _cycle("day_of_year", "day of year")


def local_time(context: ObservationContext) -> tuple[Quantity, ...]:
    """Hour of day and day of year, as ``info`` has them."""
    return _of_catalogue(CLOCK)


def published_time(context: ObservationContext) -> tuple[Quantity, ...]:
    """Sine and cosine of the day of year (365 days), then of the hour of day (24 h)."""
    return _cycle("day_of_year", "day of year") + _cycle("hour_of_day", "hour of day")


def controls(context: ObservationContext) -> tuple[Quantity, ...]:
    """The controls as in force, in physical units, in the model's order."""
    return tuple(Quantity(c.quantity, c.unit, 0.0, c.at_one, c.meaning) for c in capacities(context.model, context.parameters))


def control_fractions(context: ObservationContext) -> tuple[Quantity, ...]:
    """The controls as in force, as fractions of capacity."""
    return tuple(
        Quantity(f"{c.quantity}_fraction", "-", 0.0, 1.0, f"{c.meaning}, share of capacity")
        for c in capacities(context.model, context.parameters)
    )


def switches(context: ObservationContext) -> tuple[Quantity, ...]:
    """For each control that stays on or off for a while, how long it still does; UnknownNameError where there is none."""
    if not context.holds:
        msg = (
            "'switches' shows for how long machines stay on or off, and there is none: add [actuation.on_off.<control>] with hold_minutes."
        )
        raise UnknownNameError(msg)
    by_name = {c.name: c for c in capacities(context.model, context.parameters)}
    return tuple(
        Quantity(f"{by_name[name].quantity}_locked", "min", 0.0, minutes, f"time until it may be switched: {by_name[name].meaning}")
        for name, minutes in context.holds
        if name in by_name  # else the task says that there is no such control
    )


def schedule(context: ObservationContext) -> tuple[Quantity, ...]:
    """Each scheduled control as it will be in the coming step; UnknownNameError where there is none."""
    if not context.scheduled_controls:
        refuse("'schedule' shows controls that follow a schedule, and there is none: add [[schedule]].", UnknownNameError)
    every = {c.name: c for c in capacities(context.model, context.parameters)}
    ones = (every[name] for name in context.scheduled_controls)
    return tuple(Quantity(f"{one.quantity}_scheduled", "-", 0.0, 1.0, f"{one.meaning}, in the coming step") for one in ones)


CAMERA = "camera"
"""The observation module that shows what an encoder sees in a picture."""


def head_mass_of(model: Model) -> Callable[[Any, Any], Any]:
    """The mean mass of a head [g] from states and parameters of ``model``. Raises ``UnknownNameError`` when it has no heads."""
    masses = [signal.of for signal in model.signals() if signal.path == "crop/head" and signal.of is not None]
    if not masses:
        refuse(f"'{CAMERA}' shows heads, and {model.id} has none. Choose a model with heads, or leave the module out.", UnknownNameError)
    return masses[0]


def camera(context: ObservationContext) -> tuple[Quantity, ...]:
    """The features of the last picture; UnknownNameError without a camera, or for a model without heads."""
    if context.library is None:
        refuse(f"'{CAMERA}' shows pictures of a library, and none is named: add [camera] library = \"lettuce-2\".", UnknownNameError)
    head_mass_of(context.model)
    if "mass" not in context.library.truth:
        refuse(
            f"'{CAMERA}' needs pictures by mass, and those of {context.library.crop} have none: library = \"lettuce-2\".", UnknownNameError
        )
    numbers = range(1, len(context.library.columns) + 1)
    return tuple(Quantity(f"{CAMERA}_{n}", "-", -1.0, 1.0, f"feature {n} of the last picture of the crop") for n in numbers)


def prices(context: ObservationContext) -> tuple[Quantity, ...]:
    """The price of now of every price table; UnknownNameError where there is none."""
    if not context.prices:
        refuse("'prices' shows prices that change with time, and there is none: add [price_tables.<name>].", UnknownNameError)
    return tuple(Quantity(f"price_{name}", unit, low, high, f"price '{name}' of now") for name, unit, low, high in context.prices)


def day_ahead_prices(context: ObservationContext) -> tuple[Quantity, ...]:
    """Prices of coming hours, each table for all hours ahead: until midnight as they will be, then as 24 h before."""
    tables = {name: (unit, low, high) for name, unit, low, high in context.prices}
    return tuple(
        Quantity(f"price_{name}_in_{hour}h", *tables[name], f"price '{name}' {hour} h ahead; after midnight that of 24 h before")
        for name in context.day_ahead
        for hour in context.day_ahead_hours
    )


_WEATHER = _of_catalogue(OUTDOOR, "global_radiation", "outdoor_temperature", "outdoor_relative_humidity", "outdoor_co2", "wind_speed")
_PUBLISHED_FORECAST = _of_catalogue(
    OUTDOOR, "global_radiation", "outdoor_temperature", "outdoor_vapour_pressure", "outdoor_co2_density", "wind_speed"
)
_WINDOW = (
    *_of_catalogue(OUTDOOR, "global_radiation"),
    Quantity("outdoor_co2_density", "kg m-3", 0.0, 0.01, OUTDOOR["outdoor_co2_density"].meaning),
    *_of_catalogue(OUTDOOR, "outdoor_temperature"),
    Quantity("outdoor_vapour_density", "kg m-3", 0.0, 0.2, "vapour density outside"),
)


def weather(context: ObservationContext) -> tuple[Quantity, ...]:
    """Global radiation, outdoor temperature, relative humidity, CO2, wind speed."""
    return _WEATHER


def _ahead(rows: int, row: tuple[Quantity, ...]) -> tuple[Quantity, ...]:
    """``rows`` copies of ``row``, row after row; the first is the row after the one that ``weather`` shows."""
    return tuple(
        Quantity(f"{q.name}_ahead_{n}", q.unit, q.low, q.high, f"{q.meaning}, {n} step{'s' if n > 1 else ''} ahead")
        for n in range(1, rows + 1)
        for q in row
    )


def forecast(context: ObservationContext) -> tuple[Quantity, ...]:
    """Weather of the next ``forecast_steps`` rows, five quantities each, row after row."""
    return _ahead(context.forecast_steps, _WEATHER)


FORECAST = _of_catalogue(OUTDOOR, "global_radiation", "outdoor_temperature", "outdoor_relative_humidity", "wind_speed")
"""What is forecast by the hour."""


def weather_forecast(context: ObservationContext) -> tuple[Quantity, ...]:
    """Forecast by the hour: radiation, temperature, humidity and wind, each for all hours ahead.

    Every column is the mean over the hour that ends so many hours after the last full hour, as it was forecast then.
    """
    return tuple(
        Quantity(f"{q.name}_in_{hour}h", q.unit, q.low, q.high, f"{q.meaning}, forecast {hour} h ahead")
        for q in FORECAST
        for hour in context.forecast_hours
    )


def published_forecast(context: ObservationContext) -> tuple[Quantity, ...]:
    """As ``forecast``, with vapour pressure [Pa] and CO2 density [mg m-3] in the places of humidity and CO2."""
    return _ahead(context.forecast_steps, _PUBLISHED_FORECAST)


def weather_window(context: ObservationContext) -> tuple[Quantity, ...]:
    """Radiation, CO2 density [kg m-3], temperature and vapour density [kg m-3] of now, then of the next ``forecast_steps`` rows."""
    return _WINDOW + _ahead(context.forecast_steps, _WINDOW)


def step_counter(context: ObservationContext) -> tuple[Quantity, ...]:
    """Count of steps taken, 0 after reset; with the timing ``published``, the number of the step just taken."""
    return (Quantity("step_counter", "-", 0.0, float(context.steps), "steps since the start"),)


def full_state(context: ObservationContext) -> tuple[Quantity, ...]:
    """All states of the model under their own names and units."""
    bounds = context.model.bounds(context.horizon)
    return tuple(
        Quantity(state.name, state.unit.replace("°C", "degC"), *bounds.get(state.name, (-_WIDEST, _WIDEST)), state.meaning)
        for state in context.model.states
    )


__all__ = ["FORECAST", "LIMITED", "Capacity", "ObservationContext", "Quantity", "QuantityTable", "capacities"]
