"""docs/environment.md: its examples run, its tables are complete."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator

import pytest

from glbench.env import QUANTITIES, REWARDS, info_quantities
from glbench.tasks import get_task
from glbench.tasks.vocabulary import OBSERVATION_MODULES
from tests.support import DOCS, examples_of, run_examples

PAGE = (DOCS / "environment.md").read_text(encoding="utf-8")


def rows() -> Iterator[tuple[list[str], str]]:
    """Names in the first cell of each table row, and the second cell."""
    for line in PAGE.splitlines():
        if line.startswith("| `"):
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            yield re.findall(r"`([^`]+)`", cells[0]), cells[1]


@pytest.mark.usefixtures("own_words")
def test_the_examples_run_one_after_the_other(capsys: pytest.CaptureFixture[str]) -> None:
    run_examples("environment.md", examples_of("environment.md"), {})
    assert "(3, 28)" in capsys.readouterr().out
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


def test_the_table_has_every_quantity_with_its_unit() -> None:
    told = {name: unit for names, unit in rows() for name in names}
    assert {quantity.name: told.get(quantity.name) for quantity in QUANTITIES} == {
        quantity.name: quantity.unit for quantity in QUANTITIES
    }


def test_every_number_of_info_and_every_module_is_named() -> None:
    for quantity in info_quantities(get_task("Schiphol2010-Delta10-v1")):
        assert f"`{quantity.name}`" in PAGE
    for name in (*REWARDS, *OBSERVATION_MODULES.names):
        assert f"`{name}`" in PAGE or name.startswith("published_")
