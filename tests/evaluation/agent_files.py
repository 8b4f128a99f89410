"""Agents written into files, as a user has them."""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from pathlib import Path

AgentWriter = Callable[..., Path]

GOOD = """
    def act(self, observations):
        wanted = np.tanh((observations[:, :6].astype(float) - 20.0) / 50.0)
        self.memory = 0.5 * self.memory + 0.5 * wanted  # remembers, so that resuming has something to get wrong
        self.calls += 1
        return self.memory
"""
"""A batched agent with memory whose rows do not depend on each other."""


def agent_writer(folder: Path) -> AgentWriter:
    """A function that writes an agent into ``folder`` and returns its path."""

    def write(methods: str = GOOD, name: str = "agent_under_test", *, single: bool = False) -> Path:
        reset = "def reset(self, task):" if single else "def reset(self, task, n_runs):"
        n = "1" if single else "n_runs"
        body = textwrap.indent(textwrap.dedent(methods).strip("\n"), "    ")
        own_reset = "" if "def reset" in methods else f"    {reset}\n        self.n, self.calls, self.memory = {n}, 0, 0.0\n"
        path = folder / f"{name}.py"
        path.write_text(
            "import os, sys, time\nimport numpy as np\n"
            f"class Agent:\n    single_run = {single}\n{own_reset}{body}\n\n"
            "def make_agent(task):\n    return Agent()\n",
            encoding="utf-8",
        )
        return path

    return write
