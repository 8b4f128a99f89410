"""A greenhouse controller to start from.

Copy this file, change it, and see what it earns:

    glbench evaluate submissions/my_agent.py --runs 2

docs/submit.md tells the rest. The file needs numpy only. Every submission has a function make_agent(task), as at the end here.
"""

import numpy as np


def ramp(value, start, full):
    """From 0 at ``start`` to 1 at ``full``, straight in between; ``full`` may be the lower one."""
    return np.clip((value - start) / (full - start), 0.0, 1.0)


class MyAgent:
    """Proportional control: every control follows what is measured now, without memory."""

    def reset(self, task, n_runs):
        """Called before the first step: ``n_runs`` runs of ``task`` begin."""
        # The task card says what is where. To see all columns of the observation:
        #     for quantity in task.observations: print(quantity.name, quantity.unit, quantity.meaning)
        self.task = task
        self.column = {name: i for i, name in enumerate(task.observation_names)}
        self.controls = {control.name: control for control in task.controls}

    def act(self, observations):
        """Called in every step: actions (runs, actions) for observations (runs, observations)."""

        # observations[run, column]: all runs are decided at once, so every value below is an array with one number a run.
        def seen(name):
            return observations[:, self.column[name]].astype(float)

        temperature = seen("air_temperature")  # degC, should stay within 15 and 34
        humidity = seen("relative_humidity")  # %, should stay within 50 and 85: the limit that is broken most
        co2 = seen("co2")  # ppm, should stay within 300 and 1600
        light = ramp(seen("global_radiation"), 0.0, 100.0)  # W m-2 of sun outside, made 0 (night) to 1 (day)
        cold_outside = ramp(seen("outdoor_temperature"), 16.0, 10.0)
        warm_enough = ramp(temperature, 15.0, 17.0)

        # A task may show a forecast. With it, the day begins two hours before the sun does: warm air is drier, and plants wake up dry.
        day = light
        for coming in ("global_radiation_in_1h", "global_radiation_in_2h"):
            if coming in self.column:
                day = np.maximum(day, ramp(seen(coming), 0.0, 100.0))

        # What we want: fractions of what is installed. 1 is full power, a closed screen, an open vent.
        wanted = {
            "uBoil": ramp(temperature, 17.5 + 2.0 * day, 15.5 + 2.0 * day),  # two degrees warmer by day
            "uCo2": light * ramp(co2, 900.0, 700.0),  # without light, plants cannot use it
            "uThScr": (1.0 - light) * cold_outside * ramp(humidity, 92.0, 86.0),
            "uVent": np.maximum(ramp(humidity, 80.0, 88.0) * warm_enough, ramp(temperature, 26.0, 30.0)),
            "uLamp": np.zeros_like(light),  # lamps cost more than they earn at these prices. Or do they?
            "uBlScr": np.zeros_like(light),  # keeps lamp light inside at night
        }

        # How we get there. An action does not set a control, it moves it: -1 and 1 by max_change (a tenth) a step of 15 minutes,
        # 0 not at all. From shut to open takes ten steps. The controls in force are observed in W m-2, mg m-2 s-1 and so on.
        actions = np.zeros((len(observations), len(self.task.actions)))
        for i, name in enumerate(self.task.action_names):
            now = seen(self.controls[name].quantity) / self.controls[name].at_one
            actions[:, i] = np.clip((wanted[name] - now) / self.task.max_change, -1.0, 1.0)
        return actions


def make_agent(task):
    """Called by glbench with the public task card; returns the agent."""
    return MyAgent()
