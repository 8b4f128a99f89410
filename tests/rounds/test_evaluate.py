"""Evaluations in a round: results apart from public ones, the salt nowhere, interruptions, engines."""

from __future__ import annotations

import dataclasses
import gzip
import importlib.util
import json
import pickle
from pathlib import Path

import pytest

from glbench.episodes import read_episode, read_log
from glbench.episodes.header import definition_json
from glbench.episodes.mcap_file import scan
from glbench.errors import EpisodeError, ResultError, SandboxError
from glbench.evaluation import evaluate, load_result, prepare, protect, result_path
from glbench.evaluation.evaluation import results_folder
from glbench.evaluation.jobs import Job, LocalEngine, Options, PackedAgent, PackedTask, RunsJob, compute_runs, join_parts
from glbench.evaluation.saving import make_episodes, task_of_result
from glbench.execution import JobContext
from glbench.resources import data_folder
from glbench.tasks import TaskSpec
from glbench.verification import SUFFIX
from tests.cli.command_line import Command
from tests.evaluation.agent_files import AgentWriter
from tests.evaluation.test_resume import StopError, stop_after
from tests.rounds.conftest import OTHER, SECRET


def test_results_of_rounds_lie_apart_and_replace_nothing(reports: Path, public: Path, sealed: Path) -> None:
    found = sorted(path.relative_to(reports).as_posix() for path in reports.rglob("rule_based.json"))
    folders = [f"rounds/{one.commitment[:16]}/results/Tiny-v1/rule_based.json" for one in (SECRET, OTHER)]
    assert found == sorted(["results/Tiny-v1/rule_based.json", *folders])
    digests = {load_result(reports / path).results_digest for path in found}
    assert len(digests) == 3
    assert load_result(public).task.salt_commitment is None
    assert load_result(sealed).task.salt_commitment == SECRET.commitment


def test_nothing_that_an_evaluation_writes_holds_the_salt(reports: Path, sealed: Path) -> None:
    files = [path for path in reports.rglob("*") if path.is_file()]
    assert len(files) >= 12
    wanted = (SECRET.salt.encode(), bytes.fromhex(SECRET.salt))
    for file in files:
        content = file.read_bytes()
        if file.suffix == ".mcap":  # compressed inside
            inside = scan(file)
            content += b"".join(inside.attachments.values()) + str(inside.metadata).encode() + b"".join(inside.chunks)
        elif file.suffix == ".gz":
            content += gzip.decompress(content)
        assert not any(salt in content for salt in wanted), file


def test_the_commitment_stands_in_result_record_and_episode(sealed: Path, public: Path) -> None:
    document = json.loads(sealed.read_text())
    assert document["task"]["salt_commitment"] == SECRET.commitment
    record = read_log(sealed.with_name("rule_based.actions.mcap"))
    assert record.provenance.task.salt_commitment == SECRET.commitment
    (episode,) = (sealed.parents[2] / "episodes" / "Tiny-v1" / "rule_based").glob("*.mcap")
    assert read_episode(episode).provenance.task.salt_commitment == SECRET.commitment
    for path in (public, public.with_name("rule_based.actions.mcap")):
        assert b"salt_commitment" not in path.read_bytes()


def test_released_results_are_written_again_with_the_same_bytes() -> None:
    files = [file for file in data_folder("reports/released/results").rglob("*.json") if not file.name.endswith(SUFFIX)]
    assert len(files) > 100
    assert [file for file in files if load_result(file).to_json() != file.read_text(encoding="utf-8")] == []


def test_the_definition_in_a_record_is_that_of_the_public_task(tiny: TaskSpec) -> None:
    assert definition_json(tiny.in_split("test", SECRET.secret)) == definition_json(tiny)


def test_a_stored_result_of_the_round_is_taken_and_fresh_makes_it_again(reports: Path, tiny: TaskSpec) -> None:
    task = tiny.in_split("test", SECRET.secret)
    assert prepare(task, "rule_based", out=reports).stored is not None
    assert prepare(task, "rule_based", out=reports, fresh=True).stored is None
    again = evaluate(task, "rule_based", out=reports, fresh=True)
    assert again.task.salt_commitment == SECRET.commitment


def test_a_result_of_another_round_in_the_same_folder_is_not_taken(reports: Path, sealed: Path, tiny: TaskSpec) -> None:
    task = tiny.in_split("test", OTHER.secret)
    for file in sealed.parent.iterdir():
        (results_folder(reports, task) / "results" / "Tiny-v1" / file.name).write_bytes(file.read_bytes())
    with pytest.raises(ResultError, match="other draws"):
        prepare(task, "rule_based", out=reports)


def test_trials_of_a_round_lie_below_it(tiny: TaskSpec, tmp_path: Path) -> None:
    task = tiny.in_split("test", SECRET.secret)
    evaluate(task, "rule_based", runs=2, out=tmp_path)
    assert result_path(results_folder(tmp_path, task) / "trials", task.id, "rule_based").is_file()


def test_an_interruption_changes_no_bit_and_its_checkpoint_holds_no_salt(tiny: TaskSpec, sealed: Path, tmp_path: Path) -> None:
    task, out = tiny.in_split("test", SECRET.secret), tmp_path / "again"
    with pytest.raises(StopError):
        evaluate(task, "rule_based", out=out, checkpoint_seconds=0.0, progress=stop_after(9))
    kept = [path for path in out.rglob("*") if path.is_file()]
    assert any(path.suffix == ".npz" for path in kept)
    for file in kept:
        assert SECRET.salt.encode() not in file.read_bytes()
        assert bytes.fromhex(SECRET.salt) not in file.read_bytes()
    # Neither the public draws nor another round go on from it.
    assert not prepare(tiny, "rule_based", out=out).interrupted
    assert not prepare(tiny.in_split("test", OTHER.secret), "rule_based", out=out).interrupted
    resumed = evaluate(task, "rule_based", out=out)
    assert resumed.evaluation.resumed_at_step == 9
    assert resumed.results_digest == load_result(sealed).results_digest


def test_an_agent_in_this_process_is_refused(tiny: TaskSpec, write_agent: AgentWriter) -> None:
    with pytest.raises(SandboxError, match="could read it"):
        prepare(tiny.in_split("test", SECRET.secret), write_agent())
    prepare(tiny, write_agent())


def test_a_task_without_a_test_split_is_refused(glbench: Command, tmp_path: Path) -> None:
    (tmp_path / "round.toml").write_text(SECRET.to_toml(), encoding="utf-8")
    answer = glbench(
        "evaluate", "rule_based", "--task", "glbench/Schiphol2010-Delta10-v1", "--round", tmp_path / "round.toml",
        "--out", tmp_path,
    )  # fmt: skip
    assert answer.code == 1
    assert "has no split 'test'" in answer.err


def test_the_record_of_a_round_is_replayed_with_its_secret_only(sealed: Path, tiny: TaskSpec, tmp_path: Path) -> None:
    result = load_result(sealed)
    with pytest.raises(EpisodeError, match="sealed round"):
        make_episodes(("all",), result, sealed, task_of_result(result, sealed), tmp_path / "episodes")
    with pytest.raises(EpisodeError, match="right round"):
        make_episodes(("all",), result, sealed, task_of_result(result, sealed, OTHER), tmp_path / "episodes")
    made = make_episodes(("all",), result, sealed, task_of_result(result, sealed, SECRET), tmp_path / "episodes")
    assert len(made) == len(result.runs)
    (kept,) = (sealed.parents[2] / "episodes" / "Tiny-v1" / "rule_based").glob("*.mcap")
    assert (tmp_path / "episodes" / kept.name).read_bytes() == kept.read_bytes()


def test_a_public_record_is_not_replayed_with_a_secret(public: Path, tmp_path: Path) -> None:
    result = load_result(public)
    with pytest.raises(EpisodeError, match="public draws"):
        make_episodes(("all",), result, public, task_of_result(result, public, SECRET), tmp_path / "episodes")


# On a cluster


def test_a_worker_has_the_draws_of_the_round(tiny: TaskSpec, sealed: Path) -> None:
    task = tiny.in_split("test", SECRET.secret)
    evaluation = prepare(task, "rule_based")
    order = RunsJob(
        PackedTask.of(task), PackedAgent.of("rule_based"), evaluation.seeds, False, evaluation.protection, evaluation.agent.digest
    )  # fmt: skip
    assert SECRET.salt not in repr(order)
    context = JobContext(None, lambda progress: None)
    computed = compute_runs(context, pickle.loads(pickle.dumps(order)))
    whole = join_parts(evaluation, [computed])
    assert whole.result.results_digest == load_result(sealed).results_digest
    assert whole.result.task.salt_commitment == SECRET.commitment
    without = compute_runs(context, dataclasses.replace(order, task=dataclasses.replace(order.task, sealed="")))
    assert without.result.task.salt_commitment is None


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="Ray is not installed")
@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.filterwarnings("ignore::FutureWarning")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_ray_computes_a_round_as_this_machine_does(tiny: TaskSpec, tmp_path: Path) -> None:
    from glbench.evaluation.jobs import RayEngine

    task = tiny.in_split("test", SECRET.secret)

    def jobs(out: str) -> list[Job]:
        return [Job(task, "rule_based", protect("rule_based", "auto"), Options(tmp_path / out, workers=1))]

    (there,) = RayEngine(cores=1).run(jobs("ray"), lambda job, standing: None)
    (here,) = LocalEngine().run(jobs("local"), lambda job, standing: None)
    assert there.result is not None, there.reason
    assert here.result is not None
    assert there.result.results_digest == here.result.results_digest
    assert there.result.task.salt_commitment == SECRET.commitment
