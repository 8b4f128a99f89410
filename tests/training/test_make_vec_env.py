"""The vector environment for scripts of one's own: Stable-Baselines3 finds in it all that it expects of its own."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from glbench.env import GreenhouseEnv
from glbench.errors import GlbenchError, TaskError, UnknownNameError
from glbench.tasks import TaskSpec, get_task
from glbench.training import make_vec_env
from glbench.training.settings import FIRST_TRAINING_SEED
from glbench.training.vec_env import TrainingVecEnv
from tests.support import examples_of, run_examples


def test_row_and_episode_are_those_of_the_environment_that_gymnasium_makes(day: TaskSpec) -> None:
    rows, single = make_vec_env(day, 3, seed=2, kernel="reference"), GreenhouseEnv(day)
    assert isinstance(rows, VecEnv)
    check_env(single, warn=True, skip_render_check=True)
    seen, first = rows.reset(), FIRST_TRAINING_SEED + 2_000_000
    random = np.random.default_rng(0)
    for episode in range(2):
        observation, _ = single.reset(seed=first + 3 * episode + 1)
        for _ in range(day.steps):
            np.testing.assert_array_equal(seen[1], observation)
            actions = random.uniform(-1, 1, (3, 6)).astype(np.float32)
            seen, rewards, _, infos = rows.step(actions)
            observation, reward, terminated, _, _ = single.step(actions[1])
            assert rewards[1] == np.float32(reward)
        assert terminated
        np.testing.assert_array_equal(infos[1]["terminal_observation"], observation)


def test_a_task_is_named_as_gymnasium_names_it_or_shorter() -> None:
    ids = [make_vec_env(name, 1).environment.task.id for name in ("glbench:glbench/Spring-v1", "Spring-v1")]
    assert ids == ["glbench/Spring-v1"] * 2


def test_episodes_are_of_the_training_split_unless_another_is_named(day: TaskSpec) -> None:
    assert make_vec_env("Spring-v1", 1).environment.task.split == "training"
    assert make_vec_env("Spring-v1", 1, split="validation").environment.task.split == "validation"
    assert make_vec_env("Spring-v1", 1, overrides={"weather.days": 7}).environment.task.steps == 672
    with pytest.raises(TaskError, match="no split 'validation'"):
        make_vec_env(day, 1, split="validation")


def test_other_seeds_meet_other_seasons(day: TaskSpec) -> None:
    met = []
    for seed in (0, 0, 1):
        env = make_vec_env(day, 2, seed=seed)
        env.reset()
        met.append(env.environment.simulation.seeds.tolist())
    assert met == [[FIRST_TRAINING_SEED, FIRST_TRAINING_SEED + 1]] * 2 + [
        [FIRST_TRAINING_SEED + 1_000_000, FIRST_TRAINING_SEED + 1_000_001]
    ]


def test_workers_change_no_bit(day: TaskSpec) -> None:
    actions = np.random.default_rng(0).uniform(-1, 1, (5, 6)).astype(np.float32)
    for one, two in zip(*(stepped(make_vec_env(day, 5, workers=workers), actions) for workers in (1, 2)), strict=True):
        np.testing.assert_array_equal(one, two)


def stepped(env: TrainingVecEnv, actions: np.ndarray) -> tuple[np.ndarray, ...]:
    first = env.reset()
    observations, rewards, *_ = env.step(actions)
    env.close()
    return first, observations, rewards


@pytest.mark.parametrize(("given", "words"), [({"seed": -1}, "from 0 to 9,999"), ({"n_envs": 0}, "0")])
def test_impossible_numbers_are_refused(day: TaskSpec, given: dict[str, int], words: str) -> None:
    with pytest.raises(GlbenchError, match=words):
        make_vec_env(day, **given)


def test_an_unknown_preset_is_refused(day: TaskSpec) -> None:
    with pytest.raises(UnknownNameError, match="fast"):
        make_vec_env(day, 1, kernel="fats")


@pytest.mark.parametrize("algorithm", [PPO, SAC])
def test_algorithms_learn_on_it_and_know_its_seasons_without_a_monitor(algorithm: type, day: TaskSpec) -> None:
    env = VecNormalize(make_vec_env(day, 4))
    assert env.env_is_wrapped(Monitor) == [True] * 4
    more = {"n_steps": 24, "n_epochs": 1} if algorithm is PPO else {"learning_starts": 48, "buffer_size": 500}
    model = algorithm("MlpPolicy", env, policy_kwargs={"net_arch": [16]}, batch_size=32, device="cpu", seed=0, **more)
    before = {name: value.clone() for name, value in model.policy.state_dict().items()}
    model.learn(4 * 24 * 2)
    assert any((value != before[name]).any() for name, value in model.policy.state_dict().items())
    assert {one["l"] for one in model.ep_info_buffer} == {day.steps}
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # that there is no Monitor
        rewards, _ = evaluate_policy(model, make_vec_env(day, 2, seed=1), 2, return_episode_rewards=True)
    assert np.isfinite(rewards).all()


@pytest.mark.slow
def test_the_example_of_the_page_trains_and_saves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (example,) = (one for one in examples_of("training.md") if "make_vec_env" in one)
    names = run_examples("training.md", [example], {})
    assert names["model"].num_timesteps >= 12_288
    assert names["env"].observation_space.shape == (len(get_task("GreenhouseReal-v1").observed()),)
    assert (tmp_path / "my_ppo.zip").is_file()
    assert (tmp_path / "vecnormalize.pkl").is_file()
