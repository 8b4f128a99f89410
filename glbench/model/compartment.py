"""A compartment as measured: what the published greenhouse lacks when it is compared with a season measured every five minutes.

Gutters, slabs and steel store heat, and the sun warms them. Walls and doors exchange heat, vapour and CO2 with the compartments next to
this one. A vent that opens further also opens higher. A crop that is topped grows no new leaves, while the crew goes on picking the old
ones. Each part is the simplest that conserves energy, water and carbon. With the benchmark's values of its parameters (nothing stored, no
neighbours, no topping) only vents that are partly open differ from the published model.

Sources. Vents: de Jong (1990), Natural ventilation of large multi-span greenhouses, eq. 6.10: flow by buoyancy grows with the height of the
opening to the power 1.5. We had this equation from two programs that quote it (Universal Simulator, and the Modelica library Greenhouses),
not the thesis. Mass: Vanthoor (2011) section 8.4 lets the construction absorb a share of the sun and release all of it to the air at once;
here it keeps a part, at a temperature of its own: chosen. Neighbours and topping: chosen, as the simplest forms. docs/realism.md tells how
the values of ``bleiswijk_2020`` came about, docs/compartment.md has the equations.
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
from glbench.model.parameter_table import Check, Parameter, declared_table, read_table
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
    """The GreenLight climate with vents that open higher as they open further."""

    name: ClassVar[str] = "greenlight_rising_vents"

    def processes(self, lai: Expr, act: Actuators, x: ClimateState, u: Controls, d: Disturbances, p: ClimateParameters) -> ClimateFluxes:
        """``hVent`` is the height of a vent that is fully open. De Jong's opening rises with a sine, here linearly."""
        return super().processes(lai, act, x, u, d, p._replace(h_vent=p.h_vent * u.u_vent))


class MassState(NamedTuple):
    """State of what stores heat besides the parts of the published greenhouse."""

    t_mass: Annotated[Expr, Variable("°C", "temperature of gutters, slabs and steel")]


def _number(
    unit: str, meaning: str, value: float, measured: float, check: Check = "nonnegative", source: str = "fitted, docs/realism.md"
) -> Parameter:
    """A parameter with the value of the benchmark, which leaves its part out, and that of the measured compartment."""
    return Parameter(unit, meaning, value, source, check, "compartment", ((MEASURED, measured),))


class CompartmentParameters(NamedTuple):
    """Parameters of the mass that stores heat, and of the walls to the compartments next to this one."""

    cap_mass: Annotated[Expr, _number("J K-1 m-2", "heat capacity of gutters, slabs and steel", 50000.0, 57920.0, "positive")]
    hec_air_mass: Annotated[Expr, _number("W m-2 K-1", "heat exchange of the air with gutters, slabs and steel", 0.0, 7.443)]
    eta_glob_mass: Annotated[Expr, _number("-", "share that the construction keeps of the sun it absorbs", 0.0, 0.3938, "fraction")]
    hec_wall: Annotated[Expr, _number("W m-2 K-1", "heat exchange with the neighbours through walls", 0.0, 0.3201)]
    f_wall: Annotated[Expr, _number("m3 m-2 s-1", "air exchange with the neighbours", 0.0, 0.001795)]
    t_wall: Annotated[Expr, _number("°C", "air temperature of the neighbours", 18.0, 20.19, "any")]
    rh_wall: Annotated[Expr, _number("%", "relative humidity of the neighbours", 80.0, 80.0, source="chosen")]
    co2_wall: Annotated[Expr, _number("ppm", "CO2 of the neighbours", 600.0, 636.5)]


class CompartmentFluxes(NamedTuple):
    """What the mass and the neighbours take from the main air."""

    h_air_mass: Annotated[Expr, Quantity("W m-2", "heat, main air to gutters, slabs and steel")]
    r_sun_mass: Annotated[
        Expr, Quantity("W m-2", "solar radiation that gutters, slabs and steel keep instead of releasing it to the main air")
    ]
    h_air_wall: Annotated[Expr, Quantity("W m-2", "heat, main air to neighbours")]
    mv_air_wall: Annotated[Expr, Quantity("kg m-2 s-1", "vapour, main air to neighbours")]
    mc_air_wall: Annotated[Expr, Quantity("mg m-2 s-1", "CO2, main air to neighbours")]


@dataclass(frozen=True)
class MassAndNeighbours(Addition):
    """A mass that stores heat, and the neighbours of a compartment."""

    name: ClassVar[str] = "mass_and_neighbours"
    State: ClassVar[type[MassState]] = MassState
    Parameters: ClassVar[type[CompartmentParameters]] = CompartmentParameters

    def processes(self, x: MassState, around: Around, p: CompartmentParameters) -> CompartmentFluxes:
        """What leaves the air is what mass and neighbours gain. Vapour as in Vanthoor (2011) eq. 8.45."""
        air, climate = around.surroundings.x, around.surroundings.p
        heat_of_air = climate.rho_air_cap * climate.c_p_air * p.f_wall
        vapour = p.rh_wall / 100 * saturation_vapour_pressure(p.t_wall)
        return CompartmentFluxes(
            h_air_mass=p.hec_air_mass * (air.t_air - x.t_mass),
            r_sun_mass=p.eta_glob_mass * around.surroundings.light.r_glob_sun_air,
            h_air_wall=(p.hec_wall + heat_of_air) * (air.t_air - p.t_wall),
            mv_air_wall=carried_vapour(p.f_wall, air.vp_air, vapour, air.t_air, p.t_wall, climate, AUTHOR),
            mc_air_wall=p.f_wall * (air.co2_air - co2_density(p.t_wall, p.co2_wall)),
        )

    def exchange(self, x: MassState, around: Around, fluxes: CompartmentFluxes, p: CompartmentParameters) -> AirExchange:
        heat = fluxes.h_air_mass + fluxes.r_sun_mass + fluxes.h_air_wall
        return AirExchange(heat=heat, vapour=fluxes.mv_air_wall, co2=fluxes.mc_air_wall)

    def rates(self, x: MassState, around: Around, fluxes: CompartmentFluxes, p: CompartmentParameters) -> MassState:
        return MassState((fluxes.h_air_mass + fluxes.r_sun_mass) / p.cap_mass)

    def start(self, d: Disturbances, air_temperature: float, p: CompartmentParameters) -> MassState:
        return MassState(air_temperature)

    def bounds(self, horizon: Horizon) -> Mapping[str, tuple[float, float]]:
        return {"tMass": (COLDEST, HOTTEST_METAL)}


ToppedParameters = typed_record(
    "ToppedParameters",
    {
        **TomatoParameters.__annotations__,
        "t_sum_top": Annotated[
            Expr, _number("°C day", "temperature sum at which half of the leaf area that topping costs is lost", 1e5, 2764.0, "positive")
        ],
        "t_sum_top_width": Annotated[
            Expr, _number("°C day", "temperature sum over which a topped crop loses its leaf area", 300.0, 300.0, "positive")
        ],
        "lai_top": Annotated[Expr, _number("-", "share of the largest leaf area that a topped crop keeps", 1.0, 0.5254, "fraction")],
    },
)
"""Parameters of the crop, with a temperature sum in place of the date of its topping."""


@dataclass(frozen=True)
class ToppedTomato(VanthoorTomato):
    """The tomato crop, topped: no new leaves grow, the crew picks the old ones, and the largest leaf area falls to a share of itself."""

    name: ClassVar[str] = "tomato_topped"
    Parameters: ClassVar[type[TomatoParameters]] = ToppedParameters
    table = (*read_table(TomatoParameters), *declared_table(ToppedParameters))

    def processes(self, x: TomatoState, s: Surroundings, p: TomatoParameters) -> TomatoFluxes:
        """The temperature sum stands for the date. The fall is logistic, its steepest slope would end it within the width; chosen."""
        topped: Any = p
        lost_share = (1 - topped.lai_top) * sigmoid(4 * (x.t_can_sum - topped.t_sum_top) / topped.t_sum_top_width)
        return super().processes(x, s, p._replace(c_leaf_max=p.c_leaf_max * (1 - lost_share)))
