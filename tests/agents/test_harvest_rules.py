"""The harvest rules: when they call the crew, from days and from samples, and what they need."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.agents import load_agent
from glbench.agents.harvest_rules import HARVEST, HarvestRulesAgent, HarvestRuleSettings
from glbench.agents.tuned_rules import RulePage, read_rule_page, settings_text
from glbench.env import Simulation
from glbench.errors import SubmissionError
from glbench.resources import data_folder
from glbench.tasks import get_task, task_card
from tests.agents.test_tuned_rules import PLAIN as CLIMATE
from tests.env.test_harvest import written

TASK = get_task("LettuceHarvest-v1")
CARD = task_card(TASK)
PLACE = CARD.action_names.index(HARVEST)


def numbers(days: float = 100.0, mass: float = 0.0, growth: float = 10.0, part: float = 0.5) -> HarvestRuleSettings:
    own = {"harvest_days": days, "harvest_mass": mass, "harvest_growth": growth, "harvest_sample": part}
    return HarvestRuleSettings(**CLIMATE.model_dump(), **own)


def seen(age: float, sample: float) -> NDArray[np.float32]:
    values = {
        "air_temperature": 18.0, "co2": 500.0, "relative_humidity": 75.0, "global_radiation": 50.0, "outdoor_temperature": 10.0,
        "cos_hour_of_day": -1.0, "cos_day_of_year": 1.0, "days_since_planting": age, "mean_head_mass": sample,
    }  # fmt: skip
    return np.array([[values.get(name, 0.0) for name in CARD.observation_names]], np.float32)


def called(one: HarvestRuleSettings, *observations: tuple[float, float]) -> list[bool]:
    """Whether the crew is called after each observation of age [day] and sample [g]."""
    agent = HarvestRulesAgent([one])
    agent.reset(CARD, 1)
    return [bool(agent.act(seen(age, sample))[0, PLACE] > 0.0) for age, sample in observations]


def test_the_crew_is_called_after_some_days_whatever_samples_say() -> None:
    assert called(numbers(days=40.0), (0.0, 3.0), (39.9, 500.0), (40.0, 500.0), (0.01, 500.0)) == [False, False, True, False]


def test_the_crew_is_called_when_what_was_weighed_and_has_grown_since_is_heavy_enough() -> None:
    """300 g were weighed on day 30, and 10 g come a day: 350 g on day 35."""
    plain = numbers(mass=350.0, part=1.0)
    assert called(plain, (0.0, 3.0), (30.0, 300.0), (34.9, 300.0), (35.0, 300.0)) == [False, False, False, True]


def test_rules_that_go_by_a_sample_need_one() -> None:
    without = task_card(
        TASK.replace(
            {
                "id": "test/NoSample-v1",
                "samples": None,
                "observation.modules": ["indoor_climate", "planting", "time", "controls", "weather"],
            }
        )
    )
    HarvestRulesAgent([numbers()]).reset(without, 1)
    with pytest.raises(
        SubmissionError, match=r"test/NoSample-v1 does not show 'mean_head_mass', which harvest_mass needs\. Set harvest_mass to 0"
    ):
        HarvestRulesAgent([numbers(mass=360.0)]).reset(without, 1)


def test_a_sample_counts_in_part_beside_what_was_thought_before() -> None:
    """240 g and 7 days at 10 g a day are 310; half of that and half of 330 are 320."""
    history = ((0.0, 3.0), (28.0, 240.0), (35.0, 330.0), (36.9, 330.0), (37.1, 330.0))
    after_first = numbers(mass=350.0, part=0.5)
    thought = 0.5 * (0.5 * (3.0 + 28 * 10) + 0.5 * 240.0 + 70.0) + 0.5 * 330.0
    days = 35.0 + (350.0 - thought) / 10.0
    assert called(after_first, *history[:3], (days - 0.1, 330.0), (days + 0.1, 330.0)) == [False, False, False, False, True]


def test_what_was_weighed_before_a_harvest_is_sold() -> None:
    """Until there is a sample of the new plants, nobody calls by the old one."""
    plain = numbers(mass=350.0, part=1.0)
    history = ((0.0, 3.0), (30.0, 360.0), (0.001, 360.0), (1.0, 360.0), (6.0, 360.0), (6.5, 20.0), (30.0, 300.0), (36.0, 300.0))
    assert called(plain, *history) == [False, True, False, False, False, False, False, True]


def test_rules_that_do_not_look_at_samples_do_not_need_them() -> None:
    assert called(numbers(days=40.0, mass=0.0), (0.0, 900.0), (39.0, 900.0)) == [False, False]


def test_a_run_gets_the_same_bits_alone_and_in_a_batch(tmp_path: Path) -> None:
    task = written(tmp_path, ("first = 20.0", "first = 5.0"))
    rows = [numbers(days=12.0), numbers(mass=20.0)]
    simulation = Simulation(task, 2, "fast")
    together, alone = HarvestRulesAgent(rows), [HarvestRulesAgent([row]) for row in rows]
    for agent, runs in ((together, 2), (alone[0], 1), (alone[1], 1)):
        agent.reset(CARD, runs)
    observations, crew = simulation.reset([1, 2]), []
    for _ in range(14 * TASK.steps_per_day):
        actions = together.act(observations)
        assert actions.tobytes() == np.vstack([agent.act(observations[k : k + 1]) for k, agent in enumerate(alone)]).tobytes()
        observations = simulation.step(actions).observations
        crew.append(simulation.u[:, TASK.model_value.control_names.index(HARVEST)])
    assert (np.max(crew, axis=0) == 1.0).all(), "both called the crew"
    assert (np.sum(crew, axis=0) == TASK.steps_per_day).all(), "once, for a day"


def test_a_page_of_rules_is_an_agent(tmp_path: Path) -> None:
    page = RulePage((TASK.id,), numbers(mass=350.0))
    (tmp_path / "rules.yml").write_text(settings_text(page), encoding="utf-8")
    assert read_rule_page(tmp_path / "rules.yml", HarvestRuleSettings).numbers == page.numbers
    card = (
        'title = "Harvest by samples"',
        'controller = "rule_based_harvest"',
        'settings = "rules.yml"',
        'description = "d"',
        'made = "m"',
    )
    (tmp_path / "card.toml").write_text("\n".join((*card, "sources = []", "")), encoding="utf-8")
    agent = load_agent(str(tmp_path)).make(CARD)
    agent.reset(CARD, 1)
    assert agent.act(seen(36.0, 360.0)).shape == (1, 5)


def test_other_tasks_are_refused_in_words() -> None:
    agent = HarvestRulesAgent([numbers()])
    with pytest.raises(SubmissionError, match=r"does not show the observations days_since_planting"):
        agent.reset(task_card(get_task("Lettuce-v2")), 1)


def test_they_are_what_is_tuned_for_such_a_task() -> None:
    rule_search = pytest.importorskip("glbench.training.rule_search")
    assert rule_search.kind_for([TASK]) is HarvestRuleSettings
    assert rule_search.shipped_start([TASK]) == data_folder("baselines") / "rule_based_harvest" / "rules" / "lettuceharvest.yml"
