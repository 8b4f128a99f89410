"""docs/benchmark-design.md: its tables, the sums behind them, and what its sentences claim."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from docs import benchmark_design_figures as design
from glbench.agents import load_agent
from glbench.env import Simulation
from glbench.tasks import get_task, task_card
from glbench.training.periodic_evaluation import season_sums
from tests.support import is_recorded_processor


@pytest.fixture(scope="module")
def figures() -> dict[str, Any]:
    return design.read()


def test_the_page_holds_the_measurements(figures: dict[str, Any]) -> None:
    page = design.PAGE.read_text(encoding="utf-8")
    assert design.filled(page, figures) == page


def test_a_page_without_a_place_for_a_table_is_refused(figures: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="0 places for the table 'families'"):
        design.filled("no markers", figures)


def test_everything_that_is_to_be_evaluated_was(figures: dict[str, Any]) -> None:
    asked = {(job.label, job.name) for job in design.jobs()}
    there = {(label, agent) for label, agents in figures["evaluations"].items() for agent in agents}
    assert asked == there
    assert all(len(runs) == design.RUNS for agents in figures["evaluations"].values() for kept in agents.values() for runs in kept.values())


def test_no_scenario_is_one_of_the_test() -> None:
    for job in design.jobs():
        for task in (job.task, job.recorded or job.task):
            assert task.splits is not None
            assert tuple(task.splits.test.years) == (2008, 2009, 2010)
            assert task.as_tables()["scenario"]["salt"] in (design.DRAWS, design.OTHER_DRAWS, design.RECORDED)


def test_the_recorded_season_is_none_of_the_scenarios() -> None:
    for job in design.jobs():
        assert job.recorded is None or job.recorded.as_tables()["scenario"]["salt"] == design.RECORDED
        assert job.task.as_tables()["scenario"]["salt"] != design.RECORDED


def test_profit_less_violations_is_the_score(figures: dict[str, Any]) -> None:
    for agents in figures["evaluations"].values():
        for kept in agents.values():
            np.testing.assert_allclose(np.subtract(kept["epi"], kept["penalty"]), kept["reward"], atol=2e-4)


# The sums.


def test_the_spread_of_a_table_that_was_made_of_three_parts() -> None:
    agents, scenarios = np.array([0.0, 1.0, 2.0]), np.array([-3.0, 0.0, 3.0, 0.0])
    found = design.spread(agents[:, None] + scenarios)
    assert found == pytest.approx({"between agents": 1.0, "between scenarios": 6.0**0.5, "agent x scenario": 0.0}, abs=1e-12)


def test_the_order_of_agents_that_differ_in_every_scenario_is_certain_and_that_of_equals_is_not() -> None:
    noise = np.random.default_rng(1).normal(size=(2, 30))
    certain = design.stability(np.stack([noise[0], noise[0] + 1.0, noise[0] - 1.0]))
    assert set(certain.values()) == {1.0}
    assert design.stability(noise)["same order"] < 1.0


def test_what_thirty_scenarios_detect_is_found_in_four_of_five_cases() -> None:
    random, cases = np.random.default_rng(2), 4000
    table = random.normal(size=(2, 2000))
    _, difference = design.detectable(table)["found"][30]
    drawn = difference + random.normal(0.0, 2.0**0.5, (cases, 30))
    errors = drawn.std(axis=1, ddof=1) / 30**0.5
    assert (drawn.mean(axis=1) / errors > 2.045).mean() == pytest.approx(0.8, abs=0.04)  # Student's t, 29 degrees of freedom


def test_a_recording_is_measured_by_the_lead_of_its_agent() -> None:
    own, blind, reference = np.array([3.0, 5.0]), np.array([0.0, 2.0]), np.array([1.0, 1.0])
    assert design.recorded(own, blind, reference) == {"lost": 3.0, "lead": 3.0, "multiple": 1.0, "below": 0.5}
    assert np.isnan(design.recorded(reference, blind, own)["multiple"])


def test_knowing_is_worth_nothing_where_one_agent_is_always_best_and_where_draws_are_others() -> None:
    always = np.array([[2.0, 3.0], [1.0, 1.0]])
    assert design.knowing(always, always)["public salt"] == 0.0
    crossed = np.array([[2.0, 0.0], [0.0, 2.0]])
    assert design.knowing(crossed, crossed[:, ::-1]) == {"public salt": 1.0, "secret salt": -1.0}


def test_first_days_are_taken_out_of_a_difference() -> None:
    days, real_days = np.array([45.0, 50.0, 60.0, 70.0]), np.array([50.0, 72.0, 73.0])
    difference, error = design.at_equal_days(1.0 + 0.2 * days, 0.2 * real_days, days, real_days)
    assert (difference, error) == pytest.approx((1.0, 0.0), abs=1e-9)


# What the sentences say.

CONTROLS = ("SpringYears", "SpringMismatch", "Spring")
"""Families in which an action moves controls."""


def mean(figures: dict[str, Any], family: str, agent: str, what: str = "reward") -> float:
    return float(np.mean(figures["evaluations"][family][agent][what]))


def recordings(figures: dict[str, Any], family: str) -> dict[str, dict[str, float]]:
    reference = design.scores_of(figures, "Spring", [design.REFERENCE])[design.REFERENCE]
    if family in CONTROLS:
        reference = design.scores_of(figures, family, [design.REFERENCE])[design.REFERENCE]
    found = figures["evaluations"][family]
    told = {}
    for agent in found:
        if f"recording_of_{agent}" in found:
            own, blind = design.scores_of(figures, family, [agent, f"recording_of_{agent}"]).values()
            told[agent] = design.recorded(own, blind, reference)
    return told


@pytest.mark.parametrize("family", CONTROLS)
def test_a_recording_loses_more_than_half_of_the_lead_and_is_below_the_unlit_rules_in_every_season(
    figures: dict[str, Any], family: str
) -> None:
    told = recordings(figures, family)
    assert any(one["lead"] > 0.0 for one in told.values())
    for one in told.values():
        assert one["below"] == 1.0
        assert one["lost"] > 2.0 * one["lead"]


def test_the_papers_recording_is_below_the_unlit_rules_in_every_season(figures: dict[str, Any]) -> None:
    blind, rules = design.scores_of(figures, "SpringYears", ["recording", "rule_based_unlit"]).values()
    assert (blind < rules).all()


@pytest.mark.parametrize("family", CONTROLS)
def test_three_quarters_of_what_recordings_lose_are_violations(figures: dict[str, Any], family: str) -> None:
    for agent, one in recordings(figures, family).items():
        if agent not in design.LIT:
            blind = mean(figures, family, f"recording_of_{agent}", "penalty")
            assert blind - mean(figures, family, agent, "penalty") > 0.75 * one["lost"]


def test_a_recording_of_set_points_loses_next_to_nothing(figures: dict[str, Any]) -> None:
    assert all(one["lost"] < 0.35 for one in recordings(figures, "SpringSetpoints").values())


def test_profit_alone_would_not_tell_control_from_neglect(figures: dict[str, Any]) -> None:
    for family in CONTROLS:
        agents = design.controllers(figures, family, lit=True)
        idle = mean(figures, family, "do_nothing", "epi")
        poorer = [agent for agent in agents if mean(figures, family, agent, "epi") < idle]
        assert len(poorer) > len(agents) / 2
        assert mean(figures, family, "do_nothing", "penalty") > 30.0 * idle


def test_the_papers_policies_do_not_carry_over(figures: dict[str, Any]) -> None:
    for family in ("SpringYears", "SpringMismatch"):
        unlit = design.controllers(figures, family, lit=False)
        assert all(mean(figures, family, "ppo_tuned") < runs.mean() for runs in unlit.values())
    assert max(design.controllers(figures, "SpringYears", lit=True).items(), key=lambda one: one[1].mean())[0] == "ppo"
    assert mean(figures, "SpringMismatch", "ppo") < mean(figures, "SpringMismatch", "my_agent")


@pytest.mark.parametrize("family", CONTROLS)
def test_agents_with_their_lamps_off_are_told_apart(figures: dict[str, Any], family: str) -> None:
    table = np.array(list(design.controllers(figures, family, lit=False).values()))
    told = design.spread(table)
    assert told["agent x scenario"] < told["between agents"] < told["between scenarios"]
    assert design.stability(table)["pairs in the same order"] > 0.98
    assert design.stability(table)["same best"] > 0.95


def test_sensors_cost_who_reads_them_more_than_half_a_euro_and_the_house_costs_a_policy_most(figures: dict[str, Any]) -> None:
    def cost(agent: str, factor: str, which: str = "") -> float:
        return mean(figures, f"factors seasons{which}", agent) - mean(figures, f"factors {factor}{which}", agent)

    assert all(cost(agent, "sensors") > 0.5 for agent in ("my_agent", "pi_controller", "rule_based_fair_unlit"))
    assert cost("ppo", "sensors", ", paper") > 0.5
    assert cost("rule_based_unlit", "sensors") == 0.0
    single = [factor for factor in design.FACTORS if factor not in ("seasons", "all")]
    assert max(single, key=lambda factor: cost("ppo", factor, ", paper")) == "house"


def test_generated_seasons_pay_what_real_ones_pay_and_order_agents_alike(figures: dict[str, Any]) -> None:
    agents = [Path(agent).stem for agent in design.REAL_AGENTS]
    made, real = (design.scores_of(figures, label, agents) for label in ("SpringYears", "SpringYears real"))
    assert sorted(agents, key=lambda agent: made[agent].mean()) == sorted(agents, key=lambda agent: real[agent].mean())
    days, real_days = (np.array(figures["first_days"][label], float) for label in ("SpringYears", "SpringYears real"))
    assert all(abs(design.at_equal_days(made[agent], real[agent], days, real_days)[0]) < 0.4 for agent in agents)


def test_choosing_by_known_draws_gains_and_loses_under_another_salt_unless_one_agent_is_always_best(figures: dict[str, Any]) -> None:
    gains = {}
    for family, agents in design.CHOICE.items():
        names = [Path(agent).stem for agent in agents]
        known, anew = (np.array(list(design.scores_of(figures, label, names).values())) for label in (family, f"{family} anew"))
        gains[family] = design.knowing(known, anew)
    assert gains["SpringMismatch"]["public salt"] > 0.0 > gains["SpringMismatch"]["secret salt"]
    assert gains["Spring"] == {"public salt": 0.0, "secret salt": 0.0}


def test_first_days_are_most_of_the_spread_between_scenarios(figures: dict[str, Any]) -> None:
    days = np.array(figures["first_days"]["SpringYears"], float)
    table = np.array(list(design.controllers(figures, "SpringYears", lit=False).values()))
    assert np.corrcoef(days, table.mean(axis=0))[0, 1] ** 2 > 0.5


@pytest.mark.slow
def test_the_score_of_the_grower_on_the_test_split_is_that_of_an_evaluation() -> None:
    task = get_task("SpringSetpoints-v1").scored
    card, seeds = task_card(task), list(task.evaluation.seeds)
    agent = load_agent("grower").make(card)
    agent.reset(card, len(seeds))  # type: ignore[call-arg, arg-type]
    reward = season_sums(Simulation(task, len(seeds)), seeds, agent.act)["reward"].mean()  # type: ignore[union-attr, arg-type]
    match = re.search(r"here and (-\d\.\d\d) on the test split of", design.PAGE.read_text(encoding="utf-8"))
    assert match is not None
    assert float(match[1]) == pytest.approx(reward, abs=0.005 if is_recorded_processor() else 0.03)
