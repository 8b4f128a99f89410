"""The free run by what the actuators did, compared with the measured climate: as a file without measured values, and as pictures."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from glbench.realism.comparison import COLOURS, saved_figure
from glbench.realism.free_run import CHANNELS, Drive, Error, drive, free_run
from glbench.realism.houses import House, Settings, model, parameters
from glbench.realism.indoor import read_indoor
from glbench.realism.inputs import outdoors
from glbench.realism.published import ROW_SECONDS, Archive
from glbench.settings import Table
from glbench.weather.comparison import INK, tidy
from glbench.weather.record import FloatArray

LABELS: Mapping[str, str] = {"air_temperature": "air temperature\n[°C]", "humidity": "relative humidity\n[%]", "co2": "CO2\n[ppm]"}


Errors = dict[str, Error]  # By channel: ``air_temperature``, ``humidity``, ``co2``; those without a reading are left out


class HouseClimate(Table):
    """Errors of a house: in all, by month (``2020-03``), by hours of the day (``0-3``), in even and odd weeks."""

    name: str
    description: str
    overall: Errors
    months: dict[str, Errors]
    hours: dict[str, Errors]
    weeks: dict[str, Errors]


class CompartmentClimate(Table):
    """A compartment that has a measured climate: all houses, what was filled or taken out, and what a person should look at."""

    name: str
    houses: tuple[HouseClimate, ...]
    notes: tuple[str, ...]
    doubts: tuple[str, ...]


class ClimateComparison(Table):
    """Free runs by the actuators against the measured climate, from the first to the last day."""

    first: dt.date
    last: dt.date
    models: tuple[str, ...]
    settings: Settings
    notes: tuple[str, ...]
    compartments: tuple[CompartmentClimate, ...]


@dataclass(frozen=True, eq=False)
class ClimateRun:
    """The free runs of a compartment: a series [degC, %, ppm] (steps,) of each house by channel, beside what was measured."""

    name: str
    season: Drive
    simulated: Mapping[str, Mapping[str, FloatArray]]


Progress = Callable[[int, int], None]
"""Called with steps done and steps in all."""


def compare_climate(
    archive: Archive, houses: Sequence[House], settings: Settings, *, progress: Progress | None = None
) -> tuple[ClimateComparison, tuple[ClimateRun, ...]]:
    """Run each of ``houses`` freely in every compartment that has an indoor climate.

    Raises ``ArchiveError`` for unusable weather or climate, more light or CO2 than installed, ``StepError`` if no house can be run.
    """
    outside = outdoors(archive, settings.place.clock, settings.place.co2, step_seconds=ROW_SECONDS)
    measured = [(one.name, one.indoor) for one in archive.compartments if one.indoor is not None]
    models = tuple(dict.fromkeys(house.model for house in houses))
    jobs, compartments, runs = len(measured) * len(models), [], []
    for place, (compartment, path) in enumerate(measured):
        power = settings.lamps.power if archive.own else None
        indoor = read_indoor(path, settings.place.clock, first=archive.first, days=archive.days, lamp_power=power)
        season = drive(indoor, outside, archive.first)
        by_house: dict[str, HouseClimate] = {}
        simulated: dict[str, Mapping[str, FloatArray]] = {}
        for number, name in enumerate(models):
            before = place * len(models) + number

            def move(step: int, steps: int, before: int = before) -> None:
                if progress is not None:
                    progress(before * steps + step, jobs * steps)

            lanes = [house for house in houses if house.model == name]
            rows = np.stack([parameters(house, settings) for house in lanes])
            run = free_run(model(name), rows, season, settings.plants, progress=move)
            for lane, house in enumerate(lanes):
                overall = {channel: one for channel, one in run.errors(lane).items() if one.readings}
                by_house[house.name] = HouseClimate(name=house.name, description=house.description, overall=overall, **run.table(lane))
                simulated[house.name] = {channel: values[:, lane] for channel, values in run.climate.items()}
        ordered = tuple(by_house[house.name] for house in houses)
        compartments.append(CompartmentClimate(name=compartment, houses=ordered, notes=indoor.notes, doubts=indoor.doubts))
        runs.append(ClimateRun(compartment, season, {house.name: simulated[house.name] for house in houses}))
    comparison = ClimateComparison(
        first=archive.first, last=archive.dates[-1].item(), models=models, settings=settings, notes=(*archive.notes, *outside.notes),
        compartments=tuple(compartments),
    )  # fmt: skip
    return comparison, tuple(runs)


def draw_mean_days(run: ClimateRun, path: Path) -> None:
    """Write a PNG: the mean day of each month, a row a channel, a column a month; what was simulated beside what was measured.

    Hours without a measured reading count for neither. It shows measured values: mind the licence of the data before you pass it on.
    """
    import pandas as pd
    from matplotlib.figure import Figure

    season = run.season
    months = season.date.astype("datetime64[M]")
    every = np.unique(months)
    figure = Figure(figsize=(1.6 + 2.1 * every.size, 7.4), dpi=100, layout="constrained", facecolor="white")
    axes: Any = figure.subplots(len(CHANNELS), every.size, sharex=True, sharey="row", squeeze=False)
    for number_of_row, (row, channel) in enumerate(zip(axes, CHANNELS, strict=True)):
        for place, (box, month) in enumerate(zip(row, every, strict=True)):
            steps = (months == month) & np.isfinite(season.measured[channel])
            lines = [(name, COLOURS[number % len(COLOURS)], 1.2, one[channel]) for number, (name, one) in enumerate(run.simulated.items())]
            for name, colour, width, values in (*lines, ("measured", INK, 2.2, season.measured[channel])):
                mean = pd.Series(values[steps]).groupby(season.hour[steps]).mean().reindex(range(24))
                box.plot(mean.index + 0.5, mean, color=colour, lw=width, label=name)
            if number_of_row == 0:
                box.set_title(f"{month.item():%B %Y}", fontsize=10, color=INK)
            if not place:
                box.set_ylabel(LABELS[channel], fontsize=9, color=INK)
            if number_of_row == len(CHANNELS) - 1:
                box.set_xlabel("hour of day [h]", fontsize=9, color=INK)
            box.set_xlim(0, 24)
            box.set_xticks(range(0, 25, 6))
            tidy(box)
    saved_figure(figure, axes[0][0], path)


def draw_errors(compartment: CompartmentClimate, path: Path) -> None:
    """Write a PNG: root mean square error at the left and bias at the right by month, a row a channel, a line a house."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 7.4), dpi=100, layout="constrained", facecolor="white")
    axes: Any = figure.subplots(len(CHANNELS), 2, sharex=True, squeeze=False)
    axes[0][0].set_title("root mean square error", fontsize=10, color=INK)
    axes[0][1].set_title("bias: simulated minus measured", fontsize=10, color=INK)
    for row, (channel, unit) in zip(axes, CHANNELS.items(), strict=True):
        row[0].set_ylabel(f"{LABELS[channel].partition(chr(10))[0]}\n[{unit}]", fontsize=9, color=INK)
        row[1].axhline(0.0, color=INK, lw=0.8)
        for number, house in enumerate(compartment.houses):
            months = [month for month, errors in house.months.items() if channel in errors]
            look = {"color": COLOURS[number % len(COLOURS)], "lw": 1.2, "marker": "o", "ms": 4, "label": house.name}
            names = [f"{dt.date.fromisoformat(f'{month}-01'):%b %Y}".replace(" ", chr(10)) for month in months]
            row[0].plot(names, [house.months[month][channel].rmse for month in months], **look)
            row[1].plot(names, [house.months[month][channel].bias for month in months], **look)
        row[0].set_ylim(bottom=0.0)
        for box in row:
            tidy(box)
    saved_figure(figure, axes[0][0], path)
