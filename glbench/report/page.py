"""Putting the page together: data, script, style and plotly.js in one file that needs nothing else."""

from __future__ import annotations

import importlib
import json
import logging
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from glbench import __version__
from glbench.episodes.signals import KWH_A_CUBIC_METRE
from glbench.errors import ResultError
from glbench.evaluation.files import ensure_writable
from glbench.evaluation.profiles import Profile, load_profile
from glbench.extras import require
from glbench.leaderboard import StoredResult, TaskTable, rank
from glbench.leaderboard.catalogue import drawn, of_published
from glbench.leaderboard.collect import own_and_released_results, published_expectations
from glbench.leaderboard.comparisons import RESOLUTION
from glbench.leaderboard.suites import SuiteTable, suite_tables
from glbench.leaderboard.tables import SCORE_STEP
from glbench.report import collecting
from glbench.report.packing import Blocks, profile_blocks, squeezed
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


def write_report(out: Path) -> tuple[Path, Report]:
    """Make ``<out>/index.html`` from ``<out>/results`` and the released baselines, and return its path.

    Raises
    ------
    ResultError
        When there are no results, or results of different tasks stand under one id.
    GlbenchError
        When the packages of the extra ``report`` are missing, or the folder cannot be written.
    """
    require("The report", "report", "jinja2", "plotly")
    stored, problems = own_and_released_results(out)
    if not stored:
        msg = (
            f"There are no results in {out / 'results'} yet. Make one with `glbench evaluate submissions/my_agent.py`."
        )
        raise ResultError(msg)
    ensure_writable(out)
    report = replace(build_report(stored), left_out=problems)
    write_atomically(out / PAGE, report.html)
    return out / PAGE, report


def build_report(stored: Sequence[StoredResult]) -> Report:
    """The page of ``stored``. The same results give the same bytes. Raises as ``write_report`` does."""
    require("The report", "report", "jinja2", "plotly")
    profiles = _profiles(stored)
    expected = published_expectations()
    tables = rank(stored, expected)
    suites = suite_tables(stored, expected, tables)
    known = collecting.known_results(stored, tables, profiles)
    blocks = Blocks()
    data = page_data(known, tables, suites, blocks)
    missing = tuple(item.stored.path for item in known if item.profile is None)
    return Report(_html(data, blocks), data, len(known), missing)


def page_data(
    known: Sequence[collecting.Known], tables: Sequence[TaskTable], suites: Sequence[SuiteTable], blocks: Blocks
) -> dict[str, Any]:
    """Everything that the page's script reads, but the ``blocks``, which it opens when they are needed."""
    words = collecting.Vocabularies(known)
    profiles, weather = profile_blocks(known, {table.task_id: table.task for table in tables}, blocks)
    of_task = {item.row.task_id: item.stored.result.task for item in known}
    tasks = [
        {
            **collecting.task_facts(table, of_task[table.task_id].steps, of_task[table.task_id].step_seconds),
            "words_of": words.of(table.words, [table.task_id], drawn(table.task)),
            "weather": weather.get(table.task_id),
        }
        for table in tables
    ]  # fmt: skip
    shown = [table.task_id for table in tables]
    by_digest = {(item.row.task_id, item.row.results_digest): item for item in known}
    of_suites = [
        {**collecting.suite_facts(table), "words_of": words.of(of_published(table.tasks), table.tasks)}
        for table in suites
    ]
    results = [
        facts for table in tables for row in table.rows for facts in collecting.entry_facts(row, by_digest, profiles)
    ]
    return {
        "version": __version__,
        "kwh_a_cubic_metre": KWH_A_CUBIC_METRE,
        "settings": collecting.numbered(results, "settings"),
        "start": usual_task(shown) or shown[0],
        "words": words.all,
        "other_words": [[one["word"], one["meaning"]] for one in tomllib.loads(_asset("words.toml"))["word"]],
        "tasks": tasks,
        "families": collecting.families(tables),
        "resolution": RESOLUTION,
        "score_step": SCORE_STEP,
        "suites": of_suites,
        "agents": collecting.agent_facts(tables, known),
        "results": results,
    }


def _profiles(stored: Sequence[StoredResult]) -> dict[tuple[str, str], Profile]:
    """Profiles by task id and ``results_digest``; one that cannot be used is left out with a warning, as one that is missing."""
    found = {}
    for item in stored:
        try:
            profile = load_profile(item.result, item.path)
        except ResultError as error:
            logger.warning("%s", error)
            continue
        if profile is not None:
            found[item.board, item.result.results_digest] = profile
    return found


def _html(data: dict[str, Any], blocks: Blocks) -> str:
    jinja = importlib.import_module("jinja2")
    environment = jinja.Environment(
        autoescape=True, undefined=jinja.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.from_string(_asset("page.html.j2"))
    page: str = template.render(
        data=packed_data(data),
        blocks=blocks.by_name,
        plotly=_squeezed_plotly(),
        style=_asset("style.css"),
        script="\n".join(_asset(name) for name in _scripts()),
        version=__version__,
    )
    return page


@cache
def _squeezed_plotly() -> str:
    return squeezed(importlib.import_module("plotly.offline").get_plotlyjs().encode())


def packed_data(data: dict[str, Any]) -> str:
    """What the page's script reads first, compressed: letters and digits that cannot end the element they stand in.

    Text of result files is shown without characters that steer the direction of writing or a terminal that it is copied to.
    """
    return squeezed(json.dumps(_shown(data), separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode())


def _shown(part: Any) -> Any:
    """The same document with every text in it ``visible``."""
    if isinstance(part, str):
        return visible(part, keep="\n")
    if isinstance(part, dict):
        return {_shown(key): _shown(value) for key, value in part.items()}
    return [_shown(one) for one in part] if isinstance(part, list | tuple) else part


def _scripts() -> list[str]:
    folder = resources.files("glbench.report") / "assets"
    return sorted(item.name for item in folder.iterdir() if item.name.endswith(".js"))


def _asset(name: str) -> str:
    return (resources.files("glbench.report") / "assets" / name).read_text(encoding="utf-8")
