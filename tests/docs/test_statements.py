"""What README and docs/reproduction.md say without a figure: who is ahead of whom."""

from __future__ import annotations

import pytest

from tests.docs.claims import LEVELS, NotReleasedError, mean, mean_of_trainings, trainings


@pytest.mark.parametrize("level", LEVELS)
def test_doing_nothing_has_a_higher_epi_than_sac(level: int) -> None:
    assert mean("do_nothing", level, "epi") > max(mean(agent, level, "epi") for agent in trainings("sac", level))


def test_at_30_percent_doing_nothing_is_ahead_of_two_ppo_policies_and_of_the_unlit_rules() -> None:
    nothing = mean("do_nothing", 30, "epi")
    assert sum(nothing > mean(agent, 30, "epi") for agent in trainings("ppo", 30)) == 2
    assert nothing > mean("rule_based_unlit", 30, "epi")


@pytest.mark.parametrize("level", LEVELS)
def test_every_ppo_is_ahead_of_every_sac_and_every_sac_ahead_of_the_unlit_rules(level: int) -> None:
    ppo, sac = ([mean(agent, level) for agent in trainings(name, level)] for name in ("ppo", "sac"))
    assert min(ppo) > max(sac)
    assert min(sac) > mean("rule_based_unlit", level)
    assert mean("rule_based_unlit", level, "epi") > mean_of_trainings("sac", level, "epi")


@pytest.mark.parametrize("level", LEVELS)
def test_the_tuned_policy_is_ahead_in_reward_and_of_the_unlit_rules_in_money(level: int) -> None:
    assert mean("ppo_tuned", level) > max(mean(agent, level) for agent in trainings("ppo", level))
    assert mean("ppo_tuned", level, "epi") > mean("rule_based_unlit", level, "epi")
    assert mean("ppo_tuned", level, "cost_electricity") < 0.005


def test_a_blind_recording_is_ahead_of_all_but_the_policy_it_was_made_of() -> None:
    try:
        blind = mean("recording", 10)
    except NotReleasedError as error:
        pytest.fail(str(error))
    others = [*trainings("ppo", 10), *trainings("sac", 10), "rule_based", "rule_based_fair", "rule_based_unlit"]
    assert blind > max(mean(agent, 10) for agent in others)
    assert abs(blind - mean("ppo_tuned", 10)) < 3.0
