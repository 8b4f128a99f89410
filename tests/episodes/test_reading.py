"""A record gives back what the environment returned, bit by bit."""

from __future__ import annotations

import hashlib

import mcap.reader
import numpy as np
import pytest
from mcap_protobuf.decoder import DecoderFactory

import glbench.episodes
from glbench.agents import load_agent
from glbench.env import GreenhouseEnv
from glbench.env.accounts import QUANTITY_NAMES
from glbench.episodes import read_episode, read_log
from glbench.errors import EpisodeError
from glbench.model import CONTROL_NAMES, DISTURBANCE_NAMES, STATE_NAMES
from glbench.tasks import task_card
from tests.episodes.day import RANDOM
from tests.evaluation.agent_files import agent_writer


@pytest.fixture(scope="session")
def lived(day_task, day_result, tmp_path_factory):
    """What a Gymnasium environment returned in the first run, with an agent of its own."""
    agent = load_agent(agent_writer(tmp_path_factory.mktemp("again"))(RANDOM, "wavy")).make(task_card(day_task))
    environment = GreenhouseEnv(day_task)
    observation, _ = environment.reset(seed=day_result[0].runs[0].seed)
    agent.reset(task_card(day_task), 1)
    rows, over = [], False
    while not over:
        action = agent.act(observation[np.newaxis])[0]
        observation, reward, terminated, truncated, _ = environment.step(action)
        over = terminated or truncated
        simulation = environment.unwrapped.simulation
        rows.append((action, reward, simulation.x[0].copy(), simulation.u[0].copy(), simulation.air[:, 0].copy()))
    return [np.array(column) for column in zip(*rows, strict=True)]


def test_the_table_is_what_the_environment_returned_to_the_last_bit(episode_file, lived, day_task):
    frame = glbench.episodes.read(episode_file)
    actions, rewards, states, controls, air = lived
    assert len(frame) == day_task.steps == 24
    for values, names in (
        (actions, [f"action_{name}" for name in CONTROL_NAMES]),
        (states, STATE_NAMES),
        (controls, CONTROL_NAMES),
        (air.reshape(24, 3), ["air_temperature", "co2", "relative_humidity"]),
        (day_task.disturbances().values[:24], DISTURBANCE_NAMES),
    ):
        recorded = np.ascontiguousarray(frame[list(names)].to_numpy())
        assert recorded.tobytes() == np.ascontiguousarray(values).tobytes(), names[0]
    assert frame["reward"].to_numpy().tobytes() == rewards.tobytes()


def test_every_quantity_of_a_step_has_a_column_with_its_unit(episode_file):
    frame = glbench.episodes.read(episode_file)
    assert set(QUANTITY_NAMES) <= set(frame.columns)
    assert frame.attrs["units"]["epi"] == "EUR m-2"
    assert frame.attrs["units"]["tAir"] == "°C"
    assert set(frame.columns) - {"utc_start", "utc_end"} == set(frame.attrs["units"])


def test_steps_count_from_one_and_times_are_the_simulated_utc(episode_file):
    frame = glbench.episodes.read(episode_file)
    assert list(frame.index) == list(range(1, 25))
    assert str(frame["utc_start"].iloc[0]) == "2010-03-01 00:00:00"
    assert str(frame["utc_end"].iloc[-1]) == "2010-03-02 00:00:00"


def test_the_rewards_of_the_record_add_up_to_the_metric(day_result, episode_file):
    result, _ = day_result
    total = 0.0
    for reward in glbench.episodes.read(episode_file)["reward"]:
        total += reward
    assert total == result.runs[0].metrics["reward"]


def test_states_include_the_start(episode_file, day_task):
    states = read_episode(episode_file).states
    assert states.shape == (25, 28)
    assert states[0].tobytes() == day_task.initial_state().tobytes()


def test_any_reader_of_mcap_and_protobuf_reads_the_same_numbers(episode_file):
    frame = glbench.episodes.read(episode_file)
    seen: dict[str, list[tuple[int, int, float]]] = {}
    wanted = {"climate": "air_temperature", "controls": "uBoil", "economics": "cost_co2", "agent_action": "action_uVent"}
    with episode_file.open("rb") as file:
        reader = mcap.reader.make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            assert channel.topic in {"/inputs", "/outcome"}
            for part, name in wanted.items():
                if part in decoded.DESCRIPTOR.fields_by_name and decoded.HasField(part):
                    value = getattr(getattr(decoded, part), name)
                    seen.setdefault(part, []).append((message.sequence, message.log_time, value))
        assert reader.get_summary().statistics.message_count == 24 * 2 + 1
    for part, name in wanted.items():
        values = [value for sequence, _, value in seen[part] if sequence > 0]
        assert values == frame[name].tolist(), part
    assert seen["controls"][0][:2] == (1, frame["utc_start"].iloc[0].value)
    assert seen["economics"][0][:2] == (1, frame["utc_end"].iloc[0].value)
    assert seen["climate"][0][:2] == (0, frame["utc_start"].iloc[0].value)
    assert seen["climate"][1][:2] == (1, frame["utc_end"].iloc[0].value)


def test_the_record_says_where_it_comes_from(episode_file, day_task, day_result):
    episode = read_episode(episode_file)
    result, _ = day_result
    assert episode.provenance.task.digest == day_task.digest
    assert episode.provenance.task.parts["weather"] == day_task.fingerprint().weather
    assert episode.provenance.agent.digest == result.agent.digest
    assert episode.provenance.kernel == result.evaluation.kernel
    assert episode.provenance.versions["numpy"] == np.__version__
    assert episode.run.seed == result.runs[0].seed
    assert episode.task().digest == day_task.digest


def test_the_recorded_actions_of_all_runs_are_those_of_the_episodes(day_result, episode_file):
    result, path = day_result
    log = read_log(path.with_name(result.record.file))
    assert log.digest == result.record.digest
    assert log.actions[:, 0].tobytes() == read_episode(episode_file).tables["action"].tobytes()
    assert [log.rewards[:, row].tobytes() for row in range(3)] == [
        read_episode(episode_file.with_name(f"seed-{run.seed}.mcap"))["reward"].tobytes() for run in result.runs
    ]


def test_an_unknown_column_is_answered_with_the_nearest(episode_file):
    with pytest.raises(EpisodeError, match="Did you mean 'air_temperature'"):
        read_episode(episode_file)["air_temprature"]


def test_a_file_that_is_no_record_is_refused_in_words(tmp_path, day_result):
    text = tmp_path / "words.mcap"
    text.write_text("no record")
    with pytest.raises(EpisodeError, match="no MCAP file"):
        read_episode(text)
    with pytest.raises(EpisodeError, match="There is no record"):
        read_episode(tmp_path / "nowhere.mcap")
    result, path = day_result
    with pytest.raises(EpisodeError, match="is not a glbench episode"):
        read_episode(path.with_name(result.record.file))


def test_a_flipped_bit_is_noticed(tmp_path, episode_file):
    data = bytearray(episode_file.read_bytes())
    original = hashlib.sha256(data).hexdigest()
    for place in range(200, len(data) - 9, len(data) // 150):
        data[place] ^= 4
        (tmp_path / "flipped.mcap").write_bytes(data)
        data[place] ^= 4
        with pytest.raises(EpisodeError):
            read_episode(tmp_path / "flipped.mcap")
    assert hashlib.sha256(data).hexdigest() == original
