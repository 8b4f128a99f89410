"""Files that are trouble before any code of them is run: refused in words, at once, without filling the memory."""

from __future__ import annotations

import io
import json
import os
import resource
import socket
import struct
import zipfile
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

import pytest

from glbench.agents import load_agent
from glbench.agents.card import check_card
from glbench.agents.identity import LARGEST_SUBMISSION, digest_of, files_of_folder, identify, policy_digest, read_identity
from glbench.agents.saved_policies import torchscript_complaint
from glbench.agents.sb3 import read_archive
from glbench.errors import SubmissionError
from glbench.resources import sha256_of_files

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
    with pytest.raises(SubmissionError, match="has more than 3 files"):
        read_identity(folder)


def test_empty_folders_and_hidden_files_without_end_are_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("glbench.agents.identity.MOST_ENTRIES", 20)
    for number in range(10):
        (folder / f".{number}").touch()
        (folder / f"{number}" / "empty").mkdir(parents=True)
    with pytest.raises(SubmissionError, match="or more than 20 with hidden files and folders"):
        read_identity(folder)


def test_what_lies_in_a_hidden_folder_is_not_even_looked_at(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("glbench.agents.identity.MOST_ENTRIES", 5)
    for place in (".git", "__pycache__"):
        (folder / place).mkdir()
        for number in range(10):
            os.mkfifo(folder / place / str(number))
    assert read_identity(folder).all_files() == (folder / "agent.py",)


@pytest.mark.parametrize("name", [b"caf\xe9.txt", b"\x1b[2J.txt", b"two\nlines", "\u202eevil".encode()], ids=ascii)
def test_a_name_that_cannot_be_shown_is_refused_in_words(folder: Path, name: bytes) -> None:
    (folder / "deep").mkdir()
    (folder / "deep" / os.fsdecode(name)).touch()
    with pytest.raises(SubmissionError, match=r"deep cannot be shown as text: '.*'. Rename the file or folder") as refused:
        read_identity(folder)
    assert str(refused.value).isprintable()


def test_files_that_grow_or_shrink_while_they_are_read_are_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = files_of_folder(folder)
    (folder / "agent.py").write_bytes(b"x" * 100)
    honest = os.fstat
    for size in (99, 101, 2**40):
        monkeypatch.setattr(os, "fstat", lambda fd, s=size: os.stat_result((*honest(fd)[:6], s, *honest(fd)[7:10])))
        with pytest.raises(SubmissionError, match=r"agent.py changes while it is read"):
            digest_of(files, folder)


@pytest.mark.parametrize("place", ["/proc/self/maps", "/dev/zero", "/proc/kmsg"])
@pytest.mark.parametrize("name", ["weights.bin", "submission.toml"])
def test_links_to_files_without_end_are_not_followed(folder: Path, place: str, name: str) -> None:
    (folder / name).symlink_to(place)
    with pytest.raises(SubmissionError, match="is a link"):
        read_identity(folder)


def test_a_submission_that_is_itself_a_link_is_refused(folder: Path, tmp_path: Path) -> None:
    for target in (folder, folder / "agent.py"):
        link = tmp_path / f"eve{target.suffix}"
        link.symlink_to(target)
        for read in (identify, load_agent):
            with pytest.raises(SubmissionError, match=r"eve(\.py)? is a link\. Name the file or folder that it leads to"):
                read(link)


def test_a_file_beside_a_submission_that_is_a_link_to_elsewhere_is_refused(tmp_path: Path) -> None:
    (tmp_path / "anna").mkdir()
    (tmp_path / "anna" / "anna.onnx").write_bytes(b"x")
    (tmp_path / "secret").write_text("42", encoding="utf-8")
    (tmp_path / "anna" / "anna.onnx.data").symlink_to(tmp_path / "secret")
    with pytest.raises(SubmissionError, match=r"anna.onnx.data is a link that leads out"):
        read_identity(tmp_path / "anna" / "anna.onnx")


def test_a_card_cannot_name_a_file_that_the_digest_does_not_cover(folder: Path) -> None:
    (folder / "deep" / ".hidden").mkdir(parents=True)
    (folder / "deep" / ".hidden" / "model.onnx").write_bytes(b"x")
    (folder / "submission.toml").write_text(CARD + 'model = "deep/.hidden/model.onnx"\n', encoding="utf-8")
    with pytest.raises(SubmissionError, match="the folder has none of that name that is not hidden"):
        read_identity(folder)


def test_a_copy_has_the_digest_of_the_original_and_tells_nothing_else(folder: Path, tmp_path: Path) -> None:
    (folder / "deep").mkdir()
    (folder / "deep" / "weights.bin").write_bytes(bytes(3 << 20))
    (folder / "deep" / "same").symlink_to("weights.bin")
    (folder / "empty").mkdir()
    (folder / ".secret").write_text("42", encoding="utf-8")
    os.utime(folder / "agent.py", (42, 42))
    (folder / "agent.py").chmod(0o600)
    files = files_of_folder(folder)
    digest = digest_of(files, folder, tmp_path / "copy")

    assert digest == digest_of(files, folder) == sha256_of_files(folder, list(files)) == read_identity(folder).digest
    copies = sorted((tmp_path / "copy").rglob("*"))
    assert [str(item.relative_to(tmp_path / "copy")) for item in copies] == [
        "agent.py", "deep", "deep/same", "deep/weights.bin",
    ]  # fmt: skip
    assert not any(item.is_symlink() for item in copies)
    assert len({(item.stat().st_mtime, item.stat().st_mode & 0o777) for item in copies}) == 1


def pipe(place: Path) -> None:
    os.mkfifo(place)


def bound_socket(place: Path) -> None:
    with socket.socket(socket.AF_UNIX) as sock:
        sock.bind(str(place))


@pytest.mark.parametrize("make", [pipe, bound_socket])
def test_what_is_no_file_may_lead_out_of_the_sandbox(folder: Path, make: Callable[[Path], None], monkeypatch: pytest.MonkeyPatch) -> None:
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
    with pytest.raises(SubmissionError, match="1 to 100 letters"):
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


def test_an_archive_with_names_without_end_is_refused_at_once(tmp_path: Path) -> None:
    entry = struct.pack("<4s4B4HL2L5H2L", b"PK\1\2", 20, 3, 20, *[0] * 8, 1, *[0] * 6) + b"a"
    names = entry * (2**23 // len(entry))
    end = struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, 65535, 65535, len(names), 0, 0)
    file = tmp_path / "names.zip"
    file.write_bytes(names + end)
    with pytest.raises(SubmissionError, match="its table of contents is longer than 4 MiB"):
        read_archive(file)
    assert "is not even an archive" in (torchscript_complaint(file) or "")
    bytes_alone = sha256(file.read_bytes()).hexdigest()
    assert policy_digest([file]) == sha256(bytes_alone.encode()).hexdigest(), "its table of contents is not read"


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"[" * 200_000, "recursion"),
        (b"[]", "its settings are no table"),
        (b"\xff", "decode"),
        (json.dumps({**SETTINGS, "num_timesteps": "x"}).encode(), "not a number"),
        (json.dumps({**SETTINGS, "num_timesteps": float("inf")}).encode(), "not a number"),
        (json.dumps({**SETTINGS, "observation_space": {":type:": "Box'>", "_shape": [{}]}}).encode(), "not a number"),
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
    assert "is not even an archive" in (torchscript_complaint(file) or "")
    bytes_alone = sha256(file.read_bytes()).hexdigest()
    assert policy_digest([file]) == sha256(bytes_alone.encode()).hexdigest(), "its table of contents is not read"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (CARD.replace('"x"', '"\\u001b[2Jx"'), "U+001B cannot be shown"),
        (CARD.replace('"x"', '"\\u202ex"'), "U+202E cannot be shown"),
        ("x = " + "[" * 20_000 + "]" * 20_000, "nested without end"),
        ("# " + "x" * 100_000, "larger than 64 KiB"),
        (CARD + f'"{"k" * 500}" = 1', "k ... is not a key of a card"),
        (CARD + '"\\u001b[2J" = 1', r"'\x1b[2J' is not a key of a card"),
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
