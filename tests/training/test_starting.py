"""A training may begin with a trained policy: it acts as that one did, and the card says so."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glbench.agents.network_policy import read_policy
from glbench.errors import TrainingError
from glbench.tasks import TaskSpec
from glbench.training import TrainingSettings, read_settings, train
from glbench.training.algorithms import make_model
from glbench.training.card import settings_digest, start_of
from glbench.training.export import begin_with, export_model
from glbench.training.vec_env import Normalizer, TrainingVecEnv
from tests.training.conftest import PPO, torch_action

pytestmark = pytest.mark.train


@pytest.fixture(scope="module")
def first(day: TaskSpec, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a finished training of PPO."""
    folder = tmp_path_factory.mktemp("first")
    (folder / "tiny.yml").write_text(PPO, encoding="utf-8")
    train(day, read_settings(folder / "tiny.yml", "ppo", day.id), folder / "run", tensorboard=False)
    return folder / "run"


def settings_with(folder: Path, task: TaskSpec, start: str | Path, text: str = PPO) -> TrainingSettings:
    file = folder / "more.yml"
    file.write_text(f"{text}  start_from: {start}\n", encoding="utf-8")
    return read_settings(file, "ppo", task.id)


def test_it_acts_at_once_as_the_policy_did(day: TaskSpec, tiny: TrainingSettings, tmp_path: Path) -> None:
    train(day, tiny, tmp_path / "first", tensorboard=False)
    file = tmp_path / "first" / "policy.npz"
    env = TrainingVecEnv(day, 2)
    normalization = Normalizer(env)
    model = make_model(tiny, normalization, 7)
    observations = np.array([env.observation_space.sample() for _ in range(50)])

    assert np.abs(torch_action(model, normalization, observations) - read_policy(file).act(observations)).max() > 0.01
    begin_with(file, model, normalization, day)
    np.testing.assert_allclose(torch_action(model, normalization, observations), read_policy(file).act(observations), atol=1e-6)


def test_columns_of_a_scale_below_that_of_the_normalisation_count_as_they_did(day: TaskSpec, first: Path, tmp_path: Path) -> None:
    """As densities in kg m-3: VecNormalize divides by no less than 1e-4."""
    policy = read_policy(first / "policy.npz")
    mean, scale = policy.mean.copy(), policy.scale.copy()
    mean[1], scale[1] = 0.0, 6e-5
    narrow = replace(policy, mean=mean, scale=scale)
    (tmp_path / "narrow.npz").write_bytes(narrow.to_bytes())
    env = TrainingVecEnv(day, 2)
    normalization = Normalizer(env)
    model = make_model(read_settings(first / "settings.yml", "ppo", day.id), normalization, 7)
    begin_with(tmp_path / "narrow.npz", model, normalization, day)
    observations = env.reset().repeat(20, axis=0)
    observations[:, 1] = np.linspace(-3e-4, 3e-4, len(observations))
    expected = narrow.act(observations)
    assert np.ptp(expected, axis=0).max() > 0.01
    np.testing.assert_allclose(torch_action(model, normalization, observations), expected, atol=1e-3)


def test_the_card_says_from_what_it_started(day: TaskSpec, first: Path, tmp_path: Path) -> None:
    settings = settings_with(tmp_path, day, first / "policy.npz")
    train(day, settings, tmp_path / "run", tensorboard=False)

    card = tomllib.loads((tmp_path / "run" / "card.toml").read_text(encoding="utf-8"))
    before = tomllib.loads((first / "card.toml").read_text(encoding="utf-8"))
    assert card["start"]["file"] == "policy.npz"
    assert card["start"]["steps"] == before["training"]["steps"]
    assert card["start"]["wall_seconds"] == before["wall_seconds"]["total"]
    assert len(card["start"]["digest"]) == 64


def test_the_place_of_the_policy_does_not_matter_and_its_content_does(day: TaskSpec, first: Path, tmp_path: Path) -> None:
    policy = (first / "policy.npz").read_bytes()
    digests = []
    for name, content in (("a", policy), ("b", policy), ("c", policy + b"0")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "policy.npz").write_bytes(content)
        digests.append(settings_digest(settings_with(tmp_path / name, day, "policy.npz")))  # relative to the settings
    assert digests[0] == digests[1] != digests[2]


def test_a_network_of_another_size_is_refused(day: TaskSpec, first: Path, tmp_path: Path) -> None:
    settings = settings_with(tmp_path, day, first / "policy.npz", PPO.replace("[16, 16]", "[16, 8]"))
    with pytest.raises(TrainingError, match=r"layers 22 - 16 - 16 - 6 .* the settings ask for 22 - 16 - 8 - 6"):
        train(day, settings, tmp_path / "run", tensorboard=False)


@pytest.mark.parametrize("algorithm", ["ppo"], indirect=True)
@pytest.mark.parametrize("other", [{"clip_obs": 0.5}, {"norm_obs": False}])
def test_another_normalisation_is_refused(day: TaskSpec, first: Path, tiny: TrainingSettings, other: dict[str, Any]) -> None:
    normalization = Normalizer(TrainingVecEnv(day, 2), **other)
    with pytest.raises(
        TrainingError, match=r"its observations are clipped at 10; with these settings they are (clipped at 0.5|not normalised)"
    ):
        begin_with(first / "policy.npz", make_model(tiny, normalization, 7), normalization, day)


def test_a_policy_that_is_not_there_is_named(day: TaskSpec, tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match=r"'start_from': .*there is no policy file .*nowhere\.npz"):
        settings_with(tmp_path, day, "nowhere.npz")


def test_a_card_of_something_else_beside_the_policy_does_no_harm(day: TaskSpec, first: Path, tmp_path: Path) -> None:
    export_model(first / "best" / "model.zip", "ppo", first / "best" / "vecnormalize.pkl", day, tmp_path / "mine")
    train(day, settings_with(tmp_path, day, tmp_path / "mine" / "policy.npz"), tmp_path / "run", tensorboard=False)
    card = tomllib.loads((tmp_path / "run" / "card.toml").read_text(encoding="utf-8"))
    assert card["start"].keys() == {"file", "digest"}


def test_what_the_start_started_from_counts_as_well(day: TaskSpec, first: Path, tmp_path: Path) -> None:
    train(day, settings_with(tmp_path, day, first / "policy.npz"), tmp_path / "second", tensorboard=False)
    cards = [tomllib.loads((folder / "card.toml").read_text(encoding="utf-8")) for folder in (first, tmp_path / "second")]
    assert start_of(tmp_path / "second" / "policy.npz")["steps"] == sum(card["training"]["steps"] for card in cards)


@pytest.mark.parametrize("algorithm", ["ppo"], indirect=True)
def test_statistics_weigh_the_same_whenever_the_policy_was_kept(day: TaskSpec, first: Path, tiny: TrainingSettings) -> None:
    normalization = Normalizer(TrainingVecEnv(day, 2))
    begin_with(first / "policy.npz", make_model(tiny, normalization, 7), normalization, day)
    mean = normalization.obs_rms.mean.copy()
    normalization.reset()
    np.testing.assert_allclose(normalization.obs_rms.mean, mean, rtol=1e-4, atol=1e-2)
