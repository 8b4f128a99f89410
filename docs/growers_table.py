"""Tables and picture of docs/growers.md: ``python -m docs.growers_table [--only-page]``.

Evaluates three pages of rules in seasons of the validation split of FullSeason-v1, adds up by week what each used, picked and earned,
and writes docs/measurements/growers.json, docs/images/growers-weeks.svg and the tables between the markers of the page. It takes
minutes; ``--only-page`` writes page and picture from the measurements that are there.
"""

from __future__ import annotations

import json
import re
import shutil
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from docs.tables import with_tables
from glbench.episodes import by_week, read_log, replayed_episodes
from glbench.evaluation import evaluate
from glbench.resources import write_atomically
from glbench.tasks import get_task

DOCS = Path(__file__).parent
PAGE, FILE, PICTURE = DOCS / "growers.md", DOCS / "measurements" / "growers.json", DOCS / "images" / "growers-weeks.svg"
RULES = DOCS.parent / "baselines" / "rule_based_energy"
TASK: Final = "FullSeason-v1"
RUNS: Final = 4
"""Seasons of the validation split."""
STRATEGIES: Final[Mapping[str, Mapping[str, float]]] = {"lit": {}, "unlit": {"lamps_fruit": 0.0}, "less_drying": {"boiler_humidity": 0.05}}
"""Each page by its name: the baseline's with these numbers changed."""
WORDS: Final = {
    "lit": "`lit`: the page as it is",
    "unlit": "`unlit`: lamps stay off",
    "less_drying": "`less_drying`: a third of the heat against humid air",
}
WEEKS: Final = 4
"""Weeks in a row of the first table."""


def write_page(folder: Path, changes: Mapping[str, float]) -> Path:
    """A copy of the baseline in ``folder`` with some numbers of its page of FullSeason-v1 changed.

    Raises
    ------
    ValueError
        When the page has no such number.
    """
    shutil.copytree(RULES, folder)
    page = folder / "rules" / "fullseason.yml"
    text = page.read_text(encoding="utf-8")
    for name, value in changes.items():
        text, count = re.subn(rf"^{name}: [-\d.]+", f"{name}: {value:g}", text, flags=re.MULTILINE)
        if count != 1:
            msg = f"{page} has {count} lines with '{name}'; one was expected."
            raise ValueError(msg)
    page.write_text(text, encoding="utf-8")
    return folder


def measured() -> dict[str, Any]:
    """What each strategy used, picked and earned: its weeks, in the mean over the seasons, and the metrics of each season."""
    task, found = get_task(TASK).in_split("validation"), {}
    with tempfile.TemporaryDirectory() as temporary:
        for name, changes in STRATEGIES.items():
            result = evaluate(task, write_page(Path(temporary) / name, changes), runs=RUNS, out=Path(temporary) / "out")
            (actions,) = Path(temporary).glob(f"out/**/{name}.actions.mcap")
            log = read_log(actions)
            weeks = [by_week(episode) for episode in replayed_episodes(task, log, list(range(RUNS)))]
            count = min(len(one) for one in weeks)
            units = {**weeks[0].attrs["units"], "days": "day"}
            found[name] = {
                "weeks": {
                    f"{column} [{units[column]}]": np.mean([one[column][:count] for one in weeks], axis=0).round(6).tolist()
                    for column in weeks[0].columns
                },
                "seasons": [{key: round(value, 6) for key, value in run.metrics.items() if value is not None} for run in result.runs],
            }
    return {"task": TASK, "digest": task.digest, "split": "validation", "strategies": found}


def read() -> dict[str, Any]:
    """The measurements that are there."""
    return dict(json.loads(FILE.read_text(encoding="utf-8")))


def week_sums(strategy: Mapping[str, Any], column: str, size: int = WEEKS) -> list[float]:
    """Sums of a column over each ``size`` weeks from planting; of light the mean."""
    values = np.array(strategy["weeks"][column])
    add = np.mean if column.startswith("par_today") else np.sum
    return [float(add(values[first : first + size])) for first in range(0, len(values), size)]


def mean(strategy: Mapping[str, Any], metric: str) -> float:
    """Mean of a metric over the seasons."""
    return float(np.mean([season[metric] for season in strategy["seasons"]]))


def gas(strategy: Mapping[str, Any]) -> float:
    """Natural gas of a season [m3 m-2], mean over the seasons."""
    return sum(strategy["weeks"]["heat_cubic_metres [m3 m-2]"])


def filled(page: str, found: Mapping[str, Any]) -> str:
    """The page with its tables."""
    strategies = found["strategies"]
    lit = strategies["lit"]
    columns = {
        "par_today [mol m-2 d-1]": "light on the crop, mol/m² a day",
        "heat_cubic_metres [m3 m-2]": "gas, m³/m²",
        "electricity [kWh m-2]": "lamps, kWh/m²",
        "co2_dosed [kg m-2]": "CO2, kg/m²",
        "fruit_picked [kg m-2]": "picked, kg/m² a week",
        "epi [EUR m-2]": "profit, EUR/m²",
    }
    season = [f"| weeks | {' | '.join(columns.values())} |", f"|---|{'---:|' * len(columns)}"]
    rows = zip(*(week_sums(lit, column) for column in columns), strict=True)
    lengths = week_sums(lit, "days [day]")
    for place, (light, cubic, power, co2, picked, profit) in enumerate(rows):
        last = min((place + 1) * WEEKS, len(lit["weeks"]["days [day]"]))
        a_week = max(picked, 0.0) * 7.0 / lengths[place]
        cells = f"{light:.0f} | {cubic:.1f} | {power:.1f} | {co2:.1f} | {a_week:.2f} | {profit:+.2f}".replace("+-", "-")
        season.append(f"| {place * WEEKS + 1} to {last} | {cells} |")
    sums = [mean(lit, name) for name in ("electricity", "co2_dosed", "fruit_picked", "epi")]
    season.append(
        f"| **season** | | **{gas(lit):.1f}** | **{sums[0]:.0f}** | **{sums[1]:.0f}** | **{sums[2]:.1f} in all** | **{sums[3]:+.2f}** |"
    )
    lines = {
        "gas, m³/m²": lambda one: f"{gas(one):.1f}",
        "lamps, kWh/m²": lambda one: f"{mean(one, 'electricity'):.0f}",
        "picked, kg/m²": lambda one: f"{mean(one, 'fruit_picked'):.1f}",
        "fruit sold and standing, EUR/m²": lambda one: f"{mean(one, 'revenue_harvest') + mean(one, 'revenue_growth'):.2f}",
        "heat, EUR/m²": lambda one: f"{mean(one, 'cost_heat'):.2f}",
        "lamps, EUR/m²": lambda one: f"{mean(one, 'cost_electricity'):.2f}",
        "CO2, EUR/m²": lambda one: f"{mean(one, 'cost_co2'):.2f}",
        "**profit, EUR/m²**": lambda one: f"**{mean(one, 'epi'):.2f}**",
        "hours too humid": lambda one: f"{mean(one, 'hours_relative_humidity_high'):,.0f}",
        "price of all violations, EUR/m²": lambda one: f"{mean(one, 'penalty'):.2f}",
        "**score, EUR/m²**": lambda one: f"**{mean(one, 'reward'):.2f}**",
    }
    compared = [f"| | {' | '.join(WORDS[name] for name in strategies)} |", f"|---|{'---:|' * len(strategies)}"]
    compared += [f"| {title} | {' | '.join(cell(one) for one in strategies.values())} |" for title, cell in lines.items()]
    return with_tables(page, {"season": "\n".join(season), "strategies": "\n".join(compared)})


def draw(found: Mapping[str, Any]) -> None:
    """Fruit picked and gas burnt by week, lit and unlit, as PICTURE."""
    import matplotlib as mpl

    mpl.use("svg")
    mpl.rcParams.update({"svg.hashsalt": "growers", "svg.fonttype": "none", "font.size": 9})
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 2.9), layout="constrained")
    for axis, column, title in zip(
        axes, ("fruit_picked [kg m-2]", "heat_cubic_metres [m3 m-2]"), ("Picked [kg/m² a week]", "Gas [m³/m² a week]"), strict=True
    ):
        for name, colour in (("lit", "#d17a00"), ("unlit", "#33658a")):
            weeks = found["strategies"][name]["weeks"]
            whole = np.array(weeks["days [day]"]) > 6.99
            axis.plot(np.arange(1, len(whole) + 1)[whole], np.array(weeks[column])[whole], color=colour, label=name)
        axis.set(title=title, xlabel="week after planting in January", ylim=(0, None))
        axis.grid(alpha=0.3)
    axes[0].legend(frameon=False)
    figure.savefig(PICTURE, metadata={"Date": None})
    plt.close(figure)


if __name__ == "__main__":
    if "--only-page" not in sys.argv:
        write_atomically(FILE, (json.dumps(measured(), indent=1) + "\n").encode())
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8"), read()), encoding="utf-8")
    draw(read())
