"""``glbench compare``: two agents side by side, and whether the difference is more than luck."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from glbench.cli.console import messages, output
from glbench.errors import ResultError

if TYPE_CHECKING:
    from rich.table import Table

    from glbench.leaderboard.pairs import Pair

_ITEMS = {"revenue": "fruit", "cost_heat": "heat", "cost_electricity": "light", "cost_co2": "CO2"}
_SENTENCES = 3
_NOT_DRAWN = "–"


def compare(
    first: Annotated[str, typer.Argument(metavar="A", help="A result file, or the name of an agent.")],
    second: Annotated[str, typer.Argument(metavar="B", help="The same of the other one.")],
    task: Annotated[
        list[str] | None, typer.Option("--task", "-t", help="This task (repeatable). Default: all that both have.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="Folder with results/ in it.")] = Path("reports"),
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON and nothing else.")] = False,
) -> None:
    """Compare two agents on the runs that both did: metric by metric, with intervals of the difference.

    Runs with the same seed met the same weather and the same crop, so they are compared in pairs (Wilcoxon signed-rank test; over several
    tasks the p-values are corrected for their number).
    """
    from glbench.cli.stored import find_results
    from glbench.leaderboard.comparisons import RESOLUTION
    from glbench.leaderboard.pairs import compare_results, corrected_p_values

    ours = {result.task.id: result for result in find_results(first, task or [], out)}
    theirs = {result.task.id: result for result in find_results(second, task or [], out)}
    common = [task_id for task_id in ours if task_id in theirs]
    if not common:
        msg = f"'{first}' has results on {', '.join(ours)}; '{second}' on {', '.join(theirs)}: none in common. Evaluate both on one task."
        raise ResultError(msg)
    if all(ours[task_id].results_digest == theirs[task_id].results_digest for task_id in common):
        msg = f"'{first}' and '{second}' are one and the same result. Give two agents, or two result files."
        raise ResultError(msg)
    pairs = [compare_results(ours[task_id], theirs[task_id]) for task_id in common]
    corrected = corrected_p_values(pairs)
    if as_json:
        output().out(
            json.dumps([_plain(pair, p) for pair, p in zip(pairs, corrected, strict=True)], indent=2), highlight=False
        )
        return
    if len(pairs) == 1:
        output().print(_metrics_table(pairs[0]))
    else:
        output().print(_tasks_table(pairs, corrected))
        output().print(_count(pairs, corrected), soft_wrap=True)
    for pair, p_value in list(zip(pairs, corrected, strict=True))[:_SENTENCES]:
        output().print(_sentence(pair, p_value, named=len(pairs) > 1), soft_wrap=True)
    if len(pairs) > _SENTENCES:
        messages().print(
            f"In words for the first {_SENTENCES} tasks; --task ID shows every metric of one.", style="dim"
        )
    messages().print(
        "Intervals: 95 %, bootstrap over pairs of runs. Where a task draws nothing, a reward that differs by less than "
        f"{RESOLUTION:g} differs by rounding, and there is no p-value (–).",
        style="dim",
    )


def _metrics_table(pair: Pair) -> Table:
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    from glbench.cli.evaluation_tables import label_of, metric_order, number_of, unit_of

    view = Table(
        title=f"{escape(pair.first)} (A) and {escape(pair.second)} (B) on {escape(pair.task_id)}: {pair.runs} pairs of runs",
        title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0),
    )  # fmt: skip
    for heading in ("Sum over the period", "Unit"):
        view.add_column(heading, no_wrap=True)
    for heading in ("A", "B", "A - B", "95 % interval"):
        view.add_column(heading, justify="right", no_wrap=True)
    for name in metric_order():
        one = pair.metrics[name]
        numbers = [number_of(name, value) for value in (one.first, one.second, one.difference.value)]
        low, high = (number_of(name, value) for value in (one.difference.low, one.difference.high))
        view.add_row(label_of(name), unit_of(name), *numbers, f"{low} to {high}" if low != high else "–")
    return view


def _tasks_table(pairs: list[Pair], corrected: list[float]) -> Table:
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    view = Table(
        title=f"{escape(pairs[0].first)} (A) minus {escape(pairs[0].second)} (B), task by task",
        title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, collapse_padding=True,
    )  # fmt: skip
    view.add_column("Task", overflow="fold")
    for heading in ("Reward", "EPI\n\\[EUR/m²]", "Penalty", "P(A > B)", "p"):
        view.add_column(heading, justify="right", no_wrap=True)
    for pair, p_value in zip(pairs, corrected, strict=True):
        differences = [pair.metrics[name].difference.value for name in ("reward", "epi", "penalty")]
        view.add_row(
            escape(pair.task_id.rpartition("/")[2]), f"{differences[0]:+,.1f}", f"{differences[1]:+,.3f}", f"{differences[2]:+,.1f}",
            f"{pair.improvement.value:.2f}", _p_words(pair, p_value),
        )  # fmt: skip
    return view


def _sentence(pair: Pair, p_value: float, *, named: bool) -> str:
    """Who earns more, and from what."""
    from rich.markup import escape

    epi = pair.metrics["epi"].difference.value
    more, less = (pair.first, pair.second) if epi >= 0.0 else (pair.second, pair.first)
    sign = 1.0 if epi >= 0.0 else -1.0
    items = sorted(pair.money.items(), key=lambda item: -abs(item[1]))
    parts = ", ".join(f"{sign * value:+.3f} {_ITEMS[name]}" for name, value in items if abs(value) >= 0.0005)
    verdict = (
        "Their rewards cannot be told apart"
        if not pair.told_apart(p_value)
        else f"{escape(pair.first if pair.metrics['reward'].difference.value > 0 else pair.second)} has the higher reward"
    )
    where = f"{escape(pair.task_id.rpartition('/')[2])}: " if named else ""
    words = _p_words(pair, p_value)
    shown = (
        "nothing is drawn here"
        if words == _NOT_DRAWN
        else f"p < {words[1:]}"
        if words.startswith("<")
        else f"p = {words}"
    )
    gap = f"earns {abs(epi):.3f} EUR/m² more than" if abs(epi) >= 0.0005 else "earns as much as"
    return f"{where}[bold]{escape(more)}[/] {gap} {escape(less)}{f' ({parts})' if parts else ''}. {verdict} ({shown})."


def _p_words(pair: Pair, p_value: float) -> str:
    """A p-value, or a dash where a task draws nothing and there is no chance to test against."""
    reward = pair.metrics["reward"].difference
    if reward.low == reward.high:
        return _NOT_DRAWN
    return f"{p_value:.3f}" if p_value >= 0.001 else "<0.001"


def _count(pairs: list[Pair], corrected: list[float]) -> str:
    """On how many tasks who is ahead."""
    from rich.markup import escape

    clear = [pair for pair, p_value in zip(pairs, corrected, strict=True) if pair.told_apart(p_value)]
    first = sum(pair.metrics["reward"].difference.value > 0.0 for pair in clear)
    words = [f"[bold]{escape(pairs[0].first)}[/] has the higher reward on {first} of {len(pairs)} tasks"]
    words.append(f"{escape(pairs[0].second)} on {len(clear) - first}")
    words.append(f"on {len(pairs) - len(clear)} they cannot be told apart")
    return ", ".join(words[:2]) + "; " + words[2] + "."


def _plain(pair: Pair, p_value: float) -> dict[str, object]:
    return {
        "task": pair.task_id,
        "first": pair.first,
        "second": pair.second,
        "runs": pair.runs,
        "p_value_corrected": p_value,
        "probability_of_improvement": [pair.improvement.value, pair.improvement.low, pair.improvement.high],
        "money [EUR m-2]": dict(pair.money),
        "metrics": {
            name: {
                "first": one.first, "second": one.second,
                "difference": one.difference.value, "low": one.difference.low, "high": one.difference.high,
            }
            for name, one in pair.metrics.items()
        },
    }  # fmt: skip
