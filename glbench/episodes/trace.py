"""What a simulation did, step by step, for all of its runs: written down while it happens, cut into episodes afterwards."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glbench.env import Simulation, StepResult, run_weather
from glbench.env.quantities import QUANTITY_NAMES
from glbench.episodes.columns import CROP_STATES, ECONOMICS, OTHER_STATES, VIOLATIONS, action_group, groups_of
from glbench.episodes.definition import definition_json
from glbench.episodes.episode import Episode
from glbench.episodes.header import Provenance, RunFacts
from glbench.model import STATE_NAMES

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec

Floats = NDArray[np.float64]

_CROP = [STATE_NAMES.index(name) for name in CROP_STATES]
_OTHERS = [STATE_NAMES.index(name) for name in OTHER_STATES]
_ECONOMICS = [QUANTITY_NAMES.index(name) for name in ECONOMICS]
_VIOLATIONS = [QUANTITY_NAMES.index(name) for name in VIOLATIONS]


class Trace:
    """States, controls, climate and quantities of all runs of ``simulation``, from where it stands on.

    ``rows`` chooses runs; by default all. About 0.5 kB a step and run.
    """

    def __init__(self, simulation: Simulation, rows: Sequence[int] | None = None) -> None:
        steps, self.rows = simulation.task.steps, tuple(range(simulation.n) if rows is None else rows)
        n, chosen = len(self.rows), list(self.rows)
        self._all = self.rows == tuple(range(simulation.n))
        self._steps = 0
        self.x = np.empty((steps + 1, n, simulation.x.shape[1]))
        self.air = np.empty((steps + 1, 3, n))
        self.u = np.empty((steps, n, simulation.u.shape[1]))
        self.quantities = np.empty((steps, len(QUANTITY_NAMES), n))
        self.x[0], self.air[0] = simulation.x[chosen], simulation.air[:, chosen]

    def add(self, simulation: Simulation, outcome: StepResult) -> None:
        """Write down the step that was just taken."""
        step = self._steps
        x, u, air = simulation.x, simulation.u, simulation.air
        table = outcome.table
        if self._all:
            self.quantities[step] = table
        else:
            chosen = list(self.rows)
            x, u, air = x[chosen], u[chosen], air[:, chosen]
            self.quantities[step] = table[:, chosen]
        self.x[step + 1], self.u[step], self.air[step + 1] = x, u, air
        self._steps += 1

    def episode(
        self, task: TaskSpec, row: int, provenance: Provenance, run: RunFacts, actions: NDArray[np.floating]
    ) -> Episode:
        """The episode of the simulation's ``row``, whose raw actions were ``actions`` ``(steps or more, m)``."""
        place, steps = self.rows.index(row), run.steps
        weather = run_weather(task, run.seed)
        states, air = self.x[: steps + 1, place], self.air[: steps + 1, :, place]
        quantities = self.quantities[:steps, :, place]
        agent = provenance.agent
        with_start = {"climate": air, "crop": states[:, _CROP], "state": states[:, _OTHERS]}
        tables: dict[str, NDArray[np.floating]] = {
            "action": actions[:steps],
            "controls": self.u[:steps, place],
            "weather": weather.values[:steps],
            "economics": quantities[:, _ECONOMICS],
            "violations": quantities[:, _VIOLATIONS],
            **{name: values[1:] for name, values in with_start.items()},
        }
        return Episode(
            provenance=provenance,
            run=run,
            definition=definition_json(task),
            groups=groups_of(action_group(agent.columns, controls=agent.acts == "controls")),
            tables=tables,
            start={name: values[0] for name, values in with_start.items()},
            times=weather.times[: steps + 1].astype("datetime64[ns]"),
        )
