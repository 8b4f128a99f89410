"""What a season earned by the accounting of the archive's organisers, from measured days or from simulated ones.

``prices.toml`` is their page of prices. Net profit is the fruit of both classes minus electricity at two tariffs, heat, CO2 in two steps,
labour by stem and day, and plants. All of it is per square metre as the archive's files count it; they do not say whether that is a
compartment's 96 m2 or the 62.5 m2 that are grown.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from glbench import settings
from glbench.errors import ArchiveError
from glbench.realism.published import Archive, Compartment
from glbench.weather.record import FloatArray

PRICES = Path(__file__).with_name("prices.toml")

_Price = Annotated[float, Field(ge=0.0)]
_Brix = Annotated[float, Field(gt=0.0, le=30.0)]
_Day = Annotated[str, Field(pattern=r"^(0[1-9]|1[0-2])-(0[1-9]|[12]\d|3[01])$")]


class Prices(settings.Table):
    """The page: units as in ``prices.toml``, which explains each entry."""

    electricity_high: _Price
    electricity_low: _Price
    heat: _Price
    co2: _Price
    co2_until: _Price
    co2_beyond: _Price
    labour: _Price
    plant: _Price
    class_b: Annotated[float, Field(ge=0.0, le=1.0)]
    sweet: _Brix
    plain: _Brix
    fruit: dict[_Day, tuple[_Price, _Price]] = Field(min_length=1)

    def of_fruit(self, dates: NDArray[np.datetime64], brix: FloatArray | float) -> FloatArray:
        """Price of class A on ``dates`` (days,) at ``brix`` [EUR kg-1] (days,); before the year's first price its last one holds."""
        days = sorted(self.fruit)
        rows = np.searchsorted(days, [str(date)[5:] for date in dates], side="right") - 1
        sweet, plain = np.array([self.fruit[day] for day in days])[rows].T
        return np.asarray(plain + (brix - self.plain) / (self.sweet - self.plain) * (sweet - plain))


def read_prices(path: Path = PRICES) -> Prices:
    """Read a page of prices from a TOML file; an ``ArchiveError`` says what is wrong with it."""
    advice = f"{PRICES} explains each entry. Copy it and change it."
    return settings.read_settings(Prices, path, "the prices", ArchiveError, toml=True, advice=advice)


class Account(settings.Table):
    """A season's money [EUR m-2] and amounts [kg m-2, kWh m-2, MJ m-2, kg m-2].

    ``house`` is ``None`` where it was measured. ``fruit_ratio``: measured over simulated fruit of the growers' season in the house, if any.
    """

    name: str
    house: str | None = None
    fruit_ratio: float | None = None
    fruit: float
    electricity: float
    heat: float
    co2: float
    income: float
    cost_electricity: float
    cost_heat: float
    cost_co2: float
    labour: float
    plants: float

    def net(self, fruit_ratio: float = 1.0) -> float:
        """Net profit with ``fruit_ratio`` times the income [EUR m-2]."""
        return fruit_ratio * self.income - self.cost_electricity - self.cost_heat - self.cost_co2 - self.labour - self.plants


def settle(prices: Prices, **values: Any) -> Account:
    """An account of which heat and CO2 are still to be paid; ``values`` are its other fields."""
    beyond = max(values["co2"] - prices.co2_until, 0.0)
    cost_co2 = prices.co2 * (values["co2"] - beyond) + prices.co2_beyond * beyond
    return Account(cost_heat=prices.heat * values["heat"], cost_co2=cost_co2, **values)


def account_of(archive: Archive, one: Compartment, prices: Prices) -> Account:
    """The account of a compartment as measured; an ``ArchiveError`` names what was not measured."""
    if one.class_b is None or one.brix is None or one.stems is None or one.plants is None:
        msg = f"{one.name}: net profit needs TSS in TomQuality.csv, and stem_dens and plant_dens in CropParameters.csv. Add them."
        raise ArchiveError(msg)
    high, low, full = float(one.high.sum()), float(one.low.sum()), one.harvest - (1.0 - prices.class_b) * one.class_b
    return settle(
        prices, name=one.name, fruit=float(one.harvest.sum()), electricity=high + low, heat=float(one.heat.sum()), co2=float(one.co2.sum()),
        income=float((prices.of_fruit(archive.dates, one.brix) * full).sum()), labour=prices.labour * float(one.stems.sum()),
        plants=prices.plant * float(one.plants[0]), cost_electricity=prices.electricity_high * high + prices.electricity_low * low,
    )  # fmt: skip
