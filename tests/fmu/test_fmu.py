"""FMUs as an importer runs them: every number is the environment's, every mistake is explained, and units are the catalogue's."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from glbench.env import Simulation, info_quantities
from glbench.errors import GlbenchError, TaskError
from glbench.kernel import StepFailure
from glbench.model import vapour_pressure_deficit
from glbench.model.units import parse_unit, same_unit
from glbench.quantities import GROUPS
from glbench.tasks import get_task
from tests.support import LETTUCE, write_day_task

pytest.importorskip("pythonfmu", reason="PythonFMU is not installed (extra 'fmu')")
fmpy = pytest.importorskip("fmpy", reason="fmpy is not installed")

SPRING, SEED, SPLIT = "glbench/Spring-v1", 12_345_678_901, "validation"


class Instance:
    """One instance of an FMU, whose variables are read and written by name."""

    def __init__(self, file: Path, folder: Path) -> None:
        from fmpy import calloc, fmi2, free

        self.description = fmpy.read_model_description(str(file))
        if not folder.is_dir():
            fmpy.extract(str(file), str(folder))
        self.variables = {one.name: one for one in self.description.modelVariables}
        self.log: list[str] = []
        self.callbacks = fmi2.fmi2CallbackFunctions()
        self.callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(lambda *words: self.log.append(words[-1].decode()))
        self.callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(calloc)
        self.callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(free)
        self.fmu = fmi2.FMU2Slave(
            guid=self.description.guid,
            unzipDirectory=str(folder),
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName="greenhouse",
        )
        self.fmu.instantiate(callbacks=self.callbacks, loggingOn=True)
        self.time = 0.0

    def start(self, begin: float = 0.0, **parameters: Any) -> Instance:
        self.fmu.setupExperiment(startTime=begin)
        for name, value in parameters.items():
            self.set(name, value)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        self.time = begin
        return self

    def set(self, name: str, value: Any) -> None:
        reference = [self.variables[name].valueReference]
        if isinstance(value, str):
            self.fmu.setString(reference, [value])
        else:
            self.fmu.setReal(reference, [value])

    def step(self, seconds: float, *targets: float) -> None:
        inputs = [one.valueReference for one in self.description.modelVariables if one.causality == "input"]
        if targets:
            self.fmu.setReal(inputs, list(targets))
        self.fmu.doStep(self.time, seconds)
        self.time += seconds

    def get(self, prefix: str = "") -> dict[str, float]:
        reals = [one for one in self.variables.values() if one.type == "Real" and one.name.startswith(prefix)]
        return dict(zip((one.name for one in reals), self.fmu.getReal([one.valueReference for one in reals]), strict=True))


Starter = Callable[..., Instance]


@pytest.fixture(scope="module")
def spring(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from glbench.fmu import export_fmu

    file = tmp_path_factory.mktemp("fmu") / "spring.fmu"
    export_fmu(get_task(SPRING), file, seed=SEED, split=SPLIT)
    return file


@pytest.fixture(scope="module")
def day(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a task file that is not there any more."""
    from glbench.fmu import export_fmu

    folder = tmp_path_factory.mktemp("day")
    task = get_task(write_day_task(folder))
    export_fmu(task, folder / "day.fmu")
    (folder / "day.toml").unlink()
    return folder / "day.fmu"


@contextmanager
def running(file: Path, **parameters: Any) -> Iterator[Instance]:
    instance = Instance(file, file.with_suffix("")).start(**parameters)
    yield instance
    instance.fmu.terminate()
    instance.fmu.fmi2FreeInstance(instance.fmu.component)


def largest_difference(numbers: dict[str, float], expected: dict[str, float]) -> float:
    """Relative, over all names of ``expected``."""
    assert numbers.keys() >= expected.keys()
    return max(abs(numbers[name] - value) / max(abs(value), 1.0) for name, value in expected.items())


def test_the_model_description_is_valid(spring: Path, day: Path) -> None:
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(spring)) == []
    assert validate_fmu(str(day)) == []
    description = fmpy.read_model_description(str(spring))
    assert "glbench" in description.generationTool
    slave = description.coSimulation
    assert slave.canGetAndSetFMUstate
    assert slave.canSerializeFMUstate
    assert not slave.canHandleVariableCommunicationStepSize
    assert float(description.defaultExperiment.stepSize) == 900.0
    assert float(description.defaultExperiment.stopTime) == 60 * 86400.0


def test_a_day_gives_the_bits_of_the_environment(spring: Path, capsys: pytest.CaptureFixture[str]) -> None:
    task = get_task(SPRING).in_split(SPLIT)
    env = gymnasium.make(f"glbench:{SPRING}", split=SPLIT).unwrapped
    observation, info = env.reset(seed=SEED)
    columns, capacities = [column.name for column in task.observed()], task.capacities()
    at_one = np.array([capacity.at_one for capacity in capacities])
    generator, summed = np.random.default_rng(1), {}
    worst, targets = 0.0, np.zeros(len(at_one))

    with running(spring) as fmu:
        for step in range(97):
            expected = {name: float(value) for name, value in info.items() if name != "seed"}
            expected |= {f"observed.{name}": float(value) for name, value in zip(columns, observation, strict=True)}
            names = task.model_value.state_names
            expected |= {f"state.{name}": float(value) for name, value in zip(names, env.simulation.x[0], strict=True)}
            names = task.model_value.disturbance_names
            expected |= {f"weather.{name}": float(value) for name, value in zip(names, env.simulation.d[0], strict=True)}
            expected["vapour_pressure_deficit"] = vapour_pressure_deficit(info["air_temperature"], info["relative_humidity"])
            for name in ("epi", "heat", "cost_heat"):
                summed[name] = summed.get(name, 0.0) + expected.get(name, 0.0)
            expected |= {f"total.{name}": value for name, value in summed.items()}
            numbers = fmu.get()
            worst = max(worst, largest_difference(numbers, expected))
            assert worst <= 1e-9, step
            if step == 96:
                break
            if step % 3 == 0:
                targets = generator.random(len(at_one)) * at_one
            action = np.clip((targets / at_one - env.simulation.u[0]) / task.actuation.max_change, -1.0, 1.0)
            observation, reward, *_, info = env.step(action)
            fmu.step(900.0, *targets)
        assert numbers["step_reward"] == reward
        assert numbers["total.heat"] > 0.1
    with capsys.disabled():
        sys.stdout.write(f"\nlargest relative difference to the environment, {len(expected)} numbers, 96 steps: {worst:.3g}\n")


def test_scheduled_controls_are_no_inputs_and_follow_the_calendar(tmp_path: Path) -> None:
    """The screen is half shut from 02:00 to 03:00 of the first day, whatever the inputs are."""
    from glbench.fmu import export_fmu

    task = get_task(write_day_task(tmp_path)).replace(
        {
            "schema": 2,
            "id": "test/Scheduled-v1",
            "actuation.controls": ["uBoil", "uVent"],
            "schedule": [{"control": "uThScr", "value": 0.5, "hours": [2.0, 3.0]}],
        }
    )
    export_fmu(task, tmp_path / "scheduled.fmu")
    with running(tmp_path / "scheduled.fmu") as fmu:
        assert [name for name in fmu.variables if name.startswith("target.")] == ["target.boiler", "target.vents"]
        screen = []
        for _ in range(5):
            fmu.step(3600.0, 50.0, 0.2)
            screen.append(fmu.get()["thermal_screen"])
    assert screen == [0.0, 0.0, 0.5, 0.0, 0.0]


def test_a_long_communication_step_holds_the_inputs_and_adds_up(spring: Path) -> None:
    targets = (80.0, 2.0, 0.3, 0.6, 60.0, 0.0)
    with running(spring) as short, running(spring) as long:
        rows = []
        for _ in range(8):
            short.step(900.0, *targets)
            rows.append(short.get())
        long.step(8 * 900.0, *targets)
        numbers = long.get()
    assert largest_difference(numbers, {name: value for name, value in rows[-1].items() if name.startswith("state.")}) == 0
    assert numbers["total.epi"] == pytest.approx(rows[-1]["total.epi"], rel=1e-12)
    assert numbers["epi"] == pytest.approx(sum(row["epi"] for row in rows), rel=1e-12)
    for name in ("violation_relative_humidity_high", "violation_air_temperature_low"):
        assert numbers[name] == pytest.approx(np.mean([row[name] for row in rows]), rel=1e-12)
    assert max(row["violation_relative_humidity_high"] for row in rows) > 0.0


def test_a_saved_state_continues_with_the_same_bits_also_in_another_instance(spring: Path) -> None:
    targets = (100.0, 1.0, 0.5, 0.2, 30.0, 0.1)
    with running(spring) as one, running(spring, seed=5.0) as other:
        one.step(900.0, *targets)
        state = one.fmu.getFMUState()
        saved, packed = one.get(), one.fmu.serializeFMUState(state)
        one.step(900.0)
        after = one.get()
        assert after != saved
        one.fmu.setFMUState(state)
        assert one.get() == saved
        other.fmu.setFMUState(other.fmu.deserializeFMUState(packed))
        assert other.get() == saved
        one.time = other.time = 900.0
        one.step(900.0)
        other.step(900.0)
        assert one.get() == after
        assert other.get() == after
        one.fmu.freeFMUState(state)


def test_instances_are_independent_and_reset_starts_over(spring: Path) -> None:
    with running(spring) as one, running(spring, seed=5.0, split="training") as other:
        first = one.get()
        assert other.get("weather.") != one.get("weather.")
        training = Simulation(get_task(SPRING).in_split("training"), 1)
        training.reset([5])
        assert list(other.get("state.").values()) == training.x[0].tolist()
        one.step(900.0, *(0.0,) * 6)
        one.fmu.reset()
        assert one.start(begin=86400.0).get() == first
        one.step(900.0)
        other.fmu.reset()
    for _ in range(12):  # PythonFMU 0.7.0 releases what the module of the FMU consists of
        with running(spring) as again:
            assert again.get() == first


REFUSED: dict[str, tuple[Callable[[Instance], None], str]] = {
    "a step that is too short": (lambda fmu: fmu.step(600.0), "is controlled every 3600 s. Set the communication step to 3600 s"),
    "no multiple": (lambda fmu: fmu.step(5400.0), "or to a multiple of it"),
    "a step that is no number": (lambda fmu: fmu.step(np.nan), "A communication step of nan s is not possible"),
    "another time": (
        lambda fmu: fmu.fmu.doStep(7200.0, 3600.0), "A step from 7200 s was asked for, but the greenhouse is at 0 s."
    ),
    "an input out of bounds": (
        lambda fmu: fmu.step(3600.0, 131.0, *(0.0,) * 5), "target.boiler is 131 W m-2, outside its range 0 to 130 W m-2"
    ),
    "an input that is no number": (lambda fmu: fmu.step(3600.0, np.nan, *(0.0,) * 5), "target.boiler is nan W m-2"),
    "beyond the end": (lambda fmu: fmu.step(25 * 3600.0), "24 control steps of 3600 s are left at 0 s"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", REFUSED)
def test_a_step_that_cannot_be_done_is_refused_in_words_and_the_fmu_goes_on(day: Path, mistake: str) -> None:
    make, words = REFUSED[mistake]
    with running(day) as fmu:
        before = fmu.get("state.")
        with pytest.raises(Exception, match="discard"):
            make(fmu)
        assert words in fmu.log[-1]
        assert "Traceback" not in fmu.log[-1]
        assert fmu.get("state.") == before
        fmu.step(24 * 3600.0, *(0.0,) * 6)
        assert fmu.fmu.getBoolean([fmu.variables["ended"].valueReference]) == [True]
        with pytest.raises(Exception, match="discard"):
            fmu.step(3600.0)
        assert "0 control steps of 3600 s are left at 86400 s" in fmu.log[-1]


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"split": "test"}, "test seasons of glbench/Spring-v1 score agents and are not exported"),
        ({"split": "validaton"}, "Did you mean 'validation'?"),
        ({"seed": 1.5}, "The seed 1.5 is not a whole number"),
    ],
)
def test_a_season_that_is_not_exported_is_refused_in_words(spring: Path, parameters: dict[str, Any], words: str) -> None:
    fmu = Instance(spring, spring.with_suffix(""))
    with pytest.raises(Exception, match="fatal"):
        fmu.start(**parameters)
    assert words in fmu.log[-1]
    fmu.fmu.fmi2FreeInstance(fmu.fmu.component)  # PythonFMU 0.7.0 releases it a second time here


def test_a_seed_is_fixed_once_the_season_runs(day: Path) -> None:
    fmu = Instance(day, day.with_suffix("")).start(seed=5.0)
    fmu.set("seed", 5.0)
    with pytest.raises(Exception, match="fatal"):
        fmu.set("seed", 6.0)
    assert "The parameter seed cannot change in a running season." in fmu.log[-1]


def test_exports_are_refused_before_anything_is_written(tmp_path: Path) -> None:
    from glbench.fmu import export_fmu

    task, file = get_task(SPRING), tmp_path / "greenhouse.fmu"
    paper = get_task("glbench/Schiphol2010-Delta00-v1")
    for spec, options, words in [
        (task, {"split": "test"}, "not exported"),
        (task, {"seed": -1}, "not a whole number"),
        (get_task("glbench/Transfer-Greensboro-v1"), {}, "has only test seasons"),
        (paper, {"seed": 666}, "the seed 666 is not exported"),
        (paper, {"split": "validation"}, "has no splits"),
    ]:
        with pytest.raises(TaskError, match=words):
            export_fmu(spec, file, **options)
    with pytest.raises(GlbenchError, match=r"should end with \.fmu"):
        export_fmu(task, tmp_path / "greenhouse.zip")
    file.write_bytes(b"precious")
    with pytest.raises(GlbenchError, match="exists already"):
        export_fmu(task, file)
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"precious"]


def test_the_id_of_a_task_may_begin_with_a_digit(tmp_path: Path) -> None:
    from glbench.fmu import export_fmu

    (tmp_path / "4ha.toml").write_text(f'base = "{SPRING}"\nid = "mylab/4ha-v1"\ntitle = "Our 4 ha"\n', encoding="utf-8")
    export_fmu(get_task(tmp_path / "4ha.toml"), tmp_path / "4ha.fmu")
    assert fmpy.read_model_description(str(tmp_path / "4ha.fmu")).modelName == "_4ha_v1"


def test_units_are_those_of_the_task_and_the_catalogue(spring: Path) -> None:
    task, description = get_task(SPRING), fmpy.read_model_description(str(spring))
    units = {one.name: (one.unit or "-").replace(".", " ") for one in description.modelVariables if one.type == "Real"}
    for quantity in info_quantities(task)[1:]:
        assert same_unit(units[quantity.name], quantity.unit), quantity
    for column in task.observed():
        assert same_unit(units[f"observed.{column.name}"], column.unit), column
    for state in task.model_value.states:
        assert same_unit(units[f"state.{state.name}"], state.unit), state
    entries = {name: entry for group in ("air", "deficit", "clock", "step") for name, entry in GROUPS[group].items()}
    shared = units.keys() & entries.keys() - {"penalty"}  # of which the unit depends on the task
    assert len(shared) >= 6
    for name in shared:
        assert same_unit(units[name], entries[name].unit), name
    assert same_unit(units["target.lamps"], "W m-2")
    bases = {one.name: one.baseUnit for one in description.unitDefinitions}
    assert (bases["kWh.m-2"].factor, bases["kWh.m-2"].kg, bases["kWh.m-2"].s, bases["kWh.m-2"].m) == (3.6e6, 1, -2, 0)
    assert (bases["degC"].K, bases["degC"].factor, bases["degC"].offset) == (1, 1.0, 273.15)
    assert (bases["mg.m-2.s-1"].kg, bases["mg.m-2.s-1"].factor) == (1, 1e-6)
    assert (bases["degC.day"].K, bases["degC.day"].s, bases["degC.day"].factor, bases["degC.day"].offset) == (1, 1, 86400.0, 0)
    assert bases["EUR.m-2"] is None
    assert {symbol for name in bases for symbol in parse_unit(name.replace(".", " "))} >= {"EUR", "kWh", "°C", "ppm", "%"}


@pytest.mark.parametrize("name", ["FullSeasonEnergy-v1", "SpringSetpoints-v1", "lettuce", "vents first"])
def test_other_models_and_kinds_of_actuation_have_their_own_variables(name: str, tmp_path: Path) -> None:
    """Without a file: what PythonFMU would run, called as it calls it."""
    from glbench.fmu.scenario import FmuSetup
    from glbench.fmu.slave import GreenhouseSlave

    if name == "lettuce":
        (tmp_path / "salad.toml").write_text(LETTUCE, encoding="utf-8")
        task = get_task(tmp_path / "salad.toml")
    elif name == "vents first":
        task = get_task(SPRING).replace({"actuation.controls": ["uVent", "uBoil", "uLamp"]})
    else:
        task = get_task(name)
    split = "" if task.splits is None else SPLIT
    own = name in ("lettuce", "vents first")

    class Slave(GreenhouseSlave):
        setup = FmuSetup(task.id, task.digest, json.dumps(task.attachment()) if own else "", 3, split, "0")

    slave = Slave(instance_name="one", resources="")
    assert slave.to_xml().find("UnitDefinitions") is not None
    slave.setup_experiment(0.0, None, None)
    slave.exit_initialization_mode()
    references = {variable.name: reference for reference, variable in slave.vars.items()}
    simulation = Simulation(task.in_split(split) if split else task, 1)
    simulation.reset([3])
    shares = np.arange(1, len(task.actions) + 1) / (len(task.actions) + 1)
    if task.actuation.kind == "process_computer":
        actions = np.array([one.low + share * (one.high - one.low) for one, share in zip(task.actions, shares, strict=True)])
        targets = {one.name: one.value(action) for one, action in zip(task.actions, actions, strict=True)}
    else:
        actions, capacities = shares, {one.name: one for one in task.capacities()}
        controls = [capacities[control] for control in task.actuation.controls]
        targets = {one.quantity: one.at_one * task.actuation.max_change * share for one, share in zip(controls, shares, strict=True)}
    slave.set_real([references[f"target.{target}"] for target in targets], list(targets.values()))
    assert not slave.do_step(float("nan"), task.step_seconds)
    assert slave.do_step(0.0, task.step_seconds), slave.log_queue[-1].msg
    result = simulation.step(actions[None])
    values = {variable.name: variable.getter() for variable in slave.vars.values()}
    assert [values[f"state.{state}"] for state in task.model_value.state_names] == pytest.approx(simulation.x[0], rel=1e-9)
    assert values["step_reward"] == pytest.approx(result.rewards[0], rel=1e-9)
    assert simulation.u[0].any()


@pytest.mark.parametrize(("target", "day"), [(None, None), (0.49, None), (0.5, 2), (1.0, 2)])
def test_a_crew_comes_when_it_is_wanted_and_the_plants_are_old_enough(target: float | None, day: int | None, tmp_path: Path) -> None:
    from glbench.fmu.scenario import FmuSetup
    from glbench.fmu.slave import GreenhouseSlave

    task = get_task("LettuceHarvest-v1").replace({"actuation.on_off.uHarvest.due.first": 2.0, "actuation.on_off.uHarvest.due.last": 60.0})

    class Slave(GreenhouseSlave):
        setup = FmuSetup(task.id, task.digest, json.dumps(task.attachment()), 3, "validation", "0")

    slave = Slave(instance_name="one", resources="")
    slave.exit_initialization_mode()
    variables = {variable.name: variable for variable in slave.vars.values()}
    assert "off below 0.5, else 1 or more" in variables["target.harvest"].description
    if target is not None:
        slave.set_real([reference for reference, one in slave.vars.items() if one.name == "target.harvest"], [target])
    at_work = []
    for quarter in range(4 * 96):
        assert slave.do_step(quarter * 900.0, 900.0), slave.log_queue[-1].msg
        at_work.append(variables["control.harvest"].getter() if "control.harvest" in variables else variables["harvest"].getter())
    assert at_work.count(1.0) == (0 if day is None else 96)
    assert day is None or at_work.index(1.0) == day * 96


def test_a_control_step_that_cannot_be_computed_ends_the_season_as_in_the_environment(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    from glbench.fmu import slave
    from glbench.fmu.scenario import FmuSetup

    class FailsInTheThirdStep:
        calls = 0

        def try_step(self, x: Any, u: Any, d: Any, p: Any) -> tuple[Any, list[StepFailure]]:
            self.calls += 1
            return x.copy(), [StepFailure(0, "The air caught fire.")] if self.calls == 3 else []

    monkeypatch.setattr(slave, "Simulation", lambda task, n: Simulation(task, n, FailsInTheThirdStep()))
    task = get_task(SPRING)

    class Slave(slave.GreenhouseSlave):
        setup = FmuSetup(task.id, task.digest, "", 3, SPLIT, "0")

    one = Slave(instance_name="one", resources="")
    one.exit_initialization_mode()
    assert one.do_step(0.0, 4 * 900.0)
    values = {variable.name: variable.getter() for variable in one.vars.values()}
    assert values["ended"] is True
    assert values["step"] == 2
    assert values["step_reward"] == values["total.reward"] < task.evaluation.failed_step.reward + 1e-9
    assert "could not be computed. The air caught fire." in one.log_queue[-1].msg
    assert one.log_queue[-1].msg in caplog.text
    assert not one.do_step(3600.0, 900.0)
    assert "0 control steps of 900 s are left at 1800 s" in one.log_queue[-1].msg


def test_another_task_of_the_same_name_is_refused() -> None:
    from glbench.fmu.scenario import FmuSetup

    with pytest.raises(TaskError, match="has the digest"):
        FmuSetup(SPRING, "0" * 64, "", 1, SPLIT, "0.0.9").find_task()


def test_an_importer_without_glbench_is_told_what_to_install(spring: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    fmpy.extract(str(spring), str(tmp_path))
    (program,) = (tmp_path / "resources").glob("Spring_v1_*.py")
    monkeypatch.setitem(sys.modules, "glbench.fmu.slave", None)
    names: dict[str, Any] = {"__name__": "program"}
    exec(compile(program.read_text(encoding="utf-8"), str(program), "exec"), names)
    with pytest.raises(RuntimeError, match=r"needs glbench \d.* Install it there"):
        names["Spring_v1"](instance_name="one")
