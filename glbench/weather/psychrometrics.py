"""Small physics of outside air and sky, with the constants of the greenhouse model.

Every function takes numpy arrays (or floats) and returns arrays of the same shape.
"""

from __future__ import annotations

import numpy as np

from glbench.weather.record import FloatArray

KELVIN = 273.15
STEFAN_BOLTZMANN = 5.67e-8  # W m-2 K-4, as the cloud correlation was published
STEFAN_BOLTZMANN_ENERGYPLUS = 5.6697e-8  # W m-2 K-4, as EnergyPlus turns sky infrared into a temperature
GAS_CONSTANT = 8.3144598  # J mol-1 K-1
MOLAR_MASS_CO2 = 44.01e-3  # kg mol-1
PRESSURE = 101325.0  # Pa
COMMON_YEAR_SECONDS = 365.0 * 86400.0


def saturation_vapour_pressure(temperature: FloatArray) -> FloatArray:
    """Saturation vapour pressure [Pa] at ``temperature`` [degC]. Magnus form of the GreenLight model."""
    return np.asarray(610.78 * np.exp(17.2694 * temperature / (temperature + 238.3)))


def vapour_pressure(temperature: FloatArray, relative_humidity: FloatArray) -> FloatArray:
    """Vapour pressure [Pa] of air at ``temperature`` [degC] and ``relative_humidity`` [%]."""
    return np.asarray(relative_humidity / 100.0 * saturation_vapour_pressure(temperature))


def co2_density(temperature: FloatArray, ppm: float) -> FloatArray:
    """CO2 density [mg m-3] of ``ppm`` at ``temperature`` [degC] and 101325 Pa (ideal gas; 731.82 for 400 ppm at 20)."""
    return np.asarray(1e6 * PRESSURE * 1e-6 * ppm * MOLAR_MASS_CO2 / (GAS_CONSTANT * (temperature + KELVIN)))


def sky_temperature_from_cloud(temperature: FloatArray, cloud_fraction: FloatArray) -> FloatArray:
    """Apparent sky temperature [degC] from air ``temperature`` [degC] and ``cloud_fraction`` [0..1].

    De Zwart (1996), eq. 5.22, 5.26 and 5.32: a clear sky radiates 213 + 5.5 t W m-2; cloud adds 84 % of a black body.
    """
    black_body = STEFAN_BOLTZMANN * (temperature + KELVIN) ** 4
    clear = (213.0 + 5.5 * temperature) / black_body
    emissivity = (1.0 - 0.84 * cloud_fraction) * clear + 0.84 * cloud_fraction
    return np.asarray(emissivity**0.25 * (temperature + KELVIN) - KELVIN)


def sky_temperature_from_infrared(infrared: FloatArray) -> FloatArray:
    """Apparent sky temperature [degC] from the sky's infrared radiation on the horizontal [W m-2] (EnergyPlus)."""
    return np.asarray((infrared / STEFAN_BOLTZMANN_ENERGYPLUS) ** 0.25 - KELVIN)


def soil_temperature(seconds_into_year: FloatArray) -> FloatArray:
    """Temperature [degC] of the soil 1 to 2 m deep: a yearly sine, 6.46 degC at the start of 1 January."""
    return np.asarray(10.0 + 5.0 * np.sin(2.0 * np.pi * (seconds_into_year / COMMON_YEAR_SECONDS + 0.625)))


def seconds_into_year(times: FloatArray) -> FloatArray:
    """Seconds since 1 January 00:00 UTC of each moment's own year; ``times`` in seconds since 1970."""
    moments = np.floor(times).astype(np.int64).astype("datetime64[s]")
    return np.asarray(times - moments.astype("datetime64[Y]").astype("datetime64[s]").astype(np.int64))
