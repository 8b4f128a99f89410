"""The compiled PPO: it learns, can be repeated and continued to the bit, leaves an agent, and says what it refuses."""

from __future__ import annotations

import csv
import signal
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from glbench.agents import load_agent
from glbench.agents.network_policy import FAST, ActorAgent, Gru, read_actor
from glbench.env import GreenhouseVectorEnv
from glbench.errors import TrainingError
from glbench.kernel import why_not_compiled
from glbench.tasks import TaskSpec, get_task, task_card
from glbench.training import Trained
from tests.training.watching import PowerCutError, Watching

jax = pytest.importorskip("jax", reason="JAX is not installed (extra 'jax')")
pytestmark = [pytest.mark.slow, pytest.mark.train, pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))]

from glbench.training.compiled import _Training, train_compiled  # noqa: E402
from glbench.training.compiled_settings import CompiledSettings, read_compiled_settings  # noqa: E402
from glbench.training.learner import Greenhouses, Learner, Statistics, _apply, steps_of_controls  # noqa: E402

TINY = """
default:
  learner: compiled
  n_timesteps: 9_000
  n_envs: 16
  n_steps: 12
  batch_size: 48
  net_arch: [16]
  scenarios: 4
  places: 6
  evaluation: {every: 3_000, runs: 2, first_seed: 20_000_000_000}
test/Day-v1:
  accrual: {state: cBuf, price: 5.5e-4}
"""
MEMORY = "  memory: {hours: [1, 4]}\n  critic_sees: [tAir, epi]\n"
GRU = "  memory: {hours: [1, 4], gru: 8}\n  critic_sees: [tAir, epi]\n"


def tiny(day: TaskSpec, folder: Path, more: str = "") -> CompiledSettings:
    file = folder / "tiny.yml"
    names = {line.partition(":")[0] for line in more.splitlines()}
    others = [line for line in TINY.splitlines(keepends=True) if line.partition(":")[0] not in names]
    file.write_text("".join(others) + more, encoding="utf-8")
    return read_compiled_settings(file, day)


@pytest.fixture(scope="module")
def trained(day: TaskSpec, tmp_path_factory: pytest.TempPathFactory) -> Trained:
    folder = tmp_path_factory.mktemp("compiled")
    return train_compiled(day, tiny(day, folder), folder / "run", seed=3)


def test_it_learns_and_leaves_an_agent(trained: Trained, day: TaskSpec) -> None:
    with (trained.folder / "learning_curve.csv").open(encoding="utf-8") as file:
        rewards = [float(point["reward"]) for point in csv.DictReader(file)]
    assert len(rewards) == 4
    assert trained.learnt
    assert max(rewards[1:]) > rewards[0] + 2.0
    assert trained.steps == 9_024
    card = tomllib.loads((trained.folder / "card.toml").read_text(encoding="utf-8"))
    assert card["training"]["algorithm"] == "compiled ppo"
    assert card["training"]["first_env_seed"] == 10_000_000_000
    assert card["best"]["evaluation_seeds"] == [20_000_000_000, 20_000_000_001]
    assert "growth of cBuf was paid for as well: carbohydrates (CH2O) in the buffer" in card["description"]
    assert "0.00055 of the reward for 1 mg m-2." in card["description"]
    assert load_agent(str(trained.folder)).name == "run"


def test_the_policy_earns_what_the_curve_says(trained: Trained, day: TaskSpec) -> None:
    agent = load_agent(str(trained.folder)).make(task_card(day))
    agent.reset(task_card(day), 2)
    native = GreenhouseVectorEnv(day, 2, kernel="fast")
    observations, _ = native.reset(seed=[20_000_000_000, 20_000_000_001])
    earned = np.zeros(2)
    for _ in range(day.steps):
        observations, rewards, *_ = native.step(agent.act(observations))
        earned += rewards
    assert earned.mean() == pytest.approx(trained.best_reward, rel=1e-5), "without what is paid for training alone"


def test_a_training_can_be_repeated_and_continued_to_the_bit(trained: Trained, day: TaskSpec, tmp_path: Path) -> None:
    settings = tiny(day, tmp_path)
    with pytest.raises(PowerCutError):
        train_compiled(day, settings, tmp_path / "run", seed=3, listeners=[Watching(31)])
    with pytest.raises(TrainingError, match=r"unfinished training\. Continue with --resume"):
        train_compiled(day, settings, tmp_path / "run", seed=3)
    again = train_compiled(day, settings, tmp_path / "run", seed=3, resume=True)
    assert (again.folder / "policy.npz").read_bytes() == (trained.folder / "policy.npz").read_bytes()
    assert again.best_reward == trained.best_reward
    done = train_compiled(day, settings, tmp_path / "run", seed=3)
    assert done.already_done
    (done.folder / "policy.npz").unlink()
    with pytest.raises(TrainingError, match=r"a finished training without its policy\.npz\. Remove the folder to train again"):
        train_compiled(day, settings, tmp_path / "run", seed=3)


def test_ctrl_c_waits_for_the_update_and_keeps_it(trained: Trained, day: TaskSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings, update = tiny(day, tmp_path), _Training.update
    finished = []

    def interrupted(training: _Training) -> float:
        if training.updates == 20:  # between two evaluations
            signal.raise_signal(signal.SIGINT)
        finished.append(update(training))
        return finished[-1]

    monkeypatch.setattr(_Training, "update", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train_compiled(day, settings, tmp_path / "run", seed=3)
    monkeypatch.undo()
    assert len(finished) == 21, "not cut off"
    counted = Watching()
    again = train_compiled(day, settings, tmp_path / "run", seed=3, resume=True, listeners=[counted])
    assert len(counted.told) == settings.updates - 21, "nothing is done twice"
    assert (again.folder / "policy.npz").read_bytes() == (trained.folder / "policy.npz").read_bytes()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_state_that_was_changed_or_is_of_another_training_is_refused(trained: Trained, day: TaskSpec, tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match=r"--resume|another training"):
        train_compiled(day, tiny(day, tmp_path), trained.folder, seed=4)
    state = trained.folder / "learner.npz"
    with np.load(state) as kept:
        arrays = dict(kept)
    arrays["leaf_0"] = arrays["leaf_0"] + 1.0
    (tmp_path / "run").mkdir()
    np.savez(tmp_path / "run" / "learner.npz", allow_pickle=False, **arrays)
    with pytest.raises(TrainingError, match="does not match its digest"):
        train_compiled(day, tiny(day, tmp_path), tmp_path / "run", seed=3, resume=True)
    (tmp_path / "run" / "learner.npz").write_bytes(b"nothing")
    with pytest.raises(TrainingError, match="cannot be read"):
        train_compiled(day, tiny(day, tmp_path), tmp_path / "run", seed=3, resume=True)


def test_growth_of_a_state_is_paid_for_in_training_alone(day: TaskSpec, tmp_path: Path) -> None:
    settings = tiny(day, tmp_path)
    dear = settings.model_copy(update={"accrual": settings.accrual.model_copy(update={"price": 1.0})})  # type: ignore[union-attr]
    found = []
    for one in (settings, dear):
        learner = Learner.of(day, one)
        learning = learner.begin(jax.random.key(0))
        after, reward = jax.jit(learner.update)(learning, jax.random.key(1), 0.0)
        found.append((float(after.returns.variance), float(reward)))
    assert found[0][1] == found[1][1], "the reward that is told is the task's"
    assert found[1][0] > 100.0 * found[0][0], "returns contain what is paid"


def test_a_policy_with_a_memory_acts_as_it_learnt_to(day: TaskSpec, tmp_path: Path) -> None:
    """What the learner keeps of traces and positions is what the agent of the file keeps."""
    trained = train_compiled(day, tiny(day, tmp_path, MEMORY), tmp_path / "run", seed=3)
    assert trained.learnt
    card = tomllib.loads((trained.folder / "card.toml").read_text(encoding="utf-8"))
    assert "running means of air_temperature, co2, relative_humidity over 1 h, 4 h" in card["description"]
    actor = read_actor(trained.folder / "policy.npz")
    assert len(actor.network.observation_names) == len(actor.columns) + 6
    assert (actor.max_change == day.actuation.max_change).all()

    learner = Learner.of(day, tiny(day, tmp_path, MEMORY + "  places: 1\n"))
    learning = learner.begin(jax.random.key(0))
    quiet = learning._replace(weights={**learning.weights, "spread": jax.numpy.full(6, -30.0)})
    now, rollout = jax.lax.scan(lambda now, key: learner._step(quiet, now, key), quiet.now, jax.random.split(jax.random.key(1), 8))
    columns = len(actor.columns)
    network = replace(
        actor.network,
        mean=np.zeros(columns + 6),
        scale=np.asarray(learner.scale(quiet.columns), np.float64),
        weights=tuple(np.asarray(weights) for weights, _ in quiet.weights["actor"]),
        biases=tuple(np.asarray(bias) for _, bias in quiet.weights["actor"]),
    )
    agent = ActorAgent(replace(actor, network=network))
    agent.reset(task_card(day), 16)
    for seen in np.asarray(rollout.observations):
        agent.act(seen[:, :columns])
    assert np.allclose(agent._positions, now.positions, atol=1e-5)
    assert np.allclose(agent._traces.reshape(16, -1), np.asarray(rollout.observations)[-1, :, columns:], rtol=1e-5)


def test_a_recurrent_unit_remembers_what_it_did_in_training(day: TaskSpec, tmp_path: Path) -> None:
    """In the rollout, when a batch is replayed, and in the agent of the file."""
    trained = train_compiled(day, tiny(day, tmp_path, GRU), tmp_path / "run", seed=3)
    assert trained.learnt
    actor = read_actor(trained.folder / "policy.npz")
    assert actor.gru is not None
    assert actor.to_bytes() == (trained.folder / "policy.npz").read_bytes()
    with pytest.raises(PowerCutError):
        train_compiled(day, tiny(day, tmp_path, GRU), tmp_path / "cut", seed=3, listeners=[Watching(31)])
    again = train_compiled(day, tiny(day, tmp_path, GRU), tmp_path / "cut", seed=3, resume=True)
    assert (again.folder / "policy.npz").read_bytes() == actor.to_bytes()
    assert "It remembers with a gated recurrent unit of 8 units." in (again.folder / "card.toml").read_text("utf-8")

    learner = Learner.of(day, tiny(day, tmp_path, GRU + "  places: 4\n"))
    begun = learner.begin(jax.random.key(0))
    weights = {**begun.weights, "spread": jax.numpy.full(6, -30.0)}
    quiet = begun._replace(weights=weights, columns=begun.columns._replace(mean=begun.now.observations.mean(0)))

    def step(now: Greenhouses, key: object) -> object:
        return learner._step(quiet, now, key)

    now, rollout = jax.lax.scan(step, quiet.now, jax.random.split(jax.random.key(1), 40))
    assert rollout.ended.any(), "seasons begin in between"
    told = rollout.actor_input, rollout.critic_input, rollout.samples, rollout.ended
    rows = jax.tree.map(lambda a: a.swapaxes(0, 1), told), quiet.now.memory
    actor_input, _, given = learner._replayed(weights, rows)
    assert np.allclose(_apply(weights["actor"], actor_input), given, atol=1e-5)

    columns, units = len(actor.columns), 8
    network = replace(
        actor.network,
        mean=np.append(quiet.columns.mean, np.zeros(units)),
        scale=np.append(learner.scale(quiet.columns), np.ones(units)),
        weights=tuple(np.asarray(weights) for weights, _ in weights["actor"]),
        biases=tuple(np.asarray(bias) for _, bias in weights["actor"]),
    )
    gru = Gru(*(np.asarray(weights["gru"][name]) for name in ("weights", "bias", "recurrent")))
    exact = replace(actor, network=network, gru=gru)
    whole = ~np.asarray(rollout.ended).any(0)
    for policy in (exact, exact.with_arithmetic(FAST)):
        agent = ActorAgent(policy)
        agent.reset(task_card(day), 16)
        for seen in np.asarray(rollout.observations):
            agent.act(seen[:, :columns])
        assert np.abs(agent._memory).max() > 0.1
        assert np.allclose(agent._memory[whole], now.memory[whole], atol=1e-4)
        assert np.allclose(agent._positions[whole], now.positions[whole], atol=1e-4)


def test_settings_without_a_recurrent_unit_keep_their_digest(day: TaskSpec, tmp_path: Path) -> None:
    assert "gru" not in tiny(day, tmp_path, MEMORY).model_dump(mode="json")["memory"]
    assert tiny(day, tmp_path, GRU).model_dump(mode="json")["memory"]["gru"] == 8
    assert tiny(day, tmp_path, GRU).digest != tiny(day, tmp_path, MEMORY).digest


@pytest.mark.parametrize("more", [MEMORY, GRU])
def test_a_policy_with_a_view_is_deaf_to_all_else(day: TaskSpec, tmp_path: Path, more: str) -> None:
    """Whatever hidden columns read, missing or not, its actions have the same bits; and the learner acts as the file does."""
    settings = tiny(day, tmp_path, more + "  view: [outdoor, air_temperature]\n")
    with pytest.raises(TrainingError, match=r"'memory\.columns': 'co2' is out of the view outdoor, air_temperature"):
        Learner.of(day, settings)
    settings = read_compiled_settings(tmp_path / "tiny.yml", day, view=["outdoor", "air_temperature"])
    assert settings.memory.columns == ("air_temperature",), "traces of visible columns only"
    trained = train_compiled(day, settings, tmp_path / "run", seed=3)
    card = tomllib.loads((trained.folder / "card.toml").read_text(encoding="utf-8"))
    assert card["training"]["view"] == ["outdoor", "air_temperature"]
    assert "It looks at 16 of 22 observed columns: outdoor, air_temperature." in card["description"]
    names = list(task_card(day).observation_names)
    hidden = np.array([name not in card["training"]["columns_in_view"] for name in names])
    assert {"co2", "relative_humidity", "pipe_temperature", "fruit_dry_mass"} <= {*np.array(names)[hidden]}

    policy = read_actor(trained.folder / "policy.npz")
    assert not policy.network.weights[0][: len(names)][hidden].any()
    agents = [ActorAgent(policy) for _ in range(3)]
    for agent in agents:
        agent.reset(task_card(day), 4)
    rng = np.random.default_rng(0)
    for _ in range(5):
        readings = rng.normal(policy.network.mean[: len(names)], 3.0, (4, len(names))).astype(np.float32)
        others, missing = readings.copy(), readings.copy()
        others[:, hidden], missing[:, hidden] = rng.normal(0.0, 1e4, others[:, hidden].shape), np.nan
        actions, *same = [agent.act(rows) for agent, rows in zip(agents, (readings, others, missing), strict=True)]
        assert all(one.tobytes() == actions.tobytes() for one in same)
        assert np.ptp(actions, axis=0).any(), "what it sees matters"

    learner = Learner.of(day, settings)
    begun = learner.begin(jax.random.key(0))
    quiet = begun._replace(weights={**begun.weights, "spread": jax.numpy.full(6, -30.0)})
    other = begun.now.observations.at[:, np.flatnonzero(hidden)].set(1e4)
    for one in (0, 2):  # inputs of the critic and of the actor
        first, second = (np.asarray(learner._value(quiet, now)[one]) for now in (quiet.now, quiet.now._replace(observations=other)))
        assert np.array_equal(first, second)


def test_the_policy_of_a_view_acts_as_its_learner(day: TaskSpec, tmp_path: Path) -> None:
    tiny(day, tmp_path)
    settings = read_compiled_settings(tmp_path / "tiny.yml", day, view=["two_sensors", "-wind_speed"])
    training = _Training([day], settings, settings.digest, 3, tmp_path / "run")
    training.prepare()
    for _ in range(3):
        training.update()
    learning, learner = training._learning, training._learner
    quiet = learning._replace(weights={**learning.weights, "spread": jax.numpy.full(6, -30.0)})
    agent = ActorAgent(training.policy())
    agent.reset(task_card(day), 16)
    agent._positions = np.asarray(learning.now.positions, np.float64)
    _, rollout = learner._step(quiet, learning.now, jax.random.key(1))
    expected, _ = learner._act(rollout.samples, learning.now.positions)
    assert np.allclose(agent.act(np.asarray(rollout.observations)), expected, atol=1e-5)


def test_a_training_without_a_view_keeps_its_digest_and_weights(day: TaskSpec, tmp_path: Path) -> None:
    plain = tiny(day, tmp_path)
    assert "view" not in plain.model_dump(mode="json")
    everything = plain.model_copy(update={"view": tuple(day.observation.modules)})
    assert everything.digest != plain.digest
    assert Learner.of(day, plain).visible.all()
    assert Learner.of(day, everything).visible.all()


def test_a_view_with_a_memory_brings_the_recipe_of_the_shipped_one(day: TaskSpec, tmp_path: Path) -> None:
    tiny(day, tmp_path)
    blind = read_compiled_settings(tmp_path / "tiny.yml", day, view=["blind"])
    assert blind.memory.hours == (1.0, 4.0)
    assert blind.memory.columns == ("global_radiation", "outdoor_temperature", "outdoor_relative_humidity", "wind_speed")
    assert read_compiled_settings(tmp_path / "tiny.yml", day, view=["memory"]).memory.columns == (
        "air_temperature",
        "co2",
        "relative_humidity",
    )
    assert read_compiled_settings(tmp_path / "tiny.yml", day, view=["outdoor"]).memory.hours == ()
    assert blind.critic_sees == ("tAir", "co2Air", "vpAir", "tCan", "tPipe")
    tiny(day, tmp_path, "  critic_sees: [tAir, epi]\n")
    assert read_compiled_settings(tmp_path / "tiny.yml", day, view=["blind"]).critic_sees == ("tAir", "epi")


def test_the_critic_alone_sees_what_is_told(day: TaskSpec, tmp_path: Path) -> None:
    learner = Learner.of(day, tiny(day, tmp_path, MEMORY))
    learning = learner.begin(jax.random.key(0))
    after, _ = jax.jit(learner.update)(learning, jax.random.key(1), 0.0)
    inputs = len(day.observed()) + 6
    assert after.weights["actor"][0][0].shape[0] == inputs
    assert after.weights["critic"][0][0].shape[0] == inputs + 2
    assert 5.0 < float(after.privileged.mean[0]) < 40.0, "tAir [degC]"


def test_without_steering_the_network_gives_the_action(day: TaskSpec, tmp_path: Path) -> None:
    learner = Learner.of(day, tiny(day, tmp_path, "  steer: false\n"))
    action, _ = learner._act(jax.numpy.array([[-2.0, -0.5, 0.0, 0.5, 1.0, 2.0]]), jax.numpy.zeros((1, 6)))
    assert np.array_equal(action, [[-1.0, -0.5, 0.0, 0.5, 1.0, 1.0]])


def test_machines_that_are_off_or_on_are_not_steered() -> None:
    task = get_task("SpringEnergy-v1")
    steps = dict(zip(task.actuation.controls, steps_of_controls(task), strict=True))
    assert {name for name, step in steps.items() if step == 0.0} == set(task.on_off) != set()
    assert set(steps.values()) == {0.0, task.actuation.max_change}


def test_single_actions_may_explore_less(tmp_path: Path) -> None:
    task = get_task("LettuceHarvest-v1")
    learner = Learner.of(task, tiny(task, tmp_path, f"{task.id}:\n  log_std_of: {{uHarvest: -3.0}}\n"))
    spread = dict(zip(task.actuation.controls, learner.begin(jax.random.key(0)).weights["spread"].tolist(), strict=True))
    assert spread == pytest.approx(dict.fromkeys(("uBoil", "uCo2", "uThScr", "uVent"), -0.7) | {"uHarvest": -3.0})
    with pytest.raises(TrainingError, match=r"has no action 'uHarves'\. Did you mean 'uHarvest'"):
        Learner.of(task, tiny(task, tmp_path, f"{task.id}:\n  log_std_of: {{uHarves: -3.0}}\n"))


def test_a_training_starts_from_a_policy_and_may_keep_it_while_the_critic_learns(trained: Trained, day: TaskSpec, tmp_path: Path) -> None:
    (tmp_path / "start.npz").write_bytes((trained.folder / "policy.npz").read_bytes())
    settings = tiny(day, tmp_path, f"{day.id}:\n  n_timesteps: 384\n  start_from: start.npz\n  critic_first: 0.5\n")
    training = _Training([day], settings, settings.digest, 0, tmp_path / "run")
    training.prepare()
    weights = [training._learning.weights]
    for _ in range(2):
        training.update()
        weights.append(training._learning.weights)

    def differs(part: str, first: int, second: int) -> bool:
        leaves = zip(jax.tree.leaves(weights[first][part]), jax.tree.leaves(weights[second][part]), strict=True)
        return any((before != after).any() for before, after in leaves)

    policy = read_actor(trained.folder / "policy.npz").network
    np.testing.assert_array_equal(weights[0]["actor"][0][0], policy.weights[0])
    assert [differs("actor", 0, 1), differs("critic", 0, 1), differs("actor", 1, 2)] == [False, True, True]

    elsewhere = tmp_path / "elsewhere.npz"
    elsewhere.write_bytes((tmp_path / "start.npz").read_bytes())
    assert settings.model_copy(update={"start_from": elsewhere}).digest == settings.digest
    elsewhere.write_bytes(b"another policy")
    assert settings.model_copy(update={"start_from": elsewhere}).digest != settings.digest


def test_while_the_critic_learns_alone_the_memory_that_the_policy_shares_stays(day: TaskSpec, tmp_path: Path) -> None:
    settings = tiny(day, tmp_path, f"{day.id}:\n  n_timesteps: 384\n  critic_first: 0.5\n{GRU}")
    training = _Training([day], settings, settings.digest, 0, tmp_path / "run")
    training.prepare()
    before = training._learning.weights
    training.update()
    after = training._learning.weights
    for name in before["gru"]:
        np.testing.assert_array_equal(before["gru"][name], after["gru"][name])
    assert (before["critic"][0][0] != after["critic"][0][0]).any()


def test_a_policy_to_start_from_scores_as_it_did_and_is_on_the_card(trained: Trained, day: TaskSpec, tmp_path: Path) -> None:
    more = f"{day.id}:\n  n_timesteps: 192\n  start_from: {trained.folder / 'policy.npz'}\n"
    after = train_compiled(day, tiny(day, tmp_path, more), tmp_path / "run", seed=3)
    with (after.folder / "learning_curve.csv").open(encoding="utf-8") as file:
        first = float(next(csv.DictReader(file))["reward"])
    assert first == pytest.approx(trained.best_reward, abs=0.01)
    card = tomllib.loads((after.folder / "card.toml").read_text(encoding="utf-8"))
    assert card["start"]["steps"] == 9_024


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        ("  net_arch: [8]\n", r"its layers \('net_arch', 'memory'\) are"),
        (MEMORY, "its layers"),
        ("  steer: false\n", r"its changes of controls in a step \('steer'\) are"),
        ("  normalize: {clip_observations: 0.3}\n", r"its limits of normalised observations .* are 10.0; those of this training are 0.3"),
        ("  view: [time]\n", "it uses 'air_temperature', which is not in 'view'"),
        ("  least_scale: {air_temperature: 99.0}\n", "'least_scale' is above the policy's own scale of 'air_temperature'"),
    ],
)
def test_a_policy_of_another_kind_is_no_start(trained: Trained, day: TaskSpec, tmp_path: Path, more: str, reason: str) -> None:
    own = f"{day.id}:\n  start_from: {trained.folder / 'policy.npz'}\n{more}"
    with pytest.raises(TrainingError, match=f"cannot start from .*policy.npz: {reason}"):
        train_compiled(day, tiny(day, tmp_path, own), tmp_path / "run")


def test_statistics_of_parts_are_those_of_the_whole() -> None:
    rows = np.random.default_rng(0).normal(3.0, 2.0, (60, 4)).astype(np.float32)
    found = Statistics.empty(4)
    for part in np.split(rows, [7, 20, 55]):
        found = found.with_rows(jax.numpy.asarray(part))
    assert np.allclose(found.mean, rows.mean(0), atol=1e-5)
    assert np.allclose(found.variance, rows.var(0), rtol=1e-5)
    assert found.count == 60
    recent = found.with_rows(jax.numpy.asarray(rows[:10] + 100.0), at_most=1e-3)
    assert np.allclose(recent.mean, rows[:10].mean(0) + 100.0, atol=0.1), "what came before hardly counts"


def test_impossible_settings_are_refused_in_words(day: TaskSpec, tmp_path: Path) -> None:
    for more, words in {
        "  batch_size: 50\n": "'batch_size: 50' does not divide the 192 steps of a rollout",
        "  first_env_seed: 666\n": "666 is not a seed for training",
        "  learning_rat: 1e-3\n": "there is no setting 'learning_rat'. Did you mean 'learning_rate'",
        "  memory: {gru: 8}\n  batch_size: 32\n": "a batch has whole sequences: 'n_steps: 12' must divide 'batch_size: 32'",
        "  memory: {hours: [1, -4]}\n": "time constants are positive numbers of hours, not 1, -4",
        "  normalize: {rewards: false}\n": "always normalises observations and rewards",
        "  net_arch: [8, 0]\n": r"'net_arch\.1': input should be greater than 0",
        "  memory: {hours: [1], columns: [co2, co2]}\n": "no entry may appear twice, as in co2, co2",
        "  memory: {hours: [4, 4]}\n": "no entry may appear twice, as in 4",
    }.items():
        with pytest.raises(TrainingError, match=words):
            tiny(day, tmp_path, more)
    settings = tiny(day, tmp_path, "  accrual: {state: cBug, price: 1}\n")
    with pytest.raises(TrainingError, match=r"'accrual': the model of test/Day-v1 has no state 'cBug'.*'cBuf'"):
        Learner.of(day, settings)
    settings = tiny(day, tmp_path, "  memory: {hours: [1], columns: [co3]}\n")
    with pytest.raises(TrainingError, match=r"'memory\.columns': test/Day-v1 shows no column 'co3'.*'co2'"):
        Learner.of(day, settings)


def test_in_measured_greenhouses_carbohydrate_is_paid_at_the_same_share_of_the_fruit_price() -> None:
    for name in ("GreenhouseYears-v1", "GreenhouseReal-v1"):
        accrual = read_compiled_settings(None, get_task(name)).accrual
        assert accrual is not None
        assert accrual.states == ("cBuf", "mould")
        assert accrual.prices[0] == pytest.approx(0.45 * 4.0 / 0.09 * 1e-6)
        assert accrual.prices[1] < 0.0, "mould is charged"


@pytest.mark.parametrize(("name", "updates"), [("Spring-v1", 2), ("Schiphol2010-Delta10-v1", 3)])
def test_the_shipped_settings_hold_for_shipped_tasks(name: str, updates: int) -> None:
    task = get_task(name)
    settings = read_compiled_settings(None, task, steps=10_000)
    assert settings.updates == updates
    assert min(settings.seeds) >= 10_000_000_000
    if name == "Spring-v1":
        assert settings.accrual is not None
        price = 1.6 / 0.065 * 1e-6  # EUR for a mg of carbohydrate, as fresh fruit
        assert settings.accrual.price == pytest.approx(0.45 * price, rel=0.01)


def test_what_the_compiled_kernel_cannot_step_is_referred_to_stable_baselines3(day: TaskSpec, tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("glbench.jax.door.why_not_compiled", lambda model: "there is no compiler")
        patch.setattr("glbench.jax.door.CompiledEnvironments", type("None", (), {}))
        with pytest.raises(TrainingError, match=r"there is no compiler.*glbench train stable_baselines3\.PPO --task FILE\.toml$"):
            Learner.of(day, tiny(day, tmp_path))


@pytest.mark.parametrize("memory", [MEMORY, GRU])
def test_an_update_is_compiled_once(day: TaskSpec, tmp_path: Path, memory: str) -> None:
    """What it takes and what it returns have the same types; weak ones count, or the second update would be compiled again."""
    learner = Learner.of(day, tiny(day, tmp_path, memory))
    begun = jax.eval_shape(learner.begin, jax.random.key(0))
    after, _ = jax.eval_shape(learner.update, begun, jax.random.key(0), 0.0)
    kinds = [[(leaf.shape, leaf.dtype, leaf.weak_type) for leaf in jax.tree.leaves(one)] for one in (begun, after)]
    assert kinds[0] == kinds[1]
