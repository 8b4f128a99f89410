"""Constant set points: one temperature, one CO2 level, one humidity, day and night, and nothing else.

An example of an agent for a single run. It says ``single_run = True``; glbench then makes one for each run, and each sees only
its own observation: a row of numbers, plain ``if`` and ``float`` all the way.
"""

import numpy as np

HEAT_BELOW = 17.0  # degC
VENT_ABOVE = 26.0  # degC
DRY_ABOVE = 84.0  # %, open the vents a little and heat against the cold
COLDEST = 15.5  # degC, no venting below
CO2 = 700.0  # ppm by day


class ConstantSetPoints:
    """Switches: full on when a value is on the wrong side of its set point, off otherwise."""

    single_run = True

    def reset(self, task):
        """Called before the first step of the run."""
        self.task = task
        self.column = {name: i for i, name in enumerate(task.observation_names)}

    def act(self, observation):
        """Called in every step: the action (actions,) for the observation (observations,) of this run."""

        def seen(name):
            return float(observation[self.column[name]])

        temperature, humidity = seen("air_temperature"), seen("relative_humidity")
        too_humid = humidity > DRY_ABOVE and temperature > COLDEST
        wanted = {
            "uBoil": 1.0 if temperature < HEAT_BELOW else 0.0,
            "uCo2": 1.0 if seen("co2") < CO2 and seen("global_radiation") > 20.0 else 0.0,
            "uThScr": 0.0,
            "uVent": 1.0 if temperature > VENT_ABOVE else 0.3 if too_humid else 0.0,
            "uLamp": 0.0,
            "uBlScr": 0.0,
        }
        # The rate limit turns every switch into a slope: a control moves by a tenth of its range a step at most.
        now = {control.name: seen(control.quantity) / control.at_one for control in self.task.controls}
        changes = [(wanted[name] - now[name]) / self.task.max_change for name in self.task.action_names]
        return np.clip(changes, -1.0, 1.0)


def make_agent(task):
    """Called by glbench once a run, because the agent is one for a single run."""
    return ConstantSetPoints()
