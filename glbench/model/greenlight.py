"""The GreenLight climate: air, construction and equipment of a greenhouse, from weather, controls and a crop's leaf area.

Units and signs are in docs/nomenclature.md. Source: Katzin (2021) on top of Vanthoor (2011).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

from glbench.errors import ParameterError
from glbench.model.actuators import Actuators, actuators
from glbench.model.air import humidity_deficit, saturation_vapour_pressure, vapour_pressure_deficit
from glbench.model.balances import ClimateFluxes, climate_balances, without
from glbench.model.bounds import (
    COLDEST,
    HOTTEST,
    HOTTEST_METAL,
    LARGEST_VAPOUR_PRESSURE,
    Horizon,
    highest_co2_density,
    highest_co2_ppm,
    highest_light_sums,
    round_up,
)
from glbench.model.capacities import capacities
from glbench.model.co2 import co2_transport
from glbench.model.controls import Controls as ClimateControls
from glbench.model.convection import convection
from glbench.model.derived import derived_climate
from glbench.model.disturbances import Disturbances
from glbench.model.expressions import Expr
from glbench.model.longwave import long_wave, views
from glbench.model.model import Capacity, Flow, ObservedColumn, Record, Signal, Step
from glbench.model.optics import cover_optics
from glbench.model.parameter_checks import Order, Shares
from glbench.model.parameter_table import read_table
from glbench.model.parameters import ClimateParameters
from glbench.model.quantities import states_of, table_of
from glbench.model.shortwave import par_above, photons_of, short_wave
from glbench.model.states import ClimateState
from glbench.model.submodels import Climate
from glbench.model.surroundings import AirExchange, CropExchange, Surroundings
from glbench.model.transpiration import transpiration
from glbench.model.vapour import vapour
from glbench.model.variants import AUTHOR, Variant
from glbench.model.ventilation import ventilation
from glbench.quantities import AIR, DEFICITS, FLOWS, INSIDE, LIGHT, OUTDOOR, Entry, raised_unit

JOULES_PER_KWH = 3.6e6
KG_PER_MG = 1e-6
MOL_PER_UMOL = 1e-6
SQUARE_METRES_PER_SQUARE_CENTIMETRE = 1e-4

START_HUMIDITY = 0.90
"""Relative humidity of main and top air at the start [-]."""

CANOPY_EXCESS = 4.0
"""Canopy temperature above air temperature at the start [K]."""

_METAL = frozenset(("tPipe", "tGroPipe", "tLamp", "tIntLamp"))

SHARES: tuple[Shares, ...] = (
    Shares("the sun's energy", ("etaGlobPar", "etaGlobNir")),
    Shares("PAR on the roof", ("tauRfPar", "rhoRfPar")),
    Shares("NIR on the roof", ("tauRfNir", "rhoRfNir")),
    Shares("far-infrared on the roof", ("tauRfFir", "rhoRfFir")),
    Shares("PAR on the thermal screen", ("tauThScrPar", "rhoThScrPar")),
    Shares("NIR on the thermal screen", ("tauThScrNir", "rhoThScrNir")),
    Shares("PAR on the blackout screen", ("tauBlScrPar", "rhoBlScrPar")),
    Shares("NIR on the blackout screen", ("tauBlScrNir", "rhoBlScrNir")),
    Shares("PAR on the lamp layer", ("tauLampPar", "rhoLampPar")),
    Shares("NIR on the lamp layer", ("tauLampNir", "rhoLampNir")),
    Shares("the lamps' power", ("etaLampPar", "etaLampNir", "etaLampCool")),
    Shares("the interlights' power", ("etaIntLampPar", "etaIntLampNir")),
)
"""Sums that energy conservation bounds. The far-infrared properties of the screens are not among them: in the author's
data the blackout screen transmits 0.7 and emits 0.67."""


@dataclass(frozen=True)
class GreenLightClimate(Climate):
    """The greenhouse of Katzin (2021): two air layers, canopy, cover, two screens, floor, five soil layers, pipes and lamps."""

    variant: Variant = AUTHOR

    name: ClassVar[str] = "greenlight"
    State: ClassVar[type[ClimateState]] = ClimateState
    Controls: ClassVar[type[ClimateControls]] = ClimateControls
    Parameters: ClassVar[type[ClimateParameters]] = ClimateParameters
    table = read_table(ClimateParameters)
    shares = SHARES
    orders = (
        Order("hAir", "hGh", "the main air lies below the ridge"),
        Order("phiPipeI", "phiPipeE", "a pipe's wall has a thickness"),
        Order("phiGroPipeI", "phiGroPipeE", "a pipe's wall has a thickness"),
    )
    air = ("tAir", "co2Air", "vpAir")
    singular = ("tAir", "tTop")
    canopy = "tCan"
    observation_modules: ClassVar[Mapping[str, str]] = {
        "indoor_climate": "air temperature, CO2, relative humidity, pipe temperature",
        "published_indoor_climate": "as indoor_climate, CO2 first",
        "vapour_deficit": "vapour pressure deficit and humidity deficit of the air as observed",
        "light_today": "radiation outside and PAR above the canopy, summed since midnight",
    }

    @property
    def variant_name(self) -> str:  # type: ignore[override]
        return self.variant.name

    def actuators(self, u: ClimateControls, p: ClimateParameters) -> Actuators:
        return actuators(u, p)

    def processes(
        self, lai: Expr, act: Actuators, x: ClimateState, u: ClimateControls, d: Disturbances, p: ClimateParameters
    ) -> ClimateFluxes:
        variant = self.variant
        cap = capacities(lai, x, p)
        optics = cover_optics(u, p)
        light = short_wave(lai, optics, act, d, p)
        view_factors = views(lai, optics, p)
        air = ventilation(x, u, d, p, variant)
        heat = convection(lai, x, air, u, d, p, variant)
        return ClimateFluxes(
            optics=optics,
            capacities=cap,
            actuators=act,
            short_wave=light,
            views=view_factors,
            long_wave=long_wave(view_factors, x, optics, u, d, p, variant),
            ventilation=air,
            convection=heat,
            transpiration=transpiration(lai, light.r_can, x, p),
            vapour=vapour(x, air, heat, d, p, variant),
            co2=co2_transport(x, air, d),
        )

    def surroundings(self, lai: Expr, x: ClimateState, fluxes: ClimateFluxes, p: ClimateParameters) -> Surroundings:
        return Surroundings(lai, fluxes.short_wave, x, p)

    def rates(self, x: ClimateState, fluxes: ClimateFluxes, uptake: CropExchange, p: ClimateParameters) -> ClimateState:
        return climate_balances(p, fluxes, uptake)

    def without(self, rates: ClimateState, fluxes: ClimateFluxes, extraction: AirExchange, p: ClimateParameters) -> ClimateState:
        return without(rates, p, fluxes, extraction)

    def derived(self, p: ClimateParameters) -> ClimateParameters:
        return derived_climate(p)

    def refuse(self, values: Mapping[str, float]) -> None:
        if not values["aRoof"] + values["aSide"] > 0:
            msg = "aRoof and aSide are both 0 m2: the model needs vents. Set aRoof to their area; the control may keep them shut."
            raise ParameterError(msg)

    def start(self, d: Disturbances, air_temperature: float, p: ClimateParameters) -> ClimateState:
        """Air and surfaces at one temperature [°C], the canopy warmer, soil in between the air and the deep soil."""
        t0 = air_temperature
        vapour_pressure = float(START_HUMIDITY * saturation_vapour_pressure(t0))
        return ClimateState(
            co2_air=d.co2_out,
            co2_top=d.co2_out,
            t_air=t0,
            t_top=t0,
            t_can=t0 + CANOPY_EXCESS,
            t_cov_in=t0,
            t_cov_e=t0,
            t_th_scr=t0,
            t_flr=t0,
            t_pipe=t0,
            t_so1=t0,
            t_so2=(3 * t0 + d.t_so_out) / 4,
            t_so3=(2 * t0 + 2 * d.t_so_out) / 4,
            t_so4=(t0 + 3 * d.t_so_out) / 4,
            t_so5=d.t_so_out,
            vp_air=vapour_pressure,
            vp_top=vapour_pressure,
            t_lamp=t0,
            t_int_lamp=t0,
            t_gro_pipe=t0,
            t_bl_scr=t0,
        )

    def capacities(self, p: Mapping[str, float]) -> tuple[Capacity, ...]:
        """Installed capacities: the controls in their order, and what each delivers at 1."""
        floor = p["aFlr"]
        installed = (
            ("boiler", "W m-2", p["pBoil"] / floor, "heat to the rail pipes", "Heating"),
            ("co2_supply", "mg m-2 s-1", p["phiExtCo2"] / floor, "CO2 dosed", "CO₂ dosing"),
            ("thermal_screen", "-", 1.0, "closure of the thermal screen", "Thermal screen"),
            ("vents", "-", 1.0, "opening of the roof vents", "Vents"),
            ("lamps", "W m-2", p["thetaLampMax"], "electric power of the lamps", "Lamps"),
            ("blackout_screen", "-", 1.0, "closure of the blackout screen", "Blackout screen"),
        )
        return tuple(Capacity(control.name, *entry) for control, entry in zip(table_of(self.Controls), installed, strict=True))

    def flows(self) -> tuple[Flow, ...]:
        return (
            _flow(FLOWS["heat"], _heat),
            _flow(FLOWS["electricity"], _electricity),
            _flow(FLOWS["co2_dosed"], _co2_dosed),
            _flow(FLOWS["lamp_light"], _lamp_light),
        )

    def signals(self) -> tuple[Signal, ...]:
        return (
            Signal("climate/canopy_temperature", "Canopy temperature", "°C", "tCan"),
            _signal("climate/pipe_temperature", INSIDE["pipe_temperature"], "tPipe"),
            _signal("climate/par_today", LIGHT["par_today"], "", _photons),
            Signal("controls/boiler", "Boiler valve (heating)", "%", "uBoil", 100.0),
            Signal("controls/vents", "Roof vents open", "%", "uVent", 100.0),
            Signal("controls/lamps", "Lamps", "%", "uLamp", 100.0),
            Signal("controls/co2_dosing", "CO₂ dosing valve", "%", "uCo2", 100.0),
            Signal("controls/thermal_screen", "Thermal screen closed", "%", "uThScr", 100.0),
            Signal("controls/blackout_screen", "Blackout screen closed", "%", "uBlScr", 100.0),
            _signal("weather/global_radiation", OUTDOOR["global_radiation"], "iGlob"),
            _signal("weather/radiation_today", LIGHT["radiation_today"], "", _radiation),
            _signal("weather/temperature", OUTDOOR["outdoor_temperature"], "tOut"),
            _signal("weather/wind", OUTDOOR["wind_speed"], "wind"),
            _signal("weather/vapour_pressure", OUTDOOR["outdoor_vapour_pressure"], "vpOut"),
        )

    def bounds(self, horizon: Horizon) -> Mapping[str, tuple[float, float]]:
        by_unit = {"mg m-3": (0.0, highest_co2_density(horizon)), "Pa": (0.0, LARGEST_VAPOUR_PRESSURE), "°C": (COLDEST, HOTTEST)}
        return {state.name: (COLDEST, HOTTEST_METAL) if state.name in _METAL else by_unit[state.unit] for state in states_of(ClimateState)}

    def observed(self, module: str, horizon: Horizon) -> tuple[ObservedColumn, ...] | None:
        temperature, co2, humidity = (
            ObservedColumn(name, entry.unit, entry.observed, name, low, high)
            for (name, entry), (low, high) in zip(
                AIR.items(), ((COLDEST, HOTTEST), (0.0, highest_co2_ppm(horizon)), (0.0, 100.0)), strict=True
            )
        )
        pipe = _column(INSIDE["pipe_temperature"], COLDEST, HOTTEST_METAL, "tPipe")
        driest = round_up(vapour_pressure_deficit(HOTTEST, 0.0)), round_up(humidity_deficit(HOTTEST, 0.0))
        vpd, deficit = (
            replace(_column(DEFICITS[name], 0.0, most), of_air=of)
            for name, most, of in (
                ("vapour_pressure_deficit", driest[0], lambda air: vapour_pressure_deficit(air.air_temperature, air.relative_humidity)),
                ("humidity_deficit", driest[1], lambda air: humidity_deficit(air.air_temperature, air.relative_humidity)),
            )
        )
        brightest = highest_light_sums(horizon)
        radiation, par = (
            ObservedColumn(name, LIGHT[name].unit, f"{LIGHT[name].meaning}, summed since midnight", "", 0.0, most, today=rate)
            for name, most, rate in (("radiation_today", brightest[0], _radiation), ("par_today", brightest[1], _photons))
        )
        return {
            "vapour_deficit": (vpd, deficit),
            "light_today": (radiation, par),
            "indoor_climate": (temperature, co2, humidity, pipe),
            "published_indoor_climate": (co2, temperature, humidity, pipe),
        }.get(module)


def _flow(entry: Entry, amount: Callable[[Step], Expr]) -> Flow:
    return Flow(entry.name, entry.unit, entry.meaning, entry.amount_label or entry.item_label, amount)


def _signal(path: str, entry: Entry, source: str, today: Callable[[Record, Record, Record], Expr] | None = None) -> Signal:
    return Signal(path, entry.label, raised_unit(entry.unit), source, today=today)


def _column(entry: Entry, low: float, high: float, source: str = "") -> ObservedColumn:
    return ObservedColumn(entry.name, entry.unit, entry.meaning, source, low, high)


def _heat(step: Step) -> Expr:
    """Heat of the boiler [kWh m-2]."""
    p = step.parameters
    return step.controls.u_boil * (p.p_boil / p.a_flr * (step.seconds / JOULES_PER_KWH))


def _electricity(step: Step) -> Expr:
    """Electricity of the lamps [kWh m-2]."""
    return step.controls.u_lamp * (step.parameters.theta_lamp_max * (step.seconds / JOULES_PER_KWH))


def _lamp_light(step: Step) -> Expr:
    """Photons of PAR from the lamps [mol m-2]."""
    p = step.parameters
    return step.controls.u_lamp * ((p.eta_lamp_par * p.zeta_lamp_par * p.theta_lamp_max) * step.seconds * MOL_PER_UMOL)


def _co2_dosed(step: Step) -> Expr:
    """CO2 dosed [kg m-2]."""
    p = step.parameters
    return step.controls.u_co2 * (p.phi_ext_co2 / p.a_flr * step.seconds * KG_PER_MG)


def _radiation(u: Record, d: Disturbances, p: Record) -> Expr:
    """Global radiation outside [J cm-2 s-1]."""
    return SQUARE_METRES_PER_SQUARE_CENTIMETRE * d.i_glob


def _photons(u: Record, d: Disturbances, p: Record) -> Expr:
    """PAR above the canopy [mol m-2 s-1]: what roof, screens and lamps let through of the sun's, and the lamps' own."""
    return MOL_PER_UMOL * photons_of(par_above(cover_optics(u, p), actuators(u, p), d, p), p)
