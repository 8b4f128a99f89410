"""Take a picture of what a command prints: ``python docs/images/terminal_picture.py out.svg glbench leaderboard``.

The picture is what a terminal of 100 columns shows, colours included, as SVG.
"""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

from rich.console import Console
from rich.text import Text

WIDTH = 100


def main(picture: Path, command: list[str]) -> None:
    """Run ``command`` and save its output to ``picture``."""
    environment = {**os.environ, "COLUMNS": str(WIDTH), "FORCE_COLOR": "1", "TERM": "xterm-256color"}
    shown = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True).stdout
    console = Console(record=True, width=WIDTH, file=io.StringIO())
    console.print(f"$ {' '.join(command)}", style="bold")
    console.print(Text.from_ansi(shown.rstrip()))
    console.save_svg(str(picture), title=" ".join(command[:2]))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
