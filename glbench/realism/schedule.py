"""When lamps burn and CO2 is dosed, so that every day uses the measured amounts; and the grower's set points that go with this light.

The archive's sums do not say at which hours. Lamps burn at full power: at the low tariff in the hours before the high one begins, and
then before midnight; at the high tariff from its beginning, first in light below a limit, then in the dimmest light that is left. CO2 is
dosed evenly while there is light from sun or lamps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glbench.realism.outdoors import STEP_SECONDS, Outdoors
from glbench.realism.published import Compartment
from glbench.realism.settings import Lamps, Settings
from glbench.weather.record import FloatArray

_KWH = 3.6e6  # J
_STEPS_AN_HOUR = 3600 // STEP_SECONDS
DAY, PRE_NIGHT, NIGHT = 0, 1, 2


@dataclass(frozen=True, eq=False)
class Schedule:
    """What is given in every step, a column a compartment.

    Attributes
    ----------
    lamps
        Share of the installed power (steps, compartments).
    dose
        CO2 [mg m-2 s-1] (steps, compartments).
    period
        ``DAY``, ``PRE_NIGHT`` or ``NIGHT`` (steps, compartments).
    heating, ventilation, humidity_deficit, outdoor
        Set points: temperatures [degC], humidity deficit [g m-3], and outdoor temperature [degC] below which the screen closes
        (steps, compartments).
    """

    lamps: FloatArray
    dose: FloatArray
    period: NDArray[np.int64]
    heating: FloatArray
    ventilation: FloatArray
    humidity_deficit: FloatArray
    outdoor: FloatArray


def schedule(
    compartments: tuple[Compartment, ...],
    outside: Outdoors,
    settings: Settings,
    *,
    most_co2: float,
    warmer: float = 0.0,
) -> Schedule:
    """The schedule of these compartments.

    Parameters
    ----------
    most_co2
        Installed dosing [mg m-2 s-1]: a day that asks for more gets so much.
    warmer
        Added to all temperatures of heating and ventilation [K].
    """
    radiation = outside.of("iGlob")
    sunlit = radiation >= settings.periods.dark_below
    lamps = np.column_stack([lamp_shares(one, outside, settings.lamps) for one in compartments])
    lit = sunlit[:, None] | (lamps > 0.0)
    dose = np.column_stack(
        [np.minimum(co2_dose(one.co2, outside, lit[:, i]), most_co2) for i, one in enumerate(compartments)]
    )
    period = periods(lit, settings.periods.pre_night)
    heat, vents = settings.heating, settings.ventilation
    bright = np.clip((last_hour(radiation) - heat.light_from) / (heat.light_full - heat.light_from), 0.0, 1.0)
    bright_day = np.where(period == DAY, bright[:, None], 0.0)
    heating = np.choose(period, (heat.day, heat.pre_night, heat.night)) + heat.light_raise * bright_day + warmer
    above = np.where(period == DAY, vents.day, vents.night) + vents.light_raise * bright_day
    deficit, screen = settings.humidity_deficit, settings.screen
    return Schedule(
        lamps,
        dose,
        period,
        heating,
        heating + above,
        np.where(period == DAY, deficit.day, deficit.night),
        np.where(period == DAY, screen.outdoor_day, screen.outdoor_night),
    )


def lamp_shares(one: Compartment, outside: Outdoors, lamps: Lamps) -> FloatArray:
    """Share of the installed power in every step (steps,), so that each day's electricity at each tariff is the measured one.

    A day that asks for more than all lamps give in those hours gets all of them.
    """
    radiation, hour = outside.of("iGlob"), outside.hour
    shares = np.zeros(outside.steps)
    at_high = (hour >= lamps.high_from) & (hour < lamps.high_until)
    # The lower the rank the sooner a step is lit.
    bright = np.where(radiation < lamps.radiation_limit, 0.0, radiation)
    before = hour < lamps.high_from
    from_the_beginning_back = np.where(before, lamps.high_from - hour, 100.0 + hour)
    a_step = lamps.power * STEP_SECONDS / _KWH
    for number, (high, low) in enumerate(zip(one.high.tolist(), one.low.tolist(), strict=True)):
        today = outside.day == number
        for energy, window, ranks in (
            (high, today & at_high, (hour, bright)),
            (low, today & ~at_high, (from_the_beginning_back,)),
        ):
            steps = np.flatnonzero(window)
            order = steps[np.lexsort(tuple(rank[steps] for rank in ranks))]
            shares[order] = np.clip(energy / a_step - np.arange(order.size), 0.0, 1.0)
    return shares


def co2_dose(daily: FloatArray, outside: Outdoors, lit: NDArray[np.bool_]) -> FloatArray:
    """CO2 [mg m-2 s-1] in every step (steps,): each day's [kg m-2] evenly over its light, or over all of a day without light."""
    days = daily.size
    light = np.bincount(outside.day[lit], minlength=days)
    dosed = lit | (light == 0)[outside.day]
    seconds = np.bincount(outside.day[dosed], minlength=days) * STEP_SECONDS
    return np.where(dosed, (1e6 * daily / seconds)[outside.day], 0.0)


def periods(lit: NDArray[np.bool_], pre_night_hours: float) -> NDArray[np.int64]:
    """Period of every step from the light in it, both (steps, compartments). Before the first light it is night."""
    steps = np.arange(lit.shape[0])[:, None]
    last_lit = np.maximum.accumulate(np.where(lit, steps, -lit.shape[0]), axis=0)
    dark = (steps - last_lit - 1) / _STEPS_AN_HOUR  # h since dark fell
    return np.where(lit, DAY, np.where((last_lit >= 0) & (dark < pre_night_hours), PRE_NIGHT, NIGHT)).astype(np.int64)


def last_hour(values: FloatArray) -> FloatArray:
    """Mean of the hour that ends with each step (steps,); of less at the beginning."""
    total = np.concatenate(([0.0], np.cumsum(values)))
    ends = np.arange(1, values.size + 1)
    begins = np.maximum(ends - _STEPS_AN_HOUR, 0)
    return np.asarray((total[ends] - total[begins]) / (ends - begins))
