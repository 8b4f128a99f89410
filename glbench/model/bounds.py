"""Bounds of what can be observed, for whatever controls an agent chooses and whatever weather a record can contain.

They are wide on purpose and no statement about good growing conditions. How they were found:

* Indoor temperatures: sky and leaks cannot cool below ``COLDEST``. The warmest house is closed, calm and humid, with the
  sun standing still at 1500 W m-2 over air of 60 degC, boiler and lamps at 1: 170 degC. At ``HOTTEST`` the cover alone would
  give off 2600 W m-2, which is more than all of these supply. Pipes and lamps stand up to 100 K above the air.
* Indoor CO2: the largest dose without photosynthesis, through the main compartment's own leaks at the lowest wind, or
  gathered over the whole horizon where that is less. The model does not know that CO2 displaces air, so the number
  exceeds what physics allows; in ordinary wind a dose that never stops leads to about 20 000 ppm.
* Vapour pressure: saturation at ``HOTTEST``.
* Light of a day: the brightest sky and all lamps for 25 hours, through a roof that keeps nothing back.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from glbench.model.shortwave import SUN_PHOTONS

COLDEST = -100.0
"""Lower bound of every temperature [degC]."""
HOTTEST = 200.0
"""Upper bound of temperatures of air, crop, cover, screens and soil [degC]."""
HOTTEST_METAL = 300.0
"""Upper bound of pipe and lamp temperatures [degC]."""
LARGEST_VAPOUR_PRESSURE = 2.0e6
"""Upper bound of vapour pressures [Pa]; saturation at 200 degC is 1.6e6 Pa."""
BRIGHTEST = 2000.0
"""Upper bound of global radiation [W m-2]."""
LONGEST_DAY = 90000.0
"""Length of the day on which summer time ends [s]."""

_RESPIRED_CO2 = 2.0e5  # mg m-3; all carbohydrate of a mature crop breathed into the house


@dataclass(frozen=True)
class Horizon:
    """What bounds may depend on: the control steps of an episode, and all parameters by public name, nominal values."""

    steps: int
    step_seconds: float
    parameters: Mapping[str, float]

    @property
    def days(self) -> float:
        """Length of the episode [day]."""
        return self.steps * self.step_seconds / 86400.0


def highest_co2_density(horizon: Horizon) -> float:
    """Highest CO2 density of the main air [mg m-3]: see the module's text.

    Only the leaks of the main compartment count, at the wind below which leakage no longer falls.
    """
    p = horizon.parameters
    dose = p["phiExtCo2"] / p["aFlr"]  # mg m-2 s-1
    gathered = dose * horizon.steps * horizon.step_seconds / p["capCo2Air"]
    leak = (1.0 - p["cLeakTop"]) * p["cLeakage"] * p["minWind"]  # m3 m-2 s-1
    return round_up((min(gathered, dose / leak) if leak > 0.0 else gathered) + _RESPIRED_CO2 + 1.0e4)


def highest_co2_ppm(horizon: Horizon) -> float:
    """``highest_co2_density`` as a volume fraction [ppm], in the hottest air the bounds allow."""
    molar = 8.3144598 * (HOTTEST + 273.15) / (101325.0 * 44.01e-3)  # m3 per kg of CO2
    return round_up(highest_co2_density(horizon) * molar)


def highest_light_sums(horizon: Horizon) -> tuple[float, float]:
    """Highest sums of a day: radiation outside [J cm-2], photons of PAR above the canopy [mol m-2]."""
    p = horizon.parameters
    sun = SUN_PHOTONS * p["etaGlobPar"] * BRIGHTEST  # umol m-2 s-1
    lamps = p["zetaLampPar"] * p["etaLampPar"] * p["thetaLampMax"]
    return round_up(1e-4 * BRIGHTEST * LONGEST_DAY), round_up(1e-6 * (sun + lamps) * LONGEST_DAY)


def round_up(value: float) -> float:
    """Next number of two significant digits that is not smaller."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / unit) * unit
