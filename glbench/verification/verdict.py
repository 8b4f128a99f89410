"""What came out of a verification, in a form for programs and in words for people."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NoReturn

Outcome = Literal["reproduced", "refuted", "unknown"]
Exactness = Literal["bits", "tolerance"]

EXIT_CODES: dict[Outcome, int] = {"reproduced": 0, "refuted": 1, "unknown": 2}


@dataclass(frozen=True)
class Verdict:
    """The verdict on one result.

    Attributes
    ----------
    path
        The result's file.
    outcome
        ``"reproduced"``, ``"refuted"``, or ``"unknown"`` when it cannot be told.
    cause
        A short name of the reason why it is not reproduced, such as ``"reward"`` or ``"dropped_run"``; empty when it is.
    reason
        In words: how closely it was reproduced, or what differs where, or why it cannot be told.
    exactness
        Whether it was reproduced to the last bit or within the tolerance; ``None`` when it was not.
    largest_difference
        Largest relative difference found, 0 when all bits are the same.
    notes
        What else a reader should know.
    runs, steps
        Runs and steps that were simulated again.
    episodes
        Seeds of the full episodes that were compared, too.
    reproduced, stated
        Fields of the result that were reproduced, and those that it merely states; see ``glbench.verification.coverage``.
    """

    path: Path
    outcome: Outcome
    cause: str
    reason: str
    exactness: Exactness | None = None
    largest_difference: float = 0.0
    notes: tuple[str, ...] = ()
    runs: int = 0
    steps: int = 0
    episodes: tuple[int, ...] = ()
    reproduced: tuple[str, ...] = ()
    stated: tuple[str, ...] = ()

    @property
    def exit_code(self) -> int:
        """0 reproduced, 1 refuted, 2 cannot tell."""
        return EXIT_CODES[self.outcome]


class Refused(Exception):  # noqa: N818 -- no error of the program: it carries a verdict outwards
    """Ends a verification early, with its outcome, cause and reason."""

    def __init__(self, outcome: Outcome, cause: str, reason: str) -> None:
        super().__init__(reason)
        self.outcome, self.cause, self.reason = outcome, cause, reason


def refute(cause: str, reason: str) -> NoReturn:
    """End the verification: the result is not what it says."""
    raise Refused("refuted", cause, reason)  # noqa: EM101 -- words of the program, not a message


def cannot_tell(cause: str, reason: str) -> NoReturn:
    """End the verification: something that a verification needs is missing."""
    raise Refused("unknown", cause, reason)  # noqa: EM101 -- words of the program, not a message
