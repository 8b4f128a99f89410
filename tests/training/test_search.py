"""Searches are read, refused when they make no sense, and choose within their bounds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import optuna
import pytest
import yaml

from glbench.cli.train import trial_in_words
from glbench.errors import TrainingError
from glbench.execution import ProcessExecutor
from glbench.leaderboard.catalogue import catalogue
from glbench.tasks import PAPER_TASK, TaskSpec, get_task
from glbench.training.folder import Trained
from glbench.training.periodic_evaluation import CurvePoint, ProbeResult
from glbench.training.settings import TrainingSettings
from glbench.training.sweep import Search, TrialReport, _Pruning, open_study, read_search, sweep, with_choices

BASE = TrainingSettings(algorithm="ppo", policy_kwargs={"activation_fn": "Tanh"}, hyperparameters={"gamma": 0.9})


def read(folder: Path, parameters: str, more: str = "") -> Search:
    file = folder / "search.yml"
    file.write_text(f"algorithm: ppo\ntask: Schiphol2010-Delta10-v1\n{more}\nparameters:\n{parameters}", encoding="utf-8")
    return read_search(file)


def test_a_choice_goes_where_its_setting_is() -> None:
    chosen = with_choices(
        BASE, {"gamma": 0.99, "n_envs": 4, "normalize.rewards": False, "policy_kwargs.activation_fn": "SiLU", "new": 1}, 100
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
    search = read(tmp_path, "  lr: {min: 1.0e-5, max: 1.0e-3, distribution: log_uniform_values}\n  gamma: {values: [0.9, 0.99]}")
    assert search.wandb_config() == {
        "name": "ppo Schiphol2010-Delta10-v1",
        "method": "bayes",
        "metric": {"name": "best_reward", "goal": "maximize"},
        "parameters": {"lr": {"min": 1e-5, "max": 1e-3, "distribution": "log_uniform_values"}, "gamma": {"values": [0.9, 0.99]}},
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


@pytest.mark.slow
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


def a_search(day_file: Path, base: Path, values: str = "{gamma: {values: [0.9, 0.95, 0.99]}}", **more: Any) -> Search:
    said = {"algorithm": "ppo", "task": str(day_file), "config": base, "steps": 32, "trials": 3, "method": "grid"}
    return Search.model_validate({**said, "parameters": yaml.safe_load(values), **more})


def trained_by(monkeypatch: pytest.MonkeyPatch, training: Callable[[TrainingSettings, Path], float]) -> None:
    """Let trials be trained by a function of settings and folder that gives the best reward."""

    def train(task: TaskSpec, settings: TrainingSettings, folder: Path, **_: object) -> Trained:
        reward = training(settings, folder)
        return Trained(folder, settings.n_timesteps, reward, settings.n_timesteps, reward, already_done=False)

    monkeypatch.setattr("glbench.training.sweep.train", train)


@pytest.mark.train
def test_a_trial_that_fails_is_told_and_the_search_goes_on(
    day_file: Path, tmp_path: Path, base: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    told: list[TrialReport] = []
    search = a_search(day_file, base, "{batch_size: {values: [16, 1]}}", trials=5)
    trials = sweep(search, tmp_path / "study", report=told.append)
    assert [trial.number for trial in told] == [0, 1]
    assert [(trial.state, trial.choices["batch_size"]) for trial in trials] == [("complete", 16), ("fail", 1)]
    assert (trials[0].reason, trials[1].reward) == (None, None)
    assert "PPO refuses its settings" in str(trials[1].reason)
    assert "\n" not in str(trials[1].reason)
    assert sweep(search, tmp_path / "study", report=told.append) == trials, "no combination is tried again"
    assert len(told) == 2
    assert "Traceback" not in capfd.readouterr().err


def test_a_search_whose_trials_all_fail_says_why(day_file: Path, tmp_path: Path, base: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def diverge(settings: TrainingSettings, folder: Path) -> float:
        msg = f"gamma {settings.gamma} diverges\nin many words"
        raise ValueError(msg)

    trained_by(monkeypatch, diverge)
    with pytest.raises(TrainingError, match=r"All 3 trials .* failed, the last one so: ValueError: gamma 0\.9\d? diverges$"):
        sweep(a_search(day_file, base), tmp_path / "study")


def test_the_command_says_why_a_trial_failed() -> None:
    trial = TrialReport(7, "fail", None, {"batch_size": 1}, "PPO refuses its settings")
    assert "batch_size 1: PPO refuses its settings" in trial_in_words(trial, catalogue(None).score)


def test_the_command_says_what_a_trial_reached_in_the_words_of_its_task() -> None:
    for task, words in ((PAPER_TASK, "reward  3,751.9"), ("glbench/Spring-v1", "score 3,751.900")):
        assert words in trial_in_words(TrialReport(7, "complete", 3751.9, {}), catalogue(get_task(task)).score)


def test_a_trial_that_is_interrupted_stops_the_search_and_is_made_up_for(
    day_file: Path, tmp_path: Path, base: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(settings: TrainingSettings, folder: Path) -> float:
        if settings.gamma == 0.95:
            raise KeyboardInterrupt
        return settings.gamma

    trained_by(monkeypatch, interrupted)
    with pytest.raises(KeyboardInterrupt):
        sweep(a_search(day_file, base), tmp_path / "study")
    trained_by(monkeypatch, lambda settings, folder: settings.gamma)
    trials = sweep(a_search(day_file, base), tmp_path / "study")
    assert [trial.choices["gamma"] for trial in trials] == [0.99, 0.95, 0.9]


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ("{learning_rat: {values: [0.1]}}", "Did you mean 'learning_rate'"),
        ("{learning_rat: {min: 0.1, max: 0.2}}", "Did you mean 'learning_rate'"),
        ("{normalize.reward: {value: true}}", "Did you mean 'rewards'"),
        ("{gamma: {values: [2, 0.9]}}", "'gamma: 2' cannot be"),
        ("{seed: {values: [1, 2]}}", "glbench sets 'seed'"),
    ],
)
def test_a_parameter_that_cannot_be_is_found_before_anything_is_written(
    day_file: Path, tmp_path: Path, base: Path, values: str, said: str
) -> None:
    with pytest.raises(TrainingError, match=said):
        sweep(a_search(day_file, base, values, method="bayes"), tmp_path / "study")
    assert not (tmp_path / "study").exists()


def test_a_search_may_move_its_files_but_not_change_what_they_say(
    day_file: Path, tmp_path: Path, base: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trained_by(monkeypatch, lambda settings, folder: settings.gamma)
    begun = sweep(a_search(day_file, base), tmp_path / "study")
    moved, task = tmp_path / "moved.yml", tmp_path / "task.toml"
    moved.write_text(base.read_text(encoding="utf-8"), encoding="utf-8")
    task.write_text(day_file.read_text(encoding="utf-8"), encoding="utf-8")
    assert sweep(a_search(task, moved), tmp_path / "study") == begun
    moved.write_text(base.read_text(encoding="utf-8").replace("n_steps: 16", "n_steps: 32"), encoding="utf-8")
    with pytest.raises(TrainingError, match="another search, which differs in config"):
        sweep(a_search(task, moved), tmp_path / "study")
    task.write_text(day_file.read_text(encoding="utf-8").replace("days = 1", "days = 2"), encoding="utf-8")
    with pytest.raises(TrainingError, match="another search, which differs in task"):
        sweep(a_search(task, base), tmp_path / "study")


@pytest.mark.train
def test_a_trial_that_ended_keeps_its_policy_and_not_its_checkpoint(day_file: Path, tmp_path: Path, base: Path) -> None:
    sweep(a_search(day_file, base, "{gamma: {value: 0.9}}"), tmp_path / "study")
    kept = {file.name for file in (tmp_path / "study" / "trial-0000").iterdir()}
    assert {"card.toml", "policy.npz", "best", "learning_curve.csv"} <= kept
    assert "checkpoint" not in kept


def test_a_trial_that_is_stopped_keeps_no_checkpoint(day_file: Path, tmp_path: Path, base: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(settings: TrainingSettings, folder: Path) -> float:
        (folder / "checkpoint" / "a").mkdir(parents=True)
        (folder / "best").mkdir()
        raise optuna.TrialPruned

    trained_by(monkeypatch, stopped)
    trials = sweep(a_search(day_file, base), tmp_path / "study")
    assert [trial.state for trial in trials] == ["pruned"] * 3
    assert [[item.name for item in folder.iterdir()] for folder in (tmp_path / "study").glob("trial-*")] == [["best"]] * 3


def test_a_trial_that_came_to_its_end_is_not_stopped_there(tmp_path: Path) -> None:
    study = open_study(read(tmp_path, "  gamma: {values: [0.9, 0.99]}"), tmp_path)
    for _ in range(6):
        done = study.ask()
        for steps in (0, 50, 100):
            done.report(10.0, steps)
        study.tell(done, 10.0)
    ended, stopped = (_Pruning(study.ask(), 100) for _ in range(2))
    for steps in (0, 100):
        ended.on_evaluation(CurvePoint(steps, 0.0, ProbeResult({"reward": -1.0}), is_best=False))
    stopped.on_evaluation(CurvePoint(0, 0.0, ProbeResult({"reward": -1.0}), is_best=False))
    with pytest.raises(optuna.TrialPruned):
        stopped.on_evaluation(CurvePoint(50, 0.0, ProbeResult({"reward": -1.0}), is_best=False))


def test_numbers_that_yaml_takes_for_text_are_numbers_in_a_search(tmp_path: Path) -> None:
    search = read(tmp_path, "  lr: {values: [1e-3, lin_1e-4]}\n  n_steps: {min: 1e1, max: 1e2}", "steps: 2e5")
    assert search.steps == 200_000
    assert search.parameters["lr"].values == (1e-3, "lin_1e-4")
    low, high = search.parameters["n_steps"].min, search.parameters["n_steps"].max
    assert (low, high, type(low), type(high)) == (10, 100, int, int)


def test_a_grid_has_no_more_trials_than_combinations(tmp_path: Path) -> None:
    values = "  gamma: {values: [0.9, 0.99]}\n  n_epochs: {values: [1, 2, 3]}\n  n_envs: {value: 2}"
    assert [read(tmp_path, values, f"trials: 20\nmethod: {method}").total for method in ("grid", "random")] == [6, 20]
    assert read(tmp_path, values, "trials: 4\nmethod: grid").total == 4


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
def test_workers_share_the_trials_and_all_are_told(day_file: Path, tmp_path: Path, base: Path) -> None:
    search = a_search(day_file, base, "{gamma: {min: 0.9, max: 0.99}}", method="random")
    told: list[TrialReport] = []
    with ProcessExecutor(2) as executor:
        trials = sweep(search, tmp_path / "study", executor=executor, report=told.append)
    assert sorted(trial.number for trial in told) == sorted(trial.number for trial in trials) == [0, 1, 2]
    assert len(list((tmp_path / "study").glob("trial-*"))) == 3


@pytest.mark.train
@pytest.mark.slow
def test_a_grid_tries_every_combination_once_with_two_workers(day_file: Path, tmp_path: Path, base: Path) -> None:
    search = Search.model_validate(
        {
            "algorithm": "ppo", "task": str(day_file), "config": base, "steps": 32, "trials": 4, "method": "grid",
            "parameters": {"gamma": {"values": [0.9, 0.99]}, "n_epochs": {"values": [1, 2]}},
        }
    )  # fmt: skip
    with ProcessExecutor(2) as executor:
        trials = sweep(search, tmp_path / "study", executor=executor)
    tried = {(trial.choices["gamma"], trial.choices["n_epochs"]) for trial in trials}
    assert tried == {(0.9, 1), (0.9, 2), (0.99, 1), (0.99, 2)}
    rewards = [trial.reward for trial in trials]
    assert None not in rewards
    assert rewards == sorted(rewards, key=lambda reward: reward or 0.0, reverse=True)


@pytest.mark.parametrize("damage", ["no database", "cut", "a folder"])
def test_a_study_that_cannot_be_read_is_told_with_a_way_out(day_file: Path, tmp_path: Path, base: Path, damage: str) -> None:
    search = Search(algorithm="ppo", task=str(day_file), config=base, trials=1, steps=8, parameters={"gamma": {"values": [0.9, 0.99]}})
    out = tmp_path / "out"
    if damage == "a folder":
        (out / "study.db").mkdir(parents=True)
    else:
        sweep(search, out)
        whole = (out / "study.db").read_bytes()
        (out / "study.db").write_bytes(b"no database" if damage == "no database" else whole[: len(whole) // 3])
    with pytest.raises(TrainingError, match=r"study\.db cannot be read or written: .*choose a new folder with --out") as refused:
        sweep(search, out)
    assert "sqlalche.me" not in str(refused.value)
