"""The evolution strategy of the searches, and what is kept of one so that it can go on.

CMA-ES (Hansen 2016, arXiv:1604.00772; package ``cmaes``) asks for numbers, gets their rewards, and asks again. The rewards so far
are all it takes to go on: asked again from the beginning, the strategy says the same.
"""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from cmaes import CMA
from numpy.typing import NDArray

from glbench.errors import TrainingError
from glbench.resources import write_atomically
from glbench.training.folder import DAMAGED, altered
from glbench.training.periodic_evaluation import History

Floats = NDArray[np.float64]


class Strategy:
    """Generations of a search.

    Parameters
    ----------
    mean
        Middle of the first generation, ``(numbers,)``.
    sigma
        Standard deviation of the first generation.
    population, seed
        Candidates a generation; seed of all that is drawn.
    bounds
        Lowest and highest value of each number, ``(numbers, 2)``.
    """

    def __init__(self, mean: Floats, sigma: float, *, population: int, seed: int, bounds: NDArray[np.float64] | None = None) -> None:
        self.population = population
        self._cma = CMA(mean=mean, sigma=sigma, population_size=population, seed=seed, bounds=bounds)
        self.rewards: list[Floats] = []
        """Of each generation so far, ``(population,)``."""

    @property
    def mean(self) -> Floats:
        """Middle of the next generation, ``(numbers,)``."""
        mean: Floats = self._cma.mean
        return mean

    def ask(self) -> list[Floats]:
        """The candidates of the next generation."""
        return [self._cma.ask() for _ in range(self.population)]

    def tell(self, candidates: Sequence[Floats], rewards: Floats) -> None:
        """The rewards ``(population,)`` of the candidates that were asked."""
        self._cma.tell([(numbers, -float(reward)) for numbers, reward in zip(candidates, rewards, strict=True)])
        self.rewards.append(rewards)

    def repeat(self, rewards: Sequence[Floats]) -> None:
        """Go on after generations with these rewards."""
        for reward in rewards:
            self.tell(self.ask(), reward)

    def keep(self, file: Path, identity: dict[str, Any], history: History) -> None:
        """Write what it takes to go on to ``file``."""
        rewards = np.array(self.rewards).reshape(len(self.rewards), self.population)
        state = {"identity": identity, "history": asdict(history)}
        facts = json.dumps({**state, "digest": _digest(state, rewards)})
        content = io.BytesIO()
        np.savez(content, allow_pickle=False, rewards=rewards, facts=np.frombuffer(facts.encode(), dtype=np.uint8))
        write_atomically(file, content.getvalue())

    def go_on(self, file: Path, identity: dict[str, Any]) -> History:
        """Go on from what ``file`` keeps, and the history of the search so far.

        Raises
        ------
        TrainingError
            When the file is of another search, cannot be read, or is not as it was written.
        """
        try:
            with np.load(file, allow_pickle=False) as arrays:
                rewards, facts = arrays["rewards"], json.loads(arrays["facts"].tobytes())
        except DAMAGED as error:
            msg = f"The state of the search {file} cannot be read: {error}. Remove it to start the search over."
            raise TrainingError(msg) from error
        if facts["identity"] != identity:
            msg = f"{file.parent} holds another search: task, settings, start or seed differ. Choose another folder."
            raise TrainingError(msg)
        if facts.pop("digest", None) != _digest(facts, rewards):
            raise altered(file)
        self.repeat(rewards)
        return History.from_dict(facts["history"])


def _digest(facts: dict[str, Any], rewards: Floats) -> str:
    """SHA-256 (hex) over what is kept of a search."""
    return sha256(json.dumps(facts, sort_keys=True).encode() + rewards.astype("<f8").tobytes()).hexdigest()
