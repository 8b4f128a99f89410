"""``GymnaxEnvironment`` is an environment of gymnax 1.x, and ``Environment`` one for learners that unpack five values."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest

from glbench.env import GreenhouseVectorEnv
from glbench.errors import GlbenchError
from glbench.kernel import why_not_compiled
from glbench.tasks import TaskSpec

jax = pytest.importorskip("jax", reason="JAX is not installed (extra 'jax')")
pytestmark = [pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled())), pytest.mark.filterwarnings("default")]

import jax.numpy as jnp  # noqa: E402

import glbench.jax  # noqa: E402
from glbench.jax import Environment  # noqa: E402

SEEDS = range(10_000_000_000, 10_000_000_003)
N = len(SEEDS)


@pytest.fixture
def environment(day: TaskSpec) -> Any:
    pytest.importorskip("gymnax", reason="gymnax is not installed (python -m docs.compatibility_table installs it)")
    from glbench.jax import GymnaxEnvironment

    return GymnaxEnvironment(day, seeds=SEEDS)


def keys(n: int = N, seed: int = 1) -> Any:
    return jax.random.split(jax.random.key(seed), n)


def test_without_gymnax_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gymnax", None)
    monkeypatch.setitem(sys.modules, "gymnax.environments", None)
    monkeypatch.delitem(sys.modules, "glbench.jax.gymnax", raising=False)
    monkeypatch.delitem(vars(glbench.jax), "GymnaxEnvironment", raising=False)
    with pytest.raises(GlbenchError, match=r"needs gymnax 1\.0 or newer, which is not installed.*pip install"):
        from glbench.jax import GymnaxEnvironment  # noqa: F401


def test_its_parts_are_gymnax_own(environment: Any, day: TaskSpec) -> None:
    from gymnax.environments import spaces
    from gymnax.environments.environment import Environment as GymnaxBase
    from gymnax.environments.environment import EnvParams, EnvState

    params = environment.default_params
    native = GreenhouseVectorEnv(day, 1)
    assert isinstance(environment, GymnaxBase)
    assert isinstance(params, EnvParams)
    assert (environment.name, environment.num_actions) == (day.id, 6)
    assert params.replace(max_steps_in_episode=5).max_steps_in_episode == 5
    assert params.max_steps_in_episode == day.steps
    for box, ours in (
        (environment.action_space(params), native.single_action_space),
        (environment.observation_space(params), native.single_observation_space),
    ):
        assert isinstance(box, spaces.Box)
        assert spaces.gymnax_space_to_gym_space(box) == ours
    observation, state = environment.reset(jax.random.key(0), params)
    assert isinstance(state, EnvState)
    assert environment.observation_space(params).contains(observation)


def test_six_values_with_the_bits_of_the_other_door(environment: Any, day: TaskSpec) -> None:
    five = Environment(day, seeds=SEEDS)
    observation, state = jax.vmap(environment.reset)(keys())
    other, standing = jax.vmap(five.reset)(keys())
    assert np.array_equal(observation, other)
    step = jax.jit(jax.vmap(environment.step))
    rng = np.random.default_rng(0)
    for k in range(1, day.steps + 1):
        action = rng.uniform(-1.0, 1.0, (N, 6)).astype(np.float32)
        observation, state, reward, terminated, truncated, info = step(keys(), state, action)
        other, standing, same, done, _ = jax.vmap(five.step_env)(keys(), standing, action)
        assert np.array_equal(info["final_observation"], other)
        assert np.array_equal(reward, same)
        assert np.array_equal(terminated, done)
        assert np.array_equal(terminated, np.full(N, k == day.steps))
        assert not truncated.any(), "the end of a season is an end, nothing is cut"
    assert not np.array_equal(observation, info["final_observation"]), "another episode has begun"
    assert np.array_equal(state.time, np.zeros(N))
    assert set(info) == {"epi", "penalty", "failed", "discount", "terminated", "truncated", "final_observation"}


def test_a_limit_truncates(environment: Any) -> None:
    params = environment.default_params.replace(max_steps_in_episode=5)
    _, state = environment.reset(jax.random.key(0), params)
    ends = []
    for k in range(10):
        _, state, _, terminated, truncated, info = environment.step(jax.random.key(k), state, jnp.zeros(6), params)
        ends.append((bool(terminated), bool(truncated), float(info["discount"])))
    assert ends == ([(False, False, 1.0)] * 4 + [(False, True, 1.0)]) * 2


def test_gymnax_own_wrappers_take_it(environment: Any, day: TaskSpec) -> None:
    from gymnax import wrappers

    logged = wrappers.LogWrapper(wrappers.FlattenObservationWrapper(environment))
    _, state = logged.reset(jax.random.key(0))
    for k in range(day.steps):
        *_, info = logged.step(jax.random.key(k), state, jnp.zeros(6))
        _, state, *_ = logged.step(jax.random.key(k), state, jnp.zeros(6))
    assert (int(info["returned_episode_lengths"]), bool(info["returned_episode"])) == (day.steps, True)
    single = wrappers.GymnaxToGymWrapper(environment, seed=0)
    observation, _ = single.reset(seed=1)
    assert len(single.step(single.action_space.sample())) == 5
    assert observation in single.observation_space
    legacy = wrappers.LegacyStepAPIWrapper(environment)
    assert len(legacy.step(jax.random.key(0), legacy.reset(jax.random.key(0))[1], jnp.zeros(6))) == 5


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["ppo", "sac", "td3"])
def test_rejax_trains_on_five_values(day: TaskSpec, algorithm: str) -> None:
    rejax = pytest.importorskip("rejax", reason="rejax is not installed (python -m docs.compatibility_table installs it)")
    environment = Environment(day, seeds=SEEDS, normalise=True)
    off_policy = {"fill_buffer": 64, "buffer_size": 512, "batch_size": 32}
    settings: dict[str, Any] = {"ppo": {"num_envs": 4, "num_steps": 24, "num_minibatches": 2}}.get(algorithm, off_policy)
    learner = rejax.get_algo(algorithm).create(env=environment, total_timesteps=192, eval_freq=192, **settings)
    _, (lengths, returns) = jax.jit(learner.train)(jax.random.key(0))
    assert lengths.shape == returns.shape == (2, 128)
    assert (np.asarray(lengths) == day.steps).all(), "evaluations run whole seasons"
    assert np.isfinite(returns).all()


def test_a_limit_ends_an_episode_of_five_values(day: TaskSpec) -> None:
    environment = Environment(day, seeds=SEEDS)
    default, short = environment.default_params, environment.default_params.replace(max_steps_in_episode=5)
    assert (default.max_steps_in_episode, short.count) == (day.steps, N)
    step = jax.jit(environment.step)
    _, state = environment.reset(jax.random.key(0), default)
    cut = state
    for k in range(1, 11):
        key, before = jax.random.key(k), state
        observation, state, _, done, info = step(key, before, jnp.zeros(6), default)
        begun, cut, _, ended, told = step(key, cut, jnp.zeros(6), short)
        assert not done
        assert bool(ended) == (k % 5 == 0)
        assert int(cut.time) == k % 5
        assert float(told["discount"]) == float(info["discount"]) == 1.0
        if k < 5:
            assert np.array_equal(observation, begun), "a limit changes no bit"


@pytest.mark.parametrize("rows", [1, 2])
def test_normalised_observations_are_the_same_in_every_door(day: TaskSpec, rows: int) -> None:
    environment = Environment(day, seeds=SEEDS, normalise=True)
    native = GreenhouseVectorEnv(day, rows, kernel="fast", normalise=True)
    observation, state = jax.jit(jax.vmap(environment.reset))(keys(rows))
    seen, _ = native.reset(seed=[environment.seeds[i] for i in np.asarray(state.scenario)])
    assert np.asarray(observation).tobytes() == seen.tobytes()
    for _ in range(3):
        action = np.full((rows, 6), 0.5, np.float32)
        observation, state, *_ = jax.jit(jax.vmap(environment.step))(keys(rows), state, action)
        assert np.asarray(observation).tobytes() == native.step(action)[0].tobytes()
    assert np.array_equal(environment.observation_space().low, native.single_observation_space.low)  # type: ignore[attr-defined]
