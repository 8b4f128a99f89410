"""Decisions as arithmetic, on arrays or recorded values: a condition is 1.0 where it holds and 0.0 where it does not.

A tape has no comparisons (``glbench.kernel.tape``). These build them from its operations, exactly: a difference of two numbers is 0
only when they are equal. ``select`` needs finite numbers on both sides.
"""

from __future__ import annotations

from typing import Any

import numpy as np


def below(a: Any, b: Any) -> Any:
    """Whether a < b."""
    return np.maximum(np.sign(b - a), 0.0)


def at_least(a: Any, b: Any) -> Any:
    """Whether a >= b."""
    return 1.0 - below(a, b)


def negation(a: Any) -> Any:
    """Whether the condition a does not hold."""
    return 1.0 - a


def both(a: Any, b: Any) -> Any:
    """Whether the conditions a and b hold."""
    return a * b


def either(a: Any, b: Any) -> Any:
    """Whether one of the conditions a and b holds."""
    return np.maximum(a, b)


def select(condition: Any, a: Any, b: Any) -> Any:
    """The number a where the condition holds, else b."""
    return condition * a + (1.0 - condition) * b


def within(value: Any, low: Any, high: Any) -> Any:
    """The value, kept between low and high; high where they contradict each other."""
    return np.minimum(np.maximum(value, low), high)


def share(value: Any, start: Any, full: Any) -> Any:
    """From 0 at ``start`` to 1 at ``full``, straight in between; ``full`` may be the lower one, never the same."""
    return within((value - start) / (full - start), 0.0, 1.0)


def switch(state: Any, on: Any, off: Any) -> Any:
    """A switch with hysteresis: 1 where ``on`` holds, 0 where only ``off`` does, else the ``state`` that it had."""
    return either(on, both(state, negation(off)))


def held_switch(state: Any, steps: Any, wanted: Any, least: float) -> tuple[Any, Any]:
    """A switch that stays as it is for at least ``least`` steps: its new state, and for how many steps it will have had it.

    ``steps`` is that number before; a switch that was never thrown has had its state for ``least`` steps.
    """
    free = at_least(steps, least)
    now = select(free, wanted, state)
    changed = (now - state) * (now - state)
    return now, select(changed, 1.0, steps + 1.0)
