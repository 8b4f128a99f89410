"""Weights & Biases, without its service: runs are written to files, and the service that chooses trials is played here."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("wandb", reason="needs the extra 'wandb'")

import wandb

from glbench.tasks import TaskSpec
from glbench.training import TrainingSettings, train
from glbench.training.sweep import Search
from glbench.training.wandb_log import WandbListener, wandb_sweep

pytestmark = [pytest.mark.train, pytest.mark.slow]


@pytest.fixture(autouse=True)
def offline(monkeypatch: pytest.MonkeyPatch) -> None:
    """No account, no network."""
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("WANDB_SILENT", "true")


@pytest.mark.parametrize("algorithm", ["ppo"], indirect=True)
def test_a_training_leaves_a_run_that_can_be_synced_later(day: TaskSpec, tiny: TrainingSettings, tmp_path: Path) -> None:
    listener = WandbListener("my run, seed 0", {"gamma": 0.96}, tmp_path / "run")
    try:
        trained = train(day, tiny, tmp_path / "run", tensorboard=False, listeners=[listener])
        assert listener.run.id == "my-run--seed-0"
        assert listener.run.config["gamma"] == 0.96
        assert wandb.run.summary["best_reward"] == trained.best_reward
    finally:
        listener.close()
    assert list((tmp_path / "run" / "wandb").glob("offline-run-*/*.wandb"))


def test_a_sweep_asks_the_service_for_trials(day_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, Any] = {}

    def agent(sweep_id: str, function: Callable[[], None], count: int, project: str) -> None:
        asked["agent"] = (sweep_id, count)
        function()

    def sweep(config: dict[str, Any], project: str) -> str:
        asked["config"] = config
        return "sweep-1"

    monkeypatch.setattr(wandb, "sweep", sweep)
    monkeypatch.setattr(wandb, "agent", agent)
    (tmp_path / "base.yml").write_text(
        "default: {n_envs: 2, policy_kwargs: {net_arch: [8]}, n_steps: 16, batch_size: 16, evaluation: {every: 1000, runs: 1}}",
        encoding="utf-8",
    )
    search = Search.model_validate(
        {"algorithm": "ppo", "task": str(day_file), "config": tmp_path / "base.yml", "steps": 32, "trials": 3,
         "parameters": {"gamma": {"values": [0.9, 0.99]}}}
    )  # fmt: skip
    wandb_sweep(search, tmp_path / "study")
    assert asked == {"config": search.wandb_config(), "agent": ("sweep-1", 3)}
    assert len(list((tmp_path / "study").glob("*/card.toml"))) == 1
