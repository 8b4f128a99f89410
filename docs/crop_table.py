"""Tables of docs/crop.md: ``python -m docs.crop_table [--measured FOLDER] [--year] [--only-page]``.

``--measured FOLDER`` grows the crop with trusses beside the archive of docs/realism.md: in the air that the growers' compartment had, and
in whole houses by set points, light and CO2, beside the published crop. ``--year`` grows seasons of the validation split of FullSeason-v1.
Both write docs/measurements/crop.json, which holds sums and statistics, no measured day. It takes half an hour.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from docs.realism_practice import GROWER, GROWINGS, write_agent
from docs.tables import with_tables
from glbench.control import Scenario, air_of
from glbench.env import Simulation, StepResult
from glbench.evaluation import prepare, protect
from glbench.kernel import Kernel
from glbench.model import get_model
from glbench.model.air import co2_density, saturation_vapour_pressure
from glbench.model.crop.stages import STAGES
from glbench.realism import HOUSES, SHIPPED, Archive, read_archive, read_indoor, read_settings
from glbench.realism.comparison import FIRST_FRUIT, fresh
from glbench.realism.free_run import drive
from glbench.realism.houses import read_house
from glbench.realism.inputs import STEP_SECONDS, outdoors
from glbench.realism.published import ROW_SECONDS, ROWS_A_DAY
from glbench.realism.season import simulate, young_crop
from glbench.resources import write_atomically
from glbench.tasks import get_task
from glbench.tasks import set_points as names

Floats = NDArray[np.float64]
DOCS = Path(__file__).parent
PAGE, FILE = DOCS / "crop.md", DOCS / "measurements" / "crop.json"
MODEL, SET = "greenlight-tomato-2-compartment-1.0.0", "bleiswijk_2020"
TRUSSES: Final = DOCS / "measurements" / "bleiswijk-2020-trusses.toml"
GROWERS: Final = "Reference"
TOPPED: Final = 128
"""Day after planting on which the growers topped their crop, 22 April 2020."""
HEIGHT: Final = 600.0
"""Height of the air [m] in the run by measured air: so much air keeps what it was set to for a step."""
VARIANTS: Final = {
    "measured": {},
    "cold_spots": {"dtColdSpot": 2.5},
    "uninjured": {"injuryMax": 0.0},
    "large_truss": {"nTruss": 9.0, "cTruss1": -1.708e-7 / 9, "gMax": 1e4, "dmFruit": 0.0627},
}
"""What is changed in the set ``bleiswijk_2020`` in the run by measured air: nothing, the benchmark's cold spots, no injury by long light,
the book's tomato."""
YEAR_TASK, SPLIT, SEEDS, YEAR_MODEL = "FullSeason-v1", "validation", (10000, 10001, 10002, 10003), "greenlight-tomato-2-1.0.0"
HEALTHY: Final = "_healthy"
"""Ends a way of growing in which mould does not grow."""
WAYS: Final = ("grower_unlit", "grower_unlit_healthy", "tuned_unlit", "grower_lit", "grower_lit_healthy", "tuned_lit")
"""Ways of growing of docs.realism_practice."""


def weekly(daily: Floats) -> Floats:
    """Sums of whole weeks from the first day (weeks, ...)."""
    weeks = len(daily) // 7
    return np.asarray(daily[: 7 * weeks].reshape(weeks, 7, *daily.shape[1:]).sum(axis=1))


def _compared(simulated: Floats, measured: Floats) -> dict[str, Any]:
    """Sums [kg m-2], days until the first fruit, and root mean square errors of weeks and of fortnights [kg m-2]."""
    first = [int(np.argmax(np.cumsum(days) >= FIRST_FRUIT)) for days in (measured, simulated)]
    weeks = weekly(simulated - measured)
    odd = np.arange(len(weeks)) % 2 == 1
    fortnights = weeks[: len(weeks) // 2 * 2].reshape(-1, 2).sum(axis=1)
    return {
        "measured": float(measured.sum()),
        "simulated": float(simulated.sum()),
        "measured_from": first[0],
        "simulated_from": first[1],
        "rmse_week": float(np.sqrt(np.mean(weeks**2))),
        "rmse_odd_weeks": float(np.sqrt(np.mean(weeks[odd] ** 2))),
        "rmse_fortnight": float(np.sqrt(np.mean(fortnights**2))),
        "ratio_even": float(weekly(simulated)[~odd].sum() / weekly(measured)[~odd].sum()),
        "ratio_odd": float(weekly(simulated)[odd].sum() / weekly(measured)[odd].sum()),
    }


def by_measured_air(archive: Archive) -> dict[str, Any]:
    """The crop of the growers' compartment in the air, light and pipes that it had."""
    page, model = read_settings(SHIPPED), get_model(MODEL)
    compartment = next(one for one in archive.compartments if one.name == GROWERS)
    outside = outdoors(archive, page.place.clock, page.place.co2, step_seconds=ROW_SECONDS)
    assert compartment.indoor is not None
    indoor = read_indoor(compartment.indoor, page.place.clock, first=archive.first, days=archive.days)
    season = drive(indoor, outside, archive.first)
    house = {"thetaLampMax": page.lamps.power, "hAir": HEIGHT, "hGh": HEIGHT + 1.0}
    p = np.stack([model.parameters.default(SET, house | change) for change in VARIANTS.values()])
    readings = (np.array(one) for one in (season.measured[name] for name in ("air_temperature", "humidity", "co2")))
    present = (np.interp(np.arange(one.size), np.flatnonzero(np.isfinite(one)), one[np.isfinite(one)]) for one in readings)
    temperature, humidity, ppm = present
    air = np.column_stack([temperature, humidity / 100 * saturation_vapour_pressure(temperature), co2_density(temperature, ppm)])
    place, column = model.state_index, {name: number for number, name in enumerate(model.control_names)}
    x = np.stack([young_crop(model, season.weather[0], row, page.plants, temperature[0]) for row in p])
    u = np.zeros((season.hour.size, len(column)))
    for name, share in season.shares.items():
        u[:, column[name]] = share
    u[:, column[names.LAMPS]] = np.minimum(season.lamps / page.lamps.power, 1.0)
    u[:, column["uTop"]] = np.arange(len(u)) >= TOPPED * ROWS_A_DAY
    kernel = Kernel(model, STEP_SECONDS, preset="fast", threads=2)
    held = [place(name) for name in ("tAir", "vpAir", "co2Air")]
    read = ("sumMcFruitHar", "nSet", "trusses", "mould", "injury", "sourceSink")
    days = {name: np.zeros((archive.days, len(p))) for name in (*read, "picked")}
    picked = np.zeros(len(p))
    for step in range(0, len(u), STEP_SECONDS // ROW_SECONDS):
        row, weather = u[step], season.weather[step]
        x[:, held] = air[step]
        for state, values in season.pipes.items():
            if np.isfinite(values[step]):
                x[:, place(state)] = values[step]
        x = kernel.step(x, np.repeat(row[None], len(p), axis=0), np.repeat(weather[None], len(p), axis=0), p)
        picked = picked + x[:, place("nRipe")] * STEP_SECONDS / 7200.0
        day = outside.day[step]
        for name in read:
            days[name][day] = x[:, place(name)]
        days["picked"][day] = picked
    result = {}
    for lane, name in enumerate(VARIANTS):
        content = float(p[lane, model.parameter_names.index("dmFruit")])
        kilograms = np.diff(1e-6 * days["sumMcFruitHar"][:, lane] / content, prepend=0.0)
        result[name] = _compared(kilograms, compartment.harvest) | {
            "weeks": weekly(kilograms).round(4).tolist(),
            "trusses": float(days["trusses"][TOPPED, lane]),
            "set": float(days["nSet"][-1, lane]),
            "picked": float(picked[lane]),
            "grams": float(1e3 * kilograms.sum() / picked[lane]),
            "mould": float(days["mould"][:, lane].max()),
            "injury": float(days["injury"][:, lane].max()),
            "supply": float(days["sourceSink"][:, lane].mean()),
        }
    return result


def in_houses(archive: Archive) -> dict[str, Any]:
    """All compartments in houses, by light, CO2 and set points as ``glbench validate --by set-points``: by house, then by compartment."""
    page, result = read_settings(SHIPPED), {}
    outside = outdoors(archive, page.place.clock, page.place.co2)
    indoors = {
        one.name: read_indoor(one.indoor, page.place.clock, first=archive.first, days=archive.days)
        for one in archive.compartments
        if one.indoor is not None
    }
    for house in (HOUSES["mixed_2020"], HOUSES["bleiswijk_2020"], read_house(TRUSSES)):
        season = simulate(archive, outside, house, page, indoors=indoors)
        result[house.name] = {
            one.name: _compared(fruit := fresh(season, place, one, page)[0], one.harvest) | {"weeks": weekly(fruit).round(4).tolist()}
            for place, one in enumerate(archive.compartments)
        }
    return result


class _Record:
    """States after each step of an evaluation, and share of the light that lamps gave."""

    def __init__(self) -> None:
        self.states: list[Floats] = []

    def add(self, simulation: Simulation, outcome: StepResult) -> None:
        """Keep a step."""
        self.states.append(np.array(simulation.x))


def year(way: str) -> dict[str, float]:
    """What a season grown in one of ``WAYS`` gave, means over the seeds; masses are a square metre's."""
    base = get_task(YEAR_TASK)
    changes: dict[str, Any] = {"id": "docs/Trusses-v1", "model.id": YEAR_MODEL, "actuation.controls": list(base.model_value.control_names)}
    growing = GROWINGS[way.removesuffix(HEALTHY)]
    if way.endswith(HEALTHY):
        changes["model.overrides"] = {"growthMould": {"value": 0.0, "unit": "day-1"}}
    if growing.agent == GROWER:
        changes["actuation.kind"] = "process_computer"
    task = base.in_split(SPLIT).replace(changes)
    crop, record = task.model_value, _Record()
    with tempfile.TemporaryDirectory() as temporary:
        agent = protect(write_agent(Path(temporary) / "agent", growing), "none")
        replace(prepare(task, agent), task=task, seeds=SEEDS, workers=1).compute(None, record)
    runs = []
    for place, seed in enumerate(SEEDS):
        scenario = Scenario.of(task, seed)
        x = dict(zip(crop.state_names, np.array([rows[place] for rows in record.states]).T, strict=True))
        p = dict(zip(crop.parameter_names, scenario.p, strict=True))
        air = air_of(crop, np.array([rows[place] for rows in record.states])).values
        bearing = slice(len(x["cRipe"]) // 3, None)
        fruits = sum(x[f"nFruit{stage}"] for stage in range(1, STAGES + 1))
        picked = np.diff(x["sumMcFruitHar"] * 1e-6 / p["dmFruit"])
        weeks = weekly(picked[: len(picked) // task.steps_per_day * task.steps_per_day].reshape(-1, task.steps_per_day).sum(axis=1))
        number = float(x["nRipe"].sum() * task.step_seconds / 7200.0)
        runs.append(
            {
                "days": task.steps / task.steps_per_day,
                "kilograms": float(picked.sum()),
                "first pick, day": float(np.argmax(np.cumsum(picked) >= FIRST_FRUIT) / task.steps_per_day),
                "best week": float(weeks.max()),
                "fruits set": float(x["nSet"][-1]),
                "fruits picked": number,
                "grams": 1e3 * float(picked.sum()) / number,
                "trusses a week": float(7 * (x["trusses"][-1] - x["trusses"][0]) / (task.steps / task.steps_per_day)),
                "set of a truss": float(x["nSet"][-1] / (x["trusses"][-1] * p["nStem"])),
                "on the plants": float(fruits[bearing].mean()),
                "leaf area": float((x["cLeaf"] * p["sla"])[bearing].mean()),
                "light hours": float(24 * x["photoperiod"].mean()),
                "injury": float(x["injury"].mean()),
                "mould": float(x["mould"].max()),
                "rotten": float(1 - np.exp(-x["sumRot"][-1])),
                "humid": float((air[:, 2] > 84.5).mean()),
            }
        )
    return {name: round(float(np.mean([run[name] for run in runs])), 4) for name in runs[0]}


def air_rows(found: Any) -> str:
    """The crop in the measured air: a column a variant."""
    words = {
        "measured": "set `bleiswijk_2020`",
        "uninjured": "no injury by long light",
        "cold_spots": "cold spots of the benchmark",
        "large_truss": "round tomatoes of the book",
    }
    one = found["measured"]
    lines = [f"| | measured | {' | '.join(words.values())} |", f"|---|---:|{'---:|' * len(words)}"]
    for name, title, digits, known in (
        ("simulated", "fruit picked, kg m⁻²", 1, f"{one['measured']:.1f}"),
        ("simulated_from", "first 0.05 kg m⁻², days after planting", 0, f"{one['measured_from']}"),
        ("rmse_week", "root mean square error of a week, kg m⁻²", 2, ""),
        ("rmse_fortnight", "of two weeks, kg m⁻²", 2, ""),
        ("trusses", "trusses of a stem at topping", 1, "23.2"),
        ("picked", "fruits picked, m⁻²", 0, ""),
        ("grams", "weight of a fruit, g", 1, "9.1"),
        ("mould", "largest diseased share, %", 1, ""),
        ("injury", "largest injury by long light, %", 0, ""),
    ):
        factor = 100 if name in ("mould", "injury") else 1
        lines.append(f"| {title} | {known} | {' | '.join(f'{factor * found[of][name]:.{digits}f}' for of in words)} |")
    return "\n".join(lines)


def house_rows(found: Any) -> str:
    """Six compartments in houses: sums, errors of two weeks, first fruit."""
    words = {
        "mixed_2020": "published crop, `mixed_2020`",
        "bleiswijk_2020": "published crop, `bleiswijk_2020`",
        "bleiswijk_2020_trusses": "trusses, `bleiswijk_2020`",
    }
    lines = [f"| | measured | {' | '.join(words.values())} |", f"|---|---|{'---|' * len(words)}"]
    for name, one in found["mixed_2020"].items():
        cells = [
            f"{of['simulated']:.1f} kg, day {of['simulated_from']}, {of['rmse_fortnight']:.2f}"
            for of in (found[house][name] for house in words)
        ]
        lines.append(f"| {name} | {one['measured']:.1f} kg, day {one['measured_from']} | {' | '.join(cells)} |")
    ratios = [
        sum(one["simulated"] for one in found[house].values()) / sum(one["measured"] for one in found[house].values()) for house in words
    ]
    lines.append(f"| simulated / measured, all six | | {' | '.join(f'{ratio:.2f}' for ratio in ratios)} |")
    return "\n".join(lines)


def year_rows(found: Any) -> str:
    """Seasons beside practice."""
    titles = {
        "kilograms": ("fruit picked, kg m⁻²", 1, "49 to 63 unlit, above 95 lit in a year"),
        "first pick, day": ("first 0.05 kg m⁻², days after planting", 0, "about 56"),
        "best week": ("best week, kg m⁻²", 2, ""),
        "trusses a week": ("trusses of a stem a week", 2, "about 1"),
        "set of a truss": ("fruits set of a truss of 9 flowers", 1, ""),
        "grams": ("weight of a fruit, g", 0, ""),
        "on the plants": ("fruits on the plants, m⁻²", 0, ""),
        "leaf area": ("leaf area index", 2, "3 to 4, lit"),
        "light hours": ("light, h a day", 1, "at most 18"),
        "injury": ("mean injury by long light, 100 = full, %", 1, ""),
        "mould": ("largest diseased share, %", 2, ""),
        "rotten": ("loss to mould of what was there at planting, %", 1, "0 to 5"),
        "humid": ("time above 84.5 % relative humidity, %", 0, "54 in the measured compartment"),
    }
    words = {
        "grower_unlit": "grower's page, unlit",
        "grower_unlit_healthy": "the same without mould",
        "tuned_unlit": "tuned rules, unlit",
        "grower_lit": "grower's page, lit",
        "grower_lit_healthy": "the same without mould",
        "tuned_lit": "tuned rules, lit",
    }
    ways = [way for way in WAYS if way in found]
    lines = [f"| | {' | '.join(words[way] for way in ways)} | practice |", f"|---|{'---:|' * len(ways)}---|"]
    for name, (title, digits, practice) in titles.items():
        factor = 100 if title.endswith("%") else 1
        lines.append(f"| {title} | {' | '.join(f'{factor * found[way][name]:.{digits}f}' for way in ways)} | {practice} |")
    return "\n".join(lines)


TABLES = {"air": air_rows, "houses": house_rows, "year": year_rows}


def filled(page: str, found: Any) -> str:
    """The page with its tables."""
    return with_tables(page, {f"crop-{name}": make(found[name]) for name, make in TABLES.items() if name in found})


def read() -> dict[str, Any]:
    """The measurements that are there."""
    return dict(json.loads(FILE.read_text(encoding="utf-8"))) if FILE.is_file() else {}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--measured", type=Path, metavar="FOLDER")
    parser.add_argument("--year", action="store_true")
    parser.add_argument("--only-page", action="store_true")
    chosen, found = parser.parse_args(), read()
    if chosen.measured is not None:
        archive = read_archive(chosen.measured, read_settings(SHIPPED).place.clock)
        found |= {"air": by_measured_air(archive), "houses": in_houses(archive)}
    if chosen.year:
        found |= {"year": {way: year(way) for way in WAYS}}
        found |= {"task": YEAR_TASK, "digest": get_task(YEAR_TASK).digest, "split": SPLIT, "seeds": list(SEEDS)}
    if not chosen.only_page:
        write_atomically(FILE, json.dumps(found, indent=1) + "\n")
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8"), found), encoding="utf-8")
