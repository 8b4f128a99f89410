"""Agents for the task of one day: what the tests of records and proofs work with."""

from __future__ import annotations

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
