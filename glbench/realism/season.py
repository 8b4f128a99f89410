"""Simulates a season of the compartments in a house: given weather, light and CO2, heat and vents by the process computer.

A compartment with indoor climate can be driven by its own set points, as they were realised, instead of the page of settings: those of both
sides' vents, and the positions of screens and lamps. The model's boiler feeds the rail pipes only, so these give off, by the organisers'
formula, what the least temperatures of rail and growing pipe ask for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from glbench.env.process_computer import MEMORY, Measured, work
from glbench.errors import ArchiveError
from glbench.kernel import Kernel
from glbench.model import Model, co2_ppm, humidity_deficit, relative_humidity
from glbench.realism.houses import House, Plants, Settings, model, parameters
from glbench.realism.indoor import Indoor
from glbench.realism.inputs import STEP_SECONDS, Outdoors, schedule
from glbench.realism.published import ROW_SECONDS, Archive
from glbench.tasks import get_task
from glbench.tasks import set_points as names
from glbench.weather.record import FloatArray

AIR_AT_START = 18.0  # Temperature of air and surfaces when the season begins [degC]
MOST_CHANGE = 0.3  # Most that a control moves in a step
RAIL_PIPE, GROW_PIPE = 2.1, 0.62
"""Heat per kelvin above the air, by the archive's organisers, of the rail pipe and of the growing pipe [W m-2 K-1]."""
_READ = ("tAir", "vpAir", "co2Air", "sumMcFruitHar", "tPipe", "tGroPipe")
_BASE = "glbench/SpringYears-v1"
_ALWAYS = 2000.0  # W m-2: no sun is brighter
_STEERED = (names.BOILER, names.VENTS, names.DOSING, names.LAMPS, names.SCREEN, names.BLACKOUT)
NEEDED = ("heating_set_point", "ventilation_lee_set_point")  # Without these a compartment cannot be driven by its own set points
_REALISED = (
    *NEEDED, "ventilation_wind_set_point", "humidity_deficit_set_point", "minimum_rail_pipe", "minimum_grow_pipe", "minimum_vents",
    "co2_set_point", "lamps", "thermal_screen", "blackout_screen",
)  # fmt: skip

Progress = Callable[[int, int], None]
"""Called with days done and days in all."""


@dataclass(frozen=True, eq=False)
class Season:
    """A simulated season, day by day; every array is (days, compartments).

    ``heat`` is what the boiler gave the pipes [MJ m-2], ``pipe_heat`` what they gave off as the archive's heat is computed, ``RAIL_PIPE``
    and ``GROW_PIPE`` times pipe above air temperature [MJ m-2]; then the lamps' electricity [kWh m-2], ``co2`` dosed [kg m-2], dry mass of
    the ``harvest`` [kg m-2], and means of the day of the air [degC, %, ppm].
    """

    house: House
    heat: FloatArray
    pipe_heat: FloatArray
    lamps: FloatArray
    co2: FloatArray
    harvest: FloatArray
    air_temperature: FloatArray
    humidity: FloatArray
    co2_air: FloatArray


def simulate(
    archive: Archive,
    outside: Outdoors,
    house: House,
    settings: Settings,
    *,
    indoors: Mapping[str, Indoor] = MappingProxyType({}),
    warmer: float = 0.0,
    progress: Progress | None = None,
) -> Season:
    """Simulate all compartments of ``archive`` in ``house`` under its weather ``outside``.

    ``indoors`` has by name of a compartment its indoor climate over the days of the archive, whose set points drive it; all else is the
    page's. ``warmer`` is added to all temperatures of heating and ventilation [K]. Raises ``ArchiveError`` when an indoor climate lacks a
    set point of heating or ventilation, or has other days, and ``StepError`` when a step cannot be integrated.
    """
    greenhouse, p, count = model(house.model), parameters(house, settings), len(archive.compartments)
    # Of the process computer's task only its defaults and the house count.
    computer = get_task(_BASE).replace(
        {
            "id": f"realism/{house.name}-v1",
            "title": f"The process computer of {house.name}",
            "actuation.kind": "process_computer",
            "actuation.max_change": MOST_CHANGE,
            "weather.step_seconds": STEP_SECONDS,
            "model.parameters": house.parameters,
        }
    )
    installed = {one.name: one.capacity for one in greenhouse.capacities(dict(zip(greenhouse.parameter_names, p.tolist(), strict=True)))}
    plan = schedule(archive.compartments, outside, settings, most_co2=installed[names.DOSING], warmer=warmer)
    own = [number for number, one in enumerate(archive.compartments) if one.name in indoors]
    lanes = np.array([*range(count), *own], dtype=np.intp)  # the computer works windward vents as those of compartments of their own
    realised = {name: np.full((outside.steps, count), np.nan) for name in _REALISED}
    for number in own:
        _realise(realised, number, indoors[archive.compartments[number].name])

    def in_force(name: str, planned: FloatArray, shift: float = 0.0) -> FloatArray:
        return np.where(np.isnan(realised[name]), planned, realised[name] + shift)

    heating = in_force("heating_set_point", plan.heating, warmer)[:, lanes]
    lee = in_force("ventilation_lee_set_point", plan.ventilation, warmer)
    ventilation = np.hstack([lee, in_force("ventilation_wind_set_point", lee, warmer)[:, own]])
    deficit = in_force("humidity_deficit_set_point", plan.humidity_deficit)[:, lanes]
    lamps = np.minimum(in_force("lamps", installed[names.LAMPS] * plan.lamps) / installed[names.LAMPS], 1.0)
    rail_pipe, grow_pipe, vents, co2 = (
        np.nan_to_num(realised[name]) for name in ("minimum_rail_pipe", "minimum_grow_pipe", "minimum_vents", "co2_set_point")
    )
    by_dose = np.isnan(realised["co2_set_point"])
    kernel = Kernel(greenhouse, STEP_SECONDS)
    place = {name: greenhouse.state_index(name) for name in _READ}
    column = {name: number for number, name in enumerate(greenhouse.control_names)}
    x = np.repeat(young_crop(greenhouse, outside.values[0], p, settings.plants)[None], count, axis=0)
    u = np.zeros((count, len(column)))
    moved: dict[str, Any] = {name: np.zeros(lanes.size) for name in _STEERED}
    memory: dict[str, Any] = {name: np.full(lanes.size, value) for name, value in MEMORY.items()}
    sums = {name: np.zeros((archive.days, count)) for name in ("heat", "pipes", "lamps", "co2", "harvest", "air", "humid", "ppm")}
    p_rows = np.repeat(p[None], count, axis=0)
    for step in range(outside.steps):
        day, d = int(outside.day[step]), outside.values[step]
        air, vapour, carbon = (x[:, place[name]] for name in ("tAir", "vpAir", "co2Air"))
        humidity, ppm = relative_humidity(air, vapour), co2_ppm(air, carbon)
        sums["air"][day] += air
        sums["humid"][day] += humidity
        sums["ppm"][day] += ppm
        burning = lamps[step]
        set_points = {
            names.HEATING: heating[step],
            names.VENTILATION: ventilation[step],
            names.HUMIDITY: deficit[step],
            names.CO2: co2[step, lanes],
            # The computer closes the blackout screen over burning lamps; the plan says how much they burn.
            names.LAMPS_FROM: 0.0,
            names.LAMPS_UNTIL: np.where(burning > 0.0, 24.0, 0.0)[lanes],
            names.LAMP_RADIATION: _ALWAYS,
            names.SCREEN_RADIATION: settings.screen.radiation_limit,
            names.SCREEN_OUTDOOR: plan.outdoor[step, lanes],
        }
        readings = Measured(air[lanes], ppm[lanes], humidity_deficit(air, humidity)[lanes], d[0], d[1], d[4], hour_of_day=12.0)
        moved, memory = work(computer, set_points, moved, readings, memory)
        moved[names.LAMPS] = burning[lanes]
        for name, position in ((names.SCREEN, "thermal_screen"), (names.BLACKOUT, "blackout_screen")):
            shut = realised[position][step, lanes] / 100.0
            moved[name] = np.where(np.isnan(shut), moved[name], shut)
        for name, values in moved.items():
            u[:, column[name]] = values[:count]
        u[own, column[names.VENTS]] = 0.5 * (np.maximum(u[own, column[names.VENTS]], vents[step, own] / 100.0) + moved[names.VENTS][count:])
        least = RAIL_PIPE * np.maximum(rail_pipe[step] - air, 0.0) + GROW_PIPE * np.maximum(grow_pipe[step] - air, 0.0)
        u[:, column[names.BOILER]] = np.maximum(u[:, column[names.BOILER]], np.minimum(least / installed[names.BOILER], 1.0))
        dose = np.where(by_dose[step], plan.dose[step], installed[names.DOSING] * u[:, column[names.DOSING]])
        u[:, column[names.DOSING]] = dose / installed[names.DOSING]
        before = x[:, place["sumMcFruitHar"]].copy()
        x = kernel.step(x, u, np.repeat(d[None], count, axis=0), p_rows)
        sums["harvest"][day] += 1e-6 * (x[:, place["sumMcFruitHar"]] - before)
        sums["heat"][day] += 1e-6 * STEP_SECONDS * installed[names.BOILER] * u[:, column[names.BOILER]]
        air, rail, grow = (x[:, place[name]] for name in ("tAir", "tPipe", "tGroPipe"))
        release = RAIL_PIPE * np.maximum(rail - air, 0.0) + GROW_PIPE * np.maximum(grow - air, 0.0)
        sums["pipes"][day] += 1e-6 * STEP_SECONDS * release
        sums["lamps"][day] += STEP_SECONDS / 3.6e6 * installed[names.LAMPS] * burning
        sums["co2"][day] += 1e-6 * STEP_SECONDS * dose
        if progress is not None and (step + 1 == outside.steps or outside.day[step + 1] != day):
            progress(day + 1, archive.days)
    steps = np.bincount(outside.day, minlength=archive.days)[:, None]
    return Season(
        house, sums["heat"], sums["pipes"], sums["lamps"], sums["co2"], sums["harvest"],
        sums["air"] / steps, sums["humid"] / steps, sums["ppm"] / steps,
    )  # fmt: skip


def _realise(realised: Mapping[str, FloatArray], place: int, indoor: Indoor) -> None:
    """Write the means of the steps into column ``place``; a gap holds the reading before it."""
    import pandas as pd

    for name, table in realised.items():
        values, rows = indoor.columns[name], len(table) * STEP_SECONDS // ROW_SECONDS
        present = np.count_nonzero(~np.isnan(values))
        if values.size != rows or (name in NEEDED and not present):
            msg = (
                f"{indoor.name} cannot be driven by its own set points: it has {present:,} of {rows:,} readings of {name}. Read its "
                "indoor climate over the days of the archive, or simulate it by the settings."
            )
            raise ArchiveError(msg)
        table[:, place] = pd.Series(values).ffill().bfill().to_numpy().reshape(len(table), -1).mean(axis=1)


def young_crop(greenhouse: Model, first: FloatArray, p: FloatArray, plants: Plants, air_temperature: float = AIR_AT_START) -> FloatArray:
    """State when the young plants have been planted (states,), with air, surfaces and plants at ``air_temperature`` [degC].

    ``first`` is the first row of the weather (disturbances,), ``p`` the parameters (parameters,); the rest is that of any start. Of a crop
    with more states than plants are described by, such as trusses, the model's own young crop is planted instead.
    """
    mass = 1e3 * plants.dry_mass  # mg m-2
    own = {
        "tCan": air_temperature, "tCan24": air_temperature, "cBuf": 0.0, "cLeaf": mass * plants.leaves, "cStem": mass * plants.stems,
        "cFruit": mass * plants.fruit, "tCanSum": 0.0,
    }  # fmt: skip
    if not own.keys() >= set(greenhouse.crop_states):
        return np.array(greenhouse.start("young_crop", first, air_temperature, p))
    x = np.array(greenhouse.start("mature_crop", first, air_temperature, p))
    for name, value in own.items():
        x[greenhouse.state_index(name)] = value
    return x
