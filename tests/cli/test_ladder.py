"""``glbench ladder``: it trains what is missing, continues what was interrupted, and says what went wrong."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path

import pytest

from glbench.agents.predictive import read_predictive_settings
from glbench.agents.rules import FairRuleBasedAgent
from glbench.cli.console import Printer
from glbench.cli.ladder import _agent, _evaluate, _rungs
from glbench.evaluation import load_result, result_path
from glbench.evaluation.jobs import Job, LocalEngine, Outcome, Report
from glbench.kernel import why_not_compiled
from glbench.leaderboard.ladder import Ladder
from glbench.resources import data_folder
from glbench.tasks import get_task
from tests.cli.command_line import Command

TINY = """
default:
  learner: compiled
  n_envs: 8
  n_steps: 12
  batch_size: 48
  net_arch: [8]
  scenarios: 2
  places: 4
  evaluation: {every: 100, runs: 1, first_seed: 20_000_000_000}
"""
SEARCH = """
default:
  directions: 2
  population: 4
  generations: 2
  evaluation: {every: 100, runs: 1, first_seed: 20_000_000_000}
"""
OF_DAY = ("day.toml", "--config", "tiny.yml", "--steps", "200", "--split", "test", "--runs", "3", "--out", "lad", "--workers", "1")


@pytest.fixture
def day(here: Path) -> Path:
    (here / "tiny.yml").write_text(TINY, encoding="utf-8")
    (here / "wrong.yml").write_text(f"{SEARCH}  actions: [uCO2]\n", encoding="utf-8")
    return here


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--views", "outdor"), r"--views: there is no view 'outdor'. Did you mean 'outdoor'?"),
        (("--views", "without_co3"), "'co3'. Did you mean 'co2'"),
        (("--split", "training"), "--split training is not evaluated"),
        (("--agents", "my_agent"), "my_agent: 'my_agent' is neither a file or folder here nor a baseline"),
        (("--rules", "runs/tuned"), "runs/tuned: "),
        (("--rules", "grower"), "--rules grower: The grower works at a process computer"),
        (("--search", "tiny.yml"), "tiny.yml"),
        (("--search", "other.yml"), "other.yml"),
        (("--search", "wrong.yml"), "'actions' names 'uCO2', which is not an action of the task. Did you mean 'uCo2'?"),
        (("--zero", "grower"), "has the actuation 'rate'. Name others: --zero rule_based_fair, or --zero grower where"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_trained(day: Path, glbench: Command, arguments: tuple[str, str], words: str) -> None:
    refused = glbench("ladder", *OF_DAY, *arguments)
    assert refused.code == 1
    assert words in refused.err.replace("\n", " ")
    assert not (day / "lad").exists()


def test_an_agent_that_fails_in_all_runs_is_reported_and_left_out(day: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (day / "broken.py").write_text("def make_agent(task):\n    raise ValueError('no')\n", encoding="utf-8")
    task = get_task(str(day / "day.toml"))
    results = _evaluate(task, {"steady.py": 2, "broken.py": 2}, day / "lad", 1, Printer())
    assert list(results) == ["steady.py"]
    assert "ValueError: no" in capfd.readouterr().err
    rungs = _rungs(task, results, {Path("steady.py"): ("outdoor", 4)})
    assert [(rung.name, rung.kind, rung.columns, rung.seeds) for rung in rungs] == [("outdoor", "ppo", 15, (4,))]
    assert rungs[0].values == (results["steady.py"].values("reward"),)
    (other,) = _rungs(task, results, {})
    assert (other.name, other.kind, other.columns, other.seeds) == ("steady", "other", None, ())


def test_mpc_is_the_baseline_that_plans_for_the_model_of_the_task(day: Path) -> None:
    """Its name, its settings with a view, and its rung, which is called mpc whichever it is."""
    baselines = {"mpc": get_task("Spring-v1"), "mpc_greenhouse": get_task("GreenhouseReal-v1")}
    for name, task in baselines.items():
        assert _agent(day, "mpc", task) == name
        assert read_predictive_settings(Path(_agent(day, "mpc_blind", task)) / "settings.yml").end_values.keys() == {
            *read_predictive_settings(data_folder("baselines") / name / "settings.yml").end_values
        }
        assert _agent(day, "grower", task) == "grower"
    assert _agent(day, "mpc", get_task("Lettuce-v1")) == "mpc", "whose error says which models there are"
    result = load_result(result_path(data_folder("reports/released"), "glbench/Spring-v1", "mpc"))
    for name in baselines:
        agent = result.agent.model_copy(update={"name": name})
        (rung,) = _rungs(get_task("Spring-v1"), {name: result.model_copy(update={"agent": agent})}, {})
        assert (rung.name, rung.kind) == ("mpc", "mpc")


def test_an_agent_that_fails_stops_no_other_and_is_tried_again(day: Path, glbench: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    def too_late(*_: object) -> None:
        raise TimeoutError

    monkeypatch.setattr("glbench.cli.ladder._train", lambda *_: {day / "steady.py": ("outdoor", 0)})
    arguments = ("ladder", *OF_DAY, "--views", "outdoor", "--trainings", "1", "--rules", "rule_based_fair", "--agents", "", "--json")
    with monkeypatch.context() as slow:
        slow.setattr(FairRuleBasedAgent, "act", too_late)
        part = glbench(*arguments)
    assert part.code == 1
    ladder = Ladder.model_validate_json(part.out)
    assert [(rung.name, rung.failed) for rung in ladder.rungs] == [("outdoor", 0), ("rule_based_unlit", 0)]
    assert ladder.rows[0].lead is not None
    assert (ladder.zero, ladder.rules, ladder.separation) == ("rule_based_unlit", "rule_based_fair", None)
    files = {file.name: file.stat().st_mtime_ns for file in (day / "lad" / "results" / "Day-v1").glob("*.json")}

    whole = glbench(*arguments)
    assert whole.code == 0, whole.err
    assert [rung.name for rung in Ladder.model_validate_json(whole.out).rungs] == ["outdoor", "rule_based_unlit", "rule_based_fair"]
    again = {file.name for file in (day / "lad" / "results" / "Day-v1").glob("*.json") if file.stat().st_mtime_ns != files[file.name]}
    assert again == {"rule_based_fair.json"}


@pytest.mark.slow
@pytest.mark.train
@pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))
def test_it_continues_what_was_interrupted_and_repeats_nothing(day: Path, glbench: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("jax", reason="JAX is not installed (extra 'jax')")
    run = LocalEngine.run

    def interrupted(engine: LocalEngine, jobs: list[Job], report: Report) -> Iterator[Outcome]:
        for number, outcome in enumerate(run(engine, jobs, report)):
            if number == 2:
                raise KeyboardInterrupt
            yield outcome

    monkeypatch.setattr(LocalEngine, "run", interrupted)
    arguments = ("ladder", *OF_DAY, "--trainings", "2", "--agents", "steady.py", "--agent-runs", "2", "--rules", "rule_based_fair")
    stopped = glbench(*arguments, "--views", "outdoor")
    assert stopped.code == 130
    assert "Run the same command again to continue" in stopped.err
    assert not (day / "lad" / "ladder-test.json").exists()
    monkeypatch.undo()
    monkeypatch.setenv("GLBENCH_SANDBOX", "none")
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.chdir(day)
    policies = [day / "lad" / f"ppo-Day-v1-outdoor-seed{seed}" / "policy.npz" for seed in (0, 1)]
    times = [file.stat().st_mtime_ns for file in policies]

    whole = glbench(*arguments, "--views", "outdoor,without_co2")
    assert whole.code == 0, whole.err
    assert [file.stat().st_mtime_ns for file in policies] == times
    assert whole.err.count("already there") == 3, "three evaluations were done before the interruption"
    assert "choose nothing by them" in whole.err
    ladder = Ladder.model_validate_json((day / "lad" / "ladder-test.json").read_text(encoding="utf-8"))
    assert [rung.name for rung in ladder.rungs] == ["outdoor", "without_co2", "rule_based_unlit", "rule_based_fair", "steady"]
    assert [rung.kind for rung in ladder.rungs] == ["ppo", "ppo", "other", "other", "other"]
    assert [rung.columns for rung in ladder.rungs] == [15, 21, None, None, None]
    assert {len(rung.seeds) for rung in ladder.rungs[:2]} == {2}
    assert [len(values) for rung in ladder.rungs for values in rung.values] == [3, 3, 3, 3, 3, 3, 2]
    assert len(ladder.seeds) == 3
    result = json.loads((day / "lad" / "results" / "Day-v1" / "ppo-Day-v1-outdoor-seed1.json").read_text(encoding="utf-8"))
    assert list(ladder.rungs[0].values[1]) == [one["metrics"]["reward"] for one in result["runs"]]
    assert ladder.verdicts[0].blind == "outdoor"
    assert "ppo: outdoor keeps" in whole.out

    (policies[0].parent / "settings.yml").unlink()
    again = glbench(*arguments, "--views", "outdoor,without_co2", "--json")
    assert again.code == 0
    assert json.loads(again.out) == json.loads((day / "lad" / "ladder-test.json").read_text(encoding="utf-8"))
    assert [file.stat().st_mtime_ns for file in policies] == times

    other = glbench(*arguments, "--views", "outdoor", "--steps", "400")
    assert other.code == 1, "another number of steps is another training"
    assert "holds another training" in other.err
    assert "This ladder is not complete, so lad/ladder-test.json stays as it is." in other.err
    kept = json.loads((day / "lad" / "ladder-test.json").read_text(encoding="utf-8"))
    assert [rung["name"] for rung in kept["rungs"]] == [rung.name for rung in ladder.rungs]


@pytest.mark.slow
@pytest.mark.train
@pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))
def test_searches_follow_each_training_and_the_last_one_is_the_agent(day: Path, glbench: Command) -> None:
    pytest.importorskip("jax", reason="JAX is not installed (extra 'jax')")
    pytest.importorskip("cmaes", reason="cmaes is not installed (extra 'train')")
    (day / "first.yml").write_text(SEARCH, encoding="utf-8")
    (day / "second.yml").write_text(SEARCH.replace("population: 4", "population: 6"), encoding="utf-8")
    arguments = ("ladder", *OF_DAY, "--trainings", "1", "--agents", "", "--rules", "rule_based_fair", "--views", "outdoor")
    line = (*arguments, "--search", "first.yml", "--search", "second.yml")
    whole = glbench(*line, "--json")
    assert whole.code == 0, whole.err
    ladder = Ladder.model_validate_json(whole.out)
    assert ladder.search_steps == 2 * (4 + 6) * get_task(str(day / "day.toml")).steps
    assert f"trainings of 200 steps and searches of {ladder.search_steps:,} steps" == ladder.trained
    agent = day / "lad" / "ppo-Day-v1-outdoor-seed0"
    places = [agent.with_name(f"{agent.name}-stage1"), agent.with_name(f"{agent.name}-stage2"), agent]
    policies = [(place / "policy.npz").read_bytes() for place in places]
    cards = [tomllib.loads((place / "card.toml").read_text(encoding="utf-8")) for place in places]
    assert [card["start"]["digest"] for card in cards[1:]] == [sha256(policy).hexdigest() for policy in policies[:2]]
    assert ["adapted" in card["title"] for card in cards] == [False, True, True]
    (result,) = (day / "lad" / "results" / "Day-v1").glob("ppo-*.json")
    assert list(ladder.rungs[0].values[0]) == [run["metrics"]["reward"] for run in json.loads(result.read_text(encoding="utf-8"))["runs"]]

    times = [(place / "policy.npz").stat().st_mtime_ns for place in places]
    again = glbench(*line, "--json")
    assert (again.code, again.out) == (0, whole.out)
    assert [(place / "policy.npz").stat().st_mtime_ns for place in places] == times

    (day / "longer.yml").write_text(SEARCH.replace("generations: 2", "generations: 3"), encoding="utf-8")
    changed = glbench(*arguments, "--search", "longer.yml", "--search", "second.yml")
    assert changed.code == 1
    assert "begun with other settings" in changed.err
    assert [(place / "policy.npz").stat().st_mtime_ns for place in places] == times, "what was trained stays usable"
    assert glbench(*line, "--json").out == whole.out
    (day / "lad" / f"{agent.name}-stages.json").unlink()
    assert "holds a training without these searches" in glbench(*line).err
