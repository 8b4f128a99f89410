"""Draws docs/images/speed.svg and fills the tables of docs/speed.md: ``python -m docs.speed_figure docs/measurements/speed.json``.

With another page behind the record, fills the tables of that page and draws nothing.

The chart continues the one of the benchmark's paper: steps of 300 s in a second of one core, ten days from October 2009. What the paper
states is written here; everything of glbench comes from the record.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

from docs.tables import with_tables
from glbench.speed import SpeedRecord, read_record
from glbench.speed.subjects import GROUPS

PAPER_RATE = 1800.0  # steps/s, "over 1,800 steps per second"
# Name, steps/s, and where the figure is from.
PUBLISHED = (
    ("older implementation, paper's slower", PAPER_RATE / 24, "paper: GreenLight-Gym is 24 times as fast"),
    ("older implementation, paper's faster", PAPER_RATE / 17, "paper: GreenLight-Gym is 17 times as fast"),
    ("GreenLight-Gym, as stated", PAPER_RATE, "paper"),
)
WIDTH, ROW, LEFT, RIGHT, TOP = 860, 30, 290, 150, 58
LOWEST, HIGHEST = 10.0, 1e6


def main(arguments: list[str]) -> int:
    """Write picture and tables."""
    record = read_record(Path(arguments[0]))
    here = Path(__file__).parent
    page = Path(arguments[1]) if len(arguments) > 1 else here / "speed.md"
    if page.name == "speed.md":
        (here / "images" / "speed.svg").write_text(picture(record), encoding="utf-8")
    page.write_text(filled(page.read_text(encoding="utf-8"), record), encoding="utf-8")
    return 0


def filled(text: str, record: SpeedRecord) -> str:
    """The page with the record's figures between its marks."""
    return with_tables(text, {"figures": "\n".join(tables(record)), "machine": "\n".join(machine_lines(record))})


def tables(record: SpeedRecord) -> list[str]:
    """A Markdown table a group."""
    lines: list[str] = []
    for group, title in GROUPS.items():
        rows = [one for one in record.measurements if one.group == group]
        if not rows:
            continue
        heads = f"| {title} | us a step | steps/s | times CVODES | rounds |"
        lines += ["", heads, "|---|---:|---:|---:|---:|"] if lines else [heads, "|---|---:|---:|---:|---:|"]
        lines += [
            f"| {one.title} | {one.microseconds:,.2f} | {one.steps_per_second:,.0f} | **{one.ratio:,.1f}** | "
            f"{one.ratio_low:,.1f} to {one.ratio_high:,.1f} |"
            for one in rows
        ]
    return lines


def machine_lines(record: SpeedRecord) -> list[str]:
    """What it was measured on, and what happens once."""
    machine, kernel, reference = record.machine, record.kernel, record.find("step/standard/walk")
    cost = f", {reference.reference_microseconds:,.0f} us a step of 900 s" if reference is not None else ""
    lines = [
        f"{machine.processor}, {machine.cores} cores, {kernel.get('lanes', 1):.0f} lanes, {kernel.get('compiler', '')}; "
        f"{record.created[:10]}, glbench {record.versions.glbench}. Reference: {record.reference}{cost}."
    ]
    if record.first_use is not None:
        lines.append(f"First use on an empty cache: {record.first_use.seconds:.1f} s, at most {record.first_use.megabytes:,.0f} MB.")
    if record.memory is not None:
        memory = record.memory
        lines.append(
            f"Memory: {memory.megabytes:,.0f} MB with {memory.environments:,} environments, {memory.megabytes_of_one:,.0f} MB with one."
        )
    return lines


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
