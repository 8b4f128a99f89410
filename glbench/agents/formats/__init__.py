"""Saved policies that are submissions without code: Stable-Baselines3, TorchScript, ONNX.

Each form has a file with one function ``*_agent(submission, task)``. torch, Stable-Baselines3 and onnxruntime are imported when such an
agent is made, and never before.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from glbench.agents.formats.exported import onnx_agent, torchscript_agent
from glbench.agents.formats.sb3 import sb3_agent

if TYPE_CHECKING:
    from glbench.agents.formats.policy import PolicyAgent
    from glbench.agents.identity import Identity
    from glbench.tasks import TaskCard

_MAKERS = {"sb3": sb3_agent, "torchscript": torchscript_agent, "onnx": onnx_agent}


def policy_agent(submission: Identity, task: TaskCard) -> PolicyAgent:
    """The agent of a saved policy.

    Raises
    ------
    SubmissionError
        When a package is missing, the file cannot be used, or it does not fit the task.
    """
    return _MAKERS[submission.form](submission, task)


__all__ = ["policy_agent"]
