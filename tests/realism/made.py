"""A made archive in the form of the published one: a few days of smooth weather, two compartments."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from glbench.realism.published import DAY_ZERO, ROWS_A_DAY

FIRST = dt.date(2020, 2, 10)


@dataclass
class Made:
    """Tables of an archive, to be changed by a test and written in one of the two layouts."""

    days: int = 3
    first: dt.date = FIRST
    weather: pd.DataFrame = field(init=False)
    resources: dict[str, pd.DataFrame] = field(init=False)
    production: dict[str, pd.DataFrame] = field(init=False)
    quality: dict[str, pd.DataFrame] = field(init=False)
    climate: dict[str, pd.DataFrame] = field(init=False, default_factory=dict)
    crop: dict[str, pd.DataFrame] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        number = (self.first - DAY_ZERO).days
        rows = np.arange(self.days * ROWS_A_DAY + 1)
        hour = rows % ROWS_A_DAY / 12.0
        self.weather = pd.DataFrame(
            {
                "time": np.round(number + rows / ROWS_A_DAY, 5),
                "Iglob": np.round(np.maximum(400.0 * np.sin(np.pi * (hour - 8.0) / 10.0), 0.0), 1),
                "Tout": np.round(6.0 + 3.0 * np.sin(np.pi * (hour - 9.0) / 12.0), 2),
                "Rhout": 80.0,
                "Windsp": 4.0,
                "Pyrgeo": -50.0,
                "Rain": 0,
            }
        )
        days = number + np.arange(self.days)
        used = {"Heat_cons": 2.0, "ElecHigh": 1.2, "ElecLow": 0.5, "CO2_cons": 0.05, "Irr": 1.0}
        self.resources = {
            name: pd.DataFrame({"Time": days, **{key: value * factor for key, value in used.items()}})
            for name, factor in (("Anna", 1.0), ("Bert", 1.5))
        }
        self.production = {
            name: pd.DataFrame({"time": [days[0], days[-1]], "ProdA": [0.3, 0.4], "ProdB": [0.0, 0.1]}) for name in self.resources
        }
        self.quality = {
            name: pd.DataFrame({"time": [days[0], days[-1]], "Flavour": 70.0, "DMC_fruit": [8.0, 9.0]}) for name in self.resources
        }

    def indoors(self) -> pd.DataFrame:
        """A smooth indoor climate: air from 18 to 22 degC, lamps from 3 to 15 h, pipes at night, vents by day."""
        hour = np.arange(len(self.weather)) % ROWS_A_DAY / 12.0
        by_day, lit = (hour >= 8.0) & (hour < 18.0), (hour >= 3.0) & (hour < 15.0)
        wave = np.sin(np.pi * (hour - 9.0) / 12.0)
        return pd.DataFrame(
            {
                "time": self.weather["time"],
                "Tair": np.round(20.0 + 2.0 * wave, 2),
                "Rhair": np.round(75.0 - 10.0 * wave, 2),
                "CO2air": np.round(600.0 + 100.0 * wave, 1),
                "VentLee": np.where(by_day, 20.0, 0.0),
                "Ventwind": np.where(by_day, 10.0, 0.0),
                "EnScr": np.where(by_day, 0.0, 100.0),
                "BlackScr": np.where(lit & ~by_day, 96.0, 0.0),
                "AssimLight": np.where(lit, 100.0, 0.0),
                "PipeLow": np.where(by_day, 0.0, 45.0),
                "PipeGrow": 0.0,
                "co2_dos": np.where(by_day, 0.005, 0.0),
                "t_heat_vip": np.where(by_day, 20.0, 18.0),
                "int_red_vip": np.where(lit, 1000.0, np.nan),
                "int_blue_sp": 500.0,
            }
        )

    def sold(self, first: int = 1) -> None:
        """Measure what net profit needs: sugar content, and from day ``first`` on 3, at last 4 stems of 1.5 plants."""
        days = self.resources["Anna"]["Time"].to_numpy()
        for name in self.resources:
            self.quality[name]["TSS"] = np.linspace(8.0, 9.0, len(self.quality[name]))
            self.crop[name] = pd.DataFrame({"Time": [days[first], days[-1]], "stem_dens": [3.0, 4.0], "plant_dens": [1.5, np.nan]})

    def write(self, folder: Path) -> Path:
        """As in the folder of the README: a Parquet file, and files with the compartment's name in front."""
        folder.mkdir(exist_ok=True)
        self.weather.to_parquet(folder / "Weather.parquet")
        for name, tables in self._of_compartments().items():
            for kind, table in tables.items():
                _write(table, folder / f"{name}_{kind}.csv")
        return folder

    def write_as_published(self, folder: Path) -> Path:
        """As the archive itself: folders, and ``%`` before the first column."""
        (folder / "Weather").mkdir(parents=True)
        _write(self.weather, folder / "Weather" / "Weather.csv")
        for name, tables in self._of_compartments().items():
            (folder / name).mkdir()
            for kind, table in tables.items():
                _write(table, folder / name / f"{kind}.csv")
        return folder

    def _of_compartments(self) -> dict[str, dict[str, pd.DataFrame]]:
        return {
            name: {
                "Resources": self.resources[name],
                "Production": self.production[name],
                **({"GreenhouseClimate": self.climate[name]} if name in self.climate else {}),
                **({"TomQuality": self.quality[name]} if name in self.quality else {}),
                **({"CropParameters": self.crop[name]} if name in self.crop else {}),
            }
            for name in self.resources
        }


def own_export(made: Made, folder: Path) -> Path:
    """The same weather and indoor climate as a greenhouse's own export: a unit in each title, stamps on the local clock."""
    folder.mkdir(exist_ok=True)
    inside, outside = made.indoors(), made.weather
    stamps = pd.date_range(made.first, periods=len(inside), freq="5min", name="time")
    lit = inside["AssimLight"] > 0.0
    columns = {
        "air_temperature [degC]": inside["Tair"],
        "humidity [%]": inside["Rhair"],
        "co2 [ppm]": inside["CO2air"],
        "vents_lee [%]": inside["VentLee"],
        "vents_wind [%]": inside["Ventwind"],
        "thermal_screen [%]": inside["EnScr"],
        "rail_pipe [degC]": inside["PipeLow"],
        "lamps [W/m2]": np.where(lit, 81.0 + 25.3 + 0.5 * 7.27, 0.0),
        "co2_dose [kg/m2/h]": inside["co2_dos"],
    }
    pd.DataFrame({name: np.asarray(values) for name, values in columns.items()}, stamps).to_csv(folder / "indoor.csv")
    weather = {"global_radiation [W/m2]": "Iglob", "outdoor_temperature [degC]": "Tout", "outdoor_humidity [%]": "Rhout"}
    weather |= {"wind_speed [m/s]": "Windsp"}
    text: Any = pd.DataFrame({title: outside[name].to_numpy() for title, name in weather.items()}, stamps).to_csv()
    (folder / "weather.csv").write_text(f"# latitude: 52.0\n# longitude: 4.5\n{text}", encoding="utf-8")
    return folder


def _write(table: pd.DataFrame, path: Path) -> None:
    text: Any = table.to_csv(index=False, na_rep="NaN")
    path.write_text("%" + text, encoding="utf-8")
