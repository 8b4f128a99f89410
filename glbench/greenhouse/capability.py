"""What a greenhouse can do, computed with the model: balances that it settles in, without sun and with controls that stay.

In a balance nothing in the climate changes. It is reached by implicit Euler steps that grow until the rates are zero. The crop stays.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from glbench.arrays import Floats
from glbench.errors import ParameterError
from glbench.model import TOMATO, saturation_vapour_pressure
from glbench.model.states import ClimateState
from glbench.tasks.set_points import BLACKOUT, SCREEN

Parameters = Mapping[str, float]

WIND, SKY_BELOW, HUMIDITY, SOIL = 4.0, 15.0, 0.8, 8.0
"""Wind [m s-1], how far the sky is colder than the air [K], relative humidity [-] and soil temperature [degC] outside."""
COLD_NIGHT, SAVING_NIGHT, INSIDE = -10.0, 0.0, 18.0
"""Air outside in the night of the boiler and in that of the screens, and the air inside in the latter [degC]."""
HOT_PIPES = 90.0  # Rail pipes are seldom warmer [degC]
_FREE = len(ClimateState._fields)
_FIRST_STEP, _LAST_STEP, _SHORTEST_STEP, _GROWTH, _LARGEST_CHANGE = 60.0, 1e9, 1e-6, 1.7, 0.2
_WIDE_BOILER = 1000.0  # Heat of a boiler with which every temperature is reached [W m-2]


@dataclass(frozen=True)
class Capability:
    """What a greenhouse can do."""

    boiler: float
    """Heat installed [W m-2]."""
    cold_temperature: float
    pipe_temperature: float
    """``cold_temperature`` and ``pipe_temperature``: of air and rail pipes with full heat and closed screens in the cold night [degC]."""
    cold_heat: float
    """What 18 degC would need there [W m-2]."""
    saving: float | None
    """Heat that the closed energy screen saves at 0 degC outside [-]; ``None`` without one."""
    light: float
    lamp_power: float
    """``light`` and ``lamp_power``: of the lamps [umol m-2 s-1], [W m-2]."""
    dosing: float
    """CO2 [g m-2 h-1]."""
    vent_area: float
    """Open roof vents for each square metre of floor [-]."""
    air_changes: float
    """Volumes of air that leave with open vents in an hour, 26 degC inside, 20 degC outside [h-1]."""


def _vector(names: tuple[str, ...], **values: float) -> Floats:
    return np.array([values.get(name, 0.0) for name in names])


def outdoors(temperature: float, wind: float = WIND) -> Floats:
    """Disturbances of a night outside with this air temperature [degC] and wind [m s-1]."""
    vapour = HUMIDITY * float(saturation_vapour_pressure(temperature))
    sky = temperature - SKY_BELOW
    return _vector(TOMATO.disturbance_names, tOut=temperature, vpOut=vapour, co2Out=750.0, wind=wind, tSky=sky, tSoOut=SOIL)


def balance(parameters: Floats, weather: Floats, **controls: float) -> Floats:
    """State (states,) that settles with constant weather (disturbances,) and controls by name. Raises ``ParameterError`` when none does."""
    state, u = TOMATO.start("mature_crop", weather, INSIDE, parameters), _vector(TOMATO.control_names, **controls)
    step = _FIRST_STEP
    while step < _LAST_STEP:
        rates = TOMATO.rhs(state, u, weather, parameters)[:_FREE]
        slopes = TOMATO.jacobian(state, u, weather, parameters)[:_FREE, :_FREE]
        change = np.linalg.solve(np.eye(_FREE) / step - slopes, rates)
        if np.max(np.abs(change) / (1.0 + np.abs(state[:_FREE]))) > _LARGEST_CHANGE:
            step /= 4.0
            if step < _SHORTEST_STEP:
                msg = "This greenhouse settles nowhere: its climate runs away with constant controls. Look at its parameters again."
                raise ParameterError(msg)
            continue
        state[:_FREE] += change
        step *= _GROWTH
    return state


def heat_for(temperature: float, parameters: Parameters, weather: Floats, **controls: float) -> float:
    """Heat [W m-2] that holds the air at a temperature [degC] in the balance."""
    from scipy.optimize import brentq

    wide = _vector(TOMATO.parameter_names, **{**parameters, "pBoil": _WIDE_BOILER * parameters["aFlr"]})
    air = TOMATO.state_index("tAir")

    def excess(share: float) -> float:
        return float(balance(wide, weather, uBoil=share, **controls)[air]) - temperature

    return _WIDE_BOILER * float(brentq(excess, 0.0, 1.0, xtol=1e-6))


def screen_saving(parameters: Parameters) -> float:
    """Share of the heat that the closed energy screen saves in the night of the screens [-]."""
    weather = outdoors(SAVING_NIGHT)
    return 1.0 - heat_for(INSIDE, parameters, weather, uThScr=1.0) / heat_for(INSIDE, parameters, weather)


def capability(parameters: Parameters, *, energy_screen: bool = True, blackout_screen: bool = True) -> Capability:
    """What a greenhouse with all these parameters of the model, by name, can do."""
    p, floor = _vector(TOMATO.parameter_names, **parameters), parameters["aFlr"]
    screens = {SCREEN: float(energy_screen), BLACKOUT: float(blackout_screen)}
    cold = outdoors(COLD_NIGHT)
    night = balance(p, cold, uBoil=1.0, **screens)
    day, warm = outdoors(20.0, wind=3.0), TOMATO.start("mature_crop", outdoors(20.0), 26.0, p)
    exchange = TOMATO.auxiliary_values(warm, _vector(TOMATO.control_names, uVent=1.0), day, p)
    return Capability(
        boiler=parameters["pBoil"] / floor,
        cold_temperature=float(night[TOMATO.state_index("tAir")]),
        pipe_temperature=float(night[TOMATO.state_index("tPipe")]),
        cold_heat=heat_for(INSIDE, parameters, cold, **screens),
        saving=screen_saving(parameters) if energy_screen else None,
        light=parameters["thetaLampMax"] * parameters["etaLampPar"] * parameters["zetaLampPar"],
        lamp_power=parameters["thetaLampMax"],
        dosing=3.6 * parameters["phiExtCo2"] / floor,
        vent_area=parameters["aRoof"] / floor,
        air_changes=3600.0 * float(exchange["fVentRoof"]) / parameters["hGh"],
    )
