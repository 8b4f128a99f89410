"""Cards that nobody wrote in good faith: each ends in sentences, none of them long, and in no traceback."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from glbench.agents.card import check_card, read_card
from glbench.errors import SubmissionError

GOOD = 'name = "x"\nauthors = ["a"]\nlicence = "MIT"\ninformation = ["observations"]\n'
HUGE = "0x" + "f" * 10_000


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (f"seed = {HUGE}", "'seed' is a value that is too large to show"),
        ("seed = " + "9" * 5000, "no valid TOML"),
        ("[training]\nsteps = 1" + "0" * 30, "'training.steps' is 1000"),
        ("[training]\nwall_hours = 1e300", "'training.wall_hours' is 1e.300"),
        (f"requires = [{HUGE}]", "'requires.0'"),
        (f"[training]\nhardware = {{ a = {HUGE} }}", "'training.hardware' is a value that is too large"),
        ("requires = " + "[" * 20_000 + "]" * 20_000, "nested without end"),
        ("requires = " + "[" * 300 + "]" * 300, "'requires.0'"),
        (".".join(["a"] * 30_000) + " = 1", "more than 500 dots"),
        ("training" + " . a" * 10_000 + " = 1", "more than 500 dots"),
        ("training" + ".a" * 400 + " = 1", "'a' is not a key of a card"),
        ("k" * 60_000 + " = 1", "is not a key of a card"),
        ('"\\u001b[2J" = 1', "x1b.2J' is not a key of a card"),
        ('description = "' + "x" * 60_000 + '"', "'description' is 'xxx"),
        ("requires = [" + '"a", ' * 5000 + "]", "at most 100 items"),
        ('model = "m.onnx"\nnormalisation = { mean = [inf], std = [1.0] }', "finite number"),
        ('model = "m.onnx"\nnormalisation = { mean = [1e300], std = [1.0] }', "less than or equal"),
    ],
    ids=lambda value: value[:40],
)
def test_a_hostile_card_ends_in_short_sentences(tmp_path: Path, lines: str, words: str) -> None:
    file = tmp_path / "submission.toml"
    file.write_text(GOOD + lines, encoding="utf-8")
    card, problems = check_card(file)
    assert card is None
    assert all(len(problem) < 400 and problem.isprintable() for problem in problems), problems
    with pytest.raises(SubmissionError, match=words):
        read_card(file)


@pytest.mark.skipif(sys.platform == "win32", reason="no pipes in folders")
def test_a_card_that_is_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "submission.toml")
    with pytest.raises(SubmissionError, match="not a regular file"):
        read_card(tmp_path / "submission.toml")
