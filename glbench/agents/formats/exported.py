"""Policies as files of a runtime, ONNX and TorchScript: observations (n, columns) float32 in, actions (n, actions) out."""

from __future__ import annotations

import zipfile
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glbench.agents.formats.packages import need
from glbench.agents.formats.policy import (
    BLOCK,
    EvenRows,
    Function,
    PolicyAgent,
    Rows,
    normaliser,
    without_warnings,
)
from glbench.errors import SubmissionError, last_line
from glbench.untrusted import opened_archive

if TYPE_CHECKING:
    from pathlib import Path

    from glbench.agents.identity import Identity
    from glbench.tasks import TaskCard


_KINDS: dict[str, type[np.floating]] = {"tensor(float)": np.float32, "tensor(double)": np.float64}
_ONLY_ERRORS = 3
_HOW = (
    'Write one with: torch.jit.script(policy).save("policy.pt"), or torch.jit.trace(policy, example).save("policy.pt").'
)


def onnx_agent(submission: Identity, task: TaskCard) -> PolicyAgent:
    """The agent of an ONNX file, run on one thread of the processor.

    Raises
    ------
    SubmissionError
        When onnxruntime is missing, the file is no ONNX, or the policy does not fit the task.
    """
    file = submission.entry
    runtime = need("onnxruntime", f"The ONNX policy {file.name}")
    # onnxruntime has error types of its own below Exception, and names none of them in its interface.
    try:
        session = _session(runtime, str(file))
    except Exception as error:
        msg = f"{file.name} cannot be loaded as ONNX: {last_line(error)}."
        raise SubmissionError(msg) from error
    block, kind, name = _input(session, len(task.observations), file.name)
    return _agent(submission, task, _function(session, name, kind), block)


def _session(runtime: Any, file: str) -> Any:
    options = runtime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.execution_mode = runtime.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = _ONLY_ERRORS
    return runtime.InferenceSession(file, options, providers=["CPUExecutionProvider"])


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
    found = inputs[0]
    if found.type not in _KINDS:
        msg = f"{file} takes {found.type}, expected tensor(float) of shape (rows, {columns})."
        raise SubmissionError(msg)
    shape = list(found.shape)
    if len(shape) != 2 or (isinstance(shape[1], int) and shape[1] != columns):
        wanted = f"({', '.join(str(size) for size in shape)})"
        msg = (
            f"{file} takes observations of shape {wanted}, the task shows (rows, {columns}): "
            "it was made for another task or other observations."
        )
        raise SubmissionError(msg)
    return (shape[0] if isinstance(shape[0], int) and shape[0] > 0 else BLOCK), _KINDS[found.type], found.name


def _function(session: Any, name: str, kind: type[np.floating]) -> Any:
    output = session.get_outputs()[0].name

    def function(rows: Rows) -> NDArray[np.floating]:
        answer: NDArray[np.floating] = np.asarray(session.run([output], {name: rows.astype(kind, copy=False)})[0])
        return answer

    return function


def torchscript_agent(submission: Identity, task: TaskCard) -> PolicyAgent:
    """The agent of a TorchScript file; torch uses one thread from here on, since bits depend on the number of threads.

    Raises
    ------
    SubmissionError
        When torch is missing, the file is not TorchScript, or the policy does not fit the task.
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
        msg = f"{file.name} cannot be loaded as TorchScript: {last_line(error)}."
        raise SubmissionError(msg) from error
    return _agent(submission, task, _torch_function(torch, module))


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
        msg = f"{file} fails on observations of {columns} columns, which the task shows: {last_line(error)}."
        raise SubmissionError(msg) from error
    if shape != (1, actions):
        msg = f"{file} answers a row of {columns} observations with {shape[1]} numbers, the task has {actions} actions."
        raise SubmissionError(msg)
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


def _torch_function(torch: Any, module: Any) -> Any:
    def function(rows: Rows) -> NDArray[np.floating]:
        # The optimising executor compiles after the first calls, and may add up in another order from then on.
        with torch.inference_mode(), torch.jit.optimized_execution(False):
            answer = module(torch.from_numpy(rows))
        if not isinstance(answer, torch.Tensor):
            msg = f"the policy answers with a {type(answer).__name__}, expected one tensor of actions"
            raise SubmissionError(msg)
        array: NDArray[np.floating] = answer.detach().cpu().numpy()
        return array

    return function
