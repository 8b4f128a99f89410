"""A run in words and numbers, for ``render_mode="ansi"``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from glbench.env.climate import AIR
from glbench.model import Air
from glbench.tasks.ledger import LIMITED
from glbench.tasks.prices import local_times

if TYPE_CHECKING:
    from glbench.env.simulation import Simulation
    from glbench.env.step_result import StepResult
    from glbench.model import Seen
    from glbench.tasks import TaskSpec
    from glbench.tasks.ledger import LedgerItem
    from glbench.tasks.quantities import Capacity

_CLIMATE, _CROP, _DEFICITS = "indoor_climate", "crop", "vapour_deficit"
"""Observation modules whose quantities the panel shows, of models that have them."""
_OUTSIDE = (("tOut", "air", ".1f"), ("iGlob", "sun", ".0f"), ("wind", "wind", ".1f"))
_TOO = {
    "air_temperature": ("too cold", "too warm"),
    "co2": ("too little CO2", "too much CO2"),
    "relative_humidity": ("too dry", "too humid"),
}
_CENTS = 100.0


def panel(simulation: Simulation, row: int, result: StepResult | None) -> str:
    """What a grower would want to know of one run, in a few lines; ``result`` is its last step, if it took one."""
    task = simulation.task
    model = task.model_value
    time = time_words(simulation.time[row], float(simulation.hour_of_day[row]))
    horizon = task.observation_context().horizon
    modules = {module: model.observed(module, horizon) or () for module in model.observation_modules}
    shown = {name: modules.get(name, ()) for name in (_CLIMATE, _CROP)}
    if not any(shown.values()):
        shown["state"] = next(iter(modules.values()), ())
    places = {entry.name: place for place, entry in enumerate(model.disturbances)}
    weather = ", ".join(
        f"{words} {simulation.d[row, places[name]]:{form}} {model.disturbances[places[name]].unit.replace('°C', 'degC')}"
        for name, words, form in _OUTSIDE
        if name in places
    )
    controls = ", ".join(
        _control(capacity, fraction)
        for capacity, fraction in zip(task.capacities(), simulation.u[row].tolist(), strict=True)
    )
    told = {
        "inside": _seen(simulation, row, shown[_CLIMATE]),
        "": _seen(simulation, row, modules.get(_DEFICITS, ())),
        "outside": weather,
        "controls": controls,
        "crop": _seen(simulation, row, shown[_CROP]),
        "state": _seen(simulation, row, shown.get("state", ())),
        **({} if result is None else _last_step(simulation, result, row)),
    }
    lines = [f"{task.title}: {time}, step {simulation.k[row]} of {task.steps}"]
    return "\n".join([*lines, *(f"  {name:9} {text}" for name, text in told.items() if text)])


def _seen(simulation: Simulation, row: int, columns: Sequence[Seen]) -> str:
    """Quantities that the model observes, in words."""
    task = simulation.task
    model, numbers = task.model_value, simulation.x[row].tolist()
    known = dict(zip(model.state_names, numbers, strict=True))
    if model.air:
        known |= dict(zip(AIR, simulation.air[:, row].tolist(), strict=True))

    def value(column: Seen) -> float:
        if column.of is not None:
            return float(column.of(model.State(*numbers), model.Parameters(*task.parameters().tolist())))
        if column.of_air is not None:
            return float(column.of_air(Air(*simulation.air[:, row].tolist())))
        return float(known[column.source] * column.factor)

    return ", ".join(
        f"{_words(column.name)} {value(column):.4g} {column.unit}" for column in columns if column.today is None
    )


def time_words(time: np.datetime64, hour_of_day: float) -> str:
    """A moment in UTC and, where it shows another time, on the clock of the greenhouse."""
    local = local_times(np.array([time]), np.array([hour_of_day]))[0]
    words = np.datetime_as_string(time, unit="m").replace("T", " ")
    return f"{words} UTC" if local == time else f"{words} UTC, {np.datetime_as_string(local, unit='m')[-5:]} local"


def _words(name: str) -> str:
    return name.replace("_", " ").replace("co2", "CO2")


def _control(capacity: Capacity, fraction: float) -> str:
    name = _words(capacity.quantity)
    return (
        f"{name} {fraction:.0%}" if capacity.unit == "-" else f"{name} {fraction * capacity.at_one:.3g} {capacity.unit}"
    )


def _last_step(simulation: Simulation, result: StepResult, row: int) -> dict[str, str]:
    quantities = {name: float(values[row]) for name, values in result.quantities.items()}
    ledger = simulation.task.ledger
    earned, paid = (
        [f"{_label(item)} {_CENTS * quantities[item.name]:.3f}" for item in side]
        for side in (ledger.earned, ledger.paid)
    )
    sum_of = " - ".join([" + ".join(earned) or "0", *paid])
    told = {
        "limits": _complaints(quantities) or ("all kept" if simulation.task.constraints.items() else ""),
        "this step": f"{_CENTS * quantities['epi']:+.3f} ct m-2 = {sum_of}; {_score(simulation.task, quantities)}",
    }
    reasons = [failure.reason for failure in result.failed if failure.row == row]
    return {**told, "stopped": ", ".join(reasons)}


def _score(task: TaskSpec, quantities: dict[str, float]) -> str:
    """The reward of the step; where it is money, after what violations cost."""
    if not task.scores_money:
        return f"reward {quantities['reward']:.3f}"
    violations, score = (_CENTS * quantities[name] for name in ("penalty", "reward"))
    return f"violations {violations:.3f}, score {score:+.3f}"


def _label(item: LedgerItem) -> str:
    """The item in a sentence; terminals may lack the letters of plots."""
    label = (item.label or _words(item.name)).replace("₂", "2")
    return label if label[1:2].isupper() else label.lower()


def _complaints(quantities: dict[str, float]) -> str:
    return ", ".join(
        f"{word} by {quantities[f'violation_{name}_{side}']:.3g} {unit}"
        for name, unit in LIMITED.items()
        for side, word in zip(("low", "high"), _TOO[name], strict=True)
        if quantities.get(f"violation_{name}_{side}", 0.0) > 0.0
    )
