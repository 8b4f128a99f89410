"""Searching the last layer of a policy: what it finds, that it can be repeated and continued, and what it refuses."""

from __future__ import annotations

import csv
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glbench.agents import load_agent
from glbench.agents.network_policy import Actor, ActorAgent, read_actor, read_policy
from glbench.env import Simulation
from glbench.env.kernels import shared_kernel
from glbench.errors import TrainingError
from glbench.kernel import StepFailure
from glbench.tasks import TaskSpec, task_card
from glbench.training import read_settings, train
from glbench.training.compiled_settings import CompiledSettings
from glbench.training.folder import Trained
from glbench.training.periodic_evaluation import Listener, Progress, season_sums
from glbench.training.season_search import BatchedPolicy, SearchSettings, read_season_search, search, train_then_search
from tests.agents.test_actor import policy as actor_of
from tests.training.conftest import PPO, SAC
from tests.training.watching import PowerCutError, Watching

pytestmark = pytest.mark.train

SEARCH = """
default:
  start_from: {start}
  directions: 3
  population: 8
  generations: 6
  first_seed: 30_000_000_000
  evaluation: {{every: 400, runs: 2, first_seed: 20_000_000_000}}
"""


@pytest.fixture(scope="module", params=["ppo", "sac"])
def start(request: pytest.FixtureRequest, day: TaskSpec, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Policy of a short training."""
    folder = tmp_path_factory.mktemp(request.param)
    (folder / "tiny.yml").write_text(PPO if request.param == "ppo" else SAC, encoding="utf-8")
    train(day, read_settings(folder / "tiny.yml", request.param, day.id), folder / "run", tensorboard=False)
    return folder / "run" / "policy.npz"


def settings_for(start: Path, folder: Path, more: str = "") -> SearchSettings:
    file = folder / "search.yml"
    names = {line.partition(":")[0] for line in more.splitlines()}
    others = [line for line in SEARCH.splitlines(keepends=True) if line.partition(":")[0] not in names]
    file.write_text("".join(others).format(start=start) + more, encoding="utf-8")
    return read_season_search(file, "test/Day-v1")


def test_it_finds_better_policies_that_differ_in_the_last_layer_only(day: TaskSpec, start: Path, tmp_path: Path) -> None:
    watching = Watching()
    found = search(day, settings_for(start, tmp_path), tmp_path / "run", listeners=[watching])

    assert found.best_reward == max(point.result.reward for point in watching.points) > watching.points[0].result.reward
    assert found.steps == 6 * 8 * 24 == watching.told[-1].steps == watching.told[-1].total_steps
    before, after = read_policy(start), read_policy(tmp_path / "run" / "policy.npz")
    for old, new in zip(before.weights[:-1], after.weights[:-1], strict=True):
        np.testing.assert_array_equal(old, new)
    assert (before.weights[-1] != after.weights[-1]).any()
    assert (after.task_id, after.delta) == (day.id, day.uncertainty.delta)
    assert load_agent(tmp_path / "run").privileged is False


def test_its_card_and_curve_say_what_was_spent(day: TaskSpec, start: Path, tmp_path: Path) -> None:
    search(day, settings_for(start, tmp_path), tmp_path / "run", seed=3)

    card = tomllib.loads((tmp_path / "run" / "card.toml").read_text(encoding="utf-8"))
    assert (card["task"]["id"], card["training"]["steps"], card["training"]["generations"]) == (day.id, 6 * 8 * 24, 6)
    assert card["training"]["seed"] == 3
    again = read_season_search(tmp_path / "run" / "settings.yml", day.id)
    assert again.digest == card["training"]["settings_digest"]
    assert card["start"]["steps"] >= 600
    assert sum(card["share_of_training_time"].values()) == pytest.approx(1.0, abs=0.001)  # of seconds that round to 0
    with (tmp_path / "run" / "learning_curve.csv").open(encoding="utf-8") as curve:
        rows = list(csv.DictReader(curve))
    assert [int(row["steps"]) for row in rows] == [0, 576, 1152]
    assert max(float(row["reward"]) for row in rows) == pytest.approx(card["best"]["reward"], rel=1e-9)


def test_the_same_seed_finds_the_same_and_another_seed_another(day: TaskSpec, start: Path, tmp_path: Path) -> None:
    settings = settings_for(start, tmp_path)
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        search(day, settings, tmp_path / name, seed=seed)
    a, b, c = ((tmp_path / name / "policy.npz").read_bytes() for name in "abc")
    assert a == b != c


def test_a_search_that_was_killed_goes_on_to_the_same_policy(day: TaskSpec, start: Path, tmp_path: Path) -> None:
    settings = settings_for(start, tmp_path)
    search(day, settings, tmp_path / "whole")
    with pytest.raises(PowerCutError):
        search(day, settings, tmp_path / "cut", listeners=[Watching(generations=4)])
    with pytest.raises(TrainingError, match="an unfinished training"):
        search(day, settings, tmp_path / "cut")
    watching = Watching()
    search(day, settings, tmp_path / "cut", resume=True, listeners=[watching])

    assert len(watching.told) < 6  # what was kept is not done again
    assert (tmp_path / "cut" / "policy.npz").read_bytes() == (tmp_path / "whole" / "policy.npz").read_bytes()
    assert search(day, settings, tmp_path / "cut", resume=True).already_done


def test_another_search_is_not_continued(day: TaskSpec, start: Path, tmp_path: Path) -> None:
    with pytest.raises(PowerCutError):
        search(day, settings_for(start, tmp_path), tmp_path / "run", listeners=[Watching(generations=4)])
    with pytest.raises(TrainingError, match="holds another search"):
        search(day, settings_for(start, tmp_path, "  sigma: 0.2\n"), tmp_path / "run", resume=True)


def test_a_search_whose_rewards_were_changed_is_not_continued(day: TaskSpec, start: Path, tmp_path: Path) -> None:
    settings, file = settings_for(start, tmp_path), tmp_path / "run" / "search.npz"
    with pytest.raises(PowerCutError):
        search(day, settings, tmp_path / "run", listeners=[Watching(generations=4)])
    with np.load(file) as content:
        kept = dict(content)
    np.savez(file, **{**kept, "rewards": kept["rewards"] + 1.0})
    with pytest.raises(TrainingError, match=r"search\.npz is damaged or was changed"):
        search(day, settings, tmp_path / "run", resume=True)


def test_an_action_may_begin_anew(day: TaskSpec, start: Path, tmp_path: Path) -> None:
    more = "  begin_anew: {uCo2: 0.25}\n  sigma: 1.0e-9\n"
    search(day, settings_for(start, tmp_path, more), tmp_path / "run")
    policy = read_policy(tmp_path / "run" / "policy.npz")
    np.testing.assert_allclose(policy.weights[-1][:, 1], 0.0, atol=1e-6)
    begun = policy.biases[-1][1]
    assert (np.tanh(begun) if policy.output == "tanh" else begun) == pytest.approx(0.25, abs=1e-6)
    if policy.output == "tanh":
        with pytest.raises(TrainingError, match="lies between -1 and 1"):
            search(day, settings_for(start, tmp_path, "  begin_anew: {uCo2: 1.0}\n"), tmp_path / "other")
    with pytest.raises(TrainingError, match=r"'begin_anew' names 'uCO2', .* Did you mean 'uCo2'"):
        search(day, settings_for(start, tmp_path, "  begin_anew: {uCO2: 0.0}\n"), tmp_path / "other")


def test_some_actions_may_be_varied_alone(day: TaskSpec, start: Path, tmp_path: Path) -> None:
    search(day, settings_for(start, tmp_path, "  actions: [uCo2]\n"), tmp_path / "run")
    before, after = read_policy(start), read_policy(tmp_path / "run" / "policy.npz")
    varied = [name for column, name in enumerate(before.action_names) if (before.weights[-1] != after.weights[-1])[:, column].any()]
    assert varied == ["uCo2"]
    assert [name for name, is_new in zip(before.action_names, before.biases[-1] != after.biases[-1], strict=True) if is_new] == varied
    with pytest.raises(TrainingError, match=r"'actions' names 'uCO2', .* Did you mean 'uCo2'"):
        search(day, settings_for(start, tmp_path, "  actions: [uCO2]\n"), tmp_path / "other")


def test_settings_that_came_later_leave_earlier_digests(start: Path, tmp_path: Path) -> None:
    usual = settings_for(start, tmp_path)
    assert settings_for(start, tmp_path, "  actions: []\n  seasons: 1\n").digest == usual.digest
    assert (
        settings_for(start, tmp_path, "  actions: [uCo2]\n").digest
        != usual.digest
        != settings_for(start, tmp_path, "  seasons: 2\n").digest
    )


def test_impossible_settings_are_named(tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match=r"'population': .*; there is no setting 'generation'. Did you mean 'generations'"):
        settings_for(tmp_path / "policy.npz", tmp_path, "  population: 1\n  generation: 5\n")


def test_many_policies_at_once_act_as_each_alone(day: TaskSpec, start: Path) -> None:
    policy = read_policy(start)
    batched = BatchedPolicy(Actor.of(policy), day)
    rng = np.random.default_rng(0)
    layers = [(policy.weights[-1] * np.float32(factor), policy.biases[-1]) for factor in (1.0, -0.5, 2.0)]
    batched.take(layers)
    low, high = np.array([(column.low, column.high) for column in day.observed()]).T
    seen = rng.uniform(low, high, (3, len(low))).astype(np.float32)

    actions = batched.act(seen)

    for row, (weights, biases) in enumerate(layers):
        alone = replace(policy, weights=(*policy.weights[:-1], weights), biases=(*policy.biases[:-1], biases))
        np.testing.assert_allclose(actions[row], alone.act(seen[row : row + 1])[0], atol=2e-6)


def test_many_policies_with_a_memory_act_as_each_alone_and_keep_what_is_around_their_network(day: TaskSpec, tmp_path: Path) -> None:
    actor, rng = actor_of(day, units=4), np.random.default_rng(0)
    network = actor.network
    layers = [(network.weights[-1] * np.float32(factor), network.biases[-1]) for factor in (1.0, -0.5)]
    others = [replace(network, weights=(*network.weights[:-1], weights), biases=(*network.biases[:-1], bias)) for weights, bias in layers]
    alone = [ActorAgent(replace(actor, network=other)) for other in others]
    batched = BatchedPolicy(actor, day)
    for _ in range(2):  # a season after another
        batched.take(layers)
        for agent in alone:
            agent.reset(task_card(day), 1)
        for _ in range(5):
            seen = rng.normal(20.0, 5.0, (2, len(actor.columns))).astype(np.float32)
            expected = [agent.act(seen[row : row + 1])[0] for row, agent in enumerate(alone)]
            np.testing.assert_allclose(batched.act(seen), expected, atol=1e-5)
    (tmp_path / "policy.npz").write_bytes(actor.to_bytes())
    search(day, settings_for(tmp_path / "policy.npz", tmp_path), tmp_path / "run")
    tuned = read_actor(tmp_path / "run" / "policy.npz")
    assert tuned.columns == actor.columns
    assert np.array_equal(tuned.shares, actor.shares)
    assert tuned.gru is not None
    assert np.array_equal(tuned.network.weights[0], network.weights[0])
    assert not np.array_equal(tuned.network.weights[-1], network.weights[-1])


def test_a_variation_may_play_several_seasons(day: TaskSpec, start: Path, tmp_path: Path) -> None:
    """Without any variation, the reward of a generation is the policy's mean over these seasons."""
    folder = tmp_path / "run"
    search(day, settings_for(start, tmp_path, "  sigma: 1.0e-12\n  seasons: 3\n  generations: 2\n"), folder)
    card = tomllib.loads((folder / "card.toml").read_text(encoding="utf-8"))
    assert card["training"]["steps"] == 2 * 8 * 3 * day.steps
    agent, first = ActorAgent(Actor.of(read_policy(start))), 30_000_000_000
    simulation = Simulation(day, 6, "fast")
    agent.reset(task_card(day), 6)
    rewards = season_sums(simulation, range(first, first + 6), agent.act)["reward"].reshape(2, 3).mean(axis=1)
    with np.load(folder / "search.npz") as content:
        assert content["rewards"] == pytest.approx(np.repeat(rewards[:, None], 8, axis=1), abs=1e-4)


class _Failing:
    """A kernel that cannot simulate the tenth step."""

    def __init__(self, task: TaskSpec) -> None:
        self._kernel, self._steps = shared_kernel(task.model_value, task.step_seconds, "fast"), 0

    def try_step(self, x: Any, *inputs: Any) -> Any:
        after, failures = self._kernel.try_step(x, *inputs)
        self._steps += 1
        return (x, [StepFailure(0, "made to fail")]) if self._steps == 10 else (after, failures)


def test_a_run_that_fails_is_charged_for_each_missing_step_once(day: TaskSpec) -> None:
    charge, still = day.evaluation.failed_step, np.zeros((1, len(day.actions)))
    sums = season_sums(Simulation(day, 1, _Failing(day)), [7], lambda _: still)  # type: ignore[arg-type]
    simulation = Simulation(day, 1)
    simulation.reset([7])
    steps = [simulation.step(still).quantities for _ in range(9)]
    for name in ("reward", "epi", "penalty"):
        expected = sum(float(step[name][0]) for step in steps) + (day.steps - 9) * getattr(charge, name)
        assert sums[name][0] == pytest.approx(expected, rel=1e-4)


def test_progress_of_several_stages_is_that_of_all_of_them(
    day: TaskSpec, start: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A first stage of 96 steps, and a search of 6 generations of 8 seasons."""
    own = settings_for(start, tmp_path)
    compiled = CompiledSettings.model_validate({"learner": "compiled", "n_timesteps": 96, "n_envs": 8, "n_steps": 12, "batch_size": 48})
    steps = (96, own.steps(day))

    def stage(_: object, settings: object, folder: Path, **options: Any) -> Trained:
        total = steps[settings is not compiled]
        for listener in options["listeners"]:
            listener.on_progress(Progress(total // 2, total, 1.0, None))
        return Trained(folder, total, 0.0, total, 0.0, already_done=False)

    monkeypatch.setattr("glbench.training.season_search.search", stage)
    shares = []

    class Noting(Listener):
        def on_progress(self, progress: Progress) -> None:
            shares.append((progress.steps, progress.total_steps))

    trained = train_then_search(day, compiled, tmp_path / "agent", train=stage, searches=[own], listeners=[Noting()])
    assert shares == [(48, sum(steps)), (96 + steps[1] // 2, sum(steps))]
    assert trained.folder == tmp_path / "agent"
