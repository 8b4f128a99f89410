"""Which results stand in tables: released ones keep their rows, one's own and trials find theirs beside them."""

from __future__ import annotations

from pathlib import Path

import pytest

from glbench.evaluation import Result, evaluate, load_result
from glbench.evaluation.evaluation import TRIALS
from glbench.evaluation.files import result_path, save_result
from glbench.evaluation.records import results_digest, summarise
from glbench.leaderboard import StoredResult, rank
from glbench.leaderboard.collect import own_and_released_results, published_expectations
from glbench.resources import data_folder
from glbench.tasks import get_task
from tests.leaderboard.synthetic import digest_of, make_result
from tests.support import write_short_task

pytestmark = pytest.mark.usefixtures("few_released")
TASK = "glbench/Schiphol2010-Delta10-v1"
RELEASED = data_folder("reports/released/results")


def released(agent: str) -> Result:
    return load_result(result_path(RELEASED.parent, TASK, agent))


def changed(result: Result, *, reward: float = 0.0, seeds: int = 0, runs: int | None = None, **agent: object) -> Result:
    """``result`` with rewards, seeds, number of runs or words about the agent changed, and consistent again."""
    listed = tuple(
        run.model_copy(update={"seed": run.seed + seeds, "metrics": run.metrics | {"reward": run.metrics["reward"] + reward}})
        for run in result.runs[:runs]
    )
    record = result.agent.model_copy(update=agent)
    evaluation = {"seeds": tuple(run.seed for run in listed), "runs": len(listed)}
    return result.model_copy(
        update={
            "runs": listed,
            "agent": record,
            "evaluation": result.evaluation.model_copy(update=evaluation),
            "summary": summarise(listed),
            "results_digest": results_digest(result.task.digest, record, listed),
        }
    )


def rows(out: Path, agent: str, task: str = TASK) -> list[StoredResult]:
    stored, _ = own_and_released_results(out)
    return [item for item in stored if (item.result.agent.name, item.result.task.id) == (agent, task)]


def test_ones_own_evaluation_with_the_released_bits_needs_no_second_row(tmp_path):
    save_result(released("rule_based"), tmp_path)
    (row,) = rows(tmp_path, "rule_based")
    assert row.origin == "released"
    assert row.reproduced
    assert row.confirmed
    assert not any(item.confirmed for item in own_and_released_results(tmp_path)[0] if item.path != row.path)
    assert own_and_released_results(tmp_path)[1] == ()


def test_ones_own_evaluation_that_differs_leaves_the_row_to_the_released_one_and_is_named(tmp_path):
    theirs = released("rule_based")
    path = save_result(changed(theirs, reward=5.0), tmp_path)
    (row,) = rows(tmp_path, "rule_based")
    assert (row.origin, row.result) == ("released", theirs)
    (problem,) = own_and_released_results(tmp_path)[1]
    assert f"{path} differs from the released result of 'rule_based'" in str(problem)
    assert "The files state no reason" in str(problem)
    assert f"glbench compare rule_based {path}" in str(problem)


def test_what_may_explain_the_difference_is_named(tmp_path):
    theirs = released("rule_based")
    kernel = theirs.evaluation.kernel | {"library_digest": "f" * 64}
    ours = changed(theirs, reward=5.0)
    ours = ours.model_copy(update={"evaluation": ours.evaluation.model_copy(update={"kernel": kernel})})
    save_result(ours.model_copy(update={"machine": ours.machine.model_copy(update={"processor": "an abacus"})}), tmp_path)
    (problem,) = own_and_released_results(tmp_path)[1]
    assert "kernel (compiled/reference/ffffffffffffffff, released compiled/reference/" in str(problem)
    assert "processor (an abacus, released" in str(problem)


@pytest.mark.parametrize(
    ("words", "agent"),
    [
        ("'ppo' is the name of that one", {"name": "ppo", "kind": "submission"}),
        ("'ppo' is the name of that one", {"name": "ppo", "kind": "baseline"}),
        ("'do_nothing' is the name of that one", {"name": "do_nothing"}),
        ("'PPO' looks like 'ppo'", {"name": "PPO"}),
        ("'Rule-Based' looks like 'rule_based'", {"name": "Rule-Based"}),
        ("'Do_Nothing' looks like 'do_nothing'", {"name": "Do_Nothing"}),
        ("calls 'clever' a baseline", {"name": "clever", "kind": "baseline"}),
    ],
)
@pytest.mark.parametrize("task", [TASK, "mylab/Winter-v1"])
def test_nobody_else_bears_the_name_of_a_built_in_agent(tmp_path, words, agent, task):
    path = save_result(changed(make_result("x", [9e9] * 4, task_id=task), **agent), tmp_path)
    stored, problems = own_and_released_results(tmp_path)
    assert all(item.path != path for item in stored)
    (problem,) = problems
    assert words in str(problem)


def test_a_built_in_agent_without_its_privileges_is_another_one(tmp_path):
    save_result(changed(released("rule_based"), privileged=False, reward=900.0), tmp_path)
    (row,) = rows(tmp_path, "rule_based")
    assert row.released
    assert "privileges differ" in str(own_and_released_results(tmp_path)[1][0])


def test_a_stranger_under_a_released_name_does_not_make_two_results_of_one_agent(tmp_path):
    theirs = released("rule_based")
    save_result(theirs, tmp_path)
    stranger = changed(theirs, digest=digest_of("stranger"), reward=900.0)
    (result_path(tmp_path, TASK, "x")).write_text(stranger.to_json(), encoding="utf-8")
    (row,) = rows(tmp_path, "rule_based")
    assert row.released
    assert len(own_and_released_results(tmp_path)[1]) == 1


def test_a_built_in_agent_on_a_task_of_ones_own_has_a_row(tmp_path):
    theirs = released("rule_based")
    task = theirs.task.model_copy(update={"id": "mylab/Winter-v1", "digest": digest_of("winter")})
    mine = theirs.model_copy(update={"task": task, "results_digest": results_digest(task.digest, theirs.agent, theirs.runs)})
    save_result(mine, tmp_path)
    (row,) = rows(tmp_path, "rule_based", "mylab/Winter-v1")
    assert row.origin == "own"
    assert own_and_released_results(tmp_path)[1] == ()


def test_a_trial_stands_where_its_agent_has_no_full_result(tmp_path):
    full = changed(released("ppo"), name="anna", kind="submission", digest=digest_of("anna"))
    trial = changed(full, runs=2)
    save_result(trial, tmp_path / TRIALS)
    (row,) = rows(tmp_path, "anna")
    assert (row.origin, row.result) == ("trial", trial)
    save_result(full, tmp_path)
    (row,) = rows(tmp_path, "anna")
    assert (row.origin, row.result) == ("own", full)


def test_other_seeds_are_a_trial_wherever_the_file_lies(tmp_path):
    other = changed(released("ppo"), name="anna", kind="submission", digest=digest_of("anna"), seeds=100)
    save_result(other, tmp_path)
    (row,) = rows(tmp_path, "anna")
    assert row.origin == "trial"


def test_a_trial_of_a_built_in_agent_is_not_shown_beside_its_released_result(tmp_path):
    save_result(changed(released("rule_based"), runs=2), tmp_path / TRIALS)
    (row,) = rows(tmp_path, "rule_based")
    assert row.released
    assert own_and_released_results(tmp_path)[1] == ()


@pytest.mark.usefixtures("all_released")
def test_the_released_results_alone_are_seen_where_they_lie():
    stored, problems = own_and_released_results(RELEASED.parent)
    assert problems == ()
    assert all(item.origin == "released" for item in stored)
    assert len(stored) == len([path for path in RELEASED.rglob("*.json") if not path.name.endswith(".proof.json")])


@pytest.mark.parametrize("name", ["ppo_seed3", "ppo-seed0", "PPO_seed03", "rule_based_seed1", "ppo_seed1_seed2"])
@pytest.mark.parametrize("kind", ["submission", "baseline"])
def test_nobody_else_adds_a_training_to_a_released_recipe(tmp_path, name, kind):
    save_result(changed(released("ppo"), reward=100.0, name=name, kind=kind), tmp_path)
    assert rows(tmp_path, name) == []
    assert any(name in str(problem) for problem in own_and_released_results(tmp_path)[1])


def test_a_result_of_another_version_of_a_published_task_is_left_out_and_stops_nobody(tmp_path):
    """Somebody's file with a published id and another digest does not end the board of the others."""
    path = save_result(make_result("stranger", [1.0, 2.0], task_id=TASK, task_digest=digest_of("other")), tmp_path)
    stored, (problem,) = own_and_released_results(tmp_path)
    assert "stranger" not in {item.result.agent.name for item in stored}
    assert f"{path} is not of '{TASK}' as it is published" in str(problem)
    assert rank(stored, published_expectations())


def test_of_two_results_of_one_agent_the_one_in_its_place_counts(tmp_path):
    mine = make_result("mine", [1.0, 2.0])
    place = save_result(mine, tmp_path)
    double = tmp_path / "results" / "A-copy.json"
    double.write_text(make_result("mine", [8.0, 9.0]).to_json(), encoding="utf-8")
    (row,) = rows(tmp_path, "mine", mine.task.id)
    assert row.path == place
    (problem,) = own_and_released_results(tmp_path)[1]
    assert f"{double} is a second result of 'mine'" in str(problem)


def test_of_two_versions_of_a_task_of_ones_own_the_one_with_more_results_counts(tmp_path):
    for name in ("one", "two"):
        save_result(make_result(name, [1.0, 2.0]), tmp_path)
    path = save_result(make_result("three", [8.0, 9.0], task_digest=digest_of("other")), tmp_path)
    stored, (problem,) = own_and_released_results(tmp_path)
    assert {item.result.agent.name for item in stored if not item.released} == {"one", "two"}
    assert f"{path} is of another version of 'glbench/Meadow-v1'" in str(problem)
    assert rank(stored, published_expectations())


def test_a_folder_that_is_called_trials_has_whole_results(tmp_path: Path) -> None:
    task = get_task(write_short_task(tmp_path, "Day", days=1))
    evaluate(task, "rule_based", out=tmp_path / "trials")
    stored, _ = own_and_released_results(tmp_path / "trials")
    (table,) = rank([one for one in stored if one.result.task.id == task.id], published_expectations())
    assert [(row.agent, row.rank, row.origin) for row in table.rows] == [("rule_based", 1, "own")]
