"""Shared by the kernel's tests: known steps, and kernels that are slow to make."""

from __future__ import annotations

import pytest

from glbench.kernel import Kernel
from glbench.model import TOMATO, default_parameters
from tests.kernel.known_steps import Array, KnownSteps, known_steps


@pytest.fixture(scope="session")
def steps_300() -> KnownSteps:
    return known_steps(300)


@pytest.fixture(scope="session")
def steps_900() -> KnownSteps:
    return known_steps(900)


@pytest.fixture(scope="session")
def p() -> Array:
    return default_parameters()


@pytest.fixture(scope="session")
def kernel() -> Kernel:
    """The kernel that works everywhere, 900 s."""
    return Kernel(TOMATO, 900.0, backend="casadi")


@pytest.fixture
def leafless(steps_900: KnownSteps) -> Array:
    """A state that no integrator can leave: without leaves, the CO2 compensation point is infinite."""
    x: Array = steps_900.x[0].copy()
    x[23] = 0.0
    return x
