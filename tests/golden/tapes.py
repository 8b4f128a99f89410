"""Numbers of tasks' tapes on fixed inputs that hold zeros of both signs, ties, infinities and NaN.

``tapes.npz`` holds what NumPy played when tapes were recorded operation by operation; nothing writes it again.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from glbench.env.air import read_air
from glbench.env.program import make_program
from glbench.tasks import get_task

ROOT = Path(__file__).resolve().parents[2]
FILE = Path(__file__).with_suffix(".npz")
TASKS = ("Schiphol2010-Delta10-v1", "Spring-v1", "SpringEnergy-v1", "Lettuce-v1", "WinterLED-v1", "tasks/drafts/springsetpoints-v1.toml")
TAPES = ("actuation", "followers", "update", "outcome")
ROWS = 48
SPECIAL = np.array([0.0, -0.0, 1.0, -1.0, 0.5, 20.0, 100.0, np.inf, -np.inf, np.nan, 5e-324, 1e308])

Array = np.ndarray[Any, Any]


def inputs(source: str, index: int) -> Array:
    """Values of an input ``(ROWS,)``: from all of a number line, from a range of usual states, then special ones."""
    rng = np.random.default_rng([*source.encode(), index])
    third = ROWS // 3
    values = np.concatenate([rng.normal(0.0, 10.0, third), rng.uniform(0.0, 1.0, third), rng.choice(SPECIAL, third)])
    values[third : third + 4] *= 1000.0
    return values


def tapes(task: str) -> dict[str, Any]:
    """The tapes of a task."""
    program = make_program(get_task(ROOT / task if task.endswith(".toml") else task).scored)[0]
    return {name: getattr(program, name) for name in TAPES}


def played(tape: Any) -> tuple[list[str], Array]:
    """Names of a tape's outputs, in order, and their values ``(outputs, ROWS)``; every NaN is the same one."""
    found = {f"{target} {index}": values for target, index, values in tape.play(inputs)}
    names = sorted(found)
    values = np.array([np.broadcast_to(found[name], ROWS) for name in names]).reshape(len(names), ROWS)
    return names, np.where(np.isnan(values), np.nan, values)


def air() -> Array:
    """The air that follows from special temperatures, densities and pressures ``(3, ROWS)``."""
    values = read_air(*(inputs("after", index) for index in range(3)))
    return np.where(np.isnan(values), np.nan, values)
