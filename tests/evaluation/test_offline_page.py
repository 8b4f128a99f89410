"""docs/offline.md: its command and its example run, and its size is right."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from glbench.cli.app import app
from glbench.tasks import get_task
from tests.support import DOCS, examples_of, run_examples

minari = pytest.importorskip("minari", reason="Minari is not installed (extra 'minari')")
pytestmark = pytest.mark.slow


def test_the_command_writes_the_dataset_that_the_example_learns_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    page = (DOCS / "offline.md").read_text(encoding="utf-8")
    (command,) = re.findall(r"uv run glbench (episodes export .*)", page)
    done = CliRunner().invoke(app, [*command.replace("--runs 20", "--runs 1").split()])
    assert done.exit_code == 0, done.output
    assert "rule_based_fair" in done.stdout
    task = get_task("GreenhouseReal-v1")
    (steps, columns, size) = re.findall(r"`GreenhouseReal-v1`, ([\d,]+) steps with (\d+) columns, takes ([\d.]+) MB", page)[0]
    assert (int(steps.replace(",", "")), int(columns)) == (task.steps, len(task.observed()))
    files = [file.stat().st_size for file in tmp_path.rglob("*.parquet")]
    assert len(files) == 2
    assert all(abs(one / 1e6 - float(size)) < 0.1 for one in files)

    names = run_examples("offline.md", examples_of("offline.md"), {})
    told = float(re.findall(r"(-?[\d.]+) EUR/m2", capsys.readouterr().out)[0])
    assert told == pytest.approx(names["season"], abs=0.01)
    assert names["env"].unwrapped.task.split == "validation"
    error = names["features"](names["observations"]) @ names["weights"] - names["actions"]
    assert (error**2).mean() < 0.9 * ((names["actions"] - names["actions"].mean(axis=0)) ** 2).mean()
    assert np.isfinite(names["weights"]).all()
