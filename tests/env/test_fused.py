"""The fused step gives the bits of the reference, whatever the task, the batch and the threads, and gives way where it must."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from glbench.env import GreenhouseEnv, Simulation, StepResult, program, register_reward
from glbench.env.uncertainty import DerivedParameters
from glbench.errors import ActionError
from glbench.kernel import Kernel, why_not_compiled
from glbench.kernel.compiled import CompiledStepper
from glbench.kernel.tape import RecordingError
from glbench.model import TOMATO, paper
from glbench.tasks import TaskSpec, get_task
from tests.env.stepping import StillKernel, walk
from tests.kernel.chain import CHAIN
from tests.support import shipped_tasks

MakeTask = Callable[..., TaskSpec]
SEEDS = list(range(666, 677))
N = len(SEEDS)

pytestmark = pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))


@pytest.fixture(scope="module")
def kernel() -> Kernel:
    return Kernel(TOMATO, 900.0, backend="compiled", preset="fast")


def both(task: TaskSpec, kernel: Kernel, n: int = N) -> tuple[Simulation, Simulation]:
    """The same runs, fused and by the reference."""
    pair = Simulation(task, n, kernel), Simulation(task, n, kernel, fused=False)
    assert [simulation.fused for simulation in pair] == [True, False]
    first, second = (simulation.reset(SEEDS[:n]) for simulation in pair)
    assert first.tobytes() == second.tobytes()
    return pair


def standing(simulation: Simulation) -> list[bytes]:
    arrays: tuple[np.ndarray[Any, Any], ...] = (
        simulation.x, simulation.u, simulation.k, simulation.ended, simulation.air, simulation.info_columns, simulation.seeds,
    )  # fmt: skip
    return [array.tobytes() for array in arrays]


def given(result: StepResult) -> list[Any]:
    arrays: tuple[np.ndarray[Any, Any], ...] = (result.observations, result.rewards, result.terminated, result.table)
    return [*(array.tobytes() for array in arrays), result.failed]


def assert_alike(pair: tuple[Simulation, Simulation], results: list[StepResult]) -> None:
    assert given(results[0]) == given(results[1])
    assert standing(pair[0]) == standing(pair[1])


def step_both(pair: tuple[Simulation, Simulation], steps: int, seed: int = 4) -> None:
    """Random actions, and now and then controls; the same bits after every step."""
    rng = np.random.default_rng(seed)
    for number in range(steps):
        if number % 5 == 4:
            controls = rng.uniform(0.0, 1.0, pair[0].u.shape)
            results = [simulation.step_controls(controls) for simulation in pair]
        else:
            low = [action.low for action in pair[0].task.actions]
            actions = rng.uniform(low, 1.0, (pair[0].n, len(low))).astype(np.float32)
            results = [simulation.step(actions) for simulation in pair]
        assert_alike(pair, results)


@pytest.mark.parametrize("task_id", [task.id for task in shipped_tasks(maps=False)])
def test_every_shipped_task_has_the_bits_of_the_reference(task_id: str) -> None:
    task = get_task(task_id)
    pair = both(task, Kernel(task.model_value, 900.0, backend="compiled", preset="fast"))
    step_both(pair, 12)
    for simulation in pair:
        simulation.end([3, 7])
    step_both(pair, 3)
    for simulation in pair:
        simulation.reset([1, 2**64 - 1], rows=[3, 0])
    step_both(pair, 3)


@pytest.mark.parametrize("delta", ["0.10", "0.0"])
def test_states_that_follow_are_stepped_with_the_parameters_of_their_row(
    make_task: MakeTask, monkeypatch: pytest.MonkeyPatch, delta: str
) -> None:
    """Some of the parameters that are drawn for each row and step are those of the states that follow."""
    monkeypatch.setattr(paper, "_MODELS", {**paper._MODELS, TOMATO.id: {"author": CHAIN}})
    task = make_task(("delta = 0.10", f"delta = {delta}"), ('title = "Schiphol', 'title = "A chain in Schiphol'))
    assert task.model_value is CHAIN
    pair = both(task, Kernel(CHAIN, 900.0, backend="compiled", preset="fast", threads=2))
    fruit = [i for i, state in enumerate(CHAIN.states) if state.follower]
    before = pair[0].x[:, fruit]
    step_both(pair, 12)
    assert (pair[0].x[:, fruit] != before).all()
    alone = both(task, Kernel(CHAIN, 900.0, backend="compiled", preset="fast"), 1)
    step_both(alone, 3)


PAPER = 'modules = ["indoor_climate", "crop", "time", "controls", "weather"]'
EVERYTHING = (
    "indoor_climate", "crop", "time", "controls", "weather", "forecast", "step_counter", "control_fractions",
)  # fmt: skip
AS_PUBLISHED = (
    "published_indoor_climate", "published_crop", "control_fractions", "weather", "step_counter", "published_time",
    "published_forecast",
)  # fmt: skip
PUBLISHED_TIMING = ('timing = "current"', 'timing = "published"')
SIX = 'controls = ["uBoil", "uCo2", "uThScr", "uVent", "uLamp", "uBlScr"]'
SCALED = 'modules = ["scaled_epi", "scaled_penalty"]'
START = "[initial_state]"


def modules(*names: str, forecast: int = 0) -> tuple[str, str]:
    listed = ", ".join(f'"{name}"' for name in names)
    return PAPER, f"modules = [{listed}]" + (f"\nforecast = {{ steps = {forecast} }}" if forecast else "")


OWN_TASKS: dict[str, tuple[tuple[str, str], ...]] = {
    "forecast": (modules(*EVERYTHING, forecast=5),),
    "forecast of the row that acts": (modules(*EVERYTHING, forecast=1), PUBLISHED_TIMING),
    "as published": (modules(*AS_PUBLISHED, forecast=48), PUBLISHED_TIMING),
    "full state": (modules("full_state", "step_counter", "time"),),
    "set point": (('kind = "rate"', 'kind = "set_point"'),),
    "some controls": ((SIX, 'controls = ["uVent", "uBoil", "uBlScr"]'),),
    "set points of some controls": (('kind = "rate"', 'kind = "set_point"'), (SIX, 'controls = ["uLamp", "uCo2"]')),
    "one draw an episode": (('redraw = "step"', 'redraw = "episode"'),),
    "one parameter": (('parameters = "crop28"', 'parameters = ["sla"]'),),
    "three parameters": (('parameters = "crop28"', 'parameters = ["hAir", "phiPipeE", "lPipe"]'),),
    "other rewards": ((SCALED, 'modules = ["penalties", "epi", "scaled_penalty"]'),),
    "more equipment": ((START, '[model.overrides]\naIntLamp = { value = 1.0, unit = "-" }\n' + START),),
}  # fmt: skip


@pytest.mark.parametrize("name", OWN_TASKS)
def test_every_part_has_the_bits_of_the_reference(name: str, make_task: MakeTask, kernel: Kernel) -> None:
    step_both(both(make_task(*OWN_TASKS[name]), kernel, 5), 12)


def test_an_episode_ends_alike(make_task: MakeTask, kernel: Kernel) -> None:
    pair = both(make_task(), kernel, 2)
    for simulation in pair:
        for _ in range(3):
            simulation.step(np.zeros((2, 6)))
        simulation.reset([5], rows=[1])
    step_both(pair, 96 - 3)
    assert [simulation.ended.tolist() for simulation in pair] == [[True, False]] * 2
    step_both(pair, 3)
    assert [simulation.over for simulation in pair] == [2, 2]


@pytest.fixture
def impatient() -> Kernel:
    """A kernel of which a test may change the number of substeps that it allows."""
    return Kernel(TOMATO, 900.0, backend="compiled", preset="fast")


def allow(kernel: Kernel, substeps: int) -> None:
    kernel._backend.settings.most = float(substeps)  # type: ignore[attr-defined]


def test_failed_steps_cost_and_say_the_same(make_task: MakeTask, impatient: Kernel) -> None:
    pair = both(make_task(), impatient)
    step_both(pair, 4)
    trial = Simulation(pair[0].task, N, impatient, fused=False)
    trial.restore(pair[0].snapshot())
    trial.step(np.zeros((N, 6)))
    enough_for_some = int(impatient._backend.substeps.min())  # type: ignore[attr-defined]
    allow(impatient, enough_for_some)
    results = [simulation.step(np.zeros((N, 6))) for simulation in pair]
    assert_alike(pair, results)
    assert 0 < len(results[0].failed) < N
    assert f"more than {enough_for_some} substeps" in results[0].failed[0].reason
    assert "controls uBoil" in results[0].failed[0].reason
    allow(impatient, 20_000)
    step_both(pair, 2)


def test_a_failed_step_ends_the_single_environment_with_its_reason(make_task: MakeTask, impatient: Kernel) -> None:
    task = make_task()
    allow(impatient, 2)
    env = GreenhouseEnv(task, impatient)
    env.reset(seed=1)
    _, reward, terminated, _, info = env.step(np.ones(6, np.float32))
    assert terminated
    assert reward == info["step_reward"] == task.evaluation.failed_step.reward
    assert info["step"] == 0
    assert "more than 2 substeps" in info["failure"]


@pytest.mark.parametrize("n", [1, 2, 8, 9, 64])
@pytest.mark.parametrize("threads", [1, 2])
def test_a_row_has_the_same_bits_in_every_batch_and_thread(day: TaskSpec, n: int, threads: int) -> None:
    kernel = Kernel(TOMATO, 900.0, backend="compiled", preset="fast", threads=threads)
    simulation, alone = Simulation(day, n, kernel), Simulation(day, 1, kernel)
    simulation.reset(range(n))
    row = n - 1
    alone.reset([row])
    for actions in walk(3, 4, n):
        many, one = simulation.step(actions), alone.step(actions[row:])
        assert many.observations[row].tobytes() == one.observations[0].tobytes()
        assert many.table[:, row].tobytes() == one.table[:, 0].tobytes()
        assert simulation.x[row].tobytes() == alone.x[0].tobytes()


def numbers_of(stepper: CompiledStepper, task: TaskSpec) -> list[bytes]:
    """Everything about a few fused steps of eleven runs."""
    kernel = Kernel(TOMATO, 900.0, backend="compiled", preset="fast")
    kernel._backend = stepper
    simulation = Simulation(task, N, kernel)
    simulation.reset(SEEDS)
    results = [simulation.step(actions) for actions in walk(5, 3, N)]
    assert simulation.fused
    return [*standing(simulation), *(part for result in results for part in given(result)[:4])]


@pytest.mark.parametrize("width", [1, 4])
def test_any_number_of_lanes(day: TaskSpec, width: int) -> None:
    usual = numbers_of(CompiledStepper(TOMATO, 900.0, preset="fast"), day)
    assert numbers_of(CompiledStepper(TOMATO, 900.0, preset="fast", width=width), day) == usual


@pytest.mark.parametrize(
    "command",
    [
        "clang++",
        pytest.param("g++ -mno-avx512f", marks=pytest.mark.slow),
        pytest.param("g++ -mno-avx512f -mno-avx2", marks=pytest.mark.slow),
    ],
)
def test_other_compilers_and_instruction_sets(day: TaskSpec, command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if shutil.which(command.split()[0]) is None:
        pytest.skip(f"{command} is not installed")
    usual = numbers_of(CompiledStepper(TOMATO, 900.0, preset="fast"), day)
    monkeypatch.setenv("CXX", command)
    assert numbers_of(CompiledStepper(TOMATO, 900.0, preset="fast"), day) == usual


def test_one_run_by_itself_has_the_same_numbers(day: TaskSpec, kernel: Kernel) -> None:
    single, many = Simulation(day, 1, kernel), Simulation(day, 1, kernel)
    by_reference = Simulation(day, 1, kernel, fused=False)
    for simulation in (single, many, by_reference):
        simulation.reset([7])
    for action in walk(1, 5, 1)[:, 0]:
        result = many.step(action[None])
        for simulation in (single, by_reference):
            observation, numbers, ended = simulation.step_single(action)
            assert observation.tobytes() == result.observations[0].tobytes()
            assert numbers == [*many.info_columns[:, 0].tolist(), *result.table[:, 0].tolist()]
            assert not ended
            assert simulation.result is not None
            assert given(simulation.result) == given(result)


BAD: dict[str, Any] = {
    "not a number": np.where(np.arange(12).reshape(2, 6) == 8, np.nan, 0.0),
    "infinite": np.where(np.arange(12).reshape(2, 6) == 3, np.inf, 0.0).astype(np.float32),
    "too large": np.full((2, 6), 1.0 + 2e-6),
    "too small": np.full((2, 6), -1.0 - 2e-6),
    "one row": np.zeros(6),
    "too many": np.zeros((2, 7)),
    "words": [["a"] * 6] * 2,
    "ragged": [[0.0] * 6, [0.0]],
    "nothing": None,
}


@pytest.mark.parametrize("name", BAD)
def test_bad_actions_are_refused_in_the_same_words(name: str, day: TaskSpec, kernel: Kernel) -> None:
    pair = both(day, kernel, 2)
    step_both(pair, 2)
    words = []
    for simulation in pair:
        before, result = standing(simulation), simulation.result
        with pytest.raises(ActionError) as caught:
            simulation.step(BAD[name])
        words.append(str(caught.value))
        assert standing(simulation) == before
        assert simulation.result is result
    assert words[0] == words[1]
    step_both(pair, 2)


@pytest.mark.parametrize("given_as", [list, lambda a: a.astype(np.float32), np.asfortranarray, lambda a: a.astype(np.int64)])
def test_actions_may_come_in_any_form(given_as: Callable[[Any], Any], day: TaskSpec, kernel: Kernel) -> None:
    pair = both(day, kernel, 2)
    edges = np.array([[1.0, -1.0, 0.0, -0.0, 1.0, -1.0], [-1.0, 1.0, 0.0, 0.0, -0.0, 1.0]])
    for _ in range(3):
        assert_alike(pair, [simulation.step(given_as(edges)) for simulation in pair])


def test_what_rounding_puts_outside_the_bounds_is_the_bound(day: TaskSpec, kernel: Kernel) -> None:
    pair = both(day, kernel, 1)
    assert_alike(pair, [simulation.step(np.full((1, 6), 1.0 + 9e-7)) for simulation in pair])
    assert (pair[0].u == 0.1).all()


def test_nothing_that_was_handed_out_changes_later(day: TaskSpec, kernel: Kernel) -> None:
    simulation = Simulation(day, 3, kernel)
    observations = simulation.reset([1, 2, 3])
    result = simulation.step(np.ones((3, 6)))
    held: list[np.ndarray[Any, Any]] = [
        observations, result.observations, result.rewards, result.terminated, result.table, result.quantities["epi"],
        simulation.x, simulation.u, simulation.k, simulation.ended, simulation.air, simulation.info_columns, simulation.seeds,
    ]  # fmt: skip
    kept = [array.copy() for array in held]
    for actions in walk(1, 95, 3):
        simulation.step(actions)
    simulation.reset([9, 9, 9])
    assert all((array == copy).all() for array, copy in zip(held, kept, strict=True))
    for array in (simulation.x, simulation.u, simulation.k, simulation.ended, simulation.air):
        assert not array.flags.writeable


def test_a_snapshot_goes_from_one_way_to_the_other(day: TaskSpec, kernel: Kernel) -> None:
    pair = both(day, kernel)
    step_both(pair, 6)
    pair[0].end([4])
    pair[1].end([4])
    crossed = Simulation(day, N, kernel), Simulation(day, N, kernel, fused=False)
    seen = [new.restore(old.snapshot()).tobytes() for new, old in zip(crossed, reversed(pair), strict=True)]
    assert seen == [old.observe().tobytes() for old in pair]
    step_both(pair, 5, seed=8)
    step_both(crossed, 5, seed=8)
    assert standing(crossed[0]) == standing(pair[0])


@pytest.mark.usefixtures("own_words")
def test_a_part_of_ones_own_is_stepped_by_the_reference(make_task: MakeTask, kernel: Kernel) -> None:
    register_reward("test_fruit", "fresh fruit grown", lambda task, accounts: lambda outcome: outcome["fruit_fresh"])
    simulation = Simulation(make_task((SCALED, 'modules = ["scaled_penalty", "test_fruit"]')), 2, kernel)
    simulation.reset([1, 2])
    assert not simulation.fused
    result = simulation.step(np.ones((2, 6)))
    assert (result.rewards == -result.quantities["penalty"] + result.quantities["fruit_fresh"]).all()


def test_formulas_that_no_tape_holds_are_stepped_by_the_reference(
    make_task: MakeTask, kernel: Kernel, monkeypatch: pytest.MonkeyPatch
) -> None:
    task = make_task(('parameters = "crop28"', 'parameters = ["hElevation"]'))  # the air's density follows by exp
    assert Simulation(task, 1, kernel).fused
    program._shipped.cache_clear()

    def refuse(*args: Any, **options: Any) -> None:
        raise RecordingError

    monkeypatch.setattr(DerivedParameters, "tape", refuse)
    assert not Simulation(task, 1, kernel).fused
    program._shipped.cache_clear()


def test_kernels_that_step_states_only_are_used_by_the_reference(day: TaskSpec) -> None:
    assert not Simulation(day, 2, StillKernel()).fused
    assert not Simulation(day, 2, Kernel(TOMATO, 900.0, backend="casadi")).fused


def test_the_seeds_decide_the_draws(day: TaskSpec, kernel: Kernel) -> None:
    simulation = Simulation(day, 2, kernel)
    simulation.reset([1, 2])
    simulation.step(np.zeros((2, 6)))
    assert simulation.x[0, 25] != simulation.x[1, 25]
    same = replace(simulation.snapshot(), seeds=np.array([2, 2], np.uint64), states=simulation.x[[1, 1]])
    simulation.restore(same)
    simulation.step(np.zeros((2, 6)))
    assert simulation.x[0].tobytes() == simulation.x[1].tobytes()
