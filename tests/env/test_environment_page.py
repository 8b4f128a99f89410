"""docs/environment.md: its examples run, its tables are complete."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from glbench.env import QUANTITIES, REWARDS, info_quantities
from glbench.tasks import get_task
from glbench.tasks.vocabulary import OBSERVATION_MODULES

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "environment.md").read_text(encoding="utf-8")


def rows() -> Iterator[tuple[list[str], str]]:
    """Names in the first cell of each table row, and the second cell."""
    for line in PAGE.splitlines():
        if line.startswith("| `"):
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            yield re.findall(r"`([^`]+)`", cells[0]), cells[1]


@pytest.mark.usefixtures("own_words")
def test_the_examples_run_one_after_the_other(capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, object] = {}
    for example in re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL):
        exec(compile(example, "docs/environment.md", "exec"), names)
    assert "(3, 28)" in capsys.readouterr().out
    assert "warm_feet" in list(REWARDS)


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
