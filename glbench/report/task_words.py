"""A task's definition in words and tables, section after section.

``for_growers`` names quantities by their labels, in the units that people write: the page begins with it. ``definition_in_words`` has every
key and number as the task file names them: ``glbench tasks show`` prints it, and the page keeps it in a fold.
"""

from __future__ import annotations

import datetime as dt
import re
from calendar import month_name
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from statistics import fmean
from typing import Any
from zoneinfo import ZoneInfo

from glbench import tasks
from glbench.errors import GlbenchError
from glbench.leaderboard.catalogue import catalogue, charts_of
from glbench.quantities import OUTDOOR, in_sentence, pretty_unit, sentence, unit_sold
from glbench.tasks import tables
from glbench.tasks.ledger import FLOW, LIMITED, VIOLATION_PRICES
from glbench.tasks.spreads import HEAT
from glbench.tasks.vocabulary import FORECAST_ERRORS, OBSERVATION_MODULES

_MOST_ROWS, _FIRST_ROWS = 64, 40


@dataclass(frozen=True)
class Section:
    """A heading, lines below it, and a table: the headings of its columns, those of numbers among them, and its rows."""

    heading: str
    lines: Sequence[str] = ()
    columns: Sequence[str] = ()
    right: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()


def definition_in_words(task: tasks.TaskSpec) -> Iterator[Section]:
    """The task, part after part, for a grower and a researcher. Without its weather record what does not need it."""
    try:
        card = tasks.task_card(task)
    except GlbenchError:
        card = None
    if task.base is not None:
        changes = [
            f"{one.key} is left out (there {one.before})"
            if one.value is None
            else f"{one.key} = {one.value} ({f'there {one.before}' if one.before else 'not there'})"
            for one in task.changes
        ]
        yield Section(f"Based on {task.base}, changed:", changes)
    yield Section("Period and place", _period(task, card))
    if task.splits is not None:
        yield Section("Seasons", list(_splits(task, task.splits)))
    yield from _greenhouse(task)
    if card is not None:
        yield from _interface(task, card)
    yield from _money(task, card)
    yield from _scoring(task)


_TOPICS = {
    "weather": "the season and its weather",
    "model": "the model of greenhouse and crop",
    "initial": "the start",
    "scenario": "what is drawn at random",
    "uncertainty": "what is drawn at random",
    "sensors": "the errors of sensors",
    "outdoor_sensors": "the errors of sensors of the weather",
    "actuators": "what vents, screens and valves deliver of their commands",
    "samples": "what is counted and weighed by hand",
    "camera": "the camera",
    "observation": "what the agent sees",
    "actuation": "what the agent controls",
    "ledger": "what is sold and paid for",
    "price_tables": "prices",
    "schedule": "what follows the calendar",
    "constraints": "the limits of the climate",
    "violation_prices": "the price of a violation",
    "reward": "what is scored",
    "evaluation": "the number of runs",
    "splits": "the seasons to learn from and to be judged by",
}
"""What the tables of a task file are about."""
_SPELLINGS = {"degC": "°C", "CO2": "CO₂", " m2": " m²", "EUR m-2": "EUR/m²", "kg m-2": "kg/m²", "kWh m-2": "kWh/m²"}
"""Units and signs of the definition as people write them."""


def for_growers(task: tasks.TaskSpec) -> Iterator[Section]:
    """What a task asks and pays, by labels and with units: no key of the task file, no symbol of the model."""
    words, definition = catalogue(task), {section.heading: section for section in definition_in_words(task)}
    series, scenario, model = charts_of(task).series, task.scenario, task.model_value
    labels = {item.price: words_of.label for words_of in words.items for item in task.ledger.items if item.name == words_of.money}

    def plain(heading: str, lines: Sequence[str], columns: Sequence[str] = (), rows: Sequence[Sequence[str]] = ()) -> Section:
        def spelling(text: str) -> str:
            text = re.sub(r"'(\w+)'", lambda word: word[1].replace("_", " "), text)
            for sign, usual in _SPELLINGS.items():
                text = text.replace(sign, usual)
            return text

        table = [[spelling(cell) for cell in row] for row in rows]
        return Section(heading, [spelling(line) for line in lines], columns, (), table)

    if task.base is not None:
        topics = dict.fromkeys(_TOPICS.get(change.key.split(".")[0], "other numbers") for change in task.changes)
        yield plain("Compared with another task", [f"As {task.base.partition('/')[2]}, but for {sentence(list(topics))}."])
    yield plain("Season and place", definition["Period and place"].lines)
    if "Seasons" in definition:
        yield plain("Seasons to learn from and to be judged by", definition["Seasons"].lines)
    start = f"Start: {_meaning(tasks.INITIAL_STATES, task.initial.kind)} ({task.initial.air_temperature:g} degC)."
    groups = [(group.name, group.parameters, group.half_width, _WHEN[group.redraw]) for group in scenario.groups]
    if task.conventions.shows_delta and task.uncertainty.half_width:
        moment = _WHEN["step" if task.uncertainty.redraw == "step" else "episode"]
        groups = [("crop", tuple(task.uncertain_parameters()), task.uncertainty.half_width, moment)]
    meanings = {one.name: one.meaning for one in model.table} | {one.name: one.meaning for one in model.states}
    reach = {name: words for group in scenario.groups if group.spread for name, words in group.spread.reach().items()}
    properties = [(meanings[one], reach.get(one, f"±{100 * half:g} %"), moment) for _, names, half, moment in groups for one in names]
    properties += [(meanings[name], f"±{100 * one.half_width:g} %", "at the start") for one in scenario.start_groups for name in one.states]
    lines = [
        start,
        f"{len(properties)} properties differ from run to run; the agent does not know by how much."
        if properties
        else "Nothing differs from run to run but what the season brings.",
    ]
    yield plain("Greenhouse and crop", lines)
    if properties:
        yield plain("What differs from run to run", (), ("Property", "By up to", "Drawn"), properties)
    sensors = "Sensors inside; what is judged is the truth"
    if sensors in definition:
        yield plain("Errors of the sensors (the climate is judged by its true values)", definition[sensors].lines)
    if _OUTSIDE in definition:
        yield plain("Errors of the weather station (the weather acts as it is)", definition[_OUTSIDE].lines)
    for heading in (_ACTUATORS, _BY_HAND, _CAMERA):
        if heading in definition:
            yield plain(heading, definition[heading].lines)
    observations = [
        model.observation_modules.get(name)
        or (OBSERVATION_MODULES[name].meaning if name in OBSERVATION_MODULES else name.replace("_", " "))
        for name in task.observation.modules
    ]
    yield plain("What the agent sees at every decision", [f"{line[:1].upper()}{line[1:]}." for line in observations])
    try:
        card = tasks.task_card(task)
    except GlbenchError:  # the weather record is not installed here
        return
    by_name = {capacity.name: capacity for capacity in card.controls}

    def full(capacity: tasks.Capacity, fraction: float) -> str:
        if capacity.unit == "-":
            return f"{100 * capacity.at_one * fraction:g} %"
        dose = f" ({36 * capacity.at_one * fraction:.3g} kg/ha an hour)" if capacity.unit == "mg m-2 s-1" else ""
        return f"{capacity.at_one * fraction:.3g} {pretty_unit(capacity.unit)}{dose}"

    actions = [
        (
            series.get(one.name, {}).get("label", capacity.meaning),
            capacity.meaning,
            full(capacity, 1.0),
            "switched" if one.name in task.on_off else full(capacity, card.max_change),
        )
        if (capacity := by_name.get(one.name)) is not None
        else (one.meaning, "set point", f"{one.lowest:g} to {one.highest:g} {one.unit}", "")
        for one in card.actions
    ]
    machines = [
        f"The {in_sentence(series[name]['label'])} runs at {f'{100 * one.lowest:g} to ' if one.lowest < 1.0 else ''}100 % or not at all, "
        f"and stays on or off for at least {one.hold_minutes:g} minutes." + _due_words(task, one)
        for name, one in task.on_off.items()
    ]
    machines += [
        f"By the calendar: {by_name[entry.control].meaning}, {full(by_name[entry.control], entry.value)}, {entry.in_words()}."
        for entry in task.schedule
    ]
    yield plain(
        "What the agent controls",
        machines,
        ("Control", "What it does", "Fully open or on", f"Most in {minutes(task.step_seconds)}"),
        actions,
    )
    limits = []
    for one in card.constraints:
        unit, cost = pretty_unit(one.unit), f"{one.scale:g} {one.unit} cost 1 point a step"
        if one.price is not None:
            each = 1 if one.price >= 1e-3 else 100
            cost = f"{each * one.price:.2g} EUR/m² for every {'' if each == 1 else '100 '}{unit} and hour"
            if one.lower_price is not None:
                cost += f"; {each * one.lower_price:.2g} EUR/m² for values below the lower limit"
        limits.append((words.limits[one.name], f"{one.low:g} {unit}", f"{one.high:g} {unit}", cost))
    if limits:
        yield plain("Limits of the climate", (), ("Quantity", "Lowest", "Highest", "What a violation costs"), limits)
    prices = []
    for of_money in words.items:
        item = next(one for one in task.ledger.items if one.name == of_money.money)
        if isinstance(item.price, str):
            table = task.price_tables[item.price]
            low, high = table.limits
            by = "by the hour of the day" if table.hourly else "by the hour, with sun and wind"
            by = "with the date" if table.dated else "by the hour, as in a table" if table.series else by
            price = f"changes {by}, {low:g} to {high:g} {pretty_unit(table.unit)}"
            if table.source in labels:
                price += f"; that of {in_sentence(labels[table.source])}{f' and {table.plus:g}' if table.plus else ''}"
        else:
            price = f"{item.price:g} {of_money.unit}"
            if item.beyond is not None:
                price += f", {item.beyond.price:g} beyond {item.beyond.amount:g} {item.amount_unit}"
        prices.append((of_money.label, "earned" if of_money.sign > 0 else "paid", price, item.amount_meaning or item.label))
    yield plain("Prices", (), ("Item", "", "Price", "Of what"), prices)
    score, profit, penalty = words.score, words.profit, words.of_kind("penalty")[0]
    counted = (
        f"{profit.label} minus {in_sentence(penalty.label)}"
        if "epi" in task.reward.modules
        else "profit on a scale from 0 to 1 a step, minus the penalty for broken limits"
    )
    lines = [
        f"{score.label} of a run: {in_sentence(counted)}, summed over all {task.steps:,} decisions.",
        f"Agents are ranked by the mean over {task.evaluation.runs} runs. Every decision that a failed run misses costs "
        f"{abs(task.evaluation.failed_step.reward):.2g} {pretty_unit(score.unit) or 'points'}.",
    ]
    yield plain("What counts", lines)


def figures(task: tasks.TaskSpec) -> dict[str, Any]:
    """What charts need of a task, and what the reward needs to be computed again at other prices.

    A price that is a table stands as the factor 1 of that table, with its hourly prices and their mean where it has them. The mean is
    null where it can be taken from what runs sold and bought, and missing where an item is valued as a stock.
    """
    from glbench.env.accounts import make_accounts

    accounts, labels, scale = make_accounts(task), catalogue(task).limits, task.penalty_scales
    scaled: dict[str, Any] = {}  # what ``scaled_epi`` is made of at other prices
    if "scaled_epi" in task.reward.modules and accounts.stated_bounds is not None:
        scaled = {"stated_scale": list(accounts.stated_bounds)}
    elif "scaled_epi" in task.reward.modules:
        paid, earned = ([item.name for item in side] for side in (accounts.ledger.paid, accounts.ledger.earned))
        scaled = {
            "full_use": dict(zip(paid, accounts.full_use.tolist(), strict=True)),
            "full_growth": dict(zip(earned, accounts.full_growth.tolist(), strict=True)),
        }
    return {
        "limits": [
            {
                "name": name, "label": labels[name], "unit": pretty_unit(limits.unit),
                "low": limits.low, "high": limits.high, "scale": scale[name],
            }
            for name, limits in task.constraints.items()
        ],
        "prices": {item.name: 1.0 if isinstance(item.price, str) else item.price for item in task.ledger.items},
        "hourly_prices": {
            item.name: list(task.price_tables[item.price].hourly) for item in task.ledger.items if isinstance(item.price, str)
        },
        "mean_prices": {
            item.name: fmean(hourly) if (hourly := task.price_tables[item.price].hourly) else None
            for item in task.ledger.items
            if isinstance(item.price, str) and (item.valued == FLOW or task.price_tables[item.price].hourly)
        },
        "beyond": {item.name: [item.beyond.amount, item.beyond.price] for item in task.ledger.items if item.beyond},
        "reward_modules": list(task.reward.modules),
        **scaled,
        "failed_step": task.evaluation.failed_step.model_dump(),
    }  # fmt: skip


def clock_of(task: tasks.TaskSpec) -> str:
    """The clock that the hours of the day are of; UTC where the weather record is not installed."""
    try:
        return "UTC" if task.weather.preprocessing == "paper" else task.record().timezone
    except GlbenchError:
        return "UTC"


def clock_changes(task: tasks.TaskSpec) -> bool:
    """Whether the clock can change to or from summer time within a run."""
    zone, scenario = ZoneInfo(clock_of(task)), task.scored.scenario
    days = range(task.weather.days + scenario.start_within_days + 1)
    offsets = (
        {dt.datetime.combine(season.start + dt.timedelta(days=late), dt.time(), zone).utcoffset() for late in days}
        for season in scenario.seasons
    )
    return any(len(shifts) > 1 for shifts in offsets)


def common_start(task: tasks.TaskSpec) -> dt.date | None:
    """First day of all runs; ``None`` where the days of two runs have different dates, leap days included."""
    scenario, length = task.scored.scenario, dt.timedelta(days=task.weather.days)
    days = [season.start for season in scenario.seasons]
    dates = {(first.month, first.day, last.month, last.day) for first, last in ((day, day + length) for day in days)}
    return None if scenario.start_within_days or len(dates) > 1 else days[0]


def minutes(seconds: float) -> str:
    """A step in minutes, or in seconds where that is not a whole number."""
    return f"{seconds / 60:g} min" if seconds % 60 == 0 else f"{seconds:g} s"


def day(date: dt.date) -> str:
    """``1 March 2010``."""
    return f"{date.day} {date:%B %Y}"


def period(task: tasks.TaskSpec) -> str:
    """``50 days from 1 March 2010, 2011 or 2012, up to 14 days later``: how long, and every first day that a run may draw.

    Without years where those are listed with the splits.
    """
    scenario = task.scenario
    days = sorted({season.start for season in scenario.seasons})
    if task.splits is not None:
        first = _without_year(task.weather.start)
    elif len({(start.month, start.day) for start in days}) == 1:
        *others, last = [str(start.year) for start in days]
        first = f"{_without_year(days[0])} {_or(others, last)}"
    else:
        *others, last = [day(start) for start in days]
        first = _or(others, last)
    within = scenario.start_within_days
    later = f", up to {within} day{'s' if within > 1 else ''} later" if within else ""
    return f"{task.weather.days} days from {first}{later}"


def _without_year(date: dt.date) -> str:
    """``1 March``."""
    return f"{date.day} {date:%B}"


def _or(others: Sequence[str], last: str) -> str:
    return f"{', '.join(others)} or {last}" if others else last


def _period(task: tasks.TaskSpec, card: tasks.TaskCard | None) -> list[str]:
    weather, end = task.weather, task.weather.start + dt.timedelta(days=task.weather.days)
    scenario, clock, place = task.scenario, "", "not installed here"
    if card is not None:
        at, clock = card.place, f", clock {card.clock}"
        if card.clock == "UTC" != at.timezone:  # how far the grower's own clock is ahead
            zone = ZoneInfo(at.timezone)
            moments = (dt.datetime.combine(date, dt.time(), dt.UTC) for date in (card.start, end))
            shifts = dict.fromkeys((moment.astimezone(zone).utcoffset() or dt.timedelta()) / dt.timedelta(hours=1) for moment in moments)
            clock += f" ({at.timezone} is UTC{' and later UTC'.join(f'{hours:+g} h' for hours in shifts)})"
        north, east = ("N" if at.latitude >= 0 else "S"), ("E" if at.longitude >= 0 else "W")
        place = f"{at.station}, {abs(at.latitude):g} {north}, {abs(at.longitude):g} {east}, {at.altitude:g} m"
    when = f"{weather.days} days, from {day(weather.start)} 00:00 to {day(end)} 00:00"
    varies = len(scenario.seasons) > 1 or scenario.start_within_days > 0
    if varies or task.splits is not None:
        choice = "another for every season" if scenario.generated else "drawn evenly" if varies else "the same"
        when = f"{period(task)}, {choice}{'' if scenario.generated else ' for every run'}"
    between = scenario.generated.co2_range if scenario.generated is not None else None
    co2 = f"{weather.co2_ppm:g} ppm" if between is None else f"wanders between {between[0]:g} and {between[1]:g} ppm"
    if weather.preprocessing == "sampled":
        co2 = "as sampled"
    return [
        f"{when}{clock}; one decision every {minutes(task.step_seconds)}, {task.steps} in all.",
        f"Weather '{weather.source}': {place}; CO2 outside {co2}.",
        f"Prepared {tasks.PREPROCESSINGS[weather.preprocessing].meaning}.",
    ]


_FOR = {"training": "Training", "validation": "Validation, to choose between agents", "test": "Test, which scores"}


def _splits(task: tasks.TaskSpec, splits: tables.SplitsTable) -> Iterator[str]:
    """What each split is for, of which years it is made, and how many seasons it has."""
    listed: set[tuple[int, ...]] = set()
    for name in splits.names:
        split: tables.SplitTable = getattr(splits, name)
        *others, last = [str(year) for year in split.years]
        years = f"{', '.join(others)} and {last}" if others else last
        if task.scenario.generated is None:
            seasons = f"the seasons of {years}"
        else:
            other = "other " if split.years in listed else ""
            seasons = f"{split.seasons} {other}season{'s' if split.seasons != 1 else ''}, put together from days of {years}"
        listed.add(split.years)
        yield f"{_FOR[name]}: {seasons}."
    if task.scenario.generated is not None:
        yield "Weather, first day, CO2 outside and forecast errors belong to the season; all else that is drawn belongs to the run."
    if splits.training is None:
        yield f"Nothing can be learned here: agents come from {task.base or 'another task'}."


def _greenhouse(task: tasks.TaskSpec) -> Iterator[Section]:
    """The model with its parameters and start, what of it a run draws, and what each sensor is off by."""
    names, uncertainty, scenario = task.uncertain_parameters(), task.uncertainty, task.scenario
    equations = f"; {_meaning(tasks.MODEL_VARIANTS, task.model.variant)}" if task.model_id.startswith("greenlight") else ""
    running = "".join(f"{name} at {value:g} {unit}, " for name, value, unit in task.initial.controls)
    lines = [
        *([f"Model {task.model_id}."] if task.conventions.names_model else []),
        f"Parameter set '{task.model.parameters}'{equations}.",
        *(f"Changed: {name} = {value:g} {unit}." for name, value, unit in task.model.overrides),
        f"Start: {_meaning(tasks.INITIAL_STATES, task.initial.kind)} ({task.initial.air_temperature:g} degC), "
        f"{running}all {'other ' if running else ''}controls at 0.",
    ]
    if not task.conventions.shows_delta:
        lines.append(f"Random numbers of the family '{scenario.family}'.")
        if len({season.source for season in scenario.seasons}) > 1:
            days = ", ".join(f"{season.start} ({season.source})" for season in scenario.seasons)
            lines.append(f"A run's season is one of {len(scenario.seasons)}, drawn evenly: {days}.")
        lines += [
            f"Uncertain, drawn {_WHEN[group.redraw]}, '{group.name}' ({group.distribution}, ±{100 * group.half_width:g} %): "
            f"{', '.join(group.parameters)}."
            if group.spread is None
            else f"Uncertain, drawn {_WHEN[group.redraw]}, '{group.name}' (log-normal, spread '{group.spread.name}' with factor "
            f"{group.spread.factor:g}, a season's heat within {HEAT[0]:g} to {HEAT[1]:g} times that of the nominal house): "
            f"{', '.join(f'{name} {words}' for name, words in group.spread.reach().items())}."
            for group in scenario.groups
        ]
        lines += [
            f"Drawn at the start, '{start.name}' ({start.distribution}, ±{100 * start.half_width:g} %): {', '.join(start.states)}."
            for start in scenario.start_groups
        ]
    elif uncertainty.half_width == 0.0:
        lines.append("Nothing is uncertain: the parameters keep their nominal values.")
    else:
        moment = "at every step" if uncertainty.redraw == "step" else "once an episode"
        lines += [
            f"Uncertain: {moment} each of {len(names)} parameters is its nominal value times 1 + e, e {uncertainty.distribution} "
            f"within ±{100 * uncertainty.half_width:g} % and different for each.",
            f"These are {', '.join(names)}.",
        ]
    yield Section("Greenhouse and crop", lines)
    if task.sensors is not None:
        lines = []
        for name, sensor in task.sensors.items():
            label = f"{name.replace('_', ' ')}:".capitalize().replace("Co2", "CO2")
            for_a_run = "both standard deviations" if sensor.noise else "standard deviation"
            parts = (
                ("noise", sensor.noise, " at every step"),
                ("bias", sensor.bias, f" for a run ({for_a_run})"),
                ("drift of up to", sensor.drift, " by the end"),
            )
            errors = [f"{word} {value:g} {LIMITED[name]}{more}" for word, value, more in parts if value]
            lines.append(f"{label} {', '.join(errors) or 'no error'}.")
        if (out := task.sensors.dropouts) is not None:
            every = f"every {out.days_between:g} days for {out.hours:g} h"
            lines.append(f"Each hangs at its last value {every}, both on average.")
        yield Section("Sensors inside; what is judged is the truth", lines)
    if task.outdoor_sensors is not None:
        yield Section(_OUTSIDE, [_outdoor_sensor(name, sensor) for name, sensor in task.outdoor_sensors.items()])
    if task.actuators:
        meanings = {capacity.name: capacity.meaning for capacity in task.capacities()}
        yield Section(_ACTUATORS, [f"{name} ({meanings[name]}) {_actuator(one)}." for name, one in task.actuators.items()])
    if task.samples:
        yield Section(_BY_HAND, [_sample(name, table) for name, table in task.samples.items()])
    if task.picture_library is not None and task.camera is not None:
        often = f"Every day at {task.camera.hour} h, first at the start: heads of their mean mass then, plants and light drawn at random."
        library = (
            f"Library '{task.camera.library}': {len(task.picture_library.seeds)} rendered pictures, {task.picture_library.digest[:12]}..."
        )
        yield Section(_CAMERA, [often, library])


_OUTSIDE = "Sensors of the weather; what acts is the truth, and forecasts come from elsewhere"


def _outdoor_sensor(name: str, sensor: tables.ScaledSensorTable | tables.OffsetSensorTable) -> str:
    """How far one is off."""
    unit, label = OUTDOOR[name].unit, name.replace("_", " ").capitalize()
    if isinstance(sensor, tables.ScaledSensorTable):
        scale = f"reads {sensor.scale.low:g} to {sensor.scale.high:g} times the truth, drawn evenly for a run"
        return f"{label}: {scale}; noise {100 * sensor.noise:g} % at every step (standard deviation)."
    return f"{label}: bias {sensor.bias:g} {unit} for a run, noise {sensor.noise:g} {unit} at every step (both standard deviations)."


_ACTUATORS = "Actuators; the agent sees their commands, not what they deliver"


def _actuator(table: tables.ActuatorTable) -> str:
    """What an actuator does to its commands."""
    parts = [f"follows with a lag of {table.lag_minutes:g} minutes"] if table.lag_minutes else []
    if table.shortfall:
        parts.append(f"delivers less by 0 to {100 * table.shortfall:g} %, drawn once a run")
    for fault, words in ((table.sticks, "stays where it is"), (table.fails, "delivers nothing")):
        if fault is not None:
            parts.append(f"{words} every {fault.days_between:g} days for {fault.hours:g} h, both on average")
    if table.wind is not None:
        parts.append(f"delivers less above {table.wind.above:g} m/s of wind, {100 * table.wind.share:g} % from {table.wind.full:g} m/s on")
    return "; ".join(parts) or "is ideal"


_CAMERA = "A camera above the crop; the agent sees what an encoder makes of the last picture"
_BY_HAND = "Counted or weighed by hand; the agent sees the last sample until the next"


def _sample(module: str, table: tables.SampleTable) -> str:
    """How often a module is sampled, and how far a sample is off."""
    often = "every day" if table.every_days == 1 else f"every {table.every_days} days"
    label = module.replace("_", " ").capitalize()
    return f"{label}: {often}, first at the start; noise {100 * table.noise:g} % in each sample and column (standard deviation)."


def _meaning(words: tasks.Registry[Any], name: str) -> str:
    """What a word means, or the word where only the model knows it."""
    return words[name].meaning if name in words else f"'{name}'"


_WHEN = {"step": "at every step", "day": "every day", "episode": "once a run"}


def _interface(task: tasks.TaskSpec, card: tasks.TaskCard) -> Iterator[Section]:
    """What the agent sees, and what it does."""
    count = len(card.observations)
    first = card.observations if count <= _MOST_ROWS else card.observations[:_FIRST_ROWS]
    rows = [
        (str(i), one.name, one.unit, f"{one.low:g}", f"{one.high:{'g' if one.high < 1e6 else '.2g'}}", one.meaning)
        for i, one in enumerate(first)
    ]
    if len(first) < count:
        rows.append(("...", f"and {count - len(first)} more; --json lists all", "", "", "", ""))
    hours, forecast, lines = task.observation.forecast_hours, task.observation.forecast, []
    if hours and isinstance(forecast, tables.ForecastTable):
        ahead, error = ", ".join(map(str, hours)), forecast.error
        mean = "; zero on average" if forecast.unbiased else ""
        lines = [f"Forecast by the hour, {ahead} h ahead; errors '{error}': {FORECAST_ERRORS[error].meaning}{mean}."]
    heading = f"What the agent sees: {count} values after every step, float32, in this order"
    bounds = ("", "Name", "Unit", "Lowest", "Highest", "Meaning")
    yield Section(heading, lines, bounds, ("", "Lowest", "Highest"), rows)
    by_name, heading = {capacity.name: capacity for capacity in card.controls}, "What the agent does"
    words = f"{len(card.actions)} numbers a step, in this order: {tasks.ACTUATION_KINDS[card.actuation].meaning}."
    schedule = [f"By the schedule {entry.control} is {entry.value:g}: {entry.in_words()}." for entry in task.schedule]
    if any(action.name not in by_name for action in card.actions):
        rows = [
            (str(i), action.name, action.unit, f"{action.lowest:g}", f"{action.highest:g}", action.meaning)
            for i, action in enumerate(card.actions)
        ]
        yield Section(heading, (words, *schedule), bounds, ("", "Lowest", "Highest"), rows)
        return
    rows = []
    for i, action in enumerate(card.actions):
        one = by_name[action.name]
        at_one, most = _delivers(one, 1.0), "switched" if one.name in task.on_off else _delivers(one, card.max_change)
        rows.append((str(i), one.name, one.meaning, f"{action.low:g} to {action.high:g}", at_one, most))
    others = by_name.keys() - {action.name for action in card.actions}
    idle = dict.fromkeys(others, "stays at 0") | dict.fromkeys(task.scheduled_places, "scheduled")
    rows += [("", name, by_name[name].meaning, idle[name], "", "") for name in sorted(others)]
    machines = [
        f"{name} is 0 or {f'{one.lowest:g} to ' if one.lowest < 1.0 else ''}1"
        + (f", and stays on or off for at least {one.hold_minutes:g} minutes." if one.hold_minutes else ".")
        + _due_words(task, one)
        for name, one in task.on_off.items()
    ]
    machines += schedule
    columns = ("", "Control", "Drives", "Action", "At 1", "Most a step")
    yield Section(heading, (words, *machines), columns, ("", "At 1", "Most a step"), rows)


def _due_words(task: tasks.TaskSpec, machine: tables.OnOffTable) -> str:
    """When a machine runs that is due by a state, in words."""
    if machine.due is None:
        return ""
    due, meaning = machine.due, {state.name: state.meaning for state in task.model_value.states}[machine.due.state]
    unit = "days" if due.unit == "day" else due.unit
    spans = f"{due.first:g} {unit} at the highest action, {due.last:g} {unit} at the lowest"
    return f" Its action says when: it is on when the {meaning} is at least {spans}."


def _delivers(capacity: tasks.Capacity, fraction: float) -> str:
    return f"{capacity.at_one * fraction:g}" + (f" {capacity.unit}" if capacity.unit != "-" else "")


def _money(task: tasks.TaskSpec, card: tasks.TaskCard | None) -> Iterator[Section]:
    """Limits of the climate with what their violations cost, and what is earned and paid."""
    words = catalogue(task)
    if card is not None and card.constraints:
        rows: list[tuple[str, ...]] = [
            (
                words.limits[one.name],
                *(f"{value:g} {one.unit}" for value in (one.low, one.high)),
                f"{one.scale:g} {one.unit}"
                if one.price is None
                else f"{one.price:g}{'' if one.lower_price is None else f', below {one.lower_price:g}'} {VIOLATION_PRICES[one.name]}",
            )
            for one in card.constraints
        ]
        cost = "Price of a violation" if task.violation_prices else "Violation that costs 1 a step"
        how = "judged by the mean distance in every step" if task.judges_means else "checked after every step"
        columns = ("Quantity", "Lowest", "Highest", cost)
        yield Section(f"Limits of the climate, {how}", (), columns, ("Lowest", "Highest"), rows)
    labels, rows = {item.money: item.label for item in words.items}, []
    for item in task.ledger.items:
        if isinstance(item.price, str):
            table = task.price_tables[item.price]
            by = "hour of the day" if table.hourly else "date" if table.market is None else "hour, with sun and wind"
            low, high = table.limits
            price = f"'{item.price}', {low:g} to {high:g} {table.unit} by {by}"
        else:
            per = unit_sold(item.amount_unit) or "piece" if "m-2" in item.amount_unit else f"m2 and {item.amount_unit}"
            beyond = item.beyond and f", {item.beyond.price:g} beyond {item.beyond.amount:g} {item.amount_unit}"
            price = f"{item.price:g} EUR per {per}{beyond or ''}"
        side = "earned" if item.sign > 0 else "paid"
        rows.append((labels[item.name], side, price, item.amount_meaning or item.label))
    lines = []
    for name, table in task.price_tables.items():
        times = f"{table.times:g} times " if table.times != 1.0 else ""
        plus = f", {'plus' if table.plus > 0 else 'minus'} {abs(table.plus):g}" if table.plus else ""
        what = f"that of '{table.source}'" if table.source else _entries_of_prices(table)
        lines.append(f"Price '{name}' [{table.unit}]: {times}{what}{plus}.")
    yield Section("Prices", lines, ("Item", "", "Price", "Amount"), (), rows)


_MOST_POINTS = 12  # Moments of a series that are listed one by one


def _entries_of_prices(table: tasks.PriceTable) -> str:
    """Hours of equal price as ranges, days, moments; a long series from where to where; a market by what moves it."""
    if table.market is not None:
        market = table.market
        return (
            f"a market around {market.level:g} that sun and wind make cheaper, by {100 * market.sun:g} % of that at 1000 W m-2 and by "
            f"{100 * market.wind:g} % for 5 m s-1, from {market.lowest:g} to {market.highest:g}"
        )
    if table.hourly:
        ranges, hour = [], 0
        for price, hours in groupby(table.hourly):
            end = hour + len(list(hours))
            ranges.append(f"{hour:02d}:00 to {end:02d}:00 {price:g}")
            hour = end
        return ", ".join(ranges)
    if table.dated:
        return ", ".join(f"from {number} {month_name[month]} {price:g}" for month, number, price in table.dated)
    series = table.series
    if len(series) <= _MOST_POINTS:
        return ", ".join(f"from {moment:%Y-%m-%d %H:%M} UTC {price:g}" for moment, price in series)
    prices = [price for _, price in series]
    return (
        f"{len(series)} prices from {series[0][0]:%Y-%m-%d %H:%M} to {series[-1][0]:%Y-%m-%d %H:%M} UTC, "
        f"{min(prices):g} to {max(prices):g}, mean {fmean(prices):g}"
    )


_PRICED_PENALTY = "minus what the violations of the limits cost, each at its price [EUR m-2]"


def _scoring(task: tasks.TaskSpec) -> Iterator[Section]:
    """The reward of a step, and how runs are evaluated."""
    modules, evaluation, words = task.reward.modules, task.evaluation, catalogue(task)
    meanings = {name: tasks.REWARD_MODULES[name].meaning for name in modules}
    if task.violation_prices:
        meanings |= {name: _PRICED_PENALTY for name in modules if name == "scaled_penalty"}
    lines = [f"reward = {' + '.join(modules)}", *(f"  {name}: {meaning}." for name, meaning in meanings.items())]
    if {"epi", "scaled_epi"} & set(modules):
        name = "Profit (epi)" if task.violation_prices else "Economic performance EPI"
        lines += [f"{name} [EUR m-2] =", *(f"  {line}" for line in task.ledger.lines())]
    if "scaled_epi" in modules:
        from glbench.env.accounts import make_accounts

        accounts, lowest, highest = make_accounts(task), "", ""
        if task.conventions.paper_words:
            lowest = ": all that is paid for at its most, no growth"
            highest = ": growth at the potential rate at 20 degC, nothing used"
        lines += [
            "Scaled EPI = (EPI - lowest) / (highest - lowest), not clipped;",
            f"  lowest {accounts.lowest_epi:.6f} EUR m-2{lowest};",
            f"  highest {accounts.highest_epi:.8f} EUR m-2{highest}.",
        ]
    yield Section("Reward of a step", lines)
    charges = [
        f"{words.metrics[name].words} {getattr(evaluation.failed_step, name):g} {words.metrics[name].unit}".rstrip(" -")
        for name in ("reward", "epi", "penalty")
    ]
    lines = [
        f"{evaluation.runs} runs with the seeds {evaluation.seeds[0]} to {evaluation.seeds[-1]}. "
        f"Ranked by {evaluation.metric}: {tasks.METRICS[evaluation.metric].meaning}.",
        f"Each missing step of a run that fails counts as {', '.join(charges)}.",
    ]
    yield Section("Evaluation", lines)
