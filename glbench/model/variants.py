"""The author's equations, and the published benchmark code as one named variant of them.

The code published with the benchmark paper differs from the model author's own definition in exactly eleven places. Each
is one field here, read at the equation it concerns, so no equation is written twice. Row numbers and the measured
effects are in docs/adr/0002-author-equations-by-default.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from glbench.errors import UnknownNameError, did_you_mean
from glbench.model.air import CELSIUS_ZERO


@dataclass(frozen=True)
class Variant:
    """The places where two published readings of the model differ. The defaults are the author's."""

    name: str

    convection_exponent: float = 0.33
    """Row 1: exponent of the temperature difference at horizontal surfaces [-] (the code: 1/3)."""

    leaf_pruning_rate: float = 1e5
    """Row 2: largest rate of leaf pruning [mg m-2 s-1] (the code, and Vanthoor's print: 5e4)."""

    blackout_screen_dries: bool = False
    """Row 3: whether the small negative lobe of the condensation function may dry the blackout screen."""

    vapour_flow_factor: float | None = None
    """Row 4: water held by air, ``mWater/R`` [kg K J-1]; None computes it from the parameters (the code: 0.002165)."""

    vapour_flow_celsius_zero: float = CELSIUS_ZERO
    """Row 5: 0 °C [K] in the vapour carried by air (the code rounds it to single precision)."""

    harvest_logarithm: float = math.log(100)
    """Row 6: ln(100) in the harvest function [-] (the code: 4.6052)."""

    screen_flow_guard: float = 0.0
    """Row 7: added under the root of the flow through a screen's gap [kg2 m-4 s-2] (the code: 1e-10)."""

    temperature_difference_guard: float = 0.0
    """Row 8: added to temperature differences that are raised to a power [K] (the code: 1e-10)."""

    electron_transport_guard: float = 0.0
    """Row 9: added under the root of the electron transport [umol2 m-4 s-2] (the code: 1e-10)."""

    blackout_screen_hides_sky_from_pipe: bool = True
    """Row 10: whether the blackout screen attenuates the far-infrared exchange of pipes and sky."""

    side_vents_counted: bool = True
    """Row 11: whether the area of side vents reduces the roof's share of all vents."""


AUTHOR = Variant(name="author")
"""The model author's own definition: the default everywhere."""

GL_GYM2 = Variant(
    name="gl_gym2",
    convection_exponent=1 / 3,
    leaf_pruning_rate=5e4,
    blackout_screen_dries=True,
    vapour_flow_factor=0.002165,
    vapour_flow_celsius_zero=273.149993896484375,  # 273.15 as a 32-bit float
    harvest_logarithm=4.6052,
    screen_flow_guard=1e-10,
    temperature_difference_guard=1e-10,
    electron_transport_guard=1e-10,
    blackout_screen_hides_sky_from_pipe=False,
    side_vents_counted=False,
)
"""The equations of the code published with the benchmark paper, for comparison with its results."""

VARIANTS: tuple[str, ...] = (AUTHOR.name, GL_GYM2.name)


def get_variant(name: str) -> Variant:
    """Variant of that name. Raises ``UnknownNameError`` when there is none."""
    for variant in (AUTHOR, GL_GYM2):
        if variant.name == name:
            return variant
    msg = f"There is no model variant '{name}'.{did_you_mean(name, VARIANTS)}"
    raise UnknownNameError(msg)
