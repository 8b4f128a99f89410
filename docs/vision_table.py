"""Tables and pictures of docs/vision.md, from the shipped libraries: ``python -m docs.vision_table [--picture]``."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.vision_render import OWN_ROWS, tomato_states
from docs.tables import with_tables
from glbench.resources import write_atomically
from glbench.vision.library import Library
from glbench.vision.tomato import STEMS as STEMS_M2
from glbench.vision.tomato import row

DOCS = Path(__file__).resolve().parent
PAGE = DOCS / "vision.md"
PICTURES = {"lettuce": DOCS / "images" / "vision-lettuce.jpg", "tomato": DOCS / "images" / "vision-tomato.jpg"}
CLASSES = ((3, 30), (30, 100), (100, 200), (200, 300), (300, 400), (400, 500), (500, 701))
"""From and below [g]."""
SCALE = 0.06
"""Error of the weekly sample of ``LettuceHarvest-v1``, relative: tasks/lettuceharvest-v1.toml."""
SHEET = (10.0, 30.0, 70.0, 130.0, 200.0, 300.0, 400.0, 550.0)
"""Masses of the picture [g]."""
LIGHTS = ("overcast", "noon", "late afternoon")
TOMATO = {"leaf_area_index": "leaf area index, m² m⁻²", "fruits": "fruits on the plants, m⁻²", "ripe": "ripe fruits, m⁻²"}
STEMS, EVERY = 10, 5
"""Stems that a crew counts, and of how many scenes one is counted again for this page."""
SEASON = (0, 4, 7, 10, 13, 15, 19)
"""States of a season in the picture, of those in ``benchmarks.vision_render``."""


def errors(library: Library, rows: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Relative error of the estimated mass of some scenes."""
    return np.asarray(library.estimates[rows, 0] / library.truth["mass"][rows] - 1.0)


def rms(values: NDArray[np.float64]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def determination(library: Library, rows: NDArray[np.bool_]) -> float:
    """Coefficient of determination of the estimated mass."""
    mass = library.truth["mass"][rows]
    return 1.0 - float(np.sum((library.estimates[rows, 0] - mass) ** 2) / np.sum((mass - mass.mean()) ** 2))


def lasting(library: Library, rows: NDArray[np.bool_]) -> float:
    """What the mean over the pictures of one plant variation is off by, relative, root mean square: no second picture takes it away."""
    seeds = library.seeds[rows]
    return rms(np.array([errors(library, rows)[seeds == seed].mean() for seed in np.unique(seeds)]))


def by_mass(library: Library) -> str:
    """Error by mass class, of plants that the encoder has not seen; beside it that of a sample on the scale."""
    lines = [
        "| mean mass of the heads, g | pictures | error of a picture, g | in % | lasting part, % | R² | plants trained on, % "
        "| scale, ten heads, g | in % |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for low, high in (*CLASSES, (3, 701)):
        inside = (library.truth["mass"] >= low) & (library.truth["mass"] < high)
        rows, seen = inside & ~library.plants("encoder"), inside & library.plants("encoder")
        grams = library.estimates[rows, 0] - library.truth["mass"][rows]
        name = "all" if (low, high) == (3, 701) else f"{low} to {min(high, 700)}"
        lines.append(
            f"| {name} | {rows.sum()} | {rms(grams):.1f} | {100 * rms(errors(library, rows)):.1f} | {100 * lasting(library, rows):.1f} "
            f"| {determination(library, rows):.2f} | {100 * rms(errors(library, seen)):.1f} "
            f"| {SCALE * rms(library.truth['mass'][rows]):.1f} | {100 * SCALE:g} |"
        )
    return "\n".join(lines)


def by_light(library: Library) -> str:
    """Error by light, of heads from 200 to 500 g that the encoder has not seen; and that of the cover below 200 g."""
    lines = ["| light | error of the mass, 200 to 500 g, % | error of the cover, below 200 g, percentage points |", "|---|---:|---:|"]
    for light, name in enumerate(LIGHTS):
        shown = ~library.plants("encoder") & (library.lights == light)
        heavy, light_ones = shown & (library.truth["mass"] >= 200) & (library.truth["mass"] < 500), shown & (library.truth["mass"] < 200)
        off = library.estimates[light_ones, 1] - library.truth["cover"][light_ones]
        lines.append(f"| {name} | {100 * rms(errors(library, heavy)):.1f} | {100 * rms(off):.1f} |")
    return "\n".join(lines)


def counting_errors() -> NDArray[np.float64]:
    """What a count of ``STEMS`` stems is off by, of all fruits and of ripe ones [m-2], root mean square over some of the rows shown."""
    rows = [row(index, fruits, variation) for variation, index, fruits in tomato_states()[OWN_ROWS::EVERY]]
    spreads = np.array([[np.var(one.fruits, ddof=1), np.var(one.ripe, ddof=1)] for one in rows])
    return np.asarray(STEMS_M2 * np.sqrt(spreads.mean(axis=0) / STEMS))


def of_tomato(library: Library) -> str:
    """Error of each estimate, of rows that the encoder has not seen; beside it that of a count."""
    lines = ["| what | range | error of a picture | R² | of rows trained on | of a count of ten stems |", "|---|---:|---:|---:|---:|---:|"]
    test, seen, counts = library.plants("test"), library.plants("encoder"), ["–", *(f"{value:.1f}" for value in counting_errors())]
    for place, (name, words) in enumerate(TOMATO.items()):
        off, true = library.estimates[:, place] - library.truth[name], library.truth[name][test]
        share, decimals = 1.0 - np.mean(off[test] ** 2) / np.var(true), 2 if place == 0 else 1
        own, others = (f"{rms(off[rows]):.{decimals}f}" for rows in (seen, test))
        span = f"{true.min():.{decimals}f} to {true.max():.{decimals}f}"
        lines.append(f"| {words} | {span} | {others} | {share:.2f} | {own} | {counts[place]} |")
    return "\n".join(lines)


def filled(page: str, library: Library, tomato: Library) -> str:
    """The page with its tables."""
    return with_tables(page, {"by-mass": by_mass(library), "by-light": by_light(library), "of-tomato": of_tomato(tomato)})


def season_sheet(library: Library) -> NDArray[np.uint8]:
    """A row that the encoder has not seen, in states of a season from left to right, at noon."""
    first = np.flatnonzero(library.plants("test") & (library.lights == LIGHTS.index("noon")))[list(SEASON)]
    return np.concatenate([library.image(int(index)) for index in first], axis=1)


def sheet(library: Library) -> NDArray[np.uint8]:
    """Pictures of one planting that the encoder has not seen, by mass from left to right, in each light from top to bottom."""
    scene = np.array(SHEET)
    lights = (np.arange(len(LIGHTS)) + 0.5) / len(LIGHTS)
    rows = [library.pick(scene, np.full(scene.shape, 0.5), np.full(scene.shape, light)) for light in lights]
    return np.concatenate([np.concatenate([library.image(int(index)) for index in row], axis=1) for row in rows])


def main() -> None:
    """Fill the page; with ``--picture`` draw the pictures, too."""
    library, tomato = Library.open("lettuce"), Library.open("tomato")
    write_atomically(PAGE, filled(PAGE.read_text(encoding="utf-8"), library, tomato))
    if "--picture" in sys.argv:
        from PIL import Image

        Image.fromarray(sheet(library)).save(PICTURES["lettuce"], quality=92)
        Image.fromarray(season_sheet(tomato)).save(PICTURES["tomato"], quality=92)


if __name__ == "__main__":
    main()
