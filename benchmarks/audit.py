"""Recompute a result of glbench from its record of actions, without trusting the package that made it.

    python benchmarks/audit.py RESULT.json [--runs N] [--task FILE.toml]

The exit code is 0 if the result agrees, 1 if it differs (in which run, step and number), 2 if it cannot be audited (why).

**From glbench** comes `glbench.model` alone: right-hand side of the plain model, names, sizes of states, parameters and how they follow,
and the fruits that a crop of trusses starts with.

**Written again here**, from the documentation: digests of results and records, inheritance of task files, Philox and all draws, weather and
seasons, the start, actuation, actuators, schedules, the meters of violations, the integration, ledger, reward, sums and means.

**Other libraries**: mcap unpacks the record, pyarrow reads the weather. docs/verification.md has the tolerances.
"""

from __future__ import annotations

import argparse
import csv
import datetime as dt
import hashlib
import json
import math
import re
import sys
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from decimal import Decimal
from functools import partial, reduce
from pathlib import Path
from typing import Any, NoReturn
from zoneinfo import ZoneInfo

import casadi
import numpy as np
import pyarrow.parquet
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from scipy.integrate import ode

from benchmarks.audit_weather import CO2, Array, Generator, Hourly, NotCoveredError, conserving, paper, saturation
from glbench.model import get_model

Table = dict[str, Any]
Run = tuple[Table, Array, Array, Array]  # how it ended, actions, rewards, final state

ROOT, DIFFERS, CANNOT = Path(__file__).resolve().parents[1], 1, 2
NOT_AUDITED = "the agent and what it saw, kernel, limits, times, sandbox, versions, machine, git, profile, episodes"
HEAT = (0.5, 1.5)  # of a season, in that of the nominal house
WEEKDAYS = ("monday", "tuesday", "wednesday", "thursday", "friday", "saturday", "sunday")
AIR = ("air_temperature", "co2", "relative_humidity")  # degC, ppm, %

TOLERANCE = 1e-9  # of the integration: relative, and as a share of the typical size of a state
STATES = 1e-6  # final states may be off by this share of their typical size: what the kernel promises for a step
AT_END, MEAN = (1e-4, 1e-3, 1e-4), (2e-3, 2e-2, 2e-3)  # violations, by the same promise; means depend on when air crosses a limit
MONEY, SUMS = 1e-8, 1e-7  # profit of a step [EUR m-2]; sums over a run, relative to 1 or more
IN_ALL, HOURS = 10.0, 0.01  # rewards and penalties of a run, in those of a step; share of hours outside limits, besides 1 h
FOLLOW = 1000.0  # states and sums may be off by so many times more, and rewards of a run by 10 times, if some states follow (docs/adr/0032)


class VerdictError(Exception):
    """Why an audit ends before all was found to agree: exit code and words."""


def end(code: int, words: str) -> NoReturn:
    raise VerdictError(code, words)


def read_json(text: str | bytes) -> Any:
    """JSON without keys that come twice, of which other readers may take the other one."""

    def table(pairs: list[tuple[str, Any]]) -> Table:
        if twice := [key for key, count in Counter(key for key, _ in pairs).items() if count > 1]:
            end(DIFFERS, f"the key '{twice[0]}' appears twice in one table")
        return dict(pairs)

    return json.loads(text, object_pairs_hook=table, parse_constant=lambda word: end(DIFFERS, f"a number is {word}"))


def canonical(value: Any) -> str:
    """JSON by RFC 8785: sorted keys, no spaces, numbers as ECMAScript writes them."""
    if isinstance(value, dict):
        keys = sorted(value, key=lambda key: str(key).encode("utf-16-be"))
        return "{" + ",".join(f"{canonical(key)}:{canonical(value[key])}" for key in keys) + "}"
    if isinstance(value, list):
        return "[" + ",".join(map(canonical, value)) + "]"
    if type(value) not in (int, float):
        return json.dumps(value, ensure_ascii=False)
    text = repr(float(value))
    if value == 0.0 or 1e-6 <= abs(value) < 1e21:
        return format(Decimal(text) + 0, "f").removesuffix(".0")
    return re.sub(r"e([+-])0*", r"e\1", text)


def read_record(path: Path) -> tuple[Table, Table, list[Run], str]:
    """Provenance, task and runs of a record of actions, and the digest of its content (docs/episodes.md)."""
    if not path.is_file():
        end(CANNOT, f"there is no record {path} beside the result: evaluate again")
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        texts = {one.name: one.data for one in reader.iter_attachments()}
        parts = [(channel.topic, part) for _, channel, _, part in reader.iter_decoded_messages(log_time_order=False)]
    provenance, sha, runs = read_json(texts["provenance.json"]), hashlib.sha256(), []
    kind = np.dtype("<f8" if (field := parts[0][1].DESCRIPTOR.fields_by_name["actions"]).type == field.TYPE_DOUBLE else "<f4")
    for text in (texts["provenance.json"], texts["runs.json"], texts["task.json"]):
        sha.update(len(text).to_bytes(8, "little") + text)
    sha.update(kind.name.encode())
    for run in read_json(texts["runs.json"])["runs"]:
        own = sorted((part for topic, part in parts if topic == f"/runs/{run['seed']}"), key=lambda part: int(part.first_step))
        actions = np.concatenate([np.array(part.actions, kind).reshape(len(provenance["agent"]["columns"]), -1).T for part in own])
        rewards, final = np.concatenate([np.array(part.rewards, "<f8") for part in own]), np.array(own[-1].final_state, "<f8")
        for array in (actions, rewards, final):
            sha.update(np.ascontiguousarray(array).tobytes())
        begins, counts = np.cumsum([0, *(len(part.rewards) for part in own)]).tolist(), [run["steps"], run["actions"]]
        if [int(part.first_step) - 1 for part in own] != begins[:-1] or [len(rewards), len(actions)] != counts:
            holds = f"{len(rewards)} rewards and {len(actions)} actions in parts that begin at {begins[:-1]}"
            end(DIFFERS, f"run {run['seed']} claims {counts[0]} steps and {counts[1]} actions; the record holds {holds}")
        runs.append((run, actions.astype(np.float64), rewards, final))
    return provenance, read_json(texts["task.json"]), runs, sha.hexdigest()


def task_tables(name: str, folder: Path) -> Table:
    """The tables of a task file, or of a shipped task, with those of its bases (docs/tasks.md, docs/task-file.md)."""
    path = folder / name if name.endswith(".toml") else ROOT / "tasks" / f"{name.rpartition('/')[2].lower()}.toml"
    if not path.is_file():
        end(CANNOT, f"there is no task file {path}: name it with --task")
    own = tomllib.loads(path.read_text(encoding="utf-8"))
    if "base" not in own:
        return own
    below = task_tables(own.pop("base"), path.parent)
    if below["schema"] != own.get("schema", below["schema"]):
        end(CANNOT, "a base of another schema is not covered")
    for key in own.pop("without", []):
        *tables, last = key.split(".")
        del reduce(dict.__getitem__, tables, below)[last]
    if any("years" in split for split in own.get("splits", {}).values()):
        below.pop("splits", None)
    return merged(below, own)


def merged(below: Table, own: Table) -> Table:
    both = {key: (below[key], value) for key, value in own.items() if isinstance(value, dict) and isinstance(below.get(key), dict)}
    return below | own | {key: merged(*pair) for key, pair in both.items()}


def number(quantity: Any) -> float:
    return float(quantity["value"] if isinstance(quantity, dict) else quantity)


def uniforms(label: str, step: int, count: int) -> Array:
    """Numbers in [0, 1) of the stream that is called `label`, in a step: Philox4x32-10 (docs/adr/0006, 0014)."""
    key, numbers = hashlib.sha256(label.encode()).digest(), list[float]()
    low, high = int.from_bytes(key[:4], "big"), int.from_bytes(key[4:8], "big")
    for block in range((count + 1) // 2):
        a, b, c, d, k, m = step, block, 0, 0, low, high
        for _ in range(10):
            left, right = 0xD2511F53 * a, 0xCD9E8D57 * c
            a, b, c, d = (right >> 32) ^ b ^ k, right & 0xFFFFFFFF, (left >> 32) ^ d ^ m, left & 0xFFFFFFFF
            k, m = (k + 0x9E3779B9) & 0xFFFFFFFF, (m + 0xBB67AE85) & 0xFFFFFFFF
        numbers += [((one >> 5) * 2**26 + (other >> 6)) * 2.0**-53 for one, other in ((a, b), (c, d))]
    return np.array(numbers[:count])


def read_weather(source: str) -> Hourly:
    """KNMI's own numbers, as weather/manifest.toml explains them."""
    entry = tomllib.loads((ROOT / "weather" / "manifest.toml").read_text(encoding="utf-8"))["record"].get(source, {})
    if entry.get("format") != "knmi":
        end(CANNOT, f"[weather] source = '{source}': only KNMI's records are covered")
    table = pyarrow.parquet.read_table(ROOT / "weather" / entry["file"])
    factors = {"T": 100.0, "U": 1000.0, "FH": 100.0, "Q": 1e4, "N": 1000.0}
    counts = np.stack([table[name].to_numpy() * factor for name, factor in factors.items()], axis=1)
    return int(entry["first"].timestamp()), counts, (entry["latitude"], entry["longitude"], entry["altitude"]), ZoneInfo(entry["timezone"])


def house(name: str, factor: float, numbers: Callable[[int, int], Array]) -> Iterator[tuple[str, float]]:
    """Parameters of a house, each with what its nominal value is multiplied by (docs/uncertainty.md, "Measured widths")."""
    with (ROOT / "glbench" / "tasks" / "spreads.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["spread"] == name]
    sizes, low, high, elasticity = np.array([[float(row[one]) for one in ("log_sd", "low", "high", "heat_elasticity")] for row in rows]).T
    draws, (least, most) = list(dict.fromkeys(row["draw"] for row in rows)), np.log(HEAT).tolist()
    logs, heat = np.zeros(len(rows)), 0.0
    for attempt in range(32):
        bells = 2.0 * (numbers(attempt, 3 * len(draws)).reshape(-1, 3).sum(axis=1) - 1.5)
        logs = np.clip(factor * sizes * bells[[draws.index(row["draw"]) for row in rows]], np.log(low), np.log(high))
        heat = float(elasticity @ logs)
        if least <= heat <= most:
            break
    else:
        logs *= min(max(heat, least), most) / heat
    yield from zip([row["parameter"] for row in rows], np.clip(np.exp(logs), low, high).tolist(), strict=True)


COVERED = re.compile(
    r"(schema|id|title|description|suites|observation|sensors|samples|outdoor_sensors|evaluation|prices|constraints|splits)\b.*"
    r"|weather\.((source|preprocessing|start|days|co2_ppm)=.*|step_seconds=(300|600|900|1200|1800|3600))|initial_state\.(kind=mature_crop|air_temperature.*)"
    r"|model\.(id=greenlight-tomato(-harvest|-season|-2-compartment)?-1\.0\.0|(variant|parameters)=.*|overrides\..*)"
    r"|uncertainty\.(distribution=uniform|redraw=(step|episode)|(delta|half_width_factor|parameters)\b.*)"
    r"|scenario\.((family|salt|start_within_days)=.*|generated=True|co2_range\..*)"
    r"|scenario\.(parameters|start)\.\d+\.(distribution=uniform|redraw=(step|episode)|half_width=.*|factor=.*|(name|spread|parameters|states)\b.*)"
    r"|actuation\.(kind=rate|max_change=.*|controls\..*)|reward\.(modules\.\d=(epi|scaled_epi|scaled_penalty)|(penalty_scale|violation_price)\..*)"
    r"|actuators\.\w+\.((lag_minutes|shortfall|(sticks|fails)\.(days_between|hours))=.*|wind\..*)|schedule\.\d+\.(control|value|weekdays|hours)\b.*"
    r"|ledger\.\w+\.((side|amount|unit|factor|label)=.*|stock=fruit|flow=(heat|electricity|co2_dosed|fruit_growth|fruit_harvested)|price\..*)",
    re.DOTALL,
)
"""What a task may say, key by key. What only concerns observations changes no reward of recorded actions."""


def said(value: Any, key: str = "") -> list[str]:
    """A task as lines such as `weather.days=60`."""
    if not isinstance(value, dict | list):
        return [f"{key}={value}"]
    pairs = value.items() if isinstance(value, dict) else enumerate(value)
    return [line for name, inner in pairs for line in said(inner, f"{key}.{name}" if key else str(name))]


def air_of(parcel: Any, exp: Any = np.exp) -> list[Any]:
    """Temperature [degC], CO2 [ppm] and relative humidity [%] from temperature, CO2 density [mg m-3] and vapour pressure [Pa]."""
    t, co2, vapour = parcel
    return [t, co2 * (t + 273.15) / CO2, 100.0 * vapour / saturation(t, exp)]


class Task:
    """A task in one of its splits, with own meters on the air outside its limits if violations are means, and an integrator."""

    def __init__(self, tables: Table, split: str | None) -> None:
        strange, reward, table = [line for line in said(tables) if not COVERED.fullmatch(line)], tables["reward"], tables["model"]
        self.split, self.hourly, self.paper = split, read_weather(tables["weather"]["source"]), tables["schema"] == 1
        strange += ["draws of real years"] if bool(split) != tables.get("scenario", {}).get("generated", False) else []
        strange += ["'scaled_epi' of schema 2"] if "scaled_epi" in reward["modules"] and not self.paper else []
        if strange or len({"penalty_scale", "violation_price"} & reward.keys()) > 1:
            end(CANNOT, f"not covered in the task: {', '.join(strange) or 'violations with a scale and a price'}")
        if self.paper:  # its prices are a ledger, its uncertainty is a scenario
            noise, price = tables["uncertainty"], {name: number(value) for name, value in tables["prices"].items()}
            fresh, goods = 1e-6 / price["dry_matter_content"], {"heat": "heat", "electricity": "electricity", "co2": "co2_dosed"}
            ledger = {f"cost_{one}": {"side": "paid", "flow": flow, "amount": one, "price": price[one]} for one, flow in goods.items()}
            ledger["revenue"] = {
                "side": "earned",
                "flow": "fruit_growth",
                "amount": "yield",
                "unit": "kg m-2",
                "factor": fresh,
                "price": price["fruit"],
            }
            groups = [noise | {"half_width": noise["delta"] * noise["half_width_factor"]}]
            tables = tables | {"ledger": ledger, "scenario": {"parameters": groups}}
        self.tables, self.scenario, self.step = tables, tables["scenario"], int(tables["weather"]["step_seconds"])
        self.hours, self.limited, wide = self.step / 3600.0, tables.get("constraints", {}), {"low": -1e9, "high": 1e9}
        self.steps, self.means = tables["weather"]["days"] * 86400 // self.step, self.limited.get("judged", "end") == "mean"
        self.limits = [[number(self.limited.get(name, wide)[one]) for one in ("low", "high")] for name in AIR]
        self.model = get_model(table.get("id", "greenlight-tomato-1.0.0"), table.get("variant", "author"))
        self.states, self.controls, self.parameters = (list(self.model.names[one]) for one in "xup")
        self.air = [self.states.index(name) for name in ("tAir", "co2Air", "vpAir")]
        self.scale = np.array([state.scale for state in self.model.states])
        slack, self.in_all = (FOLLOW, 10.0 * IN_ALL) if any(state.follower for state in self.model.states) else (1.0, IN_ALL)
        self.at_end, self.sums = slack * STATES, slack * SUMS  # relative
        overrides = {name: f"{one['value']} {one['unit']}" for name, one in table.get("overrides", {}).items()}
        self.nominal = np.array(self.model.parameters.default(table.get("parameters", "benchmark"), overrides))
        self.scheduled = sorted({self.controls.index(entry["control"]) for entry in tables.get("schedule", [])})
        p: dict[str, float] = dict(zip(self.parameters, self.nominal.tolist(), strict=True))
        # What flows is a multiple of a control, or of the change of a state.
        heat, dose = (p[one] / p["aFlr"] for one in ("pBoil", "phiExtCo2"))
        flows = {"heat": ("uBoil", heat * self.hours / 1e3), "electricity": ("uLamp", p["thetaLampMax"] * self.hours / 1e3)}
        flows |= {"co2_dosed": ("uCo2", dose * self.step * 1e-6), "fruit_harvested": ("sumMcFruitHar", 1.0)}
        flows, self.items = flows | dict.fromkeys(("fruit", "fruit_growth"), ("cFruit", 1.0)), []
        self.units = dict[str, str]()
        of_flow, money = {"heat": "kWh m-2", "electricity": "kWh m-2", "co2_dosed": "kg m-2"}, "EUR m-2"
        for name, item in tables["ledger"].items():
            flow = item.get("flow") or item["stock"]
            amount, (source, factor) = item.get("amount") or (flow if "flow" in item else f"{flow}_gained"), flows[flow]
            self.items.append((name, amount, source, item.get("factor", 1.0) * factor, item["side"] == "earned", number(item["price"])))
            self.units |= {name: money, amount: item.get("unit") or of_flow.get(flow, "mg m-2")}
        paid, grown = (float(sum(worth * price for *_, worth, earned, price in self.items if earned == side)) for side in (False, True))
        self.low, self.high = (-paid, p["rgFruit"] * self.step * grown) if self.paper else (0.0, 1.0)  # profit of 0 and 1 when scaled
        costs, scales = reward.get("violation_price", {}), reward.get("penalty_scale", {})
        pays = {"penalty": money if costs else "-", "reward": money if costs and {*reward["modules"]} == {"epi", "scaled_penalty"} else "-"}
        self.units |= pays | {"epi": money, "actuator_travel": "-"}
        self.weights = [number(costs.get(name, 0.0)) * self.hours if costs else 1.0 / number(scales.get(name, math.inf)) for name in AIR]
        self.penalty_margin = sum(2.0 * weight * near for weight, near in zip(self.weights, MEAN if self.means else AT_END, strict=True))
        self.margin = self.penalty_margin + MONEY / (self.high - self.low)
        self.generator = Generator(self.hourly, tables["splits"][split]["years"]) if split else None
        self.solver = self._integrator()

    def _integrator(self) -> Any:
        x, u, d, p = (casadi.SX.sym(name, size) for name, size in self.model.sizes.items())
        ends = zip(air_of([x[place] for place in self.air], casadi.exp), self.limits if self.means else (), strict=False)
        outside = [casadi.fmax(0.0, one) for value, (low, high) in ends for one in (low - value, value - high)]
        rates, x = casadi.vertcat(self.model.rhs_function()(x, u, d, p), *outside), casadi.vertcat(x, casadi.SX.sym("meters", len(outside)))
        self.inputs, calls = [np.zeros(one.numel()) for one in (x, u, d, p)], []
        for expression in (rates, casadi.jacobian(rates, x).T):  # transposed, because CasADi stores columns
            function = casadi.Function("f", [x, u, d, p], [casadi.cse(casadi.densify(expression))])
            result, (buffer, call) = np.zeros(expression.shape).squeeze(), function.buffer()
            for place, array in enumerate(self.inputs):
                buffer.set_arg(place, array.data)  # type: ignore[call-arg]
            buffer.set_res(0, result.data)  # type: ignore[call-arg]
            calls.append((call, result, buffer, function))

        def evaluate(which: int, _: float, state: Array) -> Array:
            self.inputs[0][:] = state
            calls[which][0]()
            return np.array(calls[which][1])

        errors = np.append(TOLERANCE * self.scale, [1e-6 * self.step] * len(outside))
        solver: Any = ode(partial(evaluate, 0), partial(evaluate, 1))
        return solver.set_integrator("lsoda", rtol=TOLERANCE, atol=errors, nsteps=100000)

    def advance(self, x: Array, *held: Array) -> Array:
        """The state a control step later, with controls, weather and parameters held."""
        for array, values in zip(self.inputs[1:], held, strict=True):
            array[:] = values
        after = np.asarray(self.solver.set_initial_value(x, 0.0).integrate(float(self.step)))
        if not self.solver.successful() or not np.isfinite(after).all():
            end(CANNOT, "a step cannot be integrated")
        return after

    def uniforms(self, of: object, name: str, step: int, count: int) -> Array:
        """Random numbers of a run or season."""
        salt = "\n".join(filter(None, (self.scenario.get("salt"), self.split)))
        family = f" uncertain parameters\n{self.tables['id']}\n{of}" if self.paper else f"\n{self.scenario['family']}\n{salt}\n{of}\n{name}"
        return uniforms(f"glbench{family}", step, count)

    def draw(self, parameters: Array, seed: int, step: int | None) -> Array:
        """Parameters with the draws of a step, or those of the episode (None)."""
        values, own = dict(zip(self.parameters, parameters.tolist(), strict=True)), dict(zip(self.parameters, self.nominal, strict=True))
        changed = set[str]()
        for k, group in enumerate(self.scenario.get("parameters", [])):
            if (group["redraw"] == "step") != (step is not None) or group.get("half_width") == 0.0:
                continue
            stream = partial(self.uniforms, seed, f"parameters {group.get('name') or f'parameters {k}'}")
            if "spread" in group:
                factors = dict(house(group["spread"], group.get("factor", 1.0), stream))
            else:
                named = group["parameters"]
                names = self.model.parameters.drawn_set(named) if isinstance(named, str) else named
                factors = dict(zip(names, 1.0 + group["half_width"] * (2.0 * stream(step or 0, len(names)) - 1.0), strict=True))
            if billed := {"pBoil", "thetaLampMax", "phiExtCo2", "aFlr"} & {*factors}:
                end(CANNOT, f"not covered: the task draws {', '.join(sorted(billed))}, which amounts are computed from")
            values |= {name: own[name] * factor for name, factor in factors.items()}
            changed |= {*factors}
        follow = set[str]()
        for one in self.model.table:  # in which what others follow from comes first
            follow |= {one.name} if (changed | follow) & {*re.findall(r"\w+", one.formula)} else set()
        if follow:
            whole = self.model.derived(self.model.Parameters(*values.values()))
            values |= {name: value for name, value in zip(self.parameters, whole, strict=True) if name in follow}
        return np.array([*values.values()])

    def weather(self, seed: int) -> tuple[Array, Array]:
        """Disturbances of the run with that seed `(steps, 10)`, and its scheduled controls `(steps, controls)`."""
        table, hourly, late = self.tables["weather"], self.hourly, 0
        ppm: Any = number(table["co2_ppm"])
        if self.generator is not None:
            season = (seed - self.tables["evaluation"]["first_seed"]) % self.tables["splits"][self.split]["seasons"]
            shift = self.uniforms("all seasons", "start days", 0, 1)[0] + 0.6180339887498949 * season
            late = math.floor((self.scenario.get("start_within_days", 0) + 1) * (shift % 1.0))
            first = table["start"].toordinal() - dt.date(1970, 1, 1).toordinal() + late
            count = table["days"] + 7
            hourly = self.generator.season(first, self.uniforms(f"season {season}", "weather", 0, 2 * count).reshape(-1, 2))
            if "co2_range" in self.scenario:
                low, high = (number(self.scenario["co2_range"][one]) for one in ("low", "high"))
                path, every = list[float](), max(3600 // self.step, 1)
                for hour in range(-(-self.steps // every)):
                    shock = 2.0 * (self.uniforms(f"season {season}", "CO2 outside", hour, 3).sum() - 1.5)
                    path.append(0.979 * path[-1] + math.sqrt(1.0 - 0.979**2) * shock if path else shock)
                wave = np.repeat(np.clip(np.array(path) / 2.0, -1.0, 1.0), every)[: self.steps]
                ppm = (low + high) / 2.0 + (high - low) / 2.0 * wave
        prepare, zone = (conserving, hourly[3]) if table["preprocessing"] == "conserving" else (paper, dt.UTC)
        start = int(dt.datetime.combine(table["start"], dt.time(), zone).timestamp()) + 86400 * late
        moments = [dt.datetime.fromtimestamp(start + self.step * k, zone) for k in range(self.steps)]
        return prepare(hourly, start, self.steps, self.step, ppm), np.array([self.schedule(moment) for moment in moments])

    def schedule(self, moment: dt.datetime) -> Array:
        """Scheduled controls at a moment (docs/schedule.md)."""
        controls, hour = np.zeros(len(self.controls)), moment.hour + moment.minute / 60.0
        for entry in self.tables.get("schedule", []):
            begins, ends = entry.get("hours", (0.0, 24.0))
            day = WEEKDAYS[(moment - dt.timedelta(hours=ends if begins > ends else 0.0)).weekday()]
            if (hour - begins) % 24.0 < ((ends - begins) % 24.0 or 24.0) and day in entry.get("weekdays", WEEKDAYS):
                controls[self.controls.index(entry["control"])] = entry["value"]
        return controls

    def deliver(self, seed: int, step: int, wind: float, before: Array, commands: Array, faults: dict[str, bool]) -> Array:
        """Controls that actuators make of commands in a step (docs/uncertainty.md); `faults` of the step before become those of this."""
        after, table = commands.copy(), self.tables.get("actuators", {})
        actuators = [(self.controls.index(name), name, table[name]) for name in self.tables["actuation"]["controls"] if name in table]
        short = [name for _, name, one in actuators if one.get("shortfall")]
        most = dict(zip(short, self.uniforms(seed, "actuator shortfalls", 0, len(short)), strict=True))
        numbers = iter(self.uniforms(seed, "actuators", step, 2 * len(actuators)))
        for place, name, one in actuators:
            for fault in (f"{kind} {name}" for kind in ("sticks", "fails") if kind in one):
                means = one[fault.partition(" ")[0]]
                chance = 1.0 - self.hours / means["hours"] if faults.get(fault) else self.hours / 24.0 / means["days_between"]
                faults[fault] = bool(next(numbers) < chance)
            able = 1.0 - most.get(name, 0.0) * one.get("shortfall", 0.0)
            if "wind" in one:
                above, full = (number(one["wind"][key]) for key in ("above", "full"))
                able *= 1.0 - (1.0 - one["wind"].get("share", 0.0)) * min(max((wind - above) / (full - above), 0.0), 1.0)
            carried = math.exp(-self.step / 60.0 / one["lag_minutes"]) if one.get("lag_minutes") else 0.0
            after[place] = carried * before[place] + (1.0 - carried) * able * commands[place]
            after[place] = 0.0 if faults.get(f"fails {name}") else before[place] if faults.get(f"sticks {name}") else after[place]
        return after

    def start(self, seed: int, weather: Array) -> Array:
        """State at the start (docs/nomenclature.md): all surfaces and screens at one temperature, meters and clock at 0."""
        t, co2, soil = number(self.tables["initial_state"]["air_temperature"]), float(weather[3]), float(weather[6])
        values = {name: t for name in self.states if re.fullmatch(r"t(Air|Top|Cov\w*|\w*Scr|Flr|\w*Pipe|\w*Lamp|Mass)", name)}
        values |= {f"tSo{layer + 1}": ((4 - layer) * t + layer * soil) / 4.0 for layer in range(5)}
        values |= {"tCan": t + 4.0, "tCan24": t + 4.0, "co2Air": co2, "co2Top": co2}
        sla, place = self.model.parameters.default("benchmark"), self.parameters.index("sla")
        values |= {"cLeaf": 95283.0 * sla[place] / self.nominal[place], "cStem": 251070.0, "cFruit": 55338.0, "tCanSum": 3097.8}
        values |= dict.fromkeys(("vpAir", "vpTop"), 0.9 * float(saturation(t)))
        if "nRipe" in self.states:  # fruits of all stages are the model's own; the rest is in docs/nomenclature.md
            fruits = dict(zip(self.states, self.model.start("mature_crop", weather, t, self.nominal).tolist(), strict=True))
            values |= {name: fruits[name] for name in self.states if re.fullmatch(r"[nc]Fruit\d+", name)}
            values |= {"cFruit": sum(fruits[f"cFruit{k + 1}"] for k in range(33)), "tFruit": t, "photoperiod": 0.5, "sourceSink": 0.5}
        x = np.array([values.get(name, 0.0) for name in self.states] + [0.0] * (6 * self.means))
        for k, group in enumerate(self.scenario.get("start", [])):
            numbers = self.uniforms(seed, f"start {group.get('name') or f'start {k}'}", 0, len(group["states"]))
            x[[self.states.index(name) for name in group["states"]]] *= 1.0 + group["half_width"] * (2.0 * numbers - 1.0)
        return x

    def replay(
        self, seed: int, x: Array, weather: Array, schedule: Array, actions: Array, *, direct: bool
    ) -> Iterator[tuple[Array, Array, Array, Array, Array]]:
        """Of each step: the state before, the controls before and in it, the parameters, and the state after."""
        (u, commands), parameters, faults = np.zeros((2, len(self.controls))), self.draw(self.nominal, seed, None), dict[str, bool]()
        moved = [self.controls.index(name) for name in self.tables["actuation"]["controls"]]
        for k, action in enumerate(actions):
            last, commands = commands, np.clip(action, 0.0, 1.0) if direct else np.zeros_like(u)
            if not direct:
                commands[moved] = np.clip(last[moved] + self.tables["actuation"]["max_change"] * np.clip(action, -1.0, 1.0), 0.0, 1.0)
            commands[self.scheduled] = schedule[k, self.scheduled]
            before, u_before, u = x, u, self.deliver(seed, k, float(weather[k, 4]), u, commands, faults)
            drawn = self.draw(parameters, seed, k)
            x = self.advance(before, u, weather[k], drawn)
            yield before, u_before, u, drawn, x

    def quantities(self, before: Array, after: Array, u_before: Array, u: Array) -> dict[str, float]:
        """What a step adds to the metrics."""
        changes = dict(zip([*self.states, *self.controls], [*(after - before)[: len(self.states)].tolist(), *u.tolist()], strict=True))
        rows = {"reward": 0.0, "epi": 0.0, "penalty": 0.0} | (
            {} if self.paper else {"actuator_travel": float(np.abs(np.delete(u - u_before, self.scheduled)).sum())}
        )
        for name, amount, source, factor, earned, price in self.items:
            rows[amount] = changes[source] * factor
            rows[name] = rows[amount] * price
            rows["epi"] += rows[name] if earned else -rows[name]
        air, meters = air_of(after[self.air]), (after - before)[len(self.states) :] / self.step
        air[2], hours = min(max(air[2], 0.0), 100.0), dict[str, float]()
        for place, (name, (low, high)) in enumerate(zip(AIR, self.limits, strict=True)):
            sides = meters[2 * place : 2 * place + 2].tolist() if self.means else [low - float(air[place]), float(air[place]) - high]
            rows["penalty"] += sum(max(one, 0.0) for one in sides) * self.weights[place]
            if name in self.limited:
                hours |= {f"hours_{name}_{side}": self.hours * (one > 0.0) for side, one in zip(("low", "high"), sides, strict=True)}
        hours |= {"hours_outside_limits": max(hours.values())} if hours else {}
        parts = {"epi": rows["epi"], "scaled_epi": (rows["epi"] - self.low) / (self.high - self.low), "scaled_penalty": -rows["penalty"]}
        return rows | hours | {"reward": sum(parts[one] for one in self.tables["reward"]["modules"])}


def compare(what: str, own: float, theirs: float, margin: float) -> float:
    """How far two numbers are apart, within the margin."""
    if not abs(own - theirs) <= margin:
        end(DIFFERS, f"{what} is {own!r}, and {theirs!r} in the result or its record (tolerance {margin:.1e})")
    return abs(own - theirs)


def same(what: str, own: Any, theirs: Any) -> None:
    if own != theirs:
        ours, other = (said(json.loads(canonical(one))) for one in (own, theirs))
        words = [
            ", ".join([line.lstrip("=") for line in one if line not in two][:3]) or "nothing more"
            for one, two in ((ours, other), (other, ours))
        ]
        end(DIFFERS, f"{what}: expected {words[0]}; found {words[1]}"[:600])


def audit_run(task: Task, run: Run, metrics: Mapping[str, float], *, direct: bool) -> str:
    """Recompute a run, and say how closely it agrees."""
    (_, actions, rewards, final), seed, sums, worst = run, run[0]["seed"], dict[str, float](), 0.0
    weather, schedule = task.weather(seed)
    x = task.start(seed, weather[0])
    if not ((actions >= (-1e-6 if direct else -1.0 - 1e-6)) & (actions <= 1.0 + 1e-6)).all():
        end(DIFFERS, f"run {seed}: an action is outside its bounds")
    steps = task.replay(seed, x, weather, schedule, actions[: len(rewards)], direct=direct)
    for k, ((before, u_before, u, _, x), recorded) in enumerate(zip(steps, rewards.tolist(), strict=True)):
        rows = task.quantities(before, x, u_before, u)
        sums = {name: sums.get(name, 0.0) + value for name, value in rows.items()}
        worst = max(worst, compare(f"run {seed}, step {k + 1}: the reward", rows["reward"], recorded, task.margin))
    meters = [task.in_all * near * task.step / task.at_end for near in MEAN for _ in range(2)] if task.means else []
    names = [*task.states, *(f"{name} outside its limit, summed" for name in AIR for _ in range(2))]
    same(f"run {seed}: the size of the state", len(x), len(final))
    ends = zip(names, x.tolist(), final.tolist(), [*task.scale.tolist(), *meters], strict=False)
    off = max(compare(f"run {seed}: '{name}' at the end", own, theirs, task.at_end * scale) / scale for name, own, theirs, scale in ends)
    missing, charge = task.steps - len(rewards), task.tables["evaluation"]["failed_step"]
    total = float(np.add.accumulate(np.append(0.0, rewards))[-1]) + missing * number(charge["reward"])
    near = {"reward": task.margin, "penalty": task.penalty_margin}
    compare(f"run {seed}: the sum of the recorded rewards", total, metrics["reward"], 0.0)
    same(f"run {seed}: the names of the metrics", sorted(sums or metrics), sorted(metrics))
    for name in sorted(metrics):
        if name.startswith("hours_") and math.copysign(1.0, metrics[name]) < 0.0:
            end(DIFFERS, f"run {seed}: '{name}' is negative, {metrics[name]!r} h")
        own = sums.get(name, 0.0) + missing * number(charge.get(name, 0.0))
        size = sum(abs(sums.get(item, 0.0)) for item, *_ in task.items) if name == "epi" else abs(own)  # of what is earned and paid
        margin = task.in_all * near[name] if name in near else task.sums * max(size, 1.0)
        margin += HOURS * own + 1.0 if name.startswith("hours_") else 0.0
        compare(f"run {seed}: '{name}'", own, metrics[name], margin)
    score = f"{abs(sums.get('reward', 0.0) - rewards.sum()):.1e} of {total:.6g} (tolerance {task.in_all * task.margin:.1e})"
    step = f"{len(rewards)} steps; reward of a step within {worst:.1e} (tolerance {task.margin:.1e})"
    return f"run {seed}: {step}, of the run within {score}, final state within {off:.1e} of its typical size (tolerance {task.at_end:.0e})"


def plain(tables: Table) -> dict[str, str]:
    """A task as its record has it: without words for people, that of the paper without units and what is not there, too."""
    own = [line for line in said(tables) if not re.match(r"(description|suites)\b", line)]
    own = [line for line in own if tables["schema"] > 1 or not re.search(r"\.unit=|=None$", line)]
    return {key.removesuffix(".value"): re.sub(r"\.0$", "", value) for key, _, value in (line.partition("=") for line in own)}


def audit(path: Path, most: int | None, task_file: str | None) -> Iterator[str]:
    """Audit a result, or the first ``most`` runs of it; sentences about what agrees, as they come."""
    if most == 0:
        end(CANNOT, "no run to audit: --runs must be at least 1")
    result = read_json(path.read_bytes())
    if not isinstance(result, dict) or (result.get("schema"), result.get("schema_version")) != ("glbench/result", 1) or not result["runs"]:
        end(CANNOT, f"{path} is not a glbench result with runs, such as reports/results/Spring-v1/my_agent.json")
    runs, agent, name, digest = result["runs"], result["agent"], result["task"]["id"], result["task"]["digest"]
    if result["task"].get("salt_commitment") or not result["record"]:
        end(CANNOT, "results of sealed rounds, and those without a record, are not covered")
    provenance, definition, recorded, content = read_record(path.with_name(result["record"]["file"]))
    lock, direct = tomllib.loads((ROOT / "tasks" / "lock.toml").read_text(encoding="utf-8")), provenance["agent"]["acts"] == "controls"
    tables, split = task_tables(task_file or name, Path()), result["task"].get("split")
    if task_file and name in lock:
        end(CANNOT, f"{name} is published: leave out --task")
    if tables.get("id") != name:
        end(CANNOT, f"the task file defines {tables.get('id')}, the result is of {name}")
    if split not in tables.get("splits", [None]):
        end(DIFFERS, f"the task has no split '{split}'")
    task, n, good, start = Task(tables, split), len(runs), sum(run["status"] == "ok" for run in runs), runs[0]["seed"]
    means = {name: math.fsum(run["metrics"][name] for run in runs) / n for name in runs[0]["metrics"]}
    summary = {"runs": n, "ok": good, "failed": n - good, "statuses": Counter(run["status"] for run in runs), "mean": means}
    facts: Table = {"id": name, "digest": lock.get(name, {"digest": digest})["digest"], "title": tables["title"]}
    facts, years = facts | {"steps": task.steps, "step_seconds": float(task.step)}, split and sorted(tables["splits"][split]["years"])
    covered = {"task": digest, "agent": {one: agent[one] for one in ("name", "digest")}, "runs": runs}
    own: Table = {"results_digest": hashlib.sha256(canonical(covered).encode()).hexdigest(), "record.digest": content, "summary": summary}
    own |= {"seeds": list(range(start, start + n)), "runs": n, "seeds of runs": [run["seed"] for run in runs], "task": facts}
    own |= {"units": {one: "h" if one.startswith("hours_") else task.units.get(one) for one in means}, "split, years": [split, years]}
    theirs = {one: result.get(one) for one in own} | {
        "seeds of runs": result["evaluation"]["seeds"],
        "record.digest": result["record"]["digest"],
    }
    theirs |= {one: result["evaluation"][one] for one in ("seeds", "runs")} | {"split, years": [split, result["task"].get("years")]}
    same("the result", own, theirs | {"task": {one: result["task"][one] for one in facts}})
    own = {"task": facts | {"start": str(tables["weather"]["start"])}, "definition": plain(tables)}
    own["runs"] = [{one: run[one] for one in ("seed", "status", "reason", "steps")} for run in runs]
    own["agent"] = {one: agent[one] for one in ("name", "kind", "digest", "information")} | {"privileged": direct or agent["privileged"]}
    own["columns"] = task.controls if direct else [*tables["actuation"]["controls"]]
    theirs = {part: {one: provenance[part][one] for one in own[part]} for part in ("task", "agent")} | {"definition": plain(definition)}
    theirs["runs"] = [{one: run[one] for one in own["runs"][0]} for run, *_ in recorded]
    same("the record", own, theirs | {"columns": provenance["agent"]["columns"]})
    same("privileged in the result", own["agent"]["privileged"], agent["privileged"])
    first, asked = tables["evaluation"]["first_seed"], tables["evaluation"]["runs"]
    trial = f"; the task asks for {asked} from {first} on" + (", of the test split" if split else "")
    trial, many = "" if (start, n) == (first, asked) and split in (None, "test") else trial, "s" * (n > 1)
    yield f"{name}{f', {split} split' if split else ''}, agent {agent['name']}: {n} run{many} from {start} on{trial}"
    for run, row in list(zip(recorded, runs, strict=True))[:most]:
        if row["status"] == "simulation_failed" or (row["status"] == "ok") != (row["steps"] == task.steps):
            end(CANNOT, f"run {row['seed']} is {row['status']} after {row['steps']} steps, which is not covered")
        same(f"what is said of run {row['seed']}", ["metrics", "reason", "seed", "status", "steps"], sorted(row))
        yield audit_run(task, run, row["metrics"], direct=direct)
    left = ["fresh draws"] * bool(result.get("fresh_draws")) + ["the digest of a task that is not published"] * (name not in lock)
    yield f"not audited: {', '.join([*left, NOT_AUDITED])}"
    yield f"agrees ({len(runs[:most])} of {n} runs)"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Recompute a result of glbench from its record of actions.")
    parser.add_argument("result", type=Path)
    parser.add_argument("--runs", type=int, help="audit so many runs only")
    parser.add_argument("--task", help="file of a task that glbench does not ship")
    options, code = parser.parse_args(arguments), 0
    try:
        for words in audit(options.result, options.runs and max(options.runs, 0), options.task):
            sys.stdout.write(words + "\n")
    except VerdictError as verdict:
        code, words = verdict.args
    except NotCoveredError as error:
        code, words = CANNOT, str(error)
    except Exception as error:  # whatever a strange file brings
        code, words = CANNOT, f"a file is missing, damaged, or not what it should be: {type(error).__name__}: {error}"
    if code:
        sys.stdout.write(f"{'differs' if code == DIFFERS else 'cannot be audited'}: {words}\n")
    return code


if __name__ == "__main__":
    sys.exit(main())
