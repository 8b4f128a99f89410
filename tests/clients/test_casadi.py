"""The examples of docs/casadi.md run as they stand, and give what the kernel gives."""

from __future__ import annotations

from typing import Any

import casadi
import numpy as np
import pytest

from glbench.errors import ShapeError
from glbench.kernel import Kernel
from glbench.model import TOMATO, rhs
from tests.support import examples_of, run_examples

MODEL, INTEGRATOR, DO_MPC, ACADOS = examples_of("casadi.md")


@pytest.fixture(scope="module")
def names() -> dict[str, Any]:
    return run_examples("casadi.md", [MODEL, INTEGRATOR], {})


def test_the_function_is_the_model_and_its_integral_the_kernels_step(names: dict[str, Any]) -> None:
    task, weather, controls = names["task"], names["weather"][0], names["controls"]
    x, p = task.initial_state(), task.parameters()
    assert np.array_equal(names["f"](x, controls, weather, p).full().ravel(), names["model"].rhs(x, controls, weather, p))
    stepped = Kernel(names["model"], 900.0, preset="tight").step(x, controls, weather, p)
    assert np.allclose(names["after"], stepped, rtol=1e-5, atol=1e-6)
    assert names["jacobian"](x, controls, weather).shape == (28, 28)


def test_what_acados_asks_for_is_there(names: dict[str, Any]) -> None:
    model = run_examples("casadi.md", [ACADOS], dict(names))["ocp_model"]
    residual = casadi.Function("r", [model.xdot, model.x, model.u, model.p], [model.f_impl_expr])
    x, u, d = names["task"].initial_state(), names["controls"], names["weather"][0]
    rate = names["f"](x, u, d, names["task"].parameters())
    assert float(casadi.norm_inf(residual(rate, x, u, d))) < 1e-12


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_do_mpc_controls_it(names: dict[str, Any]) -> None:
    pytest.importorskip("do_mpc", reason="do-mpc is not installed (python -m docs.compatibility_table installs it)")
    made = run_examples("casadi.md", [DO_MPC], dict(names))
    assert made["mpc"].solver_stats["success"]
    assert ((made["decision"] > -1e-6) & (made["decision"] < 1.0 + 1e-6)).all()


@pytest.mark.parametrize("kind", [casadi.SX, casadi.MX])
def test_expressions_are_led_to_the_functions(kind: Any) -> None:
    x, u, d, p = kind.sym("x", 28), np.zeros(6), np.zeros(10), np.zeros(208)
    doors = (TOMATO.rhs, rhs, TOMATO.auxiliary_values, TOMATO.jacobian, Kernel(TOMATO, 900.0).step, Kernel(TOMATO, 900.0).linearise)
    for door in doors:
        with pytest.raises(ShapeError, match=rf"x is a CasADi expression \({kind.__name__}\).*model\.rhs_function\(\)\(x, u, d, p\)"):
            door(x, u, d, p)
