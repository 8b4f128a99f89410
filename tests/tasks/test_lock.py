"""A published task never changes: an edited one is refused, and the message says what differs."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

import glbench.model
from glbench.errors import TaskError, UnknownNameError
from glbench.model import TOMATO
from glbench.tasks import Quantity, get_task, list_tasks, lock_new_tasks, read_lock
from glbench.tasks.vocabulary import OBSERVATION_MODULES, ObservationModule
from tests.tasks.names import FILE, SHORT_ID

ADVICE = "Published tasks never change: restore the file, or add your change as a new version and run `glbench tasks lock`."


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert text.count(old) == 1
    path.write_text(text.replace(old, new), encoding="utf-8")


def test_one_changed_character_is_refused(published: Path) -> None:
    locked = read_lock()[f"glbench/{SHORT_ID}"].fingerprint.definition
    assert get_task(SHORT_ID).locked
    edit(published / FILE, "delta = 0.10", "delta = 0.11")
    with pytest.raises(TaskError) as caught:
        get_task(SHORT_ID)
    message = str(caught.value)
    assert message.startswith(f"tasks/{FILE} no longer matches tasks/lock.toml (locked {locked[:8]}..., found ")
    assert message.endswith(ADVICE)


def test_an_edited_task_is_refused_before_its_impossible_weather_is_looked_for(published: Path) -> None:
    edit(published / FILE, "2010-03-01", "1910-03-01")
    with pytest.raises(TaskError, match=r"no longer matches tasks/lock\.toml"):
        get_task(SHORT_ID)


def test_the_list_refuses_a_changed_task_too(published: Path) -> None:
    edit(published / FILE, "runs = 30", "runs = 31")
    with pytest.raises(TaskError, match=r"no longer matches tasks/lock\.toml"):
        list_tasks()


def test_comments_and_prose_of_a_published_task_may_change(published: Path) -> None:
    digest = get_task(SHORT_ID).digest
    edit(published / FILE, 'title = "', 'title = "Now: ')
    edit(published / FILE, "# KNMI station 240", "# Station 240 of KNMI")
    assert get_task(SHORT_ID).digest == digest


def test_another_model_is_named_as_the_reason(published: Path, forget: Callable[[], None], monkeypatch: pytest.MonkeyPatch) -> None:
    changed = replace(TOMATO, stated_version="1.1.0-changed")
    monkeypatch.setattr(glbench.model, "get_model", lambda model_id, variant: changed)
    forget()
    with pytest.raises(TaskError) as caught:
        get_task(SHORT_ID)
    message = str(caught.value)
    assert f"tasks/{FILE} is as it was published, but the model is another one" in message
    assert "here version 1.1.0-changed" in message
    assert "install the glbench version that the task was locked with" in message
    assert ADVICE not in message


@pytest.mark.parametrize(
    ("part", "words"),
    [
        ("weather", "the weather 'schiphol' has other values, or is prepared in another way"),
        ("parameters", "the parameter set 'benchmark' has other values"),
        ("start", "the start 'mature_crop' is another one"),
    ],
)
def test_other_weather_parameters_or_start_are_named_as_the_reason(published: Path, part: str, words: str) -> None:
    text = (published / "lock.toml").read_text(encoding="utf-8")
    changed = re.sub(rf'^(digest|{part}) = "....', r'\1 = "0000', text, flags=re.MULTILINE)
    (published / "lock.toml").write_text(changed, encoding="utf-8")
    with pytest.raises(TaskError, match=rf"is as it was published, but {words} \(locked 0000"):
        get_task(SHORT_ID)


def test_other_columns_are_named_as_the_reason(published: Path, forget: Callable[[], None], monkeypatch: pytest.MonkeyPatch) -> None:
    wider = ObservationModule("crop", "", lambda context: (Quantity("fruit_dry_mass", "kg m-2", 0.0, 99.0, ""),))
    monkeypatch.setitem(OBSERVATION_MODULES._entries, "crop", wider)
    forget()
    with pytest.raises(TaskError, match="but the observed columns have other names, units or bounds"):
        get_task(SHORT_ID)


def test_locking_adds_new_tasks_and_leaves_the_others_alone(published: Path) -> None:
    before = dict(read_lock())
    new = published / "schiphol2010-delta10-v2.toml"
    new.write_text((published / FILE).read_text(encoding="utf-8"), encoding="utf-8")
    edit(new, f'id = "glbench/{SHORT_ID}"', 'id = "glbench/Schiphol2010-Delta10-v2"')
    edit(new, "delta = 0.10", "delta = 0.12")
    assert not get_task("Schiphol2010-Delta10-v2").locked
    assert [entry.id for entry in lock_new_tasks()] == ["glbench/Schiphol2010-Delta10-v2"]
    after = read_lock()
    assert {task_id: after[task_id] for task_id in before} == before
    assert get_task("Schiphol2010-Delta10-v2").locked
    assert lock_new_tasks() == ()


def test_locking_refuses_a_changed_task_and_writes_nothing(published: Path) -> None:
    text = (published / "lock.toml").read_text(encoding="utf-8")
    edit(published / FILE, "delta = 0.10", "delta = 0.11")
    with pytest.raises(TaskError, match="no longer matches"):
        lock_new_tasks()
    assert (published / "lock.toml").read_text(encoding="utf-8") == text


def test_locking_wants_the_file_called_after_its_task(published: Path) -> None:
    text = (published / FILE).read_text(encoding="utf-8").replace(SHORT_ID, "Winter-v1")
    (published / "other.toml").write_text(text, encoding="utf-8")
    with pytest.raises(TaskError, match=r"its file must be called winter-v1\.toml"):
        lock_new_tasks()


def test_a_file_of_ones_own_may_not_pass_for_a_published_task(published: Path, tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    own.write_text((published / FILE).read_text(encoding="utf-8"), encoding="utf-8")
    assert get_task(own).locked
    edit(own, "delta = 0.10", "delta = 0.01")
    with pytest.raises(TaskError, match=f"Give your task an id of your own, such as 'mylab/{SHORT_ID}'"):
        get_task(own)


@pytest.mark.parametrize("damage", ["not toml", '["glbench/X-v1"]\nfile = "x.toml"\n', "a = 1\n"])
def test_a_damaged_lock_is_said_to_be_one(published: Path, damage: str) -> None:
    (published / "lock.toml").write_text(damage, encoding="utf-8")
    with pytest.raises(TaskError, match=r"Cannot read .*lock\.toml.*Restore the file"):
        get_task(SHORT_ID)


def test_a_broken_file_does_not_hide_the_other_tasks(published: Path) -> None:
    (published / FILE).write_text("[", encoding="utf-8")
    assert get_task("Schiphol2010Code-Delta30-v1").locked
    with pytest.raises(TaskError, match=f"tasks/{FILE} is no valid TOML"):
        get_task(SHORT_ID)


def test_a_digest_edited_in_the_lock_is_told_as_that(published: Path, forget: Callable[[], None]) -> None:
    path = published / "lock.toml"
    text = path.read_text(encoding="utf-8")
    path.write_text(re.sub(r'^digest = "....', 'digest = "0000', text, flags=re.MULTILINE), encoding="utf-8")
    forget()
    with pytest.raises(TaskError, match=r"lock.toml contradicts itself about glbench/.*locked 0000") as refused:
        get_task("Schiphol2010-Delta10-v1")
    assert "but ." not in str(refused.value)


@pytest.mark.parametrize("wrong", [5, None, 2.5])
def test_a_task_is_asked_for_by_id_or_file(wrong: object) -> None:
    with pytest.raises(UnknownNameError, match="A task is asked for by its id"):
        get_task(wrong)  # type: ignore[arg-type]
