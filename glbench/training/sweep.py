"""Hyperparameter search: an Optuna study in a local SQLite file, which any number of workers share and continue."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from optuna.storages import RDBStorage
from optuna.study import MaxTrialsCallback
from optuna.trial import FrozenTrial, TrialState

from glbench.errors import TrainingError
from glbench.tasks import get_task
from glbench.training.progress import CurvePoint, Listener, Progress
from glbench.training.run import train
from glbench.training.search_space import Parameter, Search, with_choices
from glbench.training.settings import TrainingSettings, read_settings, shipped_settings

STUDY = "study.db"
_COUNTED = (TrialState.COMPLETE, TrialState.PRUNED)
_LOCK_SECONDS = 60


@dataclass(frozen=True)
class TrialReport:
    """A trial that ended."""

    number: int
    state: str
    """``complete``, ``pruned`` or ``fail``."""
    reward: float | None
    """Best evaluation return; ``None`` when it has none."""
    choices: dict[str, Any]


Report = Callable[[TrialReport], None]


def base_settings(search: Search) -> TrainingSettings:
    """The settings that a search starts from, checked against its task."""
    file = search.config or shipped_settings(search.algorithm)
    return read_settings(file, search.algorithm, get_task(search.task).id)


def sweep(search: Search, folder: Path, *, workers: int = 1, report: Report | None = None) -> list[TrialReport]:
    """Run the search in ``folder`` until it has all its trials; what is there already counts, and is continued.

    A trial that a kill interrupted does not count, and another one takes its place. What a trial draws follows from the
    search's seed and the trial's number: a search that is continued, and several workers, try no choice twice by that.
    With several workers the course of a search depends on who is faster; each trial by itself is reproducible.

    Returns
    -------
    list of TrialReport
        All trials that ended, best first.

    Raises
    ------
    TrainingError
        When the search cannot be run, or the folder holds another one.
    """
    base_settings(search)
    folder.mkdir(parents=True, exist_ok=True)
    study = open_study(search, folder)
    _claim(study, search, folder)
    if workers == 1:
        _work(search, folder, report)
    else:
        context = multiprocessing.get_context("spawn")
        others = [context.Process(target=_work, args=(search, folder)) for _ in range(workers)]
        for process in others:
            process.start()
        try:
            for process in others:
                process.join()
        except BaseException:
            for process in others:
                process.terminate()
            raise
        if any(process.exitcode for process in others):
            msg = f"A worker of the sweep in {folder} failed; its message is above. The same command goes on."
            raise TrainingError(msg)
    ended = [_report_of(trial) for trial in study.get_trials(states=(*_COUNTED, TrialState.FAIL))]
    return sorted(ended, key=lambda trial: -float("inf") if trial.reward is None else trial.reward, reverse=True)


class _Pruning(Listener):
    """Tells the study how a trial goes, and stops it when the study says so."""

    def __init__(self, trial: optuna.Trial) -> None:
        self._trial = trial

    def on_progress(self, progress: Progress) -> None:
        """Nothing to tell."""

    def on_evaluation(self, point: CurvePoint) -> None:
        """Report; raise when the trial is to be pruned."""
        self._trial.report(point.result.reward, point.steps)
        if self._trial.should_prune():
            raise optuna.TrialPruned

    def on_saved(self, steps: int) -> None:
        """Nothing to tell."""


def _work(search: Search, folder: Path, report: Report | None = None) -> None:
    settings, task = base_settings(search), get_task(search.task)

    def objective(trial: optuna.Trial) -> float:
        if search.method != "grid":
            trial.study.sampler = _sampler(search, trial.number)
        choices = {name: _suggest(trial, name, parameter) for name, parameter in search.parameters.items()}
        chosen = with_choices(settings, choices, search.steps)
        place = folder / f"trial-{trial.number:04d}"
        trained = train(
            task,
            chosen,
            place,
            seed=search.seed,
            resume=True,
            tensorboard=False,
            save_seconds=float("inf"),
            listeners=[_Pruning(trial)],
        )
        return trained.best_reward

    def tell(study: optuna.Study, trial: FrozenTrial) -> None:
        if report is not None:
            report(_report_of(trial))

    study = open_study(search, folder)
    left = search.trials - len(study.get_trials(deepcopy=False, states=_COUNTED))
    if left > 0:
        enough = MaxTrialsCallback(search.trials, states=_COUNTED)
        study.optimize(objective, n_trials=left, callbacks=[tell, enough])


def open_study(search: Search, folder: Path) -> optuna.Study:
    """The study in ``folder``, begun where there is none."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    storage = RDBStorage(
        f"sqlite:///{(folder / STUDY).resolve()}", engine_kwargs={"connect_args": {"timeout": _LOCK_SECONDS}}
    )
    pruner: optuna.pruners.BasePruner = optuna.pruners.NopPruner()
    if search.prune:
        pruner = optuna.pruners.MedianPruner(n_warmup_steps=1)  # the evaluation at step 0 says nothing
    return optuna.create_study(
        study_name="glbench", storage=storage, sampler=_sampler(search, 0), pruner=pruner, direction="maximize", load_if_exists=True
    )  # fmt: skip


def _sampler(search: Search, trial: int) -> optuna.samplers.BaseSampler:
    seed = int(np.random.SeedSequence([search.seed, trial]).generate_state(1)[0])
    if search.method == "grid":
        grid = {name: list(p.values or ([] if p.value is None else [p.value])) for name, p in search.parameters.items()}
        return optuna.samplers.GridSampler(grid, seed=search.seed)
    if search.method == "random":
        return optuna.samplers.RandomSampler(seed=seed)
    return optuna.samplers.TPESampler(seed=seed)


def _suggest(trial: optuna.Trial, name: str, parameter: Parameter) -> Any:
    if parameter.value is not None:
        return trial.suggest_categorical(name, [parameter.value])
    if parameter.values:
        return trial.suggest_categorical(name, list(parameter.values))
    low, high = parameter.bounds()
    log = parameter.distribution == "log_uniform_values"
    whole = isinstance(low, int) and isinstance(high, int) and parameter.distribution != "uniform"
    if whole or parameter.distribution == "int_uniform":
        return trial.suggest_int(name, int(low), int(high), log=log)
    return trial.suggest_float(name, float(low), float(high), log=log)


def _claim(study: optuna.Study, search: Search, folder: Path) -> None:
    """Write the search into its study; refuse a study of another search."""
    wanted = search.model_dump_json(exclude={"trials"})
    found = study.user_attrs.get("search")
    if found is None:
        study.set_user_attr("search", wanted)
    elif found != wanted:
        msg = f"{folder} holds another search. Choose another folder with --out, or the file it was begun with (only 'trials' may grow)."
        raise TrainingError(msg)


def _report_of(trial: FrozenTrial) -> TrialReport:
    reward = (
        trial.value if trial.state == TrialState.COMPLETE else max(trial.intermediate_values.values(), default=None)
    )
    return TrialReport(trial.number, trial.state.name.lower(), reward, dict(trial.params))
