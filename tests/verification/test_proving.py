"""Honest results are proved, and what cannot be known is not claimed."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from glbench.episodes import episodes_folder, read_log
from glbench.evaluation import evaluate, load_result, provenance, result_path
from glbench.evaluation.preparing import TRIALS
from glbench.verification import comparing, proof_path, read_proof, save_proof, verify
from glbench.verification.comparing import Agreement
from tests.episodes.day import RANDOM
from tests.evaluation.agent_files import GOOD
from tests.verification.forging import changed, record_of, rewrite, rewrite_record


@pytest.mark.parametrize("agent", ["wavy", "narrow", "failing", "rule_based"])
def test_an_honest_result_is_proved_to_the_last_bit(reports, day_task, agent):
    verdict = verify(result_path(reports, day_task.id, agent))
    assert (verdict.outcome, verdict.exactness, verdict.exit_code) == ("proved", "bits", 0), verdict
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


def test_a_step_that_cannot_be_simulated_is_proved_to_fail_again(day_task, write_agent, tmp_path, monkeypatch):
    from glbench.kernel import Kernel, StepFailure

    plain = Kernel.try_step

    def brittle(self, x, u, d, p):
        """A kernel that cannot do a boiler above 0.35."""
        after, failed = plain(self, x, u, d, p)
        rows = np.flatnonzero(u[:, 0] > 0.35)
        after[rows] = x[rows]
        return after, [*failed, *(StepFailure(int(row), "too hot") for row in rows)]

    monkeypatch.setattr(Kernel, "try_step", brittle)
    monkeypatch.setattr(
        Kernel, "environments", lambda kernel, program, n: None
    )  # a fused step does not ask for this one
    result = evaluate(
        day_task, write_agent("def act(self, observations):\n    return np.full((self.n, 6), 1.0)"), out=tmp_path
    )
    path = result_path(tmp_path, day_task.id, "agent_under_test")
    assert {(run.status, run.steps) for run in result.runs} == {("simulation_failed", 3)}
    assert verify(path).exactness == "bits"
    monkeypatch.setattr(Kernel, "try_step", plain)
    verdict = verify(path)
    assert (verdict.outcome, verdict.cause) == ("refuted", "status") or verdict.cause in {"reward", "metric", "state"}


def test_an_agent_that_never_started_is_proved(day_task, write_agent, tmp_path):
    agent = write_agent(
        "def reset(self, task, n_runs):\n    raise OSError('no weights')\ndef act(self, observations):\n    return 0"
    )
    result = evaluate(day_task, agent, out=tmp_path, episodes="best")
    assert {run.steps for run in result.runs} == {0}
    assert verify(result_path(tmp_path, day_task.id, "agent_under_test")).exactness == "bits"


def test_a_resumed_evaluation_is_proved(day_task, write_agent, tmp_path):
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


def test_fewer_runs_than_the_task_asks_for_are_proved_as_a_trial(day_task, write_agent, tmp_path):
    evaluate(day_task, write_agent(GOOD), out=tmp_path, runs=2)
    verdict = verify(result_path(tmp_path / TRIALS, day_task.id, "agent_under_test"))
    assert verdict.outcome == "proved"
    assert "trial of 2 runs" in verdict.notes[0]


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
    here = provenance.machine()
    monkeypatch.setattr(provenance, "machine", lambda: here.model_copy(update={"processor": "Abacus 9"}))


def scaled(factor):
    return lambda log: replace(log, rewards=changed(log.rewards, (5, 0), log.rewards[5, 0] * factor))


def test_the_same_bits_on_another_processor_are_still_the_same_bits(wavy, elsewhere):
    verdict = verify(wavy)
    assert verdict.exactness == "bits"
    assert "Abacus 9" in verdict.reason


def test_a_last_digit_of_another_processor_is_within_the_tolerance_and_said(wavy, elsewhere):
    rewrite_record(wavy, scaled(1.0 + 1e-12))
    verdict = verify(wavy)
    assert (verdict.outcome, verdict.exactness) == ("proved", "tolerance")
    assert "not to the last bit" in verdict.reason
    assert 1e-14 < verdict.largest_difference < 1e-11


def test_the_same_last_digit_on_the_same_machine_is_refuted(wavy):
    rewrite_record(wavy, scaled(1.0 + 1e-12))
    assert verify(wavy).cause == "reward"


def test_more_than_the_tolerance_on_another_processor_cannot_be_told(wavy, elsewhere):
    rewrite_record(wavy, scaled(1.0 + 1e-6))
    unknown(wavy, "other_machine", "step 6")


def test_no_processor_explains_a_forged_reward(wavy, elsewhere):
    rewrite_record(wavy, scaled(0.5))
    verdict = verify(wavy)
    assert (verdict.outcome, verdict.cause) == ("refuted", "reward")
    assert "cannot explain" in verdict.reason


def test_the_tolerance_is_relative_to_the_column():
    one = np.array([[1000.0, 1.0], [0.0, 2.0]])
    found = Agreement().add("x", one, one + np.array([[0.0, 0.0], [5e-7, 0.0]]), ("a", "b"), "here")
    assert found.largest == pytest.approx(5e-10)
    assert found.largest < comparing.TOLERANCE
    assert found.first_large is None
    assert found.first.words == "here, step 2, a: recorded 0.0, found 5e-07"


def test_zeros_of_different_sign_are_different_bits():
    found = Agreement().add("x", np.array([[0.0]]), np.array([[-0.0]]), ("a",), "here")
    assert found.first is not None
    assert found.verdict(same_machine=True, other="") is not None
    assert found.verdict(same_machine=False, other="the processor differs") is None


# Proofs


def test_a_proof_lies_beside_the_result_and_holds_for_this_very_file(wavy):
    assert read_proof(wavy) is None
    assert save_proof(verify(wavy)) == proof_path(wavy)
    proof = read_proof(wavy)
    assert (proof.proved, proof.runs, proof.full_episodes) == ("bits", 3, (666, 667, 668))
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
    proof_path(wavy).write_text(json.dumps({"schema": "glbench/proof", "proved": "bits"}))
    assert read_proof(wavy) is None
