"""The catalogue of quantities: complete, said once, and what files hold is as it was."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

import glbench
from glbench import quantities
from glbench.env.info import info_quantities
from glbench.episodes.signals import signals_of
from glbench.evaluation.metrics import metrics_of
from glbench.evaluation.profiles.building import columns_of
from glbench.leaderboard.catalogue import Metric, catalogue, charts_of
from glbench.quantities import Entry
from glbench.tasks import get_task

PACKAGE = Path(glbench.__file__).parent
GOLDEN = json.loads((Path(__file__).parents[1] / "golden" / "quantities.json").read_text(encoding="utf-8"))
EVERY = [entry for group in quantities.GROUPS.values() for entry in group.values()]


def named(columns: Iterable[Any]) -> list[list[str]]:
    """Name, unit and meaning of columns."""
    return [[one.name, one.unit, one.meaning] for one in columns]


@pytest.mark.parametrize("task_id", GOLDEN)
def test_names_units_and_meanings_of_what_files_hold_never_change(task_id: str) -> None:
    """What observations, info, results, records and profiles call their columns, in their order."""
    task, golden = get_task(task_id), GOLDEN[task_id]
    assert named(info_quantities(task)) == golden["info"]
    observed = [[one.name, one.unit, one.meaning, one.low, one.high] for one in task.observed()]
    assert observed[: len(golden["observed"])] == golden["observed"]
    assert named(metrics_of(task)) == golden["metrics"]
    groups = signals_of(task).groups(task.actuation.controls, controls=False)
    assert {group.name: named(group.columns) for group in groups if group.name != "action"} == golden["record"]
    profile = [[one.name, one.unit, one.meaning, one.kind] for one in columns_of(task).all]
    assert profile == golden["profile"]


def test_every_entry_has_what_its_readers_need() -> None:
    names = [entry.name for entry in EVERY]
    assert len(set(names)) == len(names)
    known = {one.name for one in fields(Metric)}
    for entry in EVERY:
        for words in (entry.metric, entry.money, entry.amount):
            assert words.keys() <= known | {"elsewhere", "money"}
        assert not entry.metric or {"kind", "decimals", "line", "better", "explanation"} <= entry.metric.keys()
        assert not entry.chart or "decimals" in entry.chart
        assert entry.label or not (entry.chart or entry.metric or entry.page)
    for words in quantities.charts().values():
        assert {"name", "label", "unit", "decimals"} <= words.keys()
    colours = [entry.colour for entry in quantities.FLOWS.values() if entry.colour is not None]
    assert len(set(colours)) == len(colours)


def texts(entry: Entry) -> Iterable[str]:
    """The words of an entry that are long enough to be recognised."""
    said = (entry.label, entry.meaning, entry.at_end, entry.summed, entry.day, entry.amount_label, entry.gas, entry.price_of)
    return (text for text in said if len(text) > 11)


def test_what_the_catalogue_says_is_said_nowhere_else() -> None:
    """No label and no meaning stands in quotes in another file of the package."""
    files = [path for suffix in ("py", "js", "toml") for path in PACKAGE.rglob(f"*.{suffix}")]
    elsewhere = "\n".join(path.read_text(encoding="utf-8") for path in files if path.name != "quantities.toml")
    quoted = set(re.findall(r'"([^"\n]{12,})"', elsewhere))
    assert {text for entry in EVERY for text in texts(entry)} & quoted == set()


def test_a_label_of_a_ledger_wins_over_the_catalogue() -> None:
    assert quantities.known_flow("electricity", "Electricity") is quantities.FLOWS["electricity"]
    assert quantities.known_flow("co2_dosed", "CO2") is quantities.FLOWS["co2_dosed"]
    assert quantities.known_flow("heat", "District heat") is None
    assert quantities.known_flow("water", "Water") is None


def test_viewer_board_and_report_call_known_items_alike() -> None:
    for task_id in GOLDEN:
        task = get_task(task_id)
        labels = {item.money: item.label for item in catalogue(task).items}
        lines = {line.name: line.title for line in signals_of(task).accounts if line.kind in ("earned", "paid")}
        assert {name: label.replace("CO2", "CO₂") for name, label in labels.items()} == lines
        assert charts_of(task).series["air_temperature"]["label"] == quantities.AIR["air_temperature"].label
