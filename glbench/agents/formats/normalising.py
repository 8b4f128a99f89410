"""Normalisation of observations before a policy sees them: VecNormalize's statistics, or mean and std of a card.

Element by element, so that no bit depends on the number of rows.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glbench.agents.formats.packages import need
from glbench.errors import SubmissionError

if TYPE_CHECKING:
    from glbench.agents.card import Normalisation
    from glbench.agents.identity import Identity

Normalise = Callable[[NDArray[np.float32]], NDArray[np.float32]]


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
