"""Submissions to start from: ``new_submission`` writes a folder that runs at once, ``copy_examples`` small files to read."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Literal, get_args

from glbench.agents.identity import name_of
from glbench.errors import GlbenchError, SubmissionError
from glbench.resources import data_folder, with_unix_line_ends, write_atomically

Kind = Literal["rule", "sb3", "torch", "mpc"]
KINDS: tuple[Kind, ...] = get_args(Kind)
EXAMPLE_KIND = "example"
"""What ``glbench submit new --kind`` calls the example submissions, each of which is a file."""
_NAME = "template-name"
_OWN_NAMES = ("submission.toml", "README.md")
"""Files of a template in which its name stands."""


def new_submission(folder: Path, kind: Kind) -> tuple[Path, ...]:
    """Write a submission of that ``kind`` into a new ``folder``, whose name becomes the submission's, and return the files.

    Raises
    ------
    SubmissionError
        When the folder is there already, or its name cannot be that of an agent.
    GlbenchError
        When it cannot be written.
    """
    if folder.exists():
        msg = f"{folder} is there already, and nothing is overwritten. Choose another name, or move it away."
        raise SubmissionError(msg)
    name = name_of(folder)
    source = data_folder("submissions") / "templates" / kind
    written = []
    try:
        for file in sorted(item for item in source.iterdir() if item.is_file()):
            text = file.read_text(encoding="utf-8")
            target = folder / file.name
            write_atomically(target, text.replace(_NAME, name) if file.name in _OWN_NAMES else text)
            written.append(target)
    except GlbenchError:
        # Half a template would be in the way of the next attempt.
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return tuple(written)


def copy_examples(folder: Path) -> tuple[Path, ...]:
    """Write the example submissions into ``folder``, ``my_agent.py`` among them, and return the files.

    Raises
    ------
    SubmissionError
        When a file of one of their names is there that is not the example itself.
    GlbenchError
        When they cannot be written.
    """
    sources = sorted(data_folder("submissions").glob("*.py"))
    written = tuple(folder / source.name for source in sources)
    for source, target in zip(sources, written, strict=True):
        if target.exists() and not (target.is_file() and _text(target) == _text(source)):
            msg = f"{target} is there already, and nothing is overwritten. Choose another folder, or move it away."
            raise SubmissionError(msg)
    for source, target in zip(sources, written, strict=True):
        write_atomically(target, _text(source))
    return written


def _text(file: Path) -> bytes:
    return with_unix_line_ends(file.name, file.read_bytes())
