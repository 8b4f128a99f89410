"""Finding tasks: by id among the shipped ones, or by path among the user's own; and the suites they form."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

import numpy as np

from glbench.canonical import canonical_sha256
from glbench.errors import TaskError, UnknownNameError, did_you_mean, refuse
from glbench.registration import draft_files, task_files
from glbench.tasks.card import injected_task
from glbench.tasks.digest import LOCK_WORDS, LockEntry, lock_path, read_lock, write_lock
from glbench.tasks.inheritance import TaskTables, read_tables, shipped_file, shown_path
from glbench.tasks.price_files import doubts_of_prices
from glbench.tasks.references import warn_if_deprecated
from glbench.tasks.spec import TaskSpec
from glbench.untrusted import real_path

logger = logging.getLogger(__name__)
_State = tuple[int, int]
"""When a file was changed, and its size."""

DEFAULT_TASK = "glbench/GreenhouseReal-v1"
"""The task that is meant when none is named."""

PAPER_TASK = "glbench/Schiphol2010-Delta10-v1"
"""The benchmark of the GreenLight-Gym paper."""


def usual_task(ids: Iterable[str]) -> str | None:
    """Of these tasks, the one that is meant when none is named: the default one, else the paper's; ``None`` without both."""
    names = set(ids)
    return next((task for task in (DEFAULT_TASK, PAPER_TASK) if task in names), None)


def get_task(id_or_path: str | Path) -> TaskSpec:
    """Task with an id such as ``glbench/Schiphol2010-Delta10-v1`` (or its short form), or of a ``.toml`` file.

    A published task is compared with the lock, weather and model included, once a process. A file of your own is loaded as
    it is; its ``locked`` is false. In a sandbox the agent's own task is there, without weather, and no other. Warns of deprecated tasks.

    Raises ``UnknownNameError`` when there is no task of that id; names the nearest. Raises ``TaskError`` when the definition is invalid,
    when a published task was changed, or when a file uses a published id for another task.
    """
    if not isinstance(id_or_path, str | Path):
        refuse(f"A task is asked for by its id, such as '{DEFAULT_TASK}', or by its file (.toml); got {id_or_path!r}.", UnknownNameError)
    injected = injected_task(str(id_or_path))
    if injected is not None:
        return injected
    path = Path(id_or_path)
    return _load(path) if isinstance(id_or_path, Path) or path.suffix == ".toml" else _load(shipped_file(str(id_or_path)))


def read_task(path: Path) -> TaskSpec:
    """Task of the file ``path``. Checks everything that can be checked without the model and the weather.

    Raises ``TaskError`` when the file or its base cannot be read, is not TOML, or they do not define a task.
    """
    return TaskSpec.of_file(read_tables(path), shown_path(path))


def published_task(task_id: str) -> TaskSpec:
    """A shipped task by its id, without weather. Only its file is compared with the lock, as by ``list_tasks``.

    Raises ``UnknownNameError``, with the nearest ids, when there is no such task, and ``TaskError`` when its file is invalid or changed.
    """
    return _load(shipped_file(task_id), whole=False)


def list_tasks() -> list[TaskSpec]:
    """All published tasks, in the order of their files.

    Their files are compared with the lock; weather and model are only when a task is taken with ``get_task``.

    Raises ``TaskError`` when a file is invalid or a published one was changed.
    """
    return [_load(path, whole=False) for path in task_files()]


def list_drafts() -> list[TaskSpec]:
    """Shipped tasks that are not published: usable like any other, and may change. Raises ``TaskError`` when a file is invalid."""
    return [read_task(path) for path in draft_files()]


def list_suites() -> dict[str, tuple[str, ...]]:
    """Names of the suites and the ids of their tasks; those of the default task come first, then their older forms (``control-2025``)."""
    suites: dict[str, list[str]] = {}
    for task in sorted(list_tasks(), key=lambda task: task.id != DEFAULT_TASK):
        for suite in task.suites:
            suites.setdefault(suite, []).append(task.id)
    ours = next(iter(suites), "")
    return {suite: tuple(sorted(suites[suite])) for suite in sorted(suites, key=lambda suite: not suite.startswith(ours))}


def get_suite(name: str) -> tuple[TaskSpec, ...]:
    """Tasks of a suite, each compared with the lock. Raises ``UnknownNameError`` for an unknown suite, and errors as for ``get_task``."""
    suites = list_suites()
    if name not in suites:
        refuse(f"There is no suite '{name}'.{did_you_mean(name, suites)}", UnknownNameError)
    return tuple(get_task(task_id) for task_id in suites[name])


def lock_new_tasks() -> tuple[LockEntry, ...]:
    """Add the shipped tasks that are not locked yet to the lock and return the new entries.

    Raises ``TaskError`` when a locked task was changed: nothing is written then, because a lock entry never changes.
    """
    entries = dict(read_lock())
    new = []
    for path in task_files():
        task = read_task(path)
        check_file_name(task, path)
        if task.id in entries:
            check_against_lock(task, entries[task.id])
        else:
            entries[task.id] = LockEntry(task.id, path.name, task.fingerprint())
            new.append(entries[task.id])
    if new:
        write_lock(entries, lock_path())
    return tuple(new)


def check_file_name(task: TaskSpec, path: Path) -> None:
    """Refuse a shipped task whose file is not called after its id. Raises ``TaskError`` with the name the file should have."""
    expected = f"{task.short_id.lower()}.toml"
    if path.name != expected:
        refuse(f"{task.source} defines '{task.id}', so its file must be called {expected}. Rename the file or correct the id.", TaskError)


_REMEMBERED: dict[tuple[Path, Path, bool], tuple[TaskSpec, dict[Path, _State]]] = {}
"""Tasks by file and lock, and the state of every file that each was made of: none of them is read again until one changes."""


def _load(path: Path, *, whole: bool = True) -> TaskSpec:
    """The task of a file, compared with the lock if its id is published; without ``whole``, weather and model are not compared."""
    file, lock = real_path(path), lock_path()
    remembered = _REMEMBERED.get((file, lock, whole))
    if remembered is not None and all(_state(one) == state for one, state in remembered[1].items()):
        return remembered[0]
    states = {one: _state(one) for one in (file, lock)}
    tables = read_tables(file)
    states |= {one: _state(one) for one in tables.files}
    task = _checked(file, tables, lock, states[lock], whole)
    _REMEMBERED[file, lock, whole] = task, states
    return task


@lru_cache(maxsize=256)
def _checked(file: Path, tables: TaskTables, _lock: Path, _lock_state: _State, whole: bool) -> TaskSpec:
    """``_load`` for one content of file, bases and prices and state of the lock: a task is checked once, and again when it changes."""
    for base in tables.files if whole else ():
        if _is_shipped(base) and base.suffix == ".toml":
            _load(base, whole=False)  # a published base that was edited is refused
    task = TaskSpec.of_file(tables, shown_path(file))
    entry = read_lock().get(task.id)
    if not whole:
        if entry is not None:
            check_file_against_lock(task, entry)
    elif entry is None:
        task.fingerprint()  # whatever cannot be resolved is reported now and not in the middle of a run
        check_schedule(task)
        for doubt in price_doubts(task):
            logger.warning("%s: %s", task.source, doubt)
    elif _is_shipped(file):
        check_against_lock(task, entry)
        warn_if_deprecated(task.id)
    elif task.digest != entry.digest:
        msg = (
            f"{task.source} uses the id '{task.id}' of a published task, but defines another one (published "
            f"{entry.digest[:8]}..., found {task.digest[:8]}...). Give your task an id of your own, such as 'mylab/{task.short_id}'."
        )
        raise TaskError(msg)
    return task


def price_doubts(task: TaskSpec) -> list[str]:
    """What is doubtful about the series of prices: hours without a price that runs of any split may use, and an unusual mean.

    Raises ``TaskError`` when a series has no price for any of these hours.
    """
    tables = {name: table for name, table in task.price_tables.items() if table.series and not table.source}
    if not tables:
        return []
    in_splits = [task] if task.splits is None else [task.in_split(name) for name in task.splits.names]
    begin_and_days = {
        (season.start, task.weather.days + one.scenario.start_within_days) for one in in_splits for season in one.scenario.seasons
    }
    seasons = [np.datetime64(begin, "h") + np.arange(24 * days) for begin, days in begin_and_days]
    hours = np.unique(np.concatenate(seasons))
    doubts = []
    for name, table in tables.items():
        stale = hours[table.is_stale(hours)]
        missing = f"[price_tables.{name}] has no price for {stale.size:,} of the {hours.size:,} hours that runs may use"
        if stale.size == hours.size:
            msg = (
                f"{task.source}: {missing}: {table.in_words()}. The runs lie between {hours[0].item():%Y-%m-%d} and "
                f"{hours[-1].item():%Y-%m-%d}. List prices of these dates, or write yearly = true to use one year of prices for all."
            )
            raise TaskError(msg)
        if stale.size:
            doubts.append(
                f"{missing}, the first of them {stale[0].item():%Y-%m-%d %H:%M} UTC. The nearest price before them (or the first) is "
                "charged. List the missing hours."
            )
        doubts += doubts_of_prices(table.unit, table.mean, name)
    return doubts


def check_schedule(task: TaskSpec) -> None:
    """Refuse an entry of the schedule that applies in no step of any run: TaskError with the place of the entry, from 1."""
    in_splits, day = [task] if task.splits is None else [task.in_split(name) for name in task.splits.names], task.steps_per_day
    starts = {(season.start, one.scenario.start_within_days) for one in in_splits for season in one.scenario.seasons}
    steps = [np.arange(day * (task.weather.days + late)) * np.timedelta64(task.weather.step_seconds, "s") for _, late in starts]
    moments = [np.datetime64(start, "s") + of_season for (start, _), of_season in zip(starts, steps, strict=True)]
    for number, entry in enumerate(task.schedule, 1):
        first = entry.after_day if entry.after_day < task.weather.days else 10**9
        if not any(entry.applies(season[first * day :]).any() for season in moments):
            msg = (
                f"{task.source}: [[schedule]] entry {number} ({entry.control}, {entry.in_words()}) never applies: a run has "
                f"{task.weather.days} days, and none of its steps begins at such a time. Correct the entry, or leave it out."
            )
            raise TaskError(msg)


def _state(path: Path) -> _State:
    try:
        status = path.stat()
    except OSError:
        return (0, 0)
    return (status.st_mtime_ns, status.st_size)


def series_in_words(task: TaskSpec) -> list[str]:
    """Of each series of prices: the dates that it covers, and its mean, lowest and highest price."""
    return [f"Price '{name}': {table.in_words()}." for name, table in task.price_tables.items() if table.series]


def _is_shipped(path: Path) -> bool:
    return path.parent == lock_path().parent.resolve()


def check_against_lock(task: TaskSpec, entry: LockEntry) -> None:
    """Refuse ``task`` if it is not the one that ``entry`` locks, and say what differs.

    Raises ``TaskError`` with what differs (the file, the model, parameters, weather, start, observed columns) and what to do.
    """
    check_file_against_lock(task, entry)
    here, locked = task.fingerprint(), entry.fingerprint
    if here.digest == locked.digest:
        return
    parts = {
        "model": f"the model is another one, locked version {locked.model_version}, here version {here.model_version}",
        "parameters": f"the parameter set '{task.model.parameters}' has other values",
        "weather": f"the weather '{task.weather.source}' has other values, or is prepared in another way",
        "start": f"the start '{task.initial.kind}' is another one",
        "observation": "the observed columns have other names, units or bounds",
    }
    digests = {part: (getattr(locked, part), getattr(here, part)) for part in parts}
    reasons = [f"{parts[part]} ({_change(*pair)})" for part, pair in digests.items() if pair[0] != pair[1]]
    if not reasons:
        msg = (
            f"{LOCK_WORDS} contradicts itself about {task.id}: its parts are as locked, the digest over them is not "
            f"({_change(locked.digest, here.digest)}). The entry was edited: restore the file, or install glbench again."
        )
        raise TaskError(msg)
    msg = (
        f"{task.source} is as it was published, but {'; '.join(reasons)}. Results would not be comparable with published "
        "ones: install the glbench version that the task was locked with, or, if the change is meant, publish new "
        "versions of the tasks and run `glbench tasks lock`."
    )
    raise TaskError(msg)


def check_file_against_lock(task: TaskSpec, entry: LockEntry) -> None:
    """As ``check_against_lock``, for the definition alone; needs neither model nor weather."""
    here, locked = canonical_sha256(task.definition()), entry.fingerprint.definition
    if here != locked:
        msg = (
            f"{task.source} no longer matches {LOCK_WORDS} ({_change(locked, here)}).\n"
            "Published tasks never change: restore the file, or add your change as a new version and run "
            "`glbench tasks lock`."
        )
        raise TaskError(msg)


def _change(locked: str, here: str) -> str:
    return f"locked {locked[:8]}..., found {here[:8]}..."
