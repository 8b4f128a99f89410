"""Hand in plans: each is replayed, and replaces the best known plan if it earns more."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from glbench import __version__
from glbench.agents.baselines import read_baseline
from glbench.agents.plans import PlanBook, PlanFolder, read_book
from glbench.bounds.search import PlanValue, replay_plans, save_card
from glbench.errors import GlbenchError, SubmissionError, UnknownNameError, refuse
from glbench.evaluation import load_result
from glbench.evaluation.saving import recorded_actions, task_of_result
from glbench.resources import data_folder
from glbench.tasks import TaskSpec, get_task

BASELINE = "best_known"
"""Name of the baseline that carries out the best known plans."""


@dataclass(frozen=True)
class PlanComparison:
    """A plan for a run and the best known one: what each earns; ``best_value`` is ``None`` if there is no best known plan."""

    task: TaskSpec
    seed: int
    value: PlanValue
    best_value: PlanValue | None

    @property
    def is_better(self) -> bool:
        """Whether the plan replaces the best known one."""
        return self.best_value is None or self.value.reward > self.best_value.reward


def best_known() -> PlanFolder:
    """The best known plans."""
    settings = read_baseline(BASELINE).settings
    assert isinstance(settings, PlanFolder)
    return settings


def submit(files: Sequence[Path], folder: PlanFolder | None = None) -> Iterator[PlanComparison]:
    """Replay plans, replace the best known ones with those that earn more, and yield each run's comparison once the books are written.

    ``files`` are books of plans (``.npz``), folders of such books, or results (``.json``) with recorded actions beside them. The best known
    plans are in ``folder``; by default that of the baseline ``best_known``. Raises ``GlbenchError`` when a file cannot be read, was made
    for another version of its task, or a plan cannot be simulated.
    """
    folder = folder or best_known()
    shipped = folder.folder.resolve().is_relative_to(data_folder("baselines").resolve())
    for task, book in _batches(files):
        if shipped and not task.locked:
            raise SubmissionError(_not_published(task.id, task.digest))
        if shipped and (task.split not in (None, "test") or not {*book.seeds} <= {*task.evaluation.seeds}):
            refuse(f"Best known plans are for scored runs only, and some of these plans for {task.id} are for other runs.", SubmissionError)
        place = folder.place(task)
        best_book = read_book(place) if place.is_file() else None
        reason = None if best_book is None else best_book.why_not(task)
        if reason is not None:
            refuse(f"The best known plans in {place} do not fit: {reason}. Remove the file first.", GlbenchError)
        values = replay_plans(task, book, book.seeds)
        common = [seed for seed in book.seeds if best_book is not None and seed in best_book.runs]
        best_values = replay_plans(task, best_book, common) if best_book is not None and common else {}
        comparisons = [PlanComparison(task, seed, values[seed], best_values.get(seed)) for seed in book.seeds]
        better = [comparison.seed for comparison in comparisons if comparison.is_better]
        if better:
            better_book = book.only(better)
            first = {number: seed for seed, number in better_book.runs.items()}  # runs that share a plan earn the same
            about = ({**one, "glbench": __version__, **values[first[number]]._asdict()} for number, one in enumerate(better_book.about))
            better_book = replace(better_book, about=tuple(about))
            (better_book if best_book is None else best_book.merged(better_book)).save(place)
        yield from comparisons


def repeats_actions(result: Path, folder: Path) -> Path:
    """Write an agent into ``folder`` that repeats what was done in the runs of a result, and return its folder: a start for a ``Search``.

    Raises ``GlbenchError`` when the result has no recorded actions beside it, or they cannot be plans.
    """
    ((task, book),) = candidates(result)
    name = f"actions_of_{result.stem}"
    book.save(PlanFolder(folder / name).place(task))
    save_card(folder / name, f"Actions of {result.stem} on {task.id}", f"Repeats what was done in the runs of {result.name}.")
    return folder / name


def _not_published(task_id: str, digest: str) -> str:
    return (
        f"Best known plans are those of published tasks, and {task_id} with the digest {digest[:12]} is not one. "
        "For your own task, evaluate the folder that `glbench bound FILE` wrote: glbench evaluate FOLDER --task FILE"
    )


def _batches(files: Sequence[Path]) -> Iterator[tuple[TaskSpec, PlanBook]]:
    """The plans in the files, in batches of one task and different runs, so that each batch is replayed at once."""
    batch: tuple[TaskSpec, PlanBook] | None = None
    books: list[Path] = []
    for file in files:
        plans = sorted(file.glob("*.npz")) if file.is_dir() else [file]
        if not plans:
            refuse(f"There are no plans in {file}. `glbench bound TASK` searches for some.", SubmissionError)
        books += plans
    for file in books:
        for task, book in candidates(file):
            if batch is None:
                batch = task, book
            elif batch[1].same_task == book.same_task and not set(batch[1].runs) & set(book.runs):
                batch = task, batch[1].merged(book)
            else:
                yield batch
                batch = task, book
    if batch is not None:
        yield batch


def candidates(file: Path) -> Iterator[tuple[TaskSpec, PlanBook]]:
    """The plans in a file, with their task. Raises ``GlbenchError`` when the file has no plans that can be replayed."""
    if file.suffix == ".json":
        result = load_result(file)
        log, task = recorded_actions(result, file), task_of_result(result, file)
        agent = log.provenance.agent
        if agent.acts != "actions" or task.salt_commitment is not None:
            msg = f"{file} holds no plans: {agent.name} sets controls past the task's actuation, or its draws are secret."
            raise SubmissionError(msg)
        about = {"method": f"actions of {agent.name}", "agent_digest": agent.digest, "glbench": __version__}
        whole = [row for row, run in enumerate(log.runs) if run.status == "ok"]
        if not whole:
            refuse(f"{file} holds no plans: all of its runs failed.", SubmissionError)
        books = [PlanBook.of(task, [log.seeds[row]], log.actions[:, row], about) for row in whole]
        book = books[0]
        for other in books[1:]:
            book = book.merged(other)
        yield task, book
        return
    book = read_book(file)
    try:
        task = get_task(book.task_id)
    except UnknownNameError as error:
        raise SubmissionError(_not_published(book.task_id, book.task_digest)) from error
    task = task.in_split(book.split) if book.split else task
    reason = book.why_not(task)
    if reason is not None:
        refuse(f"The plans in {file} are not for this version of {task.id}: {reason}.", SubmissionError)
    yield task, book
