"""Agents for the task of one day, and a short task with another crop: what the tests of records and proofs work with."""

from __future__ import annotations

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


def write_lettuce_task(folder: Path, *, days: int, more: tuple[tuple[str, str], ...] = ()) -> Path:
    """The lettuce task, cut to some days of 24 steps and three runs, as ``test/Salad-v1``, with further replacements."""
    text = (data_folder("tasks") / "lettuce-v1.toml").read_text(encoding="utf-8")
    cut = (
        ('id = "glbench/Lettuce-v1"', 'id = "test/Salad-v1"'),
        ("days = 50", f"days = {days}"),
        ("step_seconds = 900", "step_seconds = 3600"),
        ("runs = 30", "runs = 3"),
    )
    for old, new in (*cut, *more):
        assert old in text, old
        text = text.replace(old, new, 1)
    path = folder / "lettuce.toml"
    path.write_text(text, encoding="utf-8")
    return path
