"""Heat harvesting: a cooler in the air, a heat pump, and a cold and a hot buffer between them.

The cooler takes sensible and latent heat from the main air into the cold buffer, and dries the air. The heat pump lifts this heat into the
hot buffer, which heats the rail pipes beside the boiler. A house that is cooled need not open its vents: it keeps its CO2, and has the heat
of the day at night. Everything is per floor area.

Sources. Katzin (2021), Energy saving by LED lighting in greenhouses, sections 5.2.3.1 and 7.4.10, as its author published it:
``addHeatHarvesting.m`` of GreenLight (github.com/davkat1/GreenLight), which names the equations of the thesis. It follows Righini et al.
(2020), A greenhouse climate-yield model focussing on additional light, heat harvesting and its validation, Biosystems Engineering 194,
1-15, and the electronic appendix of Vanthoor et al. (2011). The thesis and the papers were not at hand.

Where the published code lets its control rules keep the machines within what is possible, these equations do, because here any controller
may ask for anything: a full cold buffer ends cooling, an empty one or a full hot one the heat pump, an empty hot one heating; and a cooler
takes nothing from air that is neither warmer nor moister than its surface.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple

from glbench.errors import ParameterError
from glbench.model.actuators import Actuators
from glbench.model.bounds import Horizon, round_up
from glbench.model.disturbances import Disturbances
from glbench.model.expressions import Expr, exp, fmax, fmin, sqrt, square
from glbench.model.greenhouse import Meter
from glbench.model.greenlight import JOULES_PER_KWH
from glbench.model.model import Capacity, Flow, ObservedColumn, Record, Signal
from glbench.model.parameter_checks import Order
from glbench.model.parameter_table import read_table
from glbench.model.quantities import Quantity, Variable
from glbench.model.submodels import Addition, Around
from glbench.model.surroundings import AirExchange
from glbench.model.vapour import LEWIS_FACTOR, condensation, condensing_pressure

MEGA = 1e-6
"""Turns joules to megajoules."""

START = 0.5
"""How full both buffers are at the start of an episode [-]; chosen."""

_BEYOND = 0.01
"""Share of a buffer by which its heat may seem to be outside its limits, in bounds: integrators err."""


class HarvestState(NamedTuple):
    """State of the buffers."""

    e_buf_cold: Annotated[Expr, Variable("MJ m-2", "heat in the cold buffer, above that of its coldest water", scale=1.0, small=1e-3)]
    e_buf_hot: Annotated[Expr, Variable("MJ m-2", "heat in the hot buffer", scale=1.0, small=1e-3)]


class HarvestControls(NamedTuple):
    """Controls besides those of the climate."""

    u_mech: Annotated[Expr, Quantity("-", "cooler in the main air, 1 = copMech pMech")]
    u_heat_pump: Annotated[Expr, Quantity("-", "load of the heat pump, 1 = pHeatPump")]
    u_buf_hot: Annotated[Expr, Quantity("-", "valve from the hot buffer to the rail pipes, 1 = pBufHot")]


class HarvestParameters(NamedTuple):
    """One value for each parameter; unit, meaning and source stand in heat_harvesting.csv."""

    cop_mech: Expr
    p_mech: Expr
    eta_mech: Expr
    t_mech: Expr
    t_mech_edge: Expr
    cop_heat_pump: Expr
    p_heat_pump: Expr
    p_buf_hot: Expr
    e_buf_cold_max: Expr
    e_buf_hot_max: Expr
    e_mech_edge: Expr


class HarvestFluxes(NamedTuple):
    """What heat, vapour and electricity do in heat harvesting."""

    hec_air_mech: Annotated[Expr, Quantity("W m-2 K-1", "heat exchange coefficient, main air to cooler")]
    h_air_mech: Annotated[Expr, Quantity("W m-2", "sensible heat, main air to cooler")]
    mv_air_mech: Annotated[Expr, Quantity("kg m-2 s-1", "condensation, main air to cooler")]
    l_air_mech: Annotated[Expr, Quantity("W m-2", "latent heat, main air to cooler")]
    h_mech_buf_cold: Annotated[Expr, Quantity("W m-2", "heat, cooler to cold buffer: sensible and latent")]
    q_heat_pump_in: Annotated[Expr, Quantity("W m-2", "electric power of the heat pump")]
    h_buf_cold_heat_pump: Annotated[Expr, Quantity("W m-2", "heat, cold buffer to heat pump")]
    h_heat_pump_buf_hot: Annotated[Expr, Quantity("W m-2", "heat, heat pump to hot buffer")]
    h_buf_hot_pipe: Annotated[Expr, Quantity("W m-2", "heat, hot buffer to rail pipes")]


HARVEST_PARAMETERS = read_table(HarvestParameters, Path(__file__).with_name("heat_harvesting.csv"))
"""Name, unit, meaning, source and value of the parameters, in the order of the vector."""


def discharge_share(stored: Expr, p: HarvestParameters) -> Expr:
    """Share of what is asked for that a buffer gives [-]: 0 when it is empty, 0.63 at one edge's width [MJ m-2], soon 1."""
    return 1 - exp(-stored / p.e_mech_edge)


def charge_share(stored: Expr, full: Expr, p: HarvestParameters) -> Expr:
    """Share of what comes that a buffer takes [-]: 0 when it is full or beyond, 0.63 with room for one edge's width, soon 1."""
    return 1 - exp(fmin((stored - full) / p.e_mech_edge, 0))


def cooler(t_air: Expr, vp_air: Expr, power: Expr, latent_heat: Expr, p: HarvestParameters) -> tuple[Expr, Expr, Expr, Expr]:
    """What the cooler takes from air of a temperature [°C] and vapour pressure [Pa] with a power [W m-2].

    Katzin (2021) eqs 7.51 to 7.55, with the ``latent_heat`` of water [J kg-1]. The surface has one
    temperature, and the power is shared by sensible and latent heat as temperature and vapour pressure of the air exceed the surface's.
    Two things differ, and both only where the air is hardly warmer or moister than the surface: each excess is at least 0, and the sum of
    both, in kelvins, is never less than about ``tMechEdge``, so that the cooler takes less there instead of exchanging without limit.

    Returns heat exchange coefficient [W m-2 K-1], sensible heat [W m-2], condensation [kg m-2 s-1] and latent heat [W m-2].
    """
    warmer = fmax(t_air - p.t_mech, 0)
    moister = fmax(condensing_pressure(vp_air, p.t_mech), 0)
    excess = warmer + LEWIS_FACTOR * latent_heat * moister
    hec = power / sqrt(square(excess) + square(p.t_mech_edge))
    condensed = condensation(hec, moister)
    return hec, hec * warmer, condensed, latent_heat * condensed


def to_pipes(x: HarvestState, u: Record, p: HarvestParameters) -> Expr:
    """Heat of the hot buffer to the rail pipes [W m-2]. Katzin (2021) eq. 7.65, less from an almost empty buffer."""
    return u.u_buf_hot * p.p_buf_hot * discharge_share(x.e_buf_hot, p)


def fluxes(x: HarvestState, t_air: Expr, vp_air: Expr, u: Record, latent_heat: Expr, p: HarvestParameters) -> HarvestFluxes:
    """All fluxes, from temperature [°C] and vapour pressure [Pa] of the main air and all controls. Katzin (2021) eqs 7.51 to 7.65."""
    power = u.u_mech * (p.cop_mech * p.p_mech) * charge_share(x.e_buf_cold, p.e_buf_cold_max, p)
    hec, sensible, condensed, latent = cooler(t_air, vp_air, power, latent_heat, p)
    electric = u.u_heat_pump * p.p_heat_pump * discharge_share(x.e_buf_cold, p) * charge_share(x.e_buf_hot, p.e_buf_hot_max, p)
    return HarvestFluxes(
        hec_air_mech=hec,
        h_air_mech=sensible,
        mv_air_mech=condensed,
        l_air_mech=latent,
        h_mech_buf_cold=sensible + latent,
        q_heat_pump_in=electric,
        h_buf_cold_heat_pump=(p.cop_heat_pump - 1) * electric,
        h_heat_pump_buf_hot=p.cop_heat_pump * electric,
        h_buf_hot_pipe=to_pipes(x, u, p),
    )


@dataclass(frozen=True)
class HeatHarvesting(Addition):
    """Cooler, heat pump, cold and hot buffer, beside whatever else heats the rail pipes."""

    name: ClassVar[str] = "heat_harvesting"
    State: ClassVar[type[HarvestState]] = HarvestState
    Controls: ClassVar[type[HarvestControls]] = HarvestControls
    Parameters: ClassVar[type[HarvestParameters]] = HarvestParameters
    table = HARVEST_PARAMETERS
    orders = (
        Order("eMechEdge", "eBufColdMax", "an edge is a part of the buffer"),
        Order("eMechEdge", "eBufHotMax", "an edge is a part of the buffer"),
    )
    observation_modules: ClassVar[Mapping[str, str]] = {"heat_harvesting": "heat in the cold and in the hot buffer, and how full they are"}

    def supply(self, act: Actuators, x: HarvestState, u: Record, p: HarvestParameters) -> Actuators:
        return act._replace(h_boil_pipe=act.h_boil_pipe + to_pipes(x, u, p))

    def processes(self, x: HarvestState, around: Around, p: HarvestParameters) -> HarvestFluxes:
        air, climate = around.surroundings.x, around.surroundings.p
        return fluxes(x, air.t_air, air.vp_air, around.controls, climate.L, p)

    def exchange(self, x: HarvestState, around: Around, fluxes: HarvestFluxes, p: HarvestParameters) -> AirExchange:
        return AirExchange(heat=fluxes.h_air_mech, vapour=fluxes.mv_air_mech)

    def rates(self, x: HarvestState, around: Around, fluxes: HarvestFluxes, p: HarvestParameters) -> HarvestState:
        """Katzin (2021) eqs 7.60 and 7.61."""
        f = fluxes
        return HarvestState(
            e_buf_cold=MEGA * (f.h_mech_buf_cold - f.h_buf_cold_heat_pump), e_buf_hot=MEGA * (f.h_heat_pump_buf_hot - f.h_buf_hot_pipe)
        )

    def start(self, d: Disturbances, air_temperature: float, p: HarvestParameters) -> HarvestState:
        return HarvestState(START * p.e_buf_cold_max, START * p.e_buf_hot_max)

    def refuse(self, values: Mapping[str, float]) -> None:
        if values["copHeatPump"] < 1:
            msg = (
                f"copHeatPump is {values['copHeatPump']:g}: a heat pump gives its electricity as heat and what it takes from the cold "
                "buffer besides, so that its coefficient of performance is at least 1."
            )
            raise ParameterError(msg)

    def capacities(self, p: Mapping[str, float]) -> tuple[Capacity, ...]:
        cooled, pumped = p["copMech"] * p["pMech"], p["copHeatPump"] * p["pHeatPump"]
        return (
            Capacity("uMech", "cooler", "W m-2", cooled, "heat that the cooler takes from warm, moist air", "Cooler"),
            Capacity("uHeatPump", "heat_pump", "W m-2", pumped, "heat of the heat pump to the hot buffer", "Heat pump"),
            Capacity("uBufHot", "hot_buffer", "W m-2", p["pBufHot"], "heat of the hot buffer to the rail pipes", "Hot buffer"),
        )

    def flows(self) -> tuple[Flow, ...]:
        return (
            Flow(
                "electricity_cooler",
                "kWh m-2",
                "electricity of the cooler's water pump",
                "Electricity of the cooler",
                lambda step: cooler_power(step.controls, step.parameters) * (step.seconds / JOULES_PER_KWH),
            ),
        )

    def signals(self) -> tuple[Signal, ...]:
        return (
            Signal("controls/cooler", "Cooler", "%", "uMech", 100.0),
            Signal("controls/heat_pump", "Heat pump", "%", "uHeatPump", 100.0),
            Signal("controls/hot_buffer", "Heating: hot buffer to pipes", "%", "uBufHot", 100.0),
            Signal("energy/cold_buffer", "Heat in the cold buffer", "MJ m⁻²", "eBufCold"),
            Signal("energy/cold_buffer_share", "Cold buffer filled", "%", "", of=cold_filled),
            Signal("energy/hot_buffer", "Heat in the hot buffer", "MJ m⁻²", "eBufHot"),
            Signal("energy/hot_buffer_share", "Hot buffer filled", "%", "", of=hot_filled),
        )

    def bounds(self, horizon: Horizon) -> Mapping[str, tuple[float, float]]:
        full = {name: horizon.parameters[f"{name}Max"] for name in ("eBufCold", "eBufHot")}
        return {name: (-_BEYOND * most, round_up((1 + _BEYOND) * most)) for name, most in full.items()}

    def observed(self, module: str, horizon: Horizon) -> tuple[ObservedColumn, ...] | None:
        if module != "heat_harvesting":
            return None
        outside, bounds = 100 * _BEYOND, self.bounds(horizon)
        return tuple(
            column
            for word, source, filled in (("cold", "eBufCold", cold_filled), ("hot", "eBufHot", hot_filled))
            for column in (
                ObservedColumn(f"{word}_buffer_heat", "MJ m-2", f"heat in the {word} buffer", source, *bounds[source]),
                ObservedColumn(f"{word}_buffer_share", "%", f"how full the {word} buffer is", "", -outside, 100 + outside, of=filled),
            )
        )


def cooler_power(u: Record, p: Record) -> Expr:
    """Electric power of the cooler's water pump [W m-2]. Katzin (2021) eq. 5.1. The pump runs whether there is heat to take or not."""
    return u.u_mech * (p.eta_mech * p.p_mech)


def cold_filled(x: Any, p: Any) -> Expr:
    """How full the cold buffer is [%]."""
    return x.e_buf_cold * (100 / p.e_buf_cold_max)


def hot_filled(x: Any, p: Any) -> Expr:
    """How full the hot buffer is [%]."""
    return x.e_buf_hot * (100 / p.e_buf_hot_max)


def _meter(flux: str, flow: str, meaning: str, label: str) -> Meter:
    return Meter(flux, flow, "J m-2", meaning, label, scale=1e6, small=1e4)


HARVEST_METERS = (
    _meter("q_heat_pump_in", "electricity_heat_pump", "electricity of the heat pump", "Electricity of the heat pump"),
    _meter("h_mech_buf_cold", "heat_harvested", "heat of the air to the cold buffer", "Heat harvested"),
    _meter("h_buf_hot_pipe", "heat_delivered", "heat of the hot buffer to the rail pipes", "Heat delivered"),
)
"""What a ledger may ask of heat harvesting and only the integrator knows: ``compose(..., HeatHarvesting(), meters=HARVEST_METERS)``."""
