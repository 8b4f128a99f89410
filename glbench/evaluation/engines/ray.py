"""Jobs on a Ray cluster: plain remote tasks, one for each share of an evaluation's runs, tried again when a worker is lost.

This machine prepares every job, keeps the locks, and saves. Workers compute, and send numbers and checkpoints. So nothing but Ray itself
has to be shared with them. Only agents for single runs are divided. An agent that decides for all runs at once keeps them together,
whatever it does with them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from glbench.agents.identity import baseline_names, files_of_folder, identify
from glbench.episodes.action_log import exactly
from glbench.errors import GlbenchError, SubmissionError
from glbench.evaluation.checkpoint import take_over
from glbench.evaluation.engines.cluster import (
    LOOK_SECONDS,
    TRIES,
    Cluster,
    News,
    Teller,
    board_of,
    cores_of,
    in_words,
    one_thread,
    read_files,
    write_files,
)
from glbench.evaluation.engines.local import Job, Outcome, Report, failed
from glbench.evaluation.engines.luggage import Luggage, PackedTask
from glbench.evaluation.files import Scratch
from glbench.evaluation.preparing import Evaluation, JointAgentError, prepare
from glbench.evaluation.rollout import Progress
from glbench.evaluation.sandbox.choosing import Protection
from glbench.evaluation.saving import Computed


@dataclass(frozen=True)
class PackedAgent:
    """An agent on its way: the name of a baseline, or the files of a submission. ``name`` is that of its file or folder."""

    name: str
    files: tuple[tuple[str, bytes], ...] = ()
    is_folder: bool = False

    @classmethod
    def of(cls, ref: str) -> PackedAgent:
        """Pack the agent ``ref``.

        Raises
        ------
        SubmissionError
            When its files cannot be read.
        """
        if ref in baseline_names():
            return cls(ref)
        path = Path(ref).expanduser().resolve()
        identity = identify(path)
        own = identity.files if identity is not None else ()
        root = path.parent if own else path
        try:
            files = [(file.relative_to(root).as_posix(), file.read_bytes()) for file in own or files_of_folder(path)]
        except OSError as error:
            msg = f"The submission {path} cannot be packed: {error}. Check that its files exist and may be read."
            raise SubmissionError(msg) from error
        return cls(path.name, tuple(files), is_folder=not own)

    @contextmanager
    def unpacked(self) -> Iterator[str]:
        """The agent as ``prepare`` takes it; the files are gone afterwards."""
        if not self.files:
            yield self.name
            return
        scratch = Scratch()
        try:
            root = scratch.folder() / self.name if self.is_folder else scratch.folder()
            for name, content in self.files:
                file = root / PurePosixPath(name)
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_bytes(content)
            yield str(scratch.folder() / self.name)
        finally:
            scratch.remove()


def divided(seeds: tuple[int, ...], parts: int) -> list[tuple[int, ...]]:
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


def put_together(evaluation: Evaluation, parts: Sequence[Computed]) -> Computed:
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


@dataclass(frozen=True)
class Refusal:
    """Why there are no numbers, in words. ``joint``: the agent decides for all runs at once, so they cannot be divided."""

    reason: str
    joint: bool = False


def work(job: RunsJob, progress: Callable[[Progress], None], checkpoints: Path | None = None) -> Computed | Refusal:
    """Do what was ordered, from the checkpoint in ``checkpoints`` if there is one. Errors of glbench come back as text."""
    # Numerical libraries would start a thread a core in each of several workers on one machine, and round by their number.
    one_thread()
    try:
        with job.packed_agent.unpacked() as ref:
            evaluation = prepare(
                job.task.unpacked(),
                ref,
                runs=len(job.seeds),
                first_seed=job.seeds[0],
                sandbox="bubblewrap" if job.protection == "bubblewrap" else "none",
            )
            if job.agent_digest != evaluation.agent.digest:
                return Refusal(
                    "The agent arrived with a different digest from the one it was sent with. Did its files change while it was packed?"
                )
            computed = replace(evaluation, checkpoints=checkpoints, is_part=job.is_part).compute(progress)
    except JointAgentError as error:
        return Refusal(str(error), joint=True)
    except GlbenchError as error:
        return Refusal(str(error))
    return replace(computed, trace=None)


class RayEngine:
    """Does jobs on the cluster at ``address``, or on one that is started on this machine with ``cores`` and stopped afterwards."""

    def __init__(self, address: str | None = None, cores: int | None = None) -> None:
        self._cluster = Cluster(address, cores)

    def run(self, jobs: Sequence[Job], report: Report) -> Iterator[Outcome]:
        """Do the jobs; outcomes come in the order in which jobs end.

        Raises
        ------
        GlbenchError
            When the cluster cannot be reached or started.
        """
        with self._cluster.connected() as ray:
            yield from _Session(ray, report).run(jobs)


@dataclass
class _Running:
    """A job under way: its parts, those that are there, and how far the others are."""

    job: Job
    evaluation: Evaluation
    luggage: Any
    began: float
    lock: ExitStack
    parts: list[tuple[int, ...]]
    done: dict[int, Computed] = field(default_factory=dict)
    references: dict[Any, int] = field(default_factory=dict)

    def folder(self, part: int) -> Path | None:
        """Where the checkpoint of a part is kept on this machine, if anything is."""
        folder, seeds = self.evaluation.folder, self.parts[part]
        return folder if folder is None or len(self.parts) == 1 else folder / f"runs-{seeds[0]}-{seeds[-1]}"


class _Session:
    """All jobs of one call of ``run``."""

    def __init__(self, ray: Any, report: Report) -> None:
        self._ray, self._report = ray, report
        self._work = ray.remote(num_cpus=1, max_retries=TRIES)(_work)
        self._board = board_of(ray)
        self._cores = cores_of(ray)
        self._running: dict[int, _Running] = {}

    def run(self, jobs: Sequence[Job]) -> Iterator[Outcome]:
        """Send all jobs, then take what comes back."""
        luggage = self._ray.put(Luggage.of({job.task.digest: job.task for job in jobs}.values()))
        try:
            for number, job in enumerate(jobs):
                outcome = self._begun(number, job, luggage)
                if outcome is not None:
                    yield outcome
            while self._running:
                yield from self._returned()
                self._tell()
        finally:
            for running in self._running.values():
                running.lock.close()

    def _begun(self, number: int, job: Job, luggage: Any) -> Outcome | None:
        """Send a job, unless its outcome is known already."""
        began, lock = time.monotonic(), ExitStack()
        try:
            evaluation = job.prepare()
            if evaluation.stored is not None:
                evaluation.complete_episodes(evaluation.stored)
                return Outcome(job, evaluation.stored, None, time.monotonic() - began, stored=True)
            lock.enter_context(evaluation.result_lock())
            parts = divided(evaluation.seeds, self._cores) if may_be_divided(evaluation) else [evaluation.seeds]
            running = _Running(job, evaluation, luggage, began, lock, parts)
            self._send(number, running)
        except Exception as error:
            lock.close()
            return failed(job, error, began)
        self._running[number] = running
        return None

    def _send(self, number: int, running: _Running) -> None:
        evaluation, job = running.evaluation, running.job
        task, packed_agent = PackedTask.of(evaluation.task), PackedAgent.of(job.ref)
        for part, seeds in enumerate(running.parts):
            key, folder = _key(number, seeds), running.folder(part)
            if folder is not None and (files := read_files(folder)) is not None:
                self._ray.get(self._board.leave.remote(key, files))
            is_part = len(running.parts) > 1
            runs_job = RunsJob(task, packed_agent, seeds, is_part, evaluation.protection, evaluation.agent.digest)
            running.references[self._work.remote(runs_job, running.luggage, self._board, key)] = part

    def _returned(self) -> Iterator[Outcome]:
        """Take the parts that are there; the jobs that are whole or have failed are outcomes."""
        waiting = {reference: number for number, running in self._running.items() for reference in running.references}
        ready, _ = self._ray.wait(list(waiting), num_returns=1, timeout=LOOK_SECONDS)
        for reference in ready:
            number = waiting[reference]
            running = self._running.get(number)
            if running is None or reference not in running.references:
                continue
            part = running.references.pop(reference)
            try:
                outcome = self._taken(number, running, part, self._ray.get(reference))
            except Exception as error:
                outcome = failed(running.job, in_words(error), running.began)
            if outcome is not None:
                self._forget(number)
                yield outcome

    def _taken(self, number: int, running: _Running, part: int, given: Computed | Refusal) -> Outcome | None:
        if isinstance(given, Refusal):
            if not given.joint:
                return Outcome(running.job, None, given.reason, time.monotonic() - running.began)
            # The source spoke of single runs, and the agent is none: all runs together, then.
            for reference in running.references:
                self._ray.cancel(reference)
            running.references, running.parts, running.done = {}, [running.evaluation.seeds], {}
            self._send(number, running)
            return None
        running.done[part] = given
        if len(running.done) < len(running.parts):
            return None
        whole = put_together(running.evaluation, [running.done[index] for index in range(len(running.parts))])
        result = running.evaluation.save(whole)
        return Outcome(running.job, result, None, time.monotonic() - running.began, printed=whole.printed)

    def _forget(self, number: int) -> None:
        running = self._running.pop(number)
        for reference in running.references:
            with suppress(Exception):  # one that has ended already cannot be cancelled, which is as good
                self._ray.cancel(reference)
        running.lock.close()

    def _tell(self) -> None:
        """Keep checkpoints, and report the progress of jobs: the average over their parts, weighted by runs."""
        keys = [_key(number, seeds) for number, running in self._running.items() for seeds in running.parts]
        told: dict[str, News] = self._ray.get(self._board.news.remote(keys))
        for number, running in self._running.items():
            steps, runs = running.job.task.steps, len(running.evaluation.seeds)
            done, alive = 0, 0
            for part, seeds in enumerate(running.parts):
                news, folder = told.get(_key(number, seeds), News()), running.folder(part)
                if news.files is not None and folder is not None and part not in running.done:
                    take_over(folder, news.files)
                step, living = (steps, len(seeds)) if part in running.done else news.standing or (0, len(seeds))
                done, alive = done + step * len(seeds), alive + living
            self._report(running.job, Progress(done // runs, steps, alive, runs, waiting="workers"))


def _key(number: int, seeds: tuple[int, ...]) -> str:
    """The board's key for a part of a job."""
    return f"{number}/{seeds[0]}-{seeds[-1]}"


def _work(job: RunsJob, luggage: Luggage, board: Any, key: str) -> Computed | Refusal:
    """``work`` as a remote task, which reports its progress to the board and leaves its checkpoints there."""
    luggage.unpack()
    teller, scratch = Teller(board, key), Scratch()
    try:
        folder = scratch.folder() / "checkpoint"
        write_files(folder, teller.begin())
        return work(job, lambda standing: teller.stand((standing.step, standing.alive), folder), folder)
    finally:
        scratch.remove()
