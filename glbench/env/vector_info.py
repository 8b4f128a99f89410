"""Infos of a vector environment in Gymnasium's form: an array for each name, and a mask of the rows it holds for."""

from __future__ import annotations

from collections.abc import Container
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.env.info import FAILURE
from glbench.env.step_result import StepResult

Mask = NDArray[np.bool_]


def with_masks(
    columns: dict[str, NDArray[np.generic]], rows: Mask, stepped: Mask, names_of_step: Container[str]
) -> dict[str, Any]:
    """``columns`` with their masks: quantities of a step hold for the rows in ``stepped``, the others for ``rows``.

    Where a column does not hold it is 0.
    """
    info: dict[str, Any] = {}
    of_step, of_row = (stepped, bool(stepped.all())), (rows, bool(rows.all()))
    for name, values in columns.items():
        mask, everywhere = of_step if name in names_of_step else of_row
        info[name] = values if everywhere else np.where(mask, values, np.zeros_like(values))
        info[f"_{name}"] = mask
    return info


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
