"""The kernel serves any model: sizes, names, scales and tolerances are the model's, several models step side by side."""

from __future__ import annotations

import pickle
from dataclasses import dataclass

import casadi
import numpy as np
import pytest

from glbench.errors import ActionError, ShapeError, StepError, UnknownNameError
from glbench.kernel import Kernel, Rows, available, state_scale, why_not_compiled
from glbench.kernel.compiled import CompiledStepper, CompiledUnavailable, absent_equipment
from glbench.model import TOMATO, Evaluation, Model, get_model
from tests.kernel.known_steps import Array, KnownSteps
from tests.kernel.toy import DECAY, METERED, TANK, Tank, decay_rows, metered_rows, tank_rows

BACKENDS = ("compiled", "casadi", "cvodes")


def kernel_of(model: Model, backend: str, preset: str = "reference", threads: int = 1) -> Kernel:
    if backend not in available(model):
        pytest.skip(why_not_compiled(model))
    return Kernel(model, 900.0, backend=backend, preset=preset, threads=threads)


@pytest.fixture(scope="module")
def harvests(steps_900: KnownSteps) -> Rows:
    return metered_rows(steps_900)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("preset", ["reference", "standard", "fast"])
def test_a_row_has_the_same_bits_alone_and_in_a_batch(backend: str, preset: str) -> None:
    kernel, rows = kernel_of(TANK, backend, preset), tank_rows(100)
    whole = kernel.step(*rows)
    alone = [kernel.step(x, u, d, rows.p[0]) for x, u, d in zip(*rows[:3], strict=True)]
    assert np.stack(alone).tobytes() == whole.tobytes()
    assert kernel_of(TANK, backend, preset, threads=2).step(*rows).tobytes() == whole.tobytes()


@pytest.mark.parametrize("backend", ["casadi", "cvodes"])
@pytest.mark.parametrize(("model", "rows"), [(TANK, tank_rows(40)), (DECAY, decay_rows(5))])
def test_the_backends_agree(model: Model, rows: Rows, backend: str) -> None:
    ours, theirs = (kernel_of(model, name, "tight").step(*rows) for name in ("compiled", backend))
    assert np.abs((ours - theirs) / state_scale(model)).max() < 1e-9


@pytest.mark.parametrize("backend", BACKENDS)
def test_decay_is_the_exponential(backend: str) -> None:
    rows = decay_rows(5)
    exact = rows.x * np.exp(-900.0 * rows.p[0, 0])
    assert np.abs(kernel_of(DECAY, backend).step(*rows) - exact).max() < 1e-6


@pytest.mark.parametrize("backend", BACKENDS)
def test_jacobians_are_those_of_finite_differences(backend: str) -> None:
    kernel, rows = kernel_of(TANK, backend, "tight"), tank_rows(6)
    lines = kernel.linearise(*rows, parameters=TANK.parameter_names[:3])
    found = {"x": lines.dx, "u": lines.du, "d": lines.dd, "p": lines.dp}
    for key, jacobian in found.items():
        for j in range(jacobian.shape[2]):
            table = getattr(rows, key)
            by = 1e-3 * np.abs(table[:, j]).mean()
            up, down = table.copy(), table.copy()
            up[:, j] += by
            down[:, j] -= by
            step = [kernel.advance(rows._replace(**{key: moved}))[0] for moved in (up, down)]
            expected = (step[0] - step[1]) / (2.0 * by)
            assert np.abs(jacobian[:, :, j] - expected).max() < 1e-5 * max(1.0, np.abs(expected).max()), (key, j)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("model", "rows"), [(TANK, tank_rows(6)), (DECAY, decay_rows(3))])
def test_reverse_is_the_transpose_of_forward(model: Model, rows: Rows, backend: str) -> None:
    kernel = kernel_of(model, backend)
    weights = np.linspace(0.5, 2.0, model.sizes["x"])
    lines = kernel.linearise(*rows, parameters=model.parameter_names)
    _, gradient = kernel.adjoint(*rows, weights, parameters=True)
    tolerance = 1e-10 if backend == "compiled" else 1e-5
    for ours, jacobian in ((gradient.x, lines.dx), (gradient.u, lines.du), (gradient.d, lines.dd), (gradient.p, lines.dp)):
        expected = np.einsum("i,nij->nj", weights, jacobian)
        np.testing.assert_allclose(ours, expected, rtol=tolerance, atol=tolerance * np.abs(expected).max(initial=0.0))


def test_parameters_that_are_zero_in_the_models_own_set_are_left_out() -> None:
    assert absent_equipment(TANK) == (TANK.parameter_names.index("leak"),)
    rows = tank_rows(70)
    leaking = np.tile(rows.p, (70, 1))
    leaking[::3, 3] = 1e-3
    for preset in ("reference", "fast"):
        found = kernel_of(TANK, "compiled", preset).step(*rows._replace(p=leaking))
        other = kernel_of(TANK, "compiled", preset).step(*rows)
        assert (found[::3, 0] < other[::3, 0]).all()
        assert found[1::3].tobytes() == other[1::3].tobytes()
    exact = kernel_of(TANK, "casadi", "tight").step(*rows._replace(p=leaking))
    assert np.abs(kernel_of(TANK, "compiled", "tight").step(*rows._replace(p=leaking)) - exact).max() < 1e-8


def test_a_metered_tomato_steps_like_the_tomato(harvests: Rows) -> None:
    meter = METERED.state_index("sumMcFruitHar")
    kernel, plain = (kernel_of(model, "compiled") for model in (METERED, TOMATO))
    found = kernel.step(*harvests)
    expected = plain.step(np.delete(harvests.x, meter, axis=1), *harvests[1:])
    error = np.abs(np.delete(found, meter, axis=1) - expected) / state_scale(TOMATO)
    assert error.max() < 5e-7
    assert found[:, meter].min() > 1.0


@pytest.mark.parametrize(("preset", "limit"), [("reference", 1e-6), ("standard", 2e-4)])
def test_a_metered_tomato_agrees_with_cvodes(harvests: Rows, preset: str, limit: float) -> None:
    rows = Rows(*(table[:8] for table in harvests[:3]), harvests.p)
    ours, theirs = kernel_of(METERED, "compiled", preset).step(*rows), kernel_of(METERED, "cvodes").step(*rows)
    assert np.abs((ours - theirs) / state_scale(METERED)).max() < limit


def test_what_a_meter_adds_up_has_derivatives(harvests: Rows) -> None:
    meter, fruit = METERED.state_index("sumMcFruitHar"), METERED.state_index("cFruit")
    kernel = kernel_of(METERED, "compiled", "tight")
    rows = Rows(*(table[:4] for table in harvests[:3]), harvests.p)
    up, down = rows.x.copy(), rows.x.copy()
    up[:, fruit] += 1.0
    down[:, fruit] -= 1.0
    expected = (kernel.step(up, *rows[1:]) - kernel.step(down, *rows[1:]))[:, meter] / 2.0
    np.testing.assert_allclose(kernel.linearise(*rows).dx[:, meter, fruit], expected, rtol=1e-5)
    assert (np.abs(expected) > 1e-3).all()


def test_models_side_by_side_do_not_disturb_each_other(steps_900: KnownSteps, p: Array, harvests: Rows) -> None:
    tomatoes = Rows(steps_900.x, steps_900.u, steps_900.d, p[None])
    lettuce = get_model("greenlight-lettuce-1.0.0")
    values = lettuce.parameters.default()
    kind = next(iter(lettuce.starts()))
    planted = np.stack([lettuce.start(kind, d, 18.0, values) for d in steps_900.d])
    lettuces = Rows(planted, steps_900.u, steps_900.d, values[None])
    pairs = [
        (TANK, tank_rows(32)), (TOMATO, tomatoes), (METERED, harvests), (DECAY, decay_rows(32)), (lettuce, lettuces),
    ]  # fmt: skip
    kernels = [kernel_of(model, "compiled") for model, _ in pairs]
    apart = [kernel_of(model, "compiled").step(*rows).tobytes() for model, rows in pairs]
    for _ in range(2):
        assert [kernel.step(*rows).tobytes() for kernel, (_, rows) in zip(kernels, pairs, strict=True)] == apart


@pytest.mark.parametrize("backend", BACKENDS)
def test_failures_speak_of_the_model(backend: str) -> None:
    rows = tank_rows(3)
    rows.x[1, 1] = -0.5  # the uptake of salt divides by zero
    after, (failure,) = kernel_of(TANK, backend).try_step(*rows)
    assert failure.row == 1
    assert after[1].tobytes() == rows.x[1].tobytes()
    assert f"controls uTap {rows.u[1, 0]:.3g}; outside rain {rows.d[1, 0]:.4g} m s-1" in failure.reason
    assert "salt" in failure.reason
    assert "model time" not in failure.reason
    with pytest.raises(StepError, match="row 1 of 3"):
        kernel_of(TANK, backend).linearise(*rows)


def test_inputs_are_checked_by_the_models_names() -> None:
    kernel, (x, u, d, p) = Kernel(TANK, 900.0, backend="casadi"), tank_rows(2)
    with pytest.raises(ShapeError, match=r"expected \(2,\) or \(rows, 2\), in the order level, salt\."):
        kernel.step(np.zeros(28), u, d, p)
    with pytest.raises(ActionError, match="Control uTap of row 0"):
        kernel.step(x, u + 2.0, d, p)
    with pytest.raises(ShapeError, match="disturbance rain of row 0 is nan"):
        kernel.step(x, u, d * np.nan, p)
    with pytest.raises(UnknownNameError, match=r"no parameter 'leek'.*leak"):
        kernel.linearise(x, u, d, p, parameters=["leek"])


def test_a_kernel_says_which_model_it_steps_and_is_copied_with_it() -> None:
    kernel = Kernel(TANK, 300.0, backend="casadi", preset="fast")
    facts = kernel.describe()
    assert (facts["model_version"], facts["model_digest"]) == (TANK.version, TANK.digest)
    twin = pickle.loads(pickle.dumps(kernel))
    assert twin.model == kernel.model
    assert twin.step(*tank_rows(1)).tobytes() == kernel.step(*tank_rows(1)).tobytes()


@dataclass(frozen=True)
class OddTank(Tank):
    """A tank with an operation that the generator does not know."""

    def equations(self, x, u, d, p):  # type: ignore[no-untyped-def]
        rates = super().equations(x, u, d, p).derivative
        return Evaluation(rates._replace(salt=rates.salt + 1e-6 * casadi.erf(x.level)), ())


def test_a_model_that_cannot_be_compiled_is_stepped_by_casadi() -> None:
    odd = OddTank()
    if why_not_compiled(TANK) is not None:
        pytest.skip("There is no compiler.")
    with pytest.raises(CompiledUnavailable, match=r"tank-1\.0\.0 cannot be compiled.*OP_ERF"):
        CompiledStepper(odd, 900.0)
    assert Kernel(odd, 900.0).backend == "casadi"


def test_equal_names_with_other_equations_do_not_share_a_library() -> None:
    @dataclass(frozen=True)
    class FasterTank(Tank):
        def equations(self, x, u, d, p):  # type: ignore[no-untyped-def]
            rates = super().equations(x, u, d, p).derivative
            return Evaluation(rates._replace(level=2.0 * rates.level), ())

    rows = tank_rows(1)
    ours, theirs = (kernel_of(model, "compiled").step(*rows) for model in (TANK, FasterTank()))
    assert ours.tobytes() != theirs.tobytes()
