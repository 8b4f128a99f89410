"""Speed measurement: reference and subject in turn, round by round; besides, time and memory of the first use.

The reference is the model as the benchmark's paper steps it: CasADi's interface to CVODES with absolute and relative tolerance 1e-6 on the
states as they are, the right-hand side compiled by the C compiler at -O3. Without one CasADi's virtual machine does, and a word says so.
"""

from __future__ import annotations

import datetime as dt
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from glbench import children
from glbench.errors import GlbenchError, refuse
from glbench.evaluation.records import current_versions, this_machine
from glbench.kernel import Kernel
from glbench.kernel.cvodes import paper_cvodes, signals_wait
from glbench.model import TOMATO
from glbench.speed.record import FirstUse, Measurement, Memory, SpeedRecord
from glbench.speed.subjects import STEP_SECONDS, Points, Season, Subject, Work, paper_season, points

ROUNDS = 7
TOLERANCE = 1e-6
SHORTEST_SECONDS = 0.05  # Shorter work is repeated until it has taken that long
MANY = 4096
_STEPS = 96
_TIMEOUT_SECONDS = 600.0

ProgressCallback = Callable[[str, int, int], None]
"""Called with the current subject in words, the number of subjects measured, and of all subjects."""


@dataclass(frozen=True)
class Timed:
    """Work, its repeats in one round, and the clock that times it.

    Processor time of this process and its threads, by default: what others do on the machine does not count.
    """

    work: Work
    repeats: int
    clock: Callable[[], float] = time.process_time

    def seconds_per_step(self) -> float:
        """Time of one step in one round [s]."""
        started = self.clock()
        steps = sum(self.work() for _ in range(self.repeats))
        return (self.clock() - started) / steps


def timed(work: Work) -> Timed:
    """``work`` after one call to warm up, with enough repeats to be measured."""
    started = time.perf_counter()
    work()
    return Timed(work, max(1, round(SHORTEST_SECONDS / max(time.perf_counter() - started, 1e-9))))


@dataclass(frozen=True)
class Reference:
    """CVODES for one step length; ``compiled`` says whether the model is."""

    integrator: Any
    compiled: bool

    def scattered(self, points: Points) -> Work:
        """Some of the steps of ``points``, one by one."""
        inputs = np.concatenate([points.u, points.d], axis=1)[:_STEPS]

        def work() -> int:
            with signals_wait():
                for x, row in zip(points.x[:_STEPS], inputs, strict=True):
                    self.integrator(x0=x, p=row)
            return len(inputs)

        return work

    def season(self, season: Season) -> Work:
        """All steps of ``season``, in sequence."""
        inputs = np.concatenate([season.controls, season.weather], axis=1)

        def work() -> int:
            x = season.start
            with signals_wait() as arrived:
                for row in inputs:
                    x = x if arrived else self.integrator(x0=x, p=row)["xf"]
            return len(inputs)

        return work


@contextmanager
def references(subjects: Iterable[Subject]) -> Iterator[dict[float, Reference]]:
    """A reference for each step length [s] of ``subjects``. CasADi compiles in the working directory: a temporary one here."""
    compiled = shutil.which("gcc") is not None
    lengths, before = sorted({one.step_seconds for one in subjects}), Path.cwd()
    with tempfile.TemporaryDirectory(prefix="glbench-bench-") as folder:
        os.chdir(folder)
        try:
            yield {seconds: Reference(paper_cvodes(TOMATO, TOLERANCE, seconds, jit=compiled), compiled) for seconds in lengths}
        finally:
            os.chdir(before)


class Comparisons:
    """Times subjects in turn with references, each prepared once a step length [s], ``rounds`` times."""

    def __init__(self, by_length: Mapping[float, Reference], rounds: int) -> None:
        self._by_length = by_length
        self._rounds = rounds
        self._prepared: dict[tuple[float, str, bool], Timed] = {}

    def compare(self, subject: Subject) -> Measurement:
        """The figures of one subject."""
        own = timed(subject.make())
        key = (subject.step_seconds, subject.controls, subject.follows_season)
        if key not in self._prepared:
            integrator = self._by_length[subject.step_seconds]
            self._prepared[key] = timed(
                integrator.season(paper_season())
                if subject.follows_season
                else integrator.scattered(points(subject.controls, subject.step_seconds))
            )
        reference = self._prepared[key]
        if subject.on_the_wall:
            own, reference = (replace(one, clock=time.perf_counter) for one in (own, reference))
        pairs = [(reference.seconds_per_step(), own.seconds_per_step()) for _ in range(self._rounds)]
        ratios = [theirs / ours for theirs, ours in pairs]
        return Measurement(
            name=subject.name,
            group=subject.group,
            title=subject.title,
            microseconds=1e6 * min(ours for _, ours in pairs),
            reference=f"{'course' if subject.follows_season else subject.controls}, {subject.step_seconds:g} s",
            reference_microseconds=1e6 * min(theirs for theirs, _ in pairs),
            ratio=statistics.median(ratios),
            ratio_low=min(ratios),
            ratio_high=max(ratios),
            clock="wall" if subject.on_the_wall else "processor",
        )


def measure(
    subjects: Sequence[Subject], *, rounds: int = ROUNDS, processes: bool = True, progress: ProgressCallback | None = None
) -> SpeedRecord:
    """Set each of ``subjects`` (see ``choose_subjects``) against the reference, ``rounds`` times, 1 or more.

    With ``processes``, first use and memory are measured too, in processes of their own (some seconds); ``progress`` hears of each subject.
    """
    tell = progress or (lambda words, number, total: None)
    measurements = []
    with references(subjects) as by_length:
        comparisons = Comparisons(by_length, rounds)
        for number, subject in enumerate(subjects):
            tell(f"{subject.group}: {subject.title}", number, len(subjects))
            measurements.append(comparisons.compare(subject))
        compiled = all(one.compiled for one in by_length.values())
    if processes:
        tell("first use and memory", len(subjects), len(subjects))
    return SpeedRecord(
        created=dt.datetime.now(dt.UTC).isoformat(timespec="seconds"),
        machine=this_machine(),
        versions=current_versions(TOMATO.version),
        kernel=Kernel(TOMATO, STEP_SECONDS, preset="standard").describe(),
        reference=f"CasADi CVODES, tolerances 1e-6, {'compiled with -O3' if compiled else 'not compiled: no gcc here'}",
        rounds=rounds,
        measurements=tuple(measurements),
        first_use=measure_first_use() if processes else None,
        memory=Memory(environments=MANY, megabytes=_run(_MEMORY, str(MANY)), megabytes_of_one=_run(_MEMORY, "1")) if processes else None,
    )


_FIRST_USE = """
import resource
from glbench.kernel import Kernel
from glbench.model import TOMATO
kernel = Kernel(TOMATO, 900.0)
peak = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
print(peak / 1024)
"""

# On Linux ru_maxrss also counts the memory that the parent held when it started this process; VmHWM is the process's own.
_PEAK = """
def peak():
    import pathlib, resource
    status = pathlib.Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.exists() else []
    own = [float(line.split()[1]) for line in lines if line.startswith("VmHWM:")]
    return (own or [resource.getrusage(resource.RUSAGE_SELF).ru_maxrss])[0] / 1024
"""

_MEMORY = f"""
import sys
{_PEAK}
import numpy as np
from glbench.env import GreenhouseVectorEnv
envs = GreenhouseVectorEnv("glbench/Schiphol2010-Delta10-v1", int(sys.argv[1]))
envs.reset(seed=0)
for _ in range(4):
    envs.step(np.zeros(envs.action_space.shape, dtype=np.float32))
print(peak())
"""


def measure_first_use() -> FirstUse:
    """Start a process with an empty cache and make a kernel: everything is generated and compiled again."""
    with tempfile.TemporaryDirectory(prefix="glbench-bench-") as cache:
        started = time.perf_counter()
        megabytes = _run(_FIRST_USE, GLBENCH_CACHE=cache)
        return FirstUse(seconds=time.perf_counter() - started, megabytes=megabytes)


def _run(code: str, *arguments: str, **environment: str) -> float:
    """Run ``code`` in another process and return the number that it prints. Raises ``GlbenchError`` when it fails or takes too long."""
    command, settings = [sys.executable, "-c", code, *arguments], {**os.environ, **environment}
    try:
        process = children.run(command, env=settings, timeout=_TIMEOUT_SECONDS)
        process.check_returncode()
    except subprocess.CalledProcessError as error:
        last = error.stderr.strip().splitlines()[-1:] or ["nothing"]
        refuse(f"A process that was to be measured failed; it said: {last[0]}", GlbenchError, error)
    except subprocess.TimeoutExpired as error:
        refuse(f"A process that was to be measured took longer than {_TIMEOUT_SECONDS:g} s.", GlbenchError, error)
    return float(process.stdout)
