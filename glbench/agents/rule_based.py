"""The rule-based controller as it was published: privileged, because it knows what no greenhouse knows.

It reads the model's state, is told at midnight how much sun the day will bring and half an hour ahead when it will dawn, and
sets controls at once, without the rate limit that every agent works under. Its fair twin is in ``rule_based_fair``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from glbench.agents.rule_settings import RuleSettings
from glbench.agents.rules import RuleInputs, rule_controls
from glbench.errors import ShapeError
from glbench.model import DISTURBANCE_NAMES, STATE_NAMES, co2_ppm, relative_humidity

if TYPE_CHECKING:
    from glbench.tasks import TaskCard

Array = NDArray[np.float64]


class RuleBasedController:
    """Rules on true state and disturbances; a ``PrivilegedController``. It remembers nothing from one step to the next."""

    privileged: Final = True

    def __init__(self, settings: RuleSettings) -> None:
        self.settings = settings

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
        return rule_controls(privileged_inputs(x, d, hour_of_day, day_of_year), self.settings)


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
    d = np.broadcast_to(d, (n, len(DISTURBANCE_NAMES)))

    def state(name: str) -> Array:
        return _column(x, STATE_NAMES.index(name))

    def disturbance(name: str) -> Array:
        return _column(d, DISTURBANCE_NAMES.index(name))

    air_temperature = state("tAir")
    return RuleInputs(
        air_temperature=air_temperature,
        relative_humidity=np.asarray(relative_humidity(air_temperature, state("vpAir"))),
        co2=np.asarray(co2_ppm(air_temperature, state("co2Air"))),
        radiation=disturbance("iGlob"),
        outdoor_temperature=disturbance("tOut"),
        day_radiation_sum=disturbance("dayRadSum"),
        is_day=disturbance("isDay"),
        is_day_smooth=disturbance("isDaySmooth"),
        hour_of_day=np.full(n, hour_of_day),
        day_of_year=np.full(n, day_of_year),
    )


def _column(table: Array, index: int) -> Array:
    # Contiguous, because numpy may take another path, with another last bit, through the columns of a larger array.
    return np.array(table[:, index], dtype=np.float64, order="C")
