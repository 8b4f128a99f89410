"""The process computer: set points in physical units, and the rules by which it works boiler, vents, CO2, lamps and screens.

The rules are written once, as arithmetic on arrays or CasADi's expressions; ``glbench.env.program`` records them. Formulae, units and
defaults of the settings: docs/process-computer.md. The measurements are arguments, so that they can be those of sensors that err.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from glbench.tasks import TaskSpec
from glbench.tasks import set_points as points

_SECONDS_AN_HOUR = 3600.0
_LONG_AGO = 1e6
"""Steps since a switch was thrown that never was."""
_ROUNDING = 1e-9
"""What a time given in hours may lose when it is counted in steps."""
_TIE = 1e-4
"""What is read counts as so much more [h, W m-2, degC] where a set point switches: scaling and float32 move set points by less than
that, so that a reading that equals one falls on the same side."""
_NEAR = 0.02
"""Within this distance of their position vents go there at once."""

MEMORY: Mapping[str, float] = {
    "begun": 0.0,
    points.HEATING: 0.0,
    points.VENTILATION: 0.0,
    "bright": 0.0,
    "bright_steps": _LONG_AGO,
    "screen": 0.0,
    "screen_steps": _LONG_AGO,
}
"""What the computer remembers, and with which values a run starts: whether it has worked before, the heating and ventilation
temperatures in force [degC], whether it is too bright for lamps, whether the screen is closed, and how many steps each of these two has
been as it is."""


@dataclass(frozen=True)
class Measured:
    """What the computer measures at the start of a step."""

    air_temperature: Any
    co2: Any
    humidity_deficit: Any
    """``air_temperature``, ``co2`` and ``humidity_deficit``: inside [degC, ppm, g m-3]."""
    radiation: Any
    outdoor_temperature: Any
    wind_speed: Any
    """``radiation``, ``outdoor_temperature`` and ``wind_speed``: outside [W m-2, degC, m s-1]."""
    hour_of_day: Any
    """The task's clock [h]."""


def work(
    task: TaskSpec, set_points: Mapping[str, Any], controls: Mapping[str, Any], measured: Measured, memory: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """A step of the computer.

    ``set_points`` are by name those of ``task.actions``, in their units, ``controls`` those in force, fractions, and ``memory`` what it
    remembers, by the names of ``MEMORY``. Returns new values of the granted controls, and the memory for the next step.
    """
    return _Step(task, set_points, controls, measured, memory).run()


class _Step:
    """One step, rule by rule."""

    def __init__(
        self, task: TaskSpec, set_points: Mapping[str, Any], controls: Mapping[str, Any], measured: Measured, memory: Mapping[str, Any]
    ) -> None:
        self.s, self.set_points, self.controls = task.actuation.process_computer, set_points, controls
        self.measured, self.memory = measured, memory
        self.max_change = task.actuation.max_change
        self.steps_an_hour = _SECONDS_AN_HOUR / task.step_seconds
        self.heat_installed = {capacity.name: capacity.at_one for capacity in task.capacities()}.get(points.BOILER, 0.0)
        self.next_memory: dict[str, Any] = {"begun": 1.0}
        self.heating, self.ventilation = self._temperatures()
        self.too_humid: Any = 0.0  # how far the air is below the humidity deficit of the set point, as a share of the band
        if points.HUMIDITY in set_points:
            self.too_humid = share(set_points[points.HUMIDITY] - measured.humidity_deficit, 0.0, self.s.humidity_band)

    def run(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """All granted controls, and the memory for the next step; rules of controls that are not granted are left out."""
        moved: dict[str, Any] = {}
        for name, rule in (
            (points.BOILER, self._boiler), (points.VENTS, self._vents), (points.LAMPS, self._lamps), (points.SCREEN, self._screen),
        ):  # fmt: skip
            if name in self.controls:
                moved[name] = self._approached(name, rule())
        if points.DOSING in self.controls:
            moved[points.DOSING] = self._approached(points.DOSING, self._dosing(moved))
        if points.BLACKOUT in self.controls:
            position: Any = 0.0
            if points.LAMPS in moved:  # closed while lamps burn in the dark
                dark = below(self.measured.radiation, self.s.blackout_radiation)
                position = self.lit * dark * (1.0 - self._gap())
            moved[points.BLACKOUT] = self._approached(points.BLACKOUT, position)
        return moved, self.next_memory

    def _approached(self, name: str, position: Any) -> Any:
        """``position``, or as near to it as the control comes in a step."""
        now = self.controls[name]
        return within(within(position, now - self.max_change, now + self.max_change), 0.0, 1.0)

    # Temperatures.

    def _temperatures(self) -> tuple[Any, Any]:
        """Heating and ventilation temperature in force: ramped, and a dead zone apart.

        Without a boiler, or without vents, the one temperature follows from the other; ``None`` where there are neither.
        """
        apart, heating, ventilation = self.s.dead_zone, None, None
        if points.HEATING in self.set_points:
            heating = self._ramped(points.HEATING, self.set_points[points.HEATING])
        if points.VENTILATION in self.set_points:
            target = self.set_points[points.VENTILATION]
            if heating is not None:
                target = np.maximum(target, self.set_points[points.HEATING] + apart)
            ventilation = self._ramped(points.VENTILATION, target)
            if heating is not None:
                ventilation = np.maximum(ventilation, heating + apart)
                self.next_memory[points.VENTILATION] = ventilation
        if heating is None and ventilation is not None:
            heating = ventilation - apart
        if ventilation is None and heating is not None:
            ventilation = heating + apart
        return heating, ventilation

    def _ramped(self, name: str, target: Any) -> Any:
        """The set point on its way to its target; at once there in the first step."""
        before = self.memory[name]
        up, down = self.s.temperature_rise / self.steps_an_hour, self.s.temperature_fall / self.steps_an_hour
        ramped = select(self.memory["begun"], within(target, before - down, before + up), target)
        self.next_memory[name] = ramped
        return ramped

    # One rule for each control: the position that it should have.

    def _boiler(self) -> Any:
        s, installed = self.s, self.heat_installed
        heat = share(self.heating - self.measured.air_temperature, 0.0, s.heating_band)
        least = min(s.minimum_heat / installed, 1.0) if installed > 0.0 else 0.0
        return np.maximum(heat, least * self.too_humid * share(self.measured.radiation, s.minimum_heat_radiation, 0.0))

    def _vents(self) -> Any:
        """The larger of the openings for temperature and humidity, approached slowly: a small opening cools a lot."""
        s, air_temperature = self.s, self.measured.air_temperature
        warm = share(air_temperature, self.heating - s.vent_gap_cold, self.heating)
        cold = np.maximum(s.ventilation_band_below - self.measured.outdoor_temperature, 0.0)
        band = s.ventilation_band + s.ventilation_band_cold * cold + s.ventilation_band_wind * self.measured.wind_speed
        band = np.minimum(band, s.ventilation_band_most)  # it widens with cold and wind
        too_hot = share(air_temperature, self.ventilation, self.ventilation + band)
        position = np.maximum(too_hot, s.vent_gap * self.too_humid * warm)
        now, weight = self.controls[points.VENTS], 1.0 / (1.0 + s.vent_time * self.steps_an_hour)
        return select(below((position - now) * (position - now), _NEAR * _NEAR), position, now + weight * (position - now))

    def _dosing(self, moved: Mapping[str, Any]) -> Any:
        s = self.s
        short = share(self.measured.co2, self.set_points[points.CO2], self.set_points[points.CO2] - s.co2_band)
        light = share(self.measured.radiation, 0.0, s.co2_radiation)
        if points.LAMPS in moved:
            light = np.maximum(light, moved[points.LAMPS])
        return short * light * (share(moved[points.VENTS], s.co2_vents_off, s.co2_vents) if points.VENTS in moved else 1.0)

    def _lamps(self) -> Any:
        """On within the hours and while it is not too bright; the clock does not wait for the minimum time."""
        s, limit, hour = self.s, self.set_points[points.LAMP_RADIATION], self.measured.hour_of_day + _TIE
        dimmer = limit - np.minimum(s.lamp_hysteresis, 0.5 * limit)
        radiation = self.measured.radiation + _TIE
        bright_now, dim_now = at_least(radiation, limit), below(radiation, dimmer)
        bright = self._timed_switch("bright", switch(self.memory["bright"], bright_now, dim_now), s.lamp_minimum_time)
        in_hours = at_least(hour, self.set_points[points.LAMPS_FROM]) * below(hour, self.set_points[points.LAMPS_UNTIL])
        self.lit = in_hours * (1.0 - bright)
        return self.lit

    def _timed_switch(self, name: str, target: Any, hours: float) -> Any:
        """A switch of the memory that is thrown at most once in so many hours."""
        least = hours * self.steps_an_hour - _ROUNDING
        now, steps = held_switch(self.memory[name], self.memory[f"{name}_steps"], target, least)
        self.next_memory[name], self.next_memory[f"{name}_steps"] = now, steps
        return now

    def _screen(self) -> Any:
        s, dark, cold = self.s, self.set_points[points.SCREEN_RADIATION], self.set_points[points.SCREEN_OUTDOOR]
        radiation, outside = self.measured.radiation + _TIE, self.measured.outdoor_temperature + _TIE
        close = below(radiation, dark) * below(outside, cold)
        brighter = at_least(radiation, dark + np.minimum(s.screen_radiation_hysteresis, dark))
        warmer = at_least(outside, cold + s.screen_temperature_hysteresis)
        opened = np.maximum(brighter, warmer)
        closed = self._timed_switch("screen", switch(self.memory["screen"], close, opened), s.screen_minimum_time)
        return closed * (1.0 - self._gap())

    def _gap(self) -> Any:
        """How far a closed screen opens again: a little in humid air, fully in air that is far too warm."""
        gap = self.s.screen_gap * self.too_humid
        if self.ventilation is None:
            return gap
        warm = share(self.measured.air_temperature, self.ventilation, self.ventilation + self.s.screen_heat_band)
        return np.maximum(gap, warm)


# Conditions are 1.0 or 0.0, also on arrays, and are combined by products. They are made of arithmetic because that keeps NaN: what follows
# from a reading that is NaN is NaN. A difference of two numbers is 0 only when they are equal. ``select`` needs finite numbers.


def below(a: Any, b: Any) -> Any:
    """Whether a < b."""
    return np.maximum(np.sign(b - a), 0.0)


def at_least(a: Any, b: Any) -> Any:
    """Whether a >= b."""
    return 1.0 - below(a, b)


def select(condition: Any, a: Any, b: Any) -> Any:
    """The number a where the condition holds, else b."""
    return condition * a + (1.0 - condition) * b


def within(value: Any, low: Any, high: Any) -> Any:
    """The value, kept between low and high; high where they contradict each other."""
    return np.minimum(np.maximum(value, low), high)


def share(value: Any, start: Any, full: Any) -> Any:
    """From 0 at ``start`` to 1 at ``full``, straight in between; ``full`` may be the lower one, never the same."""
    return within((value - start) / (full - start), 0.0, 1.0)


def switch(state: Any, on: Any, off: Any) -> Any:
    """A switch with hysteresis: 1 where ``on`` holds, 0 where only ``off`` does, else the ``state`` that it had."""
    return np.maximum(on, state * (1.0 - off))


def held_switch(state: Any, steps: Any, target: Any, least: float) -> tuple[Any, Any]:
    """A switch that stays as it is for at least ``least`` steps: its new state, and for how many steps it will have had it.

    ``steps`` is that number before; a switch that was never thrown has had its state for ``least`` steps.
    """
    now = select(at_least(steps, least), target, state)
    changed = (now - state) * (now - state)
    return now, select(changed, 1.0, steps + 1.0)
