"""Two agents on one task, metric by metric, on the seeds that both were given.

Of several trainings of one recipe the mean over them counts, run by run.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from glbench.errors import ResultError
from glbench.evaluation.metrics import METRIC_NAMES
from glbench.leaderboard.aggregates import Interval, probability_of_improvement
from glbench.leaderboard.comparisons import holm, paired_test, told_apart
from glbench.leaderboard.entries import Entry
from glbench.leaderboard.statistics import bootstrap_interval

MONEY = {"revenue": 1.0, "cost_heat": -1.0, "cost_electricity": -1.0, "cost_co2": -1.0}
"""What the EPI is made of, and whether it adds or takes."""


@dataclass(frozen=True)
class MetricPair:
    """One metric of two agents: means, and the mean of A minus B with its 95 % interval over pairs of runs, in the metric's unit."""

    metric: str
    first: float
    second: float
    difference: Interval


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
    p_value: float
    favours: int
    """Whom the ranks of the paired test favour: 1 the first, -1 the second, 0 neither."""
    improvement: Interval
    money: Mapping[str, float]

    def told_apart(self, corrected: float) -> bool:
        """Whether the rewards differ beyond chance, at the p-value corrected for the number of tasks."""
        return told_apart(corrected, self.favours, self.metrics["reward"].difference.value)


def compare_entries(one: Entry, other: Entry) -> Pair:
    """Compare two entries of one task on their common seeds.

    Raises
    ------
    ResultError
        When they are of different tasks, or have no seed in common.
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
    places = [[entry.seeds.index(seed) for seed in seeds] for entry in (one, other)]
    values = [
        {name: entry.values(name)[place] for name in METRIC_NAMES}
        for entry, place in zip((one, other), places, strict=True)
    ]
    metrics = {name: _metric(name, values[0][name], values[1][name]) for name in METRIC_NAMES}
    rewards = values[0]["reward"], values[1]["reward"]
    runs = [entry.by_training("reward")[:, place].ravel() for entry, place in zip((one, other), places, strict=True)]
    test = paired_test([rewards[0]], [rewards[1]])
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
        improvement=probability_of_improvement({"": runs[0]}, {"": runs[1]}),
        money={name: sign * metrics[name].difference.value for name, sign in MONEY.items()},
    )


def corrected_p_values(pairs: list[Pair]) -> list[float]:
    """P-values of several tasks, corrected for their number (Holm)."""
    return holm([pair.p_value for pair in pairs])


def _metric(name: str, first: np.ndarray, second: np.ndarray) -> MetricPair:
    difference = first - second
    low, high = bootstrap_interval(difference)
    return MetricPair(name, float(first.mean()), float(second.mean()), Interval(float(difference.mean()), low, high))
