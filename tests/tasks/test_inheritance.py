"""A task file may name a base and say only what differs; the result is as if it were written out."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from glbench.cli.tasks import app
from glbench.episodes.header import definition_json, task_of
from glbench.errors import TaskError, UnknownNameError
from glbench.tasks import get_task
from tests.tasks.names import FILE, SHORT_ID

Write = Callable[[str], Path]
OWN = """\
base = "glbench/Schiphol2010-Delta10-v1"
id = "mylab/Spring2011-v1"
title = "Spring 2011, dearer heat"
weather.start = 2011-03-01
prices.heat = { value = 0.12, unit = "EUR kWh-1" }
constraints.co2.high = 1200.0
"""


def test_a_task_with_a_base_is_the_task_written_out(write: Write, own_text: str, tmp_path: Path) -> None:
    task = get_task(write(OWN))
    text = own_text.replace(f'id = "mylab/{SHORT_ID}"', 'id = "mylab/Spring2011-v1"')
    for old, new in (("2010-03-01", "2011-03-01"), ("value = 0.09", "value = 0.12"), ("high = 1600.0", "high = 1200.0")):
        text = text.replace(old, new)
    whole = tmp_path / "whole.toml"
    whole.write_text(re.sub(r"title = .*", 'title = "Written out"', text), encoding="utf-8")
    assert task.definition() == get_task(whole).definition()
    assert task.digest == get_task(whole).digest
    assert (task.title, task.description, task.suites) == ("Spring 2011, dearer heat", "", ())


def test_records_hold_the_whole_task_and_need_no_base(write: Write) -> None:
    task = get_task(write(OWN))
    attached = definition_json(task)
    assert b"base" not in attached
    assert task_of(attached).digest == task.digest


def test_a_base_may_be_a_file_beside_it_with_a_base_of_its_own(write: Write, tmp_path: Path) -> None:
    base = write(OWN)
    again = tmp_path / "again.toml"
    again.write_text(f'base = "{base.name}"\nid = "mylab/Again-v1"\ntitle = "Again"\n[weather]\ndays = 5\n', "utf-8")
    task = get_task(again)
    assert (task.steps, task.prices.heat) == (480, 0.12)
    base.write_text(OWN.replace("0.12", "0.13"), encoding="utf-8")
    assert get_task(again).prices.heat == 0.13, "a changed base is read again"


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        ('base = "mine.toml"', TaskError, "is its own base (mine.toml -> mine.toml)"),
        ('base = "Schiphol2010-Delta11-v1"', UnknownNameError, "Did you mean 'Schiphol2010-Delta1"),
        ('base = "nothing.toml"', TaskError, "There is no task file"),
        ("base = 3", TaskError, "base = 3 is neither the id of a task nor a file beside this one"),
        (f'base = "{SHORT_ID}"', TaskError, "lacks the key 'id'"),
        (OWN.replace("weather.start", "weather.begin"), TaskError, "'begin' is not a key of [weather]"),
        (OWN.replace("1200.0", "200.0"), TaskError, "low = 300 must be below high = 200"),
        (OWN.replace("mylab/Spring2011-v1", f"glbench/{SHORT_ID}"), TaskError, "Give your task an id of your own"),
    ],
)
def test_a_mistake_is_told_in_words(write: Write, text: str, error: type[Exception], words: str) -> None:
    with pytest.raises(error) as caught:
        get_task(write(text))
    assert words in str(caught.value)


def test_a_file_without_base_and_model_is_told_to_name_a_base(tmp_path: Path) -> None:
    file = tmp_path / "empty.toml"
    file.write_text('id = "my/Empty-v1"\ntitle = "Nothing else"\n', encoding="utf-8")
    with pytest.raises(TaskError, match=r'names no base and is no whole task\. Add base = "glbench/GreenhouseReal-v1"'):
        get_task(file)


def test_bases_in_a_circle_are_refused_with_the_way(tmp_path: Path) -> None:
    for name, base in (("a", "b"), ("b", "c"), ("c", "a")):
        (tmp_path / f"{name}.toml").write_text(f'base = "{base}.toml"\n', encoding="utf-8")
    with pytest.raises(TaskError, match=r"\(a\.toml -> b\.toml -> c\.toml -> a\.toml\)"):
        get_task(tmp_path / "a.toml")


def test_a_published_base_that_was_edited_is_refused(published: Path, write: Write) -> None:
    file = published / FILE
    file.write_text(file.read_text(encoding="utf-8").replace("delta = 0.10", "delta = 0.11"), encoding="utf-8")
    with pytest.raises(TaskError, match=rf"tasks/{FILE} no longer matches"):
        get_task(write(OWN))


def test_show_names_the_base_and_every_change(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = " ".join(CliRunner().invoke(app, ["show", str(write(OWN))]).stdout.split())
    assert "Based on glbench/Schiphol2010-Delta10-v1, changed:" in shown
    assert "weather.start = 2011-03-01 (there 2010-03-01)" in shown
    assert "constraints.co2 = { low = 300.0, high = 1200.0" in shown
    assert 'prices.heat = { value = 0.12, unit = "EUR kWh-1" } (there { value = 0.09' in shown


def test_what_is_no_file_is_not_waited_for(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.toml"
    os.mkfifo(pipe)
    for path in (pipe, tmp_path, Path("/dev/zero")):
        with pytest.raises(TaskError, match="it is a folder, a pipe or a device"):
            get_task(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("#" * 2_000_000, "it is larger than 1 MiB"),
        ("schema = " + "[" * 100_000, "holds a number or a nesting that no task has"),
        ("schema = " + "[" * 20 + "]" * 20, "nested more than 8 deep"),
        ("schema = " + "9" * 5000, "holds a number or a nesting that no task has"),
        ("schema = 0x" + "f" * 5000, "schema is a whole number beyond 64 bits"),
        ("weather.days = 99999999999999999999", "days is a whole number beyond 64 bits"),
    ],
)
def test_a_file_beyond_all_measure_is_refused_in_words(write: Write, text: str, words: str) -> None:
    with pytest.raises(TaskError) as caught:
        get_task(write(text))
    assert words in str(caught.value)
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize(
    ("new", "words"),
    [
        (r'title = "red \u001b[31m"', "holds the character U+001B"),
        (r'title = "two\nlines"', "It must be one line"),
        (r'title = "left to \u202e right"', "holds the character U+202E"),
        (r'suites = ["\u0007"]' + '\ntitle = "bell"', "holds the character U+0007"),
        ('title = "late"\nweather.start = 9999-12-31', "in the years 1900 to 2199"),
    ],
)
def test_texts_and_days_that_nothing_can_show_are_refused(write: Write, new: str, words: str) -> None:
    with pytest.raises(TaskError) as caught:
        get_task(write(f'base = "{SHORT_ID}"\nid = "mylab/Odd-v1"\n{new}\n'))
    assert words in str(caught.value)
    assert "\x1b" not in str(caught.value)
