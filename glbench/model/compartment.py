"""A compartment as measured: what the books' greenhouse lacks beside a season measured every five minutes.

Heat is stored in gutters, slabs and steel, and the sun warms them; walls and doors pass heat and CO2 to and from the compartments next
to it; a vent that opens further also opens higher; and a crop that is topped keeps ever fewer leaves, because the crew goes on picking
the old ones. Each part is as simple as it can be and keep energy and carbon. With the values of the books' sets (no stored heat, no
neighbours, no topping) only the vents differ from the published model.

Sources. Mass: Bot (1983), Greenhouse climate: from physical processes to a dynamic model, who gives the construction a temperature of its
own. Vents: de Jong (1990), Natural ventilation of large multi-span greenhouses; de Zwart (1996), Analyzing energy-saving options in
greenhouse cultivation using a simulation model: flow by buoyancy grows with the opening's height to the power 1.5. Neighbours and topping:
chosen, as the simplest forms. How the values of ``bleiswijk_2020`` were found is told in docs/realism.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, NamedTuple

from glbench.model.actuators import Actuators
from glbench.model.air import co2_density, saturation_vapour_pressure
from glbench.model.balances import ClimateFluxes
from glbench.model.bounds import COLDEST, HOTTEST_METAL, Horizon
from glbench.model.controls import Controls
from glbench.model.crop.tomato import TomatoFluxes, VanthoorTomato
from glbench.model.disturbances import Disturbances
from glbench.model.expressions import Expr, sigmoid
from glbench.model.greenhouse import typed_record
from glbench.model.greenlight import GreenLightClimate
from glbench.model.parameter_table import Parameter, declared_table, read_table
from glbench.model.parameters import ClimateParameters, TomatoParameters
from glbench.model.quantities import Quantity, Variable
from glbench.model.states import ClimateState, TomatoState
from glbench.model.submodels import Addition, Around
from glbench.model.surroundings import AirExchange, Surroundings
from glbench.model.vapour import carried_vapour
from glbench.model.variants import AUTHOR

MEASURED = "bleiswijk_2020"
"""The set fitted to the growers' compartment of the second Autonomous Greenhouse Challenge."""


@dataclass(frozen=True)
class RisingVents(GreenLightClimate):
    """The GreenLight climate with vents whose opening is the higher the further they open."""

    name: ClassVar[str] = "greenlight_rising_vents"

    def processes(self, lai: Expr, act: Actuators, x: ClimateState, u: Controls, d: Disturbances, p: ClimateParameters) -> ClimateFluxes:
        """``hVent`` is the height of a vent that is fully open. De Jong (1990), de Zwart (1996) section 5.4."""
        return super().processes(lai, act, x, u, d, p._replace(h_vent=p.h_vent * u.u_vent))


class BesideState(NamedTuple):
    """What a compartment has besides the greenhouse of the books."""

    t_mass: Annotated[Expr, Variable("°C", "temperature of gutters, slabs and steel")]


def _number(
    unit: str, meaning: str, value: float, measured: float, check: str = "nonnegative", source: str = "fitted, docs/realism.md"
) -> Parameter:
    """A parameter with the value that switches its part off, and that of the measured compartment."""
    return Parameter(unit, meaning, value, source, check, "compartment", ((MEASURED, measured),))  # type: ignore[arg-type]


class BesideParameters(NamedTuple):
    """Heat stored, and what passes the walls to the compartments next to it."""

    cap_mass: Annotated[Expr, _number("J K-1 m-2", "heat capacity of gutters, slabs and steel", 50000.0, 50000.0, "positive")]
    hec_air_mass: Annotated[Expr, _number("W m-2 K-1", "heat exchange of the air with gutters, slabs and steel", 0.0, 5.0)]
    eta_glob_mass: Annotated[Expr, _number("-", "share of the sun absorbed by the construction that it keeps", 0.0, 0.35, "fraction")]
    hec_wall: Annotated[Expr, _number("W m-2 K-1", "heat exchange with neighbours through walls", 0.0, 0.3)]
    f_wall: Annotated[Expr, _number("m3 m-2 s-1", "air exchange with neighbours", 0.0, 4.3e-4)]
    t_wall: Annotated[Expr, _number("°C", "air temperature of the neighbours", 18.0, 18.0, "any")]
    rh_wall: Annotated[Expr, _number("%", "relative humidity of the neighbours", 80.0, 80.0, source="chosen")]
    co2_wall: Annotated[Expr, _number("ppm", "CO2 of the neighbours", 600.0, 624.0)]


class BesideFluxes(NamedTuple):
    """What the mass and the neighbours take from the main air."""

    h_air_mass: Annotated[Expr, Quantity("W m-2", "heat, main air to gutters, slabs and steel")]
    r_sun_mass: Annotated[Expr, Quantity("W m-2", "solar radiation that gutters, slabs and steel keep from the air")]
    h_air_wall: Annotated[Expr, Quantity("W m-2", "heat, main air to neighbours")]
    mv_air_wall: Annotated[Expr, Quantity("kg m-2 s-1", "vapour, main air to neighbours")]
    mc_air_wall: Annotated[Expr, Quantity("mg m-2 s-1", "CO2, main air to neighbours")]


@dataclass(frozen=True)
class Beside(Addition):
    """Heat stored in the construction, and the neighbours of a compartment."""

    name: ClassVar[str] = "beside"
    State: ClassVar[type[BesideState]] = BesideState
    Parameters: ClassVar[type[BesideParameters]] = BesideParameters

    def processes(self, x: BesideState, around: Around, p: BesideParameters) -> BesideFluxes:
        """Heat and carbon that leave the air are what mass and neighbours gain; vapour as in Vanthoor (2011) eq. 8.45."""
        air, climate = around.surroundings.x, around.surroundings.p
        heat_of_air = climate.rho_air_cap * climate.c_p_air * p.f_wall
        vapour = p.rh_wall / 100 * saturation_vapour_pressure(p.t_wall)
        return BesideFluxes(
            h_air_mass=p.hec_air_mass * (air.t_air - x.t_mass),
            r_sun_mass=p.eta_glob_mass * around.surroundings.light.r_glob_sun_air,
            h_air_wall=(p.hec_wall + heat_of_air) * (air.t_air - p.t_wall),
            mv_air_wall=carried_vapour(p.f_wall, air.vp_air, vapour, air.t_air, p.t_wall, climate, AUTHOR),
            mc_air_wall=p.f_wall * (air.co2_air - co2_density(p.t_wall, p.co2_wall)),
        )

    def exchange(self, x: BesideState, around: Around, fluxes: BesideFluxes, p: BesideParameters) -> AirExchange:
        heat = fluxes.h_air_mass + fluxes.r_sun_mass + fluxes.h_air_wall
        return AirExchange(heat=heat, vapour=fluxes.mv_air_wall, co2=fluxes.mc_air_wall)

    def rates(self, x: BesideState, around: Around, fluxes: BesideFluxes, p: BesideParameters) -> BesideState:
        return BesideState((fluxes.h_air_mass + fluxes.r_sun_mass) / p.cap_mass)

    def start(self, d: Disturbances, air_temperature: float, p: BesideParameters) -> BesideState:
        return BesideState(air_temperature)

    def bounds(self, horizon: Horizon) -> Mapping[str, tuple[float, float]]:
        return {"tMass": (COLDEST, HOTTEST_METAL)}


ToppedParameters = typed_record(
    "ToppedParameters",
    {
        **TomatoParameters.__annotations__,
        "t_sum_top": Annotated[
            Expr, _number("°C day", "temperature sum at which half of the leaves to go are gone", 1e5, 2793.0, "positive")
        ],
        "t_sum_top_width": Annotated[
            Expr, _number("°C day", "temperature sum over which the leaves of a topped crop go", 300.0, 300.0, "positive")
        ],
        "lai_top": Annotated[Expr, _number("-", "share of the largest leaf area that a topped crop keeps", 1.0, 0.53, "fraction")],
    },
)
"""Parameters of the crop, with the day of its topping as a temperature sum."""


@dataclass(frozen=True)
class ToppedTomato(VanthoorTomato):
    """The tomato crop, topped: no new leaves come, the crew picks the old ones, and the largest leaf area falls to a share of it."""

    name: ClassVar[str] = "tomato_topped"
    Parameters: ClassVar[type[TomatoParameters]] = ToppedParameters
    table = (*read_table(TomatoParameters), *declared_table(ToppedParameters))

    def processes(self, x: TomatoState, s: Surroundings, p: TomatoParameters) -> TomatoFluxes:
        """The temperature sum of planting to topping stands for its date; the fall is a logistic curve, chosen."""
        topped: Any = p
        gone = (1 - topped.lai_top) * sigmoid(4 * (x.t_can_sum - topped.t_sum_top) / topped.t_sum_top_width)
        return super().processes(x, s, p._replace(c_leaf_max=p.c_leaf_max * (1 - gone)))
