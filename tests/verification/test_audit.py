"""The auditor confirms results that were honestly made, finds those that were forged, and says what it cannot audit.

Forgeries are thorough: digests and summaries follow what was changed, so that only recomputing finds it.
"""

from __future__ import annotations

import ast
import datetime as dt
import json
import math
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import rfc8785

from benchmarks import audit, audit_weather
from glbench.env import uncertainty
from glbench.env.random import key_of
from glbench.env.scenario import RunScenarios, run_weather
from glbench.episodes import action_log, read_log
from glbench.evaluation import evaluate, load_result, result_path
from glbench.tasks import get_task
from glbench.tasks.spreads import read_spread
from glbench.verification.documents import find_task
from glbench.verification.proof import Refused
from tests.episodes.day import FAILING, RANDOM
from tests.evaluation.agent_files import agent_writer
from tests.support import write_short_task
from tests.verification.forging import changed, perturb, record_of, rewrite, rewrite_record

SPRING = """
base = "glbench/Spring-v1"
id = "test/SpringDay-v1"
title = "A day of spring"
weather.days = 1
evaluation.runs = 2
evaluation.first_seed = 10003
"""

REAL = """
base = "glbench/GreenhouseReal-v1"
id = "test/RealDay-v1"
title = "A Monday in real greenhouses, with vents that often stick and a CO2 supply that often fails"
weather.days = 1
scenario.start_within_days = 0
evaluation.runs = 2
actuators.uVent.sticks = { days_between = 0.2, hours = 2.0 }
actuators.uVent.wind.above.value = 1.0
actuators.uCo2.fails = { days_between = 0.2, hours = 2.0 }
actuators.uCo2.sticks = { days_between = 0.2, hours = 2.0 }
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with tasks of a day and results on them."""
    folder = tmp_path_factory.mktemp("audited")
    (folder / "springday.toml").write_text(SPRING)
    (folder / "realday.toml").write_text(REAL)
    write_short_task(folder, "Day", days=1)
    write = agent_writer(folder)
    evaluate(get_task(folder / "springday.toml"), write(RANDOM, "wavy"), out=folder / "reports", episodes="none")
    (folder / "papersky.toml").write_text(SPRING.replace("SpringDay", "PaperSky") + 'weather.preprocessing = "paper"\n')
    evaluate(get_task(folder / "papersky.toml"), write(RANDOM, "wavy"), out=folder / "reports", episodes="none", runs=1)
    for agent in (write(RANDOM, "wavy"), "rule_based"):
        evaluate(get_task(folder / "realday.toml"), agent, out=folder / "reports", episodes="none")
    for agent in (write(FAILING, "failing"), "rule_based"):
        evaluate(get_task(folder / "day.toml"), agent, out=folder / "reports", episodes="none")
    return folder


@pytest.fixture
def forged(made: Path, tmp_path: Path) -> Path:
    """A copy of the result on the day of spring, to be forged."""
    reports = Path(shutil.copytree(made / "reports", tmp_path / "reports"))
    return result_path(reports, "test/SpringDay-v1", "wavy")


def audited(result: Path, made: Path, capsys: pytest.CaptureFixture[str], *more: str, task: str = "springday") -> tuple[int, str]:
    code = audit.main([str(result), "--task", str(made / f"{task}.toml"), *more])
    return code, capsys.readouterr().out


def test_an_honest_result_agrees(made, capsys):
    """Crop, house, start, a generated season and its CO2, violations as means."""
    code, words = audited(result_path(made / "reports", "test/SpringDay-v1", "wavy"), made, capsys)
    assert code == 0, words
    assert "run 10003: 96 steps" in words
    assert "run 10004: 96 steps" in words
    assert words.startswith("test/SpringDay-v1, test split, agent wavy: 2 runs from 10003 on\n")
    assert "\nnot audited: the digest of a task that is not published, the agent and what it saw, " in words
    assert words.endswith(", profile, episodes\nagrees (2 of 2 runs)\n")


@pytest.mark.parametrize("agent", ["wavy", "rule_based"])
def test_an_honest_result_on_the_day_of_real_greenhouses_agrees(made, capsys, agent):
    """Measured houses, actuators that lag, stick, fail and are drawn in by wind, a crew that picks on Mondays, a crop of trusses."""
    code, words = audited(result_path(made / "reports", "test/RealDay-v1", agent), made, capsys, task="realday")
    assert code == 0, words
    assert "run 10000: 96 steps" in words
    assert words.endswith("agrees (2 of 2 runs)\n")


@pytest.mark.parametrize(
    ("line", "other"),
    [
        ("uVent.sticks = { days_between = 0.2", "uVent.sticks = { days_between = 0.3"),
        ("uCo2.fails = { days_between = 0.2, hours = 2.0", "uCo2.fails = { days_between = 0.2, hours = 3.0"),
        ("wind.above.value = 1.0", "wind.above.value = 6.0"),
        ("evaluation.runs = 2", "evaluation.runs = 2\nactuators.uBoil.shortfall = 0.0"),
        ("evaluation.runs = 2", "evaluation.runs = 2\nactuators.uThScr.lag_minutes = 9.0"),
        ("evaluation.runs = 2", "evaluation.runs = 2\nmodel.overrides.hecWall.value = 1.0"),
        ("evaluation.runs = 2", 'evaluation.runs = 2\nschedule = [{ control = "uAway", value = 0.0 }]'),
        (
            "evaluation.runs = 2",
            'evaluation.runs = 2\nschedule = [{ control = "uAway", value = 1.0, weekdays = ["monday"], hours = [7.0, 6.0] }]',
        ),
    ],
)
def test_other_houses_actuators_and_crews_are_other_runs(made, tmp_path, line, other):
    """Recomputed with another task, runs do not agree: each of these is computed and decides."""
    log = read_log(record_of(result_path(made / "reports", "test/RealDay-v1", "wavy")))
    (tmp_path / "realday.toml").write_text(REAL.replace(line, other))
    task = audit.Task(audit.task_tables("realday.toml", tmp_path), "test")
    run = (log.runs[0].model_dump(), log.actions[:, 0], log.rewards[:, 0], log.final_states[0])
    with pytest.raises(audit.VerdictError, match="run 10000"):
        audit.audit_run(task, run, {}, direct=False)


@pytest.mark.parametrize(("heat", "fewest", "most"), [((0.5, 1.5), 0, 0), ((0.95, 1.05), 1, 30), ((0.9999, 1.0001), 31, 31)])
def test_measured_houses_are_those_of_the_benchmark(monkeypatch, heat, fewest, most):
    """To the last digits; the narrower limits of heat make houses be drawn again, and the last one moved."""
    monkeypatch.setattr(audit, "HEAT", heat)
    monkeypatch.setattr(uncertainty, "HEAT", heat)
    seeds, attempts = list(range(10000, 10020)), []
    keys = np.array([key_of(f"measured {seed}") for seed in seeds], np.uint64)
    theirs = uncertainty.spread_multipliers(read_spread("measured", 2.0), keys)

    def numbers(label: str, attempt: int, count: int) -> audit.Array:
        attempts.append(attempt)
        return audit.uniforms(label, attempt, count)

    own = [[factor for _, factor in audit.house("measured", 2.0, partial(numbers, f"measured {seed}"))] for seed in seeds]
    np.testing.assert_allclose(own, theirs, rtol=1e-14)
    assert fewest <= max(attempts) <= most


def test_what_is_drawn_once_a_run_is_that_of_the_benchmark():
    """Parameters that follow from drawn ones, weather and start of the default task."""
    task, own = get_task("GreenhouseReal-v1").scored, audit.Task(audit.task_tables("glbench/GreenhouseReal-v1", Path()), "test")
    for seed in (10000, 10057):
        scenes, (weather, _) = RunScenarios(task).draw([seed]), own.weather(seed)
        assert scenes.parameters is not None
        np.testing.assert_array_equal(own.draw(own.nominal, seed, None), scenes.parameters[0, : len(own.parameters)])
        np.testing.assert_allclose(own.start(seed, weather[0]), scenes.states[0], rtol=1e-12)
        np.testing.assert_allclose(weather, run_weather(task, seed).values[: task.steps], rtol=1e-11, atol=1e-11)


def test_a_schedule_past_midnight():
    """Hours after midnight belong to the day on which they began."""
    own = audit.Task(audit.task_tables("glbench/GreenhouseReal-v1", Path()), "test")
    own.tables["schedule"] = [{"control": "uAway", "value": 0.5, "weekdays": ["monday"], "hours": [22.0, 6.0]}]
    monday = dt.datetime(2010, 2, 15)
    hours = [hour for hour in range(-24, 72) if own.schedule(monday + dt.timedelta(hours=hour))[own.controls.index("uAway")] == 0.5]
    assert hours == list(range(22, 30))


def test_only_runs_that_were_audited_agree(made, capsys):
    result = result_path(made / "reports", "test/SpringDay-v1", "wavy")
    code, words = audited(result, made, capsys, "--runs", "1")
    assert (code, "run 10004" in words, words.endswith("agrees (1 of 2 runs)\n")) == (0, False, True)
    for runs in ("0", "-1"):
        assert audited(result, made, capsys, "--runs", runs) == (2, "cannot be audited: no run to audit: --runs must be at least 1\n")


@pytest.mark.parametrize("agent", ["failing", "rule_based"])
def test_an_honest_result_on_the_paper_s_weather_agrees(made, capsys, agent):
    """Parameters that are redrawn in every step, runs that ended early, and a controller that sets controls."""
    code, words = audited(result_path(made / "reports", "test/Day-v1", agent), made, capsys, task="day")
    assert code == 0, words
    assert ("17 steps" if agent == "failing" else "24 steps") in words


def test_whole_numbers_in_a_task_file_are_those_of_the_record(made, capsys):
    """And its keys may come in another order, its words be others: neither is in the digest."""
    whole = made / "whole.toml"
    whole.write_text(
        'base = "day.toml"\nid = "test/Whole-v1"\ntitle = "Whole numbers"\ndescription = "Other words."\n'
        "uncertainty.delta = 0\nprices.heat.value = 1\ninitial_state.air_temperature.value = 18\n"
    )
    evaluate(get_task(whole), made / "wavy.py", out=made / "reports", episodes="none")
    result = result_path(made / "reports", "test/Whole-v1", "wavy")
    whole.write_text(whole.read_text().replace("Other words.", "Words that were found later."))
    code, words = audited(result, made, capsys, task="whole")
    assert code == 0, words
    assert find_task(load_result(result), read_log(record_of(result)), whole).id == "test/Whole-v1"


def test_co2_that_wanders_on_the_paper_s_weather(made, capsys):
    code, words = audited(result_path(made / "reports" / "trials", "test/PaperSky-v1", "wavy"), made, capsys, task="papersky")
    assert code == 0, words
    assert words.startswith(
        "test/PaperSky-v1, test split, agent wavy: 1 run from 10003 on; the task asks for 2 from 10003 on, of the test split"
    )


def differs(result: Path, made: Path, capsys: pytest.CaptureFixture[str], *words: str, task: str = "springday") -> None:
    code, said = audited(result, made, capsys, task=task)
    assert code == 1, said
    for word in ("differs: ", *words):
        assert word in said


def test_a_changed_reward(forged, made, capsys):
    rewrite_record(forged, lambda log: replace(log, rewards=changed(log.rewards, (40, 0), log.rewards[40, 0] + 1e-4)))
    differs(forged, made, capsys, "run 10003, step 41: the reward")


def test_a_changed_metric(forged, made, capsys):
    def cheaper(document):
        metrics = document["runs"][0]["metrics"]
        metrics["cost_heat"] *= 0.99

    rewrite(forged, cheaper)
    differs(forged, made, capsys, "run 10003: 'cost_heat'")


def test_a_better_reward_of_a_run(forged, made, capsys):
    rewrite(forged, lambda document: document["runs"][0]["metrics"].update(reward=1.0))
    differs(forged, made, capsys, "run 10003: the sum of the recorded rewards", "1.0")


def test_a_changed_action(forged, made, capsys):
    rewrite_record(forged, lambda log: replace(log, actions=changed(log.actions, (7, 0, 0), 0.9)))
    differs(forged, made, capsys, "run 10003, step 8: the reward")


def test_an_action_that_is_not_allowed(forged, made, capsys):
    """Kept within its bounds it would lead to the recorded rewards."""
    rewrite_record(forged, lambda log: replace(log, actions=changed(log.actions, (0, 0, 0), 7.0)))
    differs(forged, made, capsys, "run 10003: an action is outside its bounds")


def test_a_final_state_that_is_cut(forged, made, capsys):
    rewrite_record(forged, lambda log: replace(log, final_states=log.final_states[:, :5]))
    differs(forged, made, capsys, "run 10003: the size of the state: expected 35; found 5")


def test_a_changed_final_state(forged, made, capsys):
    rewrite_record(forged, lambda log: replace(log, final_states=changed(log.final_states, (0, 2), log.final_states[0, 2] + 0.01)))
    differs(forged, made, capsys, "run 10003: 'tAir' at the end")


def test_meters_that_do_not_follow(forged, made, capsys):
    rewrite_record(forged, lambda log: replace(log, final_states=changed(log.final_states, (0, -1), 12345.0)))
    differs(forged, made, capsys, "run 10003: 'relative_humidity outside its limit, summed' at the end")


def test_another_task_in_the_record(forged, made, capsys):
    rewrite_record(forged, lambda log: replace(log, definition=log.definition.replace(b"1.6", b"9.9")))
    differs(forged, made, capsys, "the record: expected ", "ledger.revenue_harvest.price=1.6", "ledger.revenue_harvest.price=9.9")
    with pytest.raises(Refused, match="The task definition in the record is not that of test/SpringDay-v1"):
        find_task(load_result(forged), read_log(record_of(forged)), made / "springday.toml")


def test_other_columns_in_the_record(forged, made, capsys):
    def turn(log):
        agent = log.provenance.agent
        return replace(
            log, provenance=log.provenance.model_copy(update={"agent": agent.model_copy(update={"columns": agent.columns[::-1]})})
        )

    rewrite_record(forged, turn)
    differs(forged, made, capsys, "the record: expected columns.0=uBoil, ")


def test_a_run_that_ended_early_and_claims_to_be_complete(forged, made, capsys, monkeypatch):
    original, failing = action_log.canonical, forged.parents[1] / "Day-v1" / "failing.json"
    whole = {"status": "ok", "reason": None, "steps": 24}

    def canonical(model):
        document = json.loads(original(model))
        document["runs"] = [run | whole for run in document["runs"]] if "runs" in document else None
        return audit.canonical(document if document["runs"] else json.loads(original(model))).encode()

    rewrite(failing, lambda document: [run.update(whole) for run in document["runs"]])
    monkeypatch.setattr(action_log, "canonical", canonical)
    rewrite_record(failing, lambda log: log)
    differs(failing, made, capsys, "claims 24 steps and 17 actions; the record holds 17 rewards and 17 actions", task="day")


def test_a_controller_that_hides_its_privilege(forged, made, capsys):
    rules = forged.parents[1] / "Day-v1" / "rule_based.json"
    rewrite(rules, lambda document: document["agent"].update(privileged=False))
    rewrite_record(
        rules,
        lambda log: replace(
            log, provenance=log.provenance.model_copy(update={"agent": log.provenance.agent.model_copy(update={"privileged": False})})
        ),
    )
    differs(rules, made, capsys, "expected agent.privileged=True; found agent.privileged=False", task="day")


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("hours_co2_low", -0.5, "run 10003: 'hours_co2_low' is negative, -0.5 h"),
        ("bonus", 0.0, "expected units.bonus=None; found units.bonus=h"),
    ],
)
def test_metrics_that_cannot_be(forged, made, capsys, name, value, words):
    def add(document):
        document["units"][name] = "h"
        for run in document["runs"]:
            run["metrics"][name] = value

    rewrite(forged, add)
    differs(forged, made, capsys, words)


def test_a_key_that_is_there_twice(forged, made, capsys):
    forged.write_text(forged.read_text().replace('"summary":', '"summary": {"runs": 500}, "summary":', 1))
    differs(forged, made, capsys, "the key 'summary' appears twice")


def test_a_file_cannot_stand_in_for_a_published_task(forged, made, capsys, tmp_path):
    rewrite(forged, lambda document: document["task"].update(id="glbench/Spring-v1"))
    (tmp_path / "mine.toml").write_text(SPRING.replace("test/SpringDay-v1", "glbench/Spring-v1"))
    code = audit.main([str(forged), "--task", str(tmp_path / "mine.toml")])
    assert (code, "glbench/Spring-v1 is published: leave out --task" in capsys.readouterr().out) == (2, True)


def test_other_seeds(forged, made, capsys):
    """Both seeds one later: another season, crop and house."""

    def shift(document):
        for run in document["runs"]:
            run["seed"] += 1

    rewrite(forged, shift)
    rewrite_record(forged, lambda log: replace(log, runs=tuple(run.model_copy(update={"seed": run.seed + 1}) for run in log.runs)))
    differs(forged, made, capsys, "run 10004, step 1: the reward")


def test_runs_that_change_places(forged, made, capsys):
    def swap(document):
        first, second = document["runs"]
        first["metrics"], second["metrics"] = second["metrics"], first["metrics"]

    rewrite(forged, swap)
    rewrite_record(
        forged, lambda log: replace(log, actions=log.actions[:, ::-1], rewards=log.rewards[:, ::-1], final_states=log.final_states[::-1])
    )
    differs(forged, made, capsys, "run 10003, step 1: the reward")


def test_everything_a_hundredth_better(forged, made, capsys):
    """Rewards, states and metrics agree with each other, and not with the actions."""
    perturb(forged, 1.01)
    differs(forged, made, capsys, "run 10003, step ")


def test_a_digest_that_was_not_repaired(forged, made, capsys):
    rewrite(forged, lambda document: document["runs"][0]["metrics"].update(heat=0.0), repair=False)
    differs(forged, made, capsys, "results_digest")


@pytest.mark.parametrize(
    ("table", "key", "value", "words"),
    [
        ("agent", "name", "other", "agent"),
        ("agent", "digest", "1" * 64, "agent"),
        ("agent", "privileged", True, "agent"),
        ("summary", "runs", 500, "summary"),
        ("summary", "statuses", {"ok": 500}, "summary"),
        ("evaluation", "runs", 100, "runs=2"),
        ("units", "reward", None, "units"),
        ("units", "heat", "MJ m-2", "expected units.heat=kWh m-2; found units.heat=MJ m-2"),
        ("task", "steps", 5, "expected task.steps=96; found task.steps=5"),
        ("task", "step_seconds", 60.0, "expected task.step_seconds=900; found task.step_seconds=60"),
        ("task", "title", "A year", "found task.title=A year"),
        ("task", "years", [2008, 2009], "years.1.0=2008"),
        ("task", "split", "training", "expected split, years.1.0=2008"),
    ],
)
def test_who_acted_and_what_is_counted(forged, made, capsys, table, key, value, words):
    def change(document):
        document[table][key] = value
        if value is None:
            del document[table][key]

    rewrite(forged, change, repair=table == "agent")
    differs(forged, made, capsys, words)


def test_what_cannot_be_audited(forged, made, capsys):
    code, words = audited(forged, made, capsys, task="day")
    assert (code, "the task file defines test/Day-v1" in words) == (2, True), words
    forged.with_name("wavy.actions.mcap").write_bytes(b"no record")
    code, words = audited(forged, made, capsys)
    assert (code, words.startswith("cannot be audited: ")) == (2, True), words
    with pytest.raises(audit.VerdictError, match=r"ledger\.cost_electricity\.price=power") as error:
        audit.Task(audit.task_tables("glbench/WinterLED-v1", Path()), "test")
    assert error.value.args[0] == audit.CANNOT


def test_only_the_model_comes_from_glbench():
    nodes = [node for file in (audit, audit_weather) for node in ast.walk(ast.parse(Path(file.__file__).read_text(encoding="utf-8")))]
    imported = {node.module for node in nodes if isinstance(node, ast.ImportFrom)}
    imported |= {name.name for node in nodes if isinstance(node, ast.Import) for name in node.names}
    own = {name for name in imported if name and name.partition(".")[0] in ("glbench", "benchmarks", "docs", "tests")}
    assert own == {"glbench.model", "benchmarks.audit_weather"}


def test_canonical_json():
    numbers = [
        0.0,
        -0.0,
        1.0,
        -1.5,
        123456789012.0,
        1e20,
        1e21,
        1.5e300,
        1e-6,
        1.2e-7,
        5e-324,
        0.1,
        2.0**53 - 1,
        math.pi * 1e-5,
        math.pi * 1e25,
        7,
    ]
    value = {"b": numbers, "a": [True, None, 'é\n"\u2028'], "€": {}, "\U0001f600": []}
    assert audit.canonical(value).encode() == rfc8785.dumps(value)
