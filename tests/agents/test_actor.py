"""Policies of the compiled PPO: what stands before and behind their network, and their files."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from glbench.agents.network_policy import Actor, ActorAgent, Gru, NetworkPolicy, PolicyFiles, read_actor, read_policy
from glbench.env import Simulation
from glbench.errors import ShapeError, SubmissionError
from glbench.tasks import TaskSpec, get_task, task_card


@pytest.fixture(scope="module")
def spring() -> TaskSpec:
    return get_task("Spring-v1")


def policy(spring: TaskSpec, hours: tuple[float, ...] = (1.0, 4.0), max_change: float = 0.1, units: int = 0) -> Actor:
    """Random weights, with traces of the first two columns, and a recurrent unit."""
    card, rng = task_card(spring), np.random.default_rng(0)
    names, actions = card.observation_names, len(card.actions)
    traced = np.arange(2)
    inputs = (*names, *(f"{names[i]}, {hour}" for hour in hours for i in traced), *(f"memory {i}" for i in range(units)))
    sizes = [len(inputs), 5, actions]
    network = NetworkPolicy(
        task_id=spring.id,
        delta=0.0,
        observation_names=inputs,
        action_names=card.action_names,
        low=np.zeros(actions),
        high=np.ones(actions),
        mean=np.append(rng.normal(size=len(inputs) - units), np.zeros(units)),
        scale=np.append(rng.uniform(10.0, 20.0, len(inputs) - units), np.ones(units)),
        clip=10.0,
        weights=tuple(rng.normal(size=size).astype(np.float32) for size in pairwise(sizes)),
        biases=tuple(rng.normal(size=size).astype(np.float32) for size in sizes[1:]),
        activation="Tanh",
        output="clip",
        about={},
    )
    shares = -np.expm1(-spring.step_seconds / (3600.0 * np.array(hours)))
    unit = [rng.normal(size=size).astype(np.float32) for size in ((len(inputs) - units, 3 * units), 3 * units, (units, 3 * units))]
    return Actor(network, traced, shares, np.full(actions, max_change), *card.action_bounds, Gru(*unit) if units else None)


def test_the_network_is_shown_running_means(spring: TaskSpec) -> None:
    actor = policy(spring)
    agent, card = ActorAgent(actor), task_card(spring)
    agent.reset(card, 3)
    readings = np.random.default_rng(1).normal(20.0, 5.0, (6, 3, len(card.observation_names))).astype(np.float32)
    means = np.repeat(readings[0][:, None, :2].astype(np.float64), 2, axis=1)
    positions = np.zeros((3, len(card.actions)))
    for seen in readings:
        means += actor.shares[:, None] * (seen[:, None, :2] - means)
        wanted = actor.network.act(np.concatenate([seen.astype(np.float64), means.reshape(3, -1)], axis=1))
        expected = np.clip((wanted - positions) / 0.1, -1.0, 1.0)
        given = agent.act(seen)
        assert np.allclose(given, expected, atol=1e-12)
        positions = np.clip(positions + 0.1 * given, 0.0, 1.0)
    agent.reset(card, 3)
    assert np.allclose(agent.act(readings[0]), np.clip(actor.network.act(
        np.concatenate([readings[0], np.tile(readings[0][:, :2], 2)], axis=1).astype(np.float64)) / 0.1, -1.0, 1.0))  # fmt: skip


def test_controls_go_where_the_network_wants_them(spring: TaskSpec) -> None:
    actor = policy(spring, hours=(), max_change=spring.actuation.max_change)
    still = replace(actor.network, weights=tuple(np.zeros_like(w) for w in actor.network.weights),
                    biases=(actor.network.biases[0], np.array([0.07, 0.25, 0.5, 1.0, 0.0, 0.33], np.float32)))  # fmt: skip
    agent = ActorAgent(replace(actor, network=still, traced=np.zeros(0, np.int64), shares=np.zeros(0)))
    agent.reset(task_card(spring), 2)
    simulation = Simulation(spring, 2)
    observations = simulation.reset([1, 2])
    for _ in range(12):
        observations = simulation.step(agent.act(observations)).observations
    assert np.allclose(simulation.u, [0.07, 0.25, 0.5, 1.0, 0.0, 0.33], atol=1e-6)


def test_an_action_that_is_no_rate_is_given_as_it_is(spring: TaskSpec) -> None:
    actor = replace(policy(spring, hours=()), max_change=np.zeros(6), traced=np.zeros(0, np.int64))
    seen = np.random.default_rng(2).normal(size=(4, len(actor.columns))).astype(np.float32)
    agent = ActorAgent(actor)
    agent.reset(task_card(spring), 4)
    assert np.array_equal(agent.act(seen), np.clip(actor.network.act(seen), actor.low, actor.high))


def test_a_recurrent_unit_remembers(spring: TaskSpec) -> None:
    """Its equations as PyTorch's documentation of GRU has them (Cho et al., 2014)."""
    actor, card, units = policy(spring, (), units=3), task_card(spring), 3
    gru, network = actor.gru, actor.network
    assert gru is not None
    agent = ActorAgent(actor)
    agent.reset(card, 2)
    memory = np.zeros((2, units))
    for seen in np.random.default_rng(4).normal(10.0, 15.0, (8, 2, len(card.observation_names))):
        agent.act(seen.astype(np.float32))
        x = np.clip((seen.astype(np.float32) - network.mean[:-units]) / network.scale[:-units], -10.0, 10.0)
        z, r, n = np.split(x @ gru.weights + gru.bias, 3, axis=1)
        hz, hr, hn = np.split(memory @ gru.recurrent, 3, axis=1)
        z, r = (1.0 / (1.0 + np.exp(-gate)) for gate in (z + hz, r + hr))
        memory = (1.0 - z) * np.tanh(n + r * hn) + z * memory
        assert np.allclose(agent._memory, memory, atol=1e-9)
    agent.reset(card, 2)
    assert not agent._memory.any(), "a run begins without memories"


@pytest.mark.parametrize("units", [0, 4])
def test_a_run_gets_the_same_bits_alone_and_among_others(spring: TaskSpec, units: int) -> None:
    actor, card = policy(spring, units=units), task_card(spring)
    readings = np.random.default_rng(3).normal(20.0, 5.0, (5, 7, len(card.observation_names))).astype(np.float32)
    together, alone = ActorAgent(actor), ActorAgent(actor)
    together.reset(card, 7)
    alone.reset(card, 1)
    for seen in readings:
        assert np.array_equal(together.act(seen)[4:5], alone.act(seen[4:5]))


def test_a_reading_that_is_missing_leaves_a_trace_as_it_is(spring: TaskSpec) -> None:
    card = task_card(spring)
    seen = np.full((1, len(card.observation_names)), 20.0, np.float32)
    missing = seen.copy()
    missing[0, 0] = np.nan
    agents = ActorAgent(policy(spring)), ActorAgent(policy(spring))
    for agent, second in zip(agents, (seen, missing), strict=True):
        agent.reset(card, 1)
        agent.act(seen)
        assert np.isfinite(agent.act(second)).all()
    recurrent = ActorAgent(policy(spring, units=4))
    recurrent.reset(card, 1)
    assert all(np.isfinite(recurrent.act(one)).all() for one in (missing, seen)), "what is missing is not remembered"
    steady = [agent.act(seen) for agent in agents]
    for _ in range(30):  # positions come together
        steady = [agent.act(seen) for agent in agents]
    assert np.array_equal(steady[0], steady[1]), "the trace of 20 was left as it was"


@pytest.mark.parametrize("units", [0, 4])
def test_the_file_holds_the_policy(spring: TaskSpec, tmp_path: Path, units: int) -> None:
    actor = policy(spring, units=units)
    file = tmp_path / "policy.npz"
    file.write_bytes(actor.to_bytes())
    again = read_actor(file)
    assert again.to_bytes() == actor.to_bytes()
    assert again.columns == task_card(spring).observation_names
    assert PolicyFiles.at(tmp_path).files == (file,)
    with pytest.raises(SubmissionError, match="is a policy of the compiled PPO"):
        read_policy(file)
    for damaged in (b"nothing", actor.to_bytes()[:-40]):
        file.write_bytes(damaged)
        with pytest.raises(SubmissionError, match="not a glbench policy"):
            read_actor(file)
    with pytest.raises(SubmissionError, match="There is no policy at"):
        PolicyFiles.at(tmp_path / "none.npz")


def test_what_does_not_fit_is_refused(spring: TaskSpec) -> None:
    actor, card = policy(spring), task_card(spring)
    for wrong in ({"shares": np.array([0.5, 2.0])}, {"max_change": np.zeros(2)}, {"traced": np.array([0, 99])}):
        with pytest.raises(ShapeError, match="cannot have traces"):
            replace(actor, **wrong)
    unit = policy(spring, units=4).gru
    assert unit is not None
    with pytest.raises(ShapeError, match="cannot have traces"):
        replace(policy(spring, units=3), gru=unit)
    with pytest.raises(ShapeError, match="cannot have weights of shapes"):
        replace(unit, bias=unit.bias[:-1])
    with pytest.raises(ShapeError, match="weights that are not finite"):
        replace(unit, recurrent=unit.recurrent * np.float32(np.nan))
    agent = ActorAgent(actor)
    with pytest.raises(SubmissionError, match="does not fit this task: it was trained on"):
        agent.reset(replace(card, observations=card.observations[1:]), 1)
    with pytest.raises(SubmissionError, match=r"glbench train ppo --task FILE\.toml\.$"):
        agent.reset(replace(card, id="mine/Spring-v1", observations=card.observations[1:]), 1)
    with pytest.raises(SubmissionError, match="its actions are not those of"):
        agent.reset(replace(card, actions=card.actions[:2]), 1)
    agent.reset(card, 2)
    with pytest.raises(ShapeError, match="observations of 1 runs, reset was called with 2"):
        agent.act(np.zeros((1, len(card.observation_names)), np.float32))
