"""Butterhead lettuce that a crew cuts on a day of the agent's choice, and plants again.

It is ``Butterhead`` with one more control. While ``u_harvest`` is 1, a crew is at work: it cuts all heads within minutes, clears the beds,
and leaves young plants behind. The heads earn what a buyer pays who takes one size: a head of 310 to 430 g earns the full price, a lighter
one less, and a heavier one, which does not fit the box and begins to bolt, less again. How long the crew works is for
the task to say (``[actuation.on_off.uHarvest]``).

Equations. Cutting moves the states to those of young plants, at the rate ``CUTTING u_harvest``. Of what stands at the start of a step, the
share ``1 - exp(-CUTTING u_harvest t)`` is cut by its end, and sold as it stood at the start. Plants that nobody cuts have a value of their
own: what somebody pays who takes over the house. It rises by about as much every day until the heads are ready, so that a season that ends
between two harvests loses nothing by that.

Sources: 60 ct for heads of 400 to 450 g at BelOrta (Hortidaily, BelOrta sees area shift from butter lettuce to alternative varieties); a
normal head weighs 300 g, in dim spring only 220 to 230 g, and one that stands longer gets weak leaves and rot (Be Fresh Produce, Why does
the weight of lettuce fluctuate). The edges of the size, the prices outside of it and the value of standing plants are chosen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, NamedTuple

from glbench.model.balances import DAY
from glbench.model.bounds import Horizon
from glbench.model.crop.butterhead import Butterhead, ButterheadParameters, mean_over_heads, relative_price
from glbench.model.crop.lettuce import AT_FULL_PRICE, LETTUCE_PARAMETERS, YOUNG_HEAD, Fluxes, LettuceState, head_mass, start_state
from glbench.model.expressions import Expr, exp, fmax, fmin
from glbench.model.greenhouse import record_of
from glbench.model.model import Flow, ObservedColumn, Signal, Step, Stock
from glbench.model.parameter_table import Parameter, declared_table
from glbench.model.quantities import Quantity, Variable
from glbench.model.submodels import CropStart
from glbench.model.surroundings import Surroundings

CUTTING = 1 / 60
"""Rate at which a crew at work cuts [s-1]: all but a third of a millionth within a quarter of an hour; chosen."""

AT_WORK = 0.01
"""Plants are younger than this while a crew is at work [day]."""

SIZES = {200.0: 0.0, 250.0: 0.4, 290.0: 0.6, 310.0: 1.0, 430.0: 1.0, 470.0: 0.6, 600.0: 0.4, 800.0: 0.2}
"""Price of a head that is cut, by fresh mass [g], relative to one of the full price [-]; linear in between, constant outside."""

STANDING = {0.0: 0.0, 3.0: 0.12, 30.0: 0.3, 100.0: 0.55, 200.0: 0.78, 300.0: 0.88, 350.0: 0.9, 400.0: 0.85, 450.0: 0.55, 800.0: 0.15}
"""Value of a plant that stands [-], likewise, by the mean mass of a planting [g]."""


class HarvestControls(NamedTuple):
    """Work by hand."""

    u_harvest: Annotated[Expr, Quantity("-", "crew at work: cuts all heads and sets young plants")]


class _Age(NamedTuple):
    planting_days: Annotated[Expr, Variable("day", "time since the plants were set", scale=10.0, small=0.01)]


HarvestState = record_of("HarvestState", (LettuceState, _Age))
"""State of the crop; also used for its time derivative."""


class _OwnParameters(NamedTuple):
    young_head: Annotated[Expr, Parameter("g", "fresh mass of a young plant when it is set", YOUNG_HEAD, "chosen", "positive", "planting")]


HarvestParameters = record_of("HarvestParameters", (ButterheadParameters, _OwnParameters))
"""Parameters of the crop."""


@dataclass(frozen=True)
class HarvestedButterhead(Butterhead):
    """Lettuce that is cut and planted again when the crew is called."""

    name: ClassVar[str] = "harvested_butterhead"
    State: ClassVar[type[Any]] = HarvestState
    Controls: ClassVar[type[HarvestControls]] = HarvestControls
    Parameters: ClassVar[type[Any]] = HarvestParameters
    table = (*LETTUCE_PARAMETERS, *declared_table(HarvestParameters))
    observation_modules: ClassVar[Mapping[str, str]] = {**Butterhead.observation_modules, "planting": "days since the plants were set"}

    def rates(self, x: Any, s: Surroundings, fluxes: Fluxes, p: Any) -> Any:
        cutting, young, grown = CUTTING * s.u.u_harvest, start_state(p, p.young_head), super().rates(x, s, fluxes, p)
        return HarvestState(
            x_n=grown.x_n + cutting * (young.x_n - x.x_n),
            x_s=grown.x_s + cutting * (young.x_s - x.x_s),
            planting_days=1 / DAY - cutting * x.planting_days,
        )

    def starts(self) -> Mapping[str, CropStart]:
        return {"young_lettuce": lambda air_temperature, p: HarvestState(*start_state(p, p.young_head), 0.0)}

    def flows(self) -> tuple[Flow, ...]:
        by_price = "heads cut, each counted by its price relative to the full one"
        heads = Flow("heads_cut", "m-2", by_price, "Heads", _heads_cut, counted=AT_FULL_PRICE)
        return (*super().flows(), heads, Flow("plants_set", "m-2", "young plants set after a harvest", "Young plants", _plants_set))

    def stocks(self) -> tuple[Stock, ...]:
        meaning = "plants that stand, counted by the value of one of mean mass relative to a head of the full price"
        return (*super().stocks(), Stock("standing_heads", "m-2", meaning, "Standing plants", standing_heads, AT_FULL_PRICE))

    def bounds(self, horizon: Horizon) -> Mapping[str, tuple[float, float]]:
        return {**super().bounds(horizon), "plantingDays": (-0.01, horizon.days * (1.0 + 1e-6))}

    def observed(self, module: str, horizon: Horizon) -> tuple[ObservedColumn, ...] | None:
        if module != "planting":
            return super().observed(module, horizon)
        low, high = self.bounds(horizon)["plantingDays"]
        return (ObservedColumn("days_since_planting", "day", "time since the plants were set", "plantingDays", low, high),)

    def signals(self) -> tuple[Signal, ...]:
        return (
            *super().signals(),
            Signal("crop/planting_days", "Time since planting", "d", "plantingDays"),
            Signal("controls/harvest", "Crew at work", "%", "uHarvest", 100.0),
        )


def standing_heads(x: Any, p: Any) -> Expr:
    """Plants per floor area, all counted by the relative value of one of mean mass [m-2]."""
    return p.n_head * relative_price(head_mass(x, p), STANDING)


def _share_cut(step: Step) -> Expr:
    """Share of what stood at the start of a step that is cut in it [-]."""
    return 1 - exp(-CUTTING * step.seconds * step.controls.u_harvest)


def _heads_cut(step: Step) -> Expr:
    """Heads cut, counted by their relative price [m-2]."""
    p = step.parameters
    return _share_cut(step) * mean_over_heads(head_mass(step.before, p), SIZES, p)


def _plants_set(step: Step) -> Expr:
    """Young plants set [m-2]: all of them when plants of a day or more are cut, none while a crew goes on working."""
    older = fmin(fmax(step.before.planting_days - AT_WORK, 0.0), 1.0)
    return _share_cut(step) * older * step.parameters.n_head
