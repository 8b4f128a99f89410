"""A submission that walks through everything it can see and searches it for what no sandbox may hold."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from tests.evaluation.sandbox import content_search
from tests.evaluation.sandbox.content_search import Needles

_AGENT = """
import json
import sys
from pathlib import Path

import numpy as np
from content_search import Needles, Search

HERE = Path(__file__).parent
# The submission carries what it searches for; /proc is the kernel's.
LEFT_OUT = [HERE, Path("/proc"), *map(Path, LEAVE_OUT)]


class Walker:
    def reset(self, task, n_runs):
        self.n = n_runs
        search = Search(Needles.load(HERE / "needles.npz"))
        search.folder(Path("/"), LEFT_OUT)
        print("SEEN " + json.dumps([sorted(search.found), search.looked]))

    def act(self, observations):
        return np.zeros((self.n, 6))


def make_agent(task):
    return Walker()
"""


def write_walker(folder: Path, needles: Needles, leave_out: Iterable[Path | str] = ()) -> Path:
    """The submission ``walker`` in ``folder``; it does not look into ``leave_out``."""
    walker = folder / "walker"
    walker.mkdir()
    places = [str(place) for place in leave_out]
    (walker / "agent.py").write_text(_AGENT.replace("LEAVE_OUT", repr(places)), encoding="utf-8")
    shutil.copy(content_search.__file__, walker / "content_search.py")
    needles.save(walker / "needles.npz")
    return walker


def sight_of(text: str) -> Any:
    """What an agent printed after ``SEEN``."""
    (line,) = [line for line in text.splitlines() if "SEEN " in line]
    return json.loads(line.partition("SEEN ")[2])
