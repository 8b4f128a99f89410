"""Heat harvesting stepped: what closes over time, empty and full buffers, what is off, backends, batches, derivatives."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from glbench.kernel import Kernel, Rows, available, state_scale, why_not_compiled
from glbench.model import TOMATO_HEAT_PUMP, get_model
from tests.kernel.known_steps import Array, KnownSteps

MODEL = TOMATO_HEAT_PUMP
PLAIN = get_model("greenlight-tomato-harvest-1.0.0")
COLD, HOT, PUMPED, HARVESTED, DELIVERED = (
    MODEL.state_index(name) for name in ("eBufCold", "eBufHot", "sumQHeatPumpIn", "sumHMechBufCold", "sumHBufHotPipe")
)
FULL = np.array([0.4184, 0.8368])
COP = 5.5
BACKENDS = ("compiled", "casadi", "cvodes")


@cache
def kernel_of(backend: str, preset: str = "reference", model: object = MODEL, threads: int = 1) -> Kernel:
    if backend not in available(model):  # type: ignore[arg-type]
        pytest.skip(why_not_compiled(model))  # type: ignore[arg-type]
    return Kernel(model, 900.0, backend=backend, preset=preset, threads=threads)  # type: ignore[arg-type]


def rows_of(steps: KnownSteps, n: int, **overrides: float) -> Rows:
    """Known steps with buffers from empty to full and all kinds of controls for them."""
    p = MODEL.parameters.default(overrides=overrides)
    generator = np.random.default_rng(12)
    full = p[[MODEL.parameter_names.index(name) for name in ("eBufColdMax", "eBufHotMax")]]
    stored = generator.uniform(0.0, full, (n, 2))
    stored[::4], stored[1::4] = 0.0, full
    x = np.insert(steps.x[:n], 27, np.zeros((6, n)), axis=1)
    x[:, [COLD, HOT]] = stored
    u = np.hstack([steps.u[:n], generator.choice([0.0, 0.3, 0.7, 1.0], (n, 3))])
    return Rows(x, u, steps.d[:n], p[None])


def warm(steps: KnownSteps) -> KnownSteps:
    """The steps that start in air from which the cooler can take heat, the warmest first."""
    air = steps.x[:, MODEL.state_index("tAir")]
    pick = np.argsort(-air, kind="stable")[: (air > 15.0).sum()]
    return KnownSteps(*(rows[pick] for rows in steps[:4]), [steps.labels[k] for k in pick])


def control(**loads: float) -> Array:
    u = np.zeros(len(MODEL.controls))
    for name, load in loads.items():
        u[MODEL.control_names.index(name)] = load
    return u


@pytest.mark.parametrize("preset", ["reference", "standard", "fast"])
def test_heat_harvested_and_electricity_are_heat_delivered_and_stored_over_hours(steps_900: KnownSteps, preset: str) -> None:
    rows, kernel = rows_of(warm(steps_900), 20), kernel_of("compiled", preset)
    x, generator = rows.x.copy(), np.random.default_rng(5)
    for _ in range(24):
        u = rows.u.copy()
        u[:, 6:] = generator.choice([0.0, 0.3, 0.7, 1.0], (20, 3))
        x = kernel.step(x, u, rows.d, rows.p)
    cold, hot = (1e6 * (x - rows.x)[:, place] for place in (COLD, HOT))
    size = 1e6 * FULL.sum()
    np.testing.assert_allclose(cold + (COP - 1) * x[:, PUMPED], x[:, HARVESTED], rtol=1e-9, atol=1e-9 * size)
    np.testing.assert_allclose(hot + x[:, DELIVERED], COP * x[:, PUMPED], rtol=1e-9, atol=1e-9 * size)
    assert (x[:, [PUMPED, HARVESTED, DELIVERED]] > 1e4).all()


@pytest.mark.parametrize("preset", ["reference", "standard", "fast"])
def test_no_buffer_is_below_empty_or_above_full(steps_900: KnownSteps, preset: str) -> None:
    rows, kernel = rows_of(steps_900, 24), kernel_of("compiled", preset)
    x, generator = rows.x.copy(), np.random.default_rng(7)
    lowest, highest = np.full(2, np.inf), np.full(2, -np.inf)
    for step in range(60):
        if step % 5 == 0:  # long enough to empty and to fill them
            u = rows.u.copy()
            u[:, 6:] = generator.choice([0.0, 1e-3, 0.7, 1.0], (24, 3))
        x = kernel.step(x, u, rows.d, rows.p)
        stored = x[:, [COLD, HOT]]
        lowest, highest = np.minimum(lowest, stored.min(axis=0)), np.maximum(highest, stored.max(axis=0))
    # The buffers settle at an edge within minutes, so that a substep may end beyond it, by less than its own error.
    assert (lowest >= -1e-15).all()
    assert (highest <= FULL + 1e-10).all()
    assert (lowest < 0.02 * FULL).all()
    assert (highest > 0.95 * FULL).all()


def test_a_full_cold_buffer_takes_what_the_heat_pump_takes_from_it(steps_900: KnownSteps) -> None:
    rows, kernel = rows_of(warm(steps_900), 1), kernel_of("compiled")
    x = rows.x.copy()
    x[:, [COLD, HOT]] = FULL[0], 0.0
    for _ in range(4):
        before, x = x, kernel.step(x, control(uMech=1.0, uHeatPump=1.0, uBufHot=1.0), rows.d, rows.p)
    pumped = (x - before)[0, PUMPED] / 900.0
    assert pumped == pytest.approx(62.5 / COP, rel=1e-4)
    assert (x - before)[0, HARVESTED] / 900.0 == pytest.approx((COP - 1) * pumped, rel=1e-3)
    assert (x - before)[0, DELIVERED] / 900.0 == pytest.approx(62.5, rel=1e-3)
    assert 0.8 * FULL[0] < x[0, COLD] < FULL[0]
    assert 0.0 < x[0, HOT] < 0.05


def test_empty_buffers_give_nothing(steps_900: KnownSteps) -> None:
    rows, kernel = rows_of(steps_900, 1), kernel_of("compiled")
    x = rows.x.copy()
    x[:, [COLD, HOT]] = 0.0
    after = kernel.step(x, control(uHeatPump=1.0, uBufHot=1.0), rows.d, rows.p)
    assert not after[0, [COLD, HOT, PUMPED, HARVESTED, DELIVERED]].any()


def test_the_cooler_cools_and_dries_the_air(steps_900: KnownSteps) -> None:
    rows, kernel = rows_of(warm(steps_900), 12), kernel_of("compiled")
    x, u = rows.x.copy(), rows.u.copy()
    x[:, COLD], u[:, 6:] = 0.0, 0.0
    cooled = u.copy()
    cooled[:, 6] = 1.0
    changed = kernel.step(x, cooled, rows.d, rows.p) - kernel.step(x, u, rows.d, rows.p)
    assert (changed[:, MODEL.state_index("tAir")] < 0.0).all()
    assert (changed[:, MODEL.state_index("vpAir")] < 0.0).all()
    assert (changed[:, HARVESTED] > 1e4).all()


def test_what_is_always_off_is_the_plain_greenhouse(steps_900: KnownSteps) -> None:
    """The rates are the same to the bit (tests/model/test_heat_harvesting.py).

    The kernel may choose other substeps, because it judges five more states, of which none moves. Each of the two steps is exact to 1e-6
    of a state's scale (preset ``reference``).
    """
    n = 24
    rows = rows_of(steps_900, n)
    ours, theirs = kernel_of("compiled"), kernel_of("compiled", model=PLAIN)
    keep = [MODEL.state_index(name) for name in PLAIN.state_names]
    x, plain = rows.x.copy(), rows.x[:, keep].copy()
    u = rows.u.copy()
    u[:, 6:] = 0.0
    scale = state_scale(PLAIN)
    for step in range(96):
        x, plain = ours.step(x, u, rows.d, rows.p), theirs.step(plain, u[:, :6], rows.d, rows.p[:, :208])
        if step == 0:
            assert (np.abs(x[:, keep] - plain) / scale).max() < 2e-6
    # No step adds more than 2e-6, and 96 steps no more than 96 times that.
    assert (np.abs(x[:, keep] - plain) / scale).max() < 96 * 2e-6
    assert (x[:, [COLD, HOT]] == rows.x[:, [COLD, HOT]]).all()
    assert not x[:, [PUMPED, HARVESTED, DELIVERED]].any()


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("preset", ["reference", "standard", "fast"])
def test_a_row_has_the_same_bits_alone_and_in_a_batch(steps_900: KnownSteps, backend: str, preset: str) -> None:
    rows = rows_of(steps_900, 9 if backend == "compiled" else 3)
    kernel = kernel_of(backend, preset)
    whole = kernel.step(*rows)
    alone = [kernel.step(x, u, d, rows.p[0]) for x, u, d in zip(*rows[:3], strict=True)]
    assert np.stack(alone).tobytes() == whole.tobytes()
    assert kernel_of(backend, preset, threads=2).step(*rows).tobytes() == whole.tobytes()


@pytest.mark.parametrize(
    ("backend", "preset", "limit"), [("casadi", "reference", 1e-6), ("cvodes", "reference", 1e-6), ("cvodes", "standard", 2e-4)]
)
def test_the_backends_agree(steps_900: KnownSteps, backend: str, preset: str, limit: float) -> None:
    rows = rows_of(steps_900, 8)
    ours, theirs = kernel_of("compiled", preset).step(*rows), kernel_of(backend).step(*rows)
    assert np.abs((ours - theirs) / state_scale(MODEL)).max() < limit


def test_derivatives_of_a_step_are_those_of_finite_differences(steps_900: KnownSteps) -> None:
    """Between empty and full; CasADi's derivatives, because compiling those of a whole greenhouse takes minutes."""
    rows = rows_of(steps_900, 2)
    rows.x[:, [COLD, HOT]] = [[0.03, 0.8], [0.39, 0.03]]
    rows.u[:, 6:] = np.random.default_rng(2).uniform(0.2, 0.8, (2, 3))
    lines, kernel = kernel_of("casadi", "tight").linearise(*rows), kernel_of("compiled", "tight")
    scale = state_scale(MODEL)
    for jacobian, key, column in (
        (lines.dx, "x", COLD), (lines.dx, "x", HOT), (lines.du, "u", 6), (lines.du, "u", 7), (lines.du, "u", 8),
    ):  # fmt: skip
        by = 1e-4
        moved = []
        for sign in (1.0, -1.0):
            table = getattr(rows, key).copy()
            table[:, column] += sign * by
            moved.append(kernel.step(*rows._replace(**{key: table})))
        expected = (moved[0] - moved[1]) / (2 * by) / scale
        found = jacobian[:, :, column] / scale
        assert np.abs(found - expected).max() < 1e-5 * max(1.0, np.abs(expected).max()), (key, column)
        assert np.abs(expected).max() > 1e-3
