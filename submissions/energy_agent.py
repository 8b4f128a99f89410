"""A controller to start from where power has a price for every hour: lamps, gas engine and heat buffer (the suite "energy").

Copy this file, change it, and see what it earns:

    glbench evaluate submissions/energy_agent.py --task SpringEnergy-v1 --split validation --runs 2

It keeps the climate as my_agent.py does. docs/energy.md explains the equipment, docs/prices.md the prices. The file needs numpy only.
"""

import numpy as np


def ramp(value, start, full):
    """From 0 at ``start`` to 1 at ``full``, straight in between; ``full`` may be the lower one."""
    return np.clip((value - start) / (full - start), 0.0, 1.0)


class EnergyAgent:
    """Proportional control of the climate; lamps and engine by the price of power, the boiler by day for its CO2."""

    def reset(self, task, n_runs):
        """Called before the first step: ``n_runs`` runs of ``task`` begin."""
        self.task = task
        self.column = {name: i for i, name in enumerate(task.observation_names)}
        self.controls = {control.name: control for control in task.controls}

    def act(self, observations):
        """Called in every step: actions (runs, actions) for observations (runs, observations)."""

        def seen(name):
            return observations[:, self.column[name]].astype(float)

        temperature = seen("air_temperature")  # degC, should stay within 15 and 34
        humidity = seen("relative_humidity")  # %, should stay within 50 and 85
        sun = seen("global_radiation")  # W m-2, outside
        lamps = seen("lamps") / self.controls["uLamp"].at_one  # from 0 to 1
        light = ramp(sun + 150.0 * lamps, 0.0, 100.0)
        cold_outside = ramp(seen("outdoor_temperature"), 16.0, 10.0)
        heat = ramp(temperature, 17.5 + 2.0 * light, 15.5 + 2.0 * light)
        dose = light * ramp(seen("co2"), 900.0, 700.0)

        wanted = {
            "uBoil": heat,
            "uCo2": dose,
            "uThScr": (1.0 - ramp(sun, 0.0, 100.0)) * cold_outside * ramp(humidity, 92.0, 86.0),
            "uVent": np.maximum(
                ramp(humidity, 80.0, 88.0) * ramp(temperature, 15.0, 17.0), ramp(temperature, 26.0, 30.0)
            ),
            "uLamp": np.zeros_like(light),
            "uBlScr": np.zeros_like(light),
        }

        # Lamps are on while a kWh [EUR] costs less than the fruit that it makes, some 0.12 kg. Where the price of fruit is not shown (in
        # spring, when the sun makes the fruit), they stay off.
        if "price_fruit" in self.column:
            wanted["uLamp"] = (seen("price_power") < 0.12 * seen("price_fruit")) * (sun < 300.0)

        # With engine and buffer, heat goes into the pipes from the buffer. The engine runs while power is worth more than the gas, as
        # long as the buffer has room; the boiler burns by day for the CO2 in its flue gas, and at night when the buffer is empty.
        if "buffer_share" in self.column:
            share = seen("buffer_share")  # %, how full the buffer is
            engine = (seen("price_power") > 0.06) & (share < 90.0)
            wanted["uPipe"] = heat
            wanted["uChp"] = 1.0 * engine
            wanted["uBoil"] = np.maximum(0.5 * dose * (share < 90.0) * ~engine, heat * (share < 10.0))

        # An action moves its control by up to max_change, a tenth, in a step of 15 minutes.
        actions = np.zeros((len(observations), len(self.task.actions)))
        for i, name in enumerate(self.task.action_names):
            now = seen(self.controls[name].quantity) / self.controls[name].at_one
            actions[:, i] = np.clip((wanted[name] - now) / self.task.max_change, -1.0, 1.0)
        return actions


def make_agent(task):
    """Called by glbench with the public task card; returns the agent."""
    return EnergyAgent()
