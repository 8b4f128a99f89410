"""One policy for two crops: in each task it is an ordinary policy of that task, and trainings of both kinds are shipped alike."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks import two_crops
from benchmarks.mixed_vec_env import Greenhouses, restricted
from benchmarks.two_crops import TRAININGS, Training, main, ship
from glbench.agents.network_policy import ActorAgent, PolicyFiles, read_actor
from glbench.errors import TrainingError
from glbench.tasks import task_card

SHORT = """
base = "glbench/{base}"
id = "test/{base}"
title = "Two days"
weather = {{ days = 2 }}
"""
SETTINGS = """
default:
  n_timesteps: 96
  n_envs: 3
  policy_kwargs: {net_arch: [16, 16], activation_fn: Tanh}
  learning_rate: 1.0e-2
  n_steps: 16
  batch_size: 48
  evaluation: {every: 48, runs: 2, first_seed: 20_000_000_000}
test/Spring-v1:
  gamma: 0.9
  accrual: {state: cBuf, price: 1.0e-5}
test/Lettuce-v1:
  gamma: 0.98
  accrual: {state: xS, price: 15.0}
"""


@pytest.fixture
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Settings of a training of a few hundred steps; the tasks last two days."""
    for name, task in dict(two_crops.TASKS).items():
        (tmp_path / f"{name}.toml").write_text(SHORT.format(base=task))
        monkeypatch.setitem(two_crops.TASKS, name, str(tmp_path / f"{name}.toml"))
    (tmp_path / "small.yml").write_text(SETTINGS)
    return tmp_path / "small.yml"


@pytest.mark.parametrize("kind", TRAININGS)
def test_in_each_task_the_policy_acts_as_the_network_on_the_columns_of_all_tasks(kind: str, settings: Path) -> None:
    training = Training.of(kind, 0, settings)
    env = training.env()
    assert len(env.names) == len(set(env.names)) == (54 if kind == "two_crops" else 51)
    model = training.model(env)
    seen = np.asarray(env.reset())
    random = np.random.default_rng(0)
    for _ in range(30):
        seen = np.asarray(env.step(random.uniform(0.0, 1.0, (env.num_envs, 6)))[0])
    model.learn(96)
    for number, (task, part, rows) in enumerate(zip(training.tasks.values(), env.parts, env.rows, strict=True)):
        actor = restricted(model, env, number, task, {})
        assert actor.why_not(task_card(task)) is None
        raw = np.asarray(part.unnormalize_obs(seen[rows][:, env.places[number]]))
        wide = env.union(number, np.asarray(part.normalize_obs(raw)))
        assert set(wide[:, -1]) == {(-1.0, 1.0)[number]}
        absent = [place for place in range(len(env.names) - 1) if place not in env.places[number]]
        assert not wide[:, absent].any()
        joint = model.policy.get_distribution(torch.from_numpy(wide).float()).mode().detach().numpy()
        np.testing.assert_allclose(actor.network.act(raw), np.clip(joint, 0.0, 1.0), atol=1e-6, rtol=0.0)


def test_advantages_discount_each_task_by_its_own_gamma(settings: Path) -> None:
    training = Training.of("two_crops", 0, settings)
    env = training.env()
    buffer = training.model(env).rollout_buffer
    buffer.rewards[:], buffer.episode_starts[0] = 1.0, 1.0
    buffer.gae_lambda = 1.0
    buffer.compute_returns_and_advantage(torch.zeros(env.num_envs), np.zeros(env.num_envs))
    sums = [sum(gamma**step for step in range(16)) for gamma in (0.9, 0.98)]
    np.testing.assert_allclose(buffer.advantages[0], np.repeat(sums, 3), rtol=1e-5)
    assert [part.gamma for part in env.parts] == [0.9, 0.98]


def test_controls_move_to_the_positions_and_first_episodes_end_apart(settings: Path) -> None:
    training = Training.of("spring", 0, settings)
    task = training.tasks["spring"]
    env = Greenhouses(task, training.settings["spring"])
    env.reset()
    vents = task_card(task).observation_names.index("vents")
    readings = [env.step(np.full((3, 6), 0.25, np.float32)) for _ in range(task.steps)]
    assert [np.asarray(step[0])[0, vents] for step in readings[:4]] == pytest.approx([0.1, 0.2, 0.25, 0.25])
    ends = [(number, row) for number, step in enumerate(readings, 1) for row in np.flatnonzero(step[2]).tolist()]
    assert ends == [(task.steps // 3, 0), (2 * task.steps // 3, 1), (task.steps, 2)]
    assert [readings[number - 1][3][row]["TimeLimit.truncated"] for number, row in ends] == [True, True, False]


@pytest.mark.train
def test_trainings_are_made_once_and_shipped_for_each_task(settings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    command = ["--work", str(tmp_path / "work"), "--settings", str(settings), "--seeds", "1"]
    assert main(command) == 0
    policies = sorted((tmp_path / "work").rglob("policy.npz"))
    assert [file.parent.parent.name for file in policies] == ["lettuce-seed1", "spring-seed1", "two_crops-seed1", "two_crops-seed1"]
    monkeypatch.setattr(Training, "carry_out", None)
    assert main(command) == 0
    (tmp_path / "other.yml").write_text(SETTINGS.replace("batch_size: 48", "batch_size: 24"))
    assert main([*command, "--settings", str(tmp_path / "other.yml")]) == 1
    for recipe in ("ppo_two_crops", "ppo_one_crop"):
        (tmp_path / "baselines" / recipe).mkdir(parents=True)
        (tmp_path / "baselines" / recipe / "card.in.toml").write_text(
            'title = "PPO"\ncontroller = "actor"\nsettings = "weights"\ndescription = "x"\nmade = "x"\nsources = []\n'
        )
    monkeypatch.setattr(two_crops, "data_folder", lambda name: tmp_path / name)
    for kind in TRAININGS:
        ship(Training.of(kind, 1, settings), tmp_path / "work" / f"{kind}-seed1")
    for recipe, on in (("ppo_two_crops", 2), ("ppo_one_crop", 1)):
        home = tmp_path / "baselines" / f"{recipe}_seed1"
        assert tomllib.loads((home / "card.toml").read_text())["training"] == {"recipe": recipe, "seed": 1}
        for name, task in Training.of("two_crops", 1, settings).tasks.items():
            agent = ActorAgent(PolicyFiles.at(home / "weights"))
            agent.reset(task_card(task), 1)
            assert agent.act(np.zeros((1, 50), np.float32)).shape == (1, 6)
            assert read_actor(home / f"weights/{name}.npz").network.task_id == task.id
            card = tomllib.loads((home / f"training/{name}.toml").read_text())["training"]
            assert (card["steps"], len(card["trained_on"])) == (96 * on, on)


def test_settings_of_the_tasks_may_differ_in_what_training_pays_and_how_far_it_looks_alone(settings: Path) -> None:
    settings.write_text(SETTINGS.replace("test/Lettuce-v1:", "test/Lettuce-v1:\n  n_steps: 8"))
    with pytest.raises(TrainingError, match="differ in more than 'accrual' and 'gamma'"):
        Training.of("two_crops", 0, settings)
