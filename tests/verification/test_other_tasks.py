"""Results of a task of schema 2 are reproduced run by run, each in its own season, and what was changed in them is found."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from glbench.evaluation import evaluate, result_path
from glbench.tasks import get_task
from glbench.verification import verify
from tests.evaluation.agent_files import agent_writer
from tests.support import lettuce_task
from tests.verification.forging import Document, changed, rewrite, rewrite_record


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lettuce")
    result = evaluate(lettuce_task(), agent_writer(folder)(), out=folder / "reports", episodes="best")
    return result_path(folder / "reports", lettuce_task().id, result.agent.name)


@pytest.fixture
def result(honest: Path, tmp_path: Path) -> Path:
    folder = honest.parents[2]
    return Path(shutil.copytree(folder, tmp_path / "reports")) / honest.relative_to(folder)


def test_it_is_reproduced_from_its_records_alone(result: Path) -> None:
    verdict = verify(result)

    assert (verdict.outcome, verdict.exactness, verdict.runs, len(verdict.episodes)) == ("reproduced", "bits", 3, 1)


@pytest.mark.parametrize("kind", ["actions", "controls"])
def test_runs_with_faults_of_actuators_are_reproduced(tmp_path: Path, kind: str) -> None:
    often = {"days_between": 0.2, "hours": 2.0}
    actuators = {"uVent": {"lag_minutes": 10.0, "sticks": often}, "uBoil": {"fails": often}, "uThScr": {"shortfall": 0.2}}
    changes = {"id": "test/Faults-v1", "weather.days": 1, "evaluation.runs": 2, "actuators": actuators}
    agent = agent_writer(tmp_path)() if kind == "actions" else "rule_based"
    result = evaluate(get_task("Spring-v1").replace(changes), agent, out=tmp_path / "reports", episodes="best")
    verdict = verify(result_path(tmp_path / "reports", "test/Faults-v1", result.agent.name))
    assert (verdict.outcome, verdict.exactness, verdict.runs, len(verdict.episodes)) == ("reproduced", "bits", 2, 1)


def _metric(name: str) -> Callable[[Document], None]:
    return lambda document: document["runs"][1]["metrics"].update({name: document["runs"][1]["metrics"][name] + 0.01})


@pytest.mark.parametrize("name", ["reward", "epi", "cost_electricity", "heads_gained", "hours_outside_limits"])
def test_another_metric_is_found(result: Path, name: str) -> None:
    rewrite(result, _metric(name))

    assert verify(result).outcome == "refuted"


def test_another_unit_is_found(result: Path) -> None:
    rewrite(result, lambda document: document["units"].update(heat="MJ m-2"))
    verdict = verify(result)

    assert (verdict.outcome, verdict.cause) == ("refuted", "units")
    assert "heat in MJ m-2, not kWh m-2" in verdict.reason


def test_the_metric_that_ranks_must_be_there(result: Path) -> None:
    def without(document: Document) -> None:
        for values in (*(run["metrics"] for run in document["runs"]), document["units"]):
            del values["epi"]

    rewrite(result, without)
    verdict = verify(result)

    assert (verdict.outcome, verdict.cause) == ("refuted", "metric")


def test_a_reward_of_another_season_is_found(result: Path) -> None:
    rewrite_record(result, lambda log: replace(log, rewards=changed(log.rewards, (5, 0), log.rewards[5, 1])))

    assert verify(result).outcome == "refuted"
