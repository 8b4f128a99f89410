"""Leaf pruning and fruit harvest. Source: Vanthoor (2011) eqs 9.47 and B.5, Katzin (2021) eq. 7.45."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from glbench.model.expressions import Expr, sigmoid
from glbench.model.parameters import TomatoParameters
from glbench.model.quantities import Quantity
from glbench.model.states import TomatoState
from glbench.model.variants import Variant

TRANSITION_WIDTH = 1e4
"""Mass over which harvest sets in [mg m-2]. Katzin (2021) p. 246."""

FRUIT_HARVEST_RATE = 5e4
"""Largest rate of fruit harvest [mg m-2 s-1]. Katzin (2021) eq. 7.45."""


class Harvest(NamedTuple):
    """Carbohydrates taken out of the greenhouse."""

    mc_leaf_har: Annotated[Expr, Quantity("mg m-2 s-1", "CH2O, leaves pruned")]
    mc_fruit_har: Annotated[Expr, Quantity("mg m-2 s-1", "CH2O, fruit harvested")]


def removal(mass: Expr, limit: Expr, rate: float, variant: Variant) -> Expr:
    """Removal [mg m-2 s-1]: ``rate`` far above the limit [mg m-2], half at it, 0 far below. Row 6: the published code rounds ln(100)."""
    return rate * sigmoid(2 * variant.harvest_logarithm * (mass - limit) / TRANSITION_WIDTH)


def harvest(x: TomatoState, p: TomatoParameters, variant: Variant) -> Harvest:
    """Leaf pruning and fruit harvest.

    Row 2: Vanthoor (2011) prints 5e4 mg m-2 s-1 for the largest rate of leaf pruning, as the published code has it; the
    author's data set of 2021 has 1e5.
    """
    return Harvest(
        mc_leaf_har=removal(x.c_leaf, p.c_leaf_max, variant.leaf_pruning_rate, variant),
        mc_fruit_har=removal(x.c_fruit, p.c_fruit_max, FRUIT_HARVEST_RATE, variant),
    )
