"""Commands on a cluster whose machines share no folder: the same bits as alone, also when a machine is lost, and what was begun goes on."""

from __future__ import annotations

import importlib.util
import json
import signal
import subprocess
import time
from collections.abc import Callable, Iterator

import pytest

from glbench.evaluation import evaluate, load_result
from glbench.evaluation.sandbox.bubblewrap import why_no_sandbox
from glbench.tasks import TaskSpec, get_task
from glbench.weather import load_weather, save_weather
from tests.evaluation.agent_files import agent_writer
from tests.machines import Machines, MachinesError, two_machines
from tests.support import write_day_task

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(3600),
    pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="Ray is not installed"),
    pytest.mark.skipif(why_no_sandbox() is not None, reason="no namespaces here"),
]
PATIENCE_SECONDS = 900.0
"""A busy machine needs minutes to start Ray's workers."""
GLBENCH = ("-c", "from glbench.cli.app import main; main()")
SLOW = """
def act(self, observations):
    self.calls += 1
    time.sleep(0.4)
    if self.calls == 16:
        open(os.path.expanduser("~/half"), "w").close()
    return np.tanh(observations[:, :6].astype(float) / 50.0)
"""
SINGLE = """
def act(self, observation):
    return np.full(6, np.tanh(0.01 * float(observation[0])))
"""
SETTINGS = """
default:
  n_timesteps: 4000
  n_envs: 2
  n_steps: 48
  n_epochs: 2
  policy_kwargs: {net_arch: [16, 16]}
  batch_size: 32
  evaluation: {every: 1000, runs: 1}
"""
TRAIN = """
import sys
from pathlib import Path
from glbench.evaluation.jobs import Payload
from glbench.execution import RayExecutor
from glbench.tasks import get_task
from glbench.training import read_settings, train
from glbench.training.multi_seed import train_seeds

class Listening:
    def __init__(self, seed):
        self.seed = seed
    def on_progress(self, progress):
        pass
    def on_saved(self, steps):
        pass
    def on_evaluation(self, point):
        sys.stdout.write(f"evaluated {self.seed} {point.steps}\\n")  # one write: two threads never share a line
        sys.stdout.flush()

task = get_task("day.toml")
settings = read_settings(Path("settings.yml"), "ppo", task.id)
with RayExecutor(sys.argv[1], 2, Payload.of([task]).unpack) as executor:
    folders = {seed: Path("api") / f"seed{seed}" for seed in (0, 1)}
    for seed, trained in train_seeds(
        executor, train, task, settings, folders, listeners=lambda seed: [Listening(seed)],
        tensorboard=False, save_seconds=0.0,
    ):
        print("ended", seed, trained, flush=True)
"""
SEES = """
import json, os, sys, ray
ray.init(address=sys.argv[1], log_to_driver=False, logging_level="error")
def sees(folder):
    home = os.path.expanduser("~")
    open(os.path.join(home, "mark-" + ray.get_runtime_context().get_node_id()), "w").close()
    return os.path.exists(folder), [name for name in os.listdir(home) if name.startswith("mark-")]
asked = [ray.remote(resources={name: 1})(sees).remote(sys.argv[2]) for name in "ab"]
print(json.dumps(ray.get(asked)))
"""


@pytest.fixture(scope="module")
def machines(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machines]:
    try:
        with two_machines(tmp_path_factory.mktemp("machines")) as started:
            yield started
    except MachinesError as error:
        pytest.skip(f"Ray's own processes do not start in time on this machine: {error}")


@pytest.fixture
def task(machines: Machines, monkeypatch: pytest.MonkeyPatch) -> TaskSpec:
    """A day with weather that the user of the command alone has."""
    monkeypatch.setenv("GLBENCH_DATA", machines.environment["GLBENCH_DATA"])
    file = write_day_task(machines.command_folder)
    text = file.read_text(encoding="utf-8")
    assert text.count('source = "schiphol"') == 1
    file.write_text(text.replace('source = "schiphol"', 'source = "ours"'), encoding="utf-8")
    save_weather(load_weather("schiphol"), "ours", overwrite=True)
    return get_task(file)


def eventually(what: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    """Wait for something that a process brings about."""
    deadline = time.monotonic() + PATIENCE_SECONDS
    try:
        while not what():
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < deadline
            time.sleep(0.1)
    except BaseException:
        process.kill()
        raise


def answered(done: subprocess.CompletedProcess[str] | None) -> subprocess.CompletedProcess[str]:
    assert done is not None, "it takes too long"
    assert done.returncode in (0, 3), done.stderr  # 3: a training that learnt nothing, which is not its point
    return done


def test_the_machines_share_no_folder(machines: Machines) -> None:
    done = answered(machines.python("-c", SEES, machines.address, str(machines.command_folder)))
    seen = json.loads(done.stdout)
    assert [there for there, _ in seen] == [False, False]
    assert [len(marks) for _, marks in seen] == [1, 1]
    assert seen[0][1] != seen[1][1]


def test_an_evaluation_goes_on_from_its_checkpoint_when_its_machine_is_lost(machines: Machines, task: TaskSpec) -> None:
    write = agent_writer(machines.command_folder)
    slow, single = write(SLOW, name="slow"), write(SINGLE, name="single", single=True)
    command = (*GLBENCH, "evaluate", "slow.py", "single.py", "-t", "day.toml", "--sandbox", "none", "--engine", "ray")
    process = machines.begun(*command, "--address", machines.address)
    eventually(lambda: any((machines.home(name) / "half").exists() for name in "ab"), process)
    lost = next(name for name in "ab" if (machines.home(name) / "half").exists())
    machines.end(lost)
    _, err = process.communicate(timeout=PATIENCE_SECONDS)
    assert process.returncode == 0, err
    for agent in (slow, single):
        result = load_result(machines.command_folder / "reports" / "results" / "Day-v1" / f"{agent.stem}.json")
        assert result.results_digest == evaluate(task, agent).results_digest
        if agent is slow:
            assert result.evaluation.resumed_at_step is not None
            assert result.evaluation.resumed_at_step > 0
    other = machines.home("b" if lost == "a" else "a")
    cached = {file.relative_to(other / ".cache" / "glbench").parts[0] for file in other.rglob("*.so")}
    assert cached == {"travelled"}, "the kernel came along, and nobody compiled it"
    machines.start(lost)
    machines.wait_for("a", "b")


def test_an_interrupted_evaluation_goes_on_from_what_came_back(machines: Machines, task: TaskSpec) -> None:
    agent = agent_writer(machines.command_folder)(SLOW, name="begun")
    command = (*GLBENCH, "evaluate", "begun.py", "-t", "day.toml", "--sandbox", "none", "--engine", "ray", "-n", "2")
    process = machines.begun(*command, "--address", machines.address)
    eventually(lambda: any((machines.command_folder / "reports").rglob("begun/**/snapshot.npz")), process)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=PATIENCE_SECONDS)
    assert process.returncode == 130, err
    answered(machines.python(*command, "--address", machines.address))
    (found,) = (machines.command_folder / "reports" / "trials").rglob("begun.json")
    result = load_result(found)
    assert result.evaluation.resumed_at_step is not None
    assert result.results_digest == evaluate(task, agent, runs=2).results_digest


def test_plans_are_the_same(machines: Machines, task: TaskSpec) -> None:
    command = (*GLBENCH, "bound", "day.toml", "--scenario", "20001", "--scenario", "20002", "-n", "2")
    there = ("--engine", "ray", "--address", machines.address, "--out", "plans-there")
    answered(machines.python(*command, "--sandbox", "none", *there))
    answered(machines.python(*command, "--sandbox", "none", "--out", "plans-here", "--workers", "1"))
    here, there_found = (
        {file.name: file.read_bytes() for file in (machines.command_folder / name).iterdir()} for name in ("plans-here", "plans-there")
    )
    assert here == there_found
    assert sorted(here) == ["20001.npz", "20002.npz", "card.toml"]


@pytest.mark.train
def test_a_training_goes_on_from_its_checkpoint_when_its_machine_is_lost(machines: Machines, task: TaskSpec) -> None:
    from glbench.training import read_settings, train

    (machines.command_folder / "settings.yml").write_text(SETTINGS, encoding="utf-8")
    process = machines.begun("-c", TRAIN, machines.address)
    states = [machines.command_folder / "api" / f"seed{seed}" / "checkpoint" / "state.json" for seed in (0, 1)]
    eventually(lambda: all(state.is_file() for state in states), process)
    machines.end("a")
    out, err = process.communicate(timeout=PATIENCE_SECONDS)
    assert process.returncode == 0, err
    evaluated = [tuple(map(int, line.split()[1:])) for line in out.splitlines() if line.startswith("evaluated")]
    assert [evaluated.count((seed, 0)) for seed in (0, 1)] == [1, 1], "none began anew"
    settings = read_settings(machines.command_folder / "settings.yml", "ppo", task.id)
    for seed in (0, 1):
        alone, there = machines.folder / f"alone{seed}", machines.command_folder / "api" / f"seed{seed}"
        train(task, settings, alone, seed=seed, tensorboard=False)
        assert (there / "policy.npz").read_bytes() == (alone / "policy.npz").read_bytes()
        names = {file.relative_to(alone) for file in alone.rglob("*")}
        assert names == {file.relative_to(there) for file in there.rglob("*")}
        assert (there / "settings.yml").read_bytes() == (alone / "settings.yml").read_bytes()
    machines.start("a")
    machines.wait_for("a", "b")


@pytest.mark.train
def test_seeds_and_sweeps_are_trained_there_and_kept_here(machines: Machines, task: TaskSpec) -> None:
    pytest.importorskip("stable_baselines3", reason="Stable-Baselines3 is not installed")
    (machines.command_folder / "few.yml").write_text(SETTINGS.replace("4000", "96"), encoding="utf-8")
    there = ("--engine", "ray", "--address", machines.address)
    command = (*GLBENCH, "train", "ppo", "--task", "day.toml", "--config", "few.yml", "--seeds", "0-1", "--out", "some", *there)
    first = answered(machines.python(*command))
    assert "glbench evaluate some/ppo-Day-v1-seed*" in first.stdout
    for seed in (0, 1):
        kept = {file.name for file in (machines.command_folder / "some" / f"ppo-Day-v1-seed{seed}").iterdir()}
        assert {"policy.npz", "card.toml", "learning_curve.csv", "settings.yml", "best", "checkpoint", "tensorboard"} <= kept
    again = answered(machines.python(*command))
    assert again.stderr.count("already trained") == 2

    search = machines.command_folder / "search.yml"
    search.write_text(
        "algorithm: ppo\ntask: day.toml\nconfig: few.yml\nsteps: 96\ntrials: 3\nmethod: random\n"
        "parameters:\n  gamma: {min: 0.9, max: 0.99}\n",
        encoding="utf-8",
    )
    answered(machines.python(*GLBENCH, "sweep", "--config", "search.yml", "--out", "swept-there", *there))
    answered(machines.python(*GLBENCH, "sweep", "--config", "search.yml", "--out", "swept-here"))
    for trial in ("trial-0000", "trial-0001", "trial-0002"):
        policies = [machines.command_folder / name / trial / "policy.npz" for name in ("swept-there", "swept-here")]
        assert policies[0].read_bytes() == policies[1].read_bytes()
        assert not policies[0].with_name("checkpoint").exists()
