"""What a verification checks of a result, field by field, and what it leaves as the result states it.

A field is named by its place in the result file. Every field of a result is in exactly one of the two lists.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Final

from glbench.evaluation import Result

_ALWAYS: Final = (
    "schema", "schema_version", "task.id", "task.digest", "task.title", "task.steps", "task.step_seconds",
    "evaluation.runs", "evaluation.seeds", "runs.seed", "runs.steps", "runs.metrics", "summary", "units", "results_digest", "record",
)  # fmt: skip
ENDS: Final = ("runs.status", "runs.reason")
"""Reproduced where all runs went to the end or stopped at a step that cannot be simulated here either; otherwise stated."""
PROFILE: Final = "profile"
_STATED: Final[dict[str, tuple[str, ...]]] = {
    "that this agent gave these actions (its name, kind, digest, card, and what it saw)": (
        "agent.name", "agent.kind", "agent.digest", "agent.privileged", "agent.information", "agent.card",
    ),
    "why runs ended early": ENDS,
    "sandbox and time limits": ("evaluation.sandbox", "evaluation.limits"),
    "decision time, wall time and workers": (
        "evaluation.decision_seconds", "evaluation.decision_milliseconds", "evaluation.wall_seconds", "evaluation.steps_per_second",
        "evaluation.workers", "evaluation.resumed_at_step",
    ),
    "kernel, versions, machine, commit and date": ("evaluation.kernel", "versions", "machine", "git", "created"),
    "the profile (typical day, season, worst run)": (PROFILE,),
}  # fmt: skip
_OWN_ENDS = frozenset({"ok", "simulation_failed"})


def coverage(result: Result, *, profile: bool) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Fields of a reproduced ``result`` that were reproduced, and those that are stated; ``profile``: whether that was made again."""
    ends = all(run.status in _OWN_ENDS for run in result.runs)
    reproduced = (*_ALWAYS, *(ENDS if ends else ()), *((PROFILE,) if profile else ()))
    stated = tuple(field for fields in _STATED.values() for field in fields if field not in reproduced)
    return reproduced, stated


def stated_words(stated: Collection[str]) -> Sequence[str]:
    """The stated fields in words, as groups."""
    return [words for words, fields in _STATED.items() if any(field in stated for field in fields)]
