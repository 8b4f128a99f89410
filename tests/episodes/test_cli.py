"""``glbench episodes`` and ``glbench evaluate --episodes`` as a person meets them."""

from __future__ import annotations

import shutil

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import glbench.episodes
from glbench.cli.app import app
from glbench.cli.console import messages, output
from glbench.errors import EpisodeError
from glbench.evaluation import result_path
from glbench.verification import verify
from tests.episodes.day import RANDOM
from tests.support import write_day_task

RUNNER = CliRunner()


@pytest.fixture(autouse=True)
def _wide(monkeypatch):
    """A terminal of 200 columns. The consoles are remembered with their width, so they are made anew before and after."""
    monkeypatch.setenv("COLUMNS", "200")
    for console in (messages, output):
        console.cache_clear()
    yield
    for console in (messages, output):
        console.cache_clear()


def run(*arguments):
    return RUNNER.invoke(app, list(map(str, arguments)))


def test_info_shows_origin_and_every_column_with_its_unit(episode_file):
    done = run("episodes", "info", episode_file)
    assert done.exit_code == 0, done.output
    for words in ("test/Day-v1", "wavy", "666", "/outcome.model_state", "cost_electricity", "EUR m-2", "mg m-3", "float64"):
        assert words in done.stdout, words


def test_info_of_recorded_actions_names_runs_and_digest(day_result):
    result, path = day_result
    done = run("episodes", "info", path.with_name(result.record.file))
    assert "seeds 666 to 668" in done.stdout
    assert result.record.digest in done.stdout


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_an_exported_table_reads_back_to_the_same_bits(episode_file, tmp_path, ending):
    out = tmp_path / f"table.{ending}"
    assert run("episodes", "export", episode_file, "--to", out).exit_code == 0
    frame = glbench.episodes.read(episode_file)
    dates = ["utc_start", "utc_end"]
    back = pd.read_parquet(out) if ending == "parquet" else pd.read_csv(out, index_col="step", dtype=str)
    assert list(back.columns) == list(frame.columns)
    for name in frame.columns.drop(dates):
        assert np.array([float(value) for value in back[name]]).tobytes() == np.asarray(frame[name], np.float64).tobytes(), name
    if ending == "parquet":
        assert back.attrs["units"] == frame.attrs["units"]
        assert (back[dates] == frame[dates]).all().all()


def test_export_wants_to_know_the_format(episode_file, tmp_path):
    done = run("episodes", "export", episode_file, "--to", tmp_path / "table.xyz")
    assert isinstance(done.exception, EpisodeError)


@pytest.mark.parametrize("more", [(), ("--to", "table.csv", "--minari", "day-v0")])
def test_export_wants_to_know_what_to_write(episode_file, more):
    done = run("episodes", "export", episode_file, *more)
    assert isinstance(done.exception, EpisodeError)
    assert "--to" in str(done.exception)
    assert "--minari" in str(done.exception)


def test_what_is_said_of_a_dataset_is_not_for_a_table(episode_file, tmp_path):
    done = run("episodes", "export", episode_file, "--to", tmp_path / "table.csv", "--noise", "0.1")
    assert "are for --minari" in str(done.exception)
    assert not (tmp_path / "table.csv").exists()


def test_a_table_is_of_one_episode(episode_file, tmp_path):
    done = run("episodes", "export", episode_file, episode_file, "--to", tmp_path / "table.csv")
    assert isinstance(done.exception, EpisodeError)
    assert not (tmp_path / "table.csv").exists()


def test_agents_are_exported_as_a_dataset_of_each_its_seasons(write_agent, tmp_path, monkeypatch):
    minari = pytest.importorskip("minari", reason="Minari is not installed (extra 'minari')")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    agents = write_agent(RANDOM, "wavy"), "rule_based_fair"
    done = run("episodes", "export", *agents, "--minari", "day-v0", "--task", write_day_task(tmp_path), "--runs", "2",
               "--noise", "0.1", "--seed", "50_000_000_000", "--author", "A. Grower")  # fmt: skip
    assert done.exit_code == 0, done.output
    assert "wavy" in done.stdout
    assert "96 steps" in done.stderr
    dataset = minari.load_dataset("day-v0")
    seeds = [one["seed"] for one in dataset.storage.get_episode_metadata(range(4))]
    assert seeds == list(range(50_000_000_000, 50_000_000_004))
    assert dataset.storage.metadata["author"] == {"A. Grower"}


def test_recover_says_how_many_steps_are_lost(episode_file, tmp_path):
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(episode_file.read_bytes()[:-24000])
    done = run("episodes", "recover", torn)
    assert done.exit_code == 0, done.output
    recovered = glbench.episodes.read_episode(tmp_path / "torn.recovered.mcap")
    assert f"Recovered {recovered.steps} of 24 steps" in done.stderr
    assert 0 < recovered.steps < 24
    assert "recovered from a file that was cut" in run("episodes", "info", tmp_path / "torn.recovered.mcap").stdout


def test_evaluate_keeps_three_episodes_and_the_others_can_be_made(write_agent, tmp_path):
    task, agent, out = write_day_task(tmp_path), write_agent(RANDOM, "wavy"), tmp_path / "out"
    assert run("evaluate", agent, "--task", task, "--out", out, "--episodes", "best").exit_code == 0
    assert len(list((out / "episodes").rglob("*.mcap"))) == 1
    path = result_path(out, "test/Day-v1", "wavy")
    done = run("episodes", "make", path, "--episodes", "all")
    assert done.exit_code == 0, done.output
    assert len(done.stdout.splitlines()) == len(list((out / "episodes").rglob("*.mcap"))) == 3
    assert verify(path).episodes == (666, 667, 668)
    assert "chooses no run, so nothing was written" in run("episodes", "make", path, "--episodes", "none").stderr
    shutil.rmtree(out / "episodes")
    assert run("evaluate", agent, "--task", task, "--out", out).exit_code == 0
    assert 2 <= len(list((out / "episodes").rglob("*.mcap"))) <= 3


def test_a_misspelt_choice_is_answered_before_the_evaluation(write_agent, tmp_path):
    task = write_day_task(tmp_path)
    done = run("evaluate", write_agent(RANDOM), "--task", task, "--out", tmp_path / "out", "--episodes", "bets")
    assert isinstance(done.exception, EpisodeError)
    assert "best" in str(done.exception)
