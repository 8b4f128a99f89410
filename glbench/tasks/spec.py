"""A task: what its file says, and what follows from that: model, parameters, weather, start, observed columns, ledger, digest.

What a file says is pure data (``glbench.tasks.tables.TaskFile2``), read without the model and the weather. ``TaskRecord`` has it in one
of its splits, ``ResolvedTask`` what follows from it, ``glbench.tasks.digest`` its digest (docs/adr/0015, 0029).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property, lru_cache
from typing import Any, Self

from glbench.tasks.digest import Fingerprint, definition_of, fingerprint_of, read_lock
from glbench.tasks.inheritance import TaskTables
from glbench.tasks.ledger import LIMITED
from glbench.tasks.resolver import ResolvedTask
from glbench.tasks.serialisation import changed_tables, file_of, file_of_attachment, record_of, with_dates
from glbench.untrusted import html_of


class TaskSpec(ResolvedTask):
    """A task as ``get_task`` returns it: the tables of its file, and what follows from them.

    The tables of the file are attributes of the same name; ``[initial_state]`` is ``initial`` and ``schema`` is ``schema_version``. Numbers
    written with a unit in the file are plain floats in that unit here. What follows from them is computed on demand and remembered.
    Equal files make equal tasks. Files of schema 1 have the tables of schema 2 as well, except a ledger: ``prices`` has their prices.
    """

    @classmethod
    def model_validate(cls, content: Mapping[str, Any]) -> Self:
        """The task that the tables ``content`` define, as TOML gives them. Raises ``pydantic.ValidationError`` when they define none."""
        return cls(file_of(content))

    @classmethod
    def of_file(cls, tables: TaskTables, source: str) -> Self:
        """The task of the tables of a file that messages call ``source``. Raises ``TaskError`` with every mistake of them."""
        return cls(record_of(tables, source), source, tables.base, tables.changes)

    @classmethod
    def from_tables(cls, plain: Mapping[str, Any]) -> Self:
        """The task of which ``as_tables`` gave ``plain``.

        Raises ``pydantic.ValidationError`` or ``ValueError`` or ``KeyError`` or ``TypeError`` when it defines none.
        """
        return cls.model_validate(with_dates(plain))

    def attachment(self) -> dict[str, Any]:
        """The tables as plain JSON values, as records of runs have them: what ``of_attachment`` reads. Errors as for ``as_tables``."""
        return self.file.attachment(self.source)

    @classmethod
    def of_attachment(cls, plain: Mapping[str, Any]) -> Self:
        """The task of which ``attachment`` gave ``plain``.

        Raises ``pydantic.ValidationError`` or ``KeyError`` or ``TypeError`` or ``ValueError`` or ``AttributeError`` when it defines none.
        """
        return cls(file_of_attachment(plain))

    def replace(self, changes: Mapping[str, Any] | None = None, /, **tables: Any) -> TaskSpec:
        """The task with ``changes``, as a task file makes it that names this task as its base.

        ``task.replace({"weather.days": 30, "prices.heat.value": 0.12})`` and ``task.replace(weather={"days": 30})`` name keys as a file
        does, with dots or table in table, and both may be used. Changes replace the task's values, key by key; ``None`` leaves
        a table or a key out. Quantities are written as in a file: ``{"value": 0.12, "unit": "EUR kWh-1"}``. Days and moments may be
        text (``"2011-03-01"``).

        ``id`` and ``title`` are keys like others. Without an id it is called ``my/`` and its short id. The split stays, if there is one.

        Raises ``TaskError`` when the result is not a task; it names table, key and value. Also when the id is that of a shipped task.
        """
        base = self.file.content(self.source)
        task = _changed_task(*changed_tables(base, self.id, {} if changes is None else changes, tables))
        names = task.splits.names if task.splits is not None else ()
        return task if self.split is None or self.split not in names else task.in_split(self.split, self.sealed)

    def definition(self) -> dict[str, Any]:
        """What the file says without prose, as plain JSON values: the part of the digest that comes from the file."""
        return definition_of(self)

    def fingerprint(self) -> Fingerprint:
        """The digest and the parts it is made of (``glbench.tasks.digest``), remembered; needs the model and the weather.

        It does not cover the code that computes a step from these: draws, accounts, reward, and for schema 1 the weather between the
        hours. What that code gives for the published tasks is in ``tasks/behaviour.toml`` (``glbench.env.behaviour``).

        Raises ``TaskError`` when the task asks for what does not exist.
        """
        return self._fingerprint

    @cached_property
    def _fingerprint(self) -> Fingerprint:
        return fingerprint_of(self)

    @property
    def digest(self) -> str:
        """SHA-256 [hex] over definition, parameters, start, observed columns, weather and model; see docs/task-digests.md."""
        return self.fingerprint().digest

    @property
    def locked(self) -> bool:
        """Whether this task is published: tasks/lock.toml has its id with this digest."""
        entry = read_lock().get(self.id)
        return entry is not None and entry.digest == self.digest

    def _repr_html_(self) -> str:
        """What a notebook shows: the task in short, and its limits."""
        weather, days = self.weather, self.steps / self.steps_per_day
        split = f", split {self.split}" if self.split else ""
        where = f"{weather.source}, from {weather.start:%d %B}" + ("" if self.splits else f" {weather.start.year}")
        facts: list[tuple[str, object]] = [
            ("task", f"{self.id}{split}"),
            ("weather", f"{where}, {days:g} days"),
            ("a step", f"{self.step_seconds / 60:g} min, {self.steps} steps"),
            ("model", self.model_id),
            ("observed", f"{sum(1 for _ in self.observed())} columns: {', '.join(self.observation.modules)}"),
            ("actions", f"{self.actuation.kind}: {', '.join(action.name for action in self.actions)}"),
            ("earned", ", ".join(item.name for item in self.ledger.earned)),
            ("paid", ", ".join(item.name for item in self.ledger.paid)),
            ("runs", len(self.evaluation.seeds)),
        ]
        limits = [(name, LIMITED[name], one.low, one.high) for name, one in self.constraints.items()]
        return html_of(self.title, facts, ("limits", "unit", "low", "high"), limits)


@lru_cache(maxsize=64)
def _changed_task(tables: TaskTables, source: str) -> TaskSpec:
    """The task of changed tables. Whatever cannot be resolved is reported now and not in the middle of a run."""
    task = TaskSpec.of_file(tables, source)
    task.fingerprint()
    return task
