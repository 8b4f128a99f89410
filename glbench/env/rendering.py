"""Render modes: text always, pictures with the extra ``video``."""

from __future__ import annotations

import importlib.util
import warnings
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glbench.env.program import air_columns, info_columns
from glbench.env.quantities import EPI
from glbench.env.trail import DayLight, Trail
from glbench.errors import GlbenchError, UnknownNameError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from glbench.env.picture import Picture
    from glbench.env.simulation import Simulation
    from glbench.env.step_result import StepResult

TEXT, PICTURES = "ansi", "rgb_array"
RENDER_MODES = (TEXT, PICTURES)
"""Those that there are; ``drawable_modes`` tells which of them can be drawn here."""
FRAMES_PER_SECOND = 24
"""Of a video: a day of 96 steps in 4 s."""

NO_PICTURES = (
    "The render mode 'rgb_array' needs matplotlib, which is not installed: pip install 'glbench[video]'. "
    "Without it the environment works, but cannot be drawn."
)


def drawable_modes() -> tuple[str, ...]:
    """Render modes whose packages can be found, without importing them."""
    return RENDER_MODES if importlib.util.find_spec("matplotlib") is not None else (TEXT,)


def checked_render_mode(render_mode: str | None) -> str | None:
    """``render_mode`` if there is such a mode; warns, once, when pictures are wanted and cannot be drawn.

    Raises
    ------
    UnknownNameError
        Otherwise.
    """
    if render_mode is not None and render_mode not in RENDER_MODES:
        msg = f"There is no render mode {render_mode!r}. Use {', '.join(map(repr, RENDER_MODES))} or None."
        raise UnknownNameError(msg)
    if render_mode == PICTURES and PICTURES not in drawable_modes():
        _warn_without_matplotlib()
    return render_mode


@cache
def _warn_without_matplotlib() -> None:
    warnings.warn(NO_PICTURES, stacklevel=4)


class Camera:
    """Follows the runs of a simulation and draws them; what it sees changes nothing in them."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._shown = slice(air_columns(simulation.task).start, info_columns(simulation.task))  # air and controls
        self._light = DayLight(simulation.task)
        self._trails: list[Trail] = []
        self._pictures: dict[int, Picture] = {}  # one a row: what a picture keeps suits the next one of the same run

    def __getstate__(self) -> dict[str, Any]:
        """Without the figures, which are made again when they are needed."""
        return self.__dict__ | {"_pictures": {}}

    def begin(self, rows: Iterable[int] | None = None) -> None:
        """Follow new episodes in ``rows``, by default in all."""
        simulation = self._simulation
        if rows is None:
            rows, self._trails = range(simulation.n), [None] * simulation.n  # type: ignore[list-item]
        for row in rows:
            trail = self._trails[row] = Trail(int(simulation.k[row]), simulation.task.step_seconds)
            trail.add(simulation.info_columns[self._shown, row].tolist())
            trail.light = self._light.begin(simulation, row)

    def follow_only(self, numbers: Sequence[float], epi: float) -> None:
        """Note a step of the only run, from the numbers of ``Simulation.step_single``."""
        self._trails[0].add(numbers[self._shown], epi)
        self._trails[0].light = self._light.add(self._trails[0].light, self._simulation, 0)

    def follow(self, result: StepResult, rows: Iterable[int]) -> None:
        """Note the step that ``rows`` have taken."""
        shown, epi = self._simulation.info_columns[self._shown].T.tolist(), result.table[EPI].tolist()
        for row in rows:
            self._trails[row].add(shown[row], epi[row])
            self._trails[row].light = self._light.add(self._trails[row].light, self._simulation, row)

    def picture(self, row: int) -> NDArray[np.uint8]:
        """Picture of a run, ``(480, 640, 3)``.

        Raises
        ------
        GlbenchError
            Without matplotlib, or before the first reset.
        """
        if not self._trails:
            msg = "There is nothing to draw yet: call reset first."
            raise GlbenchError(msg)
        if row not in self._pictures:
            try:
                from glbench.env.picture import Picture
            except ModuleNotFoundError as error:
                raise GlbenchError(NO_PICTURES) from error
            self._pictures[row] = Picture(self._simulation.task)
        return self._pictures[row](self._trails[row], self._simulation, row)
