"""What a page becomes: a task file, and rules that fit the greenhouse."""

from __future__ import annotations

import json
import re
from contextlib import suppress

from glbench.agents.energy_rules import EnergyRuleSettings
from glbench.agents.tuned_rules import RulePage, TunedRuleSettings, read_rule_pages, rounded, settings_text
from glbench.errors import ParameterError, TaskError
from glbench.greenhouse.page import Page
from glbench.greenhouse.parameters import Greenhouse
from glbench.resources import data_folder
from glbench.tasks import TaskSpec, get_task
from glbench.tasks.set_points import LAMPS, WORKED
from glbench.untrusted import quoted

_FIELDS = ("boiler_outside", "boiler_daylight", "boiler_humidity", "boiler_trend")  # Numbers of rules that are shares of the boiler
_SEASONS = 30  # Seasons of validation and test in another weather than the base's


def base_task(page: Page) -> TaskSpec:
    """The task that the page is based on.

    Raises ``TaskError`` when its greenhouse is not GreenLight's, or its weather is a real one and the page asks for another.
    """
    base = get_task(page.base)
    names = base.model_value.parameter_names
    if "aFlr" not in names or "rgFruit" not in names:
        msg = f"base = {quoted(page.base)}: its model {base.model_id} is no greenhouse with tomatoes. Take 'glbench/GreenhouseReal-v1'."
        raise TaskError(msg)
    other = page.season.weather not in (None, base.weather.source)
    if (other or page.season.years) and base.scenario.generated is None:
        msg = (
            f"The page's [season] asks for other weather or years, and {base.id} has the real weather of one season. "
            "Take a base with generated seasons, such as 'glbench/GreenhouseReal-v1'."
        )
        raise TaskError(msg)
    return base


def task_text(page: Page, house: Greenhouse, task_id: str, source: str) -> str:
    """The task file: the base, what differs, and as comments how each parameter follows and what was assumed.

    ``source`` names the page. Raises ``TaskError`` as for ``base_task``, or when the weather's years do not fit.
    """
    base = base_task(page)
    lines = [
        f"# Written by `glbench greenhouse task {source}`. Change the page and write it again, or change this file.",
        "",
        f'base = "{base.id}"',
        "schema = 2",
        f'id = "{task_id}"',
        f"title = {_text(page.title)}",
    ]
    if base.model.overrides:
        lines.append('without = ["model.overrides"]')
    lines += ["", "[model]", f'parameters = "{house.book}"', "", "[model.overrides]"]
    width = max((len(entry.name) for entry in house.entries), default=0)
    for entry in house.entries:
        lines.append(f'{entry.name:<{width}} = {{ value = {entry.value!r}, unit = "{entry.unit}" }}  # {entry.reason}')
    if house.assumptions:
        lines += ["", f"# The page does not say these. What holds instead, besides all other parameters of the book {house.book}:"]
        lines += [f"#   {assumption}" for assumption in house.assumptions]
    lines += [f"# Doubt: {doubt}" for doubt in house.doubts]
    controls = [name for name in base.actuation.controls if name not in WORKED or name in house.controls]
    lines += ["", "[actuation]", f"controls = {json.dumps(controls)}"]
    lines += _weather_lines(page, base)
    own = {entry.name: entry.value for entry in house.entries}
    model = base.model_value
    values = dict(zip(model.parameter_names, model.parameters.default(house.book, own).tolist(), strict=True))
    for group in base.scenario.groups:
        if group.spread is not None:
            lines += ["", "[[scenario.parameters]]", f'name = "{group.name}"', f'spread = "{group.spread.name}"']
            lines += [f"factor = {group.spread.factor!r}", f'redraw = "{group.redraw}"']
            continue
        independent, variable = [name for name in group.parameters if not model.parameters.info(name).is_derived], []
        for name in independent:  # a layer cannot let through and reflect more than all the light
            with suppress(ParameterError):
                model.parameters.default(house.book, own | {name: values[name] * (1.0 + group.half_width)})
                variable.append(name)
        lines += ["", "[[scenario.parameters]]", f'name = "{group.name}"', f"parameters = {json.dumps(variable)}"]
        lines += [f"half_width = {group.half_width!r}", f'redraw = "{group.redraw}"', f'distribution = "{group.distribution}"']
        if len(variable) < len(independent):
            constant = ", ".join(name for name in independent if name not in variable)
            lines.append(f"# The same in all runs, because {100.0 * group.half_width:g} % more would be more than all: {constant}")
    return "\n".join(lines) + "\n"


def _weather_lines(page: Page, base: TaskSpec) -> list[str]:
    """Tables of the season, where its weather is not the base's."""
    from zoneinfo import ZoneInfo

    from glbench.weather import load_weather

    source = page.season.weather or base.weather.source
    if source == base.weather.source and not page.season.years:
        return []
    record = load_weather(source)
    zone = ZoneInfo(record.timezone)
    first, last = record.first.astimezone(zone), record.last.astimezone(zone)
    whole = range(first.year + (first.timetuple().tm_yday > 1), last.year + (last.month == 12 and last.day == 31))
    years = page.season.years or tuple(whole)
    if not years or not set(years) <= set(whole):
        years_words = ", ".join(map(str, years)) or "none"
        msg = (
            f"season.years: {years_words}. Weather {quoted(source)} has the whole years {', '.join(map(str, whole)) or 'none'}, and "
            "seasons are made from whole years. `glbench weather show` shows the record."
        )
        raise TaskError(msg)
    early, late = list(years[:-1]), [years[-1]]
    lines = ["", "[weather]", f'source = "{source}"', f"start = {base.weather.start.replace(year=late[0]).isoformat()}"]
    if early:
        lines += ["", "[splits.training]", f"years = {early}", "seasons = 256"]
        lines += ["", "[splits.validation]", f"years = {early}", f"seasons = {_SEASONS}"]
    lines += ["", "[splits.test]", f"years = {late}", f"seasons = {_SEASONS}", "", "[evaluation]", f"runs = {_SEASONS}"]
    return lines


def rules_text(page: Page, task: TaskSpec) -> dict[str, str]:
    """A folder of rules for ``task``, the greenhouse of ``page``: the texts of ``card.toml`` and ``rules.yml``.

    They are the shipped rules of the base. Numbers that are shares of boiler or CO2 supply are scaled, so that they ask for the same heat
    and CO2 by the square metre; lamps burn in the page's hours. Raises ``SubmissionError`` when no rules are shipped for the base.
    """
    base, folder = base_task(page), data_folder("baselines")
    energy = read_rule_pages(folder / "rule_based_energy" / "rules", EnergyRuleSettings)
    of_energy = any(base.id in one.scope for one in energy.pages.values())
    pages = energy if of_energy else read_rule_pages(folder / "rule_based_tuned" / "rules")
    numbers: TunedRuleSettings = pages.numbers_for(base.reward.modules, base.id, base.model_id)
    before, after = base.parameters_by_name(), task.parameters_by_name()
    heat, dosing = ((after[name] / after["aFlr"]) / (before[name] / before["aFlr"]) for name in ("pBoil", "phiExtCo2"))
    scaled = {name: getattr(numbers, name) / heat for name in _FIELDS} if heat > 0.0 else {}
    scaled |= {"boiler_band": numbers.boiler_band * heat, "co2_band": numbers.co2_band * dosing}
    changes = {name: rounded(min(max(value, numbers.bounds(name)[0]), numbers.bounds(name)[1])) for name, value in scaled.items()}
    if not of_energy and LAMPS in task.actuation.controls:
        season = page.season
        changes |= {"lamps_from": season.lamps_from, "lamps_until": season.lamps_until, "lamps_radiation": season.lamps_radiation}
    scope = (task.id,) if of_energy else tuple(task.reward.modules)
    heading = [
        f"Rules for {task.id}: those that glbench ships for {base.id}. Shares of boiler and CO2 supply were scaled to what is installed",
        f"here: {after['pBoil'] / after['aFlr']:.4g} W m-2 (there {before['pBoil'] / before['aFlr']:.4g}) and "
        f"{3.6 * after['phiExtCo2'] / after['aFlr']:.4g} g m-2 h-1 (there {3.6 * before['phiExtCo2'] / before['aFlr']:.4g}).",
        "Change any number. `glbench tune rules` finds better ones.",
    ]
    rules = settings_text(RulePage(scope, numbers.model_copy(update=changes)), heading)
    controller = "rule_based_energy" if of_energy else "rule_based_tuned"
    card = "\n".join(
        (
            f"title = {_text(f'Rules for {page.title}')}",
            f'controller = "{controller}"',
            'settings = "rules.yml"',
            f'description = "The rules of {controller} for {task.id}, scaled to its boiler and CO2 supply."',
            'made = "By glbench greenhouse task. Not tuned for this greenhouse."',
            "sources = []",
        )
    )
    return {"card.toml": card + "\n", "rules.yml": rules}


def _text(words: str) -> str:
    """Words as TOML."""
    plain = re.sub(r'[\x00-\x1f\x7f"\\]', " ", words)
    return f'"{plain}"'
