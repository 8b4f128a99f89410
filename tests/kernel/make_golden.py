"""Recomputes the 900 s steps of tests/golden/kernel_steps.npz with SciPy's Radau IIA, an integrator that glbench does not use.

Run as ``python -m tests.kernel.make_golden`` on purpose only: tests compare the kernel with these numbers. The inputs and the
300 s steps in the file are kept; where the latter come from is written in tests/golden/kernel_steps.md.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from glbench.kernel import state_scale
from glbench.model import TOMATO, default_parameters, jacobian, rhs
from tests.kernel.known_steps import GOLDEN, Array

STATE_SCALE = state_scale(TOMATO)


def radau_step(x: Array, u: Array, d: Array, p: Array, seconds: float) -> Array:
    """x(t + seconds) at a relative tolerance of 1e-12."""
    solution = solve_ivp(
        lambda _t, z: rhs(z * STATE_SCALE, u, d, p) / STATE_SCALE,
        (0.0, seconds),
        x / STATE_SCALE,
        method="Radau",
        rtol=1e-12,
        atol=1e-12,
        jac=lambda _t, z: jacobian(z * STATE_SCALE, u, d, p) * STATE_SCALE / STATE_SCALE[:, None],
    )
    if not solution.success:
        raise RuntimeError(solution.message)
    last: Array = solution.y[:, -1] * STATE_SCALE
    return last


def main() -> None:
    with np.load(GOLDEN) as file:
        data = {key: file[key] for key in file.files}
    p = default_parameters()
    inputs = zip(data["x_900"], data["u_900"], data["d_900"], strict=True)
    data["next_900"] = np.array([radau_step(x, u, d, p, 900.0) for x, u, d in inputs])
    np.savez_compressed(GOLDEN, **data)


if __name__ == "__main__":
    main()
