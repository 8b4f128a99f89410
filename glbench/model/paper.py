"""The greenhouse of the benchmark's paper, and the models that tasks can name.

``greenlight-tomato-1.0.0`` is the GreenLight greenhouse with its tomato crop: 28 states, 6 controls, 10 disturbances, 208
parameters. ``greenlight-tomato-harvest-1.0.0`` has a meter on its harvest besides.
The names and functions below are those of the first; code that serves any model asks the model instead.
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points

import casadi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from glbench.errors import UnknownNameError, did_you_mean
from glbench.model.crop.lettuce import VanHentenLettuce
from glbench.model.crop.tomato import VanthoorTomato
from glbench.model.greenhouse import Greenhouse, Meter, compose
from glbench.model.greenlight import GreenLightClimate
from glbench.model.model import Evaluation, Model, Symbolic
from glbench.model.parameter_sets import Given
from glbench.model.parameter_table import BENCHMARK
from glbench.model.variants import AUTHOR, VARIANTS, Variant, get_variant

Array = NDArray[np.float64]


@cache
def tomato(variant: str = "author") -> Greenhouse:
    """The tomato greenhouse in one of the two readings of its equations.

    Raises
    ------
    UnknownNameError
        When there is no such variant.
    """
    reading = get_variant(variant)
    return compose(GreenLightClimate(reading), VanthoorTomato(reading))


HARVEST = Meter(
    "mc_fruit_har",
    "fruit_harvested",
    "mg m-2",
    "carbohydrate of the fruit harvested",
    "Fruit harvested",
    scale=1e5,
    small=100.0,
)
"""The harvest of a control step: what is picked can be paid when it is picked."""


@cache
def tomato_harvest(variant: str = "author") -> Greenhouse:
    """The tomato greenhouse with a meter on its harvest: ``greenlight-tomato-harvest-1.0.0``.

    Raises
    ------
    UnknownNameError
        When there is no such variant.
    """
    reading = get_variant(variant)
    return compose(
        GreenLightClimate(reading), VanthoorTomato(reading), meters=(HARVEST,), name="greenlight-tomato-harvest"
    )


TOMATO = tomato()
"""The model author's own equations: the model of the paper."""

LETTUCE = compose(GreenLightClimate(), VanHentenLettuce())
"""The same greenhouse with lettuce in it."""

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


def default_parameters(set_name: str = BENCHMARK, overrides: dict[str, Given] | None = None) -> Array:
    """Parameters of a named set, see ``ParameterValues.default``."""
    return TOMATO.parameters.default(set_name, overrides)


parameter_group = TOMATO.parameters.group
crop_parameter_set = TOMATO.parameters.drawn_set
recompute_derived = TOMATO.parameters.complete


def initial_state(disturbances: ArrayLike, air_temperature: float = 16.5, parameters: ArrayLike | None = None) -> Array:
    """State at the start of the benchmark's season: a mature crop, air and surfaces at one temperature [°C]."""
    values = default_parameters() if parameters is None else parameters
    return TOMATO.start("mature_crop", disturbances, air_temperature, values)


_MODELS: dict[str, dict[str, Model]] = {}


def register_model(model: Model) -> Model:
    """Make ``model`` known to task files by its id, in its variant, and return it.

    Raises
    ------
    UnknownNameError
        When another model has that id and variant.
    """
    variants = _MODELS.setdefault(model.id, {})
    if variants.get(model.variant, model) != model:
        msg = f"There is another model '{model.id}' ({model.variant}) already. Give yours another name or version."
        raise UnknownNameError(msg)
    variants[model.variant] = model
    return model


def get_model(model_id: str, variant: str = "author") -> Model:
    """Model of that id, such as ``greenlight-tomato-1.0.0``.

    Raises
    ------
    UnknownNameError
        When there is no such model or variant; the message names the nearest.
    """
    if model_id not in _MODELS:
        _load_plugins()
    if model_id not in _MODELS:
        msg = f"There is no model '{model_id}'.{did_you_mean(model_id, _MODELS)}"
        raise UnknownNameError(msg)
    variants = _MODELS[model_id]
    if variant not in variants:
        msg = f"There is no variant '{variant}' of the model '{model_id}'.{did_you_mean(variant, variants)}"
        raise UnknownNameError(msg)
    return variants[variant]


@cache
def _load_plugins() -> None:
    """Call what installed packages name in the entry points ``glbench.models``: functions that register models."""
    for entry in entry_points(group="glbench.models"):
        entry.load()()


def registered_models() -> tuple[Model, ...]:
    """Every model that task files can name, in each of its variants."""
    return tuple(model for variants in _MODELS.values() for model in variants.values())


for _variant in VARIANTS:
    register_model(tomato(_variant))
    register_model(tomato_harvest(_variant))
register_model(LETTUCE)
