"""Many agents on many tasks: what is to be done, and the engines that do it, here or on a Ray cluster, with the same bits.

``docs/scale.md`` shows how they are used.
"""

from __future__ import annotations

from glbench.evaluation.engines.local import Engine, Job, LocalEngine, Options, Outcome, Report

__all__ = ["Engine", "Job", "LocalEngine", "Options", "Outcome", "Report"]
