"""The greenhouse as a picture, for ``render_mode="rgb_array"``: the last two days of climate, controls and money.

Limits, controls and units are those of the task. Axes, ticks and bands are drawn once and kept for as long as they do not
change; lines, fills and numbers are redrawn without matplotlib's artists, which take most of the time: ``_Brush`` draws what they
hold. Needs matplotlib and the Pillow that comes with it (the extra ``video``); uses none of its global state.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib import get_data_path
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.path import Path
from matplotlib.text import Text
from matplotlib.transforms import Affine2D, IdentityTransform
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from glbench.arrays import Floats
from glbench.env.air import AIR
from glbench.env.history import HOURS_SHOWN, MONEY, DailyLightSums, RecentHistory, time_words
from glbench.model import Air
from glbench.quantities import pretty_unit

if TYPE_CHECKING:
    from collections.abc import Iterable

    from matplotlib.axes import Axes
    from matplotlib.axes._base import _AxesBase
    from matplotlib.collections import FillBetweenPolyCollection

    from glbench.env.simulation import Simulation
    from glbench.tasks import TaskSpec


WIDTH, HEIGHT = 640, 480
"""Size of a picture [pixels]."""

_DPI = 100
_INK, _QUIET, _EDGE, _BAND = "#1f2933", "#52606d", "#b8c2cc", "#dcefdc"
_LINE, _BROKEN, _CONTROL, _MONEY = "#14532d", "#d92d20", "#e2a23b", "#1d5fa8"
_CLIMATE, _RIGHT = (0.072, 0.385), (0.625, 0.36)
"""Left edge and width of the two columns, shares of the figure."""
_TOP, _BOTTOM, _GAP = 0.87, 0.075, 0.07
_MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")
_ROOM_OF_A_DATE = 0.06
"""Share of the axis: a date nearer to the right edge would be cut."""
_WINDOWS = (6.0, 12.0, 24.0, HOURS_SHOWN)
"""[h] What the axes cover: the smallest that holds all there is."""
_CIRCLE, _AS_IS = Path.unit_circle(), IdentityTransform()
_LANE = 0.8
"""Height of a control at its capacity; lanes are 1 apart."""


@dataclass
class _Curve:
    """A quantity over time in axes of its own, and what is redrawn in every picture."""

    axes: Axes
    line: Line2D
    now: Line2D
    broken: Line2D
    value: Text
    unit: str
    low: float = -math.inf
    high: float = math.inf
    covered: tuple[float, float] = (math.nan, math.nan)

    def cover(self, covered: tuple[float, float]) -> bool:
        """Let the axis reach from and to; whether that is a change."""
        if covered == self.covered:
            return False
        self.covered = covered
        self.axes.set_ylim(*covered)
        return True

    def show(self, hours: Floats, values: Floats, text: str) -> None:
        """Take over the values of a run, at ``hours`` up to now (0)."""
        outside = (values < self.low) | (values > self.high)
        self.line.set_data(hours, values)
        self.broken.set_data(hours, np.where(outside, values, np.nan))
        self.now.set_data(hours[-1:], values[-1:])
        color = _BROKEN if outside[-1] else self.line.get_color()
        self.now.set_color(color)
        self.value.set_color(color)
        self.value.set_text(text)


class Picture:
    """Draws histories of a task's runs. It shows the limits and controls of ``task``."""

    def __init__(self, task: TaskSpec) -> None:
        self._task = task
        self._figure = Figure(figsize=(WIDTH / _DPI, HEIGHT / _DPI), dpi=_DPI, facecolor="white")
        self._canvas: Any = FigureCanvasAgg(self._figure)  # matplotlib does not say what its methods take
        self._title, self._place = (
            self._figure.text(x, 0.988, "", fontsize=9, color=_INK, fontweight=weight, ha=side, va="top", animated=True)
            for x, weight, side in ((0.012, "bold", "left"), (0.988, "normal", "right"))
        )
        self._subtitle = self._figure.text(0.012, 0.952, "", fontsize=7.5, color=_QUIET, ha="left", va="top", animated=True)
        horizon = task.observation_context().horizon
        self._deficits = task.model_value.observed("vapour_deficit", horizon) or ()
        self._light = DailyLightSums(task).columns
        self._seed = self._figure.text(  # at the foot: unseeded episodes have seeds of up to 20 digits
            0.988, 0.008, "", fontsize=7, color=_QUIET, ha="right", va="bottom", animated=True
        )
        self._airs = len(AIR) if task.model_value.air else 0  # a history begins with so many columns of air
        self._climate = self._make_climate()
        self._controls = tuple(
            (index, capacity)
            for index, capacity in enumerate(task.capacities())
            if capacity.name in (*task.actuation.controls, *task.scheduled_places)
        )
        self._lanes, self._amounts, lanes = self._make_lanes()
        money = self._axes(_RIGHT, _BOTTOM, 0.175, labelled=True)
        money.axhline(0.0, color=_EDGE, lw=0.8)
        self._money = self._curve(money, "EPI so far", "EUR/m²", _MONEY)
        self._every = [*(curve.axes for curve in self._climate.values()), lanes, self._money.axes]
        self._window = 0.0
        self._midnights = [
            [axes.axvline(0.0, color=_QUIET, lw=0.7, ls=(0, (2, 2)), animated=True) for axes in self._every]
            for _ in range(math.ceil(HOURS_SHOWN / 24.0))
        ]
        self._dates = [
            lanes.text(0.0, -0.13, "", fontsize=7, color=_QUIET, ha="center", va="bottom", animated=True) for _ in self._midnights
        ]
        moving = self._figure.findobj(lambda artist: bool(artist.get_animated()), include_self=False)
        self._texts = {text: _Place.of(text, lanes if text in self._dates else None) for text in moving if isinstance(text, Text)}
        self._background: Any = None

    def __call__(self, history: RecentHistory, simulation: Simulation, row: int) -> NDArray[np.uint8]:
        """Where the run in ``row`` stands, and its history, ``(480, 640, 3)``; the array is the caller's."""
        points = history.table()
        hours = np.arange(1 - len(points), 1).astype(np.float64) * (self._task.step_seconds / 3600.0)
        time = simulation.time[row]
        self._title.set_text(f"{self._task.short_id}   {time_words(time, float(simulation.hour_of_day[row]))}")
        air = simulation.air[:, row].tolist()
        amounts = [(column, float(column.of_air(Air(*air)))) for column in self._deficits if column.of_air is not None]
        if history.light is not None:
            amounts += [pair for pair in zip(self._light, history.light.sums, strict=True) if math.isfinite(pair[1])]
        self._subtitle.set_text(
            "    ".join(
                f"{_name(column.name)} {value:.{0 if value >= 100.0 else 1 if value >= 10.0 else 2}f} {_unit(column.unit)}"
                for column, value in amounts
            )
        )
        self._place.set_text(f"step {simulation.k[row]} of {self._task.steps}")
        self._seed.set_text(f"seed {simulation.seeds[row]}")
        changed = [curve.axes for column, curve in self._climate.items() if self._show_air(curve, hours, points[:, column])]
        if self._show_money(hours, points.T[MONEY], history.first_step):
            changed.append(self._money.axes)
        if self._look_back(-float(hours[0])):
            self._background = None
        self._show_controls(hours, points[:, self._airs : MONEY])
        self._show_midnights(time, hours[0])
        if self._background is None:
            self._canvas.draw()
        else:
            self._canvas.restore_region(self._background)
            for axes in changed:
                self._renew(axes)
        if self._background is None or changed:
            self._background = self._canvas.copy_from_bbox(self._figure.bbox)
        brush = _Brush(self._canvas)
        for fill in self._lanes:
            brush.fill(fill)
        for curve in (*self._climate.values(), self._money):
            for line in (curve.line, curve.broken, curve.now):
                brush.line(line)
        return brush.picture(self._texts, (line for lines in self._midnights for line in lines))

    def _renew(self, axes: Axes) -> None:
        """Redraw one axes and its margins, which reach half way to its neighbours."""
        box, x = axes.get_position(), 0.5 if axes is self._money.axes else 0.0
        foot, top = 0.0 if box.y0 == _BOTTOM else box.y0 - _GAP / 2.0, box.y1 + _GAP / 2.0
        room = Rectangle((x, foot), 0.5, top - foot, transform=self._figure.transFigure, color="white", lw=0.0)
        room.set_figure(self._figure)
        self._figure.draw_artist(room)
        self._figure.draw_artist(axes)

    def _axes(self, column: tuple[float, float], bottom: float, height: float, *, labelled: bool) -> Axes:
        """Axes over the hours shown, in a column of the figure."""
        x, width = column
        axes = self._figure.add_axes((x, bottom, width, height))
        axes.tick_params(labelsize=7.5, colors=_QUIET, length=2.5, width=0.6, pad=2, labelbottom=labelled)
        for spine in axes.spines.values():
            spine.set(color=_EDGE, linewidth=0.8)
        return axes

    def _look_back(self, hours: float) -> bool:
        """Let the axes reach back over the hours that there are, two days at most; whether that is a change."""
        window = next((reach for reach in _WINDOWS if reach >= hours), HOURS_SHOWN)
        if window == self._window:
            return False
        self._window = window
        for axes in self._every:
            axes.set_xlim(-window, 0.02 * window)
            axes.set_xticks([-window, -window / 2, 0.0], [f"{window:g} h ago", f"{window / 2:g} h ago", "now"])
        return True

    def _curve(self, axes: Axes, title: str, unit: str, color: str) -> _Curve:
        axes.set_title(title, fontsize=8, color=_INK, loc="left", pad=3)
        (line,) = axes.plot([], [], color=color, lw=1.4, animated=True)
        (broken,) = axes.plot([], [], color=_BROKEN, lw=1.4, marker=".", ms=4.0, mew=0.0, animated=True)
        (now,) = axes.plot([], [], color=color, marker="o", ms=4.0, mew=0.0, animated=True, clip_on=False)
        value = axes.text(1.0, 1.02, "", transform=axes.transAxes, fontsize=9, fontweight="bold", ha="right", va="bottom", animated=True)
        return _Curve(axes, line, now, broken, value, unit)

    def _make_climate(self) -> dict[int, _Curve]:
        """A curve for each quantity of the air that has limits, by its column."""
        limits = self._task.constraints.items()
        height = (_TOP - _BOTTOM - (len(limits) - 1) * _GAP) / max(len(limits), 1)
        curves = {}
        for place, (name, limit) in enumerate(limits):
            unit = _unit(AIR[name])
            bottom = _TOP - height - place * (height + _GAP)
            axes = self._axes(_CLIMATE, bottom, height, labelled=place == len(limits) - 1)
            curve = self._curve(axes, f"{_name(name)} ({limit.low:g} to {limit.high:g} {unit})", unit, _LINE)
            axes.axhspan(limit.low, limit.high, color=_BAND, lw=0.0)
            curve.low, curve.high = limit.low, limit.high
            curves[list(AIR).index(name)] = curve
        return curves

    def _make_lanes(self) -> tuple[list[FillBetweenPolyCollection], list[Text], Axes]:
        """One lane for each control that the task grants."""
        bottom = 0.325
        axes = self._axes(_RIGHT, bottom, _TOP - bottom, labelled=False)
        axes.set_title("Controls in force", fontsize=8, color=_INK, loc="left", pad=12)
        axes.set_ylim(len(self._controls) - 0.1, -0.1)
        axes.set_yticks([])
        lanes, amounts = [], []
        for lane, (_, capacity) in enumerate(self._controls):
            base = lane + _LANE
            axes.axhline(base, color=_EDGE, lw=0.6)
            lanes.append(axes.fill_between([0.0], [base], [base], color=_CONTROL, lw=0.0, animated=True))
            at: dict[str, Any] = {"x": -0.025, "transform": axes.get_yaxis_transform(), "ha": "right", "color": _INK}
            axes.text(y=lane + 0.36, s=_name(capacity.quantity), fontsize=7.5, va="bottom", **at)
            amounts.append(axes.text(y=lane + 0.44, s="", fontsize=8, fontweight="bold", va="top", animated=True, **at))
        return lanes, amounts, axes

    def _show_air(self, curve: _Curve, hours: Floats, values: Floats) -> bool:
        """Show a quantity of the air; whether its axis has changed."""
        step = (curve.high - curve.low) / 4.0 or 1.0
        low, high = min(values.min(), curve.low - 0.2 * step), max(values.max(), curve.high + 0.2 * step)
        curve.show(hours, values, f"{values[-1]:.{0 if values[-1] >= 100.0 else 1}f} {curve.unit}")
        return curve.cover((math.floor(low / step) * step, math.ceil(high / step) * step))

    def _show_money(self, hours: Floats, values: Floats, first_step: int) -> bool:
        self._money.show(hours, values, f"{round(values[-1], 3) + 0.0:+.3f} {self._money.unit}")
        title = "EPI so far" if first_step == 0 else f"EPI since step {first_step}"
        renamed = title != self._money.axes.get_title(loc="left")
        if renamed:
            self._money.axes.set_title(title, fontsize=8, color=_INK, loc="left", pad=3)
        low, high = float(values.min()), float(values.max())
        step = 10.0 ** math.ceil(math.log10(max(high - low, 0.01))) / 4.0
        return self._money.cover(((math.floor(low / step) - 0.2) * step, (math.ceil(high / step) + 0.2) * step)) or renamed

    def _show_controls(self, hours: Floats, controls: Floats) -> None:
        edges = np.repeat(hours, 2)[:-1]  # a control was in force from the point before until its own
        for lane, ((index, capacity), fill, amount) in enumerate(zip(self._controls, self._lanes, self._amounts, strict=True)):
            values = controls[:, index]
            shares = values / capacity.at_one if capacity.at_one else values
            base = lane + _LANE
            outline = np.column_stack([edges, base - _LANE * np.repeat(shares, 2)[1:]])
            fill.set_verts([np.vstack([[edges[0], base], outline, [edges[-1], base]])])
            now = float(values[-1])
            amount.set_text(f"{now:.0%}" if capacity.unit == "-" else f"{round(now, 2):.3g} {_unit(capacity.unit)}")

    def _show_midnights(self, now: np.datetime64, first: float) -> None:
        today = now.astype("datetime64[D]")
        since = float((now - today) / np.timedelta64(1, "s")) / 3600.0
        for days, (lines, date) in enumerate(zip(self._midnights, self._dates, strict=True)):
            hours = -since - 24.0 * days
            for line in lines:
                line.set_xdata([hours, hours])
                line.set_visible(hours >= first)
            day = (today - np.timedelta64(days, "D")).item()
            date.set_x(hours)
            date.set_text(f"{day.day} {_MONTHS[day.month - 1]}")
            date.set_visible(hours >= first and hours < -_ROOM_OF_A_DATE * self._window)


class _Brush:
    """Draws lines, dots, fills and single lines of text of matplotlib's artists into one picture."""

    def __init__(self, canvas: Any) -> None:
        self._canvas, self._renderer = canvas, canvas.get_renderer()
        self._matrices: dict[_AxesBase, Floats] = {}

    def line(self, line: Line2D) -> None:
        """Draw a line and its dots, if it has any; points that are not finite leave gaps."""
        axes, dots, color = line.axes, line.get_marker(), line.get_color()
        assert axes is not None
        at = self._pixels(axes, np.column_stack([line.get_xdata(), line.get_ydata()]))
        there = np.isfinite(at[:, 1])
        if not there.any():
            return
        context = self._context(axes, color, line.get_linewidth(), clipped=bool(line.get_clip_on()))
        if len(at) > 1:
            self._renderer.draw_path(context, Path(at), _AS_IS)
        if dots != "None":
            radius = Affine2D().scale(float(line.get_markersize()) * (0.5 if dots == "o" else 0.25) * _DPI / 72.0)
            context.set_linewidth(0.0)
            self._renderer.draw_markers(context, _CIRCLE, radius, Path(at[there]), _AS_IS, to_rgb(color))
        context.restore()

    def fill(self, fill: FillBetweenPolyCollection) -> None:
        """The area below a control."""
        axes, color = fill.axes, to_rgb(_CONTROL)
        assert axes is not None
        context = self._context(axes, color, 0.0, clipped=True)
        outline = Path(self._pixels(axes, np.asarray(fill.get_paths()[0].vertices)))
        self._renderer.draw_path(context, outline, _AS_IS, color)
        context.restore()

    def picture(self, texts: dict[Text, _Place], midnights: Iterable[Line2D]) -> NDArray[np.uint8]:
        """The picture ``(480, 640, 3)``, with ``texts`` and dashed lines at midnight on it."""
        buffer, pixels = np.asarray(self._canvas.buffer_rgba()), np.empty((HEIGHT, WIDTH, 3), np.uint8)
        for channel in range(3):  # a quarter of the time of a copy of the slice
            pixels[..., channel] = buffer[..., channel]
        for text, place in texts.items():
            if text.get_visible() and text.get_text():
                x = place.x if place.axes is None else self._pixels(place.axes, np.array([[text.get_position()[0], 0.0]]))[0, 0]
                place.write(pixels, text.get_text(), x, _ink(text.get_color()))
        for line in midnights:
            axes, hours = line.axes, line.get_xdata()
            assert axes is not None
            if line.get_visible():
                column = round(float(self._pixels(axes, np.array([[np.ravel(hours)[0], 0.0]]))[0, 0]))
                rows = np.arange(round(HEIGHT - axes.bbox.y1), round(HEIGHT - axes.bbox.y0))
                if axes.bbox.x0 <= column <= axes.bbox.x1:
                    pixels[rows[rows // 2 % 2 == 0], column] = _ink(line.get_color())
        return pixels

    def _pixels(self, axes: _AxesBase, points: Floats) -> Floats:
        """Points ``(n, 2)`` of ``axes`` in pixels from the lower left corner."""
        if axes not in self._matrices:
            self._matrices[axes] = axes.transData.get_affine().get_matrix()
        matrix = self._matrices[axes]
        return points @ matrix[:2, :2].T + matrix[:2, 2]

    def _context(self, axes: _AxesBase, color: Any, width: float, *, clipped: bool) -> Any:
        context = self._renderer.new_gc()
        context.set_foreground(color)
        context.set_linewidth(width * _DPI / 72.0)
        if clipped:
            context.set_clip_rectangle(axes.bbox)
        return context


@dataclass(frozen=True)
class _Place:
    """Position [pixels from the upper left corner] and font of a text; with ``axes``, x is in data coordinates."""

    x: float
    baseline: float
    side: str
    font: ImageFont.FreeTypeFont
    axes: Axes | None

    @classmethod
    def of(cls, text: Text, axes: Axes | None) -> _Place:
        x, y = text.get_transform().transform(text.get_position())
        size = float(text.get_fontsize()) * _DPI / 72.0
        baseline = HEIGHT - y + {"top": 0.76, "bottom": -0.24}[text.get_verticalalignment()] * size
        return cls(float(x), float(baseline), text.get_horizontalalignment(), _font(size, str(text.get_fontweight())), axes)

    def write(self, pixels: NDArray[np.uint8], text: str, x: float, ink: tuple[int, int, int]) -> None:
        """Draw one line of text word by word; words are cached, because most occur in every picture."""
        words, gap = [_Word.of(word, self.font) for word in text.split(" ")], self.font.getlength(" ")
        length = sum(word.advance for word in words) + gap * (len(words) - 1)
        x -= {"left": 0.0, "center": 0.5, "right": 1.0}[self.side] * length
        for word in words:
            row, column = round(self.baseline) + word.y, round(x) + word.x
            there = pixels[row : row + word.cover.shape[0], column : column + word.cover.shape[1]]
            there += (word.cover * (np.array(ink) - there)).astype(np.int16).astype(np.uint8)  # modulo 256, which the sum undoes
            x += word.advance + gap


class _Word(NamedTuple):
    """Coverage of pixels by a word ``(height, width, 1)``, its offset from the origin, and the advance to the next word."""

    cover: Floats
    x: int
    y: int
    advance: float

    @staticmethod
    @lru_cache(maxsize=4096)
    def of(word: str, font: ImageFont.FreeTypeFont) -> _Word:
        x0, y0, x1, y1 = (round(edge) for edge in font.getbbox(word, anchor="ls"))
        image = Image.new("L", (x1 - x0, y1 - y0))
        ImageDraw.Draw(image).text((-x0, -y0), word, fill=255, font=font, anchor="ls")
        return _Word(np.asarray(image)[..., None] / 255.0, x0, y0, font.getlength(word))


@cache
def _ink(color: Any) -> tuple[int, int, int]:
    red, green, blue = (round(255.0 * share) for share in to_rgb(color))
    return red, green, blue


@cache
def _font(size: float, weight: str) -> ImageFont.FreeTypeFont:
    file = "DejaVuSans-Bold.ttf" if weight == "bold" else "DejaVuSans.ttf"
    return ImageFont.truetype(f"{get_data_path()}/fonts/ttf/{file}", size, layout_engine=ImageFont.Layout.BASIC)


def _unit(unit: str) -> str:
    return pretty_unit(unit) or unit


def _name(name: str) -> str:
    words = name.replace("_", " ").replace("co2", "CO2").replace("par ", "PAR ")
    return words[0].upper() + words[1:]
