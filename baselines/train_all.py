"""Train the shipped PPO and SAC agents, one after the other: run it again after an interruption and it goes on.

    python baselines/train_all.py --out runs/baselines             # all 26 trainings, delta 0, 10 and 30 % first
    python baselines/train_all.py --out runs/baselines --list      # what is done and what is left

Each training takes 20 to 40 minutes on one core. What is finished is skipped; what was interrupted continues from its last
checkpoint, to the same weights as without the interruption.
"""

from __future__ import annotations

import argparse
import logging
import sys
import time
from pathlib import Path

from glbench.tasks import get_task
from glbench.training import CurvePoint, Progress, read_settings, shipped_settings, train
from glbench.training.card import CARD, read_card

LEVELS = ("00", "10", "30", "05", "15", "20", "25")
SEEDED_LEVELS = ("00", "10", "30")
log = logging.getLogger("train_all")


def plan() -> list[tuple[str, str, int]]:
    """Algorithm, level and seed of every training, in order."""
    first = [(algorithm, level, 0) for level in LEVELS for algorithm in ("ppo", "sac")]
    more = [(algorithm, level, seed) for seed in (1, 2) for level in SEEDED_LEVELS for algorithm in ("ppo", "sac")]
    return first + more


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
        left = progress.seconds_left
        log.info(
            "%s: %d of %d steps, %.0f steps/s, %s min left, season reward %s",
            self._name, progress.steps, progress.total_steps, progress.steps_per_second,
            "?" if left is None else f"{left / 60:.0f}",
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
    """Train what is left of the plan."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the trainings")
    parser.add_argument("--only", nargs="*", default=[], metavar="NAME", help="some of them, such as ppo_delta10_seed0")
    parser.add_argument("--list", action="store_true", help="say what is done and leave")
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s", datefmt="%H:%M:%S", stream=sys.stdout)
    for algorithm, level, seed in plan():
        name = f"{algorithm}_delta{level}_seed{seed}"
        if arguments.only and name not in arguments.only:
            continue
        folder = arguments.out / name
        if arguments.list:
            done = read_card(folder / CARD) is not None
            print(f"{name:22} {'done' if done else 'begun' if folder.exists() else '-'}")
            continue
        task = get_task(f"Schiphol2010-Delta{level}-v1")
        settings = read_settings(shipped_settings(algorithm), algorithm, task.id)
        trained = train(task, settings, folder, seed=seed, resume=True, listeners=[LogLines(name)])
        if not trained.already_done:
            log.info("%s: done, best reward %.1f at %d steps", name, trained.best_reward, trained.best_steps)
    return 0


if __name__ == "__main__":
    sys.exit(main())
