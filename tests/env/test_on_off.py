"""Machines that are off or on: the loads that they have, how long they stay, what is remembered, observed, counted and refused."""

from __future__ import annotations

from itertools import groupby
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.control import Scenario, StageReward
from glbench.env import GreenhouseEnv, GreenhouseVectorEnv, Simulation
from glbench.env.actuation import actions_of, make_actuation
from glbench.env.snapshot import Snapshot
from glbench.errors import TaskError
from glbench.report.task_words import definition_in_words
from glbench.tasks import TaskSpec, get_task, task_card
from tests.energy import energy_task
from tests.env.stepping import Floats, StillKernel

KINDS = {
    "rate": {"actuation.kind": "rate", "actuation.max_change": 0.1},
    "coarse rate": {"actuation.kind": "rate", "actuation.max_change": 1.0},
    "set_point": {"actuation.kind": "set_point", "actuation.max_change": 0.2},
    "any set_point": {},
}
LOWEST, HOLD = 0.7, 4  # steps
MODULES = ("switches",)


@pytest.fixture(params=KINDS)
def task(request: pytest.FixtureRequest) -> TaskSpec:
    return energy_task(KINDS[request.param])


def engine(task: TaskSpec) -> int:
    return task.model_value.control_names.index("uChp")


def actions(task: TaskSpec, n: int, seed: int = 1) -> NDArray[np.float32]:
    """Actions ``(steps, n, m)`` that often ask for all or nothing, and now and then for something in between."""
    generator = np.random.default_rng(seed)
    low, high = task.actions[0].low, task.actions[0].high
    drawn = generator.uniform(low, high, (task.steps, n, len(task.actions)))
    asked = generator.choice([low, high, 0.5 * (low + high)], (task.steps // 3, n)).repeat(3, axis=0)
    mixed = generator.random(asked.shape) < 0.7
    drawn[..., 1] = np.where(mixed, asked, drawn[..., 1])
    return drawn.astype(np.float32)


class Engine:
    """The rule once more, in plain words: a load, and how long ago it was switched."""

    def __init__(self, kind: str, max_change: float) -> None:
        self.kind, self.max_change, self.load, self.since = kind, max_change, 0.0, 10**6

    def step(self, action: float) -> float:
        off = max(LOWEST - self.max_change, 0.0)
        here = self.load if self.load > 0.0 else off
        if self.kind == "rate":
            there = here + self.max_change * action
        else:
            goal = off if action < LOWEST / 2 else max(action, LOWEST)
            there = min(max(goal, here - self.max_change), here + self.max_change)
        asked_on, is_on = there >= (off + LOWEST) / 2 - 1e-9, self.load > 0.0
        if asked_on != is_on and self.since >= HOLD:
            is_on, self.since = asked_on, 1
        else:
            self.since += 1
        self.load = min(max(there, LOWEST), 1.0) if is_on else 0.0
        return self.load

    @property
    def minutes_locked(self) -> float:
        return 15.0 * max(HOLD - self.since, 0)


def course(task: TaskSpec, given: NDArray[Any], seeds: tuple[int, ...], *, fused: bool = True) -> dict[str, Floats]:
    """Controls, observations, quantities and memory of every step."""
    simulation = Simulation(task, len(seeds), "fast", fused=fused)
    assert simulation.fused is fused
    simulation.reset(seeds)
    found: dict[str, list[Any]] = {"u": [], "observations": [], "table": []}
    for action in given:
        result = simulation.step(action)
        for name, value in (("u", simulation.u), ("observations", result.observations), ("table", result.table)):
            found[name].append(value.copy())
    return {name: np.array(values) for name, values in found.items()}


def test_a_machine_has_its_loads_stays_as_long_as_it_must_and_is_what_the_words_say(task: TaskSpec) -> None:
    given = actions(task, 3)
    found = course(task, given, (1, 2, 3))
    loads = found["u"][:, :, engine(task)]
    column = [quantity.name for quantity in task.observed()].index("engine_locked")
    for row in range(3):
        told = Engine(task.actuation.kind, task.actuation.max_change)
        for step, load in enumerate(loads[:, row]):
            assert load == pytest.approx(told.step(float(given[step, row, 1])), abs=1e-12)
            assert found["observations"][step, row, column] == told.minutes_locked
        spells = [(on, len(list(group))) for on, group in groupby(loads[:, row] > 0.0)]
        assert all(length >= HOLD for _, length in spells[1:-1])
        assert len(spells) > 4
    running = loads[loads > 0.0]
    assert running.min() >= LOWEST
    assert running.max() <= 1.0
    assert ((running > LOWEST) & (running < 1.0)).any()


def test_starts_are_counted_and_paid(task: TaskSpec) -> None:
    found = course(task, actions(task, 2), (1, 2))
    names = [quantity.name for quantity in task.quantities]
    on = np.vstack([np.zeros((1, 2)), found["u"][:, :, engine(task)]]) > 0.0
    starts = (on[1:] & ~on[:-1]).astype(float)
    assert found["table"][:, names.index("engine_starts")].tolist() == starts.tolist()
    assert found["table"][:, names.index("cost_starts")].tolist() == (0.0005 * starts).tolist()
    assert found["table"][:, names.index("engine_hours")].tolist() == (0.25 * on[1:]).tolist()
    assert starts.sum() > 4


def test_the_compiled_step_and_numpy_give_the_same_bits_alone_and_in_a_batch(task: TaskSpec) -> None:
    given, seeds = actions(task, 5), (1, 2, 3, 4, 5)
    whole, plain = course(task, given, seeds), course(task, given, seeds, fused=False)
    for name, values in whole.items():
        assert values.tobytes() == plain[name].tobytes(), name
    alone = course(task, given[:, 3:4], seeds[3:4])
    assert alone["u"].tobytes() == np.ascontiguousarray(whole["u"][:, 3:4]).tobytes()
    assert alone["observations"].tobytes() == np.ascontiguousarray(whole["observations"][:, 3:4]).tobytes()
    assert alone["table"].tobytes() == np.ascontiguousarray(whole["table"][:, :, 3:4]).tobytes()


def test_gymnasium_environments_switch_alike() -> None:
    task = energy_task(KINDS["rate"])
    given = actions(task, 2)
    found = course(task, given, (1, 2))
    single, several = GreenhouseEnv(task, kernel="fast"), GreenhouseVectorEnv(task, 2, kernel="fast")
    single.reset(seed=1)
    several.reset(seed=[1, 2])
    for step in range(40):
        one = single.step(given[step, 0])[0]
        many = several.step(given[step])[0]
        assert one.tobytes() == found["observations"][step, 0].tobytes()
        assert many.tobytes() == found["observations"][step].tobytes()


@pytest.mark.parametrize("fused", [True, False])
def test_a_snapshot_remembers_for_how_long_a_machine_is_locked(fused: bool) -> None:
    task = energy_task()
    given = actions(task, 2)
    given[8:10, :, 1], given[10:14, :, 1] = 0.0, 1.0
    given[14:20, :, 1] = 0.0
    one, other = (Simulation(task, 2, "fast", fused=fused) for _ in range(2))
    one.reset([1, 2])
    for action in given[:12]:
        one.step(action)
    locked = [quantity.name for quantity in task.observed()].index("engine_locked")
    assert (one.observe()[:, locked] > 0.0).any()
    other.restore(Snapshot.from_bytes(one.snapshot().to_bytes()))
    assert other.observe().tobytes() == one.observe().tobytes()
    for action in given[12:24]:
        assert one.step(action).observations.tobytes() == other.step(action).observations.tobytes()
        assert one.u.tobytes() == other.u.tobytes()


def test_runs_start_off_and_free() -> None:
    task = energy_task()
    simulation = Simulation(task, 2, StillKernel())
    locked = [quantity.name for quantity in task.observed()].index("engine_locked")
    for _ in range(2):
        assert (simulation.reset([1, 2])[:, locked] == 0.0).all()
        simulation.step(np.eye(8)[[1, 1]])
        assert (simulation.u[:, engine(task)] == 1.0).all()
        assert (simulation.observe()[:, locked] == 45.0).all()


def test_a_machine_without_a_hold_is_switched_in_every_step() -> None:
    task = energy_task({"actuation.on_off.uChp.hold_minutes": None, "observation.modules": ["indoor_climate", "energy"]})
    simulation = Simulation(task, 1, StillKernel())
    simulation.reset([1])
    loads = []
    for asked in (0.34, 0.36, 0.9, 0.2, 1.0):
        simulation.step(np.eye(8)[[1]] * asked)
        loads.append(float(simulation.u[0, engine(task)]))
    assert loads == [0.0, 0.7, 0.9, 0.0, 1.0]


def test_small_changes_cross_the_gap_from_its_middle_on() -> None:
    task = energy_task({**KINDS["rate"], "actuation.on_off.uChp.hold_minutes": None, "observation.modules": ["indoor_climate"]})
    simulation = Simulation(task, 1, StillKernel())
    simulation.reset([1])
    loads = []
    for action in (0.49, 0.5, 0.2, -0.6, -0.49, -0.5, -0.51):
        simulation.step(np.eye(8)[[1]] * action)
        loads.append(float(simulation.u[0, engine(task)]))
    assert loads == pytest.approx([0.0, 0.7, 0.72, 0.7, 0.7, 0.7, 0.0])


def test_other_controls_move_as_they_do_without_machines() -> None:
    task = energy_task(KINDS["rate"])
    plain = task.replace({"actuation.on_off": None, "observation.modules": ["indoor_climate", "energy"]})
    given = actions(task, 2)
    ours, theirs = (np.delete(course(one, given, (1, 2))["u"], engine(one), axis=2) for one in (task, plain))
    assert ours.tobytes() == theirs.tobytes()


def test_controls_past_the_actuation_are_applied_as_they_are() -> None:
    task = energy_task()
    simulation = Simulation(task, 1, StillKernel())
    simulation.reset([1])
    controls = np.zeros((1, 8))
    for load in (0.2, 0.0, 0.2):
        controls[0, engine(task)] = load
        result = simulation.step_controls(controls)
        assert simulation.u[0, engine(task)] == load
        assert result.quantities["engine_starts"].tolist() == [float(load > 0.0)]


# Task files


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"actuation.on_off.uChp.lowest": 0.0}, "a fraction above 0, up to 1"),
        ({"actuation.on_off.uChp.lowest": 1.5}, "a fraction above 0, up to 1"),
        ({"actuation.on_off.uChp.hold_minutes": -5}, "a number of minutes, 0 to 1440"),
        ({"actuation.on_off.uChp.longest": 2}, "longest"),
        ({"actuation.on_off.uChq.lowest": 0.7}, "'?uChq.* does not grant"),
        ({"actuation.kind": "process_computer"}, r"kind is .process_computer.\. It must be rate or set_point"),
        ({"actuation.on_off": None}, "'switches' shows for how long machines stay on or off"),
        ({"actuation.on_off.uChp.hold_minutes": None}, "'switches' shows for how long machines stay on or off"),
    ],
)
def test_impossible_machines_are_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(TaskError, match=words):
        _ = energy_task(changes).digest


def test_machines_are_part_of_a_task_s_digest_and_tasks_without_them_keep_theirs() -> None:
    task = energy_task()
    other = energy_task({"actuation.on_off.uChp.lowest": 0.6})
    assert task.definition()["actuation"]["on_off"] == {"uChp": {"lowest": 0.7, "hold_minutes": 60.0}}
    assert task.digest != other.digest
    assert "on_off" not in get_task("Spring-v1").definition()["actuation"]
    assert get_task("Spring-v1").locked
    assert get_task("Schiphol2010-Delta10-v1").on_off == {}


def test_a_submission_s_card_tells_of_machines() -> None:
    assert task_card(energy_task()).task().on_off == energy_task().on_off


def test_a_task_is_told_in_words() -> None:
    words = [line for section in definition_in_words(energy_task()) for line in section.lines]
    assert "uChp is 0 or 0.7 to 1, and stays on or off for at least 60 minutes." in words


# Planning


def test_controls_alone_cannot_tell_what_a_machine_does() -> None:
    with pytest.raises(TaskError, match="of uChp remembers: it works in the step of a Simulation only"):
        make_actuation(energy_task())


@pytest.mark.parametrize("kind", ["rate", "set_point"])
def test_actions_lead_to_the_nearest_load_that_there_is(kind: str) -> None:
    task = energy_task({**KINDS[kind], "actuation.on_off.uChp.hold_minutes": None, "observation.modules": ["energy"]})
    simulation = Simulation(task, 1, StillKernel())
    simulation.reset([1])
    wanted = np.full((1, 8), 0.4)
    reached = []
    for load in (0.8, 0.3, 0.4, 1.0, 0.0):
        wanted[0, engine(task)] = load
        for _ in range(6):
            simulation.step(actions_of(task, simulation.u, wanted))
        reached.append(float(simulation.u[0, engine(task)]))
    assert reached == pytest.approx([0.8, 0.0, 0.7, 1.0, 0.0])
    assert np.delete(simulation.u[0], engine(task)) == pytest.approx(np.full(7, 0.4))


def test_a_reward_that_prices_starts_has_no_derivatives() -> None:
    with pytest.raises(TaskError, match=r"depends on what controls were before a step \(a line of its ledger prices starts\)"):
        StageReward(energy_task())
    task = energy_task({"ledger.cost_starts": None})
    given = actions(task, 1)[:8]
    simulation = Simulation(task, 1, "fast")
    simulation.reset([1])
    states, controls, rewards = [simulation.x[0].copy()], [], []
    for action in given:
        rewards.append(simulation.step(action).rewards[0])
        states.append(simulation.x[0].copy())
        controls.append(simulation.u[0].copy())
    values, slopes = StageReward(task).gradient(np.array(states), np.array(controls), Scenario.of(task, 1).calendar[: len(states)])
    assert values.reward.tobytes() == np.array(rewards).tobytes()
    assert np.isfinite(slopes.controls).all()
    assert (slopes.controls[:, engine(task)] != 0.0).any()
