"""Searches are read, refused when they make no sense, and choose within their bounds."""

from __future__ import annotations

from pathlib import Path

import pytest

from glbench.errors import TrainingError
from glbench.training.search_space import Search, read_search, with_choices
from glbench.training.settings import TrainingSettings
from glbench.training.sweep import open_study, sweep

BASE = TrainingSettings(algorithm="ppo", policy_kwargs={"activation_fn": "Tanh"}, hyperparameters={"gamma": 0.9})


def read(folder: Path, parameters: str, more: str = "") -> Search:
    file = folder / "search.yml"
    file.write_text(
        f"algorithm: ppo\ntask: Schiphol2010-Delta10-v1\n{more}\nparameters:\n{parameters}", encoding="utf-8"
    )
    return read_search(file)


def test_a_choice_goes_where_its_setting_is() -> None:
    chosen = with_choices(
        BASE,
        {"gamma": 0.99, "n_envs": 4, "normalize.rewards": False, "policy_kwargs.activation_fn": "SiLU", "new": 1},
        100,
    )
    assert chosen.hyperparameters == {"gamma": 0.99, "new": 1}
    assert (chosen.n_envs, chosen.n_timesteps, chosen.normalize.rewards) == (4, 100, False)
    assert chosen.policy_kwargs == {"activation_fn": "SiLU"}
    assert BASE.hyperparameters == {"gamma": 0.9}


def test_a_choice_that_has_no_place_is_refused() -> None:
    with pytest.raises(TrainingError, match="has no parts"):
        with_choices(BASE, {"gamma.x": 1}, 100)
    with pytest.raises(TrainingError, match="'n_envs'"):
        with_choices(BASE, {"n_envs": 0}, 100)


@pytest.mark.parametrize(
    ("parameters", "more", "said"),
    [
        ("  gamma: {min: 0.9}", "", "both 'min' and 'max'"),
        ("  gamma: {min: 0.9, max: 0.8}", "", "below 'max'"),
        ("  gamma: {min: 0.0, max: 0.8, distribution: log_uniform_values}", "", "above 0"),
        ("  gamma: {values: [1], value: 2}", "", "'value', 'values'"),
        ("  gamma: {min: 0.9, max: 0.99}", "method: grid", "a grid needs 'values'"),
        ("  gamma: {vals: [1]}", "", "vals"),
        ("  {}", "", "'parameters'"),
    ],
)
def test_a_search_that_makes_no_sense_is_refused(tmp_path: Path, parameters: str, more: str, said: str) -> None:
    with pytest.raises(TrainingError, match=said):
        read(tmp_path, parameters, more)


def test_the_same_file_is_a_sweep_of_weights_and_biases(tmp_path: Path) -> None:
    search = read(
        tmp_path, "  lr: {min: 1.0e-5, max: 1.0e-3, distribution: log_uniform_values}\n  gamma: {values: [0.9, 0.99]}"
    )
    assert search.wandb_config() == {
        "name": "ppo Schiphol2010-Delta10-v1",
        "method": "bayes",
        "metric": {"name": "best_reward", "goal": "maximize"},
        "parameters": {
            "lr": {"min": 1e-5, "max": 1e-3, "distribution": "log_uniform_values"},
            "gamma": {"values": [0.9, 0.99]},
        },
    }


@pytest.fixture
def base(tmp_path: Path) -> Path:
    """Settings of trainings that are over at once."""
    file = tmp_path / "base.yml"
    file.write_text(
        "default: {n_envs: 2, policy_kwargs: {net_arch: [8]}, n_steps: 16, batch_size: 16, evaluation: {every: 1000, runs: 1}}",
        encoding="utf-8",
    )
    return file


@pytest.mark.train
def test_a_continued_search_tries_something_new(day_file: Path, tmp_path: Path, base: Path) -> None:
    search = Search.model_validate(
        {
            "algorithm": "ppo", "task": str(day_file), "config": base, "steps": 32, "trials": 4, "method": "random",
            "parameters": {"gamma": {"min": 0.9, "max": 0.99}},
        }
    )  # fmt: skip
    sweep(search.model_copy(update={"trials": 2}), tmp_path / "halves")
    halves = {trial.number: trial.choices["gamma"] for trial in sweep(search, tmp_path / "halves")}
    assert len(set(halves.values())) == 4
    assert halves == {trial.number: trial.choices["gamma"] for trial in sweep(search, tmp_path / "whole")}


def test_a_trial_is_not_stopped_before_it_has_learnt_anything(tmp_path: Path) -> None:
    study = open_study(read(tmp_path, "  gamma: {values: [0.9, 0.99]}"), tmp_path)
    for _ in range(6):
        done = study.ask()
        for steps in (0, 100):
            done.report(10.0, steps)
        study.tell(done, 10.0)
    trial = study.ask()
    trial.report(-1.0, 0)
    assert not trial.should_prune()
    trial.report(-1.0, 100)
    assert trial.should_prune()


@pytest.mark.train
@pytest.mark.slow
def test_a_grid_tries_every_combination_once_with_two_workers(day_file: Path, tmp_path: Path, base: Path) -> None:
    search = Search.model_validate(
        {
            "algorithm": "ppo", "task": str(day_file), "config": base, "steps": 32, "trials": 4, "method": "grid",
            "parameters": {"gamma": {"values": [0.9, 0.99]}, "n_epochs": {"values": [1, 2]}},
        }
    )  # fmt: skip
    trials = sweep(search, tmp_path / "study", workers=2)
    tried = {(trial.choices["gamma"], trial.choices["n_epochs"]) for trial in trials}
    assert tried == {(0.9, 1), (0.9, 2), (0.99, 1), (0.99, 2)}
    rewards = [trial.reward for trial in trials]
    assert None not in rewards
    assert rewards == sorted(rewards, key=lambda reward: reward or 0.0, reverse=True)
