"""Folders with settings for a built-in controller come from anybody and are read outside of the sandbox: each ends in a sentence."""

from __future__ import annotations

import io
import os
import struct
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from glbench.agents import load_agent
from glbench.agents.baselines import LARGEST_ARCHIVE
from glbench.errors import SubmissionError
from glbench.resources import data_folder
from glbench.tasks import get_task, task_card


def write(folder: Path, controller: str, settings: str, content: bytes | None = None) -> Path:
    place = folder / "mine"
    place.mkdir()
    card = {"title": "t", "controller": controller, "settings": settings, "description": "d", "made": "m"}
    text = "".join(f'{key} = "{value}"\n' for key, value in card.items()) + "sources = []\n"
    (place / "card.toml").write_text(text, encoding="utf-8")
    if content is not None:
        (place / settings).write_bytes(content)
    return place


def refused(folder: Path, words: str = ".") -> None:
    with pytest.raises(SubmissionError, match=words) as caught:
        load_agent(folder).make(task_card(get_task("Schiphol2010-Delta10-v1")))
    assert len(str(caught.value)) < 2000


def archive(**changes: object) -> bytes:
    arrays = dict(np.load(data_folder("baselines") / "recording" / "actions.npz"))
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, value in {**arrays, **changes}.items():
            piece = io.BytesIO()
            np.save(piece, value)
            packed.writestr(f"{name}.npy", value if isinstance(value, bytes) else piece.getvalue())
    return file.getvalue()


def header(shape: str) -> bytes:
    text = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}".encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


@pytest.mark.parametrize("settings", ["/dev/zero", "../../../../../../etc/passwd", "../other.yml"])
@pytest.mark.parametrize("controller", ["rule_based", "network", "recording"])
def test_settings_outside_of_the_folder_are_not_read(tmp_path, controller, settings):
    (tmp_path / "other.yml").touch()
    refused(write(tmp_path, controller, settings), "lie elsewhere")


@pytest.mark.skipif(sys.platform == "win32", reason="no pipes in folders")
@pytest.mark.parametrize("controller", ["rule_based", "network", "recording"])
def test_a_pipe_or_a_link_to_a_device_is_neither_waited_for_nor_read(tmp_path, controller):
    folder = write(tmp_path, controller, "x.npz")
    os.mkfifo(folder / "x.npz")
    refused(folder, "pipe")
    (folder / "x.npz").unlink()
    (folder / "x.npz").symlink_to("/dev/zero")
    refused(folder, "lie elsewhere")


@pytest.mark.parametrize(
    "content",
    [b"a: " + b"[" * 50_000, b"lamps_on: " + b"9" * 6000, b"lamps_on: 2010-13-45", b"\0", b"\xff"],
    ids=["deep", "digits", "date", "null", "no text"],
)
def test_yaml_that_python_does_not_like(tmp_path, content):
    refused(write(tmp_path, "rule_based", "x.yml", content))


@pytest.mark.parametrize(
    "content", [b"a = " + b"[" * 50_000, b"a = " + b"9" * 6000, b".".join([b"a"] * 20_000) + b" = 1"], ids=["deep", "digits", "dots"]
)
def test_a_card_that_python_does_not_like(tmp_path, content):
    folder = write(tmp_path, "rule_based", "x.yml")
    (folder / "card.toml").write_bytes(content)
    refused(folder, "Cannot read the card")


def test_a_name_of_settings_with_a_null_character(tmp_path):
    refused(write(tmp_path, "rule_based", "a\\u0000b"))


@pytest.mark.parametrize(
    "change",
    [
        {"actions": header("(10000000000000,)")},
        {"actions": header("(99999999999999999999,)")},
        {"actions": header("(" * 3000)},
        {"format": np.array([1, 2])},
        {"names": np.array(3)},
        {"about": np.array("[" * 100_000)},
        {"low": np.array(1.0)},
    ],
    ids=["vast", "overflow", "header", "format", "names", "about", "low"],
)
def test_an_archive_of_arrays_that_numpy_does_not_like(tmp_path, change):
    refused(write(tmp_path, "recording", "x.npz", archive(**change)))


@pytest.mark.parametrize("controller", ["network", "recording"])
def test_an_archive_that_expands_without_limit_is_not_unpacked(tmp_path, controller):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as packed, packed.open("mean.npy", "w") as entry:
        for _ in range(LARGEST_ARCHIVE // 2**20 + 1):
            entry.write(bytes(2**20))
    refused(write(tmp_path, controller, "x.npz", file.getvalue()), "expands to more than")


@pytest.mark.parametrize("controller", ["network", "recording"])
def test_an_archive_with_names_without_end_is_refused_at_once(tmp_path, controller):
    entry = struct.pack("<4s4B4HL2L5H2L", b"PK\1\2", 20, 3, 20, *[0] * 8, 1, *[0] * 6) + b"a"
    names = entry * (2**23 // len(entry))
    end = struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, 65535, 65535, len(names), 0, 0)
    refused(write(tmp_path, controller, "x.npz", names + end), "its table of contents is longer than 4 MiB")
