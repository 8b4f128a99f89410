"""A model of two states, without air: something grows in the light and is watered."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, NamedTuple

from glbench.model import Capacity, Evaluation, Flow, Model, Stock
from glbench.model.bounds import Horizon
from glbench.model.model import ObservedColumn, Start
from glbench.model.parameter_table import ParameterInfo
from glbench.model.quantities import Quantity, Variable


class ToyState(NamedTuple):
    mass: Annotated[Any, Variable("kg m-2", "dry mass", scale=1.0, small=0.01)]
    water: Annotated[Any, Variable("kg m-2", "water in the soil", scale=10.0, small=0.1)]


class ToyControls(NamedTuple):
    u_tap: Annotated[Any, Quantity("-", "opening of the tap")]


class ToyParameters(NamedTuple):
    rate: Any
    tap: Any


class ToyFluxes(NamedTuple):
    growth: Annotated[Any, Quantity("kg m-2 s-1", "growth")]


def _parameter(name: str, unit: str, value: float) -> ParameterInfo:
    return ParameterInfo(name, name, unit, name, "made up", "toy", "positive", "", "yes", frozenset(), {"benchmark": value})


@dataclass(frozen=True)
class Toy(Model):
    State: ClassVar[type[Any]] = ToyState
    Controls: ClassVar[type[Any]] = ToyControls
    Parameters: ClassVar[type[Any]] = ToyParameters
    name: ClassVar[str] = "toy"
    version: ClassVar[str] = "1.0.0"
    table: ClassVar[tuple[ParameterInfo, ...]] = (_parameter("rate", "s-1", 1e-6), _parameter("tap", "kg m-2 s-1", 1e-3))

    def equations(self, x: Any, u: Any, d: Any, p: Any) -> Evaluation:
        growth = p.rate * x.water * d.i_glob / 500.0
        return Evaluation(ToyState(growth, p.tap * u.u_tap - growth), (ToyFluxes(growth),))

    def starts(self) -> Mapping[str, Start]:
        return {"seedling": lambda first, air_temperature, p: ToyState(0.1, 5.0)}

    def capacities(self, p: Mapping[str, float]) -> tuple[Capacity, ...]:
        return (Capacity("uTap", "tap", "kg m-2 s-1", p["tap"], "water", "Tap"),)

    def flows(self) -> tuple[Flow, ...]:
        return (Flow("water", "kg m-2", "water from the tap", "Water", lambda s: s.controls.u_tap * (s.parameters.tap * s.seconds)),)

    def stocks(self) -> tuple[Stock, ...]:
        return (Stock("mass", "kg m-2", "dry mass", "Mass", lambda x, p: x.mass),)

    def bounds(self, horizon: Horizon) -> Mapping[str, tuple[float, float]]:
        return {"mass": (0.0, 100.0), "water": (-1.0, 1e5)}

    def observed(self, module: str, horizon: Horizon) -> tuple[ObservedColumn, ...] | None:
        return (ObservedColumn("mass", "g m-2", "dry mass", "mass", 0.0, 1e5, 1000.0),) if module == "scales" else None

    @property
    def observation_modules(self) -> Mapping[str, str]:
        return {"scales": "dry mass"}


TASK = """
schema = 2
id = "mylab/Toy-v1"
title = "Water a toy"

[weather]
source = "schiphol"
preprocessing = "conserving"
start = 2010-05-01
days = 3
step_seconds = 3600
co2_ppm = 400.0

[model]
id = "toy-1.0.0"

[initial_state]
kind = "seedling"
air_temperature = { value = 18.0, unit = "degC" }

[observation]
modules = ["scales", "controls", "time"]
timing = "current"

[actuation]
kind = "set_point"
max_change = 1.0
controls = ["uTap"]

[ledger.growth]
side = "earned"
stock = "mass"
price = "market"

[ledger.cost_water]
side = "paid"
flow = "water"
price = { value = 0.01, unit = "EUR kg-1" }

[price_tables.market]
unit = "EUR kg-1"
hourly = [1, 1, 1, 1, 1, 1, 1, 1, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 1, 1, 1, 1]

[scenario]
family = "toys"

[reward]
modules = ["epi"]

[evaluation]
first_seed = 1
runs = 2
metric = "profit"

[evaluation.failed_step]
reward = -1.0
epi = { value = -0.01, unit = "EUR m-2" }
penalty = 0.0
"""
