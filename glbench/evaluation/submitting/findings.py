"""What a check found: findings in words, by subject, and the report that holds them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

Level = Literal["problem", "note"]
Subject = Literal[
    "card",
    "files",
    "packages",
    "loading",
    "decisions",
    "repeatable",
    "rows",
    "time",
    "memory",
    "surroundings",
    "printing",
]

CHECKS: dict[Subject, str] = {
    "card": "The card is there and makes sense",
    "files": "Files can be read and are not too large",
    "packages": "Everything that is imported is installed",
    "loading": "The agent can be loaded and made",
    "decisions": "Actions have the right shape, are finite and within their bounds",
    "repeatable": "The same observations give the same actions",
    "rows": "Same decisions alone and in a batch",
    "time": "Decisions are fast enough",
    "memory": "Memory stays within its limit",
    "surroundings": "It needs no network and writes no files",
    "printing": "It prints little",
}
"""Everything that is looked at, in the order of a report."""


@dataclass(frozen=True)
class Finding:
    """One thing found. A ``problem`` will cost the submission runs or its place; a ``note`` is good to know."""

    subject: Subject
    level: Level
    text: str


@dataclass(frozen=True)
class Report:
    """Everything that was found.

    ``checked`` names the subjects that were reached: a file that cannot be loaded makes no decisions that could be looked at.
    ``facts`` are measured figures in words by subject.
    """

    name: str
    what: str
    task: str
    findings: tuple[Finding, ...]
    checked: frozenset[Subject]
    facts: dict[Subject, str] = field(default_factory=dict)
    seconds: float = 0.0

    @property
    def problems(self) -> tuple[Finding, ...]:
        """The findings that have to be mended."""
        return tuple(finding for finding in self.findings if finding.level == "problem")

    @property
    def ok(self) -> bool:
        """Whether there are no problems."""
        return not self.problems

    def of(self, subject: Subject) -> tuple[Finding, ...]:
        """The findings about one subject."""
        return tuple(finding for finding in self.findings if finding.subject == subject)


def problem(subject: Subject, text: str) -> Finding:
    """A finding that is a problem."""
    return Finding(subject, "problem", text)


def note(subject: Subject, text: str) -> Finding:
    """A finding that is good to know."""
    return Finding(subject, "note", text)
