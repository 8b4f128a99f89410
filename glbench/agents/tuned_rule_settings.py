"""Numbers of the tuned rules, read from YAML files that a grower can read: each with its name, unit, bounds and meaning.

``TunedRuleSettings`` is the one place that says what there is to set. The comments of the files are made of it (``settings_text``),
and ``glbench tune rules`` stays within its bounds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, model_validator

from glbench.errors import SubmissionError
from glbench.settings import read_settings

REWARD = "reward"
"""Key of a file beside the numbers: the reward modules of the tasks that they are for."""
_SIGNIFICANT = 4
_COMMENT_COLUMN = 32


def _number(low: float, high: float, unit: str, words: str, *, section: str | None = None, tuned: bool = True) -> Any:
    about: dict[str, Any] = {"unit": unit, "tuned": tuned}
    if section is not None:
        about["section"] = section
    return Field(ge=low, le=high, description=words, json_schema_extra=about)


class TunedRuleSettings(BaseModel):
    """Numbers of the rules. Temperatures [degC], differences of them [K], humidity [%], CO2 [ppm], radiation [W m-2], times [h].

    "Share" is a fraction of what is installed. "Limit" is the task's own: of relative humidity the upper one, of air temperature the
    lower one. Radiation is the global radiation outside.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    morning_before_sunrise: float = _number(
        0.0, 6.0, "h", "before sunrise the heating temperature leaves that of the night", section="Periods of the day"
    )
    evening_before_sunset: float = _number(-2.0, 5.0, "h", "before sunset it leaves that of the day")
    night_after_sunset: float = _number(-2.0, 8.0, "h", "after sunset it leaves that of the evening")
    ramp_hours: float = _number(0.25, 3.0, "h", "each of these changes takes")

    heating_night: float = _number(12.0, 20.0, "degC", "at night", section="Heating temperature")
    heating_morning: float = _number(12.0, 24.0, "degC", "before it gets light")
    heating_day: float = _number(12.0, 26.0, "degC", "in daylight")
    heating_evening: float = _number(12.0, 22.0, "degC", "from the evening on, until the night")
    heating_daylight: float = _number(20.0, 500.0, "W m-2", "from so much radiation on it counts as full daylight")
    heating_light_raise: float = _number(0.0, 10.0, "K", "more in full sun")
    heating_light_from: float = _number(0.0, 400.0, "W m-2", "the raise begins")
    heating_light_span: float = _number(50.0, 800.0, "W m-2", "so much later it is complete")

    boiler_band: float = _number(
        0.5, 10.0, "K", "too cold for the boiler to go from nothing to full power", section="Boiler"
    )
    boiler_outside: float = _number(0.0, 0.05, "share K-1", "for each degree that it is colder outside than wanted")
    boiler_daylight: float = _number(0.0, 0.4, "share", "in daylight, besides")
    boiler_humidity: float = _number(0.0, 0.3, "share %-1", "against humidity, for each percent")
    boiler_humidity_above: float = _number(-6.0, 4.0, "%", "above the limit (below it when negative) that begins")
    boiler_trend: float = _number(0.0, 0.3, "share h K-1", "less, for each degree an hour that it warms up")

    co2_dim: float = _number(300.0, 1600.0, "ppm", "in dim light", section="CO2")
    co2_sunny: float = _number(300.0, 1600.0, "ppm", "in full sun")
    co2_light_from: float = _number(0.0, 300.0, "W m-2", "up to here light is dim")
    co2_light_span: float = _number(20.0, 800.0, "W m-2", "so much later it is full sun")
    co2_vents: float = _number(0.0, 8000.0, "ppm", "less with fully open vents (in proportion with others)")
    co2_band: float = _number(20.0, 600.0, "ppm", "too little for the supply to go from nothing to full")
    co2_dark: float = _number(0.0, 60.0, "W m-2", "in less light than this none is dosed")

    vents_humidity_day: float = _number(
        -12.0, 2.0, "%", "above the limit (below it when negative) is wanted by day", section="Vents"
    )
    vents_humidity_night: float = _number(-12.0, 2.0, "%", "the same in the dark")
    vents_gain: float = _number(0.0, 2.0, "share %-1 h-1", "they open in an hour for each percent too much (integral)")
    vents_trend: float = _number(0.0, 0.3, "share %-1", "they open for each percent of rise (proportional)")
    vents_cold_less: float = _number(0.0, 0.95, "-", "part of both that is left out when it is 18 K colder outside")
    vents_wind_less: float = _number(0.0, 0.95, "-", "part of both that is left out in a wind of 10 m s-1")
    vents_most: float = _number(0.05, 1.0, "share", "widest opening against humidity")
    vents_temperature: float = _number(18.0, 33.0, "degC", "above it they open for heat")
    vents_light_raise: float = _number(0.0, 8.0, "K", "higher in full sun, as with heating")
    vents_band: float = _number(1.0, 20.0, "K", "too warm for them to go from shut to open")
    vents_cold: float = _number(-1.5, 3.0, "K", "above the limit of temperature: colder they are shut")

    screen_light_from: float = _number(0.0, 150.0, "W m-2", "begins to open", section="Thermal screen")
    screen_light_span: float = _number(5.0, 300.0, "W m-2", "so much later it is open")
    screen_outdoor: float = _number(-5.0, 25.0, "degC", "outside: colder it is closed, 3 K warmer it is open")
    screen_humidity: float = _number(-10.0, 10.0, "%", "above the limit (below it when negative) a gap opens")
    screen_gap: float = _number(0.0, 0.3, "share %-1", "for each percent, of the screen")
    screen_gap_most: float = _number(0.0, 1.0, "share", "widest gap")

    temperature_smoothing: float = _number(
        0.0, 3.0, "h", "the sensor of temperature is smoothed over", section="Sensors"
    )
    humidity_smoothing: float = _number(0.0, 3.0, "h", "the sensor of humidity is smoothed over")

    lamps_from: float = _number(0.0, 24.0, "h", "of the day they may be on", section="Lamps (not tuned)", tuned=False)
    lamps_until: float = _number(0.0, 24.0, "h", "of the same day they go off", tuned=False)
    lamps_radiation: float = _number(
        0.0, 1000.0, "W m-2", "they are off from here on; 0: they are never on", tuned=False
    )

    @classmethod
    def bounds(cls, name: str) -> tuple[float, float]:
        """Lowest and highest value of the number called ``name``."""
        limits = {type(limit).__name__: limit for limit in cls.model_fields[name].metadata}
        return float(limits["Ge"].ge), float(limits["Le"].le)

    @classmethod
    def tuned_names(cls) -> tuple[str, ...]:
        """Names of the numbers that a tuner may change."""
        return tuple(name for name in cls.model_fields if _about(name)["tuned"])


@dataclass(frozen=True)
class RulePage:
    """A file of settings: numbers, and the reward modules of the tasks that they are for."""

    reward: tuple[str, ...]
    numbers: TunedRuleSettings


@dataclass(frozen=True)
class RulePages:
    """The pages of a folder, or the one of a file."""

    pages: Mapping[Path, RulePage]
    """By their files."""

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that they were read from."""
        return tuple(self.pages)

    def page_for(self, modules: Sequence[str]) -> Path | None:
        """File of the page for a task with these reward modules: an only page serves every task. ``None`` when there is none."""
        if len(self.pages) == 1:
            return self.files[0]
        return next((file for file, page in self.pages.items() if page.reward == tuple(modules)), None)

    def numbers_for(self, modules: Sequence[str], task_id: str) -> TunedRuleSettings:
        """Numbers of that page.

        Raises
        ------
        SubmissionError
            When none of several pages is for such a reward.
        """
        file = self.page_for(modules)
        if file is not None:
            return self.pages[file].numbers
        known = "; ".join(f"{file.name}: {', '.join(page.reward)}" for file, page in self.pages.items())
        msg = (
            f"No page of the tuned rules is for {task_id}, whose reward is {', '.join(modules)} ({known}). "
            "Copy the folder and leave the page in it that is to be followed: an only page serves every task."
        )
        raise SubmissionError(msg)


def read_rule_pages(place: Path) -> RulePages:
    """Read the page in the YAML file ``place``, or those in all ``*.yml`` of the folder ``place``.

    Raises
    ------
    SubmissionError
        When there is none, one cannot be read or lacks a number, has an unknown or impossible one, or two are for the same reward.
    """
    files = sorted(place.glob("*.yml")) if place.is_dir() else [place]
    if not files:
        msg = f"There is no page of rules (*.yml) in {place}."
        raise SubmissionError(msg)
    pages = {file: read_rule_page(file) for file in files}
    rewards = [page.reward for page in pages.values()]
    twice = next((reward for reward in rewards if rewards.count(reward) > 1), None)
    if twice is not None:
        msg = f"Two pages of rules in {place} are for the same reward, {', '.join(twice)}. Leave one of them."
        raise SubmissionError(msg)
    return RulePages(pages)


def read_rule_page(file: Path) -> RulePage:
    """Read one page. Errors as for ``read_rule_pages``."""
    page = read_settings(_Page, file, "the rules")
    return RulePage(
        page.reward, TunedRuleSettings(**{name: getattr(page, name) for name in TunedRuleSettings.model_fields})
    )


def settings_text(page: RulePage, heading: Sequence[str] = ()) -> str:
    """A page as YAML, every number with its unit and meaning; ``heading`` are lines of comment above it."""
    lines = [f"# {line}".rstrip() for line in heading]
    lines += [f"{REWARD}: [{', '.join(page.reward)}]"]
    for name, value in page.numbers.model_dump().items():
        about = _about(name)
        if "section" in about:
            lines += ["", f"# {about['section']}"]
        given = f"{name}: {rounded(value)!r}"
        words = TunedRuleSettings.model_fields[name].description
        lines += [f"{given:<{_COMMENT_COLUMN}} # {about['unit']}{', ' if about['unit'] != '-' else ' '}{words}"]
    return "\n".join(lines) + "\n"


def rounded(value: float) -> float:
    """A number with so many digits as a page shows: four, which is finer than anybody can measure."""
    return float(f"{value:.{_SIGNIFICANT}g}")


class _Page(TunedRuleSettings):
    reward: tuple[str, ...]

    @model_validator(mode="before")
    @classmethod
    def _names_are_words(cls, content: Any) -> Any:
        given = content.get(REWARD) if isinstance(content, dict) else None
        if given is not None and not (isinstance(given, list) and all(isinstance(name, str) for name in given)):
            msg = "'reward' is the list of a task's reward modules, such as [epi, scaled_penalty]"
            raise ValueError(msg)
        return content


def _about(name: str) -> dict[str, Any]:
    about = TunedRuleSettings.model_fields[name].json_schema_extra
    assert isinstance(about, dict)
    return about
