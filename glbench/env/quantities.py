"""What is measured in every control step of a task of schema 1, with units: the table behind ``StepResult.quantities`` and ``info``.

The quantities of any task are ``task.quantities``: they follow from its ledger and its constraints. The first two are the same for all.
"""

from __future__ import annotations

from glbench.tasks.ledger import LIMITED, StepQuantity, step_quantities
from glbench.tasks.schema1 import paper_v1
from glbench.tasks.tables import PricesTable

_PAPER = paper_v1(
    PricesTable.model_construct(
        fruit=1.0, dry_matter_content=1.0, co2=1.0, heat=1.0, electricity=1.0
    )  # names, not prices
)

QUANTITIES: tuple[StepQuantity, ...] = step_quantities(_PAPER, LIMITED)
QUANTITY_NAMES: tuple[str, ...] = tuple(quantity.name for quantity in QUANTITIES)

REWARD, EPI = 0, 1
"""Rows of every task's table: the reward and the profit."""
PENALTY = QUANTITY_NAMES.index("penalty")
"""Row of the penalty in a table of ``QUANTITIES``."""

__all__ = ["EPI", "PENALTY", "QUANTITIES", "QUANTITY_NAMES", "REWARD", "StepQuantity"]
