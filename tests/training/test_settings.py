"""Settings say what the paper says, and mistakes in them are explained."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from annotated_types import Le, Lt
from pydantic import ValidationError
from stable_baselines3 import SAC
from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit

from glbench.errors import GlbenchError, TrainingError, UnknownNameError
from glbench.tasks import TaskSpec, get_task
from glbench.tasks.tables import EvaluationTable
from glbench.training import read_settings, shipped_settings
from glbench.training.algorithms import algorithm_class, check_settings, make_model
from glbench.training.card import to_toml
from glbench.training.season_search import SearchSettings
from glbench.training.settings import FIRST_TRAINING_SEED
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
    assert (settings.n_timesteps, settings.n_envs) == (2_000_000, 8)
    critic = "vf" if algorithm == "ppo" else "qf"
    assert settings.policy_kwargs["net_arch"] == {"pi": [256] * 3, critic: [512] * 3}
    assert settings.policy_kwargs["activation_fn"] == "SiLU"
    assert settings.policy_kwargs["optimizer_kwargs"]["amsgrad"] is True
    assert settings.action_noise_std == (None if algorithm == "ppo" else 0.05)
    assert settings.normalize.observations
    assert settings.normalize.rewards


def test_the_networks_built_from_the_shipped_settings_are_the_papers(day: TaskSpec) -> None:
    settings = read_settings(shipped_settings("ppo"), "ppo", TASK)
    model = make_model(settings, TrainingVecEnv(day, 8), 0)
    layers = [tuple(value.shape) for name, value in model.policy.state_dict().items() if name.endswith("weight")]
    assert layers == [(256, 22), (256, 256), (256, 256), (512, 22), (512, 512), (512, 512), (6, 256), (1, 512)]
    assert model.policy.optimizer.param_groups[0]["amsgrad"] is True


def test_a_section_named_by_the_task_changes_only_what_it_names(tmp_path: Path) -> None:
    file = write(tmp_path, f"default: {{n_timesteps: 5, gamma: 0.9, n_steps: 8}}\n{TASK}: {{gamma: 0.99}}\nother/Task-v1: {{gamma: 0.5}}\n")
    settings = read_settings(file, "ppo", TASK)
    assert (settings.n_timesteps, settings.gamma, settings.hyperparameters["n_steps"]) == (5, 0.99, 8)


def test_a_section_named_by_the_task_leaves_the_rest_of_a_table_as_it_is(tmp_path: Path) -> None:
    file = write(
        tmp_path,
        "default: {policy_kwargs: {net_arch: [8], activation_fn: SiLU}, evaluation: {every: 5, runs: 3}}\n"
        f"{TASK}: {{policy_kwargs: {{activation_fn: Tanh}}, evaluation: {{runs: 2}}}}\n",
    )
    settings = read_settings(file, "ppo", TASK)
    assert settings.policy_kwargs == {"net_arch": [8], "activation_fn": "Tanh"}
    assert (settings.evaluation.every, settings.evaluation.runs) == (5, 2)


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("2e-5", 2e-5),
        ("-3e-4", -3e-4),
        ("1.0e6", 1_000_000),
        ("1e1", 10),
        (".5e-1", 0.05),
        ("[1e-3, 1e1]", [1e-3, 10]),
        ("{a: {b: 1e-5}}", {"a": {"b": 1e-5}}),
        ("lin_3e-4", "lin_3e-4"),
        ("auto", "auto"),
        ("auto_0.1", "auto_0.1"),
    ],
)
def test_a_number_that_yaml_takes_for_text_is_a_number_and_other_text_is_none(tmp_path: Path, written: str, meant: object) -> None:
    read = read_settings(write(tmp_path, f"default: {{target: {written}}}"), "ppo", TASK).hyperparameters["target"]
    assert (read, type(read)) == (meant, type(meant))


def test_numbers_are_read_in_the_trainings_own_settings_too(tmp_path: Path) -> None:
    text = "default: {n_timesteps: 2e6, evaluation: {every: 1e5}, policy_kwargs: {optimizer_kwargs: {eps: 1e-5}}}"
    settings = read_settings(write(tmp_path, text), "ppo", TASK)
    assert (settings.n_timesteps, settings.evaluation.every) == (2_000_000, 100_000)
    assert settings.policy_kwargs == {"optimizer_kwargs": {"eps": 1e-5}}


@pytest.mark.parametrize(
    ("algorithm", "name"), [("PPO", "ppo"), ("Sac", "sac"), ("stable_baselines3.PPO", "ppo"), ("stable_baselines3.SAC", "sac")]
)
def test_the_papers_algorithms_have_shipped_settings_under_all_their_names(algorithm: str, name: str) -> None:
    assert shipped_settings(algorithm) == shipped_settings(name)


def test_an_algorithm_without_shipped_settings_is_named() -> None:
    with pytest.raises(TrainingError, match=r"no settings for 'sb3_contrib\.TQC'"):
        shipped_settings("sb3_contrib.TQC")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("defaults: {}", "no section 'default:'"),
        ("- 1", "not a table of names and values"),
        ("default: {n_envs: 0}", "'n_envs'"),
        ("default: {normalize: {reward: true}}", r"no setting 'normalize\.reward'\. Did you mean 'rewards'"),
        ("default: {learning_rate: 1e-x}", "'learning_rate: 1e-x' .* not a number"),
        ("default: {learning_rate: -1e-x}", "'learning_rate: -1e-x' .* not a number"),
        ("default: {learning_rate: -3e-4}", r"used: 'learning_rate: -0\.0003' cannot be: it is a number above 0"),
        ("default: {learning_rate: constant}", "'learning_rate: constant' cannot be"),
        ("default: {learning_rate: lin_x}", "'learning_rate: lin_x' cannot be"),
        ("default: {learning_rate: lin_-1}", "'learning_rate: lin_-1' cannot be"),
        ("default: {gamma: null}", "'gamma: None' cannot be: it is a number above 0, at most 1"),
        ("default: {gamma: abc}", "'gamma: abc' cannot be"),
        ("default: {gamma: 1.1}", "'gamma: 1.1' cannot be"),
        ("default: {gae_lambda: 0}", "'gae_lambda: 0' cannot be"),
        ("default: {tau: true}", "'tau: True' cannot be"),
        ("default: {batch_size: 0.5}", "'batch_size: 0.5' cannot be: it is a whole number, 1 or more"),
        ("default: {n_steps: 0}", "'n_steps: 0' cannot be"),
        ("default: {n_epochs: -1}", "'n_epochs: -1' cannot be"),
        ("default: {buffer_size: null}", "'buffer_size: None' cannot be"),
        ("default: {gradient_steps: -2}", "'gradient_steps: -2' cannot be: it is .* or -1"),
        ("default: [", "Cannot read"),
    ],
)
def test_a_mistake_in_the_file_is_named(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(TrainingError, match=said):
        read_settings(write(tmp_path, text), "ppo", TASK)


def test_values_at_the_edge_of_what_is_allowed_are_taken(tmp_path: Path) -> None:
    arguments = {"gamma": 1, "tau": 1.0, "gradient_steps": -1, "batch_size": 1, "learning_rate": "lin_3e-4"}
    text = "default: {gamma: 1, tau: 1.0, gradient_steps: -1, batch_size: 1, learning_rate: lin_3e-4}"
    settings = read_settings(write(tmp_path, text), "sac", TASK)
    assert settings.hyperparameters == arguments
    check_settings(settings)


@pytest.mark.parametrize("seed", [0, 666, 10_000, 2**32 + 9_998, FIRST_TRAINING_SEED - 1, 2**53])
def test_seeds_that_a_task_may_be_scored_with_are_refused(tmp_path: Path, seed: int) -> None:
    for place, text in {
        "first_env_seed": f"{{first_env_seed: {seed}}}",
        "evaluation.first_seed": f"{{evaluation: {{first_seed: {seed}}}}}",
    }.items():
        with pytest.raises(TrainingError, match=f"'{place}': .*{seed:,} is not a seed for training"):
            read_settings(write(tmp_path, f"default: {text}"), "ppo", TASK)
    policy = write(tmp_path, "default: {}")
    with pytest.raises(ValidationError, match=f"{seed:,} is not a seed for training"):
        SearchSettings(start_from=policy, first_seed=seed)


def test_no_task_can_be_scored_with_a_seed_for_training() -> None:
    fields = EvaluationTable.model_fields
    bounds = {name: next(at for at in fields[name].metadata if isinstance(at, Lt | Le)) for name in ("first_seed", "runs")}
    last = bounds["first_seed"].lt - 1 + bounds["runs"].le - 1
    assert last < FIRST_TRAINING_SEED


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_the_shipped_settings_train_and_evaluate_on_seeds_of_their_own(algorithm: str) -> None:
    settings = read_settings(shipped_settings(algorithm), algorithm, TASK)
    seasons = -(-settings.n_timesteps // get_task(TASK).steps)
    trained = range(settings.first_env_seed, settings.first_env_seed + seasons + settings.n_envs)
    evaluated = settings.evaluation.seeds(get_task(TASK))
    assert trained.start >= FIRST_TRAINING_SEED
    assert len(evaluated) == settings.evaluation.runs
    assert not set(trained) & set(evaluated)
    assert len(settings.evaluation.seeds(get_task("Schiphol2010-Delta00-v1"))) == 1, "nothing is drawn there"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("default: {seed: 3}", "glbench sets 'seed' of PPO: it is given with --seed"),
        ("default: {device: cuda}", "glbench sets 'device'"),
        ("default: {verbose: 1}", "glbench sets 'verbose'"),
        ("default: {tensorboard_log: here}", "glbench sets 'tensorboard_log'"),
        ("default: {_init_setup_model: false}", "no setting '_init_setup_model'"),
        ("default: {clip_range: lin_x}", "no schedule"),
        ("default: {learning_rat: 0.1}", "Did you mean 'learning_rate'"),
        ("default: {action_noise_std: 0.1}", "no action noise"),
        ("default: {policy_kwargs: {activation_fn: SiLu}}", "Did you mean 'SiLU'"),
    ],
)
def test_settings_are_checked_without_an_environment(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(GlbenchError, match=said):
        check_settings(read_settings(write(tmp_path, text), "ppo", TASK))


def test_an_update_every_episode_reaches_the_algorithm(tmp_path: Path, day: TaskSpec) -> None:
    settings = read_settings(write(tmp_path, "default: {train_freq: [1, episode], buffer_size: 10}"), "sac", TASK)
    model = make_model(settings, TrainingVecEnv(day, 1), 0)
    assert isinstance(model, SAC)
    assert str(model.train_freq) == str(TrainFreq(1, TrainFrequencyUnit.EPISODE))


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
def test_a_setting_that_the_algorithm_does_not_take_is_named(tmp_path: Path, day: TaskSpec, text: str, said: str) -> None:
    settings = read_settings(write(tmp_path, text), "ppo", TASK)
    with pytest.raises(GlbenchError, match=said):
        make_model(settings, TrainingVecEnv(day, 2), 0)


def test_algorithms_are_found_by_name_and_by_class_path() -> None:
    assert algorithm_class("PPO") is algorithm_class("stable_baselines3.PPO")
    assert algorithm_class("sb3_contrib.RecurrentPPO").__name__ == "RecurrentPPO"


@pytest.mark.parametrize(
    ("name", "said"), [("pppo", "Did you mean 'ppo'"), ("nowhere.PPO", "cannot be imported"), ("sb3_contrib.XPO", "cannot be imported")]
)
def test_an_unknown_algorithm_is_named(name: str, said: str) -> None:
    with pytest.raises(UnknownNameError, match=said):
        algorithm_class(name)


def test_a_class_that_is_no_algorithm_is_refused() -> None:
    with pytest.raises(TrainingError, match="not an algorithm"):
        algorithm_class("collections.OrderedDict")


def test_what_a_card_says_is_read_back_as_it_was() -> None:
    content = {"text": 'a "b" \\ c', "lines": "one\ntwo\n", "both": 'a\n"""b', "list": ["a", "b"], "table": {"a-b": 1, "c": 0.1, "d": True}}
    assert tomllib.loads(to_toml(content)) == content
