"""What is stepped: states, controls and weather of real seasons, the same for every method."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from glbench.kernel import Kernel
from glbench.model import CONTROL_NAMES, TOMATO, default_parameters, initial_state
from glbench.weather import disturbances, load_weather

Array = NDArray[np.float64]
Controls = Literal["walk", "jump"]

LARGEST_CHANGE = 0.1
"""Of a control in one step, when controls walk."""

_SEASON_DAYS = 2


@dataclass(frozen=True)
class Course:
    """Consecutive steps of one greenhouse: controls (steps, 6), weather (steps, 10), state at the start (28,)."""

    controls: Array
    weather: Array
    start: Array


@dataclass(frozen=True)
class Points:
    """Steps that have nothing to do with one another: states (n, 28), controls (n, 6), weather (n, 10)."""

    x: Array
    u: Array
    d: Array

    def parts(self, rows: int) -> tuple[Points, ...]:
        """The same points, ``rows`` at a time; what is left over is left out."""
        starts = range(0, len(self.x) - rows + 1, rows)
        return tuple(Points(self.x[i : i + rows], self.u[i : i + rows], self.d[i : i + rows]) for i in starts)

    def resized(self, rows: int) -> Points:
        """``rows`` of them, repeated when there are fewer."""
        x, u, d = (np.ascontiguousarray(np.resize(a, (rows, a.shape[1]))) for a in (self.x, self.u, self.d))
        return Points(x, u, d)


def controls_of(kind: Controls, steps: int, seed: int) -> Array:
    """Controls (steps, 6) that walk by at most ``LARGEST_CHANGE`` a step within 0..1, or jump: 0 or 1, redrawn at every step."""
    generator = np.random.default_rng([seed, ("walk", "jump").index(kind)])
    if kind == "jump":
        return generator.integers(0, 2, (steps, len(CONTROL_NAMES))).astype(np.float64)
    changes = generator.uniform(-LARGEST_CHANGE, LARGEST_CHANGE, (steps, len(CONTROL_NAMES)))
    controls = np.empty_like(changes)
    now = generator.uniform(0.0, 1.0, len(CONTROL_NAMES))
    for step, change in enumerate(changes):
        now = np.minimum(np.maximum(now + change, 0.0), 1.0)
        controls[step] = now
    return controls


@cache
def course(kind: Controls, step_seconds: float, start: dt.date, days: float, seed: int = 0) -> Course:
    """A greenhouse at Schiphol from ``start``, with a grown crop, under controls of that kind."""
    steps = round(days * 86400.0 / step_seconds)
    weather = disturbances(load_weather("schiphol"), start=start, steps=steps, step_seconds=step_seconds).values
    return Course(controls_of(kind, steps, seed), weather, initial_state(weather[0], 16.5, default_parameters()))


@cache
def points(kind: Controls, step_seconds: float, count: int = 512, seed: int = 0) -> Points:
    """``count`` steps out of all months of a year, with the states that controls of that kind lead to."""
    kernel = Kernel(TOMATO, step_seconds, preset="standard")
    parameters = default_parameters()
    found: list[tuple[Array, Array, Array]] = []
    for month in range(1, 13):
        one = course(kind, step_seconds, dt.date(2010, month, 1), _SEASON_DAYS, seed + month)
        x = one.start
        for u, d in zip(one.controls, one.weather, strict=True):
            found.append((x, u, d))
            x = kernel.step(x, u, d, parameters)
    pick = np.random.default_rng(seed).choice(len(found), count, replace=len(found) < count)
    x, u, d = (np.stack([found[i][k] for i in pick]) for k in range(3))
    return Points(x, u, d)
