"""What is recorded and shown of a run, as one description: columns, MCAP channels, curves, pages and words all follow from it.

``Signals`` is handed in; no other file of this room names a state, a control, a cost, or counts them. The second half of this file makes
the description of a task: from its model what there is of states, controls and weather, and what of it is drawn; from its constraints the
climate and its violations; from its ledger the money and the amounts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from glbench import quantities
from glbench.arrays import Floats
from glbench.env.daily_sums import daily_sums
from glbench.env.weather_pool import CLOCK
from glbench.errors import TaskError
from glbench.model import Model, humidity_deficit, vapour_pressure_deficit
from glbench.model import Signal as ModelSignal
from glbench.tasks import Action, TaskSpec
from glbench.tasks.ledger import FLOW, LedgerItem

Columns = Mapping[str, Floats]  # Columns of an episode by name, each ``(steps,)``
Moment = Literal["start", "end"]
Source = Literal["control", "disturbance", "air", "state", "clock", "derived", "quantity", "camera"]
"""Where a simulation has a number: the vectors u, d and x, the climate measured in the air, the clock of the greenhouse, what follows from
all these, the table of a step's quantities, or the pictures of the crop."""
Vectors = Mapping[Source, Floats]  # What a simulation has, by source, ``(rows, entries)`` each
Formula = Callable[[Vectors], Floats]
_ACTS: frozenset[Source] = frozenset({"control", "disturbance"})  # Sources of what acts during a step; all others are measured at its end
_AT_START: frozenset[Source] = frozenset({"air", "state", "clock", "derived", "camera"})
"""Sources that also have values at step 0, before anything was done."""

KWH_A_CUBIC_METRE = 31.65 / 3.6
"""Heat in a cubic metre of natural gas [kWh m-3]: its lower heating value, 31.65 MJ m-3, as in the published code of GreenLight
(``energyContentGas``). The energy tasks count gas by it, too; the upper one of the same Dutch gas is 35.17 MJ m-3."""

TOPICS: dict[Moment, str] = {"start": "/inputs", "end": "/outcome"}
"""Topics of a record: what acts during a step, and the result at its end."""
MESSAGES = {"/inputs": "Inputs", "/outcome": "Outcome"}  # Message type of each topic
ACTION = "action"  # Group of what the agent answered
SCENE = "scene"  # Column that says which picture of the crop is shown
_PARTS = {ACTION: ("agent_action", "AgentAction"), "state": ("model_state", "ModelState")}
"""Part and message type of the groups that are not called like them."""


@dataclass(frozen=True)
class Column:
    """One column: ``name``, ``unit``, and ``meaning`` in words."""

    name: str
    unit: str
    meaning: str


@dataclass(frozen=True)
class Group:
    """Columns that belong together: a message type of their own, which is a part of the message of their topic.

    Steps are numbered from 1; step k lasts from t(k-1) to t(k). Groups of the moment ``"start"`` act during the whole step and carry the
    time of its start; groups of the moment ``"end"`` are measured when it is over and carry the time of its end. ``field`` is the name of
    the part. ``at_start`` is true for groups that also have a sample at step 0. A column's name occurs once among all groups.

    All groups of one moment are parts of one message, because MCAP keeps an uncompressed index entry of 16 bytes for each message: with a
    message for each group it was a quarter of a file.
    """

    name: str
    field: str
    message: str
    moment: Moment
    at_start: bool
    columns: tuple[Column, ...]

    @property
    def topic(self) -> str:
        """Topic of the record in which the group stands."""
        return TOPICS[self.moment]

    @property
    def path(self) -> str:
        """Where Foxglove finds the group: topic and part, as in ``/outcome.climate``."""
        return f"{self.topic}.{self.field}"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns, in order."""
        return tuple(column.name for column in self.columns)


def make_group(name: str, columns: Iterable[Column], moment: Moment, *, at_start: bool) -> Group:
    """A group; its part and message type are called like it, but for the two of ``_PARTS``."""
    field, message = _PARTS.get(name, (name, name.capitalize()))
    return Group(name, field, message, moment, at_start, tuple(columns))


@dataclass(frozen=True)
class Signal:
    """One number of every step: a column of the record's ``group``, which the simulation has at ``index`` of ``source``."""

    name: str
    unit: str
    meaning: str
    group: str
    source: Source
    index: int


@dataclass(frozen=True)
class Curve:
    """One curve for each controller. Nothing is recomputed but sums over time, differences, and factors of units.

    ``path`` is its place in the recording, ``group/quantity``; the controller's name follows, unless the curve is ``shared``, the same for
    all, such as the weather. The ``form`` of its ``columns`` is the ``value``; the ``sum`` from the first step on, in the order of the
    steps, so that the last value is the run's metric (of several columns the sum of their sums); ``beyond``: the second of two columns
    minus the first, of which one is 0 in every step; or ``any``: the sum of the largest of several columns, such as the hours with at least
    one limit broken. ``factor`` converts the column's unit to the one shown.

    The ``moment`` says whether a value belongs to the ``start`` of its step, from where it holds, or to its ``end``. ``limits`` names the
    task's constraint that belongs to it, if any. A ``slow`` curve is first shown over the whole episode, as sums are, and not over a few
    days. ``span`` is the range of values shown first; ``None``: as the values are.
    """

    path: str
    title: str
    unit: str
    columns: tuple[str, ...]
    form: Literal["value", "sum", "beyond", "any"] = "value"
    factor: float = 1.0
    moment: Moment = "end"
    limits: str | None = None
    shared: bool = False
    slow: bool = False
    span: tuple[float, float] | None = None

    @property
    def summed(self) -> bool:
        """Whether it is a sum, which begins at 0."""
        return self.form in ("sum", "any")

    @property
    def whole(self) -> bool:
        """Whether it is first shown over the whole episode."""
        return self.slow or self.summed

    @property
    def heading(self) -> str:
        """Title with unit."""
        return f"{self.title} [{self.unit}]"

    def values(self, columns: Columns) -> Floats:
        """The curve ``(steps,)`` from the columns of a record, in ``unit``."""
        arrays = [columns[name] for name in self.columns]
        if self.form == "beyond":
            return arrays[1] - arrays[0]
        if self.form == "any":
            return np.cumsum(np.max(arrays, axis=0))
        curve: Floats = arrays[0] * self.factor
        if self.form == "value":
            return curve
        summed: Floats = np.cumsum(curve)
        for other in arrays[1:]:
            summed = summed + np.cumsum(other * self.factor)
        return summed


@dataclass(frozen=True)
class Page:
    """A page of plots in the viewer."""

    title: str
    curves: tuple[Curve, ...]


LineKind = Literal["light", "grown", "used", "earned", "paid", "violations", "profit", "score"]


@dataclass(frozen=True)
class Line:
    """One line of a run's accounts: what is summed over the steps of a week, or of any other part of the run.

    ``name`` is unique among the lines. The ``kind`` ``light`` is shown as the mean of a day; ``grown`` and ``used`` are amounts, the others
    money or points. ``factor`` converts the ``column`` of the record to ``unit``. A ``formula`` is summed instead of a column: the amount
    of each step ``(steps,)`` from ``control`` and ``disturbance``.
    """

    name: str
    title: str
    unit: str
    kind: LineKind
    column: str = ""
    factor: float = 1.0
    formula: Formula | None = None


@dataclass(frozen=True)
class Amount:
    """What the card tells of a harvest: the sum of ``column``, then ``words``, as in ``kg/m² of fruit grown``."""

    column: str
    words: str


@dataclass(frozen=True)
class Signals:
    """What is recorded and shown of runs of one task.

    ``recorded`` are all columns but the agent's actions, in the order of the record; ``formulas`` what is ``derived``, in the order of its
    source; ``clock`` the column with the hour of day of the greenhouse's clock at the end of each step.

    ``pages`` have the curves; ``overview`` has the paths of its own, column by column: outcome, climate, controls. ``worst`` is the column
    with whose largest sums the days to look at closely are found. ``names`` is how the card calls a constraint, ``prices`` the task's
    prices in words, as in ``heat 0.09 EUR/kWh``; ``total``, ``income``, ``costs``, ``harvest`` and ``reward`` are columns whose sums it
    tells of every controller. ``set_points`` are the entries of the task's actions that are no controls, ``accounts`` what a run grew, used
    and earned, line by line.
    """

    recorded: tuple[Signal, ...]
    pages: tuple[Page, ...]
    overview: tuple[tuple[str, ...], ...]
    worst: str
    names: Mapping[str, str]
    prices: tuple[str, ...]
    total: str
    income: tuple[str, ...]
    costs: tuple[str, ...]
    harvest: tuple[Amount, ...]
    reward: str
    formulas: tuple[Formula, ...] = ()
    clock: str = CLOCK[0]
    set_points: tuple[Action, ...] = ()
    accounts: tuple[Line, ...] = ()

    @property
    def curves(self) -> tuple[Curve, ...]:
        """All curves."""
        return tuple(curve for page in self.pages for curve in page.curves)

    @property
    def needed(self) -> tuple[str, ...]:
        """Columns that a record must have to be shown."""
        of_curves = (name for curve in self.curves for name in curve.columns)
        of_card = (self.worst, self.total, *self.income, *self.costs, *(amount.column for amount in self.harvest))
        return tuple(dict.fromkeys((*of_curves, *of_card, self.reward)))

    def vector(self, source: Source) -> tuple[Signal, ...]:
        """The signals of a source, in the order of its vector."""
        return tuple(sorted((one for one in self.recorded if one.source == source), key=lambda one: one.index))

    def derived(self, vectors: Vectors) -> Floats:
        """What follows from the numbers of a run, ``(rows, formulas)``.

        ``vectors`` has ``state`` and ``air`` of ``steps + 1`` moments, the start included, or of the ``steps`` after it: these are the
        rows. It has ``clock`` of all ``steps + 1`` moments [hours of day], and ``control`` and ``disturbance`` of the ``steps``.
        """
        rows = len(vectors["state"])
        values = np.empty((rows, len(self.formulas)))
        for column, formula in enumerate(self.formulas):
            values[:, column] = formula(vectors)[-rows:]
        return values

    def lacking(self, columns: Iterable[str]) -> Signals:
        """What can be shown without ``columns``: the curves that need none of them."""
        missing = set(columns)
        pages = tuple(
            Page(page.title, curves)
            for page in self.pages
            if (curves := tuple(curve for curve in page.curves if missing.isdisjoint(curve.columns)))
        )
        paths = {curve.path for page in pages for curve in page.curves}
        overview = tuple(tuple(path for path in column if path in paths) for column in self.overview)
        return replace(self, pages=pages, overview=tuple(column for column in overview if column))

    @property
    def width(self) -> int:
        """Numbers to keep of a run in a step: those that do not follow from the others or from its season."""
        return sum(signal.source not in ("disturbance", "clock", "derived", "camera") for signal in self.recorded)

    def groups(self, agent_columns: Iterable[str], *, controls: bool) -> tuple[Group, ...]:
        """All groups, in the order of the record: what acts during a step, then its result.

        ``agent_columns`` are the controls that the agent drives, or its set points; ``controls``: a privileged agent sets controls itself.
        """
        what = "control asked for" if controls else "action"
        words = {signal.name: ("-", f"{what}: {signal.meaning}") for signal in self.vector("control")}
        words |= {one.name: (one.unit, f"set point: {one.meaning}") for one in self.set_points}
        actions = (Column(f"action_{name}", *words[name]) for name in agent_columns)
        members: dict[str, list[Signal]] = {}
        for signal in self.recorded:
            members.setdefault(signal.group, []).append(signal)
        return (
            make_group(ACTION, actions, "start", at_start=False),
            *(
                make_group(
                    name,
                    (Column(one.name, one.unit, one.meaning) for one in listed),
                    "start" if listed[0].source in _ACTS else "end",
                    at_start=listed[0].source in _AT_START,
                )
                for name, listed in members.items()
            ),
        )

    def in_units(self, actions: NDArray[np.floating], agent_columns: Sequence[str]) -> NDArray[np.floating]:
        """Actions ``(steps, columns)`` as a record shows them: set points in their units, all else as it is."""
        scaled = {one.name: one for one in self.set_points if one.stands_for is not None}
        if scaled.keys().isdisjoint(agent_columns):
            return actions
        values = actions.astype(np.float64)
        for column, name in enumerate(agent_columns):
            if name in scaled:
                values[:, column] = scaled[name].value(values[:, column])
        return values

    def tables(self, vectors: Vectors) -> dict[str, Floats]:
        """Values ``(rows, columns)`` by group, of the sources ``(rows, entries)`` that are given."""
        places: dict[str, tuple[Source, list[int]]] = {}
        for signal in self.recorded:
            if signal.source in vectors:
                places.setdefault(signal.group, (signal.source, []))[1].append(signal.index)
        return {name: vectors[source][:, columns] for name, (source, columns) in places.items()}


@lru_cache(maxsize=32)
def signals_of(task: TaskSpec) -> Signals:
    """The description for ``task``. Raises ``TaskError`` when two columns of its record would have the same name."""
    model, ledger = task.model_value, task.ledger
    pages = _pages(task)
    paths = [curve.path for page in pages for curve in page.curves]
    recorded = _recorded(task)
    names = [one.name for one in recorded]
    for one in recorded:
        if names.count(one.name) > 1:
            msg = (
                f"{task.source}: '{one.name}' is the name of two columns of a record: of {model.id}, its climate, and the quantities of a "
                "step. Give one of them another name (in the ledger: amount = ...)."
            )
            raise TaskError(msg)
    return Signals(
        recorded=recorded,
        pages=pages,
        overview=_overview(task, paths),
        worst="penalty",
        names={name: entry.words for name, entry in quantities.AIR.items()},
        prices=tuple(_price(task, item) for item in (*ledger.earned, *ledger.paid)),
        total="epi",
        income=tuple(item.name for item in ledger.earned),
        costs=tuple(item.name for item in ledger.paid),
        harvest=tuple(
            Amount(item.amount, f"{unit}/m² of {what}" if unit else f"{what} per m²")
            for item in _by_amount(ledger.earned)
            if not _is_energy(item)
            for unit in [quantities.unit_sold(item.amount_unit)]
            for what in [quantities.in_sentence(_amount_title(item).partition(",")[0])]
        ),
        reward="reward",
        formulas=tuple(formula for _, formula in _derived(task)),
        set_points=tuple(action for action in task.actions if action.name not in task.actuation.controls),
        accounts=_accounts(task),
    )


_AIR = ("air_temperature", "relative_humidity", "co2")  # What is measured in the main air, in the order shown
_DEFICITS = {"vapour_pressure_deficit": vapour_pressure_deficit, "humidity_deficit": humidity_deficit}
"""What follows from temperature and humidity of the main air."""
_HOUR = CLOCK[0]
_TITLES = {"climate": "Climate", "crop": "Crop and harvest", "controls": "Controls", "weather": "Weather", "energy": "Energy and CO₂"}
"""Pages that a model's signals may be on, in their order; other groups of signals follow, each with a page."""
_KWH = "kWh m-2"
_TOTALS: Mapping[str, LineKind] = {"epi": "profit", "penalty": "violations", "reward": "score"}
_ONE, _PERCENT = "–", "%"
_SHUT_TO_OPEN = (-5.0, 105.0)  # Range of the controls [%], with room for lines at its ends
_COLUMNS_OF_CONTROLS = 4


def _recorded(task: TaskSpec) -> tuple[Signal, ...]:
    """Controls, weather, climate, crop, other states, clock, what is derived, money and amounts, violations."""
    model = task.model_value
    crop = model.crop_states
    states = [Signal(s.name, s.unit, s.meaning, "crop" if s.name in crop else "state", "state", i) for i, s in enumerate(model.states)]
    amounts = [
        Signal(q.name, q.unit, q.meaning, "violations" if beyond else "economics", "quantity", i)
        for i, q in enumerate(task.quantities)
        for beyond in [q.name == "penalty" or q.name.startswith((quantities.VIOLATION, quantities.OUTSIDE))]
    ]
    return (
        *(Signal(c.name, "-", c.meaning, "controls", "control", i) for i, c in enumerate(model.controls)),
        *(Signal(d.name, d.unit, d.meaning, "weather", "disturbance", i) for i, d in enumerate(model.disturbances)),
        *(
            Signal(name, entry.unit, entry.meaning, "climate", "air", i)
            for i, (name, entry) in enumerate(quantities.AIR.items())
            if model.air is not None
        ),
        *sorted((one for one in states if one.group == "crop"), key=lambda one: crop.index(one.name)),
        *(one for one in states if one.group == "state"),
        Signal(_HOUR, quantities.CLOCK[_HOUR].unit, quantities.CLOCK[_HOUR].meaning, "clock", "clock", 0),
        *(Signal(column.name, column.unit, column.meaning, "derived", "derived", i) for i, (column, _) in enumerate(_derived(task))),
        *([Signal(SCENE, "-", "scene of the library in the last picture", "camera", "camera", 0)] if task.camera is not None else []),
        *(one for one in amounts if one.group == "economics"),
        *(one for one in amounts if one.group == "violations"),
    )


def _derived(task: TaskSpec) -> list[tuple[Column, Formula]]:
    """What follows from the numbers of a run: of the model, and of its air."""
    model = task.model_value
    nominal: Any = model.Parameters(*task.parameters().tolist())

    def of_states(of: Callable[[Any, Any], Any]) -> Formula:
        return lambda vectors: np.asarray(of(model.State(*vectors["state"].T), nominal), dtype=np.float64)

    def of_air(formula: Callable[[Any, Any], Any]) -> Formula:
        temperature, humidity = (list(quantities.AIR).index(name) for name in ("air_temperature", "relative_humidity"))
        return lambda vectors: formula(vectors["air"][:, temperature], vectors["air"][:, humidity])

    def of_day(rate: Callable[[Any, Any, Any], Any]) -> Formula:
        rates = _rates(task, rate)
        return lambda vectors: daily_sums(rates(vectors), vectors["clock"][:, 0], task.step_seconds)

    columns: list[tuple[Column, Formula]] = []
    for series in model.signals():
        column = Column(series.path.rpartition("/")[2], quantities.plain_unit(series.unit), series.label)
        if series.of is not None:
            columns.append((column, of_states(series.of)))
        elif series.today is not None:
            columns.append((column, of_day(series.today)))
    if model.air is not None:
        columns += [(Column(name, entry.unit, entry.label), of_air(_DEFICITS[name])) for name, entry in quantities.DEFICITS.items()]
    return columns


def _pages(task: TaskSpec) -> tuple[Page, ...]:
    model = task.model_value
    limited = [name for name, _ in task.constraints.items()]
    curves: dict[str, list[Curve]] = {group: [] for group in _TITLES}
    if model.air is not None:
        curves["climate"] += (
            Curve(
                f"climate/{name}", quantities.AIR[name].label, quantities.raised_unit(quantities.AIR[name].unit), (name,),
                limits=name if name in limited else None,
            )
            for name in _AIR
        )  # fmt: skip
        curves["climate"] += (
            Curve(f"climate/{name}", entry.label, quantities.raised_unit(entry.unit), (name,))
            for name, entry in quantities.DEFICITS.items()
        )
    earned = [item for item in _by_amount(task.ledger.earned) if not _is_energy(item)]
    if len(earned) > 1 and len({item.amount_unit for item in earned}) == 1:  # such as fruit on the plants and fruit picked
        first, *others = (_amount_title(item) for item in earned)
        title = f"{' and '.join([first, *map(quantities.in_sentence, others)])}, summed"
        unit = quantities.raised_unit(earned[0].amount_unit)
        curves["crop"].append(Curve("crop/harvest", title, unit, tuple(item.amount for item in earned), "sum"))
    curves["crop"] += (_summed(f"crop/{item.amount}", _amount_title(item), item) for item in earned if item.valued == FLOW)
    for series in model.signals():
        curves.setdefault(series.path.partition("/")[0], []).append(_curve(model, series))
    curves["crop"] += (_summed(f"crop/{item.amount}", _amount_title(item), item) for item in earned if item.valued != FLOW)
    curves.setdefault("energy", []).extend(_energy(task))
    for quantity in task.quantities:
        if quantity.name in quantities.STEP and (page := quantities.STEP[quantity.name].page):
            title, unit = f"{quantities.STEP[quantity.name].label}, summed", _unit_of(quantity.unit)
            curves.setdefault(page, []).append(Curve(f"{page}/{quantity.name}", title, unit, (quantity.name,), "sum"))
    pages = [Page(_TITLES.get(group) or quantities.capitalised(group), tuple(listed)) for group, listed in curves.items() if listed]
    return (*pages, Page("Money", _money(task)), Page("Violations", _violations(task, limited)))


def _energy(task: TaskSpec) -> Iterable[Curve]:
    """What was bought and sold besides the harvest, and gas, summed from the start."""
    ledger = task.ledger
    for item in _by_amount((*(item for item in ledger.earned if _is_energy(item)), *ledger.paid)):
        yield _summed(f"energy/{item.amount}", _amount_title(item), item)
        if title := _gas(item):
            yield Curve(
                f"energy/{item.amount}_cubic_metres", f"{title}, summed", "m³ m⁻²", (item.amount,), "sum",
                1 / KWH_A_CUBIC_METRE,
            )  # fmt: skip


def _gas(item: LedgerItem) -> str:
    """What an amount is called in cubic metres of gas, for a boiler without losses (lower heating value); empty for most."""
    return quantities.FLOWS[item.flow].gas if item.flow in quantities.FLOWS else ""


def _is_energy(item: LedgerItem) -> bool:
    """Whether an item is heat or power, and no harvest."""
    return item.amount_unit == _KWH


def _accounts(task: TaskSpec) -> tuple[Line, ...]:
    """Light, what was grown, used and burnt, and the money of every item of the ledger, violations, profit and score."""
    ledger, units = task.ledger, {quantity.name: quantity.unit for quantity in task.quantities}

    def amount(item: LedgerItem) -> Iterable[Line]:
        kind: LineKind = "grown" if item.sign > 0 else "used"
        gained = "," * bool(item.counted) + " gained" if item.valued != FLOW else ""
        yield Line(item.amount, _amount_title(item) + gained, item.amount_unit, kind, item.amount)
        if title := _gas(item):
            name, factor = f"{item.amount}_cubic_metres", 1 / KWH_A_CUBIC_METRE
            yield Line(name, title, "m3 m-2", kind, item.amount, factor)

    def money(item: LedgerItem) -> Line:
        return Line(item.name, _label(item), item.unit, "earned" if item.sign > 0 else "paid", item.name)

    return (
        *_light(task),
        *(line for item in _by_amount((*ledger.earned, *ledger.paid)) for line in amount(item)),
        *(money(item) for item in (*ledger.earned, *ledger.paid)),
        *(Line(name, _total(name, units[name]), units[name], kind, name) for name, kind in _TOTALS.items()),
    )


def _total(name: str, unit: str) -> str:
    """What profit, penalty or reward is called, which may be in money."""
    entry = quantities.STEP[name]
    return entry.priced["label"] if entry.priced and unit == quantities.MONEY else entry.label


def _rates(task: TaskSpec, rate: Callable[[Any, Any, Any], Any]) -> Formula:
    """A rate of the model in each step ``(steps,)``, from controls and weather."""
    model = task.model_value
    nominal: Any = model.Parameters(*task.parameters().tolist())

    def rates(vectors: Vectors) -> Floats:
        u, d = model.Controls(*vectors["control"].T), model.Disturbances(*vectors["disturbance"].T)
        return np.broadcast_to(np.asarray(rate(u, d, nominal), dtype=np.float64), len(vectors["control"]))

    return rates


def _light(task: TaskSpec) -> Iterable[Line]:
    """Daily light integrals: of PAR above the canopy as the model has it, and of the sun's outside."""

    def of(rate: Callable[[Any, Any, Any], Any], factor: float) -> Formula:
        rates = _rates(task, rate)
        return lambda vectors: rates(vectors) * (task.step_seconds * factor)

    for series in task.model_value.signals():
        name = series.path.rpartition("/")[2]
        if series.today is not None and name in quantities.LIGHT:
            words = quantities.LIGHT[name]
            formula = of(series.today, words.day_factor)
            yield Line(name, words.day, words.day_unit or words.unit, "light", formula=formula)


def _curve(model: Model, series: ModelSignal) -> Curve:
    """A series of the model."""
    group, _, name = series.path.rpartition("/")
    if series.of is not None or series.today is not None:
        return Curve(series.path, series.label, series.unit, (name,), shared=group == "weather", slow=group == "crop")
    control, weather = series.source in model.control_names, series.source in model.disturbance_names
    moment: Moment = "start" if control or weather else "end"
    words, span = (series.path, series.label, series.unit), _SHUT_TO_OPEN if control and series.unit == _PERCENT else None
    return Curve(*words, (series.source,), factor=series.factor, moment=moment, shared=weather, slow=group == "crop", span=span)


def _by_amount(items: Iterable[LedgerItem]) -> tuple[LedgerItem, ...]:
    """The items with an amount of their own: one amount may have two prices."""
    return tuple({item.amount: item for item in items}.values())


def _label(item: LedgerItem) -> str:
    """What an item is called."""
    entry = quantities.known_flow(item.flow, item.label)
    return (entry and entry.label) or f"{item.label.replace('CO2', 'CO₂') or quantities.capitalised(item.name)} {item.counted}".rstrip()


def _amount_title(item: LedgerItem) -> str:
    label = item.amount_label or (quantities.FLOWS[item.flow].amount_label if item.flow in quantities.FLOWS else "")
    return label or (_label(item) if item.label else quantities.capitalised(item.amount))


def _summed(path: str, title: str, item: LedgerItem) -> Curve:
    words = f"{title}, summed" if item.valued == FLOW else f"{title}{',' * bool(item.counted)} gained"
    return Curve(path, words, quantities.raised_unit(item.amount_unit), (item.amount,), "sum")


def _money(task: TaskSpec) -> tuple[Curve, ...]:
    def summed(name: str, title: str, unit: str) -> Curve:
        return Curve(f"money/{name}", f"{title}, summed", unit, (name,), "sum")

    ledger, units = task.ledger, {quantity.name: quantity.unit for quantity in task.quantities}
    profit = "Economic performance" if ledger.meaning.startswith("economic performance") else "Profit"
    return (
        summed("epi", f"{profit} (EPI)", "EUR m⁻²"),
        *(summed(i.name, f"Revenue of the {quantities.in_sentence(_label(i))}", quantities.raised_unit(i.unit)) for i in ledger.earned),
        *(summed(i.name, f"Cost of {quantities.in_sentence(_label(i))}", quantities.raised_unit(i.unit)) for i in ledger.paid),
        summed("reward", _total("reward", units["reward"]), _unit_of(units["reward"])),
    )


def _unit_of(unit: str) -> str:
    return _ONE if unit == "-" else quantities.raised_unit(unit)


def _violations(task: TaskSpec, limited: list[str]) -> tuple[Curve, ...]:
    hours = tuple(q.name for q in task.quantities if q.name.startswith(quantities.OUTSIDE))
    penalty = next(quantity.unit for quantity in task.quantities if quantity.name == "penalty")
    return (
        *(
            Curve(
                f"violations/{name}",
                f"{quantities.AIR[name].label} beyond its limits, − below, + above",
                quantities.raised_unit(quantities.AIR[name].unit),
                (f"{quantities.VIOLATION}{name}_low", f"{quantities.VIOLATION}{name}_high"),
                "beyond",
            )
            for name in _AIR
            if name in limited
        ),
        *([Curve("violations/hours", "Time outside the limits, summed", "h", hours, "any")] if hours else []),
        Curve("violations/penalty", f"{_total('penalty', penalty)}, summed", _unit_of(penalty), ("penalty",), "sum"),
    )


def _overview(task: TaskSpec, paths: list[str]) -> tuple[tuple[str, ...], ...]:
    """What was earned, grown, paid and broken; the climate and the sun; the first controls."""
    paid = task.ledger.paid
    cost = next((item for item in paid if item.flow == "electricity"), paid[0] if paid else None)

    def of(group: str, count: int) -> list[str]:
        return [path for path in paths if path.startswith(f"{group}/")][:count]

    outcome = ["money/epi", *of("crop", 1), *([f"money/{cost.name}"] if cost else []), "violations/hours"]
    columns = (outcome, [*of("climate", len(_AIR)), *of("weather", 1)], of("controls", _COLUMNS_OF_CONTROLS))
    return tuple(there for column in columns if (there := tuple(path for path in column if path in paths)))


def _price(task: TaskSpec, item: LedgerItem) -> str:
    """As in ``heat 0.09 EUR/kWh``; a price that changes with the calendar from its lowest to its highest."""
    unit = quantities.unit_sold(item.amount_unit)
    prices = task.price_tables[item.price].limits if isinstance(item.price, str) else (item.price,)
    price = " to ".join(f"{value:g}" for value in sorted({min(prices), max(prices)}))
    return f"{item.goods or quantities.in_sentence(_label(item))} {price} EUR{f'/{unit}' if unit else ' each'}"
