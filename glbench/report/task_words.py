"""A task's definition in words, part after part, and the figures that the page computes with."""

from __future__ import annotations

import datetime as dt
from typing import Any

from glbench.env.accounts import make_accounts
from glbench.errors import GlbenchError
from glbench.tasks import ACTUATION_KINDS, INITIAL_STATES, MODEL_VARIANTS, PREPROCESSINGS, TaskSpec
from glbench.weather import WeatherRecord

CONTROL_LABELS = {
    "uBoil": "Heating",
    "uCo2": "CO₂ dosing",
    "uThScr": "Thermal screen",
    "uVent": "Vents",
    "uLamp": "Lamps",
    "uBlScr": "Blackout screen",
}
LIMIT_LABELS = {"air_temperature": "Air temperature", "co2": "CO₂", "relative_humidity": "Relative humidity"}
UNITS = {"degC": "°C", "W m-2": "W/m²", "mg m-2 s-1": "mg/m²/s", "-": ""}
_MODULE_WORDS = {
    "indoor_climate": "air temperature, CO₂ and humidity inside, pipe temperature",
    "crop": "fruit mass, 24-hour mean canopy temperature, temperature sum",
    "time": "time of day and of year",
    "controls": "the six controls as they stand",
    "weather": "sun, temperature, humidity, CO₂ and wind outside",
}


def definition_in_words(task: TaskSpec) -> list[tuple[str, list[str]]]:
    """Headings, each with sentences."""
    return [
        ("When and where", _period(task)),
        ("Greenhouse and crop", _greenhouse(task)),
        ("What is uncertain", [_uncertainty(task)]),
        ("What the agent sees", _seen(task)),
        ("What the agent does", [_done(task)]),
        ("What counts", _reward(task)),
    ]


def figures(task: TaskSpec) -> dict[str, Any]:
    """Limits, prices, capacities, and what the reward needs to be computed again at other prices."""
    accounts = make_accounts(task)
    heat, electricity, co2 = accounts.full_use.ravel().tolist()
    scale = dict(task.reward.penalty_scale.items())
    prices = task.prices
    return {
        "limits": [
            {
                "name": name, "label": LIMIT_LABELS[name], "unit": UNITS.get(limits.unit, limits.unit),
                "low": limits.low, "high": limits.high, "scale": scale[name],
            }
            for name, limits in task.constraints.items()
        ],
        "prices": {"fruit": prices.fruit, "heat": prices.heat, "electricity": prices.electricity, "co2": prices.co2},
        "dry_matter_content": prices.dry_matter_content,
        "reward_modules": list(task.reward.modules),
        "full_use": {"heat": heat, "electricity": electricity, "co2": co2},
        "full_growth": float(accounts.full_growth[0]),
        "failed_step": task.evaluation.failed_step.model_dump(),
        "capacities": [
            {"name": c.name, "label": CONTROL_LABELS[c.name], "unit": UNITS.get(c.unit, c.unit), "at_one": c.at_one, "meaning": c.meaning}
            for c in task.capacities()
        ],
    }  # fmt: skip


def clock_of(task: TaskSpec) -> str:
    """The clock that the hours of the day are of."""
    record = _record(task)
    return "UTC" if task.weather.preprocessing == "paper" or record is None else record.timezone


def _record(task: TaskSpec) -> WeatherRecord | None:
    """The weather record, where it is installed: a page of someone else's task may have to do without."""
    try:
        return task.record()
    except GlbenchError:
        return None


def _day(date: dt.date) -> str:
    return f"{date.day} {date:%B %Y}"


def _step(seconds: float) -> str:
    return f"{seconds / 60:g} minutes" if seconds % 60 == 0 else f"{seconds:g} seconds"


def _period(task: TaskSpec) -> list[str]:
    weather, record = task.weather, _record(task)
    last = weather.start + dt.timedelta(days=weather.days - 1)
    place = f"Weather of {record.station}" if record is not None else f"Weather record '{weather.source}'"
    return [
        f"{weather.days} days, {_day(weather.start)} to {_day(last)}. "
        f"One decision every {_step(task.step_seconds)}, {task.steps:,} in all.",
        f"{place}, {weather.co2_ppm:g} ppm of CO₂ outside; prepared {PREPROCESSINGS[weather.preprocessing].meaning}.",
    ]


def _greenhouse(task: TaskSpec) -> list[str]:
    lines = [
        f"Parameter set '{task.model.parameters}': {MODEL_VARIANTS[task.model.variant].meaning}.",
        f"At the start: {INITIAL_STATES[task.initial.kind].meaning}, {task.initial.air_temperature:g} °C inside, all controls at 0.",
    ]
    return lines + [f"Changed: {name} = {value:g} {unit}." for name, value, unit in task.model.overrides]


def _uncertainty(task: TaskSpec) -> str:
    uncertainty = task.uncertainty
    if uncertainty.half_width == 0.0:
        return "Nothing: the crop behaves exactly as the model says, and all runs are alike."
    moment = "at every step" if uncertainty.redraw == "step" else "once in every run"
    return (
        f"{len(task.uncertain_parameters())} properties of the crop. "
        f"Each is off by up to ±{100 * uncertainty.half_width:g} % of its value, drawn anew {moment}."
    )


def _seen(task: TaskSpec) -> list[str]:
    words = [_MODULE_WORDS.get(name, name.replace("_", " ")) for name in task.observation.modules]
    forecast = task.observation.forecast_steps
    return [
        f"{len(task.observed())} numbers after every step: {'; '.join(words)}.",
        f"A forecast of {forecast} steps." if forecast else "No forecast.",
    ]


def _done(task: TaskSpec) -> str:
    labels = ", ".join(CONTROL_LABELS[name].lower().replace("co₂", "CO₂") for name in task.actuation.controls)
    kind = (
        ACTUATION_KINDS[task.actuation.kind]
        .meaning.replace("max_change", f"{task.actuation.max_change:g}")
        .replace(" -1 ", " −1 ")
    )
    return f"Moves {labels}: {kind}."


def _reward(task: TaskSpec) -> list[str]:
    evaluation, modules = task.evaluation, task.reward.modules
    lines = []
    if "scaled_epi" in modules:
        lines.append(
            "Profit of a step, on a scale on which 0 is boiler, lamps and CO₂ at full without any growth, and 1 is full growth for nothing."
        )
    if "epi" in modules:
        lines.append("Profit of a step in EUR/m².")
    if "scaled_penalty" in modules:
        lines.append("Minus the distance to each broken limit, divided by the distance that costs 1.")
    if "penalties" in modules:
        lines.append("Minus the distance to each broken limit, in its own unit.")
    failed = evaluation.failed_step
    lines.append(
        f"{evaluation.runs} runs with the seeds {evaluation.seeds[0]} to {evaluation.seeds[-1]}. A step that a failed run misses counts as "
        f"reward {failed.reward:g}, profit {failed.epi:g} EUR/m² and penalty {failed.penalty:g}.".replace("-", "−")
    )
    return lines
