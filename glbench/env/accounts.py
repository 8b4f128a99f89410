"""The accounts of a control step: what was used and grown, what that costs and earns, and how far the climate was off.

All amounts are per m2 of greenhouse floor. What is earned and paid is the task's ledger, of flows and states of its model; profit (EPI, the
economic performance indicator of the GreenLight-Gym paper) is what is earned minus what is paid.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import Floats
from glbench.errors import TaskError
from glbench.model import SIDES, Flow, Model, Side, Step, Stock, violation_meter
from glbench.tasks import TaskSpec
from glbench.tasks.ledger import LIMITED, STOCK, TRAVEL, Ledger, LedgerItem, StepQuantity, step_quantities
from glbench.tasks.schema1 import paper_v1
from glbench.tasks.tables import PricesTable

_PAPER = paper_v1(
    PricesTable.model_construct(fruit=1.0, dry_matter_content=1.0, co2=1.0, heat=1.0, electricity=1.0)  # names, not prices
)

QUANTITIES: tuple[StepQuantity, ...] = step_quantities(_PAPER, LIMITED)
"""What is measured in every control step of a task of schema 1: rows of ``StepResult.table``; those of any task are ``task.quantities``."""
QUANTITY_NAMES: tuple[str, ...] = tuple(quantity.name for quantity in QUANTITIES)

REWARD, EPI = 0, 1
"""Rows of every task's table: the reward and the profit."""

Values = Sequence[Any] | Mapping[int, Any] | Floats
"""A number, an array or a recorded value for each place; a mapping where only some are needed (``Accounts.ledger_states``)."""


class ByName:
    """The entries of a vector by the names of the equations, read on access; ``reads`` has the places of those that were."""

    def __init__(self, entries: Sequence[Any], values: Values) -> None:
        self._places = {entry.attribute: place for place, entry in enumerate(entries)}
        self._values = values
        self.reads: set[int] = set()

    def __getattr__(self, name: str) -> Any:
        try:
            place = self._places[name]
        except KeyError:
            raise AttributeError(name) from None
        self.reads.add(place)
        return self._values[place]


@dataclass(frozen=True, eq=False)
class Accounts:
    """Everything that turns states and controls of a step into its quantities."""

    source: str
    """The task's file, for messages."""
    model: Model
    ledger: Ledger
    """``model`` and ``ledger``: what flows, and what that is worth."""
    parameters: Any
    """Nominal parameters, a record of the model's."""
    step_seconds: float
    """Length of the control step [s]."""
    names: tuple[str, ...]
    """Names of all quantities of a step, in order."""
    limits: tuple[tuple[str, float, float, tuple[float, float]], ...]
    """Name, low, high and penalty scales, below and above, of each constrained quantity of the air."""
    means: bool = False
    """Whether a violation is the mean over the step, by the meters of the model; else that at the end of the step."""
    stated_bounds: tuple[float, float] | None = None
    """Profit of a step that counts as 0 and as 1, where the task states them [EUR m-2]."""
    scheduled_places: Sequence[int] = ()
    """Places of scheduled controls, whose changes are no travel."""

    @cached_property
    def flows(self) -> Mapping[str, Flow]:
        """The model's flows by name."""
        return {flow.name: flow for flow in self.model.flows()}

    @cached_property
    def stocks(self) -> Mapping[str, Stock]:
        """The model's stocks by name."""
        return {stock.name: stock for stock in self.model.stocks()}

    @property
    def price_tables(self) -> tuple[str, ...]:
        """Names of the prices that change with the calendar: what ``prices`` of ``of_step`` are, in this order."""
        return self.ledger.price_tables

    @cached_property
    def full_use(self) -> Floats:
        """Amounts paid for in a step with all controls at 1, by the ledger. Raises ``TaskError`` when one depends on more than these."""
        step = self._step(0.0, 1.0)
        amounts = [self._amount(item, step) for item in self.ledger.paid]
        if step.before.reads | step.after.reads:
            reason = "what is paid does not follow from the controls alone"
            raise self._no_bounds(reason)
        return _frozen(amounts)

    @property
    def unit_costs(self) -> Floats:
        """Prices of what is paid for, in the order of the ledger; TaskError where one changes with the calendar."""
        return _frozen(self._worth(self.ledger.paid, np.ones(len(self.ledger.paid))))

    @cached_property
    def full_growth(self) -> Floats:
        """Amounts earned in a step at the model's potential rates, by the ledger. Raises ``TaskError`` when one has no potential."""
        step, amounts = self._step(0.0, 1.0), []
        for item in self.ledger.earned:
            potential = self.flows[item.flow].potential if item.valued != STOCK else None
            if potential is None:
                reason = f"{self.model.id} states no potential rate of what '{item.name}' earns"
                raise self._no_bounds(reason)
            amounts.append(_times(potential(step), item.factor))
        return _frozen(amounts)

    @cached_property
    def lowest_epi(self) -> float:
        """Profit of a step that counts as 0 [EUR m-2]: every control at 1 and nothing earned, unless the task states another."""
        if self.stated_bounds is not None:
            return self.stated_bounds[0]
        return -float(sum(self._worth(self.ledger.paid, self.full_use)))

    @cached_property
    def highest_epi(self) -> float:
        """Profit of a step that counts as 1 [EUR m-2]: potential growth and nothing paid, unless the task states another."""
        if self.stated_bounds is not None:
            return self.stated_bounds[1]
        return float(sum(self._worth(self.ledger.earned, self.full_growth)))

    def quantities(
        self,
        before: Floats,
        after: Floats,
        controls: Floats,
        air: Floats,
        prices: Floats | None = None,
        later: Floats | None = None,
        controls_before: Floats | None = None,
    ) -> Floats:
        """All quantities of a step but the reward, which stays 0; rows as ``names``, shape ``(quantities, n)``.

        ``before`` and ``after`` are the states at the start and at the end of the step, ``(n, states)``; ``controls`` those during it,
        fractions, ``(n, controls)``; ``air`` its temperature, CO2 and relative humidity at the end, ``(3, n)``; ``prices`` and ``later``
        the prices of this and the next step, ``(n, price_tables)``; ``controls_before`` those before the step, by default those during it.
        """
        now = () if prices is None else prices.T
        previous = controls if controls_before is None else controls_before
        rows = self.of_step(before.T, after.T, controls.T, air, now, now if later is None else later.T, previous.T)
        table = np.zeros((len(self.names), len(after)))
        for row, name in enumerate(self.names):
            if name in rows:
                table[row] = rows[name]
        return table

    def of_step(
        self,
        before: Values,
        after: Values,
        controls: Values,
        air: Values,
        prices: Values = (),
        later: Values = (),
        controls_before: Values | None = None,
    ) -> dict[str, Any]:
        """The same by name, from and as arrays ``(n,)`` or values recorded for the compiled kernel.

        ``before``, ``after`` and ``controls`` are indexed by the places of the model's states and controls, and only where the ledger needs
        one; ``prices`` (of this step) and ``later`` (of the next) by those of ``price_tables``.
        """
        step = self._record(before, after, controls, controls if controls_before is None else controls_before)
        money: dict[str, Any] = {}
        amounts: dict[str, Any] = {}
        profit: Any = None
        for item in (*self.ledger.earned, *self.ledger.paid):
            amount = amounts[item.amount] = self._amount(item, step)
            now, then = self._price(item, prices), self._price(item, later)
            if item.valued == STOCK and isinstance(item.price, str):
                start, end = (_times(self._stock(item, record), item.factor) for record in (step.before, step.after))
                worth = end * then - start * now
            else:
                worth = amount * now
            if item.beyond is not None:
                total = self.flows[item.flow].total
                assert total is not None
                start, end = (
                    np.maximum(_times(total(record), item.factor) - item.beyond.amount, 0.0) for record in (step.before, step.after)
                )
                worth = worth + (end - start) * (item.beyond.price - now)
            money[item.name] = worth
            if profit is None:
                profit = worth if item.sign > 0 else -worth
            elif item.sign > 0:
                profit = profit + worth
            else:
                profit = profit - worth
        quantities = {"epi": 0.0 if profit is None else profit, **money, **amounts, **self._violations(before, after, air)}
        if controls_before is not None and TRAVEL in self.names:
            travel: Any = 0.0
            for place, (previous, control) in enumerate(zip(controls_before, controls, strict=True)):
                if place not in self.scheduled_places:
                    # A pair of a larger and a smaller value, because a tape knows no absolute value.
                    travel = travel + (np.maximum(previous, control) - np.minimum(previous, control))
            quantities[TRAVEL] = travel
        return quantities

    def ledger_states(self) -> tuple[int, ...]:
        """Places of the states that the ledger depends on, and of the meters of violations."""
        step = self._step(1.0, 1.0)
        for item in self.ledger.items:
            self._amount(item, step)
        return tuple(sorted(step.before.reads | step.after.reads | {*self._meters.values()}))

    @cached_property
    def _meters(self) -> Mapping[tuple[str, Side], int]:
        """Places of the meters of violations, by quantity and side."""
        if not self.means:
            return {}
        limited = [(name, side) for name, *_ in self.limits for side in SIDES]
        return {(name, side): self.model.state_index(violation_meter(name, side)) for name, side in limited}

    def _record(self, before: Values, after: Values, controls: Values, controls_before: Values) -> Step:
        states, names = self.model.states, self.model.controls
        return Step(
            ByName(states, before), ByName(states, after), ByName(names, controls), self.parameters, self.step_seconds,
            ByName(names, controls_before),
        )  # fmt: skip

    def _step(self, state: float, control: float) -> Step:
        states, controls = [state] * len(self.model.states), [control] * len(self.model.controls)
        return self._record(states, states, controls, controls)

    def _amount(self, item: LedgerItem, step: Step) -> Any:
        if item.valued == STOCK:
            return _times(self._stock(item, step.after) - self._stock(item, step.before), item.factor)
        return _times(self.flows[item.flow].amount(step), item.factor)

    def _stock(self, item: LedgerItem, record: ByName) -> Any:
        return self.stocks[item.flow].amount(record, self.parameters)

    def _price(self, item: LedgerItem, prices: Values) -> Any:
        return prices[self.price_tables.index(item.price)] if isinstance(item.price, str) else item.price

    def _worth(self, items: tuple[LedgerItem, ...], amounts: Floats) -> list[float]:
        for item in items:
            if isinstance(item.price, str):
                reason = f"the price of '{item.name}' changes with the calendar"
                raise self._no_bounds(reason)
        return [amount * item.price for amount, item in zip(amounts.tolist(), items, strict=True)]

    def _no_bounds(self, reason: str) -> TaskError:
        msg = (
            f"{self.source}: [reward] 'scaled_epi' needs a profit that counts as 0 and one that counts as 1, and {reason}. "
            'State them: epi_scale = { low = -0.01, high = 0.01, unit = "EUR m-2" }.'
        )
        return TaskError(msg)

    def _violations(self, before: Values, after: Values, air: Values) -> dict[str, Any]:
        """Penalty, violations, and the hours they lasted."""
        places = {name: place for place, name in enumerate(LIMITED)}
        hours = self.step_seconds / 3600.0
        violations: dict[str, Any] = {}
        penalty: Any = None
        for name, low, high, scales in self.limits:
            if self.means:
                # The mean over the step; an integrator may leave a meter below 0 by its error.
                meters = (self._meters[name, side] for side in SIDES)
                below, above = (np.maximum(after[meter] - before[meter], 0.0) / self.step_seconds for meter in meters)
            else:
                value = air[places[name]]
                below, above = np.maximum(low - value, 0.0), np.maximum(value - high, 0.0)
            for side, violation in (("low", below), ("high", above)):
                violations[f"violation_{name}_{side}"] = violation
                violations[f"hours_outside_{name}_{side}"] = np.sign(violation) * hours
            share = (below + above) / scales[0] if scales[0] == scales[1] else below / scales[0] + above / scales[1]
            penalty = share if penalty is None else penalty + share
        return {"penalty": 0.0 if penalty is None else penalty, **violations}


def make_accounts(task: TaskSpec) -> Accounts:
    """Accounts of a task, from its model, nominal parameters, ledger and constraints."""
    model, scales, hours = task.model_value, task.penalty_scales, task.step_seconds / 3600.0
    lower = {name: 1.0 / (price * hours) for name, price in task.lower_prices.items()}
    bounds = getattr(task.reward, "epi_scale", None)
    return Accounts(
        source=task.source,
        model=model,
        ledger=task.ledger,
        parameters=model.Parameters(*task.parameters().tolist()),
        step_seconds=task.step_seconds,
        names=tuple(quantity.name for quantity in task.quantities),
        limits=tuple(
            (name, limits.low, limits.high, (lower.get(name, scales[name]), scales[name])) for name, limits in task.constraints.items()
        ),
        means=task.judges_means,
        stated_bounds=None if bounds is None else (bounds.low, bounds.high),
        scheduled_places=tuple(task.scheduled_places.values()),
    )


def flow_amounts(task: TaskSpec, names: Collection[str], x: NDArray[np.floating], u: NDArray[np.floating]) -> dict[str, Floats]:
    """Amounts of the flows ``names`` of the task's model in every step, each as ``u`` without its last axis.

    Model and nominal parameters are those of ``task``; names that its model does not have are left out. ``x`` are states
    ``(steps + 1, ..., states)``, the start included, ``u`` controls ``(steps, ..., controls)``.
    """
    model = task.model_value
    controls_before = np.concatenate([np.broadcast_to(task.initial_controls, u[:1].shape), u[:-1]])
    step = Step(
        before=model.State(*np.moveaxis(x[:-1], -1, 0)),
        after=model.State(*np.moveaxis(x[1:], -1, 0)),
        controls=model.Controls(*np.moveaxis(u, -1, 0)),
        parameters=model.Parameters(*task.parameters().tolist()),
        seconds=task.step_seconds,
        controls_before=model.Controls(*np.moveaxis(controls_before, -1, 0)),
    )
    return {
        flow.name: np.broadcast_to(np.asarray(flow.amount(step), dtype=np.float64), u.shape[:-1])
        for flow in model.flows()
        if flow.name in names
    }


def _times(value: Any, factor: float) -> Any:
    return value if factor == 1.0 else value * factor


def _frozen(values: list[float]) -> Floats:
    column = np.array(values, dtype=np.float64)
    column.flags.writeable = False
    return column
