"""An evaluation: one agent on one task with everything decided, run from the start or from a checkpoint, and saved."""

from __future__ import annotations

import datetime as dt
import logging
from contextlib import AbstractContextManager, closing, nullcontext, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, cast

from glbench import __version__
from glbench.agents import Identity, LoadedAgent
from glbench.agents.card import Split
from glbench.canonical import canonical_sha256
from glbench.env import Simulation
from glbench.env.kernels import shared_kernel
from glbench.episodes import Recorder, chosen_rows, parse_selection, provenance_of
from glbench.episodes.header import versions as recorded_versions
from glbench.errors import EpisodeError, GlbenchError, ResultError, SandboxError, SubmissionError, TaskError, refuse, whole_number
from glbench.evaluation import records, saving
from glbench.evaluation.checkpoint import Checkpoint, Saved, discard, holds_checkpoint, read_checkpoint
from glbench.evaluation.files import ensure_writable, load_result, result_path
from glbench.evaluation.limits import TimeLimits
from glbench.evaluation.metrics import units_of
from glbench.evaluation.rollout import Progress, ProgressCallback, RolloutLoop, RunTotals, StepCallback
from glbench.evaluation.runners import AgentRunner, make_runner
from glbench.evaluation.sandbox.choosing import Protected, Protection, SandboxChoice, protect
from glbench.evaluation.sandbox.frames import Prints, SandboxLimits
from glbench.evaluation.saving import Computed, agent_folder, complete_profile, make_episodes, result_lock, run_facts, save, settle, tidy
from glbench.kernel import make_kernel
from glbench.tasks import TaskSpec, get_task, task_card
from glbench.untrusted import real_path

logger = logging.getLogger(__name__)

_LARGEST_SEED = 2**53 - 1  # Largest whole number that every reader of JSON keeps exactly
CHECKPOINT_SECONDS = 2.0  # Shortest time between two checkpoints: what a kill costs at most, besides one step


ROUNDS = "rounds"  # Folder below ``out`` for sealed rounds, each in a folder that begins as its commitment does
_SHOWN_COMMITMENT = 16
TRIALS, VALIDATION = "trials", "validation"  # Folder below ``out`` for trials, which are evaluations with other seeds than the task's
_MOST_RUNS = 10_000
_CHECKPOINT_FORMAT = 4


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
    if task.split == "preview":
        refuse(f"{task.id} is in its preview, whose seasons are not scored. Evaluate the task as get_task gives it.", TaskError)
    task = task.scored
    protected = agent if isinstance(agent, Protected) else protect(agent, sandbox)
    agent = protected.agent
    if task.sealed and protected.protection == "unsandboxed":
        msg = (
            f"'{agent.name}' would run without a sandbox, in the process that holds the secret of the round, and could read it. "
            "In a round submissions run with --sandbox bubblewrap only."
        )
        raise SandboxError(msg)
    seeds = _seeds(task, runs, first_seed)
    choice = parse_selection(episodes)
    chosen_rows(choice, seeds, [0.0] * len(seeds))  # a seed that no run has is reported now, not after the evaluation
    workers = None if workers is None else whole_number(workers, "The number of workers")
    if workers is not None and workers < 1:
        refuse(f"An evaluation needs at least one worker; got {workers}.", GlbenchError)
    # Absolute at once: an agent may change the working directory.
    folder = None if out is None else results_folder(real_path(Path(out).expanduser()), task)
    kernel = shared_kernel(task.model_value, task.step_seconds).describe()
    limits = limits or TimeLimits.of_table(task.evaluation.time_limits)
    stored = None
    if folder is not None and task.split == "validation":
        folder = folder / VALIDATION
    elif folder is not None and seeds != tuple(task.evaluation.seeds):
        folder = folder / TRIALS
    if folder is not None:
        ensure_writable(result_path(folder, task.id, agent.name).parent)
        settle(folder, task.id, agent.name)
        stored = _finished(folder, task, agent, seeds, kernel, protected.protection, limits, fresh=fresh)
    workers = min(workers or records.usable_cores(), len(seeds))
    evaluation = Evaluation(
        task, agent, seeds, workers, kernel, folder, limits, checkpoint_seconds, stored, choice, protected.protection, protected.submission
    )
    if fresh:
        evaluation.forget()
    if stored is not None and folder is not None and evaluation.folder is not None:
        tidy(folder, task.id, agent.name, evaluation.folder)
    return evaluation


def results_folder(out: Path, task: TaskSpec) -> Path:
    """Folder of the results of ``task``: ``out`` with public draws, ``<out>/rounds/<commitment>`` in a sealed round."""
    commitment = task.salt_commitment
    return out if commitment is None else out / ROUNDS / commitment[:_SHOWN_COMMITMENT]


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
) -> records.Result:
    """Evaluate an agent on a task over seeded runs.

    Raises ``GlbenchError`` for an unknown task, an agent that cannot be loaded, a folder that cannot be written, impossible numbers.

    Parameters
    ----------
    task
        A task, its id or the path of its file. One with splits is evaluated on its test; in validation (``task.in_split("validation")``) it
        makes a trial; one of a sealed round (``task.in_split("test", sealed=round.secret)``) has secret draws; a preview is refused.
    agent
        The path of a submission, the name of a baseline, an agent that was loaded already, or what ``protect`` made of one of them.
    runs, first_seed
        Number of runs and seed of the first; by default what the task says. Run i has the seed ``first_seed + i``.
    workers
        Processes that share the simulation of the runs. The numbers do not depend on it.
    out
        Folder for the result (``<out>/results/<task>/<agent>.json``) and for the checkpoint of an interrupted evaluation.
        A trial, with other seeds than the task's, is saved below ``<out>/trials``, one on the validation split below
        ``<out>/validation``. Without it nothing is written.
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
        evaluation.complete(evaluation.stored)
    return evaluation.stored or evaluation.run(progress)


def _seeds(task: TaskSpec, runs: int | None, first_seed: int | None) -> tuple[int, ...]:
    runs = task.evaluation.runs if runs is None else whole_number(runs, "The number of runs")
    first = task.evaluation.first_seed if first_seed is None else whole_number(first_seed, "The seed of the first run")
    if runs < 1:
        refuse(f"An evaluation needs at least one run; got {runs}.", GlbenchError)
    if runs > _MOST_RUNS:
        msg = f"An evaluation has at most {_MOST_RUNS:,} runs; got {runs:,}. Divide them: the seed of the first run is yours to choose."
        raise GlbenchError(msg)
    if first < 0 or first + runs - 1 > _LARGEST_SEED:
        refuse(f"Seeds lie between 0 and 2^53 - 1; got {runs} runs from seed {first}.", GlbenchError)
    return tuple(range(first, first + runs))


def _finished(
    out: Path,
    task: TaskSpec,
    agent: LoadedAgent,
    seeds: tuple[int, ...],
    kernel: dict[str, str | float],
    protection: Protection,
    limits: TimeLimits,
    *,
    fresh: bool,
) -> records.Result | None:
    """The stored result of this very evaluation; one from a sandbox does where none is wanted, and not the other way round.

    A ``fresh`` evaluation gets ``None``: it may replace a result of the same task, but not one of another task. Raises ``ResultError`` when
    the result of another task stands there: of another namespace, or of the same id with another definition.
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
    if fresh:
        return None
    if stored.task.digest != task.digest:
        msg = (
            f"{path} holds a result of another task with the same id {task.id} (digest {stored.task.digest[:8]}, this one has "
            f"{task.digest[:8]}), and this evaluation would replace it. Give the task an id of its own, choose another folder with "
            "--out, or replace the result with --fresh."
        )
        raise ResultError(msg)
    if stored.task.salt_commitment != task.salt_commitment:
        refuse(f"{path} holds a result with other draws than these. Choose another folder with --out.", ResultError)
    made_by = (stored.task.digest, stored.agent.digest, stored.evaluation.kernel, stored.versions.glbench)
    if made_by != (task.digest, agent.digest, kernel, __version__) or stored.agent.training != agent_record(agent).training:
        return None
    weaker = protection == "bubblewrap" and stored.evaluation.sandbox != "bubblewrap"
    if weaker or stored.evaluation.seeds != seeds or stored.task.split != task.split or stored.evaluation.limits != _seconds_of(limits):
        return None
    try:
        saving.recorded_actions(stored, path)
    except EpisodeError:
        logger.warning("The recorded actions of %s are missing or damaged, so that nobody can verify it; evaluating again.", path)
        return None
    return stored


class JointAgentError(SubmissionError):
    """An agent that decides for all runs at once was asked for some of them."""


@dataclass(frozen=True)
class Evaluation:
    """One agent on one task with everything decided, ready to be run. Made by ``prepare``."""

    task: TaskSpec
    agent: LoadedAgent
    seeds: tuple[int, ...]
    workers: int
    kernel: dict[str, str | float]
    out: Path | None
    limits: TimeLimits
    checkpoint_seconds: float
    stored: records.Result | None
    """The finished result, when this very evaluation has been done before."""
    episodes: tuple[str, ...] = ("none",)
    """Which runs are kept as full episodes; see ``glbench.episodes.parse_selection``."""
    protection: Protection = "unsandboxed"
    """How the agent runs, as the result will say."""
    submission: Identity | None = None
    """What goes into the sandbox, if there is one."""
    sizes: SandboxLimits = field(default_factory=SandboxLimits)
    prints: Prints = field(default_factory=Prints, compare=False, repr=False)
    """What a sandboxed agent printed."""
    checkpoints: Path | None = None
    """Folder of the checkpoint, where it is not to be the usual one below ``out``."""
    is_part: bool = False
    """Whether these are some of the runs of a larger evaluation, which only agents for single runs may be divided into."""

    @property
    def path(self) -> Path | None:
        """Where the result is or will be saved; ``None`` without a folder."""
        return None if self.out is None else result_path(self.out, self.task.id, self.agent.name)

    @property
    def interrupted(self) -> bool:
        """Whether there is a checkpoint to go on from."""
        return self.folder is not None and holds_checkpoint(self.folder)

    def forget(self) -> None:
        """Throw the checkpoint away, so that ``run`` starts from the beginning."""
        if self.folder is not None:
            discard(self.folder)

    def check_start(self) -> None:
        """Raises ``SubmissionError`` when the agent cannot be made for the task, or cannot begin a run of it."""
        with closing(self._runner()) as runner:
            for failure in runner.start():
                refuse(f"'{self.agent.name}' cannot begin {self.task.id}: {failure.reason}.", SubmissionError)

    def run(self, progress: ProgressCallback | None = None, callback: StepCallback | None = None) -> records.Result:
        """Run it, from its checkpoint if there is one, and save the result; ``callback`` looks on.

        Raises ``SubmissionError`` when the agent cannot be made. Raises ``SandboxError`` when its sandbox cannot be built. Raises
        ``SavingError`` when the runs are over and the result, its record or its episodes cannot be written; it has the result. Raises
        ``GlbenchError`` when another process works on the same result.
        """
        with self.result_lock():
            return self.save(self.compute(progress, callback))

    def compute(self, progress: ProgressCallback | None = None, callback: StepCallback | None = None) -> Computed:
        """Run it, from its checkpoint if there is one, and save nothing but checkpoints. Errors as for ``run``."""
        task, workers = self.task, self.workers
        # with several cores a kernel whose rows they share, otherwise the one that all simulations of this thread share
        own = nullcontext() if workers == 1 else make_kernel(task.model_value, task.step_seconds, workers=workers)
        with own as kernel:
            simulation = Simulation(self.task, len(self.seeds), kernel=kernel)
            saved = read_checkpoint(self.folder) if self.folder is not None else None
            outcome = self._rolled_out(simulation, saved, progress, callback) if saved is not None else None
            if outcome is None:
                self.forget()
                outcome = self._rolled_out(simulation, None, progress, callback)
            assert outcome is not None  # from the start on there is nothing that the agent could do otherwise
            result, recorder = outcome
            provenance = provenance_of(self.task, self.agent, self.kernel)
            log = recorder.log(simulation, provenance, run_facts(result.runs))
        return Computed(result, log, recorder.trace, self.prints.text())

    def save(self, computed: Computed) -> records.Result:
        """Save what was computed, if there is a folder, and remove the checkpoint. Raises ``GlbenchError`` when it cannot be written."""
        if self.out is None:
            return computed.result
        result = save(computed, self.out, self.task, self.episodes, checkpointed=self.interrupted)
        if self.folder is not None:
            discard(self.folder)
            with suppress(OSError):  # unfinished work of other evaluations stays
                self.folder.parent.rmdir()
        return result

    def result_lock(self) -> AbstractContextManager[None]:
        """Lock this result, if it is to be saved. Raises ``GlbenchError`` when another process does, or no folder can be written."""
        return nullcontext() if self.out is None else result_lock(self.out, self.task.id, self.agent.name)

    def complete(self, result: records.Result) -> None:
        """Make the profile and the wanted full episodes where they are not there, by replaying the recorded actions of ``result``.

        Raises ``EpisodeError`` when the recorded actions are missing, damaged, or of another result, ``ResultError`` for another profile.
        """
        if self.path is None:
            return
        complete_profile(result, self.path, self.task)
        if self.episodes != ("none",):
            make_episodes(self.episodes, result, self.path, self.task)

    def _rolled_out(
        self, simulation: Simulation, saved: Saved | None, progress: ProgressCallback | None, callback: StepCallback | None
    ) -> tuple[records.Result, Recorder] | None:
        """Result and record of a fresh agent, from the start or on from ``saved``; ``None`` when it cannot be brought back there."""
        totals, n = RunTotals(self.task, self.seeds), len(self.seeds)
        if progress is not None:
            progress(Progress(0, self.task.steps, n, n, waiting="loading", limit=self.limits.start))
        checkpoint = Checkpoint(self.folder, self.checkpoint_seconds)
        with closing(self._runner()) as runner:
            recorder = Recorder(simulation, runner.shape[1], traced=self.out is not None)
            rollout = RolloutLoop(simulation, runner, totals, checkpoint, recorder, self.limits, progress, callback)
            rollout.start()
            if saved is None:
                rollout.run(simulation.reset(self.seeds), 0)
            elif self._replayed(rollout, saved):
                rollout.run(simulation.observe(), saved.step)
            else:
                return None
            result = self.result(
                totals.results(),
                workers=self.workers,
                wall_seconds=rollout.wall_seconds,
                decision_seconds=float(totals.seconds.sum()),
                resumed_at=saved.step if saved is not None else None,
            )
            return result, recorder

    def _replayed(self, rollout: RolloutLoop, saved: Saved) -> bool:
        try:
            if rollout.replay(saved):
                return True
        except ResultError as error:
            logger.warning("The checkpoint cannot be used (%s); starting from the beginning.", error)
            return False
        logger.warning(
            "The interrupted evaluation of '%s' cannot be continued: shown the same observations again, the agent decided differently. "
            "It is not deterministic, or it depends on the clock. Starting from the beginning.",
            self.agent.name,
        )
        return False

    def _runner(self) -> AgentRunner:
        """The agent in its harness, made and not yet reset."""
        n = len(self.seeds)
        if self.submission is None:
            runner = make_runner(self.agent, self.task, task_card(self.task), self.seeds, self.limits)
        else:
            from glbench.evaluation.sandbox.runners import SandboxedAgent, sandboxed_runner

            runner = sandboxed_runner(SandboxedAgent.of(self.submission, self.task, n, self.limits, self.sizes, self.prints))
        if self.is_part and not runner.one_by_one:
            runner.close()
            refuse(f"'{self.agent.name}' decides for all runs at once: they cannot be computed apart.", JointAgentError)
        return runner

    def result(
        self, runs: tuple[records.RunResult, ...], *, workers: int, wall_seconds: float, decision_seconds: float, resumed_at: int | None
    ) -> records.Result:
        """The result of ``runs`` that were made by so many ``workers``, with the versions and the machine of this process."""
        task, agent = self.task, agent_record(self.agent)
        steps = sum(run.steps for run in runs)
        return records.Result(
            task=records.TaskRecord(
                id=task.id,
                digest=task.digest,
                title=task.title,
                steps=task.steps,
                step_seconds=task.step_seconds,
                split=cast("Split | None", task.split),
                years=None if task.salt_commitment is not None else task.season_years,
                salt_commitment=task.salt_commitment,
            ),
            agent=agent,
            evaluation=records.EvaluationRecord(
                runs=len(self.seeds),
                seeds=self.seeds,
                workers=workers,
                wall_seconds=wall_seconds,
                steps_per_second=steps / wall_seconds,
                decision_seconds=decision_seconds,
                decision_milliseconds=1e3 * decision_seconds / max(steps, 1),
                resumed_at_step=resumed_at,
                limits=_seconds_of(self.limits),
                kernel=self.kernel,
                sandbox=self.protection,
            ),
            versions=records.current_versions(recorded_versions(task)["model"]),
            machine=records.this_machine(),
            git=records.git_state(),
            created=dt.datetime.now(dt.UTC).isoformat(timespec="seconds"),
            units=units_of(task),
            runs=runs,
            summary=records.summarise(runs),
            results_digest=records.results_digest(task.digest, agent, runs, task.salt_commitment),
        )

    @property
    def folder(self) -> Path | None:
        """Folder of this evaluation's checkpoint: its name changes with everything that the numbers depend on."""
        if self.checkpoints is not None or self.out is None:
            return self.checkpoints
        key: dict[str, Any] = {
            "format": _CHECKPOINT_FORMAT,
            "glbench": __version__,
            "task": self.task.digest,
            "agent": self.agent.digest,
            "seeds": list(self.seeds),
            "kernel": self.kernel,
            "sandbox": self.protection,
            "limits": _seconds_of(self.limits),
        }
        if self.task.split == "validation":
            key["split"] = self.task.split
        if self.task.salt_commitment is not None:
            key["salt_commitment"] = self.task.salt_commitment
        return agent_folder(self.out, self.task.id, self.agent.name) / canonical_sha256(key)[:16]


def _seconds_of(limits: TimeLimits) -> dict[str, float]:
    """Time limits as results state them [s]."""
    return {f"{name}_seconds": value for name, value in asdict(limits).items()}


def agent_record(agent: LoadedAgent) -> records.AgentRecord:
    """The agent as results name it."""
    return records.AgentRecord(
        name=agent.name,
        kind=agent.kind,
        digest=agent.digest,
        privileged=agent.privileged,
        information=agent.information,
        card=agent.submission.card if agent.submission is not None else None,
        training=None if agent.training is None else records.TrainingRecord.model_validate(asdict(agent.training)),
    )
