"""What an evaluation says in the terminal: what is about to run, what came out, what went wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

from glbench.cli.console import harmless, messages
from glbench.evaluation.metrics import HOURS_OUTSIDE, METRICS, UNITS
from glbench.leaderboard.ranking import Estimate, estimates_of

if TYPE_CHECKING:
    from glbench.evaluation import Evaluation, Result, RunResult

_UNITS = {"EUR m-2": "EUR/m²", "kWh m-2": "kWh/m²", "kg m-2": "kg/m²", "h": "h", "-": "–"}
_DECIMALS = {"EUR m-2": 3, "kWh m-2": 2, "kg m-2": 3, "h": 1, "-": 2}
_LABELS = {
    "reward": "Reward",
    "epi": "EPI = revenue - costs",
    "revenue": "  revenue",
    "cost_heat": "  cost of heat",
    "cost_electricity": "  cost of electricity",
    "cost_co2": "  cost of CO2",
    "penalty": "Penalty",
    "yield": "Yield, fresh fruit",
    "heat": "Heat",
    "electricity": "Lamp electricity",
    "co2": "CO2",
    "hours_outside_limits": "Outside limits",
    "hours_air_temperature_low": "  air too cold",
    "hours_air_temperature_high": "  air too hot",
    "hours_co2_low": "  too little CO2",
    "hours_co2_high": "  too much CO2",
    "hours_relative_humidity_low": "  air too dry",
    "hours_relative_humidity_high": "  air too humid",
}
_SECTIONS = {"penalty", "yield", "hours_outside_limits"}
_SHOWN_FAILURES = 5
_SHOWN_LINES, _LONGEST_LINE = 20, 300
_PROTECTIONS = {
    "bubblewrap": "in a sandbox (bubblewrap)",
    "unsandboxed": "[yellow]unsandboxed[/yellow]",
    "built-in": "a built-in agent",
}


def announcement(evaluation: Evaluation) -> str:
    """What is about to be evaluated, in two lines."""
    task, seeds, days = evaluation.task, evaluation.seeds, evaluation.task.weather.days
    numbers = f"seeds {seeds[0]} to {seeds[-1]}" if len(seeds) > 1 else f"seed {seeds[0]}"
    privileged = (
        " [yellow](privileged: sees more than the observations)[/yellow]" if evaluation.agent.privileged else ""
    )
    return (
        f"[bold]{escape(evaluation.agent.name)}[/bold]{privileged} on [bold]{escape(task.id)}[/bold]: {escape(task.title)}\n"
        f"{_count(len(seeds), 'run')} ({numbers}) of {_count(days, 'day')}, {task.steps} steps of {task.step_seconds:g} s; "
        f"{_count(evaluation.workers, 'worker')}, {evaluation.kernel['backend']} kernel, {_PROTECTIONS[evaluation.protection]}"
    )


def summary_table(result: Result) -> Table:
    """Mean, interquartile mean and 95 % interval of every metric, with units."""
    runs = len(result.runs)
    table = Table(
        title=f"{escape(result.agent.name)} on {escape(result.task.id)}: {_count(runs, 'run')}",
        title_justify="left",
        title_style="bold",
        caption="IQM: mean of the middle half of the runs. 95 % interval: bootstrap, of the mean.",
        caption_justify="left",
    )
    table.add_column("Sum over the period")
    table.add_column("Unit")
    for heading in ("Mean", "IQM", "95 % interval"):
        table.add_column(heading, justify="right")
    estimates = estimates_of(result)
    for name in metric_order():
        if name in _SECTIONS:
            table.add_section()
        unit = result.units[name]
        table.add_row(_LABELS[name], _UNITS[unit], *_cells(estimates[name], _DECIMALS[unit], runs))
    table.add_section()
    evaluation = result.evaluation
    table.add_row("Decision, each step", "ms", f"{evaluation.decision_milliseconds:.3f}", "", "")
    table.add_row("Whole evaluation", "s", f"{evaluation.wall_seconds:.1f}", "", "")
    return table


def reward_in_words(result: Result) -> str:
    """``reward 3,751.9 (3,750.9 to 3,752.8)``: mean and 95 % interval."""
    mean, _, interval = _cells(estimates_of(result)["reward"], 1, len(result.runs))
    return f"reward {mean} ({interval})" if interval != "–" else f"reward {mean}"


def print_failures(result: Result) -> None:
    """Say loudly which runs failed and why; the same reason once."""
    failed = result.failed
    if not failed:
        return
    console = messages()
    console.print(
        f"[bold red]{len(failed)} of {_count(len(result.runs), 'run')} failed.[/bold red] Each of their missing steps counts as the task's "
        "price of a failed step, so these numbers are low."
    )
    print_reasons(result, _SHOWN_FAILURES)


def print_reasons(result: Result, most: int, indent: str = "  ") -> None:
    """Why runs failed, the same reason once, and at most so many."""
    groups: dict[tuple[str, str | None, int], list[RunResult]] = {}
    for run in result.failed:
        groups.setdefault((run.status, run.reason, run.steps), []).append(run)
    for (status, reason, steps), members in list(groups.items())[:most]:
        seeds = ", ".join(str(run.seed) for run in members[:3]) + (", ..." if len(members) > 3 else "")
        messages().print(
            f"{indent}[red]{status}[/red] after {_count(steps, 'step')} ({_count(len(members), 'run')}: seed {seeds}): "
            f"{escape(harmless(reason or ''))}",
            soft_wrap=True,
        )
    if len(groups) > most:
        messages().print(f"{indent}and {len(groups) - most} more kinds of failure; the result file has them all.")


def print_prints(name: str, printed: str, *, everything: bool, last: int = _SHOWN_LINES, indent: str = "") -> None:
    """What the sandboxed agent ``name`` printed: all that was kept of it, or its last lines."""
    lines = printed.rstrip().splitlines()
    if not lines:
        return
    shown = lines if everything else lines[-last:]
    which = (
        "" if len(shown) == len(lines) else f" (the last {len(shown)} of {len(lines)} lines; --show-prints shows more)"
    )
    console = messages()
    console.print(f"{indent}What {escape(name)} printed{which}:", soft_wrap=True)
    for line in shown:
        short = line if everything or len(line) <= _LONGEST_LINE else f"{line[: _LONGEST_LINE - 4]} ..."
        console.print(f"{indent}  {short}", markup=False, soft_wrap=True)


def label_of(metric: str) -> str:
    """A metric in words."""
    return _LABELS[metric]


def unit_of(metric: str) -> str:
    """Unit of a metric as people write it."""
    return _UNITS[UNITS[metric]]


def number_of(metric: str, value: float) -> str:
    """A value with the decimals that its unit deserves."""
    return f"{value:,.{_DECIMALS[UNITS[metric]]}f}"


def metric_order() -> list[str]:
    """Metrics as shown: the time outside any limit before that outside each."""
    limits = [metric.name for metric in HOURS_OUTSIDE]
    return [metric.name for metric in METRICS if metric.name not in limits] + limits


def _cells(estimate: Estimate, decimals: int, runs: int) -> tuple[str, str, str]:
    def number(value: float) -> str:
        return f"{value:,.{decimals}f}"

    interval = (
        f"{number(estimate.low)} to {number(estimate.high)}" if runs > 1 and estimate.low < estimate.high else "–"
    )
    return number(estimate.mean), number(estimate.iqm), interval


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
