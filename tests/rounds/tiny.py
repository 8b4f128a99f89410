"""A task of one day with all that a salt decides: generated seasons, a crop, a start and sensors that are drawn, forecasts that err."""

from __future__ import annotations

from pathlib import Path

from glbench.tasks import TaskSpec, get_task

TINY = """
schema = 2
id = "test/Tiny-v1"
title = "A day of unseen weather"
description = "Of splits, sensors and forecasts, the smallest that there is."
suites = []

[weather]
source = "schiphol"
preprocessing = "conserving"
start = 2010-03-01
days = 1
step_seconds = 3600
co2_ppm = 405.0

[model]
id = "greenlight-tomato-1.0.0"

[initial_state]
kind = "mature_crop"
air_temperature = { value = 16.5, unit = "degC" }

[scenario]
family = "test/Tiny"
start_within_days = 20
generated = true

[splits.training]
years = [2008, 2009, 2010]
seasons = 8

[splits.test]
years = [2011, 2012]
seasons = 6

[[scenario.parameters]]
name = "crop"
parameters = ["sla", "rgFruit"]
half_width = 0.10
redraw = "episode"

[[scenario.start]]
name = "mass"
states = ["cFruit"]
half_width = 0.20

[sensors.air_temperature]
bias = { value = 6.0, unit = "degC" }

[observation]
modules = ["indoor_climate", "crop", "time", "controls", "weather", "weather_forecast"]
timing = "current"

[observation.forecast]
hours = [1, 6, 24]
error = "medium"

[actuation]
kind = "rate"
max_change = 0.5
controls = ["uBoil", "uCo2", "uThScr", "uVent", "uLamp", "uBlScr"]

[constraints]
air_temperature = { low = 15.0, high = 34.0, unit = "degC" }
co2 = { low = 300.0, high = 1600.0, unit = "ppm" }
relative_humidity = { low = 50.0, high = 85.0, unit = "%" }

[ledger.revenue]
side = "earned"
flow = "fruit_growth"
amount = "fruit_fresh"
unit = "kg m-2"
factor = 15.384615384615385e-6
price = { value = 1.6, unit = "EUR kg-1" }
label = "Fruit"

[ledger.cost_heat]
side = "paid"
flow = "heat"
price = { value = 0.09, unit = "EUR kWh-1" }

[reward]
modules = ["epi", "scaled_penalty"]

[reward.penalty_scale]
air_temperature = { value = 750.0, unit = "degC" }
co2 = { value = 125000.0, unit = "ppm" }
relative_humidity = { value = 750.0, unit = "%" }

[evaluation]
first_seed = 10000
runs = 6
metric = "reward"

[evaluation.failed_step]
reward = -0.1
epi = { value = -0.1, unit = "EUR m-2" }
penalty = 3.0
"""

REAL_YEARS = TINY.replace("Tiny", "Years").replace("generated = true\n", "").replace("seasons = 8\n", "").replace("seasons = 6\n", "")
"""The same with the seasons of the real years."""


def write_tiny(folder: Path, text: str = TINY) -> Path:
    """The task as a file ``tiny.toml`` in ``folder``."""
    path = folder / "tiny.toml"
    path.write_text(text, encoding="utf-8")
    return path


def tiny_task(folder: Path, text: str = TINY) -> TaskSpec:
    """The task itself."""
    return get_task(write_tiny(folder, text))
