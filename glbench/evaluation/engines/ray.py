"""Jobs on a Ray cluster: plain remote tasks, one for each share of an evaluation's runs, tried again when a worker is lost.

This machine prepares every job, keeps the locks, and saves. Workers compute and send numbers. So nothing but Ray itself has to be shared
with them; a disk that happens to be shared is used for checkpoints. Only agents for single runs are divided. An agent that decides for
all runs at once keeps them together, whatever it does with them.
"""

from __future__ import annotations

import os
import signal
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from glbench import __version__
from glbench.agents.formats.packages import need
from glbench.agents.identity import baseline_names, files_of_folder, identify
from glbench.episodes.action_log import exactly
from glbench.episodes.definition import definition_json, task_of
from glbench.errors import GlbenchError, SubmissionError
from glbench.evaluation.engines.local import Job, Outcome, Report, failed
from glbench.evaluation.files import Scratch
from glbench.evaluation.preparing import Evaluation, JointAgentError, prepare
from glbench.evaluation.rollout import Progress
from glbench.evaluation.sandbox.choosing import Protection
from glbench.evaluation.saving import Computed, agent_folder
from glbench.kernel import why_not_compiled
from glbench.resources import write_atomically

_TRIES = 3
_STARTS = 3
_LOOK_SECONDS = 0.5
_TELL_SECONDS = 0.5
_PACKAGE = Path(__file__).resolve().parents[3]


@dataclass(frozen=True)
class Parcel:
    """An agent on its way: the name of a baseline, or the files of a submission. ``name`` is that of its file or folder."""

    name: str
    files: tuple[tuple[str, bytes], ...] = ()
    is_folder: bool = False

    @classmethod
    def of(cls, ref: str) -> Parcel:
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
class Order:
    """Runs of an agent on a task, and everything that has to be the same there.

    ``checkpoints`` is a folder on the machine that sent the order, and ``mark`` a file in it: where both are seen, the two machines share
    their disk and checkpoints are worth writing. ``is_part`` says that these are only some of the evaluation's runs.
    """

    definition: bytes
    parcel: Parcel
    seeds: tuple[int, ...]
    is_part: bool
    protection: Protection
    task_digest: str
    agent_digest: str
    kernel: dict[str, str | float]
    version: str
    checkpoints: Path | None
    mark: Path | None
    sealed: str = field(default="", repr=False)
    """The secret of the round, if there is one: it goes to the workers, and into nothing that they write."""


@dataclass(frozen=True)
class Refusal:
    """Why there are no numbers, in words. ``joint``: the agent decides for all runs at once, so they cannot be divided."""

    reason: str
    joint: bool = False


def work(order: Order, progress: Callable[[Progress], None]) -> Computed | Refusal:
    """Do what was ordered. Errors of glbench come back as words, everything else is raised."""
    # Numerical libraries would start a thread a core in each of several workers on one machine, and round by their number.
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))
    try:
        with order.parcel.unpacked() as ref:
            evaluation = _prepared(order, ref)
            different = _differences(order, evaluation)
            if different is not None:
                return Refusal(different)
            computed = evaluation.compute(progress)
    except JointAgentError as error:
        return Refusal(str(error), joint=True)
    except GlbenchError as error:
        return Refusal(str(error))
    return replace(computed, trace=None)


def _prepared(order: Order, ref: str) -> Evaluation:
    task = task_of(order.definition)
    evaluation = prepare(
        task.in_split("test", order.sealed) if order.sealed else task,
        ref,
        runs=len(order.seeds),
        first_seed=order.seeds[0],
        sandbox="bubblewrap" if order.protection == "bubblewrap" else "none",
    )
    shared = order.checkpoints is not None and order.mark is not None and order.mark.is_file()
    return replace(evaluation, checkpoints=order.checkpoints if shared else None, is_part=order.is_part)


def _differences(order: Order, evaluation: Evaluation) -> str | None:
    """Why this machine's numbers would be others than those of the machine that sent the order."""
    if order.version != __version__:
        return f"The worker has glbench {__version__}, this machine {order.version}. Install the same version on all machines."
    if order.task_digest != evaluation.task.digest:
        return "The worker's weather, parameters or model differ from those of this machine: the task has another digest there."
    if order.agent_digest != evaluation.agent.digest:
        return "The agent arrived with another digest than it was sent with. Did its files change while it was packed?"
    if order.kernel != evaluation.kernel:
        reason = why_not_compiled() or f"It has {evaluation.kernel}."
        return f"The worker's kernel is another one than this machine's, which would change the numbers. {reason}"
    return None


@contextmanager
def _own_signals() -> Iterator[None]:
    """Take back the handlers of signals that Ray replaces when it starts: with its own, TERM would abort this process."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class RayEngine:
    """Does jobs on the cluster at ``address``, or on one that is started on this machine with ``cores`` and stopped afterwards."""

    def __init__(self, address: str | None = None, cores: int | None = None) -> None:
        # Below `uv run`, Ray would start its workers through uv, too, which not every cluster can.
        os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")
        self._ray: Any = need("ray", "The engine 'ray'")
        self._address, self._cores = address, cores

    def run(self, jobs: Sequence[Job], report: Report) -> Iterator[Outcome]:
        """Do the jobs; outcomes come in the order in which jobs end.

        Raises
        ------
        GlbenchError
            When the cluster cannot be reached or started.
        """
        with self.cluster() as ray:
            yield from _Session(ray, report).run(jobs)

    @contextmanager
    def cluster(self) -> Iterator[Any]:
        """The package ``ray``, connected to the cluster until the end.

        Raises
        ------
        GlbenchError
            When the cluster cannot be reached or started.
        """
        with _own_signals():
            self._begin()
        try:
            yield self._ray
        finally:
            self._ray.shutdown()

    def _begin(self) -> None:
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        paths = [str(_PACKAGE), *filter(None, [os.environ.get("PYTHONPATH")])]
        here = {"PYTHONPATH": os.pathsep.join(paths), **threads}
        local: dict[str, Any] = {"num_cpus": self._cores, "include_dashboard": False}
        settings: dict[str, Any] = {} if self._address is not None else local
        for attempt in range(1, _STARTS + 1):
            try:
                self._ray.init(
                    address=self._address or "local",
                    log_to_driver=False,
                    logging_level="error",
                    runtime_env={"env_vars": threads if self._address is not None else here},
                    **settings,
                )
            except Exception as error:  # Ray raises plain ones, too: "The current node timed out during startup"
                self._ray.shutdown()
                if attempt < _STARTS and self._address is None:
                    continue  # half a minute is short for Ray's processes on a busy machine
                where = f"at {self._address}" if self._address is not None else "on this machine"
                said = str(error).splitlines()[0] if str(error) else type(error).__name__
                msg = f"There is no Ray cluster {where}: {said} `--engine local` needs none."
                raise GlbenchError(msg) from error
            return


@dataclass
class _Running:
    """A job under way: its parts, those that are there, and how far the others are."""

    job: Job
    evaluation: Evaluation
    began: float
    lock: ExitStack
    parts: list[tuple[int, ...]]
    done: dict[int, Computed] = field(default_factory=dict)
    references: dict[Any, int] = field(default_factory=dict)


class _Session:
    """All jobs of one call of ``run``."""

    def __init__(self, ray: Any, report: Report) -> None:
        self._ray, self._report = ray, report
        self._work = ray.remote(num_cpus=1, max_retries=_TRIES)(_work)
        self._board = ray.remote(num_cpus=0)(_Board).remote()
        self._cores = max(1, int(ray.cluster_resources().get("CPU", 1)))
        self._running: dict[int, _Running] = {}

    def run(self, jobs: Sequence[Job]) -> Iterator[Outcome]:
        """Send all jobs, then take what comes back."""
        try:
            for number, job in enumerate(jobs):
                outcome = self._begun(number, job)
                if outcome is not None:
                    yield outcome
            while self._running:
                yield from self._returned()
                self._tell()
        finally:
            for running in self._running.values():
                running.lock.close()

    def _begun(self, number: int, job: Job) -> Outcome | None:
        """Send a job, unless its outcome is known already."""
        began, lock = time.monotonic(), ExitStack()
        try:
            evaluation = job.prepare()
            if evaluation.stored is not None:
                evaluation.complete_episodes(evaluation.stored)
                return Outcome(job, evaluation.stored, None, time.monotonic() - began, stored=True)
            lock.enter_context(evaluation.alone())
            parts = divided(evaluation.seeds, self._cores) if may_be_divided(evaluation) else [evaluation.seeds]
            running = _Running(job, evaluation, began, lock, parts)
            self._send(number, running)
        except Exception as error:
            lock.close()
            return failed(job, error, began)
        self._running[number] = running
        return None

    def _send(self, number: int, running: _Running) -> None:
        evaluation, job = running.evaluation, running.job
        parcel, mark = Parcel.of(job.ref), None
        if evaluation.out is not None:
            mark = agent_folder(evaluation.out, job.task.id, job.agent_name) / f".seen-{uuid.uuid4().hex}"
            write_atomically(mark, "")
            running.lock.callback(mark.unlink, missing_ok=True)
        for part, seeds in enumerate(running.parts):
            whole = len(running.parts) == 1
            folder = evaluation.folder
            if folder is not None and not whole:
                folder = folder / f"runs-{seeds[0]}-{seeds[-1]}"
            order = Order(
                definition_json(job.task),
                parcel,
                seeds,
                not whole,
                evaluation.protection,
                job.task.digest,
                evaluation.agent.digest,
                evaluation.kernel,
                __version__,
                folder,
                mark,
                job.task.sealed,
            )
            running.references[self._work.remote(order, self._board, number, part)] = part

    def _returned(self) -> Iterator[Outcome]:
        """Take the parts that are there; the jobs that are whole or have failed are outcomes."""
        waiting = {reference: number for number, running in self._running.items() for reference in running.references}
        ready, _ = self._ray.wait(list(waiting), num_returns=1, timeout=_LOOK_SECONDS)
        for reference in ready:
            number = waiting[reference]
            running = self._running.get(number)
            if running is None or reference not in running.references:
                continue
            part = running.references.pop(reference)
            try:
                outcome = self._taken(number, running, part, self._ray.get(reference))
            except Exception as error:
                outcome = failed(running.job, _in_words(error), running.began)
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
        """Hand on where the jobs stand: a job is as far as its parts are on the average, by their runs."""
        standing: dict[tuple[int, int], tuple[int, int]] = self._ray.get(self._board.standing.remote())
        for number, running in self._running.items():
            steps, runs = running.job.task.steps, len(running.evaluation.seeds)
            done, alive = 0, 0
            for part, seeds in enumerate(running.parts):
                step, living = (
                    (steps, len(seeds)) if part in running.done else standing.get((number, part), (0, len(seeds)))
                )
                done, alive = done + step * len(seeds), alive + living
            self._report(running.job, Progress(done // runs, steps, alive, runs))


class _Board:
    """Where the parts stand, by job and part: the step, and the runs that are alive. Lives on the cluster."""

    def __init__(self) -> None:
        self._standing: dict[tuple[int, int], tuple[int, int]] = {}

    def tell(self, number: int, part: int, step: int, alive: int) -> None:
        """A part has come to a step."""
        self._standing[number, part] = (step, alive)

    def standing(self) -> dict[tuple[int, int], tuple[int, int]]:
        """Where all parts stand."""
        return self._standing


def _work(order: Order, board: Any, number: int, part: int) -> Computed | Refusal:
    """``work`` as a remote task, which tells the board where it stands."""
    told = 0.0

    def progress(standing: Progress) -> None:
        nonlocal told
        now = time.monotonic()
        if now - told >= _TELL_SECONDS:
            told = now
            board.tell.remote(number, part, standing.step, standing.alive)

    return work(order, progress)


def _in_words(error: Exception) -> Exception:
    """What Ray says of a lost worker is a page long; the first sentence and the number of tries are enough."""
    if type(error).__module__.partition(".")[0] != "ray":
        return error
    first = next((line.strip() for line in str(error).splitlines() if line.strip()), "")
    name = type(error).__name__
    if name in {"WorkerCrashedError", "OutOfMemoryError", "NodeDiedError", "ObjectLostError"}:
        return GlbenchError(f"The worker was lost {_TRIES + 1} times ({name}). {first}")
    return GlbenchError(f"The worker failed ({name}): {first}")
