"""What an environment takes as its kernel."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from glbench.env import GreenhouseEnv, GreenhouseVectorEnv, Simulation
from glbench.errors import GlbenchError, UnknownNameError
from glbench.kernel import Kernel
from glbench.model import TOMATO, tomato
from glbench.tasks import TaskSpec
from tests.env.stepping import StillKernel

ID = "glbench:glbench/Schiphol2010-Delta10-v1"
ACTIONS = np.full((2, 6), 0.3, dtype=np.float32)


@pytest.mark.parametrize("preset", ["reference", "standard", "fast", "tight"])
def test_a_presets_name_is_the_kernel_of_that_preset(day: TaskSpec, preset: str) -> None:
    named, given = GreenhouseEnv(day, kernel=preset), GreenhouseEnv(day, kernel=Kernel(TOMATO, 900.0, preset=preset))
    for environment in (named, given):
        environment.reset(seed=3)
    for action in ACTIONS:
        assert named.step(action)[0].tobytes() == given.step(action)[0].tobytes()
    assert isinstance(named.simulation.kernel, Kernel)
    assert named.simulation.kernel.preset == preset
    assert GreenhouseEnv(day, kernel=preset).simulation.kernel is named.simulation.kernel


def test_the_default_is_what_scores_are_made_with(day: TaskSpec) -> None:
    assert GreenhouseEnv(day).simulation.kernel is GreenhouseEnv(day, kernel="reference").simulation.kernel


@pytest.mark.parametrize("mode", ["sync", "vector_entry_point"])
def test_gymnasium_passes_a_presets_name_on(mode: str) -> None:
    single = gymnasium.make(ID, kernel="fast")
    single.reset(seed=4)
    envs = gymnasium.make_vec(ID, num_envs=2, vectorization_mode=mode, kernel="fast")
    envs.reset(seed=4)
    assert envs.step(ACTIONS)[0][0].tobytes() == single.step(ACTIONS[0])[0].tobytes()
    envs.close()


def test_workers_go_with_a_preset_and_change_no_bit(day: TaskSpec) -> None:
    alone, shared = GreenhouseVectorEnv(day, 2, kernel="fast"), GreenhouseVectorEnv(day, 2, kernel="fast", workers=2)
    for envs in (alone, shared):
        envs.reset(seed=4)
    assert alone.step(ACTIONS)[0].tobytes() == shared.step(ACTIONS)[0].tobytes()
    shared.close()
    with pytest.raises(GlbenchError, match="a Kernel or a number of workers, not both"):
        GreenhouseVectorEnv(day, 2, kernel=Kernel(TOMATO, 900.0), workers=2)
    with pytest.raises(GlbenchError, match=r"whole number; got 2\.5"):
        GreenhouseVectorEnv(day, 2, workers=2.5)  # type: ignore[arg-type]


@pytest.mark.parametrize("make", [GreenhouseEnv, lambda task, kernel: GreenhouseVectorEnv(task, 2, kernel=kernel)])
def test_what_is_no_kernel_of_the_task_is_refused_at_once(day: TaskSpec, make: type[GreenhouseEnv]) -> None:
    with pytest.raises(UnknownNameError, match=r"no kernel preset 'fats'\. Did you mean 'fast'"):
        make(day, kernel="fats")
    for wrong in (3, {}, Kernel, object()):
        with pytest.raises(GlbenchError, match=r"name of a preset \('reference', .* or a Kernel, such as Kernel\(task\.model_value, 900\)"):
            make(day, kernel=wrong)  # type: ignore[arg-type]
    with pytest.raises(GlbenchError, match=r"step_seconds = 300.0, but tests/\w+-Delta10-v1 needs 900.0"):
        make(day, kernel=Kernel(TOMATO, 300.0))
    with pytest.raises(GlbenchError, match="variant = 'gl_gym2'"):
        make(day, kernel=Kernel(tomato("gl_gym2"), 900.0))


def test_an_object_of_ones_own_with_try_step_is_a_kernel(day: TaskSpec, still: StillKernel) -> None:
    assert Simulation(day, 1, still).kernel is still
