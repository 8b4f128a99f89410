"""The GreenLight greenhouse and its tomato crop: 28 states, 6 controls, 10 disturbances, 208 parameters.

The physics is written once, in one module a process, for floats, NumPy arrays and CasADi symbols. Numbers go in and out
through the functions below; names, units and signs are in docs/nomenclature.md.

Sources: Vanthoor (2011) greenhouse and crop, Katzin et al. (2020) and Katzin (2021) lamps, blackout screen and the
GreenLight model as a whole.
"""

from __future__ import annotations

from glbench.model.air import co2_density, co2_ppm, relative_humidity, saturation_vapour_pressure
from glbench.model.controls import CONTROL_NAMES, CONTROLS
from glbench.model.derived import recompute_derived
from glbench.model.digest import MODEL_VERSION, model_digest
from glbench.model.disturbances import DISTURBANCE_NAMES, DISTURBANCES
from glbench.model.functions import (
    AUXILIARIES,
    auxiliaries,
    build_auxiliaries,
    build_jacobian,
    build_rhs,
    jacobian,
    rhs,
)
from glbench.model.initial import initial_state
from glbench.model.parameter_sets import (
    PARAMETER_SETS,
    crop_parameter_set,
    default_parameters,
    parameter_group,
)
from glbench.model.parameter_table import PARAMETER_NAMES, PARAMETERS
from glbench.model.states import STATE_NAMES, STATES
from glbench.model.variants import VARIANTS

__all__ = [
    "AUXILIARIES",
    "CONTROLS",
    "CONTROL_NAMES",
    "DISTURBANCES",
    "DISTURBANCE_NAMES",
    "MODEL_VERSION",
    "PARAMETERS",
    "PARAMETER_NAMES",
    "PARAMETER_SETS",
    "STATES",
    "STATE_NAMES",
    "VARIANTS",
    "auxiliaries",
    "build_auxiliaries",
    "build_jacobian",
    "build_rhs",
    "co2_density",
    "co2_ppm",
    "crop_parameter_set",
    "default_parameters",
    "initial_state",
    "jacobian",
    "model_digest",
    "parameter_group",
    "recompute_derived",
    "relative_humidity",
    "rhs",
    "saturation_vapour_pressure",
]
