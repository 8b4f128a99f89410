"""A double row of high-wire tomatoes as triangles, from the leaf area of the crop and the number of fruits in each stage.

Leaves follow each other down the stem at the golden angle; the lowest are taken off. Trusses hang in the order of their age, the ripe ones
lowest, where the stem is bare. Chosen, after photographs and these figures: three leaves and 0.22 m of stem between two trusses, a truss
a week, and eight to nine weeks from set to ripe, so some 1.9 m from a truss in flower to a ripe one; leaves of half a metre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import Floats
from glbench.vision.mesh import GOLDEN_ANGLE, Mesh, draws, joined, of_grids, smooth, tubes

STEMS = 2.5
"""Stems per floor area [m-2]."""
PITCH, LENGTH, LINES = 1.6, 2.4, 0.5
"""From one double row to the next, length of the section, and from one of its two lines of stems to the other [m]."""
GUTTER, TALLEST = 0.45, 2.25
"""Height of the gutter, and of the tallest plants above it [m]."""
RIPE = 0.95
"""Development from which a fruit counts as ripe: 0 at set, 1 when red all over."""
TRUSS, FLOWERS = 7.0, 5
"""Fruits of a truss, on average, and open flowers of a stem."""
RADIUS = 0.029
"""Of a full-grown fruit [m]: about 100 g."""
_TO_FLOWERS, _TO_RIPE = 0.22, 1.85
"""Stem from the tip to the truss in flower, and from there to the ripe one [m]."""
_ROW, _STEM, _LEAVES, _TRUSSES = 4, 5, 6, 7
"""Streams of draws: what a row shares; what each stem, its leaves and its trusses have of their own."""
_LEAFLETS = np.array([
    (1.0, 0, 1.0), (0.78, 1, 0.85), (0.74, -1, 0.85), (0.55, 1, 0.8), (0.51, -1, 0.8),
    (0.34, 1, 0.6), (0.3, -1, 0.6), (0.18, 1, 0.3), (0.15, -1, 0.3),
])  # fmt: skip
"""Place on the leaf's stalk, side, and relative length of each leaflet."""
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Row:
    """Triangles of a section of a double row, and what is on each of its stems."""

    leaves: Mesh
    stems: Mesh
    """Stems, stalks of trusses, and strings."""
    fruit: Mesh
    """Fruits and flowers."""
    fruits: NDArray[np.int64]
    """Fruits of each stem, shape (stems,)."""
    ripe: NDArray[np.int64]
    """Ripe ones among them, shape (stems,)."""


def row(leaf_area_index: float, fruits: Floats, variation: int) -> Row:
    """The row of a crop with this leaf area per floor area [m2 m-2], and ``fruits`` per floor area [m-2] in equal stages from set to ripe.

    A variation has the same plants at every state. The leaf area is met exactly; numbers of fruits differ from stem to stem. The section is
    centred on (0, 0), along x.
    """
    shared, a_line = draws(_ROW, variation), round(LENGTH * PITCH * STEMS / 2.0)
    slender, pale = float(np.exp(0.08 * shared.normal())), 0.10 * float(shared.normal())
    oldest = float(np.flatnonzero(np.append(1.0, fruits) > 0.0)[-1]) / len(fruits)
    leaf_number = int(np.clip(6.0 + 4.5 * leaf_area_index, 6.0, 21.0))
    height = min(max(0.30 + 0.082 * leaf_number, _TO_FLOWERS + oldest * _TO_RIPE + 0.1), TALLEST) * np.exp(0.03 * shared.normal())
    leaves, stems, globes, counts = [], [], [], []
    for number in range(2 * a_line):
        own = draws(_STEM, variation, number)
        foot = np.array([(number % a_line + 0.5) * LENGTH / a_line - LENGTH / 2.0, (number // a_line - 0.5) * LINES, GUTTER])
        foot = foot + np.array([0.04, 0.02, 0.0]) * own.normal(size=3)
        tip = foot + np.array([0.03, 0.03, 0.03 * height]) * own.normal(size=3) + height * _UP
        leaves.append(_leaves(tip, leaf_number, slender, pale, draws(_LEAVES, variation, number)))
        development = _developments(fruits, own)
        some, stalks = _trusses(tip, development, draws(_TRUSSES, variation, number))
        globes.append(some)
        string = tubes(np.array([[foot, foot + 3.0 * _UP]]), 0.0015, (0.7, 0.7, 0.7))
        stems += [tubes(np.array([[foot, tip]]), 0.006, (0.16, 0.27, 0.07)), stalks, string]
        counts.append((len(development), int((development >= RIPE).sum())))
    scale = (leaf_area_index * LENGTH * PITCH / sum(mesh.area for mesh, _ in leaves)) ** 0.5
    grown = [Mesh(knots + scale * (mesh.vertices - knots), mesh.triangles, mesh.colours) for mesh, knots in leaves]
    return Row(joined(grown), joined(stems), joined(globes), *np.array(counts, dtype=np.int64).T)


def _developments(fruits: Floats, own: np.random.Generator) -> Floats:
    """Development of the fruits of a stem, the oldest first: about as many as the mean of the crop."""
    mean = float(fruits.sum()) / STEMS
    number = max(round(mean * (1.0 + 0.08 * own.normal()) + 0.5 * (mean > 0.0) * own.normal()), 0)
    older = np.append(0.0, np.cumsum(fruits[::-1])) / max(fruits.sum(), 1e-12)  # share of fruits older than each border of stages
    return 1.0 - np.interp((np.arange(number) + own.random(number)) / max(number, 1), older, np.linspace(0.0, 1.0, len(older)))


def _leaves(tip: Floats, number: int, slender: float, pale: float, own: np.random.Generator) -> tuple[Mesh, Floats]:
    """Leaves of a stem, and the knot that each of their vertices grows from, shape (n, 3)."""
    rank, leaflets = np.arange(number)[:, None], len(_LEAFLETS)
    noise = own.normal(size=(40, 5 + 2 * leaflets)).clip(-2.0, 2.0)[:number]
    size = 0.45 * (0.15 + 0.85 * smooth(rank, 0.0, 8.0)) * (1.0 + 0.07 * noise[:, :1])  # length of a leaf [m]
    turn = rank * GOLDEN_ANGLE + 6.0 * noise[:1, 1:2] + 0.2 * noise[:, 1:2]
    along = np.linspace(0.0, 1.0, 21)[None, :]
    rise = 55.0 - 35.0 * smooth(rank, 0.0, 9.0) + 6.0 * noise[:, 2:3]
    slope = np.radians(rise - (62.0 + 12.0 * noise[:, 3:4]) * along**1.2)  # of the stalk
    reach, lift = (np.cumsum(size / 20.0 * side, axis=1) for side in (np.cos(slope), np.sin(slope)))
    at = np.rint(20.0 * _LEAFLETS[:, 0]).astype(int)
    outwards = np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=-1)
    sideways = np.stack([-np.sin(turn), np.cos(turn), 0.0 * turn], axis=-1)
    base, angle = outwards * reach[:, at, None] + _UP * lift[:, at, None], slope[:, at, None]  # (leaves, leaflets, 3 and 1)
    tangent, normal = np.cos(angle) * outwards + np.sin(angle) * _UP, np.cos(angle) * _UP - np.sin(angle) * outwards
    spread = np.radians(62.0 + 8.0 * noise[:, 5 : 5 + leaflets, None]) * _LEAFLETS[:, 1:2]
    ahead, across = np.cos(spread) * tangent + np.sin(spread) * sideways, np.cos(spread) * sideways - np.sin(spread) * tangent
    length = 0.31 * size[..., None] * _LEAFLETS[:, 2:] * (1.0 + 0.08 * noise[:, 5 + leaflets :, None])
    u, v = np.linspace(0.0, 1.0, 9)[:, None, None], np.linspace(-1.0, 1.0, 3)[None, :, None]
    width = 0.29 * slender * np.sin(np.pi * u**0.7) ** 0.8 * (1.0 + 0.30 * np.sin(2.0 * np.pi * 3.5 * u) * np.abs(v))
    ahead, across, normal, length, base = (array[:, :, None, None] for array in (ahead, across, normal, length, base))
    points = base + length * (u * ahead + width * v * across + 0.12 * np.abs(v) * normal - (0.26 * u**2 + 0.10 * np.abs(v)) * _UP)
    knots = tip - np.cumsum(0.08 * (0.25 + 0.75 * smooth(rank, 0.0, 6.0)), axis=0) * _UP
    young, old = np.array([0.17, 0.33, 0.055]), np.array([0.07, 0.185, 0.028])
    blade = (young + (old - young) * smooth(rank + 3.0 * noise[:, 4:5], 0.0, 9.0) * (1.0 - pale))[:, None, None, None]
    rib = 0.35 * np.exp(-((v / 0.25) ** 2))
    colours = np.broadcast_to((1.0 - rib) * blade + rib * np.array([0.25, 0.38, 0.12]), points.shape)
    grids = ((points + knots[:, None, None, None]).reshape(-1, 9, 3, 3), colours.reshape(-1, 9, 3, 3))
    return of_grids(*grids), np.repeat(knots, points[0].size // 3, axis=0)


def _trusses(tip: Floats, development: Floats, own: np.random.Generator) -> tuple[Mesh, Mesh]:
    """Fruits of a stem and the flowers above them, and the stalks they hang from."""
    borders = np.cumsum(np.rint(TRUSS + own.normal(size=60)).clip(4, 10).astype(int))
    groups = [np.full(FLOWERS, -1.0), *np.split(development, borders[borders < len(development)])]
    globes, stalks = [], []
    for group, turn, noise in zip(groups, own.uniform(0.0, 2.0 * np.pi, 60), own.normal(size=(60, 10)), strict=False):
        order, out = np.arange(len(group)), np.array([np.cos(turn), np.sin(turn), 0.0])
        share = 0.10 + 0.90 * np.exp(-np.exp((0.30 - group) / 0.14))  # of the full radius
        size = np.where(group < 0.0, 0.007, RADIUS * share * (1.0 + 0.06 * noise[: len(group)]))
        knot = tip - (_TO_FLOWERS + max(float(np.mean(group)) if len(group) else 0.0, 0.0) * _TO_RIPE) * _UP
        drop = 0.03 + 1.05 * (np.cumsum(size) - size[:1])
        line = knot + out * (0.05 + 0.03 * np.sqrt(order))[:, None] - _UP * drop[:, None]
        centres = line + (np.where(order % 2, 0.9, -0.9) * size)[:, None] * np.array([-out[1], out[0], 0.0]) - 0.4 * _UP * size[:, None]
        globes.append(_globes(centres, size, group))
        stalks.append(tubes(np.stack([np.vstack([knot, line])[: len(line)], line], axis=1), 0.0025, (0.18, 0.30, 0.08)))
    return joined(globes), joined(stalks)


def _globes(centres: Floats, radius: Floats, development: Floats) -> Mesh:
    """Fruits, green at the calyx; flowers where the development is below 0."""
    polar, turn = np.linspace(0.0, np.pi, 7)[:, None], np.linspace(0.0, 2.0 * np.pi, 9)[None, :]
    globe = np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), 0.88 * np.cos(polar) + 0.0 * turn], axis=-1)
    stages = (-1.0, -0.5, 0.0, 0.75, 0.86, 0.92, 1.0)
    red, green = (0.75, 0.20, 0.20, 0.33, 0.55, 0.62, 0.55), (0.60, 0.34, 0.34, 0.45, 0.36, 0.15, 0.025)
    blue = (0.03, 0.07, 0.07, 0.16, 0.10, 0.03, 0.015)
    colour = np.stack([np.interp(development, stages, channel) for channel in (red, green, blue)], axis=-1)[:, None, None]
    calyx = np.exp(-((polar / 0.35) ** 4))[..., None]
    colours = (1.0 - calyx) * colour + calyx * np.array([0.1, 0.22, 0.04])
    points = centres[:, None, None] + radius[:, None, None, None] * globe
    return of_grids(points, np.broadcast_to(colours, points.shape))
