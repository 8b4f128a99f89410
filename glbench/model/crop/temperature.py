"""How temperature and development inhibit growth. Source: Vanthoor (2011) eqs 9.27-9.28 and B.2-B.6.

All functions are smooth and lie between 0 (no growth) and 1 (no inhibition), except the growth rate's own dependence
on the daily mean temperature.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

from glbench.model.expressions import Expr, sigmoid, sqrt, square
from glbench.model.parameters import TomatoParameters
from glbench.model.quantities import Quantity
from glbench.model.states import TomatoState

RAMP_ROUNDING = 1e-4
"""Rounds the corners of the development ramp [-]. Vanthoor (2011) eq. B.6."""


class GrowthInhibition(NamedTuple):
    """Factors on the growth of the organs."""

    g_t_can24: Annotated[Expr, Quantity("-", "growth rate at the daily mean temperature over that at 20 °C")]
    h_t_can24: Annotated[Expr, Quantity("-", "inhibition by an extreme daily mean temperature")]
    h_t_can: Annotated[Expr, Quantity("-", "inhibition of fruit growth by an extreme instantaneous temperature")]
    h_t_can_sum: Annotated[Expr, Quantity("-", "development: 0 = vegetative, 1 = fully generative")]


def within(value: Expr, low: Expr, low_slope: float, high: Expr, high_slope: float) -> Expr:
    """Smooth window: 1 between two limits, falling to 0 outside, with a slope [K-1] at each. Vanthoor (2011) B.2-B.3."""
    return sigmoid(low_slope * (value - low)) * sigmoid(high_slope * (high - value))


def rounded_positive_part(z: Expr) -> Expr:
    """``max(z, 0)`` with a rounded corner."""
    return 0.5 * (z + sqrt(square(z) + RAMP_ROUNDING))


def growth_inhibition(t_can: Expr, x: TomatoState, p: TomatoParameters) -> GrowthInhibition:
    """Growth factors at a canopy temperature [°C]. Vanthoor (2011) eqs 9.27-9.28, B.2, B.3 and B.6."""
    development = x.t_can_sum / p.t_end_sum
    return GrowthInhibition(
        g_t_can24=0.047 * x.t_can24 + 0.06,
        h_t_can24=within(x.t_can24, p.t_can24_min, 1.1587, p.t_can24_max, 1.3904),
        h_t_can=within(t_can, p.t_can_min, 0.869, p.t_can_max, 0.5793),
        h_t_can_sum=rounded_positive_part(development) - rounded_positive_part(development - 1),
    )
