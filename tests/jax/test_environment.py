"""The door for JAX has the bits of the vector environment, under jit, scan and vmap, and gives way in words where it must."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.env import GreenhouseVectorEnv, Simulation, Snapshot, register_reward
from glbench.errors import ActionError, GlbenchError, ShapeError, TaskError, UnknownNameError
from glbench.kernel import make_kernel, why_not_compiled
from glbench.tasks import TaskSpec, get_task
from tests.support import shipped_tasks

jax = pytest.importorskip("jax", reason="JAX is not installed (extra 'jax')")
pytestmark = pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))

from glbench.jax import Environment, Params, State, door  # noqa: E402

SEEDS = (10_003, 10_001, 2**63 + 5)
N = len(SEEDS)
SERVED = {task.id: task for task in shipped_tasks(maps=False)}


def split_of(task: TaskSpec) -> str | None:
    """The split to step a task in: one that only tests others has a test split alone."""
    return "test" if task.splits is not None and task.splits.training is None else None


def reset_each(environment: Environment, n: int = N) -> tuple[Any, Any]:
    """One row in each scenario, in their order."""
    rows = Params(np.arange(n), np.ones(n, np.int64))
    return jax.jit(jax.vmap(environment.reset))(jax.random.split(jax.random.key(0), n), rows)


def keys(n: int = N, seed: int = 1) -> Any:
    return jax.random.split(jax.random.key(seed), n)


def assert_standing(environment: Environment, state: State, simulation: Simulation) -> None:
    x, u, memory = environment.unpack(state)
    snapshot = simulation.snapshot()
    assert x.tobytes() == snapshot.states.tobytes()
    assert u.tobytes() == snapshot.controls.tobytes()
    assert memory.tobytes() == snapshot.memory.tobytes()
    assert np.array_equal(state.step, snapshot.steps)
    assert np.array_equal(state.ended, snapshot.ended)


def random_actions(task: TaskSpec, n: int, rng: np.random.Generator) -> NDArray[np.float32]:
    low, high = np.array([(action.low, action.high) for action in task.actions]).T
    return rng.uniform(low, high, (n, len(low))).astype(np.float32)


@pytest.mark.slow
@pytest.mark.parametrize("task_id", SERVED)
def test_every_task_has_the_bits_of_the_vector_environment(task_id: str) -> None:
    task, rng = SERVED[task_id], np.random.default_rng(3)
    split = split_of(task)
    environment = Environment(task, seeds=SEEDS, info=("epi", "hour_of_day"), split=split)
    native = GreenhouseVectorEnv(task, N, kernel="fast", split=split)
    observed, state = reset_each(environment)
    assert np.asarray(observed).tobytes() == native.reset(seed=SEEDS)[0].tobytes()
    step = jax.jit(jax.vmap(environment.step))
    for _ in range(8):
        actions = random_actions(task, N, rng)
        observed, state, reward, done, info = step(keys(), state, actions)
        theirs = native.step(actions)
        assert np.asarray(observed).tobytes() == theirs[0].tobytes()
        assert np.asarray(reward).tobytes() == theirs[1].astype(np.float32).tobytes()
        assert np.array_equal(done, theirs[2])
        for name in ("epi", "hour_of_day"):
            assert np.asarray(info[name]).tobytes() == theirs[4][name].astype(np.float32).tobytes()
        assert_standing(environment, state, native.simulation)


def test_episodes_follow_each_other_with_the_bits_of_the_vector_environment(day: TaskSpec) -> None:
    environment, rng = Environment(day, seeds=range(10_000, 10_008)), np.random.default_rng(5)
    native = GreenhouseVectorEnv(day, N, kernel="fast", autoreset_mode="Disabled")
    observed, state = reset_each(environment)
    native.reset(seed=list(environment.seeds[:N]))
    step, ends, begun = jax.jit(jax.vmap(environment.step)), 0, set()
    for number in range(2 * day.steps + 3):
        actions = random_actions(day, N, rng)
        observed, state, reward, done, info = step(keys(seed=number), state, actions)
        theirs = native.step(actions)
        assert np.asarray(reward).tobytes() == theirs[1].astype(np.float32).tobytes()
        assert np.array_equal(done, theirs[2])
        assert np.array_equal(info["discount"], 1.0 - theirs[2])
        expected = theirs[0]
        if theirs[2].any():
            ends += 1
            seeds = [environment.seeds[scenario] for scenario in np.asarray(state.scenario)]
            begun.update(seeds)
            expected, _ = native.reset(seed=seeds, options={"reset_mask": theirs[2]})
        assert np.asarray(observed).tobytes() == expected.tobytes()
        assert_standing(environment, state, native.simulation)
    assert ends == 2
    assert len(begun) > 2, "new episodes are in scenarios drawn anew"


def test_with_64_bits_rewards_and_info_are_those_of_the_vector_environment(day: TaskSpec) -> None:
    native = GreenhouseVectorEnv(day, N, kernel="fast")
    native.reset(seed=SEEDS)
    with jax.enable_x64(True):
        environment = Environment(day, seeds=SEEDS, info=("epi", "penalty", "cBuf"))
        _, state = reset_each(environment)
        actions = np.random.default_rng(0).uniform(-1.0, 1.0, (N, 6))  # float64
        _, state, reward, _, info = jax.vmap(environment.step)(keys(), state, actions)
    _, rewards, _, _, infos = native.step(actions)
    assert np.asarray(reward).tobytes() == rewards.tobytes()
    assert np.asarray(info["penalty"]).tobytes() == infos["penalty"].tobytes()
    buffer = native.simulation.x[:, day.model_value.state_index("cBuf")]
    assert np.asarray(info["cBuf"]).tobytes() == buffer.tobytes()
    assert_standing(environment, state, native.simulation)


def test_step_is_step_env_and_a_reset_where_an_episode_has_ended(day: TaskSpec) -> None:
    environment = Environment(day, seeds=range(5))
    _, state = reset_each(environment)
    state = state._replace(step=np.array([3, day.steps - 1, day.steps - 1], np.int32))
    action = np.zeros((N, 6), np.float32)
    observed, after, reward, done, info = jax.vmap(environment.step)(keys(), state, action)
    plain = jax.vmap(environment.step_env)(keys(), state, action)
    assert np.array_equal(done, [False, True, True])
    assert np.array_equal(plain[1].ended, done)
    fresh = jax.vmap(environment.reset_env)(jax.vmap(lambda key: jax.random.split(key)[1])(keys()))
    for row in range(N):
        expected = fresh if done[row] else plain[:2]
        assert np.array_equal(observed[row], expected[0][row])
        for ours, theirs in zip(after, expected[1], strict=True):
            assert np.array_equal(ours[row], theirs[row])
    assert np.array_equal(reward, plain[2])
    assert info.keys() == plain[4].keys() == {"epi", "penalty", "failed", "discount"}
    again = jax.vmap(environment.step_env)(keys(), plain[1], action)
    assert np.array_equal(np.asarray(again[2])[1:], [0.0, 0.0]), "a run that has ended stays as it is"
    assert np.array_equal(np.asarray(again[1].numbers)[1:], np.asarray(plain[1].numbers)[1:])
    assert np.array_equal(environment.is_terminal(again[1]), done)
    assert np.array_equal(environment.discount(again[1]), [1.0, 0.0, 0.0])


def test_places_are_rows_of_the_season_with_the_start_of_their_weather(day: TaskSpec) -> None:
    environment, n = Environment(day, seeds=SEEDS, places=8), 64
    _, state = jax.jit(jax.vmap(environment.reset))(keys(n))
    steps, scenarios = np.asarray(state.step), np.asarray(state.scenario)
    assert set(steps[scenarios == 0]) != set(steps[scenarios == 1]), "scenarios have places of their own"
    assert steps.min() < day.steps / 8
    assert 7 * day.steps / 8 <= steps.max() < day.steps
    assert 0 in steps
    x, u, memory = environment.unpack(state)
    weather = day.disturbances().values
    for row in range(8):
        assert np.array_equal(x[row], day.start_state(weather[steps[row]]))
    simulation = Simulation(day, n, "fast")
    simulation.reset([SEEDS[scenario] for scenario in scenarios])
    start = simulation.snapshot()
    simulation.restore(Snapshot(day.id, day.digest, x, u, steps.astype(np.int64), start.seeds, start.ended, start.generators, memory))
    actions = random_actions(day, n, np.random.default_rng(1))
    result = simulation.step(actions)
    observed, after, reward, done, _ = jax.vmap(environment.step_env)(keys(n), state, actions)
    assert np.asarray(observed).tobytes() == result.observations.tobytes()
    assert np.asarray(reward).tobytes() == result.rewards.astype(np.float32).tobytes()
    assert np.array_equal(done, result.terminated)
    assert_standing(environment, after, simulation)
    _, begun = jax.vmap(environment.reset_env)(keys(n))
    assert not np.asarray(begun.step).any(), "the next episode begins at the start"


def test_a_row_that_fails_ends_and_is_charged_as_in_the_vector_environment(day: TaskSpec) -> None:
    environment = Environment(day, seeds=SEEDS)
    _, state = reset_each(environment)
    x, _, _ = environment.unpack(state)
    x[1, 0] = np.nan
    simulation = Simulation(day, N, "fast")
    simulation.reset(SEEDS)
    start = simulation.snapshot()
    simulation.restore(Snapshot(day.id, day.digest, x, *(getattr(start, name) for name in (
        "controls", "steps", "seeds", "ended", "generators", "memory"))))  # fmt: skip
    numbers = np.array(state.numbers)
    numbers[1, :2] = np.array([np.nan]).view(np.uint32)
    actions = random_actions(day, N, np.random.default_rng(1))
    _, _, reward, done, info = jax.vmap(environment.step_env)(keys(), state._replace(numbers=numbers), actions)
    result = simulation.step(actions)
    assert [failure.row for failure in result.failed] == [1]
    assert np.array_equal(info["failed"], [False, True, False])
    assert np.array_equal(done, [False, True, False])
    assert np.asarray(reward).tobytes() == result.rewards.astype(np.float32).tobytes()


def test_n_rows_are_one_call(day: TaskSpec) -> None:
    environment = Environment(day, seeds=SEEDS)
    _, state = reset_each(environment)
    action = np.zeros((N, 6), np.float32)
    text = jax.jit(jax.vmap(environment.step)).lower(keys(), state, action).as_text()
    calls = [line for line in text.splitlines() if "@glbench_step" in line]
    assert len(calls) == 1
    assert f"tensor<{N}x{state.numbers.shape[1]}xui32>" in calls[0]
    twice = jax.vmap(jax.vmap(environment.step, in_axes=(None, 0, 0)), in_axes=(None, None, 0))
    nested = twice(jax.random.key(0), state, np.stack([action, action + 1.0]))
    assert nested[0].shape == (2, N, *environment.obs_shape)
    single = environment.step(jax.random.key(0), jax.tree.map(lambda a: a[2], state), action[2] + 1.0)
    assert np.array_equal(nested[0][1, 2], single[0]), "a row has the same bits alone"


def test_a_scan_gives_the_bits_of_single_steps_with_any_number_of_workers(day: TaskSpec) -> None:
    found = []
    for workers in (1, 2):
        environment, n = Environment(day, seeds=range(4), workers=workers), 40
        _, state = jax.vmap(environment.reset)(keys(n))
        actions = np.stack([random_actions(day, n, np.random.default_rng(i)) for i in range(12)])

        def body(state: Any, given: Any, environment: Environment = environment, n: int = n) -> Any:
            observed, state, reward, _, _ = jax.vmap(environment.step)(keys(n), state, given)
            return state, (observed, reward)

        one = jax.jit(body)
        scanned = jax.jit(lambda state, actions: jax.lax.scan(body, state, actions))(state, actions)
        found.append([np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(scanned)])
        for number in range(12):
            state, told = one(state, actions[number])
            assert np.array_equal(scanned[1][0][number], told[0])
            assert np.array_equal(scanned[1][1][number], told[1])
    assert found[0] == found[1]


def test_an_environment_says_what_gymnax_asks(day: TaskSpec) -> None:
    environment = Environment(day, seeds=SEEDS)
    native = GreenhouseVectorEnv(day, 1)
    assert environment.name == day.id
    assert environment.num_actions == 6
    assert environment.default_params == Params(0, N)
    actions, observations = environment.action_space(environment.default_params), environment.observation_space()
    assert observations.shape == environment.obs_shape == native.single_observation_space.shape
    assert np.array_equal(observations.low, native.single_observation_space.low)  # type: ignore[attr-defined]
    drawn = actions.sample(jax.random.key(3))
    assert drawn.shape == actions.shape == (6,)
    assert drawn.dtype == actions.dtype
    assert actions.contains(drawn)
    assert not actions.contains(drawn + 3.0)


def test_actions_beyond_their_bounds_are_taken_as_the_bounds(day: TaskSpec) -> None:
    environment = Environment(day, seeds=SEEDS)
    _, state = environment.reset(jax.random.key(0))
    far, near = (environment.step(jax.random.key(1), state, np.full(6, value, np.float32)) for value in (7.0, 1.0))
    assert np.array_equal(far[1].numbers, near[1].numbers)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_actions_that_are_no_numbers_are_refused(day: TaskSpec, value: float) -> None:
    environment = Environment(day, seeds=SEEDS)
    _, state = reset_each(environment)
    actions = np.zeros((N, 6), np.float32)
    actions[1, 2] = value
    with pytest.raises(Exception, match=r"action 2 of row 1 is .*Actions are finite numbers"):
        jax.block_until_ready(jax.vmap(environment.step)(keys(), state, actions))
    with pytest.raises(ShapeError, match=r"jax\.vmap"):
        environment.step(jax.random.key(0), state, actions)


def test_a_scenario_that_is_not_there_is_refused(day: TaskSpec) -> None:
    environment = Environment(day, seeds=SEEDS)
    with pytest.raises(Exception, match="there is no scenario 3: the environment has 3"):
        jax.block_until_ready(environment.reset(jax.random.key(0), Params(3, 1)))


def test_what_cannot_be_made_is_refused_in_words(day: TaskSpec) -> None:
    with pytest.raises(UnknownNameError, match=r"'fats'.*'fast'"):
        Environment(day, "fats")
    with pytest.raises(UnknownNameError, match=r"no quantity or state 'epis' for info.*'epi'"):
        Environment(day, info=("epis",))
    with pytest.raises(ShapeError, match="at least one scenario"):
        Environment(day, seeds=())
    with pytest.raises(ShapeError, match="not at 0"):
        Environment(day, places=0)
    with pytest.raises(GlbenchError, match="whole number from 0"):
        Environment(day, seeds=(-1,))


@pytest.mark.usefixtures("own_words")
def test_a_task_with_parts_in_python_is_not_served(day: TaskSpec) -> None:
    register_reward("own_part", "a part that only Python knows", lambda task, accounts: lambda step: step.quantity("epi"))
    task = day.replace({"id": "test/Own-v1", "reward.modules": ["epi", "own_part"]})
    with pytest.raises(TaskError, match=r"cannot step test/Own-v1: the reward 'own_part' is Python. Use .*GreenhouseVectorEnv"):
        Environment(task)


def test_without_a_compiler_the_reason_is_said(day: TaskSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(door, "make_kernel", lambda *given, **named: make_kernel(*given, **named, backend="casadi"))
    monkeypatch.setattr(door, "why_not_compiled", lambda model: "There is no C++ compiler here.")
    with pytest.raises(TaskError, match=r"cannot step test/Day-v1: There is no C\+\+ compiler here\. Use "):
        Environment(day)


@pytest.mark.parametrize("action", [[0j] * 6, [True] * 6, ["0"] * 6, [10**400] * 6, [None] * 6, np.zeros(6, "datetime64[s]")])
def test_an_action_that_is_not_a_row_of_real_numbers_is_refused(action: Any) -> None:
    environment = Environment("Spring-v1")
    _, state = environment.reset(jax.random.key(0))
    with pytest.raises(ActionError, match=r"is an array of real numbers, (not of|and this)"):
        environment.step(jax.random.key(1), state, action)


def test_an_episode_begins_with_the_controls_of_the_task() -> None:
    heated = {"schema": 2, "initial_state.controls": {"uBoil": {"value": 65.0, "unit": "W m-2"}}}
    environment = Environment(get_task("Schiphol2010-Delta10-v1").replace(heated), seeds=SEEDS)
    _, state = reset_each(environment)
    _, controls, _ = environment.unpack(state)
    assert np.asarray(controls)[1].tolist() == [0.5, 0.0, 0.0, 0.0, 0.0, 0.0]
