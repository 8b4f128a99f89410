"""Two agents on one task, metric by metric, on the seeds that both were given.

Of several trainings of one recipe the mean over them counts, run by run.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from glbench.errors import ResultError
from glbench.evaluation.records import RANKING_METRIC
from glbench.leaderboard.catalogue import Catalogue, catalogue
from glbench.leaderboard.comparisons import holm, paired_test, told_apart
from glbench.leaderboard.entries import Entry
from glbench.leaderboard.statistics import Array, Interval, bootstrap_interval, probability_of_improvement


@dataclass(frozen=True)
class MetricPair:
    """One metric of two agents: means, and the mean of A minus B with its 95 % interval over pairs of runs, in the metric's unit.

    What a result does not hold is ``None``.
    """

    unit: str
    first: float | None
    second: float | None
    difference: Interval | None


@dataclass(frozen=True)
class Pair:
    """Two agents on one task.

    ``p_value`` is that of the paired test of the rewards; ``improvement`` the probability that a run of A has a higher reward than a
    run of B; ``money`` what each item adds to A's EPI beside B's [EUR m-2].
    """

    task_id: str
    title: str
    first: str
    second: str
    trainings: tuple[int, int]
    """Of how many trainings each is the mean."""
    runs: int
    metrics: Mapping[str, MetricPair]
    """Those of this version in their order, then others that a result holds."""
    p_value: float
    favours: int
    """Whom the ranks of the paired test favour: 1 the first, -1 the second, 0 neither."""
    improvement: Interval
    money: Mapping[str, float]
    words: Catalogue
    """What the task calls all of it."""

    def told_apart(self, corrected: float) -> bool:
        """Whether the rewards differ beyond chance, at the p-value corrected for the number of tasks."""
        return told_apart(corrected, self.favours, self.headline)

    @property
    def headline(self) -> float:
        """Mean reward of A minus that of B."""
        return self.gap(RANKING_METRIC) or 0.0

    @property
    def is_certain(self) -> bool:
        """Whether all runs differ alike, because the task draws nothing."""
        difference = self.metrics[RANKING_METRIC].difference
        return difference is None or difference.low == difference.high

    def gap(self, metric: str) -> float | None:
        """Mean of A minus B, where both hold the metric."""
        difference = self.metrics[metric].difference
        return None if difference is None else difference.value


def compare_entries(one: Entry, other: Entry) -> Pair:
    """Compare two entries of one task on their common seeds.

    Raises
    ------
    ResultError
        When they are of different tasks, have no seed in common, or one of them holds no reward.
    """
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
    for entry in (one, other):
        if not entry.states(RANKING_METRIC):
            msg = f"'{entry.name}' does not state its {RANKING_METRIC} on {first.task.id}, which is what agents are compared by."
            raise ResultError(msg)
    words = catalogue(one.task or other.task)
    places = [[entry.seeds.index(seed) for seed in seeds] for entry in (one, other)]
    units = {**second.units, **first.units}
    metrics = {
        name: _metric(
            words.metric(name, units).unit,
            *(_values(entry, name, place) for entry, place in zip((one, other), places, strict=True)),
        )
        for name in words.known_first([*first.runs[0].metrics, *second.runs[0].metrics])
    }
    runs = [entry.by_training(RANKING_METRIC)[:, place] for entry, place in zip((one, other), places, strict=True)]
    test = paired_test(*([values.mean(axis=0)] for values in runs))
    gaps = {item.money: (metrics[item.money].difference, item.sign) for item in words.items}
    return Pair(
        task_id=first.task.id,
        title=first.task.title,
        first=one.name,
        second=other.name,
        trainings=(len(one.trainings), len(other.trainings)),
        runs=len(seeds),
        metrics=metrics,
        p_value=test.p_value,
        favours=test.favours,
        improvement=probability_of_improvement({"": runs[0].ravel()}, {"": runs[1].ravel()}),
        words=words,
        money={name: sign * gap.value for name, (gap, sign) in gaps.items() if gap is not None},
    )


def corrected_p_values(pairs: list[Pair]) -> list[float]:
    """P-values of several tasks, corrected for their number (Holm)."""
    return holm([pair.p_value for pair in pairs])


def _values(entry: Entry, metric: str, place: list[int]) -> Array | None:
    return entry.values(metric)[place] if entry.states(metric) else None


def _metric(unit: str, first: Array | None, second: Array | None) -> MetricPair:
    ours, theirs = (None if values is None else float(values.mean()) for values in (first, second))
    if first is None or second is None:
        return MetricPair(unit, ours, theirs, None)
    low, high = bootstrap_interval(first - second)
    difference = Interval(value=float((first - second).mean()), low=low, high=high)
    return MetricPair(unit, ours, theirs, difference)
