"""What comes: from the observations so far to the weather of the coming steps, as the kernel takes it.

Beside what is seen an outlook knows a ``Climatology``: the mean day of each time of the year in the task's training years, and how fast
deviations from it fade. It holds no weather of any one day, is small, and goes with an agent as a file into the sandbox.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Climatology:
    """The mean days of a task's training years, and how fast deviations from them fade."""

    @classmethod
    def of(cls, task: TaskSpec | str) -> Climatology:
        """The climatology of a task's training years; needs the weather."""

    @classmethod
    def of_settings(cls, settings: dict[str, Any]) -> Climatology:
        """The climatology of which ``settings`` gave plain values."""

    def settings(self) -> dict[str, Any]:
        """All of it as plain JSON values."""

    def write(self, path: Path | str) -> None:
        """Write it as JSON."""

    @classmethod
    def read(cls, path: Path | str) -> Climatology:
        """Read what ``write`` wrote."""


@dataclass(frozen=True, eq=False)
class Ahead:
    """The coming T steps of n runs.

    Attributes
    ----------
    d
        Disturbances of each step as the kernel takes them ``(n, T, d)``; ``d[:, 0]`` act next.
    calendar
        Hour of day, day of year and prices at the start of each step and at the end of the last ``(n, T + 1, columns)``: what
        ``StageReward`` takes.
    """

    d: Floats
    calendar: Floats


class Outlook:
    """What comes in runs of a task, from their observations.

    Parameters
    ----------
    task
        The task, or its id.
    climatology
        Of its training years.

    Attributes
    ----------
    past
        Disturbances of the step just past ``(n, d)``; before the first step those of the step to come.
    """

    def __init__(self, task: TaskSpec | str, climatology: Climatology) -> None: ...
    def reset(self, n: int) -> None:
        """Begin with ``n`` new runs."""
    def update(self, observations: ArrayLike) -> None:
        """Take in what is observed now: once before the first action, and once after every step."""
    def ahead(self, steps: int) -> Ahead:
        """The coming ``steps`` steps, as expected now."""
