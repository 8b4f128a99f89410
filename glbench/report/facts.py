"""Tasks, agents and results as plain values, from stored results, their ranks and their profiles: the data of the page.

Of baselines that come with this glbench the settings, with units, and the training are read from the files beside them; only where
the digest in the result is still theirs, else these files are not those that the result was made with.
"""

from __future__ import annotations

import csv
import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from glbench.agents.baselines import digests_of_baseline, read_baseline
from glbench.agents.identity import baseline_names
from glbench.agents.tuned_rules import RulePages
from glbench.evaluation import Result
from glbench.evaluation.files import short_task_id
from glbench.evaluation.profiles import Profile
from glbench.leaderboard import Row, StoredResult, TaskTable
from glbench.leaderboard.catalogue import Catalogue, Charts
from glbench.leaderboard.regret import PARTS
from glbench.leaderboard.statistics import SCORES, Estimate, Interval
from glbench.leaderboard.suites import SuiteRow, SuiteTable
from glbench.leaderboard.tables import scale_words
from glbench.quantities import capitalised, pretty_unit
from glbench.report.task_words import clock_changes, clock_of, common_start, definition_in_words, figures, for_growers
from glbench.resources import data_folder
from glbench.tasks import TaskSpec, list_suites, read_lock

_RUN_DIGITS = 7
_OF_CARD = ("authors", "description", "link", "algorithm", "training")


@dataclass(frozen=True)
class ReportEntry:
    """One stored result with its row of the leaderboard and, where there is one, its profile."""

    stored: StoredResult
    row: Row
    profile: Profile | None


def report_entries(
    stored: Sequence[StoredResult], tables: Sequence[TaskTable], profiles: Mapping[tuple[str, str], Profile]
) -> list[ReportEntry]:
    """All results in the order of the leaderboards, trainings one by one; ``profiles`` are by task id and ``results_digest``.

    The digest alone will not do: it does not cover the id of the task.
    """
    by_digest = {(item.board, item.result.results_digest): item for item in stored}
    return [
        ReportEntry(by_digest[row.task_id, row.results_digest], row, profiles.get((row.task_id, row.results_digest)))
        for table in tables
        for row in table.results
    ]


class LabelSets:
    """Labels task by task: equal sets once, and tasks and suites go by their numbers."""

    def __init__(self, entries: Sequence[ReportEntry]) -> None:
        self._rows = [item.row for item in entries]
        self._numbers: dict[str, int] = {}
        self.all: list[dict[str, Any]] = []

    def of(self, labels: Catalogue, task_ids: Sequence[str], charts: Charts | None = None) -> int:
        """The number of the labels of some tasks; ``charts`` is what is drawn of a task."""
        rows = [row for row in self._rows if row.task_id in task_ids]
        units = {name: unit for row in rows for name, unit in row.units.items()}
        names = labels.known_first(name for row in rows for name in row.estimates)
        metrics = sorted((labels.metric(name, units) for name in names), key=lambda metric: not metric.column)
        words = {
            "metrics": [asdict(one) | {"unit": pretty_unit(one.unit), "column": one.column} for one in metrics],
            "items": [asdict(item) for item in labels.items],
            "lead": labels.lead,
            "caution": labels.caution,
            "draws": labels.draws,
            "beyond": labels.beyond,
            **({} if charts is None else asdict(charts)),
        }
        words = json.loads(json.dumps(words, ensure_ascii=False).replace("CO2", "CO₂"))
        number = self._numbers.setdefault(json.dumps(words, sort_keys=True), len(self.all))
        if number == len(self.all):
            self.all.append(words)
        return number


def task_facts(table: TaskTable, steps: int, step_seconds: float, boards: Sequence[str]) -> dict[str, Any]:
    """A task as the page shows it; without its definition only what results say of it. ``boards`` are those of the page."""
    spec: TaskSpec | None = table.task
    lock, short = read_lock(), short_task_id(table.task_id)
    namesakes = [name for name in {*lock, *boards} - {table.task_id} if short_task_id(name) == short]
    facts: dict[str, Any] = {
        "id": table.task_id,
        "short": table.task_id if namesakes and table.task_id not in lock else short,
        "title": table.title,
        "digest": table.digest,
        "metric": table.metric,
        "draws": table.draws,
        "steps": steps,
        "step_seconds": step_seconds,
        "best_known": None if table.best_known is None else table.best_known.model_dump(),
        "turns": [[one.first, one.second, one.factor] for one in table.turns],
        "published": table.task_id in lock and lock[table.task_id].digest == table.digest,
    }
    if spec is None:
        return facts
    return {
        **facts,
        **figures(spec),
        "start": (first := common_start(spec)) and first.isoformat(),
        "days": spec.weather.days,
        "clock": clock_of(spec),
        "clock_changes": clock_changes(spec),
        "suites": list(spec.suites),
        **({"delta": 100 * spec.uncertainty.delta} if spec.conventions.shows_delta else {}),
        "description": " ".join(spec.description.split()),
        "words": [asdict(section) for section in for_growers(spec)],
        "keys": [asdict(section) for section in definition_in_words(spec)],
        "versions": [
            {"id": version, "digest": entry.digest, "model": entry.fingerprint.model_version}
            for version, entry in lock.items()
            if version.rpartition("-v")[0] == table.task_id.rpartition("-v")[0]
        ],
    }


def families(tables: Sequence[TaskTable]) -> list[dict[str, Any]]:
    """Suites of the paper's form of which several tasks have results and differ in delta: what the figure over delta is drawn of."""
    specs = {table.task_id: table.task for table in tables if table.task is not None and table.task.conventions.shows_delta}
    suites = []
    for name, members in list_suites().items():
        tasks = sorted((m for m in members if m in specs), key=lambda m: specs[m].uncertainty.delta)
        if len({specs[m].uncertainty.delta for m in tasks}) > 1:
            suites.append({"name": name, "tasks": tasks})
    return suites


def suite_facts(table: SuiteTable) -> dict[str, Any]:
    """Agents over a suite: scores with intervals, means over the tasks, profiles and probabilities of improvement."""
    profiles = () if table.in_money else table.profiles  # their axis is a normalised score
    rows = [
        {
            "agent": row.agent,
            "rank": row.rank,
            "runs": row.runs,
            "trainings": list(row.trainings),
            "missing": list(row.missing),
            **{name: (one := getattr(row, name)) and _interval(one) for name in (*SCORES, "regret", "against_rules")},
            **_at_prices(row),
            "figures": row.figures
            and {
                **{name: _short(value) for name, value in row.figures.metrics.items()},
                "failed": row.figures.failed,
                "decision": row.figures.decision_milliseconds,
                "training": row.figures.training_steps,
                **row.figures.model_dump(include={"privileged", "sandbox", "reproduced", "origin"}),
            },
        }
        for row in table.shown_rows
    ]
    return {
        "name": table.suite,
        "scale": scale_words(table),
        "in_money": table.in_money,
        "turns": [[one.first, one.second, one.factor] for one in table.turns],
        "tasks": list(table.tasks),
        "rows": rows,
        "thresholds": [round(x, 4) for x in profiles[0].thresholds] if profiles else [],
        "profiles": {one.agent: [[round(1000 * x) for x in line] for line in (one.share, one.low, one.high)] for one in profiles},
        "improvements": [[one.first, one.second, *_interval(one.probability)] for one in table.improvements],
    }


def _at_prices(row: Row | SuiteRow) -> dict[str, Any]:
    """Places at other prices of violations, where they have one."""
    places = [[one.factor, one.rank, _short(one.mean)] for one in row.at_prices]
    return {"reversal": row.reversal, **({"at_prices": places, "frontier": row.frontier} if places else {})}


def _interval(interval: Interval) -> list[float]:
    return [_short(part) for part in (interval.value, interval.low, interval.high)]


def agent_facts(tables: Sequence[TaskTable], entries: Sequence[ReportEntry]) -> list[dict[str, Any]]:
    """Entries by name, baselines last, so that colours of submissions do not change when a baseline is added; then their trainings."""
    of_result = {(item.row.task_id, item.row.results_digest): item.stored.result.agent for item in entries}
    agents: dict[str, Any] = {}
    trainings: dict[str, str] = {}
    for table in tables:
        for row in table.rows:
            agents[row.agent] = of_result[row.task_id, row.results_digest]
            trainings |= {training_name(row, one): row.agent for one in row.trainings if row.is_range}
    ordered = sorted(agents.items(), key=lambda pair: (pair[1].kind == "baseline", pair[0]))
    facts = [{"name": name, "kind": one.kind, "privileged": one.privileged, "information": one.information} for name, one in ordered]
    return facts + [{"name": name, "training_of": entry} for name, entry in sorted(trainings.items())]


def training_name(entry: Row, training: Row) -> str:
    """A name for one of several trainings. The first often has that of its entry, and gets its seed."""
    return f"{training.agent}_seed{training.training_seed}" if training.agent == entry.agent else training.agent


def entry_facts(entry: Row, entries: Mapping[tuple[str, str], ReportEntry], blocks: Mapping[tuple[str, str], str]) -> list[dict[str, Any]]:
    """What the page shows of one row of a leaderboard: a result, or several trainings as one and then one by one.

    ``entries`` are by task id and ``results_digest``, ``blocks`` are the names of their profiles. Of several trainings the values are means
    over them, run by run, so that all that is linear in amounts can be computed again; days and seasons are those of the first.
    """
    items = [entries[row.task_id, row.results_digest] for row in entry.results]
    results = [
        {**result_facts(replace(item, row=row)), "profile": blocks.get((row.task_id, row.results_digest))}
        for item, row in zip(items, entry.results, strict=True)
    ]
    first = {**results[0], "agent": entry.agent, "trainings": len(entry.trainings)}
    if not entry.is_range:
        return [first]
    stored = [item.stored.result for item in items]
    together = {
        **first,
        "members": [training_name(entry, row) for row in entry.trainings],
        "reproduced": entry.reproduced,
        "confirmed": all(item.stored.confirmed for item in items),
        "runs": entry.runs,
        "failed": entry.failed,
        "reasons": [reason for one in results for reason in one["reasons"]],
        "decision": entry.decision_milliseconds,
        "training": _training(entry),
        "sandbox": entry.sandbox,
        "digest": "",
        "estimates": _estimates(entry),
        **_notes(entry),
        "steps": [float(np.mean(steps)) for steps in zip(*([run.steps for run in one.runs] for one in stored), strict=True)],
        "values": {
            name: [_short(float(np.mean(runs))) for runs in zip(*(one.values(name) for one in stored), strict=True)]
            for name in entry.estimates
        },
    }
    members = [
        {**one, "agent": training_name(entry, row), "member_of": entry.agent, "training_seed": row.training_seed, "trainings": 0}
        for one, row in zip(results, entry.trainings, strict=True)
    ]
    return [together, *members]


def result_facts(item: ReportEntry) -> dict[str, Any]:
    """A result as the page shows it, with estimates as on the leaderboard, and all metrics of all runs."""
    result, row = item.stored.result, item.row
    same = row.model_dump(include={"agent", "rank", "remark", "origin", "reproduced", "privileged", "runs", "failed"})
    return {
        "task": row.task_id, **same, "confirmed": item.stored.confirmed, "sees": result.agent.information,
        "seeds": list(result.evaluation.seeds), "reasons": [[run.seed, run.status, run.reason, run.steps] for run in result.failed],
        "decision": result.evaluation.decision_milliseconds, "training": _training(row), "digest": result.results_digest,
        "agent_digest": result.agent.digest, "created": result.created, "glbench": result.versions.glbench,
        "kernel": f"{row.kernel} {row.build}", "estimates": _estimates(row), **_notes(row),
        "steps": None if not row.failed else [run.steps for run in result.runs],
        "values": {name: [_short(value) for value in result.values(name)] for name in row.estimates},
        **optional_facts(result.model_dump(mode="json")), "settings": settings_of(result, item.stored.task),
    }  # fmt: skip


def numbered(facts: Sequence[dict[str, Any]], name: str) -> list[Any]:
    """The different values of ``name`` in ``facts``, each once; in the facts stand their places, or nothing."""
    places: dict[str, int] = {}
    for one in facts:
        value = one.pop(name, None)
        if value is not None:
            one[name] = places.setdefault(json.dumps(value, sort_keys=True), len(places))
    return [json.loads(text) for text in places]


def _training(row: Row) -> dict[str, Any] | None:
    return None if row.training_steps is None else {"steps": row.training_steps, "wall_hours": row.training_hours}


def _notes(row: Row) -> dict[str, Any]:
    """Notes on the worst runs, on years, on trainings and runs together, and on what the training saw."""
    overall = {name: [_short(e.overall.low), _short(e.overall.high)] for name, e in row.estimates.items() if e.overall}
    regret: dict[str, Any] | None = None
    if row.regret is not None:
        parts: dict[str, Estimate | None] = {part: getattr(row.regret, part) for part in PARTS}
        regret = {
            **{name: one and [_short(value) for value in (one.mean, one.low, one.high)] for name, one in parts.items()},
            "first": row.regret.runs if row.regret.runs * max(1, len(row.trainings)) < row.runs else None,
            "ahead": row.regret.runs_ahead,
            "better": bool(row.regret.runs_ahead) and row.plan_counts and row.origin != "released",
        }
    return {
        "worst_tenth": None if row.worst_tenth is None else _interval(row.worst_tenth),
        "overall": overall,
        "by_year": [[one.year, one.runs, _short(one.mean)] for one in row.by_year],
        "trained_on": row.trained_on.words,
        "saw_scored": row.saw_scored,
        "regret": regret,
        **_at_prices(row),
        **({} if row.fresh_draws is None else {"fresh_draws": row.fresh_draws.model_dump(include={"mean", "marked"})}),
    }


def _estimates(row: Row) -> dict[str, list[float]]:
    return {name: [_short(part) for part in (e.mean, e.low, e.high, e.iqm)] for name, e in row.estimates.items()}


def optional_facts(document: Mapping[str, Any]) -> dict[str, Any]:
    """What only some results say: how the agent was kept apart, and what its card tells of it."""
    card = document["agent"].get("card") or {}
    statements = {key: card[key] for key in _OF_CARD if card.get(key)}
    return {"sandbox": document["evaluation"].get("sandbox"), "card": statements or None}


def _short(value: float) -> float:
    """Seven digits are more than anybody sees."""
    return float(f"{value:.{_RUN_DIGITS}g}")


_TEXT = (".yml", ".toml")
_KEY = re.compile(r"^(?P<indent> *)(?P<name>[A-Za-z_]\w*)\s*[:=]\s*(?P<value>[^#]*?)\s*(?:#\s*(?P<words>.*))?$")
_SECTION = re.compile(r"^\[(?P<name>\w+)\]\s*(?:#\s*(?P<words>.*))?$")
_UNIT = re.compile(
    r"^(?P<unit>degC|K|h|day|g day-1|g|ppm|%|W m-2|MJ m-2 d-1|MJ m-2|g m-3|J cm-2|share(?: h)?(?: [K%h]-1)*|-)(?=[\s,:]|$)"
    r"[,:]?\s*(?P<words>.*)$"
)
_DEEPEST = 2  # Spaces before a name; what is indented further is data
_POINTS = 60


@dataclass
class SettingsTable:
    """A table of settings: its title, what stands beside that, and rows of name, value, unit and meaning."""

    title: str
    words: str = ""
    rows: list[list[str]] = field(default_factory=list)


def settings_tables(text: str) -> list[SettingsTable]:
    """The settings in a YAML or TOML file that says units and meanings in comments behind its values.

    A comment of one line between an empty line and a name is a heading, as is a table of TOML.
    """
    tables, lines = [SettingsTable("")], text.splitlines()
    for number, line in enumerate(lines):
        heading, key, rows = _SECTION.match(line), _KEY.match(line), tables[-1].rows
        before = lines[number - 1].strip() if number else ""
        after = lines[number + 1] if number + 1 < len(lines) else ""
        if heading:
            tables.append(SettingsTable(_setting_label(heading["name"]), heading["words"] or ""))
        elif key and len(key["indent"]) <= _DEEPEST and key["value"]:
            unit, words = "", key["words"] or ""
            if comment := _UNIT.match(words):  # such as "W m-2, the raise begins"
                unit, words = comment["unit"], comment["words"]
            unit = unit if unit.startswith("share") else pretty_unit(unit)
            rows.append([_setting_label(key["name"]), key["value"].strip("\"'"), unit, words])
        elif line.startswith("# ") and not before and _KEY.match(after) and not after.startswith(" "):
            tables.append(SettingsTable(line[2:].strip()))
        elif line.lstrip().startswith("# ") and line.startswith(" ") and rows and rows[-1][3]:
            rows[-1][3] += f" {line.lstrip()[2:].strip()}"
    return [table for table in tables if table.rows]


def _setting_label(name: str) -> str:
    return capitalised(name.replace("co2", "CO₂"))


def settings_of(result: Result, task: TaskSpec | None) -> dict[str, Any] | None:
    """Settings and training of the baseline that made ``result``, as the page shows them; ``None`` where they are not known here."""
    name = result.agent.name
    if result.agent.kind != "baseline" or name not in baseline_names() or task is None:
        return None
    baseline, folder = _baseline(name), data_folder("baselines") / name
    if result.agent.digest not in digests_of_baseline(name):
        return None
    settings: Any = baseline.settings
    if isinstance(settings, RulePages):
        page = settings.page_for(task.reward.modules, task.id, task.model_id)
    else:
        file = folder / baseline.card.settings
        page = file if file.suffix in _TEXT and file.is_file() else None
    training = None
    for file in sorted((folder / "training").glob("*.toml")):
        about = tomllib.loads(file.read_text(encoding="utf-8")).get("task", {})
        if task.id in about.get("ids", [about.get("id")]):
            training = _training_facts(file)
            break
    facts = {
        "title": baseline.card.title,
        "description": " ".join(baseline.card.description.split()),
        "file": None if page is None else _path_in_baselines(page),
        "sections": [] if page is None else _settings_rows(page),
        "training": training,
    }
    return facts if facts["sections"] or facts["training"] else None


_baseline = cache(read_baseline)


def _path_in_baselines(file: Path) -> str:
    return f"baselines/{file.resolve().relative_to(data_folder('baselines').resolve()).as_posix()}"


def _settings_rows(file: Path) -> list[list[Any]]:
    return [[table.title, table.words, table.rows] for table in settings_tables(file.read_text(encoding="utf-8"))]


def _training_facts(file: Path) -> dict[str, Any]:
    """Budget, seasons, choice and recipe of a training, and its curve: steps and the reward of the policies or rules tried."""
    card = tomllib.loads(file.read_text(encoding="utf-8"))
    about, best, machine = card.get("training", {}), card.get("best", {}), card.get("machine", {})
    hours = card.get("wall_seconds", {}).get("total")
    seasons = (f"the {about['split']} seasons" if "split" in about else "", ", ".join(map(str, about.get("years", []))))
    computer = (str(machine.get("processor", "")), f"{machine['cores']} cores" if "cores" in machine else "")
    rows = [
        ["Algorithm", str(about.get("algorithm", ""))],
        ["Control steps", f"{about['steps']:,}" if "steps" in about else ""],
        ["Seed", str(about.get("seed", ""))],
        ["Learned from", " of ".join(filter(None, seasons))],
        ["Chosen by", f"the {about['chosen_on']} seasons" if "chosen_on" in about else ""],
        ["Best after", f"{best['steps']:,} steps" if "steps" in best else ""],
        ["Time", "" if hours is None else f"{hours / 3600:.1f} h"],
        ["Machine", ", ".join(filter(None, computer))],
        ["Finished", str(about.get("finished", ""))[:10]],
    ]
    recipe, learning_curve = (file.parent / str(about.get(name, "")) for name in ("settings", "learning_curve"))
    curve: list[list[float]] = []
    if learning_curve.is_file():
        with learning_curve.open(encoding="utf-8", newline="") as lines:
            points = [(float(row["steps"]), float(row["reward"])) for row in csv.DictReader(lines)]
        each = max(1, -(-len(points) // _POINTS))  # thinned to what a chart shows
        thinned = [row for place, row in enumerate(points) if place % each == 0 or place == len(points) - 1]
        curve = [[steps, float(f"{reward:.5g}")] for steps, reward in thinned]
    return {
        "file": _path_in_baselines(file),
        "rows": [row for row in rows if row[1]],
        "recipe": _settings_rows(recipe) if recipe.suffix in _TEXT and recipe.is_file() else [],
        "recipe_file": _path_in_baselines(recipe) if recipe.is_file() else None,
        "curve": curve,
    }
