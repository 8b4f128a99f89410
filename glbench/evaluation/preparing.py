"""From an agent and a task to a result: deciding everything, finding out whether it is done already, doing it."""

from __future__ import annotations

import logging
from pathlib import Path

from glbench import __version__
from glbench.agents import LoadedAgent
from glbench.env.kernels import shared_kernel
from glbench.episodes import chosen_rows, parse_selection
from glbench.errors import GlbenchError, ResultError, whole_number
from glbench.evaluation.files import ensure_writable, load_result, result_path
from glbench.evaluation.job import Evaluation
from glbench.evaluation.limits import TimeLimits
from glbench.evaluation.lockstep import ProgressCallback
from glbench.evaluation.provenance import usable_cores
from glbench.evaluation.records import Result
from glbench.evaluation.sandbox.choosing import Protected, Protection, SandboxChoice, protect
from glbench.evaluation.saving import settle, tidy
from glbench.tasks import TaskSpec, get_task

logger = logging.getLogger(__name__)

_LARGEST_SEED = 2**53 - 1
"""Largest whole number that every reader of JSON keeps exactly."""
CHECKPOINT_SECONDS = 2.0
"""Shortest time between two checkpoints: what a kill costs at most, besides one step."""


TRIALS = "trials"
"""Folder below ``out`` for trials, which are evaluations with other seeds than the task's."""
_MOST_RUNS = 10_000


def prepare(
    task: TaskSpec | str | Path,
    agent: LoadedAgent | Protected | str | Path,
    *,
    runs: int | None = None,
    first_seed: int | None = None,
    workers: int | None = 1,
    out: Path | str | None = None,
    fresh: bool = False,
    limits: TimeLimits | None = None,
    checkpoint_seconds: float = CHECKPOINT_SECONDS,
    episodes: str = "none",
    sandbox: SandboxChoice = "none",
) -> Evaluation:
    """Decide everything about an evaluation and find out what can go wrong before it starts.

    Arguments as for ``evaluate``; without a number of ``workers``, every usable core is one.
    """
    task = task if isinstance(task, TaskSpec) else get_task(task)
    protected = agent if isinstance(agent, Protected) else protect(agent, sandbox)
    agent = protected.agent
    seeds = _seeds(task, runs, first_seed)
    selection = parse_selection(episodes)
    chosen_rows(selection, seeds, [0.0] * len(seeds))  # a seed that no run has is told now, not after the evaluation
    workers = None if workers is None else whole_number(workers, "The number of workers")
    if workers is not None and workers < 1:
        msg = f"An evaluation needs at least one worker; got {workers}."
        raise GlbenchError(msg)
    # Absolute at once: an agent may change the working directory.
    folder = None if out is None else Path(out).expanduser().resolve()
    kernel = shared_kernel(task.model_value, task.step_seconds).describe()
    stored = None
    if folder is not None and seeds != tuple(task.evaluation.seeds):
        folder = folder / TRIALS
    if folder is not None:
        ensure_writable(result_path(folder, task.id, agent.name).parent)
        settle(folder, task.id, agent.name)
        stored = None if fresh else _finished(folder, task, agent, seeds, kernel, protected.protection)
    workers = min(workers or usable_cores(), len(seeds))
    evaluation = Evaluation(
        task,
        agent,
        seeds,
        workers,
        kernel,
        folder,
        limits or TimeLimits.of_table(task.evaluation.time_limits),
        checkpoint_seconds,
        stored,
        selection,
        protected.protection,
        protected.submission,
    )
    if fresh:
        evaluation.forget()
    if stored is not None and folder is not None and evaluation.folder is not None:
        tidy(folder, task.id, agent.name, evaluation.folder)
    return evaluation


def evaluate(
    task: TaskSpec | str | Path,
    agent: LoadedAgent | Protected | str | Path,
    *,
    runs: int | None = None,
    first_seed: int | None = None,
    workers: int = 1,
    out: Path | str | None = None,
    fresh: bool = False,
    limits: TimeLimits | None = None,
    checkpoint_seconds: float = CHECKPOINT_SECONDS,
    episodes: str = "none",
    sandbox: SandboxChoice = "none",
    progress: ProgressCallback | None = None,
) -> Result:
    """Evaluate an agent on a task over seeded runs.

    Parameters
    ----------
    task
        A task, its id, or the path of a task file.
    agent
        The path of a submission, the name of a baseline, an agent that was loaded already, or what ``protect`` made of one of them.
    runs, first_seed
        Number of runs and seed of the first; by default what the task says. Run i has the seed ``first_seed + i``.
    workers
        Processes that share the simulation of the runs. The numbers do not depend on it.
    out
        Folder for the result (``<out>/results/<task>/<agent>.json``) and for the checkpoint of an interrupted evaluation.
        A trial, with other seeds than the task's, is saved below ``<out>/trials``. Without it nothing is written.
    fresh
        Evaluate again even when the result is there, and from the beginning even when there is a checkpoint.
    limits
        Time that the agent may take; by default what the task says. See ``TimeLimits``.
    checkpoint_seconds
        Shortest time between two checkpoints [s]; 0 makes one after every step.
    episodes
        Runs that are kept as full episodes below ``out``: ``"all"``, ``"none"``, or a list such as ``"best,worst,median"``.
        The actions of all runs are kept anyway, so that episodes can be made later.
    sandbox
        ``"bubblewrap"`` runs a submission in a process of its own, in which it finds neither weather nor seeds nor network; ``"none"``
        runs it here, with all rights of this process. ``"auto"`` is ``"bubblewrap"``, except that unchanged examples of glbench run
        where there can be no sandbox. Whatever it is, the result has the same bits, and says how the agent ran.
    progress
        Called with a ``Progress`` after every step.

    Returns
    -------
    Result
        Also when runs failed: look at ``result.failed``. For pandas: ``result.to_frame()`` has one row a run and units in
        ``frame.attrs["units"]``.

    Raises
    ------
    GlbenchError
        For an unknown task, an agent that cannot be loaded, a folder that cannot be written, impossible numbers.
    """
    evaluation = prepare(
        task,
        agent,
        runs=runs,
        first_seed=first_seed,
        workers=workers,
        out=out,
        fresh=fresh,
        limits=limits,
        checkpoint_seconds=checkpoint_seconds,
        episodes=episodes,
        sandbox=sandbox,
    )
    if evaluation.stored is not None:
        evaluation.complete_episodes(evaluation.stored)
    return evaluation.stored or evaluation.run(progress)


def _seeds(task: TaskSpec, runs: int | None, first_seed: int | None) -> tuple[int, ...]:
    runs = task.evaluation.runs if runs is None else whole_number(runs, "The number of runs")
    first = task.evaluation.first_seed if first_seed is None else whole_number(first_seed, "The seed of the first run")
    if runs < 1:
        msg = f"An evaluation needs at least one run; got {runs}."
        raise GlbenchError(msg)
    if runs > _MOST_RUNS:
        msg = f"An evaluation has at most {_MOST_RUNS:,} runs; got {runs:,}. Divide them: the seed of the first run is yours to choose."
        raise GlbenchError(msg)
    if first < 0 or first + runs - 1 > _LARGEST_SEED:
        msg = f"Seeds lie between 0 and 2^53 - 1; got {runs} runs from seed {first}."
        raise GlbenchError(msg)
    return tuple(range(first, first + runs))


def _finished(
    out: Path,
    task: TaskSpec,
    agent: LoadedAgent,
    seeds: tuple[int, ...],
    kernel: dict[str, str | float],
    protection: Protection,
) -> Result | None:
    """The stored result of this very evaluation; one from a sandbox does where none is wanted, and not the other way round.

    Raises
    ------
    ResultError
        When the result of a task of another namespace stands there.
    """
    path = result_path(out, task.id, agent.name)
    if not path.exists():
        return None
    try:
        stored = load_result(path)
    except ResultError as error:
        logger.warning("%s The new result will replace it.", error)
        return None
    if stored.task.id != task.id:
        msg = f"{path} holds a result of the task {stored.task.id}, and {task.id} would replace it. Choose another folder with --out."
        raise ResultError(msg)
    made_by = (stored.task.digest, stored.agent.digest, stored.evaluation.kernel, stored.versions.glbench)
    if made_by != (task.digest, agent.digest, kernel, __version__):
        return None
    if protection == "bubblewrap" and stored.evaluation.sandbox != "bubblewrap":
        return None
    if stored.evaluation.seeds == seeds:
        if stored.record is not None and path.with_name(stored.record.file).is_file():
            return stored
        logger.warning("%s lacks its recorded actions, without which nobody can verify it; evaluating again.", path)
        return None
    return None
