"""What one agent does differently from another, and what that earns: their recorded actions on the same seeds, taken again side by side.

Each step of a run belongs to one of four periods of the day, which add up to the run. Everything told of a period is a mean or a sum
over its steps; none of it says why. The second half of this file tells it in words, as a page, and as plain values.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench import __version__
from glbench.arrays import Floats
from glbench.env.kernels import Stepper
from glbench.episodes import ActionLog, replayed_episodes
from glbench.episodes.episode import local_days, sums_by
from glbench.episodes.recorder import LARGEST_TRACE, bytes_a_step
from glbench.episodes.signals import KWH_A_CUBIC_METRE, Curve, Line, signals_of
from glbench.errors import ResultError
from glbench.evaluation import Result, load_result
from glbench.evaluation.saving import recorded_actions, task_of_result
from glbench.extras import require
from glbench.kernel import make_kernel
from glbench.leaderboard.catalogue import catalogue
from glbench.leaderboard.pairs import failures
from glbench.leaderboard.statistics import estimate_difference
from glbench.quantities import capitalised, in_sentence, plain_unit, pretty_unit, sentence
from glbench.report.task_words import clock_of
from glbench.tasks import TaskSpec

Places = NDArray[np.integer[Any]]

DARK = 5.0  # Global radiation outside below which it is dark [W m-2]
BEFORE_LIGHT, AFTER_LIGHT = 1.0, 2.0  # Dawn: from so long before the first light of a day until so long after it [h]
NIGHT, DAWN, DAY = range(3)  # Parts of a day
PERIODS = ("night", "dawn", "bright days", "dull days")
BRIGHT_DAYS, DULL_DAYS = 2, 3
MEANINGS = (
    f"from dusk until {BEFORE_LIGHT:g} h before the first light; it is dark below {DARK:g} W/m² outside",
    f"from {BEFORE_LIGHT:g} h before the first light until {AFTER_LIGHT:g} h after it",
    "the rest of those days on which the sum of radiation outside is at least the median of all days and runs",
    "the rest of the other days",
)
_RADIATION = "iGlob"
_HOURS = 24
_DAYS = 7
_PAGES_OF_LEVELS = ("Climate", "Controls")


@dataclass(frozen=True, eq=False)
class Story:
    """Two agents on the same runs; index 0 of an axis of two is the agent, 1 the one that it is held against."""

    task: TaskSpec
    """With the draws of the runs."""
    agents: tuple[str, str]
    seeds: tuple[int, ...]
    """``agents`` and ``seeds``: their names, and the runs that both ended."""
    left_out: tuple[int, ...]
    """Seeds that both have and that one of them did not end."""
    failed: tuple[str, ...]
    """Of each agent that did not end all shared runs, how many failed and how."""
    levels: tuple[Curve, ...]
    """What is shown as a mean: climate and controls, as the viewer draws them."""
    lines: tuple[Line, ...]
    """What is shown as a sum: light, amounts, money."""
    clock: str
    """The clock of the hours and days."""
    hours: Floats
    """Mean levels by hour of the local day, ``(2, 24, levels)``."""
    times: Floats
    """Hours a run in each period, ``(periods,)``, mean over the runs."""
    means: Floats
    """Mean levels in each period, ``(2, periods, levels)``; not a number in a period that never was."""
    sums: Floats
    """Sums of the lines, ``(2, runs, periods, lines)``."""
    weeks: Floats
    """Sums of the lines by week of the run, mean over the runs, ``(2, weeks, lines)``; of light the mean of a day."""
    days: Places
    """Days of each week, ``(weeks,)``."""

    def line(self, kind: str) -> int:
        """Place of the one line of a kind: profit, violations, score."""
        return next(place for place, line in enumerate(self.lines) if line.kind == kind)

    def gaps(self) -> Floats:
        """Agent minus the other, mean over the runs, ``(periods, lines)``."""
        difference: Floats = (self.sums[0] - self.sums[1]).mean(axis=0)
        return difference


def tell(path: Path, against: Path, workers: int = 1) -> Story:
    """The story of the result at ``path`` against that at ``against``, from the actions recorded beside them.

    Raises ``ResultError`` when they are not of one task and split, have no run in common that both ended, or are of one agent, and
    ``EpisodeError`` when the recorded actions of one are missing or of another result.
    """
    paths = (path, against)
    results = (load_result(path), load_result(against))
    if (results[0].task.digest, results[0].task.split) != (results[1].task.digest, results[1].task.split):
        msg = (
            f"{path} is of {_whose(results[0])}, {against} of {_whose(results[1])}: "
            "only results of one task can be told against each other."
        )
        raise ResultError(msg)
    if results[0].agent.name == results[1].agent.name:
        msg = f"Both results are of {results[0].agent.name}. Give one of another agent: --against NAME or --against RESULT.json."
        raise ResultError(msg)
    task = task_of_result(results[0], path)
    shared = sorted({run.seed for run in results[0].runs} & {run.seed for run in results[1].runs})
    ended = [{run.seed for run in one.runs if run.status == "ok"} for one in results]
    seeds = tuple(seed for seed in shared if seed in ended[0] and seed in ended[1])
    common = [[run for run in one.runs if run.seed in shared] for one in results]
    reasons = [failures(one.agent.name, runs) for one, runs in zip(results, common, strict=True)]
    failed = tuple(words for words in reasons if words)
    if not shared:
        msg = f"{path} and {against} have no seed in common. Evaluate one of them again with the seeds of the other (--seed, --runs)."
        raise ResultError(msg)
    if not seeds:
        broken = " and ".join(str(place) for place, words in zip(paths, reasons, strict=True) if words)
        msg = (
            f"{'; '.join(failed)}. The two have no run in common that both ended, so there is nothing to tell. "
            f"The reasons of the failures stand in {broken}."
        )
        raise ResultError(msg)
    logs = [recorded_actions(result, place) for result, place in zip(results, paths, strict=True)]
    with make_kernel(task.model_value, task.step_seconds, workers=workers) as kernel:
        sides = [_side(task, log, seeds, kernel) for log in logs]
    signals = signals_of(task)
    return Story(
        task=task,
        agents=(results[0].agent.name, results[1].agent.name),
        seeds=seeds,
        left_out=tuple(seed for seed in shared if seed not in seeds),
        failed=failed,
        levels=levels_of(task),
        lines=signals.accounts,
        clock=clock_of(task),
        times=sides[0]["times"],
        days=sides[0]["days"],
        **{name: np.stack([side[name] for side in sides]) for name in ("hours", "means", "sums", "weeks")},
    )


def _whose(result: Result) -> str:
    return f"{result.task.id}{f' ({result.task.split})' if result.task.split else ''}, digest {result.task.digest[:12]}..."


def levels_of(task: TaskSpec) -> tuple[Curve, ...]:
    """Climate and controls, without sums since midnight."""
    today = {series.path for series in task.model_value.signals() if series.today is not None}
    pages = (page for page in signals_of(task).pages if page.title in _PAGES_OF_LEVELS)
    return tuple(curve for page in pages for curve in page.curves if not curve.summed and curve.path not in today)


def parts_of(radiation: Floats, days: Places, step_seconds: float) -> Places:
    """The part of the day that each step belongs to, ``(steps,)``.

    Of each step, ``(steps,)``, ``radiation`` is the global radiation outside [W m-2], and ``days`` the day on which it begins, from 0
    without gaps; a step lasts ``step_seconds`` [s].
    """
    parts = np.full(len(radiation), NIGHT)
    before, after = (round(hours * 3600.0 / step_seconds) for hours in (BEFORE_LIGHT, AFTER_LIGHT))
    for day in range(int(days[-1]) + 1):
        lit = np.flatnonzero((days == day) & (radiation >= DARK))
        if len(lit):
            first, last = int(lit[0]), int(lit[-1])
            parts[first : last + 1] = DAY
            parts[max(first - before, 0) : min(first + after, last + 1)] = DAWN
    return parts


def periods_of(light: Floats) -> Places:
    """The period of each part of each day, ``(..., days, parts)``, from sums of radiation ``(..., days)`` of all days and runs."""
    periods = np.empty((*light.shape, len((NIGHT, DAWN, DAY))), dtype=np.int64)
    periods[..., NIGHT], periods[..., DAWN] = NIGHT, DAWN
    periods[..., DAY] = np.where(light >= np.median(light), BRIGHT_DAYS, DULL_DAYS)
    return periods


def _side(task: TaskSpec, log: ActionLog, seeds: Sequence[int], kernel: Stepper) -> dict[str, NDArray[Any]]:
    """What ``Story`` has of one agent: its runs are replayed as many at a time as fit into memory, and of each only sums are kept."""
    signals, curves, parts = signals_of(task), levels_of(task), len((NIGHT, DAWN, DAY))
    rows = [list(log.seeds).index(seed) for seed in seeds]
    together = max(1, LARGEST_TRACE // (task.steps * bytes_a_step(task)))
    by_hour, steps_by_hour, levels, steps, lines, light = ([] for _ in range(6))
    for first in range(0, len(rows), together):
        for episode in replayed_episodes(task, log, rows[first : first + together], kernel):
            local = episode.local_times
            radiation, days = np.asarray(episode[_RADIATION], dtype=np.float64), local_days(local)
            hours = ((local[:-1] - local[:-1].astype("datetime64[D]")) // np.timedelta64(1, "h")).astype(np.int64)
            count = int(days[-1]) + 1
            places, size = days * parts + parts_of(radiation, days, task.step_seconds), count * parts
            columns = {name: np.asarray(episode[name], dtype=np.float64) for curve in curves for name in curve.columns}
            values = [curve.values(columns) for curve in curves]
            by_hour.append(np.stack([np.bincount(hours, one, _HOURS) for one in values], axis=1))
            steps_by_hour.append(np.bincount(hours, minlength=_HOURS))
            levels.append(np.stack([np.bincount(places, one, size) for one in values], axis=1).reshape(count, parts, -1))
            steps.append(np.bincount(places, minlength=size).reshape(count, parts))
            lines.append(sums_by(episode, signals, places, size).reshape(count, parts, -1))
            light.append(np.bincount(days, radiation, count))
    periods = periods_of(np.stack(light))
    masks = [periods == period for period in range(len(PERIODS))]  # (runs, days, parts) each
    all_steps, all_levels, all_lines = (np.stack(one) for one in (steps, levels, lines))
    steps_in = np.array([all_steps[mask].sum() for mask in masks])
    weeks = np.arange(all_lines.shape[1]) // _DAYS
    by_week = np.stack([all_lines[:, weeks == week].sum(axis=(1, 2)).mean(axis=0) for week in range(weeks[-1] + 1)])
    lengths = np.bincount(weeks)
    by_week[:, [line.kind == "light" for line in signals.accounts]] /= lengths[:, None]
    with np.errstate(invalid="ignore"):  # an hour or a period that never was has no mean
        return {
            "hours": np.stack(by_hour).sum(axis=0) / np.stack(steps_by_hour).sum(axis=0)[:, None],
            "times": steps_in * (task.step_seconds / 3600.0) / len(seeds),
            "means": np.stack([all_levels[mask].sum(axis=0) for mask in masks]) / steps_in[:, None],
            "sums": np.stack([(all_lines * mask[..., None]).sum(axis=(1, 2)) for mask in masks], axis=1),
            "weeks": by_week,
            "days": lengths,
        }


_MINUS = "\u2212"
_MOST_LEVELS = 5  # Levels that a period's words name at most: those that differ most
_CENT = 0.005  # Smallest amount of money that is reported [EUR m-2]
_SHARE = 0.01  # An amount is reported if it differs by at least this share of the larger of the two
_DECIMALS = {"°C": 1, "%": 0, "ppm": 0, "kPa": 2, "g/m³": 1}
_VISIBLE = {"°C": 0.3, "%": 2.0, "ppm": 30.0, "kPa": 0.05, "g/m³": 0.3}  # Smallest differences of levels that are reported, by unit
_ALIKE = {
    "climate/canopy_temperature": "climate/air_temperature",
    "climate/vapour_pressure_deficit": "climate/relative_humidity",
    "climate/humidity_deficit": "climate/relative_humidity",
    "climate/pipe_temperature": "controls/boiler",
}
"""Levels that say much the same as another: words name one of them."""
_EARNED, _PAID = "earned", "paid"
_WIDTH, _HEIGHT, _LEFT, _RIGHT, _TOP, _BOTTOM = 300, 176, 52, 8, 8, 36


def unit_of(curve: Curve) -> str:
    """``g/m³`` for ``g m⁻³``."""
    return _pretty(plain_unit(curve.unit))


def _pretty(unit: str) -> str:
    """``m³/m²`` for ``m3 m-2``."""
    return re.sub(r"^m3", "m³", pretty_unit(unit))


def number(value: float, decimals: int, *, signed: bool = False) -> str:
    """``−0.42``; a plus where ``signed``, none before what rounds to 0; a dash for what is not known."""
    if math.isnan(value):
        return "–"
    text = f"{abs(value):,.{decimals}f}"
    if float(text.replace(",", "")) == 0.0:
        return text
    return (_MINUS if value < 0 else "+" if signed else "") + text


def _amount(value: float, unit: str, decimals: int, *, signed: bool = False) -> str:
    text = _pretty(unit)
    return number(value, decimals, signed=signed) + (text if text.startswith("/") else f"\u00a0{text}" if text else "")


def decimals_of(line: Line) -> int:
    """Decimals that a line of the accounts deserves."""
    return {"m-2": 1, "kWh m-2": 1, "h": 0, "-": 1}.get(line.unit, 2)


def headline(story: Story) -> str:
    """Who earns more and how sure that is, in how many runs, in which part of the day, and with how much more heat, power and fruit."""
    one, other = story.agents
    profit, violations, score = (story.line(kind) for kind in ("profit", "violations", "score"))
    totals = story.sums.sum(axis=2)  # (2, runs, lines)
    gaps, runs = totals[0] - totals[1], len(story.seeds)
    gap, line = float(gaps[:, profit].mean()), story.lines[profit]
    more = int((gaps[:, profit] > 0).sum())
    parts = [f"{number(float(value), 2, signed=True)} {_when(place)}" for place, value in enumerate(story.gaps()[:, profit])]
    what, cost = story.lines[score], story.lines[violations]

    def certainty(place: int, places: int) -> tuple[bool, str]:
        """Whether the difference of a line is beyond chance, and its interval in words."""
        spread = estimate_difference([totals[0, :, place]], [totals[1, :, place]]).interval()
        if runs == 1:
            return False, "one run: it says nothing about others"
        if spread.high <= spread.low:
            return True, "all runs differ alike"
        ends = f"95 % interval {number(spread.low, places, signed=True)} to {number(spread.high, places, signed=True)}"
        return spread.low * spread.high > 0, ends

    clear, words = certainty(profit, 2)
    figures = (
        f"({number(float(totals[0, :, profit].mean()), 2)} against {number(float(totals[1, :, profit].mean()), 2)}; "
        f"{words}; more in {more} of {runs} run{'s' * (runs > 1)})"
    )
    if (clear or runs == 1) and abs(gap) >= _CENT:
        first = f"{one} earns {_amount(abs(gap), line.unit, 2)} {'more' if gap >= 0 else 'less'} than {other} {figures}"
    else:
        first = f"The profits of {one} and {other} cannot be told apart, {_amount(gap, line.unit, 2, signed=True)} {figures}"
    better = _more(what, float(gaps[:, score].mean()), "higher", "lower")
    clear, words = certainty(score, decimals_of(what))
    chance = "" if clear or runs == 1 else ", which may be chance"
    amounts = _amount_words(story, gaps.mean(axis=0))
    return (
        f"{first}: {sentence(parts)}. {_penalty(cost, float(gaps[:, violations].mean()))}; "
        f"its {in_sentence(what.title)} is {better} ({words}){chance}."
        + (f" Over the whole run, {one} against {other}: {', '.join(amounts)}." if amounts else "")
    )


def _amount_words(story: Story, gaps: Floats) -> list[str]:
    """What grew and was used more or less, of those amounts that differ visibly; ``gaps`` by line."""
    largest = np.abs(story.sums.mean(axis=1).sum(axis=1)).max(axis=0)  # of each line, the larger of the two agents
    return [
        f"{in_sentence(line.title)} {_amount(abs(gap), line.unit, decimals_of(line))} {'more' if gap > 0 else 'less'}"
        for line, gap, most in zip(story.lines, gaps, largest, strict=True)
        if line.kind in ("grown", "used") and most > 0 and abs(gap) >= _SHARE * most
    ]


def _more(line: Line, gap: float, above: str, below: str) -> str:
    """``0.56 EUR/m² more``."""
    return f"{_amount(abs(gap), line.unit, decimals_of(line))} {above if gap >= 0 else below}"


def _penalty(line: Line, gap: float) -> str:
    """What violations cost more or less, in money or points."""
    if line.unit == "-":
        return f"Its {in_sentence(line.title)} is {_more(line, gap, 'higher', 'lower')}"
    return f"Its {in_sentence(line.title)} cost {_more(line, gap, 'more', 'less')}"


def _when(period: int) -> str:
    return f"{'at' if period < 2 else 'on'} {PERIODS[period]}"


def paragraphs(story: Story) -> list[str]:
    """For each period that there was what the agent does differently in it, and what that earns."""
    profit, violations, score = (story.line(kind) for kind in ("profit", "violations", "score"))
    penalty, reward, texts = story.lines[violations], story.lines[score], []
    for period, gaps in enumerate(story.gaps()):
        if not story.times[period] > 0:
            continue
        levels = [
            f"{in_sentence(curve.title)} {number(here, places)} instead of {number(there, places)}\u00a0{unit_of(curve)}"
            for curve, here, there, places in _differing(story, period)
        ]
        amounts = _amount_words(story, gaps)
        money = [
            f"{in_sentence(line.title)} {number(worth, 2, signed=True)}"
            for line, worth in ((line, _worth(line, gaps[place])) for place, line in enumerate(story.lines))
            if line.kind in (_EARNED, _PAID) and abs(worth) >= _CENT
        ]
        of_which = f" ({', '.join(money)})" if money else ""
        when, what = capitalised(_when(period)), "; ".join(levels) or "climate and controls hardly differ"
        parts = [
            f"{when} ({story.times[period]:.0f} h a run): {what}.",
            f"{capitalised(', '.join(amounts))}." if amounts else "",
            f"Profit {_amount(gaps[profit], 'EUR m-2', 2, signed=True)}{of_which}; {in_sentence(_penalty(penalty, gaps[violations]))}; "
            f"{in_sentence(reward.title)} {_amount(gaps[score], reward.unit, decimals_of(reward), signed=True)}.",
        ]
        texts.append(" ".join(part for part in parts if part))
    return texts


def _worth(line: Line, gap: float) -> float:
    """What a difference adds to the profit."""
    return -gap if line.kind in (_PAID, "violations") else gap


def _differing(story: Story, period: int) -> list[tuple[Curve, float, float, int]]:
    """The levels that differ most in a period, where one can see it, in the order of the story, with both values and decimals."""
    most: dict[str, tuple[float, int, Curve, float, float, int]] = {}
    for place, curve in enumerate(story.levels):
        here, there = (float(value) for value in story.means[:, period, place])
        unit = unit_of(curve)
        share = abs(here - there) / _VISIBLE.get(unit, max(abs(here), abs(there), 1e-9) / 20)
        name = _ALIKE.get(curve.path, curve.path)
        if share >= 1 and (name not in most or most[name][0] < share):
            most[name] = (share, place, curve, here, there, _DECIMALS.get(unit, 1))
    largest = sorted(most.values(), key=lambda one: -one[0])[:_MOST_LEVELS]
    return [one[2:] for one in sorted(largest, key=lambda one: one[1])]


def text_of(story: Story) -> list[str]:
    """The story as paragraphs: which runs failed, headline, periods, and what to keep in mind."""
    return [*left_out_words(story), headline(story), *paragraphs(story), CAUTION]


def left_out_words(story: Story) -> list[str]:
    """Which runs failed and are left out, where any did."""
    if not story.failed:
        return []
    runs = len(story.seeds)
    rest = f"the {runs} runs that both ended" if runs > 1 else "the one run that both ended"
    return [f"{'; '.join(story.failed)}. What follows is about {rest}."]


CAUTION = (
    "The periods add up to the whole run. That is arithmetic and no cause: sugars of a bright day still grow fruit at night, "
    "and warmth of the morning spares heat later."
)


@dataclass(frozen=True)
class TableOf:
    """A table of the page: its caption, headings, and rows with their headings first; ``strong`` rows stand out."""

    caption: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    strong: tuple[str, ...] = ()


def ledger_table(story: Story) -> TableOf:
    """What the difference of each line is worth, by period and in the whole run."""
    gaps = story.gaps()
    kinds = (_EARNED, _PAID, "profit", "violations", "score")
    used = np.abs(story.sums).max(axis=(0, 1, 2)) > 1e-9
    lines = [(place, line) for place, line in enumerate(story.lines) if used[place] or line.kind in kinds[2:]]
    ordered = [(place, line) for kind in kinds for place, line in lines if line.kind == kind]
    rows = []
    for place, line in ordered:
        worth = [_worth(line, value) for value in (*gaps[:, place], gaps[:, place].sum())]
        unit = _pretty(line.unit)
        places = 2 if line.kind in (_EARNED, _PAID, "profit") else decimals_of(line)
        title = f"{line.title}{f', {unit}' if unit != 'EUR/m²' and unit else ''}"
        rows.append((title, *(number(value, places, signed=True) for value in worth)))
    strong = tuple(line.title for line in story.lines if line.kind in ("profit", "score"))
    one, other = story.agents
    runs = len(story.seeds)
    return TableOf(
        f"{one} minus {other}: what each line adds to profit or score, EUR/m² where no unit stands, mean over {runs} run{'s' * (runs > 1)}",
        ("", *map(capitalised, PERIODS), "Whole run"),
        tuple(rows),
        strong,
    )


def week_table(story: Story, side: int) -> TableOf:
    """One agent's accounts by week."""
    kinds = ("light", "grown", "used", "profit", "violations", "score")
    largest = np.abs(story.weeks).max(axis=(0, 1))
    used = [most >= 0.5 * 10 ** -decimals_of(line) for most, line in zip(largest, story.lines, strict=True)]
    ordered = [place for kind in kinds for place, line in enumerate(story.lines) if line.kind == kind and used[place]]
    units = [_pretty(line.unit) + (" a day" if line.kind == "light" else "") for line in story.lines]
    heads = [f"{story.lines[place].title}, {units[place]}".rstrip(", ") for place in ordered]
    rows = []
    for week, values in enumerate(story.weeks[side]):
        days = int(story.days[week])
        short = "" if days == story.days[0] else f" ({days} days)"
        rows.append((f"{week + 1}{short}", *(number(values[p], decimals_of(story.lines[p])) for p in ordered)))
    return TableOf(f"{story.agents[side]} by week", ("Week", *heads), tuple(rows))


def page_of(story: Story) -> str:
    """The page: words, the ledger by period, climate and controls by hour of the day, weeks. One file, without a script."""
    require("The page", "report", "jinja2")
    from glbench.report.page import asset, jinja_environment

    limits = dict(story.task.constraints.items())
    charts = [
        _chart(curve, story.hours[:, :, place], limits.get(curve.limits or ""))
        for place, curve in enumerate(story.levels)
        if np.nanmax(np.abs(story.hours[:, :, place])) > 0
    ]
    template = jinja_environment().from_string(asset("story.html.j2"))
    page: str = template.render(
        story=story,
        agents=story.agents,
        title=story.task.title,
        failed=left_out_words(story),
        headline=headline(story),
        paragraphs=paragraphs(story),
        caution=CAUTION,
        ledger=ledger_table(story),
        weeks=[week_table(story, side) for side in (0, 1)],
        charts=charts,
        meanings=[
            *((one.label, one.explanation) for one in catalogue(story.task).of_kind("score", "profit", "penalty")),
            *zip(map(capitalised, PERIODS), MEANINGS, strict=True),
        ],
        gas=f"{3.6 * KWH_A_CUBIC_METRE:.2f}",
        style=asset("style.css"),
        version=__version__,
    )
    return page


def _chart(curve: Curve, courses: Floats, limit: Any) -> dict[str, Any]:
    """One level by hour of the local day, of both agents, as what a drawing is made of."""
    numbers = courses[np.isfinite(courses)]
    low, high = float(numbers.min()), float(numbers.max())
    lines = [] if limit is None else [value for value in (limit.low, limit.high) if low - 1 <= value <= high + 1]
    # Three to six round numbers that enclose the range are its ticks.
    low, high = min([low, *lines]), max([high, *lines])
    span = max(high - low, 1e-6, 1e-3 * abs(high))
    power = 10.0 ** math.floor(math.log10(span / 3))
    step = next(factor * power for factor in (1, 2, 5, 10) if span / (factor * power) <= 4.5)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    ticks = [place * step for place in range(first, max(last, first + 1) + 1)]
    bottom, top = ticks[0], ticks[-1]
    places = max(0, -math.floor(math.log10(step) + 1e-9))

    def x(hour: float) -> float:
        return round(_LEFT + hour / 24 * (_WIDTH - _LEFT - _RIGHT), 1)

    def y(value: float) -> float:
        return round(_TOP + (top - value) / (top - bottom) * (_HEIGHT - _TOP - _BOTTOM), 1)

    return {
        "title": curve.title,
        "unit": unit_of(curve),
        "width": _WIDTH,
        "height": _HEIGHT,
        "left": _LEFT,
        "right": _WIDTH - _RIGHT,
        "floor": _HEIGHT - _BOTTOM,
        "top": _TOP,
        "ticks": [(y(value), number(value, places)) for value in ticks],
        "hours": [(x(hour), str(hour)) for hour in (0, 6, 12, 18, 24)],
        "limits": [y(value) for value in lines],
        "paths": [
            "M" + " L".join(f"{x(hour + 0.5)},{y(value)}" for hour, value in enumerate(course) if np.isfinite(value))
            for course in courses
        ],
        "says": "; ".join(
            f"{name} {number(float(np.nanmin(course)), places)} to {number(float(np.nanmax(course)), places)}"
            for name, course in zip(("first", "second"), courses, strict=True)
        ),
    }  # fmt: skip


def document_of(story: Story) -> dict[str, Any]:
    """The story as plain values, for other programs."""
    levels = [{"path": one.path, "title": one.title, "unit": unit_of(one)} for one in story.levels]
    gaps = story.gaps()
    return {
        "task": story.task.id,
        "agent": story.agents[0],
        "against": story.agents[1],
        "seeds": list(story.seeds),
        "left_out": list(story.left_out),
        "clock": story.clock,
        "words": text_of(story),
        "periods": [
            {
                "name": name,
                "meaning": MEANINGS[period],
                "hours": round(float(story.times[period]), 3),
                "difference": {line.name: float(gaps[period, place]) for place, line in enumerate(story.lines)},
                "levels": _both(story.means[:, period]),
            }
            for period, name in enumerate(PERIODS)
        ],
        "lines": [{"name": one.name, "title": one.title, "unit": one.unit, "kind": one.kind} for one in story.lines],
        "levels": levels,
        "by_hour": _both(story.hours),
    }


def _both(values: Floats) -> list[Any]:
    """Of both agents, with null for what is not known."""
    cells = values.astype(object)
    cells[~np.isfinite(values)] = None
    values_or_null: list[Any] = cells.tolist()
    return values_or_null
