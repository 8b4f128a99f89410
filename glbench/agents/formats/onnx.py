"""An ONNX file: observations (n, columns) in, actions (n, actions) out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glbench.agents.formats.normalising import normaliser
from glbench.agents.formats.packages import need
from glbench.agents.formats.policy import PolicyAgent, check_answer
from glbench.agents.formats.rows import BLOCK, EvenRows, Rows
from glbench.agents.isolation import last_line
from glbench.errors import SubmissionError

if TYPE_CHECKING:
    from glbench.agents.identity import Identity
    from glbench.tasks import TaskCard

_KINDS: dict[str, type[np.floating]] = {"tensor(float)": np.float32, "tensor(double)": np.float64}
_ONLY_ERRORS = 3


def onnx_agent(submission: Identity, task: TaskCard) -> PolicyAgent:
    """The agent of an ONNX file, run on one thread of the processor.

    Raises
    ------
    SubmissionError
        When onnxruntime is missing, the file is no ONNX, or the policy does not fit the task.
    """
    file = submission.entry
    runtime = need("onnxruntime", f"The ONNX policy {file.name}")
    columns, actions = len(task.observations), len(task.actions)
    # onnxruntime has error types of its own below Exception, and names none of them in its interface.
    try:
        session = _session(runtime, str(file))
    except Exception as error:
        msg = f"{file.name} cannot be loaded as ONNX: {last_line(error)}."
        raise SubmissionError(msg) from error
    block, kind, name = _input(session, columns, file.name)
    normalise = normaliser(submission, columns)
    try:
        ask = EvenRows(_function(session, name, kind), columns, block)
        check_answer(ask, columns, actions, file.name)
    except SubmissionError:
        raise
    except Exception as error:
        msg = f"{file.name} fails on observations of {columns} columns, which the task shows: {last_line(error)}."
        raise SubmissionError(msg) from error
    return PolicyAgent(ask, normalise, actions, clip=submission.card is not None and submission.card.clip_actions)


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
