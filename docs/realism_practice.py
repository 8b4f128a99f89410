"""Whole seasons beside practice: ``python -m docs.realism_practice [--only-page] [--page PAGE]``.

Grows whole seasons of the validation split in several houses, unlit and lit, adds up heat, gas, electricity, CO2 and fruit, takes one
season's heat balance apart, and grows it again with one thing changed at a time. Writes docs/measurements/realism-practice.json, the
picture docs/images/realism-practice.svg and the tables between the markers of the page. It takes a quarter of an hour on two cores;
``--only-page`` writes page and picture from the measurements that are there.

Another house is one more line in ``HOUSES``.
"""

from __future__ import annotations

import argparse
import json
import logging
import re
import shutil
import tempfile
import tomllib
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from docs.tables import with_tables
from glbench.control import Scenario, air_of
from glbench.env import Simulation, StepResult
from glbench.episodes.signals import KWH_A_CUBIC_METRE
from glbench.evaluation import prepare, protect
from glbench.model import get_model
from glbench.realism.houses import mix_lamps
from glbench.resources import write_atomically
from glbench.tasks import TaskSpec, get_task

Floats = NDArray[np.float64]
log = logging.getLogger("practice")

DOCS = Path(__file__).parent
PAGE, FILE, PICTURE = (
    DOCS / "realism-practice.md",
    DOCS / "measurements" / "realism-practice.json",
    DOCS / "images" / "realism-practice.svg",
)
BASELINES = DOCS.parent / "baselines"
TASK: Final = "FullSeason-v1"
SPLIT: Final = "validation"
SEEDS: Final = (10000, 10001, 10002, 10003)
"""The first four runs of the split, those of docs/growers.md."""
MODEL: Final = "greenlight-tomato-season-1.0.0"
DRY_MATTER: Final = 0.065
"""Dry matter of the task's fruit [kg kg-1]."""
KWH: Final = 3.6e6
DARK: Final = 5.0
"""Less global radiation than this is night [W m-2]."""
VENTS_SHUT: Final = 0.01
"""Vents opened no further than this count as shut [-]."""


@dataclass(frozen=True)
class House:
    """A house: model, named set of parameters, and single parameters changed, in the table's units."""

    words: str
    parameters: str
    overrides: Mapping[str, float] = field(default_factory=dict)
    model: str = MODEL


def _mixed(hps: str, led: str, power_hps: float, power_led: float) -> dict[str, float]:
    """Both kinds of lamps, with the installed electric power of each [W m-2]."""
    values = get_model(MODEL).parameters
    share = power_hps / (power_hps + power_led)
    return mix_lamps(share, values.group("lamps", hps), values.group("lamps", led)) | {"thetaLampMax": power_hps + power_led}


HOUSES: Final[Mapping[str, House]] = {
    "led_2021": House("modern 4 ha greenhouse, LEDs (the task's)", "led_2021"),
    "hps_2021": House("modern 4 ha greenhouse, HPS lamps", "hps_2021"),
    "mixed_2020": House("the compartment of 2020, HPS lamps and uncooled LEDs", "led_2020", _mixed("hps_2020", "led_2020", 81.0, 62.0)),
    "bleiswijk_2020": House("a compartment fitted to its measured season", "bleiswijk_2020", model="greenlight-tomato-compartment-1.0.0"),
}
"""By name."""


@dataclass(frozen=True)
class Growing:
    """A way of growing: an agent of the baselines with some numbers of its page changed.

    ``changes`` name numbers of a page of rules, or ``heading.entry`` of the grower's page of settings. ``house`` multiplies
    parameters of the house.
    """

    words: str
    agent: str
    changes: Mapping[str, float | bool] = field(default_factory=dict)
    house: Mapping[str, float] = field(default_factory=dict)


GROWER, TUNED = "grower", "rule_based_energy"
UNLIT_RULES: Final = {"lamps_fruit": 0.0}
GROWINGS: Final[Mapping[str, Growing]] = {
    "grower_unlit": Growing("grower's page", GROWER),
    "published_unlit": Growing("published rules", "rule_based_unlit"),
    "tuned_unlit": Growing("tuned rules", TUNED, UNLIT_RULES),
    "grower_lit": Growing("grower's page", GROWER, {"lamps.used": True}),
    "published_lit": Growing("published rules", "rule_based"),
    "tuned_lit": Growing("tuned rules", TUNED),
}
"""By name; the second part says whether lamps burn."""

SEASONS: Final[Mapping[str, Mapping[str, Any]]] = {
    "season": {},
    "unlit_year": {"weather.start": "2009-12-15", "weather.days": 340},
    "lit_year": {"weather.start": "2009-09-27", "weather.days": 350},
}
"""The task's own season, and two that are as long as in practice, by what is changed in the task."""

GROWN: Final = (
    *(("season", "led_2021", growing) for growing in GROWINGS),
    ("season", "mixed_2020", "grower_unlit"),
    ("season", "bleiswijk_2020", "grower_unlit"),
    ("season", "hps_2021", "grower_lit"),
    ("season", "bleiswijk_2020", "grower_lit"),
    ("unlit_year", "led_2021", "grower_unlit"),
    ("lit_year", "led_2021", "published_lit"),
)
"""What is grown: season, house, way of growing."""


def _rules(words: str, **changes: float) -> Growing:
    return Growing(words, TUNED, UNLIT_RULES | changes)


def _page(words: str, changes: Mapping[str, float] | None = None) -> Growing:
    return Growing(words, GROWER, changes or {})


RULES_MORE_HUMID: Final = {
    "boiler_humidity_above": -4.25 + 4.0, "vents_humidity_day": -2.588 + 4.0,
    "vents_humidity_night": -6.94 + 4.0, "screen_humidity": -6.77 + 4.0,
}  # fmt: skip
RULES_COLDER: Final = {
    "heating_night": 17.0, "heating_morning": 20.35, "heating_day": 17.38, "heating_evening": 15.84, "vents_temperature": 20.82,
}  # fmt: skip
RULES_SCREEN: Final = {"screen_outdoor": 12.0, "screen_gap_most": 0.05}
PAGE_COLDER: Final = {"heating.day": 18.5, "heating.pre_night": 15.0, "heating.night": 16.0}
PAGE_MORE_HUMID: Final = {"humidity_deficit.day": 1.5, "humidity_deficit.night": 1.3}

CHANGES: Final[Mapping[str, Growing]] = {
    "tuned": _rules("tuned rules, unlit"),
    "tuned_no_minimum": _rules("no heat against humid air, and none fixed in daylight", boiler_humidity=0.0, boiler_daylight=0.0),
    "tuned_humid": _rules("dries the air from 4 % more relative humidity on", **RULES_MORE_HUMID),
    "tuned_screen": _rules("screen shut in the dark below 12 °C outside, gap at most 5 %", **RULES_SCREEN),
    "tuned_practice": _rules(
        "no fixed heat in daylight, drying 4 % later, 1 K lower, screen as above",
        boiler_daylight=0.0,
        **RULES_MORE_HUMID,
        **RULES_COLDER,
        **RULES_SCREEN,
    ),
    "page": _page("grower's page, unlit"),
    "page_humid": _page("humidity deficit half as large: about 90 % relative humidity", PAGE_MORE_HUMID),
    "page_practice": _page(
        "half the deficit, 1 K lower, screen shut every night",
        {**PAGE_COLDER, **PAGE_MORE_HUMID, "screen.outdoor_night": 25.0, "screen.outdoor_day": 12.0},
    ),
}
"""One thing changed at a time in the task's own season and house. A name begins with its base."""
CHANGED: Final = {"tuned": "season/led_2021/tuned_unlit", "page": "season/led_2021/grower_unlit"}
"""The bases: seasons that are grown without a change."""


def season_task(season: str, house: House, growing: Growing) -> TaskSpec:
    """The validation seasons of the published task, with another length, house and way of growing where they differ from it."""
    changes: dict[str, Any] = {**SEASONS[season]}
    values = get_model(house.model).parameters
    overrides = dict(house.overrides)
    if growing.house:
        held = dict(zip(values.names, values.default(house.parameters, overrides), strict=True))
        overrides |= {name: factor * held[name] for name, factor in growing.house.items()}
    if (house.parameters, house.model) != ("led_2021", MODEL) or overrides:
        units = {info.name: info.unit for info in values.table}
        changes["model"] = {
            "id": house.model,
            "parameters": house.parameters,
            "overrides": {name: {"value": float(value), "unit": units[name]} for name, value in overrides.items()},
        }
    if growing.agent == GROWER:
        changes["actuation.kind"] = "process_computer"
    task = get_task(TASK).in_split(SPLIT)
    return task.replace(changes | {"id": "docs/Season-v1"}) if changes else task


def write_agent(folder: Path, growing: Growing) -> Path | str:
    """The agent in ``folder``, with its numbers changed; its name where nothing is.

    Raises
    ------
    ValueError
        When its page has no such number.
    """
    if growing.agent not in (GROWER, TUNED):
        return growing.agent
    shutil.copytree(BASELINES / growing.agent, folder)
    if growing.agent == GROWER:
        settings = folder / "settings.toml"
        content = tomllib.loads(settings.read_text(encoding="utf-8"))
        for name, value in growing.changes.items():
            heading, entry = name.split(".")
            if entry not in content[heading]:
                msg = f"{settings} has no entry '{name}'."
                raise ValueError(msg)
            content[heading][entry] = value
        lines = (line for heading, entries in content.items() for line in (f"[{heading}]", *_assignments(entries)))
        settings.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return folder
    for other in (folder / "rules").iterdir():
        if other.name != "fullseason.yml":
            other.unlink()  # an only page serves every task
    page = folder / "rules" / "fullseason.yml"
    text = page.read_text(encoding="utf-8")
    for name, value in growing.changes.items():
        text, count = re.subn(rf"^{name}: [-\d.]+", f"{name}: {value:g}", text, flags=re.MULTILINE)
        if count != 1:
            msg = f"{page} has {count} lines with '{name}'; one was expected."
            raise ValueError(msg)
    page.write_text(text, encoding="utf-8")
    return folder


def _assignments(entries: Mapping[str, float | bool]) -> list[str]:
    return [f"{name} = {json.dumps(value)}" for name, value in entries.items()]


def grown(season: str, house: str, growing: Growing, *, balanced: bool = False) -> dict[str, Any]:
    """What a way of growing used and picked, and where its heat went if ``balanced``: means over the seeds."""
    task = season_task(season, HOUSES[house], growing)
    with tempfile.TemporaryDirectory() as temporary:
        agent = protect(write_agent(Path(temporary) / "agent", growing), "none")
        record = _Record()
        replace(prepare(task, agent), task=task, seeds=SEEDS, workers=1).compute(None, record)
    runs = []
    for place, seed in enumerate(SEEDS):
        given = Scenario.of(task, seed)
        states = np.concatenate([given.x0[None], [rows[place] for rows in record.states]])
        controls = np.array([rows[place] for rows in record.controls])
        runs.append(_sums(given, states, controls) | (_fluxes(given, states, controls) if balanced else {}))
    found: dict[str, Any] = _mean(runs) | {"gas_of_runs": [round(run["gas"], 2) for run in runs]}
    return found


class _Record:
    """States after each step of an evaluation, and the controls in it."""

    def __init__(self) -> None:
        self.states: list[Floats] = []
        self.controls: list[Floats] = []

    def add(self, simulation: Simulation, outcome: StepResult) -> None:
        """Keep a step."""
        self.states.append(np.array(simulation.x))
        self.controls.append(np.array(simulation.u))


def _mean(runs: list[Any]) -> Any:
    if isinstance(runs[0], dict):
        return {name: _mean([run[name] for run in runs]) for name in runs[0]}
    return round(float(np.mean(runs)), 4)


def _sums(given: Scenario, states: Floats, controls: Floats) -> dict[str, Any]:
    """A season's sums, and how the greenhouse was run, from its states and controls."""
    task, model = given.task, given.task.model_value
    p = dict(zip(model.parameters.names, given.p, strict=True))
    state = dict(zip(model.state_names, states.T, strict=True))
    u = dict(zip(model.control_names, controls.T, strict=True))
    d = dict(zip(model.disturbance_names, given.d.T, strict=True))
    air = air_of(model, states[1:]).values
    hours, night = task.step_seconds / 3600.0, d["iGlob"] < DARK
    vented, shut = u["uVent"] > VENTS_SHUT, u["uThScr"] > 0.5
    heat = u["uBoil"] * p["pBoil"] / p["aFlr"]
    kwh = hours / 1000.0
    return {
        "days": task.steps * hours / 24.0,
        "heat": heat.sum() * kwh,
        "gas": heat.sum() * kwh / KWH_A_CUBIC_METRE,
        "electricity": u["uLamp"].sum() * p["thetaLampMax"] * kwh,
        "co2": u["uCo2"].sum() * p["phiExtCo2"] / p["aFlr"] * task.step_seconds * 1e-6,
        "fruit": (state["sumMcFruitHar"][-1] - state["sumMcFruitHar"][0]) * 1e-6 / DRY_MATTER,
        "sun": d["iGlob"].sum() * kwh,
        "outside": d["tOut"].mean(),
        "temperature": {"day": air[~night, 0].mean(), "night": air[night, 0].mean(), "mean": air[:, 0].mean()},
        "humidity": {"day": air[~night, 2].mean(), "night": air[night, 2].mean()},
        "humid_hours": float((air[:, 2] > 85.0).sum()) * hours,
        "hours_heated": float((heat > 1.0).sum()) * hours,
        "heat_vented": heat[vented].sum() * kwh,
        "heat_warm": heat[vented & (d["tOut"] > 10.0)].sum() * kwh,
        "heat_summer": heat[_summer(given)].sum() * kwh,
        "screen_night": float(shut[night].mean()),
        "vents_night": float(u["uVent"][night].mean()),
    }


def _fluxes(given: Scenario, states: Floats, controls: Floats) -> dict[str, Any]:
    """A season's heat balance, leaf area and transpiration, from the model's fluxes at both ends of every step.

    Only for agents whose controls move gradually: where controls jump, a step's ends do not tell what the fluxes were in it.
    """
    task, model = given.task, given.task.model_value
    p = dict(zip(model.parameters.names, given.p, strict=True))
    ends = [model.auxiliary_values(x, controls, given.d, given.p) for x in (states[:-1], states[1:])]
    q = {name: 0.5 * (ends[0][name] + ends[1][name]) for name in ends[0]}
    flows = balance(q, p) | {"stored": _stored(model.state_names, states, ends, p) / task.step_seconds}
    night = given.d[:, model.disturbance_names.index("iGlob")] < DARK
    part = {"night": night, "day": ~night, "season": np.ones_like(night)}
    kwh = task.step_seconds / KWH
    return {
        "leaf_area": q["lai"].mean(),
        "transpired": q["mvCanAir"].sum() * task.step_seconds,
        "balance": {name: {title: float(np.sum(values[rows])) * kwh for title, values in flows.items()} for name, rows in part.items()},
    }


def _summer(given: Scenario) -> NDArray[np.bool_]:
    """Steps from May to September."""
    day = given.calendar[:-1, 1] % 365.0
    rows: NDArray[np.bool_] = (day > 120.0) & (day <= 273.0)
    return rows


def balance(q: Mapping[str, Floats], p: Mapping[str, float]) -> dict[str, Floats]:
    """Heat into (positive) and out of (negative) everything under the cover, the cover included [W m-2], from the model's fluxes."""
    evaporated = q["lCanAir"] - q["lAirThScr"] - q["lAirBlScr"] - q["lTopCovIn"]
    leak_top, leak_main = p["cLeakTop"] * q["fLeakage"], (1.0 - p["cLeakTop"]) * q["fLeakage"]
    top = np.divide(leak_top, q["fVentRoof"], out=np.ones_like(leak_top), where=q["fVentRoof"] > 0.0)
    main = np.divide(leak_main, q["fVentSide"], out=np.ones_like(leak_main), where=q["fVentSide"] > 0.0)
    moist = q["mvAirOut"] + q["mvTopOut"]
    leaked = np.divide(main * q["mvAirOut"] + top * q["mvTopOut"], moist, out=np.ones_like(moist), where=np.abs(moist) > 1e-12)
    leaked = np.clip(leaked, 0.0, 1.0)
    inside = ("rGlobSunAir", "rParSunCan", "rNirSunCan", "rParSunFlr", "rNirSunFlr", "rGlobSunCovE")
    sky = ("rCovESky", "rCanSky", "rPipeSky", "rFlrSky", "rThScrSky", "rBlScrSky", "rLampSky", "rIntLampSky")
    return {
        "boiler": q["hBoilPipe"] + q["hBoilGroPipe"],
        "lamps": q["qLampIn"] - q["hLampCool"],
        "sun": sum((q[name] for name in inside), np.zeros_like(moist)),
        "cover_convection": -q["hCovEOut"],
        "cover_radiation": -sum((q[name] for name in sky), np.zeros_like(moist)),
        "vents_warmth": -(1.0 - main) * q["hAirOut"] - (1.0 - top) * q["hTopOut"],
        "vents_moisture": -(1.0 - leaked) * evaporated,
        "leaks_warmth": -main * q["hAirOut"] - top * q["hTopOut"],
        "leaks_moisture": -leaked * evaporated,
        "soil": -q["hSo5SoOut"],
    }


def _stored(names: tuple[str, ...], states: Floats, ends: list[dict[str, Floats]], p: Mapping[str, float]) -> Floats:
    """Heat that the greenhouse stored in each step, taken out of the balance [J m-2]; negative where it gained."""
    fixed = {
        "tAir": "capAir", "tTop": "capTop", "tThScr": "capThScr", "tBlScr": "capBlScr", "tFlr": "capFlr", "tPipe": "capPipe",
        "tGroPipe": "capGroPipe", "tLamp": "capLamp", "tIntLamp": "capIntLamp",
        "tSo1": "capSo1", "tSo2": "capSo2", "tSo3": "capSo3", "tSo4": "capSo4", "tSo5": "capSo5",
    }  # fmt: skip
    moving = {"tCan": "capCan", "tCovIn": "capCovIn", "tCovE": "capCovE"}
    change = np.diff(states, axis=0)
    gained: Floats = sum((p[capacity] * change[:, names.index(state)] for state, capacity in fixed.items()), np.zeros(len(change)))
    for state, capacity in moving.items():
        gained += 0.5 * (ends[0][capacity] + ends[1][capacity]) * change[:, names.index(state)]
    return -gained


BASES: Final = {"season/led_2021/tuned_unlit": "tuned rules", "season/led_2021/grower_unlit": "grower's page"}
"""The seasons whose heat balance is shown."""


def jobs() -> dict[str, tuple[str, str, Growing]]:
    """Everything to be grown, by name."""
    asked = {f"{season}/{house}/{growing}": (season, house, GROWINGS[growing]) for season, house, growing in GROWN}
    changed = {f"changes/{name}": ("season", "led_2021", growing) for name, growing in CHANGES.items() if name not in CHANGED}
    return asked | changed


def measure(workers: int) -> None:
    """Grow what the file does not have yet, and write it after each."""
    digest = get_task(TASK).digest
    found = read() if FILE.is_file() else {}
    if found.get("digest") != digest or found.get("seeds") != list(SEEDS):
        found = {"task": TASK, "digest": digest, "split": SPLIT, "seeds": list(SEEDS), "grown": {}}
    asked = jobs()
    found["grown"] = {name: sums for name, sums in found["grown"].items() if name in asked}
    with ProcessPoolExecutor(workers) as pool:
        waiting = {pool.submit(grown, *job, balanced=name in BASES): name for name, job in asked.items() if name not in found["grown"]}
        for future in as_completed(waiting):
            found["grown"][waiting[future]] = future.result()
            log.info("%s: %.1f m3 of gas a m2", waiting[future], found["grown"][waiting[future]]["gas"])
            ordered = {name: found["grown"][name] for name in asked if name in found["grown"]}
            write_atomically(FILE, (json.dumps(found | {"grown": ordered}, indent=1) + "\n").encode())


def read() -> dict[str, Any]:
    """The measurements that are there."""
    return dict(json.loads(FILE.read_text(encoding="utf-8")))


SEASON_WORDS: Final = {
    "season": f"`{TASK}`: early January to the end of October",
    "unlit_year": "mid-December to mid-November",
    "lit_year": "end of September to mid-September",
}
FLOWS: Final = {
    "boiler": "boiler",
    "sun": "sun, absorbed inside and in the cover",
    "cover_radiation": "cover, by radiation to the sky",
    "cover_convection": "cover, to wind and air",
    "vents_warmth": "vents, warm air",
    "vents_moisture": "vents, moisture evaporated",
    "leaks_warmth": "leaks, warm air",
    "leaks_moisture": "leaks, moisture evaporated",
    "soil": "soil",
    "stored": "taken from (+) or put into (-) plants, pipes and floor",
}
HABITS: Final = {
    "mean air temperature by day, °C": lambda one: f"{one['temperature']['day']:.1f}",
    "at night, °C": lambda one: f"{one['temperature']['night']:.1f}",
    "mean relative humidity by day, %": lambda one: f"{one['humidity']['day']:.0f}",
    "at night, %": lambda one: f"{one['humidity']['night']:.0f}",
    "hours above 85 %": lambda one: f"{one['humid_hours']:,.0f}",
    "nights, screen shut, % of the time": lambda one: f"{100 * one['screen_night']:.0f}",
    "hours in which the boiler heats": lambda one: f"{one['hours_heated']:,.0f}",
    "boiler heat while vents are open, kWh m⁻²": lambda one: f"{one['heat_vented']:.0f}",
    "of that, when it is above 10 °C outside": lambda one: f"{one['heat_warm']:.0f}",
    "boiler heat from May to September, kWh m⁻²": lambda one: f"{one['heat_summer']:.0f}",
    "water transpired, kg m⁻²": lambda one: f"{one['transpired']:.0f}",
    "mean leaf area index": lambda one: f"{one['leaf_area']:.1f}",
}


def filled(page: str, found: Mapping[str, Any]) -> str:
    """The page with its tables."""
    return with_tables(page, {name: table(found["grown"]) for name, table in TABLES.items()})


def seasons_table(sums: Mapping[str, Any]) -> str:
    """A row a season, house and way of growing, unlit ones first."""
    lines = [
        "| season | house | grown by | heat, kWh m⁻² | gas, m³ m⁻² | lamps, kWh m⁻² | CO2, kg m⁻² | fruit, kg m⁻² | mean air, °C |",
        "|---|---|---|---:|---:|---:|---:|---:|---:|",
    ]
    for light in ("unlit", "lit"):
        lines.append(f"| **{light}** | | | | | | | | |")
        before = ""
        for season, house, growing in GROWN:
            if not growing.endswith(f"_{light}"):
                continue
            one = sums[f"{season}/{house}/{growing}"]
            words, before = ("" if season == before else SEASON_WORDS[season]), season
            lines.append(
                f"| {words} | `{house}` | {GROWINGS[growing].words} | {one['heat']:.0f} | {one['gas']:.1f} | "
                f"{one['electricity']:.0f} | {one['co2']:.0f} | {one['fruit']:.1f} | {one['temperature']['mean']:.1f} |"
            )
    return "\n".join(lines)


def balance_table(sums: Mapping[str, Any]) -> str:
    """Heat in and out, by night, by day and in all."""
    parts = ("night", "day", "season")
    titles = [f"{words}: {part}" if part != "season" else "in all" for words in BASES.values() for part in parts]
    lines = [f"| kWh m⁻² | {' | '.join(titles)} |", f"|---|{'---:|' * len(titles)}"]
    for flow, words in FLOWS.items():
        values = (sums[base]["balance"][part][flow] for base in BASES for part in parts)
        lines.append(f"| {words} | {' | '.join(f'{value:+.0f}'.replace('-0', '0').replace('+0', '0') for value in values)} |")
    return "\n".join(lines)


def habits_table(sums: Mapping[str, Any]) -> str:
    """How the greenhouse was run in these seasons."""
    lines = [f"| | {' | '.join(BASES.values())} |", f"|---|{'---:|' * len(BASES)}"]
    lines += [f"| {title} | {' | '.join(cell(sums[base]) for base in BASES)} |" for title, cell in HABITS.items()]
    return "\n".join(lines)


def changes_table(sums: Mapping[str, Any]) -> str:
    """What one change does to gas, fruit and humidity."""
    lines = [
        "| changed | gas, m³ m⁻² | change | CO2, kg m⁻² | fruit, kg m⁻² | hours above 85 % | mean air at night, °C |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    for name, growing in CHANGES.items():
        base, first = sums[CHANGED[name.split("_")[0]]], name in CHANGED
        one = base if first else sums[f"changes/{name}"]
        change = "" if first else f"{one['gas'] - base['gas']:+.1f}"
        words = f"**{growing.words}**" if first else growing.words
        lines.append(
            f"| {words} | {one['gas']:.1f} | {change} | {one['co2']:.0f} | {one['fruit']:.1f} | {one['humid_hours']:,.0f} | "
            f"{one['temperature']['night']:.1f} |"
        )
    return "\n".join(lines)


TABLES: Final[Mapping[str, Callable[[Mapping[str, Any]], str]]] = {
    "practice-seasons": seasons_table,
    "practice-balance": balance_table,
    "practice-habits": habits_table,
    "practice-changes": changes_table,
}
"""By the name of their place in the page."""


def draw(found: Mapping[str, Any]) -> None:
    """Where the heat of nights and days goes, as PICTURE."""
    import matplotlib as mpl

    mpl.use("svg")
    mpl.rcParams.update({"svg.hashsalt": "practice", "svg.fonttype": "none", "font.size": 9})
    import matplotlib.pyplot as plt

    losses = [flow for flow in FLOWS if flow not in ("boiler", "sun", "stored")]
    colours = dict(zip(losses, ("#33658a", "#86bbd8", "#d17a00", "#f0b35c", "#7a3b69", "#b98bab", "#8a8a8a"), strict=True))
    bars = [(base, part) for base in BASES for part in ("night", "day")]
    figure, axis = plt.subplots(figsize=(9, 2.9), layout="constrained")
    left = np.zeros(len(bars))
    names = [f"{BASES[base]}, {part}" for base, part in bars]
    for flow in losses:
        values = np.array([-found["grown"][base]["balance"][part][flow] for base, part in bars])
        axis.barh(names, values, left=left, color=colours[flow], label=FLOWS[flow])
        left += values
    boiler = [found["grown"][base]["balance"][part]["boiler"] for base, part in bars]
    axis.plot(boiler, names, "k|", ms=18, mew=2, ls="none", label="heat of the boiler")
    axis.invert_yaxis()
    axis.set(title="Heat lost in a season without lamps [kWh/m²]")
    axis.legend(frameon=False, ncols=2, fontsize=8)
    figure.savefig(PICTURE, metadata={"Date": None})
    plt.close(figure)


def main() -> None:
    """Grow, write, fill the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only-page", action="store_true", help="fill page and picture from what is stored")
    parser.add_argument("--page", type=Path, default=PAGE, help="page with the tables' markers")
    parser.add_argument("--workers", type=int, default=2, help="seasons grown at once")
    asked = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    if not asked.only_page:
        measure(asked.workers)
    write_atomically(asked.page, filled(asked.page.read_text(encoding="utf-8"), read()))
    draw(read())


if __name__ == "__main__":
    main()
