"""The simulation: its horizon, its failures, and the independence of its rows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from glbench.env import QUANTITIES, Simulation, StepResult
from glbench.env.accounts import QUANTITY_NAMES
from glbench.errors import ActionError, GlbenchError, ShapeError, UnknownNameError
from glbench.kernel import Kernel
from glbench.model import TOMATO
from glbench.tasks import TaskSpec, get_task
from tests.env.stepping import StillKernel, run, walk

MakeTask = Callable[..., TaskSpec]
SEEDS = list(range(666, 730))


def same_bits(a: StepResult, row_of_a: int, b: StepResult, row_of_b: int) -> bool:
    return (
        a.observations[row_of_a].tobytes() == b.observations[row_of_b].tobytes()
        and all(a.quantities[name][row_of_a] == b.quantities[name][row_of_b] for name in QUANTITY_NAMES)
        and a.rewards[row_of_a] == b.rewards[row_of_b]
    )


@pytest.fixture(scope="module")
def kernel() -> Kernel:
    return Kernel(TOMATO, 900.0)


@pytest.fixture(scope="module")
def together(day: TaskSpec, kernel: Kernel) -> list[StepResult]:
    simulation = Simulation(day, 64, kernel)
    simulation.reset(SEEDS)
    return run(simulation, walk(11, 6, 64))


@pytest.mark.parametrize("n", [1, 7, 30])
def test_a_run_has_the_same_bits_in_every_batch(day: TaskSpec, kernel: Kernel, together: list[StepResult], n: int) -> None:
    simulation = Simulation(day, n, kernel)
    simulation.reset(SEEDS[:n])
    for few, many in zip(run(simulation, walk(11, 6, n)), together, strict=True):
        assert all(same_bits(few, row, many, row) for row in range(n))


def test_a_run_has_the_same_bits_at_every_place_and_with_strided_actions(day: TaskSpec, kernel: Kernel, together: list[StepResult]) -> None:
    order = [40, 3, 63, 0, 17]
    simulation = Simulation(day, 5, kernel)
    simulation.reset([SEEDS[place] for place in order])
    actions = np.asfortranarray(walk(11, 6, 64).astype(np.float64))[:, order]
    assert not actions[0].flags.c_contiguous
    for few, many in zip(run(simulation, actions), together, strict=True):
        assert all(same_bits(few, row, many, place) for row, place in enumerate(order))


def test_runs_started_later_have_the_same_bits(day: TaskSpec, kernel: Kernel, together: list[StepResult]) -> None:
    simulation = Simulation(day, 2, kernel)
    simulation.reset([1, 2])
    run(simulation, walk(2, 5, 2))
    simulation.reset([SEEDS[0]], rows=[1])
    actions = walk(11, 6, 1)
    late = run(simulation, np.concatenate([walk(2, 6, 1), actions], axis=1))
    assert simulation.k.tolist() == [11, 6]
    assert all(same_bits(few, 1, many, 0) for few, many in zip(late, together, strict=True))


def test_the_real_greenhouse_gets_warmer_with_the_boiler_on(day: TaskSpec, kernel: Kernel) -> None:
    simulation = Simulation(day, 2, kernel)
    simulation.reset([1, 1])
    controls = np.zeros((2, 6))
    controls[1, 0] = 1.0
    for _ in range(8):
        simulation.step_controls(controls)
    assert simulation.air[0, 1] > simulation.air[0, 0] + 3.0


def test_an_episode_ends_after_exactly_its_steps(make_task: MakeTask, still: StillKernel) -> None:
    simulation = Simulation(make_task(days=2), 3, still)
    simulation.reset([1, 2, 3])
    ends = [result.terminated.tolist() for result in run(simulation, walk(1, 192, 3))]
    assert ends[:-1] == [[False] * 3] * 191
    assert ends[-1] == [True] * 3
    assert simulation.k.tolist() == [192] * 3
    with pytest.raises(GlbenchError, match=r"Every run has ended. Call reset"):
        simulation.step(np.zeros((3, 6)))


def test_the_shipped_horizon_is_5760_steps(still: StillKernel) -> None:
    simulation = Simulation(get_task("Schiphol2010-Delta00-v1"), 1, still)
    simulation.reset([1])
    steps = 0
    while not simulation.ended.all():
        simulation.step_controls(np.zeros((1, 6)))
        steps += 1
    assert steps == 5760


def test_the_order_of_a_step(day: TaskSpec, still: StillKernel) -> None:
    """Actuation, then draw, weather row and state of the same step go to the kernel; then the clock moves on."""
    simulation = Simulation(day, 1, still)
    simulation.reset([5])
    for k in range(3):
        before = simulation.x
        assert simulation.hour_of_day[0] == 0.25 * k
        assert simulation.day_of_year[0] == pytest.approx(59 + k / 96, abs=1e-12)
        assert (simulation.d[0] == day.disturbances().values[k]).all()
        simulation.step(np.ones((1, 6)))
        x, u, d, p = still.calls[-1]
        assert (x == before).all()
        assert u[0] == pytest.approx([0.1 * (k + 1)] * 6, abs=1e-15)
        assert (d[0] == day.disturbances().values[k]).all()
        assert (p[0] != day.parameters()).sum() == 29  # 28 drawn ones and cLeafMax
        assert (simulation.u == u).all()


def test_without_uncertainty_the_kernel_gets_one_vector_for_all(make_task: MakeTask, still: StillKernel) -> None:
    task = make_task(("delta = 0.10", "delta = 0.0"))
    simulation = Simulation(task, 3, still)
    simulation.reset([1, 2, 3])
    simulation.step(np.zeros((3, 6)))
    assert still.calls[0][3].shape == (208,)
    assert (still.calls[0][3] == task.parameters()).all()


def test_the_reward_is_judged_by_the_true_state_after_the_step(day: TaskSpec) -> None:
    class Cooling(StillKernel):
        def try_step(self, x, u, d, p):  # type: ignore[no-untyped-def]
            after, failed = super().try_step(x, u, d, p)
            after[:, 2] = 15.0 - 1e-9  # too little for float32 to tell from the limit
            return after, failed

    simulation = Simulation(day, 1, Cooling())
    simulation.reset([1])
    result = simulation.step(np.zeros((1, 6)))
    assert result.observations[0, 0] == np.float32(15.0)
    assert result.quantities["violation_air_temperature_low"][0] == pytest.approx(1e-9, rel=1e-5)
    assert result.quantities["hours_outside_air_temperature_low"][0] == 0.25


def fails_at(*fruit: float) -> StillKernel:
    """Fails for rows whose fruit has one of these masses [mg m-2]; a row starts with 55338 and gains 100 a step."""
    return StillKernel(lambda x: np.isin(np.round(x[:, 25]), fruit))


def test_a_failed_step_ends_its_run_keeps_the_state_and_costs_what_the_task_says(day: TaskSpec) -> None:
    simulation = Simulation(day, 3, fails_at(55438.0))
    simulation.reset([1, 2, 3])
    simulation.end([2])  # so that places in the kernel's batch and in the simulation differ
    simulation.reset([9], rows=[0])
    simulation.step(np.zeros((3, 6)))
    simulation.reset([3], rows=[0])
    state = simulation.x[1].copy()
    result = simulation.step(np.full((3, 6), 0.5))
    assert [(failure.row, failure.reason) for failure in result.failed] == [(1, "the test wanted it")]
    assert result.terminated.tolist() == [False, True, True]
    assert (simulation.x[1] == state).all()
    assert simulation.k.tolist() == [1, 1, 0]
    charge = day.evaluation.failed_step
    assert result.rewards[1] == charge.reward == result.quantities["reward"][1]
    assert result.quantities["epi"][1] == charge.epi
    assert result.quantities["penalty"][1] == charge.penalty
    assert result.quantities["fruit_fresh"][1] == 0.0
    assert result.quantities["cost_heat"][1] == pytest.approx(0.05 * 0.002925, rel=1e-12)
    assert result.quantities["fruit_fresh"][0] > 0.0


def test_a_run_that_has_ended_stays_as_it_is(day: TaskSpec, still: StillKernel) -> None:
    simulation = Simulation(day, 3, still)
    simulation.reset([1, 2, 3])
    first = simulation.step(np.full((3, 6), 0.5))
    simulation.end(np.array([False, True, False]))
    actions = np.full((3, 6), 0.5)
    actions[1] = np.nan
    result = simulation.step(actions)
    assert len(still.calls[-1][0]) == 2
    assert result.terminated.tolist() == [False, True, False]
    assert simulation.k.tolist() == [2, 1, 2]
    assert (result.observations[1] == first.observations[1]).all()
    assert all(values[1] == 0.0 for values in result.quantities.values())
    assert result.rewards[1] == 0.0
    assert result.rewards[0] != 0.0


def test_ending_no_run_changes_nothing(day: TaskSpec, still: StillKernel) -> None:
    simulation = Simulation(day, 2, still)
    simulation.reset([1, 2])
    simulation.end([])
    assert not simulation.ended.any()


def test_controls_are_applied_without_a_rate_limit(day: TaskSpec, still: StillKernel) -> None:
    simulation = Simulation(day, 2, still)
    simulation.reset([1, 2])
    controls = np.array([[1.0, 0.0, 0.3, 0.0, 0.9, 0.0], [0.0, 1.0, 0.0, 0.2, 0.0, 1.0]])
    simulation.step_controls(controls)
    assert (simulation.u == controls).all()
    with pytest.raises(ActionError, match=r"control 4 \('uLamp'\) of row 1 is 1.25, outside its bounds 0 to 1"):
        simulation.step_controls([[0.0] * 6, [0.0, 0.0, 0.0, 0.0, 1.25, 0.0]])


def test_a_bad_action_simulates_nothing(day: TaskSpec, still: StillKernel) -> None:
    simulation = Simulation(day, 2, still)
    simulation.reset([1, 2])
    actions = np.zeros((2, 6))
    actions[1, 3] = np.nan
    with pytest.raises(ActionError, match=r"'uVent'\) of row 1 is nan"):
        simulation.step(actions)
    assert still.calls == []
    assert simulation.k.tolist() == [0, 0]


def test_results_and_state_are_not_overwritten_by_later_steps(day: TaskSpec, still: StillKernel) -> None:
    simulation = Simulation(day, 2, still)
    simulation.reset([1, 2])
    result = simulation.step(np.ones((2, 6)))
    held: list[np.ndarray] = [result.observations, result.quantities["epi"], result.terminated, simulation.x, simulation.k]
    kept = [array.copy() for array in held]
    run(simulation, walk(1, 95, 2))
    assert all((array == copy).all() for array, copy in zip(held, kept, strict=True))
    with pytest.raises(ValueError, match="read-only"):
        simulation.x[0, 0] = 1.0


def test_a_result_holds_every_quantity(day: TaskSpec, still: StillKernel) -> None:
    simulation = Simulation(day, 2, still)
    simulation.reset([1, 2])
    result = simulation.step(np.zeros((2, 6)))
    assert list(result.quantities) == [quantity.name for quantity in QUANTITIES]
    assert all(values.shape == (2,) and values.dtype == np.float64 for values in result.quantities.values())
    assert (result.quantities["reward"] == result.rewards).all()


def test_a_task_may_be_named_by_its_id() -> None:
    assert Simulation("Schiphol2010-Delta10-v1", 2).task is get_task("Schiphol2010-Delta10-v1")
    with pytest.raises(UnknownNameError, match="got None"):
        Simulation(None, 2)  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", [-1, 2**64, 1.5, "1", None, True])
def test_an_impossible_seed_is_refused(day: TaskSpec, seed: object) -> None:
    with pytest.raises(GlbenchError, match=r"not a whole number from 0 to 2\*\*64 - 1"):
        Simulation(day, 1).reset([seed])  # type: ignore[list-item]


def test_the_largest_seed_and_numpys_numbers_are_seeds(day: TaskSpec, still: StillKernel) -> None:
    simulation = Simulation(day, 2, still)
    simulation.reset(np.array([2**64 - 1, 3], dtype=np.uint64))
    assert simulation.seeds.tolist() == [2**64 - 1, 3]


def test_misuse_says_what_to_do(day: TaskSpec, still: StillKernel) -> None:
    simulation = Simulation(day, 2, still)
    with pytest.raises(GlbenchError, match="call reset first"):
        simulation.step(np.zeros((2, 6)))
    with pytest.raises(GlbenchError, match="call reset first"):
        simulation.snapshot()
    with pytest.raises(GlbenchError, match="before all were"):
        simulation.reset([1], rows=[0])
    with pytest.raises(ShapeError, match="3 seeds for 2 runs"):
        simulation.reset([1, 2, 3])
    with pytest.raises(ShapeError, match="at least one; got 0"):
        Simulation(day, 0)


def test_simulations_of_a_thread_share_one_kernel(day: TaskSpec) -> None:
    assert Simulation(day, 1).kernel is Simulation(day, 5).kernel
