"""Settings of baselines with their units, and how they were trained, as the page shows them."""

from __future__ import annotations

import pytest

from glbench.evaluation import load_result
from glbench.report.facts import numbered, settings_of, settings_tables
from glbench.resources import data_folder
from glbench.tasks import get_task

TEXT = """# A page of settings.
reward: [epi]

# Heating
night: 16.5                      # degC, at night
gain: 0.02                       # share %-1 h-1, they open in an hour
    # for each percent
odd: 3                           # whatever it is

[lamps]                          # when they burn
used = false                     # whether light is bought
from = 2.0                       # hour of the day
"""


def test_settings_are_read_with_units_meanings_and_headings():
    sections = {one.title: one for one in settings_tables(TEXT)}
    assert sections["Heating"].rows == [
        ["Night", "16.5", "°C", "at night"],
        ["Gain", "0.02", "share %-1 h-1", "they open in an hour for each percent"],
        ["Odd", "3", "", "whatever it is"],
    ]
    assert sections["Lamps"].words == "when they burn"
    assert sections["Lamps"].rows[0] == ["Used", "false", "", "whether light is bought"]


def released(task: str, agent: str):
    return load_result(data_folder("reports/released/results") / task / f"{agent}.json")


@pytest.mark.parametrize(
    ("task", "agent", "row"),
    [
        ("Spring-v1", "rule_based_tuned", ["Heating night", "16.57", "°C", "at night"]),
        ("Schiphol2010-Delta10-v1", "rule_based_tuned", ["Heating night", "16.92", "°C", "at night"]),
        ("GreenhouseReal-v1", "rule_based_greenhouse", ["Heating night", "15.19", "°C", "at night"]),  # it has another page since
        ("SpringEnergy-v1", "rule_based_energy", ["Evening before sunset", "1.67", "h", "before sunset it leaves that of the day"]),
    ],
)  # fmt: skip
def test_the_page_of_rules_is_that_of_the_task(task, agent, row):
    found = settings_of(released(task, agent), get_task(task))
    assert found is not None
    assert row in [shown for _, _, rows in found["sections"] for shown in rows]


def test_a_policy_shows_its_budget_its_recipe_and_its_curve():
    found = settings_of(released("Spring-v1", "ppo_memory"), get_task("Spring-v1"))
    assert found is not None
    training = found["training"]
    assert ["Control steps", "5,005,312"] in training["rows"]
    assert ["Learned from", "the training seasons of 2008, 2009, 2010"] in training["rows"]
    assert training["recipe_file"] == "baselines/ppo/memory.yml"
    assert training["recipe"]
    assert training["curve"][-1] == [5005312.0, 0.86996]


def test_settings_of_other_files_than_those_of_the_result_are_not_shown():
    result = released("Spring-v1", "rule_based_tuned")
    changed = result.model_copy(update={"agent": result.agent.model_copy(update={"digest": "0" * 64})})
    assert settings_of(changed, get_task("Spring-v1")) is None
    assert settings_of(released("Spring-v1", "my_agent"), get_task("Spring-v1")) is None


def test_equal_settings_are_on_the_page_once():
    facts = [{"settings": {"a": 1}}, {"settings": None}, {"settings": {"a": 1}}]
    assert numbered(facts, "settings") == [{"a": 1}]
    assert facts == [{"settings": 0}, {}, {"settings": 0}]


def test_the_page_holds_the_settings_of_the_released_rules(made):
    shown = [one for one in made.report.data["results"] if one["agent"] == "rule_based"]
    assert shown
    assert all(made.report.data["settings"][one["settings"]]["title"].startswith("Rule-based") for one in shown)


def test_settings_of_a_harvest_have_their_units():
    page = (data_folder("baselines") / "rule_based_harvest" / "rules" / "lettuceharvest.yml").read_text(encoding="utf-8")
    rows = {row[0]: row[2] for table in settings_tables(page) for row in table.rows}
    assert (rows["Harvest days"], rows["Harvest mass"], rows["Harvest growth"]) == ("day", "g", "g/day")
