"""Libraries of others on glbench's environments; each test needs its own (``python -m docs.compatibility_table`` installs them)."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import glbench  # noqa: F401  # registers the ids
from glbench.env import GreenhouseVectorEnv
from glbench.tasks import TaskSpec

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("default")]

ID = "glbench/Spring-v1"
DAY: dict[str, Any] = {"overrides": {"weather.days": 1}, "kernel": "fast", "normalise": True}
STEPS = 96


def test_gymnasium_wrappers_and_vector_environments() -> None:
    from gymnasium import wrappers

    made = wrappers.RecordEpisodeStatistics(wrappers.TimeAwareObservation(gymnasium.make(ID, **DAY)))
    made.reset(seed=1)
    for _ in range(STEPS):
        *_, terminated, truncated, info = made.step(np.zeros(6, np.float32))
    assert (terminated, truncated, info["episode"]["l"]) == (True, False, STEPS)
    for mode in ("sync", "vector_entry_point"):
        rows = gymnasium.make_vec(ID, num_envs=2, vectorization_mode=mode, **DAY)
        rows.reset(seed=1)
        assert rows.step(np.zeros((2, 6), np.float32))[0].shape[0] == 2


def test_stable_baselines3_trains() -> None:
    sb3 = pytest.importorskip("stable_baselines3")
    wrapped: Callable[..., Any] = pytest.importorskip("sb3_contrib.common.wrappers").TimeFeatureWrapper
    agent = sb3.PPO("MlpPolicy", wrapped(gymnasium.make(ID, **DAY)), n_steps=32, batch_size=32, n_epochs=1, device="cpu")
    assert agent.learn(64).num_timesteps == 64
    agent = sb3.SAC("MlpPolicy", gymnasium.make(ID, **DAY), learning_starts=16, batch_size=16, device="cpu")
    assert agent.learn(32).num_timesteps == 32


def test_a_loop_in_the_manner_of_cleanrl_trains() -> None:
    """One update of PPO with the wrappers of CleanRL's ``ppo_continuous_action.py``."""
    torch = pytest.importorskip("torch")
    from gymnasium import wrappers

    def make_env() -> gymnasium.Env[Any, Any]:
        env: gymnasium.Env[Any, Any] = wrappers.FlattenObservation(gymnasium.make(ID, **DAY))
        env = wrappers.ClipAction(wrappers.RecordEpisodeStatistics(env))
        space = env.observation_space
        env = wrappers.TransformObservation(wrappers.NormalizeObservation(env), lambda seen: np.clip(seen, -10, 10), space)
        return wrappers.TransformReward(wrappers.NormalizeReward(env), lambda reward: float(np.clip(reward, -10, 10)))

    envs = gymnasium.vector.SyncVectorEnv([make_env, make_env])
    columns = int(np.prod(envs.single_observation_space.shape or ()))
    actor, critic = torch.nn.Linear(columns, 6), torch.nn.Linear(columns, 1)
    optimizer = torch.optim.Adam([*actor.parameters(), *critic.parameters()], lr=1e-3)
    seen, _ = envs.reset(seed=1)
    steps, episodes = [], 0
    for _ in range(STEPS + 2):
        x = torch.as_tensor(seen, dtype=torch.float32)
        policy = torch.distributions.Normal(actor(x), 0.5)
        action = policy.sample()
        seen, reward, terminated, truncated, info = envs.step(action.numpy())
        done = np.logical_or(terminated, truncated)
        episodes += int(info["episode"]["l"][0] == STEPS) if "episode" in info else 0
        assert not truncated.any()
        steps.append((policy.log_prob(action).sum(1), critic(x)[:, 0], torch.as_tensor(reward), torch.as_tensor(done)))
    assert episodes == 1
    advantages = torch.stack([reward + 0.0 * ~done for _, _, reward, done in steps]) - torch.stack([v for _, v, _, _ in steps])
    loss = -(torch.stack([log for log, *_ in steps]) * advantages.detach()).mean() + advantages.square().mean()
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    assert all(torch.isfinite(weights).all() for weights in actor.parameters())


def test_torchrl_collects() -> None:
    pytest.importorskip("torchrl")
    from torchrl.envs import GymEnv, GymWrapper
    from torchrl.envs.utils import check_env_specs

    single = GymEnv(ID, device="cpu", **DAY)
    check_env_specs(single)
    rolled = single.rollout(STEPS + 5, break_when_any_done=True)
    assert rolled["next", "terminated"][-1].item()
    assert not rolled["next", "truncated"].any()
    assert rolled.shape[0] == STEPS
    rows = GymWrapper(GreenhouseVectorEnv(ID, 3, autoreset_mode="SameStep", **DAY), device="cpu")
    assert rows.rollout(STEPS + 5, break_when_any_done=False).shape == (3, STEPS + 5)


def test_skrl_steps_and_trains() -> None:
    pytest.importorskip("skrl")
    import torch
    from skrl.agents.torch.ppo import PPO, PPO_CFG
    from skrl.envs.wrappers.torch import wrap_env
    from skrl.memories.torch import RandomMemory
    from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
    from skrl.trainers.torch import SequentialTrainer, SequentialTrainerCfg

    env = wrap_env(gymnasium.make_vec(ID, num_envs=2, **DAY))
    spaces = {"observation_space": env.observation_space, "action_space": env.action_space, "device": env.device}

    class Actor(GaussianMixin, Model):  # type: ignore[misc]
        def __init__(self) -> None:
            Model.__init__(self, **spaces)
            GaussianMixin.__init__(self, clip_actions=True)
            self.layer = torch.nn.Linear(self.num_observations, self.num_actions)
            self.spread = torch.nn.Parameter(torch.zeros(self.num_actions))

        def compute(self, inputs: Any, role: str = "") -> Any:
            return self.layer(inputs["observations"]), {"log_std": self.spread}

    class Critic(DeterministicMixin, Model):  # type: ignore[misc]
        def __init__(self) -> None:
            Model.__init__(self, **spaces)
            DeterministicMixin.__init__(self)
            self.layer = torch.nn.Linear(self.num_observations, 1)

        def compute(self, inputs: Any, role: str = "") -> Any:
            return self.layer(inputs["observations"]), {}

    agent = PPO(
        models={"policy": Actor(), "value": Critic()}, memory=RandomMemory(memory_size=16, num_envs=2, device=env.device),
        cfg=PPO_CFG(rollouts=16, learning_epochs=1, mini_batches=1), **spaces,
    )  # fmt: skip
    SequentialTrainer(env=env, agents=agent, cfg=SequentialTrainerCfg(timesteps=STEPS + 4, headless=True)).train()


def test_tianshou_collects() -> None:
    pytest.importorskip("tianshou")
    from tianshou.algorithm.algorithm_base import RandomActionPolicy
    from tianshou.data import Collector, VectorReplayBuffer
    from tianshou.env import DummyVectorEnv

    rows = DummyVectorEnv([lambda: gymnasium.make(ID, **DAY) for _ in range(2)])
    collector = Collector(RandomActionPolicy(rows.action_space[0]), rows, VectorReplayBuffer(1000, 2))
    collector.reset()
    stats = collector.collect(n_episode=2)
    assert (stats.n_collected_episodes, set(stats.lens)) == (2, {STEPS})


def test_d3rlpy_fits_online() -> None:
    d3rlpy = pytest.importorskip("d3rlpy")
    env = gymnasium.make(ID, **DAY)
    sac = d3rlpy.algos.SACConfig(batch_size=16).create(device="cpu:0")
    buffer = d3rlpy.dataset.create_fifo_replay_buffer(limit=1000, env=env)
    sac.fit_online(env, buffer, n_steps=STEPS + 4, update_start_step=STEPS, n_steps_per_epoch=STEPS + 4, show_progress=False,
                   logger_adapter=d3rlpy.logging.NoopAdapterFactory())  # fmt: skip
    assert buffer.transition_count >= STEPS


def test_rl_zoo3_trains(tmp_path: Path) -> None:
    pytest.importorskip("rl_zoo3")
    settings = tmp_path / "ppo.yml"
    settings.write_text(f"{ID}:\n  n_timesteps: 64\n  policy: MlpPolicy\n  n_steps: 32\n  batch_size: 32\n", encoding="utf-8")
    done = subprocess.run(
        [
            sys.executable, "-m", "rl_zoo3.train", "--algo", "ppo", "--env", ID, "--gym-packages", "glbench", "--conf-file", str(settings),
            "-f", str(tmp_path), "--device", "cpu", "--eval-freq", "-1", "--env-kwargs", "kernel:'fast'", "normalise:True",
        ],
        capture_output=True, text=True, check=False, timeout=300, cwd=tmp_path, env={**os.environ, "PYTHONWARNINGS": "ignore"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    assert list(tmp_path.rglob("*Spring-v1.zip"))


def test_minari_records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    collector = minari.DataCollector(gymnasium.make(ID, **DAY))
    collector.reset(seed=1)
    for _ in range(STEPS):
        collector.step(np.zeros(6, np.float32))
    dataset = collector.create_dataset(
        dataset_id="test/spring-v0", algorithm_name="still", author="A", author_email="a@example.org", code_permalink="-", description="-"
    )
    assert dataset.spec.total_steps == STEPS
    assert dataset.spec.env_spec.max_episode_steps == STEPS


def test_purejaxrl_style(day: TaskSpec) -> None:
    """``tests/jax/ppo.py`` is a learner in the manner of PureJaxRL."""
    jax = pytest.importorskip("jax")
    from glbench.jax import Environment
    from tests.jax.ppo import Settings, make_train

    environment = Environment(day, seeds=range(10_000_000_000, 10_000_000_004), normalise=True)
    rewards = jax.jit(make_train(environment, Settings(envs=8, updates=2)))(jax.random.key(0))
    assert np.isfinite(np.asarray(rewards)).all()
