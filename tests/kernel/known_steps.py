"""Steps whose result was computed by others, from tests/golden/kernel_steps.npz."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[np.float64]

GOLDEN = Path(__file__).resolve().parent.parent / "golden" / "kernel_steps.npz"


class KnownSteps(NamedTuple):
    """Inputs (n, ...) of steps with the default parameters, the states afterwards, and where each row comes from."""

    x: Array
    u: Array
    d: Array
    after: Array
    labels: list[str]


def known_steps(seconds: int) -> KnownSteps:
    """The known steps of 300 or 900 s."""
    with np.load(GOLDEN) as file:
        x, u, d, after = (file[f"{key}_{seconds}"] for key in ("x", "u", "d", "next"))
        return KnownSteps(x, u, d, after, [str(label) for label in file[f"label_{seconds}"]])
