"""A model whose step is part of it: the backend that steps it, its derivatives, and the digest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from glbench.errors import GlbenchError, ShapeError, StepError, UnknownNameError
from glbench.kernel import Kernel, RolloutError, Rows, available, built_libraries, will_compile
from glbench.model import LETTUCE_CLASSIC, TOMATO, StepMap, with_violation_meters
from glbench.model.digest import digest_of

STEP = 1800.0
SIZES = {"x": np.array([1e-3, 1e-4, 1.0, 1e-3]), "u": np.full(3, 0.1), "d": np.array([50.0, 1.0, 100.0, 50.0]), "p": 0.01}
"""Steps of which a millionth is taken for differences."""


@pytest.fixture(scope="module")
def rows() -> Rows:
    """States, controls, weather and parameters of 40 steps within the ranges, a third of them at night."""
    rng, n = np.random.default_rng(5), 40
    x = np.array([0.003, 4e-4, 8.0, 3e-3]) + np.array([0.2, 1e-3, 16.0, 8e-3]) * rng.random((n, 4))
    d = np.zeros((n, 10))
    d[:, :4] = np.array([50.0, -5.0, 400.0, 650.0]) + np.array([700.0, 25.0, 1200.0, 300.0]) * rng.random((n, 4))
    d[::3, 0] = 0.0
    p = LETTUCE_CLASSIC.parameters.default() * (1.0 + 0.05 * rng.uniform(-1.0, 1.0, (n, 23)))
    return Rows(x, rng.uniform(0.2, 0.8, (n, 3)), d, p)


@pytest.fixture(scope="module")
def kernel() -> Kernel:
    return Kernel(LETTUCE_CLASSIC, STEP)


def test_it_is_chosen_by_itself_and_nothing_is_built(kernel: Kernel) -> None:
    assert kernel.backend == "discrete"
    assert available(LETTUCE_CLASSIC) == ("discrete",)
    assert not will_compile(LETTUCE_CLASSIC)
    assert not built_libraries(LETTUCE_CLASSIC, LETTUCE_CLASSIC.parameters.default(), for_plans=True)
    assert "rk4, 4 steps" in str(kernel.describe()["method"])
    with pytest.raises(UnknownNameError, match=r"lettuce-classic-1\.0\.0 is a map.*'discrete'.*not 'casadi'"):
        Kernel(LETTUCE_CLASSIC, STEP, backend="casadi")
    with pytest.raises(UnknownNameError, match="no backend 'discrete'"):
        Kernel(TOMATO, STEP, backend="discrete")
    with pytest.raises(UnknownNameError, match="no preset 'fasst'"):
        Kernel(LETTUCE_CLASSIC, STEP, preset="fasst")


def test_a_row_has_the_same_bits_alone_in_a_batch_and_with_any_preset(kernel: Kernel, rows: Rows) -> None:
    together = kernel.step(*rows)
    for row in range(0, len(together), 7):
        alone = Kernel(LETTUCE_CLASSIC, STEP, preset="fast").step(*(table[row] for table in rows))
        assert alone.tobytes() == together[row].tobytes()
    bound = rows.x.copy()
    kernel.bind(bound, *rows[1:], bound)()
    assert bound.tobytes() == together.tobytes()


@pytest.mark.parametrize("key", ["x", "u", "d", "p"])
def test_derivatives_are_those_of_the_step(kernel: Kernel, rows: Rows, key: str) -> None:
    made = kernel.linearise(*rows, parameters=LETTUCE_CLASSIC.parameter_names)
    size = np.broadcast_to(np.asarray(SIZES[key]) * (rows.p[0] if key == "p" else 1.0), (4 if key == "d" else getattr(rows, key).shape[1],))
    exact = getattr(made, f"d{key}")
    for place, step in enumerate(1e-4 * size):
        ends = []
        for sign in (1.0, -1.0):
            table = getattr(rows, key).copy()
            table[:, place] += sign * step
            ends.append(kernel.step(*rows._replace(**{key: table})))
        difference = (ends[0] - ends[1]) / (2.0 * step)
        np.testing.assert_allclose(exact[:, :, place], difference, rtol=1e-5, atol=1e-5 * np.abs(difference).max() + 1e-14)


def test_sweeps_agree_with_the_matrices(kernel: Kernel, rows: Rows) -> None:
    made = kernel.linearise(*rows, parameters=LETTUCE_CLASSIC.parameter_names)
    weights = np.array([2.0, 300.0, 0.01, 20.0])
    after, gradient = kernel.adjoint(*rows, weights, parameters=True)
    assert after.tobytes() == made.x_next.tobytes()
    for key in SIZES:
        np.testing.assert_allclose(getattr(gradient, key), np.einsum("s,nsi->ni", weights, getattr(made, f"d{key}")), rtol=1e-12)
    states, whole = kernel.rollout_adjoint(rows.x[0], rows.u[:9], rows.d[:9], rows.p[:9], np.tile(weights, (10, 1)), parameters=True)
    trajectory = kernel.linearise_trajectory(rows.x[0], rows.u[:9], rows.d[:9], rows.p[:9])
    assert states.tobytes() == trajectory.x.tobytes()
    np.testing.assert_allclose(trajectory.pull(np.tile(weights, (10, 1))).u, whole.u, rtol=1e-10)


def test_states_stay_in_their_ranges_and_what_is_no_number_fails(kernel: Kernel, rows: Rows) -> None:
    low, high = (np.array(limits) for limits in (LETTUCE_CLASSIC.step_map.low, LETTUCE_CLASSIC.step_map.high))
    cold = rows.d[0].copy()
    cold[:2] = 0.0, -30.0
    frozen = kernel.step(low + 1e-9, np.array([1.0, 1.0, 0.0]), cold, rows.p[0])
    assert (frozen >= low).all()
    assert (frozen <= high).all()
    assert frozen[2] == low[2]
    # Without light, at the CO2 at which photosynthesis begins, its rate is 0 / 0.
    nominal, stuck = LETTUCE_CLASSIC.parameters.default(), np.array([0.1, 5.2e-5, 15.0, 0.008])
    after, failures = kernel.try_step(np.stack([stuck, rows.x[0]]), rows.u[:2], np.stack([cold, rows.d[0]]), nominal)
    assert [failure.row for failure in failures] == [0]
    assert after[0].tobytes() == stuck.tobytes()
    assert after[1].tobytes() == kernel.step(rows.x[0], rows.u[1], rows.d[0], nominal).tobytes()
    with pytest.raises(StepError, match=r"the result is not finite; controls uCo2"):
        kernel.step(stuck, rows.u[0], cold, nominal)
    with pytest.raises(RolloutError):
        kernel.rollout(stuck, rows.u[:1], cold[None], nominal)


def test_the_digest_has_the_step_where_it_is_part_of_the_model() -> None:
    assert digest_of(TOMATO.rhs_function()) == TOMATO.digest
    step, rates = LETTUCE_CLASSIC.step_map, digest_of(LETTUCE_CLASSIC.rhs_function())
    assert step is not None
    others = (step, replace(step, parts=5), replace(step, low=(0.001, *step.low[1:])), StepMap(step.high, step.low))
    assert len({rates, *(other.digest(rates) for other in others)}) == 5
    assert LETTUCE_CLASSIC.digest == step.digest(rates)
    with pytest.raises(ShapeError, match="no step of its own"):
        TOMATO.step_function(STEP)
    with pytest.raises(GlbenchError, match='judged = "end"'):
        with_violation_meters(LETTUCE_CLASSIC)
