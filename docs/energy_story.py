"""Tables and picture of docs/energy-story.md: ``python -m docs.energy_story``.

What rules, learned policies, predictive control and best known plans earn and do on the tasks of the suite energy, from released
results and their profiles. Nothing is simulated. Of each task the runs count that all of them have. Trainings of one recipe count as
one: means over them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from docs.tables import with_tables
from docs.what_the_best_does import BLUE, GREEN, ORANGE, STYLE
from glbench.episodes.signals import KWH_A_CUBIC_METRE
from glbench.evaluation import Result, load_result
from glbench.evaluation.profiles import profile_path, read_profile
from glbench.evaluation.profiles.record import unpack
from glbench.resources import data_folder, write_atomically
from glbench.tasks import get_task, list_suites

mpl.use("agg")
from matplotlib import pyplot as plt

Floats = NDArray[np.float64]

DOCS = Path(__file__).resolve().parent
PAGE, PICTURE = DOCS / "energy-story.md", DOCS / "images" / "energy-day.png"
AGENTS = {"rule_based_energy": "rules", "ppo_energy": "learned", "mpc_energy": "predictive control", "best_known": "plan"}
TRAININGS = {"ppo_energy": ("ppo_energy", *(f"ppo_energy_seed{seed}" for seed in range(1, 5)))}
"""Results that an agent stands for, where a recipe was trained more than once."""
COLOURS = {"rule_based_energy": ORANGE, "ppo_energy": "#cc79a7", "mpc_energy": BLUE, "best_known": GREEN}

Items = Sequence[tuple[str, int, Callable[["Outcome"], float | None]]]
"""Rows of a table: what, decimals, and the number, ``None`` where the task has no such thing."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What an agent did in the runs of a task that all agents have: means over these, and over its trainings."""

    task: str
    agent: str
    results: tuple[Result, ...]
    seeds: tuple[int, ...]

    def mean(self, *names: str) -> float | None:
        """Mean of the sum of these metrics; ``None`` where the task has none of them."""
        present = [name for name in names if name in self.results[0].units]
        if not present:
            return None
        runs = [run for result in self.results for run in result.runs if run.seed in self.seeds]
        return float(np.mean([sum(run.metrics[name] for name in present) for run in runs]))

    def ratio(self, amount: str, of: str) -> float | None:
        """Mean of ``amount`` divided by that of ``of``; ``None`` where one is missing or nothing."""
        above, below = self.mean(amount), self.mean(of)
        return above / below if above is not None and below else None

    def by_hour(self, column: str, days: int) -> Floats:
        """Mean amount in each hour of the day ``(24,)``, a day."""
        of_trainings = []
        for result in self.results:
            profile = read_profile(profile_path(place(self.task, result.agent.name)))
            chosen = [result.evaluation.seeds.index(seed) for seed in self.seeds]
            of_trainings.append(unpack(profile.document["hours"][column])[:, chosen].mean(axis=1))
        return np.mean(of_trainings, axis=0) / days


def place(task: str, agent: str) -> Path:
    """The file of a released result."""
    return data_folder("reports/released/results") / task.rpartition("/")[2] / f"{agent}.json"


def outcomes() -> dict[str, list[Outcome]]:
    """Of each task of the suite, of each agent."""
    found = {}
    for task in list_suites()["energy"]:
        released = {agent: tuple(load_result(place(task, name)) for name in TRAININGS.get(agent, (agent,))) for agent in AGENTS}
        seeds = set.intersection(*(set(one.evaluation.seeds) for results in released.values() for one in results))
        found[task] = [Outcome(task, agent, results, tuple(sorted(seeds))) for agent, results in released.items()]
    return found


def earned() -> Items:
    """Rows of what a season earned and cost [EUR/m2]."""
    return [
        ("score [EUR/m²]", 2, lambda one: one.mean("reward")),
        ("fruit [EUR/m²]", 2, lambda one: one.mean("revenue_harvest", "revenue_growth")),
        ("power sold [EUR/m²]", 2, lambda one: one.mean("revenue_power")),
        ("power bought [EUR/m²]", 2, lambda one: negative(one.mean("cost_electricity", "cost_power"))),
        ("heat, or gas [EUR/m²]", 2, lambda one: negative(one.mean("cost_heat", "cost_gas"))),
        ("CO2 [EUR/m²]", 2, lambda one: negative(one.mean("cost_co2"))),
        ("wear of the engine [EUR/m²]", 2, lambda one: negative(one.mean("cost_engine"))),
        ("violations [EUR/m²]", 2, lambda one: negative(one.mean("penalty"))),
    ]


def done() -> Items:
    """Rows of what was done for it, a season."""
    return [
        ("fruit, picked and grown on the plants [kg/m²]", 1, lambda one: one.mean("fruit_picked", "fruit_gained")),
        ("power bought [kWh/m²]", 1, lambda one: one.mean("electricity", "electricity_bought")),
        (
            "mean price paid [EUR/kWh]",
            3,
            lambda one: one.ratio("cost_electricity", "electricity") or one.ratio("cost_power", "electricity_bought"),
        ),
        ("power sold [kWh/m²]", 1, lambda one: one.mean("electricity_sold")),
        ("mean price earned [EUR/kWh]", 3, lambda one: one.ratio("revenue_power", "electricity_sold")),
        ("engine [h]", 0, lambda one: one.mean("engine_hours")),
        ("gas [kWh/m²]", 1, lambda one: one.mean("gas")),
        ("gas, as natural gas [m³/m²]", 1, lambda one: cubic_metres(one.mean("gas"))),
        ("heat [kWh/m²]", 1, lambda one: one.mean("heat")),
        ("CO2 bought [kg/m²]", 1, lambda one: one.mean("co2_dosed", "co2_bought")),
        ("too humid [h]", 0, lambda one: one.mean("hours_relative_humidity_high")),
        ("too cold [h]", 0, lambda one: one.mean("hours_air_temperature_low")),
    ]


def cubic_metres(energy: float | None) -> float | None:
    """Volume of natural gas [m3 m-2] with this energy [kWh m-2], by its lower heating value."""
    return None if energy is None else energy / KWH_A_CUBIC_METRE


def negative(value: float | None) -> float | None:
    """A cost as what it takes from the score."""
    return None if value is None else -value


def table(of_agents: list[Outcome]) -> str:
    """A row an item of money, then of what was done; a column an agent. Without items that the task does not have."""
    lines = ["| | " + " | ".join(AGENTS[one.agent] for one in of_agents) + " |", "|---|" + "---:|" * len(of_agents)]
    for name, digits, number in [*earned(), *done()]:
        values = [number(one) for one in of_agents]
        if None not in values:
            lines.append(f"| {name} | " + " | ".join(f"{value:.{digits}f}".replace("-", "−") for value in values) + " |")
    return "\n".join(lines)


def picture(of_task: dict[str, list[Outcome]]) -> None:
    """When it is lit, when the engine runs and when heat is stored, by hour of the day."""
    panels = [
        ("glbench/WinterLED-v1", "electricity", "Lamps, WinterLED-v1", "kWh/m² in the hour, a day"),
        ("glbench/SpringEnergy-v1", "electricity_bought", "Power bought, SpringEnergy-v1", "kWh/m² in the hour, a day"),
        ("glbench/SpringEnergy-v1", "engine_hours", "Engine, SpringEnergy-v1", "h in the hour, a day"),
        ("glbench/SpringEnergy-v1", "buffer_gained", "Into the buffer, SpringEnergy-v1", "kWh/m² in the hour, a day"),
    ]
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(2, 2, figsize=(8.4, 5.6))
        for axis, (task, column, title, unit) in zip(axes.flat, panels, strict=True):
            days = get_task(task).weather.days
            for one in of_task[task]:
                profile = one.by_hour(column, days)
                axis.stairs(profile, np.arange(25), color=COLOURS[one.agent], label=AGENTS[one.agent], baseline=None, linewidth=1.6)
            axis.set(title=title, xlabel="hour of the day", ylabel=unit, xlim=(0, 24), xticks=range(0, 25, 6))
        axes[0, 0].set_ylim(bottom=0.03)
        axes[0, 0].legend(loc="lower left")
        figure.savefig(PICTURE, dpi=120, metadata={"Software": None})
        plt.close(figure)


def filled(page: str, of_task: dict[str, list[Outcome]]) -> str:
    """``page`` with a table a task."""
    return with_tables(page, {task.rpartition("/")[2]: table(of_agents) for task, of_agents in of_task.items()})


def main() -> None:
    """Make the picture and fill the tables of the page."""
    of_task = outcomes()
    picture(of_task)
    write_atomically(PAGE, filled(PAGE.read_text(encoding="utf-8"), of_task))


if __name__ == "__main__":
    main()
