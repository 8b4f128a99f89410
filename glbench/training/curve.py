"""The learning curve: evaluations between the steps of training."""

from __future__ import annotations

import csv
import io
from pathlib import Path

from glbench.resources import write_atomically
from glbench.training.checkpoint import History
from glbench.training.probe import ProbeResult
from glbench.training.progress import CurvePoint

CURVE = "learning_curve.csv"


def add_point(history: History, steps: int, result: ProbeResult) -> CurvePoint:
    """Book an evaluation after ``steps``, the best so far or not."""
    is_best = result.reward > history.best_reward
    if is_best:
        history.best_reward, history.best_steps = result.reward, steps
    seconds = history.time.total
    history.curve.append({"steps": steps, "seconds": round(seconds, 1), "best": int(is_best), **result.sums})
    return CurvePoint(steps, seconds, result, is_best)


def write_curve(folder: Path, history: History) -> None:
    """Write the curve to ``folder``."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(history.curve[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows({key: f"{value:.10g}" for key, value in point.items()} for point in history.curve)
    write_atomically(folder / CURVE, text.getvalue())
