"""What came out of a verification: compared numbers, fields that are covered, and a verdict for programs and in words for people.

Numbers are compared to the last bit, or within a tolerance where the arithmetic of two machines differs. What a result says about its
machine plays no part: it could be forged. The numbers themselves tell. Arithmetic that differs, differs in every step that follows, so a
whole run with the same bits says that the arithmetic is the same, and then all numbers must be.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, NoReturn

import numpy as np
from numpy.typing import NDArray

from glbench.evaluation import Result

Outcome = Literal["reproduced", "refuted", "unknown", "sealed"]
Exactness = Literal["bits", "tolerance"]

EXIT_CODES: dict[Outcome, int] = {"reproduced": 0, "refuted": 1, "unknown": 2, "sealed": 3}
COMMITMENT: Final = "task.salt_commitment"
"""Reproduced with the secret of the round; a result with public draws does not have it, and that is reproduced, too."""
_ALWAYS: Final = (
    "schema", "schema_version", "task.id", COMMITMENT, "task.digest", "task.title", "task.steps", "task.step_seconds",
    "task.split", "task.years",
    "runs.cluster",
    "evaluation.runs", "evaluation.seeds", "runs.seed", "runs.steps", "runs.metrics", "summary", "units", "results_digest", "record",
    "fresh_draws",
)  # fmt: skip
ENDS: Final = ("runs.status", "runs.reason")
"""Reproduced where all runs went to the end or stopped at a step that cannot be simulated here either; otherwise stated."""
PROFILE: Final = "profile"
REFERENCES: Final = "fresh_draws.references"
"""Only in results with fresh draws. The rest of ``fresh_draws`` but the salt, and its absence, is reproduced."""
SALT: Final = "fresh_draws.salt"
"""The draws follow from it. No file can show that it was made for this evaluation, and not chosen before the agent was."""
_STATED: Final[dict[str, tuple[str, ...]]] = {
    "that this agent gave these actions (its name, kind, digest, card, training, and what it saw)": (
        "agent.name", "agent.kind", "agent.digest", "agent.privileged", "agent.information", "agent.card", "agent.training",
    ),
    "why runs ended early": ENDS,
    "sandbox and time limits": ("evaluation.sandbox", "evaluation.limits"),
    "decision time, wall time and workers": (
        "evaluation.decision_seconds", "evaluation.decision_milliseconds", "evaluation.wall_seconds", "evaluation.steps_per_second",
        "evaluation.workers", "evaluation.resumed_at_step",
    ),
    "kernel, versions, machine, commit and date": ("evaluation.kernel", "versions", "machine", "git", "created"),
    "the profile (typical day, season, worst run)": (PROFILE,),
    "the scores of the reference agents of the fresh draws": (REFERENCES,),
    "that the salt of the fresh draws was made for this evaluation and was secret before": (SALT,),
}  # fmt: skip
_OWN_ENDS = frozenset({"ok", "simulation_failed"})
TOLERANCE = 1e-9
"""Largest relative difference at which a result is reproduced, though not to the last bit."""
CHAOS = 1e-3
"""Between the tolerance and this, another machine can be the cause: an adaptive step that was accepted there and not here."""
Floats = NDArray[np.floating]


@dataclass(frozen=True)
class Verdict:
    """The verdict on one result.

    Attributes
    ----------
    path
        The result's file.
    outcome
        ``"reproduced"``, ``"refuted"``, ``"unknown"`` when it cannot be told, or ``"sealed"`` when it cannot be told before the
        host of the round publishes its secret.
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
        Fields of the result that were reproduced, and those that it merely states; see ``glbench.verification.verdict``.
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
        """0 reproduced, 1 refuted, 2 cannot tell, 3 cannot be told before the round is over."""
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


def not_yet(reason: str) -> NoReturn:
    """End the verification: the draws are secret until the host of the round publishes them."""
    raise Refused("sealed", "sealed", reason)  # noqa: EM101 -- words of the program, not a message


def coverage(result: Result, *, profile: bool, references: bool = False) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Fields of a reproduced ``result`` that were reproduced, and those that it only states.

    ``profile`` and ``references``: whether the profile was rebuilt, and the reference agents evaluated again.
    """
    fresh = result.fresh_draws
    ends = all(run.status in _OWN_ENDS for run in (*result.runs, *(() if fresh is None else fresh.runs)))
    reproduced = (*_ALWAYS, *(ENDS if ends else ()), *((PROFILE,) if profile else ()))
    reproduced += (REFERENCES,) if references else ()
    absent = (*reproduced, *((REFERENCES, SALT) if fresh is None else ()))
    stated = tuple(field for fields in _STATED.values() for field in fields if field not in absent)
    return reproduced, stated


def stated_words(stated: Collection[str]) -> Sequence[str]:
    """The stated fields in words, as groups."""
    return [words for words, fields in _STATED.items() if any(field in stated for field in fields)]


@dataclass(frozen=True)
class Difference:
    """A value that differs: what kind of value, and which one in words."""

    cause: str
    words: str


@dataclass(frozen=True)
class Agreement:
    """What was found so far.

    Attributes
    ----------
    largest
        Largest relative difference.
    first
        The first value of which a bit differs.
    first_large
        The first value that differs by more than the tolerance.
    """

    largest: float = 0.0
    first: Difference | None = None
    first_large: Difference | None = None

    @property
    def exact(self) -> bool:
        """Whether all bits were the same."""
        return self.first is None

    def add(self, cause: str, recorded: Floats, found: Floats, words: tuple[str, ...], where: str) -> Agreement:
        """Compare tables ``(steps, columns)``, of which ``words`` name the columns; step 1 is the first row."""
        differs = ~same_bits(recorded, found)
        if not differs.any():
            return self
        with np.errstate(all="ignore"):  # what is not finite counts as infinitely far apart
            apart = np.where(differs, np.nan_to_num(_relative(recorded, found), nan=np.inf, posinf=np.inf), 0.0)

        def first(which: NDArray[np.bool_]) -> Difference | None:
            if not which.any():
                return None
            step, column = (int(index) for index in np.argwhere(which)[0])
            place = f"step {step + 1}, {words[column]}" if len(recorded) > 1 else words[column]
            text = f"{where}, {place}: recorded {recorded[step, column]!s}, found {found[step, column]!s}"
            return Difference(cause, text)

        return Agreement(
            max(self.largest, float(apart.max())),
            self.first or first(differs),
            self.first_large or first(apart > TOLERANCE),
        )

    def verdict(self, *, same_arithmetic: bool, stated: str) -> Refused | None:
        """Why this is not reproduced; ``None`` when it is. ``stated`` says what the result states of its machine."""
        if self.first is None:
            return None
        if same_arithmetic:
            reason = (
                f"{self.first.words}. The recorded actions do not lead there; and it is not the machine, because other numbers of "
                "whole runs are the same to the last bit."
            )
            return Refused("refuted", self.first.cause, reason)
        if self.first_large is None:
            return None
        large = self.first_large
        if self.largest <= CHAOS:
            reason = (
                f"{large.words}. The largest relative difference is {self.largest:.1e}, more than {TOLERANCE:g}: an adaptive step on "
                f"another machine can make it, and so can a change by hand. {stated} Verify on the machine that made the result."
            )
            return Refused("unknown", "other_machine", reason)
        reason = (
            f"{large.words}. The recorded actions do not lead there, and no difference between machines is as large."
        )
        return Refused("refuted", large.cause, reason)


def _relative(recorded: Floats, found: Floats) -> Floats:
    """Differences relative to the largest value of their column."""
    size = np.max(np.abs(np.concatenate([recorded, found])), axis=0)
    apart = np.abs(np.subtract(recorded, found, dtype=np.float64))
    return np.asarray(apart / np.where(size > 0.0, size, 1.0))


def same_bits(one: Floats, other: Floats) -> NDArray[np.bool_]:
    """Bit patterns, so that 0.0 and -0.0 differ and nan equals nan."""
    if one.dtype != other.dtype:
        return np.asarray(one == other)
    whole = np.uint64 if one.dtype.itemsize == 8 else np.uint32
    return np.asarray(np.ascontiguousarray(one).view(whole) == np.ascontiguousarray(other).view(whole))
