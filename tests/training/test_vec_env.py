"""The environment that Stable-Baselines3 sees is the environment of Gymnasium."""

from __future__ import annotations

import numpy as np
import pytest

from glbench.env import GreenhouseVectorEnv
from glbench.errors import TrainingError
from glbench.kernel import make_kernel
from glbench.tasks import TaskSpec, get_task
from glbench.training.settings import FIRST_TRAINING_SEED, Accrual
from glbench.training.vec_env import TrainingVecEnv

Array = np.ndarray


def actions(steps: int, rows: int) -> Array:
    return np.random.default_rng(0).uniform(-1, 1, (steps, rows, 6)).astype(np.float32)


def test_observations_rewards_and_ends_are_those_of_the_vector_environment(day: TaskSpec) -> None:
    ours = TrainingVecEnv(day, 3, first_seed=100)
    kernel = make_kernel(day.model_value, day.step_seconds, preset="fast")
    theirs = GreenhouseVectorEnv(day, 3, kernel=kernel, autoreset_mode="Disabled")
    np.testing.assert_array_equal(ours.reset(), theirs.reset(seed=[100, 101, 102])[0])
    total = np.zeros(3)
    for step, chosen in enumerate(actions(30, 3), start=1):
        observations, rewards, done, infos = ours.step(chosen)
        expected = theirs.step(chosen)
        following = theirs.reset(seed=[103, 104, 105])[0] if step == day.steps else expected[0]
        np.testing.assert_array_equal(observations, following)
        np.testing.assert_array_equal(rewards, expected[1].astype(np.float32))
        np.testing.assert_array_equal(done, expected[2])
        total += expected[1]
        if step == day.steps:
            assert done.all()
            for row, info in enumerate(infos):
                np.testing.assert_array_equal(info["terminal_observation"], expected[0][row])
                assert info["episode"]["l"] == day.steps
                np.testing.assert_allclose(info["episode"]["r"], total[row], rtol=1e-12)
        else:
            assert not done.any()
            assert infos == [{}, {}, {}]


def test_growth_of_a_state_is_paid_for_in_rewards_but_not_in_the_sums_of_an_episode(day: TaskSpec) -> None:
    plain, paid = TrainingVecEnv(day, 2), TrainingVecEnv(day, 2, accrual=Accrual(state="cBuf", price=1e-3))
    names = day.model_value.state_names
    plain.reset()
    paid.reset()
    for chosen in actions(day.steps, 2):
        before = paid.environment.simulation.x[:, names.index("cBuf")]
        (_, rewards, _, told), (_, with_growth, done, infos) = plain.step(chosen), paid.step(chosen)
        if not done.any():  # after that the next episode has begun
            grown = paid.environment.simulation.x[:, names.index("cBuf")] - before
            assert abs(grown).min() > 0
            np.testing.assert_allclose(with_growth - rewards, 1e-3 * grown, rtol=1e-3)
    assert done.all()
    assert infos[1]["episode"] == told[1]["episode"]


@pytest.mark.parametrize("price", [1e-3, (1e-3, -4e-3)])
def test_growth_of_several_states_is_paid_for_by_one_price_or_by_that_of_each(day: TaskSpec, price: float | tuple[float, ...]) -> None:
    plain, paid = TrainingVecEnv(day, 2), TrainingVecEnv(day, 2, accrual=Accrual(state=("cBuf", "cLeaf"), price=price))
    places = [day.model_value.state_index(name) for name in ("cBuf", "cLeaf")]
    plain.reset()
    paid.reset()
    before, chosen = paid.environment.simulation.x[:, places].copy(), actions(1, 2)[0]
    paid_more = paid.step(chosen)[1] - plain.step(chosen)[1]
    grown = paid.environment.simulation.x[:, places] - before
    assert abs(grown).min() > 0
    np.testing.assert_allclose(paid_more, (np.asarray(price) * grown).sum(axis=1), rtol=1e-3)


@pytest.mark.parametrize("price", [(1.0,), (1.0, 2.0, 3.0), (1.0, 0.0), 0.0])
def test_each_state_that_is_paid_for_has_a_price(price: float | tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="cBuf, mould: give one price for all, or one for each, and none that is 0"):
        Accrual(state=("cBuf", "mould"), price=price)


@pytest.mark.parametrize("state", ["cBuf", "nFruit1", "cRipe"])
def test_growth_of_a_state_of_trusses_is_paid_for_from_the_second_step_to_the_last(state: str) -> None:
    task = get_task("SpringTrusses-v1").replace(id="test/Trusses-v1", weather={"days": 1})
    plain, paid = TrainingVecEnv(task, 2), TrainingVecEnv(task, 2, accrual=Accrual(state=state, price=1e-3))
    place = task.model_value.state_index(state)
    plain.reset()
    paid.reset()
    start, earned = paid.environment.simulation.x[:, place].copy(), np.zeros(2)
    for chosen in actions(task.steps - 1, 2):
        earned += paid.step(chosen)[1] - plain.step(chosen)[1]
    grown = paid.environment.simulation.x[:, place] - start
    assert abs(grown).min() > 0
    np.testing.assert_allclose(earned, 1e-3 * grown, rtol=1e-3, atol=1e-6)


def test_words_of_a_state_that_is_paid_for_say_what_it_is_and_the_price_of_its_unit(day: TaskSpec) -> None:
    words = "In training, growth of cBuf was paid for as well: carbohydrates (CH2O) in the buffer"
    assert Accrual(state="cBuf", price=1.1e-5).in_words(day).startswith(words)
    assert Accrual(state="cBuf", price=1.1e-5).in_words(day).endswith(", 1.1e-05 of the reward for 1 mg m-2.")
    mould = Accrual(state="mould", price=2.0).in_words(get_task("SpringTrusses-v1"))
    assert mould == "In training, growth of mould was paid for as well: diseased share of the crop, 2 of the reward for 1."


def test_words_of_several_states_name_each(day: TaskSpec) -> None:
    words = Accrual(state=("xN", "xS"), price=45.0).in_words(get_task("Lettuce-v1"))
    assert words.startswith("In training, growth of xN and xS was paid for as well: non-structural dry matter; ")
    assert words.endswith("; structural dry matter, 45 of the reward for 1 kg m-2.")
    mould = Accrual(state=("cBuf", "mould"), price=(2.0, -12.0)).in_words(get_task("SpringTrusses-v1"))
    assert mould.startswith("In training, growth of cBuf and mould was paid for as well: carbohydrates (CH2O) in the buffer")
    assert mould.endswith(", 2 of the reward for 1 mg m-2; diseased share of the crop, -12 of the reward for 1.")


def test_growth_of_a_state_that_the_model_lacks_cannot_be_paid_for(day: TaskSpec) -> None:
    with pytest.raises(TrainingError, match=r"no state 'cBuff'\. Did you mean 'cBuf'"):
        TrainingVecEnv(day, 1, accrual=Accrual(state="cBuff", price=1.0))
    with pytest.raises(TrainingError, match=r"no state 'cBuff'"):
        TrainingVecEnv(day, 1, accrual=Accrual(state=("cLeaf", "cBuff"), price=1.0))


def test_the_end_of_the_season_is_no_time_limit(day: TaskSpec) -> None:
    env = TrainingVecEnv(day, 1)
    env.reset()
    for chosen in actions(day.steps, 1):
        *_, done, infos = env.step(chosen)
    assert done.all()
    assert infos[0]["TimeLimit.truncated"] is False


def test_an_environment_set_back_to_a_moment_repeats_what_followed(day: TaskSpec) -> None:
    env = TrainingVecEnv(day, 2)
    env.reset()
    for chosen in actions(10, 2):
        env.step(chosen)
    state = env.state()
    first = [env.step(chosen)[:2] for chosen in actions(40, 2)]
    other = TrainingVecEnv(day, 2)
    other.restore(state)
    for (observations, rewards), chosen in zip(first, actions(40, 2), strict=True):
        again = other.step(chosen)
        np.testing.assert_array_equal(observations, again[0])
        np.testing.assert_array_equal(rewards, again[1])


def test_every_season_has_the_next_seeds_of_those_for_training(day: TaskSpec) -> None:
    env = TrainingVecEnv(day, 2)
    met = []
    env.reset()
    for season in range(3):
        met += env.environment.simulation.seeds.tolist()
        if season == 1:  # another process goes on
            state, env = env.state(), TrainingVecEnv(day, 2)
            env.restore(state)
        for chosen in actions(day.steps, 2):
            env.step(chosen)
    assert met == list(range(FIRST_TRAINING_SEED, FIRST_TRAINING_SEED + 6))


def test_rows_of_a_batch_have_neither_attributes_nor_methods_of_their_own(day: TaskSpec) -> None:
    env = TrainingVecEnv(day, 2)
    with pytest.raises(AttributeError, match=r"'delta' cannot be set\. Change the task"):
        env.set_attr("delta", 0.1)
    with pytest.raises(AttributeError, match=r"'render' cannot be called\. Use `environment`"):
        env.env_method("render")
    env.close()
