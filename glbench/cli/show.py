"""``glbench show``: what an agent earned, where, and how evenly, in the terminal."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from glbench.cli.console import harmless, messages, output, say

if TYPE_CHECKING:
    from collections.abc import Sequence

    from glbench.evaluation import Result

_BARS = "▁▂▃▄▅▆▇█"
_BAR_WIDTH = 40


def show(
    result: Annotated[str, typer.Argument(metavar="RESULT|AGENT", help="A result file, or the name of an agent.")],
    task: Annotated[
        list[str] | None,
        typer.Option("--task", "-t", help="Of an agent: this task (repeatable). Default: the default task."),
    ] = None,
    show_all: Annotated[bool, typer.Option("--all", help="Of an agent: all its tasks.")] = False,
    out: Annotated[Path, typer.Option("--out", help="Folder with results/ in it.")] = Path("reports"),
) -> None:
    """Show a result: every metric with its unit and interval, where the money went, how the runs differ."""
    from glbench.cli.stored import find_results

    found = find_results(result, task or [], out)
    shown = found if task or show_all else [_usual(found)]
    for one in shown:
        _show(one, _where_from(one, out))
    if len(shown) < len(found):
        messages().print(
            f"'{result}' has results on {len(found)} tasks: --all, or --task ID, shows the others.",
            style="dim",
            markup=False,
        )


def _usual(found: Sequence[Result]) -> Result:
    """That of the default task, else the latest."""
    from glbench.tasks import DEFAULT_TASK

    return next((one for one in found if one.task.id == DEFAULT_TASK), max(found, key=lambda one: one.created))


def _where_from(result: Result, out: Path) -> list[str]:
    """Origin of the result, whether it was reproduced, and the trainings that it belongs to."""
    from glbench.leaderboard import rank
    from glbench.leaderboard.published import own_and_released_results, published_expectations
    from glbench.leaderboard.tables import entry_label

    stored = [item for item in own_and_released_results(out)[0] if item.result.task.digest == result.task.digest]
    if all(
        item.result != result for item in stored
    ):  # the digest of the runs leaves out what the file states of the agent
        return []
    expected = {task_id: one for task_id, one in published_expectations().items() if one.digest == result.task.digest}
    for table in rank(stored, expected):
        for entry in table.rows:
            for row in entry.results:
                if (row.task_id, row.results_digest) == (result.task.id, result.results_digest):
                    mean = entry.estimates["reward"]
                    family = (
                        f"One of {entry_label(entry)}: reward {mean.mean:,.1f}, {mean.low:,.1f} to {mean.high:,.1f}. "
                        f"The others: {', '.join(one.agent for one in entry.results if one is not row)}."
                    )
                    checked = (
                        "reproduced by glbench verify" if row.reproduced else "not reproduced yet (glbench verify)"
                    )
                    return [f"Source: {row.origin}; {checked}", *([family] if entry.is_range else [])]
    return []


def _show(result: Result, where_from: Sequence[str]) -> None:
    from rich.markup import escape

    from glbench.cli.evaluation_tables import print_failures, summary_table

    output().print(summary_table(result))
    output().print(f"\n[bold]Where the money went[/] (mean of {len(result.runs)} runs)")
    for line in money_lines(result):
        output().print(line)
    rewards = sorted(result.values("reward"))
    if rewards[0] < rewards[-1]:
        output().print(
            f"\n[bold]Rewards[/], worst to best: {rewards[0]:,.1f} {sparkline(rewards)} {rewards[-1]:,.1f}",
            soft_wrap=True,
        )
    worst = min(result.runs, key=lambda run: run.metrics["reward"])
    output().print(
        f"Worst run: seed {worst.seed}, reward {worst.metrics['reward']:,.1f}, EPI {worst.metrics['epi']:,.3f} EUR/m²"
    )
    print_failures(result)
    kernel = result.evaluation.kernel
    stated = [
        f"decision {result.evaluation.decision_milliseconds:.3f} ms",
        f"sandbox {result.evaluation.sandbox or 'unknown'}",
        f"made {result.created} with glbench {result.versions.glbench}",
        *([f"git {result.git.commit[:12]}{' with changes' if result.git.dirty else ''}"] if result.git else []),
        *([f"card by {', '.join(result.agent.card.authors)}"] if result.agent.card else []),
    ]
    lines = [
        f"{result.agent.name} sees: {result.agent.information}",
        f"Kernel {kernel.get('backend')}, preset {kernel.get('preset', '–')}; results digest {result.results_digest[:12]}",
        *where_from,
        f"Stated by the file, not checked: {'; '.join(stated)}",
    ]
    output().print()
    for line in lines:
        say(output(), escape(harmless(line)), style="dim")


def money_lines(result: Result) -> list[str]:
    """Revenue and costs as bars of one scale, and what is left."""
    from glbench.evaluation.metrics import UNITS

    names = {"revenue": "fruit", "cost_heat": "heat", "cost_electricity": "lamps", "cost_co2": "CO2"}
    means = {name: sum(values) / len(values) for name in names for values in [result.values(name)]}
    scale = max(*(abs(value) for value in means.values()), 1e-9)
    lines = []
    for name, words in names.items():
        signed = means[name] if name == "revenue" else -means[name]
        colour = "green" if signed >= 0.0 else "red"
        bar = "█" * round(_BAR_WIDTH * abs(signed) / scale)
        lines.append(f"  {words:<6}{_signed(signed):>9} EUR/m²  [{colour}]{bar}[/]")
    left = sum(result.values("epi")) / len(result.runs)
    unit = "EUR/m²" if UNITS["epi"] == "EUR m-2" else UNITS["epi"]
    return [*lines, f"  [bold]{'EPI':<6}{_signed(left):>9} {unit}[/]"]


def _signed(value: float) -> str:
    """With sign and three decimals; what rounds to zero has no sign."""
    return f"{value:+.3f}" if abs(value) >= 0.0005 else "0.000"


def sparkline(values: Sequence[float]) -> str:
    """One character a value, its height between the smallest and the largest."""
    low, high = min(values), max(values)
    if not high > low:
        return _BARS[0] * len(values)
    return "".join(_BARS[min(int((value - low) / (high - low) * len(_BARS)), len(_BARS) - 1)] for value in values)
