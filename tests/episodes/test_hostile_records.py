"""Records from elsewhere: small files that expand, counts that promise what is not there, texts that are no texts."""

from __future__ import annotations

import io
import json
import os
import sys
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from mcap.records import Channel
from typer.testing import CliRunner

from glbench.cli.app import app
from glbench.episodes import action_log, read_episode, read_log, recover
from glbench.episodes.action_log import RunTable
from glbench.episodes.episode import PROVENANCE, TASK, _groups, episode_bytes
from glbench.episodes.header import as_words, canonical, task_of
from glbench.episodes.mcap_file import Layout, McapWriter, Part, scan, scan_bytes
from glbench.errors import EpisodeError
from glbench.untrusted import MIB
from glbench.verification import verify


@pytest.fixture
def log(day_result):
    result, path = day_result
    return read_log(path.with_name(result.record.file))


def record(log, *, provenance=None, runs=None, chunks=(), words=None):
    """A record whose parts are as given, with every checksum right."""
    buffer = io.BytesIO()
    stream = McapWriter(buffer)
    facts = {"format": action_log.LOG_FORMAT, **as_words(log.provenance), "runs": "3", "actions_as": "float64"}
    stream.metadata("glbench actions", {**facts, **(words or {})})
    stream.attachment(PROVENANCE, provenance or canonical(log.provenance))
    stream.attachment("runs.json", runs or canonical(RunTable(runs=log.runs)))
    stream.attachment(TASK, log.definition)
    schema = stream.schema("glbench.RunPart", b"")
    channels = [stream.channel(f"/runs/{run.seed}", schema, {}) for run in log.runs]
    for chunk in chunks:
        stream.chunk(chunk, {channels[0]: (np.array([1], np.uint64), np.array([0], np.uint64))})
    stream.finish()
    return buffer.getvalue()


def refused(path, data, words):
    path.write_bytes(data)
    tracemalloc.start()
    try:
        with pytest.raises(EpisodeError, match=words):
            read_log(path)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def changed(log, **values):
    document = json.loads(canonical(log.provenance))
    for place, value in values.items():
        table, _, key = place.partition("__")
        document[table][key] = value
    return json.dumps(document).encode()


def test_a_small_file_that_expands_is_not_expanded(log, tmp_path):
    bomb = record(log, chunks=[bytes(16 * MIB)] * 30)
    assert len(bomb) < MIB
    peak = refused(tmp_path / "bomb.mcap", bomb, "expands to more than a record of this size can hold")
    assert peak < 200 * MIB


def test_a_chunk_that_lies_about_its_size_is_not_expanded(log, tmp_path):
    bomb = record(log, chunks=[bytes(64 * MIB)])
    place = bomb.index((64 * MIB).to_bytes(8, "little"))
    liar = bomb[:place] + (100).to_bytes(8, "little") + bomb[place + 8 :]
    assert refused(tmp_path / "liar.mcap", liar, "does not match its checksum") < 20 * MIB


def test_a_torn_chunk_is_not_expanded_without_end():
    buffer = io.BytesIO()
    stream = McapWriter(buffer)
    channel = stream.channel("/runs/1", 0, {})
    stream.chunk(bytes(400 * MIB), {channel: (np.array([1], np.uint64), np.array([0], np.uint64))})
    tracemalloc.start()
    found = scan_bytes(buffer.getvalue()[:-100])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found.problem is not None
    assert peak < 300 * MIB


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"task__steps": 10**9}, "announces 3 runs"),
        ({"task__steps": 10**30}, "task.steps"),
        ({"task__steps": -1}, "task.steps"),
        ({"task__start": "9999-99-99x"}, "task.start"),
        ({"task__title": "\x1b[2J"}, "U.001B"),
        ({"agent__columns": ["a"] * 1000}, "agent.columns"),
        ({"agent__columns": []}, "not a whole file"),
        ({"agent__name": "../../evil"}, "cannot be the name"),
        ({"agent__name": "x.proof"}, "cannot be the name"),
    ],
    ids=lambda value: str(value)[:40],
)
def test_facts_out_of_bounds(log, tmp_path, values, words):
    message = action_log._framed(1, 1, 0, b"\x08\x01\x12\x08" + bytes(8))
    data = record(log, provenance=changed(log, **values), chunks=[message])
    assert refused(tmp_path / "facts.mcap", data, words) < 50 * MIB


@pytest.mark.parametrize("number", ["O", "V1000000000", "float16", "int64"])
def test_actions_of_another_kind(log, tmp_path, number):
    refused(tmp_path / "kind.mcap", record(log, words={"actions_as": number}), "float32 or float64")


@pytest.mark.parametrize("text", [b"[" * 100_000, b'{"runs":' + b"9" * 10_000 + b"}", b"\xff"])
def test_attachments_that_are_no_json(log, tmp_path, text):
    refused(tmp_path / "runs.mcap", record(log, runs=text), "not a whole file")
    with pytest.raises(EpisodeError, match="cannot be read"):
        task_of(text)


def test_a_task_at_the_end_of_all_dates(log):
    with pytest.raises(EpisodeError, match="less than 2200-01-01"):
        task_of(log.definition.replace(b'"start": "2010-03-01"', b'"start": "9999-12-31"'))


def test_parts_that_overlap(log, tmp_path):
    part = action_log._part_class()(first_step=1, actions=bytes(8 * 6), rewards=bytes(8))
    message = action_log._framed(1, 1, 0, part.SerializeToString())
    refused(tmp_path / "parts.mcap", record(log, chunks=[message, message]), "do not follow each other")


def test_chunks_of_empty_records_or_empty_messages(log, tmp_path):
    """Millions of them would take minutes, one by one."""
    refused(tmp_path / "zeros.mcap", record(log, chunks=[bytes(64 * MIB)]), "something else than messages")
    empty = action_log._framed(1, 1, 0, action_log._part_class()(first_step=1).SerializeToString())
    refused(tmp_path / "empty.mcap", record(log, chunks=[empty * 100_000]), "do not follow each other")


def test_runs_without_final_states(log, tmp_path):
    part = action_log._part_class()(first_step=1, actions=bytes(8 * 6), rewards=bytes(8))
    message = action_log._framed(1, 1, 0, part.SerializeToString())
    refused(tmp_path / "final.mcap", record(log, chunks=[message]), "no final state")


def test_a_channel_of_no_run(log, tmp_path):
    stray = replace(log, runs=tuple(run.model_copy(update={"seed": run.seed + 10}) for run in log.runs))
    refused(tmp_path / "stray.mcap", record(log, runs=canonical(RunTable(runs=stray.runs))), "not a whole file")


@pytest.mark.skipif(sys.platform == "win32", reason="no pipes in folders")
def test_a_pipe_in_place_of_a_record_or_a_profile_is_not_waited_for(day_result, tmp_path):
    import shutil

    from glbench.episodes import actions_path
    from glbench.evaluation.profiles import profile_path

    _, original = day_result
    path = tmp_path / original.name
    for make in (lambda one: one, actions_path, profile_path):
        shutil.copy(make(original), make(path))
    os.mkfifo(tmp_path / "pipe.mcap")
    with pytest.raises(EpisodeError, match="not a regular file"):
        read_episode(tmp_path / "pipe.mcap")
    profile_path(path).unlink()
    os.mkfifo(profile_path(path))
    assert "not a regular file" in verify(path).reason
    actions_path(path).unlink()
    os.mkfifo(actions_path(path))
    assert "not a regular file" in verify(path).reason


def test_an_episode_that_describes_no_protobuf(episode_file, tmp_path, monkeypatch):
    episode = read_episode(episode_file)
    monkeypatch.setattr(Layout, "descriptor", lambda layout: b"\xff\xff\xff")
    path = tmp_path / "strange.mcap"
    path.write_bytes(episode_bytes(episode))
    with pytest.raises(EpisodeError, match="as glbench writes it"):
        read_episode(path)


def renamed(episode, unit):
    groups = tuple(replace(group, columns=tuple(replace(column, unit=unit) for column in group.columns)) for group in episode.groups)
    return replace(episode, groups=groups)


def test_units_that_steer_a_terminal_are_refused_and_markup_is_text(episode_file, tmp_path):
    episode, path = read_episode(episode_file), tmp_path / "units.mcap"
    path.write_bytes(episode_bytes(renamed(episode, "\x1b[2J")))
    with pytest.raises(EpisodeError, match="cannot be shown"):
        read_episode(path)
    path.write_bytes(episode_bytes(renamed(episode, "[/x]")))
    done = CliRunner().invoke(app, ["episodes", "info", str(path)])
    assert done.exit_code == 0, done.output
    assert "[/x]" in done.output


def test_recovering_onto_links_in_a_circle_ends_in_words(episode_file, tmp_path):
    circle = tmp_path / "circle.mcap"
    circle.symlink_to(circle)
    with pytest.raises(EpisodeError, match="Cannot read"):
        recover(circle, tmp_path / "out.mcap")
    done = CliRunner().invoke(app, ["episodes", "recover", str(circle)])
    assert isinstance(done.exception, EpisodeError)


@pytest.mark.parametrize("name", ["=1+1", "@SUM(A1)", "-1", "a b", ""])
def test_a_column_that_a_spreadsheet_would_take_for_a_formula(name):
    part = Part("agent_action", 1, "AgentAction", (name,), np.dtype("<f8"))
    channel = Channel(1, "/inputs", "protobuf", {}, 1)
    with pytest.raises(ValueError, match="a column is called"):
        _groups(channel, Layout("Inputs", [part]))


def test_an_episode_without_actions(episode_file, tmp_path):
    found = scan(episode_file)
    buffer = io.BytesIO()
    stream = McapWriter(buffer)
    for name, words in found.metadata.items():
        stream.metadata(name, words)
    for name, data in found.attachments.items():
        stream.attachment(name, data)
    for schema in found.schemas.values():
        stream.schema(schema.name, schema.data)
    for topic in found.channels.values():
        words = {key: "other" if value == "action" else value for key, value in topic.metadata.items()}
        stream.channel(topic.topic, topic.schema_id, words)
    for chunk in found.chunks:
        stream.chunk(chunk, {1: (np.array([1], np.uint64), np.array([0], np.uint64))})
    stream.finish()
    (tmp_path / "x.mcap").write_bytes(buffer.getvalue())
    with pytest.raises(EpisodeError, match="holds no actions"):
        read_episode(tmp_path / "x.mcap", partial=True)
