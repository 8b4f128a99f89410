"""Cost of the derivatives of a step of 900 s, as multiples of the step itself in the same run, and how accurate they are.

``pytest benchmarks/test_sensitivities.py --benchmark-json=sensitivities.json`` keeps the figures under ``extra_info``: processor time a
step, and the ratios to a step alone and in a batch. Nothing here passes or fails by its time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from docs.accuracy_table import EXACT, make_inputs, run_compiled
from glbench.kernel import Kernel, state_scale
from glbench.kernel.compiled import availability
from glbench.kernel.records import Rows, as_rows
from glbench.model import TOMATO, default_parameters

STATE_SCALE = state_scale(TOMATO)

Array = NDArray[np.float64]

ROWS = 256
PRESETS = ["reference", "standard", "fast"]
KINDS: dict[str, Callable[[Kernel, Rows], object]] = {
    "direction": lambda kernel, rows: kernel.forward(*rows, dx=np.ones(28), du=np.ones(6)),
    "adjoint": lambda kernel, rows: kernel.adjoint(*rows, np.ones(28)),
    "jacobian": lambda kernel, rows: kernel.linearise(*rows),
}

pytestmark = [pytest.mark.slow, pytest.mark.skipif(availability() is not None, reason=str(availability()))]


@pytest.fixture(scope="module")
def rows() -> Rows:
    """States, controls and weather under walking controls, in all months."""
    inputs = make_inputs("walk", range(12), 2)
    exact, _ = run_compiled(inputs, EXACT)
    states = np.concatenate([inputs.initial[None], exact[:-1]])
    pick = np.random.default_rng(0).choice(states.shape[0] * 12, ROWS, replace=False)
    tables = (a.reshape(-1, a.shape[2])[pick] for a in (states, inputs.controls, inputs.weather))
    return as_rows(TOMATO.names, *tables, default_parameters())


def best(run: Callable[[], object]) -> float:
    """Processor time of the fastest of five runs [s]."""
    found = []
    for _ in range(5):
        started = time.process_time()
        run()
        found.append(time.process_time() - started)
    return min(found)


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_batch(rows: Rows, preset: str, kind: str, benchmark: Any) -> None:
    kernel = Kernel(TOMATO, 900.0, backend="compiled", preset=preset)
    alone = [rows.take(np.arange(k, k + 1)) for k in range(ROWS)]
    one = best(lambda: [kernel.advance(row) for row in alone]) / ROWS
    many = best(lambda: kernel.advance(rows)) / ROWS
    benchmark.pedantic(lambda: KINDS[kind](kernel, rows), rounds=5, warmup_rounds=1)
    seconds = best(lambda: KINDS[kind](kernel, rows)) / ROWS
    benchmark.extra_info.update(
        us_per_step=seconds * 1e6,
        us_plain_step_alone=one * 1e6,
        us_plain_step_in_batch=many * 1e6,
        ratio_to_step_alone=seconds / one,
        ratio_to_step_in_batch=seconds / many,
    )


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("kind", KINDS)
def test_one_state(rows: Rows, preset: str, kind: str, benchmark: Any) -> None:
    kernel = Kernel(TOMATO, 900.0, backend="compiled", preset=preset)
    alone = [rows.take(np.arange(k, k + 1)) for k in range(ROWS)]

    def run() -> None:
        for row in alone:
            KINDS[kind](kernel, row)

    benchmark.pedantic(run, rounds=2, warmup_rounds=1)
    benchmark.extra_info.update(us_per_step=best(run) / ROWS * 1e6)


@pytest.mark.parametrize("preset", PRESETS)
def test_errors_of_the_jacobian(rows: Rows, preset: str, benchmark: Any) -> None:
    """Largest error of each column against ``tight``, in scaled units, relative to the column's largest entry (or to 1e-3)."""
    kernel = Kernel(TOMATO, 900.0, backend="compiled", preset=preset)
    exact = Kernel(TOMATO, 900.0, backend="compiled", preset="tight").linearise(*rows)
    found = benchmark.pedantic(lambda: kernel.linearise(*rows), rounds=1)
    units = {"dx": STATE_SCALE, "du": np.ones(6), "dd": np.array([1e3, 10, 1e3, 1e3, 10, 10, 10, 10, 1, 1])}
    errors = []
    for key, unit in units.items():
        ours, theirs = (getattr(of, key) * unit / STATE_SCALE[:, None] for of in (found, exact))
        errors.append(np.abs(ours - theirs).max(axis=1) / np.maximum(np.abs(theirs).max(axis=1), 1e-3))
    error = np.concatenate(errors, axis=1)
    benchmark.extra_info.update({f"quantile_{q}": float(np.quantile(error, q)) for q in (0.5, 0.9, 0.99)})
