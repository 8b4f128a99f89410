"""Jobs, each an agent on a task, and the engines that do them: one after the other in this process, or divided among an executor's workers.

This machine prepares every job, keeps the locks, and saves. Workers compute, and send numbers and checkpoints. So nothing but Ray itself
has to be shared with them. Only agents for single runs are divided. An agent that decides for all runs at once keeps them together,
whatever it does with them. ``docs/scale.md`` shows how engines are used.
"""

from __future__ import annotations

import logging
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np

from glbench.episodes.action_log import exactly
from glbench.errors import GlbenchError
from glbench.evaluation.checkpoint import take_over
from glbench.evaluation.payload import PackedAgent, PackedTask, Payload
from glbench.evaluation.preparing import Evaluation, JointAgentError, prepare
from glbench.evaluation.records import Result
from glbench.evaluation.rollout import Progress
from glbench.evaluation.sandbox.choosing import Protected, Protection
from glbench.evaluation.saving import Computed
from glbench.execution import Executor, Future, JobContext, RayExecutor
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

    @classmethod
    def of_error(cls, job: Job, error: Exception, start: float) -> Outcome:
        """The outcome of a job that started at ``start`` and raised."""
        if isinstance(error, GlbenchError):
            reason = str(error)
        else:  # an agent's code was called; whatever it broke must not stop the others
            reason = "".join(traceback.format_exception_only(error)).strip()
            logger.debug("%s on %s failed", job.agent_name, job.task.id, exc_info=error)
        return cls(job, None, reason, time.monotonic() - start)

    @classmethod
    def of_stored(cls, job: Job, evaluation: Evaluation, start: float) -> Outcome | None:
        """The outcome of a job whose result is stored; ``None`` when it is not. Missing episodes are made."""
        if evaluation.stored is None:
            return None
        evaluation.complete_episodes(evaluation.stored)
        return cls(job, evaluation.stored, None, time.monotonic() - start, stored=True)


Report = Callable[[Job, Progress], None]
"""Called now and then with a job and its progress."""


class Engine(Protocol):
    """Does jobs."""

    def run(self, jobs: Sequence[Job], report: Report) -> Iterator[Outcome]:
        """Do the jobs; every job has one outcome, in the order in which they end. A failing job stops no other."""


class LocalEngine:
    """Does jobs in this process; what is interrupted leaves its checkpoint."""

    def run(self, jobs: Sequence[Job], report: Report) -> Iterator[Outcome]:
        """Do the jobs in their order."""
        for job in jobs:
            start = time.monotonic()
            try:
                evaluation = job.prepare()
                outcome = Outcome.of_stored(job, evaluation, start)
                if outcome is None:
                    result = evaluation.run(lambda progress, job=job: report(job, progress))  # type: ignore[misc]
                    printed = evaluation.prints.text()
                    outcome = Outcome(job, result, None, time.monotonic() - start, printed=printed)
            except Exception as error:
                outcome = Outcome.of_error(job, error, start)
            yield outcome


def split_seeds(seeds: tuple[int, ...], parts: int) -> list[tuple[int, ...]]:
    """``seeds`` in at most that many parts of nearly the same size, in their order."""
    sizes = [len(chunk) for chunk in np.array_split(np.arange(len(seeds)), min(parts, len(seeds)))]
    ends = np.cumsum(sizes).tolist()
    return [seeds[end - size : end] for size, end in zip(sizes, ends, strict=True)]


def may_be_divided(evaluation: Evaluation) -> bool:
    """Whether the agent may be one for single runs, as far as its source tells; the worker looks at the agent itself."""
    submission = evaluation.submission or evaluation.agent.submission
    if submission is None or submission.form != "python":
        return False
    return any(b"single_run" in file.read_bytes() for file in submission.all_files() if file.suffix == ".py")


def join_parts(evaluation: Evaluation, parts: Sequence[Computed]) -> Computed:
    """The whole of ``parts``, which are in the order of the seeds: the same runs, bits and digests as in one piece."""
    if len(parts) == 1:
        return replace(parts[0], trace=None)
    first = parts[0]
    log = replace(
        first.log,
        runs=tuple(run for part in parts for run in part.log.runs),
        actions=exactly(np.concatenate([part.log.actions.astype(np.float64) for part in parts], axis=1)),
        rewards=np.concatenate([part.log.rewards for part in parts], axis=1),
        final_states=np.concatenate([part.log.final_states for part in parts], axis=0),
    )
    results = [part.result for part in parts]
    records = [result.evaluation for result in results]
    resumed = [record.resumed_at_step for record in records if record.resumed_at_step is not None]
    whole = evaluation.result(
        tuple(run for result in results for run in result.runs),
        workers=len(parts),
        wall_seconds=max(record.wall_seconds for record in records),
        decision_seconds=sum(record.decision_seconds for record in records),
        resumed_at=min(resumed, default=None),
    )
    # Versions and machine are those that computed.
    there = {name: getattr(first.result, name) for name in ("versions", "machine", "git")}
    created = max(result.created for result in results)
    printed = "\n".join(part.printed for part in parts if part.printed)
    return Computed(whole.model_copy(update={**there, "created": created}), log, printed=printed)


@dataclass(frozen=True)
class RunsJob:
    """Runs of an agent on a task. ``is_part`` says that these are only some of the evaluation's runs."""

    task: PackedTask
    packed_agent: PackedAgent
    seeds: tuple[int, ...]
    is_part: bool
    protection: Protection
    agent_digest: str


def compute_runs(context: JobContext, job: RunsJob) -> Computed:
    """Compute runs on a worker, from the checkpoint in the folder of ``context`` if there is one.

    Raises
    ------
    JointAgentError
        When the agent decides for all runs at once, and these are only a part.
    GlbenchError
        When the runs cannot be computed, or this machine's numbers would differ.
    """
    with job.packed_agent.unpack() as ref:
        evaluation = prepare(
            job.task.unpack(),
            ref,
            runs=len(job.seeds),
            first_seed=job.seeds[0],
            sandbox="bubblewrap" if job.protection == "bubblewrap" else "none",
        )
        if job.agent_digest != evaluation.agent.digest:
            msg = "The agent arrived with a different digest from the one it was sent with. Did its files change while it was packed?"
            raise GlbenchError(msg)
        evaluation = replace(evaluation, checkpoints=context.folder, is_part=job.is_part)
        computed = evaluation.compute(lambda progress: context.report((progress.step, progress.alive), save=True))
    return replace(computed, trace=None)


@dataclass
class _RunningJob:
    """A job under way. ``progress`` of each part: its step, and its runs that have not failed."""

    job: Job
    evaluation: Evaluation
    start: float
    lock: ExitStack
    parts: list[tuple[int, ...]]
    futures: list[Future] = field(default_factory=list)
    computed: dict[int, Computed] = field(default_factory=dict)
    progress: dict[int, tuple[int, int]] = field(default_factory=dict)

    def submit(self, executor: Executor, report: Report) -> None:
        """Submit its parts."""
        evaluation, is_part = self.evaluation, len(self.parts) > 1
        task, agent = PackedTask.of(evaluation.task), PackedAgent.of(self.job.ref)
        self.futures, self.computed, self.progress = [], {}, {}
        for part, seeds in enumerate(self.parts):
            folder = evaluation.folder
            if folder is not None and is_part:
                folder = folder / f"runs-{seeds[0]}-{seeds[-1]}"
            job = RunsJob(task, agent, seeds, is_part, evaluation.protection, evaluation.agent.digest)
            listener = partial(self._report, report, part)
            self.futures.append(executor.submit(compute_runs, job, listener=listener, folder=folder, save=take_over))

    def _report(self, report: Report, part: int, progress: tuple[int, int]) -> None:
        """Report the progress of the job: the average over its parts, weighted by runs."""
        self.progress[part] = progress
        steps, runs, step, alive = self.job.task.steps, len(self.evaluation.seeds), 0, 0
        for index, seeds in enumerate(self.parts):
            default = (steps if index in self.computed else 0, len(seeds))
            part_step, part_alive = default if index in self.computed else self.progress.get(index, default)
            step, alive = step + part_step * len(seeds), alive + part_alive
        report(self.job, Progress(step // runs, steps, alive, runs, waiting="workers"))


class RayEngine:
    """Does jobs on the Ray cluster at ``address``, or on one that is started on this machine with ``cores`` and stopped afterwards."""

    def __init__(self, address: str | None = None, cores: int | None = None) -> None:
        self._address, self._cores = address, cores

    def run(self, jobs: Sequence[Job], report: Report) -> Iterator[Outcome]:
        """Do the jobs; outcomes come in the order in which jobs end.

        Raises
        ------
        GlbenchError
            When the cluster cannot be reached or started.
        """
        payload = Payload.of({job.task.digest: job.task for job in jobs}.values())
        cores = None if self._address is not None else self._cores
        with RayExecutor(self._address, cores, payload.unpack) as executor:
            yield from divide_jobs(executor, jobs, report)


def divide_jobs(executor: Executor, jobs: Sequence[Job], report: Report) -> Iterator[Outcome]:
    """Do jobs on the workers of an executor, and divide the runs of those that may be divided; outcomes come as jobs end."""
    running = dict[Future, _RunningJob]()
    with ExitStack() as locks:
        for job in jobs:
            start, lock = time.monotonic(), locks.enter_context(ExitStack())
            try:
                evaluation = job.prepare()
                outcome = Outcome.of_stored(job, evaluation, start)
                if outcome is None:
                    lock.enter_context(evaluation.result_lock())
                    seeds = evaluation.seeds
                    parts = split_seeds(seeds, executor.workers) if may_be_divided(evaluation) else [seeds]
                    one = _RunningJob(job, evaluation, start, lock, parts)
                    one.submit(executor, report)
                    running |= dict.fromkeys(one.futures, one)
                    continue
            except Exception as error:
                outcome = Outcome.of_error(job, error, start)
            lock.close()
            yield outcome
        for future in executor.as_completed():
            one = running[future]
            try:
                outcome = _take_part(executor, one, future, report)
            except Exception as error:
                outcome = Outcome.of_error(one.job, error, one.start)
            running |= dict.fromkeys(one.futures, one)
            if outcome is not None:
                for other in one.futures:
                    executor.cancel(other)
                one.lock.close()
                yield outcome


def _take_part(executor: Executor, one: _RunningJob, future: Future, report: Report) -> Outcome | None:
    """Take a part that has ended; the outcome of the job if this was the last one."""
    try:
        one.computed[one.futures.index(future)] = future.result()
    except JointAgentError:
        # The source mentions single runs, but the agent decides for all at once: compute them together.
        for other in one.futures:
            executor.cancel(other)
        one.parts = [one.evaluation.seeds]
        one.submit(executor, report)
    if len(one.computed) < len(one.parts):
        return None
    whole = join_parts(one.evaluation, [one.computed[part] for part in range(len(one.parts))])
    result = one.evaluation.save(whole)
    return Outcome(one.job, result, None, time.monotonic() - one.start, printed=whole.printed)
