"""Whoever ends the evaluation ends the agent, and the work goes on later with the same bits."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from glbench.evaluation import Result
from tests.evaluation.agent_files import GOOD, AgentWriter
from tests.evaluation.sandbox.conftest import Prepare
from tests.evaluation.sandbox.test_hostile_agents import LEAVE, survivors

pytestmark = pytest.mark.slow

CODE = (
    "import sys\nfrom glbench.evaluation import evaluate\n"
    "evaluate(sys.argv[1], sys.argv[2], out=sys.argv[3], checkpoint_seconds=0.0, sandbox='bubblewrap')\n"
)


@pytest.mark.usefixtures("needs_sandbox")
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_an_evaluation_that_is_killed_takes_its_agent_along_and_goes_on_later(
    day_task_file: Path, write_agent: AgentWriter, sandboxed: Prepare, good_result: Result, tmp_path: Path, how: signal.Signals
) -> None:
    more = f"self.calls += 1\n        if self.calls == 2: {LEAVE.strip()}\n        time.sleep(0.1)"
    body = GOOD.replace("self.calls += 1", more)
    agent = write_agent(body)
    for attempt in range(10):  # on a busy machine it may be over before it is looked at
        out = tmp_path / f"out-{attempt}"
        evaluation = subprocess.Popen(
            [sys.executable, "-c", CODE, str(day_task_file), str(agent), str(out)],
            stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        deadline = time.monotonic() + 300.0
        while len(list(out.rglob("dialogue-*.npz"))) < 5 and time.monotonic() < deadline and evaluation.poll() is None:
            time.sleep(0.02)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(evaluation.pid, how)
        evaluation.wait(300.0)
        if not list(out.rglob("agent_under_test.json")):
            break

    assert survivors() == []
    resumed = sandboxed(agent, out=out, limits=None).run()  # under the same limits as before
    assert resumed.evaluation.resumed_at_step is not None
    assert [run.metrics for run in resumed.runs] == [run.metrics for run in good_result.runs]
