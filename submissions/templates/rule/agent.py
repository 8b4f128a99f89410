"""A greenhouse controller of rules: every control follows what is measured now.

glbench submit check FOLDER
glbench evaluate FOLDER --runs 2 --split validation
"""

import numpy as np


def ramp(value, start, full):
    """From 0 at ``start`` to 1 at ``full``, straight in between; ``full`` may be the lower one."""
    return np.clip((value - start) / (full - start), 0.0, 1.0)


class Rules:
    """Decides for all runs at once: one row a run, in and out."""

    def reset(self, task, n_runs):
        """Called before the first step: ``n_runs`` runs of ``task`` begin."""
        self.task = task
        self.column = {name: i for i, name in enumerate(task.observation_names)}

    def act(self, observations):
        """Called in every step: actions (runs, actions) for observations (runs, columns)."""

        def seen(name):
            return observations[:, self.column[name]].astype(float)

        temperature, humidity, co2 = seen("air_temperature"), seen("relative_humidity"), seen("co2")  # degC, %, ppm
        day = ramp(seen("global_radiation"), 0.0, 100.0)  # W m-2 of sun, made 0 to 1
        too_humid = ramp(humidity, 82.0, 90.0) * ramp(temperature, 15.0, 17.0)
        wanted = {
            "uBoil": ramp(temperature, 17.5 + day, 15.5 + day),
            "uCo2": day * ramp(co2, 900.0, 700.0),
            "uVent": np.maximum(too_humid, ramp(temperature, 24.0, 28.0)),
        }
        return moves(self.task, seen, wanted)


def moves(task, seen, wanted):
    """Actions that move every control towards what is ``wanted``, 0 where nothing is said: actions move controls, they do not set them."""
    actions = []
    controls = {control.name: control for control in task.controls}
    for name in task.action_names:
        now = seen(controls[name].quantity) / controls[name].at_one
        actions.append(np.clip((wanted.get(name, 0.0) - now) / task.max_change, -1.0, 1.0))
    return np.stack(actions, axis=1)


def make_agent(task):
    """Called by glbench with the public task card; returns the agent."""
    return Rules()
