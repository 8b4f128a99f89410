"""What the sandbox costs: its start, one question, and a full evaluation beside the same one in this process.

``uv run --group dev pytest benchmarks/test_sandbox.py --benchmark-json=sandbox.json`` keeps the figures; what the evaluation costs
more with the sandbox than without stands under ``extra_info`` as ``overhead``. Nothing here passes or fails by its time.
"""

from __future__ import annotations

import resource
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glbench.agents import identify
from glbench.evaluation import TimeLimits, prepare
from glbench.evaluation.runners import AgentRunner
from glbench.evaluation.sandbox.bubblewrap import why_no_sandbox
from glbench.evaluation.sandbox.frames import SandboxLimits
from glbench.evaluation.sandbox.process import Prints
from glbench.evaluation.sandbox.runners import SandboxedAgent, sandboxed_runner
from glbench.resources import data_folder
from glbench.tasks import DEFAULT_TASK, TaskCard, get_task, task_card

pytestmark = [pytest.mark.slow, pytest.mark.skipif(why_no_sandbox() is not None, reason=str(why_no_sandbox()))]
RUNS = 30
FULL_EVALUATIONS = 7


@pytest.fixture(scope="module")
def card() -> TaskCard:
    """Card of the default task."""
    return task_card(get_task(DEFAULT_TASK))


@pytest.fixture(scope="module")
def fair(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The fair rule-based controller as somebody would submit it."""
    path = tmp_path_factory.mktemp("submission") / "fair.py"
    path.write_text(
        "from glbench.agents import read_baseline\ndef make_agent(task):\n    return read_baseline('rule_based_fair').make(task)\n",
        encoding="utf-8",
    )
    return path


def started(path: Path, card: TaskCard) -> AgentRunner:
    submission = identify(path)
    assert submission is not None
    runner = sandboxed_runner(SandboxedAgent(submission, card, RUNS, TimeLimits(), SandboxLimits(), Prints()))
    runner.start()
    return runner


def test_start(benchmark: Any, card: TaskCard) -> None:
    """From nothing to an agent that was reset, and processor time of all processes for it."""
    path = data_folder("submissions") / "my_agent.py"
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    rounds = 20
    runners: list[AgentRunner] = []

    def end() -> None:
        while runners:
            runners.pop().close()

    benchmark.pedantic(lambda: runners.append(started(path, card)), setup=end, rounds=rounds, iterations=1)
    end()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    benchmark.extra_info["processor_seconds"] = used / rounds


def test_one_question(benchmark: Any, card: TaskCard) -> None:
    """One step of 30 runs, asked and answered, with the simplest agent there is."""
    runner = started(data_folder("submissions") / "constant_setpoints.py", card)
    observations = np.zeros((RUNS, len(card.observations)), dtype=np.float32)
    alive = np.ones(RUNS, dtype=np.bool_)
    benchmark(lambda: runner.decide(0, observations, alive))
    runner.close()


def test_full_evaluation(benchmark: Any, fair: Path) -> None:
    """All runs of the default task, in turns with the sandbox and without; the median of the ratios."""
    task, seconds = get_task(DEFAULT_TASK), {"bubblewrap": [], "none": []}  # type: dict[str, list[float]]

    def both() -> None:
        for choice, taken in seconds.items():
            evaluation = prepare(task, fair, workers=None, sandbox=choice)  # type: ignore[arg-type]
            began = time.perf_counter()
            evaluation.run()
            taken.append(time.perf_counter() - began)

    benchmark.pedantic(both, rounds=FULL_EVALUATIONS, iterations=1)
    ratios = [inside / here for inside, here in zip(seconds["bubblewrap"], seconds["none"], strict=True)]
    benchmark.extra_info["seconds"] = seconds
    benchmark.extra_info["overhead"] = statistics.median(ratios) - 1.0
