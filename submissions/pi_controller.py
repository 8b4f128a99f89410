"""Two PI controllers, one for heating and one for the vents, with a memory of each run and anti-windup.

A PI controller adds to the error what the error has summed up to. While the output is at its limit that sum would grow without
effect ("wind up") and the controller would come back late; here the integrator stands still then.
"""

import numpy as np


class PI:
    """PI controller for many runs at once: one integrator a run, output within 0 and 1."""

    def __init__(self, n_runs, gain, integral_hours, step_hours):
        self.gain = gain  # output per unit of error
        self.share = step_hours / integral_hours  # of the proportional action that is added to the integral in a step
        self.integral = np.zeros(n_runs)

    def __call__(self, error):
        """Output (n_runs,) for the error (n_runs,), and a step of the integral."""
        proportional = self.gain * error
        wanted = proportional + self.integral
        output = np.clip(wanted, 0.0, 1.0)
        # Anti-windup: integrate unless the output is at a limit and the error pushes further into it.
        pushing = (wanted > 1.0) & (error > 0.0) | (wanted < 0.0) & (error < 0.0)
        self.integral = np.clip(self.integral + np.where(pushing, 0.0, self.share * proportional), 0.0, 1.0)
        return output


class PIAgent:
    """Heats to a set point, vents to a humidity and a temperature, doses CO2 by day."""

    def reset(self, task, n_runs):
        """Called before the first step: the integrators of all runs start at 0."""
        self.task = task
        self.column = {name: i for i, name in enumerate(task.observation_names)}
        step_hours = task.step_seconds / 3600.0
        # The controls follow with a rate limit of an hour or two, so the integrals must be slower than that.
        self.heating = PI(n_runs, gain=0.3, integral_hours=4.0, step_hours=step_hours)
        self.venting = PI(n_runs, gain=0.06, integral_hours=4.0, step_hours=step_hours)

    def act(self, observations):
        """Called in every step: actions (runs, actions) for observations (runs, observations)."""

        def seen(name):
            return observations[:, self.column[name]].astype(float)

        temperature, humidity = seen("air_temperature"), seen("relative_humidity")
        day = (seen("global_radiation") > 20.0).astype(float)
        # Vents shut when it gets cold, whatever the humidity; the integrator learns of it through a negative error.
        too_humid = np.where(temperature > 15.5, humidity - 84.0, -10.0)
        wanted = {
            "uBoil": self.heating(16.5 + day - temperature),
            "uCo2": day * np.clip((800.0 - seen("co2")) / 200.0, 0.0, 1.0),
            "uThScr": np.zeros_like(day),
            "uVent": self.venting(np.maximum(too_humid, 5.0 * (temperature - 26.0))),
            "uLamp": np.zeros_like(day),
            "uBlScr": np.zeros_like(day),
        }
        now = {control.name: seen(control.quantity) / control.at_one for control in self.task.controls}
        changes = [(wanted[name] - now[name]) / self.task.max_change for name in self.task.action_names]
        return np.clip(np.stack(changes, axis=1), -1.0, 1.0)


def make_agent(task):
    """Called by glbench with the public task card; returns the agent."""
    return PIAgent()
