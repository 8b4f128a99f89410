"""Several trainings at once, each with its own seed and folder: in processes on this machine, or on a Ray cluster."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from glbench.children import worker
from glbench.errors import GlbenchError, TrainingError
from glbench.training.cluster import Ended, Saved, Training, hand_on
from glbench.training.probe import CurvePoint, Listener, Progress
from glbench.training.trained import Trained

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec


class Trainer(Protocol):
    """Runs trainings somewhere else; any number of threads may each ask for one."""

    def train(
        self,
        training: Training,
        task: TaskSpec,
        settings: Any,
        folder: Path,
        *,
        listeners: Sequence[Listener] = (),
        **options: Any,
    ) -> Trained:
        """The same as ``training(task, settings, folder, listeners=listeners, **options)``, and raises the same errors."""

    def stop(self) -> None:
        """Stop all trainings; threads that wait for one get a ``TrainingError``."""


def train_seeds(
    trainer: Trainer,
    training: Training,
    task: TaskSpec,
    settings: Any,
    folders: Mapping[int, Path],
    *,
    at_once: int,
    listeners: Callable[[int], Sequence[Listener]] = lambda seed: (),
    **options: Any,
) -> Generator[tuple[int, Trained | TrainingError], None, None]:
    """Train with each seed in its folder, ``at_once`` at a time; resume interrupted ones. Yields seeds as they end.

    If a training fails, the others go on, and its error is yielded.
    """

    def one(seed: int) -> Trained | TrainingError:
        try:
            return trainer.train(
                training, task, settings, folders[seed], seed=seed, resume=True, listeners=listeners(seed), **options
            )
        except TrainingError as error:
            return error

    threads = ThreadPoolExecutor(at_once)
    try:
        seeds: dict[Future[Trained | TrainingError], int] = {threads.submit(one, seed): seed for seed in folders}
        waiting = set(seeds)
        while waiting:
            done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            yield from ((seeds[future], future.result()) for future in done)
    except BaseException:  # after an interrupt, nobody wants to wait for the trainings under way
        threads.shutdown(wait=False, cancel_futures=True)
        trainer.stop()
        raise
    finally:
        threads.shutdown(cancel_futures=True)


class ProcessTrainer:
    """Trains in processes on this machine, one per training: a training seeds the global generators of its process."""

    def __init__(self) -> None:
        self._under_way = set[Any]()

    def train(
        self,
        training: Training,
        task: TaskSpec,
        settings: Any,
        folder: Path,
        *,
        listeners: Sequence[Listener] = (),
        **options: Any,
    ) -> Trained:
        """As ``Trainer`` says. An exception of a listener ends the process, and is raised."""
        here, there = multiprocessing.Pipe(duplex=False)
        process = worker(_train_there, training, task, settings, folder, options, connections=[there])
        process.start()
        there.close()
        self._under_way.add(process)
        try:
            while not isinstance(said := here.recv(), Ended):
                hand_on(said, listeners)
            process.join()
        except EOFError as error:
            process.join()
            msg = f"The training in {folder} ended unexpectedly (exit code {process.exitcode}). Run the same command again to continue."
            raise TrainingError(msg) from error
        finally:
            here.close()
            process.terminate()
            process.join()
            self._under_way.discard(process)
        if said.trained is None:
            raise TrainingError(said.reason or "The training was stopped.")
        return said.trained

    def stop(self) -> None:
        """As ``Trainer`` says."""
        for process in list(self._under_way):
            process.terminate()


class _Sending(Listener):
    """Sends what it hears to the parent process; when that is gone, the training ends with an ``OSError``."""

    def __init__(self, there: Connection) -> None:
        self._there = there

    def on_progress(self, progress: Progress) -> None:
        self._there.send(progress)

    def on_evaluation(self, point: CurvePoint) -> None:
        self._there.send(point)

    def on_saved(self, steps: int) -> None:
        self._there.send(Saved(steps))


def _train_there(
    there: Connection, training: Training, task: TaskSpec, settings: Any, folder: Path, options: Mapping[str, Any]
) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to all processes of a terminal; the parent ends this one
    try:
        ended = Ended({}, training(task, settings, folder, listeners=[_Sending(there)], **options))
    except GlbenchError as error:
        ended = Ended({}, reason=str(error))
    with suppress(OSError):
        there.send(ended)
