"""Fills the tables of docs/realism-tables.md and draws docs/images/realism-months.png: ``python -m docs.realism_figure``.

Heat and harvest come from docs/measurements/realism.json, the comparison.json of ``glbench validate FOLDER --by set-points``; the air from
docs/measurements/realism-climate.json, the climate.json of ``glbench validate FOLDER --by actuators``. Both hold sums of the season and
statistics, no measured day. The picture needs matplotlib (``glbench[video]``).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from docs.tables import with_tables
from glbench.realism import Comparison, read_comparison
from glbench.realism.climate import ClimateComparison, Errors

DOCS = Path(__file__).parent
PAGE, PICTURE = DOCS / "realism-tables.md", DOCS / "images" / "realism-months.png"
MEASUREMENTS = DOCS / "measurements"
COLOURS = {
    "paper": "#c23b22", "paper_uncooled": "#e2a23b", "hps_2020": "#7a6a58", "mixed_2020": "#3a8f5c", "hps_2021": "#a44a8c",
    "led_2021": "#1d5fa8", "mixed_2021": "#4aa3a8", "bleiswijk_2020": "#111111",
}  # fmt: skip
INK, EDGE = "#1f2933", "#b8c2cc"
FITTED = "bleiswijk_2020"
"""The house whose errors are told apart by month and hour."""
CHANNELS = {"air_temperature": ("air temperature, K", 2), "humidity": ("relative humidity, %", 1), "co2": ("CO2, ppm", 0)}
"""Heading and digits of the errors, by channel."""


def measured() -> Comparison:
    """All sets: a compartment with set points of its own by those, the others by the page of settings."""
    return read_comparison(MEASUREMENTS / "realism.json")


def measured_climate() -> ClimateComparison:
    """All sets by what the actuators did."""
    return ClimateComparison.model_validate_json((MEASUREMENTS / "realism-climate.json").read_text(encoding="utf-8"))


def sets(comparison: Comparison) -> str:
    """A row a parameter set."""
    lines = [
        "| parameter set | heat, MJ m⁻² | simulated / measured | by pipe temperatures, MJ m⁻² | simulated / measured | "
        "of single compartments | bias a day | RMSE a day | fruit, kg m⁻² | "
        "simulated / measured | mean air temperature, °C |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    first = comparison.houses[0]
    lines.append(
        f"| *measured* | | | {first.mean(lambda one: one.heat.measured):.0f} | | | | {comparison.heat_spread:.2f} | "
        f"{first.mean(lambda one: one.harvest.measured):.1f} | | |"
    )
    for house in comparison.houses:
        single = sorted(one.heat.simulated / one.heat.measured for one in house.compartments)
        lines.append(
            f"| `{house.name}`: {house.description} | {house.mean(lambda one: one.heat.simulated):.0f} | {house.heat_ratio:.2f} | "
            f"{house.pipe_heat:.0f} | {house.pipe_heat / house.mean(lambda one: one.heat.measured):.2f} | "
            f"{single[0]:.2f} to {single[-1]:.2f} | {house.heat_bias():+.2f} | {house.heat_rmse:.2f} | "
            f"{house.mean(lambda one: one.harvest.simulated):.1f} | {house.harvest_ratio:.2f} | "
            f"{house.mean(lambda one: one.air_temperature):.1f} |"
        )
    return "\n".join(lines)


def compartments(comparison: Comparison) -> str:
    """Heat and fruit of every compartment, measured and in each set."""
    names = [house.name for house in comparison.houses]
    lines = [f"| | measured | {' | '.join(f'`{name}`' for name in names)} |", f"|---|{'---:|' * (1 + len(names))}"]
    first = comparison.houses[0]
    for kind, words, digits in (("heat", "heat, MJ m⁻²", 0), ("harvest", "fruit, kg m⁻²", 1)):
        for place, one in enumerate(first.compartments):
            values = [getattr(one, kind).measured]
            values += [getattr(house.compartments[place], kind).simulated for house in comparison.houses]
            lines.append(f"| {one.name}, {words} | {' | '.join(f'{value:.{digits}f}' for value in values)} |")
    return "\n".join(lines)


def months(comparison: Comparison) -> str:
    """What is off in which month."""
    names = comparison.months
    lines = [f"| simulated minus measured | | {' | '.join(names)} |", f"|---|---|{'---:|' * len(names)}"]
    for house in comparison.houses:
        heat = " | ".join(f"{house.heat_bias(month):+.2f}" for month in names)
        fruit = " | ".join(f"{house.harvest_bias(month):+.1f}" for month in names)
        lines.append(f"| `{house.name}` | heat, MJ m⁻² d⁻¹ | {heat} |")
        lines.append(f"| | fruit, kg m⁻² | {fruit} |")
    return "\n".join(lines)


def climate(comparison: ClimateComparison) -> str:
    """Root mean square error and bias of the air: a row a set, then the fitted set by month, hours of the day and week."""
    (compartment,) = comparison.compartments
    heads = " | ".join(f"{words} | bias" for words, _ in CHANNELS.values())
    lines = [f"| {compartment.name}: error of | {heads} |", f"|---|{'---:|---:|' * len(CHANNELS)}"]

    def add(title: str, rows: Mapping[str, Errors]) -> None:
        lines.append(f"| **{title}** |{' |' * 2 * len(CHANNELS)}")
        for name, errors in rows.items():
            cells = (
                f"{errors[channel].rmse:,.{digits}f} | {errors[channel].bias:+,.{digits}f}" for channel, (_, digits) in CHANNELS.items()
            )
            lines.append(f"| {name} | {' | '.join(cells)} |")

    fitted = next(house for house in compartment.houses if house.name == FITTED)
    add("all readings", {f"`{house.name}`": house.overall for house in compartment.houses})
    add(f"`{FITTED}`, by month", fitted.months)
    add(f"`{FITTED}`, by hours of the day", {f"{hours} h".replace("-", " to "): errors for hours, errors in fitted.hours.items()})
    add(f"`{FITTED}`, by week", {f"{name} weeks": errors for name, errors in fitted.weeks.items()})
    return "\n".join(lines)


def filled(page: str, comparison: Comparison, air: ClimateComparison) -> str:
    """The page with its tables."""
    tables = {"climate": climate(air), "sets": sets(comparison), "compartments": compartments(comparison), "months": months(comparison)}
    return with_tables(page, tables)


def draw(comparison: Comparison, path: Path) -> None:
    """Differences by month, means over the compartments: no measured day."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.8), dpi=110, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    heat, fruit = figure.subplots(1, 2)
    names = [f"{month[5:]}/{month[2:4]}" for month in comparison.months]
    for house in comparison.houses:
        look = {"color": COLOURS[house.name], "lw": 1.6, "marker": "o", "ms": 3.5, "label": house.name}
        heat.plot(names, [house.heat_bias(month) for month in comparison.months], **look)
        fruit.plot(names, [house.harvest_bias(month) for month in comparison.months], **look)
    for axes, title in ((heat, "heat [MJ m⁻² d⁻¹]"), (fruit, "fruit [kg m⁻² a month]")):
        axes.axhline(0.0, color=INK, lw=1.2)
        axes.set_title(f"simulated minus measured: {title}", loc="left", fontsize=10, color=INK)
        axes.tick_params(labelsize=8.5)
        axes.grid(color=EDGE, lw=0.5, alpha=0.6)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    figure.legend(*heat.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    figure.savefig(path)


if __name__ == "__main__":
    found = measured()
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8"), found, measured_climate()), encoding="utf-8")
    draw(found, PICTURE)
