"""Derivatives of a control step: exact for the numerical step, the same forward and in reverse, the same bits in any company.

Errors are judged on scaled inputs and states (10 degC, 1000 mg m-3, ..., see ``STATE_SCALE``), relative to the largest
derivative of a column.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.errors import StepError
from glbench.kernel import Kernel, Linearisation, state_scale
from glbench.kernel.compiled import Preset, absent_equipment
from glbench.kernel.compiled.differentiator import CompiledDifferentiator
from glbench.kernel.compiled.stepper import CompiledStepper
from glbench.kernel.records import Rows, as_rows
from glbench.kernel.sensitivities import Directions
from glbench.model import PARAMETER_NAMES, TOMATO, VARIANTS, default_parameters, tomato

STATE_SCALE = state_scale(TOMATO)

Array = NDArray[np.float64]

pytestmark = pytest.mark.usefixtures("compiled")

ONE_SUBSTEP = Preset(relative=1.0, first_substep=5.0, fast_error_floor=1.0, singular_error_factor=1.0)
"""With steps of 5 s: a single, coarse substep, so that finite differences see the numerical step and nothing else."""

SCALES = {
    "x": STATE_SCALE,
    "u": np.ones(6),
    "d": np.array([1e3, 10.0, 1e3, 1e3, 10.0, 10.0, 10.0, 10.0, 1.0, 1.0]),
    "p": np.maximum(np.abs(default_parameters()), 1e-3),
}


@pytest.fixture(scope="module")
def points(golden_steps: dict[str, Array], parameters: Array) -> Rows:
    """States and weather of the reference trajectories, winter and summer, under random controls.

    Without the first state of each: there all temperatures are equal, which is a kink of every exchange by convection.
    """
    x, d = (np.concatenate([golden_steps[f"winter_{k}"][1:], golden_steps[f"summer_{k}"][1:]]) for k in "xd")
    return as_rows(TOMATO.names, x, np.random.default_rng(1).uniform(0.01, 0.99, (78, 6)), d, parameters)


@pytest.fixture(scope="module")
def one_substep() -> Kernel:
    return own_kernel(5.0, ONE_SUBSTEP)


@pytest.fixture(scope="module")
def kernel() -> Kernel:
    return Kernel(TOMATO, 900.0, backend="compiled")


def own_kernel(seconds: float, preset: Preset, variant: str = "author") -> Kernel:
    kernel = Kernel(tomato(variant), seconds, backend="compiled")
    kernel._backend = CompiledStepper(tomato(variant), seconds, preset=preset)
    return kernel


def columns(step: Callable[[Rows], Array], rows: Rows, key: str, which: Sequence[int], share: float) -> Array:
    """Central differences (n, 28, columns), in scaled units; ``share`` of the scale is the difference to either side."""
    found = []
    for j in which:
        by = share * SCALES[key][j]
        table = getattr(rows, key)
        up, down = table.copy(), table.copy()
        up[:, j] += by
        down[:, j] -= by
        difference = step(rows._replace(**{key: up})) - step(rows._replace(**{key: down}))
        found.append(difference / (2.0 * share) / STATE_SCALE)
    return np.stack(found, axis=2)


def scaled(jacobian: Array, key: str, which: Sequence[int]) -> Array:
    return jacobian * SCALES[key][list(which)] / STATE_SCALE[:, None]


def column_errors(found: Array, expected: Array) -> Array:
    """Largest error in each column, relative to the largest derivative in it, or to 1e-3 where that is smaller."""
    return np.abs(found - expected).max(axis=1) / np.maximum(np.abs(expected).max(axis=1), 1e-3)


def jacobians(lines: Linearisation) -> dict[str, Array]:
    return {"x": lines.dx, "u": lines.du, "d": lines.dd}


def test_the_derivative_is_that_of_the_numerical_step(one_substep: Kernel, points: Rows) -> None:
    lines = one_substep.linearise(*points)
    for key, jacobian in jacobians(lines).items():
        which = range(jacobian.shape[2])
        expected = columns(lambda rows: one_substep.step(*rows), points, key, which, 2e-6)
        assert column_errors(scaled(jacobian, key, which), expected).max() < 1e-5, key


def test_the_derivative_is_that_of_the_solution(points: Rows) -> None:
    """Steps of 900 s at ``tight``, against finite differences.

    A step that crosses a kink has a derivative as accurate as the root of its tolerance, and finite differences across a kink
    are wrong; with random controls many steps cross one. Hence shares of the columns instead of the largest error.
    """
    kernel = Kernel(TOMATO, 900.0, backend="compiled", preset="tight")
    lines = kernel.linearise(*points)
    found = []
    for key, jacobian in jacobians(lines).items():
        which = range(0, jacobian.shape[2], 2)
        expected = columns(lambda rows: kernel.step(*rows), points, key, which, 1e-5)
        found.append(column_errors(scaled(jacobian[:, :, ::2], key, which), expected).ravel())
    error = np.concatenate(found)
    assert np.median(error) < 5e-7
    assert np.quantile(error, 0.8) < 1e-5
    assert np.quantile(error, 0.95) < 1e-3


def test_parameters_have_derivatives_also_those_of_absent_equipment(one_substep: Kernel, points: Rows) -> None:
    absent = set(absent_equipment(TOMATO))
    chosen = [k for k in range(0, 208, 5) if k not in absent] + sorted(absent)[::4]
    some = points.take(np.arange(30))
    lines = one_substep.linearise(*some, parameters=[PARAMETER_NAMES[k] for k in chosen])
    assert lines.dp.shape == (30, 28, len(chosen))

    def step(rows: Rows) -> Array:
        return one_substep.step(*rows)

    expected = columns(step, some, "p", chosen, 1e-5)
    error = column_errors(scaled(lines.dp, "p", chosen), expected)
    # Some parameters stand where a minimum switches (largest fluxes of equipment): a few rows sit on the kink.
    assert np.quantile(error, 0.99) < 1e-5
    assert lines.x_next.tobytes() == step(some).tobytes()
    _, gradient = one_substep.adjoint(*some, np.ones(28), parameters=True)
    assert gradient.p is not None
    assert np.abs(lines.dp.sum(axis=1) - gradient.p[:, chosen]).max() < 1e-9 * np.abs(lines.dp).max()


@pytest.mark.parametrize("preset", ["reference", "fast"])
def test_the_state_is_that_of_the_step_to_the_bit(points: Rows, preset: str) -> None:
    kernel = Kernel(TOMATO, 900.0, backend="compiled", preset=preset)
    expected = kernel.step(*points).tobytes()
    assert kernel.linearise(*points).x_next.tobytes() == expected
    assert kernel.forward(*points, du=np.ones(6))[0].tobytes() == expected
    assert kernel.adjoint(*points, np.ones(28))[0].tobytes() == expected
    assert kernel.adjoint(*points, np.ones(28), parameters=True)[0].tobytes() == expected


@pytest.mark.parametrize("preset", ["reference", "standard", "fast", "tight"])
def test_forward_and_reverse_are_one_linear_map(points: Rows, preset: str) -> None:
    """<w, A v> = <A' w, v> for random v and w in scaled units, to 1e-10 of the sum of the terms' sizes."""
    kernel = Kernel(TOMATO, 900.0, backend="compiled", preset=preset)
    generator = np.random.default_rng(7)
    v = {f"d{key}": generator.normal(size=getattr(points, key).shape) * SCALES[key] for key in "xud"}
    v["dp"] = generator.normal(size=(78, 208)) * points.p * 0.1
    w = generator.normal(size=(78, 28)) / STATE_SCALE
    _, tangent = kernel.forward(*points, **v)
    _, gradient = kernel.adjoint(*points, w, parameters=True)
    terms = np.concatenate([getattr(gradient, key) * v[f"d{key}"] for key in "xudp"], axis=1)
    size = np.abs(w * tangent).sum(axis=1) + np.abs(terms).sum(axis=1)
    assert (np.abs((w * tangent).sum(axis=1) - terms.sum(axis=1)) / size).max() < 1e-10


def test_matrices_and_directions_agree(kernel: Kernel, points: Rows) -> None:
    generator = np.random.default_rng(8)
    v = {key: generator.normal(size=getattr(points, key).shape) * SCALES[key] for key in "xud"}
    lines = kernel.linearise(*points)
    _, tangent = kernel.forward(*points, dx=v["x"], du=v["u"], dd=v["d"])
    expected = sum(np.einsum("nij,nj->ni", jacobian, v[key]) for key, jacobian in jacobians(lines).items())
    assert np.abs((tangent - expected) / STATE_SCALE).max() < 1e-10 * np.abs(expected / STATE_SCALE).max()


def test_a_direction_has_the_same_bits_alone_and_among_others(kernel: Kernel, points: Rows) -> None:
    lines = kernel.linearise(*points)
    for key, jacobian in jacobians(lines).items():
        size = jacobian.shape[2]
        for j in (0, size // 2, size - 1):
            alone = kernel.forward(*points, **{f"d{key}": np.eye(size)[j]})[1]
            assert alone.tobytes() == np.ascontiguousarray(jacobian[:, :, j]).tobytes()
    several = kernel.forward(*points, du=np.broadcast_to(np.eye(6), (78, 6, 6)))[1]
    assert several.tobytes() == np.ascontiguousarray(lines.du.swapaxes(1, 2)).tobytes()


def derivatives(kernel: Kernel, rows: Rows) -> bytes:
    lines = kernel.linearise(*rows)
    _, gradient = kernel.adjoint(*rows, 1.0 / STATE_SCALE)
    tables = [lines.dx, lines.du, lines.dd, gradient.x, gradient.u, gradient.d]
    return b"".join(table[row].tobytes() for row in range(len(rows.x)) for table in tables)


def test_a_row_has_the_same_bits_alone_in_a_batch_and_in_threads(points: Rows) -> None:
    kernel = Kernel(TOMATO, 900.0, backend="compiled", preset="fast")
    expected = derivatives(kernel, points)
    assert b"".join(derivatives(kernel, points.take(np.arange(row, row + 1))) for row in range(78)) == expected
    for threads in (2, 3):
        assert derivatives(Kernel(TOMATO, 900.0, backend="compiled", preset="fast", threads=threads), points) == expected
    shuffled = np.random.default_rng(2).permutation(78)
    again = Rows(points.x[shuffled], points.u[shuffled], points.d[shuffled], points.p)
    size = len(expected) // 78
    assert derivatives(kernel, again) == b"".join(expected[k * size : (k + 1) * size] for k in shuffled)


def everything(stepper: CompiledStepper, points: Rows) -> bytes:
    differentiator = CompiledDifferentiator(stepper.model, stepper.settings, stepper.width)
    seeds = {"x": np.eye(28)[None], "u": np.ones((1, 28, 6)), "d": np.ones((1, 28, 10))}
    forward = differentiator.forward(points, Directions(28, shared=True, seeds=seeds))
    reverse = differentiator.reverse(points, np.ones((78, 28)), parameters=False)
    tables = [forward.x_next, forward.tangents, *reverse.gradients.values()]
    return b"".join(table.tobytes() for table in tables)


@pytest.mark.slow
@pytest.mark.parametrize("width", [1, 2, 4])
def test_any_number_of_lanes_gives_the_same_bits(points: Rows, width: int) -> None:
    expected = everything(CompiledStepper(TOMATO, 900.0, preset="fast"), points)
    assert everything(CompiledStepper(TOMATO, 900.0, preset="fast", width=width), points) == expected


@pytest.mark.slow
@pytest.mark.parametrize("command", ["clang++", "g++ -mno-avx512f"])
def test_other_compilers_and_instruction_sets_give_the_same_bits(points: Rows, command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if shutil.which(command.split()[0]) is None:
        pytest.skip(f"{command} is not installed")
    expected = everything(CompiledStepper(TOMATO, 900.0, preset="fast"), points)
    monkeypatch.setenv("CXX", command)
    assert everything(CompiledStepper(TOMATO, 900.0, preset="fast"), points) == expected


@pytest.mark.slow
@pytest.mark.parametrize("variant", [name for name in VARIANTS if name != "author"])
def test_other_variants_are_differentiated_too(points: Rows, variant: str) -> None:
    kernel = own_kernel(5.0, ONE_SUBSTEP, variant)
    lines = kernel.linearise(*points)
    for key, jacobian in jacobians(lines).items():
        expected = columns(lambda rows: kernel.step(*rows), points, key, range(0, jacobian.shape[2], 3), 1e-5)
        error = column_errors(scaled(jacobian[:, :, ::3], key, range(0, jacobian.shape[2], 3)), expected)
        assert np.quantile(error, 0.99) < 1e-5, key


def test_rows_with_interlights_are_differentiated_with_the_full_model(points: Rows) -> None:
    kernel = own_kernel(5.0, ONE_SUBSTEP)
    p = np.tile(points.p, (20, 1))
    lit = np.arange(20) % 3 == 0
    interlight = [PARAMETER_NAMES.index(name) for name in ("thetaIntLampMax", "aIntLamp", "capIntLamp", "epsIntLamp")]
    p[np.ix_(lit, interlight)] = [50.0, 0.05, 10.0, 0.9]
    rows = points.take(np.arange(20))._replace(p=p)
    lines = kernel.linearise(*rows)
    expected = columns(lambda rows: kernel.step(*rows), rows, "u", range(6), 1e-5)
    assert column_errors(scaled(lines.du, "u", range(6)), expected).max() < 1e-5
    assert lines.x_next.tobytes() == kernel.step(*rows).tobytes()
    _, gradient = kernel.adjoint(*rows, 1.0 / STATE_SCALE)
    expected = np.einsum("i,nij->nj", 1.0 / STATE_SCALE, lines.du)
    assert np.abs(gradient.u - expected).max() < 1e-10 * np.abs(expected).max()
    usual = points.take(np.arange(20))
    assert lines.du[~lit].tobytes() == kernel.linearise(*usual).du[~lit].tobytes()


def test_the_clock_runs_by_itself(kernel: Kernel, points: Rows) -> None:
    lines = kernel.linearise(*points)
    assert (lines.dx[:, 27, 27] == 1.0).all()
    assert not lines.dx[:, 27, :27].any()
    assert not lines.dx[:, :27, 27].any()
    assert not lines.du[:, 27].any()


@pytest.mark.parametrize("control", range(6))
@pytest.mark.parametrize("value", [0.0, 1.0])
def test_controls_at_their_bounds_have_the_slope_of_the_inside(one_substep: Kernel, points: Rows, control: int, value: float) -> None:
    u = points.u.copy()
    u[:, control] = value
    lines = one_substep.linearise(points.x, u, points.d, points.p)
    inwards = 1.0 - 2.0 * value
    by = 1e-4 if not (value == 1.0 and control in (2, 5)) else 1e-8  # the gap of a closed screen opens like its power of 3/2
    states = []
    for k in range(3):
        u[:, control] = value + k * by * inwards
        states.append(one_substep.step(points.x, u, points.d, points.p))
    expected = inwards * (-3.0 * states[0] + 4.0 * states[1] - states[2]) / (2.0 * by) / STATE_SCALE
    error = column_errors(scaled(lines.du, "u", range(6))[:, :, control][:, :, None], expected[:, :, None])
    assert np.quantile(error, 0.95) < (1e-4 if by > 1e-6 else 1e-2)


def test_a_batch_without_rows_has_no_derivatives(kernel: Kernel, points: Rows) -> None:
    lines = kernel.linearise(*points.take(np.arange(0)))
    assert lines.dx.shape == (0, 28, 28)
    assert kernel.adjoint(*points.take(np.arange(0)), np.ones(28))[1].u.shape == (0, 6)


def test_a_row_that_cannot_be_stepped_is_named(kernel: Kernel, points: Rows) -> None:
    x = points.x[:5].copy()
    x[3, 23] = 0.0  # no leaves
    rows = as_rows(TOMATO.names, x, points.u[:5], points.d[:5], points.p)
    for call in (lambda: kernel.linearise(*rows), lambda: kernel.adjoint(*rows, np.ones(28))):
        with pytest.raises(StepError, match=r"failed in row 3 of 5: .* controls uBoil"):
            call()


def test_a_day_backwards_gives_the_gradient_of_its_end(points: Rows, parameters: Array) -> None:
    """96 steps of 900 s: gradient of a weighted end state with respect to all controls, against finite differences.

    In the direction of random changes of all controls: one number holds 576 derivatives to account.
    """
    kernel = Kernel(TOMATO, 900.0, backend="compiled", preset="tight")
    generator = np.random.default_rng(3)
    controls = np.clip(0.5 + np.cumsum(generator.uniform(-0.05, 0.05, (96, 6)), axis=0), 0.05, 0.95)
    weather, weights = points.d[np.arange(96) * 39 // 96 + 39], generator.normal(size=28) / STATE_SCALE

    def run(u: Array) -> Array:
        states = [points.x[39]]
        for step in range(96):
            states.append(kernel.step(states[-1], u[step], weather[step], parameters))
        return np.stack(states)

    states = run(controls)
    gradient, cotangent = np.empty_like(controls), weights
    for step in reversed(range(96)):
        _, adjoint = kernel.adjoint(states[step], controls[step], weather[step], parameters, cotangent)
        gradient[step], cotangent = adjoint.u, adjoint.x
    for _ in range(5):
        direction = generator.normal(size=controls.shape)
        ends = [weights @ run(controls + sign * 1e-5 * direction)[-1] for sign in (1.0, -1.0)]
        expected = (ends[0] - ends[1]) / 2e-5
        assert np.vdot(gradient, direction) == pytest.approx(expected, rel=1e-4)
