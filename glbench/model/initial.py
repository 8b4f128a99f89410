"""The state in which the benchmark's season starts: a mature crop, air and surfaces at one temperature."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glbench.errors import ShapeError
from glbench.model.air import saturation_vapour_pressure
from glbench.model.disturbances import DISTURBANCE_NAMES, Disturbances
from glbench.model.parameter_sets import default_parameters
from glbench.model.parameter_table import PARAMETER_NAMES
from glbench.model.states import State

RELATIVE_HUMIDITY = 0.90
"""Relative humidity of main and top air at the start [-]."""

CANOPY_EXCESS = 4.0
"""Canopy temperature above air temperature at the start [K]."""

LEAVES = 95283.0
"""Leaf carbohydrates of the mature crop [mg m-2]: a leaf area index of 2.53."""

STEMS = 251070.0
"""Stem carbohydrates of the mature crop [mg m-2]."""

FRUIT = 55338.0
"""Fruit carbohydrates of the mature crop [mg m-2]."""

TEMPERATURE_SUM = 3097.8
"""Temperature sum of the mature crop [°C day], far beyond the start of fruit growth."""


def initial_state(
    disturbances: ArrayLike, air_temperature: float = 16.5, parameters: ArrayLike | None = None
) -> NDArray[np.float64]:
    """State at the start of the benchmark's season.

    Parameters
    ----------
    disturbances
        The first row of the weather, shape (10,).
    air_temperature
        Temperature of air and surfaces [°C].
    parameters
        Nominal parameters, shape (208,); None for the benchmark's. Of a cultivar with another specific leaf area the crop
        starts with the same leaf area index, not the same leaf mass.

    Returns
    -------
    ndarray
        Shape (28,).

    Raises
    ------
    ShapeError
        When an input has another shape or is not finite.
    """
    row = np.asarray(disturbances, dtype=np.float64)
    if row.shape != (len(DISTURBANCE_NAMES),) or not np.isfinite(row).all() or not np.isfinite(air_temperature):
        msg = (
            f"The initial state needs one finite row of {len(DISTURBANCE_NAMES)} disturbances "
            f"({', '.join(DISTURBANCE_NAMES)}) and a finite air temperature; "
            f"got shape {row.shape}, {row.tolist() if row.size <= 10 else '...'} and {air_temperature} °C."
        )
        raise ShapeError(msg)
    d = Disturbances(*row.tolist())
    t0 = float(air_temperature)
    vapour_pressure = float(RELATIVE_HUMIDITY * saturation_vapour_pressure(t0))
    state = State(
        co2_air=d.co2_out,
        co2_top=d.co2_out,
        t_air=t0,
        t_top=t0,
        t_can=t0 + CANOPY_EXCESS,
        t_cov_in=t0,
        t_cov_e=t0,
        t_th_scr=t0,
        t_flr=t0,
        t_pipe=t0,
        t_so1=t0,
        t_so2=(3 * t0 + d.t_so_out) / 4,
        t_so3=(2 * t0 + 2 * d.t_so_out) / 4,
        t_so4=(t0 + 3 * d.t_so_out) / 4,
        t_so5=d.t_so_out,
        vp_air=vapour_pressure,
        vp_top=vapour_pressure,
        t_lamp=t0,
        t_int_lamp=t0,
        t_gro_pipe=t0,
        t_bl_scr=t0,
        t_can24=t0 + CANOPY_EXCESS,
        c_buf=0.0,
        c_leaf=LEAVES * leaf_mass_ratio(parameters),
        c_stem=STEMS,
        c_fruit=FRUIT,
        t_can_sum=TEMPERATURE_SUM,
        time=0.0,
    )
    return np.array(state, dtype=np.float64)


def leaf_mass_ratio(parameters: ArrayLike | None) -> float:
    """Leaf mass for the benchmark's leaf area, over that of the benchmark's cultivar [-]."""
    if parameters is None:
        return 1.0
    p = np.asarray(parameters, dtype=np.float64)
    sla = PARAMETER_NAMES.index("sla")
    if p.shape != (len(PARAMETER_NAMES),) or not p[sla] > 0:
        msg = f"Expected {len(PARAMETER_NAMES)} nominal parameters with a positive sla; got shape {p.shape}."
        raise ShapeError(msg)
    return float(default_parameters()[sla] / p[sla])
