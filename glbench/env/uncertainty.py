"""Uncertain parameters: how they deviate from their nominal values, and what follows from them.

Every number comes from an address instead of a stream: the draw of parameter j in step k of a run is a function of the run's key, of k
and of j, and of nothing else. See docs/adr/0006-counter-based-uncertainty-draws.md.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from glbench.arrays import Floats
from glbench.env.random import UNIFORMS_PER_NORMAL, approx_normal, key_of, uniforms
from glbench.env.registries import PartRegistry
from glbench.kernel.tape import EMPTY, Recorder, Tape
from glbench.model import Model
from glbench.tasks.resolver import Scenario
from glbench.tasks.spreads import ATTEMPTS, HEAT, Spread
from glbench.tasks.vocabulary import DISTRIBUTIONS as DISTRIBUTION_WORDS

Deviation = Callable[[Floats, float], Floats]
"""Relative deviations from uniform numbers in [0, 1) and the task's half width; element by element."""

DISTRIBUTIONS: PartRegistry[Deviation] = PartRegistry("distribution", DISTRIBUTION_WORDS)

UNIFORM = "uniform"
"""The distribution that the compiled step draws itself."""


def register_distribution(name: str, meaning: str, deviation: Deviation) -> None:
    """Make a distribution known under ``name``, here and in task files.

    ``deviation`` maps each uniform number to the relative deviation of one parameter, as an inverse distribution does.

    Raises ``TaskError`` when the name is taken.
    """
    DISTRIBUTIONS.register(name, meaning, deviation)


DISTRIBUTIONS.provide(UNIFORM, lambda numbers, half_width: (2.0 * numbers - 1.0) * half_width)


def draw_key(task_id: str, seed: int) -> tuple[int, int]:
    """Key of the parameters of the run with ``seed`` of a task of schema 1."""
    return key_of(f"glbench uncertain parameters\n{task_id}\n{seed}")


def stream_key(scenario: Scenario, seed: int, stream: str) -> tuple[int, int]:
    """Key of one stream of random numbers of the run with ``seed``: tasks of a family and salt share it, streams never do."""
    if scenario.legacy:
        return draw_key(scenario.family, seed)
    return key_of(f"glbench\n{scenario.family}\n{scenario.salt}\n{seed}\n{stream}")


def season_key(scenario: Scenario, stream: str, season: str) -> NDArray[np.uint64]:
    """Key of a stream of random numbers of a generated season ``(1, 2)``: all runs in it share it."""
    return np.array([key_of(f"glbench\n{scenario.family}\n{scenario.salt}\n{season}\n{stream}")], np.uint64)


def log_heat(spread: Spread, logs: Floats) -> Floats:
    """Logarithm of a season's heat relative to the nominal house's ``(n,)``, as predicted from those of the multipliers ``(n, rows)``."""
    # One after the other: the same bits for any number of runs.
    return sum((row.heat_elasticity * logs[:, place] for place, row in enumerate(spread.rows)), np.zeros(len(logs)))


def spread_multipliers(spread: Spread, keys: NDArray[np.uint64]) -> Floats:
    """By what the parameters of the runs with ``keys`` ``(n, 2)`` are multiplied, ``(n, rows of the spread)``.

    Attempt k draws the numbers (k, j) of the run's stream, while the house before needed too much or too little heat.
    """
    draws = list(dict.fromkeys(row.draw for row in spread.rows))
    places = [draws.index(row.draw) for row in spread.rows]
    sizes, low, high = np.array([(spread.factor * row.log_sd, row.low, row.high) for row in spread.rows]).T
    least, most = np.log(HEAT)
    logs, heat = np.zeros((len(keys), len(spread.rows))), np.full(len(keys), np.inf)
    for attempt in range(ATTEMPTS):
        again = np.flatnonzero((heat < least) | (heat > most))
        if not again.size:
            break
        numbers = uniforms(keys[again], np.full((len(again), 1), attempt), UNIFORMS_PER_NORMAL * len(draws))
        z = approx_normal(*numbers.reshape(len(again), len(draws), UNIFORMS_PER_NORMAL).transpose(2, 0, 1))
        logs[again] = np.clip(sizes * z[:, places], np.log(low), np.log(high))
        heat[again] = log_heat(spread, logs[again])
    within = np.clip(heat, least, most)
    logs *= np.divide(within, heat, out=np.ones(len(keys)), where=within != heat)[:, None]
    return np.clip(np.exp(logs), low, high)


class DerivedParameters:
    """Carries draws of uncertain parameters through to the derived ones, by the model's own formulas.

    With the crop parameters that is the leaf mass at which leaves are pruned: cLeafMax = laiMax/sla. A derived parameter that depends on
    none of the uncertain ones keeps its value. ``uncertain`` are the places of the parameters that are drawn, ``nominal`` the parameters of
    ``model``; ``followers`` are the places of the derived parameters that follow from them, even if they are among them.
    """

    def __init__(self, model: Model, nominal: Floats, uncertain: tuple[int, ...]) -> None:
        self._model = model
        self._nominal: list[Any] = list(nominal.tolist())
        self.uncertain = uncertain
        self.followers = tuple(self._following(dict(zip(uncertain, nominal[list(uncertain)][:, None], strict=True))))

    def complete(self, parameters: Floats) -> None:
        """Write the derived entries that follow from the uncertain ones into ``parameters`` ``(n, p)``."""
        columns = {place: parameters[:, place].copy() for place in range(parameters.shape[1])}
        derived = self._following(columns)
        for place in self.followers:
            parameters[:, place] = derived[place]

    def tape(self, others: tuple[int, ...] = ()) -> Tape:
        """What follows from the uncertain parameters (``drawn``, by place), as a tape.

        ``others`` are the places of parameters that differ from run to run, too.

        Raises ``RecordingError`` when a formula needs what no tape has.
        """
        if not self.followers:
            return EMPTY
        places = (*self.uncertain, *(place for place in others if place not in self.uncertain))
        with Recorder() as recorder:
            values = self._following({place: recorder.input("drawn", place) for place in places})
            for place in self.followers:
                recorder.output("parameters", place, values[place])
        return recorder.tape()

    def _following(self, values: dict[int, Any]) -> dict[int, Any]:
        """Derived parameters that change with ``values``, by place."""
        parameters = self._nominal.copy()
        for place, value in values.items():
            parameters[place] = value
        # What follows from an array is a new array; numbers, and arrays that were handed in, depend on nothing uncertain.
        return {
            place: value
            for place, value in enumerate(self._model.derived(self._model.Parameters(*parameters)))
            if isinstance(value, np.ndarray | casadi.SX) and value is not parameters[place]
        }
