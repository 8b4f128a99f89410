"""Steps a processor second of the compiled PPO, as a multiple of those of the paper's recipe in Stable-Baselines3, in the same run.

``pytest benchmarks/test_learner.py -m slow --benchmark-json=learner.json`` keeps the figures under ``extra_info``. Both learn on the
paper's task as shipped, a rollout and what is learnt from it at a time, with one thread; a ratio below ``LEAST`` fails.
"""

from __future__ import annotations

import time
from typing import Any

import pytest

from glbench.kernel import why_not_compiled
from glbench.tasks import get_task

jax = pytest.importorskip("jax", reason="JAX is not installed (extra 'jax')")
pytest.importorskip("stable_baselines3", reason="training needs the extra 'train'")

from glbench.training import read_settings, shipped_settings  # noqa: E402
from glbench.training.algorithms import make_model  # noqa: E402
from glbench.training.compiled_settings import read_compiled_settings  # noqa: E402
from glbench.training.learner import Learner  # noqa: E402
from glbench.training.run import prepare_torch  # noqa: E402
from glbench.training.vec_env import Normalizer, TrainingVecEnv  # noqa: E402

TASK, UPDATES, LEAST = "Schiphol2010-Delta10-v1", 20, 25.0

pytestmark = [pytest.mark.slow, pytest.mark.train, pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))]


def test_the_compiled_ppo_learns_from_many_times_the_steps(benchmark: Any) -> None:
    task = get_task(TASK)
    paper = read_settings(shipped_settings("ppo"), "ppo", task.id)
    prepare_torch()
    greenhouses = TrainingVecEnv(task, paper.n_envs, first_seed=paper.first_env_seed, kernel_preset=paper.kernel_preset)
    model = make_model(paper, Normalizer(greenhouses, gamma=paper.gamma), 0, None)
    theirs_steps = paper.n_envs * paper.hyperparameters["n_steps"]
    began = time.process_time()
    model.learn(theirs_steps)
    theirs = theirs_steps / (time.process_time() - began)

    settings = read_compiled_settings(None, task)
    learner = Learner.of(task, settings)
    key, update = jax.random.key(0), jax.jit(learner.update)
    learning = update(jax.jit(learner.begin)(key), key, 0.0)[0]  # compiled before the clock starts

    def turn() -> None:
        nonlocal learning
        for _ in range(UPDATES):
            learning, reward = update(learning, key, 0.0)
        assert float(reward) == float(reward)

    began = time.process_time()
    benchmark.pedantic(turn, rounds=1)
    ours = UPDATES * settings.rollout / (time.process_time() - began)
    benchmark.extra_info.update(compiled_steps_a_second=ours, paper_steps_a_second=theirs, ratio=ours / theirs)
    greenhouses.close()
    assert ours / theirs > LEAST
