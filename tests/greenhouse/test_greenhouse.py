"""Your own greenhouse: what a page may say, the parameters that follow, what the house can do, and the task it becomes."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from glbench.agents.tuned_rules import read_rule_page
from glbench.cli import greenhouse as cli
from glbench.errors import TaskError
from glbench.greenhouse import Greenhouse, design, read_page
from glbench.greenhouse.capability import balance, outdoors, screen_saving
from glbench.greenhouse.page import EMPTY_PAGE
from glbench.greenhouse.season import try_season
from glbench.greenhouse.writing import rules_text, task_text
from glbench.kernel import make_kernel
from glbench.model import PARAMETER_SETS, TOMATO
from glbench.model.plausibility import find_doubts
from glbench.tasks import get_task, list_drafts, list_tasks

VENLO = """
title = "Venlo"
[house]
floor_area = "5 ha"
gutter_height = "6.5 m"
[heating]
boiler = "5 MW"
[co2]
supply = "230 kg/ha/h"
[led_lamps]
light = "200 umol/m2/s"
power = "68 W/m2"
[energy_screen]
saving = "47 %"
"""
FLOOR = '[house]\nfloor_area = "5 ha"\n'


def page_of(folder: Path, text: str) -> Path:
    file = folder / "greenhouse.toml"
    file.write_text(text, encoding="utf-8")
    return file


def house_of(folder: Path, text: str) -> Greenhouse:
    return design(read_page(page_of(folder, text)))


def values(house: Greenhouse) -> dict[str, float]:
    vector = TOMATO.parameters.default(house.book, {entry.name: (entry.value, entry.unit) for entry in house.entries})
    return dict(zip(TOMATO.parameter_names, vector.tolist(), strict=True))


@pytest.fixture(scope="module")
def venlo(tmp_path_factory: pytest.TempPathFactory) -> Greenhouse:
    return house_of(tmp_path_factory.mktemp("venlo"), VENLO)


def test_the_parameters_of_five_hectares(venlo: Greenhouse) -> None:
    p = values(venlo)
    assert p["aFlr"] == 50_000.0
    assert p["pBoil"] == 5e6
    assert p["phiExtCo2"] == pytest.approx(230.0 * 5.0 * 1e6 / 3600.0)
    assert p["thetaLampMax"] == 68.0
    assert p["thetaLampMax"] * p["etaLampPar"] * p["zetaLampPar"] == pytest.approx(200.0)
    side, rise = math.sqrt(50_000.0), 2.0 * math.tan(math.radians(22.0))
    assert p["aCov"] == pytest.approx(50_000.0 / math.cos(math.radians(22.0)) + 4 * side * 6.5 + side * rise)
    assert (p["hAir"], p["hGh"]) == (6.3, pytest.approx(6.5 + rise / 2))
    assert p["aRoof"] / p["aFlr"] == pytest.approx(4676.0 / 40_000.0)  # the book's
    assert venlo.verdict == "usable"
    assert venlo.controls == ("uBoil", "uCo2", "uThScr", "uVent", "uLamp")
    assert any(one.startswith("roof_light: 85 %") for one in venlo.assumptions)


def test_the_books_greenhouse_comes_out_of_its_own_figures(tmp_path: Path) -> None:
    p = values(house_of(tmp_path, '[house]\nfloor_area = "4 ha"\nlength = "200 m"\ngutter_height = "6.5 m"\n'))
    assert p["aCov"] == pytest.approx(48_400.0, rel=0.01)  # Katzin (2021)
    assert (p["hAir"], p["hGh"]) == (6.3, pytest.approx(6.9, abs=0.01))
    assert p["pBoil"] == pytest.approx(12e6)


@pytest.mark.parametrize(
    ("one", "other", "name"),
    [
        ('[heating]\nboiler = "5 MW"', '[heating]\nboiler = "100 W/m2"', "pBoil"),
        ('[heating]\nboiler = "5000 kW"', '[heating]\nboiler = "1 MW/ha"', "pBoil"),
        ('[co2]\nsupply = "230 kg/ha/h"', '[co2]\nsupply = "1150 kg h-1"', "phiExtCo2"),
        ('[co2]\nsupply = "23 g/m2/h"', '[co2]\nsupply = "230 kg ha-1 h-1"', "phiExtCo2"),
        ('[heating]\npipe_diameter = "45 mm"', '[heating]\npipe_diameter = "0.045 m"', "phiPipeE"),
        ('[led_lamps]\npower = "2.5 MW"', '[led_lamps]\npower = "50 W m-2"', "thetaLampMax"),
    ],
)
def test_the_same_in_another_unit(tmp_path: Path, one: str, other: str, name: str) -> None:
    first, second = (values(house_of(tmp_path, FLOOR + text))[name] for text in (one, other))
    assert first == pytest.approx(second, rel=1e-8)
    assert first != TOMATO.parameters.info(name).values.get("led_2021")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[house]\nfloor_area = 5", 'floor_area\': 5 has no unit. Write number and unit in quotes, such as "5 ha"; units: m2, ha'),
        ('[house]\nfloor_area = "5"', "'' is no unit that fits here. Write one of m2, ha"),
        ('[house]\nfloor_area = "50 000 m2"', "'50 000 m2': write number and unit, such as \"5 ha\""),
        ("[house]\nfloor_area = \"50'000 m2\"", "write number and unit"),
        ('[house]\nfloor_area = "50.000,5 m2"', "write 50000.5, not 50.000,5"),
        ('[house]\nfloor_area = "200,000 m2"', "write 200000 or 200.000, not 200,000"),
        ('[house]\nfloor_area = "1e-3 m2"', "it must be from 1 to 10,000,000 m2"),
        (FLOOR + "gutter_height = 6,5", "line 3, 'gutter_height = 6,5': write 6.5, not 6,5"),
        (FLOOR + 'gutter_height = "6,5 m"', "'house.gutter_height': '6,5 m': write 6.5, not 6,5"),
        (FLOOR + 'gutter_height = "7 m"\nridge_height = "6 m"', "ridge_height 6 m must be above gutter_height 7 m"),
        (FLOOR + "roof_light = 0.8", "0.8 has no unit"),
        (FLOOR + '[energy_screen]\nsaving = "120 %"', "'120 %': it must be from 0 to 100 %"),
        (FLOOR + '[led_lamps]\nlight = "68 W/m2"', "'W/m2' is no unit that fits here. Write one of umol/m2/s"),
        (FLOOR + '[heating]\nboiler = "5 mW"', "'mW' is no unit that fits here. Write one of MW, kW, W, W/m2"),
        (FLOOR + '[heating]\nboiler = "-5 MW"', "it cannot be below 0"),
        (FLOOR + '[heating]\nboilr = "5 MW"', "there is no setting 'heating.boilr'. Did you mean 'boiler'?"),
        ("title = 'x'", "'house' is missing. The page that `glbench greenhouse new` writes explains each entry"),
    ],
)  # fmt: skip
def test_what_a_page_cannot_say(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(TaskError) as caught:
        read_page(page_of(tmp_path, text))
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[house]\nfloor_area = "144 m2"\n[heating]\nboiler = "2 MW"', "13,889 W for each m2 of floor; the possible range is 0 to 1,000"),
        (FLOOR + 'gutter_height = "650 m"', "Heights are in m, not in cm"),
        (FLOOR + 'roof_light = "0.8 %"', "Light that the roof lets through: 0.008; the possible range is 0.02 to 0.98"),
        (FLOOR + '[co2]\nsupply = "230 g/m2/h"', "CO2 supply: 230 g m-2 h-1; the possible range is 0 to 200"),
        (FLOOR + '[led_lamps]\nlight = "400 umol/m2/s"\npower = "68 W/m2"', "are 5.88 umol/J, and no such lamp gives more than 5.3"),
        (FLOOR + '[energy_screen]\nsaving = "90 %"', "a closed screen of the model saves"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(tmp_path: Path, text: str, words: str) -> None:
    house = house_of(tmp_path, text)
    assert house.verdict == "refused"
    assert any(words in refusal for refusal in house.refusals), house.refusals
    assert house.capability is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[heating]\nboiler = "500 kW"', "The boiler gives 10 W/m2; 18 degC at -10 degC outside would need"),
        ('[heating]\nboiler = "15 MW"', "give off less than the boiler's 300 W/m2 below 90 degC"),
        ('[co2]\nsupply = "230 kg/h"', "CO2 supply: 4.6 g m-2 h-1; the usual range is 5 to 45"),
        ('[led_lamps]\nlight = "68 umol/m2/s"\npower = "200 W/m2"', "Are light and power swapped?"),
    ],
)
def test_what_is_odd_is_doubted(tmp_path: Path, text: str, words: str) -> None:
    house = house_of(tmp_path, FLOOR + text)
    assert house.verdict == "usable, but"
    assert any(words in doubt for doubt in house.doubts), house.doubts


def test_two_kinds_of_lamps_give_their_light_together(tmp_path: Path) -> None:
    lamps = '[hps_lamps]\nlight = "110 umol/m2/s"\npower = "60 W/m2"\n[led_lamps]\nlight = "90 umol/m2/s"\npower = "30 W/m2"\n'
    p = values(house_of(tmp_path, FLOOR + lamps))
    assert p["thetaLampMax"] == 90.0
    assert p["thetaLampMax"] * p["etaLampPar"] * p["zetaLampPar"] == pytest.approx(200.0)


def test_a_house_without_equipment_lacks_its_controls_and_its_shade(tmp_path: Path) -> None:
    house = house_of(tmp_path, FLOOR)
    p = values(house)
    assert house.controls == ("uBoil", "uVent")
    assert (p["thetaLampMax"], p["phiExtCo2"], p["tauLampPar"], p["aLamp"]) == (0.0, 0.0, 1.0, 0.0)
    assert house.capability is not None
    assert house.capability.saving is None


@pytest.mark.parametrize("saving", [0.2, 0.47, 0.65])
def test_the_screen_saves_what_its_data_sheet_says(tmp_path: Path, saving: float) -> None:
    house = house_of(tmp_path, FLOOR + f'[energy_screen]\nsaving = "{100 * saving:g} %"')
    assert screen_saving(values(house)) == pytest.approx(saving, abs=0.002)


def test_a_balance_stays_when_the_model_is_simulated(venlo: Greenhouse) -> None:
    assert venlo.capability is not None
    p, cold = np.array(list(values(venlo).values())), outdoors(-10.0)
    controls = {"uBoil": 1.0, "uThScr": 1.0}
    state = balance(p, cold, **controls)
    u = np.array([controls.get(name, 0.0) for name in TOMATO.control_names])
    with make_kernel(TOMATO, step_seconds=900.0) as kernel:
        after = kernel.step(state[None], u[None], cold[None], p[None])[0]
    climate = [TOMATO.state_index(name) for name in ("tAir", "tPipe", "tCovE", "tSo5", "vpAir")]
    np.testing.assert_allclose(after[climate], state[climate], rtol=1e-3)
    assert state[climate[0]] == pytest.approx(venlo.capability.cold_temperature)
    more = balance(np.where(np.array(TOMATO.parameter_names) == "pBoil", 1.2 * p, p), cold, **controls)
    assert more[climate[0]] > state[climate[0]] + 2.0


def test_the_heat_that_is_needed_holds_the_temperature(venlo: Greenhouse) -> None:
    assert venlo.capability is not None
    p = values(venlo) | {"pBoil": venlo.capability.cold_heat * 50_000.0}
    state = balance(np.array(list(p.values())), outdoors(-10.0), uBoil=1.0, uThScr=1.0)
    assert state[TOMATO.state_index("tAir")] == pytest.approx(18.0, abs=0.01)


def test_no_greenhouse_that_ships_is_doubted() -> None:
    for name in PARAMETER_SETS:
        assert find_doubts(dict(zip(TOMATO.parameter_names, TOMATO.parameters.default(name).tolist(), strict=True))) == []
    for task in list_tasks():
        assert find_doubts(task.parameters_by_name()) == [], task.id


@pytest.mark.parametrize("base", [task.id for task in (*list_tasks(), *list_drafts()) if "rgFruit" in task.model_value.parameter_names])
def test_every_task_with_tomatoes_can_be_the_base(base: str, tmp_path: Path, venlo: Greenhouse) -> None:
    page = read_page(page_of(tmp_path, f'base = "{base}"\n{VENLO}'))
    file = tmp_path / "my_house.toml"
    file.write_text(task_text(page, venlo, "my/House-v1", "greenhouse.toml"), encoding="utf-8")
    task = get_task(file)
    expected = values(venlo)
    assert {name: value for name, value in task.parameters_by_name().items() if name in expected} == expected


def test_the_task_has_the_house_and_rules_that_fit(tmp_path: Path, venlo: Greenhouse) -> None:
    page = read_page(page_of(tmp_path, 'base = "glbench/Spring-v1"\n' + VENLO))
    file = tmp_path / "my_house.toml"
    file.write_text(task_text(page, venlo, "my/House-v1", "greenhouse.toml"), encoding="utf-8")
    task = get_task(file)
    expected = values(venlo)
    assert {name: value for name, value in task.parameters_by_name().items() if name in expected} == expected
    assert task.actuation.controls == venlo.controls
    drawn = {group.name: group.parameters for group in task.scenario.groups}
    assert "tauRfPar" not in drawn["house"]  # 0.85 and 20 % more would be more than all light
    assert "cLeakage" in drawn["house"]
    rules = tmp_path / "rules"
    rules.mkdir()
    for name, text in rules_text(page, task).items():
        (rules / name).write_text(text, encoding="utf-8")
    numbers = read_rule_page(rules / "rules.yml").numbers
    base = read_rule_page(Path(__file__).parents[2] / "baselines" / "rule_based_tuned" / "rules" / "spring.yml").numbers
    assert numbers.boiler_outside == pytest.approx(base.boiler_outside * 1.3, rel=1e-3)  # 130 W m-2 there, 100 here
    assert numbers.boiler_band == pytest.approx(base.boiler_band / 1.3, rel=1e-3)
    assert numbers.co2_band == pytest.approx(base.co2_band * 23.0 / 18.0, rel=1e-3)
    assert (numbers.lamps_from, numbers.lamps_until, numbers.lamps_radiation) == (0.0, 18.0, 250.0)
    week = get_task(file).replace({"weather.days": 3}, id="my/House-v1")
    outcome = try_season(week, rules, runs=2)
    assert (outcome.split, outcome.runs) == ("validation", 2)
    assert 2.0 < outcome.sums["heat"] < 3 * 24 * 0.1
    assert 0.0 < outcome.sums["electricity"] <= 3 * 18 * 0.068 + 1e-6


def test_years_of_weather_become_splits_and_the_last_is_the_test(tmp_path: Path, venlo: Greenhouse) -> None:
    page = read_page(page_of(tmp_path, VENLO + "[season]\nyears = [2008, 2009, 2010]"))
    file = tmp_path / "years.toml"
    file.write_text(task_text(page, venlo, "my/Years-v1", "greenhouse.toml"), encoding="utf-8")
    splits = get_task(file).splits
    assert splits is not None
    assert (splits.training.years, splits.validation.years, splits.test.years) == ((2008, 2009), (2008, 2009), (2010,))
    wrong = read_page(page_of(tmp_path, VENLO + "[season]\nyears = [2007]"))
    with pytest.raises(TaskError, match="has the whole years 2008, 2009, 2010, 2011, 2012"):
        task_text(wrong, venlo, "my/Years-v1", "greenhouse.toml")
    lettuce = read_page(page_of(tmp_path, 'base = "glbench/Lettuce-v1"\n' + VENLO))
    with pytest.raises(TaskError, match="is no greenhouse with tomatoes"):
        task_text(lettuce, venlo, "my/Years-v1", "greenhouse.toml")


def test_every_line_of_the_empty_page_can_be_filled_in(tmp_path: Path) -> None:
    text = EMPTY_PAGE.read_text(encoding="utf-8")
    filled = re.sub(r"^# (\w+ = )", r"\1", text, flags=re.MULTILINE)
    page = read_page(page_of(tmp_path, filled))
    entries = {name for table in page.model_dump().values() if isinstance(table, dict) for name in table}
    assert entries == set(re.findall(r"^# (\w+) = ", text, re.MULTILINE))
    assert page.season.years == (2021, 2022, 2023)


def test_the_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run = CliRunner()
    assert run.invoke(cli.app, ["new", "mine.toml"]).exit_code == 0
    assert (tmp_path / "mine.toml").read_text(encoding="utf-8") == EMPTY_PAGE.read_text(encoding="utf-8")
    again = run.invoke(cli.app, ["new", "mine.toml"])
    assert isinstance(again.exception, TaskError)
    page_of(tmp_path, 'base = "SpringSetpoints-v1"\n' + FLOOR)
    at_computer = run.invoke(cli.app, ["task", "greenhouse.toml", "points.toml", "--json"])
    assert json.loads(at_computer.stdout)["season"]["heat"] > 20.0
    assert "heating" in (tmp_path / "points_rules" / "settings.toml").read_text(encoding="utf-8")
    page_of(tmp_path, '[house]\nfloor_area = "144 m2"\n[heating]\nboiler = "2 MW"')
    refusal = run.invoke(cli.app, ["task", "greenhouse.toml", "my.toml", "--json"])
    assert refusal.exit_code == 1
    assert json.loads(refusal.stdout)["verdict"] == "refused"
    assert not (tmp_path / "my.toml").exists()
    assert isinstance(run.invoke(cli.app, ["task", "greenhouse.toml", "greenhouse.toml"]).exception, TaskError)
    page_of(tmp_path, 'base = "Sprong-v1"\n' + FLOOR)
    assert "Did you mean" in str(run.invoke(cli.app, ["check", "greenhouse.toml"]).exception)
    check = run.invoke(cli.app, ["check", page_of(tmp_path, VENLO).name, "--json"])
    document = json.loads(check.stdout)
    assert (check.exit_code, document["verdict"]) == (0, "usable")
    assert document["capability"]["light"] == pytest.approx(200.0)
