"""The ways that users of other libraries come in by."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import wrappers

from glbench.env import GreenhouseEnv, GreenhouseVectorEnv, info_quantities
from glbench.tasks import TaskSpec, get_task

ID = "glbench:glbench/Schiphol2010-Delta10-v1"
STILL = np.zeros(6, dtype=np.float32)

TAKEN = {
    *("observation", "reward", "done", "terminated", "truncated", "action", "is_init", "step_count", "episode_reward"),  # TorchRL
    *("pixels", "next", "final", "final_obs", "final_info", "final_observation", "episode"),  # TorchRL and Gymnasium
    *("terminal_observation", "TimeLimit.truncated", "is_success"),  # Stable-Baselines3
}  # fmt: skip
"""Keys that tools write beside those of ``info``, or read from it with a meaning of their own."""


def test_make_vec_env_of_stable_baselines3_works_and_draws() -> None:
    from stable_baselines3.common.env_util import make_vec_env

    envs = make_vec_env(ID, n_envs=2, env_kwargs={"kernel": "fast"})
    assert envs.reset().shape == (2, 22)
    envs.step(np.stack([STILL, STILL]))
    picture = envs.render()
    assert picture is not None
    assert (picture.shape, picture.dtype) == ((960, 640, 3), np.uint8)
    envs.close()


@pytest.mark.slow
def test_make_vec_env_works_in_processes() -> None:
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import SubprocVecEnv

    envs = make_vec_env(ID, n_envs=2, vec_env_cls=SubprocVecEnv, env_kwargs={"kernel": "fast"}, seed=3)
    single = make_vec_env(ID, n_envs=2, env_kwargs={"kernel": "fast"}, seed=3)
    assert envs.reset().tobytes() == single.reset().tobytes()
    actions = np.stack([STILL, STILL])
    assert envs.step(actions)[0].tobytes() == single.step(actions)[0].tobytes()
    envs.close()


def test_ppo_learns_from_an_id() -> None:
    from stable_baselines3 import PPO

    agent = PPO("MlpPolicy", ID, n_steps=32, batch_size=32, n_epochs=1, device="cpu")
    agent.learn(64)
    assert agent.num_timesteps == 64


def test_record_video_records(tmp_path: Path) -> None:
    environment = gymnasium.make(ID, render_mode="rgb_array", kernel="fast", max_episode_steps=5)
    environment = wrappers.RecordVideo(environment, str(tmp_path / "videos"), disable_logger=True)
    environment.reset(seed=1)
    for _ in range(5):
        environment.step(STILL)
    environment.close()
    assert [file.suffix for file in (tmp_path / "videos").iterdir()] == [".mp4"]


def test_gymnasiums_wrappers_work() -> None:
    environment: gymnasium.Env[Any, Any] = gymnasium.make(ID, kernel="fast")
    environment = wrappers.RecordEpisodeStatistics(wrappers.TimeLimit(environment, 6))
    environment = wrappers.FrameStackObservation(wrappers.NormalizeObservation(environment), 4)
    environment = wrappers.NormalizeReward(wrappers.RescaleAction(environment, np.float32(0.0), np.float32(1.0)))
    observation, _ = environment.reset(seed=1)
    assert observation.shape == (4, 22)
    for _ in range(6):
        observation, _, terminated, truncated, info = environment.step(STILL + 0.5)
    assert (terminated, truncated, info["episode"]["l"]) == (False, True, 6)


@pytest.mark.parametrize("mode", ["sync", "vector_entry_point"])
@pytest.mark.parametrize("render_mode", [None, "ansi", "rgb_array"])
def test_make_vec_takes_every_render_mode(mode: str, render_mode: str | None) -> None:
    envs = gymnasium.make_vec(ID, num_envs=2, vectorization_mode=mode, kernel="fast", render_mode=render_mode)
    envs.reset(seed=1)
    envs.step(np.stack([STILL, STILL]))
    shown = envs.render() if render_mode else (None, None)
    assert shown is not None
    assert len(shown) == 2
    envs.close()


@pytest.mark.slow
def test_an_asynchronous_vector_environment_is_the_native_one_to_the_bit() -> None:
    found = []
    for mode in ("async", "vector_entry_point"):
        envs = gymnasium.make_vec(ID, num_envs=2, vectorization_mode=mode, kernel="fast")
        envs.reset(seed=1)
        found.append([part.tobytes() for part in envs.step(np.stack([STILL, STILL]))[:4]])
        envs.close()
    assert found[0] == found[1]


def test_info_has_no_key_that_others_write(day: TaskSpec) -> None:
    names = {quantity.name for quantity in info_quantities(day)} | {"failure"}
    assert not names & TAKEN


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
def test_infos_of_rows_are_numbers_that_every_library_can_index(day: TaskSpec, mode: str) -> None:
    """TorchRL merges ``info`` and ``final_info``, key by key, with what a step returns: shapes (rows,), no unsigned 64-bit numbers."""
    envs = GreenhouseVectorEnv(day, 3, kernel="fast", autoreset_mode=mode)
    _, info = envs.reset(seed=[1, 2, 2**62])
    seen: list[dict[str, Any]] = [info]
    seen += [envs.step(np.zeros((3, 6)))[4] for _ in range(day.steps)]
    if mode == "SameStep":
        seen.append(seen[-1]["final_info"])
        assert set(seen[-1]) == set(seen[-3])
    for info in seen:
        for name, values in info.items():
            if name not in {"final_obs", "final_info"}:
                assert values.shape == (3,), name
                assert values.dtype in (np.float64, np.int64, np.bool_), name
    assert set(seen[-1]["seed"].tolist()) >= ({1, 2, 2**62} if mode != "NextStep" else {1})


def test_the_largest_seeds_are_told_as_they_are(day: TaskSpec) -> None:
    envs = GreenhouseVectorEnv(day, 2, kernel="fast")
    assert envs.reset(seed=[1, 2**64 - 1])[1]["seed"].tolist() == [1, 2**64 - 1]
    assert GreenhouseEnv(day, kernel="fast").reset(seed=2**64 - 1)[1]["seed"] == 2**64 - 1


def test_a_changed_copy_of_a_task_can_be_made(day: TaskSpec, make_task: Callable[..., TaskSpec]) -> None:
    environment = gymnasium.make(ID, task=make_task(days=2))
    assert environment.unwrapped.task.steps == 192  # type: ignore[attr-defined]
    envs = gymnasium.make_vec(ID, num_envs=2, vectorization_mode="vector_entry_point", task=day)
    assert envs.unwrapped.task is day  # type: ignore[attr-defined]


def test_the_horizon_is_known_before_an_environment_is_made_and_a_copy_can_leave_the_limit_out() -> None:
    assert gymnasium.spec(ID.removeprefix("glbench:")).max_episode_steps is None
    day = get_task(ID.removeprefix("glbench:")).steps_per_day
    made = gymnasium.make(ID, overrides={"weather.days": 1}, kernel="fast")
    assert made.spec is not None
    copy = gymnasium.make(made.spec, max_episode_steps=-1)
    copy.reset(seed=1)
    ends = [copy.step(STILL)[2:4] for _ in range(day)]
    assert ends[-1] == (True, False)
