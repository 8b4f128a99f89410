"""What plans earn when replayed in the ordinary simulation, all in one batch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from glbench.env import Simulation
from glbench.errors import EpisodeError

if TYPE_CHECKING:
    from glbench.agents.plans import PlanBook
    from glbench.tasks import TaskSpec


class Earned(NamedTuple):
    """Sums over a run, as in an evaluation; ``epi`` is the profit [EUR m-2], ``penalty`` the penalty for violations."""

    reward: float
    epi: float
    penalty: float


def replayed(task: TaskSpec, book: PlanBook, seeds: Sequence[int]) -> dict[int, Earned]:
    """What the plans of ``book`` earn in the runs of ``task`` with ``seeds``, with the same bits as an evaluation.

    Raises
    ------
    EpisodeError
        When a step of a plan cannot be simulated.
    """
    simulation = Simulation(task, len(seeds))
    simulation.reset(list(seeds))
    actions = np.stack([book.plan(seed) for seed in seeds], axis=1)
    sums = np.zeros((len(Earned._fields), len(seeds)))
    for step, action in enumerate(actions):
        outcome = simulation.step(action)
        if outcome.failed:
            first = outcome.failed[0]
            msg = f"Step {step + 1} of the plan for the seed {seeds[first.row]} cannot be simulated: {first.reason}."
            raise EpisodeError(msg)
        sums += [outcome.quantities[name] for name in Earned._fields]
    return {seed: Earned(*column) for seed, column in zip(seeds, sums.T.tolist(), strict=True)}
