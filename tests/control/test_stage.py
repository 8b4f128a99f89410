"""The reward along a trajectory is the environment's, and its gradient is right."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from glbench.control import Scenario, StageReward
from glbench.env import register_reward
from glbench.errors import ShapeError, TaskError, UnknownNameError
from glbench.tasks import TaskSpec, get_task
from tests.control.steps import TASKS, VARIED, Floats, scored, wild_steps

MakeTask = Callable[..., TaskSpec]


@pytest.mark.parametrize("task_id", TASKS)
def test_the_reward_of_every_task_has_the_bits_of_the_environment(task_id: str) -> None:
    task = scored(task_id)
    steps = wild_steps(task, 40)
    given = StageReward(task)(steps.x, steps.u, steps.calendar)
    names = [quantity.name for quantity in task.quantities]
    found = {"reward": given.reward, "epi": given.epi, "penalty": given.penalty, **given.violations}
    for name, values in found.items():
        assert values.tobytes() == steps.table[names.index(name)].tobytes(), name
    assert set(given.violations) == {name for name in names if name.startswith("violation_")}
    assert sum((values > 0.0).any() for values in given.violations.values()) >= 5


def differences(stage: StageReward, before: Floats, after: Floats, u: Floats, rows: Floats) -> list[tuple[Floats, Floats]]:
    """Central differences of the reward of single steps, for ``before``, ``after`` and ``u``, each with what rounding does to them."""

    def reward(*moved: Floats) -> Floats:
        x = np.stack(moved[:2], axis=1)
        return stage(x, moved[2][:, None], rows).reward[:, 0]

    given, found = [before, after, u], []
    for number, values in enumerate(given):
        slopes, rounding = np.empty_like(values), np.empty_like(values)
        for column in range(values.shape[1]):
            h = 1e-6 * np.maximum(np.abs(values[:, column]), 0.1)
            moved = [[*given[:number], values.copy(), *given[number + 1 :]] for _ in range(2)]
            moved[0][number][:, column] += h
            moved[1][number][:, column] -= h
            ahead, behind = reward(*moved[0]), reward(*moved[1])
            slopes[:, column], rounding[:, column] = (ahead - behind) / (2.0 * h), 1e-15 * (1.0 + np.abs(ahead)) / h
        found.append((slopes, rounding))
    return found


@pytest.mark.parametrize("smoothing", [0.0, 0.1])
@pytest.mark.parametrize("task_id", VARIED)
def test_the_gradient_is_that_of_differences(task_id: str, smoothing: float) -> None:
    task = scored(task_id)
    stage, steps = StageReward(task, smoothing=smoothing), wild_steps(task, 60)
    rows = np.stack([steps.calendar[:-1], steps.calendar[1:]], axis=1)
    _, gradient = stage.gradient(steps.x, steps.u, steps.calendar)
    expected = differences(stage, steps.x[:-1], steps.x[1:], steps.u, rows)
    for found, (wanted, rounding) in zip((gradient.before, gradient.after, gradient.controls), expected, strict=True):
        assert (np.abs(found - wanted) <= 1e-5 * np.abs(wanted) + rounding).all()
    assert (np.count_nonzero(gradient.after, axis=0) > 0).sum() >= 4


def test_the_gradient_of_the_states_is_that_of_the_sum() -> None:
    task = scored("Spring-v1")
    steps = wild_steps(task, 12)
    _, gradient = StageReward(task).gradient(steps.x, steps.u)
    assert gradient.states.shape == steps.x.shape
    np.testing.assert_array_equal(gradient.states[1:-1], gradient.before[1:] + gradient.after[:-1])
    np.testing.assert_array_equal(gradient.states[[0, -1]], [gradient.before[0], gradient.after[-1]])


@pytest.mark.parametrize("task_id", VARIED)
def test_a_batch_of_trajectories_has_the_bits_of_each(task_id: str) -> None:
    task = scored(task_id)
    stage, many = StageReward(task, smoothing=0.05), [wild_steps(task, 15, seed) for seed in range(3)]
    x, u, calendar = (np.stack(arrays) for arrays in list(zip(*many, strict=True))[:3])
    for rows in (calendar, calendar[0]):  # the runs share their calendar
        values, gradient = stage.gradient(x, u, rows)
        for place, steps in enumerate(many):
            one, slopes = stage.gradient(*steps[:3])
            assert values.reward[place].tobytes() == one.reward.tobytes()
            for name in ("before", "after", "controls", "states"):
                assert getattr(gradient, name)[place].tobytes() == getattr(slopes, name).tobytes()


def test_smoothing_rounds_the_kinks_and_leaves_the_profit() -> None:
    task = scored("Schiphol2010-Delta10-v1")
    steps = wild_steps(task, 60)
    exact, rounded = (StageReward(task, smoothing=share)(steps.x, steps.u) for share in (0.0, 0.1))
    assert rounded.epi.tobytes() == exact.epi.tobytes()
    width = 0.1 * (34.0 - 15.0)
    cold, counted = (exact.violations["violation_air_temperature_low"], rounded.violations["violation_air_temperature_low"])
    near = cold < width
    np.testing.assert_allclose(counted[near], cold[near] ** 2 / (2.0 * width), rtol=1e-12)
    np.testing.assert_allclose(counted[~near], cold[~near] - width / 2.0, rtol=1e-12)
    assert 0 < np.count_nonzero(cold[near]) < np.count_nonzero(cold)
    assert (rounded.penalty <= exact.penalty).all()
    scales = {"air_temperature": 15.0, "co2": 2500.0, "relative_humidity": 15.0}
    total = sum((rounded.violations[f"violation_{n}_low"] + rounded.violations[f"violation_{n}_high"]) / s for n, s in scales.items())
    np.testing.assert_allclose(rounded.penalty, total, rtol=1e-12)


def test_prices_by_the_hour_need_the_calendar() -> None:
    task = scored("Lettuce-v1")
    stage, steps = StageReward(task), wild_steps(task, 40)
    night, day = (stage(steps.x[:21], steps.u[:20], steps.calendar[:21]), stage(steps.x[:21], steps.u[:20], steps.calendar[-21:]))
    assert (night.epi > day.epi).any()
    for wrong in (None, steps.calendar[:-1], steps.calendar[:, :2], np.stack([steps.calendar] * 2)):
        with pytest.raises(ShapeError, match=r"needs the calendar of the steps, of shape \(41, 3\)"):
            stage(steps.x, steps.u, wrong)


def test_from_inside_the_bounds_unused_lamps_cost_the_power_that_they_would_buy() -> None:
    task = get_task("SpringEnergy-v1")
    scenario = Scenario.of(task, 7)
    lamp = task.model_value.control_names.index("uLamp")
    u = np.zeros((1, len(task.model_value.control_names)))
    x = np.repeat(scenario.x0[None], 2, axis=0)
    noon = scenario.calendar[48:50]
    once = np.zeros_like(u)
    once[0, lamp] = 1e-3
    stage = StageReward(task, counted="epi", inward=True)
    asked = (stage(x, once, noon).epi - stage(x, u, noon).epi)[0] / 1e-3
    assert asked < 0.0
    assert StageReward(task, counted="epi").gradient(x, u, noon)[1].controls[0, lamp] == 0.0
    assert stage.gradient(x, u, noon)[1].controls[0, lamp] == pytest.approx(asked, rel=1e-6)


def test_what_does_not_fit_is_refused() -> None:
    task = scored("Spring-v1")
    stage, steps = StageReward(task), wild_steps(task, 4)
    for x, u in (
        (steps.x[:-1], steps.u), (steps.x[:, 1:], steps.u), (steps.x, steps.u[:, 1:]), (steps.x[None], steps.u), (steps.x[0], steps.u[0]),
    ):  # fmt: skip
        with pytest.raises(ShapeError, match=r"Expected \(\.\.\., T \+ 1, 35\) and \(\.\.\., T, 6\)"):
            stage(x, u)
    with pytest.raises(UnknownNameError, match="counted='penalty' is unknown: choose 'reward', or 'epi'"):
        StageReward(task, counted="penalty")
    for smoothing in (-0.1, np.nan, np.inf):
        with pytest.raises(ShapeError, match="smoothing is a finite share"):
            StageReward(task, smoothing=smoothing)


@pytest.mark.usefixtures("own_words")
def test_a_reward_in_python_has_no_gradient(make_task: MakeTask) -> None:
    register_reward("test_fruit", "fresh fruit grown", lambda task, accounts: lambda outcome: outcome["fruit_fresh"])
    task = make_task(('modules = ["scaled_epi", "scaled_penalty"]', 'modules = ["scaled_penalty", "test_fruit"]'))
    with pytest.raises(TaskError, match=r"no derivatives: 'test_fruit' is Python .* epi, scaled_epi, penalties, scaled_penalty"):
        StageReward(task)
