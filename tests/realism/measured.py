"""A made season as measured: smooth weather, actuators by the clock, and the air that the model itself computes, with sensors' noise."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace

import numpy as np

from glbench.realism.free_run import Drive, drive, free_run
from glbench.realism.houses import HOUSES, model, parameters, read_settings
from glbench.realism.indoor import INDOOR, Indoor
from glbench.realism.inputs import Outdoors
from glbench.weather.record import FloatArray

FIRST = dt.date(2020, 1, 6)
STEP = 1800
"""Coarse, so that weeks take a second."""
SETTINGS = read_settings()
HOUSE = HOUSES["mixed_2020"]
BASE = parameters(HOUSE, SETTINGS)
NOISE = {"air_temperature": 0.3, "humidity": 2.0, "co2": 20.0}
"""Standard deviation of the sensors [K], [%], [ppm]."""


def changed(**factors: float) -> FloatArray:
    """The house's parameters (parameters,) with factors on some of them."""
    values = model(HOUSE.model).parameters
    p = BASE.copy()
    for name, factor in factors.items():
        p[values.names.index(name)] *= factor
    return values.complete(p)


def outside(days: int, step: int = STEP) -> Outdoors:
    """Weather whose days differ."""
    time = np.arange(days * 86400 // step) * step
    day, hour = time // 86400, time % 86400 / 3600.0
    mild = 4.0 + 4.0 * np.sin(2.0 * np.pi * day / 11.0)
    sun = np.maximum((350.0 + 150.0 * np.cos(2.0 * np.pi * day / 5.0)) * np.sin(np.pi * (hour - 8.0) / 9.0), 0.0)
    temperature = mild + 3.0 * np.sin(np.pi * (hour - 9.0) / 12.0)
    vapour = 0.8 * 610.78 * np.exp(17.2694 * temperature / (temperature + 238.3))
    wind = 3.0 + 2.0 * np.sin(2.0 * np.pi * day / 7.0 + 1.0)
    co2, soil, unread = np.full(time.size, 740.0), np.full(time.size, 9.0), np.zeros(time.size)
    values = np.column_stack([sun, temperature, vapour, co2, wind, temperature - 12.0, soil, unread, unread, unread])
    return Outdoors(values, day, hour, ())


def indoor(days: int, step: int = STEP) -> Indoor:
    """Actuators by the clock; the air as a constant, until the model has computed it."""
    weather = outside(days, step)
    day, hour = weather.day, weather.hour
    light, odd = (hour >= 8) & (hour < 17), day % 3 == 1
    columns = {name: np.full(day.size, np.nan) for name in INDOOR}
    columns |= {
        "air_temperature": np.full(day.size, 19.0),
        "humidity": np.full(day.size, 80.0),
        "co2": np.full(day.size, 700.0),
        "vents_lee": np.where(light & (hour >= 11), 20.0 + 10.0 * odd, 2.0),
        "vents_wind": np.where(light & odd, 10.0, 0.0),
        "thermal_screen": np.where(light, 0.0, 100.0 - 20.0 * odd),
        "blackout_screen": np.where((hour < 6) & (day % 2 == 0), 100.0, 0.0),
        "lamps": np.where((hour >= 4) & (hour < 14 - 2 * odd), 143.0, 0.0),
        "rail_pipe": np.where(light & odd, np.nan, 38.0 + 8.0 * np.cos(2.0 * np.pi * hour / 24.0)),
        "grow_pipe": np.where(hour < 8, 35.0, np.nan),
        "co2_dose": np.where(light, 0.004, 0.0),
    }
    return Indoor("Made", 1578265200 + step * np.arange(day.size), columns, 143.0, ())


def season(days: int, true: FloatArray, *, noise: float = 1.0, step: int = STEP) -> Drive:
    """What sensors measured in a house with these parameters."""
    empty = drive(indoor(days, step), outside(days, step), FIRST)
    run = free_run(model(HOUSE.model), true, empty, SETTINGS.plants)
    generator = np.random.default_rng(20200106)
    measured = {name: values[:, 0] + noise * NOISE[name] * generator.standard_normal(len(values)) for name, values in run.climate.items()}
    measured["humidity"][100:140] = np.nan
    return replace(empty, measured=measured)
