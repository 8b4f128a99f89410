"""The greenhouse in words and numbers, for ``render_mode="ansi"``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from glbench.model import DISTURBANCE_NAMES, STATE_NAMES
from glbench.tasks.quantities import LIMITED

if TYPE_CHECKING:
    from glbench.env.simulation import Simulation
    from glbench.env.step_result import StepResult
    from glbench.tasks.quantities import Capacity

_RADIATION, _OUTSIDE, _WIND = (DISTURBANCE_NAMES.index(name) for name in ("iGlob", "tOut", "wind"))
_PIPE, _FRUIT = STATE_NAMES.index("tPipe"), STATE_NAMES.index("cFruit")
_TOO = {
    "air_temperature": ("too cold", "too warm"),
    "co2": ("too little CO2", "too much CO2"),
    "relative_humidity": ("too dry", "too humid"),
}


def panel(simulation: Simulation, row: int, result: StepResult | None) -> str:
    """What a grower would want to know of one run, in a few lines; ``result`` is its last step, if it took one."""
    task, weather = simulation.task, simulation.d[row]
    state = simulation.x[row]
    temperature, co2, humidity = simulation.air[:, row].tolist()
    time = np.datetime_as_string(simulation.time[row], unit="m").replace("T", " ")
    controls = ", ".join(
        _control(capacity, fraction)
        for capacity, fraction in zip(task.capacities(), simulation.u[row].tolist(), strict=True)
    )
    lines = [
        f"{task.title}: {time} UTC, step {simulation.k[row]} of {task.steps}",
        f"  inside    air {temperature:.1f} degC, CO2 {co2:.0f} ppm, humidity {humidity:.0f} %, pipes {state[_PIPE]:.0f} degC",
        f"  outside   air {weather[_OUTSIDE]:.1f} degC, sun {weather[_RADIATION]:.0f} W m-2, wind {weather[_WIND]:.1f} m s-1",
        f"  controls  {controls}",
        f"  crop      {state[_FRUIT] / 1000:.1f} g m-2 of fruit (dry)",
    ]
    if result is not None:
        lines += _last_step(result, row)
    return "\n".join(lines)


def _control(capacity: Capacity, fraction: float) -> str:
    name = capacity.quantity.replace("_", " ").replace("co2", "CO2")
    return (
        f"{name} {fraction:.0%}" if capacity.unit == "-" else f"{name} {fraction * capacity.at_one:.3g} {capacity.unit}"
    )


def _last_step(result: StepResult, row: int) -> list[str]:
    quantities = {name: float(values[row]) for name, values in result.quantities.items()}
    euros = {name: 100 * quantities[name] for name in ("epi", "revenue", "cost_heat", "cost_electricity", "cost_co2")}
    lines = [
        f"  limits    {_complaints(quantities) or 'all kept'}",
        f"  this step {euros['epi']:+.3f} ct m-2 = fruit {euros['revenue']:.3f} - heat {euros['cost_heat']:.3f}"
        f" - electricity {euros['cost_electricity']:.3f} - CO2 {euros['cost_co2']:.3f}; reward {quantities['reward']:.3f}",
    ]
    lines += [f"  stopped   {failure.reason}" for failure in result.failed if failure.row == row]
    return lines


def _complaints(quantities: dict[str, float]) -> str:
    return ", ".join(
        f"{word} by {quantities[f'violation_{name}_{side}']:.3g} {unit}"
        for name, unit in LIMITED.items()
        for side, word in zip(("low", "high"), _TOO[name], strict=True)
        if quantities[f"violation_{name}_{side}"] > 0.0
    )
