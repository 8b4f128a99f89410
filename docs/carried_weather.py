"""What predictive control gains when it carries the public weather of the test years: measured, for threat-model.md.

``python -m docs.carried_weather`` evaluates it on the first runs of the test of Spring-v1: with the published draws beside released runs of
plain ``mpc``, and with the fresh draws that ``mpc`` had (docs/fresh_draws_table.py). It writes measurements/carried-weather.json. The
agent was made by the errors of its outlook on the validation split, and run once on the test. It is not a baseline: it knows what it should
not, and shows what a score in known years can hide.
"""

from __future__ import annotations

import datetime as dt
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from docs import fresh_draws_table
from glbench.agents import LoadedAgent
from glbench.agents.predictive import PredictiveAgent, PredictiveSettings, read_predictive_settings
from glbench.control import Climatology, Outlook
from glbench.control.disturbance_forecast import Ahead
from glbench.evaluation import load_result, prepare, result_path
from glbench.resources import data_folder
from glbench.tasks import Round, TaskCard, TaskSpec, get_task
from glbench.weather import disturbances, load_weather
from glbench.weather.preprocessing import saturation_vapour_pressure, vapour_pressure

Floats = NDArray[np.float64]

TASK, RUNS, LEVEL = "Spring-v1", 10, 0.95
FILE = Path(__file__).parent / "measurements" / "carried-weather.json"
DAY, STEP = 86400, 900
WINDOW = 24
"""Rows of observed weather [15 min] by which the place in the record is looked for."""
NEAR = 30
"""A generated season takes its days from so near in the year [d]."""
HUMIDITY, WIND, ALIKE = 3.0, 0.5, 1.0
"""A place counts as the one where the mean squared difference of humidity and wind, each in these units [%, m s-1], is below the last."""
TOO_FAR = 4.0
"""Where record and forecast differ by more [K], another block of days has begun: from the forecast before that one on, nothing is known."""
BRIGHT = 30.0
"""Clear-sky radiation [W m-2] above which radiation is carried as a share of it."""


class CarriedOutlook(Outlook):
    """An outlook that looks the coming weather up in the public record of some years, wherever it finds its place there."""

    def __init__(self, task: TaskSpec, climatology: Climatology, years: tuple[int, ...], record: str) -> None:
        # Days that a zone's clock puts into another year are left out: a block never crosses them by much.
        start = dt.datetime(years[0], 1, 2, tzinfo=dt.UTC)
        rows = (dt.datetime(years[-1], 12, 30, tzinfo=dt.UTC) - start).days * DAY // STEP
        made = disturbances(
            load_weather(record),
            start=start,
            steps=rows,
            step_seconds=STEP,
            preprocessing=task.weather.preprocessing,
            co2_ppm=task.weather.co2_ppm,
        )
        names = task.model_value.disturbance_names
        self._record = {name: made.values[:, names.index(name)] for name in ("iGlob", "tOut", "vpOut", "wind", "tSky")}
        temperature = self._record["tOut"]
        self._humidity = 100.0 * self._record["vpOut"] / saturation_vapour_pressure(temperature)
        self._times = start.timestamp() + STEP * np.arange(len(temperature))
        self._columns = {name: names.index(name) for name in self._record}
        super().__init__(task, climatology)

    def reset(self, n: int) -> None:
        """Begin with ``n`` new runs, whose places are not known."""
        super().reset(n)
        self._course: list[Floats] = []
        self.places = np.full(n, -1)

    def update(self, observations: Any) -> None:
        """Take in what is observed, and look for the place of each run in the record."""
        super().update(observations)
        shown = self._observed[:, self._weather]  # radiation, temperature, humidity, CO2, wind
        self._course = [*self._course[-WINDOW + 1 :], shown]
        self.places = np.where(self.places >= 0, self.places + 1, -1)
        if self._k % 4 == 0 and len(self._course) == WINDOW:
            self.places = np.array([self._place(run) for run in range(self._n)])
        known = np.flatnonzero(self.places >= 0)
        depression = (self._record["tOut"] - self._record["tSky"])[self.places[known]]
        self._now[known, self._columns["tSky"]] = self._now[known, self._columns["tOut"]] - depression

    def _place(self, run: int) -> int:
        """The row of the record that is shown now; -1 where none is alike."""
        course = np.array([rows[run] for rows in self._course])
        now = self._begin[run] + self._k * STEP
        first = int((now - self._times[0]) % DAY // STEP)
        ends = np.arange(first, len(self._times) - 97, DAY // STEP)
        year = 365.25 * DAY
        apart = np.abs((self._times[ends] - now + year / 2) % year - year / 2)
        ends = ends[(apart <= NEAR * DAY) & (ends >= WINDOW)]
        rows = ends[:, None] - np.arange(WINDOW)[::-1]
        off = ((self._humidity[rows] - course[:, 2]) / HUMIDITY) ** 2
        off = (off + ((self._record["wind"][rows] - course[:, 4]) / WIND) ** 2).mean(axis=1)
        best = int(off.argmin())
        return int(ends[best]) if off[best] < ALIKE else -1

    def ahead(self, steps: int) -> Ahead:
        """The coming ``steps`` steps: the record's where the place is known and the forecast does not contradict it."""
        usual = super().ahead(steps)
        found = usual.d.copy()
        for run in np.flatnonzero(self.places >= 0).tolist():
            rows = self.places[run] + np.arange(steps)
            times = self._begin[run] + (self._k + np.arange(steps)) * STEP
            temperature = self._record["tOut"][rows] + self._now[run, self._columns["tOut"]] - self._record["tOut"][rows[0]]
            until = self._agreed(run, temperature)
            here, there = self.climatology.clear(times), self.climatology.clear(self._times[rows])
            share = np.where(np.minimum(here, there) > BRIGHT, here / np.maximum(there, 1.0), 1.0)
            columns = {
                "iGlob": self._record["iGlob"][rows] * share,
                "tOut": temperature,
                "vpOut": vapour_pressure(temperature, self._humidity[rows]),
                "wind": self._record["wind"][rows],
                "tSky": temperature - (self._record["tOut"] - self._record["tSky"])[rows],
            }
            for name, values in columns.items():
                found[run, 1:until, self._columns[name]] = values[1:until]
            found[run, 0, self._columns["tSky"]] = columns["tSky"][0]
        return Ahead(found, usual.calendar)

    def _agreed(self, run: int, temperature: Floats) -> int:
        """How many coming rows the forecast of the temperature does not contradict."""
        hours = self.task.observation.forecast_hours
        told = self._observed[run, self._forecast[1]]
        until = 0
        for hour, value in zip(hours, told.tolist(), strict=True):
            row = hour * 3600 // STEP
            if row < len(temperature) and abs(temperature[row] - value) > TOO_FAR:
                return until
            until = row
        return len(temperature)


class CarryingAgent(PredictiveAgent):
    """Predictive control with such an outlook."""

    def __init__(self, settings: PredictiveSettings, years: tuple[int, ...], record: str) -> None:
        super().__init__(settings)
        self._years, self._source = years, record

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """``n_runs`` runs of ``task`` begin."""
        super().reset(task, n_runs)
        spec = task.task()
        self._outlook = CarriedOutlook(spec, Climatology.of(spec), self._years, self._source)
        self._outlook.reset(n_runs)


def carrying(task: TaskSpec) -> LoadedAgent:
    """The agent with the weather of the years of the split of ``task``."""
    assert task.season_years is not None
    settings, years = read_predictive_settings(data_folder("baselines") / "mpc" / "settings.yml"), task.season_years
    return LoadedAgent(
        "carried_weather",
        "submission",
        "0" * 64,
        "observations",
        "observations, and the public weather of the years of the split",
        lambda _: CarryingAgent(settings, years, task.weather.source),
    )


def measured(task: TaskSpec, plain: list[float]) -> dict[str, Any]:
    """Rewards of the first runs of ``task`` with carried weather, beside ``plain``, and the mean gain with its interval (t, over runs)."""
    # The agent is this file: a sandbox, which evaluations with secret draws ask for, would keep nothing from it.
    evaluation = replace(prepare(get_task(TASK), carrying(task), runs=len(plain)), task=task)
    carried = list(evaluation.run().values("reward"))
    gains = np.subtract(carried, plain)
    half = float(stats.t.ppf(0.5 + LEVEL / 2.0, len(plain) - 1) * gains.std(ddof=1) / np.sqrt(len(plain)))
    gain = float(gains.mean())
    return {"carried": carried, "plain": plain, "gain": gain, "low": gain - half, "high": gain + half}


def read() -> dict[str, Any]:
    """What was measured."""
    return dict(json.loads(FILE.read_text(encoding="utf-8")))


def main() -> None:
    """Measure with the published draws, and with the fresh draws that ``mpc`` had in measurements/fresh-draws.json."""
    test = get_task(TASK).in_split("test")
    released = load_result(result_path(data_folder("reports/released"), test.id, "mpc"))
    fresh = fresh_draws_table.read()["mpc"]
    sealed = test.in_split("test", Round(fresh["salt"]).secret)
    found = {
        "task": test.id,
        "years": list(test.season_years or ()),
        "published": measured(test, list(released.values("reward")[:RUNS])),
        "fresh": {"salt": fresh["salt"], **measured(sealed, fresh["values"])},
    }
    FILE.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
