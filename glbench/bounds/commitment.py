"""Unit commitment: a cheap way to give a run what it asked for, with boiler and engine as its task lets them run.

The engine is off, or runs at its lowest load or more, stays off or on for its hold time, and starts and stops at its lowest load; loads
change by at most ``max_change`` in a step. When the engine runs is chosen day by day, looking two days ahead, by mixed-integer programming
(heat left then is worth what the boiler's gas for it costs); all else is chosen after that for the whole run, by linear programming. So
the cost is no lower bound, as that of :mod:`glbench.bounds.dispatch` is, but that of a schedule the machines can follow.

Source: Rajan and Takriti (2005), Minimum up/down polytopes of the unit commitment problem with start-up costs, IBM Research RC23628.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import Floats
from glbench.bounds.dispatch import FINE, MJ_PER_KWH, VARIABLES, Dispatch, EnergyDemand, equipment_of, programme, way_of
from glbench.control.machines import Machines
from glbench.env.actuation import off_position
from glbench.model.equipment import Equipment, lacks_energy
from glbench.resources import standard_output_to

if TYPE_CHECKING:
    from glbench.control import SeasonPlan
    from glbench.tasks import TaskSpec

_GAP = 1e-3
"""The solver stops when a schedule of two days costs at most this share too much."""
_EDGES = 2.0
"""A plan keeps so many ``eBufEdge`` from an empty and from a full buffer, where the model gives and takes less than the programme."""


def commit(equipment: Equipment, demand: EnergyDemand, task: TaskSpec) -> Dispatch | None:
    """A cheap way to run the equipment as ``task`` lets it run; ``None`` where none was found, or it does not switch the engine alone."""
    if lacks_energy(task.model_value) or [*task.on_off] != ["uChp"]:
        return None
    steps, hours, a_day = len(demand.heat), demand.seconds / 3600.0, round(86400.0 / demand.seconds)
    boiler, load = (task.initial_controls[task.model_value.control_names.index(name)] for name in ("uBoil", "uChp"))
    running, stored, at, since, was_on = np.zeros(steps, bool), demand.start, load, steps, load > 0.0
    for first in range(0, steps, a_day):
        ahead, last = min(first + a_day, steps), min(first + 2 * a_day, steps)
        flows, prices = ({name: one[first:last] for name, one in every.items()} for every in (demand.flows, demand.prices))
        part = EnergyDemand(demand.seconds, flows, prices, stored, demand.end if last == steps else 0.0)
        solution = _solved(equipment, part, task, at, since=since, worth=demand.worth(equipment) if last < steps else 0.0)
        if solution is None:
            return None
        end_of_day = dict(zip((*VARIABLES, "on"), solution[:, ahead - first - 1], strict=False))
        running[first:ahead] = solution[len(VARIABLES), : ahead - first] > 0.5
        stored, at = MJ_PER_KWH * end_of_day["stored"] / FINE, end_of_day["engine"] / (equipment.engine * hours) * running[ahead - 1]
        since = ahead - np.flatnonzero(np.diff(running[:ahead], prepend=was_on)).max(initial=-steps)
    solution = _solved(equipment, demand, task, load, running=running, boiler=boiler)
    if solution is None:
        return None
    way, started = way_of(equipment, demand, solution[: len(VARIABLES)]), np.diff(running, prepend=was_on) & running
    return replace(way, flows={**way.flows, "engine_hours": np.where(running, hours, 0.0), "engine_starts": started.astype(np.float64)})


def _solved(
    equipment: Equipment, demand: EnergyDemand, task: TaskSpec, load: float, *, since: int = 0, worth: float = 0.0,
    running: NDArray[np.bool_] | None = None, boiler: float = 0.0,
) -> Floats | None:  # fmt: skip
    """``VARIABLES``, whether the engine runs, and whether it starts, in each step ``(9, steps)``; ``None`` where there is no way.

    ``load`` was the engine's before, ``since`` counts steps since it was switched; heat left has a ``worth`` [EUR kWh-1]. Where it is known
    when the engine is ``running``, the boiler continues from its load ``boiler``.
    """
    from scipy import optimize, sparse

    linear, steps, machine, change = programme(equipment, demand), len(demand.heat), task.on_off["uChp"], task.actuation.max_change
    hours, hold, off, on = demand.seconds / 3600.0, int(Machines(task).hold[0]), off_position(task, machine), float(load > 0.0)
    rows = [(linear["A_eq"], linear["b_eq"], linear["b_eq"]), (linear["A_ub"], -np.inf, linear["b_ub"])]
    full, most = equipment.engine * hours, equipment.boiler * hours  # in the unit of the solver [Wh m-2]
    first, changes, size = np.eye(1, steps)[0], sparse.eye_array(steps) - sparse.eye_array(steps, k=-1), len(linear["c"])

    def add(low: Any, high: Any, **parts: Any) -> None:
        rows.append((sparse.hstack([parts.get(name, 0.0 * changes) for name in (*VARIABLES, "on", "starts")]), low, high))

    def past(shares: Any, after: int = 0) -> Any:
        return sum((share * sparse.eye_array(steps, k=-ago) for ago, share in enumerate(shares, after)), 0.0 * changes)

    add(0.0, np.inf, engine=past([1.0]), on=past([-machine.lowest * full]))
    short = np.maximum(1.0 - off - change * np.arange(1, hold + 1), 0.0)  # of full load, after a start
    add(-np.inf, 0.0, engine=past([1.0]), on=past([-full]), starts=past(full * short))
    before = first * (load - off) * on  # off is one change below the lowest load: see glbench.env.actuation
    add(full * (before - change), full * (before + change), engine=changes, on=-off * full * changes)
    add(-np.inf, first * on, on=changes, starts=past([-1.0]))
    add(-np.inf, 0.0, on=past([-1.0]), starts=past([1.0] * hold))
    add(-np.inf, 1.0 - on * (np.arange(steps) < hold), on=past([1.0], hold), starts=past([1.0] * hold))
    bounds = np.concatenate([linear["bounds"], np.tile([0.0, 1.0], (2 * steps, 1))])
    if running is None:
        bounds[size : size + max(hold - since, 0)] = on
    else:
        bounds[size : size + steps] = running[:, None]
        add(most * (first * boiler - change), most * (first * boiler + change), boiler=changes)
    wear, start = (demand.prices.get(name, np.zeros(steps)) for name in ("engine_hours", "engine_starts"))
    costs = np.concatenate([linear["c"], FINE * hours * wear, FINE * start])
    costs[steps : 2 * steps] -= wear * equipment.makes()["engine_hours"].get("engine", 0.0)
    costs[size - 1] -= worth
    matrix = sparse.vstack([sparse.hstack([one, sparse.csr_array((one.shape[0], len(costs) - one.shape[1]))]) for one, _, _ in rows])
    low, high = (np.concatenate([np.broadcast_to(row[side], row[0].shape[0]) for row in rows]) for side in (1, 2))
    integral, limits = np.repeat([0, running is None, 0], [size, steps, steps]), optimize.LinearConstraint(matrix.tocsr(), low, high)
    box = optimize.Bounds(*bounds.T)
    with Path(os.devnull).open("wb") as nowhere, standard_output_to(nowhere.fileno()):  # HiGHS prints in some searches, unasked
        solution = optimize.milp(costs, integrality=integral, bounds=box, constraints=limits, options={"mip_rel_gap": _GAP})
    return None if solution.x is None else solution.x.reshape(-1, steps)


def redispatched(plan: SeasonPlan) -> Floats | None:
    """Commands of a plan ``(T, c)`` with boiler and engine run as is cheap for what it asks for; ``None`` where ``commit`` finds no way."""
    task, commands = plan.scenario.task, plan.commands.copy()
    if lacks_energy(task.model_value):
        return None
    equipment, demand = equipment_of(task), EnergyDemand.along(task, plan.states, plan.controls, plan.scenario.calendar)
    hours, edge = demand.seconds / 3600.0, _EDGES * task.parameters_by_name()["eBufEdge"]
    inner = replace(demand, start=max(demand.start - edge, 0.0), end=max(demand.end - edge, 0.0))
    way = commit(replace(equipment, buffer=equipment.buffer - 2.0 * edge), inner, task)
    if way is not None:
        for name, flow, power in (("uBoil", "heat", equipment.boiler), ("uChp", "electricity_made", equipment.engine)):
            commands[:, task.model_value.control_names.index(name)] = way.flows[flow] * FINE / (power * hours)
    return None if way is None else commands
