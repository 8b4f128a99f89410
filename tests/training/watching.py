"""Listening to a search, and ending it in the middle."""

from __future__ import annotations

from glbench.training import CurvePoint, Progress


class PowerCutError(Exception):
    """Stands for the power cut."""


class Watching:
    """Keeps what it is told, and pulls the plug after some generations."""

    def __init__(self, generations: int | None = None) -> None:
        self.points: list[CurvePoint] = []
        self.told: list[Progress] = []
        self._left = generations

    def on_progress(self, progress: Progress) -> None:
        self.told.append(progress)
        if len(self.told) == self._left:
            raise PowerCutError

    def on_evaluation(self, point: CurvePoint) -> None:
        self.points.append(point)

    def on_saved(self, steps: int) -> None: ...
