"""Data of the compiled kernel's tests, and a skip with the reason where there is no compiler."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.kernel.compiled import availability
from glbench.kernel.compiled.compiler import CompiledUnavailable, find_compiler
from glbench.model import default_parameters

Array = NDArray[np.float64]
GOLDEN = Path(__file__).parent.parent / "golden"


@pytest.fixture(scope="session")
def compiled() -> None:
    """Skip a test that needs a compiled library where there is no compiler; one that fails on the kernel fails the test."""
    try:
        find_compiler()
    except CompiledUnavailable as reason:
        pytest.skip(str(reason))
    reason_why_not = availability()
    if reason_why_not is not None:
        pytest.fail(reason_why_not)


@pytest.fixture(scope="session")
def parameters() -> Array:
    return default_parameters()


@pytest.fixture(scope="session")
def golden_steps() -> dict[str, Array]:
    """States, inputs and states 300 s later: 40 steps in winter and 40 in summer, by Radau IIA at tolerance 1e-12."""
    with np.load(GOLDEN / "kernel_compiled_steps.npz") as file:
        return {name: file[name] for name in file.files}


@pytest.fixture(scope="session")
def rows(golden_steps: dict[str, Array]) -> tuple[Array, Array, Array]:
    """States, weather and restless controls of 1,000 rows."""
    generator = np.random.default_rng(5)
    pick = generator.integers(0, 80, 1000)
    x = np.concatenate([golden_steps["winter_x"], golden_steps["summer_x"]])[pick]
    d = np.concatenate([golden_steps["winter_d"], golden_steps["summer_d"]])[pick]
    return x, generator.uniform(0.0, 1.0, (1000, 6)).round(1), d
