"""The energy of a greenhouse: boiler, engine (combined heat and power), hot-water buffer, grid, and the CO2 of flue gas.

Boiler and engine heat a buffer, and the buffer heats the rail pipes: ``u_boil`` fires the boiler, ``u_pipe`` does what ``u_boil`` does
without this part. The engine's electricity feeds the lamps first. CO2 is dosed from flue gas first, and the rest is bought; flue gas is
not stored. Everything is per floor area; gas is counted by its lower heating value.

All that controls alone decide stays the same within a control step, and is a flow: gas, electricity, CO2. What depends on the heat in the
buffer is a flux: heat into it, out of it, lost and dumped.

Sources. Buffer and shared use of CO2 and heat: Seginer, van Straten and van Beveren (2017), Day-to-night heat storage in greenhouses: 2,
Biosystems Engineering 161, 188-199. Equipment: van Beveren, Bontsema, van Straten and van Henten (2019), Optimal utilization of a boiler,
combined heat and power installation, and heat buffers in horticultural greenhouses, Computers and Electronics in Agriculture 162,
1035-1048. The equations are the simplest that keep energy and carbon; the papers were at hand as abstracts only.

That the engine does not run at low loads, nor for a few minutes, belongs to a task's actuation (docs/energy.md).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np

from glbench.model.actuators import Actuators, actuators
from glbench.model.bounds import Horizon, round_up
from glbench.model.disturbances import Disturbances
from glbench.model.expressions import Expr, exp, fmax, fmin
from glbench.model.greenhouse import Meter
from glbench.model.greenlight import JOULES_PER_KWH, KG_PER_MG
from glbench.model.model import Capacity, Flow, ObservedColumn, Record, Signal, Step, Stock
from glbench.model.parameter_checks import Order, Shares
from glbench.model.parameter_table import read_table
from glbench.model.quantities import Quantity, Variable
from glbench.model.submodels import Addition, Around

MEGA = 1e-6
"""Turns joules to megajoules."""

DAY = 86400.0
HOUR = 3600.0

START = 0.5
"""How full the buffer is at the start of an episode [-]; chosen."""

_BEYOND = 0.01
"""Share of the buffer by which its heat may seem to be outside its limits, in bounds: integrators err."""


class EnergyState(NamedTuple):
    """State of the energy system."""

    e_buf: Annotated[Expr, Variable("MJ m-2", "heat in the hot-water buffer", scale=1.0, small=1e-3)]


class EnergyControls(NamedTuple):
    """Controls besides those of the climate; the boiler's ``u_boil`` now fires into the buffer."""

    u_chp: Annotated[Expr, Quantity("-", "load of the engine (combined heat and power), 1 = pChpEl")]
    u_pipe: Annotated[Expr, Quantity("-", "valve from the buffer to the rail pipes, 1 = pPipe")]


class EnergyParameters(NamedTuple):
    """One value for each parameter; unit, meaning and source stand in energy.csv."""

    eta_boil: Expr
    eta_chp_el: Expr
    eta_chp_heat: Expr
    p_chp_el: Expr
    p_pipe: Expr
    e_buf_max: Expr
    e_buf_edge: Expr
    tau_buf: Expr
    co2_gas: Expr


class EnergyFluxes(NamedTuple):
    """What heat does in the energy system."""

    h_boil_buf: Annotated[Expr, Quantity("W m-2", "heat, boiler to buffer")]
    h_chp_buf: Annotated[Expr, Quantity("W m-2", "heat, engine to buffer")]
    h_buf_pipe: Annotated[Expr, Quantity("W m-2", "heat, buffer to rail pipes")]
    h_buf_out: Annotated[Expr, Quantity("W m-2", "heat, buffer to outside: standing loss")]
    h_dump_out: Annotated[Expr, Quantity("W m-2", "heat that a full buffer refuses, given off outside")]


class Plant(NamedTuple):
    """What boiler, engine, grid and CO2 supply do at given controls, per floor area and second."""

    gas: Expr
    """Gas burnt by both [W m-2]."""
    h_boil: Expr
    """Heat made by the boiler [W m-2]."""
    h_chp: Expr
    """Heat made by the engine [W m-2]."""
    q_made: Expr
    """Electricity made by the engine [W m-2]."""
    q_used: Expr
    """Electricity used by the lamps [W m-2], cooled ones included: what their water carries away is lost."""
    mc_flue: Expr
    """CO2 of the gas burnt [mg m-2 s-1]."""
    mc_dosed: Expr
    """CO2 dosed [mg m-2 s-1]."""


ENERGY_PARAMETERS = read_table(EnergyParameters, Path(__file__).with_name("energy.csv"))
"""Name, unit, meaning, source and value of the parameters, in the order of the vector."""


def heat_made(u: Record, p_boil: Expr, p: Record) -> tuple[Expr, Expr]:
    """Heat of boiler and engine [W m-2], from the boiler's power [W m-2] and the parameters of this part."""
    return u.u_boil * p_boil, u.u_chp * (p.p_chp_el * p.eta_chp_heat / p.eta_chp_el)


def plant(u: Record, p: Record) -> Plant:
    """All that the controls decide, from all controls and all parameters of a model."""
    climate = actuators(u, p)
    h_boil, h_chp = heat_made(u, p.p_boil / p.a_flr, p)
    q_made = u.u_chp * p.p_chp_el
    gas = h_boil / p.eta_boil + q_made / p.eta_chp_el
    return Plant(gas, h_boil, h_chp, q_made, climate.q_lamp_in + climate.q_int_lamp_in, p.co2_gas * gas, climate.mc_ext_air)


def to_pipes(x: EnergyState, u: Record, p: EnergyParameters) -> Expr:
    """Heat of the buffer to the rail pipes [W m-2]: what the valve asks for, less from an almost empty buffer, none from an empty one."""
    return u.u_pipe * p.p_pipe * (1 - exp(-x.e_buf / p.e_buf_edge))


def refused(x: EnergyState, p: EnergyParameters) -> Expr:
    """Share of the heat made that the buffer does not take [-]: all when it is full, 0.37 with room for one edge's width, soon none.

    No buffer fills beyond its limit; one that starts there takes nothing.
    """
    return exp(fmin((x.e_buf - p.e_buf_max) / p.e_buf_edge, 0))


def fluxes(x: EnergyState, u: Record, p_boil: Expr, p: EnergyParameters) -> EnergyFluxes:
    """All fluxes of heat, from all controls, the boiler's power [W m-2] and the parameters of this part."""
    h_boil, h_chp = heat_made(u, p_boil, p)
    dumped = refused(x, p)
    return EnergyFluxes(
        h_boil_buf=h_boil * (1 - dumped),
        h_chp_buf=h_chp * (1 - dumped),
        h_buf_pipe=to_pipes(x, u, p),
        h_buf_out=x.e_buf / (MEGA * DAY * p.tau_buf),
        h_dump_out=(h_boil + h_chp) * dumped,
    )


@dataclass(frozen=True)
class ChpBoilerBuffer(Addition):
    """Boiler, engine and hot-water buffer between gas, grid and rail pipes."""

    name: ClassVar[str] = "energy"
    State: ClassVar[type[EnergyState]] = EnergyState
    Controls: ClassVar[type[EnergyControls]] = EnergyControls
    Parameters: ClassVar[type[EnergyParameters]] = EnergyParameters
    table = ENERGY_PARAMETERS
    shares = (Shares("the engine's gas", ("etaChpEl", "etaChpHeat")),)
    orders = (Order("eBufEdge", "eBufMax", "an edge is a part of the buffer"),)
    observation_modules: ClassVar[Mapping[str, str]] = {"energy": "heat in the buffer, and how full that is"}

    def supply(self, act: Actuators, x: EnergyState, u: Record, p: EnergyParameters) -> Actuators:
        return act._replace(h_boil_pipe=to_pipes(x, u, p))

    def processes(self, x: EnergyState, around: Around, p: EnergyParameters) -> EnergyFluxes:
        climate = around.surroundings.p
        return fluxes(x, around.controls, climate.p_boil / climate.a_flr, p)

    def rates(self, x: EnergyState, around: Around, fluxes: EnergyFluxes, p: EnergyParameters) -> EnergyState:
        f = fluxes
        return EnergyState(MEGA * (f.h_boil_buf + f.h_chp_buf - f.h_buf_pipe - f.h_buf_out))

    def start(self, d: Disturbances, air_temperature: float, p: EnergyParameters) -> EnergyState:
        return EnergyState(START * p.e_buf_max)

    def capacities(self, p: Mapping[str, float]) -> tuple[Capacity, ...]:
        return (
            Capacity("uBoil", "boiler", "W m-2", p["pBoil"] / p["aFlr"], "heat of the boiler to the buffer", "Boiler"),
            Capacity("uChp", "engine", "W m-2", p["pChpEl"], "electric power of the engine", "Engine"),
            Capacity("uPipe", "pipe_heat", "W m-2", p["pPipe"], "heat of the buffer to the rail pipes", "Heating"),
        )

    def flows(self) -> tuple[Flow, ...]:
        def hours(step: Step) -> Expr:
            return np.sign(step.controls.u_chp) * (step.seconds / HOUR)

        def starts(step: Step) -> Expr:  # 1 in a step in which the engine runs and in the one before did not
            return np.sign(step.controls.u_chp) * (1.0 - np.sign(step.controls_before.u_chp))

        energies = (
            ("gas", "gas burnt, lower heating value", "Gas", lambda now: now.gas),
            ("engine_heat", "heat of the engine", "Heat of the engine", lambda now: now.h_chp),
            ("electricity_made", "electricity of the engine", "Electricity made", lambda now: now.q_made),
            ("electricity_bought", "electricity bought for the lamps", "Electricity bought", _bought),
            ("electricity_sold", "electricity of the engine that is sold", "Electricity sold", _sold),
        )
        masses = (
            ("co2_made", "CO2 of the gas burnt", "CO₂ of the gas", lambda now: now.mc_flue),
            ("co2_from_flue", "CO2 dosed from flue gas", "CO₂ from flue gas", _from_flue),
            ("co2_vented", "CO2 of the gas burnt that is not dosed", "CO₂ vented", lambda now: fmax(now.mc_flue - now.mc_dosed, 0.0)),
            ("co2_bought", "CO2 bought to be dosed", "CO₂ bought", _co2_bought),
        )
        return (
            *(Flow(name, "kWh m-2", words, label, _summed(of, 1 / JOULES_PER_KWH)) for name, words, label, of in energies),
            *(Flow(name, "kg m-2", words, label, _summed(of, KG_PER_MG)) for name, words, label, of in masses),
            Flow("engine_hours", "h", "time that the engine runs", "Engine", hours),
            Flow("engine_starts", "-", "starts of the engine", "Starts of the engine", starts),
        )

    def stocks(self) -> tuple[Stock, ...]:
        return (Stock("buffer_heat", "MJ m-2", "heat in the buffer", "Heat in the buffer", lambda x, p: x.e_buf),)

    def signals(self) -> tuple[Signal, ...]:
        daily = (
            ("gas_today", "Gas burnt since midnight", "kWh m⁻²", lambda now: now.gas),
            ("power_bought_today", "Electricity bought since midnight", "kWh m⁻²", _bought),
            ("power_sold_today", "Electricity sold since midnight", "kWh m⁻²", _sold),
            ("co2_from_flue_today", "CO₂ dosed from flue gas since midnight", "g m⁻²", _from_flue),
            ("co2_bought_today", "CO₂ bought since midnight", "g m⁻²", _co2_bought),
        )
        per_unit = {"kWh m⁻²": 1 / JOULES_PER_KWH, "g m⁻²": 1e-3}
        return (
            Signal("controls/boiler", "Boiler", "%", "uBoil", 100.0),
            Signal("controls/engine", "Engine (combined heat and power)", "%", "uChp", 100.0),
            Signal("controls/pipe_heat", "Heating: buffer to pipes", "%", "uPipe", 100.0),
            Signal("energy/buffer", "Heat in the buffer", "MJ m⁻²", "eBuf"),
            Signal("energy/buffer_share", "Buffer filled", "%", "", of=filled),
            *(Signal(f"energy/{name}", label, unit, "", today=_a_second(of, per_unit[unit])) for name, label, unit, of in daily),
        )

    def bounds(self, horizon: Horizon) -> Mapping[str, tuple[float, float]]:
        full = horizon.parameters["eBufMax"]
        return {"eBuf": (-_BEYOND * full, round_up((1 + _BEYOND) * full))}

    def observed(self, module: str, horizon: Horizon) -> tuple[ObservedColumn, ...] | None:
        if module != "energy":
            return None
        outside = 100 * _BEYOND
        return (
            ObservedColumn("buffer_heat", "MJ m-2", "heat in the buffer", "eBuf", *self.bounds(horizon)["eBuf"]),
            ObservedColumn("buffer_share", "%", "how full the buffer is", "", -outside, 100 + outside, of=filled),
        )


def filled(x: Any, p: Any) -> Expr:
    """How full the buffer is [%]."""
    return x.e_buf * (100 / p.e_buf_max)


_OfPlant = Callable[[Plant], Expr]


def _bought(now: Plant) -> Expr:
    return fmax(now.q_used - now.q_made, 0.0)


def _sold(now: Plant) -> Expr:
    return fmax(now.q_made - now.q_used, 0.0)


def _from_flue(now: Plant) -> Expr:
    return fmin(now.mc_dosed, now.mc_flue)


def _co2_bought(now: Plant) -> Expr:
    return fmax(now.mc_dosed - now.mc_flue, 0.0)


def _summed(of: _OfPlant, factor: float) -> Callable[[Step], Expr]:
    """What comes in a step: ``factor`` turns the unit of the rate times a second into that of the flow."""
    return lambda step: of(plant(step.controls, step.parameters)) * (step.seconds * factor)


def _a_second(of: _OfPlant, factor: float) -> Callable[[Record, Record, Record], Expr]:
    """What comes in a second, from controls, disturbances and parameters."""
    return lambda u, d, p: of(plant(u, p)) * factor


PIPE_HEAT = Meter("h_buf_pipe", "heat_to_pipes", "J m-2", "heat of the buffer to the rail pipes", "Heat to the pipes", scale=1e6, small=1e4)
"""The heat that the greenhouse gets."""

DUMPED = Meter("h_dump_out", "heat_dumped", "J m-2", "heat that a full buffer refused", "Heat dumped", scale=1e6, small=1e4)
"""The heat that is lost because the buffer is full."""
