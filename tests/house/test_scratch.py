"""Folders for copies go with the work, and are cleared away where a kill left them."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import pytest

from glbench.resources import Scratch


@pytest.fixture(autouse=True)
def own_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))


def test_there_is_no_folder_until_one_is_asked_for_and_none_afterwards(tmp_path: Path) -> None:
    scratch = Scratch()
    assert list(tmp_path.iterdir()) == []
    (scratch.folder() / "copy").write_text("x", encoding="utf-8")
    assert scratch.folder() == scratch.folder()
    scratch.remove()
    scratch.remove()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_a_kill_left_goes_with_the_next_and_one_in_use_stays(tmp_path: Path) -> None:
    in_use, left = Scratch(), Scratch()
    left_behind = left.folder()
    assert left._lock is not None
    left._lock.release()  # as the system does for a process that is gone
    (left_behind / ".in-use").touch()
    for folder in (in_use.folder(), left_behind):
        os.utime(folder, (0.0, 0.0))
    fresh = Scratch()
    assert set(tmp_path.iterdir()) == {in_use.folder(), left_behind}
    fresh.folder()
    assert set(tmp_path.iterdir()) == {in_use.folder(), fresh.folder()}
    in_use.remove()
    fresh.remove()
