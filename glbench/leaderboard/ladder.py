"""The information ladder of a task: what agents of one recipe earn that see more and more, and whether looking inside pays.

Means and differences have the intervals over scenarios and trainings of ``leaderboard.statistics``. The share of a lead is a ratio of two
differences of means; its interval has every share that the runs do not refute at 5 % (Fieller, 1954, J. R. Stat. Soc. B 16, 175-185).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Literal

import numpy as np
from pydantic import Field

from glbench.leaderboard.statistics import Array, FrozenModel, Interval, estimate_difference, estimate_mean
from glbench.quantities import pretty_unit

Kind = Literal["ppo", "mpc", "other"]
Answer = Literal["yes", "no", "not resolved"]
KINDS: tuple[Kind, ...] = ("ppo", "mpc")  # With a ladder of their own
HALF = 0.5
"""The share of a lead that a blind agent may keep."""
BLIND = ("clock", "outdoor", "blind", "mpc_clock", "mpc_outdoor", "mpc_blind")
"""Rungs that see nothing of what is inside the greenhouse."""
_LARGEST_SHARE = 100.0  # An end of an interval that is farther away does not exist
_BEFORE: Mapping[str, str] = {
    "outdoor": "clock", "blind": "outdoor", "two_sensors": "outdoor", "sensors": "two_sensors", "memory": "sensors",
    "no_forecast": "sensors", "mpc": "mpc_blind",
}  # fmt: skip


class Rung(FrozenModel):
    """An agent of the ladder and what it earned."""

    name: str
    kind: Kind
    columns: int | None = Field(description="observed columns in its view; null: what such agents see")
    seeds: tuple[int, ...] = Field(description="of its trainings; none if it is not trained")
    values: tuple[tuple[float, ...], ...] = Field(
        description="by training, of each run, in the order of the ladder's seeds, of which it may have the first only"
    )
    failed: int = Field(default=0, description="runs that failed; their missing steps count at the task's price")

    @property
    def matrix(self) -> Array:
        """Values ``(trainings, runs)``."""
        return np.array(self.values, np.float64)


class Share(FrozenModel):
    """A share of a lead with its 95 % interval; an end that is null does not exist."""

    value: float
    low: float | None
    high: float | None

    @property
    def words(self) -> str:
        """Such as ``0.59 (0.41 to 0.80)``."""
        low, high = ("unbounded" if end is None else f"{end:.2f}" for end in (self.low, self.high))
        return f"{self.value:.2f} ({low} to {high})"


class Row(FrozenModel):
    """What the table says of a rung: its mean, its lead, the share of the strongest's lead, the step from the rung ``before``."""

    name: str
    mean: Interval
    lead: Interval | None
    share: Share | None
    before: str | None
    step: Interval | None


class Verdict(FrozenModel):
    """Whether the task asks agents of a kind to look inside."""

    kind: Kind
    blind: str
    strongest: str
    share: Share | None = Field(description="of the strongest agent's lead that the blind one keeps; null: it has no lead")
    at_most_half: Answer
    gap: Interval | None = Field(description="what the rules earn more than the blind agent; null: there are no rules")
    below_rules: Answer


class Pair(FrozenModel):
    """What an agent earns more than one of another kind."""

    first: str
    second: str
    difference: Interval
    resolved: bool = Field(description="whether the interval is above 0")


class Separation(FrozenModel):
    """Whether agents of different kind separate: the rules, and the strongest agent of each other kind that looks inside."""

    pairs: tuple[Pair, ...] = Field(description="of all of them; the one with the higher mean is first, the widest pair last")
    separate: Answer = Field(description="whether the widest pair is resolved")


class Ladder(FrozenModel):
    """The ladder of a task in one of its splits."""

    schema_name: Literal["glbench/ladder"] = Field(default="glbench/ladder", alias="schema")
    schema_version: Literal[1] = 1
    task: str
    task_digest: str
    split: str
    seeds: tuple[int, ...] = Field(description="of the runs")
    metric: str
    unit: str
    digits: int = Field(description="decimals of the metric in tables")
    steps: int = Field(description="environment steps of each training")
    search_steps: int = Field(default=0, exclude_if=lambda steps: steps == 0, description="of the searches after each training")
    observed: int = Field(description="columns that the task shows")
    zero: str = Field(description="the agent over which leads are counted")
    rules: str = Field(description="the rules that blind agents are compared with")
    rungs: tuple[Rung, ...]
    rows: tuple[Row, ...]
    verdicts: tuple[Verdict, ...]
    separation: Separation | None = Field(description="null: fewer than two of rules, PPO and predictive control are there")

    @property
    def trained(self) -> str:
        """How long its policies were trained, such as ``trainings of 5,000,000 steps``."""
        return f"trainings of {self.steps:,} steps" + (f" and searches of {self.search_steps:,} steps" if self.search_steps else "")


def rows_of(rungs: Sequence[Rung], zero: str) -> tuple[Row, ...]:
    """The rows of the table, in the order of ``rungs``; leads are over the rung that ``zero`` names."""
    by_name = {rung.name: rung for rung in rungs}
    nothing = by_name.get(zero)

    def row(rung: Rung) -> Row:
        before, leader = _before(rung.name, by_name), None if rung.kind == "other" else strongest_of(rung.kind, rungs)
        return Row(
            name=rung.name, mean=estimate_mean([rung.matrix]).interval(), lead=None if rung is nothing else _difference(rung, nothing),
            share=None if rung is leader else share_of(rung, leader, nothing), before=None if before is None else before.name,
            step=_difference(rung, before),
        )  # fmt: skip

    return tuple(map(row, rungs))


def verdicts_of(rungs: Sequence[Rung], rules: str, zero: str) -> tuple[Verdict, ...]:
    """The verdict on every kind that has a blind agent and another one; ``rules`` names what is to earn more, leads are over ``zero``."""
    by_name, verdicts = {rung.name: rung for rung in rungs}, []
    for kind in KINDS:
        blind, strongest = strongest_of(kind, rungs, blind=True), strongest_of(kind, rungs)
        if blind is None or strongest is None:
            continue
        share, ruled = share_of(blind, strongest, by_name.get(zero)), by_name.get(rules)
        gap = None if ruled is None else _difference(ruled, blind)
        most, least = (None, None) if share is None else (share.high, share.low)
        half = _is_positive(*(None if end is None else HALF - end for end in (most, least)))
        below = _is_positive(*((None, None) if gap is None else (gap.low, gap.high)))
        names = {"blind": blind.name, "strongest": strongest.name}
        verdicts.append(Verdict(kind=kind, **names, share=share, at_most_half=half, gap=gap, below_rules=below))
    return tuple(verdicts)


def separation_of(rungs: Sequence[Rung], rules: str) -> Separation | None:
    """Whether agents of different kind separate; ``rules`` names the rules. ``None`` with agents of fewer than two kinds."""
    strongest = [*(strongest_of(kind, rungs) for kind in KINDS), *(rung for rung in rungs if rung.name == rules)]
    compared = list({rung.name: rung for rung in strongest if rung is not None}.values())
    pairs = []
    for first, second in combinations(compared, 2):
        difference = _difference(first, second)
        assert difference is not None
        if difference.value < 0.0:
            first, second, difference = second, first, _difference(second, first)
            assert difference is not None
        pairs.append(Pair(first=first.name, second=second.name, difference=difference, resolved=difference.low > 0.0))
    pairs.sort(key=lambda pair: pair.difference.value)
    return Separation(pairs=tuple(pairs), separate="yes" if pairs[-1].resolved else "not resolved") if pairs else None


def strongest_of(kind: Kind, rungs: Sequence[Rung], *, blind: bool = False) -> Rung | None:
    """The rung of a kind with the highest mean, among those that look inside, or the ``blind`` ones; ``None`` without any."""
    candidates = [rung for rung in rungs if rung.kind == kind and (rung.name in BLIND) == blind]
    return max(candidates, key=lambda rung: rung.matrix.mean(), default=None)


def share_of(rung: Rung, strongest: Rung | None, zero: Rung | None) -> Share | None:
    """The share of the lead of ``strongest`` over ``zero`` that ``rung`` has; ``None`` if ``strongest`` does not lead, or is missing."""
    if strongest is None or zero is None:
        return None
    own, best, nothing = _matrices(rung, strongest, zero)
    lead, whole = own - nothing.mean(axis=0), best - nothing.mean(axis=0)
    if not whole.mean() > 0.0:
        return None
    value, fixed = float(lead.mean() / whole.mean()), (not rung.seeds, not strongest.seeds)

    def is_possible(share: float) -> bool:
        interval = estimate_difference([lead], [share * whole], fixed=fixed).interval()
        return interval.low <= 0.0 <= interval.high

    def end(sign: float) -> float | None:
        inside, outside = 0.0, 1.0 / 64.0
        while is_possible(value + sign * outside):
            if outside > _LARGEST_SHARE:
                return None
            inside, outside = outside, 2.0 * outside
        for _ in range(30):
            middle = 0.5 * (inside + outside)
            inside, outside = (middle, outside) if is_possible(value + sign * middle) else (inside, middle)
        return value + sign * inside

    return Share(value=value, low=end(-1.0), high=end(1.0))


def table_cells(ladder: Ladder) -> list[list[str]]:
    """Headings and rows of the table in words, for a terminal or a page."""
    rungs, unit = {rung.name: rung for rung in ladder.rungs}, pretty_unit(ladder.unit) or "-"
    table = [["Rung", "Columns", "Trainings", f"Mean [{unit}]", f"Lead [{unit}]", "Share", f"Step [{unit}]"]]
    for row in ladder.rows:
        rung, step = rungs[row.name], "–"
        if row.step is not None:
            is_open = row.step.low <= 0.0 <= row.step.high
            step = f"{_open(row.step, ladder) if is_open else _words(row.step, ladder)} from {row.before}"
        sees = "–" if rung.columns is None else f"{rung.columns} of {ladder.observed}"
        lead = "–" if row.lead is None else _words(row.lead, ladder)
        share = "–" if row.share is None else row.share.words
        table.append(
            [row.name + ("*" if rung.failed else ""), sees, str(len(rung.seeds) or "–"), _words(row.mean, ladder), lead, share, step]
        )
    return table


def table_notes(ladder: Ladder) -> str:
    """What has to be known to read the table."""
    fewer = [
        f" {rung.name} played the first {rung.matrix.shape[1]} runs only, and others are compared with it in those runs."
        for rung in ladder.rungs
        if rung.matrix.shape[1] < len(ladder.seeds)
    ]
    failed = [f"{rung.failed} of {rung.name}" for rung in ladder.rungs if rung.failed]
    marked = f" * Runs failed ({', '.join(failed)}); their missing steps count at the task's price." if failed else ""
    return f"Leads are over {ladder.zero}. Intervals are those of 95 %, over scenarios and trainings.{''.join(fewer)}{marked}"


def verdict_lines(ladder: Ladder) -> list[str]:
    """The verdicts on all kinds, what agents of different kind earn more than each other, and whether they separate."""
    lines, separation = [verdict_words(verdict, ladder) for verdict in ladder.verdicts], ladder.separation
    if separation is None:
        return lines
    unit = f" {pretty_unit(ladder.unit)}".rstrip()
    for pair in separation.pairs:
        is_resolved = "resolved" if pair.resolved else _open(pair.difference, ladder, unit)
        lines.append(f"{pair.first} earns {_words(pair.difference, ladder)}{unit} more than {pair.second}: {is_resolved}.")
    return [*lines, f"Agents of different kind separate ({pair.first} from {pair.second}): {separation.separate}."]


def verdict_words(verdict: Verdict, ladder: Ladder) -> str:
    """A verdict in two sentences."""
    share = "no share" if verdict.share is None else verdict.share.words
    words = f"{verdict.kind}: {verdict.blind} keeps {share} of the lead of {verdict.strongest}; at most half: {verdict.at_most_half}."
    if verdict.gap is None:
        return words
    gap = f"{ladder.rules} earns {_words(verdict.gap, ladder)}{f' {pretty_unit(ladder.unit)}'.rstrip()} more than {verdict.blind}"
    return f"{words} {gap}; blind below rules: {verdict.below_rules}."


def _words(interval: Interval, ladder: Ladder) -> str:
    value, low, high = (f"{number:,.{ladder.digits}f}" for number in (interval.value, interval.low, interval.high))
    return f"{value} ({low} to {high})"


def _open(interval: Interval, ladder: Ladder, unit: str = "") -> str:
    return f"not resolved (below {max(0.0, -interval.low, interval.high):,.{ladder.digits}f}{unit})"


def _before(name: str, rungs: Mapping[str, Rung]) -> Rung | None:
    """The rung that a rung is compared with: the nearest below it that is there."""
    while name := _BEFORE.get(name, "sensors" if name.startswith("without_") else ""):
        if name in rungs:
            return rungs[name]
    return None


def _difference(first: Rung, second: Rung | None) -> Interval | None:
    if second is None:
        return None
    one, other = _matrices(first, second)
    return estimate_difference([one], [other], fixed=(not first.seeds, not second.seeds)).interval()


def _matrices(*rungs: Rung) -> list[Array]:
    """Values ``(trainings, runs)`` of each, of the runs that all of them have."""
    runs = min((rung.matrix.shape[1] for rung in rungs), default=0)
    return [rung.matrix[:, :runs] for rung in rungs]


def _is_positive(low: float | None, high: float | None) -> Answer:
    """Whether a number with this interval is above 0; an end that is ``None`` does not exist."""
    if low is not None and low > 0.0:
        return "yes"
    return "no" if high is not None and high < 0.0 else "not resolved"
