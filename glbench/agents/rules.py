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
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from glbench.agents.rule_settings import RuleSettings

Array = NDArray[np.float64]
Shared = Any
"""An array (n,), or one ``float`` for all runs."""

_LOG_100 = math.log(100.0)


@dataclass(frozen=True)
class RuleInputs:
    """What the rules look at, at the start of a control step: float64 arrays of shape (n,), one value a run.

    What is outside may also be one number for all runs: the rules then follow from it for all runs at once, with the same bits.
    """

    air_temperature: Array
    """Air below the screens [degC]."""
    relative_humidity: Array
    """Relative humidity of that air [%]."""
    co2: Array
    """CO2 of that air [ppm]."""
    radiation: Shared
    """Global radiation outside [W m-2]."""
    outdoor_temperature: Shared
    """Air outside [degC]."""
    day_radiation_sum: Shared
    """Radiation sum of the calendar day, the hours to come included [MJ m-2 d-1]."""
    is_day: Shared
    """1 by day, 0 by night, linear within dusk and dawn [-]."""
    is_day_smooth: Shared
    """The same with sigmoid dusk and dawn [-]."""
    hour_of_day: Shared
    """Clock [h], from 0 to below 24."""
    day_of_year: Shared
    """Day of the year [day], 0 at 1 January 00:00."""


@dataclass(frozen=True)
class _Climate:
    """Set points and needs that several rules share; they follow from what is outside."""

    lamps_wanted: Shared
    """1 when clock, season and radiation call for lamps, whatever the greenhouse climate [-]."""
    heating: Shared
    """Heating set point [degC]."""
    co2: Shared
    """CO2 set point [ppm]."""


class _Shares(NamedTuple):
    """How far each rule wants to go, from one side of its band to the other; shape (n,) each [-]."""

    heating: Array
    """Boiler, up when it is cold."""
    co2: Array
    """CO2 supply, up when there is little."""
    not_cold: Array
    """Down when it is too cold to open anything."""
    vents_heat: Array
    vents_humidity: Array
    screen_cold: Array
    """Thermal screen, closed when it is cold outside."""
    screen_heat: Array
    """Thermal screen, open when it is warm."""
    screen_humidity: Array
    """Thermal screen, open when it is humid."""
    lamps_heat: Array
    """Lamps, off when it is hot."""
    lamps_humidity: Array
    """Lamps, off when it is humid."""


def proportional(value: Array, set_point: Array | float, band: float, low: float, high: float) -> Array:
    """Smooth proportional action from ``low`` to ``high`` while ``value`` goes from ``set_point`` to ``set_point + band``.

    ``low + (high - low) / (1 + exp(-2/band * ln(100) * (value - set_point - band/2)))``: 1 % of the way at the set point, 99 % at
    the end of the band. A negative band acts downward.
    """
    return _action(value - set_point, 2.0 / band * _LOG_100, band / 2.0, low, high - low)


def _action(above: Array, steepness: Any, half_band: Any, low: Any, span: Any) -> Array:
    z = steepness * (above - half_band)
    # exp only ever sees numbers that are not positive, so no distance from the set point overflows.
    decay = np.exp(-np.abs(z))
    share = np.where(z >= 0.0, 1.0, decay) / (1.0 + decay)
    action: Array = low + span * share
    return action


def within(start: float, stop: float, value: Shared) -> Shared:
    """1 where ``value`` lies strictly between ``start`` and ``stop``, else 0; over the turn of day or year when start > stop."""
    inside = (start < value) & (value < stop) if start <= stop else (start < value) | (value < stop)
    return inside * 1.0


def _larger(a: Shared, b: Shared) -> Shared:
    return max(a, b) if isinstance(a, float) and isinstance(b, float) else np.maximum(a, b)


def _smaller(a: Shared, b: Shared) -> Shared:
    return min(a, b) if isinstance(a, float) and isinstance(b, float) else np.minimum(a, b)


def rule_controls(inputs: RuleInputs, settings: RuleSettings) -> Array:
    """Controls that the rules ask for.

    Returns
    -------
    ndarray (n, 6)
        Boiler, CO2 dosing, thermal screen, vents, lamps, blackout screen: fractions of capacity, 0 to 1.
    """
    return Rules(settings).controls(inputs)


class Rules:
    """The rules with their settings, for a controller that is asked at every step."""

    def __init__(self, settings: RuleSettings) -> None:
        self.settings = settings
        s = settings
        # One for each of ``_Shares``: band, and the action below and above it.
        bands = (
            (s.heating_band, 0.0, 1.0),
            (s.co2_band, 0.0, 1.0),
            (s.vent_cold_band, 1.0, 0.0),
            (s.vent_heat_band, 0.0, 1.0),
            (s.vent_humidity_band, 0.0, 1.0),
            (s.screen_cold_band, 0.0, 1.0),
            (-s.screen_cold_band, 1.0, 0.0),
            (s.screen_humidity_band, 1.0, 0.0),
            (s.lamp_heat_band, 0.0, 1.0),
            (s.blackout_humidity_band, 0.0, 1.0),
        )
        self._steepness, self._half_band, self._low, self._span = (
            np.array(column)[:, None]
            for column in zip(*((2.0 / b * _LOG_100, b / 2.0, low, high - low) for b, low, high in bands), strict=True)
        )

    def controls(self, inputs: RuleInputs) -> Array:
        """Controls (n, 6) that the rules ask for, as ``rule_controls`` gives them."""
        climate = _shared(inputs, self.settings)
        shares = self._shares(inputs, climate)
        lamps = _lamps(inputs, self.settings, climate, shares)
        controls = np.empty((len(lamps), 6))
        controls[:, 0] = shares.heating
        controls[:, 1] = shares.co2
        controls[:, 2] = _thermal_screen(self.settings, shares)
        controls[:, 3] = np.minimum(shares.not_cold, np.maximum(shares.vents_heat, shares.vents_humidity))
        controls[:, 4] = lamps
        controls[:, 5] = (1.0 - inputs.is_day_smooth) * lamps if self.settings.blackout_screen else 0.0
        return controls

    def _shares(self, inputs: RuleInputs, climate: _Climate) -> _Shares:
        """All proportional actions at once: numpy takes as long for one of them as for ten."""
        s, air, humidity, heating = self.settings, inputs.air_temperature, inputs.relative_humidity, climate.heating
        too_warm = heating + s.heating_dead_zone  # heat must leave
        screen = inputs.is_day * s.screen_day + (1.0 - inputs.is_day) * s.screen_night
        above = np.empty((len(_Shares._fields), len(air)))
        np.subtract(air, heating, out=above[0])
        np.subtract(inputs.co2, climate.co2, out=above[1])
        np.subtract(air, heating - s.vent_cold_offset, out=above[2])
        np.subtract(air, too_warm, out=above[3])
        np.subtract(humidity, s.humidity_limit, out=above[4])
        np.subtract(inputs.outdoor_temperature, screen, out=above[5])
        np.subtract(air, heating + s.screen_dead_zone, out=above[6])
        np.subtract(humidity, s.humidity_limit + s.screen_humidity_offset, out=above[7])
        np.subtract(air, too_warm + s.lamp_extra_heat, out=above[8])
        np.subtract(humidity, s.humidity_limit + s.blackout_extra_humidity, out=above[9])
        return _Shares(*_action(above, self._steepness, self._half_band, self._low, self._span))


def _shared(inputs: RuleInputs, settings: RuleSettings) -> _Climate:
    dim_day = (inputs.day_radiation_sum < settings.lamps_off_day_sum) * 1.0
    in_season = within(settings.lamp_season_start, settings.lamp_season_end, inputs.day_of_year)
    dim_now = (inputs.radiation < settings.lamps_off_radiation) * 1.0
    in_hours = within(settings.lamps_on, settings.lamps_off, inputs.hour_of_day)
    lamps_wanted = dim_now * dim_day * in_hours * in_season

    # The climate of the lamp hours fades in and out within an hour and, unlike the lamps, does not mind a sunny moment.
    lamp_climate = _lamp_ramp(inputs.hour_of_day, settings) * dim_day * in_season
    day_climate = _larger(lamp_climate, inputs.is_day)
    heating = day_climate * settings.heating_day + (1.0 - day_climate) * settings.heating_night
    heating = heating + settings.heating_lamp_shift * lamps_wanted
    return _Climate(lamps_wanted, heating, day_climate * settings.co2_day)


def _lamp_ramp(hour: Shared, settings: RuleSettings) -> Shared:
    """The lamp hours with ramps of one hour before and after [-]."""
    rising = _smaller(_larger(hour - settings.lamps_on + 1.0, 0.0), 1.0)
    falling = _smaller(_larger(settings.lamps_off - hour + 1.0, 0.0), 1.0)
    if settings.lamps_on == settings.lamps_off:
        return hour * 0.0
    return _smaller(rising, falling) if settings.lamps_on < settings.lamps_off else _larger(rising, falling)


def _thermal_screen(settings: RuleSettings, shares: _Shares) -> Array:
    """The screen closes when it is cold outside, and opens to let heat or humidity out."""
    for_humidity = np.maximum(shares.screen_humidity, 1.0 - shares.not_cold)
    # Erratum of the published code: "opened for heat or humidity" became max, so only heat *and* humidity open the screen.
    keep_closed = np.maximum if settings.thermal_screen_rule == "code" else np.minimum
    closed: Array = np.minimum(shares.screen_cold, keep_closed(shares.screen_heat, for_humidity))
    return closed


def _lamps(inputs: RuleInputs, settings: RuleSettings, climate: _Climate, shares: _Shares) -> Array:
    """Lamps as clock and sun ask, off in heat, and off in humidity that a closed blackout screen would hold back."""
    not_humid = np.maximum(shares.lamps_humidity, 1.0 - shares.not_cold)
    if settings.lamp_rule == "author":
        # By day the blackout screen is open, and humidity is no reason; the published code lost this by operator precedence.
        day = inputs.is_day_smooth
        not_humid = day + (1.0 - day) * not_humid
    lamps: Array = climate.lamps_wanted * shares.lamps_heat * not_humid
    return lamps
