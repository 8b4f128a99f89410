"""``baselines/release.py``: what it releases, and what it refuses."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from glbench.agents.baselines import digests_of_baseline
from glbench.agents.identity import baseline_names
from glbench.errors import ResultError
from glbench.evaluation import Result, load_result, result_path, save_result
from glbench.evaluation.records import GitState, results_digest
from glbench.evaluation.sandbox.choosing import EXAMPLES
from glbench.tasks import list_tasks
from glbench.verification import proof_path
from glbench.weather.trace import TRACE
from tests.support import baselines_script

ROOT = Path(__file__).resolve().parents[2]
COMMIT = GitState(commit="c" * 40, dirty=False)


@pytest.fixture
def release(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    module = baselines_script("release")
    monkeypatch.setattr(module, "git_state", lambda: COMMIT)
    return module


@pytest.fixture
def result() -> Result:
    """A released result, as if it came from this commit."""
    file = result_path(ROOT / "reports" / "released", "glbench/Schiphol2010-Delta10-v1", "rule_based")
    return load_result(file).model_copy(update={"git": COMMIT})


def with_kernel(result: Result, **changes: str) -> Result:
    evaluation = result.evaluation.model_copy(update={"kernel": result.evaluation.kernel | changes})
    return result.model_copy(update={"evaluation": evaluation})


def test_every_released_result_and_every_built_in_agent_is_planned(release):
    jobs = release.plan()
    released = [file for file in (ROOT / "reports/released/results").rglob("*.json") if "proof" not in file.name]
    assert len([job for job in jobs if job.released is not None]) == len(released)
    set_points = {"grower", "setpoints"}  # that no published task asks for
    assert {job.agent for job in jobs} >= {*baseline_names(), *EXAMPLES} - set_points  # a public copy has others, too
    assert {job.ref for job in jobs if job.agent == "do_nothing"} == {str(ROOT / "submissions" / "do_nothing.py")}


def test_a_result_of_this_commit_with_the_released_digest_is_accepted(release, result, tmp_path):
    job = release.Job("rule_based", result.task.id, result.results_digest)
    release.check(job, result, tmp_path, new_digests=False)


@pytest.mark.parametrize("git", [None, GitState(commit="c" * 40, dirty=True), GitState(commit="d" * 40, dirty=False)])
def test_a_result_of_another_state_of_the_checkout_is_refused(release, result, tmp_path, git):
    job = release.Job("rule_based", result.task.id, result.results_digest)
    with pytest.raises(ResultError, match="the checkout changed"):
        release.check(job, result.model_copy(update={"git": git}), tmp_path, new_digests=False)


def test_other_scores_are_refused_unless_they_are_meant_to_change(release, result, tmp_path):
    job = release.Job("rule_based", result.task.id, "0" * 64)
    with pytest.raises(ResultError, match="the scores differ"):
        release.check(job, result, tmp_path, new_digests=False)
    release.check(job, result, tmp_path, new_digests=True)


def test_the_result_of_a_baseline_that_grew_is_kept_if_all_runs_are_the_same(release, tmp_path):
    name, task = "rule_based_greenhouse", "GreenhouseReal-v1"
    kept = load_result(release.RELEASED / "results" / task / f"{name}.json")
    job = release.Job(name, kept.task.id, kept.results_digest)

    def evaluated(digest: str):
        agent = kept.agent.model_copy(update={"digest": digest})
        stated = results_digest(kept.task.digest, agent, kept.runs, kept.task.salt_commitment)
        return kept.model_copy(update={"agent": agent, "results_digest": stated})

    again, stranger = evaluated(digests_of_baseline(name)[0]), evaluated("0" * 64)
    assert (release.is_kept(job, again), release.is_kept(job, stranger), release.is_kept(job, kept)) == (True, False, False)
    save_result(again, tmp_path)
    assert not release.is_released(job, tmp_path / "out", tmp_path), "without a note of verify"
    proof_path(result_path(tmp_path, task, name)).write_text("{}", encoding="utf-8")
    assert release.is_released(job, tmp_path / "out", tmp_path)


def test_a_result_with_failed_runs_is_refused(release, result, tmp_path):
    job = release.Job("rule_based", result.task.id, None)
    failed = result.runs[0].model_copy(update={"status": "crashed", "reason": "There is no policy for this task."})
    summary = result.summary.model_copy(update={"failed": 1})
    with pytest.raises(ResultError, match="1 of 30 runs failed, the first with: There is no policy"):
        release.check(job, result.model_copy(update={"runs": (failed, *result.runs[1:]), "summary": summary}), tmp_path, new_digests=True)


def test_builds_of_the_kernel_are_not_mixed(release, result, tmp_path):
    job = release.Job("rule_based", result.task.id, result.results_digest)
    save_result(with_kernel(result, library_digest="f" * 64), tmp_path)
    save_result(with_kernel(result, library_digest="f" * 64), tmp_path / "first" / release.TRIALS)
    for work in (tmp_path, tmp_path / "first"):
        with pytest.raises(ResultError, match="another build"):
            release.check(job, result, work, new_digests=False)
    with pytest.raises(ResultError, match="needs a C"):
        release.check(job, with_kernel(result, backend="casadi"), tmp_path, new_digests=False)
    save_result(result, tmp_path / "out")
    for work in (tmp_path, tmp_path / "first"):
        assert release.unlike(tmp_path / "out", work) == ["results/Schiphol2010-Delta10-v1/rule_based.json"]
    assert release.unlike(tmp_path / "out", tmp_path / "out") == []


def test_a_released_result_of_a_changed_checkout_is_found(release, result, tmp_path):
    save_result(result, tmp_path)
    assert release.of_changed_checkouts(tmp_path) == []
    save_result(result.model_copy(update={"git": GitState(commit="c" * 40, dirty=True)}), tmp_path)
    assert release.of_changed_checkouts(tmp_path) == ["results/Schiphol2010-Delta10-v1/rule_based.json"]


def test_what_is_copied_is_done_until_it_changes(release, result, tmp_path):
    job = release.Job("rule_based", result.task.id, None)
    for folder in ("work", "out"):
        for place, _ in release.copies(job, tmp_path / folder, tmp_path / "nowhere"):
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_text(place.name, encoding="utf-8")
    assert release.is_released(job, tmp_path / "out", tmp_path / "work")
    place.write_text("another proof", encoding="utf-8")
    assert not release.is_released(job, tmp_path / "out", tmp_path / "work")


def test_no_weather_of_a_package_is_shipped() -> None:
    """Neither in profiles of results nor in recorded inputs."""
    tasks = [task for task in list_tasks() if task.weather.source == TRACE]
    results = [file for task in tasks for file in (ROOT / "reports" / "released" / "results" / task.short_id).iterdir()]
    assert len(results) >= 8
    assert not [file.name for file in results if ".profile." in file.name]
    with np.load(ROOT / "tests" / "golden" / "baseline_inputs.npz") as inputs:
        assert not [name for name in inputs for task in tasks if name.startswith(task.short_id)]
