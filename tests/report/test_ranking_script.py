"""The page's own estimates, for prices that a reader types, against those of the leaderboard. Needs node."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import glbench.report
from glbench.leaderboard.statistics import corrected, estimate_mean, paired_test

SCRIPT = Path(glbench.report.__file__).with_name("assets") / "25-ranking.js"
BEFORE = """const sum = (values) => values.reduce((total, value) => total + value, 0), mean = (values) => sum(values) / values.length;"""
AFTER = """const { pairs, values, resolution } = JSON.parse(require("fs").readFileSync(0));
const rows = pairs.map(([first, second, fixed]) => [
  pairedTest({ trainings: first, fixed }, { trainings: second, fixed: false }, resolution),
  ...intervalOf(estimateMean([first, second], [fixed, false])), ...intervalOf(estimateMean([first]))]);
console.log(JSON.stringify({ rows, corrected: correctedValues(values) }));"""
pytestmark = pytest.mark.skipif(shutil.which("node") is None, reason="there is no node on this machine")


@pytest.mark.parametrize("resolution", [0.0, 8.0])
def test_p_values_and_intervals_of_the_page_are_those_of_the_leaderboard(resolution: float) -> None:
    generator, pairs = np.random.default_rng(0), []
    for first, second, fixed in ((1, 1, False), (3, 3, False), (5, 3, False), (1, 3, False), (1, 3, True)):
        for runs in (1, 2, 5, 30):
            one = generator.normal(size=(first, 1)) + generator.normal(size=runs) + generator.normal(size=(first, runs))
            pairs.append((one, generator.normal(size=(second, 1)) + generator.normal(size=(second, runs)), fixed))
    pairs.append((np.repeat([[2.0], [3.0], [7.0]], 4, axis=1), np.zeros((1, 4)), False))
    values = generator.uniform(size=9).tolist()
    lists = [(one.tolist(), other.tolist(), fixed) for one, other, fixed in pairs]
    given = json.dumps({"pairs": lists, "values": values, "resolution": resolution})
    script = "\n".join([BEFORE, SCRIPT.read_text(encoding="utf-8"), AFTER])
    done = subprocess.run(["node", "-e", script], input=given, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    for (one, other, fixed), row in zip(pairs, found["rows"], strict=True):
        test = paired_test([one], [other], (resolution,), fixed=(fixed, False))
        spans = test.difference.interval(), estimate_mean([one]).interval()
        assert row == pytest.approx([test.p_value, *(end for span in spans for end in (span.low, span.high))], rel=1e-8)
    assert found["corrected"] == pytest.approx(corrected(values))
