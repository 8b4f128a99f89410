"""glbench works without JAX, and says what to install where it is asked for."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from glbench.errors import GlbenchError
from glbench.kernel import why_not_compiled

PROGRAM = """
import hashlib, jax, numpy as np
from glbench.jax import Environment
environment = Environment("glbench/Schiphol2010-Delta10-v1", seeds=range(3))
_, state = environment.reset(jax.random.key(0))
step = jax.jit(environment.step)
print(hashlib.sha256(np.asarray(step(jax.random.key(1), state, np.zeros(6, np.float32))[0]).tobytes()).hexdigest())
"""


def test_without_jax_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "jax", None)
    monkeypatch.delitem(sys.modules, "glbench.jax", raising=False)
    with pytest.raises(GlbenchError, match=r'pip install "glbench\[jax\]"'):
        importlib.import_module("glbench.jax")


@pytest.mark.slow
@pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))
def test_another_process_finds_the_programs_that_jax_stored(tmp_path: Path) -> None:
    pytest.importorskip("jax", reason="JAX is not installed (extra 'jax')")
    cache = tmp_path / "cache"
    settings = {
        "JAX_COMPILATION_CACHE_DIR": str(cache),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }
    runs = []
    for _ in range(2):
        done = subprocess.run([sys.executable, "-c", PROGRAM], env=os.environ | settings, capture_output=True, text=True, check=True)
        stored = sorted(file.name for file in cache.rglob("*-cache"))
        runs.append((done.stdout, [name for name in stored if "step" in name], stored))
    assert len(runs[0][1]) == 1
    assert runs[0] == runs[1]


@pytest.mark.slow
@pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))
def test_half_a_library_is_built_again_instead_of_crashing_the_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("jax", reason="JAX is not installed (extra 'jax')")
    library = importlib.import_module("glbench.jax.library")
    monkeypatch.setattr(library, "cache_folder", lambda: tmp_path)
    built = Path(library._build())
    whole, made = built.read_bytes(), built.stat().st_mtime_ns
    assert Path(library._build()) == built
    assert built.stat().st_mtime_ns == made, "it is built once"
    built.write_bytes(whole[: len(whole) // 2])
    assert Path(library._build()).read_bytes() == whole
