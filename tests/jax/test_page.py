"""The examples of docs/jax.md run as they stand."""

from __future__ import annotations

import numpy as np
import pytest

from glbench.kernel import why_not_compiled
from tests.support import examples_of, run_examples

pytest.importorskip("jax", reason="JAX is not installed (extra 'jax')")
pytestmark = [pytest.mark.slow, pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))]


def test_the_examples_run(capsys: pytest.CaptureFixture[str]) -> None:
    names = run_examples("jax.md", examples_of("jax.md"), {})
    assert "(16, 22)" in capsys.readouterr().out.replace("96, ", "")
    assert np.array_equal(names["states"].scenario, [0, 1, 2])
    assert np.isfinite(names["profits"]).all()
