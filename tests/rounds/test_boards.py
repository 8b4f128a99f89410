"""The board of a round: its own results alone, found by the task's name."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from glbench.leaderboard.collect import own_and_released_results
from tests.cli.command_line import Command
from tests.rounds.conftest import OTHER, SECRET

pytestmark = pytest.mark.usefixtures("few_released")
FIRST, SECOND = (f"test/Tiny-v1@{one.commitment}" for one in (SECRET, OTHER))


@pytest.fixture
def folder(reports: Path) -> Path:
    """The folder of the first round."""
    return reports / "rounds" / SECRET.commitment[:16]


def test_the_tables_of_a_round_hold_the_results_of_the_round_alone(glbench: Command, folder: Path) -> None:
    answer = glbench("leaderboard", "--write", "--all", "--out", folder)
    assert answer.code == 0, answer.err
    written = json.loads((folder / "leaderboard.json").read_text(encoding="utf-8"))
    assert [table["task"] for table in written["tasks"]] == ["test/Tiny-v1"]
    assert FIRST[:-48] in answer.out
    assert "Spring-v1" not in (folder / "leaderboard.md").read_text(encoding="utf-8")
    assert "Spring-v1" not in answer.out
    assert "more task" not in answer.err


def test_the_folder_with_public_results_still_has_the_released_ones(reports: Path) -> None:
    assert {item.released for item in own_and_released_results(reports)[0]} == {True, False}


def test_verify_finds_the_trials_of_a_round(glbench: Command, tmp_path: Path) -> None:
    (tmp_path / "trials" / "results").mkdir(parents=True)
    answer = glbench("verify", tmp_path / "results")
    assert answer.code != 0
    assert f"results of trials (--runs): glbench verify {tmp_path / 'trials' / 'results'}" in answer.err


def test_a_page_of_a_round_is_not_for_publication_and_says_so(glbench: Command, reports: Path, folder: Path) -> None:
    pytest.importorskip("plotly")
    of_round, public = glbench("report", "--out", folder), glbench("report", "--out", reports)
    assert (of_round.code, public.code) == (0, 0)
    assert "of a sealed round. Publish it only after the round" in of_round.err
    assert "sealed round" not in public.err


@pytest.mark.parametrize("name", ["test/Tiny-v1", "Tiny-v1", FIRST, FIRST[:-48], FIRST.removeprefix("test/")])
def test_the_only_board_of_a_task_is_found_by_the_name_of_the_task(glbench: Command, folder: Path, name: str) -> None:
    for command in (("leaderboard",), ("badge", "rule_based", "--file", folder / "badge.svg")):
        answer = glbench(*command, "--task", name, "--out", folder)
        assert answer.code == 0, answer.err
    assert FIRST[:-48] in glbench("leaderboard", "--task", name, "--out", folder).out


def test_of_several_boards_of_a_task_one_is_to_be_named(glbench: Command, reports: Path, folder: Path) -> None:
    other = reports / "rounds" / OTHER.commitment[:16] / "results"
    shutil.copytree(other, folder / "results" / "other")
    answer = glbench("leaderboard", "--task", "test/Tiny-v1", "--out", folder)
    assert answer.code != 0
    assert "'test/Tiny-v1' has several boards here" in answer.err
    assert FIRST in answer.err
    assert SECOND in answer.err
