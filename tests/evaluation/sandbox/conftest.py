"""Agents in a sandbox, on machines that can build one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from glbench.evaluation import Evaluation, Result, TimeLimits, prepare
from glbench.evaluation.sandbox.bubblewrap import why_no_sandbox
from glbench.tasks import TaskSpec


@pytest.fixture
def needs_sandbox() -> None:
    """Skip where there can be no sandbox, and say why."""
    reason = why_no_sandbox()
    if reason is not None:
        pytest.skip(reason)


Prepare = Callable[..., Evaluation]


@pytest.fixture
def sandboxed(needs_sandbox: None, day_task: TaskSpec) -> Prepare:
    """Prepare an evaluation of the day task in a sandbox."""

    def prepared(agent: Path, *, out: Path | None = None, **arguments: object) -> Evaluation:
        arguments.setdefault("limits", TimeLimits(start=120.0, step=10.0, run=600.0))
        return prepare(day_task, agent, out=out, sandbox="bubblewrap", **arguments)  # type: ignore[arg-type]

    return prepared


def ends(result: Result) -> list[tuple[str, int]]:
    """How every run ended, and after how many steps."""
    return [(run.status, run.steps) for run in result.runs]
