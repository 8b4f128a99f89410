"""Set points, bands and limits of the rule-based controllers, read from a YAML file.

The file is the whole truth: there are no defaults here, so that what a controller does can be read in one place.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from glbench.settings import read_settings

_Hour = Annotated[float, Field(ge=0.0, le=24.0)]
_Radiation = Annotated[float, Field(ge=0.0)]

_BANDS = (
    "lamp_heat_band",
    "heating_band",
    "co2_band",
    "vent_heat_band",
    "vent_humidity_band",
    "vent_cold_band",
    "screen_cold_band",
    "screen_humidity_band",
    "blackout_humidity_band",
)


class RuleSettings(BaseModel):
    """Numbers of the rules; ``baselines/rule_based/rule_based.yml`` explains each, with its name in the publication.

    Temperatures [degC], temperature differences [K], humidity [%], CO2 [ppm], hours [h], days [day], radiation [W m-2],
    radiation sums [MJ m-2 d-1].
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    lamps_on: _Hour
    lamps_off: _Hour
    lamp_season_start: float
    lamp_season_end: float
    lamps_off_radiation: _Radiation
    lamps_off_day_sum: _Radiation
    lamp_extra_heat: float
    lamp_heat_band: float
    heating_day: float
    heating_night: float
    heating_lamp_shift: float
    heating_dead_zone: float
    heating_band: float
    co2_day: float
    co2_band: float
    humidity_limit: float
    vent_heat_band: float
    vent_humidity_band: float
    vent_cold_offset: float
    vent_cold_band: float
    screen_day: float
    screen_night: float
    screen_cold_band: float
    screen_dead_zone: float
    screen_humidity_offset: float
    screen_humidity_band: float
    blackout_screen: bool
    blackout_extra_humidity: float
    blackout_humidity_band: float
    thermal_screen_rule: Literal["code", "author"]
    """When the thermal screen opens: "code", when heat and humidity both ask for it; "author", when either does."""
    lamp_rule: Literal["code", "author"]
    """When humidity may switch lamps off: "code", at any hour; "author", only while the blackout screen is closed."""

    @field_validator(*_BANDS)
    @classmethod
    def _has_width(cls, band: float) -> float:
        if band == 0.0:
            msg = "a proportional band of width 0 would be a division by zero; a narrow one such as 0.1 acts like a switch"
            raise ValueError(msg)
        return band


def read_rule_settings(path: Path) -> RuleSettings:
    """Read settings from the YAML file ``path``.

    Raises
    ------
    SubmissionError
        When the file is missing, is no YAML mapping, lacks a setting, or has an unknown or impossible one.
    """
    return read_settings(RuleSettings, path, "the rule settings")
