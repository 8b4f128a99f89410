"""Which picture of the crop belongs to each step of a run: a camera's last one, or a rendered row of tomatoes in the state of the day."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import Floats
from glbench.episodes.signals import SCENE
from glbench.extras import missing
from glbench.resources import lacks_pictures
from glbench.tasks import TaskSpec
from glbench.vision.library import Library

NOON = 12.0
"""Hour of the greenhouse's clock at which the picture of a row of tomatoes changes."""
_ROW = ("cLeaf", "fruits", "nRipe")
"""Columns of a crop of trusses that a row is drawn from: carbohydrate of the leaves [mg m-2], fruits on the plants and ripe ones [m-2]."""


def crop_scenes(task: TaskSpec, columns: Mapping[str, Floats], clock: str, seed: int) -> tuple[Library, NDArray[np.int64]] | None:
    """A library, and its scene at the end of each step ``(steps,)``.

    ``columns`` are those of a record, ``clock`` the one with the hours of the greenhouse. A row of tomatoes is the nearest of the library
    in leaf area (of nominal leaves) and number of fruits, whose plants the ``seed`` chooses. ``None`` for a crop without pictures, and
    where the library or the package pillow is not installed.
    """
    if task.picture_library is not None and SCENE in columns:
        return task.picture_library, columns[SCENE].astype(np.int64)
    if not {*_ROW, clock} <= {*columns} or lacks_pictures() or missing("PIL"):
        return None
    leaves, fruits, ripe = (columns[name] for name in _ROW)
    states = np.stack([task.parameters_by_name()["sla"] * leaves, fruits, ripe], axis=-1)
    hours, library = columns[clock], Library.open("tomato")
    changes = np.append(0, np.flatnonzero((hours[1:] >= NOON) & (hours[:-1] < NOON)) + 1)[: len(hours)]
    return library, np.repeat(library.nearest(states[changes], seed), np.diff(np.append(changes, len(hours))))
