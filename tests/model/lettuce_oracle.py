"""Van Henten's lettuce once more, to test the model against: grams and ppm as the paper has them, branches instead of rounding.

Nothing of `glbench.model` is imported. The paper's equations are taken one at a time, for single numbers, in the paper's
units (dry weight in g m-2, CO2 in ppm of a density of 1.83 mg m-3 each, or in mg m-3), and integrated by SciPy.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

DAY = 86400.0


@dataclass
class Lettuce:
    """The paper's constants, in the paper's units."""

    c_alpha: float = 0.68
    c_beta: float = 0.8
    c_tau: float = 0.07
    c_lar: float = 75e-3  # m2 g-1
    c_k: float = 0.9
    c_gr_max: float = 5e-6
    c_gamma: float = 1.0
    c_q10_gr: float = 1.6
    c_resp_sht: float = 3.47e-7
    c_resp_rt: float = 1.16e-7
    c_q10_resp: float = 2.0
    c_epsilon: float = 17e-6  # g J-1
    c_capital_gamma: float = 73.2  # mg m-3: 40 ppm of 1.83 mg m-3
    c_q10_gamma: float = 2.0
    g_bnd: float = 0.004
    g_stm: float = 0.007
    c_car: tuple[float, float, float] = (-1.32e-5, 5.94e-4, -2.64e-3)
    heads: float = 25.0
    dry_share: float = 0.045

    def compensation_point(self, temperature: float) -> float:
        """mg m-3."""
        return self.c_capital_gamma * math.pow(self.c_q10_gamma, (temperature - 20.0) / 10.0)

    def gross_photosynthesis(self, structural: float, temperature: float, co2: float, par: float) -> float:
        """g m-2 s-1 of CO2; nothing in darkness and at temperatures without carboxylation."""
        carboxylation = np.polyval(self.c_car, temperature)
        if par == 0 or carboxylation <= 0:
            return 0.0
        excess = co2 - self.compensation_point(temperature)
        if excess == 0:
            return 0.0
        efficiency = self.c_epsilon * excess / (co2 + 2 * self.compensation_point(temperature))
        resistance = 1 / self.g_bnd + 1 / self.g_stm + 1 / carboxylation
        by_light, by_co2 = efficiency * par, 1e-3 * excess / resistance
        closed_canopy = 1 / (1 / by_light + 1 / by_co2)
        leaves = self.c_lar * (1 - self.c_tau) * structural
        return -closed_canopy * math.expm1(-self.c_k * leaves)

    def derivative(self, dry: NDArray[np.float64], temperature: float, co2: float, par: float) -> tuple[float, float, float]:
        """Rates of non-structural and structural dry weight [g m-2 s-1], and CO2 respired [g m-2 s-1]."""
        nonstructural, structural = dry
        warmth = math.exp(math.log(self.c_q10_gr) * (temperature - 20) / 10)
        specific = self.c_gr_max * warmth / (1 + self.c_gamma * structural / nonstructural) if nonstructural else 0.0
        grown = specific * structural
        maintenance = (self.c_resp_sht * (1 - self.c_tau) * structural + self.c_resp_rt * self.c_tau * structural) * self.c_q10_resp ** (
            temperature / 10 - 2.5
        )
        synthesis = (1 - self.c_beta) / self.c_beta * grown
        assimilated = self.c_alpha * self.gross_photosynthesis(structural, temperature, co2, par)
        return assimilated - grown - synthesis - maintenance, grown, (synthesis + maintenance) / self.c_alpha

    def young(self, head_grams: float = 3.0) -> NDArray[np.float64]:
        """Dry weight [g m-2] of young plants, three parts in four structural."""
        return np.array([0.25, 0.75]) * head_grams * self.heads * self.dry_share / (1 - self.c_tau)

    def head(self, dry: NDArray[np.float64]) -> NDArray[np.float64]:
        """Fresh mass of a head [g]."""
        fresh: NDArray[np.float64] = (1 - self.c_tau) * dry.sum(axis=0) / self.dry_share / self.heads
        return fresh

    def heads_by_day(self, days: int, temperature: float, co2: float, par: float, light_hours: float = 12.0) -> NDArray[np.float64]:
        """Fresh mass of a head [g] at the end of every day, at constant climate and so many hours of light a day."""
        dry, masses = self.young(), [float(self.head(self.young()))]
        for _ in range(days):
            for light, hours in ((par, light_hours), (0.0, 24 - light_hours)):
                dry = self._integrate(dry, hours * 3600, lambda x, light=light: self.derivative(x, temperature, co2, light))
            masses.append(float(self.head(dry)))
        return np.array(masses)

    @staticmethod
    def _integrate(
        dry: NDArray[np.float64], seconds: float, rates: Callable[[NDArray[np.float64]], tuple[float, float, float]]
    ) -> NDArray[np.float64]:
        done = solve_ivp(lambda _, x: rates(x)[:2], (0.0, seconds), dry, method="DOP853", rtol=1e-9, atol=1e-9)
        end: NDArray[np.float64] = done.y[:, -1]
        return end
