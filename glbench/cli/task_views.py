"""How tasks look on the terminal: the list, and the explanation of one task in words and tables."""

from __future__ import annotations

import dataclasses
import datetime as dt
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any
from zoneinfo import ZoneInfo

from rich.console import RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from glbench.tasks import (
    ACTUATION_KINDS,
    INITIAL_STATES,
    METRICS,
    MODEL_VARIANTS,
    PREPROCESSINGS,
    REWARD_MODULES,
    Capacity,
    Registry,
    Scenario,
    TaskCard,
    TaskSpec,
    task_card,
)
from glbench.tasks.bases import Change

_LIMIT_WORDS = {"air_temperature": "air temperature", "co2": "CO2", "relative_humidity": "relative humidity"}


def listing(tasks: Sequence[TaskSpec], digests: Mapping[str, str | None]) -> Iterator[RenderableType]:
    """Tasks in groups of the same suite, period and weather, a heading and a table each; ``digests`` are the lock's."""
    for heading, group in groupby(tasks, key=_common):
        yield Text.assemble((f"{heading[0]}\n", "bold"), (heading[1], "dim"))
        table = _table("Task", "What it is", "Delta", "Digest", right=("Delta",))
        for task in group:
            digest = digests[task.id]
            delta = f"{100 * task.uncertainty.delta:g} %"
            table.add_row(task.short_id, task.title, delta, digest[:8] if digest else "not locked")
        yield Padding(table, (0, 0, 1, 2), expand=False)


def _common(task: TaskSpec) -> tuple[str, str]:
    """What the tasks of a group share: the suite, and period, step and weather in words."""
    weather = task.weather
    suite = f"Suite {', '.join(task.suites)}" if task.suites else "In no suite"
    return suite, (
        f"{weather.days} days from {_day(weather.start)}, step {minutes(task.step_seconds)}, "
        f"weather '{weather.source}', prepared '{weather.preprocessing}'"
    )


def explanation(task: TaskSpec) -> Iterator[RenderableType]:
    """The task in words, part after part, for a grower and a researcher."""
    card = task_card(task)
    state = "published" if task.locked else "not published"
    yield Text.assemble((task.title, "bold"), "\n", (f"{task.id}  ({state}, digest {task.digest[:8]})", "dim"))
    if task.description.strip():
        yield Text("\n" + " ".join(task.description.split()))
    if task.base is not None:
        yield _heading(f"Based on {task.base}, changed:")
        yield _words([_changed(change) for change in task.changes])
    yield _heading("Period and place")
    yield _words(_period(task, card))
    yield _heading("Greenhouse and crop")
    yield _words(_greenhouse(task))
    yield _heading(f"What the agent sees: {len(card.observations)} values after every step, float32, in this order")
    yield _observations(card)
    yield _heading("What the agent does")
    yield _words([f"{len(card.actions)} numbers a step, in this order: {ACTUATION_KINDS[card.actuation].meaning}."])
    yield _actions(card)
    if card.constraints:
        yield _heading("Limits of the climate, checked after every step")
        yield _constraints(card)
    yield _heading("Prices")
    yield _prices(card)
    yield _heading("Reward of a step")
    yield _words(_reward(task))
    yield _heading("Evaluation")
    yield _words(_evaluation(task))


def _changed(change: Change) -> str:
    return f"{change.key} = {change.value} " + (f"(there {change.before})" if change.before else "(not there)")


def explained(task: TaskSpec) -> dict[str, Any]:
    """The same for machines: card, definition, digests, uncertain parameters."""
    card = dataclasses.asdict(task_card(task))
    card["start"] = card["start"].isoformat()
    return {
        "id": task.id,
        "title": task.title,
        "description": task.description,
        "suites": list(task.suites),
        "source": task.source,
        "base": task.base,
        "changes": [dataclasses.asdict(change) for change in task.changes],
        "locked": task.locked,
        "digest": task.digest,
        "fingerprint": dataclasses.asdict(task.fingerprint()),
        "card": card,
        "uncertain_parameters": list(task.uncertain_parameters()),
        "definition": task.definition(),
    }


def first_weather(task: TaskSpec, rows: int = 4) -> RenderableType:
    """The weather of the first steps, so that a mistake in the period shows."""
    weather, zone = task.disturbances(), ZoneInfo(task.record().timezone)
    table = Table(title="Weather of the first steps", title_justify="left", box=None, header_style="bold")
    for heading in (
        "Step",
        "UTC",
        "Local",
        "Sun\nW m-2",
        "Air\ndegC",
        "Vapour\nPa",
        "CO2\nmg m-3",
        "Wind\nm s-1",
        "Sky\ndegC",
    ):
        table.add_column(heading, justify="right")
    for row, (moment, values) in enumerate(zip(weather.times[:rows], weather.values[:rows], strict=True)):
        cells = (f"{value:.1f}" for value in values[:6])
        local = moment.astype(dt.datetime).replace(tzinfo=dt.UTC).astimezone(zone)
        table.add_row(str(row), str(moment).replace("T", " ")[:16], f"{local:%H:%M}", *cells)
    return Padding(table, (0, 0, 1, 7), expand=False)


def minutes(seconds: float) -> str:
    """A step in minutes, or in seconds where that is no whole number."""
    return f"{seconds / 60:g} min" if seconds % 60 == 0 else f"{seconds:g} s"


def percent(fraction: float) -> str:
    """A deviation to both sides, such as ``±10 %``."""
    return f"±{100 * fraction:g} %"


def _day(date: dt.date) -> str:
    return f"{date.day} {date:%B %Y}"


def _heading(text: str) -> Text:
    return Text("\n" + text, style="bold")


def _words(lines: Sequence[str]) -> RenderableType:
    return Padding(Text("\n".join(lines)), (0, 0, 0, 2), expand=False)


def _period(task: TaskSpec, card: TaskCard) -> list[str]:
    end = card.start + dt.timedelta(days=task.weather.days)
    place = card.place
    north, east = ("N" if place.latitude >= 0 else "S"), ("E" if place.longitude >= 0 else "W")
    return [
        f"{task.weather.days} days, from {_day(card.start)} 00:00 to {_day(end)} 00:00, clock {card.clock}{_local(card, end)}; "
        f"one decision every {minutes(card.step_seconds)}, {card.steps} in all.",
        f"Weather '{task.weather.source}': {place.station}, {abs(place.latitude):g} {north}, {abs(place.longitude):g} {east}, "
        f"{place.altitude:g} m; CO2 outside {task.weather.co2_ppm:g} ppm.",
        f"Prepared {PREPROCESSINGS[task.weather.preprocessing].meaning}.",
    ]


def _local(card: TaskCard, end: dt.date) -> str:
    """How far the grower's own clock is ahead where the task's is UTC."""
    if card.clock != "UTC" or card.place.timezone == "UTC":
        return ""
    zone = ZoneInfo(card.place.timezone)
    moments = (dt.datetime.combine(day, dt.time(), dt.UTC) for day in (card.start, end))
    shifts = dict.fromkeys(
        (moment.astimezone(zone).utcoffset() or dt.timedelta()) / dt.timedelta(hours=1) for moment in moments
    )
    return f" ({card.place.timezone} is UTC{' and later UTC'.join(f'{hours:+g} h' for hours in shifts)})"


def _greenhouse(task: TaskSpec) -> list[str]:
    names, uncertainty = task.uncertain_parameters(), task.uncertainty
    lines = [
        *([f"Model {task.model_id}."] if task.schema_version > 1 else []),
        f"Parameter set '{task.model.parameters}'; {_meaning(MODEL_VARIANTS, task.model.variant)}.",
        *(f"Changed: {name} = {value:g} {unit}." for name, value, unit in task.model.overrides),
        f"Start: {_meaning(INITIAL_STATES, task.initial.kind)} ({task.initial.air_temperature:g} degC), all controls at 0.",
    ]
    if task.schema_version > 1:
        return [*lines, *_scenario(task.scenario)]
    if uncertainty.half_width == 0.0:
        return [*lines, "Nothing is uncertain: the parameters keep their nominal values."]
    moment = "at every step" if uncertainty.redraw == "step" else "once an episode"
    low_high = percent(uncertainty.half_width)
    return [
        *lines,
        f"Uncertain: {moment} each of {len(names)} parameters is its nominal value times 1 + e, e {uncertainty.distribution} "
        f"within {low_high} and different for each.",
        f"These are {', '.join(names)}.",
    ]


def _meaning(words: Registry[Any], name: str) -> str:
    """What a word means, or the word where the model alone knows it."""
    return words[name].meaning if name in words else f"'{name}'"


def _scenario(scenario: Scenario) -> list[str]:
    """What a run draws, in words."""
    lines = [f"Random numbers of the family '{scenario.family}'."]
    if len(scenario.seasons) > 1:
        days = ", ".join(f"{season.start} ({season.source})" for season in scenario.seasons)
        lines.append(f"A run's season is one of {len(scenario.seasons)}, drawn evenly: {days}.")
    if scenario.start_within_days:
        lines.append(f"It starts up to {scenario.start_within_days} days later, drawn evenly.")
    lines += [
        f"Uncertain, drawn anew every {group.redraw} ({group.distribution}, {percent(group.half_width)}): "
        f"{', '.join(group.parameters)}."
        for group in scenario.groups
    ]
    return lines + [
        f"At the start, {start.distribution} {percent(start.half_width)}: {', '.join(start.states)}."
        for start in scenario.start_groups
    ]


def _observations(card: TaskCard) -> RenderableType:
    table = _table("Name", "Unit", "Lowest", "Highest", "Meaning", right=("Lowest", "Highest"), numbered=True)
    shown = card.observations if len(card.observations) <= 64 else card.observations[:40]
    for index, quantity in enumerate(shown):
        bounds = (f"{quantity.low:g}", f"{quantity.high:g}" if quantity.high < 1e6 else f"{quantity.high:.2g}")
        table.add_row(str(index), quantity.name, quantity.unit, *bounds, quantity.meaning)
    if len(shown) < len(card.observations):
        table.add_row("...", f"and {len(card.observations) - len(shown)} more; --json lists all")
    return Padding(table, (0, 0, 0, 2), expand=False)


def _actions(card: TaskCard) -> RenderableType:
    table = _table("Control", "Drives", "Action", "At 1", "Most a step", right=("At 1", "Most a step"), numbered=True)
    by_name = {capacity.name: capacity for capacity in card.controls}
    for index, action in enumerate(card.actions):
        capacity = by_name[action.name]
        table.add_row(
            str(index),
            action.name,
            capacity.meaning,
            f"{action.low:g} to {action.high:g}",
            _delivers(capacity, 1.0),
            _delivers(capacity, card.max_change),
        )
    for name in sorted(by_name.keys() - {action.name for action in card.actions}):
        table.add_row("", name, by_name[name].meaning, "stays at 0", "", "")
    return Padding(table, (0, 0, 0, 2), expand=False)


def _delivers(capacity: Capacity, fraction: float) -> str:
    return f"{capacity.at_one * fraction:g}" + (f" {capacity.unit}" if capacity.unit != "-" else "")


def _constraints(card: TaskCard) -> RenderableType:
    table = _table("Quantity", "Lowest", "Highest", "Violation that costs 1 a step", right=("Lowest", "Highest"))
    for limit in card.constraints:
        low, high, scale = (f"{value:g} {limit.unit}" for value in (limit.low, limit.high, limit.scale))
        table.add_row(_LIMIT_WORDS.get(limit.name, limit.name), low, high, scale)
    return Padding(table, (0, 0, 0, 2), expand=False)


def _prices(card: TaskCard) -> RenderableType:
    prices = card.prices
    table = Table(box=None, pad_edge=False, show_header=False)
    if prices is None:
        for item in card.ledger:
            per = f"EUR per {item.amount_unit.removesuffix(' m-2')}"
            price = f"at the price '{item.price}'" if isinstance(item.price, str) else f"{item.price:g} {per}"
            table.add_row(item.name, "earned" if item.sign > 0 else "paid", item.label, price)
        return Padding(table, (0, 0, 0, 2), expand=False)
    table.add_row("fruit", f"{prices.fruit:g} EUR per kg fresh, {100 * prices.dry_matter_content:g} % of it dry matter")
    table.add_row("CO2", f"{prices.co2:g} EUR per kg")
    table.add_row("heat", f"{prices.heat:g} EUR per kWh")
    table.add_row("electricity", f"{prices.electricity:g} EUR per kWh")
    return Padding(table, (0, 0, 0, 2), expand=False)


def _reward(task: TaskSpec) -> list[str]:
    from glbench.env.accounts import make_accounts

    modules = task.reward.modules
    lines = [f"reward = {' + '.join(modules)}", *(f"  {name}: {REWARD_MODULES[name].meaning}." for name in modules)]
    if {"epi", "scaled_epi"} & set(modules) and task.schema_version > 1:
        lines += ["Economic performance EPI [EUR m-2] =", *(f"  {line}" for line in task.ledger.lines())]
    elif {"epi", "scaled_epi"} & set(modules):
        prices = task.prices
        lines += [
            "Economic performance EPI [EUR m-2] =",
            f"  {prices.fruit:g} x fruit growth [kg dry m-2] / {prices.dry_matter_content:g} - {prices.heat:g} x heat [kWh m-2]",
            f"  - {prices.electricity:g} x electricity [kWh m-2] - {prices.co2:g} x CO2 [kg m-2]; fruit is paid as it grows.",
        ]
    if "scaled_epi" in modules:
        accounts = make_accounts(task)
        lines += [
            "Scaled EPI = (EPI - lowest) / (highest - lowest), not clipped;",
            f"  lowest {accounts.lowest_epi:.6f} EUR m-2{_said(task, 'boiler, lamps and CO2 supply at 1, no growth')};",
            f"  highest {accounts.highest_epi:.8f} EUR m-2{_said(task, 'growth at the potential rate at 20 degC, nothing used')}.",
        ]
    return lines


def _said(task: TaskSpec, words: str) -> str:
    """What a bound of the profit is, of the paper's tasks."""
    return f": {words}" if task.schema_version == 1 else ""


def _evaluation(task: TaskSpec) -> list[str]:
    evaluation, failed = task.evaluation, task.evaluation.failed_step
    return [
        f"{evaluation.runs} runs with the seeds {evaluation.seeds[0]} to {evaluation.seeds[-1]}. "
        f"Ranked by {evaluation.metric}: {METRICS[evaluation.metric].meaning}.",
        f"Each missing step of a run that fails counts as reward {failed.reward:g}, EPI {failed.epi:g} EUR m-2, "
        f"penalty {failed.penalty:g}.",
    ]


def _table(*headings: str, right: tuple[str, ...] = (), numbered: bool = False) -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim")
    if numbered:
        table.add_column("", justify="right", style="dim")
    for heading in headings:
        table.add_column(
            heading, justify="right" if heading in right else "left", no_wrap=heading in ("Name", "Control")
        )
    return table
