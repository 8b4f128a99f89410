"""One improvement of controls along linearised trajectories: what plans for a season and predictive control have in common.

All functions take one trajectory or a batch with leading axes; each has the bits that it has alone.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from glbench.arrays import Floats
from glbench.control.delivery import Delivery
from glbench.control.stage import StageReward, air_of
from glbench.env.air import AIR
from glbench.kernel.trajectories import Trajectory

LENGTHS = np.array([0.0, 0.15, 0.3, 0.45, 0.6, 0.8, 1.0, 1.25])
"""Shares of an improvement that are simulated."""
_FIRST_RATE, _LAST_RATE = 0.2, 0.005
"""Length of the gradient steps in trust regions, from the first to the last."""
_MOMENTUM, _MEMORY = 0.9, 0.97
"""Weights of the past in the mean of gradients and in that of their squares."""
_FLAT = 1e-3
"""Gradients of less than this share of the root mean square count as flat."""


def feasible(controls: ArrayLike, before: Floats, high: Floats, max_change: float) -> Floats:
    """The controls nearest to ``controls``, in the middle of what is possible, that keep bounds and change little enough.

    ``controls`` are ``(..., T, c)``, ``before`` those in force before the first step ``(..., c)``, ``high`` the upper bounds ``(c,)`` (the
    lower ones are 0), and ``max_change`` is the largest change in a step.
    """
    bounded = np.clip(np.asarray(controls, dtype=np.float64), 0.0, high)
    reach = int(np.ceil(1.0 / max_change))
    padded = np.pad(bounded, [*[(0, 0)] * (bounded.ndim - 2), (reach, reach), (0, 0)], mode="edge")
    steps = bounded.shape[-2]
    lowest, highest = bounded.copy(), bounded.copy()
    for shift in range(-reach, reach + 1):
        there, change = padded[..., reach + shift : reach + shift + steps, :], max_change * abs(shift)
        np.minimum(highest, there + change, out=highest)
        np.maximum(lowest, there - change, out=lowest)
    nearest: Floats = 0.5 * (lowest + highest)
    first = max_change * np.arange(1, min(steps, reach) + 1)[:, None]
    start, near = before[..., None, :], nearest[..., : len(first), :]
    near[...] = np.clip(near, start - first, start + first)
    return np.clip(nearest, 0.0, high)


def trust_region_step(
    stage: StageReward,
    linearisation: Trajectory,
    controls: Floats,
    calendar: Floats,
    radius: Floats,
    within: Callable[[Floats], Floats],
    *,
    steps: int,
    rate: float = _FIRST_RATE,
    start: Floats | None = None,
    x: Floats | None = None,
    end: Floats | None = None,
    delivery: Delivery | None = None,
) -> Floats:
    """Changes of the controls ``(..., T, c)`` that improve the rewards of linearised trajectories: gradient steps with momentum.

    The trajectories of ``linearisation`` are linearised in states and controls; ``controls`` and ``calendar`` are along them. Each control
    may move by ``radius`` ``(..., T, c)``; the gradient of one that may not is left out. ``within`` brings controls within bounds and the
    largest change. There are ``steps`` gradient steps, the first of length ``rate`` in ``radius``; the best controls of all of them count.
    ``start`` is the change to begin with ``(..., T, c)``, none by default, and ``x`` are the states where nothing changes
    ``(..., T + 1, s)``, by default those of ``linearisation``. ``end`` is what a unit of each state is worth at the end ``(..., s)``, in
    the unit of the reward, ``delivery`` what actuators deliver of ``controls``, which are commands then; by default all of it.
    """
    still, delivered = linearisation.x if x is None else x, controls if delivery is None else delivery(controls) + delivery.rest
    move = best = np.zeros_like(controls) if start is None else start
    most = np.full(controls.shape[:-2], -np.inf)
    mean, square, flat = np.zeros_like(controls), np.zeros_like(controls), np.zeros(())
    for number in range(1, steps + 1):
        effect = move if delivery is None else delivery(move)
        changes = linearisation.push(effect)
        values, slopes = stage.gradient(still + changes, delivered + effect, calendar)
        total, cotangents = values.reward.sum(axis=-1), slopes.states
        if end is not None:
            total = total + (changes[..., -1, :] * end).sum(axis=-1)
            cotangents[..., -1, :] += end
        better = total > most
        best, most = np.where(better[..., None, None], move, best), np.maximum(most, total)
        gradient = slopes.controls + linearisation.pull(cotangents).u
        gradient = np.where(radius > 0.0, gradient if delivery is None else delivery.pull(gradient), 0.0)
        if number == 1:
            size = np.sqrt(np.mean((gradient**2).reshape(*gradient.shape[:-2], -1), axis=-1))
            flat = np.where(size > 0.0, _FLAT * size, 1.0)[..., None, None]
        mean = _MOMENTUM * mean + (1.0 - _MOMENTUM) * gradient
        square = _MEMORY * square + (1.0 - _MEMORY) * gradient**2
        direction = mean / (1.0 - _MOMENTUM**number) / (np.sqrt(square / (1.0 - _MEMORY**number)) + flat)
        length = rate * (1.0 - number / steps) ** 2 + _LAST_RATE
        move = np.clip(move + length * radius * direction, -radius, radius)
        move = within(controls + move) - controls
    return best


def radius_shares(stage: StageReward, linearisation: Trajectory) -> Floats:
    """Shares of a trust region ``(..., T, c)``: none moves the air by more than from limit to limit; of a scheduled control, 0."""
    task, du = stage.task, linearisation.du
    limits = dict(task.constraints.items())
    model = task.model_value
    effect = np.zeros((*du.shape[:-2], du.shape[-1]))
    effect[..., [*task.scheduled_places.values()]] = np.inf
    if model.air is None or not limits:
        return np.where(effect > 0.0, 0.0, 1.0)
    gradient = air_of(model, linearisation.x[..., 1:, :]).gradient
    places = [model.state_index(name) for name in model.air]
    for quantity, name in enumerate(AIR):
        if name in limits:
            # State by state, not as a product of matrices: the libraries for those differ in their last bits.
            slope = sum(gradient[..., quantity, place, None] * du[..., place, :] for place in places)
            effect += np.abs(slope) / (limits[name].high - limits[name].low)
    return np.minimum(1.0, 1.0 / (effect + 1e-9))
