"""Training on the command line: one agent from the first step to its score, and mistakes explained."""

from __future__ import annotations

import importlib
import sys
import tomllib
from pathlib import Path
from typing import NoReturn

import pytest

pytest.importorskip("stable_baselines3", reason="training needs the extra 'train'")

from glbench.cli.options import needs_the_extra
from glbench.errors import TrainingError
from glbench.kernel import why_not_compiled
from tests.cli.command_line import Command

TINY = """
default:
  n_timesteps: 200
  n_envs: 2
  policy_kwargs: {net_arch: [8], activation_fn: SiLU}
  n_steps: 32
  batch_size: 32
  evaluation: {every: 100, runs: 1}
"""
SEARCH = """
algorithm: ppo
task: day.toml
config: tiny.yml
steps: 100
trials: 2
parameters:
  learning_rate: {min: 1.0e-4, max: 1.0e-2, distribution: log_uniform_values}
"""


@pytest.fixture
def settings(here: Path) -> Path:
    """The current folder with settings of a training of 200 steps, and a search."""
    (here / "tiny.yml").write_text(TINY, encoding="utf-8")
    (here / "sweep.yml").write_text(SEARCH, encoding="utf-8")
    return here


@pytest.mark.train
def test_a_trained_folder_is_an_agent(glbench: Command, settings: Path) -> None:
    trained = glbench("train", "ppo", "--task", "day.toml", "--config", "tiny.yml", "--seed", "2")
    assert trained.code in (0, 3), trained.err  # 3: nothing was learnt in so few steps
    assert "best" in trained.err
    assert "256 steps (200 in whole rollouts of 64)" in trained.err
    folder = settings / "runs" / "ppo-Day-v1-seed2"
    card = tomllib.loads((folder / "card.toml").read_text(encoding="utf-8"))
    assert card["training"]["seed"] == 2
    assert list((folder / "tensorboard").rglob("events.out.*"))
    scored = glbench("evaluate", "runs/ppo-Day-v1-seed2", "--task", "day.toml")
    assert scored.code == 0, scored.err
    assert (settings / "reports" / "results" / "Day-v1" / "ppo-Day-v1-seed2.json").is_file()
    again = glbench("train", "ppo", "--task", "day.toml", "--config", "tiny.yml", "--seed", "2")
    assert "Already trained" in again.err
    other = glbench("train", "ppo", "--task", "day.toml", "--config", "tiny.yml", "--seed", "3", "--out", str(folder))
    assert other.code == 1
    assert "--resume" in other.err


COMPILED = """
default:
  learner: compiled
  n_timesteps: 2_000
  n_envs: 8
  n_steps: 12
  batch_size: 48
  net_arch: [8]
  scenarios: 2
  places: 4
  evaluation: {every: 1_000, runs: 1}
"""


@pytest.mark.slow
@pytest.mark.train
@pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))
def test_a_folder_of_the_compiled_learner_is_an_agent(glbench: Command, settings: Path) -> None:
    pytest.importorskip("jax", reason="JAX is not installed (extra 'jax')")
    (settings / "fast.yml").write_text(COMPILED, encoding="utf-8")
    arguments = ("train", "ppo", "--task", "day.toml", "--config", "fast.yml", "--seed", "2")
    trained = glbench(*arguments)
    assert trained.code in (0, 3), trained.err  # 3: nothing was learnt in so few steps
    assert "2,016 steps in rollouts of 96, 8 greenhouses, seed 2" in " ".join(trained.err.split())
    assert "Each evaluation is the mean of 1 season with seeds that are not scored, without exploration." in trained.err
    scored = glbench("evaluate", "runs/ppo-Day-v1-seed2", "--task", "day.toml")
    assert scored.code == 0, scored.err
    assert "Already trained" in glbench(*arguments).err
    assert "policy.npz" in glbench("export", "runs/ppo-Day-v1-seed2", "--task", "day.toml").out
    both = glbench(*arguments[:-2], "--seeds", "2,3", "--workers", "1")
    assert both.code in (0, 3), both.err
    assert "seed 2: already trained" in both.err
    assert "seed 3: done, best" in both.err
    other = glbench("train", "ppo", "--task", "day.toml", "--config", "tiny.yml", "--out", "runs/ppo-Day-v1-seed2")
    assert other.code == 1
    assert "another training" in other.err


def test_without_jax_the_compiled_learner_names_the_extra(glbench: Command, settings: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "jax", None)
    for module in ("glbench.training.compiled", "glbench.training.learner"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    tried = glbench("train", "ppo", "--task", "day.toml")
    assert tried.code == 1
    assert 'pip install "glbench[jax]"' in " ".join(tried.err.split())


@pytest.mark.train
def test_a_training_that_never_beats_its_beginning_is_no_success(glbench: Command, settings: Path) -> None:
    still = TINY + "  learning_rate: 1.0e-300\n  normalize: {observations: false}\n"
    (settings / "still.yml").write_text(still, encoding="utf-8")
    for _ in range(2):  # the second time it is finished already
        trained = glbench("train", "ppo", "--task", "day.toml", "--config", "still.yml", "--out", "run")
        assert trained.code == 3
        assert "Nothing was learnt. The training never beat the policy that it began with: reward" in trained.err
        assert "Best policy" not in trained.out


@pytest.mark.train
def test_an_exported_model_is_an_agent(glbench: Command, settings: Path) -> None:
    glbench("train", "ppo", "--task", "day.toml", "--config", "tiny.yml", "--out", "run", "--no-tensorboard")
    kept = (settings / "run" / "policy.npz").read_bytes()
    answer = glbench("export", "run/best/model.zip", "--normalization", "run/best/vecnormalize.pkl", "--task", "day.toml", "--out", "mine")
    assert answer.code == 0, answer.err
    assert "mine/policy.npz" in answer.out
    assert glbench("evaluate", "mine", "--task", "day.toml").code == 0
    assert glbench("export", "run").code == 1, "a task file of one's own is not known by its id"
    (settings / "run" / "policy.npz").unlink()
    assert glbench("export", "run", "--task", "day.toml").code == 0
    assert (settings / "run" / "policy.npz").read_bytes() == kept
    refused = glbench("export", "run", "--task", "day.toml", "--out", "elsewhere")
    assert (refused.code, "--out" in refused.err) == (1, True)


@pytest.mark.train
def test_the_normalisation_beside_a_model_is_exported_with_it(glbench: Command, settings: Path) -> None:
    glbench("train", "ppo", "--task", "day.toml", "--config", "tiny.yml", "--out", "run", "--no-tensorboard")
    policies = {}
    for name, more in {"beside": (), "named": ("run/best/vecnormalize.pkl",), "none": ("none",)}.items():
        options = ("--normalization", *more) if more else ()
        assert glbench("export", "run/best/model.zip", *options, "--task", "day.toml", "--out", name).code == 0
        policies[name] = (settings / name / "policy.npz").read_bytes()
    assert policies["beside"] == policies["named"] != policies["none"]


@pytest.mark.slow
@pytest.mark.train
def test_a_policy_with_a_memory_is_evaluated_as_it_was_saved(glbench: Command, settings: Path) -> None:
    recurrent = TINY.replace("policy_kwargs: {net_arch: [8], activation_fn: SiLU}", "policy: MlpLstmPolicy")
    (settings / "recurrent.yml").write_text(recurrent, encoding="utf-8")
    trained = glbench("train", "sb3_contrib.RecurrentPPO", "--task", "day.toml", "--config", "recurrent.yml", "--out", "run")
    assert trained.code == 0, trained.err
    assert "No policy.npz was written: RecurrentPPO has a memory" in trained.err
    assert "Next: glbench evaluate run/best/model.zip --task day.toml" in trained.err
    folder = glbench("evaluate", "run", "--task", "day.toml")
    assert (folder.code, "glbench evaluate" in folder.err, "best/model.zip" in folder.err) == (1, True, True)
    assert glbench("evaluate", "run/best/model.zip", "--task", "day.toml").code == 0


@pytest.mark.train
def test_a_tuned_folder_is_an_agent(glbench: Command, settings: Path) -> None:
    glbench("train", "ppo", "--task", "day.toml", "--config", "tiny.yml", "--out", "run", "--no-tensorboard")
    (settings / "tune.yml").write_text("default: {population: 4, seasons: 2, directions: 2, evaluation: {runs: 2}}", encoding="utf-8")
    command = ("tune", "run", "--task", "day.toml", "--config", "tune.yml", "--generations", "3", "--out", "tuned")
    tuned = glbench(*command)
    assert tuned.code == 0, tuned.err
    assert "3 generations of 8 runs" in tuned.err
    assert "Best policy: reward" in tuned.out
    card = tomllib.loads((settings / "tuned" / "card.toml").read_text(encoding="utf-8"))
    assert card["training"]["generations"] == 3
    assert glbench("evaluate", "tuned", "--task", "day.toml").code == 0
    assert "Already tuned" in glbench(*command).err


@pytest.mark.train
def test_a_folder_of_tuned_rules_is_an_agent(glbench: Command, settings: Path) -> None:
    command = ("tune", "rules", "--task", "day.toml", "--seasons", "12", "--population", "4", "--seed", "1")
    tuned = glbench(*command)
    assert tuned.code in (0, 3), tuned.err  # 3: nothing better was found so soon
    assert "3 generations of 4 candidates" in tuned.err
    folder = settings / "runs" / "rules-Day-v1-seed1"
    card = tomllib.loads((folder / "card.toml").read_text(encoding="utf-8"))
    assert (card["training"]["seasons"], card["training"]["seed"]) == (12, 1)
    scored = glbench("evaluate", "runs/rules-Day-v1-seed1", "--task", "day.toml")
    assert scored.code == 0, scored.err
    assert "Already tuned" in glbench(*command).err
    other = glbench("tune", "rules", "--task", "day.toml", "--config", "none.yml")
    assert (other.code, "Cannot read the rules none.yml" in other.err) == (1, True)


@pytest.mark.train
def test_a_search_is_continued_and_its_best_trial_shown_first(glbench: Command, settings: Path) -> None:
    first = glbench("sweep", "--config", "sweep.yml")
    assert first.code == 0, first.err
    assert first.err.count("complete") == 2
    assert "2 trials of 100 steps" in " ".join(first.err.split())
    again = glbench("sweep", "--config", "sweep.yml")
    assert "complete" not in again.err, "both trials are there already"
    assert again.out == first.out
    (settings / "sweep.yml").write_text(SEARCH.replace("steps: 100", "steps: 150"), encoding="utf-8")
    other = glbench("sweep", "--config", "sweep.yml")
    assert other.code == 1
    assert "another search" in other.err
    grid = SEARCH.replace("trials: 2", "method: grid").partition("  learning_rate")[0] + "  learning_rate: {values: [1.0e-3]}\n"
    (settings / "grid.yml").write_text(grid, encoding="utf-8")
    assert ": 1 trial of 100 steps" in " ".join(glbench("sweep", "--config", "grid.yml").err.split())


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("train", "pppo"), "Did you mean 'ppo'"),
        (("train", "sb3_contrib.RecurrentPPO"), "--config"),
        (("train", "ppo", "--config", "nowhere.yml"), "Cannot read the settings"),
        (("train", "ppo", "--config", "sweep.yml"), "not a settings file"),
        (("sweep", "--config", "tiny.yml"), "cannot be used"),
        (("tune", "nowhere.npz"), "There is no policy file"),
        (("tune", "nowhere.npz", "--config", "tiny.yml"), "Give a policy.npz file or a folder"),
        (("export", "nowhere.zip"), "Cannot read the model: nowhere.zip is not a file. Give"),
        (("export", "."), "no finished training"),
    ],
)
def test_a_mistake_is_explained(glbench: Command, settings: Path, arguments: tuple[str, ...], said: str) -> None:
    answer = glbench(*arguments)
    assert answer.code == 1
    assert said in answer.err


def interrupted(*_: object, **__: object) -> NoReturn:
    raise KeyboardInterrupt


def test_an_interrupted_training_says_once_what_was_kept(glbench: Command, settings: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("glbench.training.train", interrupted)
    arguments = ("train", "ppo", "--task", "day.toml", "--config", "tiny.yml", "--out", "run")
    nothing = glbench(*arguments)
    assert (nothing.code, nothing.err.count("Interrupted.")) == (130, 1)
    assert "Interrupted before the first checkpoint; the same command starts over." in nothing.err
    monkeypatch.setattr("glbench.training.folder.find_checkpoint", lambda folder: folder)
    assert "with --resume continues from the last checkpoint" in glbench(*arguments).err


def test_an_interrupted_search_says_so_once(glbench: Command, settings: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("glbench.training.sweep.sweep", interrupted)
    answer = glbench("sweep", "--config", "sweep.yml")
    assert (answer.code, answer.err.count("Interrupted.")) == (130, 1)
    assert "Finished trials are kept" in answer.err


def test_what_to_install_is_said_for_a_wheel_and_for_a_checkout() -> None:
    with pytest.raises(TrainingError) as caught, needs_the_extra("train"):
        importlib.import_module("glbench_is_not_this")
    for words in ("glbench_is_not_this", '`pip install "glbench[train]"`', "`uv sync --inexact --extra train`"):
        assert words in str(caught.value)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--engine", "ray"), "add --seeds"),
        (("--workers", "2"), "add --seeds"),
        (("--seeds", "0-1", "--wandb"), "--wandb logs one training"),
        (("--seeds", "0-1", "--seed", "7"), "--seed is for one training"),
        (("--seeds", "2-1"), "'2-1' names no seeds"),
        (("--seeds", "0-1", "--address", "auto"), "add --engine ray"),
    ],
)
def test_options_that_do_not_fit_several_seeds_are_refused(glbench: Command, settings: Path, options: tuple[str, ...], said: str) -> None:
    answer = glbench("train", "ppo", "--task", "day.toml", "--config", "tiny.yml", *options)
    assert answer.code == 1
    assert said in answer.err


def test_a_sweep_of_weights_and_biases_is_on_this_machine(glbench: Command, settings: Path) -> None:
    for more in (("--engine", "ray"), ("--workers", "4")):
        answer = glbench("sweep", "--config", "sweep.yml", "--wandb", *more)
        assert answer.code == 1
        assert "leave out --engine and --workers" in " ".join(answer.err.split())


@pytest.mark.slow
@pytest.mark.train
def test_several_seeds_are_trained_and_not_again(glbench: Command, settings: Path) -> None:
    command = ("train", "ppo", "--task", "day.toml", "--config", "tiny.yml", "--seeds", "0,3", "--workers", "1")
    first, again = glbench(*command), glbench(*command)
    assert {first.code, again.code} <= {0, 3}
    for seed in (0, 3):
        folder = Path("runs") / f"ppo-Day-v1-seed{seed}"
        assert tomllib.loads((folder / "card.toml").read_text(encoding="utf-8"))["training"]["seed"] == seed
        assert f"seed {seed}: done" in first.err
        assert f"seed {seed}: already trained" in again.err
    assert "glbench evaluate runs/ppo-Day-v1-seed* --task day.toml" in first.out
