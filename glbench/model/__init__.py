"""Models of greenhouses as values: the GreenLight climate with its tomato crop, and what else is composed.

The physics is written once, in one module a process, for floats, NumPy arrays and CasADi symbols. A :class:`Model` is made of submodels by
:func:`compose`; names, units and signs are in docs/nomenclature.md and docs/model-symbols.md.

Sources: Vanthoor (2011) greenhouse and crop, Katzin et al. (2020) and Katzin (2021) lamps, blackout screen and the
GreenLight model as a whole.
"""

from glbench.model.actuators import Actuators
from glbench.model.air import (
    Air,
    co2_density,
    co2_ppm,
    humidity_deficit,
    relative_humidity,
    saturation_vapour_pressure,
    vapour_density,
    vapour_pressure_deficit,
)
from glbench.model.bounds import Horizon
from glbench.model.crop.butterhead import Butterhead
from glbench.model.crop.lettuce import VanHentenLettuce
from glbench.model.crop.tomato import VanthoorTomato
from glbench.model.crop.trusses import TrussTomato
from glbench.model.energy import ChpBoilerBuffer
from glbench.model.expressions import Expr
from glbench.model.greenhouse import Meter, compose
from glbench.model.greenlight import GreenLightClimate
from glbench.model.heat_harvesting import HARVEST_METERS, HeatHarvesting
from glbench.model.model import Capacity, Evaluation, Flow, Model, ObservedColumn, Signal, Step, StepMap, Stock
from glbench.model.paper import (
    AUXILIARIES,
    BUTTERHEAD,
    CO2_DOSED,
    COMPARTMENT,
    CONTROL_NAMES,
    CONTROLS,
    DISTURBANCE_NAMES,
    DISTURBANCES,
    HARVEST,
    HARVESTED_BUTTERHEAD,
    LETTUCE,
    LETTUCE_CLASSIC,
    MODEL_VERSION,
    PARAMETER_NAMES,
    PARAMETERS,
    STATE_NAMES,
    STATES,
    TOMATO,
    TOMATO_2,
    TOMATO_2_COMPARTMENT,
    TOMATO_2_COMPARTMENT_ENERGY,
    TOMATO_2_ENERGY,
    TOMATO_2_HEAT_PUMP,
    TOMATO_ENERGY,
    TOMATO_HEAT_PUMP,
    TOMATO_SEASON,
    auxiliaries,
    build_rhs,
    crop_parameter_set,
    default_parameters,
    get_model,
    initial_state,
    jacobian,
    model_digest,
    parameter_group,
    recompute_derived,
    register_model,
    registered_models,
    rhs,
    tomato,
)
from glbench.model.parameter_sets import PARAMETER_SETS
from glbench.model.parameter_table import Parameter
from glbench.model.quantities import Quantity, Variable
from glbench.model.submodels import Addition, Around, Climate, Crop, Nothing
from glbench.model.surroundings import AirExchange, CropExchange, Surroundings
from glbench.model.variants import VARIANTS
from glbench.model.violation_meters import NO_LIMIT, SIDES, Side, limit_parameter, violation_meter, with_violation_meters

__all__ = [
    "AUXILIARIES",
    "BUTTERHEAD",
    "CO2_DOSED",
    "COMPARTMENT",
    "CONTROLS",
    "CONTROL_NAMES",
    "DISTURBANCES",
    "DISTURBANCE_NAMES",
    "HARVEST",
    "HARVESTED_BUTTERHEAD",
    "HARVEST_METERS",
    "LETTUCE",
    "LETTUCE_CLASSIC",
    "MODEL_VERSION",
    "NO_LIMIT",
    "PARAMETERS",
    "PARAMETER_NAMES",
    "PARAMETER_SETS",
    "SIDES",
    "STATES",
    "STATE_NAMES",
    "TOMATO",
    "TOMATO_2",
    "TOMATO_2_COMPARTMENT",
    "TOMATO_2_COMPARTMENT_ENERGY",
    "TOMATO_2_ENERGY",
    "TOMATO_2_HEAT_PUMP",
    "TOMATO_ENERGY",
    "TOMATO_HEAT_PUMP",
    "TOMATO_SEASON",
    "VARIANTS",
    "Actuators",
    "Addition",
    "Air",
    "AirExchange",
    "Around",
    "Butterhead",
    "Capacity",
    "ChpBoilerBuffer",
    "Climate",
    "Crop",
    "CropExchange",
    "Evaluation",
    "Expr",
    "Flow",
    "GreenLightClimate",
    "HeatHarvesting",
    "Horizon",
    "Meter",
    "Model",
    "Nothing",
    "ObservedColumn",
    "Parameter",
    "Quantity",
    "Side",
    "Signal",
    "Step",
    "StepMap",
    "Stock",
    "Surroundings",
    "TrussTomato",
    "VanHentenLettuce",
    "VanthoorTomato",
    "Variable",
    "auxiliaries",
    "build_rhs",
    "co2_density",
    "co2_ppm",
    "compose",
    "crop_parameter_set",
    "default_parameters",
    "get_model",
    "humidity_deficit",
    "initial_state",
    "jacobian",
    "limit_parameter",
    "model_digest",
    "parameter_group",
    "recompute_derived",
    "register_model",
    "registered_models",
    "relative_humidity",
    "rhs",
    "saturation_vapour_pressure",
    "tomato",
    "vapour_density",
    "vapour_pressure_deficit",
    "violation_meter",
    "with_violation_meters",
]
