"""Phrases that read as translated stay out of pages, docstrings, messages and the report (CONTRIBUTING.md, "Style").

The model and the compiled kernel are left out.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

PHRASES = {
    r"(?<![Tt]here )\bis no (agent|policy|plan|record|recording|result|task|TorchScript|TOML)\b(?! (of|for|that|with|in) )": "is not a",
    r"(?<![Tt]here )\bis no (regular |whole )?(key|file|number|model|algorithm|action|day|card|secret)\b": "is not a",
    r"(is|was) no (policy|recording|episode|archive) of (glbench|[A-Z])": "is not a ... of glbench",
    r"the bands? of (half|nine)": "50 % and 90 % bands",
    r"when nobody says|nobody has said": "not stated",
    r"does not make (a|the) figure": "the figure is still uncertain",
    r"[Ww]ho a submission is": "the submission's name and digest",
    r"becomes a sentence": "is reported as text",
    r"knows what no \w+ knows": "sees more than the observations",
    r"everyone's problem": "name the problem",
    r"stands under every": "every ... says",
    r"\b[Ll]eaves? with (0|1|code|the code)\b|\band leave(\.|$| with\b)": "exits with 1",
    r"\b(is|are) told(,|;|\.| now\b)": "is reported",
    r"\bbelongs? into\b": "belongs in",
    r"\banew\b": "again; redrawn, rebuilt, start over",
    r"\bgoes on (with|to|from|without|after|where)\b": "continues",
    r"\bfor ever\b": "forever",
    r"\b(lie|lies) (beside|below|in|at)\b": "is beside, is in",
    r"\bone's own\b": "custom; your own",
    r"seasons that never were": "synthetic seasons",
    r"\b(has|have) to be mended\b|\bto mend\b": "to fix",
    r"\bfor want of\b": "for lack of",
    r"\bfurther ado\b": "at once",
    r"\bslip of the pen\b": "typo",
    r"with suspicion": "as hostile",
    r"booked in words": "is reported",
    r"no merit of (its|theirs|his)": "not their doing",
    r"is the one of\b": "is that of",
    r"\btake\w* (it|them|the alarm) back\b": "cancel, undo",
    r"\bhangs? together\b": "is autocorrelated",
    r"\b[Rr]eset was told\b": "reset was called with",
    r"\b([Ii]s|are|was|were) told (as|each|everything|how|it|nothing|of|the|what)\b": "gets, is called with, is shown",
    r"\b[Mm]ake nothing of\b": "invalidate",
    r"\bwith everything known\b": "with perfect information",
    r"\bof which very file\b|\bwhoever multiplies\b": "name the file; name what may vary",
}
"""Phrases as regular expressions, and what a native speaker writes instead."""

KEPT = {"CONTRIBUTING.md"}
"""The page that shows them."""


def written() -> list[Path]:
    found = [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob(".github/**/*.md"), *ROOT.glob(".github/**/*.yml")]
    found += [file for kind in ("py", "html", "js") for file in ROOT.glob(f"glbench/**/*.{kind}")]
    left_out = {ROOT / "glbench" / "model", ROOT / "glbench" / "kernel" / "compiled"}
    return sorted(file for file in set(found) if file.name not in KEPT | {"CHANGELOG.md"} and not left_out & set(file.parents))


def phrases_in(text: str) -> list[tuple[int, str, str]]:
    """Line, phrase and what to write instead. Line ends, and marks of comments and strings around them, count as spaces."""
    flat = re.sub(r"[ \t]*\"?\n[ \t]*(?:#:? |f?\"|//[ ]|> )?", lambda found: " " + "\0" * (len(found[0]) - 1), text)
    kept = [i for i, character in enumerate(flat) if character != "\0"]
    plain = flat.replace("\0", "")
    return sorted(
        (text.count("\n", 0, kept[found.start()]) + 1, found[0], instead)
        for phrase, instead in PHRASES.items()
        for found in re.finditer(phrase, plain)
    )


@pytest.mark.slow
def test_no_phrase_reads_as_translated() -> None:
    problems = [
        f'{file.relative_to(ROOT).as_posix()}:{line}: "{phrase}". Write: {instead}.'
        for file in written()
        for line, phrase, instead in phrases_in(file.read_text(encoding="utf-8"))
    ]
    assert not problems, "\n" + "\n".join(problems)


@pytest.mark.parametrize(
    "text",
    [
        "until the new end the folder is no agent",
        "0 when nothing was learnt, - when nobody says",
        "shown with the bands of half and of nine tenths of them",
        "Leaves with 1 if one is wrong.",
        "whatever cannot be resolved is told now",
        '    msg = "The records lie "\n    "beside it."',
        "    # It is drawn\n    # anew.",
        "Whose page goes\non with it",
        "act got 3 runs, reset was told of 2",
        "an error that hangs together",
    ],
)
def test_a_phrase_is_found_also_over_the_end_of_a_line(text: str) -> None:
    assert phrases_in(text)


def test_what_is_plain_passes() -> None:
    text = "It is not an agent. The seed is told to nobody. It exits with 1, is reported, and continues. The page is no longer there."
    assert phrases_in(text) == []


def test_the_page_on_style_shows_what_to_write() -> None:
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    table = page[page.index("## Style") : page.index("## Releases")]
    before = [row.split("|")[1] for row in re.findall(r"^\|.*\|$", table, re.MULTILINE)[2:]]
    assert len(before) >= 10
    assert [row.strip() for row in before if not phrases_in(row)] == []
