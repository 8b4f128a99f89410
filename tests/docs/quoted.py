"""Figures that a page quotes, or a notebook in its text: numbers that somebody must have measured, computed or defined."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from decimal import ROUND_HALF_UP, Decimal
from pathlib import Path

NUMBER = r"(?<![\w.,-])[-−]?\d+(?:,\d{3})*(?:\.\d+)?(?:e-?\d+)?(?![\w]|[.,]\d)"
_UNIT = re.compile(
    rf"(?:\s(?:to|and|or)\s{NUMBER})?\s?"
    r"(?:%|(?:us|ms|ns|s|h|min|seconds?|minutes?|hours?|MB|kB|GB|MiB|GiB|steps/s|times|units|substeps|cycles|ulp|EUR|kWh|per\scent)\b)"
)
_NO_PROSE = re.compile(
    r"```.*?```|<!-- [\w-]+ -->\n.*?<!-- end -->|`[^`\n]+`|\]\([^)]*\)|https?://\S+|^    \S[^\n]*$", re.DOTALL | re.MULTILINE
)


@dataclass(frozen=True)
class Quoted:
    """A number in a page: its text, where it begins, and its line."""

    text: str
    start: int
    line: int


def text_of(file: Path) -> str:
    """Text of a Markdown page, or of a notebook's text cells."""
    text = file.read_text(encoding="utf-8")
    if file.suffix != ".ipynb":
        return text
    cells = json.loads(text)["cells"]
    return "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")


def prose(page: str) -> str:
    """The page with code, links and generated tables blanked, every other character in its place."""
    return _NO_PROSE.sub(lambda found: re.sub(r"[^\n]", " ", found[0]), page)


def line_of(page: str, at: int) -> int:
    """Line of a character, counted from 1."""
    return page.count("\n", 0, at) + 1


def quoted(page: str) -> list[Quoted]:
    """Numbers with a decimal point, of four digits or more (years apart), or with a unit of measurement."""
    text = prose(page)
    found = []
    for match in re.finditer(NUMBER, text):
        digits = match[0].lstrip("-−").replace(",", "")
        is_year = re.fullmatch(r"(19|20)\d\d", match[0]) is not None
        if re.search("[.e]", digits) or (len(digits) > 3 and not is_year) or _UNIT.match(text, match.end()):
            found.append(Quoted(match[0], match.start(), line_of(text, match.start())))
    return found


def found_words(page: str, words: str) -> list[re.Match[str]]:
    """Where ``words`` stand in ``page``, with any white space between them; ``{}`` stands for a number."""
    pattern = r"\s+".join(re.escape(word) for word in words.split()).replace(r"\{\}", f"({NUMBER})")
    return list(re.finditer(pattern, page))


def places(page: str, words: str) -> list[list[tuple[int, str]]]:
    """For each place where ``words`` stand: start and text of the numbers in their ``{}``."""
    return [[(found.start(i), found[i]) for i in range(1, (found.lastindex or 0) + 1)] for found in found_words(page, words)]


def as_quoted(value: float, text: str) -> str:
    """``value`` with as many digits as ``text`` gives; halves are rounded away from zero, as readers do."""
    number = text.replace("−", "-")
    if "e" in number:
        digits = len(number.split("e")[0].lstrip("-").replace(".", "")) - 1
        mantissa, exponent = f"{value:.{digits}e}".split("e")
        return f"{mantissa}e{int(exponent)}"
    decimals = len(number.partition(".")[2])
    rounded = Decimal(repr(float(value))).quantize(Decimal(1).scaleb(-decimals), ROUND_HALF_UP)
    shown = f"{rounded:,f}" if "," in number else f"{rounded:f}"
    return "0" if shown == "-0" else shown
