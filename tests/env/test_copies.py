"""Pickled and copied environments continue with the same bits, at any time, wrapped or not, here and elsewhere."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from glbench.env import GreenhouseEnv, GreenhouseVectorEnv, Simulation
from glbench.kernel import Kernel
from glbench.model import TOMATO
from glbench.tasks import TaskSpec
from tests.env.stepping import StillKernel, walk

MakeTask = Callable[..., TaskSpec]
Copy = Callable[[Any], Any]
ID = "glbench:glbench/Schiphol2010-Delta10-v1"


def pickled(thing: Any) -> Any:
    return pickle.loads(pickle.dumps(thing))


COPIES = pytest.mark.parametrize("copied", [pickled, copy.deepcopy])
KERNELS = pytest.mark.parametrize("kernel", [None, "fast", "own"])


def own(kernel: str | None) -> Kernel | str | None:
    return Kernel(TOMATO, 900.0, preset="standard", threads=2) if kernel == "own" else kernel


def bits(value: Any) -> Any:
    """Everything that a step or reset gave, as something that can be compared bit for bit."""
    if isinstance(value, np.ndarray) and value.dtype != object:
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, dict):
        return {name: bits(part) for name, part in value.items() if name != "t"}  # seconds on the wall, of a wrapper
    if isinstance(value, tuple | list | np.ndarray):
        return [bits(part) for part in value]
    return value


def goes_on(environment: Any, steps: int, seed: int = 9) -> list[Any]:
    """What the next steps give, and the reset after them."""
    n = getattr(environment, "num_envs", None)
    actions = walk(seed, steps, n or 1)
    return [bits(environment.step(action if n else action[0])) for action in actions] + [bits(environment.reset())]


@COPIES
@KERNELS
def test_an_environment_is_copied_before_and_after_reset_and_half_way(day: TaskSpec, copied: Copy, kernel: str | None) -> None:
    environment = GreenhouseEnv(day, kernel=own(kernel))
    twin = copied(environment)
    assert bits(environment.reset(seed=5)) == bits(twin.reset(seed=5))
    assert goes_on(copied(twin), 4) == goes_on(copied(environment), 4)
    for action in walk(1, 3, 1)[:, 0]:
        environment.step(action)
    twin = copied(environment)
    assert goes_on(twin, 6) == goes_on(environment, 6)


@COPIES
def test_wrappers_are_copied_too(day: TaskSpec, copied: Copy) -> None:
    environment = gymnasium.make(ID, task=day, kernel=Kernel(TOMATO, 900.0, preset="fast"), max_episode_steps=20)
    environment = gymnasium.wrappers.RecordEpisodeStatistics(gymnasium.wrappers.NormalizeObservation(environment))
    environment.reset(seed=5)
    environment.step(np.zeros(6, dtype=np.float32))
    twin = copied(environment)
    assert goes_on(twin, 19) == goes_on(environment, 19)
    assert twin.spec is not None


@COPIES
def test_an_episode_that_has_ended_stays_so(day: TaskSpec, copied: Copy) -> None:
    environment = GreenhouseEnv(day, kernel="fast")
    environment.reset(seed=5)
    for action in walk(1, day.steps, 1)[:, 0]:
        environment.step(action)
    twin = copied(environment)
    with pytest.raises(Exception, match="Call reset"):
        twin.step(np.zeros(6))
    assert bits(twin.reset()) == bits(environment.reset())


@COPIES
@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize("kernel", [None, "own"])
def test_a_vector_environment_is_copied_at_any_time(day: TaskSpec, copied: Copy, mode: str, kernel: str | None) -> None:
    envs = GreenhouseVectorEnv(day, 2, kernel=own(kernel), autoreset_mode=mode)
    twin = copied(envs)
    assert bits(envs.reset(seed=5)) == bits(twin.reset(seed=5))
    for action in walk(1, day.steps - 2, 2):
        envs.step(action)
    twin = copied(envs)
    assert goes_on(twin, 4) == goes_on(envs, 4)  # over the end of the episode


def test_a_row_that_ended_early_is_copied_as_ended(day: TaskSpec) -> None:
    envs = GreenhouseVectorEnv(day, 3)
    envs.reset(seed=5)
    envs.simulation.end([1])
    twin = pickled(envs)
    assert twin.simulation.ended.tolist() == [False, True, False]
    assert goes_on(twin, 3) == goes_on(envs, 3)


def test_threads_of_workers_are_copied(day: TaskSpec) -> None:
    envs = GreenhouseVectorEnv(day, 2, workers=2, kernel="fast")
    envs.reset(seed=1)
    twin = copy.deepcopy(envs)
    assert twin.simulation.kernel is not envs.simulation.kernel
    assert goes_on(twin, 2) == goes_on(envs, 2)


def test_the_last_step_is_still_told_after_copying(day: TaskSpec) -> None:
    for kernel in (None, StillKernel()):
        environment = GreenhouseEnv(day, kernel=kernel, render_mode="ansi")
        environment.reset(seed=1)
        environment.step(np.ones(6, dtype=np.float32))
        assert pickled(environment).render() == environment.render()
        assert "this step" in str(environment.render())


def test_a_copied_kernel_has_the_same_settings_and_bits(day: TaskSpec) -> None:
    kernel = Kernel(TOMATO, preset="fast", threads=2)
    twin = pickled(kernel)
    assert (twin.describe(), twin.threads) == (kernel.describe(), 2)
    one, other = Simulation(day, 1, kernel), Simulation(day, 1, twin)
    one.reset([1])
    other.reset([1])
    assert one.step(np.ones((1, 6))).rewards == other.step(np.ones((1, 6))).rewards


def test_another_process_continues_with_the_same_bits(day: TaskSpec, tmp_path: Path) -> None:
    environment = gymnasium.make(ID, task=day, kernel="standard")
    environment.reset(seed=5)
    environment.step(np.zeros(6, dtype=np.float32))
    file = tmp_path / "environment.pickle"
    file.write_bytes(pickle.dumps(environment))
    code = (
        "import pickle, sys, numpy as np\n"
        f"environment = pickle.load(open({str(file)!r}, 'rb'))\n"
        "observation, reward, *_ = environment.step(np.full(6, 0.5, np.float32))\n"
        "print(observation.tobytes().hex(), float(reward).hex(), environment.reset()[1]['seed'])\n"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=300)
    observation, reward, *_ = environment.step(np.full(6, 0.5, np.float32))
    seed = environment.reset()[1]["seed"]
    assert told.stdout.split() == [observation.tobytes().hex(), float(reward).hex(), str(seed)]
