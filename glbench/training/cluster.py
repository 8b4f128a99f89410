"""Trainings on a Ray cluster: each uses one core of any machine, and its folder is kept up to date on this one.

The folder of a training is sent to the worker, and comes back with every checkpoint and at the end. So if a worker is lost, its training
resumes from the last checkpoint on another machine; if the command is interrupted, the next command resumes it. This module does not know
what is trained: ``training`` is any function with the interface of ``glbench.training.run.train``.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from glbench.errors import GlbenchError, TrainingError
from glbench.evaluation.engines.cluster import (
    LOOK_SECONDS,
    TRIES,
    Files,
    News,
    Teller,
    board_of,
    in_words,
    one_thread,
    read_files,
    write_files,
)
from glbench.evaluation.engines.luggage import Luggage, PackedTask
from glbench.evaluation.files import Scratch
from glbench.resources import write_atomically
from glbench.training.card import CARD, POLICY
from glbench.training.folder import CHECKPOINT, LEARNER, SETTINGS, folder_lock, replaced
from glbench.training.probe import CurvePoint, Listener, Progress
from glbench.training.trained import Trained

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec

Training = Callable[..., Trained]
"""A training function: takes task, settings and folder, and by name ``seed``, ``resume``, ``listeners`` and its own options."""
_LAST = {CHECKPOINT: 1, POLICY: 2, LEARNER: 3, CARD: 4}
"""Files written after all others, in this order, as a training itself does."""
_START = "policy"


@dataclass(frozen=True)
class Saved:
    """A checkpoint was made at ``steps``."""

    steps: int


@dataclass(frozen=True)
class TrainingJob:
    """A training and all that it needs. ``start``: the policy that it starts from, if any, and its card.

    ``asks``: after each evaluation, it waits for the answer whether to continue.
    """

    task: PackedTask
    training: Training
    settings: Any
    start: Files
    options: Mapping[str, Any]
    asks: bool


@dataclass(frozen=True)
class Ended:
    """How a training ended on a worker: ``trained``, or the ``reason`` why not, or neither if it was stopped."""

    files: Files
    trained: Trained | None = None
    reason: str | None = None


class _StopTraining(Exception):  # noqa: N818  a request, not an error
    """Stops a training on request."""


class ClusterTrainer:
    """Trains on a cluster that is already connected; any number of threads may each ask for a training."""

    def __init__(self, ray: Any, tasks: Sequence[TaskSpec]) -> None:
        self._ray, self._board = ray, board_of(ray)
        self._work = ray.remote(num_cpus=1, max_retries=TRIES)(_work)
        self._luggage = ray.put(Luggage.of(tasks))
        self._under_way = set[Any]()
        self._stopped = threading.Event()

    @property
    def stopped(self) -> bool:
        """Whether all trainings were stopped."""
        return self._stopped.is_set()

    def stop(self) -> None:
        """Stop all trainings; threads that wait for one get a ``TrainingError``."""
        self._stopped.set()
        for reference in list(self._under_way):
            with suppress(Exception):  # one that has ended cannot be cancelled, which is fine
                self._ray.cancel(reference, force=True)

    def train(
        self,
        training: Training,
        task: TaskSpec,
        settings: Any,
        folder: Path,
        *,
        listeners: Sequence[Listener] = (),
        asks: bool = False,
        **options: Any,
    ) -> Trained:
        """The same as ``training(task, settings, folder, listeners=listeners, **options)``, on the cluster.

        ``asks``: an exception of a listener after an evaluation stops the training, and is raised; otherwise it is only raised.

        Raises
        ------
        TrainingError
            As ``training`` raises it; when another process works in ``folder``; when too many workers are lost.
        """
        start = _start_files(getattr(settings, "start_from", None))
        job = TrainingJob(PackedTask.of(task), training, settings, start, options, asks)
        key = str(folder.resolve())
        with folder_lock(folder):
            self._ray.get(self._board.leave.remote(key, read_files(folder, float("inf")) or {}))
            reference = self._work.remote(job, key, self._luggage, self._board)
            self._under_way.add(reference)
            try:
                ended, error = self._followed(reference, key, folder, listeners, asks)
            finally:
                self._under_way.discard(reference)
                with suppress(Exception):
                    self._ray.cancel(reference, force=True)
            bring_home(folder, ended.files)
            self._board.leave.remote(key, {})  # it is here now
        if error is not None:
            raise error
        if ended.trained is None:
            raise TrainingError(ended.reason or "The training was stopped.")
        return replace(ended.trained, folder=folder)

    def _followed(
        self, reference: Any, key: str, folder: Path, listeners: Sequence[Listener], asks: bool
    ) -> tuple[Ended, Exception | None]:
        """How a training ended, and what a listener raised to stop it; until then, pass on its news and keep its folder up to date."""
        raised: Exception | None = None
        while True:
            ready, _ = self._ray.wait([reference], timeout=LOOK_SECONDS)
            if self._stopped.is_set():
                msg = "The training was stopped."
                raise TrainingError(msg)
            told: News = self._ray.get(self._board.news.remote([key])).get(key, News())
            if told.files is not None and not ready:
                bring_home(folder, told.files)
            for event in told.events:
                try:
                    hand_on(event, listeners)
                except Exception as error:
                    if not asks:
                        raise
                    raised = error
                if asks and isinstance(event, CurvePoint):
                    self._ray.get(self._board.answer.remote(key, told.attempt, go_on=raised is None))
            if isinstance(told.standing, Progress) and raised is None:
                hand_on(told.standing, listeners)
            if ready:
                try:
                    return self._ray.get(reference), raised
                except Exception as error:
                    raise TrainingError(str(in_words(error))) from error


def _start_files(policy: Path | None) -> Files:
    """The policy that a training starts from and its cards, in the same relative places as here.

    Raises
    ------
    TrainingError
        When it cannot be read.
    """
    if policy is None:
        return {}
    beside = {f"{_START}/{CARD}": policy.with_name(CARD)}
    beside[f"training/{policy.stem}.toml"] = policy.parent.parent / "training" / f"{policy.stem}.toml"
    try:
        cards = {name: file.read_bytes() for name, file in beside.items() if file.is_file()}
        return {f"{_START}/{policy.name}": policy.read_bytes(), **cards}
    except OSError as error:
        msg = f"The policy to start from, {policy}, cannot be read: {error}."
        raise TrainingError(msg) from error


def hand_on(event: Any, listeners: Sequence[Listener]) -> None:
    """Pass the news of a remote training on to listeners."""
    for listener in listeners:
        if isinstance(event, CurvePoint):
            listener.on_evaluation(event)
        elif isinstance(event, Saved):
            listener.on_saved(event.steps)
        else:
            listener.on_progress(event)


def bring_home(folder: Path, files: Files) -> None:
    """Make ``folder`` hold ``files``, the folder of a remote training. If killed at any moment, it can still be resumed."""
    parts = dict[str, dict[str, bytes]]()
    for name, content in files.items():
        first, _, rest = name.partition("/")
        parts.setdefault(first, {})[rest] = content
    if CARD not in parts:  # it continues: the card of its earlier end no longer applies
        (folder / CARD).unlink(missing_ok=True)
    for name in sorted(parts, key=lambda name: _LAST.get(name, 0)):
        place, part = folder / name, parts[name]
        if "" in part:
            if not place.is_file() or place.read_bytes() != part[""]:
                write_atomically(place, part[""])
        elif read_files(place, float("inf")) != part:
            with replaced(place) as new:
                write_files(new, part)


class _Telling(Listener):
    """Reports a training's news to the board, and leaves its folder there with every checkpoint."""

    def __init__(self, teller: Teller, folder: Path, *, asks: bool) -> None:
        self._teller, self._folder, self._asks = teller, folder, asks

    def on_progress(self, progress: Progress) -> None:
        self._teller.stand(progress)

    def on_evaluation(self, point: CurvePoint) -> None:
        if not self._asks:
            self._teller.tell(point)
        elif not self._teller.ask(point):
            raise _StopTraining

    def on_saved(self, steps: int) -> None:
        self._teller.tell(Saved(steps), folder=self._folder)


def _work(job: TrainingJob, key: str, luggage: Luggage, board: Any) -> Ended:
    """A training as a remote task, in a folder of the worker's own."""
    one_thread()
    luggage.unpack()
    teller, scratch = Teller(board, key), Scratch()
    try:
        folder = scratch.folder() / "training"
        folder.mkdir()
        write_files(folder, teller.begin())
        settings, names = job.settings, {str(folder): key}
        if job.start:
            write_files(scratch.folder() / "start", job.start)
            start = scratch.folder() / "start" / _START / settings.start_from.name
            names[str(start)] = str(settings.start_from)
            settings = settings.model_copy(update={"start_from": start})
        ended = _ended(job, settings, folder, _Telling(teller, folder, asks=job.asks))
        teller.finish()
        files = read_files(folder, float("inf")) or {}
        for name in {SETTINGS, CARD} & files.keys():
            files[name] = _renamed(files[name].decode(), names).encode()
        reason = None if ended.reason is None else _renamed(ended.reason, names)
        return replace(ended, files=files, reason=reason)
    finally:
        scratch.remove()


def _ended(job: TrainingJob, settings: Any, folder: Path, listener: Listener) -> Ended:
    try:
        trained = job.training(job.task.unpacked(), settings, folder, listeners=[listener], **job.options)
    except _StopTraining:
        return Ended({})
    except GlbenchError as error:
        return Ended({}, reason=str(error))
    except Exception as error:  # of a library that may not even be installed where the command runs
        first = (str(error).strip().splitlines() or [""])[0]
        return Ended({}, reason=f"{type(error).__name__}: {first}")
    return Ended({}, trained)


def _renamed(text: str, names: Mapping[str, str]) -> str:
    """The text with paths on the worker replaced by those on the machine of the command."""
    for there, here in names.items():
        text = text.replace(there, here)
    return text
