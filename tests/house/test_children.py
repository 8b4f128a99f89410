"""Nothing that a command started goes on when the command was killed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from glbench import children
from tests.support import write_short_task

pytestmark = pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="looks at processes in /proc")

GLBENCH = (sys.executable, "-c", "from glbench_command import main; main()")
BUSY = """
import ctypes, multiprocessing, sys, threading
from glbench.children import Child, end_with_parent

def compute():
    end_with_parent()
    ctypes.PyDLL(None).sleep(100)  # as a solver that holds Python's lock

if __name__ == "__main__":
    worker = multiprocessing.get_context("spawn").Process(target=compute)
    worker.start()
    programs = []
    thread = threading.Thread(target=lambda: programs.append(Child(["sh", "-c", "sleep 100 & wait"])))
    thread.start()
    thread.join()
    ctypes.CDLL(None).sleep(100)
"""
SLOW_AGENT = """
import time
import numpy as np

class Slow:
    def reset(self, task, n_runs):
        self.n = n_runs
    def act(self, observations):
        time.sleep(5.0)
        return np.zeros((self.n, 6))

def make_agent(task):
    return Slow()
"""
TINY = """
default:
  n_timesteps: 1000000
  n_envs: 2
  policy_kwargs: {net_arch: [8], activation_fn: SiLU}
  n_steps: 32
  batch_size: 32
  evaluation: {every: 100, runs: 1}
"""
SWEEP = """
algorithm: ppo
task: long.toml
config: tiny.yml
steps: 1000000
trials: 4
parameters:
  learning_rate: {min: 1.0e-4, max: 1.0e-2, distribution: log_uniform_values}
"""


def descendants(root: int) -> dict[int, str]:
    """All processes below ``root`` that have not ended, with when each began."""
    seen: dict[int, str] = {}
    waiting = [root]
    while waiting:
        for task in Path(f"/proc/{waiting.pop()}/task").glob("*/children"):
            for child in task.read_text(encoding="ascii").split():
                if (since := began(int(child))) is not None:
                    seen[int(child)] = since
                    waiting.append(int(child))
    return seen


def began(process: int) -> str | None:
    """When a process began; None when it has ended, waited for or not."""
    try:
        state = Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return None
    return None if state[0] in "ZX" else state[19]


def kill_and_look(command: tuple[str, ...], folder: Path, *, wanted: int, seconds: float = 300.0) -> None:
    """Start ``command``, kill it when ``wanted`` processes have run below it for a second, and look who is left."""
    here = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2]), "GLBENCH_SANDBOX": "none", "OMP_NUM_THREADS": "1"}
    said = folder / "said"
    with said.open("wb") as file:
        process = subprocess.Popen(command, cwd=folder, stdout=file, stderr=file, env=here)
    try:
        until = time.monotonic() + seconds
        while len(descendants(process.pid)) < wanted and time.monotonic() < until and process.poll() is None:
            time.sleep(0.05)
        time.sleep(1.0)
        below = descendants(process.pid)
        assert len(below) >= wanted, (below, said.read_text(encoding="utf-8"))
    finally:
        process.kill()
        process.wait()
    until = time.monotonic() + 10.0
    while (left := [one for one, since in below.items() if began(one) == since]) and time.monotonic() < until:
        time.sleep(0.05)
    for one in left:
        os.kill(one, 9)
    assert not left


def test_workers_that_hold_the_lock_and_programs_of_ended_threads_end(tmp_path: Path) -> None:
    (tmp_path / "busy.py").write_text(BUSY, encoding="utf-8")
    kill_and_look((sys.executable, "busy.py"), tmp_path, wanted=3)


def test_a_process_that_a_benchmark_measures_ends_with_it(tmp_path: Path) -> None:
    code = "from glbench.speed import run; run._run('import time; time.sleep(600)')"
    kill_and_look((sys.executable, "-c", code), tmp_path, wanted=1)


def test_a_program_has_nothing_to_read_and_its_time() -> None:
    assert children.run(["cat"], timeout=10.0).stdout == ""
    began_at = time.monotonic()
    with pytest.raises(subprocess.TimeoutExpired):
        children.run(["sh", "-c", "sleep 50 & wait"], timeout=0.2)
    assert time.monotonic() - began_at < 10.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (("bound", "long.toml", "--scenario", "3", "--scenario", "4", "--workers", "2"), 3),
        (("submit", "check", "slow.py", "--task", "long.toml"), 1),
        (("evaluate", "slow.py", "--task", "long.toml"), 0),
    ],
    ids=lambda value: str(value[0]) if isinstance(value, tuple) else "",
)
def test_nothing_is_left_of_a_command_that_was_killed(tmp_path: Path, arguments: tuple[str, ...], wanted: int) -> None:
    write_short_task(tmp_path, "Long", days=30)
    (tmp_path / "slow.py").write_text(SLOW_AGENT, encoding="utf-8")
    kill_and_look((*GLBENCH, *arguments), tmp_path, wanted=wanted)


@pytest.mark.slow
@pytest.mark.train
@pytest.mark.parametrize(
    "arguments",
    [
        ("train", "ppo", "--task", "long.toml", "--config", "tiny.yml", "--seeds", "0-1", "--workers", "2"),
        ("sweep", "--config", "search.yml", "--workers", "2"),
    ],
    ids=["train", "sweep"],
)
def test_nothing_is_left_of_a_training_that_was_killed(tmp_path: Path, arguments: tuple[str, ...]) -> None:
    pytest.importorskip("stable_baselines3", reason="needs the extra 'train'", exc_type=ImportError)
    write_short_task(tmp_path, "Long", days=2)
    (tmp_path / "tiny.yml").write_text(TINY, encoding="utf-8")
    (tmp_path / "search.yml").write_text(SWEEP, encoding="utf-8")
    kill_and_look((*GLBENCH, *arguments), tmp_path, wanted=3)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("bwrap") is None, reason="needs bubblewrap")
def test_nothing_is_left_of_a_sandbox(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_short_task(tmp_path, "Long", days=30)
    (tmp_path / "slow.py").write_text(SLOW_AGENT, encoding="utf-8")
    command = (*GLBENCH, "evaluate", "slow.py", "--task", "long.toml", "--sandbox", "bubblewrap")
    kill_and_look(command, tmp_path, wanted=3)
