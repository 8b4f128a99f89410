"""``glbench identify``: a set that can be simulated, a report, and refusals."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest

from glbench.realism import HOUSES, read_settings
from glbench.realism.houses import model, parameters, read_house
from tests.cli.command_line import Command
from tests.realism.made import Made


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = Made(days=16)
    made.climate["Anna"] = made.indoors()
    return made.write(tmp_path_factory.mktemp("measured") / "archive")


@pytest.mark.slow
def test_a_set_a_report_and_a_second_call_that_computes_nothing(glbench: Command, folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "my_house"
    command = ("identify", folder, "--out", out, "--parameters", "cover_light,rSMin", "--split", "weeks")
    answer = glbench(*command)
    assert answer.code == 0, answer.err
    report = (out / "report.md").read_text()
    assert answer.out.strip() == report.strip()
    for words in (
        "# Fitted to Anna",
        "Anna, 2020-02-10 to 2020-02-25",
        "| even weeks, fitted | before |",
        "| odd weeks, held out | after |",
        "Sunlight that the cover lets through, dirt and construction included. (tauRfPar, tauRfNir)",
        "`",
    ):
        assert words in report
    assert "even weeks: 1 point computed" in answer.err
    page = tomllib.loads((out / "identified.toml").read_text())
    numbers = page["identified"]["numbers"]
    assert list(numbers) == ["cover_light", "rSMin"]
    house = read_house(out / "identified.toml")
    assert (house.name, house.model, house.parameters) == ("my_house", "greenlight-tomato-harvest-1.0.0", "led_2020")
    values = dict(zip(model().parameters.names, parameters(house, read_settings()).tolist(), strict=True))
    before = dict(zip(model().parameters.names, parameters(HOUSES["mixed_2020"], read_settings()).tolist(), strict=True))
    assert values["rSMin"] / before["rSMin"] == pytest.approx(numbers["rSMin"]["value"])
    assert values["tauRfNir"] / before["tauRfNir"] == pytest.approx(numbers["cover_light"]["value"])
    assert values["thetaLampMax"] == pytest.approx(142.52), "the lamps as they were measured"
    assert values["etaLampPar"] == pytest.approx(before["etaLampPar"])
    simulated = glbench("validate", folder, "--set", out / "identified.toml", "--by", "actuators", "--json")
    validated = json.loads(simulated.out)["compartments"][0]["houses"][0]
    assert validated["name"] == "my_house"
    for channel, rmse in page["identified"]["rmse"]["odd weeks"].items():
        assert validated["weeks"]["odd"][channel]["rmse"] == pytest.approx(rmse, rel=1e-9), "the page is the house that was fitted"
    again = glbench(*command, "--json")
    assert "points computed" not in again.err
    document = json.loads(again.out)["weeks"]
    assert document["numbers"]["rSMin"]["value"] == numbers["rSMin"]["value"]
    assert document["after"]["odd weeks"]["co2"]["rmse"] == page["identified"]["rmse"]["odd weeks"]["co2"]
    assert glbench("identify", folder, "--out", out, "--parameters", "vents").code == 1, "another fit is not mixed into it"


def test_refusals_are_said_in_words(glbench: Command, folder: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.toml"
    page.write_text('[weights]\nair_temperature = 1.0\nhumidity = 5.0\n\n[parameters.vents]\nmultiplies = ["cDgh"]\n')
    for arguments, words in (
        (("--parameters", "vent"), "no parameter 'vent'"),
        (("--set", "paper_2020"), "There is no parameter set 'paper_2020' to compare"),
        (("--model", "greenlight-tomato-9"), "There is no version 9 of the model"),
        (("--compartment", "Bert"), "has these: Anna"),
        (("--split", "months"), "There is no split 'months'"),
        (("--page", page), "weights"),
        (("--set", tmp_path / "none.toml"), "The page of the house"),
    ):
        answer = glbench("identify", folder, "--out", tmp_path / "out", *arguments)
        assert answer.code == 1
        assert words in answer.err
