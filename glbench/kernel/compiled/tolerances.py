"""How accurate a step is: tolerances of each state, presets, and the states that forget.

The error of a substep is measured in units of ``relative*|x| + absolute``, summed over the states as squares; a sum above
one is rejected. ``absolute`` is relative to the size below which a state's value means little for the others: 0.1 K,
1 mg m-3 of CO2, 10 Pa, 100 mg m-2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from glbench.errors import UnknownNameError, did_you_mean
from glbench.model import STATE_NAMES

FAST_STATES = ("co2Top", "tTop", "tCovIn", "tCovE", "tThScr", "vpTop", "tLamp", "tBlScr")
"""States that settle within a minute or so: an error made long before the end of the step is forgotten at its end."""

SINGULAR_STATES = ("tAir", "tTop")
"""The rates depend on the difference of these two like a root."""

_SMALL = {"co2Air": 1.0, "co2Top": 1.0, "vpAir": 10.0, "vpTop": 10.0} | dict.fromkeys(
    ("cBuf", "cLeaf", "cStem", "cFruit"), 100.0
)
_SMALL_TEMPERATURE = 0.1
# Thin, and all but decoupled while they are open: their rare large errors when they close decide the comparison with CVODES.
_SHARPER = {"tThScr": 0.3, "tBlScr": 0.3}
# Weights with which all states come about equally close to the errors of CVODES: found by search over 60 runs of 60 days of
# walking and of jumping controls. Vapour and the integrals of the canopy's temperature are what CVODES is best at.
_BALANCED = {
    "co2Top": 0.5,
    "tAir": 2.0,
    "tTop": 0.4,
    "vpAir": 0.4,
    "vpTop": 0.5,
    "tPipe": 0.6,
    "tThScr": 0.3,
    "tBlScr": 0.15,
    "cBuf": 0.2,
    "tCan24": 1e-3,
    "tCanSum": 1e-3,
}


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
    forgotten : float
        The least factor on the squared errors of the fast states, long before the end of the step.
    memory : float
        Time in which an error of a fast state is taken to fade to 1/e of itself [s].
    guard : float
        Factor on the squared errors of a substep that changes the difference of the singular states by more than half of its
        size. Very tight tolerances do without: with it they would ask for less than rounding.
    method : str
        ``"Rodas4P2"`` or ``"GRK4T"``, see native/rosenbrock.hpp.
    last_stretch : float
        The end of the control step that no substep enters from before [s]. GRK4T looks at nothing beyond 0.88 of a substep:
        where water begins to condense on a screen after that, the next substep mends it, and there must be one.
    balanced : bool
        Whether the states are weighted for the comparison with CVODES, or all alike but for the screens.
    """

    relative: float
    first_substep: float
    forgotten: float
    memory: float = 70.0
    guard: float = 1e3
    method: Method = "Rodas4P2"
    last_stretch: float = math.inf
    balanced: bool = False


PRESETS = {
    "reference": Preset(relative=1.8e-8, first_substep=1.0, forgotten=3e-3, guard=1e2),
    "standard": Preset(
        relative=8e-6, first_substep=3.0, forgotten=1e-3, method="GRK4T", last_stretch=50.0, balanced=True
    ),
    "fast": Preset(relative=2e-4, first_substep=8.0, forgotten=2e-3, method="GRK4T", last_stretch=50.0, balanced=True),
    "tight": Preset(relative=1e-10, first_substep=0.1, forgotten=1.0, guard=1.0),
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


def tolerances(preset: Preset) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Absolute [unit of the state] and relative tolerance of each state (28,)."""
    weights = _BALANCED if preset.balanced else _SHARPER
    relative = np.array([preset.relative * weights.get(name, 1.0) for name in STATE_NAMES])
    return relative * np.array([_SMALL.get(name, _SMALL_TEMPERATURE) for name in STATE_NAMES]), relative
