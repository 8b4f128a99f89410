"""Hyperparameter search, as a YAML file says it in the words of Weights & Biases sweeps.

The search is an Optuna study in a local SQLite file, which any number of workers share and continue.
"""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import optuna
from optuna.storages import RDBStorage
from optuna.trial import FrozenTrial, TrialState
from pydantic import Field, ValidationError, model_validator
from sqlalchemy.exc import SQLAlchemyError

from glbench.errors import GlbenchError, TrainingError, did_you_mean, last_line, refuse
from glbench.execution import Executor, Future, InlineExecutor
from glbench.settings import readable_errors, validated
from glbench.tasks import get_task
from glbench.training.algorithms import check_settings
from glbench.training.card import settings_digest
from glbench.training.folder import CHECKPOINT
from glbench.training.multi_seed import outcome_of, submit_training
from glbench.training.periodic_evaluation import CurvePoint, Listener
from glbench.training.run import train
from glbench.training.settings import FrozenSettings, TrainingSettings, numbers, read_settings, shipped_settings
from glbench.untrusted import real_path
from glbench.yaml_reader import read_yaml

Choice = bool | int | float | str
STUDY = "study.db"
_ENDED = (TrialState.COMPLETE, TrialState.PRUNED, TrialState.FAIL)
_REASON = "reason"
_LOCK_SECONDS = 60


class Parameter(FrozenSettings):
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
            refuse("give 'value', 'values', or both 'min' and 'max'")
        if ranged and not self.min < self.max:  # type: ignore[operator]
            refuse("'min' must be below 'max'")
        if self.distribution == "log_uniform_values" and (self.min is None or self.min <= 0):
            refuse("a logarithmic range needs a 'min' above 0")
        return self

    @property
    def first(self) -> Choice:
        """One of the choices: the value, the first of the values, or the least."""
        return next(value for value in (self.value, *(self.values or ()), self.min) if value is not None)

    def suggest(self, trial: optuna.Trial, name: str) -> Any:
        """What a trial of Optuna's takes for the parameter, which has that name."""
        low, high = self.min, self.max
        if low is None or high is None:
            return trial.suggest_categorical(name, list(self.values or (self.first,)))
        log = self.distribution == "log_uniform_values"
        whole = isinstance(low, int) and isinstance(high, int) and self.distribution != "uniform"
        if whole or self.distribution == "int_uniform":
            return trial.suggest_int(name, int(low), int(high), log=log)
        return trial.suggest_float(name, float(low), float(high), log=log)


class Search(FrozenSettings):
    """What is searched, how, and for which agent."""

    algorithm: str
    task: str
    """``algorithm`` and ``task``: what is trained on what."""
    config: Path | None = None
    """Settings that the search starts from; by default the shipped ones of the algorithm."""
    steps: int = Field(default=200_000, gt=0)
    """Environment steps of a trial."""
    trials: int = Field(default=30, gt=0)
    """Number of trials in all."""
    seed: int = Field(default=0, ge=0)
    """Seed of search and trainings."""
    method: Literal["bayes", "random", "grid"] = "bayes"
    """``bayes`` (tree-structured Parzen estimator), ``random``, or ``grid`` (``values`` and ``value`` only)."""
    prune: bool = True
    """Whether trials that lag behind the median at the same step are stopped early."""
    parameters: dict[str, Parameter] = Field(min_length=1)
    """By name: settings of the training or of the algorithm; parts of a setting with a dot (``normalize.rewards``)."""

    @model_validator(mode="after")
    def _grid_of_values(self) -> Search:
        ranges = [name for name, parameter in self.parameters.items() if parameter.min is not None]
        if self.method == "grid" and ranges:
            refuse(f"a grid needs 'values', not ranges: {', '.join(ranges)}")
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
        about = {"name": f"{self.algorithm} {self.task}", "method": self.method}
        return {**about, "metric": {"name": "best_reward", "goal": "maximize"}, "parameters": parameters}


def read_search(file: Path) -> Search:
    """The search in a YAML file. Raises ``TrainingError`` when it cannot be read, or asks for something impossible."""
    content = numbers(read_yaml(file, "the search", TrainingError))
    search = validated(Search, content, "the search", file, TrainingError, advice="docs/training.md shows one.")
    config = search.config
    return search if config is None else search.model_copy(update={"config": real_path(file.parent / config)})


def with_choices(settings: TrainingSettings, choices: dict[str, Any], steps: int) -> TrainingSettings:
    """Settings with the choices of a trial. Raises ``TrainingError`` when a choice is none of the settings' parts, or impossible."""
    content: dict[str, Any] = settings.model_dump(mode="json")
    content["n_timesteps"] = steps
    for name, value in choices.items():
        _set_choice(content, name, value)
    try:
        return TrainingSettings.model_validate(content)
    except ValidationError as error:
        problems = readable_errors(error, TrainingSettings, inline="hyperparameters")
        refuse(f"A trial cannot be trained: {problems}", TrainingError, error)


def _set_choice(content: dict[str, Any], name: str, value: Any) -> None:
    first, *rest = name.split(".")
    if not rest:
        home = content if first in content and first != "hyperparameters" else content["hyperparameters"]
        home[first] = value
        return
    part = content.get(first, content["hyperparameters"].get(first))
    for key in rest[:-1]:
        part = part.setdefault(key, {}) if isinstance(part, dict) else None
    if not isinstance(part, dict):
        names = [key for key, item in content.items() if isinstance(item, dict)]
        refuse(f"The search names '{name}', but '{first}' has no parts.{did_you_mean(first, names)}", TrainingError)
    part[rest[-1]] = value


@dataclass(frozen=True)
class TrialReport:
    """A trial that ended."""

    number: int
    state: str
    """``complete``, ``pruned`` or ``fail``."""
    reward: float | None
    """Best evaluation return; ``None`` when it has none."""
    choices: dict[str, Any]
    reason: str | None = None
    """Why it failed, in one line; ``None`` when it did not."""


Report = Callable[[TrialReport], None]


def base_settings(search: Search) -> TrainingSettings:
    """The settings that a search starts from."""
    return read_settings(search.config or shipped_settings(search.algorithm), search.algorithm, get_task(search.task).id)


def sweep(search: Search, folder: Path, *, executor: Executor | None = None, report: Report | None = None) -> list[TrialReport]:
    """Run the search in ``folder`` until it has all its trials; what is there already counts, and is continued.

    A trial that a kill interrupted does not count, and another one takes its place; one that failed counts. What a trial draws follows from
    the search's seed and the trial's number: a search that is continued, and several workers, try no choice twice by that. With several
    workers the course of a search depends on who is faster; each trial by itself is reproducible. Study and folders of the trials are
    always on this machine. Raises ``TrainingError`` when the search cannot be run, the folder holds another one, or all its trials failed,
    and ``UnknownNameError`` when there is no such algorithm or task.

    ``executor`` trains the trials, as many at a time as it has workers; by default this process. ``report`` gets each trial that ended,
    those of other commands that work on the same search included. Returns all trials that ended, best first.
    """
    settings = base_settings(search)
    check_settings(with_choices(settings, {name: p.first for name, p in search.parameters.items()}, search.steps))
    folder.mkdir(parents=True, exist_ok=True)
    with study_errors(folder), InlineExecutor() as inline:
        study = open_study(search, folder)
        _claim(study, search, settings, folder)
        reported = {trial.number for trial in study.get_trials(deepcopy=False, states=_ENDED)}
        task = get_task(search.task)

        def trials(count: int) -> Iterator[optuna.Trial]:
            for _ in range(count):
                if len(study.get_trials(deepcopy=False, states=_ENDED)) >= search.total:
                    return  # other commands may work on the same search
                yield study.ask()

        def submit(trial: optuna.Trial) -> Future:
            if search.method != "grid":
                study.sampler = _sampler(search, trial.number)
            choices = {name: parameter.suggest(trial, name) for name, parameter in search.parameters.items()}
            return submit_training(
                executor or inline,
                train,
                task,
                with_choices(settings, choices, search.steps),
                _trial_folder(folder, trial),
                seed=search.seed,
                resume=True,
                tensorboard=False,
                save_seconds=float("inf"),
                listeners=[_Pruning(trial, search.steps)],
                waits_for_answers=search.prune,
            )

        coming = (executor or inline).map_as_completed(submit, trials(max(search.total - len(reported), 0)))
        for trial, future in coming:
            _end_trial(study, trial, future, _trial_folder(folder, trial))
            for ended in study.get_trials(deepcopy=False, states=_ENDED):
                if ended.number not in reported:
                    reported.add(ended.number)
                    if report is not None:
                        report(_report_of(ended))
        reports = [_report_of(trial) for trial in study.get_trials(states=_ENDED)]
    if reports and all(trial.state == "fail" for trial in reports):
        refuse(f"All {len(reports)} trials of the search in {folder} failed, the last one so: {reports[-1].reason}", TrainingError)
    return sorted(reports, key=lambda trial: -float("inf") if trial.reward is None else trial.reward, reverse=True)


def _trial_folder(folder: Path, trial: optuna.Trial) -> Path:
    return folder / f"trial-{trial.number:04d}"


def _end_trial(study: optuna.Study, trial: optuna.Trial, future: Future, folder: Path) -> None:
    """Write the outcome of a trial into the study."""
    state, reward = TrialState.FAIL, None
    try:
        reward = outcome_of(future, folder).best_reward
        if not math.isnan(reward):
            state = TrialState.COMPLETE
    except optuna.TrialPruned:
        state = TrialState.PRUNED
    except Exception as error:
        first_line = (str(error).strip().splitlines() or [""])[0]
        reason = first_line if isinstance(error, GlbenchError) else f"{type(error).__name__}: {first_line}"
        trial.set_user_attr(_REASON, reason)
    study.tell(trial, reward if state == TrialState.COMPLETE else None, state)
    shutil.rmtree(folder / CHECKPOINT, ignore_errors=True)  # with a replay buffer it is large; no trial continues


class _Pruning(Listener):
    """Tells the study how a trial goes, and stops it when the study says so."""

    def __init__(self, trial: optuna.Trial, last_step: int) -> None:
        self._trial, self._last_step, self._reported = trial, last_step, -1

    def on_evaluation(self, point: CurvePoint) -> None:
        """Report; raise if the trial should be pruned, unless it is at its end. Reports of a lost worker are not repeated."""
        if point.steps <= self._reported:
            return
        self._reported = point.steps
        self._trial.report(point.result.reward, point.steps)
        if point.steps < self._last_step and self._trial.should_prune():
            raise optuna.TrialPruned


@contextmanager
def study_errors(folder: Path) -> Iterator[None]:
    """Raises ``TrainingError`` where the study in ``folder`` cannot be read or written: no place for it, a full disk, damage."""
    try:
        yield
    except (SQLAlchemyError, optuna.exceptions.StorageInternalError) as error:
        reason = getattr(error, "orig", None) or getattr(error.__cause__, "orig", None) or last_line(error)
        way_out = "If the disk is full or another command uses it, try again later; if it is damaged, choose a new folder with --out."
        refuse(f"The study {folder / STUDY} cannot be read or written: {reason}. {way_out}", TrainingError, error)


def open_study(search: Search, folder: Path) -> optuna.Study:
    """The study in ``folder``, begun where there is none."""
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    storage = RDBStorage(f"sqlite:///{(folder / STUDY).resolve()}", engine_kwargs={"connect_args": {"timeout": _LOCK_SECONDS}})
    pruner: optuna.pruners.BasePruner = optuna.pruners.NopPruner()
    if search.prune:
        pruner = optuna.pruners.MedianPruner(n_warmup_steps=1)  # the evaluation at step 0 says nothing
    return optuna.create_study(
        study_name="glbench", storage=storage, sampler=_sampler(search, 0), pruner=pruner, direction="maximize", load_if_exists=True
    )  # fmt: skip


def _sampler(search: Search, trial: int) -> optuna.samplers.BaseSampler:
    seed = int(np.random.SeedSequence([search.seed, trial]).generate_state(1)[0])
    if search.method == "grid":
        return _GridSampler({name: list(p.values or (p.first,)) for name, p in search.parameters.items()}, seed=search.seed)
    return optuna.samplers.RandomSampler(seed=seed) if search.method == "random" else optuna.samplers.TPESampler(seed=seed)


class _GridSampler(optuna.samplers.GridSampler):
    """Does not stop the study after the last combination, which Optuna allows in its own loop only."""

    def after_trial(self, study: optuna.Study, trial: FrozenTrial, state: TrialState, values: Any) -> None:
        """Do nothing: ``sweep`` counts trials."""


def _claim(study: optuna.Study, search: Search, settings: TrainingSettings, folder: Path) -> None:
    """Write the search into its study, with what its files say; refuse a study of another search."""
    content = search.model_dump(mode="json", exclude={"trials"})
    identity = {**content, "config": settings_digest(settings), "task": get_task(search.task).digest}
    stored = study.user_attrs.get("search")
    before = identity if stored is None else json.loads(stored)
    differences = [name for name, value in identity.items() if before.get(name) != value]
    if differences:
        differs = f"{folder} holds another search, which differs in {', '.join(differences)}."
        refuse(f"{differs} Choose another folder with --out, or what it was begun with (only 'trials' may grow).", TrainingError)
    study.set_user_attr("search", json.dumps(identity))


def _report_of(trial: FrozenTrial) -> TrialReport:
    reward = trial.value if trial.state == TrialState.COMPLETE else max(trial.intermediate_values.values(), default=None)
    reason = trial.user_attrs.get(_REASON, "its reward is not a number") if trial.state == TrialState.FAIL else None
    return TrialReport(trial.number, trial.state.name.lower(), reward, dict(trial.params), reason)
