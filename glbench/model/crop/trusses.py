"""A tomato crop as growers know it: trusses of fruits in stages, dark hours, wet nights, and a crew that picks, prunes and tops.

It is the published crop (``VanthoorTomato``), with four additions. Fruits are counted and weighed in stages (``stages.py``). Long light
injures photosynthesis, and wet nights bring grey mould (``health.py``). A crew picks ripe fruit and old leaves when it is at work, prunes
trusses, and tops the crop. Photosynthesis, growth of leaves and stems, and respiration are those of the published crop.

The fruits of the stages change slowly, and *follow*: the kernel steps them after the other states, see ``Variable``.
Their rates read other states only through the rates of meters (``t_can24_sum``, ``sum_grow_fruit``, ...), which are states for this reason.
If a task draws the fruit at the start, ``c_fruit``, the fruits of the stages become lighter or heavier in proportion (``green_share``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, NamedTuple

from glbench.arrays import Floats
from glbench.model.balances import DAY
from glbench.model.bounds import COLDEST, HOTTEST, Horizon
from glbench.model.crop.allocation import Allocation, allocation
from glbench.model.crop.harvest import removal
from glbench.model.crop.health import CREW, HOUR, HealthParameters, Injury, Wetness, infection, injury_growth, light_on, rotting, wet_share
from glbench.model.crop.photosynthesis import Photosynthesis, photosynthesis
from glbench.model.crop.respiration import Respiration, maintenance_level, respiration
from glbench.model.crop.stages import (
    NO_FRUIT,
    STAGES,
    YOUNG_STAGES,
    FruitFlows,
    FruitSet,
    growth_curve,
    load_factor,
    set_by_carbohydrate,
    sink_strength,
    stage_rate,
    total,
)
from glbench.model.crop.temperature import GrowthInhibition, growth_inhibition
from glbench.model.crop.tomato import VanthoorTomato, net_uptake
from glbench.model.expressions import Expr, fmax, fmin, log, sigmoid
from glbench.model.greenhouse import record_of, typed_record
from glbench.model.greenlight import CANOPY_EXCESS
from glbench.model.model import ObservedColumn, Signal
from glbench.model.parameter_table import Parameter, declared_table, read_table
from glbench.model.parameters import TomatoParameters
from glbench.model.quantities import Quantity, Variable, states_of
from glbench.model.states import TomatoState
from glbench.model.submodels import CropStart
from glbench.model.surroundings import CropExchange, Surroundings

PICKING = 1 / (2 * HOUR)
"""Rate at which a crew at work picks ripe fruit [s-1]: all but a fiftieth in a shift of eight hours; chosen."""

WEEK = 7 * DAY
"""Seconds."""

SUPPLY_MEMORY = 2 * DAY
"""Time over which young fruits feel a shortage [s]; chosen: fruits abort in a dark week, not on a dark day."""

LIGHT_MEMORY = 2 * DAY
"""Time over which light is averaged for the photoperiod [s]; chosen: longer than a day, to smooth its swing."""

LEAST_LEAVES = 0.5
"""Share of the largest leaf area below which a crew never picks; chosen: far below a leaf area index of 1, photosynthesis has a pole."""

SOUND_LEAVES = 0.1
"""Share of the largest leaf area that mould never takes, and below whose double it takes fewer leaves; chosen, for that pole."""

ROUND_FLOWERS = 9.0 * (-1.708e-7 / 9 + 20.0 * (7.3125e-7 / 9))
"""New flowers of a stem at 20 °C with the default parameters, those of a round tomato [s-1]."""

HEAD_IN_BALANCE, HEAD_BY_SUPPLY, SUPPLY_IN_BALANCE = 10.0, 10.0, 0.5
"""Diameter of the head [mm] of a plant in balance, its rise [mm] for a supply of 1, and the supply of a plant in balance [-]; chosen."""


BEFORE_FLOWERING = 180.0
"""Temperature sum from planting to the first flowers [°C day]: nine days at 20 °C; chosen with six measured crops (docs/crop.md)."""


class CrewControls(NamedTuple):
    """Work by hand, 0 in a crop that is picked all day and never pruned or topped. A task schedules it, or gives it to an agent."""

    u_away: Annotated[Expr, Quantity("-", "crew away: picks neither fruit nor leaves")]
    u_prune: Annotated[Expr, Quantity("-", "share of the flowers of a truss that is pruned")]
    u_defoliate: Annotated[Expr, Quantity("-", "share by which picking lowers the largest leaf area, at most half")]
    u_top: Annotated[Expr, Quantity("-", "topped: no new trusses, leaves and stems stay as they are")]


class _Moving(NamedTuple):
    """States besides those of the published crop that are stepped with the climate."""

    t_can24_sum: Annotated[Expr, Variable("°C s", "24-hour mean of the canopy temperature, summed", scale=1e8, small=1e3)]
    sum_buf_org: Annotated[Expr, Variable("s", "supply of the growing organs relative to their demand, summed", scale=1e6, small=10.0)]
    sum_grow_fruit: Annotated[Expr, Variable("mg m-2", "carbohydrate that went to fruits after they were set", scale=1e5, small=100.0)]
    n_set: Annotated[Expr, Variable("m-2", "fruits set since the start", scale=100.0, small=0.1)]
    trusses: Annotated[Expr, Variable("-", "trusses of a stem since the start", scale=10.0, small=0.01)]
    sum_rot: Annotated[Expr, Variable("-", "loss to mould relative to the crop, summed since the start", scale=1.0, small=1e-3)]
    t_fruit: Annotated[Expr, Variable("°C", "temperature of the fruit")]
    c_ripe: Annotated[Expr, Variable("mg m-2", "carbohydrate in ripe fruit on the plants", scale=1e5, small=100.0)]
    n_ripe: Annotated[Expr, Variable("m-2", "ripe fruits on the plants", scale=10.0, small=0.01)]
    photoperiod: Annotated[Expr, Variable("-", "share of the day in light, averaged over two days", scale=1.0, small=1e-3)]
    injury: Annotated[Expr, Variable("-", "injury by long light, 1 = full", scale=1.0, small=1e-3)]
    wet_hours: Annotated[Expr, Variable("h", "wet hours in a row, fading when the crop is dry", scale=10.0, small=0.01)]
    mould: Annotated[Expr, Variable("-", "diseased share of the crop", scale=1.0, small=1e-3)]


def _follows(unit: str, meaning: str, scale: float) -> Any:
    return Annotated[Any, Variable(unit, meaning, scale=scale, small=1e-3 * scale, follower=True)]


_NUMBERS = tuple(f"n_fruit{stage}" for stage in range(1, STAGES + 1))
_MASSES = tuple(f"c_fruit{stage}" for stage in range(1, STAGES + 1))
_FOLLOWERS = {
    "source_sink": _follows("-", "supply of the growing organs relative to their demand, averaged over two days", 1.0),
    "c_week": _follows("mg m-2", "carbohydrate picked in the last week, fading", 1e5),
    **{name: _follows("m-2", f"fruits in stage {stage}", 10.0) for stage, name in enumerate(_NUMBERS, 1)},
    **{name: _follows("mg m-2", f"carbohydrate of the fruits in stage {stage}", 1e4) for stage, name in enumerate(_MASSES, 1)},
}
TrussState = record_of("TrussState", (TomatoState, _Moving, typed_record("Followers", _FOLLOWERS)))
"""State of the crop; also used for its time derivative."""


class _OwnParameters(NamedTuple):
    n_stem: Annotated[Expr, Parameter("m-2", "stems", 2.5, "Vanthoor (2011) table 9.1", "positive", sets=(("bleiswijk_2020", 4.0),))]
    n_truss: Annotated[Expr, Parameter("-", "flowers of a truss", 9.0, "de Koning (1994)", "positive", sets=(("bleiswijk_2020", 28.0),))]
    c_truss1: Annotated[
        Expr,
        Parameter(
            "s-1", "truss appearance at 0 °C", -1.708e-7 / 9, "Vanthoor (2011) table 9.1, of 9 flowers", sets=(("bleiswijk_2020", 5.94e-7),)
        ),
    ]
    c_truss2: Annotated[Expr, Parameter("s-1 K-1", "truss appearance per kelvin", 7.3125e-7 / 9, "Vanthoor (2011) table 9.1, of 9 flowers")]
    g_max: Annotated[
        Expr,
        Parameter(
            "mg", "largest carbohydrate of a fruit", 1e4, "Vanthoor (2011) table 9.1", "positive", sets=(("bleiswijk_2020", 1300.0),)
        ),
    ]
    t_set_hot: Annotated[Expr, Parameter("°C", "daily mean temperature above which heat costs fruit set", 25.0, "Peet et al. (1997)")]
    set_hot: Annotated[Expr, Parameter("K-1", "share of fruit set lost per kelvin above", 0.193, "Peet et al. (1997)", "nonnegative")]
    t_set_cold: Annotated[Expr, Parameter("°C", "daily mean temperature below which cold costs fruit set", 18.0, "Adams et al. (2001)")]
    set_cold: Annotated[Expr, Parameter("K-1", "share of fruit set lost per kelvin below", 0.1025, "Adams et al. (2001)", "nonnegative")]
    abort_max: Annotated[
        Expr, Parameter("-", "share of the young fruits that abort without supply", 0.67, "TOMGRO, Jones et al. (1991)", "fraction")
    ]
    abort_slope: Annotated[Expr, Parameter("-", "fall of that share with supply", 0.73, "TOMGRO, Jones et al. (1991)", "nonnegative")]
    dm_fruit: Annotated[
        Expr, Parameter("-", "dry matter of fresh fruit", 0.0627, "published code", "positive", sets=(("bleiswijk_2020", 0.09),))
    ]


TrussParameters = record_of("TrussParameters", (TomatoParameters, _OwnParameters, HealthParameters))
"""Parameters of the crop."""


class LeafFlows(NamedTuple):
    """Carbohydrate of leaves that leaves the greenhouse."""

    mc_leaf_har: Annotated[Expr, Quantity("mg m-2 s-1", "CH2O, leaves picked")]
    mc_leaf_rot: Annotated[Expr, Quantity("mg m-2 s-1", "CH2O, diseased leaves")]


class TrussFluxes(NamedTuple):
    """Everything that enters the balances of the crop."""

    photosynthesis: Photosynthesis
    inhibition: GrowthInhibition
    allocation: Allocation
    respiration: Respiration
    fruit_set: FruitSet
    fruit: FruitFlows
    leaves: LeafFlows
    injury: Injury
    wetness: Wetness
    crop: CropExchange


@dataclass(frozen=True)
class TrussTomato(VanthoorTomato):
    """Tomato with fruits in stages, dark hours, wet nights and a crew."""

    name: ClassVar[str] = "tomato_trusses"
    State: ClassVar[Any] = TrussState
    Controls: ClassVar[type[CrewControls]] = CrewControls
    Parameters: ClassVar[Any] = TrussParameters
    table = (*read_table(TomatoParameters), *declared_table(TrussParameters))
    parameters_after = None
    observation_modules: ClassVar[Mapping[str, str]] = {
        **VanthoorTomato.observation_modules,
        "registration": "what a crop registration has: trusses, fruits, the head of the plant, fruit picked in a week",
        "crop_health": "light a day, injury by long light, wet hours in a row, diseased share of the crop",
    }

    def processes(self, x: Any, s: Surroundings, p: Any) -> Any:
        """Vanthoor (2011); injury lowers photosynthesis, and the fruits on the plants share the flow to the fruit."""
        u: CrewControls = s.u
        light = s.light
        photons = p.par_jto_umol_sun * light.r_par_gh_sun + s.p.zeta_lamp_par * light.r_par_gh_lamp
        sound = 1 - p.injury_max * x.injury
        sugar = photosynthesis(s, x, p._replace(j25_leaf_max=p.j25_leaf_max * sound, alpha=p.alpha * sound), self.variant)
        inhibition = growth_inhibition(s.x.t_can, x, p)
        most = allocation(inhibition, x, p)
        fruit_set = self._fruit_set(most.mc_buf_fruit, x, u, p)
        wetness = self._wetness(x, s, p)
        fruit = self._fruit(most.mc_buf_fruit, fruit_set.mn_fruit_set, x, u, p)
        level = maintenance_level(x, p)
        growth = most._replace(
            mc_buf_leaf=self._topped(most.mc_buf_leaf, level * p.c_leaf_m * x.c_leaf, u),
            mc_buf_stem=self._topped(most.mc_buf_stem, level * p.c_stem_m * x.c_stem, u),
            mc_buf_fruit=fruit.mc_set_fruit + fruit.mc_grow_fruit,
        )
        respired = respiration(growth, x, p)
        largest = p.c_leaf_max * fmax(1 - u.u_defoliate, LEAST_LEAVES)
        return TrussFluxes(
            photosynthesis=sugar,
            inhibition=inhibition,
            allocation=growth,
            respiration=respired,
            fruit_set=fruit_set,
            fruit=fruit,
            leaves=LeafFlows(
                mc_leaf_har=(1 - u.u_away) * removal(x.c_leaf, largest, self.variant.leaf_pruning_rate, self.variant),
                mc_leaf_rot=rotting(x.mould, p) * fmin(x.c_leaf, 2 * fmax(x.c_leaf - SOUND_LEAVES * p.c_leaf_max, 0)),
            ),
            injury=Injury(light_on=light_on(photons), h_injury=sound),
            wetness=wetness,
            crop=net_uptake(sugar, respired, p),
        )

    def _fruit_set(self, supply: Expr, x: Any, u: CrewControls, p: Any) -> FruitSet:
        """Vanthoor (2011) eq. B.4; flowers fail in heat and cold, and are pruned."""
        heat = fmax(1 - p.set_hot * fmax(x.t_can24 - p.t_set_hot, 0), 0)
        cold = fmax(1 - p.set_cold * fmax(p.t_set_cold - x.t_can24, 0), 0)
        flowers = p.n_stem * p.n_truss * self._truss_appearance(x.t_can24, p) * (1 - u.u_top) * (1 - u.u_prune)
        return FruitSet(heat, cold, flowers * heat * cold * self._flowering(x) * set_by_carbohydrate(supply))

    @staticmethod
    def _flowering(x: Any) -> Expr:
        """0 before the first truss flowers, 1 after it."""
        return sigmoid(x.t_can_sum / 20)

    @staticmethod
    def _truss_appearance(t_can24: Expr, p: Any) -> Expr:
        """Trusses of a stem [s-1], after de Koning (1994)."""
        return fmax(p.c_truss1 + p.c_truss2 * t_can24, 0)

    @staticmethod
    def _topped(growth: Expr, respired: Expr, u: CrewControls) -> Expr:
        """Growth of an organ [mg m-2 s-1]: in a topped crop only what the organ respires, so that its mass stays."""
        return (1 - u.u_top) * growth + u.u_top * fmin(growth, respired)

    @staticmethod
    def _aborting(x: Any, p: Any) -> Expr:
        """Rate at which young fruits abort [s-1]: TOMGRO's share of those that pass the young stages at 20 °C, by the supply."""
        share = fmax(p.abort_max - p.abort_slope * x.source_sink, 0)
        return -log(1 - share) * (stage_rate(20.0) / YOUNG_STAGES)

    def _wetness(self, x: Any, s: Surroundings, p: Any) -> Wetness:
        leaves, fruits = wet_share(s.x.vp_air, s.x.t_can, p), wet_share(s.x.vp_air, x.t_fruit, p)
        return Wetness(leaves, fruits, 0.5 * (leaves + fruits))

    def _fruit(self, most: Expr, fruits_set: Expr, x: Any, u: CrewControls, p: Any) -> FruitFlows:
        """``most`` is Vanthoor's flow to the fruit [mg m-2 s-1]."""
        number, mass = [getattr(x, name) for name in _NUMBERS], [getattr(x, name) for name in _MASSES]
        load = sink_strength(number, growth_curve(20.0, p.g_max).growth) / (DAY * p.rg_fruit)
        first = growth_curve(x.t_can24, p.g_max).weight[0] * fruits_set
        green = (x.c_fruit - x.c_ripe) / (total(mass) + NO_FRUIT)
        return FruitFlows(
            green_share=green,
            sink_load=load,
            mc_set_fruit=first,
            mc_grow_fruit=load_factor(load) * (most - first),
            mc_fruit_ripe=green * (stage_rate(x.t_can24) * mass[-1]),
            mc_fruit_abort=green * (self._aborting(x, p) * total(mass[:YOUNG_STAGES])),
            mc_fruit_rot=rotting(x.mould, p) * x.c_fruit,
            mc_fruit_har=(1 - u.u_away) * (PICKING * x.c_ripe),
        )

    def rates(self, x: Any, s: Surroundings, fluxes: Any, p: Any) -> Any:
        ph, al, re, fs, fr, lf = (
            fluxes.photosynthesis,
            fluxes.allocation,
            fluxes.respiration,
            fluxes.fruit_set,
            fluxes.fruit,
            fluxes.leaves,
        )
        number, mass = [getattr(x, name) for name in _NUMBERS], [getattr(x, name) for name in _MASSES]
        respiring = maintenance_level(x, p) * p.c_fruit_m
        loss = rotting(x.mould, p)
        picking = (1 - s.u.u_away) * PICKING
        as_before = {
            "t_can24": (s.x.t_can - x.t_can24) / DAY,
            "c_buf": ph.mc_air_buf - al.mc_buf_fruit - al.mc_buf_leaf - al.mc_buf_stem - re.mc_buf_air,
            "c_leaf": al.mc_buf_leaf - re.mc_leaf_air - lf.mc_leaf_har - lf.mc_leaf_rot,
            "c_stem": al.mc_buf_stem - re.mc_stem_air,
            "c_fruit": al.mc_buf_fruit - re.mc_fruit_air - fr.mc_fruit_abort - fr.mc_fruit_rot - fr.mc_fruit_har,
            "t_can_sum": s.x.t_can / DAY,
        }
        wet = fluxes.wetness.wet_crop
        passing = stage_rate(x.t_can24)
        moving = {
            "t_can24_sum": x.t_can24,
            "sum_buf_org": al.h_buf_org,
            "sum_grow_fruit": fr.mc_grow_fruit,
            "n_set": fs.mn_fruit_set,
            "trusses": self._truss_appearance(x.t_can24, p) * self._flowering(x) * (1 - s.u.u_top),
            "sum_rot": loss,
            "t_fruit": (s.x.t_air - x.t_fruit) / p.tau_fruit,
            "c_ripe": fr.mc_fruit_ripe - (respiring + loss) * x.c_ripe - fr.mc_fruit_har,
            "photoperiod": (fluxes.injury.light_on - x.photoperiod) / LIGHT_MEMORY,
            "injury": injury_growth(x.photoperiod, p) * (1 - x.injury) - x.injury / (p.tau_recovery * DAY),
            "wet_hours": (wet - (1 - wet) * x.wet_hours / p.tau_dry) / HOUR,
            "mould": p.growth_mould / DAY * infection(x.wet_hours, x.t_can24, p) * (x.mould + p.arriving_mould) * (1 - x.mould) - loss,
            "n_ripe": passing * number[-1] - (picking + loss) * x.n_ripe,
        }
        followers = {"source_sink": (al.h_buf_org - x.source_sink) / SUPPLY_MEMORY, "c_week": fr.mc_fruit_har - x.c_week / WEEK}
        curve = growth_curve(x.t_can24, p.g_max)
        first = curve.weight[0] * fs.mn_fruit_set
        gain = fr.mc_grow_fruit / (sink_strength(number, curve.growth) + NO_FRUIT)
        aborting = self._aborting(x, p)
        inflow, inflow_mass = fs.mn_fruit_set, first
        for stage in range(STAGES):
            leaving = passing + loss + (aborting if stage < YOUNG_STAGES else 0)
            gain_of_stage = gain * (number[stage] * curve.growth[stage]) if stage else 0
            followers[_NUMBERS[stage]] = inflow - leaving * number[stage]
            followers[_MASSES[stage]] = inflow_mass + gain_of_stage - (leaving + respiring) * mass[stage]
            inflow, inflow_mass = passing * number[stage], passing * mass[stage]
        return TrussState(**as_before, **moving, **followers)

    def starts(self) -> Mapping[str, CropStart]:
        return {"mature_crop": _mature, "young_crop": _young}

    def signals(self) -> tuple[Signal, ...]:
        return (
            *super().signals(),
            Signal("crop/fruits", "Fruits on the plants", "m⁻²", "", of=_fruits),
            Signal("crop/fruits_set", "Fruits set since the start", "m⁻²", "nSet"),
            Signal("crop/picked_in_week", "Fruit picked in a week, fresh", "kg m⁻²", "", of=_picked_in_week),
            Signal("crop/ripe", "Ripe fruit on the plants, fresh", "kg m⁻²", "", of=_ripe),
            Signal("crop/supply", "Supply of growth relative to demand, 2 days", "%", "sourceSink", 100.0),
            Signal("crop/light_hours", "Hours of light a day", "h", "photoperiod", 24.0),
            Signal("crop/light_injury", "Photosynthesis lost to long light", "%", "", of=_injured),
            Signal("crop/wet_hours", "Wet hours in a row", "h", "wetHours"),
            Signal("crop/mould", "Diseased share of the crop", "%", "mould", 100.0),
        )

    def bounds(self, horizon: Horizon) -> Mapping[str, tuple[float, float]]:
        """Wide: they also hold in a house at 200 °C; see ``glbench.model.bounds``."""
        as_before = super().bounds(horizon)
        seconds, masses = 86400.0 * horizon.days + 1.0, as_before["cFruit"]
        p = horizon.parameters
        flowers = p["nStem"] * p["nTruss"] * (p["cTruss1"] + p["cTruss2"] * HOTTEST) * (seconds + 100.0 * DAY)
        by_name = {
            "tCanSum": (as_before["tCanSum"][0] - BEFORE_FLOWERING, as_before["tCanSum"][1]),
            "tCan24Sum": (COLDEST * seconds, HOTTEST * seconds),
            "sumBufOrg": (0.0, 1.01 * seconds),
            "sumGrowFruit": masses,
            "sumRot": (0.0, (1 + CREW) * seconds / DAY / p["tauMould"]),
            "tFruit": (COLDEST, HOTTEST),
            "trusses": (0.0, flowers / (p["nStem"] * p["nTruss"])),
            "wetHours": (0.0, seconds / HOUR),
        }
        by_unit = {"m-2": (-1.0, flowers), "mg m-2": masses, "-": (0.0, 1.01)}
        new = states_of(TrussState)[len(TomatoState._fields) :]
        return {**as_before, **by_name, **{state.name: by_name.get(state.name) or by_unit[state.unit] for state in new}}

    def observed(self, module: str, horizon: Horizon) -> tuple[ObservedColumn, ...] | None:
        bounds, p = self.bounds(horizon), horizon.parameters
        fruits, fresh = bounds["nSet"][1], bounds["cFruit"][1] * 1e-6 / p["dmFruit"]
        trusses = ObservedColumn("trusses", "-", "trusses of a stem since the start", "trusses", *bounds["trusses"])
        count = ObservedColumn("fruits", "m-2", "fruits on the plants", "", -1.0, STAGES * fruits, of=_fruits)
        per_truss = ObservedColumn(
            "fruits_per_truss", "-", "fruits on the trusses of the last days", "", -1.0, 10 * p["nTruss"], of=_fruits_per_truss
        )
        head = ObservedColumn(
            "head_diameter", "mm", "stem of the plant's head: thick when supply is plenty", "", 0.0, 20.0, of=_head_diameter
        )
        week = ObservedColumn("picked_in_week", "kg m-2", "fresh fruit picked in the last week", "", -0.1, fresh, of=_picked_in_week)
        ripe = ObservedColumn("ripe_fruit", "kg m-2", "fresh fruit that is ripe on the plants", "", -0.1, fresh, of=_ripe)
        light = ObservedColumn("light_hours", "h", "hours of light a day, averaged over two days", "photoperiod", 0.0, 24.5, 24.0)
        injury = ObservedColumn("light_injury", "-", "photosynthesis lost to long light", "", 0.0, 1.01, of=_injured)
        wet = ObservedColumn("wet_hours", "h", "wet hours in a row", "wetHours", *bounds["wetHours"])
        mould = ObservedColumn("mould", "-", "diseased share of the crop", "mould", 0.0, 1.01)
        own = {"registration": (trusses, count, per_truss, head, week, ripe), "crop_health": (light, injury, wet, mould)}
        return own.get(module) or super().observed(module, horizon)


def _fruits(x: Any, p: Any) -> Expr:
    return total([*(getattr(x, name) for name in _NUMBERS), x.n_ripe])


def _fruits_per_truss(x: Any, p: Any) -> Expr:
    """Young fruits over the trusses that appeared while they were set, at the mean temperature of the last day."""
    inflow = TrussTomato._truss_appearance(x.t_can24, p) * p.n_stem * YOUNG_STAGES / stage_rate(x.t_can24)
    return total([getattr(x, name) for name in _NUMBERS[:YOUNG_STAGES]]) / (inflow + 1e-3)


def _head_diameter(x: Any, p: Any) -> Expr:
    """[mm]: 10 in balance, a millimetre more for each 0.1 more supply; chosen, after growers' guides."""
    return HEAD_IN_BALANCE + HEAD_BY_SUPPLY * (x.source_sink - SUPPLY_IN_BALANCE)


def _picked_in_week(x: Any, p: Any) -> Expr:
    return 1e-6 * x.c_week / p.dm_fruit


def _ripe(x: Any, p: Any) -> Expr:
    return 1e-6 * x.c_ripe / p.dm_fruit


def _injured(x: Any, p: Any) -> Expr:
    return p.injury_max * x.injury


def _start(air_temperature: float, p: Any, leaf: float, stem: float, age: float, number: Expr, mass: list[Expr]) -> Any:
    fruit = dict(zip((*_NUMBERS, *_MASSES), (*(number for _ in _NUMBERS), *mass), strict=True))
    rest = dict.fromkeys(TrussState._fields, 0.0) | {
        "t_can24": air_temperature + CANOPY_EXCESS,
        "c_leaf": leaf,
        "c_stem": stem,
        "c_fruit": total(mass),
        "t_can_sum": age,
        "t_fruit": air_temperature,
        "photoperiod": 0.5,
        "source_sink": 0.5,
    }
    return TrussState(**(rest | fruit))


def _mature(air_temperature: float, p: Any) -> Any:
    before = VanthoorTomato().starts()["mature_crop"](air_temperature, p)
    appear = TrussTomato._truss_appearance(20.0, p) * p.n_stem * p.n_truss * 0.8
    weight = growth_curve(20.0, p.g_max).weight
    number = float(appear / stage_rate(20.0))
    return _start(air_temperature, p, before.c_leaf, before.c_stem, before.t_can_sum, number, [0.5 * number * float(w) for w in weight])


def _young(air_temperature: float, p: Any) -> Any:
    before = VanthoorTomato().starts()["young_crop"](air_temperature, p)
    return _start(air_temperature, p, before.c_leaf, before.c_stem, -BEFORE_FLOWERING, 0.0, [0.0] * STAGES)


def row_of(columns: Mapping[str, Floats], parameters: Mapping[str, float]) -> tuple[Floats, Floats, Floats] | None:
    """Leaf area index [m2 m-2], fruits on the plants and ripe ones [m-2] by the columns of a record; None without a crop of trusses.

    They are those of a round tomato in that state: where stems have more flowers, one drawn fruit stands for several.
    """
    if not {"cLeaf", "fruits", "nRipe"} <= columns.keys():
        return None
    share = ROUND_FLOWERS / (parameters["nTruss"] * (parameters["cTruss1"] + 20.0 * parameters["cTruss2"]))
    return parameters["sla"] * columns["cLeaf"], share * columns["fruits"], share * columns["nRipe"]
