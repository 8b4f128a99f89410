"""Draws docs/images/prices.png: the power prices of a training season, ``python -m docs.prices_figure``.

It needs matplotlib (``glbench[video]``). The season is the first one of the training split of WinterLED-v1.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from glbench.env.scenario import RunScenarios, run_weather
from glbench.tasks import get_task

TASK = "WinterLED-v1"
DAYS = 14
INK, GOLD, BLUE, GREY = "#222222", "#d9a000", "#1f6fb4", "#888888"


def season() -> dict[str, np.ndarray]:
    """Price [EUR kWh-1], what the clock alone lets expect, sun [W m-2] and wind [m s-1] of each step of the season."""
    task = get_task(TASK)
    seed = task.evaluation.first_seed
    scenarios, weather = RunScenarios(task), run_weather(task, seed)
    first, rows = int(scenarios.draw([seed]).first[0]), slice(0, task.steps)
    pool = scenarios.pool
    return {
        "time": weather.times[rows],
        "hour": weather.hour_of_day[rows],
        "price": pool.calendar[first : first + task.steps, pool.price_column("power")],
        "expected": task.price_tables["power"].values(weather.times[rows], weather.hour_of_day[rows]),
        "sun": weather.values[rows, 0],
        "wind": weather.values[rows, 4],
    }


def draw(course: dict[str, np.ndarray]) -> Figure:
    """A fortnight by the hour with its sun and wind, and the mean of the whole season by hour of the day."""
    figure = Figure(figsize=(9.0, 6.6), dpi=100, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(3, 1, height_ratios=(1.5, 1.0, 1.3))
    price, sky, day = (figure.add_subplot(grid[row]) for row in range(3))
    rows = slice(0, DAYS * 96)
    days = np.arange(DAYS * 96) / 96
    price.step(days, course["price"][rows], where="post", color=INK, lw=1.2, label="price")
    price.step(days, course["expected"][rows], where="post", color=GREY, lw=0.8, ls=":", label="by the clock alone")
    price.set_ylabel("power [EUR kWh-1]")
    sky.fill_between(days, course["sun"][rows], color=GOLD, alpha=0.5, lw=0.0, label="sun")
    sky.set_ylabel("sun [W m-2]")
    wind = sky.twinx()
    wind.plot(days, course["wind"][rows], color=BLUE, lw=1.0, label="wind")
    wind.set_ylabel("wind [m s-1]", color=BLUE)
    wind.set_ylim(0.0, None)
    sky.set_xlabel("days since the start of the season")
    for axes in (price, sky):
        axes.set_xlim(0.0, DAYS)
        axes.set_xticks(range(DAYS + 1))
    hour = course["hour"].astype(int)
    prices = [course["price"][hour == one] for one in range(24)]
    low, high = (np.array([np.quantile(one, share) for one in prices]) for share in (0.1, 0.9))
    mean = np.array([one.mean() for one in prices])
    edges = np.arange(25)
    day.stairs(high, edges, baseline=low, fill=True, color="#dddddd", label="80 % of the days")
    day.stairs(mean, edges, baseline=None, color=INK, lw=1.6, label="mean of the season")
    day.set_xlim(0, 24)
    day.set_xticks(range(0, 25, 3))
    day.set_xlabel("hour of the day")
    day.set_ylabel("power [EUR kWh-1]")
    for axes in (price, day):
        axes.set_ylim(0.0, 0.45)
        axes.legend(fontsize=8, loc="upper right", frameon=False, ncols=2)
        axes.grid(color="#dddddd", lw=0.6)
    return figure


if __name__ == "__main__":
    draw(season()).savefig(Path(__file__).with_name("images") / "prices.png")
