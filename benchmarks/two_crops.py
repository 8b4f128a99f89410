"""One PPO policy that learns tomato and lettuce at once, beside a policy for each crop by the same recipe.

    python benchmarks/two_crops.py --work FOLDER             # trains what is missing; may be interrupted
    python benchmarks/two_crops.py --work FOLDER --ship      # puts what is done into baselines/

`benchmarks/two_crops.yml` has the settings. Half of the greenhouses of the policy for both crops grow tomatoes, half lettuce. It sees the
columns of both tasks and one that says which crop grows; columns that a task does not show are at their mean. In one task all of these
are constants, so they join the first bias: what is left is an ordinary policy of that task, which is what the baselines hold.

The best policy is chosen on the validation splits. For both crops this is the one with the highest mean of the two scores [EUR m-2], as for
a grower with as much of one crop as of the other. This was fixed before any training. No test split is seen here.
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
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from glbench.agents.network_policy import FAST, Actor, ActorAgent, NetworkPolicy
from glbench.errors import GlbenchError, TrainingError, refuse
from glbench.resources import data_folder, write_atomically
from glbench.tasks import TaskSpec, get_task, task_card
from glbench.training.algorithms import make_model
from glbench.training.card import CARD, POLICY, TrainingFacts, settings_digest, to_toml, training_table, write_card
from glbench.training.constant_columns import without_constant_columns
from glbench.training.export import actor_of
from glbench.training.periodic_evaluation import CURVE, History, Probe, ProbeResult
from glbench.training.run import prepare_torch
from glbench.training.settings import TrainingSettings, read_settings
from glbench.training.vec_env import Normalizer, TrainingVecEnv

SETTINGS, ALGORITHM = Path(__file__).with_suffix(".yml"), "ppo"
TASKS = {"spring": "Spring-v1", "lettuce": "Lettuce-v1"}
TRAININGS = {"two_crops": ("spring", "lettuce"), "spring": ("spring",), "lettuce": ("lettuce",)}
"""Tasks of each kind of training."""
SEEDS = range(3)
CROP = "crop"  # Name of the column that says which crop grows: -1 for the first task, 1 for the second
Reals = NDArray[np.floating[Any]]
log = logging.getLogger("two_crops")


class Greenhouses(TrainingVecEnv):
    """Greenhouses of a task whose actions are positions of controls, as ``Actor`` has them: 0 to 1, reached as fast as the task allows.

    The first episode of each row ends early, each at another part of the season, so that rollouts see all of it from then on.
    """

    def __init__(self, task: TaskSpec, settings: TrainingSettings) -> None:
        super().__init__(
            task, settings.n_envs, first_seed=settings.first_env_seed, kernel_preset=settings.kernel_preset, accrual=settings.accrual
        )
        self.change = largest_change(task)
        self.action_space = Box(0.0, 1.0, self.action_space.shape, np.float32)
        self._positions = np.zeros((self.num_envs, self.change.size))
        self._first_ends = task.steps * np.arange(1, self.num_envs) // self.num_envs
        self._step = 0

    def step_async(self, actions: Reals) -> None:
        moves = np.clip((np.clip(actions, 0.0, 1.0) - self._positions) / self.change, -1.0, 1.0)
        self._positions = np.clip(self._positions + self.change * moves, 0.0, 1.0)
        super().step_async(moves)

    def step_wait(self) -> Any:
        observations, rewards, ended, infos = super().step_wait()
        self._step += 1
        cut = np.append(self._first_ends == self._step, False) & ~ended
        for row in np.flatnonzero(cut).tolist():
            infos[row] = {"terminal_observation": observations[row].copy(), "TimeLimit.truncated": True}
        if cut.any():
            observations = self._begin(cut)
        self._positions[ended | cut] = 0.0
        return observations, rewards, ended | cut, infos


def largest_change(task: TaskSpec) -> NDArray[np.float64]:
    """How far each control moves in a step, of its range. Raises ``TrainingError`` where actions do not move controls."""
    if task.actuation.kind != "rate" or task.on_off:
        refuse(f"The actions of {task.id} do not move all controls by a share of their range.", TrainingError)
    return np.full(len(task.actions), task.actuation.max_change)


class Mixed(VecEnv):
    """Greenhouses of several tasks as one batch: columns by name, each task's normalised by its own statistics, 0 where it has none."""

    def __init__(self, parts: Sequence[Normalizer], columns: Sequence[tuple[str, ...]]) -> None:
        self.parts, self.names = parts, (*dict.fromkeys(name for names in columns for name in names), CROP)
        self.places = [[self.names.index(name) for name in names] for names in columns]
        ends = np.cumsum([part.num_envs for part in parts]).tolist()
        self.rows = [slice(end - part.num_envs, end) for part, end in zip(parts, ends, strict=True)]
        super().__init__(ends[-1], Box(-np.inf, np.inf, (len(self.names),), np.float32), parts[0].action_space)

    def union(self, number: int, observations: Reals) -> Reals:
        """Normalised observations of a task in the columns of all."""
        wide = np.zeros((len(observations), len(self.names)), np.float32)
        wide[:, self.places[number]], wide[:, -1] = observations, crop(number)
        return wide

    def reset(self) -> Any:
        return np.concatenate([self.union(number, np.asarray(part.reset())) for number, part in enumerate(self.parts)])

    def step_async(self, actions: Reals) -> None:
        for part, rows in zip(self.parts, self.rows, strict=True):
            part.step_async(actions[rows])

    def step_wait(self) -> Any:
        steps, infos = [part.step_wait() for part in self.parts], list[dict[str, Any]]()
        for number, step in enumerate(steps):
            for info in step[3]:
                if "terminal_observation" in info:
                    info["terminal_observation"] = self.union(number, info["terminal_observation"][None])[0]
                infos.append(info)
        seen = [self.union(number, np.asarray(step[0])) for number, step in enumerate(steps)]
        return np.concatenate(seen), *(np.concatenate([step[part] for step in steps]) for part in (1, 2)), infos

    def close(self) -> None:
        for part in self.parts:
            part.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [value for part in self.parts for value in part.get_attr(attr_name)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise NotImplementedError

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        return [value for part in self.parts for value in part.env_is_wrapped(wrapper_class)]

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        return [first for part in self.parts for first in part.seed(seed)]


def crop(number: int) -> float:
    """What the column of the crop reads in the task of that number; a policy for one crop sees that of the first."""
    return (-1.0, 1.0)[number]


def restricted(model: BaseAlgorithm, env: Mixed, number: int, task: TaskSpec, about: dict[str, str | int | float]) -> Actor:
    """What the model does in one task, as a policy of that task's columns alone."""
    layers, activation, output = actor_of(model)
    weights, biases = ([part.detach().numpy() for part in parts] for parts in zip(*((one.weight, one.bias) for one in layers), strict=True))
    first, statistics, card = weights[0].T, env.parts[number], task_card(task)
    network = NetworkPolicy(
        task_id=task.id, delta=task.uncertainty.delta, observation_names=card.observation_names, action_names=card.action_names,
        low=np.zeros(len(card.actions)), high=np.ones(len(card.actions)), mean=statistics.columns.mean.copy(), scale=statistics.scale,
        clip=float(statistics.clip_obs), weights=(first[env.places[number]].copy(), *(one.T.copy() for one in weights[1:])),
        biases=(biases[0] + np.float32(crop(number)) * first[-1], *(one.copy() for one in biases[1:])),
        activation=activation, output=output, about=about,
    )  # fmt: skip
    network = without_constant_columns(network, statistics.columns.varying)
    low, high = card.action_bounds
    return Actor(network, np.zeros(0, np.int64), np.zeros(0), largest_change(task), low, high)


@dataclass(frozen=True)
class Training:
    """One training: its tasks by name, their settings, and the learner's seed."""

    kind: str
    tasks: dict[str, TaskSpec]
    settings: dict[str, TrainingSettings]
    seed: int

    @classmethod
    def of(cls, kind: str, seed: int, file: Path = SETTINGS) -> Training:
        """The training of a kind. Raises ``TrainingError`` when the tasks' settings differ in more than ``accrual``."""
        tasks = {name: get_task(TASKS[name]) for name in TRAININGS[kind]}
        settings = {name: read_settings(file, ALGORITHM, task.id) for name, task in tasks.items()}
        if len({one.model_copy(update={"accrual": None}).model_dump_json() for one in settings.values()}) > 1:
            refuse(f"The tasks in {file} differ in more than 'accrual'.", TrainingError)
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

    def env(self) -> Mixed:
        """Its greenhouses."""
        common, parts = self.common, []
        for name, task in self.tasks.items():
            greenhouses = Greenhouses(task, self.settings[name])
            clips = {"clip_obs": common.normalize.clip_observations, "clip_reward": common.normalize.clip_rewards}
            parts.append(Normalizer(greenhouses, gamma=common.gamma, **clips))
        return Mixed(parts, [task_card(task).observation_names for task in self.tasks.values()])

    def is_done(self, folder: Path) -> bool:
        return all((folder / name / CARD).is_file() for name in self.tasks)

    def carry_out(self, folder: Path) -> History:
        """Train in ``folder``, which has a folder for each task in the end: an agent of it."""
        prepare_torch()
        env = self.env()
        model, every = make_model(self.common, env, self.seed), len(self.tasks) * self.common.evaluation.every
        choice = Choice(self, folder, env, every)
        model.learn(len(self.tasks) * self.common.n_timesteps, callback=choice)
        choice.finish()
        env.close()
        for name, task in self.tasks.items():
            write_card(folder / name, task, self.facts(name, model.num_timesteps), self.common.evaluation, choice.history)
            choice.history.write_curve(folder / name)
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
            command="python benchmarks/two_crops.py, with the settings in settings.yml; the tables below tell the rest.",
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
    card["training"] = {"recipe": recipe, "seed": training.seed}
    write_atomically(home / CARD, to_toml(card))
    log.info("%s: shipped to %s", training.name, home)


def main(arguments: Sequence[str] | None = None) -> int:
    """Train what is missing, or ship what is done."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--work", type=Path, required=True, help="folder of trainings")
    parser.add_argument("--only", nargs="*", choices=TRAININGS, default=[*TRAININGS], help="some kinds of training")
    parser.add_argument("--seeds", nargs="*", type=int, default=[*SEEDS], help="some seeds; default: 0 1 2")
    parser.add_argument("--settings", type=Path, default=SETTINGS, help="other settings than benchmarks/two_crops.yml, to try them")
    parser.add_argument("--ship", action="store_true", help="copy finished trainings to baselines/")
    options = parser.parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s", datefmt="%H:%M:%S", stream=sys.stdout)
    try:
        for training in (Training.of(kind, seed, options.settings) for seed in options.seeds for kind in options.only):
            folder = options.work / training.name
            if options.ship and training.is_done(folder):
                ship(training, folder)
            elif not options.ship and not training.is_done(folder):
                history = training.carry_out(folder)
                log.info("%s: done, best mean %.2f EUR/m2 at %d steps", training.name, history.best_reward, history.best_steps)
    except GlbenchError as error:
        sys.stderr.write(f"two_crops.py: {error}\n")
        return 1
    except KeyboardInterrupt:
        sys.stderr.write("Interrupted. The same command continues: what is finished is not repeated.\n")
        return 130
    return 0


if __name__ == "__main__":
    sys.path.insert(0, str(SETTINGS.parents[1]))  # a script sees its own folder only
    sys.exit(main())
