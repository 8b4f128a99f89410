"""Short tasks with splits, generated seasons, sensors and forecasts that err."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from glbench.env.weather_pool import WeatherPool
from glbench.tasks import TaskSpec, get_task

SENSORS = """
[sensors]
dropouts = { days_between = 2.0, hours = 3.0 }
[sensors.air_temperature]
noise = { value = 0.3, unit = "degC" }
bias = { value = 0.3, unit = "degC" }
drift = { value = 0.6, unit = "degC" }
[sensors.co2]
noise = { value = 30.0, unit = "ppm" }
bias = { value = 30.0, unit = "ppm" }
drift = { value = 60.0, unit = "ppm" }
[sensors.relative_humidity]
noise = { value = 2.0, unit = "%" }
bias = { value = 2.0, unit = "%" }
drift = { value = 4.0, unit = "%" }
"""

SPLITS = """
[splits.training]
years = [2008, 2009, 2010]
seasons = 9
[splits.validation]
years = [2008, 2009, 2010]
seasons = 4
[splits.test]
years = [2011, 2012]
seasons = 7
"""

SCENARIO = """
[scenario]
family = "tests/Spring"
start_within_days = 28
generated = true
co2_range = { low = 390.0, high = 420.0, unit = "ppm" }
[[scenario.parameters]]
name = "crop"
parameters = ["sla", "rgFruit"]
half_width = 0.10
redraw = "episode"
"""

MODULES = '"indoor_climate", "crop", "time", "controls", "weather"'
HOURS = (1, 2, 3, 6, 12, 18, 24)


def forecast(error: str = "medium", hours: tuple[int, ...] = HOURS) -> str:
    """``[observation]`` with a forecast by the hour."""
    return f'[observation]\nmodules = [{MODULES}, "weather_forecast"]\n[observation.forecast]\nhours = {list(hours)}\nerror = "{error}"\n'


def spring_file(
    path: Path,
    *,
    name: str = "Spring",
    days: int = 3,
    start: str = "2010-02-15",
    weather: str = "",
    observation: str | None = None,
    sensors: str = SENSORS,
    splits: str = SPLITS,
    scenario: str = SCENARIO,
) -> Path:
    """Write such a task."""
    head = f'base = "glbench/Schiphol2010-Delta10-v1"\nschema = 2\nid = "tests/{name}-v1"\ntitle = "Of a test"\n'
    tables = f'[weather]\npreprocessing = "conserving"\ndays = {days}\nstart = {start}\nco2_ppm = 405.0\n{weather}\n'
    path.write_text("\n".join([head, tables, scenario, splits, sensors, forecast() if observation is None else observation]))
    return path


def spring(path: Path, **changes: object) -> TaskSpec:
    """The same, read."""
    return get_task(str(spring_file(path, **changes)))  # type: ignore[arg-type]


def everything(task: TaskSpec, number: int) -> bytes:
    """What belongs to a season: rows of weather, of its tables and of its forecast, and the first day."""
    pool = WeatherPool.of(task)
    first, row = (int(found[0]) for found in pool.starts([number]))
    rows = slice(row, row + pool.day * pool.days)
    tables = pool.tables
    every = len(pool.values) // max(len(tables.forecast), 1) if tables.forecast.size else 1
    parts: list[np.ndarray[Any, Any]] = [pool.values[rows], tables.measured[rows], tables.published[rows]]
    parts += [tables.forecast[rows.start // every : rows.stop // every]] if tables.forecast.size else []
    return b"".join([str(first).encode(), *(part.tobytes() for part in parts)])
