"""The model put together: from state, controls, disturbances and parameters to all fluxes and the time derivative."""

from __future__ import annotations

from typing import NamedTuple

from glbench.model.actuators import actuators
from glbench.model.balances import Fluxes, balances, net_uptake
from glbench.model.capacities import capacities
from glbench.model.co2 import co2_transport
from glbench.model.controls import Controls
from glbench.model.convection import convection
from glbench.model.crop.allocation import allocation
from glbench.model.crop.harvest import harvest
from glbench.model.crop.photosynthesis import photosynthesis
from glbench.model.crop.respiration import respiration
from glbench.model.crop.temperature import growth_inhibition
from glbench.model.disturbances import Disturbances
from glbench.model.longwave import long_wave, views
from glbench.model.optics import cover_optics
from glbench.model.parameters import Parameters
from glbench.model.shortwave import short_wave
from glbench.model.states import State
from glbench.model.transpiration import transpiration
from glbench.model.vapour import vapour
from glbench.model.variants import AUTHOR, Variant
from glbench.model.ventilation import ventilation


class GreenLight(NamedTuple):
    """One evaluation of the model."""

    derivative: State
    """Time derivative of the state [unit of the state per second]."""
    fluxes: Fluxes
    """Everything computed on the way."""


def greenlight(x: State, u: Controls, d: Disturbances, p: Parameters, variant: Variant = AUTHOR) -> GreenLight:
    """Evaluate the model for floats, NumPy arrays (one entry a row) or CasADi symbols.

    Units and signs are in docs/nomenclature.md. Source: Katzin (2021) on top of Vanthoor (2011).
    """
    cap = capacities(x, p)
    optics = cover_optics(u, p)
    act = actuators(u, p)
    light = short_wave(cap.lai, optics, act, d, p)
    seen = views(cap.lai, optics, p)
    air = ventilation(x, u, d, p, variant)
    heat = convection(cap.lai, x, air, u, d, p, variant)
    sugar = photosynthesis(cap.lai, light, x, p, variant)
    inhibition = growth_inhibition(x, p)
    growth = allocation(inhibition, x, p)
    respired = respiration(growth, x, p)
    fluxes = Fluxes(
        optics=optics,
        capacities=cap,
        actuators=act,
        short_wave=light,
        views=seen,
        long_wave=long_wave(seen, x, optics, u, d, p, variant),
        ventilation=air,
        convection=heat,
        transpiration=transpiration(cap.lai, light.r_can, x, p),
        vapour=vapour(x, air, heat, d, p, variant),
        co2=co2_transport(x, air, d),
        photosynthesis=sugar,
        inhibition=inhibition,
        allocation=growth,
        respiration=respired,
        harvest=harvest(x, p, variant),
        crop=net_uptake(sugar, respired, p),
    )
    return GreenLight(balances(x, p, fluxes), fluxes)
