"""The ledger of a task: what is earned and paid in a control step, and every quantity of a step that follows from it.

An item prices a flow of the model (heat, fruit harvested), or counts the value of a stock (fruit on the plants) at the end of the episode
minus that at its start. Money columns, amounts, profit and a step's quantities are generated from items: a new cost is one item.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from glbench.quantities import AIR, MONEY, OUTSIDE, STEP, VIOLATION

FLOW: Literal["when it flows"] = "when it flows"
STOCK: Literal["as stock"] = "as stock"
LIMITED = {name: entry.unit for name, entry in AIR.items()}
"""Quantities of the main air that a task can constrain, with the unit their limits are written in."""

VIOLATION_PRICES = {name: f"{MONEY} {unit}-1 h-1" for name, unit in LIMITED.items()}
"""Units of the prices of violations."""
TRAVEL = "actuator_travel"


@dataclass(frozen=True)
class StepQuantity:
    """One quantity of a control step."""

    name: str
    unit: str
    meaning: str


@dataclass(frozen=True)
class Beyond:
    """Another price for what flows when ``amount`` has flowed since the start, both in the units of the item."""

    amount: float
    price: float


@dataclass(frozen=True)
class LedgerItem:
    """One line of a ledger."""

    name: str
    """The money column: ``revenue``, ``cost_heat``."""
    flow: str
    """Name of a flow of the model; of one of its stocks, where that is valued."""
    amount: str
    amount_unit: str
    """``amount`` and ``amount_unit``: the amount column: ``fruit_fresh`` [kg m-2]."""
    factor: float
    """From the unit of the flow to that of the amount."""
    price: float | str
    """EUR per unit of the amount, or the name of a price table."""
    sign: Literal[1, -1]
    """+1: earned; -1: paid."""
    unit: str = MONEY
    """Of the money column."""
    label: str = ""
    """Heading in tables and plots."""
    valued: Literal["when it flows", "as stock"] = FLOW
    """``"when it flows"``; or ``"as stock"``: what is there at the end minus what was there at the start, each at the price of its moment.
    Step by step that is the value after the step at the next step's price, minus the value before it at this step's."""
    meaning: str = ""
    amount_meaning: str = ""
    """``meaning`` and ``amount_meaning``: the two columns in words."""
    amount_label: str = ""
    """Heading of the amount in plots, where it is not ``label``."""
    goods: str = ""
    """What the price is of, in words, where it is not ``label``."""
    counted: str = ""
    """Words that follow ``label`` in headings, such as "at full price"."""
    beyond: Beyond | None = None
    """Price of the rest when much has flowed; only with a flow that is metered and a price that is a number."""

    @property
    def price_unit(self) -> str:
        """Unit of the price: ``EUR kg-1`` for amounts in kg m-2, ``EUR m-2 h-1`` for hours, ``EUR`` for counted events."""
        from glbench.model.units import parse_unit  # here: an agent's process reads cards without the model

        amount = parse_unit(self.amount_unit)
        money = {"EUR": 1.0, "m": -2.0 - amount.pop("m", 0.0)}
        exponents = money | {symbol: -exponent for symbol, exponent in amount.items()}
        return " ".join(symbol if exponent == 1.0 else f"{symbol}{exponent:g}" for symbol, exponent in exponents.items() if exponent)


@dataclass(frozen=True)
class Ledger:
    """What a task earns and pays. ``meaning`` says what the profit (``epi``) is."""

    items: tuple[LedgerItem, ...]
    meaning: str = ""

    @property
    def earned(self) -> tuple[LedgerItem, ...]:
        """Items that are earned."""
        return tuple(item for item in self.items if item.sign > 0)

    @property
    def paid(self) -> tuple[LedgerItem, ...]:
        """Items that are paid."""
        return tuple(item for item in self.items if item.sign < 0)

    def lines(self) -> tuple[str, ...]:
        """The items in words, one line each: what, at which price, of what."""
        return tuple(
            f"{'+' if item.sign > 0 else '-'} {item.name}: {item.amount_meaning or item.label} [{item.amount_unit}] x "
            + (f"the price '{item.price}'" if isinstance(item.price, str) else f"{item.price:g} {item.price_unit}")
            + (f", {item.beyond.price:g} {item.price_unit} beyond {item.beyond.amount:g} {item.amount_unit}" if item.beyond else "")
            + (", valued at the end minus at the start" if item.valued == STOCK else "")
            for item in (*self.earned, *self.paid)
        )

    @property
    def price_tables(self) -> tuple[str, ...]:
        """Names of the price tables that the items use, each once, in the order of the items."""
        return tuple(dict.fromkeys(item.price for item in self.items if isinstance(item.price, str)))


def step_quantities(
    ledger: Ledger, limited: Iterable[str], *, means: bool = False, priced: bool = False, reward_unit: str = "-", extra: Iterable[str] = ()
) -> tuple[StepQuantity, ...]:
    """Every quantity of a step: reward, profit, money, penalty, amounts, violations of the limits and the hours they last.

    ``limited`` are the names of the constrained quantities. ``means``: their violations are means over the step, not what they are at
    its end; ``priced``: they cost money; ``extra`` are entries of the catalogue that are counted besides.
    """
    earned, paid, limited = ledger.earned, ledger.paid, tuple(limited)
    amounts = {item.amount: item for item in (*paid, *earned)}
    profit = ledger.meaning or "profit: " + " minus ".join(
        ", ".join(item.label.lower() or item.name for item in side) for side in (earned, paid) if side
    )
    sides = (("low", "below"), ("high", "above"))

    def of_catalogue(name: str, **words: str) -> StepQuantity:
        return StepQuantity(name, words.get("unit", STEP[name].unit), words.get("meaning", STEP[name].meaning))

    return (
        of_catalogue("reward", unit=reward_unit),
        StepQuantity("epi", MONEY, profit),
        *(StepQuantity(item.name, item.unit, _money_words(item)) for item in (*earned, *paid)),
        of_catalogue("penalty", **({key: STEP["penalty"].priced[key] for key in ("unit", "meaning")} if priced else {})),
        *(StepQuantity(name, item.amount_unit, item.amount_meaning or item.label) for name, item in amounts.items()),
        *map(of_catalogue, extra),
        *(
            StepQuantity(
                f"{VIOLATION}{name}_{side}",
                LIMITED[name],
                f"mean distance of the {AIR[name].meaning} {word} its limit in the step"
                if means
                else f"distance of the {AIR[name].meaning} {word} its limit at the end of the step",
            )
            for side, word in sides
            for name in limited
        ),
        *(
            StepQuantity(
                f"{OUTSIDE}{name}_{side}",
                "h",
                f"length of the step if the {AIR[name].meaning} is {word} its limit {'at some time of it' if means else 'at its end'}",
            )
            for side, word in sides
            for name in limited
        ),
    )


def _money_words(item: LedgerItem) -> str:
    if item.meaning:
        return item.meaning
    if item.valued == STOCK:
        return f"value gained: {item.label}"
    return f"{'paid for' if item.sign < 0 else 'earned with'}: {item.label}"
