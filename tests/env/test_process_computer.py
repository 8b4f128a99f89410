"""The process computer: each rule by itself, and all of them in the step."""

from __future__ import annotations

import copy
import dataclasses
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box
from numpy.typing import NDArray

from glbench.env import GreenhouseEnv, GreenhouseVectorEnv, Simulation, Snapshot
from glbench.env.actuation import ActuationInputs, make_actuation, recorded_actuation
from glbench.env.air import read_air
from glbench.env.process_computer import MEMORY, Measured, work
from glbench.env.program import make_program
from glbench.episodes.signals import signals_of
from glbench.errors import ActionError, TaskError
from glbench.kernel import why_not_compiled
from glbench.kernel.tape import Recorder, with_simplification
from glbench.model import humidity_deficit
from glbench.report.task_words import definition_in_words
from glbench.tasks import Action, TaskSpec, get_task, task_card
from glbench.tasks.tables import ProcessComputerTable
from glbench.tasks.vocabulary import ACTUATION_KINDS

ALL = ("uBoil", "uCo2", "uThScr", "uVent", "uLamp", "uBlScr")
WANTED = {
    "heating_temperature": 18.0, "ventilation_temperature": 22.0, "co2_set_point": 800.0, "humidity_deficit": 0.0, "lamps_from": 2.0,
    "lamps_until": 18.0, "lamp_radiation_limit": 0.0, "screen_radiation_limit": 0.0, "screen_outdoor_temperature": 10.0,
}  # fmt: skip
STILL = Measured(20.0, 800.0, 5.0, radiation=300.0, outdoor_temperature=20.0, wind_speed=0.0, hour_of_day=12.0)
MakeComputer = Callable[..., TaskSpec]


@pytest.fixture(scope="module")
def make_computer(tmp_path_factory: pytest.TempPathFactory) -> MakeComputer:
    """A task of one day with a process computer, its settings and the controls that it works; vents that move at once unless damped."""
    folder = tmp_path_factory.mktemp("computers")
    made: dict[tuple[str, ...], TaskSpec] = {}

    def make(*settings: str, controls: tuple[str, ...] = ALL, max_change: float = 1.0, damped: bool = False) -> TaskSpec:
        if not damped:
            settings = (*settings, 'vent_time = { value = 0.0, unit = "h" }')
        key = (*settings, *controls, str(max_change))
        if key not in made:
            path = folder / f"task{len(made)}.toml"
            path.write_text(
                f"""
                base = "glbench/Schiphol2010-Delta10-v1"
                schema = 2
                id = "tests/Computer{len(made)}-v1"
                title = "A computer"
                weather.days = 1
                [actuation]
                kind = "process_computer"
                max_change = {max_change}
                controls = [{", ".join(f'"{name}"' for name in controls)}]
                {"[actuation.process_computer]" if settings else ""}
                """
                + "\n".join(settings),
                encoding="utf-8",
            )
            made[key] = get_task(str(path))
        return made[key]

    return make


class Computer:
    """A computer by itself: what it remembers and how its controls stand, step after step."""

    def __init__(self, task: TaskSpec, **wanted: float) -> None:
        self.task, self.memory = task, dict(MEMORY)
        self.controls = dict.fromkeys(task.actuation.controls, 0.0)
        self.wanted = {action.name: (WANTED | wanted)[action.name] for action in task.actions}

    def __call__(self, **measured: float) -> dict[str, Any]:
        seen = Measured(**(vars(STILL) | measured))
        moved, self.memory = work(self.task, self.wanted, self.controls, seen, self.memory)
        self.controls = {name: float(value) for name, value in moved.items()}
        return self.controls

    def settled(self, **measured: float) -> dict[str, Any]:
        """Controls once the rate limit binds no more."""
        for _ in range(20):
            self(**measured)
        return self.controls


def test_heat_is_proportional_below_the_heating_temperature(make_computer: MakeComputer) -> None:
    task = make_computer()  # a P-band of 2 K
    for air, share in ((18.5, 0.0), (18.0, 0.0), (17.5, 0.25), (17.0, 0.5), (16.0, 1.0), (10.0, 1.0)):
        assert Computer(task)(air_temperature=air)["uBoil"] == pytest.approx(share, abs=1e-12)
    wide = make_computer('heating_band = { value = 4.0, unit = "K" }')
    assert Computer(wide)(air_temperature=17.0)["uBoil"] == pytest.approx(0.25, abs=1e-12)


@pytest.mark.parametrize(
    ("outside", "wind", "band"), [(20.0, 0.0, 6.0), (30.0, 0.0, 6.0), (10.0, 0.0, 12.0), (10.0, 5.0, 13.5), (-30.0, 9.0, 25.0)]
)
def test_vents_are_proportional_in_a_band_that_widens_with_cold_and_wind(
    make_computer: MakeComputer, outside: float, wind: float, band: float
) -> None:
    task, weather = make_computer(), {"outdoor_temperature": outside, "wind_speed": wind}
    assert Computer(task)(air_temperature=22.0, **weather)["uVent"] == 0.0
    assert Computer(task)(air_temperature=22.0 + band / 4.0, **weather)["uVent"] == pytest.approx(0.25, abs=1e-12)
    assert Computer(task)(air_temperature=22.0 + band, **weather)["uVent"] == pytest.approx(1.0, abs=1e-12)


def test_vents_move_slowly_and_arrive(make_computer: MakeComputer) -> None:
    computer = Computer(make_computer(damped=True))
    found = [computer(air_temperature=25.0)["uVent"] for _ in range(12)]
    # half an hour: a third of the way in each step of 15 minutes, and at once over the last 2 %
    assert found[:3] == pytest.approx([0.5 / 3.0, 0.5 * 5.0 / 9.0, 0.5 * 19.0 / 27.0])
    assert found[-1] == 0.5
    assert [computer(air_temperature=15.0)["uVent"] for _ in range(12)][-1] == 0.0


def test_vents_never_open_below_the_heating_temperature_and_the_dead_zone(make_computer: MakeComputer) -> None:
    hostile = {"heating_temperature": 24.0, "ventilation_temperature": 10.0}
    for air in np.linspace(5.0, 25.0, 41):
        controls = Computer(make_computer(), **hostile)(air_temperature=float(air))
        assert controls["uVent"] == 0.0
    controls = Computer(make_computer(), **hostile)(air_temperature=26.5)
    assert controls["uVent"] == pytest.approx(1.5 / 6.0, abs=1e-12)
    assert controls["uBoil"] == 0.0
    apart = make_computer('dead_zone = { value = 3.0, unit = "K" }')
    assert Computer(apart, **hostile)(air_temperature=27.0)["uVent"] == 0.0


def test_set_points_are_ramped_and_hold_at_once_in_the_first_step(make_computer: MakeComputer) -> None:
    computer = Computer(make_computer())
    computer()
    assert computer.memory["heating_temperature"] == 18.0
    computer.wanted["heating_temperature"] = 20.0
    computer()
    assert computer.memory["heating_temperature"] == pytest.approx(18.0 + 1.5 / 4.0)  # 1.5 K an hour, a step of 15 minutes
    assert computer.memory["ventilation_temperature"] == 22.0
    for _ in range(10):
        computer()
    assert computer.memory["heating_temperature"] == 20.0
    computer.wanted["heating_temperature"] = 15.0
    computer()
    assert computer.memory["heating_temperature"] == pytest.approx(20.0 - 3.0 / 4.0)


def test_the_ventilation_temperature_rises_before_the_heating_comes_near(make_computer: MakeComputer) -> None:
    computer = Computer(make_computer(), ventilation_temperature=19.0)
    computer()
    computer.wanted["heating_temperature"] = 25.0
    for _ in range(40):
        computer()
        apart = computer.memory["ventilation_temperature"] - computer.memory["heating_temperature"]
        assert apart >= 1.0 - 1e-12
    assert computer.memory["ventilation_temperature"] == 26.0


def test_humid_air_brings_minimum_heat_in_little_light_and_a_gap_in_the_vents(make_computer: MakeComputer) -> None:
    task = make_computer()
    half, full, humid = {"humidity_deficit": 2.5}, {"humidity_deficit": 3.0}, 2.0
    night = {"humidity_deficit": humid, "radiation": 0.0}
    assert Computer(task, **half)(**night)["uBoil"] == pytest.approx(0.5 * 20.0 / 130.0)
    assert Computer(task, **full)(**night)["uBoil"] == pytest.approx(20.0 / 130.0)
    assert Computer(task, **full)(humidity_deficit=humid, radiation=125.0)["uBoil"] == pytest.approx(10.0 / 130.0)
    assert Computer(task, **full)(humidity_deficit=humid, radiation=250.0)["uBoil"] == 0.0
    assert Computer(task, **half)(**night)["uVent"] == pytest.approx(0.125)
    assert Computer(task, **full)(**night)["uVent"] == pytest.approx(0.25)
    assert Computer(task, **full)(humidity_deficit=3.0)["uVent"] == 0.0


def test_the_gap_shuts_as_the_air_gets_cold(make_computer: MakeComputer) -> None:
    def gap(air: float) -> float:
        value: float = Computer(make_computer(), humidity_deficit=8.0)(air_temperature=air, humidity_deficit=0.2)["uVent"]
        return value

    assert gap(18.0) == pytest.approx(0.25)
    assert gap(17.0) == pytest.approx(0.125)
    assert gap(16.0) == 0.0


def test_co2_is_dosed_below_its_set_point_in_light(make_computer: MakeComputer) -> None:
    task = make_computer()
    for co2, share in ((900.0, 0.0), (800.0, 0.0), (700.0, 0.5), (600.0, 1.0), (300.0, 1.0)):
        assert Computer(task)(co2=co2)["uCo2"] == pytest.approx(share)
    assert Computer(task)(co2=400.0, radiation=0.0)["uCo2"] == 0.0
    assert Computer(task)(co2=400.0, radiation=15.0)["uCo2"] == pytest.approx(0.5)
    lit = Computer(task, lamp_radiation_limit=200.0)
    assert lit(co2=400.0, radiation=0.0)["uLamp"] == 1.0
    assert lit.controls["uCo2"] == 1.0


def test_co2_stops_as_the_vents_open(make_computer: MakeComputer) -> None:
    task = make_computer()
    for opening, share in ((0.0, 1.0), (0.1, 1.0), (0.2, 0.5), (0.3, 0.0), (0.8, 0.0)):
        controls = Computer(task)(co2=400.0, air_temperature=22.0 + 6.0 * opening)
        assert controls["uVent"] == pytest.approx(opening, abs=1e-12)
        assert controls["uCo2"] == pytest.approx(share, abs=1e-9)
    slow = Computer(make_computer(max_change=0.25))
    assert slow(co2=400.0, air_temperature=40.0)["uVent"] == 0.25
    assert slow.controls["uCo2"] == pytest.approx(0.25, abs=1e-9)  # by the vents as they stand, within its own rate


def test_lamps_burn_within_their_hours(make_computer: MakeComputer) -> None:
    task, dark = make_computer(), {"radiation": 0.0}
    for hour, lit in ((0.0, 0.0), (1.75, 0.0), (2.0, 1.0), (12.0, 1.0), (17.75, 1.0), (18.0, 0.0), (23.75, 0.0)):
        assert Computer(task, lamp_radiation_limit=200.0)(hour_of_day=hour, **dark)["uLamp"] == lit
    for hours in ({"lamps_from": 5.0, "lamps_until": 5.0}, {"lamps_from": 20.0, "lamps_until": 4.0}):
        for hour in (0.0, 3.0, 5.0, 22.0):
            assert Computer(task, lamp_radiation_limit=200.0, **hours)(hour_of_day=hour, **dark)["uLamp"] == 0.0
    assert Computer(task, lamp_radiation_limit=0.0)(**dark)["uLamp"] == 0.0


def test_lamps_go_off_in_bright_light_and_come_back_after_a_while(make_computer: MakeComputer) -> None:
    computer = Computer(make_computer(), lamp_radiation_limit=200.0)
    course = ((0, 1), (199, 1), (200, 0), (100, 0), (160, 0), (151, 0), (149, 1), (300, 1), (300, 0))
    # 200 and above: off; on again below 200 - 50, but no sooner than half an hour after they went off, nor off after they came on
    assert [computer(radiation=float(radiation))["uLamp"] for radiation, _ in course] == [float(lit) for _, lit in course]


def test_the_clock_does_not_wait_for_the_minimum_time(make_computer: MakeComputer) -> None:
    computer = Computer(make_computer('lamp_minimum_time = { value = 5.0, unit = "h" }'), lamp_radiation_limit=200.0)
    assert computer(radiation=300.0, hour_of_day=17.25)["uLamp"] == 0.0
    assert computer(radiation=0.0, hour_of_day=17.5)["uLamp"] == 0.0
    fresh = Computer(make_computer(), lamp_radiation_limit=200.0)
    assert fresh(radiation=0.0, hour_of_day=17.75)["uLamp"] == 1.0
    assert fresh(radiation=0.0, hour_of_day=18.0)["uLamp"] == 0.0


def test_the_screen_closes_in_cold_and_little_light_with_hysteresis(make_computer: MakeComputer) -> None:
    wanted = {"screen_radiation_limit": 50.0, "screen_outdoor_temperature": 10.0}
    cold = {"outdoor_temperature": 5.0}
    computer = Computer(make_computer('screen_minimum_time = { value = 0.0, unit = "h" }'), **wanted)
    course = ((60, 0), (50, 0), (49, 1), (69, 1), (70, 0), (60, 0), (10, 1))
    assert [computer(radiation=float(r), **cold)["uThScr"] for r, _ in course] == [float(shut) for _, shut in course]
    outside = ((10.5, 1), (11.0, 0), (10.5, 0), (10.0, 0), (9.5, 1))
    found = [computer(radiation=0.0, outdoor_temperature=value)["uThScr"] for value, _ in outside]
    assert found == [float(shut) for _, shut in outside]
    computer.wanted["screen_radiation_limit"] = 0.0
    assert computer(radiation=0.0, **cold)["uThScr"] == 0.0


def test_the_screen_does_not_flap(make_computer: MakeComputer) -> None:
    computer = Computer(make_computer('screen_minimum_time = { value = 1.0, unit = "h" }'), screen_radiation_limit=50.0)
    radiation = [0.0, 200.0] * 12
    shut = [computer(radiation=one, outdoor_temperature=0.0)["uThScr"] for one in radiation]
    thrown = np.flatnonzero(np.diff(shut)) + 1
    assert shut[0] == 1.0
    assert len(thrown) > 2
    assert np.diff(thrown).min() >= 4  # an hour of steps


def test_a_closed_screen_has_a_gap_in_humid_air_and_opens_in_hot_air(make_computer: MakeComputer) -> None:
    wanted = {"screen_radiation_limit": 50.0, "humidity_deficit": 8.0}
    closed = {"radiation": 0.0, "outdoor_temperature": 0.0}
    task = make_computer()
    assert Computer(task, **wanted)(humidity_deficit=0.2, **closed)["uThScr"] == pytest.approx(0.9)
    assert Computer(task, **wanted)(air_temperature=23.0, humidity_deficit=9.0, **closed)["uThScr"] == pytest.approx(0.5)
    assert Computer(task, **wanted)(air_temperature=24.0, humidity_deficit=9.0, **closed)["uThScr"] == 0.0


def test_the_blackout_screen_is_closed_while_lamps_burn_in_the_dark(make_computer: MakeComputer) -> None:
    computer = Computer(make_computer(), lamp_radiation_limit=200.0)
    assert computer(radiation=0.0, hour_of_day=4.0)["uBlScr"] == 1.0
    assert computer(radiation=10.0, hour_of_day=8.0)["uBlScr"] == 0.0
    assert computer(radiation=0.0, hour_of_day=20.0)["uBlScr"] == 0.0
    unlit = make_computer(controls=("uThScr", "uBlScr"))
    assert Computer(unlit, screen_radiation_limit=50.0)(radiation=0.0, outdoor_temperature=0.0) == {"uThScr": 1.0, "uBlScr": 0.0}


def test_controls_move_by_at_most_max_change(make_computer: MakeComputer) -> None:
    computer = Computer(make_computer(max_change=0.1))
    found = [computer(air_temperature=5.0)["uBoil"] for _ in range(12)]
    assert found == pytest.approx([min(0.1 * step, 1.0) for step in range(1, 13)])
    assert computer(air_temperature=25.0)["uBoil"] == pytest.approx(0.9)


@pytest.mark.parametrize(
    ("controls", "actions"),
    [
        (("uBoil",), ["heating_temperature", "humidity_deficit"]),
        (("uVent", "uCo2"), ["ventilation_temperature", "co2_set_point", "humidity_deficit"]),
        (("uCo2",), ["co2_set_point"]),
        (("uLamp",), ["lamps_from", "lamps_until", "lamp_radiation_limit"]),
        (("uThScr",), ["humidity_deficit", "screen_radiation_limit", "screen_outdoor_temperature"]),
    ],
)
def test_set_points_are_those_of_the_controls_granted(make_computer: MakeComputer, controls: tuple[str, ...], actions: list[str]) -> None:
    task = make_computer(controls=controls)
    assert [action.name for action in task.actions] == actions
    assert set(Computer(task)(air_temperature=15.0, co2=300.0)) == set(controls)
    simulation = Simulation(task, 2, "fast")
    simulation.reset([1, 2])
    low, high = task_card(task).action_bounds
    for share in (0.0, 0.5, 1.0):
        simulation.step(np.tile(low + share * (high - low), (2, 1)))
        others = [place for place, name in enumerate(task.model_value.control_names) if name not in controls]
        assert (simulation.u[:, others] == 0.0).all()


def test_without_a_boiler_vents_keep_their_temperature_and_without_vents_the_screen_knows_when_it_is_hot(
    make_computer: MakeComputer,
) -> None:
    vents = Computer(make_computer(controls=("uVent",)), ventilation_temperature=8.0)
    assert vents(air_temperature=11.0)["uVent"] == pytest.approx(0.5)
    screen = Computer(make_computer(controls=("uBoil", "uThScr")), screen_radiation_limit=50.0)
    closed = screen(radiation=0.0, outdoor_temperature=0.0, air_temperature=20.0)  # 1 K above heating and dead zone
    assert closed["uThScr"] == pytest.approx(0.5)


# In the step.


def random_set_points(task: TaskSpec, steps: int, n: int, seed: int = 3) -> NDArray[np.float32]:
    """Set points that change every few steps, ``(steps, n, m)``; column i is the same for every n."""
    low, high = task_card(task).action_bounds
    shares = [np.random.default_rng([seed, row]).uniform(0.0, 1.0, (-(-steps // 4), len(low))) for row in range(n)]
    points = low + np.repeat(np.stack(shares, axis=1), 4, axis=0)[:steps] * (high - low)
    return np.asarray(np.minimum(np.maximum(points, low), high), dtype=np.float32)


def bits(simulation: Simulation) -> list[bytes]:
    return [array.tobytes() for array in (simulation.x, simulation.u, simulation.memory, simulation.k)]


@pytest.fixture(scope="module")
def task(make_computer: MakeComputer) -> TaskSpec:
    """All controls, the rate of the paper."""
    return make_computer(max_change=0.1, damped=True)


@pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))
@pytest.mark.parametrize("n", [1, 5])
def test_the_compiled_step_has_the_bits_of_numpy(task: TaskSpec, n: int) -> None:
    fused, plain = Simulation(task, n, "fast"), Simulation(task, n, "fast", fused=False)
    seeds = list(range(1, n + 1))
    first = [one.reset(seeds).tobytes() for one in (fused, plain)]
    assert first[0] == first[1]
    assert (fused.fused, plain.fused) == (True, False)
    positions = set()
    for step, actions in enumerate(random_set_points(task, 96, n)):
        if step % 17 == 16:
            controls = np.random.default_rng(step).uniform(0.0, 1.0, (n, 6))
            results = [one.step_controls(controls) for one in (fused, plain)]
        else:
            results = [one.step(actions) for one in (fused, plain)]
        assert results[0].table.tobytes() == results[1].table.tobytes()
        assert results[0].observations.tobytes() == results[1].observations.tobytes()
        assert bits(fused) == bits(plain)
        positions |= set(fused.u.ravel().tolist())
    assert len(positions) > 50


def test_a_run_has_the_same_bits_alone_and_in_a_batch(task: TaskSpec) -> None:
    together, alone = Simulation(task, 4, "fast"), Simulation(task, 1, "fast")
    together.reset([5, 6, 7, 8])
    alone.reset([7])
    for actions in random_set_points(task, 60, 4):
        together.step(actions)
        alone.step(actions[2:3])
    assert together.x[2].tobytes() == alone.x[0].tobytes()
    assert together.memory[2].tobytes() == alone.memory[0].tobytes()


def deficit_of(temperature: NDArray[np.float64], humidity: NDArray[np.float64]) -> NDArray[np.float64]:
    """The model's humidity deficit as a tape gives it."""
    with Recorder() as recorder:
        given = [recorder.input("after", place) for place in range(2)]
        recorder.output("table", 0, with_simplification(humidity_deficit, *given))
    ((_, _, values),) = recorder.tape().play(lambda source, index: (temperature, humidity)[index])
    return np.asarray(values)


def test_the_tape_does_what_the_rules_do(task: TaskSpec) -> None:
    """Recorded and played, the rules give the bits that they give on arrays: in 200 random moments."""
    rng, n = np.random.default_rng(5), 200
    tape, names = make_program(task)[0].actuation, task.model_value.control_names
    low, high = task_card(task).action_bounds
    x = np.tile(task.initial_state(), (n, 1))
    for name, width in zip(task.model_value.air or (), (15.0, 900.0, 1200.0), strict=True):
        x[:, task.model_value.state_index(name)] += rng.uniform(0.0, width, n)
    rows = {
        "given": rng.uniform(low, high, (n, len(low))), "controls": rng.uniform(0.0, 1.0, (n, 6)), "before": x,
        "weather": rng.uniform(0.0, 30.0, (n, 10)), "calendar": rng.uniform(0.0, 24.0, (n, 2)),
        "memory": np.stack([np.full(n, 1.0), *rng.uniform(10.0, 30.0, (2, n)), *rng.integers(0, 2, (4, n))], axis=1).astype(float),
    }  # fmt: skip
    played = {(target, index): values for target, index, values in tape.play(lambda source, index: rows[source][:, index])}
    recorded = recorded_actuation(task)
    assert recorded is not None
    assert list(recorded.memory) == list(MEMORY)
    air = read_air(*(x[:, task.model_value.state_index(name)] for name in task.model_value.air or ()))
    weather = rows["weather"]
    seen = air[0], air[1], deficit_of(air[0], air[2])
    measured = Measured(*seen, weather[:, 0], weather[:, 1], weather[:, 4], rows["calendar"][:, 0])
    moved, kept = recorded.work(
        task,
        ActuationInputs(
            {action.name: rows["given"][:, place] for place, action in enumerate(task.actions)},
            dict(zip(names, rows["controls"].T, strict=True)),
            dict(zip(MEMORY, rows["memory"].T, strict=True)), measured,
        ),
    )  # fmt: skip
    for index, name in enumerate(names):
        assert np.asarray(played["controls", index]).tobytes() == np.asarray(moved[name]).tobytes(), name
    for place, name in enumerate(MEMORY):
        assert np.array_equal(np.broadcast_to(played["memory", place], n), np.broadcast_to(kept[name], n)), name


def test_a_snapshot_and_a_pickle_continue_with_what_the_computer_remembers(task: TaskSpec) -> None:
    simulation = Simulation(task, 3, "fast")
    simulation.reset([1, 2, 3])
    course = random_set_points(task, 40, 3)
    for actions in course[:20]:
        simulation.step(actions)
    assert (simulation.memory[:, 0] == 1.0).all()
    others = [copy.deepcopy(simulation), pickle.loads(pickle.dumps(simulation)), Simulation(task, 3, "fast")]
    others[2].restore(Snapshot.from_bytes(simulation.snapshot().to_bytes()))
    for actions in course[20:]:
        for one in (simulation, *others):
            one.step(actions)
    for one in others:
        assert bits(one) == bits(simulation)


def test_a_new_episode_forgets_what_the_computer_remembered(task: TaskSpec) -> None:
    simulation = Simulation(task, 2, "fast")
    simulation.reset([1, 2])
    course = random_set_points(task, 30, 2)
    for actions in course:
        simulation.step(actions)
    simulation.reset([9], rows=[1])
    fresh = Simulation(task, 1, "fast")
    fresh.reset([9])
    for actions in course:
        simulation.step(actions)
        fresh.step(actions[1:])
    assert simulation.x[1].tobytes() == fresh.x[0].tobytes()


def test_environment_and_vector_environment_act_alike(task: TaskSpec) -> None:
    env, envs = GreenhouseEnv(task, "fast"), GreenhouseVectorEnv(task, num_envs=2, kernel="fast")
    assert env.action_space == Box(-1.0, 1.0, (9,), np.float32)
    assert envs.action_space.shape == (2, 9)
    env.reset(seed=4)
    envs.reset(seed=4)
    for actions in random_set_points(task, 10, 2):
        seen, _, _, _, info = env.step(actions[0])
        all_seen, *_ = envs.step(actions)
        assert seen.tobytes() == all_seen[0].tobytes()
        assert {"boiler", "vents"} <= info.keys()


@pytest.mark.parametrize(
    ("actions", "said"),
    [
        (np.zeros((1, 6)), "heating_temperature, ventilation_temperature"),
        (np.full((1, 9), np.nan), "'heating_temperature'.* not a finite number"),
        ([[0.2, 1.1, 0, 0, 0, 0, 0, 0, 0]], r"'ventilation_temperature'\) of row 0 is 1.1, outside its bounds -1 to 1"),
        ([[18.0, 0, 0, 0, 0, 0, 0, 0, 0]], r"'heating_temperature'\) of row 0 is 18.0, outside its bounds -1 to 1"),
    ],
)
def test_hostile_actions_are_refused_by_name(task: TaskSpec, actions: Any, said: str) -> None:
    simulation = Simulation(task, 1, "fast")
    simulation.reset([1])
    with pytest.raises(ActionError, match=said):
        simulation.step(actions)


def test_a_single_environment_names_set_points_when_the_shape_is_wrong(task: TaskSpec) -> None:
    env = GreenhouseEnv(task, "fast")
    env.reset(seed=1)
    with pytest.raises(ActionError, match=r"Expected shape \(9,\): heating_temperature, .*, screen_outdoor_temperature"):
        env.step(np.zeros(6, dtype=np.float32))


def test_the_computer_is_no_part_for_use_by_itself(task: TaskSpec) -> None:
    with pytest.raises(TaskError, match="in the step of a Simulation only"):
        make_actuation(task)


def test_idle_set_points_leave_everything_shut(task: TaskSpec) -> None:
    simulation = Simulation(task, 1, "fast")
    simulation.reset([1])
    idle = np.array([[action.idle for action in task.actions]])
    asked = {action.name: action.value(action.idle) for action in task.actions}
    assert asked == dict.fromkeys(asked, 0.0) | {"ventilation_temperature": 40.0, "screen_outdoor_temperature": -10.0}
    for _ in range(96):
        simulation.step(idle)
        if simulation.air[0, 0] > 0.5:
            assert (simulation.u == 0.0).all()


# Scaled set points.


def test_an_action_stands_for_a_set_point_between_the_lowest_and_the_highest(task: TaskSpec) -> None:
    assert {(action.low, action.high) for action in task.actions} == {(-1.0, 1.0)}
    vents = task.actions[1]
    assert (vents.name, vents.unit, vents.lowest, vents.highest) == ("ventilation_temperature", "degC", 5.0, 40.0)
    assert [vents.value(given) for given in (-1.0, 0.0, 1.0)] == [5.0, 22.5, 40.0]
    assert [vents.of(value) for value in (5.0, 22.5, 40.0, 57.5)] == [-1.0, 0.0, 1.0, 2.0]
    for action in task.actions:
        assert (action.value(-1.0), action.value(1.0)) == (action.lowest, action.highest)
        values = np.linspace(action.lowest, action.highest, 35).reshape(5, 7)
        given = action.of(values)
        assert (given.shape, given.min(), given.max()) == ((5, 7), -1.0, 1.0)
        assert action.value(given) == pytest.approx(values, abs=1e-12 * (action.highest - action.lowest))


def test_an_action_that_stands_for_itself_is_not_touched() -> None:
    valve, given = Action("valve", 0.0, 80.0, "degC"), np.array([-0.0, 3.3])
    assert (valve.lowest, valve.highest) == (0.0, 80.0)
    assert valve.of(given) is given
    assert valve.value(given) is given


@pytest.mark.parametrize("stands_for", [(2.0, 2.0), (3.0, 2.0), (0.0, np.inf), (np.nan, 1.0)])
def test_an_action_cannot_stand_for_values_out_of_order(stands_for: tuple[float, float]) -> None:
    with pytest.raises(TaskError, match="'pipe' from -1 to 1 cannot stand for values from"):
        Action("pipe", -1.0, 1.0, "degC", stands_for=stands_for)


def test_set_points_given_at_the_hour_or_the_reading_switch_as_if_they_had_not_been_scaled(make_computer: MakeComputer) -> None:
    """float32 rounds most of these set points up or down; a reading that equals one falls on the same side of all."""
    task = make_computer('lamp_minimum_time = { value = 0.0, unit = "h" }', 'screen_minimum_time = { value = 0.0, unit = "h" }')
    by_name = {action.name: action for action in task.actions}

    def given(name: str, value: float) -> float:
        return float(by_name[name].value(float(np.float32(by_name[name].of(value)))))

    rounded = 0
    for quarter in range(1, 95):
        hour = quarter / 4.0
        wanted = {"lamps_from": given("lamps_from", hour), "lamps_until": given("lamps_until", hour + 0.25)}
        rounded += wanted["lamps_from"] != hour
        lit = [Computer(task, lamp_radiation_limit=500.0, **wanted)(hour_of_day=one) for one in (hour - 0.25, hour, hour + 0.25)]
        assert [one["uLamp"] for one in lit] == [0.0, 1.0, 0.0]
    for tenth in range(-90, 290):
        outside, radiation = tenth / 10.0, float(abs(tenth) + 1)
        wanted = {
            "screen_outdoor_temperature": given("screen_outdoor_temperature", outside),
            "screen_radiation_limit": given("screen_radiation_limit", radiation),
            "lamp_radiation_limit": given("lamp_radiation_limit", radiation),
        }
        rounded += wanted["screen_outdoor_temperature"] != outside
        computer = Computer(task, **wanted)
        dark = {"radiation": radiation - 1.0}
        assert computer(outdoor_temperature=outside, **dark)["uThScr"] == 0.0
        assert computer(outdoor_temperature=outside - 0.1, radiation=radiation)["uThScr"] == 0.0
        assert computer(outdoor_temperature=outside - 0.1, **dark)["uThScr"] == 1.0
        assert computer(outdoor_temperature=outside + 1.0, **dark)["uThScr"] == 0.0
        assert Computer(task, **wanted)(radiation=radiation)["uLamp"] == 0.0
        assert Computer(task, **wanted)(radiation=radiation - 1.0)["uLamp"] == 1.0
    assert rounded > 100


def test_the_digest_covers_the_ranges(task: TaskSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    warmer = (dataclasses.replace(task.actions[0], stands_for=(0.0, 31.0)), *task.actions[1:])
    kind = ACTUATION_KINDS["process_computer"]
    before = task.digest
    monkeypatch.setitem(ACTUATION_KINDS._entries, "process_computer", dataclasses.replace(kind, own=lambda controls: warmer))
    assert task.model_copy(update={}).digest != before


# In task files.


def test_a_task_of_schema_1_has_no_computer(tmp_path: Path) -> None:
    path = tmp_path / "one.toml"
    path.write_text('base = "glbench/Schiphol2010-Delta10-v1"\nid = "tests/One-v1"\ntitle = "One"\nactuation.kind = "process_computer"\n')
    with pytest.raises(TaskError, match="needs a task of schema 2"):
        get_task(str(path))


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("heating_band = 2.0", 'value = ..., unit = "K"'),
        ('heating_band = { value = 2.0, unit = "degC" }', 'Its unit is "K"'),
        ('heating_band = { value = 0.0, unit = "K" }', "above 0 K"),
        ('ventilation_band = { value = 30.0, unit = "K" }', "must not be below"),
        ("co2_vents = 0.5", "must be below co2_vents_off"),
        ('heatingband = { value = 2.0, unit = "K" }', "heating_band"),
    ],
)
def test_impossible_settings_are_refused(make_computer: MakeComputer, setting: str, said: str) -> None:
    with pytest.raises(TaskError, match=said):
        make_computer(setting)


def test_settings_without_a_computer_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "two.toml"
    path.write_text(
        'base = "glbench/Schiphol2010-Delta10-v1"\nschema = 2\nid = "tests/Two-v1"\ntitle = "Two"\n'
        '[actuation.process_computer]\ndead_zone = { value = 2.0, unit = "K" }\n'
    )
    with pytest.raises(TaskError, match='the kind is "rate"'):
        get_task(str(path))


def test_a_control_that_the_computer_cannot_work_is_refused(task: TaskSpec) -> None:
    table = task.actuation.model_copy(update={"controls": ("uBoil", "uFan")})
    with pytest.raises(TaskError, match="cannot work 'uFan'"):
        _ = task.model_copy(update={"actuation": table}).actions
    table = task.actuation.model_copy(update={"controls": ("uBlScr",)})
    with pytest.raises(TaskError, match="No set point steers uBlScr"):
        _ = task.model_copy(update={"actuation": table}).actions


def test_the_digest_covers_the_settings_given_and_left_out(make_computer: MakeComputer, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = make_computer(damped=True)
    same = make_computer('heating_band = { value = 2.0, unit = "K" }', damped=True)
    other = make_computer('heating_band = { value = 2.5, unit = "K" }', damped=True)
    assert "process_computer" not in plain.definition()["actuation"]
    assert "process_computer" not in same.definition()["actuation"]
    assert other.definition()["actuation"]["process_computer"] == {"heating_band": 2.5}

    def named(task: TaskSpec) -> str:
        return task.model_copy(update={"id": "tests/Computer-v1"}).digest

    assert named(plain) == named(same) != named(other)
    # what is left out acts as well: another default is another task
    table, before = ProcessComputerTable, named(plain)
    changed = table.model_construct(**(plain.actuation.process_computer.model_dump() | {"co2_band": 150.0}))
    monkeypatch.setattr(table, "__eq__", lambda self, other: True)
    redefined = plain.model_copy(update={"actuation": plain.actuation.model_copy(update={"process_computer": changed})})
    assert redefined.definition() == plain.definition()
    assert named(redefined) != before


@pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))
def test_the_computer_reads_what_the_sensors_show(make_computer: MakeComputer, tmp_path: Path) -> None:
    """A sensor that shows 5 K too much or too little: heat for air that the computer takes to be cold; the same bits either way."""
    path = tmp_path / "sensors.toml"
    path.write_text(
        """
        base = "glbench/Schiphol2010-Delta10-v1"
        schema = 2
        id = "tests/Sensors-v1"
        title = "Sensors"
        weather.days = 1
        actuation.kind = "process_computer"
        [sensors.air_temperature]
        noise = { value = 2.0, unit = "degC" }
        bias = { value = 2.0, unit = "degC" }
        drift = { value = 1.0, unit = "degC" }
        [sensors.dropouts]
        days_between = 1.0
        hours = 2.0
        """,
        encoding="utf-8",
    )
    task, n = get_task(str(path)), 6
    fused, plain = Simulation(task, n, "fast"), Simulation(task, n, "fast", fused=False)
    plain.reset(list(range(n)))
    seen = fused.reset(list(range(n)))[:, 0]
    wanted = np.array([[action.of(WANTED[action.name]) for action in task.actions]] * n)
    for step in range(40):
        heating = fused.memory[:, 1] if step else np.full(n, 18.0)
        reading, before = seen, fused.u[:, 0]
        results = [one.step(wanted) for one in (fused, plain)]
        asked = np.clip((heating - reading) / 2.0, 0.0, 1.0)
        expected = np.clip(asked, np.maximum(before - 0.1, 0.0), before + 0.1)
        assert fused.u[:, 0] == pytest.approx(expected, abs=1e-5)  # readings are observed as float32
        assert bits(fused) == bits(plain)
        seen = results[0].observations[:, 0]
    assert np.abs(seen - fused.air[0]).max() > 0.5


def test_records_and_pages_tell_set_points_by_name_and_unit(task: TaskSpec) -> None:
    columns = next(iter(signals_of(task).groups([action.name for action in task.actions], controls=False))).columns
    assert [column.name for column in columns] == [f"action_{action.name}" for action in task.actions]
    assert [column.unit for column in columns] == [action.unit for action in task.actions]
    (section,) = (one for one in definition_in_words(task) if one.heading == "What the agent does")
    assert [row[1:5] for row in section.rows] == [
        (action.name, action.unit, f"{action.lowest:g}", f"{action.highest:g}") for action in task.actions
    ]


def test_a_record_shows_set_points_in_their_units_and_other_actions_as_they_were_given(task: TaskSpec) -> None:
    names, signals = [action.name for action in task.actions], signals_of(task)
    given = random_set_points(task, 12, 1)[:, 0]
    asked = signals.in_units(given, names)
    assert asked.dtype == np.float64
    for column, action in enumerate(task.actions):
        assert asked[:, column].tobytes() == action.value(given[:, column].astype(np.float64)).tobytes()
    assert np.ptp(asked[:, 0]) > 5.0  # degC
    controls = np.zeros((12, 6), dtype=np.float32)
    assert signals.in_units(controls, task.actuation.controls) is controls
