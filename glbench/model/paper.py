"""The greenhouse of the benchmark's paper, and the models that tasks can name.

``greenlight-tomato-1.0.0`` is the GreenLight greenhouse with its tomato crop: 28 states, 6 controls, 10 disturbances, 208
parameters. ``greenlight-tomato-harvest-1.0.0`` also has a meter on the harvest, ``greenlight-tomato-harvest-energy-1.0.0`` an
engine and a hot-water buffer besides, ``greenlight-tomato-harvest-heat-pump-1.0.0`` a cooler, a heat pump and two buffers instead;
``greenlight-lettuce-1.0.0`` has lettuce as its crop, ``greenlight-lettuce-2-1.0.0`` sells it by weight class,
``greenlight-lettuce-harvest-1.0.0`` cuts it when it is told to, and ``greenlight-tomato-compartment-1.0.0`` is a measured compartment.
``lettuce-classic-1.0.0`` is van Henten's greenhouse with four states (``lettuce_classic``).
``greenlight-tomato-2-1.0.0`` has a crop with trusses in stages, and four more whose ids begin with ``greenlight-tomato-2`` have it, too.
``STATES``, ``rhs`` and the other names and functions here are those of the first; code that serves any model asks the model.
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points

import casadi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from glbench.errors import UnknownNameError, did_you_mean, refuse
from glbench.model.compartment import MassAndNeighbours, RisingVents, ToppedTomato
from glbench.model.crop.butterhead import Butterhead
from glbench.model.crop.harvested import HarvestedButterhead
from glbench.model.crop.lettuce import VanHentenLettuce
from glbench.model.crop.tomato import VanthoorTomato
from glbench.model.crop.trusses import TrussTomato
from glbench.model.energy import DUMPED, PIPE_HEAT, ChpBoilerBuffer
from glbench.model.greenhouse import Greenhouse, Meter, compose
from glbench.model.greenlight import GreenLightClimate
from glbench.model.heat_harvesting import HARVEST_METERS, HeatHarvesting
from glbench.model.lettuce_classic import ClassicLettuce
from glbench.model.model import Evaluation, Model, Symbolic
from glbench.model.parameter_sets import Override
from glbench.model.parameter_table import BENCHMARK
from glbench.model.variants import AUTHOR, VARIANTS, Variant, get_variant

Array = NDArray[np.float64]


@cache
def tomato(variant: str = "author") -> Greenhouse:
    """The tomato greenhouse in one of the two readings of its equations. Raises ``UnknownNameError`` when there is no such variant."""
    reading = get_variant(variant)
    return compose(GreenLightClimate(reading), VanthoorTomato(reading))


HARVEST = Meter(
    "mc_fruit_har", "fruit_harvested", "mg m-2", "carbohydrate of the fruit harvested", "Fruit harvested", scale=1e5, small=100.0
)
"""The harvest of a control step: what is picked can be paid when it is picked."""


CO2_DOSED = Meter("mc_ext_air", "co2_metered", "mg m-2", "CO2 dosed, metered since the start", "CO₂", scale=1e6, small=1e3)
"""The CO2 dosed: what has flowed since the start can decide what more of it costs."""


@cache
def tomato_harvest(variant: str = "author") -> Greenhouse:
    """``greenlight-tomato-harvest-1.0.0``: with a meter on its harvest. Raises ``UnknownNameError`` when there is no such variant."""
    reading = get_variant(variant)
    return compose(GreenLightClimate(reading), VanthoorTomato(reading), meters=(HARVEST,), name="greenlight-tomato-harvest")


TOMATO = tomato()
"""The model author's own equations: the model of the paper."""

LETTUCE = compose(GreenLightClimate(), VanHentenLettuce())
"""The same greenhouse with lettuce in it."""

BUTTERHEAD = compose(GreenLightClimate(), Butterhead(), name="greenlight-lettuce-2")
"""That lettuce, sold by weight class and weighed in samples."""

HARVESTED_BUTTERHEAD = compose(GreenLightClimate(), HarvestedButterhead(), name="greenlight-lettuce-harvest")
"""The same lettuce, cut on a day that an agent chooses, and planted again."""

TOMATO_SEASON = compose(GreenLightClimate(), VanthoorTomato(), meters=(HARVEST, CO2_DOSED), name="greenlight-tomato-season")
"""The tomato greenhouse with meters on harvest and CO2."""

TOMATO_ENERGY = compose(
    GreenLightClimate(), VanthoorTomato(), ChpBoilerBuffer(), meters=(HARVEST, PIPE_HEAT, DUMPED), name="greenlight-tomato-harvest-energy"
)
"""The tomato greenhouse with boiler, engine and hot-water buffer, and meters on harvest, heat to the pipes and heat dumped."""

TOMATO_HEAT_PUMP = compose(
    GreenLightClimate(), VanthoorTomato(), HeatHarvesting(), meters=(HARVEST, *HARVEST_METERS), name="greenlight-tomato-harvest-heat-pump"
)
"""The tomato greenhouse with boiler, cooler, heat pump, cold and hot buffer, and meters on harvest, heat pump and harvested heat."""

COMPARTMENT = compose(RisingVents(), ToppedTomato(), MassAndNeighbours(), meters=(HARVEST, CO2_DOSED), name="greenlight-tomato-compartment")
"""A compartment as it was measured: with a mass that stores heat, neighbours, vents that open higher and a crop that is topped."""

TOMATO_2 = compose(GreenLightClimate(), TrussTomato(), meters=(HARVEST, CO2_DOSED), name="greenlight-tomato-2")
"""The greenhouse with a crop as growers know it: trusses in stages, dark hours, wet nights, a crew."""

TOMATO_2_COMPARTMENT = compose(
    RisingVents(), TrussTomato(), MassAndNeighbours(), meters=(HARVEST, CO2_DOSED), name="greenlight-tomato-2-compartment"
)
"""That crop in a compartment as it was measured."""

_METERS = (HARVEST, PIPE_HEAT, DUMPED, CO2_DOSED)

TOMATO_2_ENERGY = compose(GreenLightClimate(), TrussTomato(), ChpBoilerBuffer(), meters=_METERS, name="greenlight-tomato-2-energy")
"""That crop with boiler, engine and hot-water buffer."""

TOMATO_2_COMPARTMENT_ENERGY = compose(
    RisingVents(), TrussTomato(), MassAndNeighbours(), ChpBoilerBuffer(), meters=_METERS, name="greenlight-tomato-2-compartment-energy"
)
"""The same in a compartment as it was measured."""

TOMATO_2_HEAT_PUMP = compose(
    GreenLightClimate(), TrussTomato(), HeatHarvesting(), meters=(HARVEST, *HARVEST_METERS, CO2_DOSED), name="greenlight-tomato-2-heat-pump"
)
"""That crop with boiler, cooler, heat pump, cold and hot buffer."""

LETTUCE_CLASSIC = ClassicLettuce()
"""Van Henten's greenhouse of four states, with the step by which it is published: a map."""

STATES, CONTROLS, DISTURBANCES, PARAMETERS = TOMATO.states, TOMATO.controls, TOMATO.disturbances, TOMATO.table
STATE_NAMES, CONTROL_NAMES = TOMATO.state_names, TOMATO.control_names
DISTURBANCE_NAMES, PARAMETER_NAMES = TOMATO.disturbance_names, TOMATO.parameter_names
AUXILIARIES = TOMATO.auxiliaries
MODEL_VERSION = TOMATO.version
State, Controls, Disturbances, Parameters = TOMATO.State, TOMATO.Controls, TOMATO.Disturbances, TOMATO.Parameters


def greenlight(x: State, u: Controls, d: Disturbances, p: Parameters, variant: Variant = AUTHOR) -> Evaluation:  # type: ignore[valid-type]
    """Evaluate the model for floats, NumPy arrays (one entry a row) or CasADi symbols."""
    return compose(GreenLightClimate(variant), VanthoorTomato(variant)).equations(x, u, d, p)


def build_rhs(variant: str = "author", symbolic: Symbolic = "SX") -> casadi.Function:
    """See :meth:`Model.rhs_function`."""
    return tomato(variant).rhs_function(symbolic)


def rhs(x: ArrayLike, u: ArrayLike, d: ArrayLike, p: ArrayLike, variant: str = "author") -> Array:
    """Time derivative of the state, see :meth:`Model.rhs`."""
    return tomato(variant).rhs(x, u, d, p)


def auxiliaries(x: ArrayLike, u: ArrayLike, d: ArrayLike, p: ArrayLike, variant: str = "author") -> dict[str, Array]:
    """Every quantity computed on the way, see :meth:`Model.auxiliary_values`."""
    return tomato(variant).auxiliary_values(x, u, d, p)


def jacobian(x: ArrayLike, u: ArrayLike, d: ArrayLike, p: ArrayLike, wrt: str = "x", variant: str = "author") -> Array:
    """Derivative of the rates, see :meth:`Model.jacobian`."""
    return tomato(variant).jacobian(x, u, d, p, wrt)


def model_digest(variant: str = "author") -> str:
    """SHA-256 of the equations of a variant, see :attr:`Model.digest`."""
    return tomato(variant).digest


def default_parameters(set_name: str = BENCHMARK, overrides: dict[str, Override] | None = None) -> Array:
    """Parameters of a named set, see ``ParameterValues.default``."""
    return TOMATO.parameters.default(set_name, overrides)


parameter_group = TOMATO.parameters.group
crop_parameter_set = TOMATO.parameters.drawn_set
recompute_derived = TOMATO.parameters.complete


def initial_state(disturbances: ArrayLike, air_temperature: float = 16.5, parameters: ArrayLike | None = None) -> Array:
    """State at the start of the benchmark's season: a mature crop, air and surfaces at one temperature [°C]."""
    return TOMATO.start("mature_crop", disturbances, air_temperature, default_parameters() if parameters is None else parameters)


_MODELS: dict[str, dict[str, Model]] = {}
_SHIPPED: frozenset[str] = frozenset()


def register_model(model: Model) -> Model:
    """Make ``model`` known to task files by its id, in its variant, and return it.

    Raises ``UnknownNameError`` when another model has that id and variant; the message says what differs. A model with the same equations
    and variables takes the place of the one before, as when the cell of a notebook is run again, unless that came with glbench.
    """
    other = _MODELS.get(model.id, {}).get(model.variant, model)
    if other != model and (model.id in _SHIPPED or _differences(other, model)):
        differs = "; ".join(_differences(other, model)) or "the names and equations are the same, the classes are not"
        msg = f"There is another model '{model.id}' ({model.variant}) already: {differs}. Give yours another name or version."
        raise UnknownNameError(msg)
    _MODELS.setdefault(model.id, {})[model.variant] = model
    return model


def _differences(other: Model, model: Model) -> list[str]:
    """What tells two models of one id apart, in words; empty for equal equations of equal variables."""
    differences = []
    tables = {"states": "states", "controls": "controls", "disturbances": "disturbances", "parameters": "table"}
    for word, attribute in tables.items():
        before, now = ({entry.name: entry for entry in getattr(one, attribute)} for one in (other, model))
        only = {"only there": [*before.keys() - now.keys()], "only in yours": [*now.keys() - before.keys()]}
        only["with another description"] = [name for name in before.keys() & now.keys() if before[name] != now[name]]
        words = [f"{', '.join(sorted(names)[:5])} {where}" for where, names in only.items() if names]
        if words or list(before) != list(now):
            differences.append(f"{word}: {', '.join(words) or 'in another order'}")
    if other.digest != model.digest:
        differences.append(f"equations: digest {other.digest[:8]} there, {model.digest[:8]} in yours")
    return differences


def get_model(model_id: str, variant: str = "author") -> Model:
    """Model of that id, such as ``greenlight-tomato-1.0.0``. Raises ``UnknownNameError``, with the nearest name, when it is none."""
    if model_id not in _MODELS:
        broken = _load_plugins()
    if model_id not in _MODELS:
        name, _, version = model_id.rpartition("-")
        versions = [entry.removeprefix(f"{name}-") for entry in _MODELS if entry.rpartition("-")[0] == name]
        own = " The command line finds a model of your own through an entry point of an installed package (docs/extending.md)."
        if versions:
            own = ""
            problem = f"There is no version {version} of the model '{name}'. Known: {', '.join(versions)}."
        else:
            problem = f"There is no model '{model_id}'.{did_you_mean(model_id, _MODELS)}"
        raise UnknownNameError(problem + "".join(broken or (own,)))
    variants = _MODELS[model_id]
    if variant not in variants:
        refuse(f"There is no variant '{variant}' of the model '{model_id}'.{did_you_mean(variant, variants)}", UnknownNameError)
    return variants[variant]


@cache
def _load_plugins() -> tuple[str, ...]:
    """Call what installed packages name in the entry points ``glbench.models``: functions that register models.

    Returns a sentence for each that failed, for whoever misses a model.
    """
    failed = []
    for entry in entry_points(group="glbench.models"):
        try:
            entry.load()()
        except Exception as error:  # a broken package is no reason to refuse the models of others
            package = entry.dist.name if entry.dist else "an unknown package"
            cause = str(error) or "no message"
            failed.append(f" The entry point '{entry.name} = {entry.value}' of {package} failed: {type(error).__name__}: {cause}")
    return tuple(failed)


def registered_models() -> tuple[Model, ...]:
    """Every model that task files can name, in each of its variants, with those of installed packages."""
    _load_plugins()
    return tuple(model for variants in _MODELS.values() for model in variants.values())


for _variant in VARIANTS:
    register_model(tomato(_variant))
    register_model(tomato_harvest(_variant))
register_model(LETTUCE)
register_model(BUTTERHEAD)
register_model(HARVESTED_BUTTERHEAD)
register_model(TOMATO_ENERGY)
register_model(TOMATO_SEASON)
register_model(TOMATO_HEAT_PUMP)
register_model(COMPARTMENT)
for _model in (TOMATO_2, TOMATO_2_COMPARTMENT, TOMATO_2_COMPARTMENT_ENERGY, TOMATO_2_ENERGY, TOMATO_2_HEAT_PUMP, LETTUCE_CLASSIC):
    register_model(_model)
_SHIPPED = frozenset(_MODELS)
