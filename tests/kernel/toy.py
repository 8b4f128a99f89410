"""Models that have nothing of a greenhouse: what the kernel serves must not lean on the tomato."""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np

from glbench.kernel import Rows
from glbench.model import Evaluation, Meter, Model, compose
from glbench.model.crop.tomato import VanthoorTomato
from glbench.model.expressions import Expr
from glbench.model.greenlight import GreenLightClimate
from glbench.model.parameter_table import ParameterInfo
from glbench.model.quantities import Quantity, Variable
from tests.kernel.known_steps import KnownSteps


class TankState(NamedTuple):
    level: Annotated[Expr, Variable("m", "water in the tank", scale=1.0, small=1e-3)]
    salt: Annotated[Expr, Variable("kg m-2", "salt in the tank", scale=2.0, small=1e-3)]


class TankControls(NamedTuple):
    u_tap: Annotated[Expr, Quantity("-", "tap that fills the tank")]


class TankWeather(NamedTuple):
    rain: Annotated[Expr, Quantity("m s-1", "rain into the tank")]


class TankParameters(NamedTuple):
    inflow: Any
    outflow: Any
    uptake: Any
    leak: Any


def parameter(name: str, value: float) -> ParameterInfo:
    return ParameterInfo(name, name, "-", name, "", "tank", "nonnegative", "", "yes", frozenset(), MappingProxyType({"benchmark": value}))


@dataclass(frozen=True)
class Tank(Model):
    """Two states, one control, one disturbance; no clock, no fast state, no singular pair. The tank of the benchmark has no leak."""

    State: ClassVar[type[Any]] = TankState
    Controls: ClassVar[type[Any]] = TankControls
    Disturbances: ClassVar[type[Any]] = TankWeather
    Parameters: ClassVar[type[Any]] = TankParameters
    name: ClassVar[str] = "tank"  # type: ignore[assignment]
    version: ClassVar[str] = "1.0.0"  # type: ignore[assignment]
    table: ClassVar[tuple[ParameterInfo, ...]] = (  # type: ignore[assignment]
        parameter("inflow", 2e-3),
        parameter("outflow", 1e-3),
        parameter("uptake", 4e-4),
        parameter("leak", 0.0),
    )

    def equations(self, x: TankState, u: TankControls, d: TankWeather, p: TankParameters) -> Evaluation:
        filled = p.inflow * u.u_tap + d.rain
        drained = p.outflow * x.level * x.level / (1.0 + x.level) + p.leak * x.level
        salt = 0.3 * filled - p.uptake * x.salt / (0.5 + x.salt)
        fluxes = namedtuple("Fluxes", ())()
        return Evaluation(TankState(filled - drained, salt), fluxes)


@dataclass(frozen=True)
class Decay(Model):
    """One state that falls off, and nothing to do about it but a rate: linear, without controls and disturbances."""

    State: ClassVar[type[Any]] = NamedTuple("DecayState", [("amount", Annotated[Expr, Variable("kg", "amount")])])
    Controls: ClassVar[type[Any]] = NamedTuple("DecayControls", [])
    Disturbances: ClassVar[type[Any]] = NamedTuple("DecayWeather", [])
    Parameters: ClassVar[type[Any]] = NamedTuple("DecayParameters", [("rate", Any)])
    name: ClassVar[str] = "decay"  # type: ignore[assignment]
    version: ClassVar[str] = "1.0.0"  # type: ignore[assignment]
    table: ClassVar[tuple[ParameterInfo, ...]] = (parameter("rate", 1e-3),)  # type: ignore[assignment]

    def equations(self, x: Any, u: Any, d: Any, p: Any) -> Evaluation:
        return Evaluation(self.State(-p.rate * x.amount), namedtuple("Fluxes", ())())


TANK, DECAY = Tank(), Decay()
METERED = compose(
    GreenLightClimate(),
    VanthoorTomato(),
    meters=(Meter("mc_fruit_har", "fruit_harvested", "mg m-2", "fruit that is harvested", "Harvest"),),
    version="1.0.0-metered",
)
"""The tomato greenhouse with one state more, which adds up the harvest."""


def tank_rows(n: int, seed: int = 0) -> Rows:
    """Tanks of all fillings."""
    generator = np.random.default_rng(seed)
    x = generator.uniform(0.1, 3.0, (n, 2))
    d = generator.uniform(0.0, 1e-3, (n, 1))
    return Rows(x, generator.uniform(0.0, 1.0, (n, 1)), d, TANK.parameters.default()[None])


def decay_rows(n: int) -> Rows:
    """Amounts from 1 to n kg."""
    nothing = np.zeros((n, 0))
    return Rows(np.arange(1.0, n + 1.0)[:, None], nothing, nothing, DECAY.parameters.default()[None])


def metered_rows(steps: KnownSteps) -> Rows:
    """Known steps with a meter at zero and as much fruit as sets off a harvest."""
    p = METERED.parameters.default()
    x = np.insert(steps.x, METERED.state_index("sumMcFruitHar"), 0.0, axis=1)
    x[:, METERED.state_index("cFruit")] = p[METERED.parameter_names.index("cFruitMax")] - 5e3
    return Rows(x, steps.u, steps.d, p[None])
