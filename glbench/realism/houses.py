"""What is simulated: parameter sets of the model with the measured lamps, and the page of assumptions about compartments and growers.

``settings.toml`` is that page and explains each entry.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, model_validator

from glbench import settings
from glbench.agents.grower import Heating, HumidityDeficit, Screen, Ventilation
from glbench.errors import ArchiveError, UnknownNameError, did_you_mean, refuse
from glbench.model import COMPARTMENT, Model, get_model
from glbench.model.parameter_sets import Override
from glbench.tasks.fields import sorted_overrides
from glbench.weather.record import FloatArray

MODEL = "greenlight-tomato-harvest-1.0.0"  # The model with a meter on its harvest
LAMP_POWER, _COOLING, _PAR, _PHOTONS = "thetaLampMax", "etaLampCool", "etaLampPar", "zetaLampPar"
_LAMPS = "lamps"
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
            refuse("hps and led cannot both be 0")
        if self.high_from >= self.high_until:
            refuse(f"high_from = {self.high_from:g} must be below high_until = {self.high_until:g}")
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
    """The page in a TOML file. Raises ``ArchiveError`` when it cannot be read, lacks an entry, or has an unknown or impossible one."""
    advice = f"{SHIPPED} explains each entry. Copy it and change it."
    return settings.read_settings(Settings, path, "the settings", ArchiveError, toml=True, advice=advice)


@dataclass(frozen=True)
class House:
    """A parameter set of the model ``model`` and what is changed in it; name and description are as tables and pages call it.

    ``uncooled`` switches off the active cooling of its lamps. HPS and LED lamps of the sets ``mixed`` take the place of the set's own, by
    installed power. ``overrides`` are values by parameter name, in the units of the model's table.
    """

    name: str
    description: str
    parameters: str
    uncooled: bool = False
    mixed: tuple[str, str] | None = None
    model: str = MODEL
    overrides: Mapping[str, Override] = field(default_factory=dict)


HOUSES: Mapping[str, House] = MappingProxyType(
    {
        house.name: house
        for house in (
            House("paper", "the benchmark's compartment, LEDs with water cooling", "benchmark"),
            House("paper_uncooled", "the same without lamp cooling", "benchmark", uncooled=True),
            House("hps_2020", "the same compartment with HPS lamps", "hps_2020"),
            House("mixed_2020", "the same compartment with HPS lamps and uncooled LEDs", "led_2020", mixed=("hps_2020", "led_2020")),
            House("hps_2021", "modern 4 ha greenhouse, HPS lamps", "hps_2021"),
            House("led_2021", "modern 4 ha greenhouse, LEDs", "led_2021"),
            House("mixed_2021", "modern 4 ha greenhouse, HPS lamps and LEDs", "led_2021", mixed=("hps_2021", "led_2021")),
            House("bleiswijk_2020", "the growers' compartment, fitted to its season", "bleiswijk_2020", model=COMPARTMENT.id),
        )
    }
)
"""Those that are compared. The parameters of the last are fitted to one of the compartments; those of the others are published."""


class _ModelTable(settings.Table):
    id: str
    parameters: str
    overrides: Annotated[tuple[tuple[str, float, str], ...], BeforeValidator(sorted_overrides)] = ()


class _HousePage(settings.Table):
    name: str
    description: str
    model: _ModelTable
    identified: dict[str, Any] = Field(default_factory=dict)


def read_house(path: Path) -> House:
    """A house from a page in TOML: ``name``, ``description``, and ``[model]`` as in a task file. ``glbench identify`` writes such pages.

    Raises ``GlbenchError`` when the page cannot be read, or names a model, set, parameter or value that cannot be.
    """
    page = settings.read_settings(_HousePage, path, "the page of the house", ArchiveError, toml=True)
    overrides = {name: (value, unit) for name, value, unit in page.model.overrides}
    model(page.model.id).parameters.default(page.model.parameters, overrides)
    return House(page.name, page.description, page.model.parameters, model=page.model.id, overrides=overrides)


def choose_houses(names: tuple[str, ...]) -> tuple[House, ...]:
    """Houses of these names, in their order, or of pages (``read_house``) where a name ends in ``.toml``; all named ones for none.

    Raises ``UnknownNameError`` when there is no such house; the message names the nearest.
    """
    for name in names:
        if name not in HOUSES and not name.endswith(".toml"):
            refuse(f"There is no parameter set '{name}' to compare.{did_you_mean(name, HOUSES)}", UnknownNameError)
    houses = tuple(HOUSES.get(name) or read_house(Path(name)) for name in dict.fromkeys(names)) or tuple(HOUSES.values())
    if len({one.name for one in houses}) < len(houses):
        refuse(f"Two of these sets have the same name: {', '.join(one.name for one in houses)}. Rename one of them.", ArchiveError)
    return houses


def model(name: str = MODEL) -> Model:
    """The model that is simulated."""
    return get_model(name)


def parameters(house: House, settings: Settings) -> FloatArray:
    """Its parameters (parameters,): all lamps installed, fruit harvested beyond the settings' load.

    A house with both kinds of lamps has one that is their mean (``mix_lamps``).
    """
    values = model(house.model).parameters
    overrides: dict[str, Override] = {"cFruitMax": 1e3 * settings.plants.fruit_load}
    if house.mixed is not None:
        hps, led = (values.group(_LAMPS, name) for name in house.mixed)
        overrides |= mix_lamps(settings.lamps.hps / settings.lamps.power, hps, led)
    elif house.uncooled:
        overrides[_COOLING] = 0.0
    return values.default(house.parameters, overrides | {LAMP_POWER: settings.lamps.power, **house.overrides})


def mix_lamps(share: float, first: Mapping[str, float], second: Mapping[str, float]) -> dict[str, float]:
    """Properties of one lamp that stands for two kinds, of which the first has this ``share`` of the power [-].

    Every property is weighted by installed power, photons by the power of the PAR. There is no cooling.
    """
    mean = {name: share * first[name] + (1.0 - share) * second[name] for name in first}
    par = share * first[_PAR] / mean[_PAR]
    return mean | {_PHOTONS: par * first[_PHOTONS] + (1.0 - par) * second[_PHOTONS], _COOLING: 0.0}
