"""The page, with data, script, style and plotly.js in one file that needs nothing else; and profiles of results that have none yet."""

from __future__ import annotations

import importlib
import json
import logging
import tomllib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from glbench import __version__
from glbench.episodes.recorder import check_round
from glbench.episodes.signals import KWH_A_CUBIC_METRE
from glbench.errors import GlbenchError, ResultError, refuse
from glbench.evaluation.files import ensure_writable
from glbench.evaluation.profiles import Profile, load_profile, make_profile, profile_path
from glbench.evaluation.saving import recorded_actions, task_of_result
from glbench.extras import require
from glbench.kernel import make_kernel
from glbench.leaderboard import StoredResult, TaskTable, rank
from glbench.leaderboard.catalogue import charts_of, of_published
from glbench.leaderboard.collect import own_and_released_results, published_expectations
from glbench.leaderboard.statistics import RESOLUTION
from glbench.leaderboard.suites import SuiteTable, suite_tables
from glbench.leaderboard.tables import SCORE_STEP
from glbench.report import facts
from glbench.report.profile_encoding import Blocks, profile_blocks, squeezed
from glbench.resources import write_atomically
from glbench.tasks import usual_task
from glbench.untrusted import visible

PAGE = "index.html"
logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Report:
    """The page, what it was made from, and the results of which it cannot show days and seasons."""

    html: str
    data: dict[str, Any]
    results: int
    without_profile: tuple[Path, ...]
    left_out: tuple[ResultError, ...] = ()
    """Why result files are left out."""
    sealed: bool = False
    """Whether it shows runs of a sealed round."""


def write_report(out: Path) -> tuple[Path, Report]:
    """Make ``<out>/index.html`` from ``<out>/results`` and the released baselines, and return its path.

    Raises ``ResultError`` when there are no results, or results of different tasks stand under one id, and ``GlbenchError`` when the
    packages of the extra ``report`` are missing, or the folder cannot be written.
    """
    require("The report", "report", "jinja2", "plotly")
    stored, problems = own_and_released_results(out)
    if not stored:
        refuse(f"There are no results in {out / 'results'} yet. Make one with `glbench evaluate submissions/my_agent.py`.", ResultError)
    ensure_writable(out)
    report = replace(build_report(stored), left_out=problems)
    write_atomically(out / PAGE, report.html)
    return out / PAGE, report


def build_report(stored: Sequence[StoredResult]) -> Report:
    """The page of ``stored``. The same results give the same bytes. Raises as ``write_report`` does."""
    require("The report", "report", "jinja2", "plotly")
    profiles: dict[tuple[str, str], Profile] = {}
    for item in stored:
        try:
            profile = load_profile(item.result, item.path)
        except ResultError as error:  # as one that is missing
            logger.warning("%s", error)
            continue
        if profile is not None:
            profiles[item.board, item.result.results_digest] = profile
    expected = published_expectations()
    tables = rank(stored, expected)
    entries = facts.report_entries(stored, tables, profiles)
    blocks = Blocks()
    data = page_data(entries, tables, suite_tables(stored, expected, tables), blocks)
    page: str = jinja_environment().from_string(asset("page.html.j2")).render(
        data=packed_data(data),
        blocks=blocks.by_name,
        plotly=_plotly(),
        style=asset("style.css"),
        script="\n".join(asset(name) for name in script_names()),
        version=__version__,
    )  # fmt: skip
    return Report(
        page,
        data,
        len(entries),
        tuple(item.stored.path for item in entries if item.profile is None),
        sealed=any(item.profile is not None and item.stored.result.task.salt_commitment is not None for item in entries),
    )


def page_data(
    entries: Sequence[facts.ReportEntry], tables: Sequence[TaskTable], suites: Sequence[SuiteTable], blocks: Blocks
) -> dict[str, Any]:
    """Everything that the page's script reads, but the ``blocks``, which it opens when they are needed."""
    labels = facts.LabelSets(entries)
    profiles, weather = profile_blocks(entries, {table.task_id: table.task for table in tables}, blocks)
    of_task = {item.row.task_id: item.stored.result.task for item in entries}
    tasks = [
        {
            **facts.task_facts(table, of_task[table.task_id].steps, of_task[table.task_id].step_seconds),
            "words_of": labels.of(table.words, [table.task_id], charts_of(table.task)),
            "weather": weather.get(table.task_id),
        }
        for table in tables
    ]
    task_ids = [table.task_id for table in tables]
    by_digest = {(item.row.task_id, item.row.results_digest): item for item in entries}
    of_suites = [{**facts.suite_facts(table), "words_of": labels.of(of_published(table.tasks), table.tasks)} for table in suites]
    results = [one for table in tables for row in table.rows for one in facts.entry_facts(row, by_digest, profiles)]
    return {
        "version": __version__,
        "kwh_a_cubic_metre": KWH_A_CUBIC_METRE,
        "settings": facts.numbered(results, "settings"),
        "start": usual_task(task_ids) or task_ids[0],
        "words": labels.all,
        "other_words": [[one["word"], one["meaning"], one.get("marks", [])] for one in tomllib.loads(asset("words.toml"))["word"]],
        "tasks": tasks,
        "families": facts.families(tables),
        "resolution": RESOLUTION,
        "score_step": SCORE_STEP,
        "suites": of_suites,
        "agents": facts.agent_facts(tables, entries),
        "results": results,
    }


@cache
def _plotly() -> str:
    return squeezed(importlib.import_module("plotly.offline").get_plotlyjs().encode())


def packed_data(data: dict[str, Any]) -> str:
    """What the page's script reads first, compressed: letters and digits that cannot end the element they stand in.

    Text of result files is shown without characters that steer the direction of writing or a terminal that it is copied to.
    """
    return squeezed(json.dumps(_visible(data), separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode())


def _visible(part: Any) -> Any:
    """The same document with every text in it ``visible``."""
    if isinstance(part, str):
        return visible(part, keep="\n")
    if isinstance(part, dict):
        return {_visible(key): _visible(value) for key, value in part.items()}
    return [_visible(one) for one in part] if isinstance(part, list | tuple) else part


def jinja_environment() -> Any:
    """A Jinja environment that escapes text and refuses unknown names."""
    jinja = importlib.import_module("jinja2")
    return jinja.Environment(autoescape=True, undefined=jinja.StrictUndefined, trim_blocks=True, lstrip_blocks=True)


def asset(name: str) -> str:
    """Text of a file of the page."""
    return (resources.files("glbench.report") / "assets" / name).read_text(encoding="utf-8")


def script_names() -> list[str]:
    """Files of the page's script, in their order."""
    folder = resources.files("glbench.report") / "assets"
    return sorted(item.name for item in folder.iterdir() if item.name.endswith(".js"))


@dataclass(frozen=True)
class Completion:
    """The new ``profiles``, and results that cannot have one here, with the reason."""

    profiles: tuple[Path, ...]
    impossible: tuple[tuple[Path, str], ...]


def complete_profiles(stored: Iterable[StoredResult], workers: int = 1, progress: Callable[[Path], None] | None = None) -> Completion:
    """Make the profiles that are missing; results stay as they are. ``progress`` is called with each result that is replayed.

    Raises ``GlbenchError`` when a profile cannot be written, or one that is there was changed.
    """
    profiles, impossible = [], []
    for item in stored:
        if load_profile(item.result, item.path) is not None:
            continue
        try:
            task = task_of_result(item.result, item.path)
            log = recorded_actions(item.result, item.path)
            check_round(task, log.provenance)
        except GlbenchError as error:
            impossible.append((item.path, str(error)))
            continue
        if progress is not None:
            progress(item.path)
        with make_kernel(task.model_value, task.step_seconds, workers=workers) as kernel:
            profile = make_profile(task, item.result, log, None, kernel)
        write_atomically(profile_path(item.path), profile.to_bytes())
        profiles.append(profile_path(item.path))
    return Completion(tuple(profiles), tuple(impossible))
