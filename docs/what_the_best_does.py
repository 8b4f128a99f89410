"""Pictures and tables of docs/what-the-best-does.md: ``python -m docs.what_the_best_does``.

Replays the best known plan of the paper's season (glbench/Schiphol2010-Delta00-v1) beside the best trained policy, and a plan for the
same season with electricity at a third of its price, which ``python -m docs.what_the_best_does --plan`` searches for (some minutes).
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from docs.tables import with_tables
from glbench.agents.plans import PlanBook, read_book
from glbench.bounds import agent_controls, best_known
from glbench.control import Scenario, StageReward, air_of, plan_season
from glbench.evaluation import protect
from glbench.kernel import Kernel
from glbench.resources import write_atomically
from glbench.tasks import TaskSpec, get_task

mpl.use("agg")
from matplotlib import pyplot as plt

Floats = NDArray[np.float64]

DOCS = Path(__file__).resolve().parent
PAGE = DOCS / "what-the-best-does.md"
CHEAP_PLAN = DOCS / "measurements" / "cheap-power-plan.npz"
POLICY = "ppo_tuned"
SEED = 666
ITERATIONS = 60
DARK = 5.0  # W m-2 of global radiation
MONTHS = {"March": slice(0, 31), "April": slice(31, 60)}
BLUE, ORANGE, GREEN, GREY = "#0072b2", "#d55e00", "#009e73", "#999999"
STYLE: Any = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
}


def paper_task() -> TaskSpec:
    """The paper's season with a known crop."""
    return get_task("Schiphol2010-Delta00-v1")


def cheap_task() -> TaskSpec:
    """The same with electricity at a third of its price."""
    return paper_task().replace(id="docs/CheapPower-v1", prices={"electricity": {"value": 0.1, "unit": "EUR kWh-1"}})


@dataclass(frozen=True, eq=False)
class Season:
    """A season under some controls, step by step."""

    scenario: Scenario
    controls: Floats

    @classmethod
    def of_book(cls, task: TaskSpec, book: PlanBook) -> Season:
        """As the plan of a book has it."""
        reason = book.why_not(task)
        if reason is not None:
            msg = f"the plan does not fit: {reason}"
            raise ValueError(msg)
        given = Scenario.of(task, SEED)
        return cls(given, np.clip(given.u_before + given.max_change * np.cumsum(book.plan(SEED), axis=0), 0.0, given.high))

    @cached_property
    def states(self) -> Floats:
        """``(T + 1, states)``."""
        task, given = self.scenario.task, self.scenario
        return Kernel(task.model_value, task.step_seconds).rollout(given.x0, self.controls, given.d, given.p)

    @cached_property
    def air(self) -> Floats:
        """Temperature [degC], CO2 [ppm] and relative humidity [%] at the end of each step ``(T, 3)``."""
        return air_of(self.scenario.task.model_value, self.states[1:]).values

    @cached_property
    def profit(self) -> float:
        """[EUR m-2]."""
        return float(self._values.epi.sum())

    @cached_property
    def reward(self) -> float:
        """Sum of the rewards."""
        return float(self._values.reward.sum())

    @cached_property
    def _values(self) -> Any:
        return StageReward(self.scenario.task)(self.states, self.controls, self.scenario.calendar)

    @property
    def light(self) -> Floats:
        """Global radiation [W m-2] in each step."""
        return self.scenario.d[:, self.scenario.task.model_value.disturbance_names.index("iGlob")]

    def control(self, name: str) -> Floats:
        """A control in percent of its capacity."""
        return 100.0 * self.controls[:, self.scenario.task.model_value.control_names.index(name)]

    def used(self, name: str) -> float:
        """Sum of a quantity of the model over the season, by the ordinary simulation."""
        return self._sums[name]

    @cached_property
    def _sums(self) -> dict[str, float]:
        from glbench.env import Simulation

        simulation, sums = Simulation(self.scenario.task, 1), dict.fromkeys(USED, 0.0)
        simulation.reset([SEED])
        for row in self.controls:
            outcome = simulation.step_controls(row[None])
            for name in USED:
                sums[name] += float(outcome.quantities[name][0])
        return sums

    def daily(self, series: Floats, month: slice) -> Floats:
        """Median of each step of the day over the days of a month ``(steps of a day,)``."""
        day = self.scenario.task.steps_per_day
        found: Floats = np.median(series.reshape(-1, day)[month], axis=0)
        return found


USED = ("fruit_fresh", "heat", "electricity", "co2_dosed")


def main() -> None:
    """Draw and write everything; with ``--plan`` search for the plan with cheap electricity first."""
    if "--plan" in sys.argv[1:]:
        plan_cheap()
    seasons = all_seasons()
    with plt.rc_context(STYLE):
        for name, figure in {"day": typical_day(seasons), "lamps": lamps(seasons)}.items():
            figure.savefig(DOCS / "images" / f"best-{name}.png", dpi=100, metadata={"Software": None})
            plt.close(figure)
    write_atomically(PAGE, filled(PAGE.read_text(encoding="utf-8"), seasons))


def all_seasons() -> dict[str, Season]:
    """The best known plan, the policy, and the plan with cheap electricity."""
    task = paper_task()
    book = best_known().book(task)
    assert book is not None
    policy = Season(Scenario.of(task, SEED), agent_controls(task, protect(POLICY, "none"), [SEED])[0])
    return {"best": Season.of_book(task, book), "policy": policy, "cheap": Season.of_book(cheap_task(), read_book(CHEAP_PLAN))}


def plan_cheap() -> None:
    """Search for a plan, from the best known one at the paper's price, or from the one that is there."""
    task, paper = cheap_task(), paper_task()
    book = best_known().book(paper)
    assert book is not None
    before = (task, read_book(CHEAP_PLAN)) if CHEAP_PLAN.is_file() else (paper, book)
    controls = Season.of_book(*before).controls
    given = Scenario.of(task, SEED)
    plan = plan_season(given, controls, iterations=ITERATIONS)
    about = {"method": "sequential convex programming", "iterations": ITERATIONS, "reward": plan.reward}
    PlanBook.of(task, [SEED], plan.actions(), about).save(CHEAP_PLAN)


def typical_day(seasons: dict[str, Season]) -> Any:
    """Median day of March and of April under the best known plan and under the policy."""
    best, policy = seasons["best"], seasons["policy"]
    rows = (
        ("air temperature [°C]", lambda one: one.air[:, 0]),
        ("relative humidity [%]", lambda one: one.air[:, 2]),
        ("CO₂ [ppm]", lambda one: one.air[:, 1]),
        ("boiler [%]", lambda one: one.control("uBoil")),
        ("vents [%]", lambda one: one.control("uVent")),
        ("screen [%]", lambda one: one.control("uThScr")),
        ("CO₂ supply [%]", lambda one: one.control("uCo2")),
    )
    figure, axes = plt.subplots(len(rows), 2, figsize=(8.0, 11.0), sharex=True, sharey="row")
    hours = np.arange(best.scenario.task.steps_per_day) * 24.0 / best.scenario.task.steps_per_day
    for row, (label, series) in enumerate(rows):
        for column, (month, days) in enumerate(MONTHS.items()):
            axis = axes[row, column]
            axis.plot(hours, policy.daily(series(policy), days), color=ORANGE, lw=1.2, label=f"{POLICY}, the best trained policy")
            axis.plot(hours, best.daily(series(best), days), color=BLUE, lw=1.8, label="best known plan")
            if row == 0:
                axis.set_title(month)
            if row == 1:
                axis.axhline(85.0, color=GREY, ls="--", lw=0.9)
            if column == 0:
                axis.set_ylabel(label)
    for axis in axes[-1]:
        axis.set(xlabel="hour of the day (UTC)", xlim=(0, 24), xticks=range(0, 25, 6))
    axes[0, 0].legend(loc="upper left", fontsize=8)
    return figure


def lamps(seasons: dict[str, Season]) -> Any:
    """Where lamps are lit when electricity costs a third: by day of the season and hour."""
    cheap = seasons["cheap"]
    day = cheap.scenario.task.steps_per_day
    figure, (left, right) = plt.subplots(1, 2, figsize=(8.0, 3.2), width_ratios=(2, 1))
    picture = left.imshow(
        cheap.control("uLamp").reshape(-1, day).T, aspect="auto", origin="lower", extent=(0, 60, 0, 24), cmap="inferno", vmin=0, vmax=100
    )
    figure.colorbar(picture, ax=left, label="lamps [% of capacity]")
    left.set(xlabel="day of the season", ylabel="hour of the day (UTC)", yticks=range(0, 25, 6))
    left.grid(visible=False)
    hours = np.arange(day) * 24.0 / day
    for colour, (month, days) in zip((BLUE, GREEN), MONTHS.items(), strict=True):
        right.plot(hours, cheap.control("uLamp").reshape(-1, day)[days].mean(axis=0), color=colour, label=month)
    right.set(xlabel="hour of the day (UTC)", ylabel="lamps, mean [%]", xlim=(0, 24), xticks=range(0, 25, 6), ylim=(0, None))
    right.legend()
    return figure


def filled(text: str, seasons: dict[str, Season]) -> str:
    """The page with its tables between its marks."""
    return with_tables(text, {"season": "\n".join(season_table(seasons)), "climate": "\n".join(climate_table(seasons))})


COLUMNS = {"policy": f"`{POLICY}`", "best": "best known plan", "cheap": "electricity at 0.10 EUR/kWh"}


def season_table(seasons: dict[str, Season]) -> list[str]:
    """What the 60 days yield and use."""
    rows = {
        "reward, at the paper's prices": [f"{seasons[name].reward:,.1f}" if name != "cheap" else "" for name in COLUMNS],
        "profit [EUR/m2]": [f"{one.profit:.2f}" for one in in_order(seasons)],
        "fruit [kg/m2]": [f"{one.used('fruit_fresh'):.2f}" for one in in_order(seasons)],
        "heat [kWh/m2]": [f"{one.used('heat'):.1f}" for one in in_order(seasons)],
        "CO2 [kg/m2]": [f"{one.used('co2_dosed'):.2f}" for one in in_order(seasons)],
        "lamps [kWh/m2]": [f"{one.used('electricity'):.1f}" for one in in_order(seasons)],
    }
    return _table(rows)


def climate_table(seasons: dict[str, Season]) -> list[str]:
    """Means of the climate by day and night."""

    def mean(series: Floats, where: NDArray[np.bool_], unit: str) -> str:
        return f"{series[where].mean():.{0 if unit == 'ppm' else 1}f}"

    rows: dict[str, list[str]] = {}
    for month, days in MONTHS.items():
        steps = np.zeros(len(next(iter(seasons.values())).controls), bool)
        day = paper_task().steps_per_day
        steps[days.start * day : days.stop * day] = True
        rows[f"{month}: air in the dark [°C]"] = [mean(one.air[:, 0], steps & (one.light < DARK), "") for one in in_order(seasons)]
        noon = (one_hour := paper_hours()) >= 11.0
        noon &= one_hour < 15.0
        rows[f"{month}: air from 11 to 15 h [°C]"] = [mean(one.air[:, 0], steps & noon, "") for one in in_order(seasons)]
        rows[f"{month}: mean of 24 h [°C]"] = [mean(one.air[:, 0], steps, "") for one in in_order(seasons)]
        rows[f"{month}: CO2 by day [ppm]"] = [mean(one.air[:, 1], steps & (one.light > 50.0), "ppm") for one in in_order(seasons)]
        rows[f"{month}: vents from 11 to 15 h [%]"] = [mean(one.control("uVent"), steps & noon, "") for one in in_order(seasons)]
    rows["steps with humidity from 84.5 to 85.5 % [%]"] = [
        f"{100.0 * np.mean(np.abs(one.air[:, 2] - 85.0) <= 0.5):.0f}" for one in in_order(seasons)
    ]
    rows["screen closed in the dark [% of the time]"] = [
        f"{100.0 * np.mean(one.control('uThScr')[one.light < DARK] > 50.0):.0f}" for one in in_order(seasons)
    ]
    return _table(rows)


def paper_hours() -> Floats:
    """Hour of the day at the end of each step."""
    return Scenario.of(paper_task(), SEED).calendar[1:, 0]


def in_order(seasons: dict[str, Season]) -> list[Season]:
    """The seasons as the tables show them."""
    return [seasons[name] for name in COLUMNS]


def _table(rows: dict[str, list[str]]) -> list[str]:
    head = ["| | " + " | ".join(COLUMNS.values()) + " |", "|---|" + "---:|" * len(COLUMNS)]
    return [*head, *(f"| {name} | {' | '.join(cells)} |" for name, cells in rows.items())]


if __name__ == "__main__":
    main()
