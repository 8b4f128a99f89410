"""The recipe in a training's card: the same for trainings that differ in their seed alone."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from glbench.agents.card import SubmissionCard
from glbench.tasks import get_task
from glbench.training.card import TrainingFacts, _recipe

FACTS = {"algorithm": "sb3_contrib.TQC", "seed": 0, "steps": 100, "settings_digest": "0" * 64}
MAKING = TrainingFacts("title", "description", "made", (), FACTS)
SPRING = get_task("Spring-v1")


def recipe(**changes: object) -> str:
    return _recipe(replace(MAKING, training=FACTS | changes), (SPRING,))


def test_a_recipe_is_everything_but_the_seed() -> None:
    assert recipe() == recipe(seed=7)
    assert re.fullmatch(r"sb3-contrib-tqc-[0-9a-f]{16}", recipe())
    others = [recipe(settings_digest="1" * 64), recipe(steps=101), recipe(algorithm="ppo")]
    assert len({recipe(), *others, _recipe(MAKING, (get_task("Lettuce-v1"),))}) == 5


def test_a_search_is_as_long_as_its_generations() -> None:
    """Its candidates may end early, each search its own."""
    assert recipe(generations=9, steps=100) == recipe(generations=9, steps=99)
    assert recipe(generations=9) != recipe(generations=10)


@pytest.mark.parametrize("algorithm", ["compiled ppo", "CMA-ES", "_"])
def test_a_recipe_can_stand_in_a_card(algorithm: str) -> None:
    SubmissionCard(name="x", authors=("a",), licence="MIT", information=("observations",), seed=0, recipe=recipe(algorithm=algorithm))
