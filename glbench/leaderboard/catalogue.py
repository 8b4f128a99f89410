"""What tables, the terminal and the report call things in a task: metrics, what is sold and bought, limits, controls, recorded columns.

Everything comes from the task: from its metrics, its ledger, its limits and its model; ``glbench.quantities`` has the words of what glbench
knows. ``catalogue.toml`` says what the pages of the report show where.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from itertools import cycle
from typing import Any, Literal

from glbench import quantities
from glbench.quantities import MONEY, in_sentence, pretty_unit, sentence, unit_sold
from glbench.registration import task_ids
from glbench.tasks import PAPER_TASK, TaskSpec, published_task
from glbench.tasks.ledger import FLOW, LedgerItem

Kind = Literal["score", "profit", "penalty", "earned", "paid", "amount", "violation", "outside", "unknown"]
_ORDER = ("score", "profit", "earned", "paid", "penalty", "amount", "violation", "outside", "unknown")
_DIGITS = {"EUR m-2": 3, "kWh m-2": 2, "kg m-2": 3, "h": 1}
_FEW_DIGITS = 2
_COLOURS = 8
_INKS = ("accent", "soft", "vent", "lamp")


@dataclass(frozen=True)
class Metric:
    """A metric: its unit in result files, and how it is shown; ``quantities.toml`` explains the fields."""

    name: str
    unit: str
    kind: Kind
    label: str
    decimals: int
    line: str
    better: Literal["high", "low"]
    explanation: str
    heading: str = ""
    digits: int = 2
    interval: bool = False

    @property
    def column(self) -> bool:
        """Whether it is a column of the leaderboard."""
        return bool(self.heading)

    @property
    def headed(self) -> str:
        """Heading with unit, as in ``Heat [kWh/m²]``."""
        unit = pretty_unit(self.unit)
        return f"{self.heading} [{unit}]" if unit else self.heading

    @property
    def words(self) -> str:
        """What it is called inside a sentence, such as ``reward``."""
        return in_sentence(self.heading or self.label)

    def number(self, value: float) -> str:
        """A value with the decimals of its column."""
        return f"{value:z,.{self.digits}f}"

    def phrase(self, value: float) -> str:
        """A value inside a sentence: ``reward 3,751.9``, ``score 4.321 EUR/m²``."""
        return " ".join(part for part in (self.words, self.number(value), pretty_unit(self.unit)) if part)

    def text(self, value: float) -> str:
        """A value with the decimals that its unit deserves."""
        return f"{value:z,.{_DIGITS.get(self.unit, _FEW_DIGITS)}f}"


@dataclass(frozen=True)
class Item:
    """What is sold (``sign`` 1) or bought (-1): its metrics of money and amount, and its column in profiles.

    ``unit`` is that of its price; ``table`` says that the price is not one number but changes with the calendar.
    """

    money: str
    amount: str
    column: str
    sign: int
    label: str
    short: str
    words: str
    unit: str
    colour: int
    least: float = 0.0
    table: bool = False


@dataclass(frozen=True)
class Catalogue:
    """What things are called. ``profit`` is what is earned minus what is paid, in words; ``lead`` and ``caution`` are the page's.

    ``draws`` is what an interval over runs covers besides one training, and ``beyond`` what it says nothing about.
    """

    metrics: Mapping[str, Metric]
    items: tuple[Item, ...]
    limits: Mapping[str, str]
    lead: str
    draws: str
    beyond: str
    caution: str = ""

    def known_first(self, names: Iterable[str]) -> list[str]:
        """All metrics of the task in their order, then those among ``names`` that it does not have."""
        return [*self.metrics, *(name for name in dict.fromkeys(names) if name not in self.metrics)]

    def metric(self, name: str, units: Mapping[str, str]) -> Metric:
        """A metric; one that is unknown here by its name, with its unit in ``units``."""
        return self.metrics.get(name) or unknown_metric(name, units.get(name, "-"))

    @property
    def score(self) -> Metric:
        """What ranks where no task says otherwise."""
        return self.of_kind("score")[0]

    @property
    def profit(self) -> Metric:
        """What is earned minus what is paid."""
        return self.of_kind("profit")[0]

    @property
    def columns(self) -> list[Metric]:
        """Metrics that are columns of the leaderboard."""
        return [metric for metric in self.metrics.values() if metric.column]

    @property
    def headlines(self) -> list[Metric]:
        """Columns that are shown with their intervals."""
        return [metric for metric in self.columns if metric.interval]

    def of_kind(self, *kinds: Kind) -> list[Metric]:
        """The metrics of these kinds, in their order."""
        return [metric for metric in self.metrics.values() if metric.kind in kinds]


@dataclass(frozen=True)
class Charts:
    """What the report draws of a task: controls, columns of profiles as series, and which of them stand where."""

    controls: tuple[str, ...]
    series: Mapping[str, Mapping[str, Any]]
    charts: Mapping[str, tuple[str, ...]]
    panels: tuple[Mapping[str, Any], ...]


def catalogue(*tasks: TaskSpec | None) -> Catalogue:
    """The catalogue of some tasks together; ``None``, or none at all, means a task that is not known: it is taken for the default one."""
    return together([_of_task(task or published_task(PAPER_TASK)) for task in dict.fromkeys(tasks or (None,))])


def catalogue_of(task: TaskSpec | None, units: Mapping[str, str]) -> Catalogue:
    """The catalogue of one task; of one that is not known, that of the default one with the units that its results state."""
    words = catalogue(task)
    if task is not None:
        return words
    metrics = {name: _in_unit(one, units.get(name, one.unit), priced=units.get("penalty") == MONEY) for name, one in words.metrics.items()}
    return replace(words, metrics=metrics)


def _in_unit(metric: Metric, unit: str, *, priced: bool) -> Metric:
    """``metric`` in another unit; where violations have prices, in the words for money."""
    words = _counted_words(metric.name, "what is earned minus what is paid", usual=False, money=unit == MONEY) if priced else {}
    return replace(metric, unit=unit, **words)


def of_published(task_ids_: Iterable[str]) -> Catalogue:
    """The catalogue of those among these tasks that are published."""
    return catalogue(*(published_task(task_id) for task_id in task_ids_ if task_id in task_ids()))


@cache
def _layout() -> Mapping[str, Any]:
    """What ``catalogue.toml`` says."""
    return tomllib.loads((resources.files("glbench.leaderboard") / "catalogue.toml").read_text(encoding="utf-8"))


@cache
def _of_task(task: TaskSpec) -> Catalogue:
    from glbench.evaluation.metrics import metrics_of

    limits = [name for name, _ in task.constraints.items()]
    usual = (  # the items, the limits and the reward of the paper
        {item.flow for item in task.ledger.items if _entry(item)} == set(_layout()["usual"]["flows"])
        and set(limits) == quantities.AIR.keys()
        and "scaled_epi" in task.reward.modules
    )
    has_several_seasons = task.splits is not None or task.scenario.generated is not None or len(task.scenario.seasons) > 1
    coverage = _layout()["coverage"]["several" if has_several_seasons else "one"]
    # What is known comes first: a stored task has its tables in another order than the file that it came from.
    items, flows = task.ledger.items, list(quantities.FLOWS)
    places = {item.name: flows.index(item.flow) - len(flows) if _entry(item) else items.index(item) for item in items}
    ledger_items = sorted(items, key=lambda item: (-item.sign, places[item.name]))
    earned, paid = (sentence([in_sentence(_label(item)) for item in ledger_items if item.sign == sign]) for sign in (1, -1))
    profit = " minus ".join(side for side in (earned, paid) if side)
    of_money = {item.name: item for item in ledger_items}
    of_amount = {item.amount: item for item in task.ledger.items}
    metrics, amounts = [], {}
    for one in metrics_of(task):
        if one.name in of_money:
            words = _money_words(of_money[one.name])
        elif one.quantity in of_amount:
            words, amounts[one.quantity] = _amount_words(of_amount[one.quantity]), one.name
        else:
            words = _counted_words(one.name, profit, usual=usual, money=bool(one.unit == MONEY and task.violation_prices))
        metrics.append(Metric(one.name, one.unit, **words) if words else unknown_metric(one.name, one.unit))
    fixed = [entry.colour if (entry := _entry(item)) else None for item in ledger_items]
    free = cycle(sorted(set(range(_COLOURS)) - set(fixed)) or range(_COLOURS))
    known_items = [
        _item(item, next(free) if colour is None else colour, amounts.get(item.amount, item.amount))
        for item, colour in zip(ledger_items, fixed, strict=True)
    ]
    places = {name: place for place, item in enumerate(known_items) for name in (item.money, item.amount)}
    metrics.sort(key=lambda metric: (_ORDER.index(metric.kind), places.get(metric.name, 0)))
    lead = (
        f"{coverage['run']}: they earn with {earned or 'nothing'} and pay for {paid or 'nothing'}"
        f"{', while the climate stays within limits' if limits else ''}."
    )
    return Catalogue(
        metrics={metric.name: metric for metric in metrics},
        items=tuple(known_items),
        limits={name: quantities.AIR[name].label for name in limits},
        lead=_layout()["usual"]["lead"].format(run=coverage["run"]) if usual else lead,
        draws=coverage["draws"],
        beyond=coverage["beyond"],
        caution=_layout()["usual"]["caution"] if usual else "",
    )


def _entry(item: LedgerItem) -> quantities.Entry | None:
    """The entry of what a ledger prices; none where the task calls it differently or values it otherwise."""
    entry = quantities.known_flow(item.flow, item.label) if item.valued == FLOW else None
    return entry if entry and entry.label else None


def _label(item: LedgerItem) -> str:
    entry = _entry(item)
    return entry.label if entry else f"{item.label or item.name} {item.counted}".rstrip()


def _counted_words(name: str, profit: str, *, usual: bool, money: bool) -> dict[str, Any]:
    """Words of a metric that no item of the ledger makes; empty for one that is unknown."""
    for limited in quantities.AIR.values():
        for side, words in (("low", limited.below), ("high", limited.above)):
            if name == f"hours_{limited.name}_{side}":
                return {"kind": "violation", "decimals": 1, "better": "low", **words}
    entry = quantities.STEP.get(name) or quantities.RUN.get(name)
    if entry is None:
        return {}
    words = {"label": entry.label, **entry.metric}
    elsewhere, in_money = words.pop("elsewhere", {}), words.pop("money", {})
    if not usual:
        words |= elsewhere
        words["explanation"] = words["explanation"].format(profit=profit)
    return words | (in_money if money else {})


def _money_words(item: LedgerItem) -> dict[str, Any]:
    sold, label, entry = item.sign > 0, _label(item), _entry(item)
    return {
        "kind": "earned" if sold else "paid",
        "label": label,
        "decimals": 2,
        "line": f"  {in_sentence(label) if sold else f'cost of {in_sentence(label)}'}",
        "better": "high" if sold else "low",
        "explanation": f"What {in_sentence(label)} {'earned' if sold else 'cost'} at the task's price.",
        **(entry.money if entry else {}),
    }


def _amount_words(item: LedgerItem) -> dict[str, Any]:
    label, entry = _label(item), _entry(item)
    meaning = item.amount_meaning or label
    return {
        "kind": "amount",
        "label": label,
        "decimals": 2,
        "line": label,
        "better": "high" if item.sign > 0 else "low",
        "explanation": f"{meaning[:1].upper()}{meaning[1:].rstrip('.')}.",
        "heading": label,
        "digits": 2,
        **(entry.amount if entry else {}),
    }


def _item(item: LedgerItem, colour: int, amount: str) -> Item:
    label, entry, sold = _label(item), _entry(item) or quantities.Entry(item.flow), unit_sold(item.amount_unit)
    return Item(
        money=item.name,
        amount=amount,
        column=item.amount,
        sign=item.sign,
        label=label,
        short=entry.short or in_sentence(label),
        words=entry.words or in_sentence(label),
        unit=f"EUR/{sold or 'piece'}" if "m-2" in item.amount_unit else f"EUR/(m² {item.amount_unit})",
        colour=colour,
        least=entry.least,
        table=isinstance(item.price, str),
    )


def together(catalogues: Sequence[Catalogue]) -> Catalogue:
    """Everything that is in one of them; where two explain one metric differently, both."""
    if len(catalogues) == 1:
        return catalogues[0]
    metrics: dict[str, Metric] = {}
    for metric in (metric for one in catalogues for metric in one.metrics.values()):
        other = metrics.setdefault(metric.name, metric)
        if metric.explanation not in other.explanation:
            metrics[metric.name] = replace(other, explanation=f"{other.explanation} Or: {metric.explanation}")
    ordered = sorted(metrics.values(), key=lambda metric: _ORDER.index(metric.kind))
    alike = len({one.draws for one in catalogues}) == 1
    coverage = {"draws": catalogues[0].draws, "beyond": catalogues[0].beyond} if alike else _layout()["coverage"]["both"]
    return Catalogue(
        metrics={metric.name: metric for metric in ordered},
        items=tuple({item.money: item for one in reversed(catalogues) for item in one.items}.values()),
        limits={name: label for one in catalogues for name, label in one.limits.items()},
        lead=catalogues[0].lead,
        draws=coverage["draws"],
        beyond=coverage["beyond"],
        caution=" ".join(dict.fromkeys(one.caution for one in catalogues if one.caution)),
    )


@cache
def charts_of(task: TaskSpec | None) -> Charts:
    """What the report draws of a task, or of one that is not known."""
    task = task or published_task(PAPER_TASK)
    layout, ledger = _layout(), task.ledger
    moved = task.actuation.controls  # what stands still or follows a calendar says nothing of an agent
    capacities = task.model_value.capacities(task.parameters_by_name())
    labels = {one.name: one.label or one.quantity.replace("_", " ").capitalize() for one in capacities if one.name in moved}
    controls = tuple(dict.fromkeys((*(name for name in layout["order"]["controls"] if name in labels), *labels)))
    share = {"unit": "%", "factor": 100, "decimals": 0, "range": [0, 102]}
    series = {name: _in_words(words, task) for name, words in quantities.charts().items()}
    for item in ledger.items:
        if item.amount not in series:
            unit, flow = pretty_unit(item.amount_unit), quantities.FLOWS.get(item.flow)
            words: dict[str, Any] = {"name": item.amount, "label": _label(item), "decimals": 3}
            words |= {"unit": f"{unit} an hour", "daily": f"{unit} a day"}
            words |= ({"amount": True} if item.valued == FLOW else {}) | ({"gas": flow.gas} if flow and flow.gas else {})
            series[item.amount] = words
        elif item.flow in quantities.FLOWS and not _entry(item):  # the ledger has a label of its own
            series[item.amount] = series[item.amount] | {"label": _label(item)}
    series |= {name: {"name": name, "label": labels[name], **share} for name in controls}
    sides = {
        side: tuple(dict.fromkeys(item.amount for item in items)) for side, items in (("earned", ledger.earned), ("paid", ledger.paid))
    }
    charts = {
        chart: tuple(dict.fromkeys(name for column in columns for name in sides.get(column, (column,))))
        for chart, columns in layout["charts"].items()
    }
    return Charts(controls, series, charts, tuple(_panels(task, controls, labels)))


def _panels(task: TaskSpec, controls: Sequence[str], labels: Mapping[str, str]) -> Iterator[Mapping[str, Any]]:
    """The panels of the worst run; then one for each control that is in none of them and has no place of its own."""
    layout = _layout()
    usual = layout["order"]["controls"]
    in_panels = set()
    for panel in (_in_words(panel, task) for panel in layout["panel"]):
        lines = [
            {"name": in_sentence(labels[line["column"]]), **line} if line.get("column") in labels else line
            for line in panel["lines"]
            if line.get("column") in labels or line.get("column") not in usual
        ]
        in_panels |= {line.get("column") for line in lines}
        if lines:
            yield panel | {"lines": lines}
    others = [name for name in controls if name not in usual and name not in in_panels]
    for place, name in enumerate(others):
        line = {"column": name, "name": labels[name], "ink": _INKS[place % len(_INKS)]}
        yield {"title": f"{labels[name]}, %", "lines": [line]}


def _in_words(words: Mapping[str, Any], task: TaskSpec) -> dict[str, Any]:
    """A series or a panel in the words for tasks in which violations have prices, or in those for others."""
    others = {key: value for key, value in words.items() if key != "priced"}
    return others | (words.get("priced", {}) if task.violation_prices else {})


def unknown_metric(name: str, unit: str) -> Metric:
    """A metric without words: it is called by its name."""
    return Metric(name, unit, "unknown", name, _FEW_DIGITS, name, "high", "")
