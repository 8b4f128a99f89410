"""One PPO policy that learns tomato and lettuce at once, beside a policy for each crop by the same recipe.

    python -m benchmarks.two_crops --work FOLDER             # trains what is missing; may be interrupted
    python -m benchmarks.two_crops --work FOLDER --ship      # puts what is done into baselines/

`baselines/ppo_two_crops/two_crops.yml` has the settings. Half of the greenhouses of the policy for both crops grow tomatoes, half lettuce.
It sees the observations of both tasks and one input that says which crop grows; observations that a task lacks are 0 after normalisation.
Within one task these inputs are constant, so they are added to the first bias. The result is an ordinary policy for that task, as baselines
hold it.

The best policy is chosen on the validation splits. For two crops this is the policy with the highest mean of the two scores [EUR m-2], as
for a grower with equal areas of both crops. This script uses no test split.
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
import time
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from benchmarks.mixed_vec_env import Greenhouses, Mixed, restricted
from glbench.agents.network_policy import FAST, ActorAgent
from glbench.errors import GlbenchError, TrainingError, refuse
from glbench.resources import data_folder, write_atomically
from glbench.tasks import TaskSpec, get_task, task_card
from glbench.training.algorithms import make_model
from glbench.training.card import CARD, POLICY, TrainingFacts, read_card, settings_digest, to_toml, training_table, write_card
from glbench.training.periodic_evaluation import CURVE, History, Probe, ProbeResult
from glbench.training.run import prepare_torch
from glbench.training.settings import TrainingSettings, read_settings
from glbench.training.vec_env import Normalizer

SETTINGS, ALGORITHM = data_folder("baselines") / "ppo_two_crops" / "two_crops.yml", "ppo"
TASKS = {"spring": "Spring-v1", "lettuce": "Lettuce-v1"}
TRAININGS = {"two_crops": ("spring", "lettuce"), "spring": ("spring",), "lettuce": ("lettuce",)}
"""Tasks of each kind of training."""
SEEDS = range(3)
log = logging.getLogger("two_crops")


@dataclass(frozen=True)
class Training:
    """One training: its tasks by name, their settings, and the learner's seed."""

    kind: str
    tasks: dict[str, TaskSpec]
    settings: dict[str, TrainingSettings]
    seed: int

    @classmethod
    def of(cls, kind: str, seed: int, file: Path = SETTINGS) -> Training:
        """The training of a kind. Raises ``TrainingError`` when the tasks' settings differ in more than ``accrual`` and ``gamma``."""
        tasks = {name: get_task(TASKS[name]) for name in TRAININGS[kind]}
        settings = {name: read_settings(file, ALGORITHM, task.id) for name, task in tasks.items()}
        alike = [
            one.model_copy(update={"accrual": None, "hyperparameters": one.hyperparameters | {"gamma": None}}) for one in settings.values()
        ]
        if any(one != alike[0] for one in alike):
            refuse(f"The tasks in {file} differ in more than 'accrual' and 'gamma'.", TrainingError)
        return cls(kind, tasks, settings, seed)

    @property
    def common(self) -> TrainingSettings:
        """What the tasks share."""
        return next(iter(self.settings.values()))

    @property
    def name(self) -> str:
        return f"{self.kind}-seed{self.seed}"

    @property
    def baseline(self) -> str:
        """The baseline that it is a part of."""
        return f"ppo_{'two_crops' if len(self.tasks) > 1 else 'one_crop'}{f'_seed{self.seed}' if self.seed else ''}"

    def model(self, env: Mixed) -> PPO:
        """An untrained model whose advantages discount each task's rewards by that task's ``gamma``."""
        model = make_model(self.common, env, self.seed)
        assert isinstance(model, PPO)
        gammas = np.repeat([one.gamma for one in self.settings.values()], self.common.n_envs)
        model.rollout_buffer.gamma = gammas  # type: ignore[assignment]  # a number there, which is multiplied by one for each greenhouse
        return model

    def env(self) -> Mixed:
        """Its greenhouses."""
        common, parts = self.common, []
        for name, task in self.tasks.items():
            greenhouses = Greenhouses(task, self.settings[name])
            clips = {"clip_obs": common.normalize.clip_observations, "clip_reward": common.normalize.clip_rewards}
            parts.append(Normalizer(greenhouses, gamma=self.settings[name].gamma, **clips))
        return Mixed(parts, [task_card(task).observation_names for task in self.tasks.values()])

    def is_done(self, folder: Path) -> bool:
        """Whether ``folder`` holds it to its end. Raises ``TrainingError`` when it holds one with other settings."""
        cards = {name: read_card(folder / name / CARD) for name in self.tasks}
        for name, card in cards.items():
            if card is not None and card["training"]["settings_digest"] != settings_digest(self.settings[name]):
                refuse(f"{folder} holds a training with other settings. Choose another folder with --work.", TrainingError)
        return all(cards.values())

    def carry_out(self, folder: Path) -> History:
        """Train in ``folder``, which has a folder for each task in the end: an agent of it."""
        prepare_torch()
        env = self.env()
        model, every = self.model(env), len(self.tasks) * self.common.evaluation.every
        choice = Choice(self, folder, env, every)
        model.learn(len(self.tasks) * self.common.n_timesteps, callback=choice)
        choice.finish()
        env.close()
        for name, task in self.tasks.items():
            choice.history.write_curve(folder / name)
            write_card(folder / name, task, self.facts(name, model.num_timesteps), self.common.evaluation, choice.history)
        return choice.history

    def facts(self, name: str, steps: int) -> TrainingFacts:
        """What the card of a task's policy says."""
        task, settings, ids = self.tasks[name], self.settings[name], [one.id for one in self.tasks.values()]
        table = training_table(ALGORITHM, settings, settings_digest(settings), self.seed, steps)
        paid = "" if settings.accrual is None else f" {settings.accrual.in_words(task)}"
        words = f"The best policy of {steps:,} steps by its mean score on the validation splits, without the noise of exploration.{paid}"
        return TrainingFacts(
            title=f"PPO trained on {' and '.join(ids)}, seed {self.seed}",
            description=words,
            command="python -m benchmarks.two_crops, with the settings in settings.yml; the tables below tell the rest.",
            sources=("Stable-Baselines3 (Raffin et al., 2021)",),
            controller="actor",
            training={**table, "first_env_seed": settings.first_env_seed, "n_envs": len(ids) * settings.n_envs, "trained_on": ids},
        )


class Choice(BaseCallback):
    """Evaluates the policy on the validation splits between rollouts, and keeps the best."""

    def __init__(self, training: Training, folder: Path, env: Mixed, every: int) -> None:
        super().__init__()
        self.training, self.folder, self.env, self.every = training, folder, env, every
        self.history, self.mark = History(), time.perf_counter()
        plan, preset = training.common.evaluation, training.common.kernel_preset
        self.probes = {name: Probe(task.chosen_on, plan, preset) for name, task in training.tasks.items()}

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        if self.num_timesteps >= self.history.next_evaluation:
            self.evaluate()

    def finish(self) -> None:
        """The evaluation of the last policy."""
        if self.history.curve[-1]["steps"] < self.num_timesteps:
            self.evaluate()

    def evaluate(self) -> None:
        """Score the policy as it stands in every task."""
        self.history.time.learning += time.perf_counter() - self.mark
        about: dict[str, str | int | float] = {"algorithm": ALGORITHM, "seed": self.training.seed, "steps": self.num_timesteps}
        with self.history.time.spend("evaluation"):
            policies, scores = {}, {}
            for number, (name, task) in enumerate(self.training.tasks.items()):
                policies[name] = restricted(self.model, self.env, number, task, about)
                agent = ActorAgent(policies[name].with_arithmetic(FAST))
                agent.reset(task_card(task), len(self.probes[name].seeds))
                scores[name] = self.probes[name].of(agent.act).reward
        point = self.history.add(self.num_timesteps, ProbeResult({"reward": float(np.mean(list(scores.values()))), **scores}), self.every)
        if point.is_best:
            for name, policy in policies.items():
                write_atomically(self.folder / name / POLICY, policy.to_bytes())
        words = ", ".join(f"{name} {score:.2f}" for name, score in scores.items())
        log.info("%s: %d steps, %.0f s, EUR/m2: %s", self.training.name, point.steps, self.history.time.total, words)
        self.mark = time.perf_counter()


def ship(training: Training, folder: Path) -> None:
    """Copy policies, learning curves and cards of a finished training to its baseline."""
    home = data_folder("baselines") / training.baseline
    for name in training.tasks:
        write_atomically(home / f"weights/{name}.npz", (folder / name / POLICY).read_bytes())
        write_atomically(home / f"training/{name}.csv", (folder / name / CURVE).read_text(encoding="utf-8"))
        made = tomllib.loads((folder / name / CARD).read_text(encoding="utf-8"))
        settings = os.path.relpath(SETTINGS, home / "training")
        made |= {"settings": f"../weights/{name}.npz", "made": made["made"].replace("settings.yml", settings)}
        made["training"] |= {"learning_curve": f"{name}.csv", "settings": settings}
        write_atomically(home / f"training/{name}.toml", to_toml(made))
    recipe = training.baseline.removesuffix(f"_seed{training.seed}")
    card = tomllib.loads((data_folder("baselines") / recipe / "card.in.toml").read_text(encoding="utf-8"))
    if training.seed:
        card["title"] += f"; training seed {training.seed}"
        card["description"] = f"As {recipe}, trained with seed {training.seed}."
        card["made"] = card["made"].replace("seed 0", f"seed {training.seed}")
    card["training"] = {"recipe": recipe, "seed": training.seed}
    write_atomically(home / CARD, to_toml(card))
    log.info("%s: shipped to %s", training.name, home)


def main(arguments: Sequence[str] | None = None) -> int:
    """Train what is missing, or ship what is done."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--work", type=Path, required=True, help="folder of trainings")
    parser.add_argument("--only", nargs="*", choices=TRAININGS, default=[*TRAININGS], help="some kinds of training")
    parser.add_argument("--seeds", nargs="*", type=int, default=[*SEEDS], help="some seeds; default: 0 1 2")
    parser.add_argument("--settings", type=Path, default=SETTINGS, help="other settings, to try them")
    parser.add_argument("--ship", action="store_true", help="copy finished trainings to baselines/")
    options = parser.parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s", datefmt="%H:%M:%S", stream=sys.stdout)
    try:
        for training in (Training.of(kind, seed, options.settings) for seed in options.seeds for kind in options.only):
            folder = options.work / training.name
            if options.ship and not training.is_done(folder):
                log.info("%s: not finished, so not shipped", training.name)
            elif options.ship:
                ship(training, folder)
            elif not training.is_done(folder):
                history = training.carry_out(folder)
                log.info("%s: done, best mean %.2f EUR/m2 at %d steps", training.name, history.best_reward, history.best_steps)
    except GlbenchError as error:
        sys.stderr.write(f"two_crops.py: {error}\n")
        return 1
    except KeyboardInterrupt:
        sys.stderr.write("Interrupted. The same command skips finished trainings and starts the interrupted one again.\n")
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
