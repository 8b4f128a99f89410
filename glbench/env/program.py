"""A task as a program of the compiled kernel: the same formulas as everywhere, recorded instead of evaluated.

Every part that glbench ships can be recorded. A part that somebody registered is Python, which the compiled kernel cannot
run; the whole task is then stepped with numpy around the kernel (``glbench.env.reference``).
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from glbench.env.accounts import Accounts, make_accounts
from glbench.env.actuation import ACTUATIONS, ActionReader, RecordedActuation
from glbench.env.climate import AIR_STATES, record_air
from glbench.env.derived import DerivedParameters
from glbench.env.observations import Numbers, TableRows, shown_by
from glbench.env.quantities import QUANTITY_NAMES
from glbench.env.rewards import REWARDS, StepOutcome, make_reward
from glbench.env.weather_tables import WeatherTables
from glbench.kernel.environment import Draws, Lookup, Program, Reader
from glbench.kernel.tape import Recorder, RecordingError, Tape, Value
from glbench.model import CONTROL_NAMES
from glbench.tasks.quantities import LIMITED

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec

HEAD = 3 + len(LIMITED) + len(CONTROL_NAMES)
"""Columns of the table before the step's quantities: steps taken, hour of day, day of year, the air inside, controls in physical units."""


def make_program(task: TaskSpec) -> Program | None:
    """The program of a task; ``None`` when a part of it cannot be recorded."""
    if not _all_shipped(task):
        return None
    try:
        return _program(task)
    except RecordingError:
        return None


def _all_shipped(task: TaskSpec) -> bool:
    tables = WeatherTables.of(task)
    return (
        ACTUATIONS.recorded(task.actuation.kind) is not None
        and all(REWARDS.recorded(name) for name in task.reward.modules)
        and all(shown_by(name, task, tables) is not None for name in task.observation.modules)
        and (task.uncertainty.delta == 0.0 or task.uncertainty.distribution == "uniform")
    )


@lru_cache(maxsize=16)
def _program(task: TaskSpec) -> Program:
    disturbances = task.disturbances(extra_rows=task.observation.forecast_steps)
    actions, controls = ActionReader.of_task(task), ActionReader.of_controls()
    charge = task.evaluation.failed_step
    charges = {"reward": charge.reward, "epi": charge.epi, "penalty": charge.penalty}
    outcome, lookups, columns = _outcome(task)
    return Program(
        actuation=_actuation(task),
        outcome=outcome,
        actions=_reader(actions),
        controls=_reader(controls),
        steps=task.steps,
        weather=disturbances.values,
        clock=np.stack([disturbances.hour_of_day, disturbances.day_of_year], axis=1),
        lag=1 if task.observation.timing == "published" else 0,
        nominal=task.parameters(),
        draws=_draws(task),
        lookups=lookups,
        columns=columns,
        width=HEAD + len(QUANTITY_NAMES),
        head=HEAD,
        charges={HEAD + QUANTITY_NAMES.index(name): value for name, value in charges.items()},
    )


def _reader(reader: ActionReader) -> Reader:
    return Reader(reader.lowest, reader.highest, reader.low, reader.high)


def _actuation(task: TaskSpec) -> Tape:
    recorder = Recorder()
    move = cast("RecordedActuation", ACTUATIONS.recorded(task.actuation.kind))
    moved: dict[str, Any] = {
        name: move(task, recorder.input("controls", CONTROL_NAMES.index(name)), recorder.input("given", column), column)
        for column, name in enumerate(task.actuation.controls)
    }
    for index, name in enumerate(CONTROL_NAMES):
        recorder.output("controls", index, moved.get(name, 0.0))
    return recorder.tape()


def _draws(task: TaskSpec) -> Draws | None:
    uncertainty = task.uncertainty
    if uncertainty.delta == 0.0:
        return None
    derived = DerivedParameters(task.parameters(), task.uncertain_parameters())
    places = np.array(derived.uncertain, dtype=np.int32)
    return Draws(places, uncertainty.half_width, uncertainty.redraw == "episode", derived.tape())


def _outcome(task: TaskSpec) -> tuple[Tape, tuple[Lookup, ...], int]:
    """The tape after the step, what is looked up besides, and the number of observed columns."""
    recorder = Recorder()
    temperature, density, pressure = (recorder.input("after", place) for place in AIR_STATES)
    air = [temperature, *record_air(temperature, density, pressure, recorder)]
    controls = [recorder.input("controls", index) for index in range(len(CONTROL_NAMES))]
    clock = [recorder.input("clock", index) for index in range(2)]
    delivered = [control * at_one.at_one for control, at_one in zip(controls, task.capacities(), strict=True)]
    accounts = make_accounts(task)
    rows = [
        recorder.input("counter", 0),
        *clock,
        *air,
        *delivered,
        *_quantities(task, accounts, recorder, controls, air),
    ]
    for column, value in enumerate(rows):
        recorder.output("table", column, value)
    lookups, columns = _observation(task, recorder, controls, air)
    return recorder.tape(), lookups, columns


def _quantities(
    task: TaskSpec, accounts: Accounts, recorder: Recorder, controls: list[Value], air: list[Value]
) -> list[Value]:
    """In the order of ``QUANTITY_NAMES``."""
    places = accounts.ledger_states()
    before, after = ({place: recorder.input(source, place) for place in places} for source in ("before", "after"))
    rows = accounts.of_step(before, after, controls, air)
    table = [rows.get(name) for name in QUANTITY_NAMES]
    nothing = cast("NDArray[np.float64]", None)  # the recorded parts look at quantities only
    outcome = StepOutcome(cast("NDArray[np.float64]", table), nothing, nothing, nothing, nothing)
    rows["reward"] = make_reward(task, accounts)(outcome)
    return [rows[name] for name in QUANTITY_NAMES]


def _observation(
    task: TaskSpec, recorder: Recorder, controls: list[Value], air: list[Value]
) -> tuple[tuple[Lookup, ...], int]:
    tables = WeatherTables.of(task)
    lookups: list[Lookup] = []
    at = 0
    for name in task.observation.modules:
        for shown in shown_by(name, task, tables) or ():
            if isinstance(shown, TableRows):
                lookups.append(Lookup(shown.table, at, shown.rows, shown.clocked, shown.ahead))
                at += shown.rows * shown.table.shape[1]
            else:
                at = _numbers(shown, at, recorder, controls, air)
    return tuple(lookups), at


def _numbers(shown: Numbers, at: int, recorder: Recorder, controls: list[Value], air: list[Value]) -> int:
    """Record observed numbers from column ``at`` on; the column after them."""
    for index, factor in zip(shown.indices, shown.factors, strict=True):
        if shown.source == "states":
            value = recorder.input("after", index)
        elif shown.source == "counter":
            value = recorder.input("counter", index)
        else:
            value = (air if shown.source == "air" else controls)[index]
        recorder.output("observation", at, value if factor == 1.0 else value * factor)
        at += 1
    return at
