"""What the actuators of one run deliver of a plan's commands: a linear map, once its faults and its wind are known.

    d(k) = a(k) d(k - 1) + b(k) c(k)        d(-1) = 0

with a and b of each control from ``glbench.env.actuators``: an ideal one has a = 0 and b = 1, one that sticks a = 1 and b = 0. Plans are
searched among commands; gradients come back through the transposed map.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import accumulate
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glbench.env.actuators import WIND, Actuators, fault
from glbench.env.random import uniforms
from glbench.env.uncertainty import stream_key

if TYPE_CHECKING:
    from glbench.env.scenario import RunScenarios, Scenes

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Delivery:
    """The map from commands to what is delivered.

    Attributes
    ----------
    carry, gain
        a and b ``(T, c)``.
    """

    carry: Floats
    gain: Floats

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

    def __call__(self, commands: Floats) -> Floats:
        """What is delivered of commands ``(..., T, c)``."""
        return _accumulated(self.carry, self.gain * commands)

    def pull(self, slopes: Floats) -> Floats:
        """Derivatives with respect to commands ``(..., T, c)`` from those with respect to what is delivered."""
        back = np.concatenate([np.zeros_like(self.carry[:1]), self.carry[:0:-1]])
        return self.gain * _accumulated(back, slopes[..., ::-1, :])[..., ::-1, :]


def _accumulated(carry: Floats, values: Floats) -> Floats:
    """y(k) = carry(k) y(k - 1) + values(k), in doubling strides: a step of numpy for all k, as often as the powers of 2 below T."""
    carry, values, stride = carry.copy(), values.copy(), 1
    while stride < len(carry) and carry[stride:].any():
        values[..., stride:, :] += carry[stride:] * values[..., :-stride, :]
        carry[stride:] *= carry[:-stride].copy()
        stride *= 2
    return values
