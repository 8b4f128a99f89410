"""The free run: the climate that the model computes when it is given the measured weather and what the actuators measurably did.

Vents, screens, lamps and CO2 are the model's controls. The measured temperatures of the rail and growing pipe are set at the start of
each step in which the pipe is on; off, it floats. Nothing of the measured air enters after the first reading.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glbench.errors import ArchiveError, StepError, refuse
from glbench.kernel import Kernel, Rows
from glbench.model import Model, co2_ppm, relative_humidity
from glbench.realism.houses import Plants
from glbench.realism.indoor import Indoor
from glbench.realism.inputs import Outdoors
from glbench.realism.season import AIR_AT_START, young_crop
from glbench.settings import Table
from glbench.tasks import set_points as names
from glbench.weather.record import FloatArray, IntArray

CHANNELS: Mapping[str, str] = {"air_temperature": "K", "humidity": "%", "co2": "ppm"}  # What is compared, with the unit of its errors
HOURS = 3  # Length of the parts of a day whose errors are told apart [h]
PRESET, THREADS = "fast", 2  # Of the kernel; the number of threads changes no bit
_AIR, _PIPES = ("tAir", "vpAir", "co2Air"), {"rail_pipe": "tPipe", "grow_pipe": "tGroPipe"}
_SCREENS = {names.SCREEN: "thermal_screen", names.BLACKOUT: "blackout_screen"}
_MG_S = 1e6 / 3600.0  # a kilogram an hour

Flags = NDArray[np.bool_]
Progress = Callable[[int, int], None]
"""Called with steps done and steps in all."""


@dataclass(frozen=True, eq=False)
class Drive:
    """What drives the free run, and what it is compared with; every array is (steps,), ``weather`` (steps, disturbances).

    Date and whole hour are those of the local clock, weeks are counted from the first day. ``shares`` has the positions of vents and
    screens [-] by control, ``lamps`` their electric power [W m-2], ``dose`` the CO2 [mg m-2 s-1], ``pipes`` temperatures [degC] by state,
    NaN where a pipe is off, and ``measured`` the ``CHANNELS`` [degC, %, ppm], NaN where there is no reading.
    """

    step_seconds: float
    date: NDArray[np.datetime64]
    hour: IntArray
    week: IntArray
    weather: FloatArray
    shares: Mapping[str, FloatArray]
    lamps: FloatArray
    dose: FloatArray
    pipes: Mapping[str, FloatArray]
    measured: Mapping[str, FloatArray]

    def groups(self) -> dict[str, dict[str, Flags]]:
        """Steps by what errors are told apart: ``months`` (``2020-03``), ``hours`` of the day (``0-3``), ``weeks`` (even, odd)."""
        odd, months = self.week % 2 == 1, self.date.astype("datetime64[M]")
        return {
            "months": {str(one): months == one for one in np.unique(months)},
            "hours": {f"{one}-{one + HOURS}": self.hour // HOURS * HOURS == one for one in range(0, 24, HOURS)},
            "weeks": {"even": ~odd, "odd": odd},
        }


def drive(indoor: Indoor, outside: Outdoors, first: dt.date) -> Drive:
    """Put measured climate and weather together.

    Both have the same steps, of which the first is at midnight of the day ``first``. An actuator without a reading keeps its last one;
    one that was never read is closed or off. Two vents count as their mean. Raises ``ArchiveError`` when climate and weather differ in
    their steps, or temperature or humidity of the air was never measured.
    """
    steps = outside.steps
    if indoor.times.size != steps:
        msg = f"{indoor.name}: the climate has {indoor.times.size:,} rows and the weather {steps:,} steps. Both must cover the same days."
        raise ArchiveError(msg)
    missing = np.full(steps, np.nan)
    measured = {channel: indoor.columns.get(channel, missing) for channel in CHANNELS}
    if empty := [channel for channel, values in measured.items() if channel != "co2" and np.isnan(values).all()]:
        refuse(f"{indoor.name}: no plausible reading of {' or '.join(empty)}, so nothing can be compared. Check the unit.", ArchiveError)
    vents = [indoor.columns.get(name, missing) for name in ("vents_lee", "vents_wind")]
    vents = [_hold(values) for values in vents if np.isfinite(values).any()] or [np.zeros(steps)]
    shares = {names.VENTS: np.mean(vents, axis=0)} | {key: _hold(indoor.columns.get(name, missing)) for key, name in _SCREENS.items()}
    return Drive(
        step_seconds=float(indoor.times[1] - indoor.times[0]),
        date=np.datetime64(first, "D") + outside.day,
        hour=outside.hour.astype(np.int64),
        week=outside.day // 7,
        weather=outside.values,
        shares={name: np.clip(percent / 100.0, 0.0, 1.0) for name, percent in shares.items()},
        lamps=_hold(indoor.columns.get("lamps", missing)),
        dose=_MG_S * _hold(indoor.columns.get("co2_dose", missing)),
        pipes={state: indoor.columns.get(name, missing) for name, state in _PIPES.items()},
        measured=measured,
    )


def _hold(values: FloatArray) -> FloatArray:
    """Values, and where there is none the last before it; 0 before the first."""
    import pandas as pd

    return np.array(pd.Series(values).ffill().fillna(0.0), dtype=np.float64)


class Error(Table, allow_inf_nan=True):
    """Simulated minus measured, in the channel's unit: root mean square and mean of so many readings; NaN of none."""

    rmse: float
    bias: float
    readings: int


@dataclass(frozen=True, eq=False)
class FreeRun:
    """A free run of several parameter sets, the lanes: simulated ``CHANNELS`` at the start of each step, as readings are (steps, lanes).

    A lane that could not be integrated is NaN from there on; ``failures`` says why.
    """

    drive: Drive
    climate: Mapping[str, FloatArray]
    failures: Mapping[int, str]

    def differences(self, channel: str) -> FloatArray:
        """Simulated minus measured (steps, lanes) [unit of ``CHANNELS``], as far as was simulated."""
        simulated = self.climate[channel]
        return simulated - self.drive.measured[channel][: len(simulated), None]

    def errors(self, lane: int = 0, steps: Flags | None = None) -> dict[str, Error]:
        """Errors by channel, in all or of some steps."""
        result = {}
        for channel in CHANNELS:
            values = self.differences(channel)[:, lane]
            values = values if steps is None else values[steps[: values.size]]
            values = values[np.isfinite(values)]
            mean, square = (float(np.mean(one)) if values.size else float("nan") for one in (values, values**2))
            result[channel] = Error(rmse=square**0.5, bias=mean, readings=values.size)
        return result

    def table(self, lane: int = 0) -> dict[str, dict[str, dict[str, Error]]]:
        """Errors by group and label of ``Drive.groups`` and by channel; those without a reading are left out."""
        return {
            group: {label: {name: one for name, one in self.errors(lane, steps).items() if one.readings} for label, steps in labels.items()}
            for group, labels in self.drive.groups().items()
        }


def free_run(
    greenhouse: Model, parameters: FloatArray, season: Drive, plants: Plants, *, steps: int | None = None, progress: Progress | None = None
) -> FreeRun:
    """Run ``parameters`` (lanes, parameters) side by side through a measured season, or its first ``steps``.

    The young crop is planted in the air as first measured. Raises ``ArchiveError`` when lamps or CO2 supply gave more than is installed in
    a set, and ``StepError`` when no lane can be integrated.
    """
    p = np.ascontiguousarray(np.atleast_2d(parameters))
    count, total = len(p), season.hour.size if steps is None else min(steps, season.hour.size)
    warm = season.measured["air_temperature"][0]
    air = float(warm) if np.isfinite(warm) else AIR_AT_START
    x = np.stack([young_crop(greenhouse, season.weather[0], row, plants, air) for row in p])
    sets = (dict(zip(greenhouse.parameter_names, row.tolist(), strict=True)) for row in p)
    installed = [{one.name: one.capacity for one in greenhouse.capacities(values)} for values in sets]
    column = {name: number for number, name in enumerate(greenhouse.control_names)}
    controls = np.zeros((total, count, len(column)))
    for name, share in season.shares.items():
        controls[:, :, column[name]] = share[:total, None]
    for name, amount in ((names.LAMPS, season.lamps), (names.DOSING, season.dose)):
        most = np.array([one[name] for one in installed])
        if amount.max() > most.min() * (1.0 + 1e-6):
            what = (
                "The lamps took up to {} W/m2 (thetaLampMax)" if name == names.LAMPS else "Up to {} mg/m2/s CO2 was dosed (phiExtCo2/aFlr)"
            )
            msg = f"{what.format(f'{amount.max():.4g}')}, but the parameter set has {most.min():.4g}. Override the parameter."
            raise ArchiveError(msg)
        controls[:, :, column[name]] = np.clip(amount[:total, None] / np.where(most > 0.0, most, 1.0), 0.0, 1.0)
    pipes = [(greenhouse.state_index(state), values) for state, values in season.pipes.items()]
    air_states = [greenhouse.state_index(name) for name in _AIR]
    kernel = Kernel(greenhouse, season.step_seconds, preset=PRESET, threads=THREADS)
    air_values = np.full((total, count, len(_AIR)), np.nan)
    alive, failures = np.arange(count), dict[int, str]()
    for step in range(total):
        for state, values in pipes:
            if np.isfinite(values[step]):
                x[:, state] = values[step]
        air_values[step, alive] = x[:, air_states]
        u, d = controls[step, alive], np.repeat(season.weather[step : step + 1], alive.size, axis=0)
        x, failed = kernel.advance(Rows(x, u, d, p))
        if failed:
            failures |= {int(alive[one.row]): f"step {step}, {season.date[step]}: {one.reason}" for one in failed}
            rest = np.setdiff1d(np.arange(alive.size), [one.row for one in failed])
            x, p, alive = x[rest], p[rest], alive[rest]
            if not alive.size:
                refuse(f"No parameter set could be integrated; the last failed in {next(reversed(failures.values()))}", StepError)
        if progress is not None and (step + 1 == total or season.date[step + 1] != season.date[step]):
            progress(step + 1, total)
    temperature, vapour, carbon = np.moveaxis(air_values, 2, 0)
    climate = (temperature, relative_humidity(temperature, vapour), co2_ppm(temperature, carbon))
    return FreeRun(season, dict(zip(CHANNELS, climate, strict=True)), failures)
