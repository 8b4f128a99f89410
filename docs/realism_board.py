"""The tables of docs/realism-board.md: ``python -m docs.realism_board [FILE]``.

``FILE`` is the ``board.json`` of ``glbench validate FOLDER --agents NAMES --out OUT``; it is kept as docs/measurements/realism-board.json
and holds season sums alone. Without it the tables are filled from what is kept.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path

from docs.tables import with_tables
from glbench.realism.board import Board
from glbench.realism.money import Account
from glbench.resources import write_atomically

DOCS = Path(__file__).parent
PAGE, FIGURES = DOCS / "realism-board.md", DOCS / "measurements" / "realism-board.json"
MEASURED, HOUSES = "board-measured", "board-houses"
_COLUMNS = ("fruit", "electricity", "heat", "CO₂", "labour", "plants", "net profit")


def row(one: Account, name: str) -> list[str]:
    """Its amounts and money, EUR m-2, as cells."""
    return [
        name, f"{one.fruit:.1f} kg: {one.income:.2f}", f"{one.electricity:.0f} kWh: {0.0 - one.cost_electricity:.2f}",
        f"{one.heat:.0f} MJ: {-one.cost_heat:.2f}", f"{one.co2:.1f} kg: {-one.cost_co2:.2f}", f"{-one.labour:.2f}", f"{-one.plants:.2f}",
        f"**{one.net():.2f}**",
    ]  # fmt: skip


def table(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Markdown."""
    heads, rows = tuple(heads), [tuple(cells) for cells in rows]
    lines = [heads, ["---:" if any(name[:1] in "-0123456789*" for name in column) else "---" for column in zip(*rows, strict=True)], *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def tables(board: Board) -> dict[str, str]:
    """Both tables by their marks: what was measured, and what was simulated in each house."""
    rows = []
    for one in board.accounts:
        if one.house is not None:
            own = " by its own set points" if one.name == board.compartment else ""
            scaled = "-" if one.fruit_ratio is None else f"{one.net(one.fruit_ratio):.2f} ({one.fruit_ratio:.2f})"
            rows.append([f"`{one.house}`", *row(one, f"{one.name}{own}, simulated" if own else f"`{one.name}`, simulated"), scaled])
    return {
        MEASURED: table(
            ("compartment", *_COLUMNS), (row(one, f"{one.name}, measured") for one in board.accounts if one.house is None)
        ),
        HOUSES: table(("house", "who", *_COLUMNS, "the same with fruit times (ratio)"), rows),
    }  # fmt: skip


def filled(page: str, board: Board) -> str:
    """The page with its tables."""
    return with_tables(page, tables(board))


def read() -> Board:
    """What is kept."""
    return Board.model_validate_json(FIGURES.read_text(encoding="utf-8"))


def main() -> None:
    """Keep the figures, fill the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path, nargs="?", help="board.json of glbench validate")
    asked = parser.parse_args()
    board = Board.model_validate_json((asked.file or FIGURES).read_text(encoding="utf-8"))
    write_atomically(FIGURES, board.model_dump_json(indent=1) + "\n")
    write_atomically(PAGE, filled(PAGE.read_text(encoding="utf-8"), board))


if __name__ == "__main__":
    main()
