"""The energy system stepped: what closes over time, empty and full buffers, the plain boiler, backends, batches, derivatives."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from glbench.kernel import Kernel, Rows, available, state_scale, why_not_compiled
from glbench.model import TOMATO_ENERGY, get_model
from tests.kernel.known_steps import Array, KnownSteps

MODEL = TOMATO_ENERGY
PLAIN = get_model("greenlight-tomato-harvest-1.0.0")
BUFFER, PIPE, DUMPED = (MODEL.state_index(name) for name in ("eBuf", "sumHBufPipe", "sumHDumpOut"))
FULL = 3.3
BACKENDS = ("compiled", "casadi", "cvodes")


@cache
def kernel_of(backend: str, preset: str = "reference", model: object = MODEL, threads: int = 1) -> Kernel:
    if backend not in available(model):  # type: ignore[arg-type]
        pytest.skip(why_not_compiled(model))  # type: ignore[arg-type]
    return Kernel(model, 900.0, backend=backend, preset=preset, threads=threads)  # type: ignore[arg-type]


def rows_of(steps: KnownSteps, n: int, **overrides: float) -> Rows:
    """Known steps with buffers from empty to full and all kinds of controls for them."""
    p = MODEL.parameters.default(overrides=overrides)
    generator = np.random.default_rng(11)
    full = p[MODEL.parameter_names.index("eBufMax")]
    stored = generator.uniform(0.0, full, n)
    stored[::4], stored[1::4] = 0.0, full
    x = np.insert(steps.x[:n], 27, np.zeros((4, n)), axis=1)
    x[:, BUFFER] = stored
    u = np.hstack([steps.u[:n], generator.choice([0.0, 0.3, 0.7, 1.0], (n, 2))])
    u[:, 0] = generator.choice([0.0, 1e-3, 0.5, 1.0], n)
    return Rows(x, u, steps.d[:n], p[None])


def control(**loads: float) -> Array:
    u = np.zeros(len(MODEL.controls))
    for name, load in loads.items():
        u[MODEL.control_names.index(name)] = load
    return u


@pytest.mark.parametrize("preset", ["reference", "standard", "fast"])
def test_heat_made_is_heat_given_dumped_and_stored_over_hours(steps_900: KnownSteps, preset: str) -> None:
    rows, kernel = rows_of(steps_900, 24, tauBuf=1e12), kernel_of("compiled", preset)
    x, generator, made = rows.x.copy(), np.random.default_rng(5), np.zeros(24)
    for _ in range(24):
        u = rows.u.copy()
        u[:, [0, 6, 7]] = generator.choice([0.0, 0.3, 0.7, 1.0], (24, 3))
        x = kernel.step(x, u, rows.d, rows.p)
        made += 900.0 * (130.0 * u[:, 0] + 62.5 * u[:, 6])
    stored = 1e6 * (x[:, BUFFER] - rows.x[:, BUFFER])
    np.testing.assert_allclose(stored + x[:, PIPE] + x[:, DUMPED], made, rtol=1e-9)
    assert (x[:, PIPE] > 0).all()
    assert (x[:, DUMPED] > 1e3).any()


@pytest.mark.parametrize("preset", ["reference", "standard", "fast"])
@pytest.mark.parametrize("full", [FULL, 0.2])
def test_no_buffer_is_below_empty_or_above_full(steps_900: KnownSteps, preset: str, full: float) -> None:
    rows, kernel = rows_of(steps_900, 24, eBufMax=full), kernel_of("compiled", preset)
    x, generator = rows.x.copy(), np.random.default_rng(7)
    lowest, highest = np.inf, -np.inf
    for step in range(60):
        if step % 5 == 0:  # long enough to empty and to fill the small buffer
            u = rows.u.copy()
            u[:, [0, 6, 7]] = generator.choice([0.0, 1e-3, 0.7, 1.0], (24, 3))
        x = kernel.step(x, u, rows.d, rows.p)
        lowest, highest = min(lowest, x[:, BUFFER].min()), max(highest, x[:, BUFFER].max())
    assert lowest >= 0.0
    assert highest <= full
    assert lowest < 0.01 * full or full == FULL


def test_a_full_buffer_takes_no_more_than_it_loses(steps_900: KnownSteps) -> None:
    rows, kernel = rows_of(steps_900, 1), kernel_of("compiled")
    x = rows.x.copy()
    x[:, BUFFER] = FULL
    u = control(uBoil=1.0, uChp=1.0)
    for _ in range(10):
        before, x = x, kernel.step(x, u, rows.d, rows.p)
    lost = 1e6 * x[0, BUFFER] / (20 * 86400.0)
    room = -0.05 * np.log1p(-lost / 192.5)  # where what is taken is what is lost
    assert x[0, BUFFER] == pytest.approx(FULL - room, abs=1e-8)
    assert (x - before)[0, DUMPED] / 900.0 == pytest.approx(192.5 - lost, rel=1e-6)


def test_an_empty_buffer_gives_what_is_made(steps_900: KnownSteps) -> None:
    rows, kernel = rows_of(steps_900, 1), kernel_of("compiled")
    x = rows.x.copy()
    x[:, BUFFER] = 0.0
    assert kernel.step(x, control(uPipe=1.0), rows.d, rows.p)[0, BUFFER] == 0.0
    for _ in range(30):
        before, x = x, kernel.step(x, control(uBoil=0.5, uPipe=1.0), rows.d, rows.p)
    lost = 1e6 * x[0, BUFFER] / (20 * 86400.0)
    assert (x - before)[0, PIPE] / 900.0 == pytest.approx(65.0 - lost, rel=1e-6)
    assert 0.0 < x[0, BUFFER] < 0.05


def test_with_a_large_buffer_and_no_engine_the_greenhouse_is_that_of_the_plain_boiler(steps_900: KnownSteps) -> None:
    """The same heat in the pipes to the last bits: exp(-eBuf / eBufEdge) is exp(-3000).

    The kernel may choose other substeps, because it judges three more states. Each of the two steps is exact to 1e-6 of a state's scale
    (preset ``reference``), so they are within 2e-6 of each other; over a day errors neither grow nor all point one way.
    """
    n = 24
    rows = rows_of(steps_900, n, eBufMax=300.0)
    rows.x[:, BUFFER] = 150.0
    ours, theirs = kernel_of("compiled"), kernel_of("compiled", model=PLAIN)
    keep = [MODEL.state_index(name) for name in PLAIN.state_names]
    x, plain, generator = rows.x.copy(), rows.x[:, keep].copy(), np.random.default_rng(9)
    scale = state_scale(PLAIN)
    for step in range(96):
        u = rows.u.copy()
        u[:, 0], u[:, 6], u[:, 7] = generator.uniform(0, 1, n), 0.0, generator.uniform(0, 1, n)
        heated = u[:, :6].copy()
        heated[:, 0] = u[:, 7]
        if step == 0:
            error = np.abs(ours.step(x, u, rows.d, rows.p)[:, keep] - theirs.step(plain, heated, rows.d, rows.p[:, :208]))
            assert (error / scale).max() < 2e-6
        x, plain = ours.step(x, u, rows.d, rows.p), theirs.step(plain, heated, rows.d, rows.p[:, :208])
    # No step adds more than 2e-6, and 96 steps no more than 96 times that.
    assert (np.abs(x[:, keep] - plain) / scale).max() < 96 * 2e-6


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
    """Near an empty and near a full buffer; CasADi's derivatives, because compiling those of a whole greenhouse takes minutes."""
    rows = rows_of(steps_900, 2)
    rows.x[:, BUFFER] = 0.02, FULL - 0.02
    rows.u[:, [0, 6, 7]] = np.random.default_rng(2).uniform(0.2, 0.8, (2, 3))
    lines, kernel = kernel_of("casadi", "tight").linearise(*rows), kernel_of("compiled", "tight")
    scale = state_scale(MODEL)
    for jacobian, key, column in (
        (lines.dx, "x", BUFFER), (lines.du, "u", 0), (lines.du, "u", 6), (lines.du, "u", 7),
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
