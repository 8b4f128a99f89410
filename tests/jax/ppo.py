"""PPO in one compiled function, in the manner of PureJaxRL: it knows of an environment what gymnax says of it, and nothing of glbench."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp


class Settings(NamedTuple):
    envs: int = 32
    steps: int = 24
    updates: int = 20
    epochs: int = 4
    batches: int = 4
    width: int = 32
    rate: float = 3e-3
    gamma: float = 0.95
    trace: float = 0.9
    clip: float = 0.2


def make_network(key: Any, sizes: list[int], last: float) -> list[tuple[Any, Any]]:
    scales = [2.0**0.5] * (len(sizes) - 2) + [last]
    keys = jax.random.split(key, len(scales))
    pairs = pairwise(sizes)
    return [
        (jax.nn.initializers.orthogonal(scale)(k, pair, jnp.float32), jnp.zeros(pair[1]))
        for k, pair, scale in zip(keys, pairs, scales, strict=True)
    ]


def apply(network: list[tuple[Any, Any]], x: Any) -> Any:
    for weights, bias in network[:-1]:
        x = jnp.tanh(x @ weights + bias)
    return x @ network[-1][0] + network[-1][1]


def log_likelihood(mean: Any, spread: Any, action: Any) -> Any:
    return (-0.5 * ((action - mean) / jnp.exp(spread)) ** 2 - spread).sum(-1)


def make_train(env: Any, s: Settings) -> Callable[[Any], Any]:
    """A function of a key that trains, and gives the mean reward of each update ``(updates,)``."""
    env_params = env.default_params
    columns, actions = env.observation_space(env_params).shape[0], env.action_space(env_params).shape[0]
    low, high = env.observation_space(env_params).low, env.observation_space(env_params).high

    def seen(observation: Any) -> Any:
        return 2.0 * (observation - low) / (high - low) - 1.0

    def collect(weights: Any, runner: Any, key: Any) -> Any:
        state, observation = runner
        keys = jax.random.split(key, s.envs + 1)
        mean, x = apply(weights["actor"], seen(observation)), seen(observation)
        action = mean + jnp.exp(weights["spread"]) * jax.random.normal(keys[0], mean.shape)
        step = jax.vmap(env.step, in_axes=(0, 0, 0, None))
        observation, state, reward, done, info = step(keys[1:], state, action, env_params)
        value = apply(weights["critic"], x)[:, 0]
        told = (x, action, log_likelihood(mean, weights["spread"], action), value, reward, done, info)
        return (state, observation), told

    def advantages(told: Any, last: Any) -> Any:
        def back(carry: Any, now: Any) -> Any:
            advantage, following = carry
            value, reward, done = now
            delta = reward + s.gamma * following * (1.0 - done) - value
            advantage = delta + s.gamma * s.trace * (1.0 - done) * advantage
            return (advantage, value), advantage

        return jax.lax.scan(back, (jnp.zeros(s.envs), last), told, reverse=True)[1]

    def loss(weights: Any, batch: Any) -> Any:
        x, action, before, gain, target = batch
        gain = (gain - gain.mean()) / (gain.std() + 1e-8)
        ratio = jnp.exp(log_likelihood(apply(weights["actor"], x), weights["spread"], action) - before)
        bounded = jnp.clip(ratio, 1.0 - s.clip, 1.0 + s.clip)
        return ((apply(weights["critic"], x)[:, 0] - target) ** 2).mean() - jnp.minimum(ratio * gain, bounded * gain).mean()

    def adam(weights: Any, moments: Any, gradient: Any) -> Any:
        first, second, count = moments
        first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, first, gradient)
        second = jax.tree.map(lambda v, g: 0.999 * v + 0.001 * g * g, second, gradient)
        count, rate = count + 1, s.rate * jnp.sqrt(1.0 - 0.999 ** (count + 1)) / (1.0 - 0.9 ** (count + 1))
        moved = jax.tree.map(lambda w, m, v: w - rate * m / (jnp.sqrt(v) + 1e-8), weights, first, second)
        return moved, (first, second, count)

    def update(carry: Any, key: Any) -> Any:
        weights, moments, runner = carry
        keys = jax.random.split(key, s.steps + s.epochs)
        runner, told = jax.lax.scan(lambda runner, k: collect(weights, runner, k), runner, keys[: s.steps])
        x, action, before, value, reward, done, _ = told
        gain = advantages((value, reward, done), apply(weights["critic"], seen(runner[1]))[:, 0])
        flat = jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), (x, action, before, gain, gain + value))

        def minibatch(learner: Any, rows: Any) -> Any:
            gradient = jax.grad(loss)(learner[0], jax.tree.map(lambda a: a[rows], flat))
            return adam(*learner, gradient), None

        def epoch(learner: Any, k: Any) -> Any:
            order = jax.random.permutation(k, s.steps * s.envs).reshape(s.batches, -1)
            return jax.lax.scan(minibatch, learner, order)

        (weights, moments), _ = jax.lax.scan(epoch, (weights, moments), keys[s.steps :])
        return (weights, moments, runner), reward.mean()

    def train(key: Any) -> Any:
        keys = jax.random.split(key, 4)
        weights = {
            "actor": make_network(keys[0], [columns, s.width, s.width, actions], 0.01),
            "critic": make_network(keys[1], [columns, s.width, s.width, 1], 1.0),
            "spread": jnp.full(actions, -0.7),
        }
        observation, state = jax.vmap(env.reset, in_axes=(0, None))(jax.random.split(keys[2], s.envs), env_params)
        nothing = jax.tree.map(jnp.zeros_like, weights)
        begin = weights, (nothing, nothing, 0), (state, observation)
        return jax.lax.scan(update, begin, jax.random.split(keys[3], s.updates))[1]

    return train
