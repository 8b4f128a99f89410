"""One agent on one task, with everything decided: running it, going on where it was interrupted, saving what comes out."""

from __future__ import annotations

import datetime as dt
import hashlib
import logging
from collections.abc import Iterator
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import rfc8785

from glbench import __version__
from glbench.agents import Identity, LoadedAgent
from glbench.env import Simulation
from glbench.episodes import Recorder, provenance_of
from glbench.errors import ResultError, SubmissionError
from glbench.evaluation import provenance
from glbench.evaluation.checkpoint import Checkpoint, Saved, discard, holds_checkpoint, read_checkpoint
from glbench.evaluation.drivers import Driver, PerRunDriver, make_driver
from glbench.evaluation.episodes import make_episodes, run_facts
from glbench.evaluation.files import result_path
from glbench.evaluation.limits import TimeLimits
from glbench.evaluation.lockstep import Lockstep, ProgressCallback, Watcher
from glbench.evaluation.metrics import UNITS
from glbench.evaluation.records import (
    AgentRecord,
    EvaluationRecord,
    Result,
    TaskRecord,
    results_digest,
    summarise,
)
from glbench.evaluation.sandbox.choosing import Protection
from glbench.evaluation.sandbox.drivers import Guest, SandboxedRuns, sandboxed_driver
from glbench.evaluation.sandbox.limits import SandboxLimits
from glbench.evaluation.sandbox.prints import Prints
from glbench.evaluation.saving import Computed, agent_folder, alone, save
from glbench.evaluation.tally import Tally
from glbench.kernel import Kernel, make_kernel
from glbench.model import CONTROL_NAMES
from glbench.tasks import TaskSpec, task_card

logger = logging.getLogger(__name__)

_CHECKPOINT_FORMAT = 3


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
    stored: Result | None
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

    def run(self, progress: ProgressCallback | None = None, watcher: Watcher | None = None) -> Result:
        """Run it, from its checkpoint if there is one, and save the result; ``watcher`` looks on.

        Raises
        ------
        SubmissionError
            When the agent cannot be made.
        SandboxError
            When its sandbox cannot be built.
        SavingError
            When the runs are over and the result, its record or its episodes cannot be written; it has the result.
        GlbenchError
            When another process works on the same result.
        """
        with self.alone():
            computed = self.compute(progress, watcher)
            return self.save(computed)

    def compute(self, progress: ProgressCallback | None = None, watcher: Watcher | None = None) -> Computed:
        """Run it, from its checkpoint if there is one, and save nothing but checkpoints. Errors as for ``run``."""
        with _open_kernel(self.task, self.workers) as kernel:
            simulation = Simulation(self.task, len(self.seeds), kernel=kernel)
            result, recorder = self._resumed(simulation, progress, watcher) or self._from_the_start(
                simulation, progress, watcher
            )
            provenance = provenance_of(self.task, self.agent, self.kernel)
            log = recorder.log(simulation, provenance, run_facts(result.runs))
        return Computed(result, log, recorder.trace, self.prints.text())

    def save(self, computed: Computed) -> Result:
        """Save what was computed, if there is a folder for it, and remove the checkpoint.

        Raises
        ------
        GlbenchError
            When it cannot be written.
        """
        if self.out is None:
            return computed.result
        result = save(computed, self.out, self.task, self.episodes, checkpointed=self.interrupted)
        discard(agent_folder(self.out, self.task.id, self.agent.name))
        return result

    def alone(self) -> AbstractContextManager[None]:
        """Hold the lock of this result, if it is to be saved.

        Raises
        ------
        GlbenchError
            When another process holds it, or the folder cannot be written.
        """
        return nullcontext() if self.out is None else alone(self.out, self.task.id, self.agent.name)

    def complete_episodes(self, result: Result) -> None:
        """Make the full episodes that are wanted and not there yet, by replaying the recorded actions of ``result``.

        Raises
        ------
        EpisodeError
            When the recorded actions are missing, damaged, or of another result.
        """
        if self.path is not None and self.episodes != ("none",):
            make_episodes(self.episodes, result, self.path, self.task)

    def _from_the_start(
        self, simulation: Simulation, progress: ProgressCallback | None, watcher: Watcher | None
    ) -> tuple[Result, Recorder]:
        self.forget()
        with self._lockstep(simulation, progress, watcher) as (lockstep, tally, recorder):
            lockstep.start()
            lockstep.run(simulation.reset(self.seeds), 0)
            return self._result(tally, lockstep.wall_seconds, None), recorder

    def _resumed(
        self, simulation: Simulation, progress: ProgressCallback | None, watcher: Watcher | None
    ) -> tuple[Result, Recorder] | None:
        """The result by way of the checkpoint; ``None`` when there is none or it leads nowhere."""
        saved = read_checkpoint(self.folder) if self.folder is not None else None
        if saved is None:
            return None
        with self._lockstep(simulation, progress, watcher) as (lockstep, tally, recorder):
            lockstep.start()
            if not self._replayed(lockstep, saved):
                return None
            lockstep.run(simulation.observe(), saved.step)
            return self._result(tally, lockstep.wall_seconds, saved.step), recorder

    def _replayed(self, lockstep: Lockstep, saved: Saved) -> bool:
        try:
            if lockstep.replay(saved):
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

    @contextmanager
    def _lockstep(
        self, simulation: Simulation, progress: ProgressCallback | None, watcher: Watcher | None
    ) -> Iterator[tuple[Lockstep, Tally, Recorder]]:
        """A fresh agent, empty books and an empty record; the agent is let go in the end."""
        tally = Tally(self.seeds)
        checkpoint = Checkpoint(self.folder, self.checkpoint_seconds)
        columns = len(CONTROL_NAMES) if self.agent.privileged else len(self.task.actuation.controls)
        recorder = Recorder(simulation, columns, traced=self.out is not None)
        with closing(self._driver()) as driver:
            lockstep = Lockstep(simulation, driver, tally, checkpoint, recorder, self.limits, progress, watcher)
            yield lockstep, tally, recorder

    def _driver(self) -> Driver:
        """The agent in its harness, made and not yet reset."""
        card, n = task_card(self.task), len(self.seeds)
        if self.submission is None:
            driver = make_driver(self.agent, self.task, card, n, self.limits)
        else:
            driver = sandboxed_driver(Guest(self.submission, card, n, self.limits, self.sizes, self.prints))
        if self.is_part and not isinstance(driver, PerRunDriver | SandboxedRuns):
            driver.close()
            msg = f"'{self.agent.name}' decides for all runs at once: they cannot be computed apart."
            raise JointAgentError(msg)
        return driver

    def _result(self, tally: Tally, wall_seconds: float, resumed_at: int | None) -> Result:
        task, failed_step = self.task, self.task.evaluation.failed_step
        runs = tally.results(
            task.steps, {"reward": failed_step.reward, "epi": failed_step.epi, "penalty": failed_step.penalty}
        )
        agent = agent_record(self.agent)
        return Result(
            task=TaskRecord(
                id=task.id, digest=task.digest, title=task.title, steps=task.steps, step_seconds=task.step_seconds
            ),
            agent=agent,
            evaluation=self._evaluation_record(tally, wall_seconds, resumed_at),
            versions=provenance.versions(),
            machine=provenance.machine(),
            git=provenance.git_state(),
            created=dt.datetime.now(dt.UTC).isoformat(timespec="seconds"),
            units=UNITS,
            runs=runs,
            summary=summarise(runs),
            results_digest=results_digest(task.digest, agent, runs),
        )

    def _evaluation_record(self, tally: Tally, wall_seconds: float, resumed_at: int | None) -> EvaluationRecord:
        steps = int(tally.steps.sum())
        decision_seconds = float(tally.seconds.sum())
        return EvaluationRecord(
            runs=len(self.seeds),
            seeds=self.seeds,
            workers=self.workers,
            wall_seconds=wall_seconds,
            steps_per_second=steps / wall_seconds,
            decision_seconds=decision_seconds,
            decision_milliseconds=1e3 * decision_seconds / max(steps, 1),
            resumed_at_step=resumed_at,
            limits=self.limits.as_dict(),
            kernel=self.kernel,
            sandbox=self.protection,
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
        }
        return (
            agent_folder(self.out, self.task.id, self.agent.name) / hashlib.sha256(rfc8785.dumps(key)).hexdigest()[:16]
        )


def agent_record(agent: LoadedAgent) -> AgentRecord:
    """The agent as results name it."""
    return AgentRecord(
        name=agent.name,
        kind=agent.kind,
        digest=agent.digest,
        privileged=agent.privileged,
        information=agent.information,
        card=agent.submission.card if agent.submission is not None else None,
    )


@contextmanager
def _open_kernel(task: TaskSpec, workers: int) -> Iterator[Kernel | None]:
    """A kernel whose rows several cores share, or ``None`` for the one that all simulations of this thread share."""
    if workers == 1:
        yield None
        return
    with make_kernel(task.model_value, task.step_seconds, workers=workers) as kernel:
        yield kernel
