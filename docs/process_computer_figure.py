"""Draws docs/images/process-computer-day.png: a day at the process computer, ``python -m docs.process_computer_figure``.

It needs matplotlib (``glbench[video]``). The grower of ``baselines/grower`` enters the set points, in the paper's greenhouse and spring,
with sensors that do not err.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from glbench.agents.grower import GrowerAgent, read_grower_settings
from glbench.env import Simulation
from glbench.env.scenario import RunScenarios
from glbench.model import humidity_deficit
from glbench.tasks import get_task, task_card

BASE, SEED, DAY = "Schiphol2010-Delta10-v1", 1, 24
SETTINGS = Path(__file__).resolve().parents[1] / "baselines" / "grower" / "settings.toml"
INK, RED, BLUE, GREEN, GOLD, GREY = "#222222", "#c23b22", "#1f6fb4", "#2e8b57", "#d9a000", "#888888"


def course() -> dict[str, np.ndarray]:
    """The day, step by step: what is measured and asked for at its start, and what is in force during it."""
    task = get_task(BASE).replace(schema=2, actuation={"kind": "process_computer"}, weather={"preprocessing": "conserving"})
    agent, simulation = GrowerAgent(read_grower_settings(SETTINGS)), Simulation(task, 1)
    places, set_points = RunScenarios(task).slots.of("actuation"), task.actions
    agent.reset(task_card(task), 1)
    observations = simulation.reset([SEED])
    rows: list[dict[str, float]] = []
    for _ in range((DAY + 1) * task.steps_per_day):
        actions = agent.act(observations)
        temperature, co2, humidity = simulation.air[:, 0].tolist()
        row = {one.name: one.value(given) for one, given in zip(set_points, actions[0].tolist(), strict=True)}
        row |= {"hour": float(simulation.hour_of_day[0]), "air": temperature, "co2": co2}
        row |= {"outside": float(simulation.d[0, 1]), "radiation": float(simulation.d[0, 0])}
        row["deficit"] = float(humidity_deficit(temperature, humidity))
        observations = simulation.step(actions).observations
        memory = simulation.snapshot().memory[0]
        row |= {"heating": float(memory[places["heating_temperature"]])}
        row |= {"ventilation": float(memory[places["ventilation_temperature"]])}
        row |= dict(zip(task.model_value.control_names, simulation.u[0].tolist(), strict=True))
        rows.append(row)
    day = rows[-task.steps_per_day :]
    return {name: np.array([row[name] for row in day]) for name in day[0]}


def draw(day: dict[str, np.ndarray]) -> Figure:
    """Four panels over the hours of the day."""
    figure = Figure(figsize=(9.0, 9.2), dpi=110, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    temperature, gas, humidity, positions = figure.subplots(4, 1, sharex=True)
    hour = day["hour"]

    def line(axes: object, name: str, label: str, colour: str, **style: object) -> None:
        axes.plot(hour, day[name], label=label, color=colour, **({"lw": 1.6} | style))  # type: ignore[attr-defined]

    def steps(axes: object, name: str, label: str, colour: str, **style: object) -> None:
        line(axes, name, label, colour, drawstyle="steps-post", **style)

    temperature.fill_between(hour, day["heating"], day["ventilation"], color="#eeeeee", step="post")
    line(temperature, "air", "air", INK, lw=2.0)
    steps(temperature, "heating", "heating temperature in force", RED)
    steps(temperature, "heating_temperature", "asked for", RED, lw=0.9, ls=":")
    steps(temperature, "ventilation", "ventilation temperature in force", BLUE)
    steps(temperature, "ventilation_temperature", "asked for", BLUE, lw=0.9, ls=":")
    line(temperature, "outside", "outside", GREY, lw=1.0)
    temperature.set_ylabel("temperature [°C]")
    line(gas, "co2", "CO2", INK, lw=2.0)
    steps(gas, "co2_set_point", "set point", GREEN)
    gas.set_ylabel("CO2 [ppm]")
    line(humidity, "deficit", "humidity deficit", INK, lw=2.0)
    steps(humidity, "humidity_deficit", "set point", BLUE)
    humidity.set_ylabel("deficit [g m-3]")
    for name, label, colour in (
        ("uBoil", "boiler", RED), ("uVent", "vents", BLUE), ("uCo2", "CO2", GREEN), ("uThScr", "thermal screen", GREY),
    ):  # fmt: skip
        steps(positions, name, label, colour)
    positions.set_ylabel("control [-]")
    positions.set_ylim(-0.03, 1.03)
    positions.set_xlabel("hour of the day")
    positions.set_xlim(0.0, 24.0)
    positions.set_xticks(range(0, 25, 3))
    sun = positions.twinx()
    sun.fill_between(hour, day["radiation"], color=GOLD, alpha=0.25, lw=0.0, label="radiation outside")
    sun.set_ylabel("radiation [W m-2]")
    sun.set_ylim(0.0, 1000.0)
    for axes in (temperature, gas, humidity, positions):
        axes.grid(color="#dddddd", lw=0.6)
        axes.legend(fontsize=7.5, loc="upper left", bbox_to_anchor=(1.11, 1.0), frameon=False)
    return figure


if __name__ == "__main__":
    draw(course()).savefig(Path(__file__).with_name("images") / "process-computer-day.png")
