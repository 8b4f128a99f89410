"""Optimal control of a task: what an optimiser needs of it.

``StageReward`` is the reward of each step of a trajectory with its gradient, ``air_of`` the air along it, ``Scenario`` everything that is
given in a run. The steps themselves and their derivatives are in ``glbench.kernel``.
"""

from __future__ import annotations

from glbench.control.air import AirAlong, air_of
from glbench.control.scenario import Scenario
from glbench.control.season import Iteration, SeasonPlan, feasible, plan_season
from glbench.control.stage import StageGradient, StageReward, StageValues

__all__ = [
    "AirAlong",
    "Iteration",
    "Scenario",
    "SeasonPlan",
    "StageGradient",
    "StageReward",
    "StageValues",
    "air_of",
    "feasible",
    "plan_season",
]
