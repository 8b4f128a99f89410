"""What an agent was trained for: from its card, from the trainings of a shipped baseline, or not stated."""

from __future__ import annotations

import dataclasses
import tomllib
from pathlib import Path

import pytest

from glbench.agents.baselines import digests_of_baseline, read_baseline
from glbench.agents.card import SubmissionCard
from glbench.evaluation import Result, load_result, result_path
from glbench.evaluation.records import RunResult, results_digest
from glbench.leaderboard import entries as entries_module
from glbench.leaderboard.collect import own_and_released_results, read_folder, same_runs
from glbench.leaderboard.entries import entries_by_task, of_one_version
from glbench.leaderboard.training_data import UNKNOWN, Budget, budget_of
from glbench.resources import data_folder, write_atomically
from tests.leaderboard.synthetic import make_result

RESULTS = data_folder("reports/released/results")


def released(agent: str, task: str = "Schiphol2010-Delta10-v1"):
    return load_result(RESULTS / task / f"{agent}.json")


def test_a_rule_learnt_nothing():
    assert budget_of(released("rule_based")) == Budget(0, 0.0)


def test_a_submission_without_a_card_says_nothing():
    assert budget_of(make_result("quiet", [1.0])) == UNKNOWN


def test_a_card_is_believed():
    card = SubmissionCard(name="A", authors=("B",), licence="MIT", information=("observations",), training={"steps": 7, "wall_hours": 0.5})
    result = make_result("told", [1.0])
    told = result.model_copy(update={"agent": result.agent.model_copy(update={"card": card})})
    assert budget_of(told) == Budget(7, 0.5)


def spent(result) -> Budget:
    """The budget without what was trained on."""
    budget = budget_of(result)
    return Budget(budget.steps, budget.hours)


def test_of_a_shipped_policy_the_training_at_the_nearest_uncertainty_counts():
    result = released("ppo", "Schiphol2010-Delta10-v1")
    card = tomllib.loads((data_folder("baselines") / "ppo/training/delta10.toml").read_text(encoding="utf-8"))
    expected = Budget(card["training"]["steps"], pytest.approx(card["wall_seconds"]["total"] / 3600.0))
    assert spent(result) == expected
    stranger = result.model_copy(update={"agent": result.agent.model_copy(update={"digest": "0" * 64})})
    assert budget_of(stranger) == UNKNOWN, "of another policy of that name nothing is known"


@pytest.mark.parametrize(
    ("agent", "task", "training"),
    [
        ("ppo_long", "Spring-v1", "spring"),
        ("ppo_long", "SpringMismatch-v1", "springmismatch"),
        ("ppo_long", "Transfer-Miami-v1", "spring"),
        ("sac_fast", "Lettuce-v1", "lettuce"),
        ("ppo_fast", "Schiphol2010-Delta30-v1", "delta30"),
        ("ppo", "SpringYears-v1", "delta10"),
    ],
)
def test_of_a_shipped_policy_the_training_of_the_one_that_acts_counts(agent: str, task: str, training: str):
    card = tomllib.loads((data_folder("baselines") / agent / f"training/{training}.toml").read_text(encoding="utf-8"))
    budget = budget_of(released(agent, task))
    assert (budget.steps, budget.tasks) == (card["training"]["steps"], (card["task"]["id"],))


def test_a_policy_that_another_one_was_made_of_counts_with_it():
    card = tomllib.loads((data_folder("baselines") / "ppo_tuned/training/delta10.toml").read_text(encoding="utf-8"))
    steps = card["training"]["steps"] + card["start"]["steps"]
    seconds = card["wall_seconds"]["total"] + card["start"]["wall_seconds"]
    assert steps > card["training"]["steps"]
    assert spent(released("ppo_tuned")) == Budget(steps, pytest.approx(seconds / 3600.0))


def test_a_recording_counts_with_the_training_of_the_agent_that_was_recorded():
    tuned, digest = released("ppo_tuned"), read_baseline("recording").digest
    replayed = tuned.model_copy(update={"agent": tuned.agent.model_copy(update={"name": "recording", "digest": digest})})
    assert budget_of(replayed) == budget_of(tuned)


@pytest.mark.parametrize(("task", "page"), [("Schiphol2010-Delta00-v1", "paper"), ("Spring-v1", "spring")])
def test_of_tuned_rules_the_page_for_the_tasks_reward_counts(task: str, page: str):
    other, digest = released("rule_based_fair", task), read_baseline("rule_based_tuned").digest
    agent = other.agent.model_copy(update={"name": "rule_based_tuned", "digest": digest})
    budget = budget_of(other.model_copy(update={"agent": agent}))
    record = data_folder("baselines") / f"rule_based_tuned/training/{page}.toml"
    card = tomllib.loads(record.read_text(encoding="utf-8"))
    assert budget.steps == card["training"]["steps"] + card["start"]["steps"]
    if page == "spring":
        assert budget.tasks == ("glbench/SpringYears-v1", "glbench/SpringMismatch-v1", "glbench/Spring-v1")
        assert (budget.split, budget.years) == ("training", (2008, 2009, 2010))
    else:
        assert budget.tasks == ("glbench/Schiphol2010-Delta10-v1",)
        assert (budget.split, budget.years) == (None, (2010,))


def test_a_baseline_with_a_page_for_one_more_task_is_the_same_agent(monkeypatch: pytest.MonkeyPatch) -> None:
    name = "rule_based_greenhouse"
    today, *earlier = digests_of_baseline(name)
    assert today == read_baseline(name).digest
    assert (digests_of_baseline("my_agent"), digests_of_baseline("rule_based")) == ((), (read_baseline("rule_based").digest,))
    stored, _ = read_folder(RESULTS)
    (old,) = (item for item in stored if item.result.agent.name == name)
    assert old.result.agent.digest in earlier
    assert budget_of(old.result).steps
    other = next(item for item in stored if item.result.agent.name == "rule_based_tuned" and item.result.task.id == "glbench/Spring-v1")
    agent = other.result.agent.model_copy(update={"name": name, "digest": today})
    new = dataclasses.replace(other, result=other.result.model_copy(update={"agent": agent}))
    entries = entries_by_task([old, new], {})
    assert all(of_one_version(entries)[task] for task in entries)
    monkeypatch.setattr(entries_module, "digests_of_baseline", lambda name: ())
    assert not all(of_one_version(entries)[task] for task in entries), "digests that nobody knows are other agents"


def test_ones_own_evaluation_of_a_baseline_that_grew_is_the_released_one(tmp_path: Path) -> None:
    name, task = "rule_based_greenhouse", "GreenhouseReal-v1"
    kept = load_result(RESULTS / task / f"{name}.json")

    def evaluated(digest: str, runs: tuple[RunResult, ...] = kept.runs) -> Result:
        agent = kept.agent.model_copy(update={"digest": digest})
        stated = results_digest(kept.task.digest, agent, runs, kept.task.salt_commitment)
        return kept.model_copy(update={"agent": agent, "runs": runs, "results_digest": stated})

    own, stranger = evaluated(digests_of_baseline(name)[0]), evaluated("0" * 64)
    assert own.results_digest != kept.results_digest
    assert same_runs(own, kept)
    assert not same_runs(stranger, kept)
    assert not same_runs(evaluated(own.agent.digest, kept.runs[::-1]), kept)
    for result, problem in ((own, ""), (stranger, "is of another agent than the one that came with glbench")):
        file = result_path(tmp_path, task, name)
        write_atomically(file, result.model_dump_json(by_alias=True))
        stored, problems = own_and_released_results(tmp_path)
        assert problem in "".join(map(str, problems))
        assert bool(problems) is bool(problem)
        assert [item.confirmed for item in stored if item.result.agent.name == name and item.board.endswith(task)] == [not problem]
