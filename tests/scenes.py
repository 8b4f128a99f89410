"""A small library of pictures under names that no shipped one has, for tasks of tests with a camera."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from PIL import Image

from glbench.tasks import TaskSpec, get_task
from glbench.vision.library import Library

MASSES, SEEDS, LIGHTS = np.linspace(0.0, 700.0, 29), 10, 3
HIDDEN = 5
"""Number of plant variations for training, the first ones. The last three are for tests, the two between for the encoder."""


def small_library(crop: str, version: str) -> Library:
    """Features that no two scenes share, of which the first follows the mass; other ones for each version."""
    mass, seeds, lights = (one.ravel() for one in np.meshgrid(MASSES, np.arange(SEEDS), np.arange(LIGHTS), indexing="ij"))
    numbers = np.random.default_rng(int(version)).uniform(-1.0, 1.0, (len(mass), 4))
    numbers[:, 0] = mass / 350.0 - 1.0
    files = []
    for scene in range(len(mass)):
        file = io.BytesIO()
        Image.fromarray(np.full((8, 8, 3), [int(mass[scene] / 3), 160, 40 * int(lights[scene])], np.uint8)).save(file, "PNG")
        files.append(np.frombuffer(file.getvalue(), np.uint8))
    return Library(
        crop=crop, digest=f"{int(version):064x}", columns=tuple("abcd"), features=numbers, truth={"mass": mass}, seeds=seeds, lights=lights,
        roles=np.select([seeds < HIDDEN, seeds < SEEDS - 3], [0, 1], 2),
        estimates=np.zeros((len(mass), 2)), _pictures=np.concatenate(files), _starts=np.cumsum([0, *map(len, files)]),
    )  # fmt: skip


def lettuce_seen(folder: Path, library: str = "toys-1", more: str = "") -> TaskSpec:
    """LettuceHarvestImages with pictures of ``library`` and a crew that also cuts plants of a few hours."""
    text = f'base = "glbench/LettuceHarvestImages-v1"\nid = "tests/{library}-v1"\ntitle = "Eyes"\n[camera]\nlibrary = "{library}"\n'
    due = '[actuation.on_off.uHarvest]\ndue = { state = "plantingDays", first = 0.1, last = 65.0, unit = "day" }\n'
    (folder / f"{library}.toml").write_text(text + due + more, encoding="utf-8")
    return get_task(folder / f"{library}.toml").in_split("validation")
