"""Badges: one line of a leaderboard as a small picture, for the README of an agent."""

from __future__ import annotations

from html import escape

from glbench.errors import ResultError, did_you_mean
from glbench.leaderboard.ranking import RANKING_METRIC, TaskTable

_CHARACTER = 6.6  # px, about the mean width of a character at 11 px
_PADDING = 8
_HEIGHT = 20
_COLOURS = {True: "#2f7d4f", False: "#8a6d1f"}


def badge(table: TaskTable, agent: str) -> str:
    """SVG: task on the left; rank, reward and whether it is verified on the right. Green when verified, else ochre.

    Raises
    ------
    ResultError
        When the agent has no row in the table.
    """
    row = next((one for one in table.rows if one.agent == agent), None)
    if row is None:
        agents = [one.agent for one in table.rows]
        msg = f"'{agent}' is not in the table of {table.task_id}.{did_you_mean(agent, agents)} It has: {', '.join(agents)}."
        raise ResultError(msg)
    ranked = sum(one.rank is not None for one in table.rows)
    rank = f"rank {row.rank} of {ranked}" if row.rank is not None else "not ranked"
    words = f"{rank}, reward {row.estimates[RANKING_METRIC].mean:,.0f}" + (", verified" if row.verified else "")
    return _picture(table.task_id, words, _COLOURS[row.verified])


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
