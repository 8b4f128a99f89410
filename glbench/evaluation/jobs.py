"""Jobs, each an agent on a task, and the engines that do them: one after the other in this process, or divided among an executor's workers.

This machine prepares every job, keeps the locks, and saves. Workers compute, and send numbers and checkpoints. So nothing but Ray itself
has to be shared with them. Only agents for single runs are divided. An agent that decides for all runs at once keeps them together,
whatever it does with them. ``docs/scale.md`` shows how engines are used.
"""

from __future__ import annotations

import hashlib
import logging
import os
import platform
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Protocol

import numpy as np

from glbench import __version__
from glbench.agents.identity import baseline_names, files_of_folder, identify
from glbench.env.kernels import shared_kernel
from glbench.episodes.action_log import exactly
from glbench.episodes.header import definition_json, task_of
from glbench.errors import GlbenchError, SubmissionError, refuse
from glbench.evaluation.checkpoint import take_over
from glbench.evaluation.evaluation import Evaluation, JointAgentError, prepare
from glbench.evaluation.records import Result
from glbench.evaluation.rollout import Progress
from glbench.evaluation.sandbox.choosing import Protected, Protection, SandboxChoice
from glbench.evaluation.saving import Computed
from glbench.execution import Executor, Future, JobContext, RayExecutor, write_files
from glbench.kernel import built_libraries, why_not_compiled
from glbench.resources import Scratch, cache_folder, write_atomically
from glbench.tasks import TaskSpec
from glbench.weather import user_file

_CACHE = "travelled"  # Cache folder for files received from another machine
_FEATURES = ("flags", "Features")  # Linux's name for the line that lists a processor's features, on x86-64 and on AArch64


@dataclass(frozen=True)
class PackedTask:
    """A task in one of its splits, and what would change numbers if it differed: its digest, the kernel, the version of glbench."""

    definition: bytes
    split: str
    digest: str
    kernel: Mapping[str, str | float]
    version: str = __version__
    sealed: str = field(default="", repr=False)
    """The secret of the round, if there is one: it is sent to the workers, but never written by them."""

    @classmethod
    def of(cls, task: TaskSpec) -> PackedTask:
        """Pack a task."""
        kernel = shared_kernel(task.model_value, task.step_seconds).describe()
        return cls(definition_json(task), task.split or "", task.digest, kernel, sealed=task.sealed)

    def unpack(self) -> TaskSpec:
        """The task. Raises ``GlbenchError`` when this machine's numbers would differ from those of the machine that packed it."""
        if self.version != __version__:
            msg = f"The worker has glbench {__version__}, this machine {self.version}. Install the same version on all machines."
            raise GlbenchError(msg)
        task = task_of(self.definition)
        task = task.in_split(self.split, self.sealed) if self.split else task
        if self.digest != task.digest:
            msg = "The worker's weather, parameters or model differ from those of this machine: the task has a different digest there."
            raise GlbenchError(msg)
        kernel = shared_kernel(task.model_value, task.step_seconds).describe()
        if dict(self.kernel) != kernel:
            reason = why_not_compiled(task.model_value) or f"It has {kernel}."
            refuse(f"The worker's kernel differs from this machine's, which would change the numbers. {reason}", GlbenchError)
        return task


@dataclass(frozen=True)
class PackedAgent:
    """An agent to be sent: the name of a baseline, or the files of a submission. ``name`` is that of its file or folder."""

    name: str
    files: tuple[tuple[str, bytes], ...] = ()
    is_folder: bool = False

    @classmethod
    def of(cls, ref: str) -> PackedAgent:
        """Pack the agent ``ref``. Raises ``SubmissionError`` when its files cannot be read."""
        if ref in baseline_names():
            return cls(ref)
        path = Path(ref).expanduser().resolve()
        identity = identify(path)
        own = identity.files if identity is not None else ()
        root = path.parent if own else path
        try:
            files = [(file.relative_to(root).as_posix(), file.read_bytes()) for file in own or files_of_folder(path)]
        except OSError as error:
            refuse(f"The submission {path} cannot be packed: {error}. Check that its files exist and may be read.", SubmissionError, error)
        return cls(path.name, tuple(files), is_folder=not own)

    @contextmanager
    def unpack(self) -> Iterator[str]:
        """The agent as ``prepare`` takes it; the files are gone afterwards."""
        if not self.files:
            yield self.name
            return
        scratch = Scratch()
        try:
            root = scratch.folder() / self.name if self.is_folder else scratch.folder()
            write_files(root, dict(self.files))
            yield str(scratch.folder() / self.name)
        finally:
            scratch.remove()


@dataclass(frozen=True)
class Payload:
    """Files of this machine that tasks need, by the names that they need: weather that the user imported, and the compiled kernels.

    ``processor`` has the features of the processor that the kernels were compiled for.
    """

    weather: Mapping[str, bytes]
    kernels: Mapping[str, bytes]
    processor: frozenset[str]

    @classmethod
    def of(cls, tasks: Iterable[TaskSpec], *, for_plans: bool = False) -> Payload:
        """What ``tasks`` need; ``for_plans`` kernels are built first, derivatives included.

        Raises ``GlbenchError`` when a file cannot be read, or a task's weather is not there.
        """
        from glbench.control.stage import judged_at_the_end  # not at the top: it brings the optimisers

        weather, kernels = dict[str, Path](), dict[str, Path]()
        for task in tasks:
            for name in {task.record().name, task.season_record().name}:
                file = user_file(name)
                if file is not None:
                    weather[file.name] = file
            # Planning leaves out the meters of violations (docs/control.md), which makes it a different model.
            for one in (task, judged_at_the_end(task)):
                kernels |= built_libraries(one.model_value, one.parameters(), for_plans=for_plans)
        try:
            return cls(
                {name: file.read_bytes() for name, file in sorted(weather.items())},
                {name: file.read_bytes() for name, file in sorted(kernels.items())},
                processor(),
            )
        except OSError as error:
            msg = f"Cannot pack the files that the workers need: {error}. Check that the file exists and may be read."
            raise GlbenchError(msg) from error

    def unpack(self) -> None:
        """Make this process use the files. Kernels are used only if the processor has all features that they may use.

        They are kept in the cache under their digest, and all processes of a machine share them.
        """
        if self.weather:
            os.environ["GLBENCH_DATA"] = str(_cached({f"weather/{name}": file for name, file in self.weather.items()}))
        if self.kernels and self.processor <= processor():
            os.environ["GLBENCH_KERNELS"] = str(_cached(self.kernels))


def _cached(files: Mapping[str, bytes]) -> Path:
    """The folder in the cache that holds ``files``."""
    digest = hashlib.sha256()
    for name, content in files.items():
        digest.update(f"{name} {hashlib.sha256(content).hexdigest()}\n".encode())
    folder = cache_folder() / _CACHE / digest.hexdigest()[:20]
    for name, content in files.items():
        file = folder / name
        if not file.is_file() or file.read_bytes() != content:
            write_atomically(file, content)
    return folder


@cache
def processor() -> frozenset[str]:
    """The kind of system and processor, and the processor's features as far as the system lists them."""
    facts = {sys.platform, platform.machine()}
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:  # another system: only the very same processor will do
        return frozenset({*facts, platform.processor(), platform.node()})
    return frozenset({*facts, *(next((line for line in lines if line.startswith(_FEATURES)), "")).partition(":")[2].split()})


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
        """The outcome of a job whose result is stored; ``None`` when it is not. A missing profile and missing episodes are made."""
        if evaluation.stored is None:
            return None
        evaluation.complete(evaluation.stored)
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

    Raises ``JointAgentError`` when the agent decides for all runs at once, and these are only a part, and ``GlbenchError`` when the runs
    cannot be computed, or this machine's numbers would differ.
    """
    with job.packed_agent.unpack() as ref:
        sandbox: SandboxChoice = "bubblewrap" if job.protection == "bubblewrap" else "none"
        evaluation = prepare(job.task.unpack(), ref, runs=len(job.seeds), first_seed=job.seeds[0], sandbox=sandbox)
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
        """Do the jobs; outcomes come in the order in which jobs end. Raises ``GlbenchError`` when no cluster can be reached or started."""
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
    return Outcome(one.job, one.evaluation.save(whole), None, time.monotonic() - one.start, printed=whole.printed)
