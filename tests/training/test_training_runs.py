"""Trainings begin, go on, end, and say how they were made."""

from __future__ import annotations

import contextlib
import json
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
from stable_baselines3.common.base_class import BaseAlgorithm

from glbench.agents import load_agent
from glbench.agents.network_policy import read_policy
from glbench.errors import TrainingError
from glbench.evaluation import evaluate
from glbench.tasks import TaskSpec, get_task, task_card
from glbench.training import CurvePoint, Progress, TrainingSettings, train
from glbench.training.algorithms import algorithm_class, rollout_steps
from glbench.training.folder import find_checkpoint, replaced
from glbench.training.periodic_evaluation import Probe, ProbeResult
from tests.episodes.day import write_lettuce_task
from tests.training.watching import PowerCutError

pytestmark = pytest.mark.train


MADE_SEASONS = """
base = "glbench/SpringYears-v1"
id = "my/Made-v1"
title = "Generated seasons that differ in nothing else"
without = ["scenario.parameters"]
scenario.start_within_days = 0
"""


class Listening:
    """Keeps what it is told, and pulls the plug after some checkpoints."""

    def __init__(self, checkpoints: int | None = None) -> None:
        self.points: list[CurvePoint] = []
        self.last: Progress | None = None
        self._left = checkpoints

    def on_progress(self, progress: Progress) -> None:
        self.last = progress

    def on_evaluation(self, point: CurvePoint) -> None:
        self.points.append(point)

    def on_saved(self, steps: int) -> None:
        if self._left is not None:
            self._left -= 1
            if self._left == 0:
                raise PowerCutError


def weights_of(folder: Path, algorithm: str) -> dict[str, np.ndarray]:
    model: BaseAlgorithm = algorithm_class(algorithm).load(folder / "checkpoint" / "model.zip", device="cpu")
    return {name: value.numpy() for name, value in model.policy.state_dict().items()}


def assert_same_bits(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> None:
    assert one.keys() == other.keys()
    for name, value in one.items():
        np.testing.assert_array_equal(value, other[name], err_msg=name)


def test_the_same_seed_gives_the_same_weights_and_another_seed_others(day: TaskSpec, tiny: TrainingSettings, tmp_path: Path) -> None:
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        train(day, tiny, tmp_path / name, seed=seed, tensorboard=False)
    a, b, c = (weights_of(tmp_path / name, tiny.algorithm) for name in "abc")
    assert_same_bits(a, b)
    assert any((a[name] != c[name]).any() for name in a)
    assert (tmp_path / "a" / "policy.npz").read_bytes() == (tmp_path / "b" / "policy.npz").read_bytes()


def test_a_training_that_was_killed_goes_on_to_the_same_weights(day: TaskSpec, tiny: TrainingSettings, tmp_path: Path) -> None:
    train(day, tiny, tmp_path / "whole", tensorboard=False)
    with pytest.raises(PowerCutError):
        train(day, tiny, tmp_path / "cut", tensorboard=False, save_seconds=0.0, listeners=[Listening(checkpoints=4)])
    assert not (tmp_path / "cut" / "card.toml").exists()
    listening = Listening()
    trained = train(day, tiny, tmp_path / "cut", resume=True, tensorboard=False, listeners=[listening])
    assert listening.last is not None
    assert listening.last.steps == trained.steps
    assert_same_bits(weights_of(tmp_path / "whole", tiny.algorithm), weights_of(tmp_path / "cut", tiny.algorithm))
    curves = [np.genfromtxt(tmp_path / name / "learning_curve.csv", delimiter=",", names=True) for name in ("whole", "cut")]
    assert curves[0].dtype.names == curves[1].dtype.names
    for column in set(curves[0].dtype.names) - {"seconds"}:
        np.testing.assert_array_equal(curves[0][column], curves[1][column])


@pytest.mark.parametrize("algorithm", ["ppo"], indirect=True)
def test_the_card_says_where_the_versions_changed(
    day: TaskSpec, tiny: TrainingSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for interrupted in (3, 2):
        with pytest.raises(PowerCutError):
            train(day, tiny, tmp_path / "run", resume=True, tensorboard=False, save_seconds=0.0, listeners=[Listening(interrupted)])
    monkeypatch.setattr("glbench.training.card.__version__", "9.9.9")
    train(day, tiny, tmp_path / "run", resume=True, tensorboard=False)
    card = tomllib.loads((tmp_path / "run" / "card.toml").read_text(encoding="utf-8"))
    first, second = card["training"]["sessions"]
    assert first.startswith("from step 0: glbench ")
    assert second.startswith("from step 288: glbench 9.9.9, ")
    assert card["versions"]["glbench"] == "9.9.9"


def test_a_task_with_fewer_controls_can_be_trained(day_file: Path, tiny: TrainingSettings, tmp_path: Path) -> None:
    six = 'controls = ["uBoil", "uCo2", "uThScr", "uVent", "uLamp", "uBlScr"]'
    text = day_file.read_text(encoding="utf-8")
    assert six in text
    (tmp_path / "two.toml").write_text(text.replace(six, 'controls = ["uBoil", "uVent"]'), encoding="utf-8")
    train(get_task(str(tmp_path / "two.toml")), tiny, tmp_path / "run", tensorboard=False)
    assert read_policy(tmp_path / "run" / "policy.npz").action_names == ("uBoil", "uVent")


@pytest.mark.parametrize("algorithm", ["ppo"], indirect=True)
def test_the_card_tells_how_the_agent_was_made_and_where_the_time_went(day: TaskSpec, tiny: TrainingSettings, tmp_path: Path) -> None:
    listening = Listening()
    trained = train(day, tiny, tmp_path / "run", seed=3, tensorboard=False, listeners=[listening])
    card = tomllib.loads((tmp_path / "run" / "card.toml").read_text(encoding="utf-8"))
    assert card["task"] == {"id": day.id, "digest": day.digest, "model": "greenlight-tomato-1.0.0"}
    assert (card["training"]["seed"], card["training"]["steps"]) == (3, trained.steps)
    assert card["best"]["reward"] == max(point.result.reward for point in listening.points)
    assert not set(card["best"]["evaluation_seeds"]) & set(range(666, 696))
    assert sum(card["share_of_training_time"].values()) == pytest.approx(1.0, abs=1e-3)
    parts = {name: seconds for name, seconds in card["wall_seconds"].items() if name != "total"}
    assert sum(parts.values()) == pytest.approx(card["wall_seconds"]["total"], abs=0.5)
    assert {"torch", "stable-baselines3", "glbench"} <= card["versions"].keys()


@pytest.mark.parametrize("algorithm", ["ppo"], indirect=True)
def test_what_is_finished_is_not_done_again_and_what_was_begun_is_not_overwritten(
    day: TaskSpec, tiny: TrainingSettings, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    first = train(day, tiny, folder, tensorboard=False)
    again = train(day, tiny, folder, tensorboard=False)
    assert again.already_done
    assert (again.steps, again.best_reward) == (first.steps, first.best_reward)
    with pytest.raises(TrainingError, match="--resume"):
        train(day, tiny, folder, seed=1, tensorboard=False)
    with pytest.raises(TrainingError, match=r"another training.*seed"):
        train(day, tiny, folder, seed=1, resume=True, tensorboard=False)
    longer = train(day, tiny.model_copy(update={"n_timesteps": 900}), folder, resume=True, tensorboard=False)
    assert longer.steps >= 900
    assert not longer.already_done
    card = tomllib.loads((folder / "card.toml").read_text(encoding="utf-8"))
    assert card["training"]["ended_before_at"] == [first.steps]


def test_a_lengthened_training_ends_as_one_that_was_that_long_at_once(day: TaskSpec, tiny: TrainingSettings, tmp_path: Path) -> None:
    steps = (300, 600, 1200)  # ends between two evaluations, and where one is due
    for end in steps:
        train(day, tiny.model_copy(update={"n_timesteps": end}), tmp_path / "longer", resume=True, tensorboard=False)
    trained = train(day, tiny.model_copy(update={"n_timesteps": steps[-1]}), tmp_path / "once", tensorboard=False)
    assert_same_bits(weights_of(tmp_path / "longer", tiny.algorithm), weights_of(tmp_path / "once", tiny.algorithm))
    points = {}
    for name in ("longer", "once"):
        lines = (tmp_path / name / "learning_curve.csv").read_text(encoding="utf-8").splitlines()[1:]
        rows = [line.split(",") for line in lines]
        points[name] = {int(row[0]): row[3:] for row in rows}  # but for the seconds and what was best so far
        assert len(points[name]) == len(rows)
    assert points["once"].items() <= points["longer"].items()
    card = tomllib.loads((tmp_path / "longer" / "card.toml").read_text(encoding="utf-8"))
    ends = card["training"]["ended_before_at"]
    assert len(ends) == len(steps) - 1
    assert set(points["longer"]) == set(points["once"]) | set(ends)
    assert trained.steps == card["training"]["steps"]


@pytest.mark.parametrize("algorithm", ["ppo"], indirect=True)
def test_a_training_that_goes_on_is_no_finished_one_until_its_new_end(day: TaskSpec, tiny: TrainingSettings, tmp_path: Path) -> None:
    folder, longer = tmp_path / "run", tiny.model_copy(update={"n_timesteps": 1200})
    train(day, tiny, folder, tensorboard=False)
    with pytest.raises(PowerCutError):
        train(day, longer, folder, resume=True, tensorboard=False, save_seconds=0.0, listeners=[Listening(2)])
    assert not (folder / "card.toml").exists()
    assert not train(day, longer, folder, resume=True, tensorboard=False).already_done
    assert (folder / "card.toml").exists()


@pytest.mark.parametrize("algorithm", ["ppo"], indirect=True)
def test_a_best_model_from_beyond_the_end_is_not_taken_for_an_earlier_one(day: TaskSpec, tiny: TrainingSettings, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    tiny = tiny.model_copy(update={"evaluation": tiny.evaluation.model_copy(update={"every": 96})})
    with pytest.raises(PowerCutError):
        train(day, tiny, folder, tensorboard=False, save_seconds=0.0, listeners=[Listening(3)])
    later: BaseAlgorithm = algorithm_class("ppo").load(folder / "best" / "model.zip", device="cpu")
    later.num_timesteps += 96
    later.save(folder / "best" / "model.zip")
    shorter = tiny.model_copy(update={"n_timesteps": 10})
    with pytest.raises(TrainingError, match="Go on with --resume, and as many steps as before"):
        train(day, shorter, folder, resume=True, tensorboard=False)


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["ppo"], indirect=True)
def test_a_policy_with_a_memory_goes_on_with_what_it_remembers(day: TaskSpec, tiny: TrainingSettings, tmp_path: Path) -> None:
    recurrent = tiny.model_copy(
        update={"algorithm": "sb3_contrib.RecurrentPPO", "policy": "MlpLstmPolicy", "policy_kwargs": {"lstm_hidden_size": 8}}
    )
    train(day, recurrent, tmp_path / "whole", tensorboard=False)
    with pytest.raises(PowerCutError):
        train(day, recurrent, tmp_path / "cut", tensorboard=False, save_seconds=0.0, listeners=[Listening(4)])
    train(day, recurrent, tmp_path / "cut", resume=True, tensorboard=False)
    assert_same_bits(*(weights_of(tmp_path / name, recurrent.algorithm) for name in ("whole", "cut")))


class Failing(Listening):
    """Fails as an algorithm does whose weights have run away."""

    def on_progress(self, progress: Progress) -> None:
        raise ValueError("expected finite values")


@pytest.mark.parametrize("algorithm", ["ppo"], indirect=True)
def test_an_algorithm_that_fails_is_explained(day: TaskSpec, tiny: TrainingSettings, tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match=r"PPO failed at step .*expected finite values"):
        train(day, tiny, tmp_path / "run", tensorboard=False, listeners=[Failing()])


@pytest.mark.parametrize("algorithm", ["ppo"], indirect=True)
def test_a_checkpoint_with_other_numbers_is_refused(day: TaskSpec, tiny: TrainingSettings, tmp_path: Path) -> None:
    with pytest.raises(PowerCutError):
        train(day, tiny, tmp_path / "run", tensorboard=False, save_seconds=0.0, listeners=[Listening(2)])
    for name in ("state.json", "state.npz", "model.zip"):
        folder = tmp_path / name
        shutil.copytree(tmp_path / "run", folder)
        file = folder / "checkpoint" / name
        if name == "state.json":
            state = json.loads(file.read_text(encoding="utf-8"))
            state["history"]["best_reward"] += 1.0
            file.write_text(json.dumps(state), encoding="utf-8")
        elif name == "state.npz":
            with np.load(file) as content:
                arrays = dict(content)
            arrays["env_sums"] = arrays["env_sums"] + 1.0
            np.savez(file, **arrays)
        else:
            model: BaseAlgorithm = algorithm_class("ppo").load(file, device="cpu")
            model.policy.log_std.data += 0.1
            model.save(file)
        with pytest.raises(TrainingError, match=r"checkpoint is damaged or was changed.*remove it to start over"):
            train(day, tiny, folder, resume=True, tensorboard=False)


@pytest.mark.parametrize("algorithm", ["ppo"], indirect=True)
def test_a_training_cut_short_is_evaluated_where_it_stopped(day: TaskSpec, tiny: TrainingSettings, tmp_path: Path) -> None:
    with pytest.raises(PowerCutError):
        train(day, tiny, tmp_path / "run", tensorboard=False, save_seconds=0.0, listeners=[Listening(3)])
    listening = Listening()
    shorter = tiny.model_copy(update={"n_timesteps": 10})
    trained = train(day, shorter, tmp_path / "run", resume=True, tensorboard=False, listeners=[listening])
    assert [point.steps for point in listening.points] == [trained.steps] == [192]
    assert trained.last_reward == listening.points[-1].result.reward


@pytest.mark.parametrize(("algorithm", "rollout"), [("ppo", 96), ("sac", 20)], indirect=["algorithm"])
def test_progress_is_told_against_the_steps_that_will_be_made(day: TaskSpec, tiny: TrainingSettings, rollout: int, tmp_path: Path) -> None:
    listening = Listening()
    trained = train(day, tiny.model_copy(update={"n_timesteps": 190}), tmp_path / "run", tensorboard=False, listeners=[listening])
    assert rollout_steps(tiny, day.steps) == rollout
    assert listening.last is not None
    assert listening.last.total_steps == trained.steps == -(-190 // rollout) * rollout


@pytest.mark.parametrize("algorithm", ["ppo"], indirect=True)
def test_a_training_that_never_beats_its_beginning_says_so(
    day: TaskSpec, tiny: TrainingSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rewards = iter([5.0, 3.0, 4.0, 5.0, 2.0])
    monkeypatch.setattr(Probe, "run", lambda *_: ProbeResult({"reward": next(rewards)}))
    trained = train(day, tiny, tmp_path / "run", tensorboard=False)
    assert not trained.learnt
    assert (trained.best_reward, trained.best_steps) == (5.0, 0)
    card = tomllib.loads((tmp_path / "run" / "card.toml").read_text(encoding="utf-8"))
    assert (card["best"]["learnt"], card["best"]["last_reward"]) == (False, trained.last_reward)
    assert "Nothing was learnt" in card["description"]
    assert not train(day, tiny, tmp_path / "run", tensorboard=False).learnt


@pytest.mark.parametrize("algorithm", ["ppo"], indirect=True)
def test_a_damaged_checkpoint_is_explained(day: TaskSpec, tiny: TrainingSettings, tmp_path: Path) -> None:
    with pytest.raises(PowerCutError):
        train(day, tiny, tmp_path / "run", tensorboard=False, save_seconds=0.0, listeners=[Listening(2)])
    for name in ("model.zip", "state.npz", "vecnormalize.pkl"):
        folder = tmp_path / name
        shutil.copytree(tmp_path / "run", folder)
        file = folder / "checkpoint" / name
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
        with pytest.raises(TrainingError, match=r"checkpoint is damaged or was changed.*remove it to start over"):
            train(day, tiny, folder, resume=True, tensorboard=False)


def test_a_kill_between_the_two_renames_of_a_checkpoint_leaves_one(tmp_path: Path) -> None:
    folder = tmp_path / "checkpoint"
    assert find_checkpoint(folder) is None
    folder.mkdir()
    (folder / "state.json").write_text("{}", encoding="utf-8")
    assert find_checkpoint(folder) == folder
    shutil.move(folder, tmp_path / "checkpoint.old")
    assert find_checkpoint(folder) == tmp_path / "checkpoint.old"
    shutil.copytree(tmp_path / "checkpoint.old", tmp_path / "checkpoint.new")
    assert find_checkpoint(folder) == tmp_path / "checkpoint.new", "complete, and newer"
    with contextlib.suppress(PowerCutError), replaced(folder) as new:
        (new / "half").touch()
        raise PowerCutError
    assert find_checkpoint(folder) == tmp_path / "checkpoint.old"


def test_another_crop_with_another_ledger_is_learnt_and_evaluated(tiny: TrainingSettings, tmp_path: Path) -> None:
    task = get_task(write_lettuce_task(tmp_path, days=2))
    folder = tmp_path / "run"
    trained = train(task, tiny, folder, tensorboard=False)
    assert trained.not_exported is None
    card = tomllib.loads((folder / "card.toml").read_text(encoding="utf-8"))
    assert card["task"]["model"] == card["versions"]["model"] == "greenlight-lettuce-1.0.0"
    assert len(card["best"]["evaluation_seeds"]) == 2
    curve = (folder / "learning_curve.csv").read_text(encoding="utf-8").splitlines()[0]
    assert curve.endswith("reward,epi,penalty,revenue,cost_co2,cost_electricity,cost_heat")
    policy = read_policy(folder / "policy.npz")
    assert {"head_fresh_mass", "leaf_area_index"} < set(policy.observation_names)
    result = evaluate(task, folder, out=tmp_path)
    assert [run.status for run in result.runs] == ["ok"] * 3


def test_seeds_differ_wherever_runs_do(tiny: TrainingSettings, day: TaskSpec, tmp_path: Path) -> None:
    drawn_parameters = (("half_width = 0.10", "half_width = 0.0"), ("half_width = 0.20", "half_width = 0.0"))
    seasons = get_task(write_lettuce_task(tmp_path, days=2, more=drawn_parameters))
    assert len(tiny.evaluation.seeds(seasons)) == len(tiny.evaluation.seeds(day)) == 2
    alike = day.replace(uncertainty={"delta": 0.0})
    assert len(tiny.evaluation.seeds(alike)) == 1
    noisy = {"sensors": {"co2": {"noise": {"value": 30.0, "unit": "ppm"}}}}
    assert len(tiny.evaluation.seeds(get_task("LettuceClassic-Delta00-v1"))) == 1
    assert len(tiny.evaluation.seeds(get_task("LettuceClassic-Delta00-v1").replace({"id": "my/Noisy-v1", **noisy}))) == 2
    (tmp_path / "made.toml").write_text(MADE_SEASONS, encoding="utf-8")
    assert len(tiny.evaluation.seeds(get_task(tmp_path / "made.toml"))) == 2


@pytest.mark.parametrize("algorithm", ["ppo"], indirect=True)
def test_a_task_with_splits_is_learnt_in_training_chosen_in_validation_and_scored_in_its_test(
    tiny: TrainingSettings, tmp_path: Path
) -> None:
    task = get_task("Spring-v1").replace(
        id="test/SpringDay-v1",
        weather={"days": 1, "step_seconds": 3600},
        splits={"training": {"seasons": 4}, "validation": {"seasons": 2}, "test": {"seasons": 3}},
        evaluation={"runs": 3},
    )
    settings = tiny.model_copy(update={"n_timesteps": 2000})
    folder = tmp_path / "run"
    train(task, settings, folder, tensorboard=False)
    card = tomllib.loads((folder / "card.toml").read_text(encoding="utf-8"))
    assert card["task"]["id"] == task.id
    told = {name: card["training"][name] for name in ("split", "years", "chosen_on")}
    assert told == {"split": "training", "years": [2008, 2009, 2010], "chosen_on": "validation"}

    earned = {}
    for split in ("training", "validation"):
        agent = load_agent(folder).make(task_card(task))
        agent.reset(task_card(task), 2)  # type: ignore[union-attr]
        probe = Probe(task.in_split(split), settings.evaluation, settings.kernel_preset)
        earned[split] = probe.of(agent.act).reward  # type: ignore[union-attr]
    assert earned["validation"] == pytest.approx(card["best"]["reward"], rel=1e-4)
    assert earned["training"] != pytest.approx(card["best"]["reward"], rel=1e-4)

    result = evaluate(task, folder, out=tmp_path)
    assert [run.status for run in result.runs] == ["ok"] * 3
    assert (result.task.split, result.task.years) == ("test", (2011, 2012))
