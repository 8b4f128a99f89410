"""How accurate a step is: presets, and the tolerances of each state.

The error of a substep is measured in units of ``relative*|x| + absolute``, summed over the states as squares; a sum above
one is rejected. ``absolute`` is relative to the size below which a state's value means little for the others
(``Variable.small``): 0.1 K, 1 mg m-3 of CO2, 10 Pa, 100 mg m-2 in the tomato model. Its factors (``Variable.balance``) were found by
search over 60 runs of 60 days of walking and of jumping controls: with them all states come about equally close to the errors of
CVODES. Vapour and the integrals of the canopy's temperature are what CVODES is best at.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from glbench.errors import UnknownNameError, did_you_mean
from glbench.model import Model

Method = Literal["Rodas4P2", "GRK4T"]
METHODS: tuple[Method, ...] = ("Rodas4P2", "GRK4T")
"""As native/rows.hpp numbers them."""


@dataclass(frozen=True)
class Preset:
    """Settings of the step-size control.

    Attributes
    ----------
    relative : float
        Relative tolerance of a substep.
    first_substep : float
        Length of the first substep of every control step [s]; fixed, so that a step depends on its inputs only.
    fast_error_floor : float
        The least factor on the squared errors of the fast states, long before the end of the step.
    fast_time_constant : float
        Time in which an error of a fast state is taken to fade to 1/e of itself [s].
    singular_error_factor : float
        Factor on the squared errors of a substep that changes the difference of the singular states by more than half of its
        size. Very tight tolerances do without: with it they would ask for less than rounding.
    method : str
        ``"Rodas4P2"`` or ``"GRK4T"``, see native/rosenbrock.hpp.
    last_stretch : float
        The end of the control step that no substep enters from before [s]. GRK4T looks at nothing beyond 0.88 of a substep:
        where water begins to condense on a screen after that, the next substep mends it, and there must be one.
    balanced : bool
        Whether the states are weighted for the comparison with CVODES (``Variable.balance``), or all alike but for a few
        (``Variable.sharper``): thin screens, all but decoupled while they are open, whose rare large errors when they close decide
        that comparison.
    """

    relative: float
    first_substep: float
    fast_error_floor: float
    fast_time_constant: float = 70.0
    singular_error_factor: float = 1e3
    method: Method = "Rodas4P2"
    last_stretch: float = math.inf
    balanced: bool = False


PRESETS = {
    "reference": Preset(relative=1.8e-8, first_substep=1.0, fast_error_floor=3e-3, singular_error_factor=1e2),
    "standard": Preset(
        relative=8e-6, first_substep=3.0, fast_error_floor=1e-3, method="GRK4T", last_stretch=50.0, balanced=True
    ),
    "fast": Preset(
        relative=2e-4, first_substep=8.0, fast_error_floor=2e-3, method="GRK4T", last_stretch=50.0, balanced=True
    ),
    "tight": Preset(relative=1e-10, first_substep=0.1, fast_error_floor=1.0, singular_error_factor=1.0),
}
"""``reference``: what scores are made with, 1e-6 a step. ``standard``: at least as accurate as CVODES at 1e-6, which the
benchmark's paper used. ``fast``: for training. ``tight``: to check the others against."""

LARGEST_SUBSTEPS = 20_000
"""More substeps than this in one control step are a failure of that row."""

SMALLEST_SUBSTEP = 1e-7
"""[s] A substep that would have to be shorter is a failure of that row."""


def get_preset(name: str | Preset) -> Preset:
    """Preset of that name; a preset of the caller's own is given back.

    Raises
    ------
    UnknownNameError
        When there is none.
    """
    if isinstance(name, Preset):
        return name
    if name not in PRESETS:
        msg = f"The compiled kernel has no preset '{name}'.{did_you_mean(name, PRESETS)}"
        raise UnknownNameError(msg)
    return PRESETS[name]


def tolerances(model: Model, preset: Preset) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Absolute [unit of the state] and relative tolerance of each state (states,)."""
    weights = [state.balance if preset.balanced else state.sharper for state in model.states]
    relative = np.array([preset.relative * weight for weight in weights])
    return relative * np.array([state.small for state in model.states]), relative
