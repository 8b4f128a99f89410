"""HTML for notebooks: what ``_repr_html_`` of tasks, results and episodes is made of."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from glbench.untrusted import visible


def html_of(
    heading: str,
    facts: Iterable[tuple[str, object]],
    columns: Sequence[str] = (),
    rows: Iterable[Sequence[object]] = (),
) -> str:
    """A heading, a table of facts, and below it a table with ``columns``; numbers stand right. Texts are escaped."""
    told = "".join(
        f'<tr><th style="text-align:left">{_text(name)}</th>{_cell(value, "left")}</tr>' for name, value in facts
    )
    parts = [f"<p><strong>{_text(heading)}</strong></p>", f"<table>{told}</table>"]
    if columns:
        head = "".join(f"<th>{_text(column)}</th>" for column in columns)
        body = "".join(f"<tr>{''.join(_cell(value) for value in row)}</tr>" for row in rows)
        parts.append(f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>")
    return f"<div>{''.join(parts)}</div>"


def _cell(value: object, side: str | None = None) -> str:
    side = side or ("right" if isinstance(value, int | float) else "left")
    shown = f"{value:.4g}" if isinstance(value, float) else str(value)
    return f'<td style="text-align:{side}">{_text(shown)}</td>'


def _text(value: str) -> str:
    return escape(visible(value))
