"""A TorchScript file: observations (n, columns) float32 in, actions (n, actions) out."""

from __future__ import annotations

import zipfile
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glbench.agents.formats.archives import opened_archive
from glbench.agents.formats.normalising import normaliser
from glbench.agents.formats.packages import need
from glbench.agents.formats.policy import PolicyAgent, check_answer
from glbench.agents.formats.quiet import without_warnings
from glbench.agents.formats.rows import EvenRows, Rows
from glbench.agents.isolation import last_line
from glbench.errors import SubmissionError

if TYPE_CHECKING:
    from pathlib import Path

    from glbench.agents.identity import Identity
    from glbench.tasks import TaskCard


def torchscript_agent(submission: Identity, task: TaskCard) -> PolicyAgent:
    """The agent of a TorchScript file; torch uses one thread from here on, since bits depend on the number of threads.

    Raises
    ------
    SubmissionError
        When torch is missing, the file is no TorchScript, or the policy does not fit the task.
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
    columns, actions = len(task.observations), len(task.actions)
    normalise = normaliser(submission, columns)
    try:
        ask = EvenRows(_function(torch, module), columns)
        check_answer(ask, columns, actions, file.name)
    except RuntimeError as error:
        msg = f"{file.name} fails on observations of {columns} columns, which the task shows: {last_line(error)}."
        raise SubmissionError(msg) from error
    return PolicyAgent(ask, normalise, actions, clip=submission.card is not None and submission.card.clip_actions)


def torchscript_complaint(file: Path) -> str | None:
    """Why ``file`` is no TorchScript, in words, found out without loading it; ``None`` when it looks like it."""
    try:
        with opened_archive(file) as archive:
            names = archive.namelist()
    except (OSError, ValueError, zipfile.BadZipFile, NotImplementedError):  # the last: zipfile of what it cannot unpack
        return f"{file.name} is no TorchScript file: it is no archive at all. {_HOW}"
    if any(name.endswith("/constants.pkl") for name in names) and any("/code/" in name for name in names):
        return None
    if any(name.endswith("/data.pkl") for name in names):
        return f"{file.name} holds weights or a pickled module (torch.save), which say nothing of how they are used. {_HOW}"
    return f"{file.name} is no TorchScript file. {_HOW}"


_HOW = (
    'Write one with: torch.jit.script(policy).save("policy.pt"), or torch.jit.trace(policy, example).save("policy.pt").'
)


def _function(torch: Any, module: Any) -> Any:
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
