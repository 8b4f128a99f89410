"""Trainings from the files to the table: what their cards state joins them, and nothing else does."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.command_line import Command

CARD = 'name = "x"\nauthors = ["{}"]\nlicence = "MIT"\ninformation = ["observations"]\nseed = {}\nrecipe = "{}"\n'


def submission(name: str, pace: float, author: str = "Anna", recipe: str = "zed", *, seed: int) -> None:
    Path(f"{name}.py").write_text(Path("steady.py").read_text().replace("0.01", str(pace)))
    Path(f"{name}.toml").write_text(CARD.format(author, seed, recipe))


@pytest.mark.usefixtures("here")
def test_forged_trainings_change_nobodys_row(glbench: Command) -> None:
    submission("zed", 0.01, seed=0)
    submission("zed_seed1", 0.02, seed=1)
    honest = {"zed": ("zed", 0), "zed_seed1": ("zed", 1)}

    def board(*names: str) -> dict[str, tuple[str, int | None]]:
        done = glbench("evaluate", *(f"{name}.py" for name in names), "--task", "day.toml")
        assert done.code == 0, done.err
        rows = json.loads(glbench("leaderboard", "--json", "--task", "test/Day-v1").out)
        rewards.append({row["entry_reward_mean [-]"] for row in rows if row["entry"] == "zed"})
        return {row["agent"]: (row["entry"], row["training_seed"]) for row in rows}

    rewards: list[object] = []
    assert board("zed", "zed_seed1") == honest
    submission("zed_seed2", 0.9, "Eve", seed=2)
    submission("zed_seed3", 0.9, recipe="other", seed=3)
    submission("zed_seed4", 0.01, seed=4)  # the policy of zed again
    forged = ("zed_seed2", "zed_seed3", "zed_seed4")
    assert board(*forged) == honest | {name: (name, None) for name in forged}
    assert rewards[0] == rewards[1]
