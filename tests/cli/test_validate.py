"""``glbench validate``: tables, files and refusals."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.cli.command_line import Command
from tests.realism.made import Made, own_export


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = Made(days=1)
    made.resources["Bert"]["ElecHigh"] = 5.0  # more than all lamps give
    return made.write(tmp_path / "archive")


def test_tables_files_and_notes(glbench: Command, folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    answer = glbench("validate", folder, "--set", "paper", "--set", "mixed_2021", "--out", out)
    assert answer.code == 0, answer.err
    for words in ("2020-02-10 to 2020-02-10: heat in MJ/m2, fruit in kg/m2", "paper", "mixed_2021", "Anna", "Bert"):
        assert words in answer.out
    assert "…" not in answer.out, "a table is too wide for 80 columns"
    assert "Growers differ by 0.50 MJ/m2/d in one weather" in answer.out
    assert re.search(
        r"by their formula the simulated pipes give off, in MJ/m2: paper \d+, mixed_2021 \d+\.", " ".join(answer.out.split()), re.I
    )
    assert "paper, Bert: of 5.75 kWh/m2 measured (lamps) the simulation used 3.04, which is all that is installed" in " ".join(
        answer.err.split()
    )
    assert "mind the archive's licence" in answer.err
    assert (out / "comparison.png").read_bytes().startswith(b"\x89PNG")
    stored = json.loads((out / "comparison.json").read_text())
    assert [house["name"] for house in stored["houses"]] == ["paper", "mixed_2021"]


def test_the_climate_by_actuators(glbench: Command, tmp_path: Path) -> None:
    made = Made(days=1)
    made.climate["Bert"] = made.indoors()
    made.climate["Bert"].loc[40, "CO2air"] = -499.0
    folder, out = made.write(tmp_path / "archive"), tmp_path / "out"
    answer = glbench("validate", folder, "--set", "paper", "--set", "hps_2020", "--by", "actuators", "--out", out)
    assert answer.code == 0, answer.err
    words = " ".join(answer.out.split())
    assert "Bert, 2020-02-10 to 2020-02-10, by actuators: temperature, humidity, CO2" in words
    for row in ("paper", "hps_2020", "2020-02", "0-3", "21-24", "even"):
        assert re.search(rf"{row} +\d+\.\d\d +[-+]\d+\.\d\d +\d+\.\d +[-+]\d+\.\d +\d+ +[-+]\d+ *$", answer.out, re.M), row
    assert "fruit" not in words
    assert "The climate of Bert is usable." in words
    assert "co2: 1 reading taken out (1 outside 100 to 5000 ppm), the first -499 ppm at 2020-02-10 03:20" in " ".join(answer.err.split())
    stored = json.loads((out / "climate.json").read_text())
    assert [one["name"] for one in stored["compartments"]] == ["Bert"]
    assert stored["compartments"][0]["houses"][0]["overall"]["co2"]["readings"] == 287
    for name in ("mean-days-Bert.png", "errors-Bert.png"):
        assert (out / name).read_bytes().startswith(b"\x89PNG")
    assert not (out / "comparison.json").exists()


def test_both_comparisons_where_there_is_a_climate(glbench: Command, tmp_path: Path) -> None:
    made = Made(days=1)
    made.climate["Bert"] = made.indoors()
    answer = glbench("validate", made.write(tmp_path / "archive"), "--set", "hps_2020", "--json")
    assert answer.code == 0, answer.err
    both = json.loads(answer.out)
    assert (both["actuators"]["first"], len(both["set_points"]["houses"][0]["compartments"])) == ("2020-02-10", 2)


def test_an_export_of_ones_own(glbench: Command, tmp_path: Path) -> None:
    folder = own_export(Made(days=1), tmp_path / "house")
    answer = glbench("validate", folder, "--set", "hps_2020")
    assert answer.code == 0, answer.err
    words = " ".join(answer.out.split())
    assert "house, 2020-02-10 to 2020-02-10, by actuators" in words
    assert "The climate of house is usable, but:" in words
    assert "1 whole day is few" in " ".join(answer.err.split())
    answer = glbench("validate", folder, "--by", "set-points")
    assert answer.code == 1
    assert "An export has no heat and harvest of a day" in answer.err
    (folder / "weather.csv").unlink()
    answer = glbench("validate", folder)
    assert answer.code == 1
    assert "has no weather.csv, and indoor.csv no columns of the weather" in " ".join(answer.err.split())


def test_json_and_nothing_else(glbench: Command, folder: Path) -> None:
    answer = glbench("validate", folder, "--set", "hps_2021", "--warmer", "-1", "--json")
    assert answer.code == 0, answer.err
    told = json.loads(answer.out)
    assert (told["first"], told["warmer"], len(told["houses"])) == ("2020-02-10", -1.0, 1)


def test_refusals_are_said_in_words(glbench: Command, folder: Path, tmp_path: Path) -> None:
    answer = glbench("validate", tmp_path / "none")
    assert answer.code == 1
    assert "Error: There is no folder" in answer.err
    answer = glbench("validate", folder, "--by", "actuators")
    assert answer.code == 1
    assert "has an indoor climate (GreenhouseClimate.csv). Add one" in " ".join(answer.err.split())
    for choice in (("--by", "actuators"), ("--agents", "rule_based")):
        answer = glbench("validate", folder, "--warmer", "1", *choice)
        assert answer.code == 1
        assert "--warmer shifts set points, and no set points are compared here" in " ".join(answer.err.split())
    answer = glbench("validate", folder, "--agents", "rule_based", "--by", "actuators")
    assert (answer.code, "--agents compares money alone" in answer.err) == (1, True)
    answer = glbench("validate", folder, "--set", "papers")
    assert answer.code == 1
    assert "no parameter set 'papers' to compare. Did you mean 'paper'" in answer.err
    answer = glbench("validate", folder, "--settings", tmp_path / "page.toml")
    assert answer.code == 1
    assert "cannot be used: it cannot be read" in answer.err


def test_what_agents_would_have_earned(glbench: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLBENCH_DATA", str(tmp_path / "data"))
    made = Made(days=1)
    made.sold(first=0)
    made.climate["Anna"] = made.indoors().assign(t_ventlee_vip=24.0)
    out = tmp_path / "out"
    answer = glbench("validate", made.write(tmp_path / "archive"), "--agents", "rule_based_tuned, nobody", "--out", out)
    assert answer.code == 0, answer.err
    for words in ("Measured, 2020-02-10 to 2020-02-10", "Simulated in bleiswijk_2020", "rule_based_tuned", "0.8 kg", "2 kWh"):
        assert words in answer.out, words
    assert "…" not in answer.out, "a table is too wide for 80 columns"
    assert "nobody has no row in bleiswijk_2020" in " ".join(answer.err.split())
    stored = json.loads((out / "board.json").read_text())
    assert [one["house"] for one in stored["accounts"]] == [None, None, "bleiswijk_2020", "bleiswijk_2020"]
