"""What the actuators of one run deliver of a plan's commands: a linear map, once its faults and its wind are known.

    d(k) = a(k) d(k - 1) + b(k) c(k)        d(-1) = 0

with a and b of each control from ``glbench.env.actuators``: an ideal one has a = 0 and b = 1, one that sticks a = 1 and b = 0. Plans are
searched among commands; gradients come back through the transposed map.
"""

from __future__ import annotations

from dataclasses import dataclass
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
    left, gain
        a and b ``(T, c)``.
    """

    left: Floats
    gain: Floats

    @classmethod
    def of(cls, scenarios: RunScenarios, scene: Scenes, seed: int, d: Floats) -> Delivery | None:
        """That of the run with ``seed``, ``scene`` and disturbances ``d`` ``(T, disturbances)``; ``None`` where all actuators are ideal."""
        actuators, task, draws = scenarios.actuators, scenarios.task, scenarios.actuator_draws
        if not actuators.actuators:
            return None
        key = np.array([stream_key(task.scenario, seed, Actuators.STREAM)], np.uint64)
        numbers = uniforms(key, np.arange(task.steps)[None], actuators.numbers)[0].T
        faults = {}
        for (actuator, kind), column in zip(actuators.faults, numbers.tolist(), strict=True):
            course, now = np.empty(task.steps), 0.0
            for step, number in enumerate(column):
                course[step] = now = fault(now, number, actuator.faults[kind])
            faults[actuator.name, kind] = course
        left, gain = np.zeros((task.steps, len(task.model_value.controls))), np.ones((task.steps, len(task.model_value.controls)))
        for actuator in actuators.actuators:
            kept = scene.traits[0, draws.trait + actuators.short.index(actuator)] if actuator.shortfall else 1.0
            most, own = actuator.most(kept, d[:, WIND]), {kind: faults[actuator.name, kind] for kind in actuator.faults}
            left[:, actuator.place] = actuator.delivered(1.0, 0.0, most, own)
            gain[:, actuator.place] = actuator.delivered(0.0, 1.0, most, own)
        return cls(left, gain)

    def __call__(self, commands: Floats) -> Floats:
        """What is delivered of commands ``(..., T, c)``."""
        return _carried(self.left, self.gain * commands)

    def pull(self, slopes: Floats) -> Floats:
        """Derivatives with respect to commands ``(..., T, c)`` from those with respect to what is delivered."""
        left = np.zeros_like(self.left)
        left[1:] = self.left[:0:-1]
        return self.gain * _carried(left, slopes[..., ::-1, :])[..., ::-1, :]


def _carried(left: Floats, values: Floats) -> Floats:
    """y(k) = left(k) y(k - 1) + values(k), in doubling strides: a step of numpy for all k, as often as the powers of 2 below T."""
    left, values, stride = left.copy(), values.copy(), 1
    while stride < len(left) and left[stride:].any():
        values[..., stride:, :] += left[stride:] * values[..., :-stride, :]
        left[stride:] *= left[:-stride].copy()
        stride *= 2
    return values
