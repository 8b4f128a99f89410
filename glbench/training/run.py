"""``train``: one agent from settings, task and seed, in a folder that can be continued."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
import yaml
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

from glbench.errors import TrainingError
from glbench.resources import write_atomically
from glbench.tasks import get_task
from glbench.training.algorithms import make_model
from glbench.training.callback import BEST, CHECKPOINT, TrainingCallback
from glbench.training.card import CARD, POLICY, making_of, read_card, settings_digest, write_card
from glbench.training.checkpoint import MODEL, NORMALIZATION, History, find_checkpoint, load_checkpoint
from glbench.training.export import export_policy, load_model
from glbench.training.probe import Probe
from glbench.training.progress import Listener
from glbench.training.starting import begin_with, start_of
from glbench.training.vec_env import TrainingVecEnv

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec
    from glbench.training.settings import TrainingSettings

SETTINGS = "settings.yml"


@dataclass(frozen=True)
class Trained:
    """A finished training."""

    folder: Path
    steps: int
    best_reward: float
    best_steps: int
    already_done: bool
    """Whether it had been finished before, so that nothing was done."""
    not_exported: str | None = None

    @property
    def model(self) -> Path:
        """The best policy as Stable-Baselines3 saves it."""
        return self.folder / BEST / MODEL

    """Why its policy could not be exported to a file for numpy; ``None`` when it was."""


def prepare_torch(threads: int = 1) -> None:
    """Deterministic algorithms on a fixed number of threads: sums in another order would give other weights."""
    torch.set_num_threads(threads)
    torch.use_deterministic_algorithms(True)


def train(
    task: TaskSpec,
    settings: TrainingSettings,
    folder: Path,
    *,
    seed: int = 0,
    resume: bool = False,
    save_seconds: float = 120.0,
    tensorboard: bool = True,
    listeners: Sequence[Listener] = (),
) -> Trained:
    """Train one agent in ``folder``; the same task, settings and seed give the same weights on the same machine.

    Parameters
    ----------
    task, settings, seed
        What is trained. The seed is the algorithm's: first weights, exploration, batches.
    folder
        Where it is kept: checkpoint, best model with its normalisation, learning curve, card.
    resume
        Go on from the checkpoint in ``folder``, to the same bits as without the interruption; begin when there is none.
    save_seconds
        Wall time [s] between checkpoints.
    tensorboard
        Whether to write TensorBoard's files to ``folder/tensorboard``.
    listeners
        Who is told how it goes.

    Raises
    ------
    TrainingError
        When ``folder`` holds another training, or one that was begun and is not to be resumed.
    """
    identity = _identity(task, settings, seed)
    done = _done(folder, identity, settings, resume)
    if done is not None:
        return done
    prepare_torch()
    write_atomically(folder / SETTINGS, yaml.safe_dump({"default": _as_yaml(settings)}, sort_keys=False))
    env = TrainingVecEnv(
        task, settings.n_envs, first_seed=settings.first_env_seed, kernel_preset=settings.kernel_preset
    )
    try:
        model, normalization, history = _begin_or_continue(env, task, settings, folder, seed, identity, tensorboard)
        callback = TrainingCallback(
            folder,
            env,
            normalization,
            Probe(task, settings.evaluation, settings.kernel_preset),
            history,
            identity=identity,
            evaluate_every=settings.evaluation.every,
            total_steps=settings.n_timesteps,
            save_seconds=save_seconds,
            listeners=listeners,
        )
        left = settings.n_timesteps - model.num_timesteps
        if left > 0:
            model.learn(left, callback=callback, reset_num_timesteps=False, tb_log_name="run")
            callback.finish()
    finally:
        env.close()
    start = start_of(settings.start_from) if settings.start_from is not None else None
    making = making_of(task, settings, seed, model.num_timesteps)
    write_card(folder, task, making, settings.evaluation, history, start)
    reason = export_best(folder, task)
    return Trained(
        folder, model.num_timesteps, history.best_reward, history.best_steps, already_done=False, not_exported=reason
    )


def export_best(folder: Path, task: TaskSpec | None = None) -> str | None:
    """Write the best model of a finished training to ``folder/policy.npz``; why not, when its kind cannot be exported.

    ``task`` need not be given for a task that glbench knows.

    Raises
    ------
    TrainingError
        When the folder holds no finished training.
    """
    card = read_card(folder / CARD)
    if card is None:
        msg = f"{folder} holds no finished training: there is no {CARD}. Finish it with glbench train --resume."
        raise TrainingError(msg)
    task = task or get_task(card["task"]["id"])
    if task.digest != card["task"]["digest"]:
        msg = f"{folder} was trained on another version of {task.id}: digest {card['task']['digest'][:12]}, now {task.digest[:12]}."
        raise TrainingError(msg)
    training, best = card["training"], card["best"]
    about = {
        "algorithm": training["algorithm"],
        "seed": training["seed"],
        "steps": best["steps"],
        "task_digest": card["task"]["digest"],
    }
    model, normalization = load_model(folder / BEST / MODEL, training["algorithm"], folder / BEST / NORMALIZATION)
    try:
        policy = export_policy(model, normalization, task, about)
    except TrainingError as error:
        return str(error)
    write_atomically(folder / POLICY, policy.to_bytes())
    return None


def _begin_or_continue(
    env: TrainingVecEnv,
    task: TaskSpec,
    settings: TrainingSettings,
    folder: Path,
    seed: int,
    identity: dict[str, Any],
    tensorboard: bool,
) -> tuple[BaseAlgorithm, VecNormalize, History]:
    checkpoint = find_checkpoint(folder / CHECKPOINT)
    log = str(folder / "tensorboard") if tensorboard else None
    if checkpoint is not None:
        model, normalization, history = load_checkpoint(checkpoint, settings.algorithm, env, identity)
        model.tensorboard_log = log
        return model, normalization, history
    norm = settings.normalize
    normalization = VecNormalize(
        env,
        norm_obs=norm.observations,
        norm_reward=norm.rewards,
        clip_obs=norm.clip_observations,
        clip_reward=norm.clip_rewards,
        gamma=settings.gamma,
    )
    model = make_model(settings, normalization, seed, log)
    if settings.start_from is not None:
        begin_with(settings.start_from, model, normalization, task)
    return model, normalization, History()


def _done(folder: Path, identity: dict[str, Any], settings: TrainingSettings, resume: bool) -> Trained | None:
    """The finished training of ``folder``; ``None`` when there is something to do."""
    card = read_card(folder / CARD)
    if card is not None:
        found = {
            "task": card["task"]["digest"],
            "settings": card["training"]["settings_digest"],
            "seed": card["training"]["seed"],
        }
        wanted = {"task": identity["task_digest"], "settings": settings_digest(settings), "seed": identity["seed"]}
        if found == wanted and card["training"]["steps"] >= settings.n_timesteps:
            best = card["best"]
            return Trained(folder, card["training"]["steps"], best["reward"], best["steps"], already_done=True)
    if find_checkpoint(folder / CHECKPOINT) is not None and not resume:
        msg = f"{folder} holds a training that was begun. Go on with --resume, or choose another folder with --out."
        raise TrainingError(msg)
    return None


def _identity(task: TaskSpec, settings: TrainingSettings, seed: int) -> dict[str, Any]:
    return {
        "task": task.id,
        "task_digest": task.digest,
        "algorithm": settings.algorithm,
        "settings_digest": settings_digest(settings),
        "seed": seed,
    }


def _as_yaml(settings: TrainingSettings) -> dict[str, Any]:
    """The settings as the file would say them that gives just these."""
    content = settings.model_dump(mode="json", exclude={"algorithm", "hyperparameters"}, exclude_none=True)
    return {**content, **settings.hyperparameters}
