"""docs/environment.md and observations.md: their examples run, their tables are complete."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator

import pytest

from glbench.env import REWARDS, info_quantities
from glbench.tasks import DEFAULT_TASK, get_task
from glbench.tasks.vocabulary import OBSERVATION_MODULES
from tests.support import DOCS, examples_of, run_examples

PAPER = "Schiphol2010-Delta10-v1"
PAGE = (DOCS / "environment.md").read_text(encoding="utf-8")
OBSERVATIONS = (DOCS / "observations.md").read_text(encoding="utf-8")


def rows() -> Iterator[tuple[list[str], list[str]]]:
    """Names in the first cell of each row of the table of quantities, and the other cells: two units, and the meaning."""
    for line in PAGE[PAGE.index("## Info and quantities") : PAGE.index("## Seeds")].splitlines():
        if line.startswith("| `"):
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            yield re.findall(r"`([^`]+)`", cells[0]), cells[1:]


@pytest.mark.usefixtures("own_words")
def test_the_examples_run_one_after_the_other(capsys: pytest.CaptureFixture[str]) -> None:
    run_examples("environment.md", examples_of("environment.md"), {})
    run_examples("observations.md", examples_of("observations.md"), {})
    assert f"(3, {len(get_task(DEFAULT_TASK).model_value.states)})" in capsys.readouterr().out
    assert "warm_feet" in list(REWARDS)


def test_the_speeds_are_those_of_the_stored_measurements() -> None:
    measured = {
        one["name"]: one["microseconds"]
        for one in json.loads((DOCS / "measurements" / "speed.json").read_text(encoding="utf-8"))["measurements"]
    }
    for preset in ("reference", "standard", "fast"):
        (row,) = re.findall(rf"^\| `{preset}` \|.*\| ([\d.]+) \| ([\d.]+) \|$", PAGE, flags=re.MULTILINE)
        assert row == tuple(f"{measured[f'{group}/{preset}/walk']:.1f}" for group in ("step", "batch"))
    text = PAGE.replace("\n", " ")
    single, batched = measured["env/reference"], [measured[f"vector/{n}"] for n in (8, 512)]
    assert f"takes {single:.0f} us with the default and {measured['env/standard']:.0f} us with `standard`" in text
    rows = f"takes {batched[0]:.1f} us with 8 rows and {batched[1]:.1f} us with 512"
    assert f"{rows}, {single / batched[0]:.0f} and {single / batched[1]:.0f} times less" in text


@pytest.mark.parametrize(("column", "task"), [(0, DEFAULT_TASK), (1, PAPER)])
def test_the_table_has_every_quantity_of_a_step_with_its_unit_and_no_other(column: int, task: str) -> None:
    told = {name: cells[column] for names, cells in rows() for name in names if cells[column]}
    quantities = list(info_quantities(get_task(task)))
    of_a_step = quantities[[quantity.name for quantity in quantities].index("step_reward") :]
    assert told == {quantity.name: quantity.unit for quantity in of_a_step}


def test_the_page_says_what_the_reward_is_made_of_and_which_seeds_are_scored() -> None:
    text = PAGE.replace("\n", " ")
    for task, words in ((DEFAULT_TASK, f"`{get_task(DEFAULT_TASK).short_id}` has"), (PAPER, "The paper's tasks have")):
        assert f"{words} {' and '.join(f'`{name}`' for name in get_task(task).file.reward.modules)}" in text
    usual, paper = (get_task(task).evaluation.seeds for task in (DEFAULT_TASK, PAPER))
    assert f"{usual[0]} to {usual[-1]} in `{get_task(DEFAULT_TASK).short_id}`" in text
    assert f"{paper[0]} to {paper[-1]} in the paper's tasks" in text


@pytest.mark.parametrize("task", [DEFAULT_TASK, PAPER])
def test_every_number_of_info_and_every_module_is_named(task: str) -> None:
    for quantity in info_quantities(get_task(task)):
        assert f"`{quantity.name}`" in PAGE
    assert [name for name in REWARDS if f"`{name}`" not in PAGE] == []
    assert [name for name in OBSERVATION_MODULES.names if f"`{name}`" not in OBSERVATIONS] == []
