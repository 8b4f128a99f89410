"""One job after the other on this machine, each with all its workers."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

from glbench.evaluation.engines.jobs import Job, Outcome, Report, failed


class LocalEngine:
    """Does jobs in this process; what is interrupted leaves its checkpoint."""

    def run(self, jobs: Sequence[Job], report: Report) -> Iterator[Outcome]:
        """Do the jobs in their order."""
        for job in jobs:
            began = time.monotonic()
            try:
                outcome = _done(job, report, began)
            except Exception as error:
                outcome = failed(job, error, began)
            yield outcome


def _done(job: Job, report: Report, began: float) -> Outcome:
    evaluation = job.prepare()
    if evaluation.stored is not None:
        evaluation.complete_episodes(evaluation.stored)
        return Outcome(job, evaluation.stored, None, time.monotonic() - began, stored=True)
    result = evaluation.run(lambda standing: report(job, standing))
    return Outcome(job, result, None, time.monotonic() - began, printed=evaluation.prints.text())
