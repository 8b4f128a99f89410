"""What only some rows of a vector environment have in ``info``, in Gymnasium's form: an array of objects and its mask."""

from __future__ import annotations

from typing import Any

import numpy as np

from glbench.env.info import FAILURE
from glbench.env.step_result import StepResult


def add_objects(info: dict[str, Any], name: str, objects: dict[int, Any], n: int) -> None:
    """Add what only some rows have, by row, as an array of objects with its mask."""
    array, mask = np.full(n, None, dtype=object), np.zeros(n, dtype=np.bool_)
    for row, value in objects.items():
        array[row], mask[row] = value, True
    info[name], info[f"_{name}"] = array, mask


def add_failures(info: dict[str, Any], result: StepResult) -> None:
    """Add the reasons of the rows that could not be integrated, if any."""
    if result.failed:
        reasons = {failure.row: failure.reason for failure in result.failed}
        add_objects(info, FAILURE, reasons, len(result.rewards))
