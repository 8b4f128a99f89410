"""An episode in memory: what happened in one run, step by step, with where it comes from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glbench.episodes.columns import Group
from glbench.episodes.header import Provenance, RunFacts
from glbench.errors import EpisodeError, did_you_mean

if TYPE_CHECKING:
    import pandas as pd

    from glbench.tasks import TaskSpec

Table = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Episode:
    """One run.

    Attributes
    ----------
    provenance, run
        Where it comes from, and how it ended.
    definition
        The task's definition as JSON; ``task()`` makes the task of it.
    groups
        The groups of columns, with units and meanings.
    tables
        Values ``(steps, columns)`` by name of the group, float64; raw actions may be float32.
    start
        Values ``(columns,)`` at step 0 of the groups that have some.
    times
        UTC at the start and at the end of every step, ``(steps + 1,)`` datetime64[ns].
    problem
        In words, when the file was cut or damaged and this is what could be recovered; else ``None``.
    """

    provenance: Provenance
    run: RunFacts
    definition: bytes
    groups: tuple[Group, ...]
    tables: Mapping[str, Table]
    start: Mapping[str, Table]
    times: NDArray[np.datetime64]
    problem: str | None = None

    @property
    def steps(self) -> int:
        """Number of steps that are there."""
        return len(self.times) - 1

    @property
    def complete(self) -> bool:
        """Whether nothing is missing: neither was the file cut, nor does it hold fewer steps than the run had."""
        return self.problem is None and self.steps == self.run.steps

    def __getitem__(self, name: str) -> Table:
        """One column, ``(steps,)``.

        Raises
        ------
        EpisodeError
            When there is no such column, with the nearest known one.
        """
        for group in self.groups:
            if name in group.names:
                return self.tables[group.name][:, group.names.index(name)]
        msg = f"An episode has no column '{name}'.{did_you_mean(name, self.names)}"
        raise EpisodeError(msg)

    @property
    def states(self) -> Table:
        """The model's states at the start and at the end of every step, ``(steps + 1, 28)``, in the model's order and units."""
        from glbench.model import STATE_NAMES

        return np.stack([np.concatenate([[self._begun(name)], self[name]]) for name in STATE_NAMES], axis=1)

    def _begun(self, name: str) -> float:
        for group in self.groups:
            if group.name in self.start and name in group.names:
                return float(self.start[group.name][group.names.index(name)])
        msg = f"An episode has no value of '{name}' at its start."
        raise EpisodeError(msg)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all columns."""
        return tuple(name for group in self.groups for name in group.names)

    def task(self) -> TaskSpec:
        """The task, from the definition in the record."""
        from glbench.episodes.definition import task_of

        return task_of(self.definition)

    def to_frame(self) -> pd.DataFrame:
        """One row a step, indexed by ``step`` from 1; ``utc_start`` and ``utc_end``, then every column.

        ``frame.attrs`` holds units and meanings by column, the values at step 0 under ``"start"``, and task, agent and seed.
        """
        import pandas as pd

        columns: dict[str, Any] = {"utc_start": self.times[:-1], "utc_end": self.times[1:]}
        for group in self.groups:
            columns |= {name: self.tables[group.name][:, index] for index, name in enumerate(group.names)}
        frame = pd.DataFrame(columns, index=pd.RangeIndex(1, self.steps + 1, name="step"))
        listed = [column for group in self.groups for column in group.columns]
        begun = {
            group.name: dict(zip(group.names, self.start[group.name].tolist(), strict=True))
            for group in self.groups
            if group.name in self.start
        }
        frame.attrs.update(
            task=self.provenance.task.id,
            agent=self.provenance.agent.name,
            seed=self.run.seed,
            status=self.run.status,
            units={column.name: column.unit for column in listed},
            meanings={column.name: column.meaning for column in listed},
            start=begun,
        )
        return frame
