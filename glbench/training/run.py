"""``train``: one agent from settings, task and seed, in a folder that can be continued; and what happens beside the learning."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback

from glbench.errors import TrainingError, refuse
from glbench.resources import write_atomically
from glbench.tasks import TaskSpec, get_task
from glbench.training.algorithms import NORMALIZATION, load_checkpoint, make_model, save_checkpoint, steps_to_make
from glbench.training.card import CARD, POLICY, facts_of_training, note_session, read_card, settings_digest, start_of, write_card
from glbench.training.compiled_settings import NAME as COMPILED_PPO
from glbench.training.export import begin_with, export_policy, load_model
from glbench.training.folder import BEST, CHECKPOINT, MODEL, Trained, claim, find_checkpoint, folder_lock, open_folder, replaced
from glbench.training.periodic_evaluation import History, Listener, Pace, Probe, Progress
from glbench.training.settings import TrainingSettings
from glbench.training.vec_env import Normalizer, TrainingVecEnv

_PROGRESS_SECONDS = 1.0


class TrainingCallback(BaseCallback):
    """Called by the algorithm. Everything is done between two rollouts, where a checkpoint can be continued to the bit."""

    def __init__(
        self,
        folder: Path,
        env: TrainingVecEnv,
        normalization: Normalizer,
        probe: Probe,
        history: History,
        *,
        identity: dict[str, Any],
        evaluate_every: int,
        total_steps: int,
        save_seconds: float,
        listeners: Sequence[Listener],
    ) -> None:
        super().__init__()
        self.folder, self.env, self.normalization, self.probe, self.history = folder, env, normalization, probe, history
        self._identity = identity
        self._evaluate_every = evaluate_every
        self._total_steps = total_steps
        self._save_seconds = save_seconds
        self._listeners = listeners
        self._mark = time.perf_counter()
        self._simulator = env.simulator_seconds
        self._saved = time.perf_counter()
        self._last_report = 0.0
        self._pace: Pace | None = None

    def _on_rollout_start(self) -> None:
        self.history.time.learning += self._lap()
        if self.num_timesteps >= self.history.next_evaluation:
            self._evaluate()
        if time.perf_counter() - self._saved > self._save_seconds:
            self._save()
        if self._pace is None:
            self._pace = Pace(self.num_timesteps)
        self._lap()
        self._simulator = self.env.simulator_seconds

    def _on_rollout_end(self) -> None:
        simulator = self.env.simulator_seconds - self._simulator
        self.history.time.simulator += simulator
        self.history.time.policy += self._lap() - simulator

    def _on_training_start(self) -> None:
        self._lap()

    def _on_step(self) -> bool:
        now = time.perf_counter()
        if now - self._last_report > _PROGRESS_SECONDS:
            self._last_report = now
            self._tell()
        return True

    def finish(self) -> None:
        """The evaluation of the last policy, and the last checkpoint."""
        self.history.time.learning += self._lap()
        if not self.history.curve or self.history.curve[-1]["steps"] < self.num_timesteps:
            self._evaluate()
        if self.history.ends[-1:] != [self.num_timesteps]:  # a kill may have come between the last checkpoint and the card
            self.history.ends.append(self.num_timesteps)
        self._save()
        self._tell()

    def _lap(self) -> float:
        now = time.perf_counter()
        passed, self._mark = now - self._mark, now
        return passed

    def _evaluate(self) -> None:
        history = self.history
        result = self.probe.run(self.model, self.normalization)
        history.time.evaluation += self._lap()
        point = history.add(self.num_timesteps, result, self._evaluate_every)
        if point.is_best:
            with replaced(self.folder / BEST) as folder:
                self.model.save(folder / MODEL)
                self.normalization.save(str(folder / NORMALIZATION))
        history.write_curve(self.folder)
        for name, value in result.sums.items():
            self.logger.record(f"evaluation/{name}", value)
        for listener in self._listeners:
            listener.on_evaluation(point)

    def _save(self) -> None:
        save_checkpoint(self.folder / CHECKPOINT, self.model, self.env, self.normalization, self.history, self._identity)
        self.history.time.saving += self._lap()
        self._saved = time.perf_counter()
        for listener in self._listeners:
            listener.on_saved(self.num_timesteps)

    def _tell(self) -> None:
        rate = self._pace.rate(self.num_timesteps) if self._pace else 0.0
        seasons = [float(episode["r"]) for episode in self.model.ep_info_buffer or ()]
        mean = sum(seasons) / len(seasons) if seasons else None
        for listener in self._listeners:
            # an algorithm that is neither on-policy nor off-policy may make more steps than it announced
            total = max(self._total_steps, self.num_timesteps)
            listener.on_progress(Progress(self.num_timesteps, total, rate, mean))


def prepare_torch() -> None:
    """Deterministic algorithms on one thread: sums in another order would give other weights."""
    torch.set_num_threads(1)
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

    Raises ``TrainingError`` when ``folder`` holds something else, or one begun that is not to be resumed; when the algorithm fails.

    The seed is the algorithm's: first weights, exploration, batches. ``folder`` keeps the checkpoint, the best model with its
    normalisation, the learning curve and the card, and with ``tensorboard`` a folder of that name with TensorBoard's files; checkpoints are
    ``save_seconds`` of wall time [s] apart. ``resume`` continues the checkpoint, to the same bits as without the interruption, or begins
    when there is none. ``listeners`` receive progress, evaluations and saves.
    """
    with folder_lock(folder):
        words = {"task": task.id, "task_digest": task.digest, "algorithm": settings.algorithm}
        identity: dict[str, Any] = {**words, "settings_digest": settings_digest(settings), "seed": seed}
        state = find_checkpoint(folder / CHECKPOINT)
        card = claim(folder, identity, state, start=settings.start_from, target={"steps": settings.n_timesteps}, resume=resume)
        if card is not None:  # its policy is exported if a kill came before that
            reason = None if (folder / POLICY).is_file() else export_best(folder, task)
            return Trained.of(folder, card, already_done=True, not_exported=reason)
        start = start_of(settings.start_from) if settings.start_from is not None else None
        prepare_torch()
        env = TrainingVecEnv(
            task, settings.n_envs, first_seed=settings.first_env_seed, kernel_preset=settings.kernel_preset, accrual=settings.accrual
        )
        try:
            if state is not None:
                model, normalization, history = load_checkpoint(state, settings.algorithm, env, identity)
            else:
                norm, history = settings.normalize, History()
                normalization = Normalizer(
                    env,
                    norm_obs=norm.observations,
                    norm_reward=norm.rewards,
                    clip_obs=norm.clip_observations,
                    clip_reward=norm.clip_rewards,
                    gamma=settings.gamma,
                )
                model = make_model(settings, normalization, seed)
                if settings.start_from is not None:
                    begin_with(settings.start_from, model, normalization, task)
            content = settings.model_dump(mode="json", exclude={"algorithm", "hyperparameters"}, exclude_none=True)
            open_folder(folder, {**content, **settings.hyperparameters})
            note_session(history, task, model.num_timesteps)
            model.tensorboard_log = str(folder / "tensorboard") if tensorboard else None
            callback = TrainingCallback(
                folder,
                env,
                normalization,
                Probe(task.chosen_on, settings.evaluation, settings.kernel_preset),
                history,
                identity=identity,
                evaluate_every=settings.evaluation.every,
                total_steps=steps_to_make(settings, task.steps),
                save_seconds=save_seconds,
                listeners=listeners,
            )
            _learn(model, settings, callback)
        finally:
            env.close()
        reason = _export(folder, task, settings.algorithm, seed, history.best_steps)
        facts = facts_of_training(task, settings, identity["settings_digest"], seed, model.num_timesteps, history.ends[:-1])
        card = write_card(folder, task, facts, settings.evaluation, history, start)
    return Trained.of(folder, card, already_done=False, not_exported=reason)


def export_best(folder: Path, task: TaskSpec | None = None) -> str | None:
    """Write the best model of a finished training to ``folder/policy.npz``; why not, when its kind cannot be exported.

    ``task`` need not be given for a task that glbench knows. Raises ``TrainingError`` when the folder holds no finished training.
    """
    card = read_card(folder / CARD)
    if card is None:
        refuse(f"{folder} holds no finished training: there is no {CARD}. Finish it with glbench train --resume.", TrainingError)
    task = task or get_task(card["task"]["id"])
    if task.digest != card["task"]["digest"]:
        msg = f"{folder} was trained on another version of {task.id}: digest {card['task']['digest'][:12]}, now {task.digest[:12]}."
        raise TrainingError(msg)
    training = card["training"]
    if training["algorithm"] == COMPILED_PPO and (folder / POLICY).is_file():
        return None  # it keeps its best policy only in this form
    return _export(folder, task, training["algorithm"], training["seed"], card["best"]["steps"])


def _export(folder: Path, task: TaskSpec, algorithm: str, seed: int, best_steps: int) -> str | None:
    about: dict[str, str | int | float] = {
        "algorithm": algorithm, "seed": seed, "steps": best_steps, "task_digest": task.digest,
    }  # fmt: skip
    model, normalization = load_model(folder / BEST / MODEL, algorithm, folder / BEST / NORMALIZATION)
    if model.num_timesteps != best_steps:
        msg = (
            f"The best model in {folder / BEST} is of step {model.num_timesteps:,}, not of {best_steps:,}, where the training stands. "
            "Go on with --resume, and as many steps as before."
        )
        raise TrainingError(msg)
    try:
        policy = export_policy(model, normalization, task, about)
    except TrainingError as error:
        return str(error)
    write_atomically(folder / POLICY, policy.to_bytes())
    return None


def _learn(model: BaseAlgorithm, settings: TrainingSettings, callback: TrainingCallback) -> None:
    remaining = max(settings.n_timesteps - model.num_timesteps, 0)  # 0: only the end is left to do
    try:
        model.learn(remaining, callback=callback, reset_num_timesteps=False, tb_log_name="run")
    except (TypeError, ValueError, RuntimeError, AssertionError, ArithmeticError) as error:
        name = type(model).__name__
        msg = f"{name} failed at step {model.num_timesteps:,}: {error}. Check the values of its settings (a learning rate too high?)."
        raise TrainingError(msg) from error
    callback.finish()
