"""How long commands let somebody wait: each in a process of its own, and its ratio to a process that loads numpy and pandas.

The ratio, with the reference measured in the same run, is in ``extra_info``. Nothing here passes or fails by its time.
"""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path
from statistics import median
from typing import Any

import pytest

pytestmark = pytest.mark.slow
_ROUNDS = 3
_COMMANDS = ("tasks list", "tasks check", "leaderboard", "leaderboard --all", "compare mpc ppo_long", "report")
_PROGRAM = "import sys; from glbench_command import main; sys.argv = ['glbench', *sys.argv[1:]]; main()"


def processor_seconds(*arguments: str) -> float:
    """Time of the processor that a Python process with these arguments takes [s]: other processes hardly change it."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


@pytest.fixture(scope="module")
def reference() -> float:
    """Processor time of a process that loads numpy and pandas [s]: the median of several, after one that writes their bytecode."""
    return median([processor_seconds("-c", "import numpy, pandas") for _ in range(_ROUNDS + 1)][1:])


@pytest.mark.parametrize("command", _COMMANDS)
def test_command(command: str, reference: float, benchmark: Any, tmp_path: Path) -> None:
    arguments = ("-c", _PROGRAM, *command.split(), *(("--out", str(tmp_path)) if command == "report" else ()))
    processor_seconds(*arguments)  # writes bytecode
    spent: list[float] = []
    benchmark.pedantic(lambda: spent.append(processor_seconds(*arguments)), rounds=_ROUNDS)
    benchmark.extra_info.update(processor_seconds=median(spent), reference_seconds=reference, ratio=median(spent) / reference)
