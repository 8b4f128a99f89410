"""``python -m glbench``: the same as the command ``glbench``."""

from glbench.cli.app import run

if __name__ == "__main__":
    run()
