"""The evolution strategy of the searches, and what is kept of one so that it can go on.

CMA-ES (Hansen 2016, arXiv:1604.00772; package ``cmaes``) asks for numbers, gets their rewards, and asks again. The rewards so far
are all it takes to go on: asked again from the beginning, the strategy says the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from cmaes import CMA

from glbench.arrays import Floats
from glbench.training.card import training_table
from glbench.training.folder import SEARCH
from glbench.training.session import Arrays, Session

HANSEN = "Hansen (2016). The CMA evolution strategy: a tutorial. arXiv:1604.00772"


class Search(Session):
    """A search under way: generations of candidates, each rewarded with seasons of the tasks. ``begin`` makes its strategy."""

    what, state = "search", SEARCH

    def begin(self, mean: Floats, bounds: Floats | None = None) -> None:
        """Take ``mean`` ``(numbers,)`` for the middle of the first generation; ``bounds`` ``(numbers, 2)`` are the lowest and highest."""
        s = self.settings
        self._cma = CMA(mean=mean, sigma=s.sigma, population_size=s.population, seed=self.seed, bounds=bounds)
        self.rewards: list[Floats] = []
        """Of each generation so far, ``(population,)``."""

    @property
    def mean(self) -> Floats:
        """Middle of the next generation, ``(numbers,)``."""
        mean: Floats = self._cma.mean
        return mean

    @property
    def generations(self) -> int:
        """Generations so far."""
        return len(self.rewards)

    @property
    def steps_a_generation(self) -> int:
        """Environment steps of a generation."""
        return int(self.settings.population) * sum(task.steps for task in self.tasks)

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        return self.generations * self.steps_a_generation

    def ask(self) -> list[Floats]:
        """The candidates of the next generation."""
        return [self._cma.ask() for _ in range(self.settings.population)]

    def tell(self, candidates: Sequence[Floats], rewards: Floats) -> None:
        """The rewards ``(population,)`` of the candidates that were asked."""
        self._cma.tell([(numbers, -float(reward)) for numbers, reward in zip(candidates, rewards, strict=True)])
        self.rewards.append(rewards)

    def arrays(self) -> Arrays:
        """The rewards so far, ``(generations, population)``."""
        return {"rewards": np.array(self.rewards).reshape(self.generations, self.settings.population)}

    def restore(self, arrays: Arrays, facts: Mapping[str, Any]) -> None:
        """Ask again from the beginning, and tell the rewards."""
        for rewards in arrays["rewards"]:
            self.tell(self.ask(), rewards)

    def table(self) -> dict[str, Any]:
        """The card's table of the training."""
        table = training_table("CMA-ES", self.settings, self.identity["settings_digest"], self.seed, self.steps)
        return {**table, "generations": self.generations, "population": self.settings.population}
