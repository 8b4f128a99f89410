"""What a run paid for energy and CO2, and what it could have paid: with all of its equipment, and without the buffer or the engine."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from glbench.bounds.commitment import commit
from glbench.bounds.dispatch import MJ_PER_KWH, EnergyDemand, cost, dispatch, equipment_of
from glbench.episodes import replayed_episodes
from glbench.episodes.recorder import LARGEST_TRACE, bytes_a_step
from glbench.errors import GlbenchError, refuse
from glbench.evaluation.files import load_result
from glbench.evaluation.saving import recorded_actions, task_of_result
from glbench.model.equipment import Equipment
from glbench.tasks import Round, TaskSpec


@dataclass(frozen=True)
class Costs:
    """What a run paid for energy and CO2, and what it could have paid for the same heat, light and CO2 [EUR m-2].

    ``None`` where the equipment that is left could not have given it.
    """

    run: float
    """As the run did it."""
    least: float | None
    """At least, with all that there is."""
    blind: float | None
    """Planned for prices that stay at their mean, and paid at those that came."""
    without_buffer: float | None
    without_engine: float | None
    boiler_alone: float | None
    ruled: float | None = None
    """With all that there is, run as the task lets it run: the cheapest way found. ``None`` also where the task switches no engine."""

    @property
    def buffer_earns(self) -> float | None:
        """What the buffer earns at best."""
        return _gap(self.without_buffer, self.least)

    @property
    def engine_earns(self) -> float | None:
        """What the engine earns at best."""
        return _gap(self.without_engine, self.least)

    @property
    def looking_earns(self) -> float | None:
        """What it earns to know how prices change."""
        return _gap(self.blind, self.least)

    @property
    def left(self) -> float | None:
        """What the run left: no control of the equipment could have saved more."""
        return _gap(self.run, self.least)


def _gap(more: float | None, less: float | None) -> float | None:
    return None if more is None or less is None else more - less


def costs(equipment: Equipment, demand: EnergyDemand, buffer: float | None = None, task: TaskSpec | None = None) -> Costs:
    """All costs of a run; ``buffer``: with one of another size [MJ m-2] in place of its own, but for ``run``; ``ruled`` needs its task."""
    other = equipment if buffer is None else replace(equipment, buffer=buffer)

    def least(one: Equipment) -> float | None:
        optimum = dispatch(one, demand)
        return None if optimum is None else optimum.cost(demand.prices)

    planned = dispatch(other, demand.flat())
    way = commit(other, demand, task) if task is not None else None
    return Costs(
        run=cost(demand.flows, demand.prices) + demand.worth(equipment) * (demand.start - demand.end) / MJ_PER_KWH,
        least=least(other),
        blind=None if planned is None else planned.cost(demand.prices),
        without_buffer=least(replace(other, buffer=0.0)),
        without_engine=least(replace(other, engine=0.0)),
        boiler_alone=least(replace(other, engine=0.0, buffer=0.0)),
        ruled=None if way is None else way.cost(demand.prices),
    )


def costs_of_result(
    result: Path, seeds: Sequence[int] = (), buffer: float | None = None, sealed: Round | None = None
) -> Iterator[tuple[int, Costs]]:
    """Seed and costs of runs of a stored result, one after the other, from its recorded actions. Failed runs are left out.

    ``result`` is a result file with its recorded actions beside it, ``sealed`` the round that it belongs to, if any. ``seeds`` are those of
    the runs; all if none are given. ``buffer`` is as for :func:`costs`. Raises ``GlbenchError`` when the task has no energy system, no run
    has one of the seeds, or all of them failed, and ``EpisodeError`` when the recorded actions are missing, damaged, or of another result.
    """
    loaded = load_result(result)
    task, log = task_of_result(loaded, result, sealed), recorded_actions(loaded, result)
    equipment = equipment_of(task)
    unknown = set(seeds) - set(log.seeds)
    if unknown:
        refuse(f"{result} has no run with seed {min(unknown)}. Its seeds: {', '.join(map(str, log.seeds))}.", GlbenchError)
    rows = [row for row, run in enumerate(log.runs) if run.status == "ok" and (not seeds or run.seed in seeds)]
    if not rows:
        refuse(f"All of these runs of {result} failed: there is no whole run to dispatch.", GlbenchError)
    together = max(1, LARGEST_TRACE // (task.steps * bytes_a_step(task)))
    for first in range(0, len(rows), together):
        for episode in replayed_episodes(task, log, rows[first : first + together]):
            yield episode.run.seed, costs(equipment, EnergyDemand.of(episode, task), buffer, task)


def mean_costs(every: Sequence[Costs]) -> Costs:
    """Means over runs; ``None`` where one of them has no cost."""
    means = {}
    for field in fields(Costs):
        values = [getattr(one, field.name) for one in every]
        means[field.name] = None if None in values else float(np.mean(values))
    return Costs(**means)  # type: ignore[arg-type]  # the run itself always has a cost
