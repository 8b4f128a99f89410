"""Badges: one line of a leaderboard as a small picture, for the README of an agent."""

from __future__ import annotations

from html import escape

from glbench.errors import ResultError, did_you_mean
from glbench.leaderboard.ranking import TaskTable
from glbench.leaderboard.tables import number_text
from glbench.untrusted import visible

_CHARACTER = 6.6  # px, about the mean width of a character at 11 px
_PADDING = 8
_HEIGHT = 20
_COLOURS = {True: "#2f7d4f", False: "#8a6d1f"}


def badge(table: TaskTable, agent: str) -> str:
    """SVG: task on the left; rank, reward, trainings, origin and whether it was reproduced on the right. Green when reproduced, else ochre.

    Raises
    ------
    ResultError
        When the agent has no row in the table.
    """
    row = next((one for one in table.rows if one.agent == agent), None)
    if row is None:
        agents = [visible(one.agent) for one in table.rows]
        msg = f"'{agent}' is not in the table of {table.task_id}.{did_you_mean(agent, agents)} It has: {', '.join(agents)}."
        raise ResultError(msg)
    ranked = sum(one.rank is not None for one in table.rows)
    rank = f"rank {row.rank} of {ranked}" if row.rank is not None else "not ranked"
    mean, metric = row.means[table.metric], table.words.metrics[table.metric]
    score = f"{metric.words} {mean:,.0f}" if abs(mean) < 1e9 else f"{metric.words} {number_text(mean, 0)}"
    said = [rank, metric.said(mean) if metric.unit != "-" and abs(mean) < 1e9 else score]
    if row.is_range:
        said.append(f"mean of {len(row.trainings)} trainings")
    if row.origin != "own":
        said.append(row.origin)
    if row.reproduced:
        said.append("reproduced")
    return _picture(visible(table.task_id), ", ".join(said), _COLOURS[row.reproduced])


def _picture(left: str, right: str, colour: str) -> str:
    first, second = (round(len(text) * _CHARACTER) + 2 * _PADDING for text in (left, right))
    title = f"{escape(left)}: {escape(right)}"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{first + second}" height="{_HEIGHT}" role="img" aria-label="{title}">'
        f"<title>{title}</title>"
        f'<clipPath id="r"><rect width="{first + second}" height="{_HEIGHT}" rx="3"/></clipPath>'
        f'<g clip-path="url(#r)"><rect width="{first}" height="{_HEIGHT}" fill="#3e4c59"/>'
        f'<rect x="{first}" width="{second}" height="{_HEIGHT}" fill="{colour}"/></g>'
        f'<g fill="#fff" text-anchor="middle" font-family="Verdana,DejaVu Sans,sans-serif" font-size="11">'
        f'<text x="{first / 2}" y="14" textLength="{first - 2 * _PADDING}">{escape(left)}</text>'
        f'<text x="{first + second / 2}" y="14" textLength="{second - 2 * _PADDING}">{escape(right)}</text></g></svg>\n'
    )
