"""What commands show is data: tables that fit a terminal, text that is shown as it is, documents for programs."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest
import typer

from glbench.cli import console
from glbench.cli.console import Column, Line, Markup, Table, View, plain, styled


@pytest.fixture
def narrow(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A terminal of 30 columns."""
    monkeypatch.setenv("COLUMNS", "30")
    console.output.cache_clear()
    yield
    console.output.cache_clear()


def test_people_see_the_parts_and_programs_the_document(capsys: pytest.CaptureFixture[str]) -> None:
    def parts() -> Iterator[Line]:
        yield Line("for people")

    console.output.cache_clear()
    console.show(View(parts(), {"for": "programs"}))
    assert capsys.readouterr().out == "for people\n"
    console.show(View(parts(), lambda: {"for": "programs"}), as_json=True)
    assert json.loads(capsys.readouterr().out) == {"for": "programs"}


def test_parts_are_made_only_for_people_and_a_document_only_for_programs() -> None:
    def nobody() -> Iterator[Line]:
        pytest.fail("the parts were made")
        yield Line("")

    console.show(View(nobody(), {}), as_json=True)
    console.show(View((), lambda: pytest.fail("the document was made")))


def test_notes_and_the_exit_code_are_for_both(capsys: pytest.CaptureFixture[str]) -> None:
    console.messages.cache_clear()
    for as_json in (False, True):
        with pytest.raises(typer.Exit) as end:
            console.show(View((), [], notes=["mind this"], code=3), as_json=as_json)
        assert end.value.exit_code == 3
        assert capsys.readouterr().err == "Note: mind this\n"


def test_words_from_elsewhere_are_no_markup(capsys: pytest.CaptureFixture[str]) -> None:
    name = "[red]a\x1b[31m[/red]"
    console.output.cache_clear()
    view = console.table(name, name, "plain")
    view.add(name, Markup(f"{styled(name, 'bold')} {plain(name)}"))
    console.put_parts([Line(name), Line(Markup(plain(name))), view])
    out = capsys.readouterr().out
    assert out.count("[red]a?[31m[/red]") == 7
    assert "\x1b" not in out


@pytest.mark.usefixtures("narrow")
def test_columns_give_way_and_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    numbers = [Column(name, number=True, min_width=8, gives_way=way) for name, way in (("A", 0), ("B", 2), ("C", 1))]
    view = Table("Title", [Column("Agent", fold=True, elastic=True), *numbers], look={"show_edge": False})
    view.add("somebody", "1", "2", "3")
    console.put_parts([view])
    out = capsys.readouterr().out
    assert out.split()[:3] == ["Title", "Agent", "A"]
    assert "Hidden columns (terminal too narrow): B, C. Use --json to see them." in " ".join(out.split())
    assert max(map(len, out.splitlines())) <= 30


def test_a_section_ends_after_a_row(capsys: pytest.CaptureFixture[str]) -> None:
    view = console.table(None, "x", numbers=["x"])
    view.end_section()
    for number in ("1", "22"):
        view.add(number)
        view.end_section()
    assert [row.ends_section for row in view.rows] == [True, True]
    console.output.cache_clear()
    console.put_parts([view])
    assert "   1 " in capsys.readouterr().out
