"""An exported policy does what Stable-Baselines3 does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import VecNormalize

from glbench.agents import load_agent
from glbench.errors import TrainingError
from glbench.tasks import TaskSpec, task_card
from glbench.training import TrainingSettings, read_settings, shipped_settings
from glbench.training.algorithms import make_model
from glbench.training.export import export_model, export_policy
from glbench.training.vec_env import TrainingVecEnv
from tests.training.conftest import torch_action

SIZE = {"ppo": {"pi": [256] * 3, "vf": [16]}, "sac": {"pi": [256] * 3, "qf": [16]}}


def spread(normalization: VecNormalize, rows: int) -> np.ndarray:
    """Observations around those of training, some far outside."""
    draws = np.random.default_rng(1).normal(size=(rows, 22)) * np.geomspace(0.1, 30.0, rows)[:, None]
    statistics = normalization.obs_rms
    return (statistics.mean + draws * np.sqrt(statistics.var + 1e-8)).astype(np.float32)


def model_of(algorithm: str, day: TaskSpec, activation: str = "SiLU") -> tuple[object, VecNormalize]:
    """A model with the paper's actor, and a normalisation that has seen something."""
    settings = read_settings(shipped_settings(algorithm), algorithm, day.id).model_copy(
        update={"policy_kwargs": {"net_arch": SIZE[algorithm], "activation_fn": activation}}
    )
    normalization = VecNormalize(TrainingVecEnv(day, 8))
    normalization.reset()
    for chosen in np.random.default_rng(0).uniform(-1, 1, (60, 8, 6)).astype(np.float32):
        normalization.step(chosen)
    model = make_model(settings, normalization, 0)
    return model, normalization


@pytest.mark.parametrize("activation", ["SiLU", "Tanh", "ReLU"])
def test_the_exported_policy_answers_as_stable_baselines3_to_a_millionth(algorithm: str, activation: str, day: TaskSpec) -> None:
    model, normalization = model_of(algorithm, day, activation)
    policy = export_policy(model, normalization, day, {})
    seen = spread(normalization, 500)
    ours = policy.act(seen)
    assert np.ptp(ours, axis=0).min() > 0.001
    np.testing.assert_allclose(ours, torch_action(model, normalization, seen), rtol=0, atol=1e-6)


@pytest.mark.parametrize("algorithm", ["stable_baselines3.TD3", "stable_baselines3.DDPG", "sb3_contrib.TQC"])
def test_actors_like_those_of_sac_and_td3_are_exported(algorithm: str, day: TaskSpec, tmp_path: Path) -> None:
    file = tmp_path / "actor.yml"
    file.write_text("default: {n_envs: 8, policy_kwargs: {net_arch: {pi: [64, 64], qf: [16]}}}", encoding="utf-8")
    normalization = model_of("sac", day)[1]
    model = make_model(read_settings(file, algorithm, day.id), normalization, 0)
    observations = spread(normalization, 200)
    ours = export_policy(model, normalization, day, {}).act(observations)
    assert np.ptp(ours, axis=0).min() > 0.001
    np.testing.assert_allclose(ours, torch_action(model, normalization, observations), rtol=0, atol=1e-6)


def test_what_stands_between_the_layers_of_crossq_is_refused(day: TaskSpec, tmp_path: Path) -> None:
    file = tmp_path / "crossq.yml"
    file.write_text("default: {n_envs: 8}", encoding="utf-8")
    normalization = model_of("sac", day)[1]
    model = make_model(read_settings(file, "sb3_contrib.CrossQ", day.id), normalization, 0)
    with pytest.raises(TrainingError, match=r"BatchRenorm1d.*cannot be exported"):
        export_policy(model, normalization, day, {})


def test_an_exported_model_is_an_agent_for_its_task(algorithm: str, day: TaskSpec, tmp_path: Path) -> None:
    model, normalization = model_of(algorithm, day)
    model.save(tmp_path / "model.zip")
    normalization.save(str(tmp_path / "norm.pkl"))
    export_model(tmp_path / "model.zip", algorithm, tmp_path / "norm.pkl", day, tmp_path / "mine")
    loaded = load_agent(tmp_path / "mine")
    agent = loaded.make(task_card(day))
    agent.reset(task_card(day), 4)
    seen = spread(normalization, 4)
    np.testing.assert_array_equal(agent.act(seen), export_policy(model, normalization, day, {}).act(seen))
    assert (loaded.name, loaded.privileged) == ("mine", False)
    with pytest.raises(TrainingError, match="already"):
        export_model(tmp_path / "model.zip", algorithm, None, day, tmp_path / "mine")


def test_without_normalisation_observations_are_taken_as_they_are(day: TaskSpec) -> None:
    model, normalization = model_of("ppo", day)
    policy = export_policy(model, None, day, {})
    seen = spread(normalization, 50) * 0.01
    np.testing.assert_allclose(policy.act(seen), torch_action(model, None, seen), rtol=0, atol=1e-6)


def test_a_policy_with_a_memory_is_refused(day: TaskSpec, tmp_path: Path) -> None:
    file = tmp_path / "recurrent.yml"
    file.write_text("default: {policy: MlpLstmPolicy, n_steps: 8, batch_size: 8, n_envs: 2}", encoding="utf-8")
    settings = read_settings(file, "sb3_contrib.RecurrentPPO", day.id)
    model = make_model(settings, TrainingVecEnv(day, 2), 0)
    with pytest.raises(TrainingError, match="memory"):
        export_policy(model, None, day, {})


class Doubled(FlattenExtractor):
    """Shows the policy twice of what there is."""

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        return 2.0 * super().forward(observations)


def test_a_features_extractor_that_numpy_does_not_know_is_refused(day: TaskSpec) -> None:
    settings = read_settings(shipped_settings("ppo"), "ppo", day.id).model_copy(
        update={"policy_kwargs": {"net_arch": [8], "activation_fn": "SiLU", "features_extractor_class": Doubled}}
    )
    model = make_model(settings, TrainingVecEnv(day, 8), 0)
    with pytest.raises(TrainingError, match="looks at its observations with Doubled"):
        export_policy(model, None, day, {})


def test_an_activation_that_numpy_does_not_know_is_refused(day: TaskSpec) -> None:
    model, normalization = model_of("ppo", day, "GELU")
    with pytest.raises(TrainingError, match=r"GELU.*Activations: SiLU"):
        export_policy(model, normalization, day, {})


@pytest.mark.parametrize("algorithm", ["ppo"], indirect=True)
def test_a_model_that_cannot_be_read_is_named(day: TaskSpec, tiny: TrainingSettings, tmp_path: Path) -> None:
    (tmp_path / "model.zip").write_bytes(b"no zip")
    with pytest.raises(TrainingError, match=r"Cannot read the model .*model\.zip"):
        export_model(tmp_path / "model.zip", tiny.algorithm, None, day, tmp_path / "out")
