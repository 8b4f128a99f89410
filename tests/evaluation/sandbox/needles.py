"""What no sandbox may hold: data that come with glbench, from weather and plans to results and pictures, and the seeds of scored runs."""

from __future__ import annotations

import gzip
import json
from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np

from glbench.resources import data_folder
from glbench.tasks import list_drafts, list_tasks
from glbench.vision import Library
from glbench.weather import list_weather, load_weather
from glbench.weather.trace import TRACE, lacks_package
from tests.evaluation.sandbox.content_search import WINDOW, Needles

_DAY = 24
_FEWER = 240
"""Numbers between windows of plans, of which there are many."""


@cache
def shipped_needles() -> Needles:
    """Windows of weather, plans, recordings, profiles and pictures, the digests of all released results, and the seeds of scored runs."""
    results = data_folder("reports/released/results")
    files = [file for file in results.glob("*/*.json") if ".proof." not in file.name]
    digests = {json.loads(file.read_bytes())["results_digest"] for file in files}
    return Needles.collect([*_weather(), *_actions(), *_profiles(), *_pictures()], digests, _seeds())


@cache
def weather_and_seeds() -> Needles:
    """Windows of every record, and the seeds of scored runs."""
    return Needles.collect(_weather(), (), _seeds())


def _seeds() -> set[tuple[int, int]]:
    """First seed and number of runs of each task; one seed alone, as bytes, is any number 10000 of any file."""
    tasks = [task.evaluation for task in (*list_tasks(), *list_drafts())]
    return {(scored.first_seed, scored.runs) for scored in tasks if scored.runs > 1}


def _weather() -> Iterator[tuple[str, Any, int]]:
    names = [info.name for info in list_weather() if info.origin == "shipped"]
    for name in names if lacks_package(TRACE) else (*names, TRACE):
        for quantity, counts in load_weather(name).counts.items():
            yield f"{quantity} of {name}", counts, _DAY


def _actions() -> Iterator[tuple[str, Any, int]]:
    for file in sorted(data_folder("baselines").glob("**/*.npz")):
        with np.load(file) as data:
            if "actions" in data:
                # Steps are the last axis of plans, and the first of a recording.
                actions = data["actions"] if data["actions"].ndim == 3 else data["actions"].T
                for row in actions.reshape(-1, actions.shape[-1]):
                    yield f"actions of {file.stem}", row, _FEWER


def _profiles() -> Iterator[tuple[str, Any, int]]:
    for file in sorted(data_folder("reports/released/results").glob("*/*.profile.json.gz")):
        for numbers in _lists(json.loads(gzip.decompress(file.read_bytes()))["worst"]):
            yield f"profile of {file.parent.name}", numbers, len(numbers)


def _pictures() -> Iterator[tuple[str, Any, int]]:
    library = Library.open("lettuce")
    for name, numbers in zip(library.columns, library.features.T, strict=True):
        yield f"{name} of pictures", numbers, _FEWER


def _lists(value: Any) -> Iterator[list[float]]:
    if isinstance(value, dict):
        for part in value.values():
            yield from _lists(part)
    elif isinstance(value, list) and len(value) >= WINDOW and all(isinstance(one, int | float) for one in value):
        yield value
