"""The tomato crop of Vanthoor (2011), chapter 9, as corrected in Katzin (2020, 2021)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from glbench.model.balances import DAY
from glbench.model.bounds import COLDEST, HOTTEST, Horizon
from glbench.model.crop.allocation import Allocation, allocation
from glbench.model.crop.harvest import Harvest, harvest
from glbench.model.crop.photosynthesis import Photosynthesis, photosynthesis
from glbench.model.crop.respiration import Respiration, respiration
from glbench.model.crop.temperature import GrowthInhibition, growth_inhibition
from glbench.model.derived import derived_tomato
from glbench.model.expressions import Expr
from glbench.model.greenlight import CANOPY_EXCESS
from glbench.model.model import Flow, ObservedColumn, Signal, Stock
from glbench.model.parameter_checks import Order
from glbench.model.parameter_table import BENCHMARK, read_table
from glbench.model.parameters import TomatoParameters
from glbench.model.quantities import states_of
from glbench.model.states import TomatoState
from glbench.model.submodels import Crop, CropStart
from glbench.model.surroundings import CropExchange, Surroundings
from glbench.model.variants import AUTHOR, Variant
from glbench.quantities import FLOWS

LEAVES = 95283.0
"""Leaf carbohydrates of the mature crop [mg m-2]: a leaf area index of 2.53."""

STEMS = 251070.0
"""Stem carbohydrates of the mature crop [mg m-2]."""

FRUIT = 55338.0
"""Fruit carbohydrates of the mature crop [mg m-2]."""

TEMPERATURE_SUM = 3097.8
"""Temperature sum of the mature crop [°C day], far beyond the start of fruit growth."""

YOUNG_LEAF_AREA = 1.0
"""Leaf area index of a crop that has just been planted; chosen: 2.5 plants m-2 with 0.4 m2 of leaves each, about to flower.

Much below 1 the CO2 compensation point of a cold canopy is negative by Vanthoor (2011), eq. 9.23, and photosynthesis has a pole.
"""

YOUNG_STEMS = 0.36
"""Carbohydrates in stems and roots of a young crop, as a share of those in its leaves: 25 to 70, as GreenLight starts a crop."""

_OLD_CROP_SUM = 4000.0  # degC day; above every temperature sum an episode can start with
# Growth at three times the rate at 20 degC, with every crop parameter at its most favourable:
_FASTEST_FRUIT_GROWTH = 0.25  # kg m-2 a day; 0.328 mg m-2 s-1 is 0.028 kg m-2 a day, times 2^3 for the best parameters
_FRUIT_AT_START = 1.0  # kg m-2
_BELOW_ZERO = 0.01  # kg m-2; a mass that is used up may undershoot zero by the tolerance of the integration
_KG_PER_MG, _GRAM_PER_MG = 1e-6, 1e-3


class TomatoFluxes(NamedTuple):
    """Everything that the balances of the tomato crop are made of, one record a process."""

    photosynthesis: Photosynthesis
    inhibition: GrowthInhibition
    allocation: Allocation
    respiration: Respiration
    harvest: Harvest
    crop: CropExchange


def net_uptake(ph: Photosynthesis, re: Respiration, p: TomatoParameters) -> CropExchange:
    """CO2 taken from the main air: photosynthesis less all respiration, as CO2 instead of CH2O. Vanthoor (2011) eq. 9.1."""
    return CropExchange(p.m_co2 / p.m_ch2o * (ph.mc_air_buf - re.mc_buf_air - re.mc_org_air))


@dataclass(frozen=True)
class VanthoorTomato(Crop):
    """Carbohydrates in buffer, leaves, stems and fruit, the day's mean temperature and the temperature sum."""

    variant: Variant = AUTHOR

    name: ClassVar[str] = "tomato"
    State: ClassVar[type[TomatoState]] = TomatoState
    Parameters: ClassVar[type[TomatoParameters]] = TomatoParameters
    table = read_table(TomatoParameters)
    orders = (
        Order("tCan24Min", "tCan24Max", "growth needs a range of temperatures"),
        Order("tCanMin", "tCanMax", "growth needs a range of temperatures"),
    )
    parameters_after: ClassVar[str | None] = "energyContentGas"
    observation_modules: ClassVar[Mapping[str, str]] = {
        "crop": "fruit dry mass, 24-hour mean canopy temperature, temperature sum",
        "published_crop": "as crop, mean temperature first and fruit in mg m-2",
    }

    def leaf_area_index(self, x: TomatoState, p: TomatoParameters) -> Expr:
        """Vanthoor (2011) eq. 9.5."""
        return p.sla * x.c_leaf

    def processes(self, x: TomatoState, s: Surroundings, p: TomatoParameters) -> TomatoFluxes:
        sugar = photosynthesis(s, x, p, self.variant)
        inhibition = growth_inhibition(s.x.t_can, x, p)
        growth = allocation(inhibition, x, p)
        respired = respiration(growth, x, p)
        return TomatoFluxes(
            photosynthesis=sugar,
            inhibition=inhibition,
            allocation=growth,
            respiration=respired,
            harvest=harvest(x, p, self.variant),
            crop=net_uptake(sugar, respired, p),
        )

    def rates(self, x: TomatoState, s: Surroundings, fluxes: TomatoFluxes, p: TomatoParameters) -> TomatoState:
        """Vanthoor (2011) eqs 9.9, 9.1, 9.4, 9.6, 9.2 (Katzin 2021, eq. 7.43) and 9.8."""
        ph, al, re, ha = fluxes.photosynthesis, fluxes.allocation, fluxes.respiration, fluxes.harvest
        return TomatoState(
            t_can24=(s.x.t_can - x.t_can24) / DAY,
            c_buf=ph.mc_air_buf - al.mc_buf_fruit - al.mc_buf_leaf - al.mc_buf_stem - re.mc_buf_air,
            c_leaf=al.mc_buf_leaf - re.mc_leaf_air - ha.mc_leaf_har,
            c_stem=al.mc_buf_stem - re.mc_stem_air,
            c_fruit=al.mc_buf_fruit - re.mc_fruit_air - ha.mc_fruit_har,
            t_can_sum=s.x.t_can / DAY,
        )

    def derived(self, p: TomatoParameters) -> TomatoParameters:
        return derived_tomato(p)

    def starts(self) -> Mapping[str, CropStart]:
        return {"mature_crop": _mature, "young_crop": _young}

    def flows(self) -> tuple[Flow, ...]:
        return (
            Flow(
                "fruit_growth",
                "mg m-2",
                "carbohydrate gained by the fruit, harvest taken off",
                FLOWS["fruit_growth"].label,
                lambda step: step.after.c_fruit - step.before.c_fruit,
                lambda step: step.parameters.rg_fruit * step.seconds,
            ),
        )

    def stocks(self) -> tuple[Stock, ...]:
        return (Stock("fruit", "mg m-2", "carbohydrate in the fruit on the plants", "Fruit on the plants", lambda x, p: x.c_fruit),)

    def signals(self) -> tuple[Signal, ...]:
        return (
            Signal("crop/fruit", "Carbohydrates in the fruit", "g m⁻²", "cFruit", _GRAM_PER_MG),
            Signal("crop/leaves", "Carbohydrates in the leaves", "g m⁻²", "cLeaf", _GRAM_PER_MG),
            Signal("crop/stems", "Carbohydrates in stems and roots", "g m⁻²", "cStem", _GRAM_PER_MG),
            Signal("crop/buffer", "Carbohydrate buffer", "g m⁻²", "cBuf", _GRAM_PER_MG),
            Signal("crop/canopy_temperature_24h", "Canopy temperature, 24 h mean", "°C", "tCan24"),
        )

    def bounds(self, horizon: Horizon) -> Mapping[str, tuple[float, float]]:
        summed = (COLDEST * horizon.days, _OLD_CROP_SUM + HOTTEST * horizon.days)
        # Buffer and organs; in long darkness the buffer falls below zero by less than 2000 mg m-2.
        masses = (-_BELOW_ZERO * 1e6, _heaviest(horizon) * 1e6)
        by_unit = {"°C": (COLDEST, HOTTEST), "mg m-2": masses, "°C day": summed}
        return {state.name: by_unit[state.unit] for state in states_of(TomatoState)}

    def observed(self, module: str, horizon: Horizon) -> tuple[ObservedColumn, ...] | None:
        heaviest = _heaviest(horizon)
        low, high = self.bounds(horizon)["tCanSum"]
        words = "dry mass of the fruit on the plants"
        fruit = ObservedColumn("fruit_dry_mass", "kg m-2", words, "cFruit", -_BELOW_ZERO, heaviest, _KG_PER_MG)
        milligrams = ObservedColumn("fruit_carbohydrate", "mg m-2", words, "cFruit", -_BELOW_ZERO * 1e6, heaviest * 1e6)
        mean = ObservedColumn("canopy_temperature_24h", "degC", "24-hour low-pass of the canopy temperature", "tCan24", COLDEST, HOTTEST)
        summed = ObservedColumn("temperature_sum", "degC day", "temperature sum of the canopy since planting", "tCanSum", low, high)
        return {"crop": (fruit, mean, summed), "published_crop": (mean, milligrams, summed)}.get(module)


def _mature(air_temperature: float, p: TomatoParameters) -> TomatoState:
    """A bearing crop with a leaf area index of 2.5: of a cultivar with another specific leaf area the same index, not the same mass."""
    nominal = next(info for info in VanthoorTomato.table if info.name == "sla").values[BENCHMARK]
    return TomatoState(
        t_can24=air_temperature + CANOPY_EXCESS,
        c_buf=0.0,
        c_leaf=LEAVES * float(nominal / p.sla),
        c_stem=STEMS,
        c_fruit=FRUIT,
        t_can_sum=TEMPERATURE_SUM,
    )


def _young(air_temperature: float, p: TomatoParameters) -> TomatoState:
    """Plants as a nursery delivers them, none of them in fruit."""
    return TomatoState(
        t_can24=air_temperature + CANOPY_EXCESS,
        c_buf=0.0,
        c_leaf=YOUNG_LEAF_AREA / p.sla,
        c_stem=YOUNG_STEMS * (YOUNG_LEAF_AREA / p.sla),
        c_fruit=0.0,
        t_can_sum=0.0,
    )


def _heaviest(horizon: Horizon) -> float:
    """Dry mass that no fruit load exceeds [kg m-2]."""
    return _FRUIT_AT_START + _FASTEST_FRUIT_GROWTH * horizon.days
