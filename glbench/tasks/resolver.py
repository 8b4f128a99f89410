"""Resolves a task's file: model, parameters, start, weather, actions, observed columns, ledger and scenario.

Everything is computed on demand and cached. Errors of the model and the weather name the task's file and the table that caused them.

A scenario says what a run draws: its season, its start, its parameters; ``glbench.env`` does the drawing. All numbers come from
counter-based streams (docs/adr/0006, 0014): a number depends on its address alone. Tasks with the same ``family`` and ``salt`` share
their numbers, so that they can be compared run by run.
"""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from glbench.errors import ParameterError, TaskError, UnknownNameError, WeatherError, did_you_mean, refuse
from glbench.quantities import MONEY
from glbench.tasks.ledger import FLOW, STOCK, TRAVEL, Beyond, Ledger, LedgerItem, StepQuantity, step_quantities
from glbench.tasks.quantities import Capacity, ObservationContext, Quantity, capacities, of_model
from glbench.tasks.record import TaskRecord
from glbench.tasks.sealed import weather_of
from glbench.tasks.tables import BeyondTable, ItemTable, WeatherTable
from glbench.tasks.vocabulary import ACTUATION_KINDS, INITIAL_STATES, OBSERVATION_MODULES

if TYPE_CHECKING:
    from glbench.model import Model
    from glbench.tasks.quantities import Action
    from glbench.tasks.spreads import Spread
    from glbench.vision.library import Library
    from glbench.weather import Disturbances, WeatherRecord

FloatArray = npt.NDArray[np.float64]
Redraw = Literal["step", "day", "episode"]


@dataclass(frozen=True)
class ParameterGroup:
    """Parameters that are drawn together: each is its nominal value times 1 + e."""

    name: str
    """Name of the group and of its stream."""
    parameters: tuple[str, ...]
    """Their names, in the order in which numbers are drawn."""
    distribution: str
    half_width: float
    """``distribution`` and ``half_width``: of e."""
    redraw: Redraw
    """How often: at every step, at the start of every day, or once per episode."""
    spread: Spread | None = None
    """How the parameters are drawn instead, with a width for each; ``half_width`` is then their largest deviation."""


@dataclass(frozen=True)
class StartGroup:
    """States whose values at the start are multiplied by factors 1 + e, one for each state and run."""

    name: str
    states: tuple[str, ...]
    distribution: str
    half_width: float


@dataclass(frozen=True)
class Season:
    """A weather record, and the first day of an episode in it."""

    source: str
    start: dt.date


@dataclass(frozen=True)
class Generated:
    """Seasons from the weather generator."""

    years: tuple[int, ...]
    """Years of the record from which they are generated."""
    seasons: int
    """Number of seasons. The run with a seed is in season (seed - first_seed) modulo this number."""
    first_seed: int
    """Seed of the run in season 0."""
    co2_range: tuple[float, float] | None = None
    """Lowest and highest CO2 outside [ppm], between which it varies; ``None`` if it is constant."""


@dataclass(frozen=True)
class Scenario:
    """What a run draws."""

    family: str
    salt: str
    """``family`` and ``salt``: tasks for which both are equal share their random numbers."""
    groups: tuple[ParameterGroup, ...]
    start_groups: tuple[StartGroup, ...]
    """``groups`` and ``start_groups``: parameters, and states at the start, that are drawn."""
    seasons: tuple[Season, ...]
    """A run draws one of these, all with the same probability. For generated seasons, the calendar."""
    start_within_days: int = 0
    """A run's first day is drawn with equal probability from the season's first day to this many days later. The first days of generated
    seasons are spread evenly over these days."""
    generated: Generated | None = None
    """How seasons are generated, if they are. Their weather and first days belong to the season's number, not to the seed."""
    legacy: bool = False
    """Schema 1: streams are still keyed by task id and seed."""


class ResolvedTask(TaskRecord):
    """A task with its model, parameters, weather, ledger and scenario."""

    @cached_property
    def model_value(self) -> Model:
        """The model. Raises ``TaskError`` when there is no model with that id and variant."""
        from glbench.model import get_model  # not at the top: task files are read without the model

        with self.errors_in("model"):
            model = get_model(self.model_id, self.model.variant)
        if not self.judges_means:
            return model
        from glbench.model import with_violation_meters

        with self.errors_in("constraints"):
            return with_violation_meters(model)

    def parameters(self) -> FloatArray:
        """Nominal parameters, read-only, in the model's order and units, with overrides applied and derived parameters recomputed.

        If violations are means over the step, the limits are included.

        Raises ``TaskError`` when the set or an overridden parameter is unknown, or a value is impossible; the message names file and table.
        """
        return self._parameters

    @cached_property
    def _parameters(self) -> FloatArray:
        with self.errors_in("model"):
            overrides: dict[str, Any] = {name: (value, unit) for name, value, unit in self.model.overrides}
            limits = {}
            if self.judges_means:
                from glbench.model import SIDES, limit_parameter

                limits = {limit_parameter(name, side): getattr(entry, side) for name, entry in self.constraints.items() for side in SIDES}
            for name in limits.keys() & overrides.keys():
                refuse(f"'{name}' is a limit of the task: state it in [constraints].", ParameterError)
            return _read_only(self.model_value.parameters.default(self.model.parameters, overrides | limits))

    def parameters_by_name(self) -> dict[str, float]:
        """``parameters()`` as a dictionary."""
        return dict(zip(self.model_value.parameter_names, self.parameters().tolist(), strict=True))

    def uncertain_parameters(self) -> tuple[str, ...]:
        """Names of the parameters that are redrawn, group by group: in the model's order for a set, otherwise as listed."""
        return tuple(dict.fromkeys(name for group in self.scenario.groups for name in group.parameters))

    def _drawable_parameters(self, names: str | tuple[str, ...], table: str) -> tuple[str, ...]:
        """The parameters of a set or a list, all of which can be drawn."""
        values = self.model_value.parameters
        with self.errors_in(table):
            if isinstance(names, str):
                return values.drawn_set(names)
            for name in names:
                if name not in values.names:
                    refuse(f"There is no parameter called '{name}'.{did_you_mean(name, values.names)}", UnknownNameError)
                info = values.info(name)
                if info.is_derived:
                    refuse(f"'{name}' follows from other parameters ({name} = {info.formula}): list those instead.", ParameterError)
        return names

    def initial_state(self) -> FloatArray:
        """Nominal state at the start, read-only, in the model's units."""
        return self._initial_state

    @cached_property
    def _initial_state(self) -> FloatArray:
        return _read_only(self.start_state(self.disturbances().values[0]))

    @cached_property
    def initial_controls(self) -> FloatArray:
        """Controls before the first step, shares ``(controls,)``, read-only; 0 if unstated. Raises ``TaskError`` for an impossible one."""
        capacities = self.capacities()
        controls, names = np.zeros(len(capacities)), [one.name for one in capacities]
        with self.errors_in("initial_state"):
            for name, value, unit in self.initial.controls:
                if name not in self.actuation.controls or name not in names:
                    refuse(f"controls: the agent moves no control '{name}'.{did_you_mean(name, self.actuation.controls)}", UnknownNameError)
                if name in self.on_off or name in self.actuators:
                    msg = f"controls: {name} starts at 0, because it is off or on or its actuator is not ideal. Leave it out."
                    raise ParameterError(msg)
                place = names.index(name)
                one = capacities[place]
                if unit != one.unit or not 0.0 <= value <= one.at_one:
                    refuse(f"controls.{name} = {value:g} {unit} is not allowed. It must be 0 to {one.at_one:g} {one.unit}.", ParameterError)
                controls[place] = value / one.at_one
        return _read_only(controls)

    def check_start(self) -> None:
        """Raises ``TaskError``, with file, table, state and value, when the nominal start state or its rates are not finite."""
        state = self.initial_state()
        with self.errors_in("initial_state"):
            self.model_value.check_rates(state, self.disturbances().values[0], self.parameters())

    def start_state(self, first: FloatArray) -> FloatArray:
        """State at the start of an episode whose first row of weather is ``first`` ``(disturbances,)``, before any factors."""
        kind, air_temperature = self.initial.kind, self.initial.air_temperature
        with self.errors_in("initial_state"):
            own = INITIAL_STATES[kind].state if kind in INITIAL_STATES else None
            if own is not None:
                return own(first, air_temperature, self.parameters())
            return self.model_value.start(kind, first, air_temperature, self.parameters())

    def capacities(self) -> tuple[Capacity, ...]:
        """What each control of the model supplies at 1, with its unit."""
        return capacities(self.model_value, self.parameters_by_name())

    @cached_property
    def scheduled_places(self) -> Mapping[str, int]:
        """Controls that follow the schedule, with their places in the model; TaskError if it lacks one, or the agent has it."""
        names, controls = self.model_value.control_names, dict.fromkeys(entry.control for entry in self.schedule)
        for name in (name for name in controls if name not in names or name in self.actuation.controls):
            msg = f"'{name}' is in [actuation] controls: the agent moves it. Take it out of one of them."
            if name not in names:
                msg = f"There is no control called '{name}'.{did_you_mean(name, names)}"
            with self.errors_in("[schedule]"):
                raise UnknownNameError(msg)
        return {name: names.index(name) for name in controls}

    @cached_property
    def due_places(self) -> Mapping[str, int]:
        """Places of the states by which machines are due, by control; TaskError if the model lacks one, or it has another unit."""
        places = {}
        for name, due in ((name, machine.due) for name, machine in self.on_off.items() if machine.due is not None):
            with self.errors_in(f"actuation.on_off.{name}"):
                places[name] = self.model_value.state_index(due.state)
                unit = self.model_value.states[places[name]].unit
                if unit != due.unit:
                    msg = f"due: the unit of {due.state} is {unit}, not {due.unit}. Convert first and last, and write that unit."
                    raise ParameterError(msg)
        return places

    # The weather.

    def record(self) -> WeatherRecord:
        """The weather record that the task uses."""
        with self.errors_in("weather"):
            return _record(self.weather.source)

    def season_record(self) -> WeatherRecord:
        """The weather record of the split's seasons: the task's, or the round's own, about which agents get no information.

        Raises ``TaskError`` when there is no such record, or the round's own record has a different clock from the task's.
        """
        record = self.record()
        with self.errors_in("weather"):
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
        """Weather rows of the nominal season, for the whole episode: ``steps + 1 + extra_rows`` rows, cached.

        Row k acts on step k; the row after the last step is there because it is observed at the end. A forecast of n steps
        needs ``extra_rows=n``.

        Raises ``TaskError`` when there is no such record or it does not cover the period; the message names file and table.
        """
        with self.errors_in("weather"):
            return _disturbances(self.weather, self.steps + 1 + extra_rows)

    def season(self, season: Season, extra_rows: int = 0) -> Disturbances:
        """Like ``disturbances``, for a season of the scenario, with the rows for a start up to ``start_within_days`` later."""
        rows = self.steps + 1 + extra_rows + self.scenario.start_within_days * self.steps_per_day
        with self.errors_in(self.conventions.seasons_table):
            table = self.weather.model_copy(update={"source": season.source, "start": season.start})
            try:
                return _disturbances(table, rows)
            except WeatherError as error:
                late, ahead = self.scenario.start_within_days, (extra_rows + 1) / self.steps_per_day
                parts = [f"{self.weather.days} days of a run"]
                if late:
                    parts.append(f"{late} days by which it may start later (scenario.start_within_days = {late}; 0 needs none)")
                parts.append(f"{ahead:.2g} days beyond its end, which are observed or forecast")
                refuse(f"{error} What was asked for is {', '.join(parts)}.", WeatherError, error)

    # What the agent does and observes.

    @cached_property
    def actions(self) -> tuple[Action, ...]:
        """The entries of an action, with units and bounds. Raises ``TaskError`` for an unknown actuation, or a control that it lacks."""
        with self.errors_in("actuation"):
            actions = ACTUATION_KINDS[self.actuation.kind].actions(self.actuation.controls)
        return tuple(self._due(action) for action in actions)

    def _due(self, action: Action) -> Action:
        """The entry of a machine that is due by a state with its meaning; to ask for nothing is to ask for the latest."""
        machine = self.on_off.get(action.name)
        if machine is None or machine.due is None:
            return action
        due, (meaning,) = machine.due, [control.meaning for control in self.model_value.controls if control.name == action.name]
        when = f"from {due.state} = {due.first:g} {due.unit} on at {action.high:g}, {due.last:g} {due.unit} at {action.low:g}"
        return replace(action, idle=action.low, meaning=f"{meaning}; {when}")

    def observed(self) -> tuple[Quantity, ...]:
        """Columns of the observation, with units and finite bounds. Raises ``TaskError`` for an unknown module or the same name twice."""
        columns: dict[str, Quantity] = {}
        for module in self.observation.modules:
            for quantity in self.observed_by(module):
                if quantity.name in columns:
                    refuse(f"{self.source}: [observation] '{quantity.name}' of '{module}' is shown by another module already.", TaskError)
                columns[quantity.name] = quantity
        return tuple(columns.values())

    def observed_by(self, module: str) -> tuple[Quantity, ...]:
        """Columns of a module that all models have, is registered, or is the model's own. Raises ``TaskError`` when there is none."""
        context, model = self.observation_context(), self.model_value
        with self.errors_in("observation"):
            if module in OBSERVATION_MODULES:
                return OBSERVATION_MODULES[module].quantities(context)
            if module in model.observation_modules:
                return of_model(module)(context)
            near = did_you_mean(module, [*OBSERVATION_MODULES.names, *model.observation_modules])
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
            tuple(self.scheduled_places),
            self.picture_library,
        )

    @property
    def picture_library(self) -> Library | None:
        """The pictures that the task's camera takes; ``None`` without one. Raises ``TaskError`` when there is no such library."""
        with self.errors_in("camera"):
            return None if self.camera is None else _library(*self.camera.library.split("-"))

    # What a step earns and costs.

    @cached_property
    def ledger(self) -> Ledger:
        """What a control step earns and pays.

        Items of schema 2 are sorted by side and name, so that the order of keys in a file does not change a sum.

        Raises ``TaskError`` when an item prices what the model lacks, or has the wrong unit; names file and table.
        """
        paper = self.file.paper_ledger()
        if paper is not None:
            return paper
        items = []
        for name, table in sorted(self.file.ledger.items(), key=lambda entry: (entry[1].side, entry[0])):
            with self.errors_in(f"ledger.{name}"):
                items.append(self._item(name, table))
        ledger = Ledger(tuple(items))
        with self.errors_in("ledger"):
            sources: dict[str, tuple[str, float]] = {}
            for item in items:
                if sources.setdefault(item.amount, (item.flow, item.factor)) != (item.flow, item.factor):
                    refuse(f"The amount '{item.amount}' is two things. Give one of them another name: amount = ...", UnknownNameError)
            limited = (name for name, _ in self.constraints.items())
            names = [quantity.name for quantity in step_quantities(ledger, limited, extra=(TRAVEL,))]
            for name in names:
                if names.count(name) > 1:
                    refuse(f"'{name}' is the name of two columns. Give one of them another name.", UnknownNameError)
        return ledger

    def _item(self, name: str, table: ItemTable) -> LedgerItem:
        from glbench.model.units import parse_unit

        kind, source = ("flow", table.flow) if table.flow is not None else ("stock", table.stock)
        entries: dict[str, Any] = {entry.name: entry for entry in getattr(self.model_value, f"{kind}s")()}
        if source is None or source not in entries:
            refuse(f"{self.model_id} has no {kind} '{source}'.{did_you_mean(str(source), entries)}", UnknownNameError)
        entry = entries[source]
        amount, unit = table.amount or (source if kind == "flow" else f"{source}_gained"), entry.unit
        amount_unit = table.unit or unit
        price_unit = table.price_unit
        if isinstance(table.price, str):
            tables = self.price_tables
            if table.price not in tables:
                msg = f"There is no price table '{table.price}'.{did_you_mean(table.price, tables)} Add [price_tables.{table.price}]."
                raise UnknownNameError(msg)
            price_unit = tables[table.price].unit
        one, other = parse_unit(str(price_unit)), parse_unit(amount_unit)
        product = {symbol: one.get(symbol, 0) + other.get(symbol, 0) for symbol in {*one, *other}}
        if {symbol: exponent for symbol, exponent in product.items() if exponent} != parse_unit(MONEY):
            msg = f"A price in {price_unit} times an amount in {amount_unit} is not in {MONEY}. Correct the unit of one of them."
            raise ParameterError(msg)
        if table.factor == 1.0 and other != parse_unit(unit):
            refuse(f"'{source}' is in {unit}, the amount in {amount_unit}: give the factor between them.", ParameterError)
        beyond = None if table.beyond is None else self._beyond(table, table.beyond, amount_unit, str(price_unit), entry)
        return LedgerItem(
            name, source, amount, amount_unit, table.factor, table.price, 1 if table.side == "earned" else -1,
            label=table.label or entry.label, counted=entry.counted, valued=FLOW if kind == "flow" else STOCK,
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
        for what, unit, item_unit in (("amount", beyond.amount_unit, amount_unit), ("price", beyond.price_unit, price_unit)):
            if unit != item_unit:
                refuse(f"beyond: its {what} is in {unit}, that of the item in {item_unit}. Write both in one unit.", ParameterError)
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
            extra=self.conventions.extra_quantities,
        )

    # What a run draws.

    @cached_property
    def scenario(self) -> Scenario:
        """What a run draws: season, first day, start, parameters. Raises ``TaskError``, with file and table, for an unknown name in it."""
        weather, scenario, groups, starts = self.weather, self.file.scenario, [], []
        for place, group in enumerate(scenario.parameters):
            names = self._drawable_parameters(group.parameters, self.conventions.draws_table)
            name = group.name or f"parameters {place}"
            most = {} if group.measured is None else group.measured.limits()
            for side in (0, 1) if most else ():  # the farthest houses must be possible ones
                values, nominal = self.model_value.parameters, self.parameters_by_name()
                base = {one: value for one, value in nominal.items() if not values.info(one).is_derived}
                farthest = {one: nominal[one] * limits[side] for one, limits in most.items()}
                with self.errors_in(self.conventions.draws_table):
                    values.default(self.model.parameters, base | farthest)
            groups.append(ParameterGroup(name, names, group.distribution, group.width, group.redraw, group.measured))
        with self.errors_in("scenario.start"):
            for place, start in enumerate(scenario.start):
                for name in start.states:
                    self.model_value.state_index(name)
                starts.append(StartGroup(start.name or f"start {place}", start.states, start.distribution, start.half_width))
        names_of_all = [name for one in groups for name in one.parameters]
        for name in names_of_all:
            if names_of_all.count(name) > 1:
                refuse(f"{self.source}: [scenario.parameters] '{name}' is in two groups. Keep it in one.", TaskError)
        split = self.split_table
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
        with self.errors_in("scenario"):
            seasons = [Season(entry.source or weather.source, entry.start) for entry in scenario.seasons]
            if generated is None:
                for year in years:
                    try:
                        seasons.append(Season(source, weather.start.replace(year=year)))
                    except ValueError:
                        msg = f"{year} has no 29 February: start on another day."
                        raise UnknownNameError(msg) from None
        return Scenario(
            scenario.family, salt, tuple(groups), tuple(starts),
            tuple(seasons) or (Season(weather.source, weather.start),), scenario.start_within_days, generated,
            self.conventions.keys_by_task,
        )  # fmt: skip


@lru_cache(maxsize=4)
def _library(crop: str, version: str) -> Library:
    from glbench.vision.library import Library

    return Library.open(crop, version)


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


def _amount_in_words(meaning: str, unit: str, amount_unit: str, factor: float) -> str:
    """Description of an amount; includes the factor if it is a multiple of the flow, such as fresh fruit from carbohydrate."""
    times = factor / {("mg m-2", "kg m-2"): 1e-6, ("MJ m-2", "kWh m-2"): 1.0 / 3.6}.get((unit, amount_unit), 1.0)
    if math.isclose(times, 1.0):
        return meaning
    same_kind = unit == amount_unit or times != factor
    return f"{times:.4g} times the {meaning}" if same_kind else f"{factor:.4g} {amount_unit} for each {unit} of {meaning}"


def _read_only(array: FloatArray) -> FloatArray:
    array.setflags(write=False)
    return array
