"""Evaluation: seeded runs of an agent on a task, all in lockstep, as a result that checks itself.

``evaluate(task, agent)`` is the whole of it; docs/results.md explains what comes out.
"""

from typing import TYPE_CHECKING

from glbench.extras import lazy_names

if TYPE_CHECKING:
    from glbench.evaluation.evaluation import Evaluation, evaluate, prepare
    from glbench.evaluation.files import SavingError, load_result, result_path, save_result
    from glbench.evaluation.limits import TimeLimits
    from glbench.evaluation.metrics import METRIC_NAMES, METRICS, UNITS, Metric
    from glbench.evaluation.records import Result, RunResult, Summary
    from glbench.evaluation.rollout import Progress
    from glbench.evaluation.sandbox.choosing import Protected, SandboxChoice, protect
else:
    __getattr__ = lazy_names(__name__)

__all__ = [
    "METRICS", "METRIC_NAMES", "UNITS", "Evaluation", "Metric", "Progress", "Protected", "Result", "RunResult", "SandboxChoice",
    "SavingError", "Summary", "TimeLimits", "evaluate", "load_result", "prepare", "protect", "result_path", "save_result",
]  # fmt: skip
