"""The parameter sets that are set against the measurements: the paper's and the model author's, with the measured lamps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from glbench.errors import UnknownNameError, did_you_mean
from glbench.model import Model, get_model
from glbench.realism.settings import Settings
from glbench.weather.record import FloatArray

MODEL = "greenlight-tomato-harvest-1.0.0"
"""The model with a meter on its harvest."""
_LAMP_POWER, _COOLING, _PAR, _PHOTONS = "thetaLampMax", "etaLampCool", "etaLampPar", "zetaLampPar"
_LAMPS = "lamps"


@dataclass(frozen=True)
class House:
    """A parameter set and what is changed in it.

    Attributes
    ----------
    name, description
        As tables and pages call it.
    parameters
        Named set of the model.
    uncooled
        Whether the active cooling of its lamps is switched off.
    mixed
        Sets whose HPS and LED lamps take the place of the set's own, mixed by installed power; ``None`` for its own lamps.
    """

    name: str
    description: str
    parameters: str
    uncooled: bool = False
    mixed: tuple[str, str] | None = None


HOUSES: Mapping[str, House] = MappingProxyType(
    {
        house.name: house
        for house in (
            House("paper", "the benchmark's compartment, LEDs with water cooling", "benchmark"),
            House("paper_uncooled", "the same without lamp cooling", "benchmark", uncooled=True),
            House("hps_2020", "the same compartment with HPS lamps", "hps_2020"),
            House(
                "mixed_2020",
                "the same compartment with HPS lamps and uncooled LEDs",
                "led_2020",
                mixed=("hps_2020", "led_2020"),
            ),
            House("hps_2021", "modern 4 ha greenhouse, HPS lamps", "hps_2021"),
            House("led_2021", "modern 4 ha greenhouse, LEDs", "led_2021"),
            House(
                "mixed_2021", "modern 4 ha greenhouse, HPS lamps and LEDs", "led_2021", mixed=("hps_2021", "led_2021")
            ),
        )
    }
)
"""Those that are compared. No parameter is fitted."""


def choose_houses(names: tuple[str, ...]) -> tuple[House, ...]:
    """Houses of these names, in their order; all of them for none.

    Raises
    ------
    UnknownNameError
        When there is no such house; the message names the nearest.
    """
    for name in names:
        if name not in HOUSES:
            msg = f"There is no parameter set '{name}' to compare.{did_you_mean(name, HOUSES)}"
            raise UnknownNameError(msg)
    return tuple(HOUSES[name] for name in dict.fromkeys(names)) or tuple(HOUSES.values())


def model() -> Model:
    """The model that is simulated."""
    return get_model(MODEL)


def parameters(house: House, settings: Settings) -> FloatArray:
    """Its parameters (parameters,): all lamps installed, fruit harvested beyond the settings' load.

    A house with both kinds of lamps has one that is the mean: every property weighted by installed power, photons by the power of the
    PAR, no cooling.
    """
    values = model().parameters
    overrides: dict[str, float] = {"cFruitMax": 1e3 * settings.plants.fruit_load}
    if house.mixed is not None:
        hps, led = (values.group(_LAMPS, name) for name in house.mixed)
        share = settings.lamps.hps / settings.lamps.power
        overrides |= {name: share * hps[name] + (1.0 - share) * led[name] for name in hps}
        par = share * hps[_PAR] / overrides[_PAR]
        overrides |= {_PHOTONS: par * hps[_PHOTONS] + (1.0 - par) * led[_PHOTONS], _COOLING: 0.0}
    elif house.uncooled:
        overrides[_COOLING] = 0.0
    return values.default(house.parameters, overrides | {_LAMP_POWER: settings.lamps.power})
