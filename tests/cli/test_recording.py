"""``glbench episodes recording``: an agent made of what another one did."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from glbench.agents.plans import read_recording
from glbench.episodes import read_log
from glbench.evaluation import load_result
from tests.cli.command_line import Command
from tests.episodes.day import RANDOM
from tests.evaluation.agent_files import agent_writer


def test_a_recording_of_a_run_earns_what_the_run_earned(here, glbench):
    agent_writer(here)(RANDOM, "wavy")
    assert glbench("evaluate", "wavy.py", "--task", "day.toml", "--out", "out").code == 0
    result = here / "out/results/Day-v1/wavy.json"
    made = glbench("episodes", "recording", result, "--run", "667", "--out", "replayed")
    assert (made.code, made.out.strip()) == (0, "replayed")
    assert "Next: glbench evaluate replayed --task FILE.toml" in " ".join(made.err.split())
    evaluated = glbench("evaluate", "replayed", "--task", "day.toml", "--out", "out")
    assert evaluated.code == 0, evaluated.err
    replayed = load_result(here / "out/results/Day-v1/replayed.json")
    assert replayed.agent.information == "nothing: replays recorded actions"
    log, source = (read_log(here / f"out/results/Day-v1/{name}.actions.mcap") for name in ("replayed", "wavy"))
    np.testing.assert_array_equal(log.actions, np.tile(source.actions[:, 1:2].astype(np.float32), (1, 3, 1)))
    again, before = (load_result(here / f"out/results/Day-v1/{name}.json").runs[1].metrics["reward"] for name in ("replayed", "wavy"))
    assert again == pytest.approx(before, rel=1e-4), "the actions were rounded to float32, nothing else"
    assert len(read_recording(here / "replayed/actions.npz").actions) == 24


@pytest.mark.parametrize(("option", "ending"), [("--save", ".rrd"), ("--picture", ".png")])
def test_view_does_not_overwrite_a_result(glbench: Command, here: Path, option: str, ending: str) -> None:
    result = here / "result.json"
    result.write_text("{}", encoding="utf-8")
    answer = glbench("view", result, option, result)
    assert answer.code == 1
    assert f"should end with {ending}" in " ".join(answer.err.split())
    assert result.read_text(encoding="utf-8") == "{}"
