"""The environment: observations, actuation, uncertainty and reward around the kernel, for one greenhouse or many.

``GreenhouseEnv`` and ``GreenhouseVectorEnv`` are for Gymnasium, ``Simulation`` is what both of them and the evaluation step.
See docs/environment.md.
"""

from typing import TYPE_CHECKING

from glbench.env.accounts import QUANTITIES, Accounts, make_accounts
from glbench.env.actuation import ACTUATIONS, register_actuation
from glbench.env.numpy_environments import ObservationInputs
from glbench.env.observations import register_observation
from glbench.env.rewards import REWARDS, StepOutcome, register_reward
from glbench.env.scenario import RunWeather, run_weather, run_years, season_names
from glbench.env.simulation import Simulation, StepResult
from glbench.env.snapshot import Snapshot
from glbench.env.uncertainty import DISTRIBUTIONS, register_distribution
from glbench.env.weather_pool import WeatherTables
from glbench.extras import lazy_names
from glbench.tasks.ledger import StepQuantity

if TYPE_CHECKING:
    from glbench.env.greenhouse import GreenhouseEnv
    from glbench.env.info import info_quantities
    from glbench.env.vector import GreenhouseVectorEnv
else:
    __getattr__ = lazy_names(__name__, {"greenhouse": ("GreenhouseEnv",), "info": ("info_quantities",), "vector": ("GreenhouseVectorEnv",)})

__all__ = [
    "ACTUATIONS",
    "DISTRIBUTIONS",
    "QUANTITIES",
    "REWARDS",
    "Accounts",
    "GreenhouseEnv",
    "GreenhouseVectorEnv",
    "ObservationInputs",
    "RunWeather",
    "Simulation",
    "Snapshot",
    "StepOutcome",
    "StepQuantity",
    "StepResult",
    "WeatherTables",
    "info_quantities",
    "make_accounts",
    "register_actuation",
    "register_distribution",
    "register_observation",
    "register_reward",
    "run_weather",
    "run_years",
    "season_names",
]
