"""Settings of the compiled PPO from a YAML file: ``default:``, overridden by the entries under a task's own key."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, PositiveInt, field_validator, model_validator

from glbench.agents.views import OUTDOOR, RECALLING, visible_columns
from glbench.errors import TrainingError, UnknownNameError, refuse
from glbench.resources import data_folder
from glbench.settings import validated
from glbench.tasks import TaskSpec
from glbench.tasks.record import FIRST_TRAINING_SEED
from glbench.training import settings

NAME = "compiled ppo"  # Name of the algorithm in cards
COMPILED = "compiled"  # The value of ``learner`` in the settings


class Memory(settings.FrozenSettings):
    """What the policy remembers: for every column, running means with each of the time constants; and what it learns to remember."""

    hours: tuple[float, ...] = ()
    """Time constants [h]."""
    columns: tuple[str, ...] = ("air_temperature", "co2", "relative_humidity")
    gru: int = Field(default=0, ge=0, exclude_if=lambda units: units == 0)
    """Units of a gated recurrent unit that actor and critic also see; 0 for none."""

    @field_validator("hours")
    @classmethod
    def _positive(cls, hours: tuple[float, ...]) -> tuple[float, ...]:
        if not all(0 < hour < math.inf for hour in hours):
            refuse(f"time constants are positive numbers of hours, not {', '.join(f'{hour:g}' for hour in hours)}")
        return hours

    @field_validator("hours", "columns")
    @classmethod
    def _each_once(cls, values: tuple[Any, ...]) -> tuple[Any, ...]:
        if len({*values}) < len(values):
            refuse(f"no entry may appear twice, as in {', '.join(map(str, values))}")
        return values


class CompiledSettings(settings.FrozenSettings):
    """Settings of one training with the compiled PPO; keys shared with Stable-Baselines3's PPO have the same meaning."""

    learner: Literal["compiled"]
    """Marks settings of the compiled PPO, as opposed to Stable-Baselines3's."""
    n_timesteps: int = Field(default=3_000_000, gt=0)
    """Environment steps, over all greenhouses. The learning rate falls over them: a different number of steps is a different training."""
    n_envs: int = Field(default=128, gt=0)
    n_steps: int = Field(default=32, gt=0)
    """``n_envs`` and ``n_steps``: greenhouses stepped together, and steps of each between two updates."""
    n_epochs: int = Field(default=4, gt=0)
    batch_size: int = Field(default=512, gt=1)
    start_from: settings.PolicyFile | None = Field(default=None, exclude_if=lambda file: file is None)
    """Policy file (``policy.npz``) whose actor and statistics the training begins with; in a settings file, relative to it."""
    critic_first: float = Field(default=0.0, ge=0, lt=1, exclude_if=lambda share: share == 0)
    """Share of the training, at its start, in which only the critic learns: untrained, it would spoil the policy of ``start_from``."""
    first_env_seed: settings.TrainingSeed = FIRST_TRAINING_SEED
    scenarios: int = Field(default=256, gt=0)
    """``first_env_seed`` and ``scenarios``: training scenarios have the seeds ``first_env_seed`` to ``first_env_seed + scenarios - 1``;
    each episode draws one. A split has a fixed number of seasons; with more scenarios, seasons repeat with other crops, houses, starts
    and sensors."""
    places: int = Field(default=32, gt=0)
    """Number of places in each season where the first episodes may begin; later ones begin at its start."""
    net_arch: tuple[PositiveInt, ...] = Field(default=(128, 128), min_length=1)
    """Widths of the hidden layers of actor and critic (tanh)."""
    log_std_init: float = -0.7
    log_std_of: dict[str, float] = Field(default_factory=dict, exclude_if=lambda actions: not actions)
    """``log_std_init`` and ``log_std_of``: logarithm of the standard deviation of the actor's output at first, and of single actions."""
    learning_rate: float = Field(default=1e-3, gt=0)
    last_learning_rate: float = Field(default=2e-5, gt=0)
    """``learning_rate`` and ``last_learning_rate``: the learning rate falls linearly from the first to the second."""
    gamma: float = Field(default=0.97, gt=0, le=1)
    gae_lambda: float = Field(default=0.95, gt=0, le=1)
    clip_range: float = Field(default=0.2, gt=0)
    ent_coef: float = Field(default=0.0, ge=0)
    vf_coef: float = Field(default=0.5, gt=0)
    max_grad_norm: float = Field(default=0.5, gt=0)
    normalize: settings.Normalization = settings.Normalization()
    least_scale: dict[str, float] = Field(default_factory=lambda: {"outdoor_co2": 20.0})
    """Smallest standard deviation by which an observed column is divided, for columns that hardly vary in training."""
    steer: bool = True
    """Whether the actor outputs positions of controls, where the task's actions move them by a limited amount per step."""
    memory: Memory = Memory()
    """Traces of columns that actor and critic also see; none without ``hours``."""
    view: tuple[str, ...] | None = Field(default=None, exclude_if=lambda view: view is None)
    """Views, observation modules and columns that actor and critic see (``glbench.agents.views``); ``None``: all that the task shows."""
    critic_sees: tuple[str, ...] = ()
    """Quantities of a step and states of the model that the critic also sees, in training only."""
    accrual: settings.Accrual | None = None
    """A reward used only in training; ``None`` for none."""
    reward_window: int = Field(default=100_000, gt=0)
    """Rewards are divided by the spread of the returns over about this many steps."""
    evaluation: settings.EvaluationPlan = settings.EvaluationPlan(every=200_000)
    kernel_preset: Literal["fast", "reference"] = "fast"

    @model_validator(mode="after")
    def _whole_batches(self) -> Self:
        if self.rollout % self.batch_size:
            refuse(f"'batch_size: {self.batch_size}' does not divide the {self.rollout} steps of a rollout (n_envs times n_steps)")
        if self.memory.gru and self.batch_size % self.n_steps:
            refuse(f"with 'memory.gru', a batch has whole sequences: 'n_steps: {self.n_steps}' must divide 'batch_size: {self.batch_size}'")
        if not (self.normalize.observations and self.normalize.rewards):
            refuse("the compiled PPO always normalises observations and rewards; leave out the keys that switch this off")
        return self

    @property
    def rollout(self) -> int:
        """Environment steps between two updates."""
        return self.n_envs * self.n_steps

    @property
    def updates(self) -> int:
        """Updates of a training: whole rollouts, ``n_timesteps`` at least."""
        return -(-self.n_timesteps // self.rollout)

    @property
    def seeds(self) -> range:
        """Seeds of the training scenarios."""
        return range(self.first_env_seed, self.first_env_seed + self.scenarios)

    @property
    def digest(self) -> str:
        """SHA-256 (hex) over all settings, and over the policy to start from."""
        content = self.model_dump(mode="json", exclude={"start_from"})
        if self.start_from is not None:
            content["start"] = sha256(self.start_from.read_bytes()).hexdigest()  # its place does not matter
        return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def is_compiled(file: Path | None, task: TaskSpec) -> bool:
    """Whether a YAML file has settings of the compiled PPO, as the shipped ones are."""
    return file is None or settings.section(file, task.id).get("learner") == COMPILED


def read_compiled_settings(
    file: Path | None, task: TaskSpec, steps: int | None = None, view: Sequence[str] | None = None
) -> CompiledSettings:
    """Settings for a task from a YAML file, or the shipped ones; ``steps`` and ``view`` instead of the file's.

    A view with a memory (``RECALLING``) brings the memory of ``baselines/ppo/memory.yml``, unless the file has one, and with it that
    recipe's ``critic_sees``, unless the file has its own. Traces of columns that are out of view are left out; if none is left, the policy
    keeps those of the weather outside (``OUTDOOR``).

    Raises ``TrainingError`` when the file cannot be read, a value is impossible, or the task has no such view.
    """
    shipped = data_folder("baselines") / "ppo"
    source = file or shipped / "fast.yml"
    content = settings.section(source, task.id)
    if steps is not None:
        content["n_timesteps"] = steps
    if view is not None:
        content["view"] = list(view)
        if {*view} & {*RECALLING} and not content.get("memory"):
            recipe = settings.section(shipped / "memory.yml", task.id)
            states = [name for name in recipe["critic_sees"] if name in task.model_value.state_names]
            content = {"critic_sees": states} | content | {"memory": recipe["memory"]}
    whole = validated(CompiledSettings, content, "the settings", source, TrainingError)
    if view is None or not whole.memory.hours:
        return whole
    columns = in_view(task, whole)
    traced = [name for name in whole.memory.columns if name in columns] or [name for name in OUTDOOR if name in columns]
    return whole.model_copy(update={"memory": whole.memory.model_copy(update={"columns": tuple(traced)})})


def in_view(task: TaskSpec, settings: CompiledSettings) -> list[str]:
    """Names of the observed columns that actor and critic see. Raises ``TrainingError`` when the task has no such view."""
    names = [column.name for column in task.observed()]
    try:
        return names if settings.view is None else [names[place] for place in visible_columns(task, settings.view).nonzero()[0]]
    except UnknownNameError as error:
        refuse(f"'view': {error}", TrainingError, error)
