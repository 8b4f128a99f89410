"""Rules of a climate computer whose numbers were tuned: set points by the sun and by light, humidity kept just below the limit.

``baselines/rule_based_tuned`` holds the numbers in YAML files that a grower can read. ``TunedRuleSettings`` is the one place that says
what there is to set, with unit, bounds and meaning: the comments of the files are made of it (``settings_text``), and ``glbench tune
rules`` stays within its bounds. The rules look at observations and the task card alone and act through the task's actuation. They know
the limits of the climate from the card and the sun's hours from place and date.

All arithmetic goes element by element over arrays of shape (n,), one value a run, so that a run gets the same bits alone and in a
batch; every run may have numbers of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple

import numpy as np
from pydantic import BeforeValidator, Field, create_model

from glbench.agents.controllers import CLOCK, ObservedController, clock_from, controller
from glbench.agents.daylight import Sun
from glbench.arrays import Floats
from glbench.errors import ShapeError, SubmissionError, refuse
from glbench.settings import Table, validated
from glbench.tasks.set_points import BLACKOUT, BOILER, DOSING, LAMPS, SCREEN, VENTS, WORKED
from glbench.yaml_reader import read_yaml

if TYPE_CHECKING:
    from glbench.tasks import TaskCard


_SIGNIFICANT = 4
_COMMENT_COLUMN = 32
NEEDED = ("air_temperature", "relative_humidity", "global_radiation", "outdoor_temperature", *CLOCK)
_WELCOME = ("co2", "wind_speed")
"""Looked at where a task shows them: without the one no CO2 is dosed, without the other the air counts as calm."""
_SCREEN_BAND = 3.0  # The thermal screen goes from closed to open while it gets so much warmer outside [K]
_COLD_BAND = 0.7  # Vents go from shut to free while it gets so much warmer inside [K]
_NO_COLD, _FULL_COLD = 2.0, 18.0  # Vents against humidity move less from a difference to the air outside [K] to another
_STRONG_WIND = 10.0  # Wind [m s-1] in which they move least
_LOWEST_TEMPERATURE, _HIGHEST_HUMIDITY = 15.0, 85.0  # Limits [degC] and [%] where a task has none


def number(low: float, high: float, unit: str, words: str, *, section: str | None = None, tuned: bool = True) -> Any:
    """A field of settings: bounds, unit and meaning, the heading that begins above it, and whether a tuner may change it."""
    about: dict[str, Any] = {"unit": unit, "tuned": tuned}
    if section is not None:
        about["section"] = section
    return Field(ge=low, le=high, description=words, json_schema_extra=about)


class TunedRuleSettings(Table):
    """Numbers of the rules. Temperatures [degC], differences of them [K], humidity [%], CO2 [ppm], radiation [W m-2], times [h].

    "Share" is a fraction of what is installed. "Limit" is the task's own: of relative humidity the upper one, of air temperature the
    lower one. Radiation is the global radiation outside.
    """

    title: ClassVar[str] = "rules"
    scope_key: ClassVar[str] = "reward"
    """Key of a page beside the numbers: names of what they are for, here the reward modules of tasks; or ``models``, with ids of models."""

    morning_before_sunrise: float = number(
        0.0, 6.0, "h", "before sunrise the heating temperature leaves that of the night", section="Periods of the day"
    )
    evening_before_sunset: float = number(-2.0, 5.0, "h", "before sunset it leaves that of the day")
    night_after_sunset: float = number(-2.0, 8.0, "h", "after sunset it leaves that of the evening")
    ramp_hours: float = number(0.25, 3.0, "h", "each of these changes takes")

    heating_night: float = number(12.0, 20.0, "degC", "at night", section="Heating temperature")
    heating_morning: float = number(12.0, 24.0, "degC", "before it gets light")
    heating_day: float = number(12.0, 26.0, "degC", "in daylight")
    heating_evening: float = number(12.0, 22.0, "degC", "from the evening on, until the night")
    heating_daylight: float = number(20.0, 500.0, "W m-2", "from so much radiation on it counts as full daylight")
    heating_light_raise: float = number(0.0, 10.0, "K", "more in full sun")
    heating_light_from: float = number(0.0, 400.0, "W m-2", "the raise begins")
    heating_light_span: float = number(50.0, 800.0, "W m-2", "so much later it is complete")

    boiler_band: float = number(0.5, 10.0, "K", "too cold for the boiler to go from nothing to full power", section="Boiler")
    boiler_outside: float = number(0.0, 0.05, "share K-1", "for each degree that it is colder outside than wanted")
    boiler_daylight: float = number(0.0, 0.4, "share", "in daylight, besides")
    boiler_humidity: float = number(0.0, 0.3, "share %-1", "against humidity, for each percent")
    boiler_humidity_above: float = number(-6.0, 4.0, "%", "above the limit (below it when negative) that begins")
    boiler_trend: float = number(0.0, 0.3, "share h K-1", "less, for each degree an hour that it warms up")

    co2_dim: float = number(300.0, 1600.0, "ppm", "in dim light", section="CO2")
    co2_sunny: float = number(300.0, 1600.0, "ppm", "in full sun")
    co2_light_from: float = number(0.0, 300.0, "W m-2", "up to here light is dim")
    co2_light_span: float = number(20.0, 800.0, "W m-2", "so much later it is full sun")
    co2_vents: float = number(0.0, 8000.0, "ppm", "less with fully open vents (in proportion with others)")
    co2_band: float = number(20.0, 600.0, "ppm", "too little for the supply to go from nothing to full")
    co2_dark: float = number(0.0, 60.0, "W m-2", "in less light than this none is dosed")

    vents_humidity_day: float = number(-12.0, 2.0, "%", "above the limit (below it when negative) is wanted by day", section="Vents")
    vents_humidity_night: float = number(-12.0, 2.0, "%", "the same in the dark")
    vents_gain: float = number(0.0, 2.0, "share %-1 h-1", "they open in an hour for each percent too much (integral)")
    vents_trend: float = number(0.0, 0.3, "share %-1", "they open for each percent of rise (proportional)")
    vents_cold_less: float = number(0.0, 0.95, "-", "part of both that is left out when it is 18 K colder outside")
    vents_wind_less: float = number(0.0, 0.95, "-", "part of both that is left out in a wind of 10 m s-1")
    vents_most: float = number(0.05, 1.0, "share", "widest opening against humidity")
    vents_temperature: float = number(18.0, 33.0, "degC", "above it they open for heat")
    vents_light_raise: float = number(0.0, 8.0, "K", "higher in full sun, as with heating")
    vents_band: float = number(1.0, 20.0, "K", "too warm for them to go from shut to open")
    vents_cold: float = number(-1.5, 3.0, "K", "above the limit of temperature: colder they are shut")

    screen_light_from: float = number(0.0, 150.0, "W m-2", "begins to open", section="Thermal screen")
    screen_light_span: float = number(5.0, 300.0, "W m-2", "so much later it is open")
    screen_outdoor: float = number(-5.0, 25.0, "degC", "outside: colder it is closed, 3 K warmer it is open")
    screen_humidity: float = number(-10.0, 10.0, "%", "above the limit (below it when negative) a gap opens")
    screen_gap: float = number(0.0, 0.3, "share %-1", "for each percent, of the screen")
    screen_gap_most: float = number(0.0, 1.0, "share", "widest gap")

    temperature_smoothing: float = number(0.0, 3.0, "h", "the sensor of temperature is smoothed over", section="Sensors")
    humidity_smoothing: float = number(0.0, 3.0, "h", "the sensor of humidity is smoothed over")

    lamps_from: float = number(0.0, 24.0, "h", "of the day they may be on", section="Lamps (not tuned)", tuned=False)
    lamps_until: float = number(0.0, 24.0, "h", "of the same day they go off", tuned=False)
    lamps_radiation: float = number(0.0, 1000.0, "W m-2", "they are off from here on; 0: they are never on", tuned=False)

    @classmethod
    def bounds(cls, name: str) -> tuple[float, float]:
        """Lowest and highest value of the number called ``name``."""
        limits = {type(limit).__name__: limit for limit in cls.model_fields[name].metadata}
        return float(limits["Ge"].ge), float(limits["Le"].le)

    @classmethod
    def tuned_names(cls) -> tuple[str, ...]:
        """Names of the numbers that a tuner may change."""
        return tuple(name for name in cls.model_fields if cls.about(name)["tuned"])

    @classmethod
    def about(cls, name: str) -> dict[str, Any]:
        """Unit of a number, whether a tuner may change it, and the heading that begins above it, if one does."""
        about = cls.model_fields[name].json_schema_extra
        assert isinstance(about, dict)
        return about

    @classmethod
    def is_for(cls, scope: Sequence[str], reward: Sequence[str], task_id: str) -> bool:
        """Whether a page for ``scope``, tasks or reward modules, is for the task ``task_id`` with these reward modules."""
        return task_id in scope if cls.scope_key == "tasks" else tuple(scope) == tuple(reward)


@dataclass(frozen=True)
class RulePage:
    """A file of settings: numbers, and the names of what they are for."""

    scope: tuple[str, ...]
    numbers: TunedRuleSettings
    key: str = ""
    """Of the scope in the file, where it is not the ``scope_key`` of the numbers."""


@dataclass(frozen=True)
class RulePages:
    """The pages of a folder, or the one of a file."""

    pages: Mapping[Path, RulePage]
    """By their files."""

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that they were read from."""
        return tuple(self.pages)

    @property
    def kind(self) -> type[TunedRuleSettings]:
        """Of the numbers."""
        return type(next(iter(self.pages.values())).numbers)

    def page_for(self, reward: Sequence[str], task_id: str, model_id: str = "") -> Path | None:
        """File of the page for a task, that for its model before others: an only page serves every task. ``None`` when there is none."""
        if len(self.pages) == 1:
            return self.files[0]
        own = [file for file, page in self.pages.items() if model_id in page.scope]
        return next(iter(own + [file for file, page in self.pages.items() if self.kind.is_for(page.scope, reward, task_id)]), None)

    def numbers_for(self, reward: Sequence[str], task_id: str, model_id: str = "") -> TunedRuleSettings:
        """Numbers of that page. Raises ``SubmissionError`` when none of several pages is for such a task."""
        file = self.page_for(reward, task_id, model_id)
        if file is not None:
            return self.pages[file].numbers
        scopes = "; ".join(f"{file.name}: {', '.join(page.scope)}" for file, page in self.pages.items())
        msg = (
            f"No page of the {self.kind.title} is for {task_id}, whose reward is {', '.join(reward)} ({scopes}). "
            "Copy the folder and leave the page in it that is to be followed: an only page serves every task."
        )
        raise SubmissionError(msg)


def read_rule_pages(place: Path, kind: type[TunedRuleSettings] = TunedRuleSettings) -> RulePages:
    """Read the page in the YAML file ``place``, or those in all ``*.yml`` of the folder ``place``.

    Raises ``SubmissionError`` when there is none, one cannot be read, lacks a number or has a wrong one, or two are for the same.
    """
    files = sorted(place.glob("*.yml")) if place.is_dir() else [place]
    if not files:
        refuse(f"There is no page of {kind.title} (*.yml) in {place}.", SubmissionError)
    pages = {file: read_rule_page(file, kind) for file in files}
    scopes = [page.scope for page in pages.values()]
    claims: list[tuple[str, ...]] = scopes if kind is TunedRuleSettings else [(name,) for scope in scopes for name in scope]
    twice = next((claim for claim in claims if claims.count(claim) > 1), None)
    if twice is not None:
        msg = f"The pages of {kind.title} in {place} name the same {kind.scope_key} twice, {', '.join(twice)}. Leave one of them."
        raise SubmissionError(msg)
    return RulePages(pages)


def read_rule_page(file: Path, kind: type[TunedRuleSettings] = TunedRuleSettings) -> RulePage:
    """Read one page, for rewards or, with the key ``models``, for models. Errors as for ``read_rule_pages``."""
    content = read_yaml(file, f"the {kind.title}", SubmissionError)
    key = "models" if "models" in content else kind.scope_key
    fields: dict[str, Any] = {key: (Annotated[tuple[str, ...], BeforeValidator(_names)], ...)}
    page = validated(create_model(kind.__name__, __base__=kind, **fields), content, f"the {kind.title}", file)
    return RulePage(getattr(page, key), kind(**page.model_dump(exclude={key})), key.replace(kind.scope_key, ""))


def _names(content: Any) -> Any:
    if not content or not (isinstance(content, list) and all(isinstance(name, str) for name in content)):
        refuse("it is a list of names, such as [epi, scaled_penalty] for 'reward' or [mylab/Spring-v1] for 'tasks'")
    return content


def settings_text(page: RulePage, heading: Sequence[str] = ()) -> str:
    """A page as YAML, every number with its unit and meaning; ``heading`` are lines of comment above it."""
    kind = type(page.numbers)
    lines = [*(f"# {line}".rstrip() for line in heading), f"{page.key or kind.scope_key}: [{', '.join(page.scope)}]"]
    for name, value in page.numbers.model_dump().items():
        about = kind.about(name)
        if "section" in about:
            lines += ["", f"# {about['section']}"]
        entry = f"{name}: {rounded(value)!r}"
        words = kind.model_fields[name].description
        lines += [f"{entry:<{_COMMENT_COLUMN}} # {about['unit']}{', ' if about['unit'] != '-' else ' '}{words}"]
    return "\n".join(lines) + "\n"


def rounded(value: float) -> float:
    """A number with so many digits as a page shows: four, which is finer than anybody can measure."""
    return float(f"{value:.{_SIGNIFICANT}g}")


@controller("rule_based_tuned", read=read_rule_pages, version="bd6432cc9ef75f1b05f527db61c1468c3eb7cff93e20f92856e42130415ea65c")
class TunedRulesAgent(ObservedController):
    """Rules with tuned numbers; an ``Agent``. It remembers the smoothed temperature and humidity of every run.

    ``settings`` are pages of numbers, of which the task's reward chooses one, or numbers for every run, one a run.
    """

    title = "the tuned rules"
    kind: ClassVar[type[TunedRuleSettings]] = TunedRuleSettings
    works: ClassVar[tuple[str, ...]] = WORKED
    """Controls that they know."""
    needed: ClassVar[tuple[str, ...]] = NEEDED
    welcome: ClassVar[tuple[str, ...]] = _WELCOME
    """``needed`` and ``welcome``: observations without which they cannot act, and others that they read where a task shows them."""

    def __init__(self, settings: RulePages | Sequence[TunedRuleSettings]) -> None:
        self.settings = settings

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """Forget what was measured; ``n_runs`` runs of ``task`` begin.

        Raises ``SubmissionError`` when the task does not show a quantity that the rules need, has another kind of actuation, or no page is
        for it, and ``ShapeError`` when there are numbers for another count of runs.
        """
        settings = self.settings
        if isinstance(settings, RulePages):
            settings = [settings.numbers_for(task.reward_modules, task.id, task.model)] * n_runs
        if len(settings) != n_runs:
            refuse(f"The rules have numbers for {len(settings)} runs, and {n_runs} begin.", ShapeError)
        columns = {name: np.array([getattr(one, name) for one in settings]) for name in self.kind.model_fields}
        self._find_columns(task, n_runs)
        self._numbers: Any = SimpleNamespace(**columns)
        self._spans = _spans(self._numbers)
        limits = {limit.name: limit for limit in task.constraints}
        temperature, humidity = limits.get("air_temperature"), limits.get("relative_humidity")
        self._limits = (
            _LOWEST_TEMPERATURE if temperature is None else temperature.low,
            _HIGHEST_HUMIDITY if humidity is None else humidity.high,
        )
        self._step_hours = task.step_seconds / 3600.0
        self._sun = Sun(task)
        self._temperature = _Smoothed(columns["temperature_smoothing"], self._step_hours)
        self._humidity = _Smoothed(columns["humidity_smoothing"], self._step_hours)
        self._calm = np.zeros(n_runs)

    def _find_columns(self, task: TaskCard, n_runs: int) -> None:
        self.check_actuation(task)
        controls = [control.name for control in task.controls]
        unknown = [name for name in (VENTS, *task.action_names) if name not in self.works or name not in controls]
        if unknown:
            them = f"{self.title[:1].upper()}{self.title[1:]} work {', '.join(self.works)}"
            refuse(f"{them}; {task.id} is another kind of greenhouse ({', '.join(unknown)}).", SubmissionError)
        self.begin(task, n_runs, self.needed, optional=self.welcome, positions=(VENTS,))

    def decide(self, readings: dict[str, Floats], positions: dict[str, Floats], /) -> Floats:
        """Actions (n_runs, actions) towards the controls that the rules ask for."""
        return self.towards(self._rules(readings, positions[VENTS]), positions)

    def _rules(self, readings: dict[str, Floats], vents: Floats) -> dict[str, Floats]:
        """Controls (n,) by name, fractions of what is installed, with the vents where they are now."""
        n = self._numbers
        hour, day = clock_from(readings)
        temperature, warming = self._temperature.take(readings["air_temperature"])
        humidity, rising = self._humidity.take(readings["relative_humidity"])
        radiation, outdoor = readings["global_radiation"], readings["outdoor_temperature"]
        s = self._shares(hour, day, radiation, temperature, outdoor, readings.get("wind_speed", self._calm))
        above = humidity - self._limits[1]

        # Heating temperature [degC]: one in the dark by the sun's clock, that of the day as it gets light, more in full sun.
        dark = n.heating_evening + s.night * (n.heating_night - n.heating_evening)
        dark = dark + s.morning * (n.heating_morning - dark)
        afternoon_left = 1.0 - s.evening * (1.0 - s.morning)
        heating = dark + (s.daylight * (n.heating_day - dark) + n.heating_light_raise * s.sunny) * afternoon_left

        # CO2: P-band below a set point by light, lower the wider the vents are open.
        dosing = self._calm
        if "co2" in readings:
            set_point = n.co2_dim + (n.co2_sunny - n.co2_dim) * s.co2_sunny - n.co2_vents * vents
            dosing = np.where(radiation >= n.co2_dark, _share(set_point - readings["co2"], n.co2_band), 0.0)

        # The screen is closed in the dark when it is cold outside, but for a gap against humidity.
        gap = np.minimum(np.maximum(n.screen_gap * (above - n.screen_humidity), 0.0), n.screen_gap_most)
        in_hours = (hour >= n.lamps_from) & (hour < n.lamps_until)
        lamps = np.where(in_hours & (radiation < n.lamps_radiation), 1.0, 0.0)
        return {
            BOILER: _boiler(n, s, heating, temperature, warming / self._step_hours, outdoor, above),
            DOSING: dosing,
            SCREEN: (1.0 - s.bright) * (1.0 - s.mild) * (1.0 - gap),
            VENTS: _vents(n, s, vents, temperature, above, rising, self._step_hours),
            LAMPS: lamps,
            BLACKOUT: np.where(radiation <= 0.0, lamps, 0.0),
        }

    def _shares(self, hour: Floats, day: Floats, radiation: Floats, temperature: Floats, outdoor: Floats, wind: Floats) -> _Shares:
        """All shares at once: numpy takes as long for one of them as for ten."""
        n = self._numbers
        rise, fall = self._sun.hours(day)
        half = 0.5 * (fall - rise)
        noon = rise + half
        since_noon = np.mod(hour - noon, 24.0)
        above = np.empty((len(_Shares._fields), self.runs))
        np.subtract(since_noon, 24.0 - half - n.morning_before_sunrise, out=above[0])
        np.subtract(since_noon, half - n.evening_before_sunset, out=above[1])
        np.subtract(since_noon, half + n.night_after_sunset, out=above[2])
        above[3] = radiation
        np.subtract(radiation, n.heating_light_from, out=above[4])
        np.subtract(radiation, n.co2_light_from, out=above[5])
        np.subtract(temperature - outdoor, _NO_COLD, out=above[6])
        above[7] = wind
        np.subtract(temperature, self._limits[0] + n.vents_cold, out=above[8])
        np.subtract(radiation, n.screen_light_from, out=above[9])
        np.subtract(outdoor, n.screen_outdoor, out=above[10])
        return _Shares(*np.minimum(np.maximum(above / self._spans, 0.0), 1.0))


class _Shares(NamedTuple):
    """How far along each of these is, from 0 to 1 in a straight line; shape (n,) each [-]."""

    morning: Floats
    """From the temperature of the night to that of the morning."""
    evening: Floats
    """From the end of the day's temperature on; stays 1 until morning."""
    night: Floats
    """From the temperature of the evening to that of the night."""
    daylight: Floats
    sunny: Floats
    """Light that raises temperatures."""
    co2_sunny: Floats
    """Light that raises the CO2 set point."""
    cold: Floats
    """How much colder it is outside."""
    windy: Floats
    warm_enough: Floats
    """For open vents."""
    bright: Floats
    """Too bright for the screen."""
    mild: Floats
    """Too mild outside for the screen."""


def _spans(n: Any) -> Floats:
    """What each share goes from 0 to 1 in."""
    ramp = n.ramp_hours
    lights = n.heating_daylight, n.heating_light_span, n.co2_light_span
    constant = (np.full_like(ramp, span) for span in (_FULL_COLD - _NO_COLD, _STRONG_WIND, _COLD_BAND))
    return np.stack([ramp, ramp, ramp, *lights, *constant, n.screen_light_span, np.full_like(ramp, _SCREEN_BAND)])


class _Smoothed:
    """A reading smoothed over some hours: it goes step/(step + hours) of the way to what is read."""

    def __init__(self, hours: Floats, step: float) -> None:
        self._weight = step / (step + hours)
        self._value: Floats | None = None

    def take(self, reading: Floats) -> tuple[Floats, Floats]:
        """The smoothed value, and its change in this step."""
        change = np.zeros_like(reading) if self._value is None else self._weight * (reading - self._value)
        self._value = reading if self._value is None else self._value + change
        return self._value, change


def _share(value: Floats, span: Floats) -> Floats:
    """From 0 at 0 to 1 at ``span``."""
    return np.minimum(np.maximum(value / span, 0.0), 1.0)


def _boiler(n: Any, s: _Shares, heating: Floats, temperature: Floats, warming: Floats, outdoor: Floats, above: Floats) -> Floats:
    """P-band, feed-forward on what is lost to the outside, minimum heat by day and against humidity."""
    power = (heating - temperature) / n.boiler_band + n.boiler_outside * (heating - outdoor)
    power = power + n.boiler_daylight * s.daylight - n.boiler_trend * warming
    power = power + n.boiler_humidity * np.maximum(above - n.boiler_humidity_above, 0.0)
    share: Floats = np.minimum(np.maximum(power, 0.0), 1.0)
    return share


def _vents(n: Any, s: _Shares, vents: Floats, temperature: Floats, above: Floats, rising: Floats, step: float) -> Floats:
    """Against humidity a PI controller in velocity form: it moves the vents from where they are, so that nothing winds up."""
    target = n.vents_humidity_night + (n.vents_humidity_day - n.vents_humidity_night) * s.daylight
    change = n.vents_gain * step * (above - target) + n.vents_trend * rising
    change = change * (1.0 - n.vents_cold_less * s.cold) * (1.0 - n.vents_wind_less * s.windy)
    humid = np.minimum(np.maximum(vents + change, 0.0), n.vents_most) * s.warm_enough
    hot = _share(temperature - n.vents_temperature - n.vents_light_raise * s.sunny, n.vents_band)
    wider: Floats = np.maximum(humid, hot)
    return wider
