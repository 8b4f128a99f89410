"""Fills the table of accuracy in docs/kernel-compiled.md: ``python -m docs.accuracy_table docs/measurements/accuracy.txt``.

``python -m glbench.kernel.compiled.accuracy --presets standard fast > docs/measurements/accuracy.txt`` makes the measurement again.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from pathlib import Path

from docs.tables import with_tables

PAGE = Path(__file__).with_name("kernel-compiled.md")
KINDS = ("walk", "jump")


@dataclass(frozen=True)
class Accuracy:
    """What the command prints of one kind of controls: a row of figures a state, and substeps a step of each preset."""

    states: dict[str, tuple[str, ...]]
    substeps: dict[str, float]


def read(text: str) -> dict[str, Accuracy]:
    """Accuracy by kind of controls."""
    found = {}
    for kind in KINDS:
        part = text.split(f"controls that {kind}\n")[1].split("\n\n")[0].splitlines()[1:]
        rows = [line.split() for line in part if "substeps" not in line]
        substeps = {name: float(number) for name, number in re.findall(r"(\w+): ([\d.]+) substeps", "\n".join(part))}
        found[kind] = Accuracy({state: tuple(cell.rstrip("x") for cell in cells) for state, *cells in rows}, substeps)
    return found


def table(text: str) -> str:
    """Largest error of CVODES and the presets' errors as multiples of those of CVODES; states that are exact are left out."""
    found = read(text)
    lines = [
        "| state | walk: CVODES max | `standard` max | rms | `fast` rms | jump: CVODES max | `standard` max | rms | `fast` rms |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for state, walk in found["walk"].states.items():
        if float(walk[0]) > 0.0:
            # Columns: CVODES max and rms, standard max and rms, fast max and rms.
            cells = [row[i] for row in (walk, found["jump"].states[state]) for i in (0, 2, 3, 5)]
            lines.append(f"| {state} | {' | '.join(cells)} |")
    return "\n".join(lines)


def filled(page: str, text: str) -> str:
    """The page with its table made of what the command printed."""
    return with_tables(page, {"accuracy": table(text)})


def main(measurement: Path) -> None:
    """Fill the table."""
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8"), measurement.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
