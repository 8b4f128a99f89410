"""A recording replays what was recorded, looks at nothing, and says where it does not fit."""

from __future__ import annotations

import dataclasses
import json
import re

import numpy as np
import pytest

from glbench.agents import load_agent
from glbench.agents.baselines import read_baseline
from glbench.agents.plans import Recording, RecordingAgent, read_recording
from glbench.errors import ShapeError, SubmissionError
from glbench.evaluation import evaluate, load_result, result_path
from glbench.evaluation.evaluation import TRIALS
from glbench.evaluation.saving import write_recording
from glbench.resources import data_folder
from glbench.tasks import get_task, task_card

SETTINGS = read_baseline("recording").settings
assert isinstance(SETTINGS, Recording)


def short(steps: int = 3) -> Recording:
    """The shipped recording, cut after ``steps``."""
    return dataclasses.replace(SETTINGS, actions=SETTINGS.actions[:steps])


def test_the_shipped_recording_is_of_todays_ppo_tuned_and_of_todays_task():
    task = get_task("Schiphol2010-Delta10-v1")
    assert SETTINGS.about == {
        "agent": "ppo_tuned",
        "agent_digest": read_baseline("ppo_tuned").digest,
        "task": task.id,
        "task_digest": task.digest,
        "seed": 10000,
    }
    assert SETTINGS.actions.shape == (task.steps, 6)
    assert 10000 not in task.evaluation.seeds


def test_every_row_gets_the_recorded_actions_whatever_it_observes(card):
    agent, rng = RecordingAgent(short()), np.random.default_rng(1)
    for n_runs in (4, 1):
        agent.reset(card, n_runs)
        for step in (0, 1, 2, 2, 2):
            actions = agent.act(rng.normal(size=(n_runs, 22)).astype(np.float32))
            assert actions.dtype == np.float64
            np.testing.assert_array_equal(actions, np.tile(SETTINGS.actions[step].astype(float), (n_runs, 1)))


def test_another_number_of_rows_is_refused(card):
    agent = RecordingAgent(short())
    agent.reset(card, 2)
    with pytest.raises(ShapeError, match="observations of 3 runs, reset was called with 2"):
        agent.act(np.zeros((3, 22), np.float32))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"names": ("heat", "co2"), "low": (-1.0,) * 2, "high": (1.0,) * 2}, "takes"),
        ({"actuation": "set_point"}, "holds set_point actions of"),
        ({"low": (0.0,) * 6}, "other bounds"),
    ],
)
def test_a_task_with_other_actions_is_refused_in_words(card, change, words):
    changed = dataclasses.replace(short(), actions=short().actions[:, : len(change.get("names", "123456"))], **change)
    with pytest.raises(SubmissionError, match=words):
        RecordingAgent(changed).reset(card, 1)


def test_equal_recordings_give_equal_bytes_and_read_back(tmp_path):
    file = tmp_path / "actions.npz"
    file.write_bytes(short().to_bytes())
    back = read_recording(file)
    np.testing.assert_array_equal(back.actions, short().actions)
    assert (back.names, back.about) == (short().names, short().about)
    assert back.to_bytes() == file.read_bytes()


@pytest.mark.parametrize("data", [b"", b"PK\x03\x04 no more", json.dumps({"actions": []}).encode()], ids=["empty", "cut", "json"])
def test_a_file_that_is_no_recording_is_refused_in_words(tmp_path, data):
    file = tmp_path / "actions.npz"
    file.write_bytes(data)
    with pytest.raises(SubmissionError, match="not a recording of actions"):
        read_recording(file)


def test_a_recording_that_unpacks_without_end_is_refused_before_it_is_unpacked(tmp_path):
    file = tmp_path / "actions.npz"
    np.savez_compressed(file, actions=np.zeros((300, 2**20), np.uint8))
    assert file.stat().st_size < 2**20
    with pytest.raises(SubmissionError, match="more than 256 MiB"):
        read_recording(file)


def test_actions_that_are_not_finite_are_no_recording():
    with pytest.raises(ShapeError, match="not finite"):
        dataclasses.replace(SETTINGS, actions=np.full((2, 6), np.nan, np.float32))


def test_it_says_that_it_sees_nothing():
    agent = load_agent("recording")
    assert agent.information == "nothing: replays recorded actions"
    assert not agent.privileged
    assert isinstance(agent.make(task_card(get_task("Schiphol2010-Delta10-v1"))), RecordingAgent)


@pytest.mark.slow
def test_the_card_says_what_a_blind_recording_earns(tmp_path):
    card = read_baseline("recording").card.description
    figures = [float(figure.replace(",", "")) for figure in re.findall(r"\d,\d{3}\.\d", card)]
    ten, tuned_ten, thirty, tuned_thirty, own_thirty = figures
    middle, widest = "Schiphol2010-Delta10-v1", "Schiphol2010-Delta30-v1"
    for task, figures in ((middle, {"recording": ten, "ppo_tuned": tuned_ten}), (widest, {"recording": thirty, "ppo_tuned": tuned_thirty})):
        rewards = {agent: released_rewards(agent, task) for agent in figures}
        assert {agent: np.mean(values) for agent, values in rewards.items()} == pytest.approx(figures, abs=0.05)
        # What replays actions ends where it ended elsewhere; what reacts to observations may drift by some units.
        again = evaluate(get_task(task), "recording", runs=5).values("reward")
        assert again == pytest.approx(rewards["recording"][:5], abs=0.1)
    evaluate(get_task(widest), "ppo_tuned", runs=1, first_seed=10000, out=tmp_path)
    write_recording(result_path(tmp_path / TRIALS, widest, "ppo_tuned"), 10000, tmp_path / "widest")
    rewards = evaluate(get_task(widest), tmp_path / "widest").values("reward")
    assert np.mean(rewards) == pytest.approx(own_thirty, abs=8.0)


def released_rewards(agent, task):
    return load_result(data_folder("reports/released/results") / task / f"{agent}.json").values("reward")
