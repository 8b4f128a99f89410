"""Opening zip archives of strangers: their tables of contents are read into memory as a whole, so they must be small."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from zipfile import ZipFile

_LONGEST_READ = 4 * 2**20
"""Bytes that are read at once: tens of thousands of names, where a model has hundreds."""


@contextmanager
def opened_archive(file: Path) -> Iterator[ZipFile]:
    """The archive in ``file``.

    Raises
    ------
    ValueError
        When its table of contents is too long.
    OSError, zipfile.BadZipFile, NotImplementedError
        As ``ZipFile`` does.
    """
    with _InPieces(file) as stream, ZipFile(stream) as archive:
        yield archive


class _InPieces(io.FileIO):
    """A file of which only so much can be read at once."""

    def read(self, size: int | None = -1, /) -> bytes:
        """At most ``size`` bytes, or all that are left."""
        if size is None or size < 0:
            here = self.tell()
            size = self.seek(0, io.SEEK_END) - here
            self.seek(here)
        if size > _LONGEST_READ:
            msg = f"its table of contents is longer than {_LONGEST_READ // 2**20} MiB"
            raise ValueError(msg)
        return super().read(size) or b""
