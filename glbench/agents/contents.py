"""The files of a submission: which ones belong to it, how large they may be, their digest, and copies of them.

Whoever wrote the files may have meant harm, and who reads them may be root. Everything here looks at names first, reads only regular
files, and stops at the limits.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import IO

from glbench.agents.isolation import is_part_of_submission
from glbench.errors import SubmissionError
from glbench.untrusted import MIB, open_regular

LARGEST_SUBMISSION = 512 * MIB
"""Size of all files of a submission together [bytes]."""
MOST_FILES = 10_000
MOST_ENTRIES = 100_000
"""Names in a submission's folder, with hidden files and folders."""
_PIECE = MIB
_COPY_MODE = 0o755
_COPY_TIME = (315_532_800, 315_532_800)
"""Of every copy, so that times tell an agent nothing; 1980 is the first year that zip archives know."""


def files_of_folder(folder: Path) -> tuple[Path, ...]:
    """Every file in a submission's folder; hidden files and Python's caches do not belong to it.

    Raises
    ------
    SubmissionError
        When there are too many, a name cannot be shown, a link leads to a folder, to nothing or out of ``folder``, or there is a pipe,
        a socket or a device.
    OSError
        When a folder cannot be read.
    """
    files: list[Path] = []
    waiting, seen = [folder], 0
    while waiting:
        with os.scandir(waiting.pop()) as entries:
            for entry in entries:
                seen += 1
                if seen > MOST_ENTRIES or len(files) > MOST_FILES:
                    raise SubmissionError(_too_many(folder))
                path = Path(entry.path)
                if not is_part_of_submission(Path(entry.name), Path()):
                    continue
                if not entry.name.isprintable():
                    msg = f"A name in {path.parent} cannot be shown as text: {entry.name!a}. Rename the file or folder."
                    raise SubmissionError(msg)
                if entry.is_dir(follow_symlinks=False):
                    waiting.append(path)
                else:
                    check_file(path, folder)
                    files.append(path)
    if len(files) > MOST_FILES:
        raise SubmissionError(_too_many(folder))
    return tuple(sorted(files))


def check_file(file: Path, root: Path) -> None:
    """Refuse what is no regular file, or a link that leads out of ``root``.

    Raises
    ------
    SubmissionError
        When it is.
    """
    if file.is_symlink():
        if not file.is_file():
            msg = f"{file} is a link to a folder or to nothing, so the digest would not cover what it holds. Copy the files."
            raise SubmissionError(msg)
        if file.readlink().is_absolute() or not file.resolve().is_relative_to(root.resolve()):
            msg = f"{file} is a link that leads out of the submission's folder, and out of its sandbox. Copy the file."
            raise SubmissionError(msg)
    elif not file.is_file():
        msg = f"{file} is neither file nor folder, but a pipe, a socket or a device, which may lead out of the sandbox. Remove it."
        raise SubmissionError(msg)


def check_sizes(files: tuple[Path, ...], root: Path) -> None:
    """Refuse what is too large before any of it is read.

    Raises
    ------
    SubmissionError
        When all files together are larger than ``LARGEST_SUBMISSION``.
    """
    sizes = {file: file.stat().st_size for file in files}
    total = sum(sizes.values())
    if total > LARGEST_SUBMISSION:
        largest = max(files, key=sizes.__getitem__)
        msg = (
            f"The submission has {total / MIB:,.0f} MiB, more than {LARGEST_SUBMISSION / MIB:,.0f} MiB; the largest file is "
            f"{largest.relative_to(root)} ({sizes[largest] / MIB:,.0f} MiB). Leave out what the agent does not need."
        )
        raise SubmissionError(msg)


def digest_of(files: tuple[Path, ...], root: Path, copy: Path | None = None) -> str:
    """SHA-256 (hex) over names and contents, as ``glbench.resources.sha256_of_files`` has it, of at most ``LARGEST_SUBMISSION`` bytes.

    With ``copy``, a folder, what is read for the digest is written below it under the same names: the copies are what the digest covers.

    Raises
    ------
    SubmissionError
        When a file changes while it is read.
    OSError
        When a file cannot be read, or a copy not be written.
    """
    digest, left = sha256(), LARGEST_SUBMISSION
    for name, file in sorted((file.relative_to(root).as_posix(), file) for file in files):
        with open_regular(file) as stream:
            size = os.fstat(stream.fileno()).st_size
            left -= size
            if left < 0:
                raise SubmissionError(_changed(file))
            encoded = name.encode("utf-8")
            digest.update(len(encoded).to_bytes(8, "big") + encoded + size.to_bytes(8, "big"))
            with _copy(copy / name if copy is not None else None) as written:
                for piece in _pieces(stream, size, file):
                    digest.update(piece)
                    if written is not None:
                        written.write(piece)
    if copy is not None:
        _even_out(copy)
    return digest.hexdigest()


def _too_many(folder: Path) -> str:
    return (
        f"The submission in {folder} has more than {MOST_FILES:,} files, or more than {MOST_ENTRIES:,} with hidden files and folders. "
        "Leave out what the agent does not need."
    )


def _changed(file: Path) -> str:
    return f"{file} changes while it is read. Wait until nothing writes to the submission any more."


def _pieces(stream: IO[bytes], size: int, file: Path) -> Iterator[bytes]:
    """The ``size`` bytes that the file had when it was opened, of which nothing may be missing and to which nothing may be added."""
    while size > 0:
        piece = stream.read(min(size, _PIECE))
        if not piece:
            raise SubmissionError(_changed(file))
        size -= len(piece)
        yield piece
    if stream.read(1):
        raise SubmissionError(_changed(file))


@contextmanager
def _copy(place: Path | None) -> Iterator[IO[bytes] | None]:
    if place is None:
        yield None
        return
    place.parent.mkdir(parents=True, exist_ok=True)
    with place.open("xb") as file:
        yield file


def _even_out(folder: Path) -> None:
    """Give all copies the same rights and times: the digest covers names and contents only."""
    for item in (*folder.rglob("*"), folder):
        item.chmod(_COPY_MODE)
        os.utime(item, _COPY_TIME)
