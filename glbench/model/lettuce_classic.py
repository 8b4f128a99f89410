"""Van Henten's lettuce greenhouse with four states, as a benchmark of control uses it: ``lettuce-classic-1.0.0``.

The model is that of van Henten (2003), Sensitivity analysis of an optimal control problem in greenhouse climate management, Biosystems
Engineering 85 (3), equations 2 to 11, and that of van Henten (1994). Its step, ranges and coefficients are those of the package
lettuce-greenhouse-gym 0.1.3, with which published results were made: Runge-Kutta steps of 450 s, after which every state is limited.
Where both differ, the package counts. Its leakage is a tenth of the paper's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, NamedTuple

from glbench.model.air import vapour_density, vapour_pressure
from glbench.model.bounds import Horizon
from glbench.model.disturbances import Disturbances
from glbench.model.expressions import Expr, exp, square
from glbench.model.model import Capacity, Evaluation, Flow, Model, ObservedColumn, Signal, Start, StepMap, Stock
from glbench.model.parameter_table import Parameter, declared_table
from glbench.model.quantities import Quantity, Variable
from glbench.quantities import AIR, FLOWS

MG_PER_KG = 1e6
MOST_CO2, MOST_VENTILATION, MOST_HEAT = 1.2e-6, 7.5e-3, 150.0  # kg m-2 s-1, m s-1, W m-2
_JOULES_PER_KWH = 3.6e6
_LOW, _HIGH = (0.002, 0.0, 5.0, 0.0), (0.6, 0.004, 40.0, 0.051)
_MOST_PPM = 2400.0  # the highest density in the hottest air is 2335 ppm


class ClassicState(NamedTuple):
    """What stands in the greenhouse."""

    x_d: Annotated[Expr, Variable("kg m-2", "dry weight of the crop", scale=0.1, small=1e-4)]
    x_c: Annotated[Expr, Variable("kg m-3", "CO2 in the air", scale=1e-3, small=1e-6)]
    x_t: Annotated[Expr, Variable("°C", "temperature of the air")]
    x_h: Annotated[Expr, Variable("kg m-3", "water vapour in the air", scale=1e-2, small=1e-5)]


class ClassicControls(NamedTuple):
    """Shares of what is installed."""

    u_co2: Annotated[Expr, Quantity("-", "CO2 supply")]
    u_vent: Annotated[Expr, Quantity("-", "ventilation")]
    u_heat: Annotated[Expr, Quantity("-", "heating")]


def _coefficient(symbol: str, unit: str, meaning: str, value: float) -> Parameter:
    return Parameter(unit, meaning, value, f"{symbol} of van Henten (2003), as in lettuce-greenhouse-gym 0.1.3", "positive", "classic")


class ClassicParameters(NamedTuple):
    """The 23 coefficients."""

    sat_vp1: Annotated[Expr, _coefficient("c_v,1", "J m-3", "saturation of the air at 0 °C", 9348.0)]
    sat_vp2: Annotated[Expr, _coefficient("c_v,2", "-", "exponent of saturation", 17.4)]
    sat_vp3: Annotated[Expr, _coefficient("c_v,3", "°C", "temperature in the exponent of saturation", 239.0)]
    sat_vp4: Annotated[Expr, _coefficient("c_v,4", "J m-3", "saturation in the paper's limit of humidity; not read", 10998.0)]
    gas_constant: Annotated[Expr, _coefficient("c_R", "J K-1 kmol-1", "gas constant", 8314.0)]
    t_abs: Annotated[Expr, _coefficient("c_T,abs", "K", "0 °C", 273.15)]
    leakage: Annotated[Expr, _coefficient("c_leak", "m s-1", "leakage through the cover", 0.75e-5)]
    cap_co2: Annotated[Expr, _coefficient("c_cap,c", "m", "volume of air for CO2", 4.1)]
    cap_vapour: Annotated[Expr, _coefficient("c_cap,h", "m", "volume of air for vapour", 4.1)]
    cap_heat: Annotated[Expr, _coefficient("c_cap,q", "J m-2 K-1", "heat capacity of the greenhouse", 3e4)]
    cap_air: Annotated[Expr, _coefficient("c_cap,q,v", "J m-3 K-1", "heat capacity of air", 1290.0)]
    cover_heat: Annotated[Expr, _coefficient("c_ai,ou", "W m-2 K-1", "heat transfer through the cover", 6.1)]
    sun_heat: Annotated[Expr, _coefficient("c_rad,q", "-", "share of the radiation that heats the air", 0.2)]
    yield_factor: Annotated[Expr, _coefficient("c_αβ", "-", "dry weight from CO2", 0.544)]
    resp_dry: Annotated[Expr, _coefficient("c_resp,d", "s-1", "respiration at 25 °C, share of the dry weight", 2.65e-7)]
    resp_co2: Annotated[Expr, _coefficient("c_resp,c", "s-1", "CO2 respired at 25 °C, share of the dry weight", 4.87e-7)]
    leaf_surface: Annotated[Expr, _coefficient("c_pl,d", "m2 kg-1", "effective surface of leaves", 53.0)]
    light_use: Annotated[Expr, _coefficient("c_rad,phot", "kg J-1", "CO2 fixed from light", 3.55e-9)]
    s_co2_1: Annotated[Expr, _coefficient("c_co2,1", "m s-1 K-2", "conductance of leaves to CO2, square of temperature", 5.11e-6)]
    s_co2_2: Annotated[Expr, _coefficient("c_co2,2", "m s-1 K-1", "conductance of leaves to CO2, temperature", 2.3e-4)]
    s_co2_3: Annotated[Expr, _coefficient("c_co2,3", "m s-1", "conductance of leaves to CO2, constant", 6.29e-4)]
    compensation: Annotated[Expr, _coefficient("c_Γ", "kg m-3", "CO2 at which photosynthesis begins", 5.2e-5)]
    transpiration: Annotated[Expr, _coefficient("c_v,pl,ai", "m s-1", "conductance of the canopy to vapour", 3.6e-3)]


class Exchange(NamedTuple):
    """What flows in the greenhouse."""

    cover: Annotated[Expr, Quantity("-", "share of the floor that leaves cover")]
    photosynthesis: Annotated[Expr, Quantity("kg m-2 s-1", "CO2 taken up by photosynthesis, gross")]
    transpired: Annotated[Expr, Quantity("kg m-2 s-1", "water transpired")]
    co2_lost: Annotated[Expr, Quantity("kg m-2 s-1", "CO2 that air exchange takes out")]
    vapour_lost: Annotated[Expr, Quantity("kg m-2 s-1", "vapour that air exchange takes out")]
    heat_lost: Annotated[Expr, Quantity("W m-2", "heat lost through vents and cover")]


def exchange(x: ClassicState, u: ClassicControls, d: Disturbances, p: ClassicParameters) -> Exchange:
    """All fluxes at a state, with controls, weather and coefficients."""
    cover = 1 - exp(-p.leaf_surface * x.x_d)
    by_light = p.light_use * d.i_glob
    by_co2 = (-p.s_co2_1 * square(x.x_t) + p.s_co2_2 * x.x_t - p.s_co2_3) * (x.x_c - p.compensation)
    saturated = p.sat_vp1 / (p.gas_constant * (x.x_t + p.t_abs)) * exp(p.sat_vp2 * x.x_t / (x.x_t + p.sat_vp3))
    ventilation = u.u_vent * MOST_VENTILATION
    return Exchange(
        cover=cover,
        photosynthesis=cover * (by_light * by_co2) / (by_light + by_co2),
        transpired=cover * p.transpiration * (saturated - x.x_h),
        co2_lost=(ventilation + p.leakage) * (x.x_c - d.co2_out / MG_PER_KG),
        vapour_lost=(ventilation + p.leakage) * (x.x_h - vapour_density(d.t_out, d.vp_out)),
        heat_lost=(p.cap_air * ventilation + p.cover_heat) * (x.x_t - d.t_out),
    )


def rates(x: ClassicState, u: ClassicControls, d: Disturbances, p: ClassicParameters, f: Exchange) -> ClassicState:
    """Time derivative of the state; respiration doubles with 10 K."""
    warmth = 2 ** (0.1 * x.x_t - 2.5)
    return ClassicState(
        x_d=p.yield_factor * f.photosynthesis - p.resp_dry * x.x_d * warmth,
        x_c=(u.u_co2 * MOST_CO2 + p.resp_co2 * x.x_d * warmth - f.photosynthesis - f.co2_lost) / p.cap_co2,
        x_t=(u.u_heat * MOST_HEAT + p.sun_heat * d.i_glob - f.heat_lost) / p.cap_heat,
        x_h=(f.transpired - f.vapour_lost) / p.cap_vapour,
    )


@dataclass(frozen=True)
class ClassicLettuce(Model):
    """Dry weight of the crop, CO2, temperature and vapour of the air."""

    State = ClassicState
    Controls = ClassicControls
    Parameters = ClassicParameters
    name: ClassVar[str] = "lettuce-classic"
    version: ClassVar[str] = "1.0.0"
    table: ClassVar[Any] = declared_table(ClassicParameters)
    step_map: ClassVar[StepMap] = StepMap(_LOW, _HIGH)
    air: ClassVar[tuple[str, str, str]] = ("xT", "xC", "xH")
    crop_states: ClassVar[tuple[str, ...]] = ("xD",)
    observation_modules: ClassVar[Mapping[str, str]] = {
        "crop": "dry weight of the crop",
        "indoor_climate": "CO2, temperature, relative humidity of the air",
    }

    def equations(self, x: ClassicState, u: ClassicControls, d: Disturbances, p: ClassicParameters) -> Evaluation:
        f = exchange(x, u, d, p)
        return Evaluation(rates(x, u, d, p, f), (f,))

    def air_of(self, temperature: Expr, co2: Expr, vapour: Expr) -> tuple[Expr, Expr, Expr]:
        return temperature, co2 * MG_PER_KG, vapour_pressure(temperature, vapour)

    def starts(self) -> Mapping[str, Start]:
        return {"transplants": lambda d, air_temperature, p: ClassicState(0.0035, 1e-3, air_temperature, 0.008)}

    def capacities(self, p: Mapping[str, float]) -> tuple[Capacity, ...]:
        return (
            Capacity("uCo2", "co2_supply", "mg m-2 s-1", MOST_CO2 * MG_PER_KG, "CO2 supply", "CO₂ supply"),
            Capacity("uVent", "ventilation", "mm s-1", MOST_VENTILATION * 1e3, "air exchanged through vents", "Ventilation"),
            Capacity("uHeat", "heating", "W m-2", MOST_HEAT, "heating", "Heating"),
        )

    def flows(self) -> tuple[Flow, ...]:
        heat, co2, most = FLOWS["heat"], FLOWS["co2_dosed"], MOST_HEAT / _JOULES_PER_KWH
        return (
            Flow(heat.name, heat.unit, "heat supplied", heat.label, lambda s: s.controls.u_heat * (most * s.seconds)),
            Flow(co2.name, co2.unit, co2.meaning, co2.amount_label, lambda s: s.controls.u_co2 * (MOST_CO2 * s.seconds)),
        )

    def stocks(self) -> tuple[Stock, ...]:
        return (Stock("dry_weight", "kg m-2", "dry weight of the crop", "Lettuce, dry", lambda x, p: x.x_d),)

    def bounds(self, horizon: Horizon) -> Mapping[str, tuple[float, float]]:
        return dict(zip(self.state_names, zip(_LOW, _HIGH, strict=True), strict=True))

    def observed(self, module: str, horizon: Horizon) -> tuple[ObservedColumn, ...] | None:
        ranges = {"co2": (0.0, _MOST_PPM), "air_temperature": (_LOW[2], _HIGH[2]), "relative_humidity": (0.0, 100.0)}
        return {
            "crop": (ObservedColumn("dry_weight", "kg m-2", "dry weight of the crop", "xD", _LOW[0], _HIGH[0]),),
            "indoor_climate": tuple(
                ObservedColumn(name, AIR[name].unit, AIR[name].meaning, name, low, high) for name, (low, high) in ranges.items()
            ),
        }.get(module)

    def signals(self) -> tuple[Signal, ...]:
        return (Signal("crop/dry_weight", "Dry weight", "kg m⁻²", "xD"),)
