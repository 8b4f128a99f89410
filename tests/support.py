"""What the tests of several rooms work with."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from glbench.resources import data_folder
from glbench.tasks import TaskSpec, get_task, list_drafts, list_tasks
from glbench.weather.trace import lacks_package

DOCS = Path(__file__).resolve().parents[1] / "docs"


def baselines_script(name: str) -> ModuleType:
    """A script of the folder baselines as a module, which data classes find by its name."""
    spec = importlib.util.spec_from_file_location(f"baselines_{name}", DOCS.parent / "baselines" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def published_tasks() -> list[TaskSpec]:
    """The published tasks whose weather is installed here."""
    return [task for task in list_tasks() if not lacks_package(task.weather.source)]


def shipped_tasks(*, maps: bool = True) -> list[TaskSpec]:
    """The published tasks and the drafts whose weather is installed here; without those whose model is a map, if ``maps`` is false."""
    here = [task for task in (*published_tasks(), *list_drafts()) if not lacks_package(task.weather.source)]
    return [task for task in here if maps or task.model_value.step_map is None]


def wait_for_checkpoint(folder: Path, process: subprocess.Popen[str]) -> None:
    """Until an evaluation has left a checkpoint below ``folder``, or is over; five minutes at most. Folders come and go meanwhile."""
    deadline = time.monotonic() + 300
    while time.monotonic() < deadline and process.poll() is None:
        if any("snapshot.npz" in names for _, _, names in os.walk(folder)):
            return
        time.sleep(0.05)


def is_recorded_processor() -> bool:
    """Whether this processor is of the kind that figures in the pages were made on: x86 with AVX-512. Elsewhere, rounding differs, and a
    closed loop may turn it into a hundredth of a EUR/m2."""
    extensions = np.show_config(mode="dicts")["SIMD Extensions"]["found"]
    return any(name == "X86_V4" or name.startswith("AVX512") for name in extensions)


def examples_of(page: str) -> list[str]:
    """The Python examples of a page of docs/, in their order."""
    return re.findall(r"```python\n(.*?)```", (DOCS / page).read_text(encoding="utf-8"), re.DOTALL)


def run_examples(page: str, examples: Iterable[str], names: dict[str, Any]) -> dict[str, Any]:
    """Run examples of a page one after the other; what they define joins ``names``."""
    for example in examples:
        exec(compile(example, str(DOCS / page), "exec"), names)
    return names


def write_day_task(folder: Path) -> Path:
    """The default task, cut to one day of 24 steps and three runs, under an id of its own."""
    return write_short_task(folder, "Day", days=1)


def write_short_task(folder: Path, name: str, *, days: int) -> Path:
    """The default task, cut to some days of 24 steps and three runs, as ``test/NAME-v1`` in the file ``name.toml``."""
    text = (data_folder("tasks") / "schiphol2010-delta10-v1.toml").read_text(encoding="utf-8")
    for pattern, replacement in {
        r'id = "glbench/.*"': f'id = "test/{name}-v1"',
        r"days = 60": f"days = {days}",
        r"step_seconds = 900": "step_seconds = 3600",
        r"runs = 30": "runs = 3",
    }.items():
        text, count = re.subn(pattern, replacement, text, count=1)
        assert count == 1, pattern
    path = folder / f"{name.lower()}.toml"
    path.write_text(text, encoding="utf-8")
    return path


LETTUCE = """
schema = 2
id = "test/Salad-v1"
title = "Two days of lettuce"
description = "Of a task of schema 2, all that published tasks have not."
suites = []

[weather]
source = "schiphol"
preprocessing = "conserving"
start = 2010-03-01
days = 2
step_seconds = 3600
co2_ppm = 400.0

[model]
id = "greenlight-lettuce-1.0.0"

[initial_state]
kind = "young_lettuce"
air_temperature = { value = 15.0, unit = "degC" }

[scenario]
family = "test/Lettuce"
years = [2010, 2011, 2012]
start_within_days = 14

[[scenario.parameters]]
name = "crop"
parameters = ["cAlpha", "cLar", "cGrMax", "cRespSht", "cEps", "sStm"]
half_width = 0.10
redraw = "episode"

[[scenario.start]]
name = "plants"
states = ["xN", "xS"]
half_width = 0.20

[observation]
modules = ["indoor_climate", "crop", "time", "controls", "weather"]
timing = "current"

[actuation]
kind = "rate"
max_change = 0.1
controls = ["uBoil", "uCo2", "uThScr", "uVent", "uLamp", "uBlScr"]

[constraints]
air_temperature = { low = 12.0, high = 24.0, unit = "degC" }
co2 = { low = 300.0, high = 1600.0, unit = "ppm" }
relative_humidity = { low = 50.0, high = 90.0, unit = "%" }

[ledger.revenue]
side = "earned"
stock = "heads"
price = { value = 0.40, unit = "EUR" }
label = "Heads"

[ledger.cost_heat]
side = "paid"
flow = "heat"
price = { value = 0.03, unit = "EUR kWh-1" }
label = "Heat"

[ledger.cost_electricity]
side = "paid"
flow = "electricity"
price = "electricity"
label = "Electricity"

[ledger.cost_co2]
side = "paid"
flow = "co2_dosed"
price = { value = 0.08, unit = "EUR kg-1" }
label = "CO2"

[price_tables.electricity]
unit = "EUR kWh-1"
hourly = [
    0.04, 0.04, 0.04, 0.04, 0.04, 0.04, 0.04, 0.08, 0.08, 0.08, 0.08, 0.08,
    0.08, 0.08, 0.08, 0.08, 0.08, 0.08, 0.08, 0.08, 0.08, 0.08, 0.08, 0.04,
]

[reward]
modules = ["epi", "scaled_penalty"]

[reward.penalty_scale]
air_temperature = { value = 750.0, unit = "degC" }
co2 = { value = 125000.0, unit = "ppm" }
relative_humidity = { value = 750.0, unit = "%" }

[evaluation]
first_seed = 10000
runs = 3
metric = "epi"

[evaluation.failed_step]
reward = -0.1
epi = { value = -0.1, unit = "EUR m-2" }
penalty = 3.0
"""
"""Another crop, other years and first days for each run, parameters and plants drawn once, a tariff, ranked by profit."""


def write_lettuce_task(folder: Path) -> Path:
    """The task ``LETTUCE`` as a file."""
    path = folder / "lettuce.toml"
    path.write_text(LETTUCE, encoding="utf-8")
    return path


@cache
def lettuce_task() -> TaskSpec:
    """The task ``LETTUCE``."""
    with tempfile.TemporaryDirectory() as folder:
        return get_task(write_lettuce_task(Path(folder)))


FEW = ("do_nothing", "ppo", "ppo_seed1", "ppo_seed2", "rule_based", "rule_based_fair")
"""Agents whose results ``checkout_with_few_results`` keeps."""


def checkout_with_few_results(folder: Path) -> Path:
    """A package folder beside the data of this checkout, but with the released results of few agents on two tasks alone."""
    (folder / "pyproject.toml").touch()
    for name in ("tasks", "baselines", "weather", "submissions"):
        (folder / name).symlink_to(data_folder(name), target_is_directory=True)
    released = data_folder("reports/released/results")
    for task in ("Schiphol2010-Delta10-v1", "Schiphol2010Code-Delta00-v1"):
        here = folder / "reports" / "released" / "results" / task
        here.mkdir(parents=True)
        for agent in FEW:
            for file in (released / task).glob(f"{agent}.*"):
                shutil.copy(file, here)
    return folder / "glbench"
