"""Triangles with colours: what a renderer gets. Lengths are in metres, z points up, colours are reflectances (linear RGB)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import Floats

GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))
"""Turn from one leaf to the next [rad]."""


@dataclass(frozen=True)
class Mesh:
    """A surface of triangles."""

    vertices: Floats
    """Positions [m], shape (n, 3)."""
    triangles: NDArray[np.int64]
    """Rows of ``vertices``, shape (m, 3)."""
    colours: Floats
    """Reflectance of each vertex in red, green and blue, 0 to 1, shape (n, 3)."""

    @property
    def area(self) -> float:
        """Area, one side [m2]."""
        a, b, c = (self.vertices[self.triangles[:, corner]] for corner in range(3))
        return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """Several meshes as one."""
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.triangles + start for mesh, start in zip(meshes, first, strict=False)]),
        np.concatenate([mesh.colours for mesh in meshes]),
    )


def of_grids(points: Floats, colours: Floats) -> Mesh:
    """Surfaces from grids of points, shape (surfaces, rows, columns, 3), with ``colours`` of the same shape."""
    surfaces, rows, columns, _ = points.shape
    index = np.arange(surfaces * rows * columns).reshape(surfaces, rows, columns)
    a, b, c, d = index[:, :-1, :-1], index[:, :-1, 1:], index[:, 1:, :-1], index[:, 1:, 1:]
    triangles = np.concatenate([np.stack([a, b, c], axis=-1), np.stack([b, d, c], axis=-1)]).reshape(-1, 3)
    return Mesh(points.reshape(-1, 3), triangles, np.clip(colours.reshape(-1, 3), 0.0, 1.0))


def draws(*key: int) -> np.random.Generator:
    """Random numbers that depend on ``key`` alone: whole numbers, not negative."""
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(key)))


def smooth(x: Any, low: float, high: float) -> Any:
    """0 below ``low``, 1 above ``high``, smooth in between."""
    share = np.clip((x - low) / (high - low), 0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)


def tubes(ends: Floats, radius: float, colour: Sequence[float]) -> Mesh:
    """Straight tubes of four sides between two points each [m], shape (n, 2, 3)."""
    axis = ends[:, 1] - ends[:, 0]
    is_flat = np.abs(axis[:, 2:]) < 0.9 * np.linalg.norm(axis, axis=1, keepdims=True)
    one = np.cross(axis, np.where(is_flat, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
    other, turn = np.cross(axis, one), np.linspace(0.0, 2.0 * np.pi, 5)[None, :, None]
    one, other = (side / np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-12) for side in (one, other))
    points = ends[:, :, None] + radius * (np.cos(turn) * one[:, None] + np.sin(turn) * other[:, None])[:, None]
    return of_grids(points, np.broadcast_to(np.array(colour), points.shape))
