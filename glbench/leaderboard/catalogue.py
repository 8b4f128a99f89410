"""What tables, the terminal and the report call things in a task: metrics, what is sold and bought, limits, controls, recorded columns.

Everything comes from the task: from its metrics, its ledger, its limits and its model. ``catalogue.toml`` has better words for some of it.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any, Literal

from glbench.registration import task_ids
from glbench.tasks import PAPER_TASK, published_task
from glbench.tasks.ledger import FLOW, MONEY

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec
    from glbench.tasks.ledger import LedgerItem

Kind = Literal["score", "profit", "penalty", "earned", "paid", "amount", "violation", "outside", "unknown"]
_ORDER = ("score", "profit", "earned", "paid", "penalty", "amount", "violation", "outside", "unknown")
_DIGITS = {"EUR m-2": 3, "kWh m-2": 2, "kg m-2": 3, "h": 1}
_FEW_DIGITS = 2
_COLOURS = 8


@dataclass(frozen=True)
class Metric:
    """A metric: its unit in result files, and how it is shown; ``catalogue.toml`` explains the fields."""

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
        return f"{value:,.{self.digits}f}"

    def said(self, value: float) -> str:
        """A value inside a sentence: ``reward 3,751.9``, ``score 4.321 EUR/m²``."""
        return " ".join(part for part in (self.words, self.number(value), pretty_unit(self.unit)) if part)

    def text(self, value: float) -> str:
        """A value with the decimals that its unit deserves."""
        return f"{value:,.{_DIGITS.get(self.unit, _FEW_DIGITS)}f}"


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
class Drawn:
    """What the report draws of a task: controls, columns of profiles as series, and which of them stand where."""

    controls: tuple[str, ...]
    series: Mapping[str, Mapping[str, Any]]
    charts: Mapping[str, tuple[str, ...]]
    panels: tuple[Mapping[str, Any], ...]


def catalogue(*tasks: TaskSpec | None) -> Catalogue:
    """The catalogue of some tasks together; ``None``, or none at all, means a task that is not known: it is taken for the default one."""
    found = [_of_task(task or published_task(PAPER_TASK)) for task in dict.fromkeys(tasks or (None,))]
    return together(found)


def of_published(task_ids_: Iterable[str]) -> Catalogue:
    """The catalogue of those among these tasks that are published."""
    return catalogue(*(published_task(task_id) for task_id in task_ids_ if task_id in task_ids()))


def has_several_seasons(task: TaskSpec) -> bool:
    """Whether runs of the task are in different seasons."""
    scenario = task.scenario
    return task.splits is not None or scenario.generated is not None or len(scenario.seasons) > 1


@cache
def _words() -> Mapping[str, Any]:
    words = tomllib.loads((resources.files("glbench.leaderboard") / "catalogue.toml").read_text(encoding="utf-8"))
    return words | {name: {entry["name"]: entry for entry in words[name]} for name in ("metric", "limit")} | {
        "item": {entry["flow"]: entry for entry in words["item"]}
    }  # fmt: skip


@cache
def _of_task(task: TaskSpec) -> Catalogue:
    from glbench.evaluation.metrics import metrics_of

    told, ledger, limits = _words(), task.ledger, [name for name, _ in task.constraints.items()]
    known = {item.name: _known(item) for item in ledger.items}
    usual = (
        {item.flow for item in ledger.items if known[item.name]} == told["item"].keys()
        and set(limits) == told["limit"].keys()
        and "scaled_epi" in task.reward.modules
    )
    of_money = {item.name: item for item in ledger.items}
    of_amount = {item.amount: item for item in ledger.items}
    labels = {item.name: known[item.name].get("label") or item.label or item.name for item in ledger.items}
    # What is known comes first: a stored task has its tables in another order than the file that it came from.
    flows = {item.name: place for place, item in enumerate(ledger.items)} | {
        item.name: list(told["item"]).index(item.flow) - len(told["item"]) for item in ledger.items if known[item.name]
    }
    ledger_items = sorted(ledger.items, key=lambda item: (-item.sign, flows[item.name]))
    earned, paid = (
        sentence([in_sentence(labels[item.name]) for item in ledger_items if item.sign == sign]) for sign in (1, -1)
    )
    profit = " minus ".join(side for side in (earned, paid) if side)
    metrics, amounts = {}, {}
    for one in metrics_of(task):
        if one.name in of_money:
            item = of_money[one.name]
            words = _money_words(item, labels[item.name]) | known[item.name].get("money", {})
            metric = Metric(one.name, one.unit, **words)
        elif one.quantity in of_amount:
            item = of_amount[one.quantity]
            words = _amount_words(item, labels[item.name]) | known[item.name].get("amount", {})
            metric, amounts[item.amount] = Metric(one.name, one.unit, **words), one.name
        elif one.name in told["metric"]:
            words = {
                key: value
                for key, value in told["metric"][one.name].items()
                if key not in ("name", "elsewhere", "money")
            }
            if not usual:
                words |= told["metric"][one.name].get("elsewhere", {})
                words["explanation"] = words["explanation"].format(profit=profit)
            if one.unit == MONEY and task.violation_prices:
                words |= told["metric"][one.name].get("money", {})
            metric = Metric(one.name, one.unit, **words)
        else:
            metric = unknown_metric(one.name, one.unit)
        metrics[one.name] = metric
    items = [
        _item(item, place, labels[item.name], known[item.name], amounts.get(item.amount, item.amount))
        for place, item in enumerate(ledger_items)
    ]
    places = {name: place for place, item in enumerate(items) for name in (item.money, item.amount)}
    ordered = sorted(metrics.values(), key=lambda metric: (_ORDER.index(metric.kind), places.get(metric.name, 0)))
    coverage = told["coverage"]["several" if has_several_seasons(task) else "one"]
    lead = (
        f"{coverage['run']}: they earn with {earned or 'nothing'} and pay for {paid or 'nothing'}"
        f"{', while the climate stays within limits' if limits else ''}."
    )
    return Catalogue(
        metrics={metric.name: metric for metric in ordered},
        items=tuple(items),
        limits={name: told["limit"].get(name, {}).get("label", name) for name in limits},
        lead=told["usual"]["lead"].format(run=coverage["run"]) if usual else lead,
        draws=coverage["draws"],
        beyond=coverage["beyond"],
        caution=told["usual"]["caution"] if usual else "",
    )


def _known(item: LedgerItem) -> Mapping[str, Any]:
    """Words for what a ledger prices; none where the task calls it differently or values it otherwise."""
    found: Mapping[str, Any] = _words()["item"].get(item.flow, {}) if item.valued == FLOW else {}
    return found


def _money_words(item: LedgerItem, label: str) -> dict[str, Any]:
    sold = item.sign > 0
    return {
        "kind": "earned" if sold else "paid",
        "label": label,
        "decimals": 2,
        "line": f"  {in_sentence(label) if sold else f'cost of {in_sentence(label)}'}",
        "better": "high" if sold else "low",
        "explanation": f"What {in_sentence(label)} {'earned' if sold else 'cost'} at the task's price.",
    }


def _amount_words(item: LedgerItem, label: str) -> dict[str, Any]:
    return {
        "kind": "amount",
        "label": label,
        "decimals": 2,
        "line": label,
        "better": "high" if item.sign > 0 else "low",
        "explanation": _sentence_of(item.amount_meaning or label),
        "heading": label,
        "digits": 2,
    }


def _item(item: LedgerItem, place: int, label: str, known: Mapping[str, Any], amount: str) -> Item:
    return Item(
        money=item.name,
        amount=amount,
        column=item.amount,
        sign=item.sign,
        label=label,
        short=known.get("short", in_sentence(label)),
        words=known.get("words", in_sentence(label)),
        unit=f"EUR/{unit_sold(item) or 'piece'}" if "m-2" in item.amount_unit else f"EUR/(m² {item.amount_unit})",
        colour=known.get("colour", place % _COLOURS),
        least=known.get("least", 0.0),
        table=isinstance(item.price, str),
    )


def unit_sold(item: LedgerItem) -> str:
    """What a price is for: ``kg`` where amounts are in kg m-2; empty where they are counted."""
    return item.amount_unit.removesuffix("m-2").strip(" -")


def together(found: Sequence[Catalogue]) -> Catalogue:
    """Everything that is in one of them; where two explain one metric differently, both."""
    if len(found) == 1:
        return found[0]
    metrics: dict[str, Metric] = {}
    for metric in (metric for one in found for metric in one.metrics.values()):
        other = metrics.setdefault(metric.name, metric)
        if metric.explanation not in other.explanation:
            metrics[metric.name] = replace(other, explanation=f"{other.explanation} Or: {metric.explanation}")
    ordered = sorted(metrics.values(), key=lambda metric: _ORDER.index(metric.kind))
    alike = len({one.draws for one in found}) == 1
    coverage = {"draws": found[0].draws, "beyond": found[0].beyond} if alike else _words()["coverage"]["both"]
    return Catalogue(
        metrics={metric.name: metric for metric in ordered},
        items=tuple({item.money: item for one in reversed(found) for item in one.items}.values()),
        limits={name: label for one in found for name, label in one.limits.items()},
        lead=found[0].lead,
        draws=coverage["draws"],
        beyond=coverage["beyond"],
        caution=" ".join(dict.fromkeys(one.caution for one in found if one.caution)),
    )


@cache
def drawn(task: TaskSpec | None) -> Drawn:
    """What the report draws of a task, or of one that is not known."""
    task = task or published_task(PAPER_TASK)
    told, ledger = _words(), task.ledger
    labels = {one.name: one.label or one.name for one in task.model_value.capacities(task.parameters_by_name())}
    controls = [*(name for name in told["order"]["controls"] if name in labels), *labels]
    names = tuple(dict.fromkeys(controls))
    share = {"unit": "%", "factor": 100, "decimals": 0, "range": [0, 102]}
    series = {one["name"]: _in_words(one, task) for one in told["series"]}
    series |= {item.amount: _series(item, task) for item in ledger.items if item.amount not in series}
    series |= {name: {"name": name, "label": labels[name], **share} for name in names}
    sides = {"earned": _columns(ledger.earned), "paid": _columns(ledger.paid)}
    charts = {
        chart: tuple(dict.fromkeys(name for column in columns for name in sides.get(column, (column,))))
        for chart, columns in told["charts"].items()
    }
    missing = _missing(told, names)
    lined = [
        panel | {"lines": [line for line in panel["lines"] if line.get("column") not in missing]}
        for panel in (_in_words(panel, task) for panel in told["panel"])
    ]
    shown = {line.get("column") for panel in lined for line in panel["lines"]}
    others = [name for name in names if name not in {*told["order"]["controls"], *shown}]
    inks = ("accent", "soft", "vent", "lamp")
    lined += [
        {"title": f"{labels[name]}, %", "lines": [{"column": name, "name": labels[name], "ink": inks[place % len(inks)]}]}
        for place, name in enumerate(others)
    ]  # fmt: skip
    return Drawn(names, series, charts, tuple(panel for panel in lined if panel["lines"]))


def _in_words(series: Mapping[str, Any], task: TaskSpec) -> dict[str, Any]:
    """A series or a panel in the words for tasks in which violations have prices, or in those for others."""
    words = {key: value for key, value in series.items() if key != "priced"}
    return words | (series.get("priced", {}) if task.violation_prices else {})


def _columns(items: Iterable[LedgerItem]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(item.amount for item in items))


def _missing(told: Mapping[str, Any], controls: Sequence[str]) -> set[str]:
    """Controls with words that the task's model does not have."""
    return set(told["order"]["controls"]) - set(controls)


def _series(item: LedgerItem, task: TaskSpec) -> dict[str, Any]:
    """An amount as a chart."""
    label, unit = (
        _of_task(task).items[[*task.ledger.earned, *task.ledger.paid].index(item)].label,
        pretty_unit(item.amount_unit),
    )
    words = {"name": item.amount, "label": label, "unit": f"{unit} an hour", "decimals": 3, "daily": f"{unit} a day"}
    gas = {"gas": "Natural gas"} if item.flow == "gas" else {}
    return words | ({"amount": True} if item.valued == FLOW else {}) | gas


def unknown_metric(name: str, unit: str) -> Metric:
    """A metric without words: it is called by its name."""
    return Metric(name, unit, "unknown", name, _FEW_DIGITS, name, "high", "")


def pretty_unit(unit: str) -> str:
    """A unit as people write it: ``EUR/m²`` for ``EUR m-2``; empty for none."""
    text = re.sub(
        r"(?:^| )(\w+?)-(\d)",
        lambda match: f"/{match[1]}{'' if match[2] == '1' else '²' if match[2] == '2' else '³'}",
        unit,
    )
    return {"-": "", "degC": "°C"}.get(text, text)


def in_sentence(label: str) -> str:
    """A label inside a sentence: ``heat`` for ``Heat``; ``CO₂`` stays."""
    return label if label[1:2].isupper() else label[:1].lower() + label[1:]


def sentence(words: Sequence[str]) -> str:
    """``heat, light and CO2``."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def _sentence_of(words: str) -> str:
    return f"{words[:1].upper()}{words[1:].rstrip('.')}."
