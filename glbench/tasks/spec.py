"""A task: what its file says, and what follows from that: model, parameters, weather, start, observed columns, ledger, digest.

What a file says is pure data (``glbench.tasks.tables.TaskFile``), read without the model and the weather. A :class:`TaskSpec` holds
it and derives the rest when asked (docs/adr/0015). Errors of the model and the weather name the task's file and the table that
caused them.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import FrozenInstanceError
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from glbench.canonical import canonical_sha256
from glbench.errors import GlbenchError, ParameterError, TaskError, UnknownNameError, WeatherError, did_you_mean
from glbench.quantities import MONEY
from glbench.registration import task_ids
from glbench.showing import html_of
from glbench.tasks.inheritance import Change, TaskTables, read_tables, shown_path
from glbench.tasks.ledger import FLOW, LIMITED, STOCK, Beyond, Ledger, LedgerItem, StepQuantity, step_quantities
from glbench.tasks.lock import Fingerprint, read_lock
from glbench.tasks.prices import PriceTable
from glbench.tasks.quantities import PAPER_MODEL, Capacity, ObservationContext, Quantity, capacities, of_model
from glbench.tasks.scenario import Generated, ParameterGroup, Scenario, Season, StartGroup
from glbench.tasks.schema1 import paper_v1
from glbench.tasks.sealed import commitment_of, weather_of
from glbench.tasks.serialisation import changed_tables, file_of, record_of, tables_of, with_dates
from glbench.tasks.tables import (
    PROCESS_COMPUTER,
    ActuationTable,
    AnyActuationTable,
    AnyObservationTable,
    BeyondTable,
    DayAheadTable,
    EvaluationTable,
    InitialStateTable,
    ItemTable,
    ModelTable,
    ObservationTable,
    OfTheAir,
    OnOffTable,
    PricesTable,
    RewardTable,
    SensorsTable,
    SplitsTable,
    SplitTable,
    TaskFile1,
    TaskFile2,
    UncertaintyTable,
    WeatherTable,
)
from glbench.tasks.vocabulary import ACTUATION_KINDS, INITIAL_STATES, OBSERVATION_MODULES

if TYPE_CHECKING:
    from glbench.model import Model
    from glbench.tasks.actions import Action
    from glbench.weather import Disturbances, WeatherRecord

FloatArray = npt.NDArray[np.float64]

PROSE = frozenset({"title", "description", "suites"})
"""Fields that explain or file a task and do not change it: they stay out of its digest."""
PREVIEW = "preview"
"""Split of a task that has only a test split: seasons to look at, none of them scored."""
DIGITS = 9
"""Significant digits, in a digest, of numbers that are computed rather than read."""

SCHEMA_1: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "schema": (),
        "id": (),
        "weather": ("source", "preprocessing", "start", "days", "step_seconds", "co2_ppm"),
        "model": ("variant", "parameters", "overrides"),
        "initial_state": ("kind", "air_temperature"),
        "uncertainty": ("distribution", "delta", "half_width_factor", "parameters", "redraw"),
        "observation": ("modules", "timing", "forecast"),
        "actuation": ("kind", "max_change", "controls"),
        "constraints": ("air_temperature", "co2", "relative_humidity"),
        "prices": ("fruit", "dry_matter_content", "co2", "heat", "electricity"),
        "reward": ("modules", "penalty_scale"),
        "evaluation": ("first_seed", "runs", "metric", "failed_step"),
    }
)
"""The keys that the digest of a task of schema 1 covers, whatever is added later; ``evaluation.time_limits`` where it is given."""

_EVEN = 0.6180339887498949
"""Multiples of it, modulo 1, are spread evenly."""
_OF_ALL_SPLITS = frozenset(
    {
        "model_value",
        "_parameters",
        "_initial_state",
        "preview",
        "price_tables",
        "ledger",
        "quantities",
        "_fingerprint",
        "_hash",
    }
)
_GRID = 6180.339887498949  # weather rows enter a digest in steps of 1/6180: no round number lies halfway between two of them


class TaskSpec:
    """A task as ``get_task`` returns it: what its file says, and what follows from it.

    The tables of the file are attributes of the same name; ``[initial_state]`` is ``initial`` and ``schema`` is ``schema_version``. Numbers
    written with a unit in the file are plain floats in that unit here. What follows from them is computed on demand and remembered.
    Equal files make equal tasks.
    """

    schema_version: int
    id: str
    title: str
    description: str
    suites: tuple[str, ...]
    weather: WeatherTable
    model: ModelTable
    initial: InitialStateTable
    observation: ObservationTable
    actuation: ActuationTable
    constraints: OfTheAir
    reward: RewardTable
    evaluation: EvaluationTable

    file: TaskFile1 | TaskFile2
    """What the file says, as pure data."""
    source: str
    """The file the task was read from, as error messages name it."""
    base: str | None
    """The task that its file names as its base: an id or a file; ``None`` where the file is written out."""
    changes: tuple[Change, ...]
    """What its file changes in the base."""
    split: str | None
    """Which scenarios its runs are drawn from: "training" at first, "validation" or "test"; ``None`` for a task without splits.

    A task with only a test split begins in its test; its environments are in "preview".
    """
    sealed: str
    """The secret part of the salt, of which a host of a round publishes the digest first; "" in the public test."""

    _FORWARDED: ClassVar = frozenset(TaskFile1.model_fields) & frozenset(TaskFile2.model_fields)

    def __init__(
        self,
        file: TaskFile1 | TaskFile2,
        source: str = "the task",
        base: str | None = None,
        changes: tuple[Change, ...] = (),
        split: str | None = None,
        sealed: str = "",
    ) -> None:
        vars(self).update({name: getattr(file, name) for name in self._FORWARDED})
        splits = file.splits if isinstance(file, TaskFile2) else None
        if split is None and splits is not None:
            split = splits.names[0]
        vars(self).update(file=file, source=source, base=base, changes=changes, split=split, sealed=sealed)

    @classmethod
    def model_validate(cls, content: Mapping[str, Any]) -> Self:
        """The task that the tables ``content`` define, as TOML gives them.

        Raises
        ------
        pydantic.ValidationError
            When they define none.
        """
        return cls(file_of(content))

    @classmethod
    def of_tables(cls, tables: TaskTables, source: str) -> Self:
        """The task of the tables of a file that messages call ``source``.

        Raises
        ------
        TaskError
            When they define no task; it lists every mistake.
        """
        return cls(record_of(tables, source), source, tables.base, tables.changes)

    def replace(self, changes: Mapping[str, Any] | None = None, /, **tables: Any) -> TaskSpec:
        """The task with ``changes``: what a task file means that names this task as its base and says what differs.

        ``task.replace({"weather.days": 30, "prices.heat.value": 0.12})`` and ``task.replace(weather={"days": 30})`` name keys as a file
        does, with dots or table in table, and both may be given. What is given replaces what the task says, key by key; ``None`` leaves
        a table or a key out. Quantities are written as in a file: ``{"value": 0.12, "unit": "EUR kWh-1"}``. Days and moments may be
        text (``"2011-03-01"``).

        ``id`` and ``title`` are keys like others. Without an id the task is called ``my/`` and its short id. The split stays, if the
        new task has it.

        Raises
        ------
        TaskError
            When the result is not a task; it names table, key and value. When the id is that of a shipped task.
        """
        base = tables_of(self.file, self.source)
        task = _changed_task(*changed_tables(base, self.id, {} if changes is None else changes, tables))
        known = task.splits.names if task.splits is not None else ()
        return task if self.split is None or self.split not in known else task.in_split(self.split, self.sealed)

    def model_copy(self, update: Mapping[str, Any]) -> TaskSpec:
        """A copy with other tables, which are not checked; it can be run, but not recorded. ``replace`` checks."""
        file = self.file.model_copy(update=dict(update))
        if isinstance(file, TaskFile2):
            file._written = None
        return TaskSpec(file, self.source, self.base, self.changes, self.split, self.sealed)

    @property
    def splits(self) -> SplitsTable | None:
        """The years of training, validation and test; ``None`` where all runs share their seasons."""
        return self.file.splits if isinstance(self.file, TaskFile2) else None

    @property
    def sensors(self) -> SensorsTable | None:
        """Sensors that err; ``None`` where the air is observed as it is."""
        return self.file.sensors if isinstance(self.file, TaskFile2) else None

    def in_split(self, split: str, sealed: str = "") -> TaskSpec:
        """The same task with the scenarios of ``split``: "training", "validation" or "test"; digest and all else stay.

        A task with only a test split also has "preview": seasons that are not scored. They are made of the training years of its base if
        both have the same weather record, else of the test's years with other draws. Scored real years have no preview.

        ``sealed`` is the secret of a round (``glbench.tasks.sealed.Round.secret``), for the test only.

        Raises
        ------
        TaskError
            When the task has no such split, or a secret salt is given for another split than the test.
        """
        known = self.splits.names if self.splits is not None else ()
        if split not in known and not (split == PREVIEW and self.preview is not None):
            has = f"It has {', '.join(known)}." if known else "All its runs share their seasons."
            msg = f"{self.id} has no split '{split}'.{did_you_mean(split, known)} {has}"
            raise TaskError(msg)
        if sealed and split != "test":
            msg = f"A secret salt belongs to the test; {self.id} was asked for its split '{split}'."
            raise TaskError(msg)
        if (split, sealed) == (self.split, self.sealed):
            return self
        other = TaskSpec(self.file, self.source, self.base, self.changes, split, sealed)
        # What was derived already and is the same in every split.
        vars(other).update({name: value for name, value in vars(self).items() if name in _OF_ALL_SPLITS})
        return other

    @property
    def season_years(self) -> tuple[int, ...] | None:
        """Years that the seasons of the split are from; ``None`` for a task without splits."""
        table = self._split_table
        return None if table is None else table.years

    @property
    def _split_table(self) -> SplitTable | None:
        """Years and number of seasons of the split that the task is in."""
        if self.split == PREVIEW:
            return self.preview
        return getattr(self.splits, self.split) if self.split is not None else None

    @cached_property
    def preview(self) -> SplitTable | None:
        """Years and number of seasons of the preview; ``None`` if there is a training split, or only scored real years."""
        if self.splits is None or self.splits.training is not None:
            return None
        test, path = self.splits.test, task_ids().get(self.base or "")
        base = None if path is None else TaskSpec.of_tables(read_tables(path), shown_path(path))
        training = base.splits.training if base is not None and base.splits is not None else None
        if base is not None and training is not None and base.weather.source == self.weather.source:
            return training if test.seasons is not None else SplitTable(years=training.years)
        return test if test.seasons is not None else None

    @property
    def salt_commitment(self) -> str | None:
        """SHA-256 [hex] of the secret of the round, which its host publishes first; ``None`` with public draws."""
        return commitment_of(self.sealed) if self.sealed else None

    @property
    def scored(self) -> TaskSpec:
        """The task with the scenarios of its test split; itself without splits, or when it is in its validation split."""
        return self if self.splits is None or self.split == "validation" else self.in_split("test", self.sealed)

    def scored_in(self, split: str | None) -> TaskSpec:
        """The task with the scenarios of a result that names ``split``; ``None`` where a result names none."""
        return self.scored if split is None else self.in_split(split, self.sealed if split == "test" else "")

    def check_training(self) -> None:
        """Refuse a task that has a test alone: nothing can be learned in it.

        Raises
        ------
        TaskError
            That names the task to train on.
        """
        if self.splits is not None and self.splits.training is None:
            instead = f"on {self.base}, its base," if self.base is not None else "on another task"
            msg = (
                f"{self.id} has no training split: it scores agents that were trained elsewhere. Train {instead} or name the "
                'split that there is: split="test".'
            )
            raise TaskError(msg)

    @property
    def chosen_on(self) -> TaskSpec:
        """The task with the scenarios that one chooses between agents by: its validation split, or itself where it has none."""
        return self.in_split("validation") if self.splits is not None and self.splits.validation else self

    def written(self) -> dict[str, Any]:
        """The tables of the task as its file writes them, dates as text: what ``of_written`` reads.

        Raises
        ------
        TaskError
            When there is no such file: a copy of schema 2 that was changed without a check.
        """
        content = tables_of(self.file, self.source)
        plain: dict[str, Any] = json.loads(json.dumps(content, default=lambda moment: moment.isoformat()))
        return plain

    @classmethod
    def of_written(cls, plain: Mapping[str, Any]) -> Self:
        """The task of which ``written`` gave ``plain``.

        Raises
        ------
        pydantic.ValidationError, ValueError, KeyError, TypeError
            When it defines none.
        """
        return cls.model_validate(with_dates(plain))

    def model_dump(self, **options: Any) -> dict[str, Any]:
        """What the file says as plain values, as ``pydantic.BaseModel.model_dump`` gives them."""
        return self.file.model_dump(**options)

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
    def prices(self) -> PricesTable:
        """The prices of a task of schema 1.

        Raises
        ------
        TaskError
            For a task of schema 2, which has a ledger.
        """
        if isinstance(self.file, TaskFile1):
            return self.file.prices
        msg = f"{self.source} has no table [prices]: its prices are those of its ledger (task.ledger)."
        raise TaskError(msg)

    @cached_property
    def uncertainty(self) -> UncertaintyTable:
        """Which parameters are redrawn; of a task of schema 2, the widest group of its scenario."""
        if isinstance(self.file, TaskFile1):
            return self.file.uncertainty
        groups = sorted(self.file.scenario.parameters, key=lambda group: group.half_width)
        if not groups:
            return UncertaintyTable.model_construct(
                distribution="uniform", delta=0.0, half_width_factor=1.0, parameters=(), redraw="episode"
            )
        widest = groups[-1]
        return UncertaintyTable.model_construct(
            distribution=widest.distribution, delta=widest.half_width, half_width_factor=1.0, parameters=widest.parameters,
            redraw=widest.redraw,
        )  # fmt: skip

    # The model and what it says.

    @property
    def model_id(self) -> str:
        """Name and version of the model."""
        return self.file.model.id if isinstance(self.file, TaskFile2) else PAPER_MODEL

    @cached_property
    def model_value(self) -> Model:
        """The model.

        Raises
        ------
        TaskError
            When there is none of that id and variant.
        """
        from glbench.model import get_model  # not at the top: task files are read without the model

        with self._asked_by("model"):
            model = get_model(self.model_id, self.model.variant)
        if not self.judges_means:
            return model
        from glbench.model import with_violation_meters

        with self._asked_by("constraints"):
            return with_violation_meters(model)

    @property
    def judges_means(self) -> bool:
        """Whether violations are means over the step; else what they are at its end."""
        return getattr(self.constraints, "judged", "end") == "mean" and bool(self.constraints.items())

    @cached_property
    def violation_prices(self) -> Mapping[str, float]:
        """What violations cost, by constraint, in ``VIOLATION_PRICES``; empty where the task has penalty scales."""
        table = getattr(self.reward, "violation_price", None)
        return MappingProxyType({} if table is None else dict(table.items()))

    @property
    def scores_money(self) -> bool:
        """Whether the reward is money [EUR m-2]: profit minus what violations cost."""
        return bool(self.violation_prices) and {*self.reward.modules} == {"epi", "scaled_penalty"}

    @cached_property
    def penalty_scales(self) -> Mapping[str, float]:
        """Violation that adds 1 to the penalty of a step, by constraint: 1 EUR m-2 where violations have prices."""
        hours = self.step_seconds / 3600.0
        prices = {name: 1.0 / (price * hours) for name, price in self.violation_prices.items()}
        return MappingProxyType({**dict(self.reward.penalty_scale.items()), **prices})

    def parameters(self) -> FloatArray:
        """Nominal parameters, read-only, in the model's order and units, overrides applied and derived ones recomputed.

        Where violations are means over the step, the limits are among them.

        Raises
        ------
        TaskError
            When the set or an overridden parameter is unknown, or a value is impossible; it names file and table.
        """
        return self._parameters

    @cached_property
    def _parameters(self) -> FloatArray:
        with self._asked_by("model"):
            overrides: dict[str, Any] = {name: (value, unit) for name, value, unit in self.model.overrides}
            limits = self._limits()
            for name in limits.keys() & overrides.keys():
                msg = f"'{name}' is a limit of the task: state it in [constraints]."
                raise ParameterError(msg)
            return _read_only(self.model_value.parameters.default(self.model.parameters, overrides | limits))

    def _limits(self) -> dict[str, float]:
        """The limits as parameters of a model that judges by them."""
        if not self.judges_means:
            return {}
        from glbench.model import SIDES, limit_parameter

        return {
            limit_parameter(name, side): getattr(limits, side)
            for name, limits in self.constraints.items()
            for side in SIDES
        }

    def parameters_by_name(self) -> dict[str, float]:
        """``parameters()`` as a dictionary."""
        return dict(zip(self.model_value.parameter_names, self.parameters().tolist(), strict=True))

    def uncertain_parameters(self) -> tuple[str, ...]:
        """Names of the parameters that are redrawn, in the model's order for a set, else as listed, group after group."""
        return tuple(dict.fromkeys(name for group in self.scenario.groups for name in group.parameters))

    def _drawn(self, wanted: str | tuple[str, ...], table: str) -> tuple[str, ...]:
        values = self.model_value.parameters
        with self._asked_by(table):
            if isinstance(wanted, str):
                return values.drawn_set(wanted)
            for name in wanted:
                if name not in values.names:
                    msg = f"There is no parameter called '{name}'.{did_you_mean(name, values.names)}"
                    raise UnknownNameError(msg)
                info = values.info(name)
                if info.is_derived:
                    msg = f"'{name}' follows from other parameters ({name} = {info.formula}): list those instead."
                    raise ParameterError(msg)
        return wanted

    def initial_state(self) -> FloatArray:
        """Nominal state at the start, read-only, in the model's units."""
        return self._initial_state

    @cached_property
    def _initial_state(self) -> FloatArray:
        return _read_only(self.start_state(self.disturbances().values[0]))

    def check_start(self) -> None:
        """Evaluate the nominal state at the start and the rates there once.

        Raises
        ------
        TaskError
            When one is not finite; it names file, table, state and value.
        """
        state = self.initial_state()
        with self._asked_by("initial_state"):
            self.model_value.check_rates(state, self.disturbances().values[0], self.parameters())

    def start_state(self, first: FloatArray) -> FloatArray:
        """State at the start of an episode whose first row of weather is ``first`` ``(disturbances,)``, before any factors."""
        kind, air_temperature = self.initial.kind, self.initial.air_temperature
        with self._asked_by("initial_state"):
            own = INITIAL_STATES[kind].state if kind in INITIAL_STATES else None
            if own is not None:
                return own(first, air_temperature, self.parameters())
            return self.model_value.start(kind, first, air_temperature, self.parameters())

    def capacities(self) -> tuple[Capacity, ...]:
        """What each control of the model delivers at 1, with its unit."""
        return capacities(self.model_value, self.parameters_by_name())

    # The weather.

    def record(self) -> WeatherRecord:
        """The weather record that the task uses."""
        with self._asked_by("weather"):
            return _record(self.weather.source)

    def season_record(self) -> WeatherRecord:
        """The weather record of the split's seasons: the task's, or the round's own, of which agents learn nothing.

        Raises
        ------
        TaskError
            When there is no such record, or the clock of the round's own is another than the task's.
        """
        record = self.record()
        with self._asked_by("weather"):
            sealed = weather_of(self.sealed)
            if sealed is None:
                return record
            own = _record_of(sealed.digest)
        if own.timezone != record.timezone:
            msg = (
                f"The round's weather has the clock of {own.timezone}, and {self.id} that of {record.timezone}, which its agents see. "
                "Import the record with that time zone, and make another round."
            )
            raise TaskError(msg)
        return own

    def disturbances(self, extra_rows: int = 0) -> Disturbances:
        """Weather rows of the nominal season, for the whole episode: ``steps + 1 + extra_rows`` rows, remembered.

        Row k acts on step k; the row after the last step is there because it is observed at the end. A forecast of n steps
        needs ``extra_rows=n``.

        Raises
        ------
        TaskError
            When there is no such record or it does not cover the period; it names file and table.
        """
        with self._asked_by("weather"):
            return _disturbances(self.weather, self.steps + 1 + extra_rows)

    def season(self, season: Season, extra_rows: int = 0) -> Disturbances:
        """As ``disturbances``, for a season of the scenario, with the rows of a start up to ``start_within_days`` later."""
        rows = self.steps + 1 + extra_rows + self.scenario.start_within_days * self.steps_per_day
        with self._asked_by("scenario" if self.schema_version > 1 else "weather"):
            table = self.weather.model_copy(update={"source": season.source, "start": season.start})
            try:
                return _disturbances(table, rows)
            except WeatherError as error:
                late, ahead = self.scenario.start_within_days, (extra_rows + 1) / self.steps_per_day
                parts = [f"{self.weather.days} days of a run"]
                if late:
                    parts.append(
                        f"{late} days by which it may start later (scenario.start_within_days = {late}; 0 needs none)"
                    )
                parts.append(f"{ahead:.2g} days beyond its end, which are observed or forecast")
                msg = f"{error} What was asked for is {', '.join(parts)}."
                raise WeatherError(msg) from error

    # What the agent does and sees.

    @cached_property
    def actions(self) -> tuple[Action, ...]:
        """The entries of an action, in order, with units and bounds.

        Raises
        ------
        TaskError
            When there is no such kind of actuation, or it cannot work one of the controls.
        """
        with self._asked_by("actuation"):
            return ACTUATION_KINDS[self.actuation.kind].actions(self.actuation.controls)

    @property
    def on_off(self) -> Mapping[str, OnOffTable]:
        """Controls that are off or run between a lowest load and 1, in the order of the task's controls."""
        table = self.actuation
        if not isinstance(table, AnyActuationTable):
            return {}
        return {name: table.on_off[name] for name in table.controls if name in table.on_off}

    def observed(self) -> tuple[Quantity, ...]:
        """Columns of the observation, in order, with units and finite bounds.

        Raises
        ------
        TaskError
            When there is no such module, or two modules show a quantity of the same name.
        """
        columns: dict[str, Quantity] = {}
        for module in self.observation.modules:
            for quantity in self.observed_by(module):
                if quantity.name in columns:
                    msg = f"{self.source}: [observation] '{quantity.name}' of '{module}' is shown by another module already."
                    raise TaskError(msg)
                columns[quantity.name] = quantity
        return tuple(columns.values())

    def observed_by(self, module: str) -> tuple[Quantity, ...]:
        """Columns of one observation module: one that every model has or somebody registered, or the model's own.

        Raises
        ------
        TaskError
            When neither the vocabulary nor the model has it.
        """
        context, model = self.observation_context(), self.model_value
        own = model.observation_modules if self.schema_version > 1 else {}
        with self._asked_by("observation"):
            if module in own:
                return of_model(module)(context)
            if module in OBSERVATION_MODULES:
                return OBSERVATION_MODULES[module].quantities(context)
            near = did_you_mean(module, [*OBSERVATION_MODULES.names, *own])
            msg = f"{model.id} has no observation module '{module}'.{near}"
            raise UnknownNameError(msg)

    def observation_context(self) -> ObservationContext:
        """What the columns of observation modules may depend on."""
        return ObservationContext(
            self.steps,
            self.step_seconds,
            self.observation.forecast_steps,
            self.parameters_by_name(),
            self.model_value,
            self.observation.forecast_hours,
            tuple((name, one.hold_minutes) for name, one in self.on_off.items() if one.hold_minutes > 0.0),
            tuple((name, table.unit, *table.limits) for name, table in self.price_tables.items()),
            () if self.day_ahead is None else self.day_ahead.prices,
            () if self.day_ahead is None else self.day_ahead.hours,
        )

    @property
    def day_ahead(self) -> DayAheadTable | None:
        """Of which prices the coming hours are shown; ``None`` where none are."""
        return self.observation.day_ahead if isinstance(self.observation, AnyObservationTable) else None

    # What a step earns and costs.

    @cached_property
    def price_tables(self) -> Mapping[str, PriceTable]:
        """Prices that change with the calendar, by name."""
        if isinstance(self.file, TaskFile1):
            return MappingProxyType({})
        tables = self.file.price_tables
        return MappingProxyType({name: table.value(tables) for name, table in tables.items()})

    @cached_property
    def ledger(self) -> Ledger:
        """What a control step earns and pays.

        Items of a task of schema 2 stand by side and name, so that no order of keys in a file changes a sum.

        Raises
        ------
        TaskError
            When an item prices what the model does not have, or in a unit that does not fit; it names file and table.
        """
        if isinstance(self.file, TaskFile1):
            return paper_v1(self.file.prices)
        items = []
        for name, table in sorted(self.file.ledger.items(), key=lambda entry: (entry[1].side, entry[0])):
            with self._asked_by(f"ledger.{name}"):
                items.append(self._item(name, table))
        ledger = Ledger(tuple(items))
        with self._asked_by("ledger"):
            _check_columns(ledger, self.constraints)
        return ledger

    def _item(self, name: str, table: ItemTable) -> LedgerItem:
        from glbench.model.units import parse_unit

        kind, source = ("flow", table.flow) if table.flow is not None else ("stock", table.stock)
        known: dict[str, Any] = {entry.name: entry for entry in getattr(self.model_value, f"{kind}s")()}
        if source is None or source not in known:
            msg = f"{self.model_id} has no {kind} '{source}'.{did_you_mean(str(source), known)}"
            raise UnknownNameError(msg)
        entry = known[source]
        amount, unit = table.amount or (source if kind == "flow" else f"{source}_gained"), entry.unit
        amount_unit = table.unit or unit
        price_unit = table.price_unit
        if isinstance(table.price, str):
            tables = self.price_tables
            if table.price not in tables:
                msg = f"There is no price table '{table.price}'.{did_you_mean(table.price, tables)} Add [price_tables.{table.price}]."
                raise UnknownNameError(msg)
            price_unit = tables[table.price].unit
        if _product(parse_unit(str(price_unit)), parse_unit(amount_unit)) != parse_unit(MONEY):
            msg = f"A price in {price_unit} times an amount in {amount_unit} is not in {MONEY}. Correct the unit of one of them."
            raise ParameterError(msg)
        if table.factor == 1.0 and parse_unit(amount_unit) != parse_unit(unit):
            msg = f"'{source}' is in {unit}, the amount in {amount_unit}: give the factor between them."
            raise ParameterError(msg)
        beyond = (
            None if table.beyond is None else self._beyond(table, table.beyond, amount_unit, str(price_unit), entry)
        )
        return LedgerItem(
            name, source, amount, amount_unit, table.factor, table.price, 1 if table.side == "earned" else -1,
            label=table.label or entry.label, valued=FLOW if kind == "flow" else STOCK,
            amount_meaning=_amount_in_words(entry.meaning, unit, amount_unit, table.factor), beyond=beyond,
        )  # fmt: skip

    def _beyond(self, item: ItemTable, beyond: BeyondTable, amount_unit: str, price_unit: str, entry: Any) -> Beyond:
        """A price that changes with the amount since the start."""
        if isinstance(item.price, str):
            msg = f"beyond needs a price that is a number, and this one is the table '{item.price}'. Leave one of them out."
            raise ParameterError(msg)
        if getattr(entry, "total", None) is None:
            metered = [flow.name for flow in self.model_value.flows() if flow.total is not None]
            msg = (
                f"beyond counts what has flowed since the start, and {self.model_id} has no meter on '{entry.name}'. "
                f"It has {', '.join(metered) or 'none'}."
            )
            raise ParameterError(msg)
        for what, given, wanted in (
            ("amount", beyond.amount_unit, amount_unit),
            ("price", beyond.price_unit, price_unit),
        ):
            if given != wanted:
                msg = f"beyond: its {what} is in {given}, that of the item in {wanted}. Write both in one unit."
                raise ParameterError(msg)
        return Beyond(beyond.amount, beyond.price)

    @cached_property
    def quantities(self) -> tuple[StepQuantity, ...]:
        """Every quantity of a control step: reward, profit, money, penalty, amounts, violations, hours outside the limits."""
        return step_quantities(
            self.ledger,
            (name for name, _ in self.constraints.items()),
            means=self.judges_means,
            priced=bool(self.violation_prices),
            reward_unit=MONEY if self.scores_money else "-",
            travel=self.schema_version > 1,
        )

    # What a run draws.

    @cached_property
    def scenario(self) -> Scenario:
        """What a run draws: season, first day, start state, parameters.

        Raises
        ------
        TaskError
            When a parameter, a set or a state is unknown; it names file and table.
        """
        weather = self.weather
        if isinstance(self.file, TaskFile1):
            table = self.file.uncertainty
            names = self._drawn(table.parameters, "uncertainty")
            group = ParameterGroup("uncertainty", names, table.distribution, table.half_width, table.redraw)
            return Scenario(self.id, "", (group,), (), (Season(weather.source, weather.start),), legacy=True)
        scenario = self.file.scenario
        groups = tuple(
            ParameterGroup(
                group.name or f"parameters {place}", self._drawn(group.parameters, "scenario.parameters"), group.distribution,
                group.half_width, group.redraw,
            )
            for place, group in enumerate(scenario.parameters)
        )  # fmt: skip
        with self._asked_by("scenario.start"):
            starts = []
            for place, start in enumerate(scenario.start):
                for name in start.states:
                    self.model_value.state_index(name)
                starts.append(
                    StartGroup(start.name or f"start {place}", start.states, start.distribution, start.half_width)
                )
        drawn = [name for one in groups for name in one.parameters]
        for name in drawn:
            if drawn.count(name) > 1:
                msg = f"{self.source}: [scenario.parameters] '{name}' is in two groups. Keep it in one."
                raise TaskError(msg)
        split = self._split_table
        salt, generated, source = scenario.salt, None, weather.source
        years = scenario.years if split is None else split.years
        if split is not None:
            salt = "\n".join(filter(None, (scenario.salt, self.split, self.sealed)))
            sealed = weather_of(self.sealed)
            if sealed is not None:
                source, years = self.season_record().name, sealed.years
            if split.seasons is not None:
                between = scenario.co2_range
                generated = Generated(
                    years, split.seasons, self.evaluation.first_seed, None if between is None else (between.low, between.high)
                )  # fmt: skip
        with self._asked_by("scenario"):
            seasons = [Season(entry.source or weather.source, entry.start) for entry in scenario.seasons]
            if generated is None:
                seasons += [Season(source, _in_year(weather.start, year)) for year in years]
        return Scenario(
            scenario.family, salt, groups, tuple(starts),
            tuple(seasons) or (Season(weather.source, weather.start),), scenario.start_within_days, generated,
        )  # fmt: skip

    # The digest.

    def definition(self) -> dict[str, Any]:
        """What the file says without prose, as plain JSON values: the part of the digest that comes from the file."""
        options: dict[str, Any] = {"mode": "json", "by_alias": True, "exclude": set(PROSE)}
        if self.schema_version > 1:
            plain = self.file.model_dump(**options, exclude_defaults=True)
            plain["schema"] = self.schema_version
        else:
            whole = self.file.model_dump(**options)
            plain = {
                table: {key: whole[table][key] for key in keys} if keys else whole[table]
                for table, keys in SCHEMA_1.items()
            }
            if (
                self.evaluation.time_limits is not None
            ):  # a task that says nothing about time has the digest it always had
                plain["evaluation"]["time_limits"] = whole["evaluation"]["time_limits"]
        if self.schema_version == 1 or self.model.overrides:
            plain["model"]["overrides"] = {name: [value, unit] for name, value, unit in self.model.overrides}
        return plain

    def fingerprint(self) -> Fingerprint:
        """The digest and the parts it is made of, remembered; needs the model and the weather.

        It is the SHA-256 of canonical JSON (RFC 8785) over: the definition without prose, the resolved parameters, the state at the
        start, the names, units and bounds of the observed columns, the weather, and the model's equations; for schema 2 over the ledger
        and the names of drawn parameters as well. Each part also has a digest of its own, so that a mismatch can be blamed on the right
        one. Computed numbers enter with nine significant digits, because the last bit of ``exp`` may differ between machines.

        It does not cover the code that computes a step from these: draws, accounts, reward, and for schema 1 the weather between the
        hours. What that code gives for the published tasks is in ``tasks/behaviour.toml`` (``glbench.env.behaviour``).

        Raises
        ------
        TaskError
            When the task asks for what does not exist.
        """
        return self._fingerprint

    @cached_property
    def _fingerprint(self) -> Fingerprint:
        model = self.model_value
        for name in self.actuation.controls:
            with self._asked_by("actuation"):
                if name not in model.control_names:
                    msg = f"There is no control called '{name}'.{did_you_mean(name, model.control_names)}"
                    raise UnknownNameError(msg)
        scenario, ledger = self.scenario, self.ledger  # what is unknown is an error before anything is recorded
        if model.air is None and self.constraints.items():
            msg = f"{self.source}: [constraints] {model.id} has no air whose climate could be limited. Leave the table out."
            raise TaskError(msg)
        parts: dict[str, Any] = {
            "definition": self.definition(),
            "parameters": {name: _rounded(value) for name, value in self.parameters_by_name().items()},
            "start": [_rounded(value) for value in self.initial_state().tolist()],
            "observation": [[q.name, q.unit, _rounded(q.low), _rounded(q.high)] for q in self.observed()],
            "weather": self.disturbances(self.observation.forecast_steps).digest,
            "model": {"version": model.version, "variant": model.variant, "digest": model.digest},
        }
        if self.schema_version > 1:
            parts["start"] = dict(zip(model.state_names, parts["start"], strict=True))
            parts["weather"] = self._weather_digests()
            parts["model"]["id"] = model.id
            parts["ledger"] = [
                [item.name, item.flow, item.amount, item.amount_unit, item.factor, item.price, item.sign, item.valued]
                for item in ledger.items
            ]  # fmt: skip
            parts["draws"] = [[g.name, list(g.parameters)] for g in scenario.groups]
            if isinstance(self.actuation, AnyActuationTable) and self.actuation.kind == PROCESS_COMPUTER:
                parts["actuation"] = {
                    "settings": self.actuation.process_computer.model_dump(),
                    "actions": [
                        [one.name, one.unit, one.low, one.high, one.lowest, one.highest] for one in self.actions
                    ],
                }
        named = {name: canonical_sha256(part) for name, part in parts.items() if name in Fingerprint.PARTS}
        return Fingerprint(digest=canonical_sha256(parts), **named, model_version=model.version)

    def _weather_digests(self) -> list[list[str]]:
        """Digests of the weather of all splits, whichever this is."""
        splits = self.splits
        if splits is None:
            return [self._season_digest(season) for season in self.scenario.seasons]
        found: list[list[str]] = []
        for name in splits.names:
            scenario = self.in_split(name).scenario
            if scenario.generated is None:
                found += [[name, *self._season_digest(season)] for season in scenario.seasons]
            else:
                found.append([name, "generated", *map(str, scenario.generated.years), self._generated_digest(name)])
        return found

    def _generated_digest(self, split: str) -> str:
        """Digest of one season that the generator makes of the years of a split: whole numbers, the same on every machine."""
        from glbench.weather import SeasonGenerator

        years = getattr(self.splits, split).years
        with self._asked_by(f"splits.{split}"):
            generator = SeasonGenerator(self.record(), years)
        days = self.weather.days
        numbers = np.asarray(np.arange(1, generator.numbers(days) + 1) * _EVEN % 1.0, np.float64)
        return generator.season(self.weather.start, days, numbers).record.digest

    def _season_digest(self, season: Season) -> list[str]:
        rows = self.season(season, self.observation.forecast_steps)
        calendar = np.column_stack([rows.values, rows.hour_of_day, rows.day_of_year])
        steps = np.rint(calendar * _GRID).astype("<i8")
        return [season.source, season.start.isoformat(), hashlib.sha256(steps.tobytes()).hexdigest()]

    @property
    def digest(self) -> str:
        """SHA-256 [hex] over definition, parameters, start, observed columns, weather and model; see docs/tasks.md."""
        return self.fingerprint().digest

    @property
    def locked(self) -> bool:
        """Whether this very task is published: its id stands in tasks/lock.toml with this digest."""
        entry = read_lock().get(self.id)
        return entry is not None and entry.digest == self.digest

    @contextmanager
    def _asked_by(self, table: str) -> Iterator[None]:
        """Name the task's file and ``table`` in whatever goes wrong inside."""
        try:
            yield
        except TaskError:
            raise
        except GlbenchError as error:
            msg = f"{self.source}: [{table}] {error}"
            raise TaskError(msg) from error

    @cached_property
    def _hash(self) -> int:
        return hash(self.file.model_dump_json())

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        return self is other or (
            isinstance(other, TaskSpec)
            and (self.file, self.split, self.sealed) == (other.file, other.split, other.sealed)
        )

    def __setattr__(self, name: str, value: object) -> None:
        msg = f"A task is frozen: make another one with model_copy(update={{'{name}': ...}})."
        raise FrozenInstanceError(msg)

    def __reduce__(self) -> tuple[Any, ...]:
        return TaskSpec, (self.file, self.source, self.base, self.changes, self.split, self.sealed)

    def __repr__(self) -> str:
        return f"<TaskSpec {self.id}>"


@lru_cache(maxsize=64)
def _changed_task(tables: TaskTables, source: str) -> TaskSpec:
    """The task of changed tables. Whatever cannot be resolved is reported now and not in the middle of a run."""
    task = TaskSpec.of_tables(tables, source)
    task.fingerprint()
    return task


@lru_cache(maxsize=16)
def _record(source: str) -> WeatherRecord:
    from glbench.weather import load_weather

    return load_weather(source)


@lru_cache(maxsize=16)
def _record_of(digest: str) -> WeatherRecord:
    from glbench.weather import find_weather

    return _record(find_weather(digest))


@lru_cache(maxsize=32)
def _disturbances(table: WeatherTable, rows: int) -> Disturbances:
    from glbench.weather import disturbances

    return disturbances(
        _record(table.source),
        start=table.start,
        steps=rows,
        step_seconds=float(table.step_seconds),
        preprocessing=table.preprocessing,
        co2_ppm=table.co2_ppm,
    )


def _check_columns(ledger: Ledger, constraints: OfTheAir) -> None:
    """Refuse two quantities of a step with one name."""
    by_amount: dict[str, tuple[str, float]] = {}
    for item in ledger.items:
        source = (item.flow, item.factor)
        if by_amount.setdefault(item.amount, source) != source:
            msg = f"The amount '{item.amount}' is two things. Give one of them another name: amount = ..."
            raise UnknownNameError(msg)
    limited = (name for name, _ in constraints.items())
    names = [quantity.name for quantity in step_quantities(ledger, limited, travel=True)]
    for name in names:
        if names.count(name) > 1:
            msg = f"'{name}' is the name of two columns. Give one of them another name."
            raise UnknownNameError(msg)


def _amount_in_words(meaning: str, unit: str, amount_unit: str, factor: float) -> str:
    """Description of an amount; if it is a multiple of the flow, such as fresh fruit of carbohydrate, with the factor."""
    times = factor / {("mg m-2", "kg m-2"): 1e-6, ("MJ m-2", "kWh m-2"): 1.0 / 3.6}.get((unit, amount_unit), 1.0)
    if math.isclose(times, 1.0):
        return meaning
    known = unit == amount_unit or times != factor
    return f"{times:.4g} times the {meaning}" if known else f"{factor:.4g} {amount_unit} for each {unit} of {meaning}"


def _in_year(day: dt.date, year: int) -> dt.date:
    try:
        return day.replace(year=year)
    except ValueError:
        msg = f"{year} has no 29 February: start on another day."
        raise UnknownNameError(msg) from None


def _product(one: Mapping[str, float], other: Mapping[str, float]) -> dict[str, float]:
    """Exponents of the product of two units."""
    summed = {symbol: one.get(symbol, 0) + other.get(symbol, 0) for symbol in {*one, *other}}
    return {symbol: exponent for symbol, exponent in summed.items() if exponent}


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def _read_only(array: FloatArray) -> FloatArray:
    array.setflags(write=False)
    return array
