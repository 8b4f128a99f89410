"""The rules of the rule-based baseline: what a grower's climate computer would ask for, from what it measures.

Every rule is written once, for the published controller (which knows the true state and the coming sun) and for its fair twin
(which has observations and estimates). All functions work element by element on arrays of shape (n,), one value a run, so that
a run gets the same bits alone and in a batch.

Source: the published rule-based controller of the benchmark, after the GreenLight author's definition (Katzin, 2021). The two
disagree in two rules, see ``RuleSettings.thermal_screen_rule`` and ``RuleSettings.lamp_rule``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glbench.agents.rule_settings import RuleSettings

Array = NDArray[np.float64]

_LOG_100 = math.log(100.0)


@dataclass(frozen=True)
class RuleInputs:
    """What the rules look at, at the start of a control step: float64 arrays of shape (n,), one value a run."""

    air_temperature: Array
    """Air below the screens [degC]."""
    relative_humidity: Array
    """Relative humidity of that air [%]."""
    co2: Array
    """CO2 of that air [ppm]."""
    radiation: Array
    """Global radiation outside [W m-2]."""
    outdoor_temperature: Array
    """Air outside [degC]."""
    day_radiation_sum: Array
    """Radiation sum of the calendar day, the hours to come included [MJ m-2 d-1]."""
    is_day: Array
    """1 by day, 0 by night, linear within dusk and dawn [-]."""
    is_day_smooth: Array
    """The same with sigmoid dusk and dawn [-]."""
    hour_of_day: Array
    """Clock [h], from 0 to below 24."""
    day_of_year: Array
    """Day of the year [day], 0 at 1 January 00:00."""


@dataclass(frozen=True)
class _Climate:
    """Set points and needs that several rules share; shape (n,) each."""

    lamps_wanted: Array
    """1 when clock, season and radiation call for lamps, whatever the greenhouse climate [-]."""
    heating: Array
    """Heating set point [degC]."""
    too_warm: Array
    """Temperature above which heat must leave [degC]."""
    co2: Array
    """CO2 set point [ppm]."""
    not_cold: Array
    """1 in ordinary air, 0 when it is too cold to open anything [-]."""


def proportional(value: Array, set_point: Array | float, band: float, low: float, high: float) -> Array:
    """Smooth proportional action from ``low`` to ``high`` while ``value`` goes from ``set_point`` to ``set_point + band``.

    ``low + (high - low) / (1 + exp(-2/band * ln(100) * (value - set_point - band/2)))``: 1 % of the way at the set point, 99 % at
    the end of the band. A negative band acts downward.
    """
    steepness = 2.0 / band * _LOG_100
    z = steepness * (value - set_point - band / 2.0)
    # exp only ever sees numbers that are not positive, so no distance from the set point overflows.
    decay = np.exp(-np.abs(z))
    share = np.where(z >= 0.0, 1.0, decay) / (1.0 + decay)
    return low + (high - low) * share


def within(start: float, stop: float, value: Array) -> Array:
    """1 where ``value`` lies strictly between ``start`` and ``stop``, else 0; over the turn of day or year when start > stop."""
    inside = (start < value) & (value < stop) if start <= stop else (start < value) | (value < stop)
    return inside.astype(np.float64)


def rule_controls(inputs: RuleInputs, settings: RuleSettings) -> Array:
    """Controls that the rules ask for.

    Returns
    -------
    ndarray (n, 6)
        Boiler, CO2 dosing, thermal screen, vents, lamps, blackout screen: fractions of capacity, 0 to 1.
    """
    climate = _shared(inputs, settings)
    lamps = _lamps(inputs, settings, climate)
    columns = (
        proportional(inputs.air_temperature, climate.heating, settings.heating_band, 0.0, 1.0),
        proportional(inputs.co2, climate.co2, settings.co2_band, 0.0, 1.0),
        _thermal_screen(inputs, settings, climate),
        _vents(inputs, settings, climate),
        lamps,
        (1.0 - inputs.is_day_smooth) * lamps if settings.blackout_screen else np.zeros_like(lamps),
    )
    return np.stack(columns, axis=1)


def _shared(inputs: RuleInputs, settings: RuleSettings) -> _Climate:
    dim_day = (inputs.day_radiation_sum < settings.lamps_off_day_sum).astype(np.float64)
    in_season = within(settings.lamp_season_start, settings.lamp_season_end, inputs.day_of_year)
    dim_now = (inputs.radiation < settings.lamps_off_radiation).astype(np.float64)
    in_hours = within(settings.lamps_on, settings.lamps_off, inputs.hour_of_day)
    lamps_wanted = dim_now * dim_day * in_hours * in_season

    # The climate of the lamp hours fades in and out within an hour and, unlike the lamps, does not mind a sunny moment.
    lamp_climate = _lamp_ramp(inputs.hour_of_day, settings) * dim_day * in_season
    day_climate = np.maximum(lamp_climate, inputs.is_day)
    heating = day_climate * settings.heating_day + (1.0 - day_climate) * settings.heating_night
    heating = heating + settings.heating_lamp_shift * lamps_wanted
    return _Climate(
        lamps_wanted=lamps_wanted,
        heating=heating,
        too_warm=heating + settings.heating_dead_zone,
        co2=day_climate * settings.co2_day,
        not_cold=proportional(
            inputs.air_temperature, heating - settings.vent_cold_offset, settings.vent_cold_band, 1.0, 0.0
        ),
    )


def _lamp_ramp(hour: Array, settings: RuleSettings) -> Array:
    """The lamp hours with ramps of one hour before and after [-]."""
    rising = np.clip(hour - settings.lamps_on + 1.0, 0.0, 1.0)
    falling = np.clip(settings.lamps_off - hour + 1.0, 0.0, 1.0)
    if settings.lamps_on == settings.lamps_off:
        return np.zeros_like(hour)
    return np.minimum(rising, falling) if settings.lamps_on < settings.lamps_off else np.maximum(rising, falling)


def _vents(inputs: RuleInputs, settings: RuleSettings, climate: _Climate) -> Array:
    """Vents open for heat or humidity, unless it is too cold."""
    for_heat = proportional(inputs.air_temperature, climate.too_warm, settings.vent_heat_band, 0.0, 1.0)
    for_humidity = proportional(
        inputs.relative_humidity, settings.humidity_limit, settings.vent_humidity_band, 0.0, 1.0
    )
    return np.minimum(climate.not_cold, np.maximum(for_heat, for_humidity))


def _thermal_screen(inputs: RuleInputs, settings: RuleSettings, climate: _Climate) -> Array:
    """The screen closes when it is cold outside, and opens to let heat or humidity out."""
    set_point = inputs.is_day * settings.screen_day + (1.0 - inputs.is_day) * settings.screen_night
    for_cold = proportional(inputs.outdoor_temperature, set_point, settings.screen_cold_band, 0.0, 1.0)
    for_heat = proportional(
        inputs.air_temperature, climate.heating + settings.screen_dead_zone, -settings.screen_cold_band, 1.0, 0.0
    )
    humid = settings.humidity_limit + settings.screen_humidity_offset
    for_humidity = np.maximum(
        proportional(inputs.relative_humidity, humid, settings.screen_humidity_band, 1.0, 0.0), 1.0 - climate.not_cold
    )
    # Erratum of the published code: "opened for heat or humidity" became max, so only heat *and* humidity open the screen.
    keep_closed = np.maximum if settings.thermal_screen_rule == "code" else np.minimum
    return np.minimum(for_cold, keep_closed(for_heat, for_humidity))


def _lamps(inputs: RuleInputs, settings: RuleSettings, climate: _Climate) -> Array:
    """Lamps as clock and sun ask, off in heat, and off in humidity that a closed blackout screen would hold back."""
    hot = climate.too_warm + settings.lamp_extra_heat
    not_hot = proportional(inputs.air_temperature, hot, settings.lamp_heat_band, 0.0, 1.0)
    humid = settings.humidity_limit + settings.blackout_extra_humidity
    not_humid = np.maximum(
        proportional(inputs.relative_humidity, humid, settings.blackout_humidity_band, 0.0, 1.0), 1.0 - climate.not_cold
    )
    if settings.lamp_rule == "author":
        # By day the blackout screen is open, and humidity is no reason; the published code lost this by operator precedence.
        day = inputs.is_day_smooth
        not_humid = day + (1.0 - day) * not_humid
    return climate.lamps_wanted * not_hot * not_humid
