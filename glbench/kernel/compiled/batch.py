"""Arrays and pointers for a batch of rows, made once for each batch size."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glbench.errors import ShapeError
from glbench.kernel.compiled.binding import RowPointers
from glbench.model import CONTROL_NAMES, DISTURBANCE_NAMES, PARAMETER_NAMES, STATE_NAMES

Array = NDArray[np.float64]
Status = NDArray[np.int32]

SIZES = {"x": len(STATE_NAMES), "u": len(CONTROL_NAMES), "d": len(DISTURBANCE_NAMES), "p": len(PARAMETER_NAMES)}
SHARED = (SIZES["p"],)
COPIED_ROWS = 64
"""Up to so many rows it is quicker to copy the inputs beside fixed pointers than to ask arrays for theirs."""


@dataclass(frozen=True)
class Batch:
    """Arrays and pointers for ``n`` rows; the inputs are empty where the caller's own arrays are used."""

    n: int
    x: Array
    u: Array
    d: Array
    p: Array
    out: Array
    status: Status
    substeps: Status
    reached: Array
    pointers: RowPointers
    call: object  # ctypes.byref(pointers)
    x_shape: tuple[int, int]
    u_shape: tuple[int, int]
    d_shape: tuple[int, int]
    p_shape: tuple[int, int]

    def any_failed(self) -> bool:
        """Whether a row was not stepped."""
        return bool(self.pointers.failed != 0)


def new_batch(n: int, *, copies: bool | None = None) -> Batch:
    """Arrays for ``n`` rows; ``copies`` says whether inputs are copied (by default up to ``COPIED_ROWS`` rows)."""
    own = n if (n <= COPIED_ROWS if copies is None else copies) else 0
    x, u, d, p, out = (np.zeros((own, SIZES[name])) for name in ("x", "u", "d", "p", "x"))
    status, substeps, reached = np.zeros(n, np.int32), np.zeros(n, np.int32), np.zeros(n)
    pointers = RowPointers(
        n=n,
        p_stride=SIZES["p"],
        x=x.ctypes.data,
        u=u.ctypes.data,
        d=d.ctypes.data,
        p=p.ctypes.data,
        out=out.ctypes.data,
        status=status.ctypes.data,
        substeps=substeps.ctypes.data,
        reached=reached.ctypes.data,
    )
    shapes = ((n, SIZES[name]) for name in "xudp")
    return Batch(n, x, u, d, p, out, status, substeps, reached, pointers, ctypes.byref(pointers), *shapes)


def wrong_arrays(x: Array, u: Array, d: Array, p: Array, out: Array) -> ShapeError:
    """The error for arrays that do not fit together."""
    found = ", ".join(
        f"{name} {a.dtype}{a.shape}" for name, a in (("x", x), ("u", u), ("d", d), ("p", p), ("out", out))
    )
    msg = (
        "step_rows wants C-contiguous float64 arrays x (n, 28), u (n, 6), d (n, 10), p (n, 208) or (208,), out (n, 28), "
        f"not {found}."
    )
    return ShapeError(msg)
