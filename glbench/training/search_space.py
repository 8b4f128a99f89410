"""A hyperparameter search as a YAML file says it, in the words of Weights & Biases sweeps."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from glbench.errors import TrainingError, did_you_mean
from glbench.training.settings import TrainingSettings, numbers, problems_of

if TYPE_CHECKING:
    import optuna

Choice = bool | int | float | str


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Parameter(_Part):
    """What a setting may be: one ``value``, some ``values``, or from ``min`` to ``max`` (whole numbers when both are)."""

    value: Choice | None = None
    values: tuple[Choice, ...] | None = None
    min: int | float | None = None
    max: int | float | None = None
    distribution: Literal["constant", "categorical", "uniform", "int_uniform", "log_uniform_values"] | None = None

    @model_validator(mode="after")
    def _one_way(self) -> Parameter:
        ranged = self.min is not None and self.max is not None
        if (self.value is not None) + bool(self.values) + ranged != 1 or (self.min is None) != (self.max is None):
            msg = "give 'value', 'values', or both 'min' and 'max'"
            raise ValueError(msg)
        if ranged and not self.min < self.max:  # type: ignore[operator]
            msg = "'min' must be below 'max'"
            raise ValueError(msg)
        if self.distribution == "log_uniform_values" and (self.min is None or self.min <= 0):
            msg = "a logarithmic range needs a 'min' above 0"
            raise ValueError(msg)
        return self

    def bounds(self) -> tuple[int | float, int | float]:
        """``min`` and ``max`` of a range.

        Raises
        ------
        TrainingError
            When it is none.
        """
        if self.min is None or self.max is None:
            msg = "This parameter has values to choose from, no range."
            raise TrainingError(msg)
        return self.min, self.max

    @property
    def first(self) -> Choice:
        """One of the choices: the value, the first of the values, or the least."""
        return next(value for value in (self.value, *(self.values or ()), self.min) if value is not None)

    def suggest(self, trial: optuna.Trial, name: str) -> Any:
        """What a trial of Optuna's takes for the parameter, which has that name."""
        if self.min is None:
            return trial.suggest_categorical(name, list(self.values or (self.first,)))
        low, high = self.bounds()
        log = self.distribution == "log_uniform_values"
        whole = isinstance(low, int) and isinstance(high, int) and self.distribution != "uniform"
        if whole or self.distribution == "int_uniform":
            return trial.suggest_int(name, int(low), int(high), log=log)
        return trial.suggest_float(name, float(low), float(high), log=log)


class Search(_Part):
    """What is searched, how, and for which agent.

    Attributes
    ----------
    algorithm, task
        What is trained on what.
    config
        Settings that the search starts from; by default the shipped ones of the algorithm.
    steps
        Environment steps of a trial.
    trials
        Number of trials in all.
    seed
        Seed of search and trainings.
    method
        ``bayes`` (tree-structured Parzen estimator), ``random``, or ``grid`` (``values`` and ``value`` only).
    prune
        Whether trials that lag behind the median at the same step are stopped early.
    parameters
        By name: settings of the training or of the algorithm; parts of a setting with a dot (``normalize.rewards``).
    """

    algorithm: str
    task: str
    config: Path | None = None
    steps: int = Field(default=200_000, gt=0)
    trials: int = Field(default=30, gt=0)
    seed: int = Field(default=0, ge=0)
    method: Literal["bayes", "random", "grid"] = "bayes"
    prune: bool = True
    parameters: dict[str, Parameter] = Field(min_length=1)

    @model_validator(mode="after")
    def _grid_of_values(self) -> Search:
        ranges = [name for name, parameter in self.parameters.items() if parameter.min is not None]
        if self.method == "grid" and ranges:
            msg = f"a grid needs 'values', not ranges: {', '.join(ranges)}"
            raise ValueError(msg)
        return self

    @property
    def total(self) -> int:
        """Trials in all: of a grid no more than it has combinations."""
        if self.method != "grid":
            return self.trials
        return min(self.trials, math.prod(len(parameter.values or (0,)) for parameter in self.parameters.values()))

    def wandb_config(self) -> dict[str, Any]:
        """The search as Weights & Biases' own configuration."""
        parameters = {name: p.model_dump(mode="json", exclude_none=True) for name, p in self.parameters.items()}
        metric = {"name": "best_reward", "goal": "maximize"}
        return {
            "name": f"{self.algorithm} {self.task}",
            "method": self.method,
            "metric": metric,
            "parameters": parameters,
        }


def read_search(file: Path) -> Search:
    """The search in a YAML file.

    Raises
    ------
    TrainingError
        When it cannot be read, or asks for something impossible.
    """
    try:
        search = Search.model_validate(numbers(yaml.safe_load(file.read_text(encoding="utf-8"))))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        msg = f"Cannot read the search {file}: {error}."
        raise TrainingError(msg) from error
    except ValidationError as error:
        problems = "; ".join(f"'{'.'.join(map(str, p['loc'])) or 'file'}': {p['msg']}" for p in error.errors())
        msg = f"The search in {file} cannot be used: {problems}. docs/training.md shows one."
        raise TrainingError(msg) from error
    config = search.config
    return search if config is None else search.model_copy(update={"config": (file.parent / config).resolve()})


def with_choices(settings: TrainingSettings, choices: dict[str, Any], steps: int) -> TrainingSettings:
    """Settings with the choices of a trial in their places.

    Raises
    ------
    TrainingError
        When a choice is none of the settings' parts, or impossible.
    """
    content: dict[str, Any] = settings.model_dump(mode="json")
    content["n_timesteps"] = steps
    for name, value in choices.items():
        _put(content, name, value)
    try:
        return TrainingSettings.model_validate(content)
    except ValidationError as error:
        msg = f"A trial cannot be trained: {problems_of(error, TrainingSettings)}"
        raise TrainingError(msg) from error


def _put(content: dict[str, Any], name: str, value: Any) -> None:
    first, *rest = name.split(".")
    if not rest:
        home = content if first in content and first != "hyperparameters" else content["hyperparameters"]
        home[first] = value
        return
    part = content.get(first, content["hyperparameters"].get(first))
    for key in rest[:-1]:
        part = part.setdefault(key, {}) if isinstance(part, dict) else None
    if not isinstance(part, dict):
        known = [key for key, item in content.items() if isinstance(item, dict)]
        msg = f"The search names '{name}', but '{first}' has no parts.{did_you_mean(first, known)}"
        raise TrainingError(msg)
    part[rest[-1]] = value
