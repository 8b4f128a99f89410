"""Files that are trouble before any code of them is run: refused in words, at once, without filling the memory."""

from __future__ import annotations

import io
import json
import os
import resource
import socket
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from glbench.agents import load_agent
from glbench.agents.card import check_card
from glbench.agents.formats.sb3_archive import read_archive
from glbench.agents.formats.torchscript import torchscript_complaint
from glbench.agents.identity import LARGEST_SUBMISSION, identify, read_identity
from glbench.errors import SubmissionError

CARD = 'name = "x"\nauthors = ["A"]\nlicence = "MIT"\ninformation = ["observations"]\n'
SETTINGS = {"clip_range": 1, "gae_lambda": 1, "num_timesteps": 1}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    place = tmp_path / "anna"
    place.mkdir()
    (place / "agent.py").write_text("def make_agent(task): ...\n", encoding="utf-8")
    return place


def model(file: Path, data: bytes, packed: int = zipfile.ZIP_STORED) -> Path:
    with zipfile.ZipFile(file, "w", packed) as archive:
        archive.writestr("data", data)
        archive.writestr("policy.pth", b"x")
    return file


def test_a_file_of_a_terabyte_is_refused_before_it_is_read(folder: Path) -> None:
    with (folder / "weights.bin").open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(SubmissionError, match=r"1,048,576 MiB, more than 512 MiB; the largest file is weights.bin"):
        read_identity(folder)
    assert LARGEST_SUBMISSION == 512 * 2**20


def test_thousands_of_files_are_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("glbench.agents.identity.MOST_FILES", 3)
    for number in range(3):
        (folder / str(number)).touch()
    with pytest.raises(SubmissionError, match="has 4 files, more than 3"):
        read_identity(folder)


def pipe(place: Path) -> None:
    os.mkfifo(place)


def bound_socket(place: Path) -> None:
    with socket.socket(socket.AF_UNIX) as sock:
        sock.bind(str(place))


@pytest.mark.parametrize("make", [pipe, bound_socket])
def test_what_is_no_file_may_lead_out_of_the_sandbox(
    folder: Path, make: Callable[[Path], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)  # names of sockets are short
    make(Path("way"))
    with pytest.raises(SubmissionError, match="way is neither file nor folder, but a pipe, a socket or a device"):
        read_identity(folder)


def test_a_pipe_is_no_submission_and_nobody_waits_for_it(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "anna.py")
    assert identify(tmp_path / "anna.py") is None


def test_a_name_is_short_enough_to_be_a_files(tmp_path: Path) -> None:
    file = tmp_path / f"{'n' * 101}.py"
    file.touch()
    with pytest.raises(SubmissionError, match="has 101 characters, more than 100"):
        read_identity(file)


def test_an_archive_that_would_fill_the_memory_does_not(tmp_path: Path) -> None:
    file = tmp_path / "bomb.zip"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        with archive.open("data", "w") as stream:
            for _ in range(200):
                stream.write(bytes(2**20))
        archive.writestr("policy.pth", b"x")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(SubmissionError, match="'data' in it is longer than 64 MiB"):
        read_archive(file)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 180 * 1024


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"[" * 200_000, "recursion"),
        (b"[]", "its settings are no table"),
        (b"\xff", "decode"),
        (json.dumps({**SETTINGS, "num_timesteps": "x"}).encode(), "no number"),
        (json.dumps({**SETTINGS, "num_timesteps": float("inf")}).encode(), "no number"),
        (json.dumps({**SETTINGS, "observation_space": {":type:": "Box'>", "_shape": [{}]}}).encode(), "no number"),
    ],
    ids=["nested", "list", "bytes", "steps", "infinite", "shape"],
)
def test_settings_that_make_no_sense_are_told_in_words(tmp_path: Path, data: bytes, words: str) -> None:
    with pytest.raises(SubmissionError, match=words):
        read_archive(model(tmp_path / "model.zip", data))


def test_an_encrypted_archive_is_told_in_words(tmp_path: Path) -> None:
    content = model(tmp_path / "model.zip", b"{}").read_bytes()
    encrypted = bytearray(content)
    for mark, flags in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        encrypted[content.index(mark) + flags] = 1
    file = tmp_path / "locked.zip"
    file.write_bytes(bytes(encrypted))
    with pytest.raises(SubmissionError, match="encrypted"):
        read_archive(file)


def test_a_cut_archive_is_no_torchscript(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("a/data.pkl", b"x")
    content = buffer.getvalue()
    start = content.index(b"PK\x01\x02")
    file = tmp_path / "policy.pt"
    file.write_bytes(content[:start] + bytes(46) + content[start + 46 :])
    assert "is no archive at all" in (torchscript_complaint(file) or "")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (CARD.replace('"x"', '"\\u001b[2Jx"'), "U+001B cannot be shown"),
        (CARD.replace('"x"', '"\\u202ex"'), "U+202E cannot be shown"),
        ("x = " + "[" * 20_000 + "]" * 20_000, "nested without end"),
        ("# " + "x" * 100_000, "larger than 64 KiB"),
        (CARD + f'"{"k" * 500}" = 1', "k ... is no key of a card"),
        (CARD + '"\\u001b[2J" = 1', r"'\x1b[2J' is no key of a card"),
    ],
    ids=["escape", "turned", "nested", "long", "long key", "key"],
)
def test_a_card_cannot_steer_a_terminal_or_take_long(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "submission.toml"
    file.write_text(text, encoding="utf-8")
    card, problems = check_card(file)
    assert card is None
    assert any(words in problem for problem in problems), problems


def test_a_card_with_the_mark_of_windows_editors_is_read(tmp_path: Path) -> None:
    file = tmp_path / "submission.toml"
    file.write_bytes(b"\xef\xbb\xbf" + CARD.replace("\n", "\r\n").encode())
    card, problems = check_card(file)
    assert problems == []
    assert card is not None


def test_a_source_nested_without_end_is_told_in_words(tmp_path: Path) -> None:
    file = tmp_path / "anna.py"
    file.write_text("x = " + "-" * 200_000 + "1\n", encoding="utf-8")
    with pytest.raises(SubmissionError, match=r"anna.py is no valid Python: it is nested too deeply"):
        load_agent(file)
