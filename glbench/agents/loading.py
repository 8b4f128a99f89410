"""From a path or a name to an agent that can be run: ``load_agent``.

A submission is a Python file with a function ``make_agent(task)``, a saved policy, or a folder with one of the two (``identity.py`` tells
them apart). A baseline is a name; its data lie in ``baselines/<name>``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from glbench.agents.identity import (
    EXPECTED,
    FORMS,
    OBSERVATIONS_ONLY,
    Identity,
    baseline_names,
    is_built_in,
    name_of,
    path_of,
    read_identity,
)
from glbench.agents.protocol import Agent, PrivilegedController
from glbench.errors import SubmissionError, did_you_mean
from glbench.resources import data_folder

if TYPE_CHECKING:
    from glbench.agents.baselines import Baseline
    from glbench.tasks import TaskCard


@dataclass(frozen=True)
class LoadedAgent:
    """An agent, ready to be made for a task."""

    name: str
    """Name in results: the baseline's, or that of the submission's file or folder."""
    kind: Literal["submission", "baseline"]
    digest: str
    """SHA-256 (hex) over the submission's files; for a baseline over its settings and the code of its rules."""
    privileged: bool
    """Whether it is a ``PrivilegedController``; submissions never are."""
    information: str
    """What it sees, in words."""
    make: Callable[[TaskCard], Agent | PrivilegedController] = field(repr=False)
    """Makes the agent for a task; raises ``SubmissionError`` when that fails."""
    submission: Identity | None = None
    """Its files, form and card; ``None`` for a controller of glbench."""


def load_agent(ref: str | Path) -> LoadedAgent:
    """Load the agent that ``ref`` names. Of a Python submission the file is run; a saved policy is opened when the agent is made.

    Parameters
    ----------
    ref : str or Path
        Name of a baseline, or path of a submission: a Python file, a saved policy, or a folder with ``agent.py``, with a saved policy,
        or with ``card.toml`` (settings of one's own for a built-in controller).

    Raises
    ------
    SubmissionError
        When there is no such thing, or it cannot be loaded; the message says what to do.
    """
    if isinstance(ref, str) and ref in baseline_names():
        return _baseline(ref, ref, "baseline")
    path = find_submission(ref)
    if is_built_in(path):
        return _baseline(path, name_of(path), "submission")
    submission = read_identity(path)
    make = _maker(submission)
    return LoadedAgent(submission.name, "submission", submission.digest, False, OBSERVATIONS_ONLY, make, submission)


def _maker(submission: Identity) -> Callable[[TaskCard], Agent]:
    # Neither at the top: the process of an agent loads what its own form needs.
    if submission.form == "python":
        from glbench.agents.python_agent import python_maker

        return python_maker(submission)
    from glbench.agents.formats import policy_agent

    return lambda task: policy_agent(submission, task)


def find_submission(ref: str | Path) -> Path:
    """The file or folder ``ref``, which is no name of a baseline.

    Raises
    ------
    SubmissionError
        When there is no such thing.
    """
    path = path_of(ref)
    if not path.is_dir() and not path.is_file():
        raise SubmissionError(_nothing_there(str(ref), path))
    return path


def _baseline(ref: str | Path, name: str, kind: Literal["submission", "baseline"]) -> LoadedAgent:
    # Not at the top: a submission can be loaded without what the built-in controllers need.
    from glbench.agents.baselines import read_baseline

    baseline: Baseline = read_baseline(ref)
    return LoadedAgent(name, kind, baseline.digest, baseline.privileged, baseline.information, baseline.make)


def _nothing_there(ref: str, path: Path) -> str:
    known = baseline_names()
    if path.suffix in FORMS or len(path.parts) > 1:
        beside = [item.name for item in path.parent.iterdir() if item.suffix in FORMS] if path.parent.is_dir() else []
        near = did_you_mean(path.name, beside, list_few=False)
        if (data_folder("submissions") / path.name).is_file():
            return (
                f"There is no file {path}. An example of that name comes with glbench: "
                f"`glbench submit new {path.parent} --kind example` writes it, and the other examples."
            )
        return f"There is no file or folder {path}.{near} {EXPECTED}."
    return (
        f"'{ref}' is neither a file or folder here nor a baseline.{did_you_mean(ref, known, list_few=False)} "
        f"Baselines: {', '.join(known)}. A submission is named by its path, such as submissions/my_agent.py."
    )
