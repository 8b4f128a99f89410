"""Who a submission is, found out without running a line of it: its name, the digest of its files, what it will see.

``load_agent`` runs the submission's code to get an agent; ``identify`` only reads files. An evaluation in a sandbox never lets that
code into its own process, and yet must know what it files the result under.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from glbench.agents.isolation import is_part_of_submission
from glbench.errors import SubmissionError
from glbench.resources import data_folder, sha256_of_files

AGENT_FILE = "agent.py"
CARD_FILE = "card.toml"
OBSERVATIONS_ONLY = "observations and the public task card"

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


@dataclass(frozen=True)
class Identity:
    """A submission that has code of its own, as far as its files tell."""

    name: str
    """Name in results: that of the file or folder."""
    path: Path
    """The file or folder, resolved; what ``load_agent`` is to be called with."""
    files: tuple[Path, ...]
    """Of a single file: it and what belongs to it in the same folder. Empty for a folder, which belongs to it as a whole."""
    digest: str
    """SHA-256 (hex) over the submission's files, the same that ``load_agent`` gives."""
    information: str
    """What it sees, in words."""


def identify(ref: str | Path) -> Identity | None:
    """The submission at ``ref``, or ``None`` where ``ref`` names no code but glbench's own: a baseline, or settings for one.

    Raises
    ------
    SubmissionError
        When a submission is there that cannot have a result: a name that cannot be a file's, files that cannot be read.
    """
    if isinstance(ref, str) and ref in baseline_names():
        return None
    path = Path(ref).expanduser()
    if not path.exists():
        return None
    folder = path.resolve() if path.is_dir() else None
    file = folder / AGENT_FILE if folder is not None else path.resolve()
    if not file.is_file():
        return None
    name = name_of(folder or file)
    try:
        return Identity(
            name, folder or file, () if folder else (file,), submission_digest(file, folder), OBSERVATIONS_ONLY
        )
    except OSError as error:
        msg = f"The submission {name} cannot be read: {error}. Check that its files exist and may be read."
        raise SubmissionError(msg) from error


def baseline_names() -> tuple[str, ...]:
    """Names of the shipped baselines."""
    return tuple(sorted(card.parent.name for card in data_folder("baselines").glob("*/card.toml")))


def name_of(place: Path) -> str:
    """Name of the agent in the file or folder ``place``.

    Raises
    ------
    SubmissionError
        When results cannot be filed under it.
    """
    resolved = place.resolve()
    name = resolved.stem if resolved.is_file() else resolved.name
    if not _NAME.fullmatch(name):
        msg = (
            f"'{name}' cannot be the name of an agent, because results are filed under it. "
            "Rename the file or folder: letters, digits, '.', '_' and '-', beginning with a letter or digit."
        )
        raise SubmissionError(msg)
    if name in baseline_names():
        msg = f"'{name}' is the name of a baseline, whose results would be overwritten. Rename {place}, or run the baseline by its name."
        raise SubmissionError(msg)
    return name


def submission_digest(file: Path, folder: Path | None) -> str:
    """SHA-256 (hex) over ``file``, or over everything in the submission's ``folder``.

    Raises
    ------
    SubmissionError
        When a link leads to a folder or to nothing.
    """
    if folder is None:
        return sha256_of_files(file.parent, [file])
    everything = [item for item in folder.rglob("*") if is_part_of_submission(item, folder)]
    for item in everything:
        if item.is_symlink() and not item.is_file():
            msg = f"{item} is a link to a folder or to nothing, so the digest would not cover what it holds. Copy the files."
            raise SubmissionError(msg)
    return sha256_of_files(folder, [item for item in everything if item.is_file()])
