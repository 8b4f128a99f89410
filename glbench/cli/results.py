"""``glbench show``, one result, and ``glbench compare``, two agents on the same runs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.box import HEAVY_HEAD

from glbench.cli import console, options
from glbench.cli.console import Markup, count, plain, styled
from glbench.cli.console import show as show_view
from glbench.cli.options import REPORTS
from glbench.errors import ResultError, refuse

if TYPE_CHECKING:
    from glbench.evaluation import Result, RunResult
    from glbench.leaderboard import StoredResult
    from glbench.leaderboard.catalogue import Catalogue, Metric
    from glbench.leaderboard.entries import Entry
    from glbench.leaderboard.pairs import MetricPair, Pair
    from glbench.leaderboard.statistics import Estimate

_BARS = "▁▂▃▄▅▆▇█"
_BAR_WIDTH, _MONEY_WIDTH = 40, 6
_MOST_FAILURES = 5
_SECTIONS = {"penalty", "amount", "outside"}
_MAY_BE_NOTHING = {"earned", "paid", "amount"}
_NOTHING = 1e-9  # Smaller values are rounding: a model's flows fade out, and are not cut
_SENTENCES = 3
_FEWEST_PAIRS = 2  # Pairs of runs needed for an interval: a single pair has no variance
_NONE = "–"


def show(
    result: Annotated[str, typer.Argument(metavar="RESULT|AGENT", help="A result file, or the name of an agent.")],
    task: Annotated[
        list[str] | None,
        typer.Option("--task", "-t", help="Of an agent: this task, id or file (.toml); repeatable. Default: the default task."),
    ] = None,
    show_all: Annotated[bool, typer.Option("--all", help="Of an agent: all its tasks.")] = False,
    out: options.Out = REPORTS,
) -> None:
    """Show a result: every metric with its unit and interval, where the money went, how the runs differ."""
    from glbench.tasks import usual_task

    results = options.find_results(result, options.task_ids(task or []), out)
    latest = max(results, key=lambda one: one.result.created)
    usual = usual_task(one.result.task.id for one in results)
    first = next((one for one in results if one.result.task.id == usual), latest)
    selection = results if task or show_all else [first]
    for one in selection:
        console.put_parts(result_parts(one, _origin(one, out)))
    if len(selection) < len(results):
        others = f"'{result}' has {len(results)} results: --all, or --task ID, shows the others."
        console.put_parts([console.Line(others, "dim", aside=True, wrap="always")])


def _origin(stored: StoredResult, out: Path) -> list[str]:
    """Origin of the result, whether it was reproduced, and the trainings that it belongs to."""
    from glbench.leaderboard import rank
    from glbench.leaderboard.catalogue import catalogue_of
    from glbench.leaderboard.collect import own_and_released_results, published_expectations
    from glbench.leaderboard.tables import entry_label

    result = stored.result
    same_task = [item for item in own_and_released_results(out)[0] if item.result.task.digest == result.task.digest]
    if all(item.result != result for item in same_task):
        return []  # the digest of the runs leaves out what the file states of the agent
    expected = {task_id: one for task_id, one in published_expectations().items() if one.digest == result.task.digest}
    entries = [one for ranked in rank(same_task, expected) for one in ranked.rows]
    for entry, row in [(one, row) for one in entries for row in one.results]:
        if (row.task_id, row.results_digest) != (stored.board, result.results_digest):
            continue
        checked = "reproduced by glbench verify" if row.reproduced else "not reproduced yet (glbench verify)"
        metric = _score(stored, catalogue_of(stored.task, stored.result.units))
        source, mean = f"Source: {row.origin}; {checked}", entry.estimates.get(metric.name)
        if not entry.is_range or mean is None:
            return [source]
        others = ", ".join(one.agent for one in entry.results if one is not row)
        family = f"One of {entry_label(entry)}: {metric.phrase(mean.mean)}, {metric.number(mean.low)} to {metric.number(mean.high)}."
        return [source, f"{family} The others: {others}."]
    return []


def _score(stored: StoredResult, words: Catalogue) -> Metric:
    """The metric that ranks on the result's task."""
    return words.score if stored.task is None else words.metrics[stored.task.evaluation.metric]


def result_parts(stored: StoredResult, origin: Sequence[str]) -> Iterator[console.Part]:
    """A result: metrics, money, runs, and how it was made."""
    from glbench.leaderboard.catalogue import catalogue_of
    from glbench.leaderboard.fresh_draws import fresh_words
    from glbench.leaderboard.tables import SEEN_MARK
    from glbench.leaderboard.training_data import contamination_warning, training_data_of

    result = stored.result
    words = catalogue_of(stored.task, result.units)
    score = _score(stored, words)
    yield summary_table(result, words)
    yield console.Line(Markup(f"\n[bold]Where the money went[/] (mean of {console.count(len(result.runs), 'run')})"), wrap="always")
    for line in money_lines(result, words):
        yield console.Line(line, wrap="always")
    if score.name in result.runs[0].metrics:
        yield from _run_lines(stored, words, score)
    yield from failure_lines(result)
    kernel, training_data = result.evaluation.kernel, training_data_of(result)
    unfair = contamination_warning(result, training_data)
    unchecked = [
        f"decision {result.evaluation.decision_milliseconds:.3f} ms",
        f"sandbox {result.evaluation.sandbox or 'unknown'}",
        f"trained on: {training_data.words}",
        f"made {result.created} with glbench {result.versions.glbench}",
        *([f"git {result.git.commit[:12]}{' with changes' if result.git.dirty else ''}"] if result.git else []),
        *([f"card by {', '.join(result.agent.card.authors)}"] if result.agent.card else []),
    ]
    lines = [
        *_best_known_lines(stored, score),
        f"{result.agent.name} sees: {result.agent.information}",
        *([f"{SEEN_MARK} {result.agent.name} {unfair}"] if unfair else []),
        *([f"Salt commitment {result.task.salt_commitment}"] if result.task.salt_commitment else []),
        *([f"With fresh draws: {fresh_words(result, score)}"] if result.fresh_draws else []),
        f"Kernel {kernel.get('backend')}, preset {kernel.get('preset', _NONE)}; results digest {result.results_digest[:12]}",
        *origin,
        f"Stated by the file, not checked: {'; '.join(unchecked)}",
    ]
    yield console.Line("")
    for line in lines:
        yield console.paragraph(" ".join(line.split()), "dim")  # a card's line break must not look like a line of ours


def _run_lines(stored: StoredResult, words: Catalogue, score: Metric) -> Iterator[console.Line]:
    """How the runs differ: all scores, means by year, the worst ones."""
    import numpy as np

    from glbench.leaderboard.ranking import means_by_year
    from glbench.leaderboard.statistics import worst_tenth

    result = stored.result
    scores = sorted(result.values(score.name))
    if scores[0] < scores[-1]:
        spark = f"{score.number(scores[0])} {sparkline(scores)} {score.number(scores[-1])}"
        yield console.Line(Markup(f"\n[bold]{score.heading or score.label}s[/], worst to best: {spark}"))
    years = [f"{one.year} {score.number(one.mean)} ({count(one.runs, 'run')})" for one in means_by_year([stored], score.name)]
    if years:
        yield console.Line(f"By year (the year of most days of a season): {', '.join(years)}. Intervals do not cover other years.")
    yield console.Line(f"Mean of the worst tenth (CVaR10): {score.phrase(float(worst_tenth(np.array(scores))))}", wrap="always")
    worst = min(result.runs, key=lambda run: run.metrics[score.name])
    profit = worst.metrics.get(words.profit.name)
    earned = "" if profit is None or score is words.profit else f", {words.profit.phrase(profit)}"
    yield console.Line(f"Worst run: seed {worst.seed}, {score.phrase(worst.metrics[score.name])}{earned}", wrap="always")


def _best_known_lines(stored: StoredResult, score: Metric) -> list[str]:
    """Owner of the best known runs, and how to submit better ones."""
    from glbench.leaderboard.regret import best_known_means, can_be_best_known, regret_of
    from glbench.leaderboard.tables import better_note, regrets_of_first
    from glbench.tasks.references import SEVERAL

    result = stored.result
    best, regret = best_known_means(result), regret_of([result])
    if best is None or regret is None:
        return []
    whose = "several agents" if best.agent == SEVERAL else best.agent
    lines = [f"Best known runs of the task: by {whose}, {score.phrase(best.reward)}; no bound, a better one may exist"]
    if regret.runs < len(result.runs):
        lines.append(regrets_of_first(best))
    if regret.runs_ahead and not stored.released and can_be_best_known(result.agent):
        lines.append(better_note(result.agent.name, regret.runs_ahead, regret.runs, str(stored.path)))
    return lines


def ordered_metrics(words: Catalogue, names: Iterable[str], units: Mapping[str, str]) -> list[Metric]:
    """Metrics in the order of the terminal, time outside any limit before that outside each; then those that only the results have."""
    metrics = [words.metric(name, units) for name in words.known_first(names)]
    return sorted(metrics, key=lambda metric: (metric.kind == "unknown", metric.kind == "violation"))


def summary_table(result: Result, words: Catalogue) -> console.Table:
    """Mean, interquartile mean and 95 % interval of every metric, with units.

    Amounts and entries of the ledger that are zero in all runs are listed in the caption.
    """
    from glbench.leaderboard.regret import LINES, METRICS, PARTS, regret_of
    from glbench.leaderboard.statistics import estimates_of

    def cells(estimate: Estimate | None, metric: Metric) -> tuple[str, str, str]:
        if estimate is None:
            return _NONE, _NONE, _NONE
        low, high = metric.text(estimate.low), metric.text(estimate.high)
        interval = f"{low} to {high}" if len(result.runs) > 1 and estimate.low < estimate.high else _NONE
        return metric.text(estimate.mean), metric.text(estimate.iqm), interval

    numbers = ("Mean", "IQM", "95 % interval")
    headings = ("Sum over the period", "Unit", *numbers)
    split = ", validation split" if result.task.split == "validation" else ""
    view = console.table(
        f"{result.agent.name} on {result.task.id}{split}: {count(len(result.runs), 'run')}",
        *headings, numbers=numbers, fold=headings, box=HEAVY_HEAD,
        caption="IQM: mean of the middle half of the runs. 95 % interval: of the mean, Student's t.",
        caption_justify="left",
    )  # fmt: skip
    estimates, before, zero = estimates_of(result), "", dict[str, None]()
    for metric in ordered_metrics(words, result.summary.mean, result.units):
        measured = metric.kind in _MAY_BE_NOTHING and metric.name in result.units
        if measured and max(map(abs, result.values(metric.name))) < _NOTHING:
            zero[metric.line.strip().lower()] = None
            continue
        if metric.kind != before and metric.kind in _SECTIONS:
            view.end_section()
        before = metric.kind
        view.add(metric.line, unit_of(metric), *cells(estimates.get(metric.name), metric))
    if zero:
        view.caption = f"{view.caption} Zero in all runs: {', '.join(zero)}."
    if regret := regret_of([result]):
        view.end_section()
        for part in PARTS:
            metric = words.metric(METRICS[part], result.units)
            view.add(LINES[part], unit_of(metric), *cells(getattr(regret, part), metric))
        if regret.runs < len(result.runs):
            view.caption = f"{view.caption} Regrets are means over runs with a best known plan: {regret.runs} of {len(result.runs)}."
    view.end_section()
    evaluation = result.evaluation
    view.add("Decision, each step", "ms", f"{evaluation.decision_milliseconds:.3f}", "", "")
    view.add("Whole evaluation", "s", f"{evaluation.wall_seconds:.1f}", "", "")
    return view


def unit_of(metric: Metric) -> str:
    """Unit as people write it, or a dash."""
    from glbench.quantities import pretty_unit

    return pretty_unit(metric.unit) or _NONE


def money_lines(result: Result, words: Catalogue) -> list[str]:
    """Revenue and costs as bars of one scale, and the profit."""

    def signed(value: float) -> str:
        return f"{value:+.3f}" if abs(value) >= 0.0005 else "0.000"

    mean = result.summary.mean
    items = [(item.short, item.sign * mean[item.money]) for item in words.items if item.money in mean]
    scale = max([1e-9, *(abs(value) for _, value in items)])
    profit, wide = words.profit, max([_MONEY_WIDTH, *(len(name) + 1 for name, _ in items)])
    lines = [
        f"  {name:<{wide}}{signed(value):>9} {unit_of(profit)}  [{'green' if value >= 0.0 else 'red'}]"
        f"{'█' * round(_BAR_WIDTH * abs(value) / scale)}[/]"
        for name, value in items
    ]
    if profit.name in mean:
        lines.append(f"  [bold]{profit.heading:<{wide}}{signed(mean[profit.name]):>9} {unit_of(profit)}[/]")
    return [Markup(line) for line in lines]


def sparkline(values: Sequence[float]) -> str:
    """One character per value, its height between the smallest and the largest."""
    low, high = min(values), max(values)
    if not high > low:
        return _BARS[0] * len(values)
    return "".join(_BARS[min(int((value - low) / (high - low) * len(_BARS)), len(_BARS) - 1)] for value in values)


def failure_lines(result: Result) -> Iterator[console.Line]:
    """Which runs failed and why; the same reason once."""
    if result.failed:
        yield console.Line(
            Markup(
                f"[bold red]{len(result.failed)} of {count(len(result.runs), 'run')} failed.[/bold red] Each of their missing steps counts "
                "as the task's price of a failed step, so these numbers are low."
            ),
            aside=True,
            wrap="always",
        )
        yield from reason_lines(result, _MOST_FAILURES)


def reason_lines(result: Result, most: int, indent: str = "  ") -> Iterator[console.Line]:
    """Why runs failed, the same reason once, and at most so many."""
    groups: dict[tuple[str, str | None, int], list[RunResult]] = {}
    for run in result.failed:
        groups.setdefault((run.status, run.reason, run.steps), []).append(run)
    for (status, reason, steps), members in list(groups.items())[:most]:
        seeds = ", ".join(str(run.seed) for run in members[:3]) + (", ..." if len(members) > 3 else "")
        where = f"{count(steps, 'step')} ({count(len(members), 'run')}: {'seed' if len(members) == 1 else 'seeds'} {seeds})"
        yield console.aside(Markup(f"{indent}[red]{status}[/red] after {where}: {plain(reason or '')}"))
    if len(groups) > most:
        yield console.aside(f"{indent}and {len(groups) - most} more kinds of failure; the result file has them all.")


def compare(
    first: Annotated[str, typer.Argument(metavar="A", help="A result file, or the name of an agent.")],
    second: Annotated[str, typer.Argument(metavar="B", help="The same of the other one.")],
    task: Annotated[
        list[str] | None, typer.Option("--task", "-t", help="This task: id or file (.toml); repeatable. Default: all that both have.")
    ] = None,
    out: options.Out = REPORTS,
    as_json: options.AsJson = False,
) -> None:
    """Compare two agents on the runs that both did: metric by metric, with intervals of the difference.

    Runs with the same seed have the same weather and the same crop, so they are compared in pairs (t-test of the difference of the means;
    over several tasks the p-values are corrected for their number). An agent with several trainings counts with their mean, and
    its interval covers how much they differ. The name of one of them, or a result file, means that training alone.
    """
    from glbench.leaderboard.collect import own_and_released_results, published_expectations
    from glbench.leaderboard.entries import entries_by_task
    from glbench.leaderboard.pairs import compare_entries
    from glbench.leaderboard.statistics import corrected

    tasks = options.task_ids(task or [])
    by_task = cache(lambda: entries_by_task(own_and_released_results(out)[0], published_expectations()))
    ours, theirs = _entries(first, tasks, out, by_task), _entries(second, tasks, out, by_task)
    common = [task_id for task_id in ours if task_id in theirs]
    if not common:
        msg = f"'{first}' has results on {', '.join(ours)}; '{second}' on {', '.join(theirs)}: none in common. Evaluate both on one task."
        raise ResultError(msg)

    has = {part for one in common for board in (one, one.partition("@")[0]) for part in (board, board.rpartition("/")[2])}
    if lacking := [one for one in tasks if one not in has]:
        refuse(f"'{first}' and '{second}' have no results in common on {', '.join(lacking)}. Leave it out.", ResultError)

    def digests(entry: Entry) -> list[str]:
        return [item.result.results_digest for item in entry.trainings]

    if all(digests(ours[task_id]) == digests(theirs[task_id]) for task_id in common):
        refuse(f"'{first}' and '{second}' are one and the same result. Give two agents, or two result files.", ResultError)
    entries = [(ours[task_id], theirs[task_id]) for task_id in common]
    pairs = [compare_entries(one, other) for one, other in entries]
    tests = list(zip(pairs, corrected([pair.p_value for pair in pairs]), strict=True))
    view = console.View(_comparison_parts(entries, tests), lambda: [_document(pair, p_value) for pair, p_value in tests])
    show_view(view, as_json=as_json)


def _entries(name: str, tasks: Sequence[str], out: Path, by_task: Callable[[], Mapping[str, Sequence[Entry]]]) -> dict[str, Entry]:
    """By task what ``name`` means: an agent with all its trainings, one training, or a result file. ``by_task`` reads all results."""
    from glbench.leaderboard.entries import entry_of

    options.check_folder(out)
    if not options.is_file(name):
        entries = {
            task_id: entry
            for task_id, of_task in by_task().items()
            for entry in of_task
            if entry.name == name and (not tasks or task_id in tasks or task_id.rpartition("/")[2] in tasks)
        }
        if entries:
            return entries
    return {item.board: entry_of(item) for item in options.find_results(name, tasks, out)}


def _comparison_parts(entries: Sequence[tuple[Entry, Entry]], tests: Sequence[tuple[Pair, float]]) -> Iterator[console.Part]:
    from glbench.leaderboard.catalogue import together

    pairs = [pair for pair, _ in tests]
    several = len(pairs) > 1
    for both, pair in zip(entries[:_SENTENCES], pairs, strict=False):
        for words in _failures(*both):
            yield console.paragraph(Markup(f"[red]{plain(_place(pair, named=several))}{plain(words)}[/]."))
    if several:
        yield _tasks_table(tests)
        yield console.paragraph(_counts(tests))
    else:
        yield _metrics_table(pairs[0])
    for pair, p_value in tests[:_SENTENCES]:
        yield console.paragraph(Markup(plain(_place(pair, named=several)) + _sentence(pair, p_value)))
    if len(pairs) > _SENTENCES:
        words = f"In words for the first {_SENTENCES} tasks; --task ID shows every metric of one."
        yield console.Line(words, "dim", aside=True, wrap="always")
    words = (
        "Intervals: 95 %, Student's t over pairs of runs, and trainings where there are several; they and p cover the "
        f"{together([pair.words for pair in pairs]).draws}. For an agent with one training they do not cover other trainings."
    )
    if resolution := max(pair.resolution for pair in pairs):
        words += (
            f" Where a task draws nothing, a reward that differs by less than {resolution:g} differs by rounding, and there is no "
            "p-value (–)."
        )
    yield console.Line(words, "dim", aside=True, wrap="always")
    for pair in pairs[:_SENTENCES]:
        if pair.by_year:
            metric = pair.words.metrics[pair.ranks_by]
            years = ", ".join(f"{year} {metric.text(gap)} ({count(runs, 'run')})" for year, (runs, gap) in pair.by_year.items())
            where = _place(pair, named=several).replace(":", ",")
            yield console.paragraph(f"{where}A - B in {metric.words} by year: {years}. Intervals and p do not cover other years.")
    for entry in entries[0]:
        if len(entry.trainings) > 1:
            yield console.aside(f"{entry.name} is the mean of {len(entry.trainings)} trainings.", "dim")


def _place(pair: Pair, *, named: bool) -> str:
    """``GreenhouseReal-v1: `` if there are several tasks to tell apart."""
    return f"{pair.task_id.rpartition('/')[2]}: " if named else ""


def _failures(one: Entry, other: Entry) -> list[str]:
    """Of each of the two that has failed runs among those that are compared, how many and how."""
    from glbench.leaderboard.pairs import failures

    shared = set(one.seeds) & set(other.seeds)
    reports = [
        failures(entry.name, [run for item in entry.trainings for run in item.result.runs if run.seed in shared]) for entry in (one, other)
    ]
    return [f"{words}; their missing steps count at the task's price of a failed step" for words in reports if words]


def _metrics_table(pair: Pair) -> console.Table:
    from glbench.leaderboard.regret import LINES, METRICS

    def named(name: str, trainings: int) -> str:
        return console.harmless(name) + (f" ({trainings} trainings)" if trainings > 1 else "")

    view = console.table(
        f"{named(pair.first, pair.trainings[0])}, A, and {named(pair.second, pair.trainings[1])}, B, "
        f"on {pair.task_id}: {console.count(pair.runs, 'pair')} of runs",
        "Sum over the period", "Unit", "A", "B", "A - B", "95 % interval",
        numbers=("A", "B", "A - B", "95 % interval"), fold=("Sum over the period",), padding=(0, 1, 0, 0),
    )  # fmt: skip
    metrics = ordered_metrics(pair.words, pair.metrics, {name: one.unit for name, one in pair.metrics.items()})
    rows = [(metric.line, metric, pair.metrics[metric.name]) for metric in metrics]
    rows += [(LINES[part], pair.words.metric(METRICS[part], {}), one) for part, one in pair.regret.items()]
    for line, metric, one in rows:
        gap = one.difference
        values = (one.first, one.second, None if gap is None else gap.value)
        low, high = ("", "") if gap is None else (metric.text(gap.low), metric.text(gap.high))
        numbers = [_NONE if value is None else metric.text(value) for value in values]
        if all(value is None or _is_zero(metric.text(value)) for value in values):
            continue
        view.add(line, unit_of(metric), *numbers, f"{low} to {high}" if low != high else _NONE)
    if 0 < pair.regret_runs < pair.runs:
        view.caption = f"Regrets are means over the {pair.regret_runs} of these pairs that have a best known run."
    return view


def _tasks_table(tests: Sequence[tuple[Pair, float]]) -> console.Table:
    from glbench.leaderboard.tables import chance_text
    from glbench.quantities import pretty_unit

    first = tests[0][0]
    metrics = first.words.headlines
    of_pairs = [{metric.name: pretty_unit(pair.words.metric(metric.name, {}).unit) for metric in metrics} for pair, _ in tests]
    mixed = {metric.name for metric in metrics if len({units[metric.name] for units in of_pairs}) > 1}  # the unit is in the cell
    heads = [metric.heading if metric.name in mixed else metric.headed.replace(" [", "\n[") for metric in metrics]
    numbers = [*heads, "P(A > B)", "p"]
    title = f"{first.first} (A) minus {first.second} (B), task by task"
    view = console.table(title, "Task", *numbers, numbers=numbers, fold=("Task",), collapse_padding=True)
    for (pair, p_value), units in zip(tests, of_pairs, strict=True):
        gaps = [(pair.gap(metric.name), metric.digits, units[metric.name] if metric.name in mixed else "") for metric in metrics]
        view.add(
            pair.task_id.rpartition("/")[2],
            *(_NONE if gap is None else f"{gap:+,.{digits}f} {unit}".rstrip() for gap, digits, unit in gaps),
            chance_text(pair.improvement.value),
            _p_words(pair, p_value),
        )
    return view


def _sentence(pair: Pair, p_value: float) -> str:
    """Difference of the scores with its test, and difference of the profits by item; as markup."""
    verdict, epi = _verdict(pair, p_value), pair.gap(pair.words.profit.name)
    if epi is None:
        return verdict
    more, less = (pair.first, pair.second) if epi >= 0.0 else (pair.second, pair.first)
    sign = 1.0 if epi >= 0.0 else -1.0
    labels = {item.money: item.words for item in pair.words.items}
    items = sorted(pair.money.items(), key=lambda item: -abs(item[1]))
    parts = ", ".join(f"{sign * value:+.3f} {labels[name]}" for name, value in items if abs(value) >= 0.0005)
    gap = f"earns {abs(epi):.3f} EUR/m² more than" if abs(epi) >= 0.0005 else "earns as much as"
    return f"{verdict} {styled(more, 'bold')} {gap} {plain(less)}{f' ({parts})' if parts else ''}."


def _verdict(pair: Pair, p_value: float) -> str:
    """Difference of the scores, and whether it is significant; as markup."""
    better, worse = (styled(name, "bold") for name in (pair.first, pair.second)[:: 1 if pair.headline >= 0 else -1])
    metric, words = pair.words.metrics[pair.ranks_by], _p_words(pair, p_value)
    test = "the difference is the same in every run" if words == _NONE else f"p < {words[1:]}" if words[0] == "<" else f"p = {words}"
    gap = f"{metric.text(abs(pair.headline))} {unit_of(metric)}".removesuffix(f" {_NONE}")
    is_same = _is_zero(metric.text(pair.headline))
    sentence = f"{better} has the higher {metric.words}, by {gap} on average"
    if is_same:
        sentence = f"{better} and {worse} have the same mean {metric.words}"
    if is_same or pair.told_apart(p_value):
        return f"{sentence} ({test})."
    if not pair.is_certain and pair.runs < _FEWEST_PAIRS:
        few = f"{count(pair.runs, 'pair')} of runs {'is' if pair.runs == 1 else 'are'} too few for the test to decide"
        return f"{sentence}, but {few}: it needs at least {_FEWEST_PAIRS} ({test})."
    return f"{sentence}, but their {metric.words}s cannot be told apart ({test})."


def _is_zero(text: str) -> bool:
    """Whether a number is 0 in the decimals that are printed."""
    return not text.strip("-0.,")


def _p_words(pair: Pair, p_value: float) -> str:
    """A p-value, or a dash where the difference is the same in every run, so that there is no chance to test against."""
    if pair.is_certain:
        return _NONE
    return f"{p_value:.3f}" if p_value >= 0.001 else "<0.001"


def _counts(tests: Sequence[tuple[Pair, float]]) -> Markup:
    """Number of tasks that each of the two wins."""
    pair = tests[0][0]
    clear = [one for one, p_value in tests if one.told_apart(p_value)]
    ahead = sum(one.headline > 0.0 for one in clear)
    return Markup(
        f"{styled(pair.first, 'bold')} has the higher {pair.words.metrics[pair.ranks_by].words} on {ahead} of {len(tests)} tasks, "
        f"{plain(pair.second)} on {len(clear) - ahead}; on {len(tests) - len(clear)} they cannot be told apart."
    )


def _document(pair: Pair, p_value: float) -> dict[str, Any]:
    def document_of(metrics: Mapping[str, MetricPair]) -> dict[str, dict[str, float | None]]:
        ends = {"difference": "value", "low": "low", "high": "high"}
        return {
            name: {"first": one.first, "second": one.second}
            | {key: getattr(one.difference, attribute, None) for key, attribute in ends.items()}
            for name, one in metrics.items()
        }

    one = pair.improvement
    return {
        "task": pair.task_id,
        **{name: getattr(pair, name) for name in ("first", "second", "trainings", "runs", "ranks_by")},
        "by_year": {str(year): {"runs": runs, "difference": gap} for year, (runs, gap) in pair.by_year.items()},
        "p_value_corrected": p_value,
        "probability_of_improvement": [one.value, one.low, one.high],
        "money [EUR m-2]": dict(pair.money),
        "metrics": document_of(pair.metrics),
        "regret": document_of(pair.regret),
        "regret_runs": pair.regret_runs,
    }
