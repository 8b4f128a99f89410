"""One agent on one task, with everything decided: running it, going on where it was interrupted, saving what comes out."""

from __future__ import annotations

import datetime as dt
import hashlib
import logging
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import filelock
import rfc8785

from glbench import __version__
from glbench.agents import LoadedAgent
from glbench.env import Simulation
from glbench.episodes import Recorder, actions_path, log_bytes, provenance_of
from glbench.errors import GlbenchError, ResultError
from glbench.evaluation import provenance
from glbench.evaluation.checkpoint import Checkpoint, Saved, discard, holds_checkpoint, read_checkpoint
from glbench.evaluation.drivers import make_driver
from glbench.evaluation.episodes import forget_episodes, make_episodes, run_facts, write_episodes
from glbench.evaluation.files import SavingError, ensure_writable, result_path, save_result, short_task_id
from glbench.evaluation.limits import TimeLimits
from glbench.evaluation.lockstep import Lockstep, ProgressCallback, Watcher
from glbench.evaluation.metrics import UNITS
from glbench.evaluation.records import (
    AgentRecord,
    EvaluationRecord,
    RecordReference,
    Result,
    TaskRecord,
    results_digest,
    summarise,
)
from glbench.evaluation.tally import Tally
from glbench.kernel import Kernel, KernelPool, make_kernel
from glbench.model import CONTROL_NAMES
from glbench.resources import write_atomically
from glbench.tasks import TaskSpec, task_card

logger = logging.getLogger(__name__)

_CHECKPOINT_FORMAT = 2


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

    @property
    def path(self) -> Path | None:
        """Where the result is or will be saved; ``None`` without a folder."""
        return None if self.out is None else result_path(self.out, self.task.id, self.agent.name)

    @property
    def interrupted(self) -> bool:
        """Whether there is a checkpoint to go on from."""
        return self._folder is not None and holds_checkpoint(self._folder)

    def forget(self) -> None:
        """Throw the checkpoint away, so that ``run`` starts from the beginning."""
        if self._folder is not None:
            discard(self._folder)

    def run(self, progress: ProgressCallback | None = None, watcher: Watcher | None = None) -> Result:
        """Run it, from its checkpoint if there is one, and save the result; ``watcher`` looks on.

        Raises
        ------
        SubmissionError
            When the agent cannot be made.
        SavingError
            When the runs are over and the result, its record or its episodes cannot be written; it has the result.
        GlbenchError
            When another process works on the same result.
        """
        with self._alone(), _open_kernel(self.task, self.workers) as kernel:
            simulation = Simulation(self.task, len(self.seeds), kernel=kernel)
            result, recorder = self._resumed(simulation, progress, watcher) or self._from_the_start(
                simulation, progress, watcher
            )
            if self.out is not None:
                result = self._save(result, recorder, simulation, self.out)
                discard(self._agent_folder(self.out))
        return result

    def complete_episodes(self, result: Result) -> None:
        """Make the full episodes that are wanted and not there yet, by replaying the recorded actions of ``result``.

        Raises
        ------
        EpisodeError
            When the recorded actions are missing, damaged, or of another result.
        """
        if self.path is not None and self.episodes != ("none",):
            make_episodes(self.episodes, result, self.path, self.task)

    def _save(self, result: Result, recorder: Recorder, simulation: Simulation, out: Path) -> Result:
        """Write the actions, then the result that names their digest, then full episodes."""
        path = result_path(out, self.task.id, self.agent.name)
        provenance = provenance_of(self.task, self.agent, self.kernel)
        log = recorder.log(simulation, provenance, run_facts(result.runs))
        actions = actions_path(path)
        result = result.model_copy(update={"record": RecordReference(file=actions.name, digest=log.digest)})
        # The small result before the large record: a disk that fills up must not take the result down. A record of an
        # earlier evaluation goes first, so that none stands beside a result that it does not belong to.
        lacking = "Nothing of this evaluation is saved"
        try:
            actions.unlink(missing_ok=True)
            save_result(result, out)
            lacking = "The result is saved, and not the recorded actions, without which nobody can verify it"
            write_atomically(actions, log_bytes(log))
            lacking = "The result and its recorded actions are saved, and not all of the full episodes"
            forget_episodes(path)
            write_episodes(self.episodes, result, path, self.task, log, recorder.trace)
        except (GlbenchError, OSError) as error:
            msg = f"{error}\n{lacking}: free some space; the same command then {self._what_is_left(actions)}."
            raise SavingError(msg, result) from error
        return result

    def _what_is_left(self, actions: Path) -> str:
        """What the same command does after a result could not be saved."""
        if actions.is_file():
            return "makes those that are missing"
        return "goes on from the last checkpoint" if self.interrupted else "evaluates again"

    def _from_the_start(
        self, simulation: Simulation, progress: ProgressCallback | None, watcher: Watcher | None
    ) -> tuple[Result, Recorder]:
        self.forget()
        lockstep, tally, recorder = self._lockstep(simulation, progress, watcher)
        lockstep.start()
        lockstep.run(simulation.reset(self.seeds), 0)
        return self._result(tally, lockstep.wall_seconds, None), recorder

    def _resumed(
        self, simulation: Simulation, progress: ProgressCallback | None, watcher: Watcher | None
    ) -> tuple[Result, Recorder] | None:
        """The result by way of the checkpoint; ``None`` when there is none or it leads nowhere."""
        saved = read_checkpoint(self._folder) if self._folder is not None else None
        if saved is None:
            return None
        lockstep, tally, recorder = self._lockstep(simulation, progress, watcher)
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

    def _lockstep(
        self, simulation: Simulation, progress: ProgressCallback | None, watcher: Watcher | None
    ) -> tuple[Lockstep, Tally, Recorder]:
        """A fresh agent, empty books and an empty record."""
        driver = make_driver(self.agent, self.task, task_card(self.task), len(self.seeds), self.limits)
        tally = Tally(self.seeds)
        checkpoint = Checkpoint(self._folder, self.checkpoint_seconds)
        columns = len(CONTROL_NAMES) if self.agent.privileged else len(self.task.actuation.controls)
        traced = self.out is not None and self.episodes != ("none",)
        recorder = Recorder(simulation, columns, traced=traced)
        return (
            Lockstep(simulation, driver, tally, checkpoint, recorder, self.limits, progress, watcher),
            tally,
            recorder,
        )

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
        )

    @property
    def _folder(self) -> Path | None:
        """Folder of this evaluation's checkpoint: its name changes with everything that the numbers depend on."""
        if self.out is None:
            return None
        key: dict[str, Any] = {
            "format": _CHECKPOINT_FORMAT,
            "glbench": __version__,
            "task": self.task.digest,
            "agent": self.agent.digest,
            "seeds": list(self.seeds),
            "kernel": self.kernel,
        }
        return self._agent_folder(self.out) / hashlib.sha256(rfc8785.dumps(key)).hexdigest()[:16]

    def _agent_folder(self, out: Path) -> Path:
        return out / ".partial" / short_task_id(self.task.id) / self.agent.name

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Hold the lock of this result: two processes would write each other's checkpoints."""
        if self.out is None:
            yield
            return
        folder = self._agent_folder(self.out)
        ensure_writable(result_path(self.out, self.task.id, self.agent.name).parent)
        ensure_writable(folder.parent)
        lock = filelock.FileLock(folder.with_name(f"{folder.name}.lock"), blocking=False)
        try:
            lock.acquire()
        except filelock.Timeout as error:
            msg = (
                f"Another glbench process is evaluating '{self.agent.name}' on {self.task.id} into {self.out}. "
                "Wait for it, or choose another folder with --out."
            )
            raise GlbenchError(msg) from error
        try:
            yield
        finally:
            # Removed while it is held, so that nobody else's is; folders that others use are not empty and stay.
            Path(lock.lock_file).unlink(missing_ok=True)
            lock.release()
            for left in (folder.parent, folder.parent.parent):
                with suppress(OSError):
                    left.rmdir()


def agent_record(agent: LoadedAgent) -> AgentRecord:
    """The agent as results name it."""
    return AgentRecord(
        name=agent.name,
        kind=agent.kind,
        digest=agent.digest,
        privileged=agent.privileged,
        information=agent.information,
    )


@contextmanager
def _open_kernel(task: TaskSpec, workers: int) -> Iterator[Kernel | KernelPool | None]:
    """A kernel whose rows several cores share, or ``None`` for the one that all simulations of this thread share."""
    if workers == 1:
        yield None
        return
    with make_kernel(task.step_seconds, workers=workers, variant=task.model.variant) as kernel:
        yield kernel
