"""What an engine is given and what it gives back: jobs (an agent on a task) and their outcomes; and the engine of this machine."""

from __future__ import annotations

import logging
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from glbench.errors import GlbenchError
from glbench.evaluation.preparing import Evaluation, prepare
from glbench.evaluation.records import Result
from glbench.evaluation.rollout import Progress
from glbench.evaluation.sandbox.choosing import Protected
from glbench.tasks import TaskSpec

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Options:
    """What holds for all jobs; arguments of ``prepare``."""

    out: Path
    runs: int | None = None
    first_seed: int | None = None
    workers: int | None = None
    fresh: bool = False
    episodes: str = "none"


@dataclass(frozen=True)
class Job:
    """An agent on a task. ``ref`` is the agent's path or name as it was given."""

    task: TaskSpec
    ref: str
    agent: Protected
    options: Options

    @property
    def agent_name(self) -> str:
        """Name of the agent in results."""
        return self.agent.agent.name

    def prepare(self) -> Evaluation:
        """The evaluation, with the stored result if it is there and current. Errors as for ``glbench.evaluation.prepare``."""
        return prepare(self.task, self.agent, **vars(self.options))


@dataclass(frozen=True)
class Outcome:
    """How a job ended: with a ``result`` (``stored``: it was there already), or with the reason in words why there is none.

    ``printed`` is what a sandboxed agent printed, as far as it is kept.
    """

    job: Job
    result: Result | None
    reason: str | None
    seconds: float
    stored: bool = False
    printed: str = ""


Report = Callable[[Job, Progress], None]
"""Told, now and then, where a job stands."""


class Engine(Protocol):
    """Something that does jobs."""

    def run(self, jobs: Sequence[Job], report: Report) -> Iterator[Outcome]:
        """Do the jobs; every job has one outcome, in the order in which they end. A failing job stops no other."""


def failed(job: Job, error: Exception, began: float) -> Outcome:
    """The outcome of a job that raised."""
    if isinstance(error, GlbenchError):
        reason = str(error)
    else:  # code of strangers was near; whatever it broke must not stop the others
        reason = "".join(traceback.format_exception_only(error)).strip()
        logger.debug("%s on %s failed", job.agent_name, job.task.id, exc_info=error)
    return Outcome(job, None, reason, time.monotonic() - began)


class LocalEngine:
    """Does jobs in this process; what is interrupted leaves its checkpoint."""

    def run(self, jobs: Sequence[Job], report: Report) -> Iterator[Outcome]:
        """Do the jobs in their order."""
        for job in jobs:
            began = time.monotonic()
            try:
                outcome = _done(job, report, began)
            except Exception as error:
                outcome = failed(job, error, began)
            yield outcome


def _done(job: Job, report: Report, began: float) -> Outcome:
    evaluation = job.prepare()
    if evaluation.stored is not None:
        evaluation.complete_episodes(evaluation.stored)
        return Outcome(job, evaluation.stored, None, time.monotonic() - began, stored=True)
    result = evaluation.run(lambda standing: report(job, standing))
    return Outcome(job, result, None, time.monotonic() - began, printed=evaluation.prints.text())
