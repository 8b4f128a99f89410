"""Trainings as jobs of an executor: several seeds at once, in processes of this machine or on a Ray cluster.

On a cluster the folder of a training is sent to the worker, and comes back with every checkpoint and at the end. So if a worker is lost,
its training resumes from the last checkpoint on another machine; if the command is interrupted, the next command resumes it. This module
does not know what is trained: ``training`` is any function with the interface of ``glbench.training.run.train``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from glbench import execution
from glbench.errors import GlbenchError, TrainingError, refuse
from glbench.evaluation.jobs import PackedTask
from glbench.resources import Scratch, write_atomically
from glbench.tasks import TaskSpec
from glbench.training.card import CARD, POLICY
from glbench.training.folder import CHECKPOINT, LEARNER, SETTINGS, Trained, folder_lock, replaced
from glbench.training.periodic_evaluation import CurvePoint, Listener, Progress

Training = Callable[..., Trained]
"""A training function: takes task, settings and folder, and by name ``seed``, ``resume``, ``listeners`` and its own options."""
_LAST = {CHECKPOINT: 1, POLICY: 2, LEARNER: 3, CARD: 4}  # Files written after all others, in this order, as a training itself does
_START = "policy"


@dataclass(frozen=True)
class TrainingJob:
    """A training and all that it needs."""

    task: TaskSpec | PackedTask
    training: Training
    settings: Any
    folder: Path
    """On the machine of the command."""
    start: execution.Files
    """The policy that it starts from, if any, and its card, where it must be sent."""
    options: Mapping[str, Any]
    waits_for_answers: bool
    """Whether it waits after each evaluation until the listeners have returned."""


@dataclass(frozen=True)
class _Saved:
    """A checkpoint was made at ``steps``."""

    steps: int


def submit_training(
    executor: execution.Executor,
    training: Training,
    task: TaskSpec,
    settings: Any,
    folder: Path,
    *,
    listeners: Sequence[Listener] = (),
    waits_for_answers: bool = False,
    **options: Any,
) -> execution.Future:
    """Submit ``training(task, settings, folder, listeners=listeners, **options)``; ``outcome_of`` takes its outcome.

    An exception of a listener stops the training, and is its outcome; with ``waits_for_answers``, right after the evaluation. Raises
    ``TrainingError`` when the policy to start from cannot be read.
    """
    is_remote = executor.is_remote
    start = _start_files(getattr(settings, "start_from", None)) if is_remote else {}
    sent_task = PackedTask.of(task) if is_remote else task
    job = TrainingJob(sent_task, training, settings, folder.resolve(), start, options, waits_for_answers)

    def hand_on(message: CurvePoint | _Saved | Progress) -> None:
        for listener in listeners:
            if isinstance(message, CurvePoint):
                listener.on_evaluation(message)
            elif isinstance(message, _Saved):
                listener.on_saved(message.steps)
            else:
                listener.on_progress(message)

    return executor.submit(_train, job, listener=hand_on, folder=folder, save=bring_home)


def outcome_of(future: execution.Future, folder: Path) -> Trained:
    """The outcome of a training in ``folder``. Raises ``TrainingError`` when it failed or lost its workers, and what a listener raised."""
    try:
        trained: Trained = future.result()
    except execution.WorkerLostError as error:
        refuse(f"The training in {folder} ended unexpectedly. {error} Run the same command again to continue.", TrainingError, error)
    except TrainingError:
        raise
    except GlbenchError as error:
        raise TrainingError(str(error)) from error
    return replace(trained, folder=folder)


def train_seeds(
    executor: execution.Executor,
    training: Training,
    task: TaskSpec,
    settings: Any,
    folders: Mapping[int, Path],
    *,
    listeners: Callable[[int], Sequence[Listener]] = lambda seed: (),
    **options: Any,
) -> Iterator[tuple[int, Trained | TrainingError]]:
    """Train with each seed in its folder, as many at a time as ``executor`` has workers; resume interrupted ones. Yields seeds as they end.

    If a training fails, the others go on, and its error is yielded.
    """
    locks = dict[int, ExitStack]()

    def submit(seed: int) -> execution.Future:
        locks[seed] = all_locks.enter_context(ExitStack())
        if executor.is_remote:  # a local training locks its folder itself
            locks[seed].enter_context(folder_lock(folders[seed]))
        return submit_training(
            executor, training, task, settings, folders[seed], seed=seed, resume=True, listeners=listeners(seed), **options
        )  # fmt: skip

    with ExitStack() as all_locks:
        for seed, future in executor.map_as_completed(submit, folders):
            try:
                outcome: Trained | TrainingError = outcome_of(future, folders[seed])
            except TrainingError as error:
                outcome = error
            locks[seed].close()
            yield seed, outcome


class _Reporter(Listener):
    """Sends the news of a training to the process that submitted it, and saves its folder with every checkpoint."""

    def __init__(self, context: execution.JobContext, *, waits_for_answers: bool) -> None:
        self._context = context
        self._send_evaluation = context.ask if waits_for_answers else context.send

    def on_progress(self, progress: Progress) -> None:
        self._context.report(progress)

    def on_evaluation(self, point: CurvePoint) -> None:
        self._send_evaluation(point)

    def on_saved(self, steps: int) -> None:
        self._context.send(_Saved(steps), save=True)


def _train(context: execution.JobContext, job: TrainingJob) -> Trained:
    """The job: a training in the folder of ``context``, with the paths of the machine of the command in its files and errors."""
    folder, settings, scratch = context.folder, job.settings, Scratch()
    assert folder is not None
    paths = {str(folder): str(job.folder)} if folder.resolve() != job.folder else {}
    try:
        if job.start:
            execution.write_files(scratch.folder(), job.start)
            start = scratch.folder() / _START / settings.start_from.name
            paths[str(start)] = str(settings.start_from)
            settings = settings.model_copy(update={"start_from": start})
        reporter = _Reporter(context, waits_for_answers=job.waits_for_answers)
        task = job.task.unpack() if isinstance(job.task, PackedTask) else job.task
        return job.training(task, settings, folder, listeners=[reporter], **job.options)
    except execution.StopJob:
        raise
    except Exception as error:
        if not paths:
            raise
        raise TrainingError(_replace_paths(str(execution.portable_error(error)), paths)) from error
    finally:
        scratch.remove()
        if paths:
            for file in (folder / SETTINGS, folder / CARD):
                if file.is_file():
                    file.write_text(_replace_paths(file.read_text(encoding="utf-8"), paths), encoding="utf-8")
        context.return_folder()


def _replace_paths(text: str, paths: Mapping[str, str]) -> str:
    for there, here in paths.items():
        text = text.replace(there, here)
    return text


def _start_files(policy: Path | None) -> execution.Files:
    """The policy to start from and its cards, in the same relative places. Raises ``TrainingError`` when it cannot be read."""
    if policy is None:
        return {}
    cards = {f"{_START}/{CARD}": policy.with_name(CARD)}
    cards[f"training/{policy.stem}.toml"] = policy.parent.parent / "training" / f"{policy.stem}.toml"
    try:
        files = {name: file.read_bytes() for name, file in cards.items() if file.is_file()}
        return {f"{_START}/{policy.name}": policy.read_bytes(), **files}
    except OSError as error:
        refuse(f"The policy to start from, {policy}, cannot be read: {error}.", TrainingError, error)


def bring_home(folder: Path, files: execution.Files) -> None:
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
        elif execution.read_files(place) != part:
            with replaced(place) as new:
                execution.write_files(new, part)
