"""Weather: hourly records of real places, and the disturbances that the greenhouse feels.

Example
-------
>>> import datetime as dt
>>> from glbench.weather import disturbances, load_weather
>>> spring = disturbances(load_weather("schiphol"), start=dt.date(2010, 3, 1), steps=96)
>>> spring.values.shape
(96, 10)
"""

from typing import TYPE_CHECKING

from glbench.extras import lazy_names
from glbench.weather.generator import Blocks, GeneratedSeason, SeasonGenerator
from glbench.weather.knmi import fetch_knmi
from glbench.weather.preprocessing import COLUMNS
from glbench.weather.record import QUANTITIES, Place, WeatherInfo, WeatherRecord
from glbench.weather.series import PREPROCESSINGS, Disturbances, disturbances
from glbench.weather.store import find_weather, list_weather, load_weather, save_weather, user_file

if TYPE_CHECKING:
    from glbench.weather.column_map import ColumnMap, guess_column_map, read_columns, read_csv, write_column_map
    from glbench.weather.readers import FORMATS, read_weather
else:
    __getattr__ = lazy_names(__name__)

__all__ = [
    "COLUMNS", "FORMATS", "PREPROCESSINGS", "QUANTITIES", "Blocks", "ColumnMap", "Disturbances", "GeneratedSeason", "Place",
    "SeasonGenerator", "WeatherInfo", "WeatherRecord", "disturbances", "fetch_knmi", "find_weather", "guess_column_map", "list_weather",
    "load_weather", "read_columns", "read_csv", "read_weather", "save_weather", "user_file", "write_column_map",
]  # fmt: skip
