"""A task as a program: everything around the kernel's step, recorded as tapes from the formulas of the task's parts.

Every part that glbench ships can be recorded. A registered part is Python: the program leaves a gap for it, which only
``glbench.env.numpy_environments`` can fill. The same holds where parameters follow from drawn ones by more than arithmetic.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any, Literal, cast

import numpy as np

from glbench.arrays import Floats
from glbench.env import actuation
from glbench.env.accounts import REWARD, ByName, make_accounts
from glbench.env.air import AIR, air_quantities
from glbench.env.daily_sums import DAILY_SUMS, daily_sum
from glbench.env.numpy_environments import NO_PARTS, PythonParts
from glbench.env.observations import Locked, Numbers, checked_part, column_sources, python_part
from glbench.env.process_computer import Measured
from glbench.env.rewards import REWARDS, StepOutcome, make_reward
from glbench.env.scenario import RunScenarios
from glbench.env.uncertainty import DISTRIBUTIONS, UNIFORM, DerivedParameters
from glbench.env.weather_pool import CLOCK, WeatherPool, WeatherTables
from glbench.errors import TaskError, refuse
from glbench.kernel.environment import Lookup, ParameterNoise, Program
from glbench.kernel.tape import EMPTY, Recorder, RecordingError, Tape, with_simplification
from glbench.model import Air, ObservedColumn, humidity_deficit
from glbench.tasks import TaskSpec
from glbench.tasks.ledger import TRAVEL
from glbench.tasks.quantities import CAMERA


def air_columns(task: TaskSpec) -> slice:
    """Columns of the table with the air inside: after steps taken, hour of day and day of year."""
    first = 1 + len(CLOCK)
    return slice(first, first + (len(AIR) if task.model_value.air else 0))


def info_columns(task: TaskSpec) -> int:
    """How many columns the table has before the quantities of the step: those before, the air, the controls in physical units."""
    first: int = air_columns(task).stop
    return first + len(task.model_value.control_names)


def make_program(task: TaskSpec) -> tuple[Program, PythonParts]:
    """The program of a task, and what fills the gaps in it: ``NO_PARTS`` when there are none."""
    recorded = (
        actuation.recorded_actuation(task) is not None
        and all(REWARDS.recorded(name) for name in task.reward.modules)
        and all(python_part(name) is None for name in task.observation.modules)
        and all(group.distribution == UNIFORM for group in task.scenario.groups)
    )
    return _shipped(task)[0] if recorded else _program(task, RunScenarios(task))


def record_quantities(task: TaskSpec) -> Tape | None:
    """The air and the quantities of a step, to the columns of the table that they have in the program; ``None`` where the reward is Python.

    Unlike the program this needs no weather.
    """
    with Recorder() as recorder:
        controls, air = _controls(task, recorder), _true_air(task, recorder)
        quantities, reward = _quantities(task, recorder, controls, air)
        if reward is not None:
            return None
        for first, values in ((air_columns(task).start, air), (info_columns(task), quantities)):
            for column, value in enumerate(values, first):
                recorder.output("table", column, value)
    return recorder.tape()


def calendar_columns(task: TaskSpec) -> int:
    """Columns of a run's calendar: the clock, then its price tables, then its scheduled controls (``actuation.run_calendar``)."""
    return len(CLOCK) + len(task.price_tables) + len(task.scheduled_places)


@lru_cache(maxsize=8)
def _shipped(task: TaskSpec) -> tuple[tuple[Program, PythonParts], WeatherPool]:
    """With the pool that the program reads: as long as the program is cached, the task has no other pool."""
    scenarios = RunScenarios(task)
    return _program(task, scenarios), scenarios.pool


def _program(task: TaskSpec, scenarios: RunScenarios) -> tuple[Program, PythonParts]:
    charge = task.evaluation.failed_step
    charges = {"reward": charge.reward, "epi": charge.epi, "penalty": charge.penalty}
    info, names = info_columns(task), [quantity.name for quantity in task.quantities]
    with Recorder() as update:
        scenarios.sensors.update(update, _true_air(task, update), scenarios.memory_layout)
        scenarios.samples.update(update, scenarios.memory_layout)
        if scenarios.camera is not None:
            scenarios.camera.update(update, scenarios.memory_layout)
        outcome, lookups, columns, reward, observation = _outcome(task, scenarios, update)
    followers, python_followers = EMPTY, None
    if scenarios.in_step:
        derived = DerivedParameters(task.model_value, scenarios.nominal, scenarios.places(scenarios.in_step))
        try:
            followers = derived.tape(others=scenarios.places(scenarios.in_episode))
        except RecordingError:  # a formula needs more than arithmetic
            python_followers = derived
    kind = actuation.recorded_actuation(task)
    distributions = [group.distribution for group in scenarios.in_step]
    program = Program(
        actuation=_actuation(task, kind, scenarios),
        outcome=outcome,
        actions=actuation.ActionReader.of_task(task).bounds,
        controls=actuation.ActionReader.of_controls(task).bounds,
        steps=task.steps,
        weather=scenarios.pool.values,
        day=scenarios.pool.day,
        days=scenarios.pool.days,
        calendar=scenarios.pool.calendar,
        lag=1 if task.observation.timing == "published" else 0,
        nominal=scenarios.nominal,
        own_parameters=bool(scenarios.in_episode),
        parameter_noise=tuple(
            ParameterNoise(
                np.array(scenarios.places((group,)), dtype=np.int32), group.half_width, scenarios.pool.day if group.redraw == "day" else 1
            )
            for group in scenarios.in_step
        ),
        followers=followers,
        update=update.tape(),
        streams=tuple(part.numbers for part in scenarios.drawing_parts if part.numbers),
        traits=sum(part.trait_count for part in scenarios.drawing_parts),
        memory=scenarios.memory_layout.width,
        lookups=lookups,
        columns=columns,
        width=info + len(names),
        info_columns=info,
        charges={info + names.index(name): value for name, value in charges.items()},
    )
    python = (kind is None, reward, observation, python_followers, any(name != UNIFORM for name in distributions))
    if not any(python):
        return program, NO_PARTS
    parts = PythonParts(
        air_columns(task),
        actuation.make_actuation(task) if kind is None else None,
        reward,
        observation,
        tuple(DISTRIBUTIONS[name] for name in distributions),
        python_followers,
    )
    return program, parts


def _actuation(task: TaskSpec, kind: actuation.RecordedActuation | None, scenarios: RunScenarios) -> Tape:
    """Of a kind that is Python, the schedule alone."""
    names, places = task.model_value.control_names, scenarios.memory_layout.of(actuation.PART)
    with Recorder() as recorder:
        schedule = actuation.scheduled_controls(task, recorder.input)
        if kind is None:
            for name, value in schedule.items():
                recorder.output("controls", names.index(name), value)
            return recorder.tape()
        actions = {action.name: recorder.input("given", place) for place, action in enumerate(task.actions)}
        commands = scenarios.actuators.commands(recorder, _controls(task, recorder), scenarios.memory_layout)
        controls = {name: commands[names.index(name)] for name in task.actuation.controls}
        memory = {name: recorder.input("memory", place) for name, place in places.items()}
        measured, air = None, _true_air(task, recorder, "before")
        if air:  # as the sensors show it
            temperature, co2, humidity = scenarios.sensors.readings(recorder, air, scenarios.memory_layout)
            weather = scenarios.outdoor_sensors.readings(recorder)
            radiation, outside, wind = (weather[name] for name in ("global_radiation", "outdoor_temperature", "wind_speed"))
            hour = recorder.input("calendar", CLOCK.index("hour_of_day"))
            deficit = with_simplification(humidity_deficit, temperature, humidity)
            measured = Measured(temperature, co2, deficit, radiation, outside, wind, hour)
        due = {name: recorder.input("before", place) for name, place in task.due_places.items()}
        next_controls, next_memory = kind.work(task, actuation.ActuationInputs(actions, controls, memory, measured, due))
        for index, name in enumerate(names):
            if name not in task.actuators:
                recorder.output("controls", index, next_controls.get(name, schedule.get(name, 0.0)))
        scenarios.actuators.record(recorder, next_controls, scenarios.memory_layout, scenarios.actuator_draws)
        for name, value in next_memory.items():
            recorder.output("memory", places[name], value)
    return recorder.tape()


def _controls(task: TaskSpec, recorder: Recorder) -> list[Any]:
    """Controls in force, all of the model's: what actuators deliver."""
    return [recorder.input("controls", index) for index in range(len(task.model_value.control_names))]


def _true_air(task: TaskSpec, recorder: Recorder, moment: Literal["before", "after"] = "after") -> list[Any]:
    """Air temperature [degC], CO2 [ppm] and relative humidity [%] before or after the step; nothing of a model without an air."""
    model = task.model_value
    if not model.air:
        return []
    return list(air_quantities(*model.air_of(*(recorder.input(moment, model.state_index(name)) for name in model.air))))


def _outcome(task: TaskSpec, scenarios: RunScenarios, update: Recorder) -> tuple[Tape, tuple[Lookup, ...], int, Any, Any]:
    """The tape after the step, the lookups, the number of observed columns, and the reward and observations that are Python.

    What the observation keeps for the next step is recorded in ``update``.
    """
    with Recorder() as recorder:
        air = _true_air(task, recorder)
        controls = _controls(task, recorder)
        commands = scenarios.actuators.commands(recorder, controls, scenarios.memory_layout)
        delivered = [control * capacity.at_one for control, capacity in zip(controls, task.capacities(), strict=True)]
        quantities, reward = _quantities(task, recorder, controls, air)
        rows = [recorder.input("counter", 0), *(recorder.input("calendar", index) for index in range(len(CLOCK))), *air, *delivered]
        for column, value in enumerate([*rows, *quantities]):
            recorder.output("table", column, value)
        measured = scenarios.sensors.readings(recorder, air, scenarios.memory_layout)
        lookups, parts, columns = _observation(task, recorder, commands, measured, update, scenarios)
    return recorder.tape(), lookups, columns, reward, parts


def _quantities(task: TaskSpec, recorder: Recorder, controls: list[Any], air: list[Any]) -> tuple[list[Any], tuple[int, Any] | None]:
    """In the order of ``task.quantities``; the reward as Python when a part of it is."""
    accounts, tables = make_accounts(task), list(task.price_tables)
    places = accounts.ledger_states()
    before, after = ({place: recorder.input(source, place) for place in places} for source in ("before", "after"))
    columns = [len(CLOCK) + tables.index(name) for name in accounts.price_tables]
    prices, later = ([recorder.input(source, column) for column in columns] for source in ("calendar_before", "calendar"))
    controls_before = [recorder.input("controls_before", index) for index in range(len(controls))] if TRAVEL in accounts.names else None
    rows = accounts.of_step(before, after, controls, air, prices, later, controls_before)
    reward = make_reward(task, accounts)
    if all(REWARDS.recorded(name) for name in task.reward.modules):
        table = [rows.get(name) for name in accounts.names]
        nothing = cast("Floats", None)  # the recorded parts look at quantities only
        rows["reward"] = reward(StepOutcome(cast("Floats", table), nothing, nothing, nothing, nothing, accounts.names))
        return [rows[name] for name in accounts.names], None
    rows["reward"] = 0.0
    first, air_rows = info_columns(task), air_columns(task)

    def python_reward(table: Floats, before: Floats, after: Floats, controls: Floats) -> Floats:
        columns = np.ascontiguousarray(table.T)
        columns[first + REWARD] = 0.0
        return reward(StepOutcome(columns[first:], before, after, controls, columns[air_rows], accounts.names))

    return [rows[name] for name in accounts.names], (first + REWARD, python_reward)


def _observation(
    task: TaskSpec, recorder: Recorder, controls: list[Any], air: list[Any], update: Recorder, scenarios: RunScenarios
) -> tuple[tuple[Lookup, ...], tuple[tuple[slice, Any], ...], int]:
    tables, model, layout = WeatherTables.of(task), task.model_value, scenarios.memory_layout
    nominal = model.Parameters(*task.parameters().tolist())
    lookups: list[Lookup] = []
    parts: list[tuple[slice, Any]] = []
    at = 0
    for name in task.observation.modules:
        make = python_part(name)
        if make is not None:
            width = len(task.observed_by(name))
            parts.append((slice(at, at + width), checked_part(task, name, make(task, tables))))
            at += width
            continue
        if name in task.samples:
            for value in scenarios.samples.readings(recorder, name, layout):
                recorder.output("observation", at, value)
                at += 1
            continue
        if name == CAMERA:
            assert scenarios.camera is not None
            lookups.append(scenarios.camera.record(recorder, layout, at))
            at += lookups[-1].table.shape[1]
            continue
        for column in column_sources(name, task, tables):
            if isinstance(column, Lookup):
                lookups.append(replace(column, at=at))
                at += column.rows * column.table.shape[1]
                continue
            values: list[Any]
            if isinstance(column, Numbers):
                outside = list(scenarios.outdoor_sensors.readings(recorder).values()) if column.source == "weather" else []
                values = _numbers(task, column, recorder, {"air": air, "weather": outside, "controls": controls})
            elif isinstance(column, Locked):  # for how many minutes a control still stays on or off
                steps = recorder.input("memory", layout.of(actuation.PART)[actuation.hold_clock(column.control)])
                rest: Any = actuation.hold_steps(task, task.on_off[column.control]) - steps
                values = [np.maximum(rest, 0.0) * (task.step_seconds / 60.0)]
            elif column.of is not None:
                states = [recorder.input("after", place) for place in range(len(model.states))]
                values = [column.of(ByName(model.states, states), nominal)]
            elif column.of_air is not None:
                values = [with_simplification(lambda *entries, of=column.of_air: of(Air(*entries)), *air)]
            else:
                place = layout.of(DAILY_SUMS)[column.name]
                radiation = scenarios.outdoor_sensors.readings(update, "weather_before")["global_radiation"]
                update.output("memory", place, _sum_since_midnight(task, column, update, place, radiation))
                values = [recorder.input("memory", place)]
            for value in values:
                recorder.output("observation", at, value)
                at += 1
    if at != len(task.observed()):
        refuse(f"{task.id} announces {len(task.observed())} observed columns, its modules have {at}.", TaskError)
    return tuple(lookups), tuple(parts), at


def _sum_since_midnight(task: TaskSpec, column: ObservedColumn, recorder: Recorder, place: int, radiation: Any) -> Any:
    """What a column sums up since midnight, after the step, from what it had before it; ``radiation`` is the reading of the step."""
    model = task.model_value
    nominal = model.Parameters(*task.parameters().tolist())
    controls, names = _controls(task, recorder), model.disturbance_names
    weather = [radiation if name == "iGlob" else recorder.input("weather_before", names.index(name)) for name in names]

    def rate(*values: Any) -> Any:
        assert column.today is not None
        return column.today(model.Controls(*values[: len(controls)]), model.Disturbances(*values[len(controls) :]), nominal)

    hour = CLOCK.index("hour_of_day")
    before, now = recorder.input("calendar_before", hour), recorder.input("calendar", hour)
    so_far, amount = recorder.input("memory", place), with_simplification(rate, *controls, *weather)
    return daily_sum(so_far, amount, before, now, task.step_seconds)


def _numbers(task: TaskSpec, numbers: Numbers, recorder: Recorder, recorded: Mapping[str, list[Any]]) -> list[Any]:
    """Observed numbers of the run, as recorded values; ``recorded`` are those of some sources."""
    values = []
    for index, factor in zip(numbers.indices, numbers.factors, strict=True):
        if numbers.source == "states":
            value = recorder.input("after", index)
        elif numbers.source == "counter":
            value = recorder.input("counter", index)
        elif numbers.source == "clock":
            value = recorder.input("calendar", index)
        elif numbers.source == "schedule":
            value = actuation.scheduled_controls(task, recorder.input)[list(task.scheduled_places)[index]]
        else:
            value = recorded[numbers.source][index]
        values.append(value if factor == 1.0 else value * factor)
    return values
