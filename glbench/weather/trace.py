"""Weather in samples of five minutes that another package carries, and the preprocessing ``sampled``, which takes the nearest sample.

The trace ``bleiswijk_2014`` is that of the lettuce benchmark in the package lettuce-greenhouse-gym, measured at a research greenhouse in
Bleiswijk: Kempkes, Janse and Hemming (2014), Greenhouse concept with high insulating double glass with coatings and new climate control
strategies, Acta Horticulturae 1037, 83-92. It is read where the extra ``lettuce-classic`` installed it, and nothing else of that package
is used. Its terms of use are not known to glbench, which therefore carries no copy.

The file counts seconds from midnight of 10 January 2014. Days have 288 samples in a row, as published results count them: the clock is that
of winter. The radiation shows that samples from 30 March to 26 October are stamped in summer time: the sun is an hour late there.
"""

from __future__ import annotations

import hashlib
import io
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType

import numpy as np

from glbench.errors import WeatherError, refuse
from glbench.extras import missing, require
from glbench.weather import preprocessing
from glbench.weather.record import QUANTITIES, RAW_SECONDS, REQUIRED, SLOT_SECONDS, FloatArray, Place, WeatherRecord

VERSION = 1
TRACE = "bleiswijk_2014"
"""Name of the trace."""
PACKAGE = "lettuce_greenhouse_gym"
FILE = "data/outdoorWeatherWurGlas2014.csv"
FILE_DIGEST = "38c7c121c76ac2c430c7b16bb37aa2bb19adf35c8092ddd5cb5298cd00514f56"
"""SHA-256 [hex] of the file."""
_BEGIN = 1389308400  # 10 January 2014, 00:00 at UTC+1
_RADIATION_FLOOR = 1e-6  # W m-2; less is noise of the sensor at night
_COLUMNS = ("global_radiation", "air_temperature", "relative_humidity", "wind_speed")  # of the file after the time; then CO2 [ppm]


@dataclass(frozen=True, eq=False, kw_only=True)
class WeatherTrace(WeatherRecord):
    """A record whose hourly figures are means of samples, which it has as well. It says nothing about the sky."""

    samples: FloatArray
    """Global radiation [W m-2], temperature [degC], relative humidity [%], wind speed [m s-1] and CO2 [ppm], ``(rows, 5)``."""


def lacks_package(name: str) -> bool:
    """Whether the weather ``name`` comes with a package that is not installed."""
    return name == TRACE and bool(missing(PACKAGE))


def load_trace() -> WeatherTrace:
    """The trace, from the package that carries it.

    Raises ``GlbenchError`` when the package is not installed, with what to install, and ``WeatherError`` when its file is another one.
    """
    require(f"The weather '{TRACE}'", "lettuce-classic", PACKAGE)
    spec = find_spec(PACKAGE)  # finds the package without importing it
    assert spec is not None
    return _read(Path((spec.submodule_search_locations or [""])[0]) / FILE)


@lru_cache(maxsize=1)
def _read(path: Path) -> WeatherTrace:
    try:
        content = path.read_bytes()
    except OSError as error:
        refuse(f"Cannot read the weather '{TRACE}': {error}. Install lettuce-greenhouse-gym 0.1.3 again.", WeatherError, error)
    digest = hashlib.sha256(content).hexdigest()
    if digest != FILE_DIGEST:
        msg = f"{path} is not the file of the weather '{TRACE}' (SHA-256 {digest[:12]}...). Install lettuce-greenhouse-gym 0.1.3."
        raise WeatherError(msg)
    samples = np.loadtxt(io.BytesIO(content), delimiter=",")[:, 1:]
    an_hour = SLOT_SECONDS // RAW_SECONDS
    hourly = samples[: len(samples) // an_hour * an_hour].reshape(-1, an_hour, samples.shape[1]).mean(axis=1)
    counts = {name: np.rint(hourly[:, _COLUMNS.index(name)] * QUANTITIES[name].counts_per_unit).astype(np.int64) for name in REQUIRED}
    for array in (samples, *counts.values()):
        array.setflags(write=False)
    return WeatherTrace(
        name=TRACE,
        place=Place("Bleiswijk", 52.03, 4.53, -4.0, "Etc/GMT-1"),
        source="Kempkes, Janse and Hemming (2014), Acta Horticulturae 1037, 83-92; file of lettuce-greenhouse-gym 0.1.3",
        licence="not stated by the package that carries it",
        begin=_BEGIN,
        counts=MappingProxyType(counts),
        timing=MappingProxyType(dict.fromkeys(REQUIRED, "mean")),
        samples=samples,
    )


def prepare(record: WeatherTrace, window: preprocessing.Window) -> preprocessing.Prepared:
    """Disturbances of ``window``: row k is the sample nearest to the start of step k. What the trace does not have is 0."""
    index = np.rint((window.times - record.begin) / RAW_SECONDS).astype(np.int64)
    radiation, temperature, humidity, wind, co2 = record.samples[index].T
    values = np.zeros((window.steps, len(preprocessing.COLUMNS)))
    values[:, 0] = np.where(radiation < _RADIATION_FLOOR, 0.0, radiation)
    values[:, 1] = temperature
    values[:, 2] = preprocessing.vapour_pressure(temperature, humidity)
    values[:, 3] = preprocessing.co2_density(temperature, co2)
    values[:, 4] = wind
    hours = (np.array([window.start, window.end + SLOT_SECONDS - 1]) - record.begin) // SLOT_SECONDS
    return preprocessing.Prepared(values, int(hours[0]), int(hours[1]))
