"""The energy rules: lamps, engine, boiler and buffer by prices, the pages that they are read from, and what is refused."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.agents import read_baseline
from glbench.agents.energy_rules import EnergyRulesAgent, EnergyRuleSettings
from glbench.agents.tuned_rules import RulePage, read_rule_page, read_rule_pages, settings_text
from glbench.env import Simulation
from glbench.errors import ShapeError, SubmissionError
from glbench.tasks import TaskCard, TaskSpec, get_task, task_card
from tests.agents.test_tuned_rules import PLAIN as CLIMATE
from tests.support import shipped_tasks

RULES = Path(__file__).resolve().parents[2] / "baselines" / "rule_based_energy" / "rules"
FAMILIES = ("WinterLED", "SpringEnergy", "FullSeason", "FullSeasonEnergy")

PLAIN = EnergyRuleSettings(
    **CLIMATE.model_copy(update={"lamps_from": 2.0, "lamps_until": 20.0, "lamps_radiation": 200.0}).model_dump(),
    lamps_fruit=0.1, lamps_light=100.0,
    engine_price=0.05, engine_full=0.04, engine_cold=0.001, engine_wait=0.5, engine_stay=0.01,
    buffer_full=90.0, buffer_low=5.0, boiler_co2=1.0, co2_bought=0.2,
    boiler_flue=2.0, engine_flue=0.8, engine_heat=0.5,
)  # fmt: skip
"""Round numbers to calculate with; not good ones."""


@cache
def direct(family: str) -> TaskCard:
    """Card of a family whose actions set the controls at once."""
    return dataclasses.replace(task_card(get_task(f"{family}-v1")), actuation="set_point")


def seen(card: TaskCard, hour: float = 12.0, **given: float) -> NDArray[np.float32]:
    """An observation of one run: a dim noon in March unless it is ``given`` otherwise; all coming prices are those of now."""
    turn, year = 2 * np.pi * hour / 24, 2 * np.pi * 75 / 365
    values = {
        "air_temperature": 22.0, "co2": 400.0, "relative_humidity": 75.0, "global_radiation": 50.0, "outdoor_temperature": 18.0,
        "outdoor_temperature_in_12h": 18.0, "outdoor_co2": 400.0, "buffer_share": 0.0, "price_power": 0.08, "price_fruit": 1.5,
        "sin_hour_of_day": np.sin(turn), "cos_hour_of_day": np.cos(turn), "sin_day_of_year": np.sin(year), "cos_day_of_year": np.cos(year),
    } | given  # fmt: skip
    values.setdefault("price_power_bought", values["price_power"] + 0.03)
    values |= {name: values["price_power"] for name in card.observation_names if name.startswith("price_power_in_")} | given
    return np.array([[values.get(name, 0.0) for name in card.observation_names]], np.float32)


def asked(family: str, hour: float = 12.0, numbers: EnergyRuleSettings = PLAIN, **given: float) -> dict[str, float]:
    """Controls that the plain rules ask for in one observation."""
    card = direct(family)
    agent = EnergyRulesAgent([numbers])
    agent.reset(card, 1)
    return dict(zip(card.action_names, agent.act(seen(card, hour, **given))[0].tolist(), strict=True))


def test_lamps_are_on_while_power_costs_less_than_the_fruit_that_it_makes() -> None:
    """0.1 kg of fruit are worth 0.15 EUR in March and 0.20 at Christmas."""
    assert asked("WinterLED", price_power=0.149)["uLamp"] == 1.0
    assert asked("WinterLED", price_power=0.151)["uLamp"] == 0.0
    assert asked("WinterLED", price_power=0.19, price_fruit=2.0)["uLamp"] == 1.0
    assert asked("WinterLED", price_power=0.1, global_radiation=250.0)["uLamp"] == 0.0
    assert asked("WinterLED", hour=1.0, price_power=0.1)["uLamp"] == 0.0


def test_the_blackout_screen_stays_open_above_lamps() -> None:
    assert asked("WinterLED", hour=3.0, price_power=0.1, global_radiation=0.0)["uBlScr"] == 0.0


def test_where_the_price_of_fruit_does_not_change_the_ledger_tells_it() -> None:
    """1.6 EUR/kg in the spring, where lamps pay what power costs to buy: 0.03 EUR more than it is sold for."""
    assert asked("SpringEnergy", price_power=0.129)["uLamp"] == 1.0
    assert asked("SpringEnergy", price_power=0.131)["uLamp"] == 0.0
    assert asked("SpringEnergy", price_power=0.159, engine=50.0)["uLamp"] == 1.0  # the engine's own power
    assert asked("SpringEnergy", price_power=0.161, engine=50.0)["uLamp"] == 0.0


def test_lamps_count_as_light_for_heating_and_co2_and_not_for_the_screen() -> None:
    """At night 15 degC is wanted, in light of 100 W m-2 it is 19."""
    night = {"hour": 22.0, "global_radiation": 0.0, "air_temperature": 18.0, "outdoor_temperature": 0.0}
    dark, lit = (asked("WinterLED", lamps=lamps, **night) for lamps in (0.0, 200.0 / 3.0))
    assert (dark["uCo2"], lit["uCo2"]) == (0.0, 1.0)
    assert dark["uBoil"] == 0.0
    assert lit["uBoil"] == pytest.approx(0.25, abs=1e-6)
    assert dark["uThScr"] == lit["uThScr"] == 1.0


def sunny(**given: float) -> dict[str, float]:
    """What is asked for with the lamps off."""
    return asked("SpringEnergy", global_radiation=300.0, **given)


def test_the_engine_runs_above_a_price_that_rises_with_the_buffer_and_falls_before_a_cold_night() -> None:
    assert sunny(price_power=0.051)["uChp"] == 1.0
    assert sunny(price_power=0.049)["uChp"] == 0.0
    assert sunny(price_power=0.069, buffer_share=50.0)["uChp"] == 0.0  # 0.05 + 0.04 / 2
    assert sunny(price_power=0.071, buffer_share=50.0)["uChp"] == 1.0
    assert sunny(price_power=0.041, outdoor_temperature_in_12h=8.0)["uChp"] == 1.0
    assert sunny(price_power=0.041, engine=50.0)["uChp"] == 1.0  # it stays on
    assert sunny(price_power=0.3, buffer_share=91.0)["uChp"] == 0.0


def test_the_engine_waits_for_a_dearer_hour_as_the_buffer_fills() -> None:
    """Half full it runs above 0.07; with an hour at 0.17 to come it waits for a quarter of the difference more: 0.095."""
    half = {"buffer_share": 50.0, "price_power_in_4h": 0.17}
    assert sunny(price_power=0.094, **half)["uChp"] == 0.0
    assert sunny(price_power=0.096, **half)["uChp"] == 1.0
    assert sunny(price_power=0.051, price_power_in_4h=0.17)["uChp"] == 1.0  # an empty one has room for both


def test_lit_the_engine_is_worth_what_power_costs_to_buy() -> None:
    assert asked("SpringEnergy", price_power=0.03, price_power_bought=0.06)["uChp"] == 1.0
    assert asked("SpringEnergy", price_power=0.03, price_power_bought=0.06, global_radiation=300.0)["uChp"] == 0.0


def test_the_boiler_burns_for_co2_while_there_is_room_and_for_heat_when_the_buffer_is_empty() -> None:
    day = {"price_power": 0.0, "lamps": 0.0, "global_radiation": 50.0}
    assert asked("SpringEnergy", buffer_share=50.0, **day)["uBoil"] == pytest.approx(0.5)  # a full supply of CO2 is half the boiler
    assert asked("SpringEnergy", buffer_share=95.0, **day)["uBoil"] == 0.0
    cold = {"hour": 0.0, "global_radiation": 0.0, "air_temperature": 12.0, "price_power": 0.0}
    assert asked("SpringEnergy", buffer_share=50.0, **cold)["uBoil"] == 0.0
    empty = asked("SpringEnergy", buffer_share=1.0, **cold)
    assert empty["uPipe"] == empty["uBoil"] == pytest.approx(0.75, abs=1e-6)  # 3 K of a band of 4 K
    helped = asked("SpringEnergy", buffer_share=1.0, **(cold | {"price_power": 0.1}))
    assert (helped["uChp"], helped["uBoil"]) == (1.0, pytest.approx(0.25, abs=1e-6))


def test_co2_is_what_the_flue_gas_has_and_a_part_that_is_bought() -> None:
    dim = {"price_power": 0.0, "global_radiation": 50.0, "buffer_share": 95.0}
    assert asked("SpringEnergy", **dim)["uCo2"] == pytest.approx(0.2)
    assert asked("SpringEnergy", boiler=26.0, **dim)["uCo2"] == pytest.approx(0.6)  # a fifth of 130 W/m2, two supplies at full load
    assert asked("SpringEnergy", boiler=13.0, engine=25.0, **dim)["uCo2"] == pytest.approx(0.8)


@pytest.mark.parametrize("family", ["WinterLED", "SpringEnergy"])
def test_a_run_gets_the_same_bits_alone_and_in_a_batch_and_may_have_numbers_of_its_own(family: str) -> None:
    task = get_task(f"{family}-v1")
    card = task_card(task)
    rows = [read_rule_page(RULES / f"{family.lower()}.yml", EnergyRuleSettings).numbers, PLAIN]
    simulation = Simulation(task, len(rows), "fast")
    together, alone = EnergyRulesAgent(rows), [EnergyRulesAgent([row]) for row in rows]
    together.reset(card, len(rows))
    for agent in alone:
        agent.reset(card, 1)
    observations = simulation.reset([1, 2])
    for _ in range(120):
        actions = together.act(observations)
        assert (np.abs(actions) <= 1.0).all()
        for row, agent in enumerate(alone):
            assert agent.act(observations[row : row + 1]).tobytes() == actions[row : row + 1].tobytes()
        observations = simulation.step(actions).observations


@pytest.mark.parametrize("task", shipped_tasks(), ids=lambda task: task.short_id)
def test_it_plays_tasks_with_an_hourly_price_of_power_and_refuses_others(task: TaskSpec) -> None:
    card = task_card(task)
    agent = read_baseline("rule_based_energy").make(card)
    assert isinstance(agent, EnergyRulesAgent)
    paged = {name for page in read_rule_pages(RULES, EnergyRuleSettings).pages.values() for name in page.scope}
    if "price_power" not in card.observation_names or (not task.locked and task.id not in paged):
        with pytest.raises(SubmissionError, match=task.short_id):
            agent.reset(card, 2)
        return
    agent.reset(card, 2)
    actions = agent.act(np.zeros((2, len(card.observations)), dtype=np.float32))
    low, high = card.action_bounds
    assert actions.shape == (2, len(card.actions))
    assert ((actions >= low) & (actions <= high)).all()


def test_there_is_a_page_for_each_family() -> None:
    pages = read_rule_pages(RULES, EnergyRuleSettings)
    assert {task for page in pages.pages.values() for task in page.scope} == {f"glbench/{name}-v1" for name in FAMILIES}
    with pytest.raises(
        SubmissionError, match=r"No page of the energy rules is for test/Other, whose reward is epi \(fullseason.yml: glbench/FullSeason-v1"
    ):
        pages.numbers_for(("epi",), "test/Other")
    only = read_rule_pages(RULES / "winterled.yml", EnergyRuleSettings)
    assert only.numbers_for((), "test/Other") == read_rule_page(RULES / "winterled.yml", EnergyRuleSettings).numbers


@pytest.mark.parametrize("file", sorted(RULES.glob("*.yml")), ids=lambda file: file.stem)
def test_a_shipped_page_says_of_each_number_what_the_settings_say(file: Path) -> None:
    lines = file.read_text(encoding="utf-8").splitlines()
    heading = [line.removeprefix("#").strip() for line in lines[: next(i for i, line in enumerate(lines) if line[:1] != "#")]]
    assert settings_text(read_rule_page(file, EnergyRuleSettings), heading) == "\n".join(lines) + "\n"


def test_every_number_has_bounds_a_unit_and_a_meaning() -> None:
    for name, field in EnergyRuleSettings.model_fields.items():
        low, high = EnergyRuleSettings.bounds(name)
        assert low < high, name
        assert field.description, name
    assert set(EnergyRuleSettings.model_fields) - set(EnergyRuleSettings.tuned_names()) == {
        "lamps_from", "lamps_until", "boiler_flue", "engine_flue", "engine_heat",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("engine_price: 0.05", "engine_price: 5.0", r"'engine_price' is 5 EUR kWh-1; it must be from -0.05 to 0.4 EUR kWh-1"),
        ("engine_price: 0.05", "", r"'engine_price' is missing"),
        ("engine_price: 0.05", "engine_pirce: 0.05", r"there is no setting 'engine_pirce'. Did you mean 'engine_price'"),
        ("boiler_band: 4.0", "", r"'boiler_band' is missing"),
        ("tasks: [a/B-v1]", "tasks: 3", r"'tasks': it is a list of names"),
        ("tasks: [a/B-v1]", "tasks: [a/B", "not valid YAML"),
        ("tasks: [a/B-v1]", "tasks: [a/B-v1, a/B-v1]", "name the same tasks twice, a/B-v1"),
    ],
)
def test_pages_that_cannot_be_are_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    text = settings_text(RulePage(("a/B-v1",), PLAIN))
    assert old in text
    (tmp_path / "rules.yml").write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(SubmissionError, match=said):
        read_rule_pages(tmp_path, EnergyRuleSettings)


def test_what_is_no_page_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SubmissionError, match="no page of energy rules"):
        read_rule_pages(tmp_path, EnergyRuleSettings)
    with pytest.raises(SubmissionError, match="Cannot read the energy rules"):
        read_rule_pages(tmp_path / "c.yml", EnergyRuleSettings)
    (tmp_path / "list.yml").write_text("- 1\n", encoding="utf-8")
    with pytest.raises(SubmissionError, match="not a table of names and values"):
        read_rule_pages(tmp_path, EnergyRuleSettings)


def test_numbers_and_rows_must_fit_the_runs() -> None:
    card = direct("WinterLED")
    agent = EnergyRulesAgent([PLAIN, PLAIN])
    with pytest.raises(ShapeError, match="numbers for 2 runs, and 3 begin"):
        agent.reset(card, 3)
    agent.reset(card, 2)
    with pytest.raises(ShapeError, match="of 1 runs, reset was called with 2"):
        agent.act(seen(card))
