"""What pages of the energy rules with other numbers earn, in the same seasons, all side by side in one simulation.

    python baselines/compare_pages.py FullSeasonEnergy-v1 page.yml --change co2_bought=0 --change co2_bought=0,lamps_fruit=0.1
    python baselines/compare_pages.py FullSeasonEnergy-v1 page.yml --other tuned.yml --split validation --seasons 30 --kernel reference

Each `--change` is the page with these numbers in place of its own, each `--other` another page. Prints the page's mean reward, and for
each of the others what it earns more [EUR/m2], its 95 % interval over the seasons (Student's t, paired), and in how many seasons it is
better. Training seasons are those from `--first-seed` on; those of the validation split have the seeds of `glbench evaluate --split
validation`. The test split cannot be named. `--out FILE` writes reward, profit and price of violations of every season [EUR/m2]. Put
what you choose into a page, and confirm it in other seasons.
"""

from __future__ import annotations

import argparse
import csv
import io
import sys
from pathlib import Path

import numpy as np
import yaml

from glbench.agents.energy_rules import EnergyRulesAgent, EnergyRuleSettings
from glbench.agents.tuned_rules import read_rule_page
from glbench.arrays import Floats
from glbench.env import Simulation
from glbench.errors import SubmissionError, refuse
from glbench.kernel import make_kernel
from glbench.leaderboard.statistics import estimate_difference
from glbench.resources import write_atomically
from glbench.settings import validated
from glbench.tasks import TaskSpec, get_task, task_card
from glbench.tasks.record import FIRST_TRAINING_SEED
from glbench.training.periodic_evaluation import season_sums

SUMS = ("reward", "epi", "penalty")


def changed(page: EnergyRuleSettings, text: str) -> EnergyRuleSettings:
    """The page with the numbers of ``text``, such as ``co2_bought=0,lamps_fruit=0.1``. Raises ``SubmissionError`` for a wrong one."""
    parts = [part.partition("=") for part in text.split(",")]
    if wrong := [name for name, sign, _ in parts if not sign]:
        refuse(f"--change '{text}': '{wrong[0]}' has no value. Write name=value, with commas between several.", SubmissionError)
    numbers = {name: yaml.safe_load(value) for name, _, value in parts}  # numbers become numbers, all else is refused below
    content = page.model_dump() | numbers
    return validated(EnergyRuleSettings, content, "the numbers", Path(f"--change {text}"))


def played(task: TaskSpec, pages: list[EnergyRuleSettings], seeds: list[int], preset: str) -> dict[str, Floats]:
    """Sums over every season, by name ``(pages, seasons)`` [EUR/m2]."""
    rows = len(pages) * len(seeds)
    agent = EnergyRulesAgent([page for page in pages for _ in seeds])
    agent.reset(task_card(task), rows)
    simulation = Simulation(task, rows, make_kernel(task.model_value, task.step_seconds, preset=preset))
    sums = season_sums(simulation, seeds * len(pages), agent.act)
    return {name: sums[name].reshape(len(pages), len(seeds)) for name in SUMS}


def table(names: list[str], seeds: list[int], sums: dict[str, Floats]) -> str:
    """A line for every page and season, as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["page", "seed", *SUMS])
    for row, name in enumerate(names):
        writer.writerows([name, seed, *(f"{sums[one][row, column]:.10g}" for one in SUMS)] for column, seed in enumerate(seeds))
    return text.getvalue()


def main() -> int:
    """Compare, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("task")
    parser.add_argument("page", type=Path)
    parser.add_argument("--change", action="append", default=[], metavar="NAME=VALUE[,...]", help="the page with other numbers")
    parser.add_argument("--other", action="append", default=[], type=Path, metavar="PAGE", help="another page")
    parser.add_argument("--split", choices=("training", "validation"), default="training")
    parser.add_argument("--seasons", type=int, default=8)
    parser.add_argument("--first-seed", type=int, default=3 * FIRST_TRAINING_SEED + 1000, help="of the training seasons")
    parser.add_argument("--kernel", choices=("fast", "reference"), default="fast")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    task = get_task(options.task).in_split(options.split)
    first = task.evaluation.first_seed if options.split == "validation" else options.first_seed
    seeds = list(range(first, first + options.seasons))
    page = read_rule_page(options.page, EnergyRuleSettings).numbers
    names = [options.page.stem, *options.change, *(str(file) for file in options.other)]
    pages = [page, *(changed(page, text) for text in options.change)]
    pages += [read_rule_page(file, EnergyRuleSettings).numbers for file in options.other]
    sums = played(task, pages, seeds, options.kernel)
    if options.out is not None:
        write_atomically(options.out, table(names, seeds, sums))
    reward = sums["reward"]
    print(f"{task.id}, {options.split} split, seeds {seeds[0]} to {seeds[-1]}: {names[0]} earns {reward[0].mean():.2f} EUR/m2")
    for row in sorted(range(1, len(names)), key=lambda row: -reward[row].mean()):
        more = estimate_difference([reward[row]], [reward[0]])
        interval, better = more.interval(), np.count_nonzero(reward[row] > reward[0])
        print(f"{more.value:+.2f} ({interval.low:+.2f} to {interval.high:+.2f}) EUR/m2, in {better} of {len(seeds)}: {names[row]}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
