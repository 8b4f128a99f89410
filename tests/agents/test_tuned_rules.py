"""The tuned rules: what each of them does, the pages that they are read from, and what is refused."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from glbench.agents import read_baseline
from glbench.agents.tuned_rules import (
    RulePage,
    RulePages,
    TunedRulesAgent,
    TunedRuleSettings,
    read_rule_page,
    read_rule_pages,
    rounded,
    settings_text,
)
from glbench.env import Simulation
from glbench.errors import ShapeError, SubmissionError
from glbench.tasks import TaskCard, get_task, task_card
from tests.agents.conftest import Observe
from tests.support import published_tasks

RULES = Path(__file__).resolve().parents[2] / "baselines" / "rule_based_tuned" / "rules"

PLAIN = TunedRuleSettings(
    morning_before_sunrise=2.0, evening_before_sunset=1.0, night_after_sunset=2.0, ramp_hours=1.0,
    heating_night=15.0, heating_morning=17.0, heating_day=19.0, heating_evening=16.0,
    heating_daylight=100.0, heating_light_raise=2.0, heating_light_from=200.0, heating_light_span=200.0,
    boiler_band=4.0, boiler_outside=0.0, boiler_daylight=0.0, boiler_humidity=0.1, boiler_humidity_above=-1.0, boiler_trend=0.0,
    co2_dim=600.0, co2_sunny=1000.0, co2_light_from=100.0, co2_light_span=100.0, co2_vents=2000.0, co2_band=200.0, co2_dark=10.0,
    vents_humidity_day=-1.0, vents_humidity_night=-3.0, vents_gain=0.04, vents_trend=0.02, vents_cold_less=0.5, vents_wind_less=0.5,
    vents_most=0.5, vents_temperature=26.0, vents_light_raise=0.0, vents_band=5.0, vents_cold=0.0,
    screen_light_from=20.0, screen_light_span=40.0, screen_outdoor=10.0, screen_humidity=1.0, screen_gap=0.1, screen_gap_most=0.3,
    temperature_smoothing=0.0, humidity_smoothing=0.0, lamps_from=2.0, lamps_until=18.0, lamps_radiation=0.0,
)  # fmt: skip
"""Round numbers to calculate with; not good ones."""


def asked(card: TaskCard, observe: Observe, hour: float = 1.0, **given: float) -> dict[str, float]:
    """Controls that the plain rules ask for, by the set points of a task that takes these: no rate limit."""
    direct = dataclasses.replace(card, actuation="set_point")
    agent = TunedRulesAgent([PLAIN])
    agent.reset(direct, 1)
    return dict(zip(card.action_names, agent.act(observe(1, hour, **given))[0].tolist(), strict=True))


@pytest.mark.parametrize(
    ("hour", "heating"), [(0.0, 15.0), (4.0, 15.0), (6.5, 17.0), (18.5, 16.0), (19.0, 16.0), (22.0, 15.0), (23.9, 15.0)]
)
def test_heating_follows_the_sun_in_the_dark(card: TaskCard, observe: Observe, hour: float, heating: float) -> None:
    """On 1 March the sun rises at 6:22 UTC at Schiphol and sets at 17:17."""
    given = asked(card, observe, hour, air_temperature=heating - 1.0)
    assert given["uBoil"] == pytest.approx(0.25, abs=1e-6)  # 1 K of a band of 4 K


def test_light_raises_the_heating_temperature(card: TaskCard, observe: Observe) -> None:
    half = asked(card, observe, 12.0, air_temperature=17.0, global_radiation=50.0)  # half daylight: 18.0 degC
    full = asked(card, observe, 12.0, air_temperature=17.0, global_radiation=100.0)  # 19 degC
    sun = asked(card, observe, 12.0, air_temperature=17.0, global_radiation=300.0)  # and half of 2 K
    assert (full["uBoil"], sun["uBoil"]) == pytest.approx((0.5, 0.75), abs=1e-6)
    assert 0.0 < half["uBoil"] < full["uBoil"]


def test_the_boiler_works_against_humidity(card: TaskCard, observe: Observe) -> None:
    """At night 15 degC is wanted, and at 84 % it begins."""
    assert asked(card, observe, air_temperature=15.0, relative_humidity=84.0)["uBoil"] == 0.0
    assert asked(card, observe, air_temperature=15.0, relative_humidity=86.0)["uBoil"] == pytest.approx(0.2)


def test_vents_move_from_where_they_are(card: TaskCard, observe: Observe) -> None:
    """At night 82 % is wanted; 86 % are 4 too much: 0.04 x 4 in an hour, a quarter of that in a step."""
    mild = {"air_temperature": 18.0, "outdoor_temperature": 17.0, "relative_humidity": 86.0}
    assert asked(card, observe, vents=0.2, **mild)["uVent"] == pytest.approx(0.24)
    assert asked(card, observe, vents=0.49, **mild)["uVent"] == pytest.approx(0.5)  # vents_most
    cold = mild | {"outdoor_temperature": 0.0}
    assert asked(card, observe, vents=0.2, **cold)["uVent"] == pytest.approx(0.22)
    wind = cold | {"wind_speed": 10.0}
    assert asked(card, observe, vents=0.2, **wind)["uVent"] == pytest.approx(0.21)
    assert asked(card, observe, vents=0.2, **(mild | {"air_temperature": 15.0}))["uVent"] == 0.0
    hot = mild | {"air_temperature": 31.0, "relative_humidity": 50.0}
    assert asked(card, observe, vents=0.2, **hot)["uVent"] == pytest.approx(1.0)


def test_a_rise_of_humidity_opens_them_at_once(card: TaskCard, observe: Observe) -> None:
    agent = TunedRulesAgent([PLAIN])
    agent.reset(dataclasses.replace(card, actuation="set_point"), 1)
    agent.act(observe(1, 1.0, relative_humidity=82.0, outdoor_temperature=17.0))
    opened = agent.act(observe(1, 1.25, relative_humidity=85.0, outdoor_temperature=17.0))[0, 3]
    assert opened == pytest.approx(0.03 + 0.06)


def test_co2_follows_light_and_vents(card: TaskCard, observe: Observe) -> None:
    def dosed(**given: float) -> float:
        return asked(card, observe, 12.0, **({"co2": 500.0, "outdoor_temperature": 17.0} | given))["uCo2"]

    assert dosed(global_radiation=5.0) == 0.0
    assert dosed(global_radiation=50.0) == pytest.approx(0.5)  # 600 ppm wanted
    assert dosed(global_radiation=200.0, co2=900.0) == pytest.approx(0.5)  # 1000 ppm wanted
    assert dosed(global_radiation=200.0, co2=900.0, vents=0.05) == 0.0  # 900 ppm wanted


def test_the_screen_is_closed_in_the_dark_and_cold_but_for_a_gap(card: TaskCard, observe: Observe) -> None:
    assert asked(card, observe)["uThScr"] == 1.0
    assert asked(card, observe, relative_humidity=88.0)["uThScr"] == pytest.approx(0.8)
    assert asked(card, observe, relative_humidity=95.0)["uThScr"] == pytest.approx(0.7)
    assert asked(card, observe, global_radiation=40.0)["uThScr"] == pytest.approx(0.5)
    assert asked(card, observe, outdoor_temperature=11.5)["uThScr"] == pytest.approx(0.5)
    assert asked(card, observe, outdoor_temperature=13.0)["uThScr"] == 0.0


def test_lamps_burn_in_their_hours_unless_it_is_bright(card: TaskCard, observe: Observe) -> None:
    assert asked(card, observe, 3.0)["uLamp"] == 0.0
    lit = PLAIN.model_copy(update={"lamps_radiation": 200.0})
    agent = TunedRulesAgent([lit])
    direct = dataclasses.replace(card, actuation="set_point")
    for hour, radiation, lamps, blackout in ((1.5, 0, 0, 0), (3.0, 0, 1, 1), (12.0, 150, 1, 0), (12.0, 250, 0, 0), (18.0, 0, 0, 0)):
        agent.reset(direct, 1)
        actions = agent.act(observe(1, hour, global_radiation=float(radiation)))[0]
        assert (actions[4], actions[5]) == (lamps, blackout)


def test_sensors_are_smoothed(card: TaskCard, observe: Observe) -> None:
    """Over half an hour, with steps of a quarter: a third of the way at a time."""
    agent = TunedRulesAgent([PLAIN.model_copy(update={"temperature_smoothing": 0.5})])
    agent.reset(dataclasses.replace(card, actuation="set_point"), 1)
    agent.act(observe(1, 1.0, air_temperature=15.0))
    assert agent.act(observe(1, 1.25, air_temperature=12.0))[0, 0] == pytest.approx(0.25)


def test_actions_move_controls_by_the_rate_of_the_task(card: TaskCard, observe: Observe) -> None:
    agent = TunedRulesAgent([PLAIN])
    agent.reset(card, 1)
    screen, vents = agent.act(observe(1, 1.0, thermal_screen=0.95, vents=0.2, air_temperature=14.0))[0, 2:4]
    assert screen == pytest.approx(0.5)  # 0.05 of 0.1
    assert vents == -1.0


def test_limits_are_the_tasks_own(card: TaskCard, observe: Observe) -> None:
    limits = tuple(dataclasses.replace(one, high=90.0) if one.name == "relative_humidity" else one for one in card.constraints)
    humid = dataclasses.replace(card, constraints=limits)
    assert asked(card, observe, air_temperature=15.0, relative_humidity=86.0)["uBoil"] > 0.0
    assert asked(humid, observe, air_temperature=15.0, relative_humidity=86.0)["uBoil"] == 0.0


def test_a_run_gets_the_same_bits_alone_and_in_a_batch_and_may_have_numbers_of_its_own() -> None:
    task = get_task("Spring-v1")
    card, pages = task_card(task), read_rule_pages(RULES)
    rows = [page.numbers for page in pages.pages.values()] + [PLAIN]
    simulation = Simulation(task, len(rows), "fast")
    together, alone = TunedRulesAgent(rows), [TunedRulesAgent([row]) for row in rows]
    together.reset(card, len(rows))
    for agent in alone:
        agent.reset(card, 1)
    observations = simulation.reset([1, 2, 3])
    for _ in range(120):
        actions = together.act(observations)
        for row, agent in enumerate(alone):
            assert agent.act(observations[row : row + 1]).tobytes() == actions[row : row + 1].tobytes()
        observations = simulation.step(actions).observations


@pytest.mark.parametrize("task_id", sorted(task.id for task in published_tasks()))
def test_it_plays_every_published_task_that_moves_controls(task_id: str) -> None:
    card = task_card(get_task(task_id))
    agent = read_baseline("rule_based_tuned").make(card)
    assert isinstance(agent, TunedRulesAgent)
    if card.actuation == "process_computer":
        with pytest.raises(SubmissionError, match="The baseline 'grower' works at a process computer"):
            agent.reset(card, 2)
        return
    if set(card.action_names) - {"uBoil", "uCo2", "uThScr", "uVent", "uLamp", "uBlScr"}:
        with pytest.raises(SubmissionError, match=r"is another kind of greenhouse \(u(Chp, uPipe|Heat|Harvest)\)"):
            agent.reset(card, 2)
        return
    agent.reset(card, 2)
    actions = agent.act(np.zeros((2, len(card.observations)), dtype=np.float32))
    low, high = card.action_bounds
    assert actions.shape == (2, len(card.actions))
    assert ((actions >= low) & (actions <= high)).all()


def test_the_page_is_chosen_by_what_is_rewarded() -> None:
    pages = read_rule_pages(RULES)
    chosen = {
        task: pages.page_for(task_card(get_task(task)).reward_modules, task)
        for task in ("Schiphol2010-Delta00-v1", "Schiphol2010Code-Delta30-v1", "Spring-v1", "Transfer-Miami-v1", "Lettuce-v1")
    }
    assert [file.name for file in chosen.values() if file is not None] == ["paper.yml"] * 2 + ["spring.yml"] * 3
    with pytest.raises(SubmissionError, match=r"No page .* is for test/Other, whose reward is profit \(paper.yml: scaled_epi"):
        pages.numbers_for(("profit",), "test/Other")
    one = RulePages({RULES / "paper.yml": pages.pages[RULES / "paper.yml"]})
    assert one.numbers_for(("profit",), "test/Other") == one.pages[RULES / "paper.yml"].numbers


def test_a_page_for_a_model_comes_before_the_one_for_the_reward(tmp_path: Path) -> None:
    reward, colder = ("epi", "scaled_penalty"), PLAIN.model_copy(update={"heating_night": 13.0})
    (tmp_path / "a.yml").write_text(settings_text(RulePage(reward, PLAIN)), encoding="utf-8")
    model = get_task("Lettuce-v1").model_id
    text = settings_text(RulePage((model,), colder, "models"))
    assert f"models: [{model}]" in text.splitlines()
    (tmp_path / "b.yml").write_text(text, encoding="utf-8")
    pages = read_rule_pages(tmp_path)
    assert pages.numbers_for(reward, "mine/Lettuce-v1", model) == colder
    assert pages.numbers_for(reward, "glbench/Spring-v1", get_task("Spring-v1").model_id) == PLAIN
    assert pages.numbers_for(("profit",), "glbench/Lettuce-v1", model) == colder
    assert settings_text(pages.pages[tmp_path / "b.yml"]) == text
    (tmp_path / "c.yml").write_text(text + "reward: [epi]\n", encoding="utf-8")
    with pytest.raises(SubmissionError, match=r"reward"):
        read_rule_pages(tmp_path)


@pytest.mark.parametrize("file", sorted(RULES.glob("*.yml")), ids=lambda file: file.stem)
def test_a_shipped_page_says_of_each_number_what_the_settings_say(file: Path) -> None:
    lines = file.read_text(encoding="utf-8").splitlines()
    heading = [line.removeprefix("#").strip() for line in lines[: next(i for i, line in enumerate(lines) if line[:1] != "#")]]
    assert settings_text(read_rule_page(file), heading) == "\n".join(lines) + "\n"


def test_a_page_is_read_as_it_was_written(tmp_path: Path) -> None:
    page = RulePage(("epi", "scaled_penalty"), PLAIN)
    (tmp_path / "rules.yml").write_text(settings_text(page, ["by hand"]), encoding="utf-8")
    assert read_rule_page(tmp_path / "rules.yml") == page


def test_every_number_has_bounds_a_unit_and_a_meaning() -> None:
    for name, field in TunedRuleSettings.model_fields.items():
        low, high = TunedRuleSettings.bounds(name)
        assert low < high, name
        assert rounded(low) == low, name
        assert rounded(high) == high, name
        assert field.description, name
    assert set(TunedRuleSettings.model_fields) - set(TunedRuleSettings.tuned_names()) == {"lamps_from", "lamps_until", "lamps_radiation"}


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("boiler_band: 4.0", "boiler_band: 0.0", r"'boiler_band' is 0 K; it must be from 0.5 to 10 K"),
        ("boiler_band: 4.0", "", r"'boiler_band' is missing"),
        ("boiler_band: 4.0", "boiler_bnad: 4.0", r"there is no setting 'boiler_bnad'. Did you mean 'boiler_band'"),
        ("co2_dim: 600.0", "co2_dim: .nan", r"at line \d+, 'co2_dim: .nan.*': '.nan' is not a finite number"),
        ("reward: [epi, scaled_penalty]", "reward: 3", r"'reward': it is a list of names"),
        ("reward: [epi, scaled_penalty]", "reward: [epi", "not valid YAML"),
    ],
)
def test_pages_that_cannot_be_are_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    text = settings_text(RulePage(("epi", "scaled_penalty"), PLAIN))
    assert old in text
    (tmp_path / "rules.yml").write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(SubmissionError, match=said):
        read_rule_pages(tmp_path / "rules.yml")


def test_folders_without_a_page_or_with_two_for_one_reward_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SubmissionError, match="no page of rules"):
        read_rule_pages(tmp_path)
    for name in "ab":
        (tmp_path / f"{name}.yml").write_text(settings_text(RulePage(("epi",), PLAIN)), encoding="utf-8")
    with pytest.raises(SubmissionError, match=r"The pages of rules in .* name the same reward twice, epi"):
        read_rule_pages(tmp_path)
    with pytest.raises(SubmissionError, match="Cannot read the rules"):
        read_rule_pages(tmp_path / "c.yml")


def test_what_a_task_does_not_show_is_named_or_done_without(card: TaskCard, observe: Observe) -> None:
    blind = dataclasses.replace(card, observations=tuple(q for q in card.observations if q.name != "relative_humidity"))
    agent = TunedRulesAgent([PLAIN])
    with pytest.raises(SubmissionError, match="does not show the observations relative_humidity, without which the tuned rules"):
        agent.reset(blind, 1)
    kept = [index for index, q in enumerate(card.observations) if q.name not in ("co2", "wind_speed")]
    agent.reset(dataclasses.replace(card, observations=tuple(card.observations[index] for index in kept)), 1)
    actions = agent.act(observe(1, 12.0, global_radiation=300.0, co2_supply=1.0)[:, kept])
    assert actions[0, 1] == -1.0  # no CO2 is dosed without a sensor


def test_another_kind_of_greenhouse_is_refused(card: TaskCard) -> None:
    pump = dataclasses.replace(card.actions[0], name="pump")
    with pytest.raises(SubmissionError, match=r"is another kind of greenhouse \(pump\)"):
        TunedRulesAgent([PLAIN]).reset(dataclasses.replace(card, actions=(pump, *card.actions[1:])), 1)


def test_numbers_and_rows_must_fit_the_runs(card: TaskCard, observe: Observe) -> None:
    agent = TunedRulesAgent([PLAIN, PLAIN])
    with pytest.raises(ShapeError, match="numbers for 2 runs, and 3 begin"):
        agent.reset(card, 3)
    agent.reset(card, 2)
    with pytest.raises(ShapeError, match="of 3 runs, reset was called with 2"):
        agent.act(observe(3))
