"""Honest results are reproduced, and what cannot be known is not claimed."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from glbench.episodes import episodes_folder, read_log
from glbench.evaluation import Result, evaluate, load_result, result_path
from glbench.evaluation.evaluation import TRIALS
from glbench.evaluation.profiles import load_profile, profile_path
from glbench.evaluation.records import AgentRecord, EvaluationRecord, RunResult, TaskRecord, this_machine
from glbench.tasks import get_task
from glbench.verification import documents, proof_path, read_proof, save_proof, verify
from glbench.verification.proof import TOLERANCE, Agreement
from tests.episodes.day import RANDOM
from tests.evaluation.agent_files import GOOD
from tests.support import write_day_task
from tests.verification.forging import changed, perturb, record_of, rewrite, rewrite_record


@pytest.mark.parametrize("agent", ["wavy", "narrow", "failing", "rule_based"])
def test_an_honest_result_is_reproduced_to_the_last_bit(reports, day_task, agent):
    verdict = verify(result_path(reports, day_task.id, agent))
    assert (verdict.outcome, verdict.exactness, verdict.exit_code) == ("reproduced", "bits", 0), verdict
    assert (verdict.runs, verdict.episodes, verdict.notes) == (3, (666, 667, 668), ())
    assert verdict.largest_difference == 0.0


def test_failed_runs_are_recorded_as_far_as_they_went(reports, day_task):
    path = result_path(reports, day_task.id, "failing")
    log, result = read_log(record_of(path)), load_result(path)
    assert [(run.status, run.steps, run.actions) for run in log.runs] == [
        ("crashed", 17, 17),
        ("invalid_action", 10, 10),
        ("crashed", 17, 17),
    ]
    assert [run.reason for run in log.runs] == [run.reason for run in result.runs]
    assert "the pump broke" in log.runs[0].reason


def test_a_step_that_cannot_be_simulated_is_reproduced_to_fail_again(day_task, write_agent, tmp_path, monkeypatch):
    from glbench.kernel import Kernel, StepFailure

    plain = Kernel.try_step

    def brittle(self, x, u, d, p):
        """A kernel that cannot do a boiler above 0.35."""
        after, failed = plain(self, x, u, d, p)
        rows = np.flatnonzero(u[:, 0] > 0.35)
        after[rows] = x[rows]
        return after, [*failed, *(StepFailure(int(row), "too hot") for row in rows)]

    monkeypatch.setattr(Kernel, "try_step", brittle)
    monkeypatch.setattr(Kernel, "environments", lambda kernel, program, n: None)  # a fused step does not ask for this one
    result = evaluate(day_task, write_agent("def act(self, observations):\n    return np.full((self.n, 6), 1.0)"), out=tmp_path)
    path = result_path(tmp_path, day_task.id, "agent_under_test")
    assert {(run.status, run.steps) for run in result.runs} == {("simulation_failed", 3)}
    assert verify(path).exactness == "bits"
    monkeypatch.setattr(Kernel, "try_step", plain)
    verdict = verify(path)
    assert (verdict.outcome, verdict.cause) == ("refuted", "status") or verdict.cause in {"reward", "metric", "state"}


def test_an_agent_that_never_started_is_reproduced(day_task, write_agent, tmp_path):
    agent = write_agent("def reset(self, task, n_runs):\n    raise OSError('no weights')\ndef act(self, observations):\n    return 0")
    result = evaluate(day_task, agent, out=tmp_path, episodes="best")
    assert {run.steps for run in result.runs} == {0}
    assert verify(result_path(tmp_path, day_task.id, "agent_under_test")).exactness == "bits"


def test_a_resumed_evaluation_is_reproduced(day_task, write_agent, tmp_path):
    from glbench.evaluation import prepare

    evaluation = prepare(day_task, write_agent(RANDOM), out=tmp_path, checkpoint_seconds=0.0)

    def stop(progress):
        if progress.step == 9:
            raise RuntimeError

    with pytest.raises(RuntimeError):
        evaluation.run(stop)
    assert evaluation.run().evaluation.resumed_at_step == 9
    assert verify(result_path(tmp_path, day_task.id, "agent_under_test")).exactness == "bits"


def test_the_number_of_workers_changes_nothing(day_task, write_agent, tmp_path):
    evaluate(day_task, write_agent(GOOD), out=tmp_path, workers=2)
    assert verify(result_path(tmp_path, day_task.id, "agent_under_test"), workers=1).exactness == "bits"
    assert verify(result_path(tmp_path, day_task.id, "agent_under_test"), workers=2).exactness == "bits"


@pytest.mark.parametrize(("runs", "words"), [(1, "trial of 1 run from"), (2, "trial of 2 runs from")])
def test_fewer_runs_than_the_task_asks_for_are_reproduced_as_a_trial(runs, words, day_task, write_agent, tmp_path):
    evaluate(day_task, write_agent(GOOD), out=tmp_path, runs=runs)
    verdict = verify(result_path(tmp_path / TRIALS, day_task.id, "agent_under_test"))
    assert verdict.outcome == "reproduced"
    assert words in verdict.notes[0]


def test_metrics_of_another_version_are_not_vouched_for(wavy):
    def more(document):
        for values in (*(run["metrics"] for run in document["runs"]), document["units"]):
            values["water"] = 2.5
        document["units"]["water"] = "l m-2"

    rewrite(wavy, more)
    verdict = verify(wavy)
    assert (verdict.outcome, verdict.cause) == ("unknown", "unknown_metrics")
    assert verdict.reason == "This glbench does not measure water. Verify with the one that did."


def test_a_result_with_fewer_metrics_is_reproduced_in_those_it_has(wavy):
    def fewer(document):
        for values in (*(run["metrics"] for run in document["runs"]), document["units"]):
            del values["heat"]

    rewrite(wavy, fewer)
    verdict = verify(wavy)
    assert (verdict.outcome, verdict.exactness) == ("reproduced", "bits")


def test_a_task_that_a_record_brings_along_is_not_simulated_without_end(wavy, monkeypatch):
    monkeypatch.setattr(documents, "_MOST_STEPS", 23)
    verdict = verify(wavy)
    assert (verdict.outcome, verdict.cause) == ("unknown", "no_task")
    assert "has 24 steps, more than 23" in verdict.reason


# What was reproduced, and what is stated


def fields_of(model):
    """Places in a result file: one level below the task, the agent, the evaluation and the runs."""
    for name, field in model.model_fields.items():
        key = field.alias or name
        inner = {"task": TaskRecord, "agent": AgentRecord, "evaluation": EvaluationRecord, "runs": RunResult}.get(key)
        yield from [key] if inner is None else [f"{key}.{below}" for below in inner.model_fields]


@pytest.mark.parametrize("agent", ["wavy", "failing"])
def test_every_field_is_either_reproduced_or_stated(reports, day_task, agent):
    verdict = verify(result_path(reports, day_task.id, agent))
    assert sorted([*verdict.reproduced, *verdict.stated]) == sorted(fields_of(Result))
    assert ("runs.status" in verdict.stated) == (agent == "failing")
    assert "profile" in verdict.reproduced
    for stated in ("agent.digest", "evaluation.sandbox", "evaluation.decision_seconds", "machine", "git", "created"):
        assert stated in verdict.stated


def test_a_profile_that_is_not_there_is_stated(wavy):
    profile_path(wavy).unlink()
    verdict = verify(wavy)
    assert verdict.exactness == "bits"
    assert "profile" in verdict.stated


def test_results_of_a_task_with_time_limits_are_reproduced(write_agent, tmp_path):
    """The record holds the definition of a task of one's own, its time limits included; one of these runs takes too long."""
    file = write_day_task(tmp_path)
    limits = ("start", 20.0), ("step", 0.5), ("run", 60.0)
    table = "".join(f'{name} = {{ value = {value}, unit = "s" }}\n' for name, value in limits)
    file.write_text(file.read_text() + f"\n[evaluation.time_limits]\n{table}")
    body = "def act(self, observations):\n    import time\n    self.step = getattr(self, 'step', 0) + 1\n"
    body += "    time.sleep(5.0 if self.step == 4 else 0.0)\n    return np.zeros((self.n, 6))"
    result = evaluate(get_task(file), write_agent(body), out=tmp_path)
    assert {(run.status, run.steps) for run in result.runs} == {("timed_out", 3)}
    path = result_path(tmp_path, "test/Day-v1", "agent_under_test")
    assert verify(path).exactness == "bits"
    assert load_profile(result, path) is not None  # what the report reads the task from


# What cannot be told


def unknown(path, cause, word, **options):
    verdict = verify(path, **options)
    assert (verdict.outcome, verdict.cause, verdict.exit_code) == ("unknown", cause, 2), verdict
    assert word in verdict.reason


def test_without_a_record_nothing_can_be_told(wavy, tmp_path):
    unknown(tmp_path / "nowhere.json", "no_result", "no result file")
    rewrite(wavy, lambda document: document.update(record=None))
    unknown(wavy, "no_record", "no recorded actions")


def test_a_record_that_is_not_there(wavy):
    record_of(wavy).unlink()
    unknown(wavy, "no_record", "not there")


def test_a_folder_without_episodes(wavy, tmp_path):
    unknown(wavy, "no_episodes", "no episodes", episodes=tmp_path)


def test_a_file_of_another_kind(tmp_path):
    (tmp_path / "other.json").write_text('{"schema": "other"}')
    unknown(tmp_path / "other.json", "no_result", "'other'")


def test_named_episodes_are_found_below_the_folder_of_all_episodes(wavy, reports):
    assert verify(wavy, episodes=reports / "episodes").episodes == (666, 667, 668)
    moved = reports.parent / "moved"
    shutil.move(episodes_folder(wavy), moved)
    assert verify(wavy).episodes == ()
    assert verify(wavy, episodes=moved).episodes == (666, 667, 668)


# Another machine


@pytest.fixture
def elsewhere(monkeypatch):
    """This machine has another processor than the one that made the results."""
    other = this_machine().model_copy(update={"processor": "Abacus 9"})
    for module in ("proof", "proving"):
        monkeypatch.setattr(f"glbench.verification.{module}.this_machine", lambda: other)


@pytest.mark.parametrize("here", ["the machine of the result", "another one"])
def test_a_last_digit_everywhere_is_reproduced_within_the_tolerance_and_said(wavy, here, request):
    if here == "another one":
        request.getfixturevalue("elsewhere")
    perturb(wavy, 1.0 + 1e-12)
    verdict = verify(wavy)
    assert (verdict.outcome, verdict.exactness) == ("reproduced", "tolerance"), verdict
    assert "not to the last bit" in verdict.reason
    assert ("Abacus 9" in verdict.reason) == (here == "another one")
    assert 1e-14 < verdict.largest_difference < 1e-11
    assert "profile" in verdict.stated
    save_proof(verdict)
    assert read_proof(wavy).exactness == "tolerance"


def test_the_same_bits_on_another_processor_are_the_same_bits(wavy, elsewhere):
    assert verify(wavy).exactness == "bits"


def test_more_than_the_tolerance_everywhere_cannot_be_told(wavy):
    perturb(wavy, 1.0 + 1e-6)
    unknown(wavy, "other_machine", "step 1")


def test_no_machine_explains_rewards_of_half_the_size(wavy, elsewhere):
    perturb(wavy, 0.5)
    verdict = verify(wavy)
    assert (verdict.outcome, verdict.cause) == ("refuted", "reward")
    assert "differences between machines are smaller" in verdict.reason


@pytest.mark.parametrize("factor", [1.0 + 1e-15, 1.0 + 1e-12, 1.0 + 1e-6, 0.5])
def test_one_changed_reward_among_unchanged_ones_is_refuted_on_any_machine(wavy, elsewhere, factor):
    rewrite_record(wavy, lambda log: replace(log, rewards=changed(log.rewards, (5, 0), log.rewards[5, 0] * factor)))
    verdict = verify(wavy)
    assert (verdict.outcome, verdict.cause) == ("refuted", "reward")
    assert "The machine is not the cause" in verdict.reason


def test_a_reward_that_is_not_the_sum_of_the_recorded_ones_is_refuted_on_any_machine(wavy, elsewhere):
    perturb(wavy, 1.0 + 1e-12)
    rewrite(wavy, lambda d: d["runs"][0]["metrics"].update(reward=np.nextafter(d["runs"][0]["metrics"]["reward"], 0.0)))
    verdict = verify(wavy)
    assert (verdict.outcome, verdict.cause) == ("refuted", "metric")
    assert "add up" in verdict.reason


def test_the_tolerance_is_relative_to_the_column():
    one = np.array([[1000.0, 1.0], [0.0, 2.0]])
    found = Agreement().add("x", one, one + np.array([[0.0, 0.0], [5e-7, 0.0]]), ("a", "b"), "here")
    assert found.largest == pytest.approx(5e-10)
    assert found.largest < TOLERANCE
    assert found.first_large is None
    assert found.first.words == "here, step 2, a: recorded 0.0, found 5e-07"


def test_zeros_of_different_sign_are_different_bits():
    found = Agreement().add("x", np.array([[0.0]]), np.array([[-0.0]]), ("a",), "here")
    assert found.first is not None
    assert found.verdict(same_arithmetic=True, origin="") is not None
    assert found.verdict(same_arithmetic=False, origin="") is None


# Proofs


def test_a_proof_lies_beside_the_result_and_holds_for_this_very_file(wavy):
    assert read_proof(wavy) is None
    assert save_proof(verify(wavy)) == proof_path(wavy)
    proof = read_proof(wavy)
    assert (proof.exactness, proof.runs, proof.full_episodes) == ("bits", 3, (666, 667, 668))
    assert proof.results_digest == load_result(wavy).results_digest
    text = wavy.read_text()
    wavy.write_text(text.replace('"system"', '"system" '))
    assert read_proof(wavy) is None
    wavy.write_text(text)
    assert read_proof(wavy) == proof


def test_a_refuted_result_loses_its_proof(wavy):
    save_proof(verify(wavy))
    rewrite(wavy, lambda d: d["runs"][1]["metrics"].update(reward=0.0))
    assert save_proof(verify(wavy)) is None
    assert not proof_path(wavy).exists()


def test_a_proof_that_cannot_be_read_counts_for_nothing(wavy):
    proof_path(wavy).write_text(json.dumps({"schema": "glbench/proof", "reproduced": "bits"}))
    assert read_proof(wavy) is None


def test_notes_of_the_first_schema_are_read(wavy):
    save_proof(verify(wavy))
    document = json.loads(proof_path(wavy).read_text())
    document["proved"] = document.pop("exactness")
    del document["reproduced"], document["stated"]
    proof_path(wavy).write_text(json.dumps({**document, "schema_version": 1}))
    assert read_proof(wavy).exactness == "bits"
