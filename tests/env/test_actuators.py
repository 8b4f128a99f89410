"""Actuators that lag, stick, fail and fall short: against the formulas written anew, against the sizes stated, and hidden from agents."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.env import Simulation, Snapshot
from glbench.env.actuation import register_actuation
from glbench.env.random import uniforms
from glbench.env.uncertainty import stream_key
from glbench.errors import ActionError, TaskError
from glbench.report.task_words import definition_in_words, for_growers
from glbench.tasks import TaskSpec, get_task
from glbench.weather import COLUMNS
from tests.env.spring import MODULES, SENSORS, spring
from tests.env.stepping import StillKernel, walk

Floats = NDArray[np.float64]

ACTUATORS = """
[actuators.uVent]
lag_minutes = 10.0
sticks = { days_between = 0.5, hours = 2.0 }
wind = { above = { value = 3.0, unit = "m s-1" }, full = { value = 7.0, unit = "m s-1" }, share = 0.2 }
[actuators.uBoil]
fails = { days_between = 1.0, hours = 3.0 }
[actuators.uThScr]
shortfall = 0.1
[actuators.uCo2]
lag_minutes = 2.0
shortfall = 0.4
sticks = { days_between = 1.0, hours = 1.0 }
fails = { days_between = 1.0, hours = 1.0 }
"""
SHOWN = f'[observation]\nmodules = [{MODULES}, "control_fractions"]\n'
NAMES = ("uBoil", "uCo2", "uThScr", "uVent", "uLamp", "uBlScr")
SEEDS = (700, 3, 2**64 - 1, 12, 13)
STEPS = 200


def of(path: Path, actuators: str = ACTUATORS, sensors: str = SENSORS, **changes: Any) -> TaskSpec:
    return spring(path, sensors=sensors + actuators, **{"observation": SHOWN} | changes)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("actuators")


@pytest.fixture(scope="module")
def task(folder: Path) -> TaskSpec:
    return of(folder / "all.toml")


def course(
    task: TaskSpec, given: NDArray[Any], seeds: tuple[int, ...] = SEEDS, *, kernel: Any = "fast", direct: bool = False, **options: Any
) -> dict[str, NDArray[Any]]:
    """What is told and delivered, observed, counted and remembered in every step with actions, or with controls given directly."""
    simulation = Simulation(task, len(seeds), kernel, **options)
    simulation.reset(list(seeds))
    rows: list[dict[str, Any]] = []
    for values in given:
        acting = simulation.d.copy()
        result = simulation.step_controls(values) if direct else simulation.step(values)
        rows.append(
            {
                "u": simulation.u,
                "commands": simulation.commands,
                "shown": result.observations,
                "table": result.table,
                "memory": simulation.memory,
                "d": acting,
                "info": simulation.info_columns,
            }
        )
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def told(commands: Floats, wind: Floats, task: TaskSpec, seed: int) -> Floats:
    """What the actuators of ``ACTUATORS`` deliver of commands ``(steps, 6)`` in the run with ``seed``, number by number."""

    def drawn(stream: str, step: int, count: int) -> Floats:
        return uniforms(np.array([stream_key(task.scenario, seed, stream)], np.uint64), np.array([[step]]), count)[0, 0]

    # Numbers and traits are in the order of the task's controls: uBoil, uCo2, uThScr, uVent.
    kept = 1.0 - drawn("actuator shortfalls", 0, 2) * [0.4, 0.1]
    begins, lasts = 0.25 / 24.0 / np.array([1.0, 1.0, 1.0, 0.5]), 1.0 - 0.25 / np.array([3.0, 1.0, 1.0, 2.0])
    faults = np.zeros(4, bool)  # boiler fails, CO2 sticks, CO2 fails, vents stick
    delivered, now = commands.copy(), np.zeros(6)
    for k, command in enumerate(commands):
        faults = drawn("actuators", k, 4) < np.where(faults, lasts, begins)
        boil_fails, co2_sticks, co2_fails, vent_sticks = faults
        new = command.copy()
        new[0] = 0.0 if boil_fails else command[0]
        co2 = now[1] if co2_sticks else now[1] + (1.0 - np.exp(-15.0 / 2.0)) * (kept[0] * command[1] - now[1])
        new[1] = 0.0 if co2_fails else co2
        new[2] = kept[1] * command[2]
        most = 1.0 - 0.8 * min(max((wind[k] - 3.0) / 4.0, 0.0), 1.0)
        new[3] = now[3] if vent_sticks else now[3] + (1.0 - np.exp(-15.0 / 10.0)) * (most * command[3] - now[3])
        delivered[k] = now = new
    return delivered


def test_what_is_delivered_is_the_formula_number_by_number(task: TaskSpec) -> None:
    assert task.model_value.control_names == NAMES
    found = course(task, walk(1, STEPS, len(SEEDS)), kernel=StillKernel())
    for row, seed in enumerate(SEEDS):
        wanted = told(found["commands"][:, row], found["d"][:, row, COLUMNS.index("wind")], task, seed)
        np.testing.assert_allclose(found["u"][:, row], wanted, atol=1e-12)
    assert (found["u"] != found["commands"]).any(axis=(0, 1)).tolist() == [True] * 4 + [False] * 2
    assert ((found["u"] >= 0.0) & (found["u"] <= 1.0)).all()


@pytest.mark.parametrize("direct", [False, True])
def test_bits_are_the_same_compiled_with_numpy_alone_and_in_any_batch(task: TaskSpec, direct: bool) -> None:
    given = walk(2, STEPS, len(SEEDS)).astype(np.float64)
    given = np.abs(given) if direct else given
    whole, numpy_steps = (course(task, given, direct=direct, fused=fused) for fused in (True, False))
    for name, values in whole.items():
        assert values.tobytes() == numpy_steps[name].tobytes(), name
    for row in (0, 3):
        alone = course(task, given[:, [row]], (SEEDS[row],), direct=direct)
        for name in ("u", "commands", "shown", "memory"):
            assert alone[name].tobytes() == np.ascontiguousarray(whole[name][:, [row]]).tobytes(), name


def test_commands_given_directly_meet_the_same_faults_as_actions_that_ask_for_them(task: TaskSpec) -> None:
    free = task.replace({"id": "tests/Free-v1", "actuation.kind": "set_point", "actuation.max_change": 1.0})
    given = np.abs(walk(3, STEPS, len(SEEDS))).astype(np.float64)
    by_action, directly = course(free, given), course(free, given, direct=True)
    for name, values in by_action.items():
        assert values.tobytes() == directly[name].tobytes(), name
    np.testing.assert_array_equal(by_action["commands"], given)


def test_controls_that_are_refused_change_nothing(task: TaskSpec) -> None:
    simulation = Simulation(task, 2, "fast")
    simulation.reset([1, 2])
    simulation.step_controls(np.full((2, 6), 0.5))
    before = simulation.snapshot().to_bytes()
    for wrong in (1.5, np.nan):
        with pytest.raises(ActionError, match="nothing was simulated"):
            simulation.step_controls(np.full((2, 6), wrong))
        assert simulation.snapshot().to_bytes() == before


def test_an_agent_sees_what_it_told_and_nothing_of_a_fault(task: TaskSpec, folder: Path) -> None:
    """With the greenhouse standing still, nothing that is observed depends on what is delivered."""
    ideal = of(folder / "ideal.toml", "")
    given = walk(4, STEPS, len(SEEDS))
    found, without = course(task, given, kernel=StillKernel()), course(ideal, given, kernel=StillKernel())
    assert found["shown"].tobytes() == without["shown"].tobytes()
    assert found["commands"].tobytes() == without["u"].tobytes() == without["commands"].tobytes()
    np.testing.assert_allclose(found["shown"][:, :, -6:], found["commands"], rtol=1e-6)
    assert np.abs(found["u"] - found["commands"]).max() > 0.5


def test_what_is_delivered_is_stepped_charged_and_recorded(task: TaskSpec) -> None:
    kernel = StillKernel()
    found = course(task, walk(5, STEPS, len(SEEDS)), kernel=kernel)
    np.testing.assert_array_equal(found["u"], [u for _, u, _, _ in kernel.calls])
    at_one = [capacity.at_one for capacity in task.capacities()]
    np.testing.assert_allclose(found["info"][:, -6:].transpose(0, 2, 1), found["u"] * at_one)
    heat = [quantity.name for quantity in task.quantities].index("heat")
    boiling = found["u"][:, :, 0] > 0.0
    assert ((found["table"][:, heat] > 0.0) == boiling).all()
    assert not boiling.all()
    assert (found["commands"][:, :, 0][~boiling] > 0.0).any()


def test_a_lag_is_the_exact_solution_at_the_end_of_each_step(folder: Path) -> None:
    lagging = of(folder / "lag.toml", "[actuators.uVent]\nlag_minutes = 20.0\n")
    found = course(lagging, np.ones((8, 1, 6)), (1,), kernel=StillKernel(), direct=True)
    minutes = 15.0 * np.arange(1, 9)
    np.testing.assert_allclose(found["u"][:, 0, 3], 1.0 - np.exp(-minutes / 20.0), rtol=1e-12)
    np.testing.assert_array_equal(found["u"][:, 0, [0, 1, 2, 4, 5]], 1.0)


def test_faults_come_as_often_and_stay_as_long_as_stated_independently(folder: Path) -> None:
    both = "fails = { days_between = 2.0, hours = 4.0 }\n"
    failing = of(folder / "fails.toml", f"[actuators.uBoil]\n{both}[actuators.uCo2]\n{both}", days=10)
    seeds, steps = list(range(250)), 300
    simulation = Simulation(failing, len(seeds), StillKernel())
    simulation.reset(seeds)
    failed = np.empty((steps, len(seeds), 2), bool)
    for k in range(steps):
        simulation.step_controls(np.full((len(seeds), 6), 0.5))
        failed[k] = simulation.u[:, :2] == 0.0
    for faults in failed.transpose(2, 0, 1):
        begins = (faults[1:] & ~faults[:-1]).sum()
        assert begins / (~faults[:-1]).sum() * 2.0 * 96 == pytest.approx(1.0, rel=0.1)
        assert faults[1:].sum() / begins * 0.25 == pytest.approx(4.0, rel=0.1)
        assert faults[0].mean() == pytest.approx(1.0 / 192.0, abs=0.012)
    assert abs(np.corrcoef(failed[..., 0].ravel(), failed[..., 1].ravel())[0, 1]) < 0.02


def test_a_shortfall_is_drawn_evenly_and_kept_for_the_run(folder: Path) -> None:
    short = of(folder / "short.toml", "[actuators.uThScr]\nshortfall = 0.2\n")
    seeds = tuple(range(1000))
    closed = course(short, np.ones((5, len(seeds), 6)), seeds, kernel=StillKernel(), direct=True)["u"][:, :, 2]
    assert (closed == closed[0]).all()
    assert np.quantile(1.0 - closed[0], [0.0, 0.25, 0.5, 0.75, 1.0]) == pytest.approx([0.0, 0.05, 0.1, 0.15, 0.2], abs=0.012)


def test_a_snapshot_and_a_copy_continue_in_the_middle_of_faults(task: TaskSpec) -> None:
    given = walk(6, 80, 3)
    simulation = Simulation(task, 3, "fast")
    simulation.reset([1, 2, 3])
    for values in given[:40]:
        simulation.step(values)
    other = Simulation(task, 3, "fast", fused=False)
    other.restore(Snapshot.from_bytes(simulation.snapshot().to_bytes()))
    third = copy.deepcopy(simulation)
    for values in given[40:]:
        results = [one.step(values).observations.tobytes() for one in (simulation, other, third)]
        assert len(set(results)) == 1
    assert simulation.u.tobytes() == other.u.tobytes() == third.u.tobytes()
    assert simulation.commands.tobytes() == other.commands.tobytes()


def test_the_door_for_jax_has_the_same_bits(task: TaskSpec) -> None:
    jax = pytest.importorskip("jax", reason="JAX is not installed (extra 'jax')")
    from glbench.jax import Environment, Params

    given, rows = walk(7, 60, 2), Params(np.arange(2), np.ones(2, np.int64))
    wanted, environment = course(task, given, SEEDS[:2]), Environment(task, seeds=list(SEEDS[:2]))
    keys = jax.random.split(jax.random.key(0), 2)
    _, state = jax.jit(jax.vmap(environment.reset))(keys, rows)
    step = jax.jit(jax.vmap(environment.step))
    for k, actions in enumerate(given):
        observed, state, *_ = step(keys, state, actions)
        assert np.asarray(observed).tobytes() == wanted["shown"][k].tobytes()
        assert environment.unpack(state)[1].tobytes() == wanted["u"][k].tobytes()


def test_a_process_computer_works_from_its_own_commands(folder: Path) -> None:
    """Vents that never move do not keep its position for them from moving on, as far as it may in a step."""
    stuck = "[actuators.uVent]\nsticks = { days_between = 0.0001, hours = 240.0 }\n"
    computer = {"kind": "process_computer", "max_change": 0.2, "process_computer": {"vent_time": {"value": 0.0, "unit": "h"}}}
    shut = of(folder / "stuck.toml", stuck).replace({"id": "tests/Stuck-v1", "actuation": computer})
    coldest = np.full((6, 1, len(shut.actions)), -1.0)
    found = course(shut, coldest, (1,))
    assert found["u"][:, 0, 3].tolist() == [0.0] * 6
    assert np.diff(found["commands"][:, 0, 3], prepend=0.0)[:2].tolist() == pytest.approx([0.2, 0.2])


def test_published_tasks_and_tasks_without_the_table_keep_program_and_digest(folder: Path) -> None:
    plain = get_task("Spring-v1")
    simulation = Simulation(plain, 1)
    simulation.reset([1])
    assert not simulation.scenarios.actuators.actuators
    assert simulation.memory.shape[1] == simulation.scenarios.memory_layout.width
    digests = [of(folder / f"{number}.toml", text).digest for number, text in enumerate(("", ACTUATORS, ACTUATORS.replace("0.4", "0.5")))]
    assert len(set(digests)) == 3


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("[actuators.uVents]\nlag_minutes = 1.0\n", r"a control that the task does not grant.*uVent"),
        ("[actuators.uVent]\nlag = 1.0\n", "'lag' is not a key"),
        ("[actuators.uVent]\nlag_minutes = -1.0\n", "a number of minutes, 0 to 240"),
        ("[actuators.uVent]\nshortfall = 1.0\n", "a fraction from 0 to below 1"),
        ("[actuators.uVent]\nfails = { days_between = 1.0 }\n", "lacks the key 'hours'"),
        ("[actuators.uVent]\nwind = { above = 12.0, full = 16.0 }\n", "Write it with its unit"),
        (
            '[actuators.uVent]\nwind = { above = { value = 9.0, unit = "m s-1" }, full = { value = 9.0, unit = "m s-1" } }\n',
            "must be higher than above",
        ),
    ],
)
def test_what_cannot_be_is_refused_in_words(folder: Path, table: str, words: str) -> None:
    with pytest.raises(TaskError, match=words):
        of(folder / "wrong.toml", table)


def test_machines_that_are_switched_can_fail_but_not_lag(folder: Path) -> None:
    fails = "[actuators.uBoil]\nfails = { days_between = 1.0, hours = 3.0 }\n"
    engine = {"id": "tests/Engine-v1", "actuation.on_off": {"uBoil": {"lowest": 0.3}}}
    task = of(folder / "machine.toml", fails).replace(engine)
    loads = course(task, np.ones((96, 4, 6)), SEEDS[:4], kernel=StillKernel())
    assert set(np.unique(loads["u"][..., 0] == 0.0)) == {True, False}
    assert (loads["commands"][..., 0] >= 0.3)[4:].all()
    with pytest.raises(TaskError, match="is off or on"):
        task.replace({"id": "tests/Lagging-v1", "actuators.uBoil.lag_minutes": 5.0})


def test_a_registered_kind_of_actuation_is_refused(task: TaskSpec) -> None:
    register_actuation("direct_for_actuators", "the action is the control", lambda task: lambda controls, actions: actions)
    with pytest.raises(TaskError, match="kinds of actuation that glbench ships"):
        Simulation(task.replace({"id": "tests/Registered-v1", "actuation.kind": "direct_for_actuators"}), 1)


def test_the_card_says_it_in_words(task: TaskSpec) -> None:
    for words in (definition_in_words, for_growers):
        section = next(section for section in words(task) if section.heading.startswith("Actuators"))
        assert len(section.lines) == 4
        assert "lag of 10 minutes; stays where it is every 0.5 days for 2 h" in " ".join(section.lines)
