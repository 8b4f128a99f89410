"""An interruption at any moment costs time and changes no bit."""

from __future__ import annotations

import io
import random
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from glbench.errors import GlbenchError
from glbench.evaluation import Progress, Result, checkpoint, evaluate, prepare
from glbench.tasks import TaskSpec
from tests.evaluation.agent_files import GOOD, AgentWriter


class StopError(Exception):
    """Stands for Ctrl-C, a bug, the end of the world."""


def stop_after(step: int) -> Callable[[Progress], None]:
    def progress(standing: Progress) -> None:
        if standing.step == step and not standing.replaying:
            raise StopError

    return progress


def interrupted_at(step: int, task: TaskSpec, agent: Path, out: Path) -> None:
    with pytest.raises(StopError):
        evaluate(task, agent, out=out, checkpoint_seconds=0.0, progress=stop_after(step))


def finish(task: TaskSpec, agent: Path, out: Path) -> tuple[Result, list[Progress]]:
    seen: list[Progress] = []
    return evaluate(task, agent, out=out, progress=seen.append), seen


@pytest.mark.parametrize("step", [*sorted(random.Random(20100301).sample(range(1, 24), 3)), 24])
def test_same_bits_with_and_without_interruption(
    day_task: TaskSpec, good_result: Result, write_agent: AgentWriter, tmp_path: Path, step: int
) -> None:
    agent = write_agent()
    interrupted_at(step, day_task, agent, tmp_path)
    resumed, seen = finish(day_task, agent, tmp_path)

    assert resumed.runs == good_result.runs
    assert resumed.results_digest == good_result.results_digest
    assert resumed.evaluation.resumed_at_step == step
    assert [p.step for p in seen if p.replaying] == list(range(1, step + 1))
    assert [p.step for p in seen if not p.replaying and p.waiting in ("", "act")] == list(range(step, 25))
    assert list(tmp_path.rglob("*.npz")) == [], "the checkpoint is removed when the result is there"


def test_several_interruptions_in_a_row(day_task: TaskSpec, good_result: Result, write_agent: AgentWriter, tmp_path: Path) -> None:
    agent = write_agent()
    for step in (3, 4, 11, 20):
        interrupted_at(step, day_task, agent, tmp_path)
    resumed, _ = finish(day_task, agent, tmp_path)

    assert resumed.evaluation.resumed_at_step == 20
    assert resumed.runs == good_result.runs


@pytest.mark.parametrize("agent", ["rule_based", "rule_based_fair"])
def test_baselines_resume(day_task: TaskSpec, agent: str, tmp_path: Path) -> None:
    with pytest.raises(StopError):
        evaluate(day_task, agent, out=tmp_path, checkpoint_seconds=0.0, progress=stop_after(9))
    resumed = evaluate(day_task, agent, out=tmp_path)

    assert resumed.evaluation.resumed_at_step == 9
    assert resumed.runs == evaluate(day_task, agent).runs


def test_failed_runs_stay_failed(day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path) -> None:
    act = """
        def act(self, observations):
            self.calls += 1
            self.memory = 0.9 * self.memory + 0.001 * observations[:, :6].astype(float)
            actions = np.tanh(self.memory)
            if self.calls == 4: actions[0] = np.nan
            if self.calls == 15: actions[2, 1] = 7.0
            return actions
        """
    agent = write_agent(act)
    interrupted_at(10, day_task, agent, tmp_path)
    resumed, _ = finish(day_task, agent, tmp_path)

    assert [(run.status, run.steps) for run in resumed.runs] == [("invalid_action", 3), ("ok", 24), ("invalid_action", 14)]
    assert resumed.runs == evaluate(day_task, agent).runs


def test_single_run_agents_resume_with_failed_runs_left_alone(day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path) -> None:
    agent = write_agent(
        """
        def reset(self, task):
            Agent.made = getattr(Agent, "made", 0) + 1
            self.number, self.calls, self.total = Agent.made, 0, 0.0
            if self.number == 3: raise RuntimeError("had enough before it began")
        def act(self, observation):
            self.calls += 1
            self.total += float(observation[0])
            if self.number == 2 and self.calls == 7: raise RuntimeError("had enough")
            return np.full(6, np.cos(self.total))
        """,
        single=True,
    )
    interrupted_at(12, day_task, agent, tmp_path)
    resumed, _ = finish(day_task, agent, tmp_path)

    assert [(run.status, run.steps) for run in resumed.runs] == [("ok", 24), ("crashed", 6), ("crashed", 0)]
    assert resumed.evaluation.resumed_at_step == 12
    assert resumed.runs == evaluate(day_task, agent).runs


def test_kill_9_loses_nothing_but_time(
    day_task_file: Path, day_task: TaskSpec, good_result: Result, write_agent: AgentWriter, tmp_path: Path
) -> None:
    agent = write_agent()
    code = (
        "import os, signal, sys\n"
        "from glbench.evaluation import evaluate\n"
        "def kill(p):\n    if p.step == 13: os.kill(os.getpid(), signal.SIGKILL)\n"
        "evaluate(sys.argv[1], sys.argv[2], out=sys.argv[3], checkpoint_seconds=0.0, workers=2, progress=kill)\n"
    )
    killed = subprocess.run([sys.executable, "-c", code, str(day_task_file), str(agent), str(tmp_path)], check=False, timeout=300)
    assert killed.returncode == -signal.SIGKILL
    resumed, _ = finish(day_task, agent, tmp_path)

    assert resumed.evaluation.resumed_at_step == 13
    assert resumed.runs == good_result.runs


def test_fresh_forgets_the_interrupted_work(day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path) -> None:
    agent = write_agent()
    interrupted_at(6, day_task, agent, tmp_path)

    assert prepare(day_task, agent, out=tmp_path).interrupted
    assert not prepare(day_task, agent, out=tmp_path, fresh=True).interrupted
    assert evaluate(day_task, agent, out=tmp_path).evaluation.resumed_at_step is None


def test_work_of_another_agent_or_other_seeds_is_not_taken_up(day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path) -> None:
    interrupted_at(6, day_task, write_agent(), tmp_path)

    assert evaluate(day_task, write_agent(), runs=2, out=tmp_path).evaluation.resumed_at_step is None
    interrupted_at(6, day_task, write_agent(), tmp_path)
    changed = write_agent("def act(self, observations):\n    return np.zeros((self.n, 6))")
    assert evaluate(day_task, changed, out=tmp_path).evaluation.resumed_at_step is None


def test_an_agent_that_does_not_repeat_itself_starts_again(
    day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    agent = write_agent(
        """
        def act(self, observations):
            Agent.ever = getattr(Agent, "ever", 0) + 1
            return np.full((self.n, 6), 1.0 / Agent.ever)
        """
    )
    loaded_twice = prepare(day_task, agent, out=tmp_path, checkpoint_seconds=0.0)
    with pytest.raises(StopError):
        loaded_twice.run(stop_after(5))
    result = loaded_twice.run()

    assert "not deterministic" in caplog.text
    assert result.evaluation.resumed_at_step is None
    assert result.summary.ok == 3


@pytest.mark.parametrize("damage", ["cut", "text", "no dialogue", "other numbers"])
def test_a_damaged_checkpoint_means_starting_again(
    day_task: TaskSpec, good_result: Result, write_agent: AgentWriter, tmp_path: Path, caplog: pytest.LogCaptureFixture, damage: str
) -> None:
    agent = write_agent()
    interrupted_at(6, day_task, agent, tmp_path)
    snapshot = next(tmp_path.rglob("snapshot.npz"))
    if damage == "cut":
        snapshot.write_bytes(snapshot.read_bytes()[:500])
    elif damage == "text":
        snapshot.write_text("not what it was", encoding="utf-8")
    elif damage == "other numbers":  # whole and readable, but not what was computed
        digest_bytes = 32
        with np.load(io.BytesIO(snapshot.read_bytes()[digest_bytes:])) as file:
            arrays = {name: file[name] for name in file.files}
        name = max((name for name in arrays if arrays[name].dtype == np.float64), key=lambda name: arrays[name].size)
        arrays[name] = arrays[name] * 1.01
        buffer = io.BytesIO()
        np.savez(buffer, **arrays)
        snapshot.write_bytes(snapshot.read_bytes()[:digest_bytes] + buffer.getvalue())
    else:
        next(tmp_path.rglob("dialogue-00000002-*.npz")).unlink()
    resumed, _ = finish(day_task, agent, tmp_path)

    assert "starting from the beginning" in caplog.text
    assert resumed.evaluation.resumed_at_step is None
    assert resumed.runs == good_result.runs


def test_a_full_disk_stops_the_checkpoints_and_not_the_evaluation(
    day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(path: Path, data: bytes) -> None:
        msg = f"Cannot write {path}: No space left on device."
        raise GlbenchError(msg)

    monkeypatch.setattr(checkpoint, "write_atomically", full)
    result = evaluate(day_task, write_agent(), out=tmp_path, checkpoint_seconds=0.0)

    assert result.summary.ok == 3
    assert caplog.text.count("No space left on device") == 1


def test_without_a_folder_nothing_is_written(
    day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    agent = write_agent()
    monkeypatch.chdir(tmp_path)
    before = {path for path in tmp_path.rglob("*") if "__pycache__" not in path.parts}
    evaluate(day_task, agent, checkpoint_seconds=0.0)

    assert {path for path in tmp_path.rglob("*") if "__pycache__" not in path.parts} == before


def test_wall_time_counts_what_was_spent_before_the_interruption(day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path) -> None:
    agent = write_agent("def act(self, observations):\n    time.sleep(0.02)\n    return np.zeros((self.n, 6))")
    interrupted_at(20, day_task, agent, tmp_path)
    resumed, _ = finish(day_task, agent, tmp_path)

    assert resumed.evaluation.wall_seconds > 24 * 0.02
    assert 24 * 0.02 < resumed.evaluation.decision_seconds < resumed.evaluation.wall_seconds


def test_a_trial_leaves_unfinished_work_with_other_seeds_alone(day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path) -> None:
    agent = write_agent(GOOD)
    with pytest.raises(StopError):
        evaluate(day_task, agent, runs=6, first_seed=50, out=tmp_path, checkpoint_seconds=0.0, progress=stop_after(12))
    evaluate(day_task, agent, runs=1, first_seed=99, out=tmp_path)
    assert prepare(day_task, agent, runs=6, first_seed=50, out=tmp_path).interrupted
    assert evaluate(day_task, agent, runs=6, first_seed=50, out=tmp_path).evaluation.resumed_at_step == 12
