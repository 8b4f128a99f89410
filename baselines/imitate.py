"""Imitation of a controller: a network that does in microseconds what takes predictive control milliseconds.

    python baselines/imitate.py baselines/imitation_lettuce/imitation.yml --task LettuceClassic-Delta05-v1 --out runs/imitation

It is dataset aggregation (DAgger, Ross, Gordon and Bagnell 2011). In the first round the teacher acts; in later ones the policy acts, and
the teacher's action for the same observations is recorded. After each round a new network is fitted to the data of all rounds and evaluated
on seeds that are not scored; the best one is kept. Rounds are saved: after an interruption the same command gives the same weights.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import nn

from glbench.agents import load_agent
from glbench.agents.network_policy import FAST, NetworkPolicy
from glbench.agents.protocol import Agent
from glbench.arrays import Floats
from glbench.env import Simulation
from glbench.errors import GlbenchError, TrainingError, refuse
from glbench.kernel import make_kernel
from glbench.resources import write_atomically
from glbench.settings import read_settings
from glbench.tasks import TaskSpec, get_task, task_card
from glbench.training.card import POLICY, TrainingFacts, training_table, write_card
from glbench.training.constant_columns import varies, without_constant_columns
from glbench.training.folder import Trained, claim, folder_lock, open_folder
from glbench.training.periodic_evaluation import CurvePoint, History, Listener, Probe, Progress, season_sums
from glbench.training.run import prepare_torch
from glbench.training.settings import EvaluationPlan, FrozenSettings, TrainingSeed

ALGORITHM, ROUND = "dagger", "round-{}.npz"
SOURCE = (
    "Ross, Gordon and Bagnell (2011). A reduction of imitation learning and structured prediction to no-regret online learning. AISTATS"
)
EPSILON = 1e-8  # Added to the variance of a column, as Stable-Baselines3 does
Count = Annotated[int, Field(gt=0)]


class ImitationSettings(FrozenSettings):
    """Settings; ``baselines/imitation_lettuce/imitation.yml`` explains them."""

    teacher: str
    rounds: Count
    runs: Count
    first_env_seed: TrainingSeed
    net_arch: tuple[Count, ...]
    updates: Count
    batch_size: Count
    learning_rate: Annotated[float, Field(gt=0.0)]
    clip_observations: Annotated[float, Field(gt=0.0)]
    evaluation: EvaluationPlan
    kernel_preset: str

    @property
    def digest(self) -> str:
        """SHA-256 (hex) over all settings and what the teacher is made of."""
        content = {**self.model_dump(mode="json"), "teacher_digest": load_agent(self.teacher).digest}
        return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def read_imitation(file: Path) -> ImitationSettings:
    """The settings in ``file``. Raises ``TrainingError`` when one is missing, unknown or impossible, or the teacher sees too much."""
    settings = read_settings(ImitationSettings, file, "the settings of an imitation", TrainingError)
    if load_agent(settings.teacher).privileged:
        msg = f"{settings.teacher} sees more than observations, so a policy that sees these cannot imitate it. Choose another teacher."
        refuse(msg, TrainingError)
    return settings


class Lesson(NamedTuple):
    """What was observed ``(rows, columns)``, and what the teacher would do then ``(rows, actions)``."""

    observations: NDArray[np.float32]
    actions: NDArray[np.float32]


class Classroom:
    """Plays the seasons of a round and writes down what the teacher says in every step."""

    def __init__(self, task: TaskSpec, settings: ImitationSettings) -> None:
        self._task, self._runs, self._first_seed = task, settings.runs, settings.first_env_seed
        kernel = make_kernel(task.model_value, task.step_seconds, preset=settings.kernel_preset)
        self._simulation = Simulation(task, settings.runs, kernel)
        self._low, self._high = bounds_of(task)
        teacher = load_agent(settings.teacher).make(task_card(task))
        assert isinstance(teacher, Agent)
        self._teacher, self._name = teacher, settings.teacher

    def play(self, number: int, policy: NetworkPolicy | None) -> Lesson:
        """Round ``number``, counted from 0, in which ``policy`` acts; without one the teacher does."""
        self._teacher.reset(task_card(self._task), self._runs)
        rows, labels = [], []

        def act(observations: NDArray[np.float32]) -> Floats:
            advice: Floats = np.clip(np.asarray(self._teacher.act(observations), dtype=np.float64), self._low, self._high)
            running = ~self._simulation.ended
            if not np.isfinite(advice[running]).all():
                refuse(f"{self._name} gave an action that is no number in step {len(labels)} of round {number + 1}.", TrainingError)
            rows.append(observations[running].copy())
            labels.append(advice[running].astype(np.float32))
            return advice if policy is None else policy.act(observations)

        season_sums(self._simulation, self.seeds(number), act)
        return Lesson(np.concatenate(rows), np.concatenate(labels))

    def seeds(self, number: int) -> Sequence[int]:
        """Seeds of a round: no two rounds share one."""
        first = self._first_seed + number * self._runs
        return range(first, first + self._runs)


def bounds_of(task: TaskSpec) -> tuple[Floats, Floats]:
    """Lowest and highest value of each action."""
    actions = task_card(task).actions
    return np.array([action.low for action in actions]), np.array([action.high for action in actions])


def loss_of(output: torch.Tensor, advice: torch.Tensor, low: torch.Tensor, high: torch.Tensor) -> torch.Tensor:
    """Mean square of how far actions are from the advice. Beyond a bound that was advised nothing is lost: actions are cut there."""
    cut = torch.where(advice >= high, output.minimum(high), torch.where(advice <= low, output.maximum(low), output))
    return nn.functional.mse_loss(cut, advice)


def fit_network(task: TaskSpec, settings: ImitationSettings, lesson: Lesson, seed: int, number: int) -> NetworkPolicy:
    """A new network, fitted to all that the teacher has said so far."""
    card, rows = task_card(task), lesson.observations.astype(np.float64)
    varying = varies(rows.min(axis=0), rows.max(axis=0))
    mean, scale = rows.mean(axis=0), np.where(varying, np.sqrt(rows.var(axis=0) + EPSILON), 1.0)
    inputs = torch.from_numpy(np.clip((rows - mean) / scale, -settings.clip_observations, settings.clip_observations).astype(np.float32))
    advice, (low, high) = torch.from_numpy(lesson.actions), bounds_of(task)
    bounds = torch.from_numpy(np.float32(low)), torch.from_numpy(np.float32(high))
    torch.manual_seed(1000 * seed + number)
    sizes = [inputs.shape[1], *settings.net_arch]
    hidden = [layer for pair in itertools.pairwise(sizes) for layer in (nn.Linear(*pair), nn.SiLU())]
    network = nn.Sequential(*hidden, nn.Linear(sizes[-1], advice.shape[1]))
    optimiser = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
    schedule = torch.optim.lr_scheduler.LinearLR(optimiser, 1.0, 0.0, settings.updates)
    for _ in range(settings.updates):
        batch = torch.randint(len(inputs), (settings.batch_size,))
        optimiser.zero_grad()
        loss_of(network(inputs[batch]), advice[batch], *bounds).backward()
        optimiser.step()
        schedule.step()
    layers = [layer for layer in network if isinstance(layer, nn.Linear)]
    policy = NetworkPolicy(
        task_id=task.id, delta=task.uncertainty.delta, observation_names=card.observation_names, action_names=card.action_names,
        low=low, high=high, mean=mean, scale=scale, clip=settings.clip_observations,
        weights=tuple(layer.weight.detach().numpy().T.copy() for layer in layers),
        biases=tuple(layer.bias.detach().numpy().copy() for layer in layers), activation="SiLU", output="clip",
        about={"algorithm": ALGORITHM, "teacher": settings.teacher, "seed": seed, "round": number}, arithmetic=FAST,
    )  # fmt: skip
    return without_constant_columns(policy, varying)


def facts(task: TaskSpec, settings: ImitationSettings, seed: int, steps: int) -> TrainingFacts:
    """What the card says of an imitation of ``steps`` steps."""
    return TrainingFacts(
        title=f"Imitation of {settings.teacher} on {task.id}, seed {seed}",
        description=f"The best of {settings.rounds} policies, each fitted to the actions of {settings.teacher} in all seasons so far.",
        command="baselines/imitate.py, with the settings in settings.yml; the tables below tell the rest.",
        sources=(SOURCE,),
        training={
            **training_table(ALGORITHM, settings, settings.digest, seed, steps),
            "teacher": settings.teacher,
            "first_env_seed": settings.first_env_seed,
            "rounds": settings.rounds,
        },
    )


def _round(file: Path, identity: str, play: Callable[[], Lesson], history: History) -> Lesson:
    """The round in ``file``, played and saved there first where it is missing; its time counts as the simulator's."""
    if not file.is_file():
        began = time.perf_counter()
        part = file.with_suffix(".part.npz")
        np.savez_compressed(part, **play()._asdict(), identity=identity, seconds=time.perf_counter() - began)
        part.replace(file)
    with np.load(file, allow_pickle=False) as arrays:
        if str(arrays["identity"]) != identity:
            refuse(f"{file} is of another imitation (other settings, task or seed). Choose another folder with --out.", TrainingError)
        history.time.simulator += float(arrays["seconds"])
        return Lesson(arrays["observations"], arrays["actions"])


def imitate(task: TaskSpec, settings: ImitationSettings, folder: Path, *, seed: int = 0, listeners: Sequence[Listener] = ()) -> Trained:
    """Train one policy in ``folder``, which can be continued; the seed is that of first weights and batches.

    Raises ``TrainingError`` when the folder holds something else.
    """
    with folder_lock(folder):
        identity = {"task": task.id, "task_digest": task.digest, "algorithm": ALGORITHM, "settings_digest": settings.digest, "seed": seed}
        card = claim(folder, identity, None, start=None, target={"rounds": settings.rounds}, resume=True)
        if card is not None:
            return Trained.of(folder, card, already_done=True)
        open_folder(folder, settings.model_dump(mode="json"))
        prepare_torch()
        words = json.dumps(identity, sort_keys=True)
        history, lessons, classroom = History(), [], Classroom(task, settings)
        probe = Probe(task.chosen_on, settings.evaluation, settings.kernel_preset)
        policy, steps = None, 0
        for number in range(settings.rounds):
            lesson = _round(folder / ROUND.format(number), words, partial(classroom.play, number, policy), history)
            lessons.append(lesson)
            steps += len(lesson.observations)
            for listener in listeners:
                listener.on_progress(Progress(number + 1, settings.rounds, 0.0, None))
            with history.time.spend("learning"):
                policy = fit_network(task, settings, Lesson(*map(np.concatenate, zip(*lessons, strict=True))), seed, number)
            with history.time.spend("evaluation"):
                result = probe.of(policy.act)
            point = history.add(steps, result, 1)
            if point.is_best:
                write_atomically(folder / POLICY, policy.to_bytes())
            history.write_curve(folder)
            for listener in listeners:
                listener.on_evaluation(point)
        card = write_card(folder, task, facts(task, settings, seed, steps), settings.evaluation, history)
    return Trained.of(folder, card, already_done=False)


class Lines(Listener):
    """Prints a line for each round."""

    def on_progress(self, progress: Progress) -> None:
        """A round has been played."""
        print(f"Round {progress.steps} of {progress.total_steps} played; fitting", flush=True)

    def on_evaluation(self, point: CurvePoint) -> None:
        """A policy has been fitted and evaluated."""
        best = ", the best so far" if point.is_best else ""
        print(f"  {point.steps:,} steps, {point.seconds:.0f} s: score {point.result.reward:.3f}{best}", flush=True)

    def on_saved(self, steps: int) -> None:
        """Nothing to say."""


def main() -> int:
    """Imitate, from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("settings", type=Path, help="file of settings")
    parser.add_argument("--task", required=True)
    parser.add_argument("--out", type=Path, required=True, help="folder of the training")
    parser.add_argument("--seed", type=int, default=0, help="of first weights and batches")
    arguments = parser.parse_args()
    try:
        settings = read_imitation(arguments.settings)
        imitate(get_task(arguments.task), settings, arguments.out, seed=arguments.seed, listeners=[Lines()])
    except GlbenchError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
