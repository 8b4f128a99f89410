from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import filelock
import numpy as np
import pytest

from glbench.agents import Agent, load_agent
from glbench.env import Simulation
from glbench.errors import EpisodeError, GlbenchError, ResultError, SubmissionError, TaskError
from glbench.evaluation import Progress, Result, evaluate, load_result, prepare
from glbench.evaluation.records import usable_cores
from glbench.leaderboard.collect import own_and_released_results
from glbench.tasks import TaskSpec, get_task, task_card
from tests.evaluation.agent_files import AgentWriter


def test_metrics_are_the_plain_sums_of_a_simulation(day_task: TaskSpec, write_agent: AgentWriter) -> None:
    path = write_agent()
    result = evaluate(day_task, path)

    simulation = Simulation(day_task, 3)
    agent = load_agent(path).make(task_card(day_task))
    assert isinstance(agent, Agent)
    agent.reset(task_card(day_task), 3)
    observations = simulation.reset([666, 667, 668])
    reward, heat = np.zeros(3), np.zeros(3)
    for _ in range(day_task.steps):
        step = simulation.step(agent.act(observations))
        observations = step.observations
        reward += step.rewards
        heat += step.quantities["heat"]

    assert result.values("reward") == tuple(reward)
    assert result.values("heat") == tuple(heat)
    assert [run.seed for run in result.runs] == [666, 667, 668]
    assert all(run.status == "ok" and run.steps == 24 for run in result.runs)


def test_seasons_of_a_preview_are_not_scored() -> None:
    preview = get_task("Transfer-Miami-v1").in_split("preview")
    with pytest.raises(TaskError, match="Transfer-Miami-v1 is in its preview, whose seasons are not scored"):
        evaluate(preview, "rule_based_fair", runs=1)


def test_epi_is_revenue_minus_costs(good_result: Result) -> None:
    for run in good_result.runs:
        m = run.metrics
        assert m["epi"] == pytest.approx(m["revenue"] - m["cost_heat"] - m["cost_electricity"] - m["cost_co2"], abs=1e-12)
        assert 0.0 <= m["hours_outside_limits"] <= 24.0


def test_one_worker_and_two_give_the_same_bits(day_task: TaskSpec, good_result: Result, write_agent: AgentWriter) -> None:
    one = good_result
    two = evaluate(day_task, write_agent(), workers=2)

    assert two.evaluation.workers == 2
    assert two.runs == one.runs
    assert two.results_digest == one.results_digest
    assert two.evaluation.kernel == one.evaluation.kernel


def test_a_run_has_the_same_bits_alone_and_among_others(day_task: TaskSpec, good_result: Result, write_agent: AgentWriter) -> None:
    alone = evaluate(day_task, write_agent(), runs=1, first_seed=667)

    assert alone.runs == good_result.runs[1:2]


def test_different_seeds_give_different_runs(good_result: Result) -> None:
    assert len(set(good_result.values("reward"))) == 3


@pytest.mark.parametrize(("name", "privileged"), [("rule_based", True), ("rule_based_fair", False)])
def test_baselines_run_and_say_what_they_know(day_task: TaskSpec, name: str, privileged: bool) -> None:
    result = evaluate(day_task, name)

    assert result.summary.statuses == {"ok": 3}
    assert result.agent.privileged is privileged
    assert result.agent.information.startswith("privileged") is privileged


def test_a_single_run_agent_gets_what_a_batched_one_gets(day_task: TaskSpec, good_result: Result, write_agent: AgentWriter) -> None:
    single = write_agent(
        """
        def act(self, observation):
            wanted = np.tanh((observation[:6].astype(float) - 20.0) / 50.0)
            self.memory = 0.5 * self.memory + 0.5 * wanted
            return self.memory
        """,
        name="single",
        single=True,
    )

    assert evaluate(day_task, single).runs == good_result.runs


def test_progress_is_told_of_every_step(day_task: TaskSpec, write_agent: AgentWriter) -> None:
    seen: list[Progress] = []
    evaluate(day_task, write_agent(), progress=seen.append)

    assert [(p.waiting, p.limit) for p in seen[:3]] == [("loading", 300.0), ("reset", 300.0), ("act", 30.0)]
    assert [p.step for p in seen[2:]] == list(range(25))
    assert seen[-1] == Progress(step=24, steps=24, alive=3, runs=3, replaying=False)


def test_a_finished_evaluation_is_not_done_again(day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path) -> None:
    path, out = write_agent(), tmp_path / "reports"
    first = evaluate(day_task, path, out=out)
    steps: list[Progress] = []
    again = evaluate(day_task, path, out=out, progress=steps.append)

    assert again == first == load_result(out / "results" / "Day-v1" / "agent_under_test.json")
    assert not steps
    evaluate(day_task, path, out=out, fresh=True, progress=steps.append)
    assert steps


def test_a_changed_agent_is_evaluated_again(day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path) -> None:
    out = tmp_path / "reports"
    first = evaluate(day_task, write_agent(), out=out)
    changed = write_agent("def act(self, observations):\n    return np.zeros((self.n, 6))")
    second = evaluate(day_task, changed, out=out)

    assert second.agent.digest != first.agent.digest
    assert second.results_digest != first.results_digest
    assert load_result(out / "results" / "Day-v1" / "agent_under_test.json") == second


def test_a_trial_does_not_replace_the_full_evaluation(day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path) -> None:
    path, out = write_agent(), tmp_path / "reports"
    full_file = out / "results" / "Day-v1" / "agent_under_test.json"
    first = evaluate(day_task, path, runs=1, out=out)
    assert not full_file.exists(), "a trial is one also where there is no full evaluation yet"
    full = evaluate(day_task, path, out=out)

    for options in ({"runs": 1}, {"runs": 1, "fresh": True}, {"first_seed": 7, "fresh": True}):
        trial = evaluate(day_task, path, out=out, **options)
        assert load_result(out / "trials" / "results" / "Day-v1" / "agent_under_test.json") == trial
        assert load_result(full_file) == full
    assert first.results_digest != full.results_digest


def test_trials_on_validation_and_on_the_test_do_not_replace_each_other(write_agent: AgentWriter, tmp_path: Path) -> None:
    task, path = get_task("Spring-v1"), write_agent()
    folder = Path("results", "Spring-v1", "agent_under_test.json")
    evaluate(task, path, runs=1, out=tmp_path)
    evaluate(task.in_split("validation"), path, runs=1, out=tmp_path)
    assert load_result(tmp_path / "trials" / folder).task.split == "test"
    assert load_result(tmp_path / "validation" / folder).task.split == "validation"
    stored, _ = own_and_released_results(tmp_path)
    assert [(item.board, item.origin) for item in stored if item.result.agent.name == "agent_under_test"] == [
        ("glbench/Spring-v1", "trial"),
        ("glbench/Spring-v1@validation", "trial"),
    ]


def test_a_built_in_agent_that_does_not_fit_the_task_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SubmissionError, match="The grower works at a process computer, and glbench/Spring-v1 has"):
        evaluate("Spring-v1", "grower", runs=1, out=tmp_path)
    assert not list(tmp_path.rglob("*.json")), "no run of it failed: there is no result"


@pytest.mark.parametrize("runs", [10_001, 10**9])
def test_more_runs_than_a_machine_holds_are_refused(day_task: TaskSpec, write_agent: AgentWriter, runs: int) -> None:
    with pytest.raises(GlbenchError, match=f"at most 10,000 runs; got {runs:,}"):
        prepare(day_task, write_agent(), runs=runs)


def test_episodes_are_chosen_by_text(day_task: TaskSpec, write_agent: AgentWriter) -> None:
    with pytest.raises(EpisodeError, match=r"such as 'best,worst,median'; got \['all'\]"):
        prepare(day_task, write_agent(), episodes=["all"])  # type: ignore[arg-type]


def test_a_task_of_another_namespace_does_not_replace_a_result(
    day_task: TaskSpec, day_task_file: Path, write_agent: AgentWriter, tmp_path: Path
) -> None:
    evaluate(day_task, write_agent(), runs=1, out=tmp_path)
    other = tmp_path / "other.toml"
    other.write_text(day_task_file.read_text(encoding="utf-8").replace('"test/Day-v1"', '"mylab/Day-v1"'), encoding="utf-8")

    for fresh in (False, True):
        with pytest.raises(ResultError, match=r"holds a result of the task test/Day-v1, and mylab/Day-v1 would replace it"):
            evaluate(other, write_agent(), runs=1, out=tmp_path, fresh=fresh)


def test_a_task_of_the_same_id_and_another_definition_does_not_replace_a_result(
    day_task: TaskSpec, day_task_file: Path, write_agent: AgentWriter, tmp_path: Path
) -> None:
    first = evaluate(day_task, write_agent(), runs=1, out=tmp_path)
    other = tmp_path / "other.toml"
    text = day_task_file.read_text(encoding="utf-8")
    assert "co2_ppm = 400.0" in text
    other.write_text(text.replace("co2_ppm = 400.0", "co2_ppm = 410.0"), encoding="utf-8")

    with pytest.raises(ResultError, match=r"another task with the same id test/Day-v1 .* with --fresh"):
        evaluate(other, write_agent(), runs=1, out=tmp_path)

    assert evaluate(day_task, write_agent(), runs=1, out=tmp_path) == first
    assert evaluate(other, write_agent(), runs=1, out=tmp_path, fresh=True).task.digest == get_task(other).digest


def test_a_result_of_another_version_is_made_again(
    day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    evaluate(day_task, write_agent(), runs=1, out=tmp_path)

    assert prepare(day_task, write_agent(), runs=1, out=tmp_path).stored is not None
    monkeypatch.setattr("glbench.evaluation.evaluation.__version__", "99.0")
    assert prepare(day_task, write_agent(), runs=1, out=tmp_path).stored is None


def test_a_broken_result_in_the_way_is_replaced_and_said(
    day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = tmp_path / "reports" / "results" / "Day-v1" / "agent_under_test.json"
    file.parent.mkdir(parents=True)
    file.write_text('{"schema": "glbench/result", "sch', encoding="utf-8")
    result = evaluate(day_task, write_agent(), out=tmp_path / "reports")

    assert "no valid JSON" in caplog.text
    assert load_result(file) == result


def test_a_folder_that_cannot_be_written_is_found_out_before_the_run(day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path) -> None:
    in_the_way = tmp_path / "reports"
    in_the_way.write_text("a file, not a folder", encoding="utf-8")
    steps: list[Progress] = []

    with pytest.raises(GlbenchError, match=r"Cannot write into .*reports.*that you can write to"):
        evaluate(day_task, write_agent(), out=in_the_way, progress=steps.append)
    assert not steps


def test_two_evaluations_of_one_result_do_not_run_at_once(day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path) -> None:
    evaluation = prepare(day_task, write_agent(), out=tmp_path)
    lock = tmp_path / ".partial" / "Day-v1" / "agent_under_test.lock"
    lock.parent.mkdir(parents=True)
    with filelock.FileLock(lock), pytest.raises(GlbenchError, match="Another glbench process is evaluating 'agent_under_test'"):
        evaluation.run()
    assert evaluation.run().summary.ok == 3


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"runs": 0}, "at least one run; got 0"),
        ({"workers": 0}, "at least one worker; got 0"),
        ({"first_seed": -1}, "from seed -1"),
        ({"first_seed": 2**53}, "2\\^53 - 1"),
    ],
)
def test_impossible_numbers_are_refused(day_task: TaskSpec, write_agent: AgentWriter, arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(GlbenchError, match=words):
        evaluate(day_task, write_agent(), **arguments)


def test_without_a_wish_every_core_is_a_worker_but_no_more_than_there_are_runs(day_task: TaskSpec, write_agent: AgentWriter) -> None:
    assert prepare(day_task, write_agent(), workers=None).workers == min(usable_cores(), 3)
    assert prepare(day_task, write_agent(), workers=5).workers == 3


def test_a_result_tells_what_made_it(day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path) -> None:
    result = evaluate(day_task, write_agent(), runs=1)

    assert result.task.digest == day_task.digest
    assert result.agent.kind == "submission"
    assert result.versions.casadi
    assert result.machine.cores >= 1
    assert result.evaluation.kernel["variant"] == "author"
    assert result.evaluation.limits == {"start_seconds": 300.0, "step_seconds": 10.0, "run_seconds": 7200.0}
    assert result.evaluation.steps_per_second == pytest.approx(24 / result.evaluation.wall_seconds)
    assert str(tmp_path) not in result.to_json()


def test_a_disk_too_full_for_the_record_keeps_the_result(
    day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, _data: bytes) -> None:
        msg = f"Cannot write {path}: No space left on device."
        raise GlbenchError(msg)

    monkeypatch.setattr("glbench.evaluation.saving.write_atomically", full)
    with pytest.raises(GlbenchError, match="No space left"):
        evaluate(day_task, write_agent(), out=tmp_path)
    assert load_result(tmp_path / "results" / "Day-v1" / "agent_under_test.json").summary.ok == 3


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"runs": 1.5}, "The number of runs is a whole number; got 1.5"),
        ({"first_seed": "1"}, "The seed of the first run is a whole number; got '1'"),
        ({"workers": True}, "The number of workers is a whole number; got True"),
    ],
)
def test_numbers_of_the_wrong_kind_are_told_in_words(
    day_task: TaskSpec, write_agent: AgentWriter, arguments: dict[str, Any], words: str
) -> None:
    with pytest.raises(GlbenchError, match=re.escape(words)):
        evaluate(day_task, write_agent(), **arguments)
