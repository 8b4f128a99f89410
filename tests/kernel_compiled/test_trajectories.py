"""Compiled trajectories: derivatives of the numerical steps, the same bits in any company, absent equipment."""

from __future__ import annotations

import datetime as dt
import shutil
from dataclasses import astuple, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.kernel import Kernel, available, state_scale
from glbench.kernel.compiled import CompiledStepper, Preset
from glbench.model import PARAMETER_NAMES, TOMATO, get_model
from glbench.speed.subjects import Season, season

Array = NDArray[np.float64]
Inputs = tuple[Array, Array, Array, Array]

STATE_SCALE = state_scale(TOMATO)
ONE_SUBSTEP = Preset(relative=1.0, first_substep=5.0, fast_error_floor=1.0, singular_error_factor=1.0)
"""With steps of 5 s: a single, coarse substep, so that finite differences see the numerical steps and nothing else."""

pytestmark = pytest.mark.usefixtures("compiled")


def own_kernel(seconds: float, preset: Preset | str, *, threads: int = 1, width: int | None = None) -> Kernel:
    kernel = Kernel(TOMATO, seconds, backend="compiled")
    kernel._backend = CompiledStepper(TOMATO, seconds, preset=preset, threads=threads, width=width)
    return kernel


@pytest.fixture(scope="module")
def day() -> Season:
    """96 steps of 900 s on 1 May; controls off the kinks at their bounds."""
    one = season("walk", 900.0, dt.date(2010, 5, 1), 1)
    return replace(one, controls=0.05 + 0.9 * one.controls)


@pytest.fixture(scope="module")
def batch(day: Season, parameters: Array) -> Inputs:
    """Eleven horizons of 12 steps: more than there are lanes, each with starts, controls, weather and parameters of its own."""
    generator = np.random.default_rng(2)
    starts = day.start * generator.uniform(0.99, 1.01, (11, 28))
    which = 4 * np.arange(11)[:, None] + np.arange(12)
    p = parameters * generator.uniform(0.95, 1.05, (11, 12, 208))
    return starts, day.controls[which], day.weather[which], p


def everything(kernel: Kernel, inputs: Inputs) -> list[Array]:
    """All that there is to know of a batch: each table has a leading axis of horizons."""
    path = kernel.linearise_trajectory(*inputs, inputs=("x", "u", "d"))
    n, steps = len(path.x), path.x.shape[1]
    weights = np.cos(np.arange(28 * steps)).reshape(steps, 28) / STATE_SCALE
    gradient = kernel.rollout_adjoint(*inputs, weights, parameters=True)[1]
    pulled = path.pull(weights)
    changes = path.push(np.ones((n, steps - 1, 6)), 0.1 * STATE_SCALE)
    tables = [path.x, path.jacobians, changes, pulled.u, pulled.d, pulled.costates]
    return [*tables, *(table for table in astuple(gradient) if table is not None)]


def joined(tables: list[Array]) -> bytes:
    return b"".join(table.tobytes() for table in tables)


@pytest.mark.parametrize("preset", ["reference", "standard", "fast"])
def test_a_rollout_has_the_bits_of_its_steps(batch: Inputs, preset: str) -> None:
    kernel, (x, u, d, p) = Kernel(TOMATO, 900.0, backend="compiled", preset=preset), batch
    found, now = kernel.rollout(*batch), x
    for step in range(12):
        assert found[:, step].tobytes() == now.tobytes()
        now = kernel.step(now, u[:, step], d[:, step], p[:, step])
    assert found[:, 12].tobytes() == now.tobytes()


def test_a_horizon_has_the_same_bits_alone_in_a_batch_and_in_threads(batch: Inputs) -> None:
    kernel = Kernel(TOMATO, 900.0, backend="compiled", preset="fast")
    whole = everything(kernel, batch)
    alone = [everything(kernel, tuple(table[k : k + 1] for table in batch)) for k in range(11)]
    assert joined([np.concatenate(tables) for tables in zip(*alone, strict=True)]) == joined(whole)
    order = np.random.default_rng(1).permutation(11)
    assert joined(everything(kernel, tuple(table[order] for table in batch))) == joined([t[order] for t in whole])
    many = tuple(np.concatenate([table] * 4) for table in batch)
    expected = joined([np.concatenate([table] * 4) for table in whole])
    for threads in (2, 3):
        shared = Kernel(TOMATO, 900.0, backend="compiled", preset="fast", threads=threads)
        assert joined(everything(shared, many)) == expected


@pytest.mark.slow
@pytest.mark.parametrize("width", [1, 2, 4])
def test_any_number_of_lanes_gives_the_same_bits(batch: Inputs, width: int) -> None:
    for preset in ("fast", "reference"):
        expected = joined(everything(own_kernel(900.0, preset), batch))
        assert joined(everything(own_kernel(900.0, preset, width=width), batch)) == expected


@pytest.mark.slow
@pytest.mark.parametrize("command", ["clang++", "g++ -mno-avx512f"])
def test_other_compilers_and_instruction_sets_give_the_same_bits(batch: Inputs, command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if shutil.which(command.split()[0]) is None:
        pytest.skip(f"{command} is not installed")
    expected = joined(everything(own_kernel(900.0, "fast"), batch))
    monkeypatch.setenv("CXX", command)
    assert joined(everything(own_kernel(900.0, "fast"), batch)) == expected


def test_changes_and_gradients_are_those_of_the_numerical_rollout(day: Season, parameters: Array) -> None:
    """Forty steps of 5 s against central differences along random directions of everything at once."""
    kernel, generator = own_kernel(5.0, ONE_SUBSTEP), np.random.default_rng(9)
    u, d = np.repeat(day.controls[40:44], 10, axis=0), np.repeat(day.weather[40:44], 10, axis=0)
    x0 = kernel.rollout(day.start, u, d, parameters)[-1]  # off the kink at equal temperatures
    path = kernel.linearise_trajectory(x0, u, d, parameters, inputs=("x", "u", "d"))
    weights = generator.normal(size=(41, 28)) / STATE_SCALE
    gradient = kernel.rollout_adjoint(x0, u, d, parameters, weights, parameters=True)[1]
    assert gradient.p is not None
    for _ in range(5):
        dx0, du = generator.normal(size=28) * STATE_SCALE * 1e-2, generator.normal(size=(40, 6))
        dd, dp = generator.normal(size=(40, 10)) * np.abs(d) * 1e-2, generator.normal(size=208) * parameters * 1e-2

        def moved(by: float, dx0: Array = dx0, du: Array = du, dd: Array = dd, dp: Array = dp) -> Array:
            return kernel.rollout(x0 + by * dx0, u + by * du, d + by * dd, parameters + by * dp)

        def difference(dp: Array = dp) -> Array:
            return (moved(1e-5, dp=dp) - moved(-1e-5, dp=dp)) / 2e-5

        expected, found = difference(0.0 * dp) / STATE_SCALE, path.push(du, dx0, dd) / STATE_SCALE
        assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()
        slope = gradient.x0 @ dx0 + np.vdot(gradient.u, du) + np.vdot(gradient.d, dd) + gradient.p @ dp
        assert slope == pytest.approx(np.vdot(weights, difference()), rel=1e-5)


@pytest.mark.parametrize("preset", ["reference", "standard", "fast", "tight"])
def test_sweeps_adjoint_and_single_steps_are_one_linear_map(batch: Inputs, preset: str) -> None:
    kernel, (_, u, d, p) = Kernel(TOMATO, 900.0, backend="compiled", preset=preset), batch
    generator = np.random.default_rng(3)
    path = kernel.linearise_trajectory(*batch)
    weights = generator.normal(size=(11, 13, 28)) / STATE_SCALE
    dx0, du = generator.normal(size=(11, 28)) * STATE_SCALE, generator.normal(size=(11, 12, 6))
    pushed, pulled, gradient = path.push(du, dx0), path.pull(weights), kernel.rollout_adjoint(*batch, weights)[1]
    terms = np.concatenate([(pulled.x0 * dx0).ravel(), (pulled.u * du).ravel()])
    size = np.abs(weights * pushed).sum() + np.abs(terms).sum()
    assert abs((weights * pushed).sum() - terms.sum()) < 1e-12 * size
    change, costate = dx0, weights[:, 12]
    for step in range(12):
        lines = kernel.linearise(path.x[:, step], u[:, step], d[:, step], p[:, step], inputs=("x", "u"))
        assert (path.dx[:, step] == lines.dx).all()
        assert (path.du[:, step] == lines.du).all()
        change = np.einsum("nij,nj->ni", lines.dx, change) + np.einsum("nij,nj->ni", lines.du, du[:, step])
        error = np.abs((pushed[:, step + 1] - change) / STATE_SCALE).max()
        assert error < 1e-12 * np.abs(pushed / STATE_SCALE).max()
    for step in reversed(range(12)):
        _, one = kernel.adjoint(path.x[:, step], u[:, step], d[:, step], p[:, step], costate)
        costate = weights[:, step] + one.x
        for ours, theirs in ((gradient.u, one.u), (gradient.d, one.d), (gradient.costates, costate)):
            np.testing.assert_array_equal(ours[:, step], theirs)
    for ours, theirs, unit in ((pulled.u, gradient.u, 1.0), (pulled.costates, gradient.costates, STATE_SCALE)):
        assert np.abs((ours - theirs) * unit).max() < 1e-10 * np.abs(theirs * unit).max()


def test_directions_not_asked_for_change_no_bit_of_the_others(batch: Inputs) -> None:
    kernel = Kernel(TOMATO, 900.0, backend="compiled", preset="fast")
    x, u, d, p = batch[0], *(table[:, 0] for table in batch[1:])
    whole = kernel.linearise(x, u, d, p, parameters=["aPipe"])
    for inputs in ((), ("x",), ("u",), ("d",), ("u", "x"), ("x", "d")):
        some = kernel.linearise(x, u, d, p, inputs=inputs, parameters=["aPipe"])
        assert some.dp.tobytes() == whole.dp.tobytes()
        for key in "xud":
            expected = getattr(whole, f"d{key}") if key in inputs else np.zeros((11, 28, 0))
            assert getattr(some, f"d{key}").tobytes() == expected.tobytes()
            assert getattr(some, f"d{key}").shape == expected.shape


@pytest.mark.parametrize("where", ["all", "some horizons", "some steps"])
def test_equipment_that_the_usual_library_leaves_out(batch: Inputs, where: str) -> None:
    x, u, d, p = *batch[:3], batch[3].copy()
    lit = {"all": np.s_[:], "some horizons": np.s_[::3], "some steps": np.s_[:, 5:]}[where]
    interlight = [PARAMETER_NAMES.index(name) for name in ("thetaIntLampMax", "aIntLamp", "capIntLamp", "epsIntLamp")]
    for column, value in zip(interlight, (50.0, 0.05, 10.0, 0.9), strict=True):
        p[..., column][lit] = value
    kernel = Kernel(TOMATO, 900.0, backend="compiled", preset="fast")
    weights = np.random.default_rng(1).normal(size=(13, 28)) / STATE_SCALE
    path, (reached, gradient) = (kernel.linearise_trajectory(x, u, d, p), kernel.rollout_adjoint(x, u, d, p, weights, parameters=True))
    assert gradient.p is not None
    assert path.x.tobytes() == reached.tobytes()
    assert path.x.tobytes() != kernel.rollout(*batch).tobytes()
    now, costate = x, np.broadcast_to(weights[12], (11, 28))
    for step in range(12):
        lines = kernel.linearise(now, u[:, step], d[:, step], p[:, step], inputs=("x", "u"))
        assert (path.dx[:, step] == lines.dx).all()
        assert (path.du[:, step] == lines.du).all()
        now = lines.x_next
    assert now.tobytes() == np.ascontiguousarray(path.x[:, 12]).tobytes()
    for step in reversed(range(12)):
        _, one = kernel.adjoint(reached[:, step], u[:, step], d[:, step], p[:, step], costate, parameters=True)
        costate = weights[step] + one.x
        for ours, theirs in ((gradient.u, one.u), (gradient.p, one.p), (gradient.costates, costate)):
            np.testing.assert_array_equal(ours[:, step], theirs)


def test_lettuce_has_trajectories(day: Season) -> None:
    lettuce = get_model("greenlight-lettuce-1.0.0")
    if "compiled" not in available(lettuce):
        pytest.skip("no compiled kernel here")
    kernel, p = Kernel(lettuce, 900.0, backend="compiled", preset="tight"), lettuce.parameters.default()
    x0 = lettuce.start(next(iter(lettuce.starts())), day.weather[0], 18.0, p)
    inputs = x0, day.controls[:24], day.weather[:24], p
    path, scale = kernel.linearise_trajectory(*inputs), state_scale(lettuce)
    weights = np.random.default_rng(1).normal(size=path.x.shape) / scale
    pulled, (x, gradient) = path.pull(weights), kernel.rollout_adjoint(*inputs, weights)
    now = x0
    for step in range(24):
        assert (path.x[step] == now).all()
        now = kernel.step(now, inputs[1][step], inputs[2][step], p)
    assert x.tobytes() == path.x.tobytes()
    assert np.abs(pulled.u - gradient.u).max() < 1e-10 * np.abs(gradient.u).max()
    du = np.random.default_rng(2).normal(size=(24, lettuce.sizes["u"]))
    assert np.vdot(pulled.u, du) == pytest.approx(np.vdot(weights, path.push(du)), rel=1e-10)
