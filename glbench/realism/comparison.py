"""Simulated seasons compared with the measured one: sums, days and months, as a file without measured days and as a picture."""

from __future__ import annotations

import datetime as dt
import importlib.util
import io
import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from glbench.errors import ArchiveError, ResultError, refuse
from glbench.realism.houses import House, Settings, model
from glbench.realism.indoor import Indoor, read_indoor
from glbench.realism.inputs import outdoors
from glbench.realism.published import Archive, Compartment
from glbench.realism.season import NEEDED, Season, simulate
from glbench.resources import write_atomically
from glbench.settings import Table
from glbench.untrusted import MIB, read_regular, reason_of
from glbench.weather.comparison import INK, tidy
from glbench.weather.record import FloatArray

COLOURS = ("#c23b22", "#e2a23b", "#7a6a58", "#3a8f5c", "#a44a8c", "#1d5fa8", "#4aa3a8", "#111111")
_WIDTH, _HEIGHT = 12.0, 2.3  # inch; of a row
FIRST_FRUIT = 0.05  # Fresh fruit after which the harvest counts as begun [kg m-2]


class Heat(Table):
    """Heat of a compartment [MJ m-2].

    ``measured`` and ``simulated`` are sums of the season: measured as the organisers compute it from pipe temperatures, simulated as the
    boiler's, and ``by_pipes`` as the measured one (``None`` in files of earlier versions). ``bias`` and ``rmse`` are of simulated minus
    measured days [MJ m-2 d-1], also by month (``2020-03``); ``correlation`` is ``None`` where measured or simulated days do not vary.
    """

    measured: float
    simulated: float
    by_pipes: float | None = None
    bias: float
    rmse: float
    correlation: float | None
    bias_by_month: dict[str, float]


class Harvest(Table):
    """Fresh fruit of a compartment, both classes: sums of the season [kg m-2], and simulated minus measured of a month [kg m-2].

    ``dry_matter`` turns simulated dry into fresh mass [kg kg-1]; ``measured_from`` and ``simulated_from`` are when as much as
    ``FIRST_FRUIT`` was harvested, ``None`` if it never was.
    """

    measured: float
    simulated: float
    dry_matter: float
    measured_from: dt.date | None
    simulated_from: dt.date | None
    bias_by_month: dict[str, float]


class Supply(Table):
    """Light or CO2 of the season: measured, and used in the simulation."""

    measured: float
    simulated: float


class CompartmentComparison(Table):
    """A compartment in a house, with means of the simulated air of the season [degC, %, ppm].

    Of electricity of the ``lamps`` [kWh m-2] and ``co2`` [kg m-2] the simulation used what was measured, or all that is installed.
    """

    name: str
    heat: Heat
    harvest: Harvest
    lamps: Supply
    co2: Supply
    air_temperature: float
    humidity: float
    co2_air: float


class HouseComparison(Table):
    """All compartments in a house; root mean squares of all days of all, and of the days as means over all [MJ m-2 d-1]."""

    name: str
    description: str
    compartments: tuple[CompartmentComparison, ...]
    heat_rmse: float
    heat_rmse_of_mean: float

    def mean(self, of: Callable[[CompartmentComparison], float]) -> float:
        """Mean over the compartments."""
        return sum(map(of, self.compartments)) / len(self.compartments)

    @property
    def heat_ratio(self) -> float:
        """Simulated over measured heat, all compartments together; NaN where none was measured."""
        return _ratio(self.mean(lambda one: one.heat.simulated), self.mean(lambda one: one.heat.measured))

    @property
    def pipe_heat(self) -> float:
        """Simulated heat by pipe temperatures, mean over the compartments [MJ m-2]; NaN in files of earlier versions."""
        return self.mean(lambda one: math.nan if one.heat.by_pipes is None else one.heat.by_pipes)

    @property
    def harvest_ratio(self) -> float:
        """Simulated over measured harvest, all compartments together; NaN where there was none."""
        return _ratio(self.mean(lambda one: one.harvest.simulated), self.mean(lambda one: one.harvest.measured))

    def heat_bias(self, month: str | None = None) -> float:
        """Simulated minus measured heat, mean over the compartments, of the season or a month [MJ m-2 d-1]."""
        return self.mean(lambda one: one.heat.bias if month is None else one.heat.bias_by_month[month])

    def harvest_bias(self, month: str) -> float:
        """Simulated minus measured harvest of a month, mean over the compartments [kg m-2]."""
        return self.mean(lambda one: one.harvest.bias_by_month[month])


class Comparison(Table):
    """Houses against the measured season: model and digest of what was simulated, with temperatures ``warmer`` [K] than the settings say.

    ``notes`` say what was filled, moved or left out of what was read. ``heat_spread`` is the root mean square of how far a compartment's
    measured day is from the mean of all compartments on that day [MJ m-2 d-1]: what growers differ by in one weather. A simulation that is
    given nothing of them cannot come closer.
    """

    first: dt.date
    last: dt.date
    model: str
    digest: str
    warmer: float
    settings: Settings
    notes: tuple[str, ...]
    heat_spread: float
    houses: tuple[HouseComparison, ...]

    @property
    def months(self) -> tuple[str, ...]:
        """The months, in order."""
        return tuple(self.houses[0].compartments[0].heat.bias_by_month)


Progress = Callable[[House, int, int], None]
"""Called with the house, days done and days in all."""


def compare(
    archive: Archive,
    houses: Sequence[House],
    settings: Settings,
    *,
    own_set_points: bool = False,
    warmer: float = 0.0,
    progress: Progress | None = None,
) -> tuple[Comparison, tuple[Season, ...]]:
    """Simulate ``archive`` in each of ``houses`` and compare: what can be stored and passed on, and the simulated days.

    With ``own_set_points``, compartments that have set points of heating and vents in their indoor climate are driven by them. Errors as
    for ``outdoors`` and ``simulate``.
    """
    if archive.own:
        msg = "An export has no heat and harvest of a day to compare a simulation by set points with. Compare it with --by actuators."
        raise ArchiveError(msg)
    outside, indoors = outdoors(archive, settings.place.clock, settings.place.co2), dict[str, Indoor]()
    for one in archive.compartments if own_set_points else ():
        indoor = one.indoor and read_indoor(one.indoor, settings.place.clock, first=archive.first, days=archive.days)
        if indoor and not any(np.isnan(indoor.columns[name]).all() for name in NEEDED):
            indoors[one.name] = indoor
    driven = tuple(f"{name} is driven by its own set points." for name in indoors)
    moves = (None if progress is None else partial(progress, house) for house in houses)
    seasons = tuple(
        simulate(archive, outside, house, settings, indoors=indoors, warmer=warmer, progress=move)
        for house, move in zip(houses, moves, strict=True)
    )
    heat = np.column_stack([one.heat for one in archive.compartments])
    models = tuple(dict.fromkeys(house.model for house in houses))
    comparison = Comparison(
        first=archive.first,
        last=archive.dates[-1].item(),
        model=", ".join(models),
        digest=", ".join(model(name).digest for name in models),
        warmer=warmer,
        settings=settings,
        notes=(*archive.notes, *outside.notes, *driven),
        heat_spread=_rms(heat - heat.mean(axis=1, keepdims=True)),
        houses=tuple(
            HouseComparison(
                name=season.house.name,
                description=season.house.description,
                compartments=tuple(_compartment(archive, season, i, settings) for i in range(len(archive.compartments))),
                heat_rmse=_rms(season.heat - heat),
                heat_rmse_of_mean=_rms((season.heat - heat).mean(axis=1)),
            )
            for season in seasons
        ),
    )
    return comparison, seasons


def _compartment(archive: Archive, season: Season, place: int, settings: Settings) -> CompartmentComparison:
    measured = archive.compartments[place]
    heat = season.heat[:, place]
    fruit, content = fresh(season, place, measured, settings)
    months = archive.dates.astype("datetime64[M]")
    by_month = {str(month): months == month for month in np.unique(months)}
    varies = np.ptp(heat) > 0.0 and np.ptp(measured.heat) > 0.0
    return CompartmentComparison(
        name=measured.name,
        heat=Heat(
            measured=float(measured.heat.sum()),
            simulated=float(heat.sum()),
            by_pipes=float(season.pipe_heat[:, place].sum()),
            bias=float((heat - measured.heat).mean()),
            rmse=_rms(heat - measured.heat),
            correlation=float(np.corrcoef(heat, measured.heat)[0, 1]) if varies else None,
            bias_by_month={name: float((heat - measured.heat)[days].mean()) for name, days in by_month.items()},
        ),
        harvest=Harvest(
            measured=float(measured.harvest.sum()),
            simulated=float(fruit.sum()),
            dry_matter=content,
            measured_from=_harvest_start(archive, measured.harvest),
            simulated_from=_harvest_start(archive, fruit),
            bias_by_month={name: float((fruit - measured.harvest)[days].sum()) for name, days in by_month.items()},
        ),
        lamps=Supply(measured=float((measured.high + measured.low).sum()), simulated=float(season.lamps[:, place].sum())),
        co2=Supply(measured=float(measured.co2.sum()), simulated=float(season.co2[:, place].sum())),
        air_temperature=float(season.air_temperature[:, place].mean()),
        humidity=float(season.humidity[:, place].mean()),
        co2_air=float(season.co2_air[:, place].mean()),
    )


def fresh(season: Season, place: int, measured: Compartment, settings: Settings) -> tuple[FloatArray, float]:
    """Fresh fruit harvested on each day of a simulated season [kg m-2] (days,), and the dry matter content used [kg kg-1]."""
    content = settings.plants.dry_matter if measured.dry_matter is None else measured.dry_matter
    return season.harvest[:, place] / content, content


def _harvest_start(archive: Archive, fruit: FloatArray) -> dt.date | None:
    late = archive.dates[np.cumsum(fruit) >= FIRST_FRUIT]
    return late[0].item() if late.size else None


def _rms(values: FloatArray) -> float:
    return math.sqrt(float(np.mean(values**2)))


def _ratio(simulated: float, measured: float) -> float:
    return simulated / measured if measured else math.nan


def read_comparison(path: Path) -> Comparison:
    """Read one that was written as JSON; a ``ResultError`` says why it cannot be."""
    try:
        return Comparison.model_validate_json(read_regular(path, 16 * MIB))
    except (OSError, ValidationError) as error:
        why = f": {reason_of(error)}" if isinstance(error, OSError) else ""
        refuse(f"{path} is no comparison with measurements{why}. `glbench validate FOLDER --out` writes one.", ResultError, error)


def check_pictures() -> None:
    """Refuse to go on, with an ``ArchiveError``, where matplotlib is not installed."""
    if importlib.util.find_spec("matplotlib") is None:
        refuse("The picture needs matplotlib, which is not installed: pip install 'glbench[video]'. Or leave out --out.", ArchiveError)


def write_picture(archive: Archive, seasons: Sequence[Season], settings: Settings, path: Path) -> None:
    """Write a PNG to ``path``: a row a compartment, daily heat at the left, accumulated harvest at the right.

    It shows measured days: mind the archive's licence before you pass it on. A ``GlbenchError`` says why it cannot be written.
    """
    from matplotlib.figure import Figure

    count = len(archive.compartments)
    figure = Figure(figsize=(_WIDTH, 0.8 + _HEIGHT * count), dpi=100, layout="constrained", facecolor="white")
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
            tidy(axes)
    saved_figure(figure, rows[0][0], path)


def saved_figure(figure: Any, labelled: Any, path: Path) -> None:
    """Write a figure to ``path`` as PNG, on top the legend of the axes ``labelled``; a ``GlbenchError`` says why it cannot be."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    handles, labels = labelled.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=min(len(labels), 8), frameon=False, fontsize=9)
    sink = io.BytesIO()
    canvas: Any = FigureCanvasAgg(figure)
    canvas.print_png(sink)
    write_atomically(path, sink.getvalue())
