"""The digest of a task: one number over everything that defines it.

It is the SHA-256 of canonical JSON (RFC 8785) over six parts: the definition without prose, the resolved parameters, the
state at the start, the names, units and bounds of the observed columns, the hourly figures of the weather with the name and version of
their preprocessing, and the model's equations. Each part also has a digest of its own, so that a mismatch can be blamed on the right one.
Computed numbers enter with nine significant digits, because the last bit of ``exp`` may differ between machines. The order of keys,
comments and layout of the file do not matter.

It does not cover the code that computes a step from these: the weather between the hours, draws, accounts, reward. What that code gives
for the published tasks is in ``tasks/behaviour.toml`` (``glbench.env.behaviour``).
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import rfc8785

if TYPE_CHECKING:
    from glbench.tasks.spec import TaskSpec

DIGITS = 9
"""Significant digits of numbers that are computed rather than read."""


@dataclass(frozen=True)
class Fingerprint:
    """The digest of a task [SHA-256, hex] and the digests of its parts."""

    digest: str
    definition: str
    parameters: str
    start: str
    observation: str
    weather: str
    model: str
    model_version: str


def canonical_sha256(value: Any) -> str:
    """SHA-256 [hex] of ``value`` (plain JSON values) in the one form that RFC 8785 gives it."""
    return hashlib.sha256(rfc8785.dumps(value)).hexdigest()


@lru_cache(maxsize=256)
def fingerprint(task: TaskSpec) -> Fingerprint:
    """Digest of ``task`` and of its parts; needs the model and the weather.

    Raises
    ------
    TaskError
        When the task asks for weather or parameters that do not exist.
    """
    from glbench.model import MODEL_VERSION, model_digest

    task.uncertain_parameters()  # an unknown set is an error before anything is recorded
    parts = {
        "definition": task.definition(),
        "parameters": {name: _rounded(value) for name, value in task.parameters_by_name().items()},
        "start": [_rounded(value) for value in task.initial_state().tolist()],
        "observation": [[q.name, q.unit, _rounded(q.low), _rounded(q.high)] for q in task.observed()],
        "weather": task.disturbances(task.observation.forecast_steps).digest,
        "model": {
            "version": MODEL_VERSION,
            "variant": task.model.variant,
            "digest": model_digest(task.model.variant),
        },
    }
    digests = {name: canonical_sha256(part) for name, part in parts.items()}
    return Fingerprint(digest=canonical_sha256(parts), **digests, model_version=MODEL_VERSION)


def definition_digest(task: TaskSpec) -> str:
    """The definition's part of the fingerprint alone; needs neither model nor weather."""
    return canonical_sha256(task.definition())


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
