"""Columns that do not vary in training cannot move a policy; all others are normalised as Stable-Baselines3 does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from stable_baselines3.common.vec_env import VecNormalize

from glbench.agents.network_policy import NetworkPolicy, read_policy
from glbench.resources import data_folder
from glbench.tasks import TaskSpec, get_task, task_card
from glbench.training import TrainingSettings, run, train
from glbench.training.algorithms import make_model
from glbench.training.constant_columns import varies
from glbench.training.export import begin_with, export_policy, load_model
from glbench.training.season_search import SearchSettings, search
from glbench.training.vec_env import Normalizer, TrainingVecEnv
from tests.training.conftest import torch_action

PPM = 1.0


def seen_in_a_season(task: TaskSpec) -> np.ndarray:
    """Observations of seasons with random actions."""
    env = TrainingVecEnv(task, 4)
    actions = np.random.default_rng(0).uniform(-1, 1, (task.steps - 1, 4, *env.action_space.shape)).astype(np.float32)
    return np.concatenate([env.reset(), *(env.step(chosen)[0] for chosen in actions)])


def moved(policy: NetworkPolicy, seen: np.ndarray) -> float:
    """Mean change of the actions, which lie between -1 and 1, when outdoor CO2 reads 1 ppm more."""
    more = seen.copy()
    more[:, policy.observation_names.index("outdoor_co2")] += PPM
    return float(np.abs(policy.act(more) - policy.act(seen)).mean())


@pytest.mark.slow
@pytest.mark.train
def test_one_ppm_of_outdoor_co2_moves_a_trained_policy_no_more(
    day: TaskSpec, tiny: TrainingSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = tiny.model_copy(update={"n_timesteps": 3000})
    seen = seen_in_a_season(day)
    train(day, settings, tmp_path / "now", tensorboard=False)
    monkeypatch.setattr(run, "Normalizer", VecNormalize)
    train(day, settings, tmp_path / "before", tensorboard=False)
    now, before = (read_policy(tmp_path / name / "policy.npz") for name in ("now", "before"))
    assert moved(now, seen) == 0.0
    assert moved(before, seen) > 0.05
    column = now.observation_names.index("outdoor_co2")
    assert now.scale[column] == 1.0
    assert before.scale[column] < 0.2
    assert np.ptp(now.act(seen), axis=0).min() > 0.0, "it looks at the others"

    model, normalization = load_model(tmp_path / "now/best/model.zip", settings.algorithm, tmp_path / "now/best/vecnormalize.pkl")
    other = seen + np.random.default_rng(1).normal(size=seen.shape).astype(np.float32)
    np.testing.assert_allclose(now.act(other), torch_action(model, normalization, other), rtol=0, atol=1e-6)


@pytest.mark.train
@pytest.mark.parametrize("algorithm", ["ppo"], indirect=True)
def test_a_policy_that_is_tuned_loses_the_column_that_never_varied(
    day: TaskSpec, tiny: TrainingSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "Normalizer", VecNormalize)
    train(day, tiny.model_copy(update={"n_timesteps": 3000}), tmp_path / "before", tensorboard=False)
    file = tmp_path / "before" / "policy.npz"
    usual = SearchSettings.of(file)
    few = {"population": 4, "directions": 2, "generations": 1}
    search(day, usual.model_copy(update=few), tmp_path / "tuned")
    seen = seen_in_a_season(day)
    assert moved(read_policy(file), seen) > 0.05
    assert moved(read_policy(tmp_path / "tuned" / "policy.npz"), seen) == 0.0


def test_in_the_default_task_outdoor_co2_is_the_only_column_that_does_not_vary() -> None:
    task = get_task("Schiphol2010-Delta10-v1")
    normalization = Normalizer(TrainingVecEnv(task, 1))
    normalization.reset()
    for chosen in np.random.default_rng(0).uniform(-1, 1, (200, 1, 6)).astype(np.float32):
        normalization.step(chosen)
    names = task_card(task).observation_names
    steady = [name for name, varying in zip(names, normalization.columns.varying, strict=True) if not varying]
    assert steady == ["outdoor_co2"]
    assert normalization.scale[names.index("outdoor_co2")] == 1.0


def test_columns_that_vary_are_normalised_as_by_stable_baselines3(day: TaskSpec) -> None:
    ours, theirs = Normalizer(TrainingVecEnv(day, 4)), VecNormalize(TrainingVecEnv(day, 4))
    ours.reset()
    theirs.reset()
    for chosen in np.random.default_rng(0).uniform(-1, 1, (30, 4, 6)).astype(np.float32):
        one, other = ours.step(chosen), theirs.step(chosen)
        varying = ours.columns.varying
        np.testing.assert_array_equal(one[0][:, varying], other[0][:, varying])
        assert not one[0][:, ~varying].any()
        np.testing.assert_array_equal(one[1], other[1])
    assert varying.sum() >= 18
    raw = ours.get_original_obs()
    np.testing.assert_allclose(ours.unnormalize_obs(one[0])[:, varying], raw[:, varying], rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (400.0, 400.0, False),
        (399.9, 400.1, False),
        (399.0, 401.0, True),
        (0.0, 0.0, False),
        (0.0, 1e-6, True),
        (-0.0005, 0.0005, True),
        (np.inf, -np.inf, False),  # nothing was seen yet
    ],
)
def test_a_column_varies_beyond_a_thousandth_of_its_magnitude(low: float, high: float, expected: bool) -> None:
    assert varies(np.array([low]), np.array([high])).tolist() == [expected]


@pytest.mark.parametrize("algorithm", ["ppo"], indirect=True)
def test_a_released_policy_that_is_started_from_acts_as_it_did_in_its_weather(tiny: TrainingSettings) -> None:
    file = data_folder("baselines") / "ppo" / "weights" / "delta10.npz"
    task = get_task("Schiphol2010-Delta10-v1")
    settings = tiny.model_copy(update={"policy_kwargs": {"net_arch": [256] * 3, "activation_fn": "SiLU"}})
    normalization = Normalizer(TrainingVecEnv(task, 2))
    model = make_model(settings, normalization, 0)
    begin_with(file, model, normalization, task)
    seen = normalization.venv.reset()
    released, begun = read_policy(file), export_policy(model, normalization, task, {})
    np.testing.assert_allclose(begun.act(seen), released.act(seen), rtol=0, atol=1e-4)
    assert moved(begun, seen) == 0.0 < moved(released, seen)


def test_observations_that_are_not_normalised_stay_as_they_are(day: TaskSpec) -> None:
    normalization = Normalizer(TrainingVecEnv(day, 2), norm_obs=False)
    first = normalization.reset()
    np.testing.assert_array_equal(first, normalization.get_original_obs())
