"""The record of a task: the tables of its file, in one of its splits. It needs neither model nor weather."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import FrozenInstanceError
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar, Self

from glbench.errors import GlbenchError, TaskError, did_you_mean, refuse
from glbench.registration import task_ids
from glbench.tasks import tables
from glbench.tasks.inheritance import Change, read_tables, shown_path
from glbench.tasks.prices import PriceTable
from glbench.tasks.schedule import ScheduleEntry
from glbench.tasks.sealed import commitment_of
from glbench.tasks.serialisation import record_of

PREVIEW = "preview"
"""Split of a task that has only a test split: seasons for trying things out, none of them scored."""

FIRST_TRAINING_SEED = 10_000_000_000
"""Seeds from here on are for training. No task can be scored with them: a task's seeds end below 2**32 + 10,000."""

_OF_ALL_SPLITS = frozenset(
    {"model_value", "_parameters", "_initial_state", "preview", "price_tables", "ledger", "quantities", "_fingerprint", "_hash"}
)


class TaskRecord:
    """The tables of a task's file, and the split that the task is in. Equal files make equal records."""

    schema_version: int
    id: str
    title: str
    description: str
    suites: tuple[str, ...]
    weather: tables.WeatherTable
    model: tables.ModelTable
    initial: tables.InitialStateTable
    observation: tables.ObservationTable
    actuation: tables.ActuationTable
    constraints: tables.ConstraintsTable
    schedule: tuple[ScheduleEntry, ...]
    splits: tables.SplitsTable | None
    """The years of training, validation and test; ``None`` where all runs share their seasons."""
    sensors: tables.SensorsTable | None
    """Sensors with errors; ``None`` if the air is observed without errors."""
    outdoor_sensors: tables.OutdoorSensorsTable | None
    """Sensors of the weather with errors; ``None`` if it is observed without errors."""
    actuators: dict[str, tables.ActuatorTable]
    """By control, the actuators that do not follow their commands exactly."""
    samples: dict[str, tables.SampleTable]
    """By observation module, what is counted or weighed by hand."""
    camera: tables.CameraTable | None
    """The camera that takes pictures of the crop; ``None`` without one."""
    reward: tables.RewardTable
    evaluation: tables.EvaluationTable

    file: tables.TaskFile2
    """The tables of the file, as pure data."""
    source: str
    """The file that the task was read from, as shown in error messages."""
    base: str | None
    """The task that its file names as its base: an id or a file; ``None`` if the file has no base."""
    changes: tuple[Change, ...]
    """The changes that its file makes to the base."""
    split: str | None
    """Which scenarios its runs are drawn from: "training" at first, "validation" or "test"; ``None`` for a task without splits.

    A task with only a test split starts in its test split; its environments are in "preview".
    """
    sealed: str
    """The secret part of the salt; the host of a round publishes its digest first. "" in the public test."""

    _FORWARDED: ClassVar = frozenset(tables.TaskFile2.model_fields) - {"ledger", "price_tables", "scenario"}

    def __init__(
        self,
        file: tables.TaskFile2,
        source: str = "the task",
        base: str | None = None,
        changes: tuple[Change, ...] = (),
        split: str | None = None,
        sealed: str = "",
    ) -> None:
        vars(self).update({name: getattr(file, name) for name in self._FORWARDED})
        if split is None and file.splits is not None:
            split = file.splits.names[0]
        vars(self).update(file=file, source=source, base=base, changes=changes, split=split, sealed=sealed)

    @property
    def conventions(self) -> tables.Conventions:
        """What the schema of the file fixes outside its tables."""
        return self.file.conventions

    def in_split(self, split: str, sealed: str = "") -> Self:
        """The same task with the scenarios of ``split``: "training", "validation" or "test"; the digest and everything else stay the same.

        A task with only a test split also has "preview": seasons that are not scored. They are generated from the
        training years of its base if both have the same weather record, otherwise from the test's years with other
        draws. Scored real years have no preview.

        ``sealed`` is the secret of a round (``glbench.tasks.sealed.Round.secret``), for the test only.

        Raises ``TaskError`` when the task has no such split, or a secret salt is given for a split other than the test.
        """
        names = self.splits.names if self.splits is not None else ()
        if split not in names and not (split == PREVIEW and self.preview is not None):
            has = f"It has {', '.join(names)}." if names else "All its runs share their seasons."
            refuse(f"{self.id} has no split '{split}'.{did_you_mean(split, names, list_few=False)} {has}", TaskError)
        if sealed and split != "test":
            refuse(f"A secret salt belongs to the test; {self.id} was asked for its split '{split}'.", TaskError)
        if (split, sealed) == (self.split, self.sealed):
            return self
        other = type(self)(self.file, self.source, self.base, self.changes, split, sealed)
        # What was derived already and is the same in every split.
        vars(other).update({name: value for name, value in vars(self).items() if name in _OF_ALL_SPLITS})
        return other

    @property
    def season_years(self) -> tuple[int, ...] | None:
        """Years that the seasons of the split are from; ``None`` for a task without splits."""
        table = self.split_table
        return None if table is None else table.years

    @property
    def split_table(self) -> tables.SplitTable | None:
        """Years and number of seasons of the split that the task is in."""
        if self.split == PREVIEW:
            return self.preview
        return getattr(self.splits, self.split) if self.split is not None else None

    @cached_property
    def preview(self) -> tables.SplitTable | None:
        """Years and number of seasons of the preview; ``None`` if there is a training split, or only scored real years."""
        if self.splits is None or self.splits.training is not None:
            return None
        test, path = self.splits.test, task_ids().get(self.base or "")
        base = None if path is None else record_of(read_tables(path), shown_path(path))
        training = base.splits.training if base is not None and base.splits is not None else None
        if base is not None and training is not None and base.weather.source == self.weather.source:
            return training if test.seasons is not None else tables.SplitTable(years=training.years)
        return test if test.seasons is not None else None

    @property
    def salt_commitment(self) -> str | None:
        """SHA-256 [hex] of the secret of the round, which its host publishes first; ``None`` with public draws."""
        return commitment_of(self.sealed) if self.sealed else None

    @property
    def scored(self) -> Self:
        """The task with the scenarios of its test split; the task itself if it has no splits or is in its validation split."""
        return self if self.splits is None or self.split == "validation" else self.in_split("test", self.sealed)

    def scored_in(self, split: str | None) -> Self:
        """The task with the scenarios of a result that names ``split``; ``None`` if a result names none."""
        return self.scored if split is None else self.in_split(split, self.sealed if split == "test" else "")

    @property
    def chosen_on(self) -> Self:
        """The task with the scenarios for choosing between agents: its validation split, or the task itself if it has none."""
        return self.in_split("validation") if self.splits is not None and self.splits.validation else self

    def check_training(self) -> None:
        """Raises ``TaskError``, with the task to train on, when this one has only a test split, in which no agent can train."""
        if self.splits is not None and self.splits.training is None:
            instead = f"on {self.base}, its base," if self.base is not None else "on another task"
            msg = (
                f"{self.id} has no training split: it scores agents that were trained elsewhere. Train {instead} or name the "
                'split that there is: split="test".'
            )
            raise TaskError(msg)

    @property
    def short_id(self) -> str:
        """The id without its namespace, such as ``Schiphol2010-Delta10-v1``."""
        return self.id.partition("/")[2]

    @property
    def steps(self) -> int:
        """Number of control steps of an episode."""
        return self.weather.steps

    @property
    def step_seconds(self) -> float:
        """Length of a control step [s]."""
        return float(self.weather.step_seconds)

    @property
    def steps_per_day(self) -> int:
        """Number of control steps of a day."""
        return 86400 // self.weather.step_seconds

    @property
    def model_id(self) -> str:
        """Name and version of the model."""
        return self.model.id

    @property
    def prices(self) -> tables.PricesTable:
        """The prices of a task of schema 1. Raises ``TaskError`` for a task of schema 2, which has a ledger."""
        if self.file.prices is None:
            refuse(f"{self.source} has no table [prices]: its prices are those of its ledger (task.ledger).", TaskError)
        return self.file.prices

    @cached_property
    def uncertainty(self) -> tables.UncertaintyTable:
        """Which parameters are redrawn; for a task of schema 2, the widest group of its scenario."""
        return self.file.uncertainty

    @cached_property
    def price_tables(self) -> Mapping[str, PriceTable]:
        """Prices that change with the calendar, by name."""
        by_name = self.file.price_tables
        return MappingProxyType({name: table.value(by_name) for name, table in by_name.items()})

    @property
    def judges_means(self) -> bool:
        """Whether violations are means over the step; otherwise they are the values at its end."""
        return self.constraints.judged == "mean" and bool(self.constraints.items())

    @cached_property
    def violation_prices(self) -> Mapping[str, float]:
        """Price of violations by constraint, in ``VIOLATION_PRICES``; empty if the task has penalty scales.

        It is that of values too high where those too low have another (``lower_prices``).
        """
        prices = self.reward.violation_price.items()
        return MappingProxyType({name: price[1] if isinstance(price, tuple) else price for name, price in prices})

    @cached_property
    def lower_prices(self) -> Mapping[str, float]:
        """Price of values too low, where it differs from that of values too high."""
        return MappingProxyType({name: price[0] for name, price in self.reward.violation_price.items() if isinstance(price, tuple)})

    @property
    def scores_money(self) -> bool:
        """Whether the reward is money [EUR m-2]: profit minus what violations cost."""
        return bool(self.violation_prices) and {*self.reward.modules} == {"epi", "scaled_penalty"}

    @cached_property
    def penalty_scales(self) -> Mapping[str, float]:
        """Violation that adds 1 to the penalty of a step, by constraint: 1 EUR m-2 if violations have prices.

        It is that of values too high where those too low have another price (``lower_prices``).
        """
        hours = self.step_seconds / 3600.0
        prices = {name: 1.0 / (price * hours) for name, price in self.violation_prices.items()}
        return MappingProxyType({**dict(self.reward.penalty_scale.items()), **prices})

    @property
    def on_off(self) -> Mapping[str, tables.OnOffTable]:
        """Controls that are off or run between a lowest load and 1, in the order of the task's controls."""
        table = self.actuation
        return {name: table.on_off[name] for name in table.controls if name in table.on_off}

    @property
    def day_ahead(self) -> tables.DayAheadTable | None:
        """The prices that are shown for the coming hours; ``None`` if there are none."""
        return self.observation.day_ahead

    def model_copy(self, update: Mapping[str, Any]) -> Self:
        """A copy with other tables, which are not checked; it can be run, but not recorded. ``replace`` checks."""
        return type(self)(self.file.with_tables(update), self.source, self.base, self.changes, self.split, self.sealed)

    def as_tables(self) -> dict[str, Any]:
        """The tables of the task in the form of its file, dates as text: the input of ``from_tables``.

        Raises ``TaskError`` when there is no such file: a copy of schema 2 that was changed without a check.
        """
        return tables.as_json(self.file.content(self.source))

    def model_dump(self, **options: Any) -> dict[str, Any]:
        """The content of the file as plain values, as ``pydantic.BaseModel.model_dump`` gives them."""
        return self.file.plain(**options)

    @contextmanager
    def errors_in(self, table: str) -> Iterator[None]:
        """Name the task's file and ``table`` in all errors raised inside."""
        try:
            yield
        except TaskError:
            raise
        except GlbenchError as error:
            refuse(f"{self.source}: [{table}] {error}", TaskError, error)

    @cached_property
    def _hash(self) -> int:
        return hash(repr(self.file.plain()))

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        return self is other or (
            isinstance(other, TaskRecord) and (self.file, self.split, self.sealed) == (other.file, other.split, other.sealed)
        )

    def __setattr__(self, name: str, value: object) -> None:
        refuse(f"A task is frozen: make another one with model_copy(update={{'{name}': ...}}).", FrozenInstanceError)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.file, self.source, self.base, self.changes, self.split, self.sealed)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.id}>"
