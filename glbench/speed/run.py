"""The measurement: reference and subject in turn, round by round."""

from __future__ import annotations

import datetime as dt
import statistics
from collections.abc import Callable, Mapping, Sequence

from glbench.evaluation.provenance import machine, versions
from glbench.kernel import Kernel
from glbench.model import TOMATO
from glbench.speed.clock import Timed, processor_time, timed, wall_time
from glbench.speed.first_use import measure_first_use, measure_memory
from glbench.speed.record import Measurement, SpeedRecord
from glbench.speed.reference import Reference, references
from glbench.speed.subjects import STEP_SECONDS, Subject, paper_course
from glbench.speed.workloads import points

ROUNDS = 7

ProgressCallback = Callable[[str, int, int], None]
"""Called with what is being measured, how many subjects are done, and how many there are."""


def measure(
    subjects: Sequence[Subject],
    *,
    rounds: int = ROUNDS,
    processes: bool = True,
    progress: ProgressCallback | None = None,
) -> SpeedRecord:
    """Measure subjects against the reference.

    Parameters
    ----------
    subjects
        What to measure, see ``choose_subjects``.
    rounds
        How often each is set against the reference, 1 or more.
    processes
        Whether first use and memory are measured too, in processes of their own (some seconds).
    progress
        Told before each subject.
    """
    lengths = tuple(sorted({one.step_seconds for one in subjects}))
    found = []
    with references(lengths) as known:
        comparisons = Comparisons(known, rounds)
        for done, subject in enumerate(subjects):
            if progress is not None:
                progress(f"{subject.group}: {subject.title}", done, len(subjects))
            found.append(comparisons.compare(subject))
        compiled = all(one.compiled for one in known.values())
    if progress is not None and processes:
        progress("first use and memory", len(subjects), len(subjects))
    return SpeedRecord(
        created=dt.datetime.now(dt.UTC).isoformat(timespec="seconds"),
        machine=machine(),
        versions=versions(),
        kernel=Kernel(TOMATO, STEP_SECONDS, preset="standard").describe(),
        reference=f"CasADi CVODES, tolerances 1e-6, {'compiled with -O3' if compiled else 'not compiled: no gcc here'}",
        rounds=rounds,
        measurements=tuple(found),
        first_use=measure_first_use() if processes else None,
        memory=measure_memory() if processes else None,
    )


class Comparisons:
    """Sets subjects against references, each of which is prepared once.

    Parameters
    ----------
    known
        A reference for each step length [s].
    rounds
        How often a subject and its reference are timed in turn.
    """

    def __init__(self, known: Mapping[float, Reference], rounds: int) -> None:
        self._known = known
        self._rounds = rounds
        self._prepared: dict[tuple[float, str, bool], Timed] = {}

    def compare(self, subject: Subject) -> Measurement:
        """The figures of one subject."""
        own, reference = subject.make(), self._reference_of(subject)
        if own.clock is wall_time:
            reference = Timed(reference.work, wall_time, reference.repeats)
        pairs = [(reference.seconds_per_step(), own.seconds_per_step()) for _ in range(self._rounds)]
        ratios = [theirs / ours for theirs, ours in pairs]
        return Measurement(
            name=subject.name,
            group=subject.group,
            title=subject.title,
            microseconds=1e6 * min(ours for _, ours in pairs),
            reference=f"{'course' if subject.follows_course else subject.controls}, {subject.step_seconds:g} s",
            reference_microseconds=1e6 * min(theirs for theirs, _ in pairs),
            ratio=statistics.median(ratios),
            ratio_low=min(ratios),
            ratio_high=max(ratios),
            clock="processor" if own.clock is processor_time else "wall",
        )

    def _reference_of(self, subject: Subject) -> Timed:
        key = (subject.step_seconds, subject.controls, subject.follows_course)
        if key not in self._prepared:
            reference = self._known[subject.step_seconds]
            self._prepared[key] = timed(
                reference.course(paper_course())
                if subject.follows_course
                else reference.scattered(points(subject.controls, subject.step_seconds))
            )
        return self._prepared[key]
