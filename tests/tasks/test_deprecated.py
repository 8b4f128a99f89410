"""Deprecated tasks: users are told, and nothing else changes."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest
from typer.testing import CliRunner

from glbench.cli.tasks import app
from glbench.errors import TaskError
from glbench.tasks import get_task, list_tasks, read_lock
from glbench.tasks.references import read_deprecated

OLD, NEW = "glbench/Schiphol2010-Delta10-v1", "glbench/Schiphol2010Code-Delta30-v1"
ENTRY = f'["{OLD}"]\nsince = "0.2.0"\nreason = "its crop is redrawn in every step"\nuse = "{NEW}"\n'
SENTENCE = f"{OLD} is deprecated since glbench 0.2.0: its crop is redrawn in every step. Use {NEW}."


def test_what_is_deprecated_is_published_and_so_is_what_to_use_instead() -> None:
    known = read_lock()
    for task_id, entry in read_deprecated().items():
        assert task_id in known
        assert entry.use is None or (entry.use in known and entry.use not in read_deprecated())


def test_whoever_asks_for_a_deprecated_task_is_told_once(published: Path, caplog: pytest.LogCaptureFixture) -> None:
    digest = read_lock()[OLD].digest
    (published / "deprecated.toml").write_text(ENTRY)
    with caplog.at_level(logging.WARNING, logger="glbench"):
        assert get_task(OLD).digest == digest
        assert get_task(OLD).locked
        get_task(NEW)
    assert caplog.messages == [SENTENCE]
    assert len(list_tasks()) == 2


def test_the_list_of_tasks_shows_it(published: Path) -> None:
    (published / "deprecated.toml").write_text(ENTRY)
    assert f"Deprecated: {SENTENCE}" in CliRunner().invoke(app, ["list"]).stdout


def test_a_damaged_list_is_told(published: Path) -> None:
    (published / "deprecated.toml").write_text(f'["{OLD}"]\nbecause = "it is old"\n')
    with pytest.raises(TaskError, match=r"deprecated\.toml cannot be used"):
        read_deprecated()
