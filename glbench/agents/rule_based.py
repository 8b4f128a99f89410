"""The rule-based controller as it was published. It is privileged: it reads the true state and future radiation.

It reads the model's state, knows the radiation sum of the day at midnight and dawn half an hour ahead, and
sets controls at once, without the rate limit that every agent works under. Its fair twin is in ``rule_based_fair``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from glbench.agents.rule_settings import RuleSettings
from glbench.agents.rules import RuleInputs, Rules
from glbench.errors import ShapeError
from glbench.model import DISTURBANCE_NAMES, STATE_NAMES, co2_ppm, relative_humidity

if TYPE_CHECKING:
    from glbench.tasks import TaskCard

Array = NDArray[np.float64]

_STATES = [STATE_NAMES.index(name) for name in ("tAir", "vpAir", "co2Air")]
_OUTSIDE = [DISTURBANCE_NAMES.index(name) for name in ("iGlob", "tOut", "dayRadSum", "isDay", "isDaySmooth")]


class RuleBasedController:
    """Rules on true state and disturbances; a ``PrivilegedController``. It remembers nothing from one step to the next."""

    privileged: Final = True

    def __init__(self, settings: RuleSettings) -> None:
        self.settings = settings
        self._rules = Rules(settings)

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """Nothing to forget: the rules look at the present step only."""

    def controls(self, x: Array, d: Array, hour_of_day: float | Array, day_of_year: float | Array, /) -> Array:
        """Controls (n, 6) for the step that begins now, fractions of capacity.

        Parameters
        ----------
        x : ndarray (n, 28)
            State at the start of the step.
        d : ndarray (n, 10) or (10,)
            Disturbance acting in the step.
        hour_of_day, day_of_year : float or ndarray (n,)
            Clock at the start of the step [h], [day], one number or one a run.

        Raises
        ------
        ShapeError
            When x or d has another shape.
        """
        return self._rules.controls(privileged_inputs(x, d, hour_of_day, day_of_year))


def privileged_inputs(x: Array, d: Array, hour_of_day: float | Array, day_of_year: float | Array) -> RuleInputs:
    """What the rules look at, taken from state (n, 28) and disturbance (n, 10) or (10,); clock as one number or one a run."""
    n = x.shape[0] if x.ndim == 2 else -1
    if (
        x.ndim != 2
        or x.shape[1] != len(STATE_NAMES)
        or d.shape not in ((n, len(DISTURBANCE_NAMES)), (len(DISTURBANCE_NAMES),))
    ):
        msg = f"Expected states of shape (n, 28) and disturbances (n, 10) or (10,), got {x.shape} and {d.shape}."
        raise ShapeError(msg)
    # Rows of arrays of their own: numpy may take another path, with another last bit, through the columns of a larger array.
    states = np.empty((3, n))
    states[:] = x.T[_STATES]
    air_temperature, vapour_pressure, co2_density = states
    outside = d[_OUTSIDE].tolist() if d.ndim == 1 else np.ascontiguousarray(d.T[_OUTSIDE])
    radiation, outdoor_temperature, day_radiation_sum, is_day, is_day_smooth = outside
    return RuleInputs(
        air_temperature=air_temperature,
        relative_humidity=np.asarray(relative_humidity(air_temperature, vapour_pressure)),
        co2=np.asarray(co2_ppm(air_temperature, co2_density)),
        radiation=radiation,
        outdoor_temperature=outdoor_temperature,
        day_radiation_sum=day_radiation_sum,
        is_day=is_day,
        is_day_smooth=is_day_smooth,
        hour_of_day=hour_of_day,
        day_of_year=day_of_year,
    )
