"""The page on which a grower describes a greenhouse: numbers with the units that they are known in.

``page.toml`` is the empty page and explains each entry. Every number is a text with its unit, ``"5 ha"`` or ``"5 MW"``, so that kW and W,
or kg/h and kg/ha/h, cannot be confused.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, model_validator

from glbench import settings
from glbench.errors import TaskError, refuse
from glbench.greenhouse.draft import PIPE_WALL, SCREEN_BELOW_GUTTER, SPAN, Draft, Supply
from glbench.model.units import same_unit
from glbench.untrusted import decimal_point, quoted

EMPTY_PAGE = Path(__file__).with_name("page.toml")
_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([A-Za-zµμ°%].*)?")
_MG_S = 1e6 / 3600.0  # A kilogram an hour [mg s-1]
_M2_HA = 1e4


def _amount(text: Any, units: Mapping[str, float], example: str) -> tuple[float, str]:
    """A number in the unit that the factors lead to, and its own unit as ``units`` spells it."""
    if not isinstance(text, str):
        refuse(f"{quoted(text)} has no unit. Write number and unit in quotes, such as {example}; units: {', '.join(units)}")
    advice = decimal_point(text)
    number = _NUMBER.fullmatch(text.strip())
    if advice or number is None:
        advice = advice or f"write number and unit, such as {example}"
        refuse(f"{quoted(text)}: {advice}. The decimal sign is a point, and thousands have no sign")
    unit = next((name for name in units if same_unit(name, number[2] or "")), None)
    if unit is None:
        refuse(f"{quoted(text)}: {quoted(number[2] or '')} is no unit that fits here. Write one of {', '.join(units)}, such as {example}")
    return float(number[1]) * units[unit], unit


def _quantity(units: Mapping[str, float], example: str, lowest: float = 0.0, highest: float = 1e12) -> Any:
    """A field for a text with number and unit; its value is in the first of ``units``."""

    def read(text: Any) -> float:
        value, unit = _amount(text, units, example)
        if not lowest <= value <= highest:
            refuse(f"{quoted(text)}: it must be from {lowest / units[unit]:,.10g} to {highest / units[unit]:,.10g} {unit}")
        return value

    return BeforeValidator(read)


def _supply(whole: Mapping[str, float], of_floor: Mapping[str, float], example: str) -> Any:
    """A field for what is installed, of the whole greenhouse or of each square metre."""

    def read(text: Any) -> Supply:
        value, unit = _amount(text, {**whole, **of_floor}, example)
        if not 0.0 <= value <= 1e12:
            refuse(f"{quoted(text)}: it cannot be below 0")
        return Supply(value, unit in of_floor, text)

    return BeforeValidator(read)


_Area = Annotated[float, _quantity({"m2": 1.0, "ha": _M2_HA}, '"5 ha"', 1.0, 1e7)]
_Length = Annotated[float, _quantity({"m": 1.0, "cm": 0.01, "mm": 0.001}, '"6.5 m"', 0.001, 5000.0)]
_Slope = Annotated[float, _quantity({"deg": 1.0}, '"22 deg"', 1.0, 80.0)]
_Percent = Annotated[float, _quantity({"%": 0.01}, '"80 %"', 0.0, 1.0)]
_PipeLength = Annotated[float, _quantity({"m/m2": 1.0}, '"1.25 m/m2"', 0.01, 30.0)]
_Light = Annotated[float, _quantity({"umol/m2/s": 1.0}, '"200 umol/m2/s"', 0.0, 2500.0)]
_PER_FLOOR = {"W/m2": 1.0, "kW/ha": 1e3 / _M2_HA, "MW/ha": 1e6 / _M2_HA}
_Power = Annotated[Supply, _supply({"MW": 1e6, "kW": 1e3, "W": 1.0}, _PER_FLOOR, '"5 MW" or "100 W/m2"')]
_DOSING_PER_FLOOR = {"kg/ha/h": _MG_S / _M2_HA, "g/m2/h": _MG_S / 1e3, "mg/m2/s": 1.0}
_Dosing = Annotated[Supply, _supply({"kg/h": _MG_S}, _DOSING_PER_FLOOR, '"230 kg/ha/h" or "1150 kg/h"')]


class House(settings.Table):
    """Floor [m2], length [m], heights [m], slope of the roof [deg], and the light that the roof lets through [-]."""

    floor_area: _Area
    length: _Length | None = None
    gutter_height: _Length | None = None
    ridge_height: _Length | None = None
    roof_slope: _Slope | None = None
    roof_light: _Percent | None = None

    @model_validator(mode="after")
    def _can_stand(self) -> House:
        if self.gutter_height is not None and self.ridge_height is not None and self.ridge_height <= self.gutter_height:
            refuse(f"ridge_height {self.ridge_height:g} m must be above gutter_height {self.gutter_height:g} m")
        if self.length is not None and self.length > self.floor_area:
            refuse(f"length {self.length:g} m is too long for {self.floor_area:,g} m2")
        return self

    def fill(self, draft: Draft) -> None:
        """Floor, cover, heights and glass."""
        book, floor = draft.book, self.floor_area
        draft.add("aFlr", floor, "floor_area")
        slope = draft.value_or(self.roof_slope, book["psi"], "roof_slope", "deg")
        draft.add("psi", slope, "roof_slope")
        gutter = draft.value_or(self.gutter_height, book["hAir"] + SCREEN_BELOW_GUTTER, "gutter_height", "m")
        rise = 0.5 * SPAN * math.tan(math.radians(slope))
        ridge = draft.value_or(self.ridge_height, gutter + rise, "ridge_height", "m", f"spans of {SPAN:g} m with this slope")
        length = draft.value_or(self.length, math.sqrt(floor), "length", "m", "a square floor")
        width = floor / length
        walls, gables = 2.0 * (length + width) * gutter, min(length, width) * (ridge - gutter)
        roof = floor / math.cos(math.radians(slope))
        draft.add("aCov", roof + walls + gables, f"roof {roof:,.0f} m2 (floor / cos slope), walls and gables {walls + gables:,.0f} m2")
        draft.add("hAir", gutter - SCREEN_BELOW_GUTTER, f"gutter height minus {SCREEN_BELOW_GUTTER:g} m: below the screens")
        draft.add("hGh", 0.5 * (gutter + ridge), "mean of gutter and ridge height")
        light = draft.value_or(self.roof_light, book["tauRfPar"], "roof_light", "%")
        if self.roof_light is not None:
            draft.add_layer("Rf", light, "roof_light, for PAR and near-infrared alike")


class Heating(settings.Table):
    """The boiler's heat, and the rail pipes: outer diameter [m], length for each square metre [m m-2]."""

    boiler: _Power | None = None
    pipe_diameter: _Length | None = None
    pipe_length: _PipeLength | None = None

    def fill(self, draft: Draft) -> None:
        """Boiler and rail pipes."""
        book = draft.book
        draft.add_supply("pBoil", self.boiler, "boiler", 1.0, "W/m2")
        diameter = draft.value_or(self.pipe_diameter, book["phiPipeE"], "pipe_diameter", "m")
        draft.add("phiPipeE", diameter, "pipe_diameter")
        if self.pipe_diameter is not None:
            draft.add("phiPipeI", diameter - 2.0 * PIPE_WALL, f"pipe_diameter minus two walls of {1e3 * PIPE_WALL:g} mm")
        draft.add("lPipe", draft.value_or(self.pipe_length, book["lPipe"], "pipe_length", "m/m2"), "pipe_length")


class Dosing(settings.Table):
    """CO2 supply."""

    supply: _Dosing | None = None

    def fill(self, draft: Draft) -> None:
        """The supply."""
        draft.add_supply("phiExtCo2", self.supply, "supply", 3.6, "g/m2/h")


class Lamps(settings.Table):
    """Light at the crop [umol m-2 s-1] and electric power."""

    light: _Light | None = None
    power: _Power | None = None


class BlackoutScreen(settings.Table):
    """Light that the closed screen lets through [-]."""

    name: ClassVar = "blackout_screen"
    layer: ClassVar = "BlScr"
    light: _Percent | None = None

    def fill(self, draft: Draft) -> None:
        """The light."""
        entry = f"{self.name}.light"
        light = draft.value_or(self.light, draft.book[f"tau{self.layer}Par"], entry, "%")
        if self.light is not None:
            draft.add_layer(self.layer, light, f"{entry}, for PAR and near-infrared alike")


class EnergyScreen(BlackoutScreen):
    """Light that the closed screen lets through [-], and heat that it saves [-], which ``design`` finds by computing."""

    name: ClassVar = "energy_screen"
    layer: ClassVar = "ThScr"
    saving: _Percent | None = None


class Vents(settings.Table):
    """Open area of the roof vents as a share of the floor [-], and the height of one opening [m]."""

    roof_area: _Percent | None = None
    opening_height: _Length | None = None

    def fill(self, draft: Draft) -> None:
        """Roof vents; the model has no side vents that move."""
        book = draft.book
        share = draft.value_or(self.roof_area, book["aRoof"] / book["aFlr"], "roof_area", "% of the floor")
        draft.add("aRoof", share * draft.floor, f"{100 * share:.4g} % of the floor")
        draft.add("hVent", draft.value_or(self.opening_height, book["hVent"], "opening_height", "m"), "opening_height")


class Season(settings.Table):
    """Record and years of the weather, and the hours [h] and radiation [W m-2] of the lamps."""

    weather: str | None = None
    years: tuple[int, ...] = ()
    lamps_from: float = Field(default=0.0, ge=0.0, le=24.0, json_schema_extra={"unit": "h"})
    lamps_until: float = Field(default=18.0, ge=0.0, le=24.0, json_schema_extra={"unit": "h"})
    lamps_radiation: float = Field(default=250.0, ge=0.0, le=1000.0, json_schema_extra={"unit": "W m-2"})


class Page(settings.Table):
    """The page, one table a heading. A table of equipment that is missing means that the house has none."""

    title: str = Field(default="A greenhouse of my own", min_length=1, max_length=120)
    base: str = "glbench/GreenhouseReal-v1"
    book: Literal["benchmark", "hps_2020", "led_2020", "hps_2021", "led_2021"] = "led_2021"
    house: House
    heating: Heating = Heating()
    co2: Dosing | None = None
    hps_lamps: Lamps | None = None
    led_lamps: Lamps | None = None
    energy_screen: EnergyScreen | None = None
    blackout_screen: BlackoutScreen | None = None
    vents: Vents = Vents()
    season: Season = Season()


def read_page(file: Path) -> Page:
    """The page in a TOML file.

    Raises ``TaskError`` when it cannot be read, lacks the floor area, or has an unknown or impossible entry, with its value and units.
    """
    advice = "The page that `glbench greenhouse new` writes explains each entry."
    return settings.read_settings(Page, file, "the greenhouse page", TaskError, toml=True, advice=advice)
