"""``glbench report`` as a newcomer types it."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from glbench.errors import GlbenchError
from glbench.evaluation.profiles import profile_path
from glbench.report import page
from tests.cli.conftest import glbench as glbench


@pytest.fixture
def folder(made, tmp_path):
    """A folder of one's own with one result and its recorded actions."""
    shutil.copytree(made.folder / "results" / "Days-v1", tmp_path / "results" / "Days-v1")
    return tmp_path


@pytest.mark.slow
def test_the_page_is_written_and_named(glbench, folder):
    answer = glbench("report", "--out", folder)
    assert answer.code == 0
    assert str(folder / "index.html") in answer.out
    assert (folder / "index.html").read_text(encoding="utf-8").startswith("<!doctype html>")


def test_a_mistyped_folder_is_not_made(glbench, folder):
    answer = glbench("report", "--out", folder.with_name(f"{folder.name}x"))
    assert answer.code == 1
    assert f"Did you mean '{folder.name}'" in " ".join(answer.err.split())
    assert not folder.with_name(f"{folder.name}x").exists()


@pytest.mark.usefixtures("few_released")
def test_missing_profiles_are_named_and_can_be_made(glbench, folder):
    path = folder / "results" / "Days-v1" / "thrifty.json"
    kept = profile_path(path).read_bytes()
    profile_path(path).unlink()
    assert "Days-v1/thrifty" in glbench("report", "--out", folder).err
    answer = glbench("report", "--out", folder, "--complete", "--workers", "1")
    assert f"Made: {profile_path(path)}" in answer.err
    assert profile_path(path).read_bytes() == kept
    trial = Path(shutil.copytree(path.parent, folder / "trials" / "results" / "Days-v1")) / path.name
    profile_path(trial).unlink()
    path.with_name("broken.json").write_text('{"schema": 1')
    assert glbench("report", "--out", folder, "--complete", "--workers", "1").code == 0
    assert profile_path(trial).read_bytes() == kept


@pytest.mark.usefixtures("few_released")
def test_a_page_that_is_to_be_opened_is_given_to_the_browser(glbench, folder, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or True)
    assert glbench("report", "--out", folder, "--open").code == 0
    assert opened == [(folder / "index.html").as_uri()]


def test_a_folder_that_cannot_be_written_to_is_known_before_the_page_is_computed(tmp_path, monkeypatch):
    monkeypatch.setattr(page, "build_report", lambda _: pytest.fail("computed a page that has no place"))
    loop, file = tmp_path / "loop", tmp_path / "file"
    loop.symlink_to(loop)
    file.touch()
    for out in (loop, file):
        with pytest.raises(GlbenchError, match=r"Cannot write into .*: a file, or a link that leads nowhere"):
            page.write_report(out)
