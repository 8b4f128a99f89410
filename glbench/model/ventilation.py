"""Air exchange: through roof vents and leaks to the outside, and through the screens between main air and top air.

Air fluxes are per floor area [m3 m-2 s-1], that is [m s-1]. Roof vents and a share of the leakage exchange the top air
with the outside; the rest of the leakage exchanges the main air.
Source: Vanthoor (2011) eqs 8.41 and 8.65-8.73, De Zwart (1996) eq. 5.68, Katzin (2021) eqs 7.37-7.42.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

from glbench.model.air import kelvin
from glbench.model.controls import Controls
from glbench.model.disturbances import Disturbances
from glbench.model.expressions import Expr, fmax, fmin, fourth_root, if_else, magnitude_power, sqrt, square
from glbench.model.parameters import ClimateParameters
from glbench.model.quantities import Quantity
from glbench.model.states import ClimateState
from glbench.model.variants import Variant

SCREEN_EXPONENT = 0.66
"""Exponent of the temperature difference in the flow through closed screen cloth [-]. De Zwart (1996) eq. 5.68."""

SMOOTH_DENSITY = 1e-20
"""Added to a squared density difference [kg2 m-6] under a root: finite slope where both air layers are equally dense."""

SMOOTH_DRIVE = 1e-24
"""Added to the squared driving term of a roof vent [m4 s-4] under a root: finite slope where buoyancy and wind cancel."""

SMOOTH_PRESSURE_COEFFICIENT = 1e-30
"""Added to the wind pressure coefficient [-] under a root: finite slope for a vent that the wind does not affect."""


class Ventilation(NamedTuple):
    """Air exchange per floor area, and the air densities that drive it."""

    eta_roof: Annotated[Expr, Quantity("-", "share of the roof vents in the area of all vents")]
    a_roof_u: Annotated[Expr, Quantity("m2", "open area of the roof vents")]
    f_vent_roof2: Annotated[Expr, Quantity("m3 m-2 s-1", "air exchange of the roof vents alone")]
    f_vent_roof_side2: Annotated[Expr, Quantity("m3 m-2 s-1", "air exchange of roof and side vents by wind")]
    f_leakage: Annotated[Expr, Quantity("m3 m-2 s-1", "leakage of the closed greenhouse")]
    f_vent_roof: Annotated[Expr, Quantity("m3 m-2 s-1", "air exchange of top air and outside")]
    f_vent_side: Annotated[Expr, Quantity("m3 m-2 s-1", "air exchange of main air and outside")]
    rho_air: Annotated[Expr, Quantity("kg m-3", "density of the main air")]
    rho_top: Annotated[Expr, Quantity("kg m-3", "density of the top air")]
    rho_air_mean: Annotated[Expr, Quantity("kg m-3", "mean density of main and top air")]
    f_th_scr: Annotated[Expr, Quantity("m3 m-2 s-1", "air exchange that the thermal screen allows")]
    f_bl_scr: Annotated[Expr, Quantity("m3 m-2 s-1", "air exchange that the blackout screen allows")]
    f_scr: Annotated[Expr, Quantity("m3 m-2 s-1", "air exchange of main air and top air")]


class Densities(NamedTuple):
    """Air density [kg m-3] below and above the screens."""

    air: Expr
    top: Expr
    mean: Expr


def f_roof_vents(open_area: Expr, x: ClimateState, d: Disturbances, p: ClimateParameters) -> Expr:
    """Exchange of the roof vents by buoyancy and wind [m3 m-2 s-1]. Vanthoor (2011) eq. 8.65.

    The buoyancy term is negative when the outside is warmer; the root takes the magnitude of the sum.
    """
    mean_temperature = kelvin(0.5 * x.t_air + 0.5 * d.t_out)
    drive = p.g * p.h_vent * (x.t_air - d.t_out) / (2 * mean_temperature) + p.c_wgh * square(d.wind)
    return open_area * p.c_dgh / (2 * p.a_flr) * fourth_root(square(drive) + SMOOTH_DRIVE)


def f_wind_through_vents(open_area: Expr, d: Disturbances, p: ClimateParameters) -> Expr:
    """Exchange by wind pressure between roof and side vents, side vents closed [m3 m-2 s-1]. Vanthoor (2011) eq. 8.66."""
    return p.c_dgh / p.a_flr * open_area / 2 * sqrt(p.c_wgh + SMOOTH_PRESSURE_COEFFICIENT) * d.wind


def f_leak(wind: Expr, p: ClimateParameters) -> Expr:
    """Leakage of the closed greenhouse [m3 m-2 s-1], constant below a wind of ``minWind``. Vanthoor (2011) eq. 8.71."""
    return p.c_leakage * fmax(wind, p.min_wind)


def air_density(temperature: Expr, p: ClimateParameters) -> Expr:
    """Density of dry air [kg m-3] at the pressure of the site."""
    return p.m_air * p.pressure / (p.R * kelvin(temperature))


def f_through_screen(closure: Expr, permeability: Expr, x: ClimateState, v: Densities, p: ClimateParameters, variant: Variant) -> Expr:
    """Exchange that one screen allows [m3 m-2 s-1]: through its cloth, and through the gap that it leaves open.

    Vanthoor (2011) eq. 8.41, Katzin (2021) eq. 7.37. Erratum by the model's author: the printed equation compares the
    main air with the outside; temperature and density must be those of the top air (De Zwart 1996, eq. 5.68), whose
    square root in turn lacks the absolute value.
    """
    warmer = x.t_air - x.t_top + variant.temperature_difference_guard
    cloth = closure * permeability * magnitude_power(warmer, SCREEN_EXPONENT)
    # A screen is never more than closed: solvers may overshoot their bounds by a rounding error.
    gap = fmax(1 - closure, 0)
    difference = square(v.air - v.top) + SMOOTH_DENSITY
    if variant.screen_flow_guard:
        drive = 0.5 * v.mean * gap * p.g * sqrt(difference) + variant.screen_flow_guard
        return cloth + gap / v.mean * sqrt(drive)
    # The same with gap^1.5 taken out of the root, for a finite slope at a closed screen.
    return cloth + gap**1.5 * fourth_root(square(0.5 * p.g / v.mean) * difference)


def ventilation(x: ClimateState, u: Controls, d: Disturbances, p: ClimateParameters, variant: Variant) -> Ventilation:
    """All air exchange. Vanthoor (2011) eqs 8.65-8.73, Katzin (2021) eqs 7.37-7.42.

    Above a roof share of ``etaRoofThr`` the roof vents work alone; below it the screens decide how much of their exchange
    is a chimney effect. The benchmark greenhouse has no side vents, so it is always in the first case.
    """
    # Row 11: the published code knows no side vents.
    eta_roof = p.a_roof / (p.a_roof + p.a_side) if variant.side_vents_counted else 1.0
    a_roof_u = u.u_vent * p.a_roof
    roof = f_roof_vents(a_roof_u, x, d, p)
    by_wind = f_wind_through_vents(a_roof_u, d, p)
    leakage = f_leak(d.wind, p)
    screens = fmax(u.u_th_scr, u.u_bl_scr)
    roof_alone = eta_roof >= p.eta_roof_thr
    roof_mixed = screens * roof + (1 - screens) * by_wind * eta_roof
    side_mixed = (1 - screens) * by_wind * (1 - eta_roof)

    air, top = air_density(x.t_air, p), air_density(x.t_top, p)
    densities = Densities(air, top, 0.5 * (air + top))
    f_th_scr = f_through_screen(u.u_th_scr, p.k_th_scr, x, densities, p, variant)
    f_bl_scr = f_through_screen(u.u_bl_scr, p.k_bl_scr, x, densities, p, variant)
    return Ventilation(
        eta_roof=eta_roof,
        a_roof_u=a_roof_u,
        f_vent_roof2=roof,
        f_vent_roof_side2=by_wind,
        f_leakage=leakage,
        f_vent_roof=p.eta_ins_scr * if_else(roof_alone, roof, roof_mixed) + p.c_leak_top * leakage,
        f_vent_side=p.eta_ins_scr * if_else(roof_alone, 0.0, side_mixed) + (1 - p.c_leak_top) * leakage,
        rho_air=densities.air,
        rho_top=densities.top,
        rho_air_mean=densities.mean,
        f_th_scr=f_th_scr,
        f_bl_scr=f_bl_scr,
        f_scr=fmin(f_th_scr, f_bl_scr),
    )
