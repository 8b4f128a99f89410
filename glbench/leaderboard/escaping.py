"""Text of result files in terminals, Markdown, LaTeX and spreadsheets. Whoever makes a result file chooses it, so it is never trusted."""

from __future__ import annotations

from glbench.untrusted import visible

_LATEX = str.maketrans(
    {
        "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#", "%": r"\%", "_": r"\_",
        "^": r"\textasciicircum{}", "~": r"\textasciitilde{}", "<": r"\textless{}", ">": r"\textgreater{}",
        "²": "$^2$", "–": "--", "↔": r"$\leftrightarrow$", "×": r"$\times$",
    }
)  # fmt: skip
_MARKDOWN = str.maketrans(
    {"&": "&amp;", "<": "&lt;", ">": "&gt;", "|": r"\|", "`": r"\`", "[": r"\[", "]": r"\]", "*": r"\*", "\\": r"\\"}
)
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def markdown_text(text: str) -> str:
    """``text`` as Markdown shows it, also in the cell of a table: no HTML, no links, no new columns."""
    return visible(text).translate(_MARKDOWN)


def latex_text(text: str) -> str:
    """``text`` with LaTeX's special characters escaped."""
    return visible(text).translate(_LATEX)


def cell_text(text: str) -> str:
    """``text`` as a cell of a CSV file that no spreadsheet takes for a formula."""
    return f"'{text}" if text.startswith(_FORMULA) else text


def number_text(value: float, decimals: int) -> str:
    """``value`` with so many decimals; what no greenhouse makes in powers of ten, so that it does not fill the screen."""
    return f"{value:.{decimals}f}" if abs(value) < 1e9 else f"{value:.3e}"
