"""Taking times: processor time of this process, subjects in turn, medians of rounds."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

Work = Callable[[], int]
"""Does something and says how many steps it took."""

Clock = Callable[[], float]

SHORTEST_SECONDS = 0.05
"""Work that is over sooner is repeated until it has taken that long."""


def processor_time() -> float:
    """Processor time of this process and its threads [s]: what others do on the machine does not count."""
    return time.process_time()


def wall_time() -> float:
    """Time on the wall [s]: for what several threads share."""
    return time.perf_counter()


@dataclass(frozen=True)
class Timed:
    """Work, the clock that judges it, and how often it is done in one round."""

    work: Work
    clock: Clock
    repeats: int

    def seconds_per_step(self) -> float:
        """Time of one step in one round [s]."""
        steps = 0
        started = self.clock()
        for _ in range(self.repeats):
            steps += self.work()
        return (self.clock() - started) / steps


def timed(work: Work, clock: Clock = processor_time) -> Timed:
    """``work``, done once to warm up and often enough to be measured."""
    started = wall_time()
    work()
    seconds = max(wall_time() - started, 1e-9)
    return Timed(work, clock, max(1, round(SHORTEST_SECONDS / seconds)))
