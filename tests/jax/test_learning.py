"""A learner that knows gymnax alone runs on the door, whole trainings under jit and vmap."""

from __future__ import annotations

import numpy as np
import pytest

from glbench.kernel import why_not_compiled
from glbench.tasks import TaskSpec

jax = pytest.importorskip("jax", reason="JAX is not installed (extra 'jax')")
pytestmark = [pytest.mark.train, pytest.mark.slow, pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))]

from glbench.jax import Environment  # noqa: E402
from tests.jax.ppo import Settings, make_train  # noqa: E402


def test_a_learner_in_the_manner_of_purejaxrl_learns(day: TaskSpec) -> None:
    environment = Environment(day, seeds=range(10_000, 10_008), places=8)
    train = jax.jit(jax.vmap(make_train(environment, Settings())))
    keys = jax.random.split(jax.random.key(0), 2)
    rewards = np.asarray(train(keys))
    assert rewards.shape == (2, 20)
    assert (rewards[:, -5:].mean(axis=1) > rewards[:, :2].mean(axis=1) + 0.02).all(), rewards
    assert np.array_equal(train(keys), rewards)
