"""Names and titles of result files are whatever somebody wrote into them: no table may pass them on as markup, commands or formulas."""

from __future__ import annotations

import csv
import re

import pandas as pd
import pytest

from glbench.leaderboard import rank, to_markdown, write_leaderboard
from glbench.leaderboard.tables import _of_frame, badge, latex_text, markdown_text, number_text, to_latex
from glbench.untrusted import visible

NAMES = (
    "<img src=x onerror=alert(1)>",
    "=cmd|'/C calc'!A0",
    "+1+1",
    "@SUM(A1)",
    "a|b",
    "[click](javascript:alert)",
    "\x1b[31mred\x07",
    "back\u202ewards",
    r"\input{/etc/passwd}$x^2$",
    "line\nbreak",
)


@pytest.fixture
def table(store):
    """A table in which every hostile name has a row."""
    stored = []
    for i, name in enumerate(NAMES):
        item = store(f"agent{i}", [float(100 * i)] * 4)
        agent = item.result.agent.model_copy(update={"name": name, "information": name})
        changed = item.result.model_copy(update={"agent": agent})
        stored.append(type(item)(item.path, changed))
    (found,) = rank(stored, {})
    assert {row.agent for row in found.rows} == set(NAMES)
    return found


def test_no_text_steers_a_terminal():
    for name in NAMES:
        assert visible(name).isprintable()


def test_markdown_has_neither_html_nor_links_nor_more_columns(table):
    rows = [line for line in to_markdown([table], {}).splitlines() if re.match(r"\| \d+ \|", line)]
    assert len(rows) == len(NAMES)
    for line in rows:
        assert "<" not in line
        assert len(re.findall(r"(?<!\\)\|", line)) == len(re.findall(r"(?<!\\)\|", rows[0]))
        assert not re.search(r"(?<!\\)\[[^\]\d-]", line)
        assert line.isprintable()


def test_latex_has_no_commands_of_a_name(table):
    text = to_latex(table)
    assert r"\input" not in text
    assert r"\textbackslash{}input\{/etc/passwd\}\$x\textasciicircum{}2\$" in text
    assert "\x1b" not in text


def test_no_cell_of_a_csv_file_is_a_formula(table, tmp_path):
    write_leaderboard([table], {}, tmp_path)
    with (tmp_path / "leaderboard.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(NAMES)
    for row in rows:
        assert not row["agent"].startswith(("=", "+", "-", "@"))
        assert not row["information"].startswith(("=", "+", "-", "@"))


def test_no_title_of_a_csv_file_is_a_formula():
    frame = pd.DataFrame({'=HYPERLINK("x")': ["=1", "a-b"], "-": [-1.0, 2.0]})
    assert _of_frame("x", frame)["x.csv"] == """"'=HYPERLINK(""x"")",'-\n'=1,-1.0\na-b,2.0\n"""


def test_a_badge_is_a_picture_whatever_the_names(table):
    for name in NAMES:
        assert "<img" not in badge(table, name)
        assert visible(badge(table, name).rstrip("\n")) == badge(table, name).rstrip("\n")


def test_a_number_without_end_does_not_fill_the_screen():
    assert number_text(1e300, 1) == "1.000e+300"
    assert number_text(-3929.65, 1) == "-3929.7"


def test_plain_text_stays_as_it_is():
    assert markdown_text("rule_based ✓ ±10 %") == "rule_based ✓ ±10 %"
    assert latex_text("EPI [EUR/m²]") == "EPI [EUR/m$^2$]"
