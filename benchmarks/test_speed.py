"""Every measurement of ``glbench bench`` under pytest-benchmark, for the record and for comparisons between versions.

``uv run --group dev pytest benchmarks --benchmark-json=speed.json`` keeps the figures. The ratio to CVODES, measured in the same run, is
in ``extra_info``. Nothing here passes or fails by its time.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from glbench.kernel import why_not_compiled
from glbench.speed import SUBJECTS, Subject
from glbench.speed.run import Comparisons, references

pytestmark = [pytest.mark.slow, pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))]


@pytest.fixture(scope="module")
def comparisons() -> Iterator[Comparisons]:
    """References for all step lengths, each timed once."""
    with references(SUBJECTS) as known:
        yield Comparisons(known, rounds=3)


@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda one: one.name)
def test_speed(subject: Subject, comparisons: Comparisons, benchmark: Any) -> None:
    found = comparisons.compare(subject)
    benchmark.pedantic(subject.make(), rounds=3)
    benchmark.extra_info.update(found.model_dump())
