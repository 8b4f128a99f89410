"""Butterhead lettuce that is sold by weight class, and that a grower weighs in samples.

It is van Henten's lettuce (``VanHentenLettuce``) with two additions. What a head earns depends on its class, a continuous function of
its mass; the heads of a planting differ, so a planting earns the mean over them. And the crew weighs some heads now and then: between
two weighings nobody knows how heavy the crop is.

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

from glbench.model.balances import DAY
from glbench.model.bounds import Horizon
from glbench.model.crop.lettuce import LETTUCE_PARAMETERS, LettuceParameters, LettuceState, VanHentenLettuce, head_mass, start_state
from glbench.model.expressions import Expr
from glbench.model.greenhouse import record_of
from glbench.model.model import ObservedColumn, Signal, Stock
from glbench.model.parameter_table import Parameter, declared_table
from glbench.model.quantities import Quantity, Variable
from glbench.model.submodels import CropStart
from glbench.model.surroundings import Surroundings

PRICE_BY_MASS = {
    180.0: 0.0, 220.0: 0.39, 250.0: 0.46, 280.0: 0.54, 310.0: 0.62, 340.0: 0.70, 370.0: 0.79, 400.0: 0.88, 440.0: 1.0, 500.0: 1.1,
}  # fmt: skip
"""Price of a head of each fresh mass [g], relative to a head of 440 g [-]; linear in between, constant outside."""

MASS_OF_PRICE = 440.0
"""Fresh mass of the head that a ledger prices [g]."""

FIFTHS = (-1.4, -0.532, 0.0, 0.532, 1.4)
"""Mean of each fifth of a normal distribution, the lightest fifth of the heads first [standard deviations]."""

WEIGHING = 60.0
"""Time in which the reading of the scales follows the heads on them [s]; chosen, far below a control step."""

_HEAVIEST_SAMPLE = 4000.0  # g; the heaviest crop, and a sample that is twice as heavy


class CrewControls(NamedTuple):
    """Work by hand. A task schedules it."""

    u_weigh: Annotated[Expr, Quantity("-", "crew weighs a sample of heads")]


class _Sample(NamedTuple):
    sample_mass: Annotated[Expr, Variable("g", "mean fresh mass of the heads in the last sample", scale=100.0, small=0.1)]
    sample_age: Annotated[Expr, Variable("day", "time since the last sample", scale=1.0, small=1e-3)]


class _OwnParameters(NamedTuple):
    cv_head: Annotated[Expr, Parameter("-", "coefficient of variation of the mass of the heads in a planting", 0.15, "chosen", "fraction")]
    sample_share: Annotated[
        Expr, Parameter("-", "mean mass of the heads in a sample relative to all heads; a task draws it daily", 1.0, check="positive")
    ]


ButterheadState = record_of("ButterheadState", (LettuceState, _Sample))
"""State of the crop; also used for its time derivative."""

ButterheadParameters = record_of("ButterheadParameters", (LettuceParameters, _OwnParameters))
"""Parameters of the crop."""


@dataclass(frozen=True)
class Butterhead(VanHentenLettuce):
    """Lettuce that is sold by weight class and weighed in samples."""

    name: ClassVar[str] = "butterhead"
    State: ClassVar[Any] = ButterheadState
    Controls: ClassVar[type[CrewControls]] = CrewControls
    Parameters: ClassVar[Any] = ButterheadParameters
    table = (*LETTUCE_PARAMETERS, *declared_table(ButterheadParameters))
    observation_modules: ClassVar[Mapping[str, str]] = {
        **VanHentenLettuce.observation_modules,
        "registration": "what a crop registration has: mean mass of the heads last weighed, days since",
    }

    def rates(self, x: Any, s: Surroundings, fluxes: Any, p: Any) -> Any:
        grown = super().rates(x, s, fluxes, p)
        on_scales = s.u.u_weigh / WEIGHING
        return ButterheadState(
            *grown,
            sample_mass=on_scales * (p.sample_share * head_mass(x, p) - x.sample_mass),
            sample_age=1 / DAY - on_scales * x.sample_age,
        )

    def starts(self) -> Mapping[str, CropStart]:
        return {"young_lettuce": _young}

    def stocks(self) -> tuple[Stock, ...]:
        of_price = f"{MASS_OF_PRICE:g} g"
        meaning = f"heads, each counted by its price relative to a head of {of_price}"
        return (*super().stocks(), Stock("priced_heads", "m-2", meaning, "Heads", priced_heads))

    def signals(self) -> tuple[Signal, ...]:
        return (*super().signals(), Signal("crop/sample", "Fresh mass of a head, last sample", "g", "sampleMass"))

    def bounds(self, horizon: Horizon) -> Mapping[str, tuple[float, float]]:
        days = horizon.days + 1.0
        return {**super().bounds(horizon), "sampleMass": (-10.0, _HEAVIEST_SAMPLE), "sampleAge": (-1e-3, days)}

    def observed(self, module: str, horizon: Horizon) -> tuple[ObservedColumn, ...] | None:
        if module != "registration":
            return super().observed(module, horizon)
        bounds = self.bounds(horizon)
        mass = ObservedColumn("sample_mass", "g", "mean fresh mass of the heads in the last sample", "sampleMass", *bounds["sampleMass"])
        return (mass, ObservedColumn("sample_age", "day", "time since the last sample", "sampleAge", *bounds["sampleAge"]))


def relative_price(head: Any) -> Expr:
    """Price of a head of fresh mass ``head`` [g], relative to a head of 440 g [-]."""
    masses, prices = list(PRICE_BY_MASS), list(PRICE_BY_MASS.values())
    steps = zip(masses, masses[1:], prices, prices[1:], strict=False)
    return sum(
        (dearer - price) * np.minimum(np.maximum((head - mass) / (heavier - mass), 0.0), 1.0) for mass, heavier, price, dearer in steps
    )


def priced_heads(x: Any, p: Any) -> Expr:
    """Heads per floor area, each counted by its relative price [m-2]: the mean over five groups of a normal distribution of masses."""
    mean = head_mass(x, p)
    return p.n_head / len(FIFTHS) * sum(relative_price(mean * (1 + p.cv_head * deviation)) for deviation in FIFTHS)


def _young(air_temperature: float, p: Any) -> Any:
    planted = start_state(p)
    return ButterheadState(*planted, sample_mass=head_mass(planted, p), sample_age=0.0)
