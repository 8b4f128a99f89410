"""Moist air and its CO2: saturation, humidity, density and mole fraction, of floats, NumPy arrays or CasADi symbols."""

from __future__ import annotations

from typing import NamedTuple

from glbench.model.expressions import Expr, exp

CELSIUS_ZERO = 273.15
"""0 degrees Celsius on the Kelvin scale [K]."""

GAS_CONSTANT = 8.3144598
"""Molar gas constant [J mol-1 K-1] of the CO2 conversions (the heat balances use the parameter ``R`` instead)."""

STANDARD_PRESSURE = 101325.0
"""Air pressure [Pa] of the CO2 conversions, whatever the altitude of the greenhouse."""

CO2_MOLAR_MASS = 44.01e-3
"""Molar mass of CO2 [kg mol-1] of the CO2 conversions."""

WATER_MOLAR_MASS = 18.01528e-3
"""Molar mass of water [kg mol-1] of the humidity deficit."""


class Air(NamedTuple):
    """What a sensor box tells of the main air, in the order of the simulation."""

    air_temperature: Expr
    """[°C]."""
    co2: Expr
    """[ppm]."""
    relative_humidity: Expr
    """[%]."""


def kelvin(temperature: Expr) -> Expr:
    """Absolute temperature [K] from degrees Celsius."""
    return temperature + CELSIUS_ZERO


def saturation_vapour_pressure(temperature: Expr) -> Expr:
    """Vapour pressure of saturated air [Pa] at [°C], over water, also below 0 °C: GreenLight's Magnus form; 2325.98 Pa at 20 °C."""
    return 610.78 * exp(17.2694 * temperature / (temperature + 238.3))


def relative_humidity(temperature: Expr, vapour_pressure: Expr) -> Expr:
    """Relative humidity [%] from temperature [°C] and vapour pressure [Pa]; above 100 when the air is supersaturated."""
    return 100 * vapour_pressure / saturation_vapour_pressure(temperature)


def co2_ppm(temperature: Expr, density: Expr) -> Expr:
    """CO2 mole fraction [ppm] from temperature [°C] and CO2 density [mg m-3], at standard pressure."""
    return GAS_CONSTANT * 1e6 * kelvin(temperature) * (1e-6 * density) / (STANDARD_PRESSURE * CO2_MOLAR_MASS)


def co2_density(temperature: Expr, ppm: Expr) -> Expr:
    """CO2 density [mg m-3] from temperature [°C] and mole fraction [ppm]; 731.82 mg m-3 for 400 ppm at 20 °C."""
    return 1e6 * STANDARD_PRESSURE * 1e-6 * ppm * CO2_MOLAR_MASS / (GAS_CONSTANT * kelvin(temperature))


def vapour_density(temperature: Expr, vapour_pressure: Expr) -> Expr:
    """Vapour density [kg m-3] from temperature [°C] and vapour pressure [Pa]."""
    return vapour_pressure * WATER_MOLAR_MASS / (GAS_CONSTANT * kelvin(temperature))


def vapour_pressure(temperature: Expr, density: Expr) -> Expr:
    """Vapour pressure [Pa] from temperature [°C] and vapour density [kg m-3]."""
    return density * GAS_CONSTANT * kelvin(temperature) / WATER_MOLAR_MASS


def vapour_pressure_deficit(temperature: Expr, humidity: Expr) -> Expr:
    """Vapour pressure deficit [kPa] from temperature [°C] and relative humidity [%]; 0.465 kPa at 20 °C and 80 %."""
    return 1e-3 * (saturation_vapour_pressure(temperature) * (1 - humidity / 100))


def humidity_deficit(temperature: Expr, humidity: Expr) -> Expr:
    """Water that a cubic metre of air lacks to saturation at its temperature [g m-3], by the law of ideal gases.

    From temperature [°C] and relative humidity [%]; 3.44 g m-3 at 20 °C and 80 %.
    """
    grams = 1e3 * WATER_MOLAR_MASS / GAS_CONSTANT  # g K J-1
    return grams * (saturation_vapour_pressure(temperature) * (1 - humidity / 100)) / kelvin(temperature)
