"""A Ray cluster: connecting to it or starting it, and the board where its tasks report progress and leave the files they need to resume.

The board lives on the machine that runs the command. Losing that machine ends everything anyway, and the board survives the loss of any
other. A task that is tried again picks up there what its earlier try left.
"""

from __future__ import annotations

import os
import signal
import threading
import time
import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from glbench.agents.formats.packages import need
from glbench.errors import GlbenchError

TRIES = 3
"""How often a task is retried after its worker was lost."""
LOOK_SECONDS = 0.5
_STARTS = 3
_TELL_SECONDS = 0.5
_ASK_SECONDS = 0.1
_KEEP_SECONDS = 20.0
_MOST_KEPT = 256 * 2**20
"""Bytes; if a task's files are larger in total, they stay on the worker."""
_PACKAGE = Path(__file__).resolve().parents[3]
_THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
_LOST = frozenset(
    {"WorkerCrashedError", "OutOfMemoryError", "NodeDiedError", "ObjectLostError", "LocalRayletDiedError"}
)

Files = Mapping[str, bytes]
"""Contents of files by their paths in a folder, with forward slashes."""


class Cluster:
    """The cluster at ``address``, or one that is started on this machine with ``cores`` and stopped afterwards."""

    def __init__(self, address: str | None = None, cores: int | None = None) -> None:
        # Below `uv run`, Ray would start its workers through uv, too, which not every cluster can.
        os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")
        self._ray: Any = need("ray", "The engine 'ray'")
        self._address, self._cores = address, cores

    @contextmanager
    def connected(self) -> Iterator[Any]:
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
        paths = [str(_PACKAGE), *filter(None, [os.environ.get("PYTHONPATH")])]
        here = {"PYTHONPATH": os.pathsep.join(paths), **_THREADS}
        local: dict[str, Any] = {"num_cpus": self._cores, "include_dashboard": False}
        settings: dict[str, Any] = {} if self._address is not None else local
        for attempt in range(1, _STARTS + 1):
            try:
                self._ray.init(
                    address=self._address or "local",
                    log_to_driver=False,
                    logging_level="error",
                    runtime_env={"env_vars": _THREADS if self._address is not None else here},
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


@contextmanager
def _own_signals() -> Iterator[None]:
    """Restore the signal handlers that Ray replaces when it starts: with Ray's, TERM would abort this process."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def one_thread() -> None:
    """Let numerical libraries of this process use one thread: several workers share a machine, and bits may depend on their number."""
    os.environ.update(_THREADS)


@dataclass
class News:
    """What a task has reported since the last request: its progress, its events, and its files if they have changed."""

    attempt: str = ""
    standing: Any = None
    events: list[Any] = field(default_factory=list)
    files: Files | None = None


class Board:
    """What tasks report and leave, by their keys. Lives on the cluster; ``board_of`` makes it."""

    def __init__(self) -> None:
        self._news: dict[str, News] = {}
        self._files: dict[str, Files] = {}
        self._tries: dict[str, str] = {}
        self._answers: dict[str, list[bool]] = {}

    def leave(self, key: str, files: Files) -> None:
        """Provide the files from which a task starts."""
        self._files[key] = files

    def begin(self, key: str, attempt: str) -> Files:
        """Begin a try of a task and return the files from which it resumes; earlier tries are ignored from now on."""
        self._tries[key], self._answers[key] = attempt, []
        self._news.pop(key, None)
        return self._files.get(key, {})

    def tell(self, key: str, attempt: str, standing: Any, events: Sequence[Any], files: Files | None) -> None:
        """Record a task's progress, events and files."""
        if self._tries.get(key) != attempt:
            return
        news = self._news.setdefault(key, News(attempt))
        news.standing = standing if standing is not None else news.standing
        news.events.extend(events)
        if files is not None:
            self._files[key] = news.files = files

    def answer(self, key: str, attempt: str, *, go_on: bool) -> None:
        """Tell a try of a task whether to continue after its next event."""
        if self._tries.get(key) == attempt:
            self._answers[key].append(go_on)

    def answers(self, key: str, attempt: str) -> list[bool]:
        """All answers to an attempt; an outdated attempt is stopped."""
        return self._answers[key] if self._tries.get(key) == attempt else [False]

    def news(self, keys: Sequence[str]) -> dict[str, News]:
        """What tasks have reported since the last request."""
        told = {key: self._news.pop(key) for key in keys if key in self._news}
        for key, news in told.items():
            self._news[key] = News(news.attempt, news.standing)
        return told


def cores_of(ray: Any) -> int:
    """Cores of the whole cluster."""
    return max(1, int(ray.cluster_resources().get("CPU", 1)))


def board_of(ray: Any) -> Any:
    """A board on this machine."""
    strategies = need("ray.util.scheduling_strategies", "The engine 'ray'")
    here = strategies.NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
    return ray.remote(num_cpus=0)(Board).options(scheduling_strategy=here).remote()


class Teller:
    """A task's connection to the board. It reports progress, and leaves files, at intervals only."""

    def __init__(self, board: Any, key: str, keep_seconds: float = _KEEP_SECONDS) -> None:
        self._ray = need("ray", "The engine 'ray'")
        self._board, self._key, self._attempt = board, key, uuid.uuid4().hex
        self._keep_seconds, self._asked = keep_seconds, 0
        self._told = self._kept = float("-inf")

    def begin(self) -> Files:
        """The files that an earlier try left; from now on that try is ignored."""
        files: Files = self._ray.get(self._board.begin.remote(self._key, self._attempt))
        return files

    def stand(self, standing: Any, folder: Path | None = None) -> None:
        """Report progress, and leave the files of ``folder``, unless that was done a moment ago."""
        now = time.monotonic()
        if now - self._told < _TELL_SECONDS:
            return
        self._told, files = now, None
        if folder is not None and now - self._kept >= self._keep_seconds:
            files = read_files(folder)
            self._kept = self._kept if files is None else now
        self._board.tell.remote(self._key, self._attempt, standing, (), files)

    def tell(self, *events: Any, folder: Path | None = None) -> Any:
        """Report events at once; with a ``folder``, also leave its files."""
        files = None if folder is None else read_files(folder)
        return self._board.tell.remote(self._key, self._attempt, None, events, files)

    def finish(self) -> None:
        """Wait until everything is reported."""
        self._ray.get(self.tell())

    def ask(self, event: Any) -> bool:
        """Report an event, and wait for the answer whether to continue."""
        self.tell(event)
        self._asked += 1
        while len(answers := self._ray.get(self._board.answers.remote(self._key, self._attempt))) < self._asked:
            time.sleep(_ASK_SECONDS)
        return all(answers)


def read_files(folder: Path, most: float = _MOST_KEPT) -> dict[str, bytes] | None:
    """The files of a folder; ``None`` when there are none, or when they exceed ``most`` bytes in total. Hidden files are left out."""
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file() and not path.name.startswith(".")]
    if not paths or sum(path.stat().st_size for path in paths) > most:
        return None
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def write_files(folder: Path, files: Files) -> None:
    """Write files into a folder that nobody else works in."""
    for name, content in files.items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content)


def in_words(error: Exception) -> Exception:
    """Shorten Ray's page-long message about a lost worker to its first line and the number of tries."""
    if type(error).__module__.partition(".")[0] != "ray":
        return error
    first = next((line.strip() for line in str(error).splitlines() if line.strip()), "")
    name = type(error).__name__
    if name in _LOST:
        return GlbenchError(f"The worker was lost {TRIES + 1} times ({name}). {first}")
    return GlbenchError(f"The worker failed ({name}): {first}")
