"""Steps into the caller's arrays: the same bits as ``step``, nothing written where it should not be."""

from __future__ import annotations

import numpy as np
import pytest

from glbench.errors import ActionError, ShapeError, StepError
from glbench.kernel import Kernel, available
from glbench.model import TOMATO
from tests.kernel.known_steps import Array, KnownSteps


@pytest.fixture(scope="module", params=["compiled", "casadi"])
def any_kernel(request: pytest.FixtureRequest) -> Kernel:
    if request.param not in available():
        pytest.skip(f"the backend {request.param} does not work here")
    return Kernel(TOMATO, 900.0, backend=request.param, preset="fast")


def test_step_into_gives_the_bits_of_step(any_kernel: Kernel, steps_900: KnownSteps, p: Array) -> None:
    x, u, d = steps_900.x[:5], steps_900.u[:5], steps_900.d[:5]
    expected = any_kernel.step(x, u, d, p)
    out = np.empty_like(x)
    any_kernel.step_into(x, u, d, p, out)
    assert out.tobytes() == expected.tobytes()
    single = x[0].copy()
    any_kernel.step_into(single, u[0], d[0], p, single)
    assert single.tobytes() == expected[0].tobytes()


def test_step_into_checks_values_and_the_target(any_kernel: Kernel, steps_900: KnownSteps, p: Array) -> None:
    x, u, d = steps_900.x[0], steps_900.u[0], steps_900.d[0]
    with pytest.raises(ActionError):
        any_kernel.step_into(x, u + 2.0, d, p, np.empty(28))
    for target in (np.empty(27), np.empty(28, np.float32), np.empty((2, 28)), np.empty(56)[::2]):
        with pytest.raises(ShapeError, match="out must be"):
            any_kernel.step_into(x, u, d, p, target)


def test_a_bound_step_follows_its_arrays(any_kernel: Kernel, steps_900: KnownSteps, p: Array) -> None:
    x, u, d, out = steps_900.x[0].copy(), steps_900.u[0].copy(), steps_900.d[0].copy(), np.empty(28)
    step = any_kernel.bind(x, u, d, p, out)
    for row in (0, 3, 4):
        x[:], u[:], d[:] = steps_900.x[row], steps_900.u[row], steps_900.d[row]
        step()
        assert out.tobytes() == any_kernel.step(x, u, d, p).tobytes()


def test_a_step_bound_to_itself_goes_on(any_kernel: Kernel, steps_900: KnownSteps, p: Array) -> None:
    x, u, d = steps_900.x[:3].copy(), steps_900.u[:3].copy(), steps_900.d[:3].copy()
    expected = any_kernel.step(any_kernel.step(x, u, d, p), u, d, p)
    step = any_kernel.bind(x, u, d, p, x)
    step()
    step()
    assert x.tobytes() == expected.tobytes()


def test_a_bound_step_with_parameters_for_each_row(any_kernel: Kernel, steps_900: KnownSteps, p: Array) -> None:
    x, u, d, each = steps_900.x[:3].copy(), steps_900.u[:3].copy(), steps_900.d[:3].copy(), np.tile(p, (3, 1))
    each[1, 129:132] *= 1.2
    out = np.empty_like(x)
    any_kernel.bind(x, u, d, each, out)()
    assert out.tobytes() == any_kernel.step(x, u, d, each).tobytes()


def test_a_bound_step_that_fails_says_which_row(any_kernel: Kernel, steps_900: KnownSteps, p: Array) -> None:
    x, u, d = steps_900.x[:3].copy(), steps_900.u[:3].copy(), steps_900.d[:3].copy()
    expected = any_kernel.step(x, u, d, p)
    out = np.zeros_like(x)
    step = any_kernel.bind(x, u, d, p, out)
    x[1, 15] = np.nan
    with pytest.raises(StepError, match="row 1"):
        step()
    assert out[[0, 2]].tobytes() == expected[[0, 2]].tobytes()
    np.testing.assert_array_equal(out[1], x[1])


def test_arrays_that_would_have_to_be_copied_cannot_be_bound(any_kernel: Kernel, steps_900: KnownSteps, p: Array) -> None:
    x, u, d, out = steps_900.x[0].copy(), steps_900.u[0].copy(), steps_900.d[0].copy(), np.empty(28)
    with pytest.raises(ShapeError, match="u must be"):
        any_kernel.bind(x, u.astype(np.float32), d, p, out)
    with pytest.raises(ShapeError, match="x must be"):
        any_kernel.bind(np.empty((28, 2)).T, u, d, p, out)
    out.flags.writeable = False
    with pytest.raises(ShapeError, match="writeable"):
        any_kernel.bind(x, u, d, p, out)
