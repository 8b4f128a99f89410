"""What a picture of a crop is chosen by."""

from __future__ import annotations

from collections.abc import Mapping

from glbench.arrays import Floats


def row_of(columns: Mapping[str, Floats], parameters: Mapping[str, float]) -> tuple[Floats, Floats, Floats] | None:
    """Leaf area index [m2 m-2], fruits on the plants and ripe ones [m-2] by the columns of a record; None without a crop of trusses."""
    if not {"cLeaf", "fruits", "nRipe"} <= columns.keys():
        return None
    return parameters["sla"] * columns["cLeaf"], columns["fruits"], columns["nRipe"]
