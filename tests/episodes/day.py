"""A task of one day in hourly steps with three runs, and agents for it: what the tests of records and proofs work with."""

from __future__ import annotations

import re
from pathlib import Path

from glbench.resources import data_folder

RANDOM = """
    def act(self, observations):
        # Irrational numbers in float64, different in every run and step, with something remembered.
        self.calls += 1
        wanted = np.sin(observations[:, :6].astype(float) * 3.7 + self.calls)
        self.memory = 0.5 * self.memory + 0.5 * wanted
        return self.memory
"""
NARROW = """
    def act(self, observations):
        return np.cos(observations[:, :6] * np.float32(2.0)).astype(np.float32)
"""
FAILING = """
    def act(self, observations):
        self.calls += 1
        actions = np.full((self.n, 6), 0.01)
        if self.calls > 10:
            actions[1, 2] = np.nan
        if self.calls > 17:
            raise RuntimeError("the pump broke")
        return actions
"""


def write_day_task(folder: Path) -> Path:
    """The default task, cut to one day of 24 steps and three runs, under an id of its own."""
    text = (data_folder("tasks") / "schiphol2010-delta10-v1.toml").read_text(encoding="utf-8")
    for pattern, replacement in {
        r'id = "glbench/.*"': 'id = "test/Day-v1"',
        r"days = 60": "days = 1",
        r"step_seconds = 900": "step_seconds = 3600",
        r"runs = 30": "runs = 3",
    }.items():
        text, count = re.subn(pattern, replacement, text, count=1)
        assert count == 1, pattern
    path = folder / "day.toml"
    path.write_text(text, encoding="utf-8")
    return path
