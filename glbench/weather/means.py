"""Exact means of hourly (or 5-minute) weather over control steps of any length."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from glbench.weather.record import FloatArray, IntArray


class Means:
    """Means over the intervals ``[starts, ends)`` of functions given cell by cell.

    Parameters
    ----------
    starts, ends : ndarray (n,) of int64
        Seconds; every interval is at least 1 s long and lies inside the cells.
    begin, cell : int
        Start of the first cell and length of every cell, seconds.

    An interval inside one cell is never computed as a difference of long running sums, so nothing is lost to rounding.
    """

    def __init__(self, starts: IntArray, ends: IntArray, begin: int, cell: int) -> None:
        self._cell = cell
        self._first = (starts - begin) // cell
        self._last = (ends - begin - 1) // cell
        self._from = (starts - begin) - self._first * cell
        self._to = (ends - begin) - self._last * cell
        self._duration = ends - starts
        self._inside = self._first == self._last

    def of_constants(self, values: FloatArray) -> FloatArray:
        """Means (n,) of a function that is ``values[i]`` throughout cell i."""

        def partial(cells: IntArray, seconds: IntArray) -> FloatArray:
            return np.asarray(values[cells] * seconds)

        across = self._across(values * self._cell, partial)
        return np.where(self._inside, values[self._first], across / self._duration)

    def of_lines(self, nodes: FloatArray) -> FloatArray:
        """Means (n,) of the function that runs linearly from ``nodes[i]`` to ``nodes[i + 1]`` in cell i."""
        rise = np.diff(nodes)

        def partial(cells: IntArray, seconds: IntArray) -> FloatArray:
            return np.asarray((nodes[cells] + rise[cells] * (seconds / (2.0 * self._cell))) * seconds)

        across = self._across((nodes[:-1] + rise / 2.0) * self._cell, partial)
        middle = (self._from + self._to) / (2.0 * self._cell)
        return np.where(self._inside, nodes[self._first] + rise[self._first] * middle, across / self._duration)

    def of_amounts(self, amounts: IntArray, shares: FloatArray) -> FloatArray:
        """Mean rates (n,) [amount per second] when cell i receives ``amounts[i]``, of which ``shares[i, j]`` by part j's start.

        ``shares`` (cells, parts + 1) rises from exactly 0 to exactly 1; within a part it is linear.
        """
        parts = shares.shape[1] - 1

        def share(cells: IntArray, seconds: IntArray) -> FloatArray:
            position = seconds * (parts / self._cell)
            part = np.minimum(position.astype(np.int64), parts - 1)
            low, high = shares[cells, part], shares[cells, part + 1]
            return np.asarray(low + (high - low) * (position - part))

        def partial(cells: IntArray, seconds: IntArray) -> FloatArray:
            return np.asarray(amounts[cells] * share(cells, seconds))

        inside = amounts[self._first] * (share(self._first, self._to) - share(self._first, self._from))
        return np.asarray(np.where(self._inside, inside, self._across(amounts, partial)) / self._duration)

    def _across(self, whole: FloatArray | IntArray, partial: Callable[[IntArray, IntArray], FloatArray]) -> FloatArray:
        """Integrals over intervals that span cells: the end of the first, the whole ones between, the beginning of the last."""
        running = np.concatenate(([0], np.cumsum(whole)))
        # Inside one cell there is nothing between; the caller takes its own value there.
        between = running[np.maximum(self._last, self._first)] - running[np.minimum(self._first + 1, self._last)]
        head = whole[self._first] - partial(self._first, self._from)
        return np.asarray(head + between + partial(self._last, self._to))
