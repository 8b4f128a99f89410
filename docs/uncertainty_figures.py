"""Pictures and tables of docs/uncertainty.md: ``python -m docs.uncertainty_figures``.

Draws docs/images/uncertainty-*.png from the task glbench/Spring-v1 and rewrites the tables between the markers of the page. One of them
sets the sizes of the default task beside those of Spring-v1.
"""

from __future__ import annotations

import re
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from docs.tables import with_tables
from glbench.control import Scenario
from glbench.env import Simulation
from glbench.env.forecast import LEVELS, PERSISTENCE, SPREAD
from glbench.env.generated import SeasonMaker
from glbench.env.scenario import RunScenarios
from glbench.env.weather_pool import WeatherPool
from glbench.resources import write_atomically
from glbench.tasks import DEFAULT_TASK, TaskSpec, get_task

mpl.use("agg")
from matplotlib import pyplot as plt
from matplotlib.patches import Rectangle

Floats = NDArray[np.float64]

DOCS = Path(__file__).resolve().parent
PAGE = DOCS / "uncertainty.md"
TASK = next((DOCS.parent / "tasks").glob("**/spring-v1.toml"))
BIAS_SEASONS = 30
"""Training seasons over which the bias of the forecasts is measured."""
SPLITS = ("training", "validation", "test")
BLUE, ORANGE, GREEN, PINK, GREY, BLACK = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#999999", "#222222"
YEARS = {2008: "#0072b2", 2009: "#56b4e9", 2010: "#009e73", 2011: "#d55e00", 2012: "#e69f00"}
FORECAST = (("global radiation", "W m⁻²"), ("temperature", "°C"), ("relative humidity", "%"), ("wind speed", "m s⁻¹"))
SENSORS = (("air_temperature", "air temperature", "degC"), ("co2", "CO2", "ppm"), ("relative_humidity", "relative humidity", "%"))

ACTUATORS: Any = {
    "uVent": {
        "lag_minutes": 4.0,
        "sticks": {"days_between": 6.0, "hours": 4.0},
        "wind": {"above": {"value": 12.0, "unit": "m s-1"}, "full": {"value": 16.0, "unit": "m s-1"}, "share": 0.2},
    },
    "uBoil": {"fails": {"days_between": 20.0, "hours": 6.0}},
    "uCo2": {"fails": {"days_between": 15.0, "hours": 24.0}},
    "uThScr": {"shortfall": 0.1},
}
"""The example of the page."""

STYLE: Any = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
}


def main() -> None:
    """Draw and write everything."""
    task = get_task(str(TASK))
    with plt.rc_context(STYLE):
        draw(task)
    text = PAGE.read_text(encoding="utf-8")
    write_atomically(PAGE, filled(text, task))


def filled(text: str, task: TaskSpec) -> str:
    """The page with the task's tables between its marks."""
    return with_tables(text, {mark: "\n".join(lines) for mark, lines in tables(task).items()})


def draw(task: TaskSpec) -> None:
    """Draw the pictures."""
    for name, figure in (
        ("sensors", sensors(task)),
        ("actuators", actuators(task)),
        ("outdoor", outdoor(task)),
        ("forecast", forecast(task)),
        ("forecast-error", forecast_error(task)),
        ("seasons", seasons(task)),
        ("starts", starts(task)),
        ("co2", co2(task)),
        ("draws", draws(task)),
    ):
        figure.savefig(DOCS / "images" / f"uncertainty-{name}.png", dpi=100, metadata={"Software": None})
        plt.close(figure)


def tables(task: TaskSpec) -> dict[str, list[str]]:
    """The page's tables."""
    rows, measured = error_sizes(task), SENSORS
    sensor = ["| sensor | noise s | bias (sd) | drift, at most |", "|---|---:|---:|---:|"]
    assert task.sensors is not None
    for key, label, unit in measured:
        entry = getattr(task.sensors, key)
        sensor.append(f"| {label} [{unit}] | {entry.noise:g} | {entry.bias:g} | {entry.drift:g} |")
    hours = task.observation.forecast_hours
    ahead = [f"| quantity | s | φ | {' | '.join(f'{hour} h' for hour in hours)} |", "|---|---:|---:|" + "---:|" * len(hours)]
    units = ("of a clear sky's", "K", "%", "m s-1")
    for place, (label, _) in enumerate(FORECAST):
        sizes = " | ".join(f"{value:.2f}" for value in rows[place])
        ahead.append(f"| {label} [{units[place]}] | {SPREAD[place]:g} | {PERSISTENCE[place]:g} | {sizes} |")
    groups = ["| group | what | each is its nominal value times | held for |", "|---|---|---|---|"]
    for group in task.scenario.groups:
        names = ", ".join(f"`{name}`" for name in group.parameters)
        groups.append(f"| `{group.name}` | {names} | 1 ± {100 * group.half_width:g} % | the season |")
    for start in task.scenario.start_groups:
        names = ", ".join(f"`{name}`" for name in start.states)
        groups.append(f"| `{start.name}` | states on the first day: {names} | 1 ± {100 * start.half_width:g} % | the start |")
    splits = ["| split | years | seasons | used for |", "|---|---|---:|---|"]
    uses = ("`gymnasium.make`, `glbench train`", "choosing between agents", "`glbench evaluate`: the score")
    for split, use in zip(SPLITS, uses, strict=True):
        table = getattr(task.splits, split)
        splits.append(f"| {split} | {', '.join(map(str, table.years))} | {table.seasons} | {use} |")
    bias = [f"| quantity | mean of what came | {' | '.join(f'{hour} h' for hour in hours)} |", "|---|---:|" + "---:|" * len(hours)]
    unbiased = [f"{bias[0]} typical at {hours[-1]} h | clipped |", f"{bias[1]}---:|---:|"]
    fair = forecast_bias(task.replace({"observation.forecast.unbiased": True}))
    for label, (came, errors, clipped) in forecast_bias(task).items():
        digits = 1 if came > 100 else 2

        def row(errors: Floats, label: str = label, came: float = came, digits: int = digits) -> str:
            cells = " | ".join(f"{round(float(error), digits) + 0.0:+.{digits}f}" for error in errors)
            return f"| {label} | {came:.{0 if came > 10 else 1}f} | {cells} |"

        bias.append(row(errors))
        typical = " | ".join(f"{size:.{digits}f}" for size in (fair[label][2], clipped))
        unbiased.append(f"{row(fair[label][1])} {typical} |")
    sizes = sizes_beside(task, get_task(DEFAULT_TASK))
    return {"sizes": sizes, "sensors": sensor, "errors": ahead, "bias": bias, "unbiased": unbiased, "groups": groups, "splits": splits}


def sizes_beside(*both: TaskSpec) -> list[str]:
    """A table of how much differs from run to run, one column for each task."""
    columns = [sizes_of(task) for task in both]
    labels = max(columns, key=len)
    rows = [f"| {label} | {' | '.join(one.get(label, '–') for one in columns)} |" for label in labels]
    return [f"| what | {' | '.join(f'`{task.short_id}`' for task in both)} |", "|---|" + "---|" * len(both), *rows]


def sizes_of(task: TaskSpec) -> dict[str, str]:
    """What differs from run to run in a task, and by how much, in words."""
    assert task.sensors is not None
    seasons = ", ".join(str(getattr(task.splits, split).seasons) for split in SPLITS)
    widths = {group.name: group for group in task.scenario.groups}
    half = {name: f"1 ± {100 * group.half_width:g} %" for name, group in widths.items() if group.spread is None}
    spread = widths["house"].spread
    inside = [(label, unit, getattr(task.sensors, key)) for key, label, unit in SENSORS]
    hangs = task.sensors.dropouts
    assert hangs is not None
    sizes = {
        "seasons of the training, validation and test split": seasons,
        "house": half["house"] if spread is None else f"[measured widths](#measured-widths-of-the-house), `factor` {spread.factor:g}",
        **({"cold spots": half["spots"]} if "spots" in half else {}),
        "crop": half["crop"],
        "leaf": half.get("leaf", half["crop"]),
        "states at the start": f"1 ± {100 * task.scenario.start_groups[0].half_width:g} %",
        **{
            f"{label} inside: noise s, bias (sd), drift at most": f"{one.noise:g}, {one.bias:g}, {one.drift:g} {unit}"
            for label, unit, one in inside
        },
        "sensors inside hang": f"every {hangs.days_between:g} days for {hangs.hours:g} h",
    }
    outside = task.outdoor_sensors
    for name, label in (("global_radiation", "radiation"), ("wind_speed", "wind")):
        if outside is not None and (scaled := getattr(outside, name)) is not None:
            words = f"{scaled.scale.low:g} to {scaled.scale.high:g} times the truth, {100 * scaled.noise:g} %"
            sizes[f"sensor of {label} outside: scale, noise"] = words
    for name, label, unit in (("outdoor_temperature", "temperature", "degC"), ("outdoor_relative_humidity", "relative humidity", "%")):
        if outside is not None and (offset := getattr(outside, name)) is not None:
            sizes[f"sensor of {label} outside: bias (sd), noise"] = f"{offset.bias:g}, {offset.noise:g} {unit}"
    for control, label in (("uBoil", "boiler"), ("uCo2", "CO2 supply"), ("uThScr", "thermal screen"), ("uVent", "vents")):
        if (actuator := task.actuators.get(control)) is not None:
            sizes[label] = actuator_words(actuator)
    for name, sample in task.samples.items():
        sizes[f"`{name}`, taken by hand"] = f"every {sample.every_days} days, noise {100 * sample.noise:g} %"
    kind = "without bias" if task.observation.forecast.unbiased else "clipped"
    sizes["forecast"] = f"`{task.observation.forecast.error}`, {kind}"
    return sizes


def actuator_words(actuator: Any) -> str:
    """How an actuator departs from its command."""
    parts = [f"lag {actuator.lag_minutes:g} min"] if actuator.lag_minutes else []
    parts += [f"shortfall up to {100 * actuator.shortfall:g} %"] if actuator.shortfall else []
    for word, fault in (("sticks", actuator.sticks), ("fails", actuator.fails)):
        parts += [f"{word} every {fault.days_between:g} days for {fault.hours:g} h"] if fault is not None else []
    if actuator.wind is not None:
        wind = actuator.wind
        parts.append(f"drawn in from {wind.above:g} m s-1 of wind on, to {100 * wind.share:g} % at {wind.full:g} m s-1")
    return ", ".join(parts)


def error_sizes(task: TaskSpec) -> Floats:
    """Standard deviations s sqrt(1 - phi^(2 h)) for each quantity and the task's hours ahead, at the level medium."""
    hours = np.array(task.observation.forecast_hours)
    sizes: Floats = np.array(SPREAD)[:, None] * np.sqrt(1.0 - np.array(PERSISTENCE)[:, None] ** (2 * hours))
    return sizes


@cache
def forecast_bias(task: TaskSpec) -> dict[str, tuple[float, Floats, float]]:
    """Of each quantity the mean of what came, the mean error by the task's hours ahead ``(hours,)``, and the typical error at the last.

    Over training seasons; typical is the root mean square. Radiation counts in hours in which any came: by night there is nothing to
    forecast.
    """
    hours, training = np.array(task.observation.forecast_hours), task.in_split("training")
    rows = task.steps // 4 - hours.max()
    seasons = [hourly(training, number, task.steps // 4) for number in range(BIAS_SEASONS)]
    came = np.stack([[truth[h - 1 : h - 1 + rows] for h in hours] for _, truth in seasons])  # (season, ahead, issue, quantity)
    issued = np.stack([[table[:rows, :, h - 1] for h in hours] for table, _ in seasons])
    found = {}
    for place, (label, unit) in enumerate(FORECAST):
        counts = came[..., 0] > 0.0 if place == 0 else np.ones(came.shape[:-1], bool)
        off = issued[..., place] - came[..., place]
        errors = np.mean(off, axis=(0, 2), where=counts)
        typical = float(np.sqrt(np.mean(off[:, -1] ** 2, where=counts[:, -1])))
        by_day = " by day" if place == 0 else ""
        found[f"{label}{by_day} [{unit}]"] = (float(came[..., place].mean(where=counts)), errors, typical)
    return found


def controlled(task: TaskSpec, seed: int, steps: int) -> tuple[Floats, Floats]:
    """Shown and true air of a run in which a thermostat heats below 18 and ventilates above 24 degC, ``(steps, 3)``."""
    simulation, names = Simulation(task, 1, "fast"), task.model_value.control_names
    shown, true = [simulation.reset([seed])[0, :3]], [simulation.air[:, 0]]
    controls = np.zeros((1, len(names)))
    for _ in range(steps):
        temperature, _, humidity = true[-1]
        wanted = {"uBoil": (18.0 - temperature) / 5.0, "uVent": max((temperature - 22.0) / 15.0, (humidity - 82.0) / 40.0)}
        for name, value in wanted.items():
            place = names.index(name)
            controls[0, place] += np.clip(np.clip(value, 0.0, 1.0) - controls[0, place], -0.03, 0.03)
        shown.append(simulation.step_controls(controls).observations[0, :3])
        true.append(simulation.air[:, 0])
    return np.array(shown, float), np.array(true)


def sensors(task: TaskSpec) -> Any:
    """Reading and truth over three days with a drop-out."""
    length, days = 3 * task.steps_per_day, task.steps_per_day
    for seed in range(10000, 10100):
        shown, true = controlled(task, seed, 12 * days)
        hangs = np.diff(shown[:, 0], prepend=np.nan) == 0.0
        begins = [k for k in range(days, len(hangs) - length) if hangs[k] and not hangs[k - 1] and 7 <= (k % days) / 4 <= 10]
        runs = [k for k in begins if hangs[k : k + 6].all() and not hangs[k : k + 24].all()]
        if runs:
            first = (runs[0] // days - 1) * days
            break
    day = np.arange(length) / days
    figure, axes = plt.subplots(3, 1, figsize=(8.0, 6.2), sharex=True)
    part = slice(first, first + length)
    for place, (axis, label) in enumerate(zip(axes, ("air temperature [°C]", "CO₂ [ppm]", "relative humidity [%]"), strict=True)):
        hung = np.diff(shown[part, place], prepend=np.nan) == 0.0
        axis.plot(day, shown[part, place], color=ORANGE, lw=0.9, label="reading, which the agent sees")
        axis.plot(day, true[part, place], color=BLUE, lw=1.6, label="truth, which is judged")
        axis.fill_between(
            day, 0, 1, where=hung, transform=axis.get_xaxis_transform(), color=GREY, alpha=0.35, lw=0, label="the sensor hangs"
        )
        axis.set_ylabel(label)
    axes[0].legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    axes[-1].set_xlabel(f"days, from day {first // days + 1} of the run with seed {seed}")
    axes[-1].set_xlim(0, 3)
    return figure


def actuators(task: TaskSpec) -> Any:
    """Commands, what is delivered of them and the temperature inside over a week in which vents, boiler and CO2 have faults."""
    task = task.replace({"id": "docs/Actuators-v1", "actuators": ACTUATORS})
    names, length, days = task.model_value.control_names, 7 * task.steps_per_day, task.steps_per_day
    places = {name: names.index(name) for name in ("uBoil", "uVent", "uCo2")}
    for seed in range(10000, 10400):
        scenario = Scenario.of(task, seed)
        assert scenario.delivery is not None
        faults = {name: (scenario.delivery.gain[:, place] == 0.0) for name, place in places.items()}
        weeks = {name: fault[: 5 * length].reshape(5, length).sum(axis=1) for name, fault in faults.items()}
        by_day = faults["uVent"].reshape(-1, days)[:35, 40:64].sum(axis=1).reshape(5, 7).max(axis=1) >= 12
        fit = by_day & (weeks["uBoil"] > 16) & (weeks["uCo2"] > 40) & (weeks["uCo2"] < 200)
        if fit[2:].any():
            first = (int(np.argmax(fit[2:])) + 2) * length
            break
    runs = {name: _thermostat(one, seed, first + length) for name, one in (("faults", task), ("ideal", task.replace(actuators=None)))}
    figure, axes = plt.subplots(4, 1, figsize=(8.0, 7.2), sharex=True)
    day, part = np.arange(length) / days, slice(first, first + length)
    for axis, (name, label) in zip(axes, (("uBoil", "boiler"), ("uVent", "vents"), ("uCo2", "CO₂ supply")), strict=False):
        commands, delivered, _ = runs["faults"]
        axis.plot(day, commands[part, places[name]], color=ORANGE, lw=0.9, label="command, which the agent sees")
        axis.plot(day, delivered[part, places[name]], color=BLUE, lw=1.4, label="delivered, which acts and is paid for")
        shade = {"where": faults[name][part], "transform": axis.get_xaxis_transform(), "color": GREY, "alpha": 0.35, "lw": 0}
        axis.fill_between(day, 0, 1, label="fault", **shade)
        axis.set_ylabel(f"{label} [-]")
        axis.set_ylim(*((-0.015, 0.515) if name == "uVent" else (-0.03, 1.03)))
    for name, colour, words in (("ideal", GREEN, "with ideal actuators"), ("faults", BLACK, "with these")):
        axes[3].plot(day, runs[name][2][part], color=colour, lw=1.2, label=words)
    axes[3].set_ylabel("air temperature [°C]")
    axes[0].legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    axes[3].set_ylim(4, 34)
    axes[3].legend(loc="upper right", ncols=2)
    axes[3].set_xlabel(f"days, from day {first // days + 1} of the run with seed {seed}")
    axes[3].set_xlim(0, 7)
    return figure


def _thermostat(task: TaskSpec, seed: int, steps: int) -> tuple[Floats, Floats, Floats]:
    """Commands and what is delivered ``(steps, c)``, and the air temperature, of a run in which simple rules heat, ventilate and dose."""
    simulation, names = Simulation(task, 1, "fast"), task.model_value.control_names
    simulation.reset([seed])
    commands, rows = np.zeros((1, len(names))), []
    for _ in range(steps):
        (temperature, _, humidity), sun = simulation.air[:, 0], simulation.d[0, 0]
        targets = {
            "uBoil": (18.0 - temperature) / 5.0,
            "uVent": max((temperature - 22.0) / 15.0, (humidity - 82.0) / 40.0),
            "uCo2": 0.5 * (sun > 50.0),
        }
        for name, target in targets.items():
            place = names.index(name)
            commands[0, place] += np.clip(np.clip(target, 0.0, 1.0) - commands[0, place], -0.1, 0.1)
        simulation.step_controls(commands)
        rows.append((simulation.commands[0], simulation.u[0], simulation.air[0, 0]))
    given, delivered, temperatures = (np.array(column) for column in zip(*rows, strict=True))
    return given, delivered, temperatures


def outdoor(task: TaskSpec) -> Any:
    """What the weather station of the page's example shows to two runs in one season, over two days."""
    block = next(
        text for text in re.findall(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL) if "outdoor_sensors" in text
    )
    erring = task.replace(tomllib.loads(block))
    assert erring.splits is not None
    assert erring.splits.training is not None
    apart, day = erring.splits.training.seasons or 1, task.steps_per_day
    pair, names = Simulation(erring, 2, "fast"), [column.name for column in erring.observed()]
    right = Simulation(task, 2, "fast")
    rows: list[list[Floats]] = [[], []]
    for simulation, of in zip((pair, right), rows, strict=True):
        of.append(simulation.reset([10_007, 10_007 + apart]))
        of += [simulation.step_controls(np.zeros((2, len(task.model_value.control_names)))).observations for _ in range(8 * day)]
    shown, true = np.array(rows[0], float)[6 * day :], np.array(rows[1], float)[6 * day :, 0]
    figure, axes = plt.subplots(2, 2, figsize=(8.0, 5.0), sharex=True)
    columns = ("global_radiation", "wind_speed", "outdoor_temperature", "outdoor_relative_humidity")
    labels = ("global radiation [W m⁻²]", "wind speed [m s⁻¹]", "temperature [°C]", "relative humidity [%]")
    for axis, name, label in zip(axes.flat, columns, labels, strict=True):
        place, days = names.index(name), np.arange(len(true)) / day
        for run, (colour, said) in enumerate(((ORANGE, "reading of one run"), (GREEN, "reading of another"))):
            axis.plot(days, shown[:, run, place], color=colour, lw=0.9, label=said)
        axis.plot(days, true[:, place], color=BLACK, lw=1.4, label="truth, which acts")
        axis.set_ylabel(label)
    for axis in axes[-1]:
        axis.set_xlabel("days")
        axis.set_xlim(0, 2)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def hourly(task: TaskSpec, number: int, hours: int) -> tuple[Floats, Floats]:
    """The forecast table of a season with all hours ahead to a day, ``(issues, 4, 24)``, and the weather that comes by the hour."""
    forecast = task.observation.forecast.model_copy(update={"hours": tuple(range(1, 25))})  # type: ignore[union-attr]
    whole = task.model_copy({"observation": task.observation.model_copy(update={"forecast": forecast})})
    pool = WeatherPool.of(whole)
    pool.starts([number])
    rows = pool.day * pool.days
    measured = pool.tables.measured[number * rows : (number + 1) * rows, [0, 1, 2, 4]]
    issued = pool.tables.forecast[number * rows // 4 : (number + 1) * rows // 4].reshape(-1, 4, 24)
    return issued[:hours].astype(float), measured.reshape(-1, 4, 4).mean(axis=1)[:hours].astype(float)


def forecast(task: TaskSpec) -> Any:
    """Two issues and what came."""
    issued, came = hourly(task.in_split("test"), 1, 240)
    first, later = 24 * 4 + 5, 24 * 4 + 11
    figure, axes = plt.subplots(2, 2, figsize=(8.0, 5.0), sharex=True)
    for place, (axis, (label, unit)) in enumerate(zip(axes.T.flat, FORECAST, strict=True)):
        span = np.arange(first - 5, later + 25)
        axis.plot(span - first + 0.5, came[span, place], color=BLACK, lw=1.8, label="what came")
        for issue, colour, text in ((first, BLUE, "forecast at 0"), (later, ORANGE, "forecast 6 hours later")):
            axis.plot(issue - first + np.arange(24) + 0.5, issued[issue, place], color=colour, marker=".", lw=1.0, label=text)
            axis.axvline(issue - first, color=colour, lw=0.8, ls=":")
        axis.set_ylabel(f"{label} [{unit}]")
        if place == 0:
            handles = axis.get_legend_handles_labels()
    for axis in axes[-1]:
        axis.set_xlabel("hours from the first issue")
    figure.legend(*handles, loc="outside upper center", ncols=3)
    return figure


def forecast_error(task: TaskSpec) -> Any:
    """Standard deviation of the error by hours ahead: formula and 30 seasons."""
    figure, axes = plt.subplots(1, 2, figsize=(8.0, 3.4))
    hours = np.arange(1, 25)
    for place, axis in ((1, axes[0]), (3, axes[1])):
        for level, colour in (("high", ORANGE), ("medium", BLUE), ("low", GREEN)):
            size = LEVELS[level] * SPREAD[place] * np.sqrt(1.0 - PERSISTENCE[place] ** (2 * hours))
            axis.plot(hours, size, color=colour, lw=1.2, label=f"{level}: formula")
        errors = []
        for number in range(30):
            issued, came = hourly(task.in_split("test"), number, 1400)
            errors.append([issued[: 1400 - 24, place, h - 1] - came[h - 1 : h - 1 + 1376, place] for h in hours])
        axis.plot(hours, np.std(np.concatenate(errors, axis=1), axis=1), ".", color=BLACK, label="medium: 30 test seasons")
        axis.set_xlabel("hours ahead")
        axis.set_ylabel(f"sd of the error in {FORECAST[place][0]} [{'K' if place == 1 else FORECAST[place][1]}]")
        axis.set_ylim(0)
        axis.set_xticks([1, 6, 12, 18, 24])
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure


def seasons(task: TaskSpec) -> Any:
    """Of which days the first seasons of each split are made."""
    figure, axes = plt.subplots(3, 1, figsize=(8.0, 6.0), sharex=True)
    shown = 8
    for axis, split in zip(axes, SPLITS, strict=True):
        chosen = task.in_split(split)
        maker = SeasonMaker(chosen, WeatherPool.of(chosen).times[0])
        late = maker.start_days(np.arange(shown))
        begin = (task.weather.start.toordinal()) - task.weather.start.replace(month=1, day=1).toordinal()
        for number in range(shown):
            drawn = maker.season(number, task.steps + 1).days
            days = drawn.sources.astype("datetime64[D]")
            years = days.astype("datetime64[Y]").astype(int) + 1970
            for day in range(task.weather.days):
                at = begin + late[number] + day
                axis.barh(number + 1, 1, left=at, height=0.75, color=YEARS[int(years[day + 2])], lw=0)
                if drawn.joints[day + 2] and day:
                    axis.plot([at, at], [number + 0.6, number + 1.4], color="white", lw=1.2)
        axis.set_ylabel(f"season of {split}")
        axis.set_yticks(range(1, shown + 1, 2))
        axis.invert_yaxis()
        axis.grid(axis="y", visible=False)
    months = {"15 Feb": 45, "1 Mar": 59, "15 Mar": 73, "1 Apr": 90, "15 Apr": 104, "1 May": 120, "15 May": 134}
    axes[-1].set_xticks(list(months.values()), list(months))
    axes[-1].set_xlabel("day of the season's calendar")
    handles = [Rectangle((0, 0), 1, 1, color=colour) for colour in YEARS.values()]
    figure.legend(handles, [str(year) for year in YEARS], loc="outside upper center", ncols=5, title="measured in")
    return figure


def starts(task: TaskSpec) -> Any:
    """How many seasons start on each day, and the course of the temperature in the training and test seasons."""
    figure, axes = plt.subplots(1, 2, figsize=(8.0, 3.2), width_ratios=(1, 1.3))
    colours = {"training": BLUE, "test": ORANGE}
    for split, colour in colours.items():
        chosen = task.in_split(split)
        pool, number = WeatherPool.of(chosen), getattr(task.splits, split).seasons
        late = SeasonMaker(chosen, pool.times[0]).start_days(np.arange(number))
        axes[0].step(np.arange(29), np.bincount(late, minlength=29), where="mid", color=colour, label=f"{number} of {split}")
        _, rows = pool.starts(range(30))
        length = task.weather.days * pool.day
        means = np.array([pool.tables.measured[row : row + length, 1].reshape(-1, pool.day).mean(axis=1) for row in rows])
        day = np.arange(task.weather.days) + 1
        low, middle, high = np.quantile(means, [0.1, 0.5, 0.9], axis=0)
        axes[1].fill_between(day, low, high, color=colour, alpha=0.2, lw=0)
        axes[1].plot(day, middle, color=colour, lw=1.4, label=f"30 of {split}")
    axes[0].set_ylim(0, 13)
    axes[0].set_xlabel("days after 15 February")
    axes[0].set_ylabel("seasons that start")
    axes[0].legend(loc="lower center", fontsize=8)
    axes[1].set_xlabel("day of the season")
    axes[1].set_ylabel("daily mean temperature [°C]\nmedian and 10 to 90 %")
    axes[1].legend(loc="upper left", fontsize=8)
    return figure


def co2(task: TaskSpec) -> Any:
    """CO2 outside in three seasons."""
    figure, axis = plt.subplots(figsize=(8.0, 2.4))
    pool = WeatherPool.of(task)
    _, rows = pool.starts([0, 1, 2])
    length = task.weather.days * pool.day
    for number, (row, colour) in enumerate(zip(rows, (BLUE, ORANGE, GREEN), strict=True)):
        axis.plot(
            np.arange(length) / pool.day, pool.tables.measured[row : row + length, 3], color=colour, lw=0.9, label=f"season {number + 1}"
        )
    axis.set_xlabel("day of the season")
    axis.set_ylabel("CO₂ outside [ppm]")
    axis.set_ylim(387, 423)
    axis.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    axis.set_xlim(0, task.weather.days)
    return figure


def draws(task: TaskSpec) -> Any:
    """Drawn factors of a parameter of each group, and offsets of the temperature sensor, in 2,000 runs."""
    scenarios, seeds = RunScenarios(task), list(range(2000))
    scenes = scenarios.draw(seeds)
    assert scenes.parameters is not None
    figure, axes = plt.subplots(1, 3, figsize=(8.0, 2.8))
    names = list(task.model_value.parameter_names)
    for group, colour in zip(scenarios.in_episode, (BLUE, GREEN, ORANGE), strict=False):
        place = names.index(group.parameters[0])
        factor = scenes.parameters[:, place] / scenarios.nominal[place]
        axes[0].hist(factor, bins=np.linspace(0.78, 1.22, 45), histtype="step", color=colour, label=f"{group.name}: {group.parameters[0]}")
    axes[0].set_xlabel("factor on the nominal value")
    axes[0].set_ylabel("runs of 2,000")
    axes[0].set_ylim(0, 220)
    axes[0].legend(fontsize=7, loc="upper left")
    for axis, column, text in ((axes[1], 0, "bias of the thermometer [K]"), (axes[2], 1, "its drift by the end [K]")):
        axis.hist(scenes.traits[:, column], bins=40, color=BLUE)
        axis.set_xlabel(text)
    return figure


if __name__ == "__main__":
    main()
