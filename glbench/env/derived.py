"""Which parameters follow from uncertain ones, and their values for many draws at once."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.kernel.tape import Recorder, Tape, Value
from glbench.model import PARAMETER_NAMES, TOMATO

Floats = NDArray[np.float64]


class DerivedParameters:
    """Carries draws of uncertain parameters through to the derived ones, by the model's own formulas.

    With the crop parameters that is the leaf mass at which leaves are pruned: cLeafMax = laiMax/sla. A derived parameter
    that depends on none of the uncertain ones keeps its nominal value.

    Attributes
    ----------
    uncertain
        Places of the uncertain parameters in the vector.
    columns
        These, followed by the places of the derived parameters that are not among them.
    """

    def __init__(self, nominal: Floats, names: tuple[str, ...]) -> None:
        self._nominal: list[Any] = list(nominal.tolist())
        self.uncertain = [PARAMETER_NAMES.index(name) for name in names]
        followers = self._followers(nominal[self.uncertain][:, None])
        self.columns = self.uncertain + [place for place in followers if place not in self.uncertain]

    def complete(self, drawn: Floats) -> Floats:
        """Values of ``columns`` from values of ``uncertain``: ``(..., columns)`` from ``(..., uncertain)``."""
        values = np.moveaxis(drawn, -1, 0)
        completed = np.empty((len(self.columns), *values.shape[1:]))
        completed[: len(values)] = values
        for place, value in self._followers(values).items():
            completed[self.columns.index(place)] = value
        return np.moveaxis(completed, 0, -1)

    def tape(self) -> Tape:
        """What follows from the uncertain parameters (``drawn``, by place), as a tape for the compiled kernel.

        Raises
        ------
        RecordingError
            When a formula needs more than arithmetic.
        """
        recorder = Recorder()
        for place, value in self._followers([recorder.input("drawn", place) for place in self.uncertain]).items():
            recorder.output("parameters", place, value)
        return recorder.tape()

    def _followers(self, values: Any) -> dict[int, Any]:
        """Derived parameters that change with ``values`` ``(uncertain, ...)``, by place."""
        given = self._nominal.copy()
        for place, value in zip(self.uncertain, values, strict=True):
            given[place] = value
        # What follows from an array is a new array; numbers, and arrays that were handed in, depend on nothing uncertain.
        return {
            place: value
            for place, value in enumerate(TOMATO.derived(TOMATO.Parameters(*given)))
            if isinstance(value, np.ndarray | Value) and value is not given[place]
        }
