"""Git may write CRLF for LF: digests, and what runs, are the same; what is no text stays as it is."""

from __future__ import annotations

import hashlib
import io
import shutil
from pathlib import Path

import numpy as np
import pytest

from glbench.agents import load_agent
from glbench.agents.baselines import read_baseline
from glbench.agents.identity import digest_of, read_identity
from glbench.agents.loading import copy_examples
from glbench.evaluation.sandbox.choosing import EXAMPLES, protect
from glbench.resources import LARGEST_TEXT, data_folder, sha256_of_files, with_unix_line_ends
from glbench.verification.proof import was_reproduced

AGENT = b'TEXT = """two\nlines"""\n\n\ndef make_agent(task): ...\n'
CARD = b'name = "x"\nauthors = ["A"]\nlicence = "MIT"\ninformation = ["observations"]\n'


def with_crlf(content: bytes) -> bytes:
    return content.replace(b"\r\n", b"\n").replace(b"\n", b"\r\n")


def raw_digest(folder: Path) -> str:
    """The digest of a folder as it has always been, over bytes."""
    digest = hashlib.sha256()
    for file in sorted(folder.iterdir()):
        name, content = file.name.encode(), file.read_bytes()
        digest.update(len(name).to_bytes(8, "big") + name + len(content).to_bytes(8, "big") + content)
    return digest.hexdigest()


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    """A submission with LF, and the same with CRLF in its text; the weights hold both line ends."""
    buffer = io.BytesIO()
    np.savez(buffer, weights=np.frombuffer(b"\r\n\n\r" * 8, np.uint8))
    files = {"agent.py": AGENT, "submission.toml": CARD, "README": b"Read\nme\n", "numbers.json": b"[\n1\n]\n"}
    for place, change in (("lf", bytes), ("crlf", with_crlf)):
        (tmp_path / place / "anna").mkdir(parents=True)
        for name, content in files.items():
            (tmp_path / place / "anna" / name).write_bytes(change(content))
        (tmp_path / place / "anna" / "weights.npz").write_bytes(buffer.getvalue())
        (tmp_path / place / "anna" / "data.bin").write_bytes(b"1\r\n2\n")
    return tmp_path / "lf" / "anna", tmp_path / "crlf" / "anna"


def test_a_submission_has_one_digest_whatever_the_line_ends_of_its_text(folders: tuple[Path, Path]) -> None:
    lf, crlf = map(read_identity, folders)
    assert raw_digest(folders[1]) != raw_digest(folders[0])
    assert lf.digest == crlf.digest == raw_digest(folders[0]), "with LF it is what it has always been"
    assert sha256_of_files(folders[1], list(crlf.all_files())) == lf.digest
    (folders[1] / "data.bin").write_bytes(b"1\n2\n")
    assert read_identity(folders[1]).digest != lf.digest


def test_what_runs_in_a_sandbox_is_what_the_digest_covers(folders: tuple[Path, Path], tmp_path: Path) -> None:
    """A file that reads its own bytes finds the same ones, wherever git put it."""
    copies = []
    for number, folder in enumerate(folders):
        digest_of(read_identity(folder).all_files(), folder, tmp_path / str(number))
        copies.append({file.name: file.read_bytes() for file in (tmp_path / str(number)).iterdir()})
    assert copies[0] == copies[1]
    assert copies[0]["agent.py"] == AGENT
    assert copies[1]["data.bin"] == b"1\r\n2\n"


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("a.py", b"1\r\n2\r3\n", b"1\n2\n3\n"),
        ("A.TOML", b"1\r\n", b"1\n"),
        ("LICENSE", b"1\r\n", b"1\n"),
        ("a.npz", b"1\r\n", b"1\r\n"),
        ("weights", b"1\r\n", b"1\r\n"),
        ("utf16.txt", "1\r\n".encode("utf-16"), "1\r\n".encode("utf-16")),
        ("a.py", b"\xef\xbb\xbf1\n", b"\xef\xbb\xbf1\n"),
    ],
)
def test_text_is_told_by_its_name_and_by_null_bytes(name: str, content: bytes, expected: bytes) -> None:
    assert with_unix_line_ends(name, content) == expected


def test_a_text_too_large_to_hold_is_taken_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "anna").mkdir()
    (tmp_path / "anna" / "agent.py").write_bytes(AGENT)
    (tmp_path / "anna" / "table.csv").write_bytes(b"1\r\n" * (LARGEST_TEXT // 3 + 1))
    assert read_identity(tmp_path / "anna").digest == raw_digest(tmp_path / "anna")


@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_examples_with_crlf_run_where_there_is_no_sandbox(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / f"{name}.py"
    file.write_bytes(with_crlf((data_folder("submissions") / f"{name}.py").read_bytes()))
    monkeypatch.setattr("glbench.evaluation.sandbox.bubblewrap.why_no_sandbox", lambda: "there is no bubblewrap")
    protected = protect(file, "auto")
    assert (protected.protection, protected.agent.digest) == ("unsandboxed", EXAMPLES[name])


def test_examples_that_were_written_before_are_known_again_with_crlf(tmp_path: Path) -> None:
    for file in copy_examples(tmp_path):
        file.write_bytes(with_crlf(file.read_bytes()))
    assert all(b"\r" not in file.read_bytes() for file in copy_examples(tmp_path))


@pytest.mark.parametrize("name", ["rule_based", "grower", "rule_based_tuned", "mpc", "ppo_fast", "recording"])
def test_a_baseline_with_crlf_in_its_pages_is_the_same(tmp_path: Path, name: str) -> None:
    copy = tmp_path / "copy_of_settings"
    shutil.copytree(data_folder("baselines") / name, copy)
    for file in copy.rglob("*"):
        if file.suffix in {".toml", ".yml"}:
            file.write_bytes(with_crlf(file.read_bytes()))
    assert load_agent(copy).digest == read_baseline(name).digest


def test_the_note_on_a_reproduced_result_holds_with_crlf(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = data_folder("reports/released/results") / "Spring-v1"
    for name in ("my_agent.json", "my_agent.proof.json"):
        (tmp_path / name).write_bytes(with_crlf((source / name).read_bytes()))
    monkeypatch.setattr("glbench.verification.proof.is_released", lambda path: True)
    assert was_reproduced(tmp_path / "my_agent.json")
    content = (tmp_path / "my_agent.json").read_bytes()
    (tmp_path / "my_agent.json").write_bytes(content.replace(b'"steps": ', b'"steps":  ', 1))
    assert not was_reproduced(tmp_path / "my_agent.json")
