"""Where the greenhouse is, from what an agent sees: an extended Kalman filter of states, parameters and sensors.

A run is not quite the nominal model, and its task says by how much: parameters and start are drawn, sensors are off. All of it is public,
and makes the filter's covariances; nothing is left to tune but a small error of the model itself.

The filter estimates, for every run,

- the states x, stepped by the kernel with its Jacobians;
- the relative deviation of every parameter that the task draws for the episode, constant, and of those that it draws daily, which are
  forgotten within a day;
- how far an unseen column of the weather is off (``UNSEEN``), which is forgotten within hours;
- bias and drift of every sensor: a reading is truth + noise + bias + drift k / N in step k of N, as ``glbench.env.sensors`` makes it.

Parameters drawn anew in each step are noise on the states along the derivatives of the step. A reading that is exactly the last one
comes from a sensor that hangs, and is left out. Measured columns are taken one after the other in Joseph's form.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glbench.control.shown import ShownControls, ShownStates, checked_observations
from glbench.env.scenario import DerivedParameters  # noqa: F401
from glbench.env.sensors import Sensors
from glbench.env.spaces import the_task
from glbench.env.uncertainty import DISTRIBUTIONS
from glbench.errors import ShapeError, StepError, TaskError, whole_number
from glbench.kernel import Kernel

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec
    from glbench.tasks.scenario import ParameterGroup

Floats = NDArray[np.float64]

UNSEEN = {"tSky": (3.0, 6.0)}
"""Standard deviation [its unit] of what ``Outlook`` says of a column of the weather that nobody sees, and the hours in which the error
fades to 1/e."""
MODEL_ERROR = 1e-4
"""Standard deviation of the error that a step makes in each state, as a share of the state's size."""
START_ERROR = 5e-3
"""The same of the start, for states whose start the task does not draw."""
ROUNDING = 2.0**-22
"""Relative standard deviation of a column that is observed as it is: the rounding of float32, four times."""
"""Hours in which a parameter that is drawn daily is forgotten to 1/e."""
_A_DAY = 24.0
_GRID = (np.arange(4096) + 0.5) / 4096.0


class StateEstimator:
    """Estimates the states of runs of a task from their observations, step by step.

    It knows what its agent knows: the task, observations and the weather of the step just past. It works inside the sandbox.

        outlook, estimator = Outlook(task, climatology), StateEstimator(task)
        outlook.reset(n), estimator.reset(n)
        ... in every call of ``act(observations)``:
        outlook.update(observations)
        states = estimator.update(observations, outlook.past)

    Parameters
    ----------
    task
        The task, or its id.
    preset
        The kernel's preset.
    parameters
        Whether to estimate parameters that the task draws for the episode; without, their deviations act as noise of the states.

    Attributes
    ----------
    states
        Estimates ``(n, s)`` after the last update.
    parameters
        Parameters ``(n, p)`` as estimated, derived ones made to fit; nominal where the task draws none.
    deviations
        Standard deviations of ``states`` by the filter's own account ``(n, s)``.

    Raises
    ------
    TaskError
        When the task shows nothing of its states.
    """

    def __init__(self, task: TaskSpec | str, *, preset: str = "fast", parameters: bool = True) -> None: ...
    def reset(self, n: int) -> None:
        """Begin with ``n`` new runs."""
    def update(self, observations: ArrayLike, d: ArrayLike, controls: ArrayLike | None = None) -> Floats:
        """Take in what is observed now; once at the start, before the first action, and once after every step.

        Parameters
        ----------
        observations
            ``(n, columns)``, as an agent gets them.
        d
            Disturbances ``(n, d)`` of the step just past; at the first call those of the step to come, from which the start follows:
            ``Outlook.past`` is both.
        controls
            Controls in force in the step just past ``(n, c)``, fractions; read from the observations where the task shows them.

        Returns
        -------
        ndarray
            States ``(n, s)``, a new array.

        Raises
        ------
        TaskError
            When observations have the wrong shape, or controls are neither given nor shown.
        """
