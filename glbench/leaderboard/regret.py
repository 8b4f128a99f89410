"""Regret: how far a run stays below the best known run of its scenario, and whether it gives away profit or breaks limits.

The best known run of a seed is the one with the highest reward among the released results that act through the task's actuation
(``tasks/best_known``). It knows the future, or had luck with it, so an agent that sees observations is not expected to reach it; and it is
no bound: who does better in some run has a negative regret there. Where only the first runs of a task have plans, only these have best
known runs, and regrets are over them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from pydantic import Field

from glbench.errors import SubmissionError
from glbench.evaluation import Result
from glbench.evaluation.records import RANKING_METRIC, AgentRecord, RunResult
from glbench.leaderboard.collect import Expectation, StoredResult
from glbench.leaderboard.statistics import Array, Estimate, FrozenModel, estimate_over_trainings
from glbench.tasks.references import BestKnown, KnownRun, read_best_known

PROFIT, PENALTY = "epi", "penalty"
PARTS = ("total", "profit", "violations")  # Regret, and what it is made of
METRICS = {"total": RANKING_METRIC, "profit": PROFIT, "violations": PENALTY}
"""The metric that each is a difference of."""
LINES = {"total": "Regret to best known", "profit": "  profit given away", "violations": "  violations added"}
"""Their rows in tables of metrics."""
ROUNDING = 1e-6  # A run that is above the best known one by less, in the unit of the reward, is not called better


@dataclass(frozen=True)
class Regrets:
    """Regrets of ``n`` runs, each ``(trainings, n)``: in the reward, and its parts; a part that a result does not state is ``None``.

    ``profit`` is what less was earned [EUR m-2], ``violations`` what is more in the penalty, in its unit. Where the reward is the profit
    minus the penalty, the parts add up to ``total``.
    """

    total: Array
    profit: Array | None
    violations: Array | None


class Regret(FrozenModel):
    """How far an entry stays below the best known runs: means over runs, paired by seed. Negative where it is better."""

    unit: str = Field(description="unit of the regret and of its part from violations; '-' for none")
    total: Estimate = Field(description="reward of the best known run minus that of the run")
    profit: Estimate | None = Field(description="profit that is given away [EUR m-2]: EPI of the best known run minus its own")
    violations: Estimate | None = Field(description="its penalty minus that of the best known run")
    runs: int = Field(description="runs that have a best known run: fewer than the result has where plans of the first runs only are known")
    runs_ahead: int = Field(description="runs with a higher reward than the best known run; of several trainings of all of them")


class BestKnownMeans(FrozenModel):
    """What regrets of a task are measured by: means over the best known runs, in the units of the metrics."""

    agent: str = Field(description="whose they are; 'several' where they are not all of one agent")
    runs: int = Field(description="how many: all of the task, or its first ones")
    reward: float
    epi: float
    penalty: float


def best_known_of(result: Result) -> BestKnown | None:
    """The best known runs of the task of ``result``; ``None`` for other splits, secret salts and custom tasks."""
    task = result.task
    if task.split not in (None, "test") or task.salt_commitment is not None:
        return None
    best = read_best_known(task.id)
    return best if best is not None and best.task_digest == task.digest else None


def best_known_means(result: Result) -> BestKnownMeans | None:
    """Means over all best known runs of the task of ``result``."""
    best = best_known_of(result)
    if best is None:
        return None
    means = {name: float(np.mean([getattr(run, name) for run in best.runs])) for name in (RANKING_METRIC, PROFIT, PENALTY)}
    return BestKnownMeans(agent=best.agent, runs=len(best.runs), **means)


def regrets_of(trainings: Sequence[Result], seeds: Sequence[int] | None = None) -> Regrets | None:
    """Regrets of the runs of trainings that met the same runs, or of those with ``seeds``: of those that have a best known run.

    ``None`` where none has.
    """
    first = trainings[0]
    best_known = best_known_of(first)
    best = best_known.of(first.evaluation.seeds if seeds is None else seeds) if best_known is not None else ()
    if not best:
        return None
    places = [first.evaluation.seeds.index(run.seed) for run in best]
    gaps: list[Array | None] = []  # the best known minus the runs ``(trainings, n)``
    for name in (RANKING_METRIC, PROFIT, PENALTY):
        complete = all(name in run.metrics for one in trainings for run in one.runs)
        values = np.array([one.values(name) for one in trainings])[:, places] if complete else None
        gaps.append(None if values is None else np.array([getattr(run, name) for run in best]) - values)
    total, profit, penalty = gaps
    assert total is not None  # every result has a reward
    return Regrets(total, profit, None if penalty is None else -penalty)


def regret_of(trainings: Sequence[Result]) -> Regret | None:
    """Mean regret with its interval, over the runs of one result, or over trainings with the lowest and the highest of them.

    ``None`` where no run has a best known run.
    """
    regrets, best = regrets_of(trainings), best_known_of(trainings[0])
    if regrets is None or best is None:
        return None
    return Regret(
        unit=best.units["reward"],
        total=estimate_over_trainings(regrets.total),
        profit=None if regrets.profit is None else estimate_over_trainings(regrets.profit),
        violations=None if regrets.violations is None else estimate_over_trainings(regrets.violations),
        runs=regrets.total.shape[1],
        runs_ahead=int((regrets.total < -ROUNDING).sum()),
    )


def can_be_best_known(agent: AgentRecord) -> bool:
    """Whether what the agent did could be done through the task's actuation: not where it set the controls directly.

    Agents that see observations act through it; of the privileged ones only those controllers of glbench that know the scenario do.
    """
    return not agent.privileged or (agent.kind == "baseline" and _acts_through_actuation(agent.name))


@lru_cache(maxsize=64)
def _acts_through_actuation(name: str) -> bool:
    from glbench.agents.baselines import shipped_sight

    try:
        return shipped_sight(name) != "state"
    except SubmissionError:
        return False


def best_runs(stored: Iterable[StoredResult], expected: Mapping[str, Expectation]) -> dict[str, list[tuple[Result, RunResult]]]:
    """The best run of every seed of the published tasks in complete results, with the result it is of, in the metric that ranks."""
    best = {}
    for task_id, results in _candidates(stored, expected).items():
        complete = [one for one in results if one.evaluation.seeds == expected[task_id].seeds]
        if complete:
            best[task_id] = _best_of_each_seed(complete, len(expected[task_id].seeds), expected[task_id].metric)
    return best


def _candidates(stored: Iterable[StoredResult], expected: Mapping[str, Expectation]) -> dict[str, list[Result]]:
    """Results of tasks as they are published, of all their runs or the first ones, by agents that act through the actuation."""
    by_task: dict[str, list[Result]] = {}
    for item in stored:
        result, expectation = item.result, expected.get(item.board)
        if expectation is None or result.task.digest != expectation.digest:
            continue
        first_runs = result.evaluation.seeds == expectation.seeds[: len(result.runs)]
        if first_runs and can_be_best_known(result.agent) and all(expectation.metric in run.metrics for run in result.runs):
            by_task.setdefault(item.board, []).append(result)
    return by_task


def _best_of_each_seed(results: Sequence[Result], runs: int, metric: str) -> list[tuple[Result, RunResult]]:
    """The best result of each of the first ``runs``, among those that have them all; empty if none has. Of equals, the last name's."""

    def place(pair: tuple[Result, RunResult]) -> tuple[float, str]:
        return pair[1].metrics[metric], pair[0].agent.name

    having = [one for one in results if len(one.runs) >= runs]
    return [max(((one, one.runs[index]) for one in having), key=place) for index in range(runs)] if having else []


def best_known_from(stored: Iterable[StoredResult], expected: Mapping[str, Expectation]) -> dict[str, BestKnown]:
    """The best known runs of every published task that is ranked by its reward, from results.

    If only the first runs have plans, only these get a best known run: what other agents did in the rest is no yardstick beside plans.
    """
    of_tasks = {}
    for task_id, results in _candidates(stored, expected).items():
        planned = max((len(one.runs) for one in results if one.agent.privileged), default=len(expected[task_id].seeds))
        best = _best_of_each_seed(results, planned, expected[task_id].metric)
        complete = bool(best) and all({PROFIT, PENALTY} <= run.metrics.keys() for _, run in best)
        if expected[task_id].metric != RANKING_METRIC or not complete:
            continue
        owners = {one.agent.name: one.results_digest for one, _ in best}
        of_tasks[task_id] = BestKnown(
            task=task_id,
            task_digest=expected[task_id].digest,
            units={name: best[0][0].units[name] for name in (RANKING_METRIC, PROFIT, PENALTY)},
            agents=dict(sorted(owners.items())),
            runs=tuple(
                KnownRun(
                    seed=run.seed, agent=one.agent.name, reward=run.metrics[RANKING_METRIC],
                    epi=run.metrics[PROFIT], penalty=run.metrics[PENALTY],
                )
                for one, run in best
            ),
        )  # fmt: skip
    return of_tasks
