"""Settings say what the paper says, and mistakes in them are explained."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from glbench.errors import GlbenchError, TrainingError, UnknownNameError
from glbench.tasks import TaskSpec
from glbench.training import read_settings, shipped_settings
from glbench.training.algorithms import algorithm_class, make_model
from glbench.training.card import to_toml
from glbench.training.vec_env import TrainingVecEnv

TASK = "glbench/Schiphol2010-Delta10-v1"


def write(folder: Path, text: str) -> Path:
    file = folder / "settings.yml"
    file.write_text(text, encoding="utf-8")
    return file


@pytest.mark.parametrize(
    ("algorithm", "table"),
    [
        (
            "ppo",
            {"learning_rate": 2e-5, "n_steps": 2048, "batch_size": 128, "n_epochs": 8, "gamma": 0.9631, "gae_lambda": 0.9167,
             "clip_range": 0.2, "ent_coef": 0.05434, "vf_coef": 0.8225, "max_grad_norm": 0.3, "normalize_advantage": True},
        ),
        (
            "sac",
            {"learning_rate": 7e-4, "buffer_size": 576_100, "learning_starts": 57_610, "batch_size": 128, "tau": 0.0135,
             "gamma": 0.9631, "train_freq": 50, "gradient_steps": 10, "ent_coef": "auto"},
        ),
    ],
)  # fmt: skip
def test_the_shipped_settings_are_the_table_of_the_paper(algorithm: str, table: dict[str, object]) -> None:
    settings = read_settings(shipped_settings(algorithm), algorithm, TASK)
    assert settings.hyperparameters == table
    assert (settings.n_timesteps, settings.n_envs, settings.first_env_seed) == (2_000_000, 8, 666)
    critic = "vf" if algorithm == "ppo" else "qf"
    assert settings.policy_kwargs["net_arch"] == {"pi": [256] * 3, critic: [512] * 3}
    assert settings.policy_kwargs["activation_fn"] == "SiLU"
    assert settings.policy_kwargs["optimizer_kwargs"]["amsgrad"] is True
    assert settings.action_noise_std == (None if algorithm == "ppo" else 0.05)
    assert settings.normalize.observations
    assert settings.normalize.rewards


def test_the_networks_built_from_the_shipped_settings_are_the_papers(day: TaskSpec) -> None:
    settings = read_settings(shipped_settings("ppo"), "ppo", TASK)
    model = make_model(settings, TrainingVecEnv(day, 8), 0, None)
    layers = [tuple(value.shape) for name, value in model.policy.state_dict().items() if name.endswith("weight")]
    assert layers == [(256, 22), (256, 256), (256, 256), (512, 22), (512, 512), (512, 512), (6, 256), (1, 512)]
    assert model.policy.optimizer.param_groups[0]["amsgrad"] is True


def test_a_section_named_by_the_task_changes_only_what_it_names(tmp_path: Path) -> None:
    file = write(
        tmp_path,
        f"default: {{n_timesteps: 5, gamma: 0.9, n_steps: 8}}\n{TASK}: {{gamma: 0.99}}\nother/Task-v1: {{gamma: 0.5}}\n",
    )
    settings = read_settings(file, "ppo", TASK)
    assert (settings.n_timesteps, settings.gamma, settings.hyperparameters["n_steps"]) == (5, 0.99, 8)


def test_a_number_that_yaml_takes_for_text_is_a_number(tmp_path: Path) -> None:
    assert read_settings(write(tmp_path, "default: {learning_rate: 2e-5}"), "ppo", TASK).hyperparameters == {
        "learning_rate": 2e-5
    }


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("defaults: {}", "no section 'default:'"),
        ("- 1", "no settings file"),
        ("default: {n_envs: 0}", "'n_envs'"),
        ("default: {normalize: {reward: true}}", r"no setting 'normalize\.reward'\. Did you mean 'rewards'"),
        ("default: {learning_rate: 1e-x}", "no number"),
        ("default: [", "Cannot read"),
    ],
)
def test_a_mistake_in_the_file_is_named(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(TrainingError, match=said):
        read_settings(write(tmp_path, text), "ppo", TASK)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("default: {learning_rat: 0.1}", "Did you mean 'learning_rate'"),
        ("default: {n_timestep: 100}", "Did you mean 'n_timesteps'"),
        ("default: {action_noise_std: 0.1}", "no action noise"),
        ("default: {policy_kwargs: {activation_fn: SiLu}}", "Did you mean 'SiLU'"),
        ("default: {policy: MlpPolicie}", "refuses its settings"),
        ("default: {batch_size: 1}", "refuses its settings"),
    ],
)
def test_a_setting_that_the_algorithm_does_not_take_is_named(
    tmp_path: Path, day: TaskSpec, text: str, said: str
) -> None:
    settings = read_settings(write(tmp_path, text), "ppo", TASK)
    with pytest.raises(GlbenchError, match=said):
        make_model(settings, TrainingVecEnv(day, 2), 0, None)


def test_algorithms_are_found_by_name_and_by_class_path() -> None:
    assert algorithm_class("PPO") is algorithm_class("stable_baselines3.PPO")
    assert algorithm_class("sb3_contrib.RecurrentPPO").__name__ == "RecurrentPPO"


@pytest.mark.parametrize(
    ("name", "said"),
    [("pppo", "Did you mean 'ppo'"), ("nowhere.PPO", "cannot be imported"), ("sb3_contrib.XPO", "cannot be imported")],
)
def test_an_unknown_algorithm_is_named(name: str, said: str) -> None:
    with pytest.raises(UnknownNameError, match=said):
        algorithm_class(name)


def test_a_class_that_is_no_algorithm_is_refused() -> None:
    with pytest.raises(TrainingError, match="no algorithm"):
        algorithm_class("collections.OrderedDict")


def test_what_a_card_says_is_read_back_as_it_was() -> None:
    content = {
        "text": 'a "b" \\ c',
        "lines": "one\ntwo\n",
        "both": 'a\n"""b',
        "list": ["a", "b"],
        "table": {"a-b": 1, "c": 0.1, "d": True},
    }
    assert tomllib.loads(to_toml(content)) == content
