"""Writing: the same bytes every time, and nothing but the last moments lost when the writer is killed."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from glbench.episodes import EpisodeWriter, episode_bytes, read_episode, read_log, recover, replayed_episodes, write_episode
from glbench.episodes.action_log import exactly, log_bytes
from glbench.errors import EpisodeError
from glbench.evaluation import evaluate, prepare, result_path
from tests.episodes.day import NARROW, RANDOM


def test_two_evaluations_write_the_same_bytes(day_task, write_agent, tmp_path):
    files = []
    for folder in (tmp_path / "one", tmp_path / "two"):
        evaluate(day_task, write_agent(RANDOM), out=folder, episodes="all")
        files.append({path.name: path.read_bytes() for path in folder.rglob("*.mcap")})
    assert len(files[0]) == 4
    assert files[0] == files[1]


def test_what_was_read_is_written_with_the_same_bytes(episode_file, day_result):
    assert episode_bytes(read_episode(episode_file)) == episode_file.read_bytes()
    result, path = day_result
    file = path.with_name(result.record.file)
    assert log_bytes(read_log(file)) == file.read_bytes()


def test_replaying_the_actions_gives_the_same_bytes_as_recording_them(day_result, day_task, episode_file):
    result, path = day_result
    log = read_log(path.with_name(result.record.file))
    for row, episode in zip((2, 0), replayed_episodes(day_task, log, (2, 0)), strict=True):
        recorded = episode_file.with_name(f"seed-{result.runs[row].seed}.mcap")
        assert episode_bytes(episode) == recorded.read_bytes()


class Stop(Exception):  # noqa: N818
    """Ends an evaluation from its progress callback."""


@pytest.mark.parametrize("at", [1, 13, 23])
def test_an_interrupted_and_resumed_evaluation_leaves_the_same_records(day_task, write_agent, tmp_path, at):
    agent = write_agent(RANDOM)
    evaluate(day_task, agent, out=tmp_path / "whole", episodes="all")

    def stop(progress):
        if progress.step == at:
            raise Stop

    evaluation = prepare(day_task, agent, out=tmp_path / "torn", checkpoint_seconds=0.0, episodes="all")
    with pytest.raises(Stop):
        evaluation.run(stop)
    result = evaluation.run()
    assert result.evaluation.resumed_at_step is not None
    whole = {path.relative_to(tmp_path / "whole"): path.read_bytes() for path in (tmp_path / "whole").rglob("*.mcap")}
    torn = {path.relative_to(tmp_path / "torn"): path.read_bytes() for path in (tmp_path / "torn").rglob("*.mcap")}
    assert whole == torn


def test_actions_that_float32_holds_are_stored_as_float32(day_task, write_agent, tmp_path):
    result = evaluate(day_task, write_agent(NARROW), out=tmp_path, episodes="best")
    log = read_log(result_path(tmp_path, day_task.id, "agent_under_test").with_name(result.record.file))
    (episode,) = (read_episode(path) for path in (tmp_path / "episodes").rglob("*.mcap"))
    assert log.actions.dtype == episode.tables["action"].dtype == np.float32
    assert exactly(np.array([0.1])).dtype == np.float64
    assert exactly(np.array([0.5])).dtype == np.float32


def test_a_record_cut_anywhere_gives_back_its_beginning(episode_file, tmp_path):
    whole, data = read_episode(episode_file), episode_file.read_bytes()
    generator = np.random.Generator(np.random.PCG64(5))
    head = len(episode_bytes(whole)) // 3
    recovered = []
    for cut in sorted(generator.integers(head, len(data) - 1, size=12).tolist()):
        torn = tmp_path / "torn.mcap"
        torn.write_bytes(data[:cut])
        with pytest.raises(EpisodeError, match="recover"):
            read_episode(torn)
        try:
            left = recover(torn, tmp_path / "recovered.mcap")
        except EpisodeError as error:
            assert "holds no steps" in str(error) or "lacks the attachment" in str(error)  # noqa: PT017
            continue
        again = read_episode(tmp_path / "recovered.mcap")
        assert again.steps == left.steps <= 24
        assert not again.complete or left.steps == 24
        for name, table in whole.tables.items():
            assert again.tables[name].tobytes() == table[: left.steps].tobytes()
        recovered.append(left.steps)
    assert recovered == sorted(recovered)
    assert recovered[-1] >= 20


def test_a_long_record_loses_no_more_than_the_chunk_it_was_at(episode_file, tmp_path):
    day = read_episode(episode_file)
    buffer, written = io.BytesIO(), []
    writer = EpisodeWriter(buffer, day.provenance, day.run, day.definition, day.groups, np.dtype(np.float64))
    writer.begin(day.times[0], day.start)
    for first in range(0, 24, 4):
        written.append(buffer.tell())
        writer.steps(day.times[first : first + 5], {name: table[first : first + 4] for name, table in day.tables.items()})
    for chunks, size in enumerate(written):
        (tmp_path / "torn.mcap").write_bytes(buffer.getvalue()[: size + 1])
        assert read_episode(tmp_path / "torn.mcap", partial=True).steps == 4 * chunks


KILLED = """
import os, signal, sys, time
import numpy as np
from glbench.episodes import EpisodeWriter, read_episode
day = read_episode(sys.argv[1])
file = open(sys.argv[2], "wb")
writer = EpisodeWriter(file, day.provenance, day.run, day.definition, day.groups, np.dtype(np.float64))
writer.begin(day.times[0], day.start)
for first in range(0, 20, 4):
    writer.steps(day.times[first : first + 5], {name: table[first : first + 4] for name, table in day.tables.items()})
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_writer_leaves_what_it_wrote(episode_file, tmp_path):
    done = subprocess.run([sys.executable, "-c", KILLED, str(episode_file), str(tmp_path / "killed.mcap")], check=False, env={**os.environ})
    assert done.returncode == -signal.SIGKILL
    left = recover(tmp_path / "killed.mcap", tmp_path / "recovered.mcap")
    assert left.steps == 20
    assert "cut off" in (left.problem or "")


def test_an_episode_that_lacks_steps_is_not_written_as_a_whole_one(episode_file, tmp_path):
    (tmp_path / "torn.mcap").write_bytes(episode_file.read_bytes()[:-24000])
    torn = read_episode(tmp_path / "torn.mcap", partial=True)
    assert 0 < torn.steps < torn.run.steps
    with pytest.raises(EpisodeError, match="recover"):
        write_episode(tmp_path / "again.mcap", torn)
