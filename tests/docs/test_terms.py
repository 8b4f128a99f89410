"""Terms of the benchmark are explained where a page uses them first: in a few words, or by a link to the glossary."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
GLOSSARY = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
PAGES = [ROOT / "README.md", *sorted(set((ROOT / "docs").glob("*.md")) - {ROOT / "docs" / "glossary.md"})]
TERMS = {
    "travel": (r"[Aa]ctuator travel|\btravel of", r"change of every control|movements? of the controls|controls moved"),
    "cvar10": (r"\bCVaR10\b", r"worst tenth"),
    "iqm": (r"\bIQM\b", r"middle half|interquartile"),
    "salt": (r"\bsalts?\b", r"random numbers|draws"),
    "privileged": (r"\b[Pp]rivileged\b", r"true state|\bknows?\b|\bsees?\b|reads? states"),
    "epi": (r"\bEPI\b", r"economic performance|\bprofit|earned"),
    "regret": (r"\b[Rr]egret\b", r"\bloses\b|distance to the best|less than the best|behind the best"),
    "delta": (r"\bdelta\b", r"half-width|uncertain|±"),
    "split": (
        r"\b(?:test|training|validation) splits?\b|\b(?:with|without|have|has|no) splits\b",
        r"learn from|kept apart|held apart|choose between|tune on",
    ),
    "seed": (r"\bseeds?\b", r"\bdraw|scenario|\bnames?\b"),
}
"""By their anchors in the glossary: how a page uses a term, and words that explain it in the same paragraph."""
_NO_PROSE = re.compile(
    r"```.*?```|<!-- (?!end)[^\n]*?-->.*?<!-- end -->|`[^`\n]*`|^#.*?$|^    \S.*?$"
    r"|\[[^]\n]*\]\((?!(?:docs/)?glossary)[^)]*\)|\]\([^)]*\)|<[^>\n]*>",
    re.DOTALL | re.MULTILINE,
)
"""Code, generated tables, headings, and links but for the words of those to the glossary."""


def prose(text: str) -> str:
    """``text`` with spaces for code, generated tables, headings and targets of links: places stay the same."""
    return _NO_PROSE.sub(lambda found: re.sub(r"[^\n]", " ", found[0]), text)


def unexplained(text: str) -> list[tuple[str, int]]:
    """Terms whose first use has no explanation in its paragraph, or its row of a table, and where that use is."""
    plain, problems = prose(text), []
    for anchor, (use, explanation) in TERMS.items():
        first = re.search(use, plain)
        if first is None:
            continue
        begin = text.rfind("\n\n", 0, first.start()) + 1
        end = text.find("\n\n", first.start())
        paragraph = text[begin : end if end >= 0 else len(text)]
        if not re.search(rf"glossary\.md(?:#{anchor})?\)", paragraph) and not re.search(explanation, paragraph):
            problems.append((anchor, first.start()))
    return problems


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_term_is_explained_where_it_is_used_first(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert [
        f"{page.name}:{text.count(chr(10), 0, place) + 1}: '{anchor}' is not explained: say what it is, or link to glossary.md#{anchor}"
        for anchor, place in unexplained(text)
    ] == []


def test_the_glossary_has_every_term() -> None:
    assert [anchor for anchor in TERMS if f'<a id="{anchor}"></a>' not in GLOSSARY] == []


def test_a_term_without_explanation_is_found_and_code_is_no_use() -> None:
    assert unexplained("`seed` and [more](x.md#regret).\n\nIts regret is 3.") == [("regret", 37)]
    assert unexplained("Its [regret](glossary.md#regret) is 3.") == []
    assert unexplained("The IQM, the mean of the middle half.") == []


LONGEST = {
    "tasks.md": 2500,
    "task-file.md": 2600,
    "energy.md": 2500,
    "heat-harvesting.md": 2500,
    "nomenclature.md": 2500,
    "glossary.md": 2500,
}
"""Pages that were too long for their purpose, and the most words that each may have."""


@pytest.mark.parametrize(("name", "most"), LONGEST.items(), ids=LONGEST)
def test_a_page_for_one_purpose_stays_short(name: str, most: int) -> None:
    assert len((ROOT / "docs" / name).read_text(encoding="utf-8").split()) <= most
