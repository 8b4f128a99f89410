"""What surrounds a control step, as data that the compiled kernel can work off: a task's program, and environments that run it.

The kernel knows nothing of tasks. A program says where numbers come from, what arithmetic is done with them
(``glbench.kernel.tape``) and where they go; ``glbench.env`` makes one of a task and runs it with numpy where no compiled kernel does.

Every environment has a scenario of its own. Its weather is a sequence of days out of one pool of rows that all of them share; its
calendar (clock, prices) begins anywhere in another pool; its parameters, keys of random numbers, traits and memory are rows of
arrays. What is drawn once an episode is written there at the start; what is drawn in the step is named in the program.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from glbench.kernel.records import FloatArray, StepFailure
from glbench.kernel.tape import EMPTY, Tape


@dataclass(frozen=True, eq=False)
class Lookup:
    """Rows of a table that are observed as they are.

    ``table`` is ``(rows, width)`` float32, C-contiguous; its rows are those of the pool of the weather or, if ``clocked``, of the calendar.
    If ``numbered``, a single row is shown: the one whose number, a whole one from 0, ``outcome`` puts into its first column.
    ``at`` is the first column of the observation; ``rows`` is how many are shown, side by side, and those of the weather follow the
    environment's own sequence of days. The first one is that of the calendar now, or of the weather shown, or the one ``ahead`` rows later.
    ``every`` is how many rows of the pool share a row of the table.
    """

    table: npt.NDArray[np.float32]
    at: int = 0
    rows: int = 1
    clocked: bool = False
    numbered: bool = False
    ahead: int = 0
    every: int = 1


@dataclass(frozen=True, eq=False)
class ActionBounds:
    """Bounds of values from outside, each ``(m,)``: ``lowest`` to ``highest`` are accepted, and cut to ``low`` and ``high``."""

    lowest: FloatArray
    highest: FloatArray
    low: FloatArray
    high: FloatArray


@dataclass(frozen=True, eq=False)
class ParameterNoise:
    """Parameters that are drawn evenly between ``1 - half_width`` and ``1 + half_width`` times the environment's own value.

    ``places`` of the parameters ``(count,)``, in the order of the generator's numbers; redrawn every ``every`` steps.
    """

    places: npt.NDArray[np.int32]
    half_width: float
    every: int = 1


@dataclass(frozen=True, eq=False)
class Program:
    """What an environment does around the kernel's step.

    A tape reads ``before`` (states at the start of the step), ``after`` (at its end), ``controls``, ``calendar`` and
    ``calendar_before`` (the calendar's row now, and at the start of the step), ``weather`` (the row shown; before the step the one that
    acts), ``weather_before`` (after the step, the row that acted in it), ``counter`` (0: steps taken, 1: step whose weather is shown),
    ``noise`` (uniform numbers of this step), ``trait`` and ``memory``.
    """

    actuation: Tape
    """Before the step: from ``given`` (an action within its bounds), ``controls`` in force, ``before`` and the rest to ``controls`` and
    ``memory``. Left out when controls are given directly."""
    outcome: Tape
    """After the step, and at the start: to ``table`` and ``observation``."""
    actions: ActionBounds
    controls: ActionBounds
    """``actions`` and ``controls``: bounds of actions, and of controls that are given directly."""
    steps: int
    """Steps of an episode."""
    weather: FloatArray
    day: int
    """``weather`` and ``day``: pool of disturbances ``(rows, d)``, and how many rows a day has."""
    days: int
    """Days that an environment's sequence has: those of the episode, and those that a forecast reaches."""
    calendar: FloatArray
    """Pool of calendar rows ``(rows, c)``: hour of day, day of year, prices, values of scheduled controls."""
    lag: int
    """1 when the weather shown is the row that has just acted, 0 when it is the next one."""
    nominal: FloatArray
    """Parameters ``(p,)``."""
    columns: int
    width: int
    info_columns: int
    """``columns``, ``width`` and ``info_columns``: columns of the observation and of the table; those of the table before ``info_columns``
    hold for environments that stand still too, the others are 0 for one that had ended."""
    charges: dict[int, float]
    """Columns of the table with the values that they have for a failed step."""
    lookups: tuple[Lookup, ...] = ()
    """Rows of tables that are observed."""
    own_parameters: bool = False
    """Whether each environment has parameters of its own; otherwise all share one row."""
    parameter_noise: tuple[ParameterNoise, ...] = ()
    """Groups of parameters that are drawn in the step."""
    followers: Tape = EMPTY
    """From ``drawn`` (a parameter by its place, after the draws) to ``parameters``."""
    update: Tape = EMPTY
    """After a step that succeeded, before ``outcome``: to ``memory``."""
    streams: tuple[int, ...] = ()
    """How many numbers of each stream of noise a step has. ``noise`` counts through all of them."""
    traits: int = 0
    memory: int = 0
    """``traits`` and ``memory``: how many of them an environment has."""

    @property
    def keys(self) -> int:
        """How many keys an environment has: one for each group of ``parameter_noise``, then one for each of ``streams``."""
        return len(self.parameter_noise) + len(self.streams)


class Environments(ABC):
    """``n`` environments that run a program. Not thread-safe.

    A row gives the same bits alone, in any batch and with any number of threads. ``x`` and ``u`` are other arrays after a step;
    the other attributes stay the same arrays, which the next call overwrites. To start environments, write into the arrays down to
    ``memory``, and ``observe``.

    ``x``, ``u``, ``k`` and ``ended`` are states ``(n, s)``, controls ``(n, c)``, steps taken ``(n,)`` and whether the environment has ended
    ``(n,)``; ``keys`` those of the random numbers, ``(n, program.keys, 2)`` uint64 words of 32 bits. ``days`` are the rows of the pool of
    weather at which the environment's days begin, ``(n, days)``, ``first`` the row of the calendar at its start, ``(n,)``. ``parameters``
    are ``(n, p)``, or ``(1, p)`` when all share them; ``traits`` is what is constant in an episode ``(n, traits)``, ``memory`` what tapes
    write for the next step ``(n, memory)``. ``given`` are actions for ``step``, ``(n, m)``, ``given_controls`` controls for
    ``step_controls``, ``(n, c)``. ``table`` and ``observations`` are what the program makes of the last step, ``(n, width)`` float64 and
    ``(n, columns)`` float32.
    """

    def __init__(self, program: Program, n: int, states: int) -> None:
        controls = len(program.controls.low)
        self.x: FloatArray = np.zeros((n, states))
        self.u: FloatArray = np.zeros((n, controls))
        self.k: npt.NDArray[np.int64] = np.zeros(n, np.int64)
        self.ended: npt.NDArray[np.bool_] = np.zeros(n, np.bool_)
        self.keys: npt.NDArray[np.uint64] = np.zeros((n, program.keys, 2), np.uint64)
        self.days: npt.NDArray[np.int64] = np.zeros((n, program.days), np.int64)
        self.first: npt.NDArray[np.int64] = np.zeros(n, np.int64)
        self.parameters: FloatArray = np.tile(program.nominal, (n if program.own_parameters else 1, 1))
        self.traits: FloatArray = np.zeros((n, program.traits))
        self.memory: FloatArray = np.zeros((n, program.memory))
        self.actions: FloatArray = np.zeros((n, len(program.actions.low)))
        self.direct_controls: FloatArray = np.zeros((n, controls))
        self.table: FloatArray = np.zeros((n, program.width))
        self.observations: npt.NDArray[np.float32] = np.zeros((n, program.columns), np.float32)

    @property
    @abstractmethod
    def over(self) -> int:
        """How many environments have ended, by the last call."""

    @abstractmethod
    def step(self) -> int:
        """Take a step with ``actions``; how many environments failed in it, or -1, and no step, for a value out of bounds or no number."""

    @abstractmethod
    def step_controls(self) -> int:
        """Take a step with ``direct_controls``, as they are. Returns what ``step`` does."""

    @abstractmethod
    def observe(self) -> None:
        """Fill ``table`` and ``observations`` from where the environments stand."""

    @abstractmethod
    def failures(self) -> list[StepFailure]:
        """Environments that failed in the last step, in words."""
