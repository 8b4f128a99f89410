"""The page of what is assumed about compartments, plants and their grower: ``settings.toml``, which explains each entry."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field, model_validator

from glbench import settings
from glbench.agents.grower import Heating, HumidityDeficit, Screen, Ventilation
from glbench.errors import ArchiveError

SHIPPED = Path(__file__).with_name("settings.toml")

_Positive = Annotated[float, Field(gt=0.0)]
_NotNegative = Annotated[float, Field(ge=0.0)]
_Hour = Annotated[float, Field(ge=0.0, le=24.0)]
_Share = Annotated[float, Field(ge=0.0, le=1.0)]


class Place(settings.Table):
    """Clock of the archive (IANA zone) and CO2 outside [ppm]."""

    clock: str
    co2: float = Field(ge=100.0, le=2000.0)


class Lamps(settings.Table):
    """Installed electric power [W m-2], hours of the high tariff [h], and the radiation [W m-2] below which lamps burn first."""

    hps: _NotNegative
    led: _NotNegative
    high_from: _Hour
    high_until: _Hour
    radiation_limit: _NotNegative

    @model_validator(mode="after")
    def _can_burn(self) -> Lamps:
        if self.power <= 0.0:
            msg = "hps and led cannot both be 0"
            raise ValueError(msg)
        if self.high_from >= self.high_until:
            msg = f"high_from = {self.high_from:g} must be below high_until = {self.high_until:g}"
            raise ValueError(msg)
        return self

    @property
    def power(self) -> float:
        """Both kinds of lamps together [W m-2]."""
        return self.hps + self.led


class Plants(settings.Table):
    """Dry mass when planted [g m-2] and its shares, the fruit load that is kept [g m-2], and the fruit's dry matter content [kg kg-1]."""

    dry_mass: _Positive
    leaves: _Share
    stems: _Share
    fruit: _Share
    fruit_load: _Positive
    dry_matter: float = Field(gt=0.0, le=1.0)


class Periods(settings.Table):
    """Radiation below which it is dark without lamps [W m-2], and length of the pre-night [h]."""

    dark_below: _NotNegative
    pre_night: float = Field(ge=0.0, le=24.0)


class Settings(settings.Table):
    """The page, one table a heading."""

    place: Place
    lamps: Lamps
    plants: Plants
    periods: Periods
    heating: Heating
    ventilation: Ventilation
    humidity_deficit: HumidityDeficit
    screen: Screen


def read_settings(path: Path = SHIPPED) -> Settings:
    """Read the page from a TOML file.

    Raises
    ------
    ArchiveError
        When the file cannot be read, lacks an entry, or has an unknown or impossible one.
    """
    advice = f"{SHIPPED} explains each entry. Copy it and change it."
    return settings.read_settings(Settings, path, "the settings", ArchiveError, toml=True, advice=advice)
