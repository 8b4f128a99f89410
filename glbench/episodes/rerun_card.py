"""The card beside the plots: the task in words, and who is shown in which colour."""

from __future__ import annotations

from glbench.episodes.rerun_colours import PALETTE
from glbench.episodes.rerun_course import Course, Shown
from glbench.tasks import task_card

_NAMES = {"air_temperature": "air temperature", "co2": "CO₂", "relative_humidity": "relative humidity"}
_UNITS = {"degC": "°C"}


def card(shown: Shown) -> str:
    """The card as Markdown."""
    return "\n".join([*_task(shown), "", *_controllers(shown), "", *_reading()])


def _task(shown: Shown) -> list[str]:
    task, facts = shown.task, task_card(shown.task)
    prices = shown.task.prices
    limits = "; ".join(
        f"{_NAMES[limit.name]} **{limit.low:g} to {limit.high:g} {_UNITS.get(limit.unit, limit.unit)}**"
        for limit in facts.constraints
    )
    return [
        f"# {task.title}",
        "",
        " ".join(task.description.split()),
        "",
        f"**Where and when:** {facts.place.station}, from {facts.start:%-d %B %Y}, {task.weather.days} days, "
        f"a decision every {task.step_seconds / 60:g} minutes.",
        "",
        f"**Climate to stay within:** {limits}.",
        "",
        f"**Prices:** tomatoes {prices.fruit:g} EUR/kg; heat {prices.heat:g} EUR/kWh; "
        f"electricity {prices.electricity:g} EUR/kWh; CO₂ {prices.co2:g} EUR/kg.",
        "",
        f"Task `{task.id}`",
    ]


def _controllers(shown: Shown) -> list[str]:
    lines = ["## Controllers", ""]
    for colour, label, course in zip(PALETTE, shown.labels, shown.courses, strict=False):
        lines += [f"**{label}** ({colour.name}), seed {course.seed}", ""]
        lines += [f"- {line}" for line in _outcome(course)] if course.steps else ["- running"]
        if course.remark:
            lines.append(f"- **ended after step {course.steps}: {course.remark}**")
        lines.append("")
    return lines


def _outcome(course: Course) -> list[str]:
    sums = {name: float(course.columns[name].sum()) for name in ("reward", "epi", "revenue", "fruit_fresh")}
    costs = sum(float(course.columns[name].sum()) for name in ("cost_heat", "cost_electricity", "cost_co2"))
    epi = f"{sums['epi']:.2f}".replace("-", "−")
    return [
        f"EPI {epi} EUR/m² = revenue {sums['revenue']:.2f} − costs {costs:.2f}",
        f"{sums['fruit_fresh']:.2f} kg/m² of fruit grown; reward {sums['reward']:.1f}",
    ]


def _reading() -> list[str]:
    return [
        "## Reading the plots",
        "",
        "Green: inside the limits. Slow quantities show the whole episode; the others show a few days, by default those in "
        "which limits were broken most. Ctrl + scroll zooms in and out, and the ? above a plot tells more. All amounts are "
        "per m² of floor; times are UTC.",
    ]
