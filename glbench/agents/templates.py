"""``new_submission``: a folder with a submission that runs at once, to be changed into a good one."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Literal, get_args

from glbench.agents.identity import name_of
from glbench.errors import GlbenchError, SubmissionError
from glbench.resources import data_folder, write_atomically

Kind = Literal["rule", "sb3", "torch", "mpc"]
KINDS: tuple[Kind, ...] = get_args(Kind)
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
