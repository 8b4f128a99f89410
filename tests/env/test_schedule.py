"""Scheduled controls follow the calendar of their run, to the bit, whatever steps the environment and whatever the agent does."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.env import GreenhouseEnv, GreenhouseVectorEnv, Simulation, make_accounts, register_actuation
from glbench.env.snapshot import Snapshot
from glbench.errors import TaskError
from glbench.kernel import why_not_compiled
from glbench.model import GreenLightClimate, VanthoorTomato, compose, register_model
from glbench.tasks import TaskSpec, get_task
from tests.env.stepping import Floats, StillKernel
from tests.model.test_compose import WaterTank

MODULES = ("schedule",)
SCREEN = 5
SEEDS = (1, 2, 3)
ENTRIES: list[dict[str, Any]] = [
    {"control": "uBlScr", "value": 0.5, "weekdays": ["monday", "tuesday", "friday"], "hours": [22.0, 6.0]},
    {"control": "uBlScr", "value": 1.0, "after_day": 3, "hours": [5.5, 12.0]},
    {"control": "uBlScr", "value": 0.25, "from": "02-20", "until": "03-05", "hours": [11.0, 11.5]},
]
compiled = pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))


@cache
def scheduled(base: str = "Spring-v1", days: int = 8) -> TaskSpec:
    """A task whose black-out screen follows ``ENTRIES``."""
    task = get_task(base)
    controls = [name for name in task.actuation.controls if name != "uBlScr"]
    modules = [*task.observation.modules, "schedule"]
    return task.replace(
        {"schema": 2, "weather.days": days, "actuation.controls": controls, "observation.modules": modules, "schedule": ENTRIES}
    )


def as_written(moment: dt.datetime, elapsed: int) -> float:
    """The entries once more, in plain words: the screen at a moment of the task's clock, ``elapsed`` days after the start."""
    value, evening = 0.0, moment if moment.hour >= 22 else moment - dt.timedelta(days=1)
    if (moment.hour >= 22 or moment.hour < 6) and evening.strftime("%A") in ("Monday", "Tuesday", "Friday"):
        value = 0.5
    if elapsed >= 3 and dt.time(5, 30) <= moment.time() < dt.time(12):
        value = 1.0
    if dt.date(moment.year, 2, 20) <= moment.date() <= dt.date(moment.year, 3, 5) and dt.time(11) <= moment.time() < dt.time(11, 30):
        value = 0.25
    return value


def actions(task: TaskSpec, n: int, seed: int = 1) -> NDArray[np.float32]:
    """Actions ``(steps, n, m)``; those of a row are the same for every n."""
    low, high = np.array([(one.low, one.high) for one in task.actions]).T
    return np.stack([np.random.default_rng([seed, row]).uniform(low, high, (task.steps, len(low))) for row in range(n)], 1).astype(
        np.float32
    )


def course(simulation: Simulation, given: NDArray[Any], seeds: tuple[int, ...] = SEEDS) -> dict[str, Floats]:
    """Controls, observations and quantities of every step, and the moments of the task's clock at which they begin."""
    first = simulation.reset(seeds)
    course: dict[str, list[Any]] = {"u": [], "observations": [first], "table": [], "moments": []}
    for action in given:
        seconds = simulation.time.astype("datetime64[s]").astype("datetime64[D]").astype(np.int64) * 86400
        ahead = np.rint(simulation.hour_of_day * 3600).astype(np.int64) - (
            simulation.time.astype("datetime64[s]").astype(np.int64) - seconds
        )
        ahead = (ahead + 43200) % 86400 - 43200
        course["moments"].append(simulation.time.astype("datetime64[s]") + ahead.astype("timedelta64[s]"))
        result = simulation.step(action)
        course["u"].append(simulation.u)
        course["observations"].append(result.observations)
        course["table"].append(result.table)
    return {name: np.array(values) for name, values in course.items()}


def still(task: TaskSpec, n: int = len(SEEDS)) -> Simulation:
    return Simulation(task, n, StillKernel())


@pytest.mark.parametrize("base", ["Spring-v1", "SpringEnergy-v1", "Schiphol2010-Delta10-v1"])
def test_the_screen_is_where_the_entries_say_in_every_run(base: str) -> None:
    """Of generated seasons with one calendar, of those with prices of their own, and of a single season; runs begin on their own days."""
    task = scheduled(base)
    run = course(still(task), actions(task, 3))
    place, steps = task.scheduled_places["uBlScr"], range(task.steps)
    expected = [[as_written(moment.item(), k // task.steps_per_day) for moment in run["moments"][k]] for k in steps]
    assert run["u"][:, :, place].tolist() == expected
    assert {0.0, 0.5, 1.0} <= set(run["u"][:, :, place].ravel().tolist())
    coming = run["observations"][:-1, :, [one.name for one in task.observed()].index("blackout_screen_scheduled")]
    assert coming.tolist() == expected
    if base == "Spring-v1":
        assert len({tuple(column) for column in np.array(expected).T}) == 3  # other days, other weekdays


@compiled
def test_the_compiled_step_and_numpy_give_the_same_bits_alone_and_in_a_batch() -> None:
    task = scheduled(days=4)
    given = actions(task, 3)
    fused, plain = (Simulation(task, 3, "fast", fused=one) for one in (True, False))
    assert (fused.fused, plain.fused) == (True, False)
    whole, again, alone = course(fused, given), course(plain, given), course(Simulation(task, 1, "fast"), given[:, 1:2], SEEDS[1:2])
    for name, values in whole.items():
        assert values.tobytes() == again[name].tobytes(), name
        row = values[..., 1:2] if name == "table" else values[:, 1:2]
        assert np.ascontiguousarray(row).tobytes() == alone[name].tobytes(), name
    assert set(whole["u"][..., SCREEN].ravel()) == {0.0, 0.25, 0.5, 1.0}


@compiled
def test_all_environments_follow_the_schedule() -> None:
    task = scheduled(days=4)
    given = actions(task, 3)
    run = course(Simulation(task, 3, "fast"), given)
    single, several = GreenhouseEnv(task, kernel="fast"), GreenhouseVectorEnv(task, 3, kernel="fast")
    assert single.reset(seed=1)[0].tobytes() == run["observations"][0, 0].tobytes()
    several.reset(seed=list(SEEDS))
    for k in range(200):
        assert single.step(given[k, 0])[0].tobytes() == run["observations"][k + 1, 0].tobytes()
        assert several.step(given[k])[0].tobytes() == run["observations"][k + 1].tobytes()


@compiled
def test_the_door_for_jax_has_the_same_bits() -> None:
    jax = pytest.importorskip("jax", reason="JAX is not installed (extra 'jax')")
    from glbench.jax import Environment, Params

    task = scheduled(days=4)
    given = actions(task, 3)
    run = course(Simulation(task, 3, "fast"), given)
    environment = Environment(task, seeds=SEEDS)
    rows = Params(np.arange(3), np.ones(3, np.int64))
    keys = jax.random.split(jax.random.key(0), 3)
    observed, state = jax.jit(jax.vmap(environment.reset))(keys, rows)
    step = jax.jit(jax.vmap(environment.step))
    for k in range(200):
        observed, state, *_ = step(keys, state, given[k])
        assert np.asarray(observed).tobytes() == run["observations"][k + 1].tobytes()
        assert environment.unpack(state)[1].tobytes() == run["u"][k].tobytes()


@pytest.mark.parametrize("fused", [pytest.param(True, marks=compiled), False])
def test_controls_that_are_given_directly_leave_the_schedule_alone(fused: bool) -> None:
    """Also those of a controller that acts past the actuation, and of a replay."""
    task = scheduled(days=4)
    by_actions = course(Simulation(task, 3, "fast", fused=fused), actions(task, 3))
    simulation = Simulation(task, 3, "fast", fused=fused)
    simulation.reset(SEEDS)
    for k, controls in enumerate(by_actions["u"]):
        others = controls.copy()
        others[:, SCREEN] = 0.77
        assert simulation.step_controls(others).table.tobytes() == by_actions["table"][k].tobytes()
        assert simulation.u.tobytes() == controls.tobytes()


def test_a_snapshot_continues_with_the_schedule() -> None:
    task = scheduled()
    given = actions(task, 3)
    whole, first, second = course(still(task), given), still(task), still(task)
    first.reset(SEEDS)
    for action in given[:300]:
        first.step(action)
    second.restore(Snapshot.from_bytes(first.snapshot().to_bytes()))
    for k in range(300, task.steps):
        second.step(given[k])
        assert second.u.tobytes() == whole["u"][k].tobytes()


def test_python_kinds_and_the_process_computer_leave_the_schedule_alone(own_words: None) -> None:
    register_actuation("test_direct", "the action is the control", lambda task: lambda controls, actions: actions.copy())
    task = scheduled()
    direct = task.replace({"actuation.kind": "test_direct", "id": "test/Direct-v1"})
    run, by_rate = course(still(direct), actions(direct, 3)), course(still(task), actions(task, 3))
    assert run["u"][..., SCREEN].tobytes() == by_rate["u"][..., SCREEN].tobytes()
    np.testing.assert_array_equal(run["u"][..., :SCREEN], actions(direct, 3).astype(np.float64))

    computed = get_task("tasks/drafts/springsetpoints-v1.toml").replace({"weather.days": 8})
    lamps = [{**one, "control": "uLamp"} for one in ENTRIES]
    granted = [name for name in computed.actuation.controls if name != "uLamp"]
    computed = computed.replace({"actuation.controls": granted, "schedule": lamps})
    lamp = computed.scheduled_places["uLamp"]
    run = course(still(computed), actions(computed, 3))
    assert run["u"][..., lamp].tobytes() == by_rate["u"][..., SCREEN].tobytes()


def test_what_the_calendar_moves_is_no_travel() -> None:
    task = scheduled()
    run = course(still(task), actions(task, 3))
    moves = np.abs(np.diff(run["u"], axis=0, prepend=0.0))
    travel = run["table"][:, make_accounts(task).names.index("actuator_travel")]
    np.testing.assert_allclose(travel, moves[..., :SCREEN].sum(axis=-1), atol=1e-12)
    assert moves[..., SCREEN].sum() > 10.0


@compiled
def test_a_part_of_ones_own_is_worked_by_the_calendar(own_words: None) -> None:
    """The tap of a tank, open on Tuesdays for two hours: 1e-3 kg m-2 s-1 are 7.2 kg m-2, and the ledger sees them."""
    model = register_model(compose(GreenLightClimate(), VanthoorTomato(), WaterTank()))
    price = {"value": 0.002, "unit": "EUR kg-1"}
    task = get_task("Schiphol2010-Delta00-v1").replace(
        {
            "schema": 2,
            "model.id": model.id,
            "weather.days": 7,
            "ledger.cost_water": {"side": "paid", "flow": "water", "price": price},
            "schedule": [{"control": "uFill", "value": 1.0, "weekdays": ["tuesday"], "hours": [9.0, 11.0]}],
        }
    )
    simulation = Simulation(task, 1, "fast")
    run = course(simulation, np.zeros((task.steps, 1, 6), np.float32), (666,))
    water = run["table"][:, make_accounts(task).names.index("water"), 0]
    assert water.sum() == pytest.approx(7.2)
    (open_at,) = np.nonzero(water)
    assert {moment.item().strftime("%A %H") for moment in run["moments"][open_at, 0]} == {"Tuesday 09", "Tuesday 10"}


def test_the_module_needs_a_schedule() -> None:
    task = get_task("Spring-v1")
    with pytest.raises(TaskError, match=r"'schedule' shows controls that follow a schedule, and there is none: add \[\[schedule\]\]"):
        task.replace({"observation.modules": [*task.observation.modules, "schedule"]})


def test_tasks_without_a_schedule_have_the_program_they_had(make_task: Callable[..., TaskSpec]) -> None:
    from glbench.env.program import calendar_columns, make_program

    program, _ = make_program(make_task())
    assert calendar_columns(make_task()) == program.calendar.shape[1] == 2
    assert not program.actuation.reads("calendar")
    assert not program.actuation.reads("counter")
