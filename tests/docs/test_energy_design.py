"""docs/energy-design.md: its tables, the copies of the rules, and what its sentences claim."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from docs import energy_design_figures as design
from docs.benchmark_design_figures import DRAWS, MADE, RECORDED, filled, read
from glbench.agents.energy_rules import EnergyRuleSettings
from glbench.agents.tuned_rules import read_rule_page


@pytest.fixture(scope="module")
def figures() -> dict[str, Any]:
    return read(design.FIGURES)


def mean(figures: dict[str, Any], family: str, agent: str, what: str = "reward") -> float:
    return float(np.mean(figures["evaluations"][family][agent][what]))


def test_the_page_holds_the_measurements(figures: dict[str, Any]) -> None:
    page = design.PAGE.read_text(encoding="utf-8")
    assert filled(page, figures, design.TABLES) == page


def test_everything_that_is_to_be_evaluated_was_in_as_many_seasons(figures: dict[str, Any]) -> None:
    there = {(family, agent) for family, agents in figures["evaluations"].items() for agent in agents}
    assert {(job.label, job.name) for job in design.jobs()} == there
    assert figures["runs"] == design.RUNS
    for family, agents in figures["evaluations"].items():
        assert {len(values) for kept in agents.values() for values in kept.values()} == {design.RUNS[family]}
    assert len(figures["dispatch"]) == design.DISPATCHED_RUNS


def test_no_scenario_is_one_of_the_test_and_the_recorded_season_is_none_of_them() -> None:
    for job in design.jobs():
        for task, salt in ((job.task, DRAWS), (job.recorded, RECORDED)):
            if task is not None:
                assert task.splits is not None
                assert tuple(task.splits.test.years) == (2008, 2009, 2010)
                assert task.as_tables()["scenario"]["salt"] == salt


def test_profit_less_violations_is_the_score(figures: dict[str, Any]) -> None:
    for agents in figures["evaluations"].values():
        for kept in agents.values():
            np.testing.assert_allclose(np.subtract(kept["epi"], kept["penalty"]), kept["reward"], atol=2e-4)


def test_a_copy_of_the_rules_differs_by_its_numbers_alone(tmp_path: Path) -> None:
    design.make_agents(tmp_path)
    for family, variants in design.VARIANTS.items():
        folders = tmp_path / MADE / family
        rules = read_rule_page(design.PAGES / f"{family.lower()}.yml", EnergyRuleSettings).numbers.model_dump()
        for name, changed in {design.RULES: {}, **variants}.items():
            assert read_rule_page(folders / name / "page.yml", EnergyRuleSettings).numbers.model_dump() == {**rules, **changed}


def test_copies_do_without_what_they_are_said_to_do_without(figures: dict[str, Any]) -> None:
    for family in design.measured(figures, design.ENERGY):
        for name in ("never_runs_the_engine", "boiler_alone"):
            assert max(figures["evaluations"][family][name]["engine_hours"]) == 0.0
    for family in design.measured(figures, design.LIT):
        light = "electricity_bought" if family in design.ENERGY else "electricity"
        never, rules = (figures["evaluations"][family][name][light] for name in ("never_lights", design.RULES))
        assert max(never) < 0.1 * min(rules)  # it is lit when power costs less than 0


def test_a_difference_is_that_of_the_same_seasons() -> None:
    scores = {"a": {"reward": [1.0, 5.0, 3.0]}, design.RULES: {"reward": [0.0, 3.0, 0.0]}}
    found = design.paired({"evaluations": {"family": scores}}, "family", "a")
    assert found == pytest.approx((2.0, 1.0 / 3.0**0.5))


# What the sentences say.


def test_a_recording_loses_at_least_half_of_the_lead(figures: dict[str, Any]) -> None:
    for family in design.measured(figures):
        told = design.blind(figures, family)[2]
        assert told["lead"] > 0.0
        assert told["lost"] > 0.5 * told["lead"]


def test_to_do_nothing_is_the_worst(figures: dict[str, Any]) -> None:
    for family, agents in figures["evaluations"].items():
        if family not in design.WHOLE:
            assert min(agents, key=lambda agent: mean(figures, family, agent)) == "do_nothing"


def test_every_copy_earns_less_than_the_rules(figures: dict[str, Any]) -> None:
    for family in design.measured(figures):
        for name in design.VARIANTS[family]:
            difference, error = design.paired(figures, family, name)
            assert difference < -2.0 * error


def test_with_foresight_the_engine_earns_most(figures: dict[str, Any]) -> None:
    engine, buffer, looking = (
        np.mean(design.possible(design.dispatched(figures), name)) for name in ("engine_earns", "buffer_earns", "looking_earns")
    )
    assert engine > buffer > 0.0
    assert engine > looking > 0.0


def test_that_the_engine_runs_in_spring_matters_far_more_than_when(figures: dict[str, Any]) -> None:
    never, always = (design.paired(figures, "SpringEnergy", name)[0] for name in ("never_runs_the_engine", "runs_it_at_any_price"))
    assert never < 4.0 * always < 0.0
