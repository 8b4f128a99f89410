"""``tasks/behaviour.toml``: what glbench computes from a published task, in a few numbers.

The digest of a task covers what the task says, and not the code that computes weather, draws, accounts and reward from it. This file
does: for every published task it holds

* of every column of the computed weather d(t), and of its clock, a sum over all rows with weights that differ from row to row;
* of one fixed step of four greenhouses (fixed states before and after, fixed actions, no model), every quantity of the step, the
  controls, and the parameters drawn, as sums of the same kind;
* of a task of schema 2, what its test draws: the weather and forecasts of these four runs, the states that they start with, what their
  sensors are off by, and what they observe after the fixed step.

``glbench tasks check`` recomputes the numbers and compares them to ``TOLERANCE``, so that another processor or C library passes and another
constant does not. A change of one row of weather by a thousandth of the column's mean is seen. What is not covered: observations of schema
1 (their names, units and bounds are in the digest) and the model's integration (its equations are).
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from glbench.arrays import Floats
from glbench.env.accounts import make_accounts
from glbench.env.scenario import RunScenarios
from glbench.env.simulation import Simulation
from glbench.errors import TaskError, refuse
from glbench.kernel import StepFailure
from glbench.registration import BEHAVIOUR_NAME
from glbench.resources import write_atomically
from glbench.tasks import TaskSpec
from glbench.tasks.card import task_card
from glbench.tasks.digest import lock_path
from glbench.weather import COLUMNS

TOLERANCE = 1e-9
"""Relative to the sum of the magnitudes that a number is the sum of."""

OF_SINGLE_PRECISION = 1e-6
"""The same for numbers that are observed in single precision."""
_SINGLE = ("step.observed", "draw.forecast")

BEHAVIOUR_WORDS = f"tasks/{BEHAVIOUR_NAME}"

_HEADER = """\
# What glbench computes from the published tasks, written by `glbench tasks lock` and compared by `glbench tasks check`. Entries are
# added, never edited. Sums with weights over the rows of the weather, and over the greenhouses of one fixed step: glbench/env/behaviour.py.
"""
_GOLDEN = 0.6180339887498949
_MOST_NAMED = 6

# Four greenhouses: within all limits, below, above, and mixed. Air temperature [degC], CO2 [mg m-3], vapour pressure [Pa].
_AIR = ((21.0, 1200.0, 1700.0), (8.0, 300.0, 400.0), (39.0, 6500.0, 6800.0), (36.0, 350.0, 5600.0))
_EARNING = 2.0e5  # of every state that the ledger depends on
_GROWN = (150.0, 320.0, -40.0, 75.0)
_SEEDS = (0, 1, 666, 10000)


class Number(NamedTuple):
    """A weighted sum, and the same sum over the magnitudes: what rounding is measured by."""

    value: float
    size: float


def behaviour(task: TaskSpec) -> dict[str, Number]:
    """The numbers of ``task`` by name: ``weather.iGlob``, ``step.revenue``, ..."""
    task = task.scored
    weather = task.disturbances(task.observation.forecast_steps)
    columns = {**dict(zip(COLUMNS, weather.values.T, strict=True)), "hourOfDay": weather.hour_of_day, "dayOfYear": weather.day_of_year}
    return {
        **{f"weather.{name}": weighted_sum(values) for name, values in columns.items()},
        **{f"step.{name}": weighted_sum(values) for name, values in _step(task).items()},
        **({f"draw.{name}": weighted_sum(values) for name, values in _draws(task).items()} if task.conventions.freezes_draws else {}),
    }


def check_behaviour(task: TaskSpec) -> None:
    """Raises ``TaskError`` when glbench computes other numbers from a published task than when it was published; it has these numbers."""
    locked = read_behaviour().get(task.id)
    if locked is None:
        refuse(f"{BEHAVIOUR_WORDS} has no entry for {task.id}. Add it with `glbench tasks lock`.", TaskError)
    numbers = behaviour(task)
    differences = []
    for name, number in locked.items():  # what was not measured when the task was published is not compared
        now = numbers.get(name)
        if now is None:
            differences.append(f"{name} (no longer computed)")
        elif not abs(now.value - number) <= (OF_SINGLE_PRECISION if name in _SINGLE else TOLERANCE) * now.size:
            differences.append(f"{name} (locked {number:.9g}, found {now.value:.9g})")
    if differences:
        more = f" and {len(differences) - _MOST_NAMED} more" if len(differences) > _MOST_NAMED else ""
        msg = (
            f"{task.source} is as it was published, but glbench computes other numbers from it than {BEHAVIOUR_WORDS} says: "
            f"{', '.join(differences[:_MOST_NAMED])}{more}. Results would not be comparable with published ones: restore the code, or, "
            "if the change is meant, publish new versions of the tasks and run `glbench tasks lock`."
        )
        raise TaskError(msg)


def lock_behaviour(tasks: Iterable[TaskSpec]) -> tuple[str, ...]:
    """Write the numbers of those ``tasks`` that have none yet, and return their ids."""
    entries = dict(read_behaviour())
    new = {task.id: {name: number.value for name, number in behaviour(task).items()} for task in tasks if task.id not in entries}
    if new:
        entries.update(new)
        blocks = [_HEADER]
        for task_id in sorted(entries):
            groups: dict[str, list[str]] = {}
            for name, value in entries[task_id].items():
                group, _, key = name.partition(".")
                groups.setdefault(group, []).append(f"{key} = {value!r}\n")
            blocks.append("\n".join(f'["{task_id}".{group}]\n{"".join(lines)}' for group, lines in groups.items()))
        write_atomically(_path(), "\n".join(blocks))
    return tuple(new)


def read_behaviour() -> Mapping[str, Mapping[str, float]]:
    """The numbers of the published tasks by id and name; empty when there is no file yet. Raises ``TaskError`` when the file is damaged."""
    path = _path()
    if not path.is_file():
        return {}
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        return {
            task_id: {f"{group}.{name}": float(value) for group, numbers in groups.items() for name, value in numbers.items()}
            for task_id, groups in content.items()
        }
    except (OSError, ValueError, TypeError, AttributeError) as error:
        refuse(f"Cannot read {path}: {error}. Restore the file, or install glbench again.", TaskError, error)


class _FixedStep:
    """Stands in for a kernel: it returns fixed states and records its inputs."""

    def __init__(self, after: Floats) -> None:
        self.after = after
        self.controls = self.parameters = np.empty(0)

    def try_step(self, x: Floats, u: Floats, d: Floats, p: Floats) -> tuple[Floats, list[StepFailure]]:
        """The states that were fixed, four rows."""
        self.controls, self.parameters = u.copy(), np.broadcast_to(p, (len(x), p.shape[-1])).copy()
        return self.after.copy(), []


def _step(task: TaskSpec) -> dict[str, Floats]:
    """Every quantity of the fixed step, the controls, and the drawn parameters relative to their nominal values."""
    n, model, earning = len(_AIR), task.model_value, list(make_accounts(task).ledger_states())
    before = np.tile(10.0 + np.arange(len(model.states)), (n, 1))
    before[:, earning] = _EARNING
    after = before.copy()
    if model.air is not None:
        after[:, [model.state_index(name) for name in model.air]] = _AIR
    after[:, earning] += np.array(_GROWN)[:, None]
    fixed = _FixedStep(after)
    simulation = Simulation(task, n, fixed, fused=False)
    simulation.reset(_SEEDS)
    simulation.restore(replace(simulation.snapshot(), states=before))
    low, high = task_card(task).action_bounds
    part = 0.5 + 0.45 * (np.arange(1, n * len(low) + 1) * _GOLDEN % 1.0).reshape(n, -1)
    table = simulation.step(low + (high - low) * part).table
    nominal = task.parameters()
    uncertain = (fixed.parameters != nominal).any(axis=0)
    observed = {"observed": simulation.observe().astype(np.float64).ravel()} if task.conventions.freezes_draws else {}
    return {
        **{quantity.name: row for quantity, row in zip(task.quantities, table, strict=True)},
        "controls": fixed.controls.ravel(),
        "parameters": (fixed.parameters[:, uncertain] / nominal[uncertain]).ravel(),
        **observed,
    }


def _draws(task: TaskSpec) -> dict[str, Floats]:
    """What four runs draw once: rows of weather and clock by column, forecasts, states, offsets of sensors."""
    scenarios = RunScenarios(task)
    pool, scenes = scenarios.pool, scenarios.draw(_SEEDS)
    steps = np.arange(task.steps + 1)
    rows = (scenes.days[:, steps // pool.day] + steps % pool.day).ravel()
    dates = (scenes.first[:, None] + steps).ravel()
    draws = {name: pool.values[rows, column] for column, name in enumerate(COLUMNS)}
    draws |= {f"clock{column}": pool.calendar[dates, column] for column in range(pool.calendar.shape[1])}
    if pool.tables.forecast.size:
        every = 3600 // task.weather.step_seconds
        draws["forecast"] = pool.tables.forecast[rows[::every] // every].astype(np.float64).ravel()
    draws["states"] = scenes.states.ravel()
    draws["sensors"] = scenes.traits.ravel()
    return draws


def weighted_sum(values: Floats) -> Number:
    """Sum of ``values`` (k,) with weights between 1 and 2 that repeat nowhere."""
    weights = 1.0 + np.arange(len(values)) * _GOLDEN % 1.0
    terms = weights * values
    return Number(float(terms.sum()), float(np.abs(terms).sum()))


def _path() -> Path:
    return lock_path().with_name(BEHAVIOUR_NAME)
