"""Executors run jobs in this process, in processes of this machine, or on a Ray cluster, with the interface of ``concurrent.futures``.

``submit`` takes a function and its arguments, and ``as_completed`` yields jobs in the order in which they end. In addition:

- A job sends progress and events to its listener, which ``as_completed`` calls in the waiting thread. A listener that raises stops the job.
- A job may have a folder. On a cluster, the folder's files are sent with the job and returned each time it saves them.
- A job whose worker was lost starts again on another one, up to ``RETRIES`` times, with the files that it saved last.
- Leaving the executor's ``with`` block, even through an exception such as Ctrl-C, ends all jobs at once. Local
  processes also end when this process is killed.

The state of jobs on a cluster is kept in an actor on the machine that runs the command. Losing that machine ends
everything anyway; losing any other machine does not lose the state.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import pickle
import signal
import socket
import time
import traceback
import uuid
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any, Self, TypeVar

from glbench.children import worker
from glbench.errors import GlbenchError, refuse
from glbench.extras import require
from glbench.resources import Scratch, signal_handlers_kept

RETRIES = 3  # How often a job is started again after its worker was lost
_POLL_SECONDS = 0.5
_REPORT_SECONDS = 0.5
_ANSWER_SECONDS = 0.1
_END_SECONDS = 5.0
_SAVE_SECONDS = 20.0
_LARGEST_SAVED = 256 * 2**20  # Bytes; a larger folder is returned only with the result
_RAY_STARTS = 3
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Several workers share a machine, and bits may depend on the number of threads."""
_WORKER_LOST = frozenset({"WorkerCrashedError", "OutOfMemoryError", "NodeDiedError", "ObjectLostError", "LocalRayletDiedError"})

Item = TypeVar("Item")
Files = Mapping[str, bytes]  # Contents of files by their paths in a folder, with forward slashes


class JobError(GlbenchError):
    """A job raised an error that is not one of glbench's own; the message is its type and first line."""


class WorkerLostError(GlbenchError):
    """The worker of a job was lost at every try."""


class StopJob(Exception):  # noqa: N818  a request, not an error
    """Raised in a job whose listener no longer wants it."""


class JobContext:
    """First argument of a job: its connection to the process that submitted it.

    ``folder`` is the job's working folder, with the files of an earlier try; ``None`` for a job that was submitted without one.
    """

    def __init__(self, folder: Path | None, listener: Callable[[Any], object]) -> None:
        self.folder = folder
        self._listener = listener

    def report(self, progress: Any, *, save: bool = False) -> None:
        """Report progress; the listener may get only the latest report. ``save``: also save the folder, at most every 20 s."""
        self._listener(progress)

    def send(self, event: Any, *, save: bool = False) -> None:
        """Send an event to the listener; ``save``: also save the folder."""
        self._listener(event)

    def ask(self, event: Any) -> None:
        """Send an event, and wait until the listener has returned.

        Raises ``Exception`` when the listener raised: its own exception if the job runs in this process, else ``StopJob``.
        """
        self._listener(event)

    def return_folder(self) -> None:
        """Return the whole folder with the result, whatever its size."""


def _ignore(*arguments: object) -> None:
    pass


@dataclass(eq=False)
class Future:
    """A submitted job; ``folder`` is its folder on this machine."""

    function: Callable[..., Any] = _ignore
    arguments: tuple[Any, ...] = ()
    listener: Callable[[Any], object] = _ignore
    folder: Path | None = None
    save: Callable[[Path, Files], object] = _ignore
    is_done: bool = False
    key: str = field(default_factory=lambda: uuid.uuid4().hex)
    losses: int = 0
    _value: Any = None
    _error: Exception | None = None

    def result(self) -> Any:
        """What the job returned.

        Raises what the job or its listener raised: errors of glbench from another process unchanged, all others as ``JobError``. Raises
        ``WorkerLostError`` when its workers were lost.
        """
        if self._error is not None:
            raise self._error
        return self._value

    def finish(self, value: Any = None, error: Exception | None = None) -> None:
        """Set the outcome, unless an error of the listener has stopped the job: that error stays the outcome."""
        self.is_done, self._value, self._error = True, value, self._error or error

    def notify(self, message: Any) -> bool:
        """Pass a message to the listener, unless it has already raised. Returns whether it raised now."""
        if self._error is None:
            try:
                self.listener(message)
            except Exception as error:
                self._error = error
                return True
        return False

    @property
    def is_wanted(self) -> bool:
        """Whether the job should go on."""
        return self._error is None


class Executor(ABC):
    """Runs ``workers`` jobs at a time; a context manager. If it ``is_remote``, on machines that may lack this machine's files."""

    is_remote = False

    def __init__(self, workers: int = 1) -> None:
        self.workers = workers
        self._pending: list[Future] = []

    def submit(
        self,
        function: Callable[..., Any],
        *arguments: Any,
        listener: Callable[[Any], object] = _ignore,
        folder: Path | None = None,
        save: Callable[[Path, Files], object] = _ignore,
    ) -> Future:
        """Submit a job: ``function(context, *arguments)`` with a ``JobContext``. Only an ``InlineExecutor`` accepts what cannot be pickled.

        ``listener`` gets what the job reports and sends. ``folder`` is the job's working folder: executors that are not remote use it
        directly, and a remote one calls ``save(folder, files)`` to write the returned files.
        """
        future = Future(function, arguments, listener, folder, save)
        self._start(future)
        self._pending.append(future)
        return future

    def as_completed(self) -> Iterator[Future]:
        """Yield all jobs in the order in which they end, including those submitted meanwhile, without those cancelled."""
        while self._pending:
            future = next((future for future in self._pending if future.is_done), None)
            if future is None:
                self._poll()
            else:
                self._pending.remove(future)
                yield future

    def map_as_completed(self, submit: Callable[[Item], Future], items: Iterable[Item]) -> Iterator[tuple[Item, Future]]:
        """Submit a job for each item, at most ``workers`` at a time; yield each item with its job when it has ended.

        An item is taken from ``items`` when there is room for it. If ``submit`` raises an error of glbench, that is the job's outcome.
        """
        under_way = dict[Future, Item]()
        for item in items:
            try:
                under_way[submit(item)] = item
            except GlbenchError as error:
                failed = Future()
                failed.finish(error=error)
                yield item, failed
            if len(under_way) >= self.workers:
                future = next(self.as_completed())
                yield under_way.pop(future), future
        for future in self.as_completed():
            yield under_way.pop(future), future

    def cancel(self, future: Future) -> None:
        """Stop a job and never yield it."""
        if future in self._pending:
            self._pending.remove(future)
            self._stop(future)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        for future in list(self._pending):
            self.cancel(future)

    def _start(self, future: Future) -> None:  # noqa: B027  most start jobs when they poll
        """Start a job if it does not have to wait."""

    @abstractmethod
    def _poll(self) -> None:
        """Wait briefly for jobs, pass on what they send, and finish those that have ended."""

    def _stop(self, future: Future) -> None:  # noqa: B027  nothing runs between two polls in this process
        """Stop a job if it runs."""


class InlineExecutor(Executor):
    """Runs jobs in this process, one after the other."""

    def _poll(self) -> None:
        future = self._pending[0]
        try:
            future.finish(future.function(JobContext(future.folder, future.listener), *future.arguments))
        except Exception as error:
            future.finish(error=error)


def local_executor(workers: int) -> Executor:
    """An executor on this machine: this process for one worker, otherwise ``workers`` other processes."""
    return InlineExecutor() if workers <= 1 else ProcessExecutor(workers)


# Processes of this machine


@dataclass(eq=False)
class _Process:
    process: SpawnProcess
    connection: Connection
    future: Future | None = None


class ProcessExecutor(Executor):
    """Runs jobs in ``workers`` processes of this machine, one job at a time in each. They end when this process ends for any reason."""

    def __init__(self, workers: int) -> None:
        super().__init__(workers)
        self._processes: list[_Process] = []

    def __exit__(self, *exception: object) -> None:
        super().__exit__(*exception)
        for one in list(self._processes):
            self._end(one)

    def _poll(self) -> None:
        self._assign()
        busy = {one.connection: one for one in self._processes if one.future is not None}
        for connection in wait(list(busy), _POLL_SECONDS):
            one = busy[connection]  # type: ignore[index]
            assert one.future is not None
            try:
                kind, content = one.connection.recv()
                if kind == "done":
                    one.future.finish(*content)
                    one.future = None
                    continue
                raised = one.future.notify(content)
                if kind == "ask":
                    one.connection.send(one.future.is_wanted)
                elif raised:
                    one.future.finish()
                    self._end(one)
            except (EOFError, OSError):
                self._lose(one)

    def _assign(self) -> None:
        """Give jobs to idle processes, and start missing processes."""
        running = {one.future for one in self._processes}
        waiting = [future for future in self._pending if not future.is_done and future not in running]
        idle = [one for one in self._processes if one.future is None]
        while len(idle) < len(waiting) and len(self._processes) < self.workers:
            here, there = Pipe()
            one = _Process(worker(_serve, connections=[there]), here)
            one.process.start()
            there.close()
            self._processes.append(one)
            idle.append(one)
        for one, future in zip(idle, waiting, strict=False):
            one.future = future
            try:
                one.connection.send((future.function, future.arguments, future.folder))
            except OSError:
                self._lose(one)

    def _lose(self, one: _Process) -> None:
        one.process.join(_END_SECONDS)
        if (future := one.future) is not None:
            future.losses += 1
            if future.losses > RETRIES or not future.is_wanted:
                reason = f"The worker was lost {future.losses} times (exit code {one.process.exitcode})."
                future.finish(error=WorkerLostError(reason))
        self._end(one)

    def _end(self, one: _Process) -> None:
        one.process.terminate()
        one.process.join()
        one.connection.close()
        self._processes.remove(one)

    def _stop(self, future: Future) -> None:
        for one in [one for one in self._processes if one.future is future]:
            self._end(one)


class _PipeContext(JobContext):
    """A job's connection to the parent process."""

    def __init__(self, folder: Path | None, connection: Connection) -> None:
        super().__init__(folder, lambda event: connection.send(("event", event)))
        self._connection = connection
        self._last_report = float("-inf")

    def report(self, progress: Any, *, save: bool = False) -> None:
        now = time.monotonic()
        if now - self._last_report >= _REPORT_SECONDS:
            self._last_report = now
            self.send(progress)

    def ask(self, event: Any) -> None:
        self._connection.send(("ask", event))
        if not self._connection.recv():
            raise StopJob


def _serve(connection: Connection) -> None:
    """Do the jobs that the parent process sends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to all processes of a terminal; the parent ends this one
    with contextlib.suppress(EOFError):
        while True:
            call = connection.recv_bytes()
            try:
                function, arguments, folder = pickle.loads(call)
                answer = pickle.dumps(("done", _run(function, arguments, _PipeContext(folder, connection))), pickle.HIGHEST_PROTOCOL)
            except Exception as error:  # what cannot be pickled
                answer = pickle.dumps(("done", (None, portable_error(error))))
            connection.send_bytes(answer)


def _run(
    function: Callable[..., Any], arguments: Sequence[Any], context: JobContext, initializer: Callable[[], object] | None = None
) -> tuple[Any, GlbenchError | None]:
    """Value and error of a job."""
    try:
        if initializer is not None:
            initializer()
        return function(context, *arguments), None
    except StopJob:
        return None, None
    except Exception as error:
        return None, portable_error(error)


def portable_error(error: Exception) -> GlbenchError:
    """The error for a process that may lack this one's packages: an error of glbench unchanged, any other as a ``JobError``."""
    if isinstance(error, GlbenchError):
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:  # whatever its class makes of being pickled: its words still travel
            return GlbenchError(str(error))
        return error
    first_line = (str(error).strip().splitlines() or [""])[0]
    portable = JobError(f"{type(error).__name__}: {first_line}")
    portable.add_note("".join(traceback.format_exception(error)))
    return portable


# A Ray cluster


class RayExecutor(Executor):
    """Runs jobs on the Ray cluster at ``address``, or on one that is started on this machine with ``workers`` cores and stopped afterwards.

    A job uses one core, and one thread for numerical libraries; ``workers`` run at a time, by default one on every core of the cluster.
    ``initializer`` is called on the worker before each job; it is sent once, with all the data that it holds.
    """

    is_remote = True

    def __init__(self, address: str | None = None, workers: int | None = None, initializer: Callable[[], object] | None = None) -> None:
        super().__init__()
        # Below `uv run`, Ray would start its workers through uv, too, which not every cluster can.
        os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")
        require("The engine 'ray'", "ray", "ray")
        self._ray: Any = importlib.import_module("ray")
        self._address, self._limit, self._initializer = address, workers, initializer
        self._running = dict[Any, Future]()

    def __enter__(self) -> Self:
        """Connect to the cluster, or start it. Raises ``GlbenchError`` when it cannot be reached or started."""
        with signal_handlers_kept((signal.SIGTERM, signal.SIGINT)):  # with those that Ray sets, TERM would abort this process
            self._connect()
        try:
            cores = max(1, int(self._ray.cluster_resources().get("CPU", 1)))
            self.workers = cores if self._limit is None else min(self._limit, cores)
            strategies = importlib.import_module("ray.util.scheduling_strategies")
            here = strategies.NodeAffinitySchedulingStrategy(self._ray.get_runtime_context().get_node_id(), soft=False)
            self._store = self._ray.remote(num_cpus=0)(JobStore).options(scheduling_strategy=here).remote()
            self._remote_run = self._ray.remote(num_cpus=1, max_retries=RETRIES)(_run_on_ray)
            self._initializer = self._ray.put(self._initializer)
        except BaseException:
            self._ray.shutdown()
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        super().__exit__(*exception)
        self._ray.shutdown()

    def _connect(self) -> None:
        package = str(Path(__file__).resolve().parents[1])
        path = os.pathsep.join(filter(None, [package, os.environ.get("PYTHONPATH")]))
        if self._address is None:
            settings: dict[str, Any] = {"num_cpus": self._limit, "include_dashboard": False}
            environment = {"PYTHONPATH": path, **_ONE_THREAD}
        else:
            settings, environment = {}, _ONE_THREAD
        for attempt in range(1, _RAY_STARTS + 1):
            try:
                host, _, port = (self._address or "").rpartition("/")[2].rpartition(":")
                if port.isdecimal():  # Ray itself would try for minutes
                    socket.create_connection((host.strip("[]"), int(port)), timeout=10.0).close()
                self._ray.init(
                    address=self._address or "local",
                    log_to_driver=False,
                    logging_level="error",
                    runtime_env={"env_vars": environment},
                    **settings,
                )
            except Exception as error:  # Ray raises plain ones, too: "The current node timed out during startup"
                self._ray.shutdown()
                if attempt < _RAY_STARTS and self._address is None:
                    continue  # half a minute is short for Ray's processes on a busy machine
                where = f"at {self._address}" if self._address is not None else "on this machine"
                reason = str(error).splitlines()[0] if str(error) else type(error).__name__
                refuse(f"There is no Ray cluster {where}: {reason.rstrip('.')}. `--engine local` needs none.", GlbenchError, error)
            return

    def _start(self, future: Future) -> None:
        if future.folder is not None and (files := read_files(future.folder)) is not None:
            self._ray.get(self._store.put.remote(future.key, files))
        call = (future.function, future.arguments, future.folder is not None)
        self._running[self._remote_run.remote(call, future.key, self._initializer, self._store)] = future

    def _poll(self) -> None:
        ready, _ = self._ray.wait(list(self._running), timeout=_POLL_SECONDS)
        keys = [future.key for future in self._running.values()]
        updates: dict[str, Update] = self._ray.get(self._store.updates.remote(keys))
        for reference, future in list(self._running.items()):
            update = updates.get(future.key, Update())
            if update.files is not None and future.folder is not None and reference not in ready:
                future.save(future.folder, update.files)
            for event, asks in update.events:
                raised = future.notify(event)
                if asks:
                    self._ray.get(self._store.answer.remote(future.key, update.attempt, go_on=future.is_wanted))
                elif raised:
                    self._stop(future)
                    future.finish()
            if update.progress is not None and future.notify(update.progress):
                self._stop(future)
                future.finish()
        for reference in ready:
            if reference in self._running:
                self._receive(reference, self._running.pop(reference))

    def _receive(self, reference: Any, future: Future) -> None:
        try:
            value, error, files = self._ray.get(reference)
        except Exception as ray_error:
            name = type(ray_error).__name__
            reason = next((line.strip() for line in str(ray_error).splitlines() if line.strip()), "")
            if name in _WORKER_LOST:
                future.finish(error=WorkerLostError(f"The worker was lost {RETRIES + 1} times ({name}). {reason}"))
            else:
                future.finish(error=GlbenchError(f"The worker failed ({name}): {reason}"))
            return
        if files is not None and future.folder is not None:
            future.save(future.folder, files)
        self._store.put.remote(future.key, {})
        future.finish(value, error)

    def _stop(self, future: Future) -> None:
        for reference in [reference for reference, one in self._running.items() if one is future]:
            del self._running[reference]
            with contextlib.suppress(Exception):  # one that has ended cannot be cancelled, which is fine
                self._ray.cancel(reference, force=True)


@dataclass
class Update:
    """What a job has sent since the last request: progress, events (each with whether it waits for an answer), files if they changed."""

    attempt: str = ""
    progress: Any = None
    events: list[tuple[Any, bool]] = field(default_factory=list)
    files: Files | None = None


class JobStore:
    """An actor that holds what jobs on a cluster send and save, by their keys."""

    def __init__(self) -> None:
        self._updates: dict[str, Update] = {}
        self._files: dict[str, Files] = {}
        self._attempts: dict[str, str] = {}
        self._answers: dict[str, list[bool]] = {}

    def put(self, key: str, files: Files) -> None:
        """Provide the files from which a job starts."""
        self._files[key] = files

    def begin(self, key: str, attempt: str) -> Files:
        """Begin a try of a job and return the files from which it resumes; earlier tries are ignored from now on."""
        self._attempts[key], self._answers[key] = attempt, []
        self._updates.pop(key, None)
        return self._files.get(key, {})

    def tell(self, key: str, attempt: str, progress: Any, events: Sequence[tuple[Any, bool]], files: Files | None) -> None:
        """Record a job's progress, events and files."""
        if self._attempts.get(key) != attempt:
            return
        update = self._updates.setdefault(key, Update(attempt))
        update.progress = progress if progress is not None else update.progress
        update.events.extend(events)
        if files is not None:
            self._files[key] = update.files = files

    def answer(self, key: str, attempt: str, *, go_on: bool) -> None:
        """Tell a try of a job whether to continue after its next event."""
        if self._attempts.get(key) == attempt:
            self._answers[key].append(go_on)

    def answers(self, key: str, attempt: str) -> list[bool]:
        """All answers to a try; an outdated try is told to stop."""
        return self._answers[key] if self._attempts.get(key) == attempt else [False]

    def updates(self, keys: Sequence[str]) -> dict[str, Update]:
        """What jobs have sent since the last request."""
        return {key: self._updates.pop(key) for key in keys if key in self._updates}


class _RayContext(JobContext):
    """A job's connection to the store. It reports progress and saves its folder only at intervals."""

    def __init__(self, store: Any, key: str) -> None:
        super().__init__(None, _ignore)
        self._ray: Any = importlib.import_module("ray")
        self._store, self._key, self._attempt = store, key, uuid.uuid4().hex
        self._questions = 0
        self._last_report = self._last_save = float("-inf")
        self.returns_folder = False

    def begin(self) -> Files:
        """The files that an earlier try saved; from now on that try is ignored."""
        files: Files = self._ray.get(self._store.begin.remote(self._key, self._attempt))
        return files

    def report(self, progress: Any, *, save: bool = False) -> None:
        now = time.monotonic()
        if now - self._last_report >= _REPORT_SECONDS:
            self._last_report = now
            if self._tell(progress, save=save and now - self._last_save >= _SAVE_SECONDS):
                self._last_save = now

    def send(self, event: Any, *, save: bool = False) -> None:
        self._tell(None, (event, False), save=save)

    def ask(self, event: Any) -> None:
        self._tell(None, (event, True))
        self._questions += 1
        while len(answers := self._ray.get(self._store.answers.remote(self._key, self._attempt))) < self._questions:
            time.sleep(_ANSWER_SECONDS)
        if not all(answers):
            raise StopJob

    def return_folder(self) -> None:
        self.returns_folder = True

    def flush(self) -> None:
        """Wait until the store has everything."""
        self._ray.get(self._store.answers.remote(self._key, self._attempt))

    def _tell(self, progress: Any, *events: tuple[Any, bool], save: bool = False) -> bool:
        """Send to the store. Returns whether files were sent."""
        files = read_files(self.folder, _LARGEST_SAVED) if save and self.folder is not None else None
        self._store.tell.remote(self._key, self._attempt, progress, events, files)
        return files is not None


def _run_on_ray(
    call: tuple[Callable[..., Any], tuple[Any, ...], bool], key: str, initializer: Callable[[], object] | None, store: Any
) -> tuple[Any, GlbenchError | None, Files | None]:
    """A remote task: runs a job in a folder of the worker and returns its value, error and files."""
    os.environ.update(_ONE_THREAD)
    function, arguments, has_folder = call
    context, scratch = _RayContext(store, key), Scratch()
    try:
        files = context.begin()
        if has_folder:
            context.folder = scratch.folder() / "job"
            context.folder.mkdir()
            write_files(context.folder, files)
        value, error = _run(function, arguments, context, initializer)
        context.flush()
        folder = context.folder if context.returns_folder else None
        return value, error, None if folder is None else read_files(folder) or {}
    finally:
        scratch.remove()


def read_files(folder: Path, limit: float = float("inf")) -> dict[str, bytes] | None:
    """The files of a folder except hidden ones; ``None`` when there are none, or when they exceed ``limit`` bytes in total."""
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file() and not path.name.startswith(".")]
    if not paths or sum(path.stat().st_size for path in paths) > limit:
        return None
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def write_files(folder: Path, files: Files) -> None:
    """Write files into a folder that nothing else uses."""
    for name, content in files.items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content)
