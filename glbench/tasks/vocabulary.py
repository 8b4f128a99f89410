"""The words a task file may use: observation and reward modules, kinds of actuation, distributions, start states.

This is data, not behaviour: the environment computes the quantities that are named here. Every registry can be extended
at run time with ``add`` (the environment's ``register_...`` functions do so), and a name that is in none of them is
refused with the nearest known one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

from glbench.errors import TaskError, UnknownNameError, did_you_mean, refuse
from glbench.tasks import quantities as tables
from glbench.tasks.quantities import Action, QuantityTable

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True)
class Word:
    """A word of task files and what it means: reward modules, distributions, preprocessings, model variants, metrics."""

    name: str
    meaning: str


Entry = TypeVar("Entry", bound=Word)


class Registry(Generic[Entry]):
    """The known words of one kind, in the order they were added."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self._entries: dict[str, Entry] = {}

    def add(self, entry: Entry) -> Entry:
        """Make ``entry`` known and return it. Raises ``TaskError`` when the name is taken: no word changes its meaning within a process."""
        if entry.name in self._entries:
            refuse(f"There is a {self.kind} called '{entry.name}' already. Give the new one another name.", TaskError)
        self._entries[entry.name] = entry
        return entry

    def __getitem__(self, name: str) -> Entry:
        try:
            return self._entries[name]
        except KeyError:
            msg = f"There is no {self.kind} called '{name}'.{did_you_mean(name, self._entries)}"
            raise UnknownNameError(msg) from None

    def __contains__(self, name: object) -> bool:
        return name in self._entries

    def __iter__(self) -> Iterator[Entry]:
        return iter(self._entries.values())

    def __len__(self) -> int:
        return len(self._entries)

    @property
    def names(self) -> tuple[str, ...]:
        """All known words."""
        return tuple(self._entries)


@dataclass(frozen=True)
class ObservationModule(Word):
    """A group of observed quantities that a task grants together, in a fixed order."""

    quantities: QuantityTable
    """Names, units and bounds of the columns, given what they may depend on (horizon, installed capacities)."""

    is_forecast: bool = False
    """Whether it shows coming weather: such a module needs ``[observation.forecast]`` in the task file."""
    may_forecast: bool = False
    """Whether it also shows coming weather where the task file has ``[observation.forecast]``."""


@dataclass(frozen=True)
class ActuationKind(Word):
    """How an action becomes controls. It has an entry a control, between ``low`` and ``high``, or those that ``own`` gives."""

    low: float = 0.0
    high: float = 1.0
    own: Callable[[tuple[str, ...]], tuple[Action, ...]] | None = None
    """The entries of an action from the controls that a task grants; ``None``: one for each of them."""

    def actions(self, controls: tuple[str, ...]) -> tuple[Action, ...]:
        """The entries of an action in a task that grants ``controls``."""
        return self.own(controls) if self.own is not None else tuple(Action(name, self.low, self.high) for name in controls)


@dataclass(frozen=True)
class InitialState(Word):
    """What stands in the greenhouse at the start."""

    state: Callable[[NDArray[np.float64], float, NDArray[np.float64]], NDArray[np.float64]] | None = None
    """The state from the first row of weather, the air temperature [degC] and the parameters; ``None``: the model's start of that name."""


OBSERVATION_MODULES: Registry[ObservationModule] = Registry("observation module")
REWARD_MODULES: Registry[Word] = Registry("reward module")
ACTUATION_KINDS: Registry[ActuationKind] = Registry("kind of actuation")
DISTRIBUTIONS: Registry[Word] = Registry("distribution")
INITIAL_STATES: Registry[InitialState] = Registry("initial state")
METRICS: Registry[Word] = Registry("metric")
PREPROCESSINGS: Registry[Word] = Registry("preprocessing")
MODEL_VARIANTS: Registry[Word] = Registry("model variant")
WEEKDAYS: Registry[Word] = Registry("weekday")
FORECAST_ERRORS: Registry[Word] = Registry("level of forecast errors")

WEATHER_FORECAST = "weather_forecast"
"""The observation module that forecasts by the hour, with errors."""
WEATHER_WINDOW = "weather_window"
"""The observation module that shows weather as densities, now and in coming steps."""
PRICES = "prices"
"""The observation module that shows prices of now."""
DAY_AHEAD = "day_ahead_prices"
"""The observation module that shows prices of coming hours."""

for _module in (
    ObservationModule("indoor_climate", "air temperature, CO2, humidity; pipe temperature", tables.of_model("indoor_climate")),
    ObservationModule("crop", "fruit mass, 24-hour mean temperature, temperature sum", tables.of_model("crop")),
    ObservationModule("time", "hour of day and day of year, each as sine and cosine", tables.time),
    ObservationModule("local_time", "hour of day and day of year as plain numbers", tables.local_time),
    ObservationModule(
        "vapour_deficit", "vapour pressure deficit and humidity deficit of the air as observed", tables.of_model("vapour_deficit")
    ),
    ObservationModule("light_today", "radiation outside and PAR above the canopy since midnight", tables.of_model("light_today")),
    ObservationModule("controls", "the controls in force, in physical units", tables.controls),
    ObservationModule("weather", "the five measured weather quantities", tables.weather),
    ObservationModule(
        WEATHER_WINDOW,
        "radiation, temperature, CO2 and vapour density outside, now and in the coming steps",
        tables.weather_window,
        may_forecast=True,
    ),
    ObservationModule("full_state", "all states of the model, in its own units", tables.full_state),
    ObservationModule("step_counter", "number of steps taken", tables.step_counter),
    ObservationModule("forecast", "the weather of the next steps, without error", tables.forecast, is_forecast=True),
    ObservationModule(WEATHER_FORECAST, "radiation, temperature, humidity and wind of coming hours, with errors", tables.weather_forecast),
    # The groups and units of the published code, so that a task can show its 263 columns (docs/observations.md).
    ObservationModule("published_indoor_climate", "as indoor_climate, CO2 first", tables.of_model("published_indoor_climate")),
    ObservationModule("published_crop", "as crop, temperature first, fruit in mg m-2", tables.of_model("published_crop")),
    ObservationModule("switches", "minutes until machines that are on or off may be switched again", tables.switches),
    ObservationModule("schedule", "each scheduled control in the coming step, from 0 to 1", tables.schedule),
    ObservationModule(tables.CAMERA, "features of the last picture of the crop, one a day", tables.camera),
    ObservationModule(PRICES, "the prices of now that change with time", tables.prices),
    ObservationModule(DAY_AHEAD, "prices of coming hours, known until midnight", tables.day_ahead_prices),
    ObservationModule("control_fractions", "the controls in force, as fractions of capacity", tables.control_fractions),
    ObservationModule("published_time", "as time, day of year first", tables.published_time),
    ObservationModule(
        "published_forecast", "as forecast, with vapour pressure in Pa and CO2 in mg m-3", tables.published_forecast, is_forecast=True
    ),
):
    OBSERVATION_MODULES.add(_module)
for _day in ("monday", "tuesday", "wednesday", "thursday", "friday", "saturday", "sunday"):
    WEEKDAYS.add(Word(_day, _day.capitalize()))


def _set_points(controls: tuple[str, ...]) -> tuple[Action, ...]:
    from glbench.tasks.set_points import set_points  # with the model, which a submission's card does without

    return set_points(controls)


for _kind in (
    ActuationKind("rate", "an action from -1 to 1 moves its control by up to max_change a step, within 0 and 1", -1.0, 1.0),
    ActuationKind("set_point", "an action from 0 to 1 asks for a control, which moves there by at most max_change a step", 0.0, 1.0),
    ActuationKind(
        "process_computer",
        "set points, from -1 for the lowest to 1 for the highest, by which a process computer works the controls, each by at most "
        "max_change a step",
        own=_set_points,
    ),
):
    ACTUATION_KINDS.add(_kind)

INITIAL_STATES.add(InitialState("mature_crop", "a bearing crop of leaf area index 2.5; all layers at the given air temperature"))

for _words, _entries in (
    (
        REWARD_MODULES,
        {
            "epi": "economic performance of the step [EUR m-2]",
            "scaled_epi": "economic performance of the step: 0 at full use and no growth, 1 at full growth and no use",
            "penalties": "minus the sum of the constraints' violations, each in its own unit",
            "scaled_penalty": "minus the sum of the constraints' violations, each divided by its penalty scale",
        },
    ),
    (DISTRIBUTIONS, {"uniform": "parameters times 1 + e, e uniform between minus and plus the half width"}),
    (
        PREPROCESSINGS,
        {
            "paper": "as the benchmark paper prepared its weather, its half-hour shifts included; the clock is UTC",
            "conserving": "hourly sums and moments kept exactly; the clock is the greenhouse's own, with summer time",
            "sampled": "as the samples of a trace, each the nearest to the start of its step; the clock is that of the trace",
        },
    ),
    (
        MODEL_VARIANTS,
        {
            "author": "the equations as the author of GreenLight defines them",
            "gl_gym2": "the equations as the published benchmark code has them",
        },
    ),
    (
        FORECAST_ERRORS,
        {
            "none": "no forecast: the weather of now is shown for every hour ahead",
            "low": "half the errors of medium",
            "medium": "errors that grow with the hours ahead: after 24 h 1.9 K, 1.2 m/s, 8 %, and 0.18 of clear-sky radiation",
            "high": "twice the errors of medium",
            "perfect": "the weather as it will be",
        },
    ),
    (
        METRICS,
        {
            "reward": "sum of the reward over the horizon, averaged over the evaluation runs",
            "epi": "profit: sum of the economic performance over the horizon [EUR m-2], averaged over the evaluation runs",
        },
    ),
):
    for _name, _meaning in _entries.items():
        _words.add(Word(_name, _meaning))
