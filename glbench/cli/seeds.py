"""``glbench train --seeds``: one training per seed, in processes on this machine or on a Ray cluster."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from glbench.cli.console import messages, output, print_warning, put, say, table, tell
from glbench.cli.exiting import INTERRUPTED, tell_interrupted
from glbench.errors import GlbenchError

if TYPE_CHECKING:
    from glbench.leaderboard.catalogue import Metric
    from glbench.tasks import TaskSpec
    from glbench.training import Trained
    from glbench.training.cluster import ClusterTrainer, Training
    from glbench.training.several import Trainer

_MOST_SEEDS = 1000


@dataclass(frozen=True)
class Where:
    """Where trainings are done: in ``workers`` processes, or on the Ray cluster at ``address``."""

    on_ray: bool
    address: str | None
    workers: int | None


def seeds_of(text: str) -> list[int]:
    """The seeds that ``0-4`` or ``0,1,7-9`` names, each once.

    Raises
    ------
    GlbenchError
        When it names none, or too many.
    """
    seeds = dict[int, None]()
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()) or (dash and int(last) < int(first)):
            msg = f"--seeds {text}: '{part.strip()}' names no seeds. Write 0-4, or 0,1,7-9."
            raise GlbenchError(msg)
        if int(last or first) - int(first) >= _MOST_SEEDS:
            msg = f"--seeds {text} names more than {_MOST_SEEDS:,} seeds."
            raise GlbenchError(msg)
        seeds |= dict.fromkeys(range(int(first), int(last or first) + 1))
    return list(seeds)


@contextlib.contextmanager
def on_cluster(where: Where, tasks: list[TaskSpec]) -> Iterator[tuple[ClusterTrainer, int]]:
    """The trainer, and how many trainings it runs at a time."""
    from glbench.evaluation.engines.cluster import Cluster, cores_of
    from glbench.training.cluster import ClusterTrainer

    with messages().status("reaching the cluster") as status, Cluster(where.address, where.workers).connected() as ray:
        trainer, cores = ClusterTrainer(ray, tasks), cores_of(ray)
        status.stop()
        yield trainer, cores if where.workers is None else min(where.workers, cores)


@contextlib.contextmanager
def _trainer(where: Where, task: TaskSpec) -> Iterator[tuple[Trainer, int]]:
    from glbench.evaluation.provenance import usable_cores
    from glbench.training.several import ProcessTrainer

    if where.on_ray:
        with on_cluster(where, [task]) as trainer:
            yield trainer
    else:
        yield ProcessTrainer(), where.workers or usable_cores()


def train_with_seeds(
    training: Training, task: TaskSpec, settings: Any, folders: dict[int, Path], where: Where, **options: Any
) -> None:
    """Train with each seed in its folder and print the outcome; ``training`` is any function that ``glbench train`` calls.

    Raises
    ------
    typer.Exit
        With code 1 when a training failed, else 3 when one learnt nothing, 130 when interrupted.
    """
    from glbench.leaderboard.catalogue import catalogue
    from glbench.training.several import train_seeds

    score = catalogue(task).score
    ended: dict[int, Trained] = {}
    failed = 0
    try:
        with _trainer(where, task) as (trainer, at_once), contextlib.ExitStack() as stack:
            say(messages(), f"{len(folders)} seeds, {min(at_once, len(folders))} at a time, in {_place(folders)}")
            coming = train_seeds(
                trainer, training, task, settings, folders, at_once=at_once,
                listeners=lambda seed: [_Lines(seed, score)], **options,
            )  # fmt: skip
            stack.enter_context(contextlib.closing(coming))  # its threads end before the cluster disconnects
            for seed, trained in coming:
                if isinstance(trained, GlbenchError):
                    failed += 1
                    print_warning(f"seed {seed}: {trained}")
                else:
                    ended[seed] = trained
                    was = "already trained" if trained.already_done else "done"
                    tell(f"seed {seed}: {was}, best {score.said(trained.best_reward)}")
    except KeyboardInterrupt:
        tell_interrupted(
            "Run the same command again to continue: finished seeds are kept, the rest resume from their last checkpoints."
        )
        raise typer.Exit(INTERRUPTED) from None
    _show(ended, score)
    if ended:
        pattern = next(iter(ended.values())).folder.name.rpartition("seed")[0]
        put(f"Next: glbench evaluate {_place(folders)}/{pattern}seed*")
    if failed or any(not trained.learnt for trained in ended.values()):
        raise typer.Exit(1 if failed else 3)


def _place(folders: dict[int, Path]) -> Path:
    return next(iter(folders.values())).parent


def _show(ended: dict[int, Trained], score: Metric) -> None:
    numbers = ("Best", "after", "of", "Last")
    view = table(f"Trainings by {score.words}", "Seed", *numbers, "", right=("Seed", *numbers))
    for seed, trained in sorted(ended.items()):
        said = "" if trained.learnt else "nothing was learnt"
        steps = (f"{trained.best_steps:,}", f"{trained.steps:,}")
        view.add_row(str(seed), score.number(trained.best_reward), *steps, score.number(trained.last_reward), said)
    output().print(view)


class _Lines:
    """A line for every evaluation of a training."""

    def __init__(self, seed: int, score: Metric) -> None:
        self._seed, self._score = seed, score

    def on_progress(self, progress: object) -> None:
        """Nothing to show: several trainings run at once."""

    def on_evaluation(self, point: Any) -> None:
        """What the policy earns."""
        best = "  best" if point.is_best else ""
        tell(f"seed {self._seed}: {point.steps:>9,} steps  {self._score.said(point.result.reward)}{best}")

    def on_saved(self, steps: int) -> None:
        """Nothing to show: a checkpoint is no news."""
