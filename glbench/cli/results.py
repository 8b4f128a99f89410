"""``glbench show`` and ``glbench compare``: what agents earned and where, and whether a difference is more than luck."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.box import HEAVY_HEAD
from rich.markup import escape
from rich.table import Table

from glbench.cli.console import harmless, messages, output, put_json, say, table
from glbench.cli.options import REPORTS, AsJson, Out
from glbench.errors import ResultError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from glbench.evaluation import Result, RunResult
    from glbench.leaderboard import StoredResult
    from glbench.leaderboard.catalogue import Catalogue, Metric
    from glbench.leaderboard.entries import Entry
    from glbench.leaderboard.estimates import Estimate
    from glbench.leaderboard.pairs import MetricPair, Pair

_BARS = "▁▂▃▄▅▆▇█"
_BAR_WIDTH, _MONEY_WIDTH = 40, 6
_SHOWN_FAILURES = 5
_SECTIONS = {"penalty", "amount", "outside"}
_MAY_BE_NOTHING = {"earned", "paid", "amount"}
_NOTHING = 1e-9
"""Less is rounding: a model's flows fade out, and are not cut."""
_SENTENCES = 3
_FEWEST_PAIRS = 2
"""Pairs of runs needed for an interval: a single pair has no variance."""
_NONE = "–"


def show(
    result: Annotated[str, typer.Argument(metavar="RESULT|AGENT", help="A result file, or the name of an agent.")],
    task: Annotated[
        list[str] | None,
        typer.Option(
            "--task", "-t", help="Of an agent: this task, id or file (.toml); repeatable. Default: the default task."
        ),
    ] = None,
    show_all: Annotated[bool, typer.Option("--all", help="Of an agent: all its tasks.")] = False,
    out: Out = REPORTS,
) -> None:
    """Show a result: every metric with its unit and interval, where the money went, how the runs differ."""
    from glbench.cli.stored import find_results, task_ids
    from glbench.tasks import usual_task

    found = find_results(result, task_ids(task or []), out)
    latest = max(found, key=lambda one: one.result.created)
    known = usual_task(one.result.task.id for one in found)
    usual = next((one for one in found if one.result.task.id == known), latest)
    shown = found if task or show_all else [usual]
    for one in shown:
        _show(one, _where_from(one, out))
    if len(shown) < len(found):
        words = f"'{result}' has results on {len(found)} tasks: --all, or --task ID, shows the others."
        messages().print(words, style="dim", markup=False)


def _where_from(shown: StoredResult, out: Path) -> list[str]:
    """Origin of the result, whether it was reproduced, and the trainings that it belongs to."""
    from glbench.leaderboard import rank
    from glbench.leaderboard.catalogue import catalogue
    from glbench.leaderboard.collect import own_and_released_results, published_expectations
    from glbench.leaderboard.tables import entry_label

    result = shown.result
    stored = [item for item in own_and_released_results(out)[0] if item.result.task.digest == result.task.digest]
    if all(item.result != result for item in stored):
        return []  # the digest of the runs leaves out what the file states of the agent
    expected = {task_id: one for task_id, one in published_expectations().items() if one.digest == result.task.digest}
    entries = [one for ranked in rank(stored, expected) for one in ranked.rows]
    for entry, row in [(one, row) for one in entries for row in one.results]:
        if (row.task_id, row.results_digest) != (shown.board, result.results_digest):
            continue
        checked = "reproduced by glbench verify" if row.reproduced else "not reproduced yet (glbench verify)"
        known = catalogue(shown.task)
        metric = known.score if shown.task is None else known.metrics[shown.task.evaluation.metric]
        source, mean = f"Source: {row.origin}; {checked}", entry.estimates.get(metric.name)
        if not entry.is_range or mean is None:
            return [source]
        others = ", ".join(one.agent for one in entry.results if one is not row)
        family = f"One of {entry_label(entry)}: {metric.said(mean.mean)}, {metric.number(mean.low)} to {metric.number(mean.high)}."
        return [source, f"{family} The others: {others}."]
    return []


def _show(stored: StoredResult, where_from: Sequence[str]) -> None:
    import numpy as np

    from glbench.leaderboard.catalogue import catalogue
    from glbench.leaderboard.fresh_draws import fresh_words
    from glbench.leaderboard.ranking import means_by_year
    from glbench.leaderboard.seen import seen_by, what_it_should_not_have_seen
    from glbench.leaderboard.statistics import worst_tenth
    from glbench.leaderboard.tables import SEEN_MARK

    result, known = stored.result, catalogue(stored.task)
    output().print(summary_table(result, known))
    output().print(f"\n[bold]Where the money went[/] (mean of {len(result.runs)} runs)")
    for line in money_lines(result, known):
        output().print(line)
    score = known.score if stored.task is None else known.metrics[stored.task.evaluation.metric]
    if score.name in result.runs[0].metrics:
        scores = sorted(result.values(score.name))
        if scores[0] < scores[-1]:
            spark = f"{score.number(scores[0])} {sparkline(scores)} {score.number(scores[-1])}"
            output().print(f"\n[bold]{score.heading or score.label}s[/], worst to best: {spark}", soft_wrap=True)
        years = [
            f"{one.year} {score.number(one.mean)} ({count(one.runs, 'run')})"
            for one in means_by_year([stored], score.name)
        ]
        if years:
            words = (
                f"By year (the year of most days of a season): {', '.join(years)}. Intervals do not cover other years."
            )
            output().print(words, soft_wrap=True)
        worst = min(result.runs, key=lambda run: run.metrics[score.name])
        output().print(f"Mean of the worst tenth (CVaR10): {score.said(float(worst_tenth(np.array(scores))))}")
        profit = worst.metrics.get(known.profit.name)
        words = "" if profit is None or score is known.profit else f", {known.profit.said(profit)}"
        output().print(f"Worst run: seed {worst.seed}, {score.said(worst.metrics[score.name])}{words}")
    print_failures(result)
    kernel, seen = result.evaluation.kernel, seen_by(result)
    unfair = what_it_should_not_have_seen(result, seen)
    stated = [
        f"decision {result.evaluation.decision_milliseconds:.3f} ms",
        f"sandbox {result.evaluation.sandbox or 'unknown'}",
        f"trained on: {seen.words}",
        f"made {result.created} with glbench {result.versions.glbench}",
        *([f"git {result.git.commit[:12]}{' with changes' if result.git.dirty else ''}"] if result.git else []),
        *([f"card by {', '.join(result.agent.card.authors)}"] if result.agent.card else []),
    ]
    lines = [
        *_regret_lines(stored, score),
        f"{result.agent.name} sees: {result.agent.information}",
        *([f"{SEEN_MARK} {result.agent.name} {unfair}"] if unfair else []),
        *([f"Salt commitment {result.task.salt_commitment}"] if result.task.salt_commitment else []),
        *([f"With fresh draws: {fresh_words(result, score)}"] if result.fresh_draws else []),
        f"Kernel {kernel.get('backend')}, preset {kernel.get('preset', _NONE)}; results digest {result.results_digest[:12]}",
        *where_from,
        f"Stated by the file, not checked: {'; '.join(stated)}",
    ]
    output().print()
    for line in lines:
        say(output(), escape(harmless(line)), style="dim")


def _regret_lines(stored: StoredResult, score: Metric) -> list[str]:
    """Whose the best known runs are, and what to do with better ones."""
    from glbench.leaderboard.regret import best_known_means, can_be_best_known, regret_of
    from glbench.leaderboard.tables import better_note
    from glbench.tasks.best_known import SEVERAL

    result = stored.result
    known, regret = best_known_means(result), regret_of([result])
    if known is None or regret is None:
        return []
    whose = "several agents" if known.agent == SEVERAL else known.agent
    lines = [f"Best known runs of the task: by {whose}, {score.said(known.reward)}; no bound, a better one may exist"]
    if regret.runs_ahead and not stored.released and can_be_best_known(result.agent):
        lines.append(better_note(result.agent.name, regret.runs_ahead, len(result.runs), str(stored.path)))
    return lines


def shown_metrics(known: Catalogue, held: Iterable[str], units: Mapping[str, str]) -> list[Metric]:
    """Metrics in the order of the terminal, time outside any limit before that outside each; then those that only the results know."""
    found = [known.metric(name, units) for name in known.known_first(held)]
    return sorted(found, key=lambda metric: (metric.kind == "unknown", metric.kind == "violation"))


def summary_table(result: Result, known: Catalogue) -> Table:
    """Mean, interquartile mean and 95 % interval of every metric, with units.

    Amounts and entries of the ledger that are nothing in all runs are only named.
    """
    from glbench.leaderboard.estimates import estimates_of
    from glbench.leaderboard.regret import LINES, METRICS, PARTS, regret_of

    runs = len(result.runs)
    headings: tuple[str, ...] = ("Sum over the period", "Unit")
    numbers: tuple[str, ...] = ("Mean", "IQM", "95 % interval")
    split = ", validation split" if result.task.split == "validation" else ""
    view = table(
        f"{escape(result.agent.name)} on {escape(result.task.id)}{split}: {count(runs, 'run')}",
        *headings, *numbers, right=numbers, folded=headings + numbers, box=HEAVY_HEAD,
        caption="IQM: mean of the middle half of the runs. 95 % interval: of the mean, Student's t.",
        caption_justify="left",
    )  # fmt: skip
    estimates, before, nothing = estimates_of(result), "", list[str]()
    for metric in shown_metrics(known, result.summary.mean, result.units):
        measured = metric.kind in _MAY_BE_NOTHING and metric.name in result.units
        if measured and max(map(abs, result.values(metric.name))) < _NOTHING:
            line = metric.line.strip().lower()
            nothing += [line] if line not in nothing else []
            continue
        if metric.kind != before and metric.kind in _SECTIONS:
            view.add_section()
        before = metric.kind
        cells = _cells(estimates.get(metric.name), metric, runs)
        view.add_row(metric.line, unit_of(metric), *cells)
    if nothing and isinstance(view.caption, str):
        view.caption += f" Zero in all runs: {', '.join(nothing)}."
    if regret := regret_of([result]):
        view.add_section()
        for part in PARTS:
            metric = known.metric(METRICS[part], result.units)
            cells = _cells(getattr(regret, part), metric, runs)
            view.add_row(LINES[part], unit_of(metric), *cells)
    view.add_section()
    evaluation = result.evaluation
    view.add_row("Decision, each step", "ms", f"{evaluation.decision_milliseconds:.3f}", "", "")
    view.add_row("Whole evaluation", "s", f"{evaluation.wall_seconds:.1f}", "", "")
    return view


def unit_of(metric: Metric) -> str:
    """Unit as people write it, or a dash."""
    from glbench.quantities import pretty_unit

    return pretty_unit(metric.unit) or _NONE


def _cells(estimate: Estimate | None, metric: Metric, runs: int) -> tuple[str, str, str]:
    if estimate is None:
        return _NONE, _NONE, _NONE
    low, high = metric.text(estimate.low), metric.text(estimate.high)
    interval = f"{low} to {high}" if runs > 1 and estimate.low < estimate.high else _NONE
    return metric.text(estimate.mean), metric.text(estimate.iqm), interval


def money_lines(result: Result, known: Catalogue) -> list[str]:
    """What was earned and paid as bars of one scale, and what is left."""
    mean = result.summary.mean
    items = [(item.short, item.sign * mean[item.money]) for item in known.items if item.money in mean]
    scale = max(*(abs(signed) for _, signed in items), 1e-9, 1e-9)
    profit, wide = known.profit, max([_MONEY_WIDTH, *(len(words) + 1 for words, _ in items)])
    lines = [
        f"  {words:<{wide}}{_signed(signed):>9} {unit_of(profit)}  [{'green' if signed >= 0.0 else 'red'}]"
        f"{'█' * round(_BAR_WIDTH * abs(signed) / scale)}[/]"
        for words, signed in items
    ]
    if profit.name in mean:
        lines.append(f"  [bold]{profit.heading:<{wide}}{_signed(mean[profit.name]):>9} {unit_of(profit)}[/]")
    return lines


def _signed(value: float) -> str:
    """With sign and three decimals; what rounds to zero has no sign."""
    return f"{value:+.3f}" if abs(value) >= 0.0005 else "0.000"


def sparkline(values: Sequence[float]) -> str:
    """One character a value, its height between the smallest and the largest."""
    low, high = min(values), max(values)
    if not high > low:
        return _BARS[0] * len(values)
    return "".join(_BARS[min(int((value - low) / (high - low) * len(_BARS)), len(_BARS) - 1)] for value in values)


def print_failures(result: Result) -> None:
    """Say loudly which runs failed and why; the same reason once."""
    if result.failed:
        messages().print(
            f"[bold red]{len(result.failed)} of {count(len(result.runs), 'run')} failed.[/bold red] Each of their missing steps counts as "
            "the task's price of a failed step, so these numbers are low."
        )
        print_reasons(result, _SHOWN_FAILURES)


def print_reasons(result: Result, most: int, indent: str = "  ") -> None:
    """Why runs failed, the same reason once, and at most so many."""
    groups: dict[tuple[str, str | None, int], list[RunResult]] = {}
    for run in result.failed:
        groups.setdefault((run.status, run.reason, run.steps), []).append(run)
    for (status, reason, steps), members in list(groups.items())[:most]:
        seeds = ", ".join(str(run.seed) for run in members[:3]) + (", ..." if len(members) > 3 else "")
        where = f"{count(steps, 'step')} ({count(len(members), 'run')}: seed {seeds})"
        messages().print(f"{indent}[red]{status}[/red] after {where}: {escape(harmless(reason or ''))}", soft_wrap=True)
    if len(groups) > most:
        messages().print(f"{indent}and {len(groups) - most} more kinds of failure; the result file has them all.")


def count(number: int, noun: str) -> str:
    """``1 run``, ``2 runs``."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def compare(
    first: Annotated[str, typer.Argument(metavar="A", help="A result file, or the name of an agent.")],
    second: Annotated[str, typer.Argument(metavar="B", help="The same of the other one.")],
    task: Annotated[
        list[str] | None,
        typer.Option("--task", "-t", help="This task: id or file (.toml); repeatable. Default: all that both have."),
    ] = None,
    out: Out = REPORTS,
    as_json: AsJson = False,
) -> None:
    """Compare two agents on the runs that both did: metric by metric, with intervals of the difference.

    Runs with the same seed have the same weather and the same crop, so they are compared in pairs (t-test of the difference of the means;
    over several tasks the p-values are corrected for their number). An agent with several trainings counts with their mean, and
    its interval covers how much they differ. The name of one of them, or a result file, means that training alone.
    """
    from glbench.cli.stored import task_ids
    from glbench.leaderboard.catalogue import together
    from glbench.leaderboard.collect import own_and_released_results, published_expectations
    from glbench.leaderboard.entries import entries_by_task
    from glbench.leaderboard.pairs import compare_entries, corrected_p_values

    tasks = task_ids(task or [])
    by_task = cache(lambda: entries_by_task(own_and_released_results(out)[0], published_expectations()))
    ours, theirs = _entries(first, tasks, out, by_task), _entries(second, tasks, out, by_task)
    common = [task_id for task_id in ours if task_id in theirs]
    if not common:
        msg = f"'{first}' has results on {', '.join(ours)}; '{second}' on {', '.join(theirs)}: none in common. Evaluate both on one task."
        raise ResultError(msg)
    if all(_digests(ours[task_id]) == _digests(theirs[task_id]) for task_id in common):
        msg = f"'{first}' and '{second}' are one and the same result. Give two agents, or two result files."
        raise ResultError(msg)
    pairs = [compare_entries(ours[task_id], theirs[task_id]) for task_id in common]
    judged = list(zip(pairs, corrected_p_values(pairs), strict=True))
    if as_json:
        put_json([_plain(pair, p) for pair, p in judged])
        return
    for task_id in common[:_SENTENCES]:
        where = f"{escape(task_id.rpartition('/')[2])}: " if len(pairs) > 1 else ""
        for words in _failures(ours[task_id], theirs[task_id]):
            say(output(), f"[red]{where}{escape(harmless(words))}[/].")
    if len(pairs) == 1:
        output().print(_metrics_table(pairs[0]))
    else:
        output().print(_tasks_table(judged))
        say(output(), _count(judged))
    for pair, p_value in judged[:_SENTENCES]:
        say(output(), _sentence(pair, p_value, named=len(pairs) > 1))
    if len(pairs) > _SENTENCES:
        words = f"In words for the first {_SENTENCES} tasks; --task ID shows every metric of one."
        messages().print(words, style="dim")
    words = (
        "Intervals: 95 %, Student's t over pairs of runs, and trainings where there are several; they and p cover the "
    )
    words += f"{together([pair.words for pair in pairs]).draws}. For an agent with one training they do not cover other trainings."
    if resolution := max(pair.resolution for pair in pairs):
        words += (
            f" Where a task draws nothing, a reward that differs by less than {resolution:g} differs by rounding, and there is no "
            "p-value (–)."
        )
    messages().print(words, style="dim", markup=False)
    for pair in pairs[:_SENTENCES]:
        if pair.by_year:
            metric = pair.words.metrics[pair.ranks_by]
            years = ", ".join(
                f"{year} {metric.text(gap)} ({count(runs, 'run')})" for year, (runs, gap) in pair.by_year.items()
            )
            where = f"{pair.task_id.rpartition('/')[2]}, " if len(pairs) > 1 else ""
            words = f"{where}A - B in {metric.words} by year: {years}. Intervals and p do not cover other years."
            say(output(), escape(harmless(words)))
    for entry in (ours[common[0]], theirs[common[0]]):
        if len(entry.trainings) > 1:
            messages().print(
                f"{entry.name} is the mean of {len(entry.trainings)} trainings.", style="dim", markup=False
            )


def _entries(
    wanted: str, tasks: Sequence[str], out: Path, by_task: Callable[[], Mapping[str, Sequence[Entry]]]
) -> dict[str, Entry]:
    """By task what ``wanted`` means: an agent with all its trainings, one training, or a result file. ``by_task`` reads all results."""
    from glbench.cli.stored import check_folder, find_results
    from glbench.leaderboard.entries import entry_of

    check_folder(out)
    if not (wanted.endswith(".json") or Path(wanted).is_file()):
        found = {
            task_id: entry
            for task_id, entries in by_task().items()
            for entry in entries
            if entry.name == wanted and (not tasks or task_id in tasks or task_id.rpartition("/")[2] in tasks)
        }
        if found:
            return found
    return {item.board: entry_of(item) for item in find_results(wanted, tasks, out)}


def _failures(one: Entry, other: Entry) -> list[str]:
    """Of each of the two that has failed runs among those that are compared, how many and how."""
    from glbench.leaderboard.pairs import failures

    shared = set(one.seeds) & set(other.seeds)
    told = [
        failures(entry.name, [run for item in entry.trainings for run in item.result.runs if run.seed in shared])
        for entry in (one, other)
    ]
    return [f"{words}; their missing steps count at the task's price of a failed step" for words in told if words]


def _digests(entry: Entry) -> list[str]:
    return [item.result.results_digest for item in entry.trainings]


def _metrics_table(pair: Pair) -> Table:
    from glbench.leaderboard.regret import LINES, METRICS

    def named(name: str, trainings: int) -> str:
        return escape(harmless(name)) + (f" ({trainings} trainings)" if trainings > 1 else "")

    view = table(
        f"{named(pair.first, pair.trainings[0])}, A, and {named(pair.second, pair.trainings[1])}, B, "
        f"on {escape(harmless(pair.task_id))}: {pair.runs} pairs of runs",
        "Sum over the period", "Unit", "A", "B", "A - B", "95 % interval",
        right=("A", "B", "A - B", "95 % interval"), folded=("Sum over the period",), padding=(0, 1, 0, 0),
    )  # fmt: skip
    shown = shown_metrics(pair.words, pair.metrics, {name: one.unit for name, one in pair.metrics.items()})
    rows = [(metric.line, metric, pair.metrics[metric.name]) for metric in shown]
    rows += [(LINES[part], pair.words.metric(METRICS[part], {}), one) for part, one in pair.regret.items()]
    for line, metric, one in rows:
        gap = one.difference
        values = (one.first, one.second, None if gap is None else gap.value)
        low, high = ("", "") if gap is None else (metric.text(gap.low), metric.text(gap.high))
        numbers = [_NONE if value is None else metric.text(value) for value in values]
        if all(value is None or _is_zero(metric.text(value)) for value in values):
            continue
        view.add_row(line, unit_of(metric), *numbers, f"{low} to {high}" if low != high else _NONE)
    return view


def _tasks_table(judged: Sequence[tuple[Pair, float]]) -> Table:
    from glbench.leaderboard.tables import chance_text

    pair = judged[0][0]
    shown = pair.words.headlines
    numbers = [*(metric.headed.replace(" [", "\n\\[") for metric in shown), "P(A > B)", "p"]
    title = f"{escape(harmless(pair.first))} (A) minus {escape(harmless(pair.second))} (B), task by task"
    view = table(title, "Task", *numbers, right=numbers, folded=("Task",), collapse_padding=True)
    for pair, p_value in judged:
        gaps = [(pair.gap(metric.name), metric.digits) for metric in shown]
        view.add_row(
            escape(harmless(pair.task_id.rpartition("/")[2])),
            *(_NONE if gap is None else f"{gap:+,.{digits}f}" for gap, digits in gaps),
            chance_text(pair.improvement.value),
            _p_words(pair, p_value),
        )
    return view


def _sentence(pair: Pair, p_value: float, *, named: bool) -> str:
    """Who has the higher score and whether that is sure, then who earns more, and from what."""
    names = harmless(pair.first), harmless(pair.second)
    where = f"{escape(pair.task_id.rpartition('/')[2])}: " if named else ""
    epi = pair.gap(pair.words.profit.name)
    if epi is None:
        return f"{where}{_verdict(pair, p_value)}"
    more, less = names if epi >= 0.0 else names[::-1]
    sign = 1.0 if epi >= 0.0 else -1.0
    labels = {item.money: item.words for item in pair.words.items}
    items = sorted(pair.money.items(), key=lambda item: -abs(item[1]))
    parts = ", ".join(f"{sign * value:+.3f} {labels[name]}" for name, value in items if abs(value) >= 0.0005)
    gap = f"earns {abs(epi):.3f} EUR/m² more than" if abs(epi) >= 0.0005 else "earns as much as"
    return f"{where}{_verdict(pair, p_value)} [bold]{escape(more)}[/] {gap} {escape(less)}{f' ({parts})' if parts else ''}."


def _verdict(pair: Pair, p_value: float) -> str:
    """Who has the higher score, by how much, and whether the test can tell the two apart."""
    better, worse = (escape(harmless(name)) for name in (pair.first, pair.second)[:: 1 if pair.headline >= 0 else -1])
    metric, words = pair.words.metrics[pair.ranks_by], _p_words(pair, p_value)
    shown = "nothing is drawn here" if words == _NONE else f"p < {words[1:]}" if words[0] == "<" else f"p = {words}"
    gap = f"{metric.text(abs(pair.headline))} {unit_of(metric)}".removesuffix(f" {_NONE}")
    is_same = _is_zero(metric.text(pair.headline))
    said = f"[bold]{better}[/] has the higher {metric.words}, by {gap} on average"
    if is_same:
        said = f"[bold]{better}[/] and [bold]{worse}[/] have the same mean {metric.words}"
    if is_same or pair.told_apart(p_value):
        return f"{said} ({shown})."
    if not pair.is_certain and pair.runs < _FEWEST_PAIRS:
        few = f"{count(pair.runs, 'pair')} of runs {'is' if pair.runs == 1 else 'are'} too few for the test to decide"
        return f"{said}, but {few}: it needs at least {_FEWEST_PAIRS} ({shown})."
    return f"{said}, but their {metric.words}s cannot be told apart ({shown})."


def _is_zero(text: str) -> bool:
    """Whether a number is 0 in the decimals that are shown."""
    return not text.strip("-0.,")


def _ranks_by(pair: Pair) -> str:
    """What ranks on the task, inside a sentence."""
    return pair.words.metrics[pair.ranks_by].words


def _p_words(pair: Pair, p_value: float) -> str:
    """A p-value, or a dash where a task draws nothing and there is no chance to test against."""
    if pair.is_certain:
        return _NONE
    return f"{p_value:.3f}" if p_value >= 0.001 else "<0.001"


def _count(judged: Sequence[tuple[Pair, float]]) -> str:
    """On how many tasks who is ahead."""
    clear = [pair for pair, p_value in judged if pair.told_apart(p_value)]
    ahead = sum(pair.headline > 0.0 for pair in clear)
    first, second = (escape(harmless(name)) for name in (judged[0][0].first, judged[0][0].second))
    return (
        f"[bold]{first}[/] has the higher {_ranks_by(judged[0][0])} on {ahead} of {len(judged)} tasks, {second} on {len(clear) - ahead}; "
        f"on {len(judged) - len(clear)} they cannot be told apart."
    )


def _plain(pair: Pair, p_value: float) -> dict[str, object]:
    one = pair.improvement
    return {
        "task": pair.task_id,
        "first": pair.first,
        "second": pair.second,
        "trainings": list(pair.trainings),
        "runs": pair.runs,
        "ranks_by": pair.ranks_by,
        "by_year": {str(year): {"runs": runs, "difference": gap} for year, (runs, gap) in pair.by_year.items()},
        "p_value_corrected": p_value,
        "probability_of_improvement": [one.value, one.low, one.high],
        "money [EUR m-2]": dict(pair.money),
        "metrics": _plain_metrics(pair.metrics),
        "regret": _plain_metrics(pair.regret),
    }


def _plain_metrics(metrics: Mapping[str, MetricPair]) -> dict[str, dict[str, float | None]]:
    found: dict[str, dict[str, float | None]] = {}
    for name, one in metrics.items():
        gap = one.difference
        ends = (None, None, None) if gap is None else (gap.value, gap.low, gap.high)
        found[name] = {
            "first": one.first,
            "second": one.second,
            **dict(zip(("difference", "low", "high"), ends, strict=True)),
        }
    return found
