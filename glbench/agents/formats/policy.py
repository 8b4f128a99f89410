"""The agent around a saved policy: normalise, ask evenly, hand the state of each run on, clip where the card says so.

A run has the same bits alone and among others, from libraries whose matrix products round by the size of the batch. A library picks
another order of summation for one row than for thirty, and sometimes another for odd widths, depending on where a row is in memory.
So a policy is always asked with the same number of rows, filled up with zeros. Whether a row's place in that block matters is
tried out once, with the policy itself: rows are moved through all places. Where it does matter, the policy is asked row by row,
from one and the same piece of memory; that is slower and cannot depend on anything else. Observations are normalised element by
element.
"""

from __future__ import annotations

import contextlib
import pickle
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glbench.agents.formats.packages import need
from glbench.errors import ShapeError, SubmissionError

if TYPE_CHECKING:
    from glbench.agents.card import Normalisation
    from glbench.agents.identity import Identity
    from glbench.agents.protocol import Actions, Observations
    from glbench.tasks import TaskCard


Normalise = Callable[[NDArray[np.float32]], NDArray[np.float32]]
Rows = NDArray[np.float32]
Function = Callable[[Rows], NDArray[np.floating]]
"""Answers ``(b, m)`` for ``b`` rows ``(b, k)``."""
BLOCK = 32
"""Rows in a block: the 30 runs of an evaluation fit into one."""
_SIZES = (0.01, 1.0, 100.0)


@contextlib.contextmanager
def without_warnings() -> Iterator[None]:
    """Keep what is warned of while a file is loaded to itself."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def normaliser(submission: Identity, columns: int) -> Normalise:
    """What is done to the observations ``(n, columns)`` first: nothing, where neither card nor statistics say so.

    Raises
    ------
    SubmissionError
        When the statistics cannot be read or are of another number of columns.
    """
    if submission.statistics is not None:
        return _from_file(submission.statistics, columns)
    card = submission.card
    if card is not None and card.normalisation is not None and not isinstance(card.normalisation, str):
        return _from_table(card.normalisation, columns)
    return lambda observations: observations


def _from_table(table: Normalisation, columns: int) -> Normalise:
    mean, std = np.array(table.mean), np.array(table.std)
    _check_columns("The card's table [normalisation]", len(mean), columns)
    clip = np.inf if table.clip is None else table.clip
    return lambda observations: np.clip((observations - mean) / std, -clip, clip).astype(np.float32)


def _from_file(file: Path, columns: int) -> Normalise:
    """Statistics that Stable-Baselines3's ``VecNormalize.save`` wrote. Unpickling runs code of whoever wrote the file."""
    need("stable_baselines3", f"The file {file.name}")
    try:
        with file.open("rb") as stream:
            statistics: Any = pickle.load(stream)  # a submission is a stranger's program in every form
    except (
        OSError,
        EOFError,
        pickle.UnpicklingError,
        AttributeError,
        ImportError,
        ValueError,
        TypeError,
        IndexError,
    ) as error:
        msg = (
            f"{file.name} cannot be read as statistics of VecNormalize ({type(error).__name__}: {error}). "
            f'Save them with: env.save("{file.name}").'
        )
        raise SubmissionError(msg) from error
    if not hasattr(statistics, "obs_rms") or not hasattr(statistics, "normalize_obs"):
        msg = (
            f"{file.name} holds an object of type {type(statistics).__name__}, expected VecNormalize. "
            f'Save it with: env.save("{file.name}").'
        )
        raise SubmissionError(msg)
    if not statistics.norm_obs:  # only rewards were normalised, which do not matter any more
        return lambda observations: observations
    shape = np.shape(getattr(statistics.obs_rms, "mean", ()))
    if len(shape) != 1:
        msg = f"{file.name} holds statistics of observations of shape {shape}, expected a row of {columns} columns."
        raise SubmissionError(msg)
    _check_columns(f"The statistics in {file.name}", shape[0], columns)

    def normalise(observations: NDArray[np.float32]) -> NDArray[np.float32]:
        normalised: NDArray[np.float32] = np.asarray(statistics.normalize_obs(observations), dtype=np.float32)
        return normalised

    return normalise


def _check_columns(what: str, found: int, columns: int) -> None:
    if found != columns:
        msg = f"{what} are of {found} columns, the task shows {columns}: they belong to another task or other observations."
        raise SubmissionError(msg.replace("[normalisation] are", "[normalisation] is"))


class EvenRows:
    """``function`` asked so that row i of the answer depends on row i of the question only, to the last bit.

    Parameters
    ----------
    function
        A policy that takes ``(b, width)`` float32 for the ``b`` of a block.
    width
        Columns of a row.
    block
        Rows that are asked for at once; 1 for a policy that takes a single row only.
    """

    def __init__(self, function: Function, width: int, block: int = BLOCK) -> None:
        self._function = function
        self._width = width
        self.block = block
        """Rows asked for at once: the block's, or 1 where the place in the block changes bits."""
        self._memory = np.zeros((block, width), dtype=np.float32)
        if block > 1 and not self._even():
            self.block = 1
            self._memory = np.zeros((1, width), dtype=np.float32)

    def __call__(self, rows: Rows) -> NDArray[np.floating]:
        """Answers ``(n, m)`` for ``rows`` ``(n, width)``, any ``n`` from 1 on."""
        parts = [self._ask(rows[first : first + self.block]) for first in range(0, len(rows), self.block)]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def _ask(self, rows: Rows) -> NDArray[np.floating]:
        memory = self._memory
        memory[: len(rows)] = rows
        memory[len(rows) :] = 0.0
        answer = np.array(self._function(memory))
        if answer.ndim != 2 or len(answer) != self.block:
            msg = (
                f"the policy answers {self.block} rows of observations with an array of shape {answer.shape}, "
                f"expected ({self.block}, number of actions)"
            )
            raise SubmissionError(msg)
        return answer[: len(rows)]

    def _even(self) -> bool:
        """Whether rows have the same answers in every place of the block and beside zeros."""
        draws = np.random.default_rng(0).standard_normal((self.block, self._width))
        for size in _SIZES:
            rows = (size * draws).astype(np.float32)
            together = self._ask(rows)
            for shift in range(1, self.block):
                moved = np.roll(self._ask(np.roll(rows, shift, axis=0)), -shift, axis=0)
                if moved.tobytes() != together.tobytes():
                    return False
            if any(self._ask(rows[i : i + 1]).tobytes() != together[i : i + 1].tobytes() for i in range(self.block)):
                return False
        return True


class PolicyAgent:
    """An agent that asks a policy. Its rows do not know of each other, and a row has the same bits in every batch.

    Parameters
    ----------
    ask
        The policy: answers ``(n, actions + state)`` for ``(n, columns + state)``.
    normalise
        What is done to the observations first.
    actions
        Number of actions.
    state
        Numbers that a recurrent policy hands from one step of a run to the next, 0 at the run's start.
    clip
        Whether answers are clipped to the bounds of the actions.
    """

    def __init__(
        self, ask: EvenRows, normalise: Normalise, actions: int, state: int = 0, *, clip: bool = False
    ) -> None:
        self._ask, self._normalise, self._clip = ask, normalise, clip
        self._actions, self._state_width = actions, state
        self._state: NDArray[np.float32] = np.zeros((0, state), dtype=np.float32)
        self._low: NDArray[np.float64] = np.zeros(0)
        self._high: NDArray[np.float64] = np.zeros(0)

    @property
    def rows_at_once(self) -> int:
        """Rows that the policy is asked for at once; 1 where more would change bits."""
        return self._ask.block

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """All runs begin with a state of zeros."""
        self._state = np.zeros((n_runs, self._state_width), dtype=np.float32)
        self._low = np.array([action.low for action in task.actions])
        self._high = np.array([action.high for action in task.actions])

    def act(self, observations: Observations, /) -> Actions:
        """Actions (n_runs, actions) for ``observations`` (n_runs, columns).

        Raises
        ------
        ShapeError
            When there are not as many rows as runs were announced to ``reset``.
        """
        if len(observations) != len(self._state):
            msg = f"act got observations of {len(observations)} runs, reset was called with {len(self._state)}. Call reset first."
            raise ShapeError(msg)
        rows = np.ascontiguousarray(self._normalise(observations), dtype=np.float32)
        answer = self._ask(np.concatenate([rows, self._state], axis=1) if self._state_width else rows)
        actions, self._state = (
            answer[:, : self._actions].astype(np.float64),
            answer[:, self._actions :].astype(np.float32),
        )
        return np.clip(actions, self._low, self._high) if self._clip else actions
