"""Every figure that README and docs quote is recomputed here, or listed as a definition or a source's figure.

A figure is a number with a decimal point, of four digits or more, or with a unit such as s, MB, % or EUR (``quoted.py``), outside code and
generated tables. ``claims.py`` says where each comes from. Decision records (docs/adr) keep what was known when they were written.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.docs.claims import ALLOWED, CLAIMS, EVERYWHERE, NotReleasedError, UncheckedError
from tests.docs.quoted import as_quoted, found_words, line_of, places, prose, quoted, text_of

ROOT = Path(__file__).resolve().parents[2]
WRITTEN = [*(ROOT / "docs").glob("*.md"), *(ROOT / "docs").glob("notebooks/*.ipynb")]
PAGES = ["README.md", *sorted(page.relative_to(ROOT).as_posix() for page in WRITTEN), *sorted(CLAIMS)]
PAGES = list(dict.fromkeys(PAGES))


def covered_by_claims(page: str, text: str, problems: list[str]) -> set[int]:
    """Starts of the figures that a claim computes; what it finds wrong goes to ``problems``."""
    found: set[int] = set()
    for words, compute in CLAIMS.get(page, []):
        where = places(text, words)
        if not where:
            problems.append(f'{page}: nothing reads "{words}" any more. Change the entry in tests/docs/claims.py.')
            continue
        try:
            computed = compute()
        except NotReleasedError as error:
            problems.append(f'{page}: "{words}": {error}')
            found.update(start for numbers in where for start, _ in numbers)
            continue
        except UncheckedError:
            found.update(start for numbers in where for start, _ in numbers)
            continue
        values = computed if isinstance(computed, tuple) else (computed,)
        for numbers in where:
            assert len(numbers) == len(values), f'"{words}": {len(numbers)} figures, {len(values)} computed'
            for (start, number), value in zip(numbers, values, strict=True):
                found.add(start)
                said, is_so = number.replace("−", "-"), as_quoted(value, number)
                if said != is_so:
                    line = line_of(text, start)
                    problems.append(f'{page}:{line}: says {said} in "{words}", computed {is_so} ({value:.10g}). Correct the page.')
    return found


def allowed(page: str, text: str) -> set[int]:
    """Starts of the figures within a phrase that needs no computation."""
    phrases = [*EVERYWHERE, *(words for words, _ in ALLOWED.get(page, []))]
    spans = [found.span() for words in phrases for found in found_words(text, words)]
    return {one.start for one in quoted(text) if any(begin <= one.start < end for begin, end in spans)}


@pytest.mark.parametrize("page", PAGES)
def test_every_figure_of_a_page_is_backed(page: str) -> None:
    text = text_of(ROOT / page)
    problems: list[str] = []
    backed = covered_by_claims(page, text, problems) | allowed(page, text)
    lines = text.splitlines()
    problems += [
        f'{page}:{one.line}: nothing backs {one.text} in "{lines[one.line - 1].strip()[:100]}". Add what computes it to '
        "CLAIMS in tests/docs/claims.py, a reason to ALLOWED, or take the figure out."
        for one in quoted(text)
        if one.start not in backed and not page.startswith("docs/adr/")
    ]
    assert not problems, "\n" + "\n".join(problems)


@pytest.mark.parametrize("page", sorted(ALLOWED))
def test_every_allowance_is_used(page: str) -> None:
    text = text_of(ROOT / page)
    unused = [words for words, _ in ALLOWED[page] if not found_words(text, words)]
    assert not unused, f"{page} no longer says {unused}: remove them from ALLOWED in tests/docs/claims.py."


def test_what_counts_as_a_figure() -> None:
    page = "It takes 3 s and 0.5 of 4,096; in 2010 seven of 22 (`900.0`, [b](a1.5.md)) at 1e-9.\n\n    code 7.5\n"
    assert [one.text for one in quoted(page)] == ["3", "0.5", "4,096", "1e-9"]
    assert prose(page).count("\n") == page.count("\n")
    assert [one.text for one in quoted("<!-- a-table -->\n| 2.5 |\n<!-- end -->\n3.5\n")] == ["3.5"]


@pytest.mark.parametrize(
    ("value", "text", "shown"),
    [
        (3794.68, "3,794.7", "3,794.7"),
        (512.4, "513", "512"),
        (1.04e-6, "1e-6", "1e-6"),
        (362.5, "362", "363"),
        (362.5, "362.5", "362.5"),
        (-0.2, "0", "0"),
    ],
)
def test_a_value_is_compared_with_the_digits_that_are_quoted(value: float, text: str, shown: str) -> None:
    assert as_quoted(value, text) == shown
