"""A picture of simulated and measured days: the heat of each, and the harvest added up.

Needs matplotlib (the extra ``video``); uses none of its global state. The picture shows measured days: mind the archive's licence before
you pass it on.
"""

from __future__ import annotations

import importlib.util
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from glbench.errors import ArchiveError
from glbench.realism.comparison import fresh
from glbench.realism.published import Archive
from glbench.realism.season import Season
from glbench.realism.settings import Settings
from glbench.resources import write_atomically

INK, QUIET, EDGE = "#1f2933", "#52606d", "#b8c2cc"
COLOURS = ("#c23b22", "#e2a23b", "#7a6a58", "#3a8f5c", "#a44a8c", "#1d5fa8", "#4aa3a8")
_WIDTH, _HEIGHT = 12.0, 2.3  # inch; of a row


def check_pictures() -> None:
    """Refuse to go on where no picture can be drawn.

    Raises
    ------
    ArchiveError
        When matplotlib is not installed.
    """
    if importlib.util.find_spec("matplotlib") is None:
        msg = "The picture needs matplotlib, which is not installed: pip install 'glbench[video]'. Or leave out --out."
        raise ArchiveError(msg)


def write_picture(archive: Archive, seasons: Sequence[Season], settings: Settings, path: Path) -> None:
    """Write a PNG to ``path``: a row a compartment, heat at the left, harvest at the right.

    Raises
    ------
    GlbenchError
        When the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    count = len(archive.compartments)
    figure = Figure(figsize=(_WIDTH, 0.8 + _HEIGHT * count), dpi=100, layout="constrained", facecolor="white")
    canvas: Any = FigureCanvasAgg(figure)
    rows: Any = figure.subplots(count, 2, sharex=True, squeeze=False)
    dates = archive.dates
    for place, (measured, (heat, harvest)) in enumerate(zip(archive.compartments, rows, strict=True)):
        for number, season in enumerate(seasons):
            look = {"color": COLOURS[number % len(COLOURS)], "lw": 1.0, "label": season.house.name}
            heat.plot(dates, season.heat[:, place], **look)
            harvest.plot(dates, np.cumsum(fresh(season, place, measured, settings)[0]), **look)
        heat.plot(dates, measured.heat, color=INK, lw=1.8, label="measured")
        harvest.plot(dates, np.cumsum(measured.harvest), color=INK, lw=1.8, label="measured")
        heat.set_title(measured.name, loc="left", fontsize=10, color=INK)
        heat.set_ylabel("heat\n[MJ m⁻² d⁻¹]", fontsize=9, color=INK)
        harvest.set_ylabel("harvest, added up\n[kg m⁻²]", fontsize=9, color=INK)
        for axes in (heat, harvest):
            axes.set_ylim(bottom=0.0)
            axes.tick_params(labelsize=8.5, colors=QUIET)
            axes.grid(color=EDGE, lw=0.5, alpha=0.6)
            for side in ("top", "right"):
                axes.spines[side].set_visible(False)
    figure.legend(
        *rows[0][0].get_legend_handles_labels(),
        loc="outside upper center",
        ncols=len(seasons) + 1,
        frameon=False,
        fontsize=9,
    )
    sink = io.BytesIO()
    canvas.print_png(sink)
    write_atomically(path, sink.getvalue())
