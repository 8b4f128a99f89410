"""A row has the same bits alone, in any batch, in any order, with any number of threads and after any history."""

from __future__ import annotations

import numpy as np
import pytest

from glbench.kernel import Kernel
from glbench.model import TOMATO
from tests.kernel.known_steps import Array, KnownSteps


@pytest.fixture(scope="module")
def perturbed(p: Array) -> Array:
    """A parameter vector for each of the 32 known steps of 900 s."""
    return np.asarray(p * np.random.default_rng(5).uniform(0.97, 1.03, (32, p.size)))


@pytest.fixture(scope="module")
def whole(kernel: Kernel, steps_900: KnownSteps, perturbed: Array) -> Array:
    return kernel.step(steps_900.x, steps_900.u, steps_900.d, perturbed)


def test_a_row_alone_equals_the_row_in_a_batch(kernel: Kernel, steps_900: KnownSteps, perturbed: Array, whole: Array) -> None:
    alone = [kernel.step(*row) for row in zip(steps_900.x, steps_900.u, steps_900.d, perturbed, strict=True)]
    assert np.array_equal(alone, whole)


def test_the_order_of_rows_does_not_matter(kernel: Kernel, steps_900: KnownSteps, perturbed: Array, whole: Array) -> None:
    order = np.random.default_rng(1).permutation(32)
    mixed = kernel.step(steps_900.x[order], steps_900.u[order], steps_900.d[order], perturbed[order])
    assert np.array_equal(mixed, whole[order])


def test_what_was_stepped_before_does_not_matter(
    kernel: Kernel, steps_900: KnownSteps, perturbed: Array, whole: Array, leafless: Array, p: Array
) -> None:
    for before in (steps_900.x[9], leafless, steps_900.x[20]):
        kernel.try_step(before[None], steps_900.u[9], steps_900.d[30], p)
        again = kernel.step(steps_900.x[4], steps_900.u[4], steps_900.d[4], perturbed[4])
        assert np.array_equal(again, whole[4])


def test_two_kernels_in_turn_do_not_disturb_each_other(kernel: Kernel, steps_900: KnownSteps, p: Array) -> None:
    other = Kernel(TOMATO, 300.0, backend="casadi")
    x, u, d = steps_900.x[:6], steps_900.u[:6], steps_900.d[:6]
    expected = kernel.step(x, u, d, p)
    for row in range(6):
        other.step(x[row], u[row], d[row], p)
        assert np.array_equal(kernel.step(x[row], u[row], d[row], p), expected[row])


def test_shared_parameters_equal_repeated_ones(kernel: Kernel, steps_900: KnownSteps, p: Array) -> None:
    x, u, d = steps_900.x[:5], steps_900.u[:5], steps_900.d[:5]
    expected = kernel.step(x, u, d, np.tile(p, (5, 1)))
    assert np.array_equal(kernel.step(x, u, d, p), expected)
