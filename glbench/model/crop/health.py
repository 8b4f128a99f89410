"""What long light and wet nights do to a tomato crop: injury that takes photosynthesis, and grey mould that takes leaves and fruit.

Long light. Tomatoes under lamps for more than about 17 hours a day turn yellow between the veins and photosynthesise less, and recover
when nights return. The injury here grows with the square of the hours beyond a threshold, and heals with time. Threshold and sizes are
set so that after four weeks 18 hours cost little, 20 hours more than the light brings, and continuous light half of photosynthesis.

Wet nights. Leaves and fruits get wet where they are colder than the dew point. The model has one temperature for the canopy, and one for
the air where the sensor hangs; a greenhouse has spots that are some degrees colder, and fruits whose temperature lags behind the air. The
hours that the crop is wet are counted, and fade when it dries. Grey mould (Botrytis cinerea) infects more the longer the crop is wet, and
spreads from parts that are diseased already: each wet night in a row costs more than the one before. Diseased parts rot or are taken out.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

from glbench.model.air import saturation_vapour_pressure
from glbench.model.balances import DAY
from glbench.model.expressions import Expr, fmax, sigmoid, square
from glbench.model.parameter_table import Parameter
from glbench.model.quantities import Quantity

HOUR = 3600.0
"""Seconds."""

DIM = 5.0
"""PAR above the canopy at which an hour counts as half an hour of light [umol m-2 s-1]; chosen: brighter than dusk, far below any lamp."""

COLD = 0.01
"""Least difference to the temperature below which mould does not infect [K]: infection is nearly 0, and its power has a finite slope."""

CREW = 20.0
"""Limits how much faster a crew clears a sick crop: 1 + 1 / (0.05 + 1 / CREW) = 11 times, within a day, if all is diseased; chosen."""


class HealthParameters(NamedTuple):
    """Parameters of long light and of grey mould. ``injury_max = 0`` switches injury off, ``growth_mould = 0`` mould."""

    hours_light: Annotated[
        Expr, Parameter("h", "light a day that injures nothing", 17.0, "Demers and Gosselin (2002): 17 h no harm, 20 h harm", "positive")
    ]
    injury_max: Annotated[
        Expr,
        Parameter("-", "share of photosynthesis that full injury takes", 0.65, "Sysoeva (2012): half after 3 weeks at 24 h", "fraction"),
    ]
    tau_injury: Annotated[Expr, Parameter("day", "time constant of injury at 24 h light", 7.0, "Haque (2015): within 12 days", "positive")]
    tau_recovery: Annotated[Expr, Parameter("day", "time constant of recovery: new leaves replace old", 28.0, "chosen", "positive")]
    dt_cold_spot: Annotated[
        Expr,
        Parameter(
            "K",
            "how much colder than the mean the cold spots of a crop are",
            2.5,
            "chosen: up to 3 K are measured (doi 10.3389/fhort.2024.1425285)",
            "nonnegative",
            sets=(("bleiswijk_2020", 1.25),),
        ),
    ]
    tau_fruit: Annotated[
        Expr, Parameter("s", "time constant with which a fruit follows the temperature of the air", 3900.0, "a sphere of 100 g", "positive")
    ]
    tau_dry: Annotated[
        Expr, Parameter("h", "time constant with which wet hours fade when the crop is dry", 4.0, "Broome et al. (1995)", "positive")
    ]
    hours_wet: Annotated[
        Expr, Parameter("h", "wet hours after which infection is half of the largest", 10.5, "Broome et al. (1995) at 20 °C", "positive")
    ]
    t_mould_min: Annotated[
        Expr,
        Parameter("°C", "temperature below which grey mould does not infect", 5.0, "O'Neill et al. (1997), Sirjusingh and Sutton (1996)"),
    ]
    t_mould_opt: Annotated[Expr, Parameter("°C", "temperature at which grey mould infects most", 20.0, "Bulger et al. (1987)")]
    t_mould_max: Annotated[Expr, Parameter("°C", "temperature above which grey mould does not infect", 32.0, "chosen")]
    growth_mould: Annotated[Expr, Parameter("day-1", "largest relative growth of the diseased share", 1.5, "chosen", "nonnegative")]
    arriving_mould: Annotated[Expr, Parameter("-", "diseased share that equals the spores from outside", 5e-4, "chosen", "fraction")]
    tau_mould: Annotated[
        Expr, Parameter("day", "time constant of loss of few diseased parts: a crew goes through in a week", 7.0, "chosen", "positive")
    ]
    mould_share: Annotated[
        Expr, Parameter("-", "diseased share at which a crew takes out diseased parts about twice as fast", 0.05, "chosen", "positive")
    ]


class Wetness(NamedTuple):
    """Where the crop is wet."""

    wet_can: Annotated[Expr, Quantity("-", "share of the leaves that is wet")]
    wet_fruit: Annotated[Expr, Quantity("-", "share of the fruits that is wet")]
    wet_crop: Annotated[Expr, Quantity("-", "share of leaves and fruits that is wet")]


class Injury(NamedTuple):
    """Hours of light, and what long light costs."""

    light_on: Annotated[Expr, Quantity("-", "whether light above the canopy counts as day, 1 = in full")]
    h_injury: Annotated[Expr, Quantity("-", "share of photosynthesis that injury leaves, 1 = all")]


def light_on(photons: Expr) -> Expr:
    """1 in light, 0 in darkness, by PAR above the canopy [umol m-2 s-1]: dimming a lamp shortens the day only a little."""
    return photons / (photons + DIM)


def injury_growth(photoperiod: Expr, p: HealthParameters) -> Expr:
    """Rate at which leaves that are sound are injured [s-1]. ``photoperiod``: share of the day in light, averaged over two days."""
    beyond = fmax(24 * photoperiod - p.hours_light, 0) / (24 - p.hours_light)
    return square(beyond) / (p.tau_injury * DAY)


def wet_share(vapour_pressure: Expr, temperature: Expr, p: HealthParameters) -> Expr:
    """Wet share of a surface of a mean temperature [°C] in air of a vapour pressure [Pa]: half when cold spots are at the dew point.

    Spots differ: the share rises over some 3 % of the saturation pressure, half a kelvin; chosen.
    """
    return sigmoid((vapour_pressure / saturation_vapour_pressure(temperature - p.dt_cold_spot) - 1) / 0.03)


def infection(hours: Expr, t_can: Expr, p: HealthParameters) -> Expr:
    """Infection after wet hours in a row at a mean canopy temperature of the day [°C], 1 = the largest."""
    rise = fmax(t_can - p.t_mould_min, COLD) / (p.t_mould_opt - p.t_mould_min)
    fall = fmax(p.t_mould_max - t_can, 0) / (p.t_mould_max - p.t_mould_opt)
    shape = (p.t_mould_opt - p.t_mould_min) / (p.t_mould_max - p.t_mould_opt)
    return fall * rise**shape * square(hours) / (square(hours) + square(p.hours_wet))


def rotting(mould: Expr, p: HealthParameters) -> Expr:
    """Share of the crop lost to mould [s-1] at a diseased share: the larger it is, the faster a crew takes out diseased parts."""
    return mould / (p.tau_mould * DAY) * (1 + mould / (p.mould_share + mould / CREW))
