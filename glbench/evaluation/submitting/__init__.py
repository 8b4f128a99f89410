"""Looking at a submission before the long run: everything that will be wrong, in words, within seconds.

``check_submission`` reads the files, then runs the agent for a day in a process of its own. ``docs/submit.md`` shows what comes out.
"""

from glbench.evaluation.submitting.check import check_submission
from glbench.evaluation.submitting.findings import CHECKS, Finding, Report

__all__ = ["CHECKS", "Finding", "Report", "check_submission"]
