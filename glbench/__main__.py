"""``python -m glbench``: the same as the command ``glbench``."""

from __future__ import annotations

from glbench.cli.app import run

if __name__ == "__main__":
    run()
