"""What boiler, engine, buffer and prices earn: the least cost at which an energy system can give what a run asked for.

A run asks for heat in the pipes, electricity for the lamps and CO2, step by step, and pays the prices of its task's ledger. A linear
programme over its control steps finds when boiler and engine should have run, and what should have been stored, sold and bought, with all
prices and demands known beforehand. Solving it again without the buffer, without the engine, or blind to how prices change says what each
of them is worth to that run.

The programme is a relaxation: the engine runs at any load from 0 to 1, may be switched at any step, and starts cost nothing. An almost
empty or almost full buffer gives and takes like any other, and may let off heat. So no control of the equipment is cheaper, and a part of
the gap to the run is what no real machine can close. The greenhouse does not answer: what it asks for stays as it was.

Heat that the run took from the buffer, or left in it, counts at what the boiler's gas for it costs on average.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import Floats
from glbench.control import Scenario
from glbench.env.accounts import flow_amounts
from glbench.env.weather_pool import WeatherPool
from glbench.episodes import Episode
from glbench.errors import EpisodeError, GlbenchError, refuse
from glbench.model.equipment import BUFFER, Equipment, lacks_energy
from glbench.model.greenlight import JOULES_PER_KWH
from glbench.tasks import TaskSpec
from glbench.tasks.ledger import FLOW

Flows = Mapping[str, Floats]
"""Amounts of a model's flows in every step ``(steps,)``, or their prices, by name."""

MJ_PER_KWH = 3.6
_HOURS_A_DAY = 24.0
_SECONDS_AN_HOUR = 3600.0
FINE = 1000.0
"""The solver counts in Wh and g: its tolerances are absolute."""
_INFEASIBLE = 2
VARIABLES = ("boiler", "engine", "bought", "sold", "co2", "dumped", "stored")
"""What a dispatch chooses in each step: heat of the boiler, electricity of the engine, electricity bought and sold [kWh m-2], CO2 bought
[kg m-2], heat let off, and heat in the buffer at the end of the step [kWh m-2]."""


def equipment_of(task: TaskSpec) -> Equipment:
    """The equipment of a task, at its nominal parameters. Raises ``GlbenchError`` when the task's model has no energy system."""
    lacking = lacks_energy(task.model_value)
    if lacking:
        msg = (
            f"{task.id} has no boiler, engine and buffer to dispatch: its model {task.model_value.id} has no complete energy system "
            f"('{lacking[0]}' is missing). See docs/energy-dispatch.md."
        )
        raise GlbenchError(msg)
    return Equipment.of(task.model_value, task.parameters_by_name())


_DEMANDS = ("electricity", "co2_dosed", "heat_to_pipes")
"""Flows that a run asks for, and no dispatch changes."""


@dataclass(frozen=True, eq=False)
class EnergyDemand:
    """What a run asked for and paid, in steps of ``seconds``.

    ``flows`` are what flowed in each step, in the units of the flows. ``prices`` are what each flow cost in each step, EUR per unit of the
    flow, below 0 where it was earned with; only flows that the ledger prices. ``start``, ``end``: heat in the buffer then [MJ m-2].
    """

    seconds: float
    flows: Flows
    prices: Flows
    start: float
    end: float

    @classmethod
    def of(cls, episode: Episode, task: TaskSpec) -> Self:
        """What the run of ``episode`` asked for, at the prices of its moments.

        Raises ``GlbenchError`` when the model of ``task`` has no energy system, or its ledger prices nothing of it, and ``EpisodeError``
        when the prices are not those that the run paid: the task has other draws.
        """
        equipment_of(task)  # or there is nothing to ask of
        x, u = episode.states, np.stack([episode[name] for name in task.model_value.control_names], axis=1)
        demand = cls.along(task, x, u, Scenario.of(task, episode.run.seed).calendar)
        items = (item for item in task.ledger.items if item.valued == FLOW and item.flow in demand.flows)
        paid = -sum(item.sign * episode[item.name].sum() for item in items)
        if not np.isclose(cost(demand.flows, demand.prices), paid, rtol=1e-6, atol=1e-9):
            msg = (
                f"The run with seed {episode.run.seed} paid {paid:.6f} EUR m-2 for its energy and CO2; at the prices of {task.id} "
                f"it would have paid {cost(demand.flows, demand.prices):.6f} EUR m-2. Give the task that it was evaluated on, with the "
                "same draws."
            )
            raise EpisodeError(msg)
        return demand

    @classmethod
    def along(cls, task: TaskSpec, x: NDArray[np.floating], u: NDArray[np.floating], calendar: Floats) -> Self:
        """What states ``(T + 1, s)`` and controls ``(T, c)`` ask for, at the prices in the ``calendar`` of a ``Scenario``."""
        flows, store = flow_amounts(task, (*_OUTPUTS, *_DEMANDS), x, u), task.model_value.state_index(BUFFER)
        return cls(task.step_seconds, flows, _prices(task, calendar[: len(u)]), float(x[0, store]), float(x[-1, store]))

    @property
    def heat(self) -> Floats:
        """Heat into the pipes [kWh m-2]."""
        return self.flows["heat_to_pipes"] / JOULES_PER_KWH

    @property
    def electricity(self) -> Floats:
        """Electricity used [kWh m-2]."""
        return self.flows["electricity_made"] + self.flows["electricity_bought"] - self.flows["electricity_sold"]

    def flat(self) -> Self:
        """The same at prices that stay at their mean over the steps."""
        means = {name: np.full_like(price, price.mean()) for name, price in self.prices.items()}
        return replace(self, prices=MappingProxyType(means))

    def worth(self, equipment: Equipment) -> float:
        """What heat in the buffer counts at [EUR kWh-1]: what the boiler pays for it, mean over the steps."""
        outputs = equipment.makes()
        return sum(float(self.prices[name].mean()) * outputs[name]["boiler"] for name in ("gas", "heat") if name in self.prices)


@dataclass(frozen=True, eq=False)
class Dispatch:
    """A way to run the equipment, with ``flows`` as those of a run.

    ``stored`` is the heat in the buffer at the end of each step [MJ m-2], ``lent`` the worth of the heat that it had at the start and has
    no more at the end [EUR m-2].
    """

    flows: Flows
    stored: Floats
    lent: float

    def cost(self, prices: Flows) -> float:
        """Money paid minus money earned, and what was taken from the buffer [EUR m-2]."""
        return cost(self.flows, prices) + self.lent


def cost(flows: Flows, prices: Flows) -> float:
    """What the flows cost in all steps, minus what they earn [EUR m-2]."""
    return sum(float(flows[name] @ price) for name, price in prices.items())


def dispatch(equipment: Equipment, demand: EnergyDemand) -> Dispatch | None:
    """The cheapest way to give a run what it asked for; ``None`` where ``equipment`` cannot.

    A buffer starts with the heat that the run started with, and ends with what the run ended with at least; a smaller one is full then.
    Raises ``GlbenchError`` when the solver gives up.
    """
    from scipy.optimize import linprog

    solution: Any = linprog(**programme(equipment, demand), method="highs")
    if solution.status == _INFEASIBLE:
        return None
    if solution.status:
        refuse(f"The solver found no least cost for {len(demand.heat)} steps: {solution.message}", GlbenchError)
    return way_of(equipment, demand, solution.x)


def way_of(equipment: Equipment, demand: EnergyDemand, solution: Floats) -> Dispatch:
    """The way to run the equipment that a solution of its programme is."""
    variables = dict(zip(VARIABLES, solution.reshape(len(VARIABLES), -1) / FINE, strict=True))
    dosed, nothing = demand.flows["co2_dosed"], np.zeros_like(demand.heat)
    fixed = {"co2_from_flue": dosed, "co2_vented": -dosed}
    flows = {
        name: sum((per * variables[choice] for choice, per in parts.items()), fixed.get(name, nothing))
        for name, parts in equipment.makes().items()
    }
    flows |= {name: demand.flows[name] for name in _DEMANDS}
    lent = min(demand.start, equipment.buffer) - min(demand.end, equipment.buffer)
    return Dispatch(flows, MJ_PER_KWH * variables["stored"], demand.worth(equipment) * lent / MJ_PER_KWH)


def programme(equipment: Equipment, demand: EnergyDemand) -> dict[str, Any]:
    """The linear programme, with ``VARIABLES`` of all steps one after the other, as ``scipy.optimize.linprog`` takes it."""
    from scipy import sparse

    start, end = (min(heat, equipment.buffer) / MJ_PER_KWH for heat in (demand.start, demand.end))  # at the end at least [kWh m-2]
    steps, hours, outputs = len(demand.heat), demand.seconds / _SECONDS_AN_HOUR, equipment.makes()
    slow = _HOURS_A_DAY * equipment.tau / hours
    share_kept = np.exp(-1 / slow)  # of the heat in the buffer, what is left after a step
    share_stored = -np.expm1(-1 / slow) * slow  # of the heat that flows in during a step, likewise
    used, dosed = demand.electricity, demand.flows["co2_dosed"]
    most = equipment.engine * hours / 1000.0
    one: Any = sparse.identity(steps)

    def rows(**parts: Any) -> Any:
        """A row for each step: the factor, or the matrix, of each thing that is chosen."""
        blocks = (parts.get(name, 0.0) for name in VARIABLES)
        joined: list[Any] = [block if sparse.issparse(block) else block * one for block in blocks]
        return sparse.hstack(joined)

    into = -share_stored * demand.heat
    into[0] += share_kept * start
    balance = rows(
        boiler=-share_stored,
        engine=-share_stored * outputs["engine_heat"]["engine"],
        dumped=share_stored,
        stored=one - sparse.diags([share_kept], [-1], shape=(steps, steps)),
    )
    flue = rows(co2=-1.0, **{name: -per for name, per in outputs["co2_made"].items()})
    # No more is sold than on the line from nothing at no load to all that is left at full load: else, where selling pays more than buying
    # costs, what is bought would be sold on.
    room = np.maximum(1.0 - used / most, 0.0) if most else np.zeros(steps)
    at_most: dict[str, Any] = {
        "boiler": equipment.boiler * hours / 1000.0,
        "engine": most,
        "co2": dosed,
        "stored": equipment.buffer / MJ_PER_KWH,
    }
    bounds = np.zeros((2, len(VARIABLES), steps))
    for place, name in enumerate(VARIABLES):
        bounds[1, place] = at_most.get(name, np.inf)
    bounds[0, -1, -1] = end
    costs = np.zeros((len(VARIABLES), steps))  # of one unit more in each step [EUR]
    for place, variable in enumerate(VARIABLES):
        for name, price in demand.prices.items():
            costs[place] += price * outputs.get(name, {}).get(variable, 0.0)
    return {
        "c": costs.reshape(-1),
        "A_eq": sparse.vstack([balance, rows(engine=1.0, bought=1.0, sold=-1.0)]),
        "b_eq": FINE * np.concatenate([into, used]),
        "A_ub": sparse.vstack([flue, rows(sold=1.0, engine=-sparse.diags(room))]),
        "b_ub": FINE * np.concatenate([-dosed, np.zeros(steps)]),
        "bounds": FINE * bounds.reshape(2, -1).T,
    }


_OUTPUTS = tuple(Equipment(1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0).makes())
"""Flows that depend on a dispatch."""


def _prices(task: TaskSpec, calendar: Floats) -> Flows:
    """What each flow costs in each step, from the rows of a calendar at their starts."""
    pool, prices = WeatherPool.of(task), dict[str, Floats]()
    for item in task.ledger.items:
        if item.valued == FLOW and item.flow in {*_OUTPUTS, *_DEMANDS}:
            if item.beyond is not None:
                refuse(f"The price of '{item.name}' of {task.id} changes beyond an amount: no dispatch knows that.", GlbenchError)
            price = calendar[:, pool.price_column(item.price)] if isinstance(item.price, str) else item.price
            prices[item.flow] = prices.get(item.flow, np.zeros(len(calendar))) - item.sign * item.factor * price
    if not prices:
        refuse(f"The ledger of {task.id} prices neither energy nor CO2: there is no cost to compare.", GlbenchError)
    return prices
