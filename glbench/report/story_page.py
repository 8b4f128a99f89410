"""A story (``glbench.report.story.Story``) in words, as a page, and as plain values."""

from __future__ import annotations

import importlib
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench import __version__
from glbench.episodes.signals import KWH_A_CUBIC_METRE, Curve, Line
from glbench.extras import require
from glbench.quantities import in_sentence, plain_unit, pretty_unit, sentence
from glbench.report.story import MEANINGS, PERIODS, Story

Floats = NDArray[np.float64]

_MINUS = "\u2212"
_TOLD = 5
"""Levels that a period's words name at most: those that differ most."""
_CENT = 0.005
"""Smallest amount of money that is reported [EUR m-2]."""
_SHARE = 0.01
"""An amount is reported if it differs by at least this share of the larger of the two."""
_DECIMALS = {"°C": 1, "%": 0, "ppm": 0, "kPa": 2, "g/m³": 1}
_VISIBLE = {"°C": 0.3, "%": 2.0, "ppm": 30.0, "kPa": 0.05, "g/m³": 0.3}
"""Smallest differences of levels that are reported, by unit."""
_ALIKE = {
    "climate/canopy_temperature": "climate/air_temperature",
    "climate/vapour_pressure_deficit": "climate/relative_humidity",
    "climate/humidity_deficit": "climate/relative_humidity",
    "climate/pipe_temperature": "controls/boiler",
}
"""Levels that say much the same as another: words name one of them."""
_EARNED, _PAID = "earned", "paid"
_WIDTH, _HEIGHT, _LEFT, _RIGHT, _TOP, _BOTTOM = 300, 176, 52, 8, 8, 36


def unit_of(curve: Curve) -> str:
    """``g/m³`` for ``g m⁻³``."""
    return _said(plain_unit(curve.unit))


def _said(unit: str) -> str:
    """``m³/m²`` for ``m3 m-2``."""
    return re.sub(r"^m3", "m³", pretty_unit(unit))


def number(value: float, decimals: int, *, signed: bool = False) -> str:
    """``−0.42``; a plus where ``signed``, none before what rounds to 0; a dash for what is not known."""
    if math.isnan(value):
        return "–"
    text = f"{abs(value):,.{decimals}f}"
    if float(text.replace(",", "")) == 0.0:
        return text
    return (_MINUS if value < 0 else "+" if signed else "") + text


def _amount(value: float, unit: str, decimals: int, *, signed: bool = False) -> str:
    text = _said(unit)
    return number(value, decimals, signed=signed) + (text if text.startswith("/") else f"\u00a0{text}" if text else "")


def decimals_of(line: Line) -> int:
    """Decimals that a line of the accounts deserves."""
    return {"m-2": 1, "kWh m-2": 1, "h": 0, "-": 1}.get(line.unit, 2)


def headline(story: Story) -> str:
    """Who earns more, how much, in how many runs, and in which part of the day."""
    one, other = story.agents
    profit, violations, score = (story.line(kind) for kind in ("profit", "violations", "score"))
    totals = story.sums.sum(axis=2)  # (2, runs, lines)
    gaps, runs = totals[0] - totals[1], len(story.seeds)
    gap, line = float(gaps[:, profit].mean()), story.lines[profit]
    more = int((gaps[:, profit] > 0).sum())
    parts = [
        f"{number(float(value), 2, signed=True)} {_when(place)}" for place, value in enumerate(story.gaps()[:, profit])
    ]
    better = _more(story.lines[score], float(gaps[:, score].mean()), "higher", "lower")
    what, cost = story.lines[score], story.lines[violations]
    return (
        f"{one} earns {_amount(abs(gap), line.unit, 2)} {'more' if gap >= 0 else 'less'} than {other} "
        f"({number(float(totals[0, :, profit].mean()), 2)} against {number(float(totals[1, :, profit].mean()), 2)}; "
        f"more in {more} of {runs} runs): "
        f"{sentence(parts)}. "
        f"{_penalty(cost, float(gaps[:, violations].mean()))}; its {in_sentence(what.title)} is {better}."
    )


def _more(line: Line, gap: float, above: str, below: str) -> str:
    """``0.56 EUR/m² more``."""
    return f"{_amount(abs(gap), line.unit, decimals_of(line))} {above if gap >= 0 else below}"


def _penalty(line: Line, gap: float) -> str:
    """What violations cost more or less, in money or points."""
    if line.unit == "-":
        return f"Its {in_sentence(line.title)} is {_more(line, gap, 'higher', 'lower')}"
    return f"Its {in_sentence(line.title)} cost {_more(line, gap, 'more', 'less')}"


def _when(period: int) -> str:
    return f"{'at' if period < 2 else 'on'} {PERIODS[period]}"


def paragraphs(story: Story) -> list[str]:
    """For each period that there was what the agent does differently in it, and what that earns."""
    return [_of_period(story, period) for period in range(len(PERIODS)) if story.times[period] > 0]


def _of_period(story: Story, period: int) -> str:
    gaps = story.gaps()[period]
    levels = [
        f"{in_sentence(curve.title)} {number(here, places)} instead of {_amount_shown(there, curve)}"
        for curve, here, there, places in _differing(story, period)
    ]
    amounts = [
        f"{in_sentence(line.title)} {_amount(abs(gaps[place]), line.unit, decimals_of(line))} {'more' if gaps[place] > 0 else 'less'}"
        for place, line in enumerate(story.lines)
        if line.kind in ("grown", "used") and _counts(story, period, place)
    ]
    money = [
        f"{in_sentence(line.title)} {number(worth, 2, signed=True)}"
        for line, worth in ((line, _worth(line, gaps[place])) for place, line in enumerate(story.lines))
        if line.kind in (_EARNED, _PAID) and abs(worth) >= _CENT
    ]
    profit, violations, score = (story.line(kind) for kind in ("profit", "violations", "score"))
    penalty, reward = story.lines[violations], story.lines[score]
    of_which = f" ({', '.join(money)})" if money else ""
    told = [
        f"{_sentence(_when(period))} ({story.times[period]:.0f} h a run): {'; '.join(levels) or 'climate and controls hardly differ'}.",
        f"{_sentence(', '.join(amounts))}." if amounts else "",
        f"Profit {_amount(gaps[profit], 'EUR m-2', 2, signed=True)}{of_which}; {_lower(_penalty(penalty, gaps[violations]))}; "
        f"{in_sentence(reward.title)} {_amount(gaps[score], reward.unit, decimals_of(reward), signed=True)}.",
    ]
    return " ".join(part for part in told if part)


def _lower(words: str) -> str:
    return words[:1].lower() + words[1:]


def _sentence(words: str) -> str:
    return words[:1].upper() + words[1:]


def _amount_shown(value: float, curve: Curve) -> str:
    return f"{number(value, _DECIMALS.get(unit_of(curve), 1))}\u00a0{unit_of(curve)}"


def _worth(line: Line, gap: float) -> float:
    """What a difference adds to the profit."""
    return -gap if line.kind in (_PAID, "violations") else gap


def _counts(story: Story, period: int, place: int) -> bool:
    both = np.abs(story.sums[:, :, :, place].mean(axis=1).sum(axis=1)).max()
    return bool(both > 0 and abs(story.gaps()[period, place]) >= _SHARE * both)


def _differing(story: Story, period: int) -> list[tuple[Curve, float, float, int]]:
    """The levels that differ most in a period, where one can see it, in the order of the story, with both values and decimals."""
    found: dict[str, tuple[float, int, Curve, float, float, int]] = {}
    for place, curve in enumerate(story.levels):
        here, there = (float(value) for value in story.means[:, period, place])
        unit = unit_of(curve)
        share = abs(here - there) / _VISIBLE.get(unit, max(abs(here), abs(there), 1e-9) / 20)
        name = _ALIKE.get(curve.path, curve.path)
        if share >= 1 and (name not in found or found[name][0] < share):
            found[name] = (share, place, curve, here, there, _DECIMALS.get(unit, 1))
    most = sorted(found.values(), key=lambda one: -one[0])[:_TOLD]
    return [(curve, here, there, places) for _, _, curve, here, there, places in sorted(most, key=lambda one: one[1])]


def text_of(story: Story) -> list[str]:
    """The story as paragraphs: which runs failed, headline, periods, and what to keep in mind."""
    return [*left_out_words(story), headline(story), *paragraphs(story), CAUTION]


def left_out_words(story: Story) -> list[str]:
    """Which runs failed and are left out, where any did."""
    if not story.failed:
        return []
    runs = len(story.seeds)
    rest = f"the {runs} runs that both ended" if runs > 1 else "the one run that both ended"
    return [f"{'; '.join(story.failed)}. What follows is about {rest}."]


CAUTION = (
    "The periods add up to the whole run. That is arithmetic and no cause: sugars of a bright day still grow fruit at night, "
    "and warmth of the morning spares heat later."
)


@dataclass(frozen=True)
class TableOf:
    """A table of the page: its caption, headings, and rows with their headings first; ``strong`` rows stand out."""

    caption: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    strong: tuple[str, ...] = ()


def ledger_table(story: Story) -> TableOf:
    """What the difference of each line is worth, by period and in the whole run."""
    gaps = story.gaps()
    kinds = (_EARNED, _PAID, "profit", "violations", "score")
    used = np.abs(story.sums).max(axis=(0, 1, 2)) > 1e-9
    lines = [(place, line) for place, line in enumerate(story.lines) if used[place] or line.kind in kinds[2:]]
    chosen = [(place, line) for kind in kinds for place, line in lines if line.kind == kind]
    rows = []
    for place, line in chosen:
        worth = [_worth(line, value) for value in (*gaps[:, place], gaps[:, place].sum())]
        unit = _said(line.unit)
        places = 2 if line.kind in (_EARNED, _PAID, "profit") else decimals_of(line)
        title = f"{line.title}{f', {unit}' if unit != 'EUR/m²' and unit else ''}"
        rows.append((title, *(number(value, places, signed=True) for value in worth)))
    strong = tuple(line.title for line in story.lines if line.kind in ("profit", "score"))
    one, other = story.agents
    return TableOf(
        f"{one} minus {other}: what each line adds to profit or score, EUR/m² where no unit stands, mean over {len(story.seeds)} runs",
        ("", *map(_sentence, PERIODS), "Whole run"),
        tuple(rows),
        strong,
    )


def week_table(story: Story, side: int) -> TableOf:
    """One agent's accounts by week."""
    kinds = ("light", "grown", "used", "profit", "violations", "score")
    largest = np.abs(story.weeks).max(axis=(0, 1))
    used = [most >= 0.5 * 10 ** -decimals_of(line) for most, line in zip(largest, story.lines, strict=True)]
    chosen = [place for kind in kinds for place, line in enumerate(story.lines) if line.kind == kind and used[place]]
    heads = [f"{story.lines[place].title}, {_week_unit(story.lines[place])}".rstrip(", ") for place in chosen]
    rows = []
    for week, values in enumerate(story.weeks[side]):
        days = int(story.days[week])
        short = "" if days == story.days[0] else f" ({days} days)"
        rows.append((f"{week + 1}{short}", *(number(values[p], decimals_of(story.lines[p])) for p in chosen)))
    return TableOf(f"{story.agents[side]} by week", ("Week", *heads), tuple(rows))


def _week_unit(line: Line) -> str:
    return _said(line.unit) + (" a day" if line.kind == "light" else "")


def page_of(story: Story) -> str:
    """The page: words, the ledger by period, climate and controls by hour of the day, weeks. One file, without a script."""
    require("The page", "report", "jinja2")
    jinja = importlib.import_module("jinja2")
    environment = jinja.Environment(
        autoescape=True, undefined=jinja.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    folder = resources.files("glbench.report") / "assets"
    limits = dict(story.task.constraints.items())
    charts = [
        _chart(curve, story.hours[:, :, place], limits.get(curve.limits or ""))
        for place, curve in enumerate(story.levels)
        if np.nanmax(np.abs(story.hours[:, :, place])) > 0
    ]
    page: str = environment.from_string((folder / "story.html.j2").read_text(encoding="utf-8")).render(
        story=story,
        agents=story.agents,
        title=story.task.title,
        failed=left_out_words(story),
        headline=headline(story),
        paragraphs=paragraphs(story),
        caution=CAUTION,
        ledger=ledger_table(story),
        weeks=[week_table(story, side) for side in (0, 1)],
        charts=charts,
        meanings=list(zip(map(_sentence, PERIODS), MEANINGS, strict=True)),
        gas=f"{3.6 * KWH_A_CUBIC_METRE:.2f}",
        style=(folder / "style.css").read_text(encoding="utf-8"),
        version=__version__,
    )
    return page


def _chart(curve: Curve, courses: Floats, limit: Any) -> dict[str, Any]:
    """One level by hour of the local day, of both agents, as what a drawing is made of."""
    known = courses[np.isfinite(courses)]
    low, high = float(known.min()), float(known.max())
    lines = [] if limit is None else [value for value in (limit.low, limit.high) if low - 1 <= value <= high + 1]
    ticks = _ticks(min(low, *lines, low), max(high, *lines, high))
    bottom, top = ticks[0], ticks[-1]
    step = ticks[1] - ticks[0]
    places = max(0, -math.floor(math.log10(step) + 1e-9))

    def x(hour: float) -> float:
        return round(_LEFT + hour / 24 * (_WIDTH - _LEFT - _RIGHT), 1)

    def y(value: float) -> float:
        return round(_TOP + (top - value) / (top - bottom) * (_HEIGHT - _TOP - _BOTTOM), 1)

    return {
        "title": curve.title,
        "unit": unit_of(curve),
        "width": _WIDTH,
        "height": _HEIGHT,
        "left": _LEFT,
        "right": _WIDTH - _RIGHT,
        "floor": _HEIGHT - _BOTTOM,
        "top": _TOP,
        "ticks": [(y(value), number(value, places)) for value in ticks],
        "hours": [(x(hour), str(hour)) for hour in (0, 6, 12, 18, 24)],
        "limits": [y(value) for value in lines],
        "paths": [_path((x(hour + 0.5), y(value)) for hour, value in enumerate(course) if np.isfinite(value)) for course in courses],
        "says": "; ".join(
            f"{name} {number(float(np.nanmin(course)), places)} to {number(float(np.nanmax(course)), places)}"
            for name, course in zip(("first", "second"), courses, strict=True)
        ),
    }  # fmt: skip


def _path(points: Iterable[tuple[float, float]]) -> str:
    return "M" + " L".join(f"{x},{y}" for x, y in points)


def _ticks(low: float, high: float) -> Sequence[float]:
    """Three to six round numbers that enclose a range."""
    span = max(high - low, 1e-6, 1e-3 * abs(high))
    power = 10.0 ** math.floor(math.log10(span / 3))
    step = next(factor * power for factor in (1, 2, 5, 10) if span / (factor * power) <= 4.5)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [place * step for place in range(first, max(last, first + 1) + 1)]


def document_of(story: Story) -> dict[str, Any]:
    """The story as plain values, for other programs."""
    levels = [{"path": one.path, "title": one.title, "unit": unit_of(one)} for one in story.levels]
    gaps = story.gaps()
    return {
        "task": story.task.id,
        "agent": story.agents[0],
        "against": story.agents[1],
        "seeds": list(story.seeds),
        "left_out": list(story.left_out),
        "clock": story.clock,
        "words": text_of(story),
        "periods": [
            {
                "name": name,
                "meaning": MEANINGS[period],
                "hours": round(float(story.times[period]), 3),
                "difference": {line.name: float(gaps[period, place]) for place, line in enumerate(story.lines)},
                "levels": _both(story.means[:, period]),
            }
            for period, name in enumerate(PERIODS)
        ],
        "lines": [{"name": one.name, "title": one.title, "unit": one.unit, "kind": one.kind} for one in story.lines],
        "levels": levels,
        "by_hour": _both(story.hours),
    }


def _both(values: Floats) -> list[Any]:
    """Of both agents, with null for what is not known."""
    cells = values.astype(object)
    cells[~np.isfinite(values)] = None
    found: list[Any] = cells.tolist()
    return found
