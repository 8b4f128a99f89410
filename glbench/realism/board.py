"""The growers on the board: what controllers of the benchmark would have earned in the archive's season, at the archive's prices.

A house becomes a task of its own: the archive's weather, days and plants, the house's parameters, its prices as the ledger. The ordinary
evaluation plays it, with the sensors and forecasts of ``BASE`` and no crop or house drawn. The money of all rows is counted by ``money``.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from glbench import settings as pages
from glbench.errors import ArchiveError, SubmissionError
from glbench.evaluation import Progress, TimeLimits, evaluate
from glbench.model import with_violation_meters
from glbench.realism.comparison import FIRST_FRUIT
from glbench.realism.houses import House, Settings, model, parameters
from glbench.realism.indoor import read_indoor
from glbench.realism.inputs import STEP_SECONDS, Outdoors, outdoors
from glbench.realism.money import Account, Prices, account_of, settle
from glbench.realism.published import Archive
from glbench.realism.season import AIR_AT_START, simulate, young_crop
from glbench.tasks import INITIAL_STATES, TaskSpec, get_task
from glbench.tasks.vocabulary import InitialState
from glbench.weather import disturbances, load_weather, preprocessing
from glbench.weather.record import SLOT_SECONDS, Origin, Place, Rows, WeatherRecord, assemble
from glbench.weather.store import save_weather

BASE, BY_SET_POINTS = "glbench/Spring-v1", "glbench/SpringSetpoints-v1"
"""Tasks whose sensors, forecasts, limits and actions agents get: those that move controls, and those that enter set points."""
GROWERS = "Reference"  # The compartment that growers ran
TRAINING_YEARS = [2016, 2017, 2018]  # Those of ``BASE``, eight years later
LIMITS = TimeLimits(start=1800.0, step=1800.0, run=86400.0)  # Planning in a house that was never planned for begins slowly
_SOURCE = "Autonomous Greenhouse Challenge, second edition, doi 10.4121/uuid:88d22c60-21b3-4ea8-90db-20249a5be2a7"
_BLEISWIJK = (52.03, 4.53, -4.0)  # degrees north, degrees east, m
_EIGHT_YEARS = 2922 * 86400  # s, with the same leap years around each day
_HOURS_REPEATED = 72
_MEGAJOULES = 3.6  # in a kWh


class Board(pages.Table):
    """The rows: compartments as measured, and in each house the growers' season by their own set points and the agents.

    Simulated fruit has the mean ``dry_matter`` [kg kg-1] and soluble solids ``brix`` [degrees Brix] of the growers' ``compartment``.
    ``refused`` says why an agent has no row.
    """

    first: dt.date
    last: dt.date
    compartment: str
    dry_matter: float
    brix: float
    prices: Prices
    accounts: tuple[Account, ...]
    refused: tuple[str, ...]
    notes: tuple[str, ...]


def weather_record(outside: Outdoors, begin: int, clock: str) -> WeatherRecord:
    """The archive's weather as an hourly record of means; the season begins at ``begin`` [s UTC].

    The last three days come once more after the end: agents see two as a forecast, steps have the first hour only, because a task has days
    of 24 h and the clock skips one in spring. Before the season is Schiphol's weather of eight years earlier, whose first three whole
    years are the task's training years: predictive control takes its mean days from them, as in ``BASE``.
    """
    earlier = load_weather("schiphol")
    since = earlier.begin + 25 * SLOT_SECONDS  # a local midnight in winter
    hours, start = max(0, begin - _EIGHT_YEARS - since) // SLOT_SECONDS, dt.datetime.fromtimestamp(since, dt.UTC)
    past = disturbances(earlier, start=start, steps=hours, step_seconds=SLOT_SECONDS, preprocessing="conserving").values
    now = outside.values.reshape(-1, SLOT_SECONDS // STEP_SECONDS, past.shape[1]).mean(axis=1)
    values = np.concatenate([past, now, np.tile(now, (3, 1))[-_HOURS_REPEATED:]])
    radiation, temperature, vapour, _, wind, sky = values.T[:6]  # in the order of preprocessing.COLUMNS
    saturated = preprocessing.vapour_pressure(temperature, np.full(len(values), 100.0))
    columns = {
        "air_temperature": temperature,
        "relative_humidity": np.minimum(100.0 * vapour / saturated, 100.0),
        "wind_speed": wind,
        "global_radiation": radiation,
        "sky_infrared": preprocessing.STEFAN_BOLTZMANN * (sky + preprocessing.KELVIN) ** 4,
    }
    slots = np.arange(1, len(values) + 1, dtype=np.int64)
    ends = begin + SLOT_SECONDS * (slots - hours)
    notes = (f"The last {_HOURS_REPEATED} h repeat those before them. Before the season is Schiphol's weather of eight years earlier.",)
    origin = Origin("archive", Place("Bleiswijk", *_BLEISWIJK, clock), _SOURCE, "that of the archive", notes=notes)
    return assemble(Rows("the archive's weather", ends, columns, dict.fromkeys(columns, "mean"), slots), origin)


def season_task(
    archive: Archive, house: House, settings: Settings, prices: Prices, weather: str, fruit: tuple[float, float], base: str = BASE
) -> TaskSpec:
    """The archive's season in ``house`` as a task, with the record ``weather`` and the sensors and actions of the task ``base``.

    ``fruit`` is its dry matter content [kg kg-1] and soluble solids [degrees Brix]. A ``TaskError`` says what makes no task.
    """
    values, own, plants = model(house.model).parameters, parameters(house, settings), settings.plants
    greenhouse, usual = with_violation_meters(model(house.model)), values.default(house.parameters)
    infos = [values.info(name) for name in values.names]
    changed = {
        one.name: {"value": float(new), "unit": one.unit}
        for one, old, new in zip(infos, usual, own, strict=True)
        if new != old and not one.is_derived
    }
    start = f"planted-{house.name}-{plants.dry_mass:g}"
    if start not in INITIAL_STATES:
        meaning = "the young plants of the settings of glbench validate"
        INITIAL_STATES.add(InitialState(start, meaning, lambda first, air, p: young_crop(greenhouse, first, p, plants, air)))
    content, brix = fruit
    days, lamps = sorted(prices.fruit), settings.lamps
    paid = prices.of_fruit(np.array([f"2020-{day}" for day in days], dtype="datetime64[D]"), brix)
    tariffs = [prices.electricity_high if lamps.high_from <= hour < lamps.high_until else prices.electricity_low for hour in range(24)]
    picked = {"price": "fruit", "factor": 1e-6 / content}
    changes: dict[str, Any] = {
        "id": f"realism/{house.name.replace('_', '-')}{'' if base == BASE else '-set-points'}-v1",
        "title": f"The archive's season in {house.name}",
        "weather": {"source": weather, "start": archive.first, "days": archive.days, "co2_ppm": settings.place.co2},
        "model": {"id": house.model, "parameters": house.parameters, "overrides": changed},
        "initial_state": {"kind": start, "air_temperature.value": AIR_AT_START},
        "scenario": {"generated": None, "co2_range": None, "parameters": None, "start": None, "start_within_days": 0},
        "splits": {"training": {"years": TRAINING_YEARS}, "test": {"years": [archive.first.year]}},
        "ledger": {
            "revenue_harvest": picked,
            "revenue_growth": picked,
            "cost_heat.price": {"value": _MEGAJOULES * prices.heat, "unit": "EUR kWh-1"},
            "cost_electricity.price": "electricity",
            "cost_co2.price": {"value": prices.co2, "unit": "EUR kg-1"},
        },
        "price_tables.fruit": {"unit": "EUR kg-1", "from_day": dict(zip(days, paid.tolist(), strict=True))},
        "price_tables.electricity": {"unit": "EUR kWh-1", "hourly": tariffs},
        "evaluation.runs": 1,
    }
    return get_task(base).replace(changes)


def board(
    archive: Archive,
    houses: Sequence[House],
    settings: Settings,
    prices: Prices,
    agents: Sequence[str],
    *,
    out: Path | None = None,
    progress: Callable[[str, int, int], None] = lambda *_: None,
) -> Board:
    """Count the money of the compartments, and in each of ``houses`` of the growers' season and of ``agents``.

    The archive's weather is stored among the user's records. Agents are baselines, or submissions, which run in a sandbox. One that moves
    no controls enters set points; one that can do neither is refused with its own words. The heat of simulated growers is their pipes' by
    the organisers' formula, that of agents the boiler's. ``progress`` is called with what is simulated, and how far, of how much.

    An ``ArchiveError`` says which measurement is missing, another ``GlbenchError`` why an evaluation cannot be run, or saved in ``out``.
    """
    accounts = [account_of(archive, one, prices) for one in archive.compartments]
    inside = [place for place, one in enumerate(archive.compartments) if one.indoor is not None]
    if not inside:
        msg = "No compartment has indoor climate, whose set points could drive the growers' season. Add GreenhouseClimate.csv."
        raise ArchiveError(msg)
    place = next((place for place in inside if accounts[place].name == GROWERS), inside[0])
    growers, account, clock = archive.compartments[place], accounts[place], settings.place.clock
    assert growers.indoor is not None
    assert growers.brix is not None  # the account was counted
    indoor = read_indoor(growers.indoor, clock, first=archive.first, days=archive.days)
    brix = float((growers.brix * growers.harvest).sum() / growers.harvest.sum())
    content = settings.plants.dry_matter if growers.dry_matter is None else growers.dry_matter
    outside = outdoors(archive, clock, settings.place.co2)
    record = weather_record(outside, int(indoor.times[0]), clock)
    weather, refused = f"archive-{record.digest[:8]}", list[str]()
    save_weather(record, weather, overwrite=True)
    same: dict[str, Any] = {"labour": account.labour, "plants": account.plants}
    for house in houses:
        words = partial("{}: {}".format, house.name)
        alone, own = replace(archive, compartments=(growers,)), {growers.name: indoor}
        season = simulate(alone, outside, house, settings, indoors=own, progress=partial(progress, words(growers.name)))
        fruit, lamps = season.harvest[:, 0] / content, float(season.lamps.sum())
        same |= {"house": house.name, "fruit_ratio": account.fruit / float(fruit.sum()) if fruit.sum() > FIRST_FRUIT else None}
        simulated = settle(
            prices, name=growers.name, fruit=float(fruit.sum()), income=float((prices.of_fruit(archive.dates, brix) * fruit).sum()),
            electricity=lamps, cost_electricity=account.cost_electricity * lamps / account.electricity,  # at the tariffs as measured
            heat=float(season.pipe_heat.sum()), co2=float(season.co2.sum()), **same,
        )  # fmt: skip
        accounts.append(simulated)
        tasks = [season_task(archive, house, settings, prices, weather, (content, brix), base) for base in (BASE, BY_SET_POINTS)]
        for agent in agents:
            reasons: list[str] = []

            def show(at: Progress, name: str = words(agent)) -> None:
                progress(name, at.step, at.steps)

            for task in tasks:
                try:
                    result = evaluate(task, agent, out=out, sandbox="auto", limits=LIMITS, progress=show)
                except SubmissionError as error:
                    reasons.append(str(error))
                    continue
                run, reasons = result.runs[0], []
                if run.status != "ok":
                    reasons = [f"its run ended at step {run.steps:,} of {task.steps:,} ({run.status}): {run.reason}"]
                    break
                played = settle(
                    prices, name=agent, fruit=run.metrics["fruit_picked"], income=run.metrics["revenue_harvest"],
                    electricity=run.metrics["electricity"], cost_electricity=run.metrics["cost_electricity"],
                    heat=_MEGAJOULES * run.metrics["heat"], co2=run.metrics["co2_dosed"], **same,
                )  # fmt: skip
                accounts.append(played)
                break
            refused += [f"{agent} has no row in {house.name}: {reason}" for reason in reasons[:1]]
    return Board(
        first=archive.first, last=archive.first + dt.timedelta(days=archive.days - 1), compartment=growers.name, dry_matter=content,
        brix=brix, prices=prices, accounts=tuple(accounts), refused=tuple(refused),
        notes=(*archive.notes, *indoor.notes, *outside.notes),
    )  # fmt: skip
