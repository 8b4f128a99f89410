"""What actuators deliver of commands: in a run whose faults are known, and as far as one can expect.

In a run whose faults and wind are known it is a linear map of a plan's commands:

    d(k) = a(k) d(k - 1) + b(k) c(k)        d(-1) = 0

with a and b of each control from ``glbench.env.actuators``: an ideal one has a = 0 and b = 1, one that sticks a = 1 and b = 0. Plans are
searched among commands; gradients come back through the transposed map.

Of the steps to come nobody knows the faults. An actuator that was off by e in the step just past, when it delivered d, is expected to
deliver in the k-th step from then

    d(k) = w(k) d + (1 - w(k)) c(k)         w(k) = e^2 / (e^2 + OFF^2) exp(-k h / T)

with the mean time T of its faults: what is far off hangs where it is, and is repaired in time. This is a filter's estimate at hand, no
theory of faults; docs/adr/0020-predictive-control.md has what it is worth.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import Floats
from glbench.env.actuators import WIND, Actuators, fault
from glbench.env.random import uniforms
from glbench.env.scenario import RunScenarios, Scenes
from glbench.env.uncertainty import stream_key
from glbench.tasks import TaskSpec

VARIANCE = {"sticks": 1.0 / 6.0, "fails": 1.0 / 3.0}
"""Mean square of what an actuator is off during a fault: of the difference of two numbers drawn evenly from 0 to 1, and of one of them."""
OFF = 0.15
"""Off by as much, an actuator has a fault as likely as not. A choice: without one, shipped actuators fall short by up to 0.2."""


@dataclass(frozen=True, eq=False)
class Delivery:
    """The map from commands to what is delivered."""

    carry: Floats
    gain: Floats
    """``carry`` and ``gain``: a and b ``(T, c)``."""
    rest: Floats | float = 0.0
    """What is delivered besides, whatever the commands are."""

    @classmethod
    def ahead(cls, delivered: Floats, commands: Floats, fading: Floats) -> Delivery:
        """That of the coming steps in ``n`` runs, from what was ``delivered`` of ``commands`` ``(n, c)`` in the step just past.

        ``fading`` is what is left ``(T, c)``, by step, of the chance that a fault lasts.
        """
        off = (delivered - commands) ** 2
        hangs = (off / (off + OFF**2))[:, None] * fading
        return cls(np.zeros_like(fading), 1.0 - hangs, hangs * delivered[:, None])

    @classmethod
    def of(cls, scenarios: RunScenarios, scene: Scenes, seed: int, d: Floats) -> Delivery | None:
        """That of the run with ``seed``, ``scene`` and disturbances ``d`` ``(T, disturbances)``; ``None`` where all actuators are ideal."""
        actuators, task, draws = scenarios.actuators, scenarios.task, scenarios.actuator_draws
        if not actuators.actuators:
            return None
        key = np.array([stream_key(task.scenario, seed, Actuators.STREAM)], np.uint64)
        numbers = iter(uniforms(key, np.arange(task.steps)[None], actuators.numbers)[0].T.tolist())
        carry = np.zeros((task.steps, len(task.model_value.controls)))
        gain = np.ones_like(carry)
        for actuator in actuators.actuators:
            faults = {}
            for kind, chances in actuator.faults.items():
                course = accumulate(next(numbers), partial(fault, chances=chances), initial=0.0)
                faults[kind] = np.array([*course])[1:]
            trait = scene.traits[0, draws.trait + actuators.short.index(actuator)] if actuator.shortfall else 1.0
            most = actuator.most(trait, d[:, WIND])
            for column, before, command in ((carry, 1.0, 0.0), (gain, 0.0, 1.0)):
                column[:, actuator.place] = actuator.delivered(before, command, most, faults)
        return cls(carry, gain)

    def of_rows(self, rows: NDArray[np.intp]) -> Delivery:
        """That of some runs, of one that has runs."""
        return Delivery(self.carry, self.gain[rows], self.rest if isinstance(self.rest, float) else self.rest[rows])

    def __call__(self, commands: Floats) -> Floats:
        """What is delivered of commands ``(..., T, c)``, without ``rest``; of a change of commands, what it changes."""
        return _accumulated(self.carry, self.gain * commands)

    def pull(self, slopes: Floats) -> Floats:
        """Derivatives with respect to commands ``(..., T, c)`` from those with respect to what is delivered."""
        back = np.concatenate([np.zeros_like(self.carry[:1]), self.carry[:0:-1]])
        return self.gain * _accumulated(back, slopes[..., ::-1, :])[..., ::-1, :]


class ExpectedDelivery:
    """What the actuators of a task deliver in runs while none has a fault, and how far off it may be.

    ``places`` are the controls whose actuators are not ideal. Of each, ``spread`` is the standard deviation of what it delivers from what
    is expected (over time with and without faults, with commands and positions spread evenly), and ``hours`` the mean time of its faults,
    in which the deviation is forgotten to 1/e; without faults, that of the run.
    """

    def __init__(self, task: TaskSpec) -> None:
        self._actuators, self._count = Actuators.of(task).actuators if task.actuators else (), len(task.model_value.controls)
        self.places, self.spread, self.hours = [one.place for one in self._actuators], np.zeros(0), np.zeros(0)
        for one in self._actuators:
            share = {kind: begins / (begins + 1.0 - lasts) for kind, (begins, lasts) in one.faults.items()}
            variance = one.shortfall**2 / 36.0 + sum(share[kind] * VARIANCE[kind] for kind in share)
            hours = [task.step_seconds / 3600.0 / (1.0 - lasts) for _, lasts in one.faults.values()]
            self.spread = np.append(self.spread, np.sqrt(variance))
            self.hours = np.append(self.hours, max(hours, default=task.steps * task.step_seconds / 3600.0))

    def reset(self, n: int) -> None:
        """Begin with ``n`` new runs."""
        self._delivered = np.zeros((n, self._count))

    def __call__(self, commands: Floats, d: Floats) -> Floats:
        """What is delivered of commands ``(n, c)`` in the coming step with disturbances ``d`` ``(n, d)``."""
        delivered = commands.copy()
        for one in self._actuators:
            most = one.most(1.0 - one.shortfall / 2.0, d[:, WIND])
            delivered[:, one.place] = one.delivered(self._delivered[:, one.place], commands[:, one.place], most, {})
        self._delivered = delivered
        return delivered.copy()


def _accumulated(carry: Floats, values: Floats) -> Floats:
    """y(k) = carry(k) y(k - 1) + values(k), in doubling strides: a step of numpy for all k, as often as the powers of 2 below T."""
    carry, values, stride = carry.copy(), values.copy(), 1
    while stride < len(carry) and carry[stride:].any():
        values[..., stride:, :] += carry[stride:] * values[..., :-stride, :]
        carry[stride:] *= carry[:-stride].copy()
        stride *= 2
    return values
