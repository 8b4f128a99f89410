"""One page of set points for the whole season, for tasks in which a process computer works the actuators.

glbench evaluate submissions/setpoints.py --task SpringSetpoints-v1
"""

import numpy as np

# Whatever is not named stays idle: no lamps. `glbench tasks show SpringSetpoints-v1` lists all set points with their units.
PAGE = {
    "heating_temperature": 17.5,  # degC: the air is heated below it
    "ventilation_temperature": 24.0,  # degC: the vents open above it
    "co2_set_point": 700.0,  # ppm: dosed below it, in light, as far as the vents are shut
    "humidity_deficit": 2.7,  # g m-3: below it minimum heat, a gap in vents and screen
    "screen_radiation_limit": 40.0,  # W m-2: the thermal screen is closed when it is darker than that ...
    "screen_outdoor_temperature": 14.0,  # degC: ... and colder outside than this
}


class Page:
    """The same set points for all runs in every step."""

    def reset(self, task, n_runs):
        """Called before the first step."""
        # An action is a number from -1 to 1: `of` turns a set point into it.
        actions = [one.of(PAGE[one.name]) if one.name in PAGE else one.idle for one in task.actions]
        self.actions = np.tile(actions, (n_runs, 1))

    def act(self, observations):
        """Called in every step."""
        return self.actions


def make_agent(task):
    """Called by glbench once."""
    unknown = sorted(PAGE.keys() - set(task.action_names))
    if unknown:
        msg = (
            f"{task.id} has no set point '{unknown[0]}'; it has {', '.join(task.action_names)}. Correct the name, or choose a "
            "task that has it, such as SpringSetpoints-v1 (--task)."
        )
        raise ValueError(msg)
    return Page()
