"""What a crop sees of the greenhouse around it, and what the greenhouse sees of its crop."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

from glbench.model.expressions import Expr
from glbench.model.parameters import ClimateParameters
from glbench.model.quantities import Quantity
from glbench.model.shortwave import ShortWave
from glbench.model.states import ClimateState


class Surroundings(NamedTuple):
    """The climate as a crop's equations read it."""

    lai: Expr
    """Leaf area index that the climate works with [m2 m-2]."""
    light: ShortWave
    x: ClimateState
    p: ClimateParameters
    u: Any = None
    """Controls of the crop."""


class CropExchange(NamedTuple):
    """What the crop as a whole takes from the air."""

    mc_air_can: Annotated[Expr, Quantity("mg m-2 s-1", "CO2, main air to canopy: net uptake")]


class AirExchange(NamedTuple):
    """What an addition takes from the main air, per floor area; negative where it gives."""

    heat: Expr
    """Sensible heat [W m-2]."""
    vapour: Expr
    """Water vapour [kg m-2 s-1]. Its latent heat goes with it."""
    co2: Expr = 0.0
    """CO2 [mg m-2 s-1]."""
