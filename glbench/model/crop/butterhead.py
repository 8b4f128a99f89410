"""Butterhead lettuce that is sold by weight class.

It is van Henten's lettuce (``VanHentenLettuce``), and what a head earns depends on its class, a continuous function of its mass; the
heads of a planting differ, so a planting earns the mean over them. A task can have heads weighed in samples (``[samples.registration]``).

Source of the prices: Dutch and Belgian auctions class butterhead by the mass of a hundred heads [kg]. On 12 December 2018 a 44 fetched
0.81 EUR and a 37 0.64 EUR at BelOrta (G. Boonekamp, Markt: Kropsla doet het beter dan vorig jaar, Groenten & Fruit, December 2018). That
ratio is a price that rises with the mass to the power 1.36. The classes down to 22 follow this power. Below 18 nothing is sold, as in
``LIGHTEST_SOLD``; a 50 earns a tenth more than a 44. These two are chosen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np

from glbench.model.bounds import Horizon
from glbench.model.crop.lettuce import AT_FULL_PRICE, LARGEST_HEAD, LETTUCE_PARAMETERS, LettuceParameters, VanHentenLettuce, head_mass
from glbench.model.expressions import Expr
from glbench.model.greenhouse import record_of
from glbench.model.model import ObservedColumn, Stock
from glbench.model.parameter_table import Parameter, declared_table

PRICE_BY_MASS = {
    180.0: 0.0, 220.0: 0.39, 250.0: 0.46, 280.0: 0.54, 310.0: 0.62, 340.0: 0.70, 370.0: 0.79, 400.0: 0.88, 440.0: 1.0, 500.0: 1.1,
}  # fmt: skip
"""Price of a head of each fresh mass [g], relative to a head of 440 g [-]; linear in between, constant outside."""

MASS_OF_PRICE = 440.0
"""Fresh mass of the head that a ledger prices [g]."""

FIFTHS = (-1.4, -0.532, 0.0, 0.532, 1.4)
"""Mean of each fifth of a normal distribution, the lightest fifth of the heads first [standard deviations]."""


class _OwnParameters(NamedTuple):
    cv_head: Annotated[Expr, Parameter("-", "coefficient of variation of the mass of the heads in a planting", 0.15, "chosen", "fraction")]


ButterheadParameters = record_of("ButterheadParameters", (LettuceParameters, _OwnParameters))
"""Parameters of the crop."""


@dataclass(frozen=True)
class Butterhead(VanHentenLettuce):
    """Lettuce that is sold by weight class."""

    name: ClassVar[str] = "butterhead"
    Parameters: ClassVar[Any] = ButterheadParameters
    table = (*LETTUCE_PARAMETERS, *declared_table(ButterheadParameters))
    observation_modules: ClassVar[Mapping[str, str]] = {
        **VanHentenLettuce.observation_modules,
        "registration": "what a crop registration has: mean fresh mass of the heads",
    }

    def stocks(self) -> tuple[Stock, ...]:
        of_price = f"{MASS_OF_PRICE:g} g"
        meaning = f"heads, each counted by its price relative to a head of {of_price}"
        return (*super().stocks(), Stock("priced_heads", "m-2", meaning, "Heads", priced_heads, AT_FULL_PRICE))

    def observed(self, module: str, horizon: Horizon) -> tuple[ObservedColumn, ...] | None:
        if module != "registration":
            return super().observed(module, horizon)
        return (ObservedColumn("mean_head_mass", "g", "mean fresh mass of the heads", "head", -10.0, LARGEST_HEAD, of=head_mass),)


def relative_price(head: Any, prices: Mapping[float, float] = PRICE_BY_MASS) -> Expr:
    """Price of a head of fresh mass ``head`` [g] by ``prices`` of masses [g], the first of them 0 [-]; relative to a head of 440 g."""
    masses, worth = list(prices), list(prices.values())
    steps = zip(masses, masses[1:], worth, worth[1:], strict=False)
    return sum(
        (dearer - price) * np.minimum(np.maximum((head - mass) / (heavier - mass), 0.0), 1.0) for mass, heavier, price, dearer in steps
    )


def mean_over_heads(mean: Any, prices: Mapping[float, float], p: Any) -> Expr:
    """Heads per floor area [m-2], each counted by its price: of five groups of a normal distribution of masses around ``mean`` [g]."""
    return p.n_head / len(FIFTHS) * sum(relative_price(mean * (1 + p.cv_head * deviation), prices) for deviation in FIFTHS)


def priced_heads(x: Any, p: Any) -> Expr:
    """Heads per floor area, each counted by its relative price [m-2]."""
    return mean_over_heads(head_mass(x, p), PRICE_BY_MASS, p)
