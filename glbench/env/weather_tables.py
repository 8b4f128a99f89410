"""What an observation shows of weather and clock, computed once for all rows of a task and looked up in every step."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glbench.env.climate import read_air
from glbench.env.scenario import CLOCK, WeatherPool
from glbench.weather import COLUMNS

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec

HOURS_A_DAY = 24.0
DAYS_A_YEAR = 365.0

_RADIATION, _TEMPERATURE, _PRESSURE, _CO2, _WIND = (
    COLUMNS.index(name) for name in ("iGlob", "tOut", "vpOut", "co2Out", "wind")
)


@dataclass(frozen=True, eq=False)
class WeatherTables:
    """Weather and clock by row of the pool (``WeatherPool``), read-only float32 as observed.

    ``measured``: global radiation [W m-2], temperature [degC], relative humidity [%], CO2 [ppm], wind [m s-1].
    ``published``: the same with vapour pressure [Pa] and CO2 density [mg m-3].
    ``clock``: sine and cosine of the hour of day, then of the day of year.
    """

    measured: NDArray[np.float32]
    published: NDArray[np.float32]
    clock: NDArray[np.float32]

    @staticmethod
    def of(task: TaskSpec) -> WeatherTables:
        """Tables of a task, shared by all its environments in this process."""
        return _tables(task)


@lru_cache(maxsize=16)
def _tables(task: TaskSpec) -> WeatherTables:
    pool = WeatherPool.of(task)
    rows = pool.values
    air = read_air(rows[:, _TEMPERATURE], rows[:, _CO2], rows[:, _PRESSURE])
    measured = np.stack([rows[:, _RADIATION], air[0], air[2], air[1], rows[:, _WIND]], axis=1)
    published = rows[:, [_RADIATION, _TEMPERATURE, _PRESSURE, _CO2, _WIND]]
    clock = [
        (*_turn(hour / HOURS_A_DAY), *_turn(day / DAYS_A_YEAR)) for hour, day in pool.calendar[:, : len(CLOCK)].tolist()
    ]
    return WeatherTables(_frozen(measured), _frozen(published), _frozen(np.array(clock)))


def _turn(share: float) -> tuple[float, float]:
    """Sine and cosine of a share of a full turn, by the C library like everything else that is observed."""
    angle = 2.0 * math.pi * share
    return math.sin(angle), math.cos(angle)


def _frozen(values: NDArray[np.float64]) -> NDArray[np.float32]:
    table = np.ascontiguousarray(values, dtype=np.float32)
    table.flags.writeable = False
    return table
