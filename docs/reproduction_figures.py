"""Tables and figures of docs/reproduction.md from result files: ``python -m docs.reproduction_figures [reports/released/results]``.

Reads the results of the controllers on the seven levels of the paper's study, draws docs/images/reproduction-curves.svg and
reproduction-money.svg, and rewrites the tables between the markers of docs/reproduction.md. What is not evaluated yet is left out.
Where an algorithm was trained several times, its figure is the mean of the trainings, with their range.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docs.tables import with_tables
from glbench.evaluation import load_result
from glbench.leaderboard.statistics import estimate_mean
from glbench.resources import write_atomically

DOCS = Path(__file__).resolve().parent
LEVELS = (0, 5, 10, 15, 20, 25, 30)
AGENTS = {
    "ppo": "#0072b2",
    "sac": "#d55e00",
    "rule_based": "#555555",
    "rule_based_fair": "#aaaaaa",
    "rule_based_unlit": "#cc79a7",
    "ppo_tuned": "#009e73",
    "recording": "#56b4e9",
    "do_nothing": "#000000",
}
ONLY_IN_EPI = {"do_nothing"}
"""Agents whose reward and penalty lie so far from the others' that a common scale would flatten all curves."""
CURVES = (("reward", "cumulative reward [-]"), ("epi", "EPI [EUR/m²]"), ("penalty", "penalty [-]"))
TRAININGS = {"ppo": ("ppo", "ppo_seed1", "ppo_seed2"), "sac": ("sac", "sac_seed1", "sac_seed2")}
"""Agents of one recipe trained with seeds 0, 1 and 2."""
SEEDED_LEVELS = (0, 10, 30)
MONEY = (
    ("revenue", "revenue", "#7fbf7b", 1),
    ("cost_heat", "heat", "#d7301f", -1),
    ("cost_electricity", "electricity", "#fdcc8a", -1),
    ("cost_co2", "CO2", "#969696", -1),
)
FONT = 'font-family="system-ui, sans-serif"'


@dataclass(frozen=True)
class Point:
    """Mean over the runs with its 95 % interval; of several trainings, the mean of their means with the range."""

    mean: float
    low: float
    high: float
    trainings: int = 1


Points = dict[tuple[str, int, str], Point]


def headline(points: Points) -> Points:
    """``points`` with the trainings of one algorithm as one agent: the mean of their means, from the lowest to the highest."""
    members = {member for agents in TRAININGS.values() for member in agents}
    pooled = {key: point for key, point in points.items() if key[0] not in members}
    for recipe, agents in TRAININGS.items():
        for level, metric in dict.fromkeys(key[1:] for key in points if key[0] in agents):
            found = [points[agent, level, metric] for agent in agents if (agent, level, metric) in points]
            means = [point.mean for point in found]
            several = Point(float(np.mean(means)), min(means), max(means), len(means))
            pooled[recipe, level, metric] = several if len(means) > 1 else found[0]
    return pooled


def collect(results: Path) -> Points:
    """Agent, level [%] and metric -> mean over the runs."""
    points: Points = {}
    trainings = [agent for agents in TRAININGS.values() for agent in agents]
    for agent in dict.fromkeys([*AGENTS, *trainings]):
        for level in LEVELS:
            file = results / f"Schiphol2010-Delta{level:02d}-v1" / f"{agent}.json"
            if not file.is_file():
                continue
            runs = load_result(file).runs
            for metric in (*(name for name, _ in CURVES), *(name for name, *_ in MONEY)):
                values = np.array([run.metrics[metric] for run in runs])
                points[agent, level, metric] = _point(values)
    return points


def _point(values: NDArray[np.float64]) -> Point:
    found = estimate_mean([values]).interval()
    return Point(found.value, found.low, found.high)


def curves(points: Points) -> str:
    """Three panels: reward, EPI and penalty against the uncertainty."""
    points = headline(points)
    width, height, left, top = 330, 290, 62, 46
    parts = []
    for place, (metric, title) in enumerate(CURVES):
        shown = {key[:2]: point for key, point in points.items() if key[2] == metric and _drawn(key[0], metric)}
        lows, highs = [p.low for p in shown.values()], [p.high for p in shown.values()]
        ticks = round_ticks(min([*lows, 0.0] if metric != "reward" else lows), max([*highs, 0.0] if metric != "reward" else highs))
        x0 = place * width + left

        def x(level: float, x0: float = x0) -> float:
            return x0 + level / 30 * (width - left - 22)

        def y(value: float, ticks: list[float] = ticks) -> float:
            return top + (height - top - 46) * (ticks[-1] - value) / (ticks[-1] - ticks[0])

        parts.append(text(place * width + width / 2 + 20, 34, title, size=13, anchor="middle"))
        for tick in ticks:
            parts.append(f'<line x1="{x(0):.1f}" x2="{x(30):.1f}" y1="{y(tick):.1f}" y2="{y(tick):.1f}" stroke="#e4e4e4"/>')
            parts.append(text(x(0) - 8, y(tick) + 4, f"{tick:g}", anchor="end"))
        parts += [text(x(level), height - 26, str(level), anchor="middle") for level in LEVELS]
        parts.append(text((x(0) + x(30)) / 2, height - 8, "uncertainty of the crop, ± %", anchor="middle"))
        for agent, colour in AGENTS.items():
            course = [(x(level), shown[agent, level]) for level in LEVELS if (agent, level) in shown]
            line = " ".join(f"{at:.1f},{y(point.mean):.1f}" for at, point in course)
            parts.append(f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="2"/>')
            for at, point in course:
                parts.append(f'<line x1="{at:.1f}" x2="{at:.1f}" y1="{y(point.low):.1f}" y2="{y(point.high):.1f}" stroke="{colour}"/>')
                fill = "#fff" if agent in TRAININGS and point.trainings == 1 else colour
                parts.append(f'<circle cx="{at:.1f}" cy="{y(point.mean):.1f}" r="3.2" fill="{fill}" stroke="{colour}"/>')
    present = [agent for agent in AGENTS if any(key[0] == agent for key in points)]
    legend = [
        f'<circle cx="{40 + 120 * i}" cy="12" r="4" fill="{AGENTS[agent]}"/>' + text(48 + 120 * i, 16, agent)
        for i, agent in enumerate(present)
    ]
    return svg(width * 3, height, [*legend, *parts])


def money(points: Points) -> str:
    """Who earns what: revenue upwards, costs downwards, the EPI as a mark; at 0, 10 and 30 %."""
    points = headline(points)
    chosen = [(agent, level) for level in (0, 10, 30) for agent in AGENTS if (agent, level, "revenue") in points]
    highest = max(points[agent, level, "revenue"].mean for agent, level in chosen)
    lowest = -max(sum(points[agent, level, name].mean for name, *_, sign in MONEY if sign < 0) for agent, level in chosen)
    ticks = round_ticks(lowest, highest)
    bar, left, top, height = 46, 62, 40, 380
    bottom = height - 96

    def y(value: float) -> float:
        return top + (bottom - top) * (ticks[-1] - value) / (ticks[-1] - ticks[0])

    width = max(700, left + bar * len(chosen) + 3 * 30)
    parts = [text(left, 18, "EUR/m² over the 60 days", size=13)]
    for i, (_, title, colour, _) in enumerate(MONEY):
        at = left + 190 + 95 * i
        parts.append(f'<rect x="{at}" y="9" width="10" height="10" fill="{colour}"/>' + text(at + 15, 18, title))
    at = left + 190 + 95 * len(MONEY)
    parts.append(f'<rect x="{at}" y="12" width="12" height="3" fill="#000"/>' + text(at + 17, 18, "EPI"))
    for tick in ticks:
        parts.append(f'<line x1="{left}" x2="{width - 10}" y1="{y(tick):.1f}" y2="{y(tick):.1f}" stroke="#e4e4e4"/>')
        parts.append(text(left - 8, y(tick) + 4, f"{tick:g}", anchor="end"))
    x, group = left + 8.0, -1
    for agent, level in chosen:
        if group not in (-1, level):
            x += 30
        if group != level:
            parts.append(text(x, height - 6, f"± {level} %", size=13))
        group = level
        down = 0.0
        for name, _, colour, sign in MONEY:
            value = points[agent, level, name].mean
            high, low = (value, 0.0) if sign > 0 else (-down, -down - value)
            down += 0.0 if sign > 0 else value
            parts.append(f'<rect x="{x:.1f}" y="{y(high):.1f}" width="{bar - 12}" height="{y(low) - y(high):.1f}" fill="{colour}"/>')
        earned = y(points[agent, level, "epi"].mean)
        parts.append(f'<rect x="{x - 3:.1f}" y="{earned - 1.5:.1f}" width="{bar - 6}" height="3" fill="#000"/>')
        parts.append(
            f'<text transform="translate({x + 20:.1f},{bottom + 8}) rotate(-35)" text-anchor="end" font-size="11" {FONT}>{agent}</text>'
        )
        x += bar
    return svg(int(x + 20), height, parts)


def table(points: Points, metric: str, digits: int) -> str:
    """A table of one metric: a row an agent, a column a level; several trainings with their range below the mean."""
    points = headline(points)
    rows = [f"| | {' | '.join(f'{level} %' for level in LEVELS)} |", "|---|" + "---:|" * len(LEVELS)]
    for agent in AGENTS:
        cells = [points.get((agent, level, metric)) for level in LEVELS]
        if any(cells):
            rows.append(f"| `{agent}` | " + " | ".join("–" if cell is None else _cell(cell, digits) for cell in cells) + " |")
    return "\n".join(rows)


def _cell(point: Point, digits: int) -> str:
    """A mean, with the range of the trainings where there are several."""
    if point.trainings == 1:
        return f"{point.mean:,.{digits}f}"
    return f"{point.mean:,.{digits}f}<br>({point.low:,.{digits}f} to {point.high:,.{digits}f})"


def money_table(points: Points) -> str:
    """Revenue and costs at 0, 10 and 30 %; of several trainings, their mean."""
    points = headline(points)
    rows = ["| EUR/m² | " + " | ".join(title for _, title, *_ in MONEY) + " | EPI |", "|---|" + "---:|" * (len(MONEY) + 1)]
    for level in (0, 10, 30):
        for agent in AGENTS:
            if (agent, level, "epi") in points:
                cells = [points[agent, level, name].mean for name in (*(name for name, *_ in MONEY), "epi")]
                rows.append(f"| `{agent}`, ± {level} % | " + " | ".join(f"{cell:.2f}" for cell in cells) + " |")
    return "\n".join(rows)


def trainings_table(points: Points) -> str:
    """Reward and EPI of every training at the levels with several of them, and how far apart they lie."""
    rows = ["| | | seed 0 | seed 1 | seed 2 | range |", "|---|---|---:|---:|---:|---:|"]
    for recipe, agents in TRAININGS.items():
        for level in SEEDED_LEVELS:
            for metric, title, digits in (("reward", "reward", 0), ("epi", "EPI, EUR/m²", 2)):
                found = [points.get((agent, level, metric)) for agent in agents]
                means = [point.mean for point in found if point is not None]
                if len(means) > 1:
                    cells = ["–" if point is None else f"{point.mean:,.{digits}f}" for point in found]
                    cells.append(f"{max(means) - min(means):,.{digits}f}")
                    rows.append(f"| `{recipe}`, ± {level} % | {title} | " + " | ".join(cells) + " |")
    return "\n".join(rows)


def _drawn(agent: str, metric: str) -> bool:
    return agent in AGENTS and (metric == "epi" or agent not in ONLY_IN_EPI)


def round_ticks(low: float, high: float) -> list[float]:
    """Round numbers about a fifth of the span apart, from at most ``low`` to at least ``high``."""
    rough = (high - low) / 5 or 1.0
    size = 10 ** np.floor(np.log10(rough))
    step = float(size * next(factor for factor in (1, 2, 5, 10) if factor * size >= rough))
    first, last = np.floor(low / step), np.ceil(high / step)
    return [float(step * k) for k in np.arange(first, last + 1)]


def text(x: float, y: float, words: str, *, size: int = 11, anchor: str = "start") -> str:
    """Words of a figure in SVG."""
    return f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}" text-anchor="{anchor}" {FONT}>{words}</text>'


def svg(width: int, height: int, parts: list[str]) -> str:
    """A figure in SVG on white."""
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}">'
    return "\n".join([head, '<rect width="100%" height="100%" fill="#fff"/>', *parts, "</svg>"]) + "\n"


def filled(page: str, points: Points) -> str:
    """The page with its tables made of ``points``."""
    tables = {
        "reward": table(points, "reward", 0),
        "epi": table(points, "epi", 2),
        "penalty": table(points, "penalty", 0),
        "money": money_table(points),
        "trainings": trainings_table(points),
    }
    return with_tables(page, tables)


def figures(points: Points) -> dict[str, str]:
    """The figures, by name in docs/images."""
    return {"reproduction-curves.svg": curves(points), "reproduction-money.svg": money(points)}


def main(results: Path) -> None:
    """Draw the figures and fill the tables."""
    points = collect(results)
    for name, figure in figures(points).items():
        write_atomically(DOCS / "images" / name, figure)
    page = DOCS / "reproduction.md"
    write_atomically(page, filled(page.read_text(encoding="utf-8"), points))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else DOCS.parent / "reports" / "released" / "results")
