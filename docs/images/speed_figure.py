"""Draws docs/images/speed.svg from a speed record: ``python docs/images/speed_figure.py docs/measurements/speed.json``.

The chart continues the one of the benchmark's paper: steps of 300 s in a second of one core, ten days from October 2009. What the paper
states and what was measured of published packages is written here; everything of glbench comes from the record.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

from glbench.speed import SpeedRecord, read_record

PAPER_RATE = 1800.0  # steps/s, "over 1,800 steps per second"
# Name, steps/s, and where the figure is from.
PUBLISHED = (
    ("older implementation, paper's slower", PAPER_RATE / 24, "paper: GreenLight-Gym is 24 times as fast"),
    ("older implementation, paper's faster", PAPER_RATE / 17, "paper: GreenLight-Gym is 17 times as fast"),
    ("GreenLight-Gym, as stated", PAPER_RATE, "paper"),
    ("gl-gym 0.3.2, tolerance 1e-4", 2350.0, "its package, one core of an EPYC, model only"),
    ("GreenLight-Gym 2, tolerance 1e-6", 3880.0, "its code, one core of an EPYC, model only"),
)
WIDTH, ROW, LEFT, RIGHT, TOP = 860, 30, 290, 150, 58
LOWEST, HIGHEST = 10.0, 1e6


def main(arguments: list[str]) -> int:
    """Write the picture beside this script."""
    record = read_record(Path(arguments[0]))
    Path(__file__).with_name("speed.svg").write_text(picture(record), encoding="utf-8")
    return 0


def bars(record: SpeedRecord) -> list[tuple[str, float, str]]:
    """Name, steps/s and colour of every bar, slowest first."""
    found = [(name, rate, "#9aa5b1") for name, rate, _ in PUBLISHED]
    alone = record.find("paper/standard")
    if alone is not None:
        found.append(("CVODES 1e-6 compiled, same run", 1e6 / alone.reference_microseconds, "#9aa5b1"))
        found.append(("glbench, one greenhouse", alone.steps_per_second, "#2f7d4f"))
    batch = record.find("paper-batch/standard")
    if batch is not None:
        found.append(("glbench, 512 greenhouses at once", batch.steps_per_second, "#2f7d4f"))
    return sorted(found, key=lambda bar: bar[1])


def picture(record: SpeedRecord) -> str:
    """The chart as SVG, readable on light and dark pages."""
    rows = bars(record)
    height = TOP + ROW * len(rows) + 52

    def across(rate: float) -> float:
        span = math.log10(HIGHEST) - math.log10(LOWEST)
        return LEFT + (WIDTH - LEFT - RIGHT) * (math.log10(rate) - math.log10(LOWEST)) / span

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="system-ui, sans-serif" font-size="14">',
        "<title>Model steps of 300 s in a second of one core</title>",
        f'<rect width="{WIDTH}" height="{height}" fill="#ffffff"/>',
        '<text x="16" y="26" font-size="17" font-weight="600" fill="#1f2933">Model steps of 300 s in a second of one core</text>',
        '<text x="16" y="46" fill="#52606d">logarithmic; ten days from 1 October 2009</text>',
    ]
    for power in range(1, 7):
        x = across(10.0**power)
        bottom = TOP + ROW * len(rows) + 6
        parts.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{TOP}" y2="{bottom}" stroke="#e4e7eb"/>')
        parts.append(f'<text x="{x:.1f}" y="{bottom + 18}" text-anchor="middle" fill="#52606d">{10**power:,}</text>')
    for i, (name, rate, colour) in enumerate(rows):
        y = TOP + ROW * i + 6
        parts += [
            f'<text x="{LEFT - 10}" y="{y + 15}" text-anchor="end" fill="#1f2933">{name}</text>',
            f'<rect x="{LEFT}" y="{y}" width="{across(rate) - LEFT:.1f}" height="{ROW - 10}" rx="2" fill="{colour}"/>',
            f'<text x="{across(rate) + 8:.1f}" y="{y + 15}" fill="#1f2933">{rate:,.0f} <tspan fill="#52606d">steps/s</tspan></text>',
        ]
    parts.append(
        f'<text x="16" y="{height - 10}" font-size="12" fill="#52606d">{record.machine.processor}, {record.created[:10]}, '
        f"glbench {record.versions.glbench}; sources of the other figures: docs/speed.md</text></svg>"
    )
    return "\n".join(parts) + "\n"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
