"""Optimal control of a task: what an optimiser needs of it.

``StageReward`` is the reward of each step of a trajectory with its gradient, ``air_of`` the air along it, ``Scenario`` everything that is
given in a run. ``plan_season`` plans a run in which everything is known, ``PredictiveController`` the hours ahead, again and again.
The steps themselves and their derivatives are in ``glbench.kernel``.
"""

from glbench.control.climatology import Climatology
from glbench.control.disturbance_forecast import Ahead, Outlook
from glbench.control.estimator import StateEstimator
from glbench.control.mpc import PredictiveController
from glbench.control.scenario import Scenario, with_schedule
from glbench.control.season import EndValue, Iteration, SeasonPlan, plan_season
from glbench.control.stage import AirAlong, StageGradient, StageReward, StageValues, air_of
from glbench.control.trust_region import feasible
from glbench.env.actuation import actions_of

__all__ = [
    "Ahead",
    "AirAlong",
    "Climatology",
    "EndValue",
    "Iteration",
    "Outlook",
    "PredictiveController",
    "Scenario",
    "SeasonPlan",
    "StageGradient",
    "StageReward",
    "StageValues",
    "StateEstimator",
    "actions_of",
    "air_of",
    "feasible",
    "plan_season",
    "with_schedule",
]
