"""Speed of whole environment steps: one environment, many, and the rule-based controller's evaluation.

``uv run --group dev pytest benchmarks/test_environment_step.py --benchmark-json=speed.json`` keeps the figures under
``extra_info``: processor time a step, that of the kernel called alone, and the ratio to CVODES with just-in-time compilation
in the same run. Nothing here passes or fails by its time.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.agents import load_agent
from glbench.env import GreenhouseEnv, GreenhouseVectorEnv, Simulation
from glbench.episodes import Recorder
from glbench.evaluation.checkpoint import Checkpoint
from glbench.evaluation.limits import TimeLimits
from glbench.evaluation.rollout import RolloutLoop, RunTotals
from glbench.evaluation.runners import make_runner
from glbench.kernel import Kernel
from glbench.kernel.compiled import CompiledStepper, availability
from glbench.kernel.compiled.accuracy import make_cvodes
from glbench.tasks import TaskSpec, get_task, task_card

Array = NDArray[np.float64]

STEPS = 1000

pytestmark = [pytest.mark.slow, pytest.mark.skipif(availability() is not None, reason=str(availability()))]


@pytest.fixture(scope="module")
def task() -> TaskSpec:
    return get_task("Schiphol2010-Delta10-v1")


@pytest.fixture(scope="module")
def actions() -> NDArray[np.float32]:
    """A walk: controls move by at most a third of what they may."""
    return np.random.default_rng(0).uniform(-0.3, 0.3, (STEPS, 6)).astype(np.float32)


@pytest.fixture(scope="module")
def inputs(task: TaskSpec, actions: NDArray[np.float32]) -> list[tuple[Array, ...]]:
    """What the kernel gets in these steps: states, controls, disturbances, one row each."""
    simulation = Simulation(task, 1, Kernel(900.0, preset="standard"))
    simulation.reset([1])
    found = []
    for action in actions:
        x, d = simulation.x, simulation.d
        simulation.step(action[None])
        found.append((x, simulation.u, d))
    return found


@pytest.fixture(scope="module")
def cvodes_seconds(task: TaskSpec, inputs: list[tuple[Array, ...]], tmp_path_factory: pytest.TempPathFactory) -> float:
    """Processor time of one step of these by CVODES at 1e-6, compiled just in time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("jit"))  # CasADi compiles in the working directory
        integrator = make_cvodes(1e-6, jit=True)

    def run() -> None:
        for x, u, d in inputs[::8]:
            integrator(x0=x[0], p=np.concatenate([u[0], d[0]]))

    return best(run)[0] / len(inputs[::8])


def best(*runs: Callable[[], object], rounds: int = 15) -> list[float]:
    """Processor time of the fastest of some rounds [s], each run once a round, so that a busy machine is unfair to none of them."""
    found = [math.inf] * len(runs)
    for _ in range(rounds):
        for place, run in enumerate(runs):
            started = time.process_time()
            run()
            found[place] = min(found[place], time.process_time() - started)
    return found


@pytest.mark.parametrize("preset", ["reference", "standard", "fast"])
def test_one_environment(
    task: TaskSpec,
    actions: NDArray[np.float32],
    inputs: list[tuple[Array, ...]],
    cvodes_seconds: float,
    preset: str,
    benchmark: Any,
) -> None:
    env = GreenhouseEnv(task, Kernel(900.0, preset=preset))
    stepper, out, nominal = CompiledStepper(900.0, preset=preset), np.empty((1, 28)), task.parameters()

    def run() -> None:
        env.reset(seed=1)
        for action in actions:
            env.step(action)

    def kernel_only() -> None:
        for x, u, d in inputs:
            stepper.step_rows(x, u, d, nominal, out)

    benchmark.pedantic(run, rounds=3)
    seconds, kernel = (found / STEPS for found in best(run, kernel_only))
    benchmark.extra_info.update(
        us_per_step=seconds * 1e6, us_of_the_kernel_called_alone=kernel * 1e6, ratio_to_cvodes=cvodes_seconds / seconds
    )


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("n", [8, 64, 512, 4096])
def test_a_vector_environment(task: TaskSpec, n: int, threads: int, benchmark: Any) -> None:
    envs = GreenhouseVectorEnv(task, n, kernel=Kernel(900.0, preset="standard", threads=threads))
    stepper = CompiledStepper(900.0, preset="standard", threads=threads)
    rng = np.random.default_rng(0)
    envs.reset(seed=0)
    for _ in range(40):
        envs.step(rng.uniform(-0.3, 0.3, (n, 6)).astype(np.float32))
    start, actions = envs.snapshot(), rng.uniform(-0.3, 0.3, (n, 6)).astype(np.float32)
    repeats = max(1, 512 // n)
    x, d, out = envs.simulation.x, envs.simulation.d, np.empty((n, 28))
    u, p = np.clip(envs.simulation.u + 0.1 * actions, 0.0, 1.0), np.tile(task.parameters(), (n, 1))

    def run() -> None:
        for _ in range(repeats):
            envs.step(actions)

    def kernel_only() -> None:
        for _ in range(repeats):
            stepper.step_rows(x, u, d, p, out)

    benchmark.pedantic(run, setup=lambda: envs.restore(start) and None, rounds=5)
    wall = []

    def timed() -> None:
        began = time.perf_counter()
        run()
        wall.append(time.perf_counter() - began)

    seconds, _, kernel = best(timed, lambda: envs.restore(start), kernel_only)
    rows = repeats * n
    benchmark.extra_info.update(
        us_per_step=seconds / rows * 1e6,
        us_of_the_kernel_called_alone=kernel / rows * 1e6,
        steps_per_second=rows / min(wall),
    )


@pytest.mark.parametrize("agent", ["rule_based", "rule_based_fair"])
def test_thirty_runs_of_sixty_days(task: TaskSpec, agent: str, benchmark: Any) -> None:
    """The evaluation's rollout, with the preset ``standard`` instead of the one that scores are made with."""
    seeds, limits, seconds = tuple(range(666, 696)), TimeLimits(), []

    def run() -> None:
        simulation = Simulation(task, 30, Kernel(900.0, preset="standard"))
        runner = make_runner(load_agent(agent), task, task_card(task), 30, limits)
        recorder = Recorder(simulation, 6, traced=False)
        rollout = RolloutLoop(simulation, runner, RunTotals(seeds), Checkpoint(None, 2.0), recorder, limits, None)
        observations = simulation.reset(seeds)
        rollout.start()
        began = time.process_time()
        rollout.run(observations, 0)
        seconds.append(time.process_time() - began)

    benchmark.pedantic(run, rounds=3)
    benchmark.extra_info.update(processor_seconds=min(seconds), us_per_step=min(seconds) / (30 * task.steps) * 1e6)
