"""``glbench compare``: two agents side by side, and whether the difference is more than luck."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from glbench.cli.console import harmless, messages, output, say
from glbench.errors import ResultError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.table import Table

    from glbench.leaderboard.entries import Entry
    from glbench.leaderboard.pairs import Pair

_ITEMS = {"revenue": "fruit", "cost_heat": "heat", "cost_electricity": "lamp electricity", "cost_co2": "CO2"}
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
    tasks the p-values are corrected for their number). Of an agent with several trainings (NAME, NAME_seed1, ...) the mean over them
    counts, run by run; NAME_seed1 or a result file means one training.
    """
    from glbench.leaderboard.comparisons import RESOLUTION
    from glbench.leaderboard.pairs import compare_entries, corrected_p_values
    from glbench.leaderboard.tables import COVERS

    ours, theirs = _entries(first, task or [], out), _entries(second, task or [], out)
    common = [task_id for task_id in ours if task_id in theirs]
    if not common:
        msg = f"'{first}' has results on {', '.join(ours)}; '{second}' on {', '.join(theirs)}: none in common. Evaluate both on one task."
        raise ResultError(msg)
    if all(_alike(ours[task_id], theirs[task_id]) for task_id in common):
        msg = f"'{first}' and '{second}' are one and the same result. Give two agents, or two result files."
        raise ResultError(msg)
    pairs = [compare_entries(ours[task_id], theirs[task_id]) for task_id in common]
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
        say(output(), _count(pairs, corrected))
    for pair, p_value in list(zip(pairs, corrected, strict=True))[:_SENTENCES]:
        say(output(), _sentence(pair, p_value, named=len(pairs) > 1))
    if len(pairs) > _SENTENCES:
        messages().print(
            f"In words for the first {_SENTENCES} tasks; --task ID shows every metric of one.", style="dim"
        )
    messages().print(
        f"Intervals: 95 %, bootstrap over pairs of runs; they and p cover the {COVERS}. Where a task draws nothing, a reward that "
        f"differs by less than {RESOLUTION:g} differs by rounding, and there is no p-value (–).",
        style="dim",
    )
    for entry in (ours[common[0]], theirs[common[0]]):
        if len(entry.trainings) > 1:
            messages().print(
                f"{entry.name} is the mean of {len(entry.trainings)} trainings; p says nothing about trainings that were not made.",
                style="dim",
                markup=False,
            )


def _entries(wanted: str, tasks: Sequence[str], out: Path) -> dict[str, Entry]:
    """By task what ``wanted`` means: an agent with all its trainings, one training, or a result file."""
    from glbench.cli.stored import check_folder, find_results
    from glbench.leaderboard.collect import StoredResult
    from glbench.leaderboard.entries import entries_by_task, entry_of
    from glbench.leaderboard.published import own_and_released_results, published_expectations

    check_folder(out)
    if not (wanted.endswith(".json") or Path(wanted).is_file()):
        stored, _ = own_and_released_results(out)
        found = {
            task_id: entry
            for task_id, entries in entries_by_task(stored, published_expectations()).items()
            for entry in entries
            if entry.name == wanted and (not tasks or task_id in tasks or task_id.rpartition("/")[2] in tasks)
        }
        if found:
            return found
    return {result.task.id: entry_of(StoredResult(Path(wanted), result)) for result in find_results(wanted, tasks, out)}


def _alike(first: Entry, second: Entry) -> bool:
    """Whether two entries hold the same results."""
    digests = [[item.result.results_digest for item in entry.trainings] for entry in (first, second)]
    return digests[0] == digests[1]


def _named(name: str, trainings: int) -> str:
    """A name with the number of its trainings, as markup."""
    from rich.markup import escape

    return escape(harmless(name)) + (f" ({trainings} trainings)" if trainings > 1 else "")


def _metrics_table(pair: Pair) -> Table:
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    from glbench.cli.evaluation_tables import label_of, metric_order, number_of, unit_of

    view = Table(
        title=f"{_named(pair.first, pair.trainings[0])}, A, and {_named(pair.second, pair.trainings[1])}, B, "
        f"on {escape(harmless(pair.task_id))}: {pair.runs} pairs of runs",
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

    from glbench.leaderboard.suite_views import chance_text

    view = Table(
        title=f"{escape(harmless(pairs[0].first))} (A) minus {escape(harmless(pairs[0].second))} (B), task by task",
        title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, collapse_padding=True,
    )  # fmt: skip
    view.add_column("Task", overflow="fold")
    for heading in ("Reward", "EPI\n\\[EUR/m²]", "Penalty", "P(A > B)", "p"):
        view.add_column(heading, justify="right", no_wrap=True)
    for pair, p_value in zip(pairs, corrected, strict=True):
        differences = [pair.metrics[name].difference.value for name in ("reward", "epi", "penalty")]
        view.add_row(
            escape(harmless(pair.task_id.rpartition("/")[2])), f"{differences[0]:+,.1f}", f"{differences[1]:+,.3f}",
            f"{differences[2]:+,.1f}", chance_text(pair.improvement.value), _p_words(pair, p_value),
        )  # fmt: skip
    return view


def _sentence(pair: Pair, p_value: float, *, named: bool) -> str:
    """Who earns more, and from what."""
    from rich.markup import escape

    epi = pair.metrics["epi"].difference.value
    names = harmless(pair.first), harmless(pair.second)
    more, less = names if epi >= 0.0 else names[::-1]
    sign = 1.0 if epi >= 0.0 else -1.0
    items = sorted(pair.money.items(), key=lambda item: -abs(item[1]))
    parts = ", ".join(f"{sign * value:+.3f} {_ITEMS[name]}" for name, value in items if abs(value) >= 0.0005)
    verdict = (
        "Their rewards cannot be told apart"
        if not pair.told_apart(p_value)
        else f"{escape(names[pair.metrics['reward'].difference.value <= 0])} has the higher reward"
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
    words = [f"[bold]{escape(harmless(pairs[0].first))}[/] has the higher reward on {first} of {len(pairs)} tasks"]
    words.append(f"{escape(harmless(pairs[0].second))} on {len(clear) - first}")
    words.append(f"on {len(pairs) - len(clear)} they cannot be told apart")
    return ", ".join(words[:2]) + "; " + words[2] + "."


def _plain(pair: Pair, p_value: float) -> dict[str, object]:
    return {
        "task": pair.task_id,
        "first": pair.first,
        "second": pair.second,
        "trainings": list(pair.trainings),
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
