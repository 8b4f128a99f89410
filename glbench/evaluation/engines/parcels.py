"""Sending a submission and a task to a machine that may have neither."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from glbench.agents.contents import files_of_folder
from glbench.agents.identity import baseline_names, identify
from glbench.errors import SubmissionError
from glbench.evaluation.scratch import Scratch


@dataclass(frozen=True)
class Parcel:
    """An agent on its way: the name of a baseline, or the files of a submission. ``name`` is that of its file or folder."""

    name: str
    files: tuple[tuple[str, bytes], ...] = ()
    is_folder: bool = False

    @classmethod
    def of(cls, ref: str) -> Parcel:
        """Pack the agent ``ref``.

        Raises
        ------
        SubmissionError
            When its files cannot be read.
        """
        if ref in baseline_names():
            return cls(ref)
        path = Path(ref).expanduser().resolve()
        identity = identify(path)
        own = identity.files if identity is not None else ()
        root = path.parent if own else path
        try:
            files = [(file.relative_to(root).as_posix(), file.read_bytes()) for file in own or files_of_folder(path)]
        except OSError as error:
            msg = f"The submission {path} cannot be packed: {error}. Check that its files exist and may be read."
            raise SubmissionError(msg) from error
        return cls(path.name, tuple(files), is_folder=not own)

    @contextmanager
    def unpacked(self) -> Iterator[str]:
        """The agent as ``prepare`` takes it; the files are gone afterwards."""
        if not self.files:
            yield self.name
            return
        scratch = Scratch()
        try:
            root = scratch.folder() / self.name if self.is_folder else scratch.folder()
            for name, content in self.files:
                file = root / PurePosixPath(name)
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_bytes(content)
            yield str(scratch.folder() / self.name)
        finally:
            scratch.remove()
