"""How an agent is trained, as a YAML file says: ``default:`` and, over it, the entries of a task's own key."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat, model_validator

from glbench.errors import TrainingError, did_you_mean, refuse
from glbench.resources import data_folder
from glbench.settings import validated
from glbench.tasks import TaskSpec
from glbench.tasks.record import FIRST_TRAINING_SEED
from glbench.tasks.tables import PERFECT
from glbench.untrusted import real_path
from glbench.yaml_reader import read_yaml

PAPER = {"ppo": "ppo/paper.yml", "sac": "sac/sac.yml"}  # Shipped settings of the paper's algorithms, in ``baselines``


def _that_is_there(file: Path) -> Path:
    if not file.is_file():
        refuse(f"there is no policy file {file}")
    return file


PolicyFile = Annotated[Path, AfterValidator(_that_is_there)]  # Path of a policy file that exists

_LAST_FIRST_SEED = 2**52


def _that_no_task_is_scored_with(seed: int) -> int:
    if not FIRST_TRAINING_SEED <= seed <= _LAST_FIRST_SEED:
        msg = (
            f"{seed:,} is not a seed for training. Tasks are scored with smaller seeds, so trainings and their evaluations "
            f"use seeds from {FIRST_TRAINING_SEED:,} to {_LAST_FIRST_SEED:,}"
        )
        raise ValueError(msg)
    return seed


TrainingSeed = Annotated[int, AfterValidator(_that_no_task_is_scored_with)]  # First of a row of seeds that no task is scored with

LINEAR = "lin_"  # What the text of a number begins with that falls linearly to 0
_LIKE_A_NUMBER = re.compile(r"[-+]?\.?\d")
_ALLOWED = {
    "gamma": "a number above 0, at most 1",
    "gae_lambda": "a number above 0, at most 1",
    "tau": "a number above 0, at most 1",
    "learning_rate": f"a number above 0, or {LINEAR}3e-4 for one that falls from 3e-4 to 0",
    "n_epochs": "a whole number, 1 or more",
    "batch_size": "a whole number, 1 or more",
    "n_steps": "a whole number, 1 or more",
    "buffer_size": "a whole number, 1 or more",
    "gradient_steps": "a whole number, 1 or more, or -1 for as many as there were steps",
}
"""Arguments that algorithms share, and what they may be."""


def _allowed(arguments: dict[str, Any]) -> dict[str, Any]:
    for name, words in _ALLOWED.items():
        if name in arguments and not _is_allowed(name, arguments[name]):
            refuse(f"'{name}: {arguments[name]}' cannot be: it is {words}")
    return arguments


def _is_allowed(name: str, value: Any) -> bool:
    if name == "learning_rate" and isinstance(value, str) and value.startswith(LINEAR):
        value = numbers(value.removeprefix(LINEAR))
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    if name in ("gamma", "gae_lambda", "tau"):
        return 0 < value <= 1
    if name == "learning_rate":
        return 0 < value < float("inf")
    return isinstance(value, int) and (value >= 1 or (name == "gradient_steps" and value == -1))


class FrozenSettings(BaseModel):
    """Base of settings and their parts: frozen, without unknown entries."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Normalization(FrozenSettings):
    """Running mean and standard deviation of observations and rewards (``VecNormalize``)."""

    observations: bool = True
    rewards: bool = True
    clip_observations: float = Field(default=10.0, gt=0)
    clip_rewards: float = Field(default=10.0, gt=0)


class EvaluationPlan(FrozenSettings):
    """Evaluation between the steps of training, on seeds that no task is scored with."""

    every: int = Field(default=100_000, gt=0)
    """Environment steps between two evaluations."""
    runs: int = Field(default=4, gt=0)
    """Runs an evaluation; 1 is enough, and is taken, where the task draws nothing."""
    first_seed: TrainingSeed = 2 * FIRST_TRAINING_SEED

    def seeds(self, task: TaskSpec) -> list[int]:
        """Seeds of the runs; ``task`` must be in the split that they are for."""
        scenario = task.scenario
        is_drawn = any(one.half_width for one in scenario.groups) or any(one.half_width for one in scenario.start_groups)
        seasons_differ = len(scenario.seasons) > 1 or scenario.start_within_days > 0 or scenario.generated is not None
        forecast = task.observation.forecast
        is_guessed = forecast is not None and forecast.error != PERFECT
        errs = is_guessed or any((task.sensors, task.outdoor_sensors, task.actuators, task.samples, task.camera))
        return list(range(self.first_seed, self.first_seed + (self.runs if is_drawn or seasons_differ or errs else 1)))


class Accrual(FrozenSettings):
    """A reward used only in training: ``price`` times the growth of a model state in a step.

    A policy that is paid for carbohydrate as it is made learns to make it, with CO2, light and warmth; otherwise this pays off many days
    later, beyond the discount horizon. Scores, evaluations and learning curves never contain it.
    """

    state: str | tuple[str, ...]
    """Public name of the state, or of several."""
    price: FiniteFloat | tuple[FiniteFloat, ...]
    """Reward for one unit of each state, or of one after the other; below 0 for what does harm later, such as mould."""

    @property
    def states(self) -> tuple[str, ...]:
        """Public names of the states."""
        return (self.state,) if isinstance(self.state, str) else self.state

    @property
    def prices(self) -> tuple[float, ...]:
        """Reward for one unit of each of ``states``."""
        return (self.price,) * len(self.states) if isinstance(self.price, float) else self.price

    @model_validator(mode="after")
    def _has_a_price_for_each(self) -> Self:
        if len(self.prices) != len(self.states) or 0.0 in self.prices:
            refuse(f"'price' is {self.price} for {', '.join(self.states)}: give one price for all, or one for each, and none that is 0.")
        return self

    def places(self, task: TaskSpec) -> list[int]:
        """Places of the states in the model of ``task``. Raises ``TrainingError`` when the model lacks one."""
        names = task.model_value.state_names
        for state in self.states:
            if state not in names:
                refuse(f"'accrual': the model of {task.id} has no state '{state}'.{did_you_mean(state, names)}", TrainingError)
        return [names.index(state) for state in self.states]

    def in_words(self, task: TaskSpec) -> str:
        """What a card says of it: the states, what they are, and what a unit of them earns in the task's reward."""
        states = zip((task.model_value.states[place] for place in self.places(task)), self.prices, strict=True)
        parts = [f"{one.meaning}, {price:g} of the reward for 1 {one.unit}".removesuffix(" -") for one, price in states]
        return f"In training, growth of {' and '.join(self.states)} was paid for as well: {'; '.join(parts)}."


class TrainingSettings(FrozenSettings):
    """Settings of one training."""

    algorithm: str
    """``ppo``, ``sac``, or the class path of an algorithm of Stable-Baselines3's kind (``sb3_contrib.RecurrentPPO``)."""
    n_timesteps: int = Field(default=2_000_000, gt=0)
    """Environment steps, over all greenhouses."""
    n_envs: int = Field(default=8, gt=0)
    """Greenhouses stepped together."""
    first_env_seed: TrainingSeed = FIRST_TRAINING_SEED
    """Seed of the first episode of the first greenhouse; episode j of greenhouse i has the seed ``first_env_seed + j n_envs + i``, both
    counted from 0."""
    start_from: PolicyFile | None = None
    """File of a policy (``policy.npz``) whose actor and statistics the training begins with; in a settings file relative to it."""
    policy: str = "MlpPolicy"
    """Name of the policy, as the algorithm knows it."""
    policy_kwargs: dict[str, Any] = Field(default_factory=dict)
    """Arguments of the policy; ``activation_fn`` and ``optimizer_class`` by name (``SiLU``, ``Adam``)."""
    action_noise_std: float | None = Field(default=None, gt=0)
    """Standard deviation of Gaussian noise on actions, for algorithms with a replay buffer."""
    accrual: Accrual | None = None
    """A reward used only in training; ``None`` for none."""
    normalize: Normalization = Normalization()
    evaluation: EvaluationPlan = EvaluationPlan()
    kernel_preset: Literal["fast", "reference"] = "fast"
    hyperparameters: Annotated[dict[str, Any], AfterValidator(_allowed)] = Field(default_factory=dict)
    """All other arguments of the algorithm's class."""

    @property
    def gamma(self) -> float:
        """Discount a step, which also scales the rewards; Stable-Baselines3's 0.99 when the file is silent."""
        return float(self.hyperparameters.get("gamma", 0.99))


OWN = frozenset(TrainingSettings.model_fields) - {"algorithm", "hyperparameters"}
"""Settings of the training itself; all others are arguments of the algorithm's class."""


def shipped_settings(algorithm: str) -> Path:
    """File with the paper's settings of ``algorithm``, a short name in any case or a class path. Raises ``TrainingError`` without one."""
    name = algorithm.removeprefix("stable_baselines3.").lower()
    if name not in PAPER:
        msg = f"glbench ships no settings for '{algorithm}'. Give a file of your own with --config (docs/training.md shows one)."
        raise TrainingError(msg)
    return data_folder("baselines") / PAPER[name]


def read_settings(file: Path, algorithm: str, task_id: str) -> TrainingSettings:
    """Settings for a task from a YAML file: ``default:``, overlaid with the entries under the task's id.

    Keys that are not settings of the training itself are arguments of the algorithm's class. Raises ``TrainingError`` for bad files.
    """
    merged = section(file, task_id)
    own = {key: value for key, value in merged.items() if key in OWN}
    rest = {key: value for key, value in merged.items() if key not in OWN}
    for key, value in rest.items():
        if isinstance(value, str) and _LIKE_A_NUMBER.match(value):
            refuse(f"'{key}: {value}' in {file} is not a number.", TrainingError)
    content = {**own, "algorithm": algorithm, "hyperparameters": rest}
    return validated(TrainingSettings, content, "the settings", file, TrainingError, inline="hyperparameters")


def section(file: Path, task_id: str) -> dict[str, Any]:
    """Entries for a task: ``default:``, overlaid with those under the task's id; ``start_from`` becomes an absolute path.

    Errors as for ``read_settings``.
    """
    content = read_yaml(file, "the settings", TrainingError)
    if not all(isinstance(part, dict) or part is None for part in content.values()):
        refuse(f"{file} is not a settings file: it needs a section 'default:' and may have sections named by task ids.", TrainingError)
    if "default" not in content:
        names = ", ".join(f"'{name}'" for name in content)
        refuse(f"{file} has no section 'default:' (only {names}). Put the settings that hold for every task there.", TrainingError)
    sections = {name: part or {} for name, part in content.items()}
    own = sections.get(task_id, sections.get(task_id.rpartition("/")[2], {}))
    merged: dict[str, Any] = numbers(_overlaid(sections["default"], own))
    if isinstance(merged.get("start_from"), str):
        merged["start_from"] = real_path(file.parent / merged["start_from"])
    return merged


def numbers(content: Any) -> Any:
    """The content of a YAML file with numbers in the place of texts that are spelt as one: ``2e-5`` is text to YAML 1.1."""
    if isinstance(content, dict):
        return {key: numbers(value) for key, value in content.items()}
    if isinstance(content, list):
        return [numbers(value) for value in content]
    if not isinstance(content, str) or not _LIKE_A_NUMBER.match(content):
        return content
    try:
        number = float(content)
    except ValueError:
        return content
    if not math.isfinite(number):
        return content
    return int(number) if number.is_integer() else number


def _overlaid(under: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """Both, with what ``over`` says where both say something; tables in them in the same way."""
    both = {
        key: _overlaid(under[key], value) for key, value in over.items() if isinstance(value, dict) and isinstance(under.get(key), dict)
    }
    return {**under, **over, **both}
