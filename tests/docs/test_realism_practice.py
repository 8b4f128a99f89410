"""Whole seasons beside practice: what is stored belongs to the task as it is, heat balances close, and changed numbers reach the agent."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from docs import growers_table
from docs import realism_practice as practice
from glbench.tasks import get_task

FOUND = practice.read()
PAGE = "\n".join(f"<!-- {name} -->\n<!-- end -->" for name in practice.TABLES)


def test_everything_was_grown_in_the_task_as_it_is() -> None:
    assert FOUND["digest"] == get_task(FOUND["task"]).digest
    assert (FOUND["split"], tuple(FOUND["seeds"])) == (practice.SPLIT, practice.SEEDS)
    assert list(FOUND["grown"]) == list(practice.jobs())


def test_the_seasons_are_those_of_the_growers_page() -> None:
    for strategy in ("lit", "unlit"):
        other = growers_table.read()["strategies"][strategy]
        one = FOUND["grown"][f"season/led_2021/tuned_{strategy}"]
        assert one["gas"] == pytest.approx(growers_table.gas(other), rel=1e-3)
        assert one["fruit"] == pytest.approx(growers_table.mean(other, "fruit_picked"), rel=1e-3)
        assert one["co2"] == pytest.approx(growers_table.mean(other, "co2_dosed"), rel=1e-3)


@pytest.mark.parametrize("base", practice.BASES)
@pytest.mark.parametrize("part", ["night", "day", "season"])
def test_no_heat_is_lost_from_the_balance(base: str, part: str) -> None:
    flows = FOUND["grown"][base]["balance"][part]
    assert set(flows) >= set(practice.FLOWS)
    brought = sum(value for value in flows.values() if value > 0.0)
    assert abs(sum(flows.values())) < 0.01 * brought


def test_each_table_has_its_rows() -> None:
    filled = practice.filled(PAGE, FOUND)
    assert all(growing.words in filled for growing in practice.CHANGES.values())
    assert all(f"`{house}`" in filled for house in practice.HOUSES)
    assert practice.filled(filled, FOUND) == filled


def test_the_page_holds_what_was_grown() -> None:
    page = practice.PAGE.read_text(encoding="utf-8")
    assert practice.filled(page, FOUND) == page


def test_changed_numbers_reach_the_page_of_the_agent(tmp_path: Path) -> None:
    folder = practice.write_agent(tmp_path / "page", practice.CHANGES["page_humid"])
    content = tomllib.loads((Path(folder) / "settings.toml").read_text(encoding="utf-8"))
    assert (content["humidity_deficit"]["day"], content["lamps"]["used"]) == (1.5, False)
    folder = practice.write_agent(tmp_path / "rules", practice.CHANGES["tuned_no_minimum"])
    assert [one.name for one in (Path(folder) / "rules").iterdir()] == ["fullseason.yml"]
    text = (Path(folder) / "rules" / "fullseason.yml").read_text(encoding="utf-8")
    assert "\nboiler_humidity: 0 " in text
    assert "\nlamps_fruit: 0 " in text
    for agent, name in ((practice.GROWER, "heating.noon"), (practice.TUNED, "heating_noon")):
        with pytest.raises(ValueError, match="noon"):
            practice.write_agent(tmp_path / f"wrong-{agent}", practice.Growing("", agent, {name: 1.0}))


def test_a_house_and_a_longer_season_make_a_task_of_the_same_split() -> None:
    task = practice.season_task("lit_year", practice.HOUSES["mixed_2020"], practice.Growing("", practice.GROWER, house={"cLeakage": 0.5}))
    base = get_task(practice.TASK)
    values = task.parameters_by_name()
    held = task.model_value.parameters
    assert values["cLeakage"] == pytest.approx(0.5 * held.default("led_2020")[held.names.index("cLeakage")])
    assert values["thetaLampMax"] == pytest.approx(143.0)
    assert (task.split, task.steps) == ("validation", 350 * base.steps_per_day)
    assert practice.season_task("season", practice.HOUSES["led_2021"], practice.GROWINGS["tuned_lit"]).digest == base.digest
