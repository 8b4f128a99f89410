"""A season of one day, and settings so small that a training takes seconds."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from glbench.resources import data_folder
from glbench.tasks import TaskSpec, get_task
from glbench.training import TrainingSettings

TINY = """
default:
  n_timesteps: 600
  n_envs: 2
  policy_kwargs: {net_arch: [16, 16], activation_fn: SiLU}
  learning_rate: 1e-3
  batch_size: 32
  gamma: 0.96
  evaluation: {every: 200, runs: 2, first_seed: 20_000_000_000}
"""
PPO = TINY + "  n_steps: 48\n  n_epochs: 2\n"
SAC = TINY + "  buffer_size: 1000\n  learning_starts: 100\n  train_freq: 10\n  gradient_steps: 2\n  action_noise_std: 0.05\n"


@pytest.fixture(scope="session")
def day_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Task file of one day in steps of an hour: 24 steps a season."""
    text = (data_folder("tasks") / "schiphol2010-delta10-v1.toml").read_text(encoding="utf-8")
    for old, new in {
        'id = "glbench/Schiphol2010-Delta10-v1"': 'id = "test/Day-v1"',
        "days = 60": "days = 1",
        "step_seconds = 900": "step_seconds = 3600",
        "runs = 30": "runs = 3",
    }.items():
        assert old in text
        text = re.sub(re.escape(old), new, text, count=1)
    file = tmp_path_factory.mktemp("task") / "day.toml"
    file.write_text(text, encoding="utf-8")
    return file


@pytest.fixture(scope="session")
def day(day_file: Path) -> TaskSpec:
    """The task of ``day_file``."""
    return get_task(str(day_file))


@pytest.fixture(params=["ppo", "sac"])
def algorithm(request: pytest.FixtureRequest) -> str:
    """Both algorithms, one after the other."""
    return str(request.param)


@pytest.fixture
def tiny(algorithm: str, tmp_path: Path) -> TrainingSettings:
    """Settings of a training of 600 steps."""
    from glbench.training import read_settings

    file = tmp_path / f"{algorithm}.yml"
    file.write_text(PPO if algorithm == "ppo" else SAC, encoding="utf-8")
    return read_settings(file, algorithm, "test/Day-v1")


def torch_action(model: Any, normalization: Any, observations: Any) -> Any:
    """What Stable-Baselines3 itself answers, to compare with."""
    import torch

    seen = observations if normalization is None else normalization.normalize_obs(observations)
    with torch.no_grad():
        actions, _ = model.predict(seen, deterministic=True)
    return actions
