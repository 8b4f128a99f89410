"""Verification of sealed results, before and after the reveal, of honest authors and of forgers who know glbench well."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from glbench.episodes import ActionLog, log_bytes, read_log
from glbench.evaluation import evaluate, result_path
from glbench.evaluation.evaluation import results_folder
from glbench.evaluation.records import AgentRecord, RunResult, results_digest
from glbench.tasks import Round, TaskSpec
from glbench.verification import Verdict, proof_path, save_proof, verify
from tests.cli.command_line import Command
from tests.rounds.conftest import OTHER, SECRET
from tests.rounds.tiny import REAL_YEARS, tiny_task


def claim(path: Path, commitment: str | None) -> None:
    """Make the result and its record say that their draws are those of ``commitment``; all digests follow."""
    log = read_log(path.with_name(f"{path.stem}.actions.mcap"))
    facts = log.provenance.task.model_copy(update={"salt_commitment": commitment})
    log = replace(log, provenance=log.provenance.model_copy(update={"task": facts}))
    _write(path, log, commitment)


def _write(path: Path, log: ActionLog, commitment: str | None) -> None:
    path.with_name(f"{path.stem}.actions.mcap").write_bytes(log_bytes(log))
    document = json.loads(path.read_text())
    document["record"]["digest"] = log.digest
    document["profile"] = None
    document["task"].pop("salt_commitment", None)
    if commitment is not None:
        document["task"]["salt_commitment"] = commitment
    runs = tuple(RunResult.model_validate_json(json.dumps(run)) for run in document["runs"])
    agent = AgentRecord.model_validate_json(json.dumps(document["agent"]))
    document["results_digest"] = results_digest(document["task"]["digest"], agent, runs, commitment)
    path.write_text(json.dumps(document))
    shutil.rmtree(path.parents[2] / "episodes", ignore_errors=True)


def verdict(found: Verdict) -> tuple[str, str, int]:
    return found.outcome, found.cause, found.exit_code


# Honest results


def test_before_the_reveal_a_result_is_sealed_and_gets_no_note(sealed: Path) -> None:
    found = verify(sealed)
    assert verdict(found) == ("sealed", "sealed", 3)
    assert found.exactness is None
    assert found.reproduced == ()
    assert SECRET.commitment in found.reason
    assert "Not checked" in found.reason
    assert "the public draws do not lead there" in found.reason
    assert save_proof(found) is None
    assert not proof_path(sealed).exists()


def test_after_the_reveal_it_is_reproduced_to_the_last_bit(sealed: Path) -> None:
    found = verify(sealed, sealed=SECRET)
    assert verdict(found) == ("reproduced", "", 0)
    assert found.exactness == "bits"
    assert "task.salt_commitment" in found.reproduced
    assert "profile" in found.reproduced
    assert len(found.episodes) == 1
    assert save_proof(found) == proof_path(sealed)


def test_a_public_result_is_verified_as_ever(public: Path) -> None:
    assert verdict(verify(public)) == ("reproduced", "", 0)


def test_a_round_with_weather_of_its_own_is_verified_like_any_other(
    tiny: TaskSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from glbench.tasks.sealed import round_weather
    from glbench.weather import load_weather, save_weather

    monkeypatch.setenv("GLBENCH_DATA", str(tmp_path / "host"))
    record = load_weather("schiphol")
    place = replace(record.place, station="A meadow")
    counts = {name: values.copy() for name, values in record.counts.items()}
    counts["air_temperature"] -= 1_000
    save_weather(replace(record, counts=counts, place=place), "meadow")
    sealed = Round("6" * 64, round_weather("meadow", [2009, 2011]))
    task = tiny.in_split("test", sealed.secret)
    evaluate(task, "rule_based", out=tmp_path)
    path = result_path(results_folder(tmp_path, task), task.id, "rule_based")
    assert verify(path).outcome == "sealed"
    assert verify(path, sealed=sealed).exactness == "bits"
    # Somebody else, who has the round's file and not yet its weather.
    monkeypatch.setenv("GLBENCH_DATA", str(tmp_path / "reader"))
    from glbench.tasks import resolver

    resolver._record_of.cache_clear()
    found = verify(path, sealed=sealed)
    assert verdict(found) == ("unknown", "no_weather", 2)
    assert "glbench weather import" in found.reason
    # The same salt without the weather is another round.
    assert verify(path, sealed=Round("6" * 64)).cause == "other_round"


# Wrong secrets


def test_the_secret_of_another_round_opens_nothing(sealed: Path) -> None:
    found = verify(sealed, sealed=OTHER)
    assert verdict(found) == ("unknown", "other_round", 2)
    assert found.exactness is None


def test_a_public_result_does_not_pass_for_one_of_a_round(public: Path) -> None:
    found = verify(public, sealed=SECRET)
    assert verdict(found) == ("unknown", "other_round", 2)
    assert "names no commitment" in found.reason


# Forged results


def test_a_commitment_changed_in_the_result_alone_is_told_at_once(sealed: Path) -> None:
    document = json.loads(sealed.read_text())
    document["task"]["salt_commitment"] = OTHER.commitment
    sealed.write_text(json.dumps(document))
    for given in (None, SECRET, OTHER):
        found = verify(sealed, sealed=given)
        assert (found.outcome, found.cause) == ("refuted", "inconsistent")


def test_a_commitment_changed_with_all_digests_of_the_result_does_not_fit_the_record(sealed: Path) -> None:
    log = read_log(sealed.with_name("rule_based.actions.mcap"))
    claim(sealed, OTHER.commitment)
    sealed.with_name("rule_based.actions.mcap").write_bytes(log_bytes(log))
    assert verdict(verify(sealed)) == ("refuted", "record_of_other_round", 1)


@pytest.mark.parametrize(
    ("which", "claimed", "before", "given", "after"),
    [
        # Draws of one's own choice, said to be the round's.
        ("other", SECRET.commitment, "sealed", SECRET, "refuted"),
        # Public draws, which one knows, said to be the round's: told even before the reveal.
        ("public", SECRET.commitment, "refuted", SECRET, "refuted"),
        # Secret draws, in which one had luck, said to be public.
        ("sealed", None, "refuted", SECRET, "refuted"),
    ],
)
def test_draws_that_are_not_those_claimed_are_refuted(
    reports: Path, tiny: TaskSpec, which: str, claimed: str | None, before: str, given: Round, after: str
) -> None:
    tasks = {"public": tiny, "sealed": tiny.in_split("test", SECRET.secret), "other": tiny.in_split("test", OTHER.secret)}
    path = result_path(results_folder(reports, tasks[which]), tiny.id, "rule_based")
    claim(path, claimed)
    assert verify(path).outcome == before
    assert verify(path, sealed=given).outcome == after


def test_a_commitment_that_nobody_can_open_stays_sealed(sealed: Path) -> None:
    claim(sealed, "0" * 64)
    assert verify(sealed).outcome == "sealed"
    assert verify(sealed, sealed=SECRET).cause == "other_round"


@pytest.mark.parametrize("commitment", ["", "x" * 64, "5" * 63, "A" * 64, 5, ["5" * 64]])
def test_what_is_no_commitment_is_no_result(sealed: Path, commitment: object) -> None:
    document = json.loads(sealed.read_text())
    document["task"]["salt_commitment"] = commitment
    sealed.write_text(json.dumps(document))
    assert verify(sealed).outcome == "refuted"


def test_rewards_that_do_not_add_up_are_refuted_before_the_reveal(sealed: Path) -> None:
    log = read_log(sealed.with_name("rule_based.actions.mcap"))
    rewards = log.rewards.copy()
    rewards[3, 2] += 1.0
    _write(sealed, replace(log, rewards=rewards), SECRET.commitment)
    assert verdict(verify(sealed)) == ("refuted", "metric", 1)


def test_rewards_that_add_up_and_were_not_earned_are_refuted_after_the_reveal(sealed: Path) -> None:
    log = read_log(sealed.with_name("rule_based.actions.mcap"))
    rewards = log.rewards.copy()
    rewards[3, 2] += 1.0
    document = json.loads(sealed.read_text())
    total = 0.0
    for reward in rewards[:, 2]:
        total += float(reward)
    document["runs"][2]["metrics"]["reward"] = total
    document["summary"]["mean"]["reward"] = math.fsum(run["metrics"]["reward"] for run in document["runs"]) / len(document["runs"])
    sealed.write_text(json.dumps(document))
    _write(sealed, replace(log, rewards=rewards), SECRET.commitment)
    assert verify(sealed).outcome == "sealed"
    assert verdict(verify(sealed, sealed=SECRET)) == ("refuted", "reward", 1)


def test_a_sealed_result_of_a_task_that_cannot_be_sealed_is_refuted(tmp_path: Path) -> None:
    from tests.support import write_day_task

    task_file = write_day_task(tmp_path)
    evaluate(task_file, "rule_based", out=tmp_path)
    path = result_path(tmp_path, "test/Day-v1", "rule_based")
    claim(path, SECRET.commitment)
    for given in (None, SECRET):
        assert verdict(verify(path, sealed=given)) == ("refuted", "sealed", 1)


def test_seasons_that_may_be_the_same_by_chance_refute_nobody(tmp_path: Path) -> None:
    """Two real years and nothing else that is drawn: a salt can draw what the public draws are."""
    text = REAL_YEARS
    for begin, end in (("[[scenario.parameters]]", "[sensors.air"), ("[sensors.air", "[observation]\n")):
        text = text[: text.index(begin)] + text[text.index(end) :]
    task = tiny_task(tmp_path, text.replace("start_within_days = 20\n", ""))
    sealed = task.in_split("test", Round("1" * 64).secret)
    evaluate(sealed, "rule_based", runs=1, out=tmp_path)
    path = result_path(results_folder(tmp_path, sealed) / "trials", task.id, "rule_based")
    found = verify(path)
    assert found.outcome == "sealed"
    assert "public draws do not" not in found.reason


# The command


@pytest.fixture
def opened(tmp_path: Path) -> Callable[[Round], Path]:
    def write(sealed: Round) -> Path:
        file = tmp_path / f"{sealed.commitment[:6]}.toml"
        file.write_text(sealed.to_toml(), encoding="utf-8")
        return file

    return write


def test_exit_codes(glbench: Command, sealed: Path, public: Path, reports: Path, opened: Callable[[Round], Path]) -> None:
    closed = glbench("verify", sealed)
    assert closed.code == 3
    assert "sealed: cannot be verified before the round is over" in closed.out
    assert "reproduced" not in closed.out
    assert not proof_path(sealed).exists()
    assert glbench("verify", sealed, "--round", opened(SECRET)).code == 0
    assert glbench("verify", sealed, "--round", opened(OTHER)).code == 2
    assert glbench("verify", public, sealed).code == 3, "one is reproduced, one is sealed"
    claim(public, SECRET.commitment)
    assert glbench("verify", public, sealed).code == 1
    told = glbench("verify", sealed, "--json")
    assert json.loads(told.out)["outcome"] == "sealed"
    bad = opened(SECRET)
    bad.write_text(bad.read_text().replace("5" * 64, "6" * 64))
    assert glbench("verify", sealed, "--round", bad).code == 1
