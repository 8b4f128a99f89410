"""An energy system as seen from outside: sizes, efficiencies, buffer, flows; the equations are in :mod:`glbench.model.energy`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

from glbench.model.greenlight import JOULES_PER_KWH, KG_PER_MG
from glbench.model.model import Model

BUFFER = "eBuf"
"""The state that holds the heat in the buffer [MJ m-2]."""
ENERGY_FLOWS = (
    "gas", "heat", "engine_heat", "heat_to_pipes", "heat_dumped", "electricity_made", "electricity_bought", "electricity_sold",
    "co2_made", "co2_from_flue", "co2_bought",
)  # fmt: skip
"""What an energy system's balances are made of (docs/energy.md)."""


def lacks_energy(model: Model) -> tuple[str, ...]:
    """What a model lacks of an energy system with a buffer whose balances are known: nothing if it has one."""
    flows = {flow.name for flow in model.flows()}
    return (*(() if BUFFER in model.state_names else (BUFFER,)), *(name for name in ENERGY_FLOWS if name not in flows))


@dataclass(frozen=True)
class Equipment:
    """What can make, store and trade. Names, units and meanings of the parameters are those of ``glbench/model/energy.csv``."""

    boiler: float
    engine: float
    """``boiler`` and ``engine``: most heat of the boiler and most electricity of the engine [W m-2]."""
    eta_boiler: float
    eta_engine: float
    eta_engine_heat: float
    """``eta_boiler``, ``eta_engine`` and ``eta_engine_heat``: heat of the boiler, electricity and heat of the engine per gas burnt."""
    buffer: float
    """Heat in a full buffer [MJ m-2]; 0: there is none."""
    tau: float
    """Time in which an idle buffer loses all but 1/e of its heat [day]."""
    co2_of_gas: float
    """CO2 per gas burnt [kg kWh-1]."""

    @classmethod
    def of(cls, model: Model, parameters: Mapping[str, float]) -> Self:
        """The equipment of a model that lacks nothing (:func:`lacks_energy`), with all its parameters by name."""
        p = parameters
        return cls(
            boiler=p["pBoil"] / p["aFlr"],
            engine=p["pChpEl"],
            eta_boiler=p["etaBoil"],
            eta_engine=p["etaChpEl"],
            eta_engine_heat=p["etaChpHeat"],
            buffer=p["eBufMax"],
            tau=p["tauBuf"],
            co2_of_gas=p["co2Gas"] * JOULES_PER_KWH * KG_PER_MG,
        )

    def makes(self) -> Mapping[str, Mapping[str, float]]:
        """Each flow that depends on how the equipment is run, in its own unit, per unit of what is chosen.

        Chosen are ``boiler`` (its heat), ``engine`` (its electricity), ``bought`` and ``sold`` (electricity), ``co2`` (bought), ``dumped``
        (heat): kWh m-2, CO2 kg m-2. An engine at a part of its load counts as running for that part of the time.
        """
        gas = {"boiler": 1 / self.eta_boiler, "engine": 1 / self.eta_engine}
        co2 = {name: self.co2_of_gas * burnt for name, burnt in gas.items()}
        return {
            "gas": gas,
            "heat": {"boiler": 1.0},
            "engine_heat": {"engine": self.eta_engine_heat / self.eta_engine},
            "electricity_made": {"engine": 1.0},
            "electricity_bought": {"bought": 1.0},
            "electricity_sold": {"sold": 1.0},
            "co2_made": co2,
            "co2_from_flue": {"co2": -1.0},
            "co2_vented": {**co2, "co2": 1.0},
            "co2_bought": {"co2": 1.0},
            "heat_dumped": {"dumped": JOULES_PER_KWH},
            "engine_hours": {"engine": 1000.0 / self.engine} if self.engine else {},
            "engine_starts": {},
        }
