"""Evaluation: seeded runs of an agent on a task, all in lockstep, as a result that checks itself.

``evaluate(task, agent)`` is the whole of it; docs/results.md explains what comes out.
"""

from __future__ import annotations

from glbench.evaluation.files import SavingError, load_result, result_path, save_result
from glbench.evaluation.job import Evaluation
from glbench.evaluation.limits import TimeLimits
from glbench.evaluation.lockstep import Progress
from glbench.evaluation.metrics import METRIC_NAMES, METRICS, UNITS, Metric
from glbench.evaluation.preparing import evaluate, prepare
from glbench.evaluation.records import Result, RunResult, Summary

__all__ = [
    "METRICS",
    "METRIC_NAMES",
    "UNITS",
    "Evaluation",
    "Metric",
    "Progress",
    "Result",
    "RunResult",
    "SavingError",
    "Summary",
    "TimeLimits",
    "evaluate",
    "load_result",
    "prepare",
    "result_path",
    "save_result",
]
