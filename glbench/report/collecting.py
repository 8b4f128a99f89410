"""What the page knows: tasks, agents and results as plain values, from stored results, their ranks and their profiles."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from glbench.evaluation.files import short_task_id
from glbench.evaluation.profiles import Profile
from glbench.leaderboard import Row, StoredResult, TaskTable
from glbench.leaderboard.catalogue import Catalogue, Drawn
from glbench.leaderboard.estimates import Estimate
from glbench.leaderboard.regret import PARTS
from glbench.leaderboard.statistics import SCORES, Interval
from glbench.leaderboard.suites import SuiteRow, SuiteTable
from glbench.quantities import pretty_unit
from glbench.report.settings import settings_of
from glbench.report.task_words import clock_of, definition_in_words, figures
from glbench.tasks import TaskSpec, list_suites, read_lock

_RUN_DIGITS = 7
_OF_CARD = ("authors", "description", "link", "algorithm", "training")


@dataclass(frozen=True)
class Known:
    """One stored result with its row of the leaderboard and, where there is one, its profile."""

    stored: StoredResult
    row: Row
    profile: Profile | None


def known_results(
    stored: Sequence[StoredResult], tables: Sequence[TaskTable], profiles: Mapping[tuple[str, str], Profile]
) -> list[Known]:
    """All results in the order of the leaderboards, trainings one by one; ``profiles`` are by task id and ``results_digest``.

    The digest alone will not do: it does not cover the id of the task.
    """
    by_digest = {(item.board, item.result.results_digest): item for item in stored}
    return [
        Known(by_digest[row.task_id, row.results_digest], row, profiles.get((row.task_id, row.results_digest)))
        for table in tables
        for row in table.results
    ]


class Vocabularies:
    """What everything is called, task by task: equal vocabularies once, and tasks and suites go by their numbers."""

    def __init__(self, known: Sequence[Known]) -> None:
        self._rows = [item.row for item in known]
        self._numbers: dict[str, int] = {}
        self.all: list[dict[str, Any]] = []

    def of(self, told: Catalogue, task_ids: Sequence[str], shown: Drawn | None = None) -> int:
        """The number of the words of some tasks; ``shown`` is what is drawn of a task."""
        rows = [row for row in self._rows if row.task_id in task_ids]
        units = {name: unit for row in rows for name, unit in row.units.items()}
        names = told.known_first(name for row in rows for name in row.estimates)
        metrics = sorted((told.metric(name, units) for name in names), key=lambda metric: not metric.column)
        words = {
            "metrics": [asdict(one) | {"unit": pretty_unit(one.unit), "column": one.column} for one in metrics],
            "items": [asdict(item) for item in told.items],
            "lead": told.lead,
            "caution": told.caution,
            "draws": told.draws,
            "beyond": told.beyond,
            **({} if shown is None else asdict(shown)),
        }
        number = self._numbers.setdefault(json.dumps(words, sort_keys=True), len(self.all))
        if number == len(self.all):
            self.all.append(words)
        return number


def task_facts(table: TaskTable, steps: int, step_seconds: float) -> dict[str, Any]:
    """A task as the page shows it; without its definition only what results say of it."""
    spec: TaskSpec | None = table.task
    lock, short = read_lock(), short_task_id(table.task_id)
    facts: dict[str, Any] = {
        "id": table.task_id,
        "short": table.task_id if table.task_id not in lock and short in map(short_task_id, lock) else short,
        "title": table.title,
        "digest": table.digest,
        "metric": table.metric,
        "draws": table.draws,
        "steps": steps,
        "step_seconds": step_seconds,
        "best_known": None if table.best_known is None else table.best_known.model_dump(),
        "published": table.task_id in lock and lock[table.task_id].digest == table.digest,
    }
    if spec is None:
        return facts
    return {
        **facts,
        **figures(spec),
        "start": spec.weather.start.isoformat(),
        "days": spec.weather.days,
        "clock": clock_of(spec),
        "suites": list(spec.suites),
        **({"delta": 100 * spec.uncertainty.delta} if spec.conventions.shows_delta else {}),
        "description": " ".join(spec.description.split()),
        "words": [asdict(section) for section in definition_in_words(spec)],
        "versions": _versions(table.task_id),
    }


def _versions(task_id: str) -> list[dict[str, str]]:
    """Published versions of a task, oldest first."""
    stem = task_id.rpartition("-v")[0]
    return [
        {"id": known, "digest": entry.digest, "model": entry.fingerprint.model_version}
        for known, entry in read_lock().items()
        if known.rpartition("-v")[0] == stem
    ]


def families(tables: Sequence[TaskTable]) -> list[dict[str, Any]]:
    """Suites of the paper's form of which several tasks have results and differ in delta: what the figure over delta is drawn of."""
    specs = {
        table.task_id: table.task for table in tables if table.task is not None and table.task.conventions.shows_delta
    }
    found = []
    for name, members in list_suites().items():
        tasks = sorted((m for m in members if m in specs), key=lambda m: specs[m].uncertainty.delta)
        if len({specs[m].uncertainty.delta for m in tasks}) > 1:
            found.append({"name": name, "tasks": tasks})
    return found


def suite_facts(table: SuiteTable) -> dict[str, Any]:
    """Agents over a suite: scores with intervals, means over the tasks, profiles and probabilities of improvement."""
    return {
        "name": table.suite,
        "tasks": list(table.tasks),
        "rows": [_suite_row(row) for row in table.rows],
        "thresholds": [round(x, 4) for x in table.profiles[0].thresholds] if table.profiles else [],
        "profiles": {
            one.agent: [[round(1000 * x) for x in line] for line in (one.share, one.low, one.high)]
            for one in table.profiles
        },
        "improvements": [[one.first, one.second, *_interval(one.probability)] for one in table.improvements],
    }


def _suite_row(row: SuiteRow) -> dict[str, Any]:
    figures = row.figures
    return {
        "agent": row.agent,
        "rank": row.rank,
        "runs": row.runs,
        "trainings": list(row.trainings),
        "missing": list(row.missing),
        **{name: _interval(getattr(row, name)) for name in SCORES},
        "regret": row.regret and _interval(row.regret),
        "against_rules": row.against_rules and _interval(row.against_rules),
        "figures": None
        if figures is None
        else {
            **{name: _short(value) for name, value in figures.metrics.items()},
            "failed": figures.failed,
            "decision": figures.decision_milliseconds,
            "training": figures.training_steps,
            **figures.model_dump(include={"privileged", "sandbox", "reproduced", "origin"}),
        },
    }


def _interval(interval: Interval) -> list[float]:
    return [_short(part) for part in (interval.value, interval.low, interval.high)]


def agent_facts(tables: Sequence[TaskTable], known: Sequence[Known]) -> list[dict[str, Any]]:
    """Entries by name, baselines last, so that colours of submissions do not change when a baseline is added; then their trainings."""
    of_result = {(item.row.task_id, item.row.results_digest): item.stored.result.agent for item in known}
    entries: dict[str, Any] = {}
    trainings: dict[str, str] = {}
    for table in tables:
        for row in table.rows:
            entries[row.agent] = of_result[row.task_id, row.results_digest]
            trainings |= {training_name(row, one): row.agent for one in row.trainings if row.is_range}
    ordered = sorted(entries.items(), key=lambda pair: (pair[1].kind == "baseline", pair[0]))
    facts = [
        {"name": name, "kind": one.kind, "privileged": one.privileged, "information": one.information}
        for name, one in ordered
    ]
    return facts + [{"name": name, "training_of": entry} for name, entry in sorted(trainings.items())]


def training_name(entry: Row, training: Row) -> str:
    """A name for one of several trainings. The first often has that of its entry, and gets its seed."""
    return f"{training.agent}_seed{training.training_seed}" if training.agent == entry.agent else training.agent


def entry_facts(
    entry: Row, known: Mapping[tuple[str, str], Known], blocks: Mapping[tuple[str, str], str]
) -> list[dict[str, Any]]:
    """What the page shows of one row of a leaderboard: a result, or several trainings as one and then one by one.

    ``known`` holds results by task id and ``results_digest``, ``blocks`` the names of their profiles likewise. Of several
    trainings the values are means over them, run by run, so that all that is linear in amounts can be computed again; days and seasons are
    those of the first.
    """
    items = [known[row.task_id, row.results_digest] for row in entry.results]
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
        **_told_of(entry),
        "steps": [
            float(np.mean(steps)) for steps in zip(*([run.steps for run in one.runs] for one in stored), strict=True)
        ],
        "values": {
            name: [_short(float(np.mean(runs))) for runs in zip(*(one.values(name) for one in stored), strict=True)]
            for name in entry.estimates
        },
    }
    members = [
        {
            **one,
            "agent": training_name(entry, row),
            "member_of": entry.agent,
            "training_seed": row.training_seed,
            "trainings": 0,
        }
        for one, row in zip(results, entry.trainings, strict=True)
    ]
    return [together, *members]


def result_facts(item: Known) -> dict[str, Any]:
    """A result as the page shows it, with estimates as on the leaderboard, and all metrics of all runs."""
    result, row = item.stored.result, item.row
    same = row.model_dump(include={"agent", "rank", "remark", "origin", "reproduced", "privileged", "runs", "failed"})
    return {
        "task": row.task_id,
        **same,
        "confirmed": item.stored.confirmed,
        "sees": result.agent.information,
        "seeds": list(result.evaluation.seeds),
        "reasons": [[run.seed, run.status, run.reason, run.steps] for run in result.failed],
        "decision": result.evaluation.decision_milliseconds,
        "training": _training(row),
        "digest": result.results_digest,
        "agent_digest": result.agent.digest,
        "created": result.created,
        "glbench": result.versions.glbench,
        "kernel": f"{row.kernel} {row.build}",
        "estimates": _estimates(row),
        **_told_of(row),
        "steps": None if not row.failed else [run.steps for run in result.runs],
        "values": {name: [_short(value) for value in result.values(name)] for name in row.estimates},
        **optional_facts(result.model_dump(mode="json")),
        "settings": settings_of(result, item.stored.task),
    }


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


def _told_of(row: Row) -> dict[str, Any]:
    """Notes on the worst runs, on years, on trainings and runs together, and on what the training saw."""
    overall = {name: [_short(e.overall.low), _short(e.overall.high)] for name, e in row.estimates.items() if e.overall}
    return {
        "worst_tenth": None if row.worst_tenth is None else _interval(row.worst_tenth),
        "overall": overall,
        "by_year": [[one.year, one.runs, _short(one.mean)] for one in row.by_year],
        "trained_on": row.trained_on.words,
        "saw_scored": row.saw_scored,
        "regret": _regret(row),
        **({} if row.fresh_draws is None else {"fresh_draws": row.fresh_draws.model_dump(include={"mean", "marked"})}),
    }


def _regret(row: Row) -> dict[str, Any] | None:
    """Regret and its parts, each with mean and ends; how many runs are above the best known ones, and whether that is worth a word."""
    if row.regret is None:
        return None
    parts: dict[str, Estimate | None] = {part: getattr(row.regret, part) for part in PARTS}
    return {
        **{name: one and [_short(value) for value in (one.mean, one.low, one.high)] for name, one in parts.items()},
        "ahead": row.regret.runs_ahead,
        "better": bool(row.regret.runs_ahead) and row.plan_counts and row.origin != "released",
    }


def _estimates(row: Row) -> dict[str, list[float]]:
    return {name: [_short(part) for part in (e.mean, e.low, e.high, e.iqm)] for name, e in row.estimates.items()}


def optional_facts(document: Mapping[str, Any]) -> dict[str, Any]:
    """What only some results say: how the agent was kept apart, and what its card tells of it."""
    card = document["agent"].get("card") or {}
    told = {key: card[key] for key in _OF_CARD if card.get(key)}
    return {"sandbox": document["evaluation"].get("sandbox"), "card": told or None}


def _short(value: float) -> float:
    """Seven digits are more than anybody sees."""
    return float(f"{value:.{_RUN_DIGITS}g}")
