"""Speed of the compiled step as a ratio to CVODES with CasADi's just-in-time compilation, measured in the same run.

``uv run --group dev pytest benchmarks --benchmark-json=speed.json`` keeps the figures: processor time of a step of 900 s, and the
ratio, under ``extra_info``. Nothing here passes or fails by its time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.kernel.compiled import CompiledStepper, availability
from glbench.kernel.compiled.accuracy import EXACT, KINDS, make_cvodes, make_inputs, run_compiled
from glbench.model import default_parameters

Array = NDArray[np.float64]

PRESETS = ["reference", "standard", "fast"]

pytestmark = [pytest.mark.slow, pytest.mark.skipif(availability() is not None, reason=str(availability()))]


@pytest.fixture(scope="module")
def parameters() -> Array:
    """Nominal parameters (208,)."""
    return default_parameters()


@pytest.fixture(scope="module", params=KINDS)
def points(request: pytest.FixtureRequest) -> tuple[Array, Array, Array]:
    """States, controls and weather of 512 steps in all months, under controls that walk or jump."""
    inputs = make_inputs(request.param, range(12), 2)
    exact, _ = run_compiled(inputs, EXACT)
    states = np.concatenate([inputs.initial[None], exact[:-1]])
    pick = np.random.default_rng(0).choice(states.shape[0] * 12, 512, replace=False)
    x, u, d = (np.ascontiguousarray(a.reshape(-1, a.shape[2])[pick]) for a in (states, inputs.controls, inputs.weather))
    return x, u, d


@pytest.fixture(scope="module")
def cvodes_seconds(points: tuple[Array, Array, Array], tmp_path_factory: pytest.TempPathFactory) -> float:
    """Processor time of one step by CVODES, best of several passes."""
    x, u, d = points
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("jit"))  # CasADi compiles in the working directory
        integrator = make_cvodes(1e-6, jit=True)
    held = np.concatenate([u, d], axis=1)

    def run() -> None:
        for k in range(128):
            integrator(x0=x[k], p=held[k])

    return best(run) / 128


def best(run: Callable[[], object]) -> float:
    """Processor time of the fastest of twelve runs [s]: the others were disturbed."""
    found = []
    for _ in range(12):
        started = time.process_time()
        run()
        found.append(time.process_time() - started)
    return min(found)


@pytest.mark.parametrize("preset", PRESETS)
def test_one_environment(
    points: tuple[Array, Array, Array], parameters: Array, cvodes_seconds: float, preset: str, benchmark: Any
) -> None:
    stepper = CompiledStepper(900.0, preset=preset)
    out = np.empty((1, 28))
    rows = [tuple(a[k : k + 1].copy() for a in points) for k in range(512)]
    steps = [stepper.bind(*row, parameters[None], out) for row in rows]

    def run() -> None:
        for step in steps:
            step()

    benchmark.pedantic(run, rounds=3)
    seconds = best(run) / 512
    benchmark.extra_info.update(us_per_step=seconds * 1e6, ratio_to_cvodes=cvodes_seconds / seconds)


@pytest.mark.parametrize("preset", PRESETS)
def test_a_batch(
    points: tuple[Array, Array, Array], parameters: Array, cvodes_seconds: float, preset: str, benchmark: Any
) -> None:
    stepper = CompiledStepper(900.0, preset=preset)
    out = np.empty_like(points[0])

    def run() -> None:
        stepper.step_rows(*points, parameters, out)

    benchmark.pedantic(run, rounds=5)
    seconds = best(run) / 512
    benchmark.extra_info.update(us_per_step=seconds * 1e6, ratio_to_cvodes=cvodes_seconds / seconds)


@pytest.mark.parametrize("rows", [64, 512, 4096])
def test_a_step_of_many_environments(
    points: tuple[Array, Array, Array], parameters: Array, rows: int, benchmark: Any
) -> None:
    stepper = CompiledStepper(900.0, preset="standard")
    x, u, d = (np.resize(a, (rows, a.shape[1])) for a in points)
    out = np.empty_like(x)

    def run() -> None:
        stepper.step_rows(x, u, d, parameters, out)

    benchmark.pedantic(run, rounds=5)
    benchmark.extra_info.update(us_per_step=best(run) / rows * 1e6)
