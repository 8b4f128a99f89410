"""Saved policies that are submissions without code: the agent around one, and the forms ONNX and TorchScript (``sb3.py`` has the third).

Each form has a function ``*_agent(submission, task)``. torch, Stable-Baselines3 and onnxruntime are imported when one is made.

A run has the same bits alone and among others, from libraries whose matrix products round by the size of the batch. A library picks another
order of summation for one row than for thirty, and sometimes another for odd widths, depending on where a row is in memory. So a policy is
always asked with the same number of rows, filled up with zeros. Whether a row's place in that block matters is tried out once, with the
policy itself: rows are moved through all places. Where it does matter, the policy is asked row by row, from one and the same piece of
memory; that is slower and cannot depend on anything else. Observations are normalised element by element.
"""

from __future__ import annotations

import contextlib
import pickle
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glbench.agents.protocol import check_runs
from glbench.errors import SubmissionError, last_line, refuse
from glbench.extras import need
from glbench.untrusted import opened_archive

if TYPE_CHECKING:
    from glbench.agents.identity import Identity
    from glbench.agents.protocol import Actions, Observations
    from glbench.tasks import TaskCard

Normalise = Callable[[NDArray[np.float32]], NDArray[np.float32]]
Rows = NDArray[np.float32]
Function = Callable[[Rows], NDArray[np.floating]]  # Answers ``(b, m)`` for ``b`` rows ``(b, k)``
BLOCK = 32  # Rows in a block: the 30 runs of an evaluation fit into one
_SIZES = (0.01, 1.0, 100.0)
DAMAGED = (
    OSError, ValueError, KeyError, EOFError, AttributeError, TypeError, IndexError, AssertionError, RuntimeError, ImportError,
    pickle.UnpicklingError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""Errors that reading a damaged file of Stable-Baselines3 or numpy may raise."""


@contextlib.contextmanager
def without_warnings() -> Iterator[None]:
    """Keep what is warned of while a file is loaded to itself."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def normaliser(submission: Identity, columns: int) -> Normalise:
    """What is done to the observations ``(n, columns)`` first: nothing, where neither card nor statistics say so.

    Raises ``SubmissionError`` when the statistics cannot be read or are of another number of columns.
    """
    if submission.statistics is not None:
        return _statistics_from(submission.statistics, columns)
    card = submission.card
    if card is not None and card.normalisation is not None and not isinstance(card.normalisation, str):
        table = card.normalisation
        mean, std = np.array(table.mean), np.array(table.std)
        _check_columns("The card's table [normalisation] is", len(mean), columns)
        clip = np.inf if table.clip is None else table.clip
        return lambda observations: np.clip((observations - mean) / std, -clip, clip).astype(np.float32)
    return lambda observations: observations


def _statistics_from(file: Path, columns: int) -> Normalise:
    """Statistics that Stable-Baselines3's ``VecNormalize.save`` wrote. Unpickling runs code of whoever wrote the file."""
    need("stable_baselines3", f"The file {file.name}")
    try:
        with file.open("rb") as stream:
            statistics: Any = pickle.load(stream)  # a submission is a stranger's program in every form
    except DAMAGED as error:
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
        refuse(f"{file.name} holds statistics of observations of shape {shape}, expected a row of {columns} columns.", SubmissionError)
    _check_columns(f"The statistics in {file.name} are", shape[0], columns)

    def normalise(observations: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.asarray(statistics.normalize_obs(observations), dtype=np.float32)

    return normalise


def _check_columns(what: str, count: int, columns: int) -> None:
    if count != columns:
        refuse(f"{what} of {count} columns, the task shows {columns}: they belong to another task or other observations.", SubmissionError)


class EvenRows:
    """``function`` asked so that row i of the answer depends on row i of the question only, to the last bit.

    A policy that takes ``(b, width)`` float32 for the ``b`` of a ``block``: the rows asked for at once, 1 for one that takes a single row.
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

    ``ask`` answers ``(n, actions + state)`` for ``(n, columns + state)``, of observations that went through ``normalise``. ``state`` is how
    many numbers a recurrent policy hands from one step of a run to the next, 0 at the run's start. ``clip``: whether answers are clipped.
    """

    def __init__(self, ask: EvenRows, normalise: Normalise, actions: int, state: int = 0, *, clip: bool = False) -> None:
        self._ask, self._normalise, self._clip = ask, normalise, clip
        self._actions, self._state_width = actions, state
        self._state: NDArray[np.float32] = np.zeros((0, state), dtype=np.float32)
        self._low: NDArray[np.float64] = np.zeros(0)
        self._high: NDArray[np.float64] = np.zeros(0)

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """All runs begin with a state of zeros."""
        self._state = np.zeros((n_runs, self._state_width), dtype=np.float32)
        self._low = np.array([action.low for action in task.actions])
        self._high = np.array([action.high for action in task.actions])

    def act(self, observations: Observations, /) -> Actions:
        """Actions (n_runs, actions) for ``observations`` (n_runs, columns). Raises ``ShapeError`` for another number of runs."""
        check_runs(observations, len(self._state))
        rows = np.ascontiguousarray(self._normalise(observations), dtype=np.float32)
        answer = self._ask(np.concatenate([rows, self._state], axis=1) if self._state_width else rows)
        actions, self._state = answer[:, : self._actions].astype(np.float64), answer[:, self._actions :].astype(np.float32)
        return np.clip(actions, self._low, self._high) if self._clip else actions


_KINDS: dict[str, type[np.floating]] = {"tensor(float)": np.float32, "tensor(double)": np.float64}
_ONLY_ERRORS = 3
_HOW = 'Write one with: torch.jit.script(policy).save("policy.pt"), or torch.jit.trace(policy, example).save("policy.pt").'


def onnx_agent(submission: Identity, task: TaskCard) -> PolicyAgent:
    """The agent of an ONNX file, on one thread. Raises ``SubmissionError`` without onnxruntime, or when file or policy do not fit."""
    file = submission.entry
    runtime = need("onnxruntime", f"The ONNX policy {file.name}")
    # onnxruntime has error types of its own below Exception, and names none of them in its interface.
    try:
        options = runtime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.execution_mode = runtime.ExecutionMode.ORT_SEQUENTIAL
        options.log_severity_level = _ONLY_ERRORS
        session = runtime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
    except Exception as error:
        refuse(f"{file.name} cannot be loaded as ONNX: {last_line(error)}.", SubmissionError, error)
    block, kind, name = _input(session, len(task.observations), file.name)
    output = session.get_outputs()[0].name

    def function(rows: Rows) -> NDArray[np.floating]:
        return np.asarray(session.run([output], {name: rows.astype(kind, copy=False)})[0])

    return _agent(submission, task, function, block)


def _input(session: Any, columns: int, file: str) -> tuple[int, type[np.floating], str]:
    """Rows of a batch, type of number and name of the one input."""
    inputs = session.get_inputs()
    if len(inputs) != 1:
        names = ", ".join(item.name for item in inputs)
        msg = (
            f"{file} has {len(inputs)} inputs ({names}), expected one: the observations. "
            "Policies with a memory need a Python agent around them."
        )
        raise SubmissionError(msg)
    (only,) = inputs
    if only.type not in _KINDS:
        refuse(f"{file} takes {only.type}, expected tensor(float) of shape (rows, {columns}).", SubmissionError)
    shape = list(only.shape)
    if len(shape) != 2 or (isinstance(shape[1], int) and shape[1] != columns):
        sizes = f"({', '.join(str(size) for size in shape)})"
        msg = (
            f"{file} takes observations of shape {sizes}, the task shows (rows, {columns}): "
            "it was made for another task or other observations."
        )
        raise SubmissionError(msg)
    return (shape[0] if isinstance(shape[0], int) and shape[0] > 0 else BLOCK), _KINDS[only.type], only.name


def torchscript_agent(submission: Identity, task: TaskCard) -> PolicyAgent:
    """The agent of a TorchScript file; torch uses one thread from here on, since bits depend on the number of threads.

    Raises ``SubmissionError`` when torch is missing, the file is not TorchScript, or the policy does not fit the task.
    """
    file = submission.entry
    complaint = torchscript_complaint(file)
    if complaint is not None:
        raise SubmissionError(complaint)
    torch = need("torch", f"The TorchScript policy {file.name}")
    torch.set_num_threads(1)
    try:
        with without_warnings():
            module = torch.jit.load(str(file), map_location="cpu").eval()
    except (RuntimeError, ValueError, OSError) as error:
        refuse(f"{file.name} cannot be loaded as TorchScript: {last_line(error)}.", SubmissionError, error)

    def function(rows: Rows) -> NDArray[np.floating]:
        # The optimising executor compiles after the first calls, and may add up in another order from then on.
        with torch.inference_mode(), torch.jit.optimized_execution(False):
            answer = module(torch.from_numpy(rows))
        if not isinstance(answer, torch.Tensor):
            refuse(f"the policy answers with a {type(answer).__name__}, expected one tensor of actions", SubmissionError)
        array: NDArray[np.floating] = answer.detach().cpu().numpy()
        return array

    return _agent(submission, task, function)


def _agent(submission: Identity, task: TaskCard, function: Function, block: int = BLOCK) -> PolicyAgent:
    """The agent around ``function``, which was tried out on a row of zeros."""
    file, columns, actions = submission.entry.name, len(task.observations), len(task.actions)
    normalise = normaliser(submission, columns)
    try:
        ask = EvenRows(function, columns, block)
        shape = ask(np.zeros((1, columns), dtype=np.float32)).shape
    except SubmissionError:
        raise
    except Exception as error:
        refuse(f"{file} fails on observations of {columns} columns, which the task shows: {last_line(error)}.", SubmissionError, error)
    if shape != (1, actions):
        refuse(f"{file} answers a row of {columns} observations with {shape[1]} numbers, the task has {actions} actions.", SubmissionError)
    return PolicyAgent(ask, normalise, actions, clip=submission.card is not None and submission.card.clip_actions)


def torchscript_complaint(file: Path) -> str | None:
    """Why ``file`` is not TorchScript, found out without loading it; ``None`` when it looks like it."""
    try:
        with opened_archive(file) as archive:
            names = archive.namelist()
    except (OSError, ValueError, zipfile.BadZipFile, NotImplementedError):  # the last: zipfile of what it cannot unpack
        return f"{file.name} is not a TorchScript file: it is not even an archive. {_HOW}"
    if any(name.endswith("/constants.pkl") for name in names) and any("/code/" in name for name in names):
        return None
    if any(name.endswith("/data.pkl") for name in names):
        return f"{file.name} holds weights or a pickled module (torch.save), which say nothing of how they are used. {_HOW}"
    return f"{file.name} is not a TorchScript file. {_HOW}"
