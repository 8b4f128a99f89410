"""The least one can do: no heat, no CO2, no light, vents and screens shut, for the whole season.

It is the zero of normalised scores: an agent that earns less than this one does harm.
"""

import numpy as np


class DoNothing:
    """All runs at once: leaves every control where a season starts, at 0."""

    def reset(self, task, n_runs):
        """Called before the first step."""
        self.actions = np.zeros((n_runs, len(task.action_names)))

    def act(self, observations):
        """Called in every step: a change of 0 for the actuation ``rate``, a set point of 0 for ``set_point``."""
        return self.actions


def make_agent(task):
    """Called by glbench once."""
    return DoNothing()
