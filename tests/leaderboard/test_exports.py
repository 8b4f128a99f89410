"""The leaderboard as JSON with its schema, and as LaTeX."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import pandas as pd
import pytest

from glbench.evaluation import load_result
from glbench.leaderboard import rank, to_frame
from glbench.leaderboard.catalogue import unknown_metric
from glbench.leaderboard.entries import resolution_of
from glbench.leaderboard.statistics import Estimate
from glbench.leaderboard.suites import suite_table
from glbench.leaderboard.tables import format_estimate, json_schema, number_text, steps_text, to_json, to_latex, to_markdown
from glbench.tasks.references import References
from tests.leaderboard.synthetic import MONEY, TASK, make_result, result_with, stored

SCHEMA = Path(__file__).resolve().parents[2] / "docs" / "schema" / "leaderboard.schema.json"


@pytest.fixture
def tables(store):
    return rank([store("first_agent", [50.0, 51.0, 52.0]), store("second", [1.0, 2.0, 3.0], privileged=True)], {})


@pytest.fixture
def suite(store):
    references = References(zero=0.0, zero_agent="do_nothing", zero_results_digest="", best=60.0, best_agent="x", best_results_digest="")
    scores = {TASK: {"first_agent": store("first_agent", [50.0, 51.0, 52.0]).result.values("reward")}}
    return suite_table("meadows", (TASK,), {k: {a: _array(v) for a, v in s.items()} for k, s in scores.items()}, {TASK: references})


def _array(values):
    import numpy as np

    return np.array(values)


def test_the_published_schema_is_that_of_the_code():
    assert SCHEMA.read_text(encoding="utf-8") == json_schema()


def test_the_json_fits_its_schema_and_holds_the_tables(tables, suite):
    document = json.loads(to_json(tables, [suite]))
    jsonschema.validate(document, json.loads(json_schema()))
    rows = document["tasks"][0]["rows"]
    assert [(row["rank"], row["agent"]) for row in rows] == [(1, "first_agent"), (2, "second")]
    assert rows[0]["metrics"]["reward"]["mean"] == 51.0
    assert document["suites"][0]["rows"][0]["mean"]["value"] == pytest.approx(0.85)
    assert document["units"]["epi"] == "EUR m-2"


def test_latex_escapes_names_marks_the_privileged_and_has_units(tables):
    text = to_latex(tables[0])
    assert r"first\_agent" in text
    assert r"second\dag" in text
    assert "EPI [EUR/m$^2$]" in text
    assert text.count(r"\\") == 6, "a table of scores and one of resources"
    assert "Yield, fresh [kg/m$^2$]" in text
    assert "Training [steps]" in text


def test_a_unit_that_differs_between_tasks_stands_beside_each_row(store):
    points = store("first", [50.0, 51.0])
    money = make_result("first", [5.0, 6.0], task_id="glbench/Orchard-v1", task_digest="0" * 64)
    tables = rank([points, stored(money.model_copy(update={"units": money.units | MONEY}))], {})
    frame = to_frame(tables)
    assert dict(zip(frame["task"], frame["reward_unit"], strict=True)) == {TASK: "-", "glbench/Orchard-v1": "EUR m-2"}
    assert not [name for name in frame if name.startswith(("reward_", "penalty_", "entry_reward_")) and "[" in name]
    assert "epi_mean [EUR m-2]" in frame
    document = json.loads(to_json(tables))
    assert not {"reward", "penalty"} & document["units"].keys()
    assert [table["units"]["reward"] for table in document["tasks"]] == ["-", "EUR m-2"]


def test_the_released_tables_have_the_units_of_the_results() -> None:
    released = Path(__file__).resolve().parents[2] / "reports" / "released"
    table, suites = pd.read_csv(released / "leaderboard.csv"), pd.read_csv(released / "leaderboard.suites.csv")
    units = {task.removeprefix("glbench/"): set(of["reward_unit"].str.removeprefix("'")) for task, of in table.groupby("task")}
    assert units["Schiphol2010-Delta10-v1"] == {"-"}
    assert units["Spring-v1"] == units["GreenhouseReal-v1"] == {"EUR m-2"}
    for task, own in units.items():
        file = next(file for file in (released / "results" / task).glob("*.json") if not file.name.endswith(".proof.json"))
        assert own == {load_result(file).units["reward"]}
    of_paper = set(suites.loc[suites["suite"] == "paper", "reward_unit"])
    assert of_paper == {"'-"}  # the apostrophe keeps a spreadsheet from reading the minus as a formula
    assert set(suites.loc[suites["suite"] == "control-2025", "penalty_unit"]) == {"EUR m-2"}


def test_a_task_that_is_not_known_has_the_units_of_its_results() -> None:
    (table,) = rank([stored(result_with("money", [5.0, 6.0], [1.0, 2.0], task_id="mylab/Own-v1"))], {})
    text = to_markdown([table], {})
    assert table.task is None
    assert "Score [EUR/m²]" in text
    assert "Violations [EUR/m²]" in text
    assert "have no unit" not in text
    assert "differs by less than" not in text
    assert resolution_of("reward", None, {"reward": "EUR m-2"}) == 0.0


@pytest.mark.parametrize(
    ("steps", "text"),
    [(0, "0"), (999, "999"), (999_499, "999k"), (999_500, "1M"), (2_018_000, "2.02M"), (10**9, "1,000M"), (10**13, "10,000,000M")],
)
def test_steps_of_a_training_have_no_powers_of_ten(steps: int, text: str) -> None:
    assert steps_text(steps) == text


def test_what_rounds_to_zero_has_no_sign() -> None:
    assert number_text(-0.0004, 2) == "0.00"
    assert format_estimate(Estimate(mean=-0.0004, iqm=0.0, low=-0.0009, high=0.004), 2) == "0.00 [0.00, 0.00]"
    assert unknown_metric("drift", "K").number(-0.0004) == unknown_metric("drift", "K").text(-0.0004) == "0.00"
