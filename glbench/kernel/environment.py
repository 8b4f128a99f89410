"""What surrounds a control step, as data that the compiled kernel can work off: a task's program, and environments that run it.

The kernel knows nothing of tasks. A program says where numbers come from, what arithmetic is done with them
(``glbench.kernel.tape``) and where they go; ``glbench.env`` makes one of a task.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from glbench.kernel.records import FloatArray, StepFailure
from glbench.kernel.tape import Tape


@dataclass(frozen=True, eq=False)
class Lookup:
    """Rows of a table that are observed as they are.

    Attributes
    ----------
    table
        ``(rows, width)`` float32, C-contiguous.
    at
        First column of the observation.
    rows
        How many rows are shown, side by side.
    clocked
        Whether the row is that of the clock; otherwise that of the weather shown.
    ahead
        How many rows after it the first one is.
    """

    table: npt.NDArray[np.float32]
    at: int
    rows: int = 1
    clocked: bool = False
    ahead: int = 0


@dataclass(frozen=True, eq=False)
class Reader:
    """Bounds of values from outside, each ``(m,)``.

    Values from ``lowest`` to ``highest`` are accepted; those between them and ``low`` or ``high`` are taken as these.
    """

    lowest: FloatArray
    highest: FloatArray
    low: FloatArray
    high: FloatArray


@dataclass(frozen=True, eq=False)
class Draws:
    """Parameters that are drawn evenly between ``1 - half_width`` and ``1 + half_width`` times their nominal value.

    ``places`` of the parameters ``(count,)``, in the order of the generator's numbers; ``once`` an episode or in every step;
    ``followers`` is a tape from ``drawn`` (index: place of the parameter) to ``parameters``.
    """

    places: npt.NDArray[np.int32]
    half_width: float
    once: bool
    followers: Tape


@dataclass(frozen=True, eq=False)
class Program:
    """What an environment does around the kernel's step.

    Attributes
    ----------
    actuation
        From ``given`` (an action within its bounds) and ``controls`` in force to ``controls``.
    outcome
        From ``before``, ``after`` (states), ``controls``, ``clock`` (0: hour of day, 1: day of year) and ``counter`` (0: steps
        taken, 1: weather row shown) to ``table`` and ``observation``.
    actions, controls
        Bounds of actions, and of controls that are given directly.
    steps
        Steps of an episode.
    weather, clock
        Disturbances ``(rows, 10)``, of which row k acts on step k, and hour of day with day of year ``(rows, 2)``.
    lag
        1 when the weather shown is the row that has just acted, 0 when it is the next one.
    nominal
        Parameters ``(208,)``.
    draws
        Which of them are drawn; ``None`` when all are certain.
    lookups
        Rows of tables that are observed.
    columns, width, head
        Columns of the observation and of the table; those of the table before ``head`` hold for environments that stand still
        too, the others are 0 for one that had ended.
    charges
        Columns of the table with the values that they have for a failed step.
    """

    actuation: Tape
    outcome: Tape
    actions: Reader
    controls: Reader
    steps: int
    weather: FloatArray
    clock: FloatArray
    lag: int
    nominal: FloatArray
    draws: Draws | None
    lookups: tuple[Lookup, ...]
    columns: int
    width: int
    head: int
    charges: dict[int, float]


class Environments(Protocol):
    """``n`` environments that run a program. Not thread-safe.

    A row gives the same bits alone, in any batch and with any number of threads. ``x`` and ``u`` are other arrays after a step;
    the other attributes stay the same arrays, which the next call overwrites. To start environments, write into ``x``, ``u``,
    ``k``, ``ended`` and ``keys``, and ``look``.

    Attributes
    ----------
    x, u, k, ended
        States ``(n, 28)``, controls ``(n, 6)``, steps taken ``(n,)`` and whether the environment has ended ``(n,)``.
    keys
        Keys of the draws, ``(n, 2)`` uint64 words of 32 bits.
    given, given_controls
        Actions for ``step``, ``(n, m)``, and controls for ``step_controls``, ``(n, 6)``.
    table, observations
        What the program makes of the last step, ``(n, width)`` float64 and ``(n, columns)`` float32.
    """

    x: FloatArray
    u: FloatArray
    k: npt.NDArray[np.int64]
    ended: npt.NDArray[np.bool_]
    keys: npt.NDArray[np.uint64]
    given: FloatArray
    given_controls: FloatArray
    table: FloatArray
    observations: npt.NDArray[np.float32]

    @property
    def over(self) -> int:
        """How many environments have ended, by the last call."""

    def step(self) -> int:
        """Take a step with the actions ``given``.

        Returns
        -------
        int
            How many environments failed in it; -1 when a value given is out of bounds or no number, and nothing was done.
        """

    def step_controls(self) -> int:
        """Take a step with ``given_controls``, as they are. Returns what ``step`` does."""

    def look(self) -> None:
        """Fill ``table`` and ``observations`` from where the environments stand."""

    def failures(self) -> list[StepFailure]:
        """Environments that failed in the last step, in words."""
