"""Numbers of the energy rules: those of the tuned rules (``glbench.agents.tuned_rule_settings``), and more for lamps, engine and buffer.

A page is a YAML file that names the tasks it is for and gives every number.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import Field

from glbench.agents.tuned_rule_settings import TunedRuleSettings, rounded
from glbench.errors import SubmissionError
from glbench.settings import read_settings
from glbench.untrusted import quoted

TASKS = "tasks"
"""Key of a page beside the numbers: ids of the tasks that it is for."""
_COMMENT_COLUMN = 32


def _number(low: float, high: float, unit: str, words: str, section: str | None = None, *, tuned: bool = True) -> Any:
    about: dict[str, Any] = {"unit": unit, "tuned": tuned, **({} if section is None else {"section": section})}
    return Field(ge=low, le=high, description=words, json_schema_extra=about)


class EnergyRuleSettings(TunedRuleSettings):
    """Numbers of the rules for lamps at hourly prices, engine, boiler and buffer, besides those of the climate.

    "Load" is a fraction of what is installed. Numbers of machines that a task does not have are not used there.
    """

    lamps_from: float = _number(0.0, 24.0, "h", "of the day they may be on (not tuned)", "Lamps", tuned=False)
    lamps_until: float = _number(0.0, 24.0, "h", "of the same day they go off (not tuned)", tuned=False)
    lamps_radiation: float = _number(0.0, 1000.0, "W m-2", "they are off from here on; 0: they are never on")
    lamps_fruit: float = _number(0.0, 0.5, "kg kWh-1", "they are on while power costs less than so much fruit")
    lamps_light: float = _number(0.0, 500.0, "W m-2", "of radiation that they count as, for heating and CO2")

    engine_price: float = _number(-0.05, 0.4, "EUR kWh-1", "it runs while power is worth more, buffer empty", "Engine")
    engine_full: float = _number(0.0, 0.4, "EUR kWh-1", "more with a full buffer (in proportion with others)")
    engine_cold: float = _number(0.0, 0.01, "EUR kWh-1 K-1", "less for each degree below 18 degC of the coming night")
    engine_wait: float = _number(
        0.0, 1.0, "-", "more by this part of what a dearer hour is above it, in proportion with the buffer"
    )
    engine_stay: float = _number(0.0, 0.05, "EUR kWh-1", "less while it runs")

    buffer_full: float = _number(0.0, 100.0, "%", "engine and boiler fill it up to here", "Buffer and boiler")
    buffer_low: float = _number(0.0, 50.0, "%", "below it the boiler gives the heat that is asked for")
    boiler_co2: float = _number(0.0, 2.0, "-", "of the CO2 wanted by day the boiler burns this part for its flue gas")
    co2_bought: float = _number(0.0, 1.0, "share", "of the supply at most is bought, besides what is in the flue gas")

    boiler_flue: float = _number(
        0.1,
        20.0,
        "-",
        "CO2 in the flue gas of the boiler at full load, in full supplies",
        "Machines (not tuned)",
        tuned=False,
    )
    engine_flue: float = _number(0.1, 20.0, "-", "the same of the engine", tuned=False)
    engine_heat: float = _number(
        0.0, 5.0, "-", "heat of the engine at full load, in full loads of the boiler", tuned=False
    )

    @classmethod
    def tuned_names(cls) -> tuple[str, ...]:
        """Names of the numbers that a tuner may change."""
        return tuple(name for name in cls.model_fields if cls._about(name)["tuned"])

    @classmethod
    def _about(cls, name: str) -> dict[str, Any]:
        about = cls.model_fields[name].json_schema_extra
        assert isinstance(about, dict)
        return about


class _Page(EnergyRuleSettings):
    tasks: list[str] = Field(min_length=1)


@dataclass(frozen=True)
class EnergyRulePage:
    """A page: numbers, and ids of the tasks that they are for."""

    tasks: tuple[str, ...]
    numbers: EnergyRuleSettings


@dataclass(frozen=True)
class EnergyRulePages:
    """The pages of a folder, or the one of a file."""

    pages: Mapping[Path, EnergyRulePage]
    """By their files."""

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that they were read from."""
        return tuple(self.pages)

    def numbers_for(self, task_id: str) -> EnergyRuleSettings:
        """Numbers of the page for a task; an only page serves every task.

        Raises
        ------
        SubmissionError
            When none of several pages is for it.
        """
        if len(self.pages) == 1:
            return next(iter(self.pages.values())).numbers
        for page in self.pages.values():
            if task_id in page.tasks:
                return page.numbers
        known = "; ".join(f"{file.name}: {', '.join(page.tasks)}" for file, page in self.pages.items())
        msg = (
            f"No page of the energy rules is for {task_id} ({known}). "
            "Copy the folder and leave the page in it that is to be followed: an only page serves every task."
        )
        raise SubmissionError(msg)


def read_energy_rule_pages(place: Path) -> EnergyRulePages:
    """Read the page in the YAML file ``place``, or those in all ``*.yml`` of the folder ``place``.

    Raises
    ------
    SubmissionError
        When there is none, one cannot be read or lacks a number, has an unknown or impossible one, or two are for the same task.
    """
    files = sorted(place.glob("*.yml")) if place.is_dir() else [place]
    if not files:
        msg = f"There is no page of energy rules (*.yml) in {place}."
        raise SubmissionError(msg)
    pages = {file: read_energy_rule_page(file) for file in files}
    named = [task for page in pages.values() for task in page.tasks]
    twice = next((task for task in named if named.count(task) > 1), None)
    if twice is not None:
        msg = f"{place} names the task {quoted(twice)} twice. Name it on one page, once."
        raise SubmissionError(msg)
    return EnergyRulePages(pages)


def read_energy_rule_page(file: Path) -> EnergyRulePage:
    """Read one page. Errors as for ``read_energy_rule_pages``."""
    page = read_settings(_Page, file, "the energy rules")
    return EnergyRulePage(tuple(page.tasks), EnergyRuleSettings(**page.model_dump(exclude={TASKS})))


def energy_settings_text(page: EnergyRulePage, heading: Sequence[str] = ()) -> str:
    """A page as YAML, every number with its unit and meaning; ``heading`` are lines of comment above it."""
    lines = [*(f"# {line}".rstrip() for line in heading), f"{TASKS}: [{', '.join(page.tasks)}]"]
    for name, value in page.numbers.model_dump().items():
        about = EnergyRuleSettings._about(name)
        if "section" in about:
            lines += ["", f"# {about['section']}"]
        words = EnergyRuleSettings.model_fields[name].description
        given = f"{name}: {rounded(value)!r}"
        lines += [f"{given:<{_COMMENT_COLUMN}} # {about['unit']}{', ' if about['unit'] != '-' else ' '}{words}"]
    return "\n".join(lines) + "\n"
