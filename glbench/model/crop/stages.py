"""Fruits in stages: set, development, growth, abortion and ripening of the fruits on the plants, counted and weighed in each stage.

Vanthoor (2011) sends the fruits of a day through a train of ``n`` stages, each left at the rate ``n`` times the development rate, so that
fruits set on one day ripen over several weeks: an Erlang distribution. He took 50 stages. ``STAGES`` is the least number with which the
days when 10, 50 and 90 % of a day's fruits are ripe stay within 5 % of those of 50 stages (4.8 % early, 0.3 % early and 3.7 % late).

Sources. Stages, set and growth: Vanthoor (2011) section 9.5 and appendix B after de Koning (1994), Development and dry matter
distribution in glasshouse tomato, whose growth curve of a fruit is a Gompertz function of its age. We took these equations from quotations
of the electronic appendix of Vanthoor et al. (2011), and from three public programs, which agree. Heat and cold at flowering, and the
abortion of young fruits: see the parameters. A crop with few fruits takes less than Vanthoor's flow: after Heuvelink (1997).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, NamedTuple

from glbench.model.balances import DAY
from glbench.model.expressions import Expr, exp, fmax, sigmoid
from glbench.model.quantities import Quantity

STAGES = 33
"""Number of stages of a fruit from set to ripe."""

YOUNG_STAGES = 7
"""Stages in which a fruit can abort: the first fifth of its life, 11 days at 20 °C."""

SLOWEST = 0.01
"""Slowest development, in hundredths of a fruit's life a day; reached at 0.8 °C. Chosen, so that a life stays finite."""

CARBON_THRESHOLD = 0.05
"""Carbohydrate that flows to the fruit at half of the largest set [mg m-2 s-1]. Vanthoor (2011) eq. B.4."""

CARBON_SLOPE = 58.9
"""Steepness of the fruit set around that flow [m2 s mg-1]. Vanthoor (2011) eq. B.4."""

EMPTY_LOAD = 2.96 / 9
"""Fruit load, relative to one that takes all of Vanthoor's flow, whose sink equals that of leaves and stems [-]. Heuvelink (1997): n fruits
on a truss take n / (2.96 + n) of the dry matter; Vanthoor's flow is taken as that of trusses of nine."""

NO_FRUIT = 1e-9
"""Added to each mass or sink that is a divisor: a crop without fruit divides by this instead of 0."""

Stages = Sequence[Expr]
"""A value for each stage, from set to ripe."""


class FruitGrowthCurve(NamedTuple):
    """Carbohydrate of a fruit, and its gain, in the middle of each stage when supply is ample."""

    weight: Stages
    """[mg]."""
    growth: Stages
    """[mg day-1]."""


class FruitSet(NamedTuple):
    """Flowers that become fruits."""

    h_set_heat: Annotated[Expr, Quantity("-", "fruit set in the heat, 1 = not inhibited")]
    h_set_cold: Annotated[Expr, Quantity("-", "fruit set in the cold, 1 = not inhibited")]
    mn_fruit_set: Annotated[Expr, Quantity("m-2 s-1", "fruits set")]


class FruitFlows(NamedTuple):
    """Carbohydrate of the fruits on the plants."""

    green_share: Annotated[Expr, Quantity("-", "carbohydrate in unripe fruit over that of the stages: 1 unless a task draws the fruit")]
    sink_load: Annotated[Expr, Quantity("-", "fruit load at 20 °C, 1 = takes all of Vanthoor's flow")]
    mc_set_fruit: Annotated[Expr, Quantity("mg m-2 s-1", "CH2O, buffer to fruits as they are set")]
    mc_grow_fruit: Annotated[Expr, Quantity("mg m-2 s-1", "CH2O, buffer to fruits that were set before")]
    mc_fruit_ripe: Annotated[Expr, Quantity("mg m-2 s-1", "CH2O, last stage to ripe fruit")]
    mc_fruit_abort: Annotated[Expr, Quantity("mg m-2 s-1", "CH2O, aborted fruits")]
    mc_fruit_rot: Annotated[Expr, Quantity("mg m-2 s-1", "CH2O, rotten fruits")]
    mc_fruit_har: Annotated[Expr, Quantity("mg m-2 s-1", "CH2O, fruit harvested")]


def development_rate(t_can24: Expr) -> Expr:
    """Share of a fruit's life that passes in a day [day-1] at a daily mean temperature [°C]. Vanthoor (2011) eq. 9.30, de Koning (1994)."""
    return fmax(0.1 * t_can24 - 0.066, SLOWEST) / 100


def stage_rate(t_can24: Expr) -> Expr:
    """Rate at which a fruit leaves its stage [s-1]. Vanthoor (2011) eq. 9.31."""
    return STAGES / DAY * development_rate(t_can24)


def growth_curve(t_can24: Expr, g_max: Expr) -> FruitGrowthCurve:
    """Gompertz curve of a fruit that can weigh ``g_max`` [mg], with de Koning's inflexion and steepness. Vanthoor (2011) eqs 9.37-9.39.

    Age is counted in lives, so that nothing is divided by a development rate: de Koning's inflexion is ``0.548 life - 4.93 day``, his
    steepness ``1 / (2.44 day + 0.403 inflexion)``. From one stage to the next the inner exponential changes by a constant factor.
    """
    rate = development_rate(t_can24)
    steepness = 1 / ((2.44 - 0.403 * 4.93) * rate + 0.403 * 0.548)
    inner = exp(steepness * (0.548 - 4.93 * rate - 0.5 / STAGES))
    factor = exp(-steepness / STAGES)
    weight, growth = [], []
    for _ in range(STAGES):
        weight.append(g_max * exp(-inner))
        growth.append(weight[-1] * inner * (steepness * rate))
        inner = inner * factor
    return FruitGrowthCurve(weight, growth)


def total(stages: Stages) -> Expr:
    """Sum over stages."""
    value = stages[0]
    for stage in stages[1:]:
        value = value + stage
    return value


def sink_strength(number: Stages, growth: Stages) -> Expr:
    """What the fruits would gain if supply were ample [mg m-2 day-1]; those in the first stage gain nothing. Vanthoor (2011) eq. 9.35."""
    return total([n * g for n, g in zip(number[1:], growth[1:], strict=True)])


def load_factor(load: Expr) -> Expr:
    """Share of Vanthoor's flow that the fruits take at a load: 0 without fruit, 1 at a load of 1, up to a third more beyond."""
    return load * (1 + EMPTY_LOAD) / (load + EMPTY_LOAD)


def set_by_carbohydrate(supply: Expr) -> Expr:
    """Share of the largest set at a flow of carbohydrate to the fruit [mg m-2 s-1]. Vanthoor (2011) eq. B.4."""
    return sigmoid(CARBON_SLOPE * (supply - CARBON_THRESHOLD))
