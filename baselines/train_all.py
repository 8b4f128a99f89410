"""Train the shipped agents, one after the other: run it again after an interruption and it continues.

    python baselines/train_all.py --out runs/baselines             # everything, delta 0, 10 and 30 % first
    python baselines/train_all.py --out runs/baselines --list      # what is done and what is left
    python baselines/train_all.py --out runs/baselines --ship      # put what is done into baselines/

On one free core a training with Stable-Baselines3 takes about half an hour, one with the compiled PPO a few minutes. What is finished is
skipped; what was interrupted continues from its last checkpoint, to the same weights as without the interruption.
"""

from __future__ import annotations

import argparse
import logging
import os
import shutil
import sys
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path

from imitate import imitate, read_imitation  # beside this file

from glbench.errors import did_you_mean
from glbench.resources import write_atomically
from glbench.tasks import get_task
from glbench.training import CurvePoint, Progress, read_settings, train
from glbench.training.card import CARD, POLICY, read_card, settings_digest, to_toml
from glbench.training.compiled import train_compiled
from glbench.training.compiled_settings import read_compiled_settings
from glbench.training.periodic_evaluation import CURVE
from glbench.training.run import export_best
from glbench.training.season_search import SearchSettings, read_season_search, search, train_then_search

HERE = Path(__file__).resolve().parent
LEVELS = ("00", "10", "30", "05", "15", "20", "25")
SEEDED_LEVELS = ("00", "10", "30")
SETTINGS = {
    "ppo": "ppo/paper.yml",
    "sac": "sac/sac.yml",
    "ppo_tuned": "ppo_tuned/ppo_tuned.yml",
    "ppo_fast": "ppo/fast.yml",
    "ppo_memory": "ppo/memory.yml",
    "ppo_long": "ppo/long.yml",
    "sac_fast": "sac/fast.yml",
    "outdoor": "ppo/memory.yml",
    "ppo_greenhouse": "ppo/fast.yml",
    "ppo_memory_greenhouse": "ppo/memory.yml",
    "ppo_energy": "ppo/memory.yml",
    "ppo_energy_tuned": "ppo_energy_tuned/ppo.yml",
    "ppo_harvest": "ppo_harvest/climate.yml",
    "imitation_lettuce": "imitation_lettuce/imitation.yml",
    "ppo_lettuce": "ppo_lettuce/ppo.yml",
    "sac_lettuce": "sac_lettuce/sac.yml",
    "td3_lettuce": "td3_lettuce/td3.yml",
}
"""Settings of each recipe, in this folder."""
SEARCHES = {"ppo_harvest": ("ppo_harvest/day.yml", "ppo_harvest/all.yml")}
"""Searches over whole seasons that follow the trainings of a recipe."""
VIEWS = {"outdoor": ("blind",), "ppo_greenhouse": ("sensors",), "ppo_memory_greenhouse": ("memory",), "ppo_harvest": ("memory",)}
"""What the agents of a recipe look at (docs/ladder.md), where it is not all that a task shows."""
COMPILED = ("ppo_fast", "ppo_memory", "ppo_long", "ppo_energy", "ppo_energy_tuned", *VIEWS)
ALGORITHMS = {
    "ppo": "ppo",
    "sac": "sac",
    "sac_fast": "sac",
    "ppo_lettuce": "ppo",
    "sac_lettuce": "sac",
    "td3_lettuce": "stable_baselines3.TD3",
}
"""Algorithms of Stable-Baselines3 by the recipes that use them."""
OF_CONTROL = ("Spring-v1", "SpringYears-v1", "SpringMismatch-v1", "Lettuce-v1")
"""The suite ``control-2025``, on which the compiled PPO, with and without memory, and SAC train; for long only where tomatoes grow."""
OF_GREENHOUSE = ("outdoor", "ppo_greenhouse", "ppo_memory_greenhouse")
"""Recipes for the tasks in ``GREENHOUSE_TASKS``. The mean of ``outdoor`` is the zero of a task's scores."""
GREENHOUSE_TASKS = {"GreenhouseReal-v1": (5, 5, 5), "Lettuce-v2": (5, 3, 3)}
"""Trainings of each recipe of ``OF_GREENHOUSE``, by task."""
OF_ENERGY = ("WinterLED-v1", "SpringEnergy-v1", "FullSeason-v1", "FullSeasonEnergy-v1")
"""The suite ``energy``, on which the compiled PPO with a memory trains, five times each."""
IMITATIONS = ("imitation_lettuce",)
"""Recipes that imitate a controller."""
CARD_OF_RECIPE = "card.in.toml"
"""Becomes the agent's card with the first policy: an agent without weights is none."""
log = logging.getLogger("train_all")


@dataclass(frozen=True)
class Job:
    """One training: recipe, task and seed.

    ``ppo`` and ``sac`` are trained as in the paper, ``ppo_tuned`` continues where PPO ended, ``sac_fast`` is SAC on many greenhouses, and
    the recipes in ``COMPILED`` are the compiled PPO.
    """

    recipe: str
    task: str
    seed: int

    @property
    def label(self) -> str:
        """The task in file names; for the paper's tasks the level, such as ``delta10``."""
        return self.task.removeprefix("Schiphol2010-").removesuffix("-v1").lower()

    @property
    def name(self) -> str:
        """Folder of the training."""
        return f"{self.recipe}_{self.label}_seed{self.seed}"

    @property
    def agent(self) -> str:
        """Baseline that the policy belongs to; its card says which recipe and seed, by which the leaderboard joins trainings."""
        return self.recipe if self.seed == 0 else f"{self.recipe}_seed{self.seed}"

    @property
    def settings(self) -> Path:
        """The recipe's settings."""
        return HERE / SETTINGS[self.recipe]

    @property
    def searches(self) -> tuple[Path, ...]:
        """Settings of the searches that follow, the last of which makes the policy."""
        return tuple(HERE / file for file in SEARCHES.get(self.recipe, ()))


def plan() -> list[Job]:
    """Every training, in order."""
    paper = [Job(recipe, _paper(level), 0) for level in LEVELS for recipe in ("ppo", "sac")]
    seeds = [Job(recipe, _paper(level), seed) for seed in (1, 2) for level in SEEDED_LEVELS for recipe in ("ppo", "sac")]
    fast = [Job("ppo_fast", task, seed) for task in OF_CONTROL for seed in range(5)]
    fast += [Job("ppo_fast", _paper(level), seed) for level in SEEDED_LEVELS for seed in range(3)]
    memory = [Job("ppo_memory", task, seed) for task in OF_CONTROL for seed in range(5)]
    long = [Job("ppo_long", task, seed) for task in OF_CONTROL[:3] for seed in range(5)]
    off_policy = [Job("sac_fast", task, 0) for task in OF_CONTROL]
    off_policy += [Job("sac_fast", "GreenhouseReal-v1", seed) for seed in range(2)]
    greenhouse = [
        Job(recipe, task, seed)
        for task, trainings in GREENHOUSE_TASKS.items()
        for recipe, count in zip(OF_GREENHOUSE, trainings, strict=True)
        for seed in range(count)
    ]
    energy = [Job("ppo_energy", task, seed) for task in OF_ENERGY for seed in range(5)]
    energy += [Job("ppo_energy_tuned", "SpringEnergy-v1", seed) for seed in range(5)]
    harvest = [Job("ppo_harvest", "LettuceHarvest-v1", seed) for seed in range(3)]
    of_classic = {**dict.fromkeys((*IMITATIONS, "ppo_lettuce"), 5), "sac_lettuce": 3, "td3_lettuce": 3}
    classic = [Job(recipe, "LettuceClassic-Delta05-v1", seed) for recipe, count in of_classic.items() for seed in range(count)]
    of_others = [*off_policy, *greenhouse, *energy, *harvest, *classic]
    return [*paper, Job("ppo_tuned", _paper("10"), 0), *seeds, *fast, *memory, *long, *of_others]


def _paper(level: str) -> str:
    return f"Schiphol2010-Delta{level}-v1"


class LogLines:
    """Says how a training goes, a line at a time."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._last = time.monotonic()

    def on_progress(self, progress: Progress) -> None:
        """A line a minute."""
        if time.monotonic() - self._last < 60:
            return
        self._last = time.monotonic()
        seconds = progress.seconds_left
        log.info(
            "%s: %d of %d steps, %.0f steps/s, %s min left, season reward %s",
            self._name, progress.steps, progress.total_steps, progress.steps_per_second,
            "?" if seconds is None else f"{seconds / 60:.0f}",
            "-" if progress.season_reward is None else f"{progress.season_reward:.0f}",
        )  # fmt: skip

    def on_evaluation(self, point: CurvePoint) -> None:
        """A line an evaluation."""
        sums = point.result.sums
        log.info(
            "%s: evaluation at %d steps (%.0f s): reward %.1f, EPI %.2f EUR/m2, penalty %.1f%s",
            self._name, point.steps, point.seconds, sums["reward"], sums["epi"], sums["penalty"], " (best)" if point.is_best else "",
        )  # fmt: skip

    def on_saved(self, steps: int) -> None:
        """Nothing to say."""


def main() -> int:
    """Train what is left of the plan, list it, or ship what is done."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the trainings")
    parser.add_argument("--only", nargs="*", default=[], metavar="NAME", help="some of them, such as ppo_delta10_seed0")
    parser.add_argument("--list", action="store_true", help="say what is done and leave")
    parser.add_argument("--ship", action="store_true", help="copy policies, learning curves and cards of what is done to baselines/")
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s", datefmt="%H:%M:%S", stream=sys.stdout)
    names = [job.name for job in plan()]
    for name in arguments.only:
        if name not in names:
            parser.error(f"there is no training '{name}'.{did_you_mean(name, names)}")
    jobs = [job for job in plan() if not arguments.only or job.name in arguments.only]
    for job in jobs:
        if arguments.list:
            print(f"{job.name:26} {_state(job, arguments.out / job.name)}")
        elif arguments.ship:
            _ship(job, arguments.out / job.name)
        else:
            _train(job, arguments.out / job.name)
    return 0


def _train(job: Job, folder: Path) -> None:
    task = get_task(job.task)
    listeners = [LogLines(job.name)]
    if job.recipe in COMPILED:
        compiled = read_compiled_settings(job.settings, task, view=VIEWS.get(job.recipe))
        searches = [read_season_search(file, task.id, file) for file in job.searches]  # their start is the stage before
        trained = train_then_search(
            task, compiled, folder, train=train_compiled, searches=searches, seed=job.seed, resume=True, listeners=listeners
        )
    elif job.recipe in IMITATIONS:
        trained = imitate(task, read_imitation(job.settings), folder, seed=job.seed, listeners=listeners)
    elif job.recipe in ALGORITHMS:
        settings = read_settings(job.settings, ALGORITHMS[job.recipe], task.id)
        trained = train(task, settings, folder, seed=job.seed, resume=True, listeners=listeners)
    else:
        sought = _search_settings(job, task.id, folder.parent)
        trained = search(task, sought, folder, seed=job.seed, resume=True, listeners=listeners)
    if not trained.already_done:
        log.info("%s: done, best reward %.1f at %d steps", job.name, trained.best_reward, trained.best_steps)
    if not trained.learnt:
        log.warning("%s: nothing was learnt: no policy was better than the one that it began with", job.name)


def _search_settings(job: Job, task_id: str, trainings: Path) -> SearchSettings:
    """Settings of a search, which starts from PPO as trained in ``trainings``, or as shipped when it was not trained there."""
    trained = trainings / Job("ppo", job.task, job.seed).name / POLICY
    return read_season_search(job.settings, task_id, trained if trained.is_file() else None)


def _ship(job: Job, folder: Path) -> None:
    """Copy what people and evaluations need of a finished training to its baseline; one that learnt nothing stays out."""
    if _state(job, folder) != "done":
        return
    if not (folder / POLICY).is_file():
        export_best(folder)
    home = HERE / job.agent
    name = job.label
    for place in ("weights", "training"):
        (home / place).mkdir(parents=True, exist_ok=True)
    shutil.copyfile(folder / POLICY, home / f"weights/{name}.npz")
    shutil.copyfile(folder / CURVE, home / f"training/{name}.csv")
    making = tomllib.loads((folder / CARD).read_text(encoding="utf-8"))
    if "settings" in making:  # the policy's place
        making["settings"] = f"../weights/{name}.npz"
    making["training"]["learning_curve"] = f"{name}.csv"
    making["training"]["settings"] = os.path.relpath((job.settings, *job.searches)[-1], home / "training")
    if "made" in making:
        making["made"] = making["made"].replace("settings.yml", making["training"]["settings"])
    write_atomically(home / f"training/{name}.toml", to_toml(making))
    card = tomllib.loads((HERE / job.recipe / CARD_OF_RECIPE).read_text(encoding="utf-8"))
    if job.seed:
        card["title"] += f"; training seed {job.seed}"
        card["made"] = card["made"].replace("--seed 0", f"--seed {job.seed}").replace("_seed0", f"_seed{job.seed}")
        levels = ", for uncertainties of 0, 10 and 30 % only" if job.recipe in ("ppo", "sac") else ""
        card["description"] = f"As {job.recipe}, trained with seed {job.seed}{levels}."
    card["training"] = {"recipe": job.recipe, "seed": job.seed}
    write_atomically(home / CARD, to_toml(card))
    log.info("%s: shipped to %s", job.name, home.relative_to(HERE.parent))


def _state(job: Job, folder: Path) -> str:
    """``done`` when the folder holds this very training to its end."""
    card = read_card(folder / CARD)
    if card is None:
        return "begun" if folder.exists() else "-"
    task = get_task(job.task)
    if job.searches:
        before = folder.with_name(f"{folder.name}-stage{len(job.searches)}") / POLICY
        sought = read_season_search(job.searches[-1], task.id, before)
        digest, goal, reached = sought.digest, sought.generations, card["training"]["generations"]
    elif job.recipe in COMPILED:
        compiled = read_compiled_settings(job.settings, task, view=VIEWS.get(job.recipe))
        digest, goal, reached = compiled.digest, compiled.updates * compiled.rollout, card["training"]["steps"]
    elif job.recipe in IMITATIONS:
        imitation = read_imitation(job.settings)
        digest, goal, reached = imitation.digest, imitation.rounds, card["training"]["rounds"]
    elif job.recipe in ALGORITHMS:
        settings = read_settings(job.settings, ALGORITHMS[job.recipe], task.id)
        digest, goal, reached = settings_digest(settings), settings.n_timesteps, card["training"]["steps"]
    else:
        sought = _search_settings(job, task.id, folder.parent)
        digest, goal, reached = sought.digest, sought.generations, card["training"]["generations"]
    identity = card["task"]["digest"], card["training"]["settings_digest"], card["training"]["seed"]
    same = identity == (task.digest, digest, job.seed)
    if not same:
        return "another training"
    if reached < goal:
        return "begun"
    return "done" if card["best"]["learnt"] else "nothing learnt"


if __name__ == "__main__":
    sys.exit(main())
