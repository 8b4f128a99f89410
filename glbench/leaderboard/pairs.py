"""Two agents on one task, metric by metric, on the seeds that both were given; of several trainings of one recipe the mean, run by run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from glbench.errors import ResultError, refuse
from glbench.evaluation.records import RunResult
from glbench.leaderboard.catalogue import Catalogue, catalogue_of
from glbench.leaderboard.collect import years_of_runs
from glbench.leaderboard.entries import Entry, metric_of, resolution_of
from glbench.leaderboard.regret import METRICS, PARTS, best_known_of, regrets_of
from glbench.leaderboard.statistics import SIGNIFICANCE, Array, Interval, estimate_difference, paired_test, probability_of_improvement


@dataclass(frozen=True)
class MetricPair:
    """One metric of two agents: means, and the mean of A minus B with its 95 % interval, in the metric's unit.

    The interval is over pairs of runs, and over trainings where an agent has several. ``None`` if a result lacks the metric.
    """

    unit: str
    first: float | None
    second: float | None
    difference: Interval | None


@dataclass(frozen=True)
class Pair:
    """Two agents on one task.

    ``ranks_by`` is the metric that ranks on the task. ``p_value`` is that of the paired test of its mean; ``improvement`` the
    probability that A has a higher value than B in the same run; ``money`` what each item adds to A's EPI beside B's [EUR m-2].
    """

    task_id: str
    title: str
    first: str
    second: str
    trainings: tuple[int, int]
    """Of how many trainings each is the mean."""
    runs: int
    ranks_by: str
    by_year: Mapping[int, tuple[int, float]]
    """Number of pairs of runs and mean of A minus B in the ranking metric, by weather year; empty if only one year is known."""
    resolution: float
    """Difference of what ranks that rounding can make where the task draws nothing; 0 where none is known."""
    metrics: Mapping[str, MetricPair]
    """Those of this version in their order, then others that a result holds."""
    p_value: float
    improvement: Interval
    money: Mapping[str, float]
    words: Catalogue
    """What the task calls all of it."""
    regret: Mapping[str, MetricPair] = field(default_factory=dict)
    """Regret to the best known and its parts, see ``PARTS``; empty where no common run has a best known one."""
    regret_runs: int = 0
    """Common runs that have a best known one; regrets are over these."""

    def told_apart(self, corrected: float) -> bool:
        """Whether the means of the ranking metric differ beyond chance, by the p-value corrected for the number of tasks."""
        return corrected < SIGNIFICANCE

    @property
    def headline(self) -> float:
        """Mean of what ranks, of A minus that of B."""
        return self.gap(self.ranks_by) or 0.0

    @property
    def is_certain(self) -> bool:
        """Whether the difference is the same in every run."""
        difference = self.metrics[self.ranks_by].difference
        return difference is None or (self.runs > 1 and difference.low == difference.high)

    def gap(self, metric: str) -> float | None:
        """Mean of A minus B, where both hold the metric."""
        difference = self.metrics[metric].difference
        return None if difference is None else difference.value


def compare_entries(one: Entry, other: Entry) -> Pair:
    """Compare entries on their common seeds. Raises ``ResultError`` for different tasks, no such seed, or one without a reward."""
    first, second = one.first, other.first
    if first.task.digest != second.task.digest:
        msg = (
            f"'{one.name}' was evaluated on {first.task.id} (digest {first.task.digest[:12]}), '{other.name}' on "
            f"{second.task.id} (digest {second.task.digest[:12]}). Only results of one and the same task can be compared."
        )
        raise ResultError(msg)
    seeds = sorted(set(one.seeds) & set(other.seeds))
    if not seeds:
        msg = f"'{one.name}' and '{other.name}' have no seed in common on {first.task.id}. Evaluate both with the same seeds."
        raise ResultError(msg)
    if one.task_id != other.task_id:
        msg = (
            f"'{one.name}' was evaluated on {one.task_id}, '{other.name}' on {other.task_id}: one task, but not the same draws. "
            "Evaluate both on the same split and with the same salt."
        )
        raise ResultError(msg)
    task = one.task or other.task
    ranks_by = metric_of(first.task.id, {}, task)
    for entry in (one, other):
        if not entry.states(ranks_by):
            refuse(f"'{entry.name}' does not state its {ranks_by} on {first.task.id}, which is what agents are compared by.", ResultError)
    places = [[entry.seeds.index(seed) for seed in seeds] for entry in (one, other)]
    units = {**second.units, **first.units}
    words = catalogue_of(task, units)
    years = years_of_runs(one.trainings[0]) or ()
    metrics = {}
    for name in words.known_first([*first.runs[0].metrics, *second.runs[0].metrics]):
        ours, theirs = (
            entry.by_training(name)[:, place] if entry.states(name) else None for entry, place in zip((one, other), places, strict=True)
        )
        metrics[name] = _metric(words.metric(name, units).unit, ours, theirs, (one.is_fixed, other.is_fixed))
    runs = [entry.by_training(ranks_by)[:, place] for entry, place in zip((one, other), places, strict=True)]
    resolution = resolution_of(ranks_by, task, units)
    test = paired_test(runs[:1], runs[1:], (resolution,), fixed=(one.is_fixed, other.is_fixed))
    gaps_by_run, met = runs[0].mean(axis=0) - runs[1].mean(axis=0), [years[i] for i in places[0]] if years else []
    of_year = {year: gaps_by_run[[year == one for one in met]] for year in sorted(set(met))}
    gaps = {item.money: (metrics[item.money].difference, item.sign) for item in words.items}
    return Pair(
        task_id=one.task_id,
        title=first.task.title,
        first=one.name,
        second=other.name,
        trainings=(len(one.trainings), len(other.trainings)),
        runs=len(seeds),
        ranks_by=ranks_by,
        by_year={year: (gaps.size, float(gaps.mean())) for year, gaps in of_year.items()},
        resolution=resolution,
        metrics=metrics,
        p_value=test.p_value,
        improvement=probability_of_improvement({"": runs[0]}, {"": runs[1]}),
        words=words,
        regret=_regret(one, other, seeds),
        regret_runs=len(best.of(seeds)) if (best := best_known_of(first)) is not None else 0,
        money={name: sign * gap.value for name, (gap, sign) in gaps.items() if gap is not None},
    )


def _regret(one: Entry, other: Entry, seeds: list[int]) -> dict[str, MetricPair]:
    """Regrets of both, of what each states, in the common runs."""
    ours, theirs = (regrets_of([item.result for item in entry.trainings], seeds) for entry in (one, other))
    best = best_known_of(one.first)
    if ours is None or theirs is None or best is None:
        return {}
    return {
        part: _metric(best.units[METRICS[part]], getattr(ours, part), getattr(theirs, part), (one.is_fixed, other.is_fixed))
        for part in PARTS
    }


def failures(name: str, runs: Iterable[RunResult]) -> str:
    """How many of these runs of an agent failed, and how, as in ``2 of 3 runs of mine failed (crashed: 2)``; empty where none did."""
    states = Counter(run.status for run in runs)
    failed = {state: number for state, number in states.items() if state != "ok"}
    if not failed:
        return ""
    how = ", ".join(f"{state.replace('_', ' ')}: {number}" for state, number in failed.items())
    return f"{sum(failed.values())} of {states.total()} runs of {name} failed ({how})"


def _metric(unit: str, first: Array | None, second: Array | None, fixed: tuple[bool, bool]) -> MetricPair:
    ours, theirs = (None if values is None else float(values.mean()) for values in (first, second))
    if first is None or second is None:
        return MetricPair(unit, ours, theirs, None)
    return MetricPair(unit, ours, theirs, estimate_difference([first], [second], fixed=fixed).interval())
