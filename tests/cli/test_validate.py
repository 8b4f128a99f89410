"""``glbench validate``: tables, files and refusals."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.cli.command_line import Command
from tests.realism.made import Made


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = Made(days=1)
    made.resources["Bert"]["ElecHigh"] = 5.0  # more than all lamps give
    return made.write(tmp_path / "archive")


def test_tables_files_and_notes(glbench: Command, folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    answer = glbench("validate", folder, "--set", "paper", "--set", "mixed_2021", "--out", out)
    assert answer.code == 0, answer.err
    for words in (
        "2020-02-10 to 2020-02-10: heat in MJ/m2, fruit in kg/m2",
        "paper",
        "mixed_2021",
        "Anna",
        "Bert",
    ):
        assert words in answer.out
    assert "…" not in answer.out, "a table is too wide for 80 columns"
    assert "Growers differ by 0.50 MJ/m2/d in one weather" in answer.out
    assert re.search(
        r"by their formula the simulated pipes give off, in MJ/m2: paper \d+, mixed_2021 \d+\.",
        " ".join(answer.out.split()),
        re.I,
    )
    assert "paper, Bert: of 5.75 kWh/m2 measured (lamps) the simulation used 3.04, which is all that is installed" in " ".join(
        answer.err.split()
    )
    assert "mind the archive's licence" in answer.err
    assert (out / "comparison.png").read_bytes().startswith(b"\x89PNG")
    stored = json.loads((out / "comparison.json").read_text())
    assert [house["name"] for house in stored["houses"]] == ["paper", "mixed_2021"]


def test_json_and_nothing_else(glbench: Command, folder: Path) -> None:
    answer = glbench("validate", folder, "--set", "hps_2021", "--warmer", "-1", "--json")
    assert answer.code == 0, answer.err
    told = json.loads(answer.out)
    assert (told["first"], told["warmer"], len(told["houses"])) == ("2020-02-10", -1.0, 1)


def test_refusals_are_said_in_words(glbench: Command, folder: Path, tmp_path: Path) -> None:
    answer = glbench("validate", tmp_path / "none")
    assert answer.code == 1
    assert "Error: There is no folder" in answer.err
    answer = glbench("validate", folder, "--set", "papers")
    assert answer.code == 1
    assert "no parameter set 'papers' to compare. Did you mean 'paper'" in answer.err
    answer = glbench("validate", folder, "--settings", tmp_path / "page.toml")
    assert answer.code == 1
    assert "cannot be used: it cannot be read" in answer.err
