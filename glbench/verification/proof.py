"""The verdict of a verification, for programs and in words for people, and the record of it beside the result.

Numbers are compared to the last bit, or within a tolerance where the arithmetic of two machines differs. What a result says about its
machine plays no part: it could be forged. The numbers themselves tell. Arithmetic that differs, differs in every step that follows, so a
whole run with the same bits says that the arithmetic is the same, and then all numbers must be.
"""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import os
import secrets
import tempfile
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal, NoReturn

import numpy as np
from numpy.typing import NDArray
from pydantic import AliasChoices, FailFast, Field, ValidationError

from glbench import __version__
from glbench.errors import GlbenchError, refuse
from glbench.evaluation import Result
from glbench.evaluation.files import LARGEST_RESULT, load_with_bytes
from glbench.evaluation.records import Digest, Machine, Record, this_machine
from glbench.fields import Count, Word
from glbench.resources import is_released, user_data_folder, with_unix_line_ends, write_atomically
from glbench.untrusted import MIB, read_regular

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
_CLAIMS: Final[dict[str, tuple[str, ...]]] = {
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
CHAOS = 1e-3  # Between the tolerance and this, another machine can be the cause: an adaptive step that was accepted there and not here
Floats = NDArray[np.floating]


@dataclass(frozen=True)
class Verdict:
    """The verdict on one result, in the file ``path``.

    The ``outcome`` is ``"reproduced"``, ``"refuted"``, ``"unknown"`` when it cannot be verified here, or ``"sealed"`` when it cannot be
    before the host of the round publishes its secret. If it is not reproduced, ``cause`` is a short name of the reason, such as
    ``"reward"`` or ``"dropped_run"``. The ``reason`` says in words how closely it was reproduced, or what differs where, or what is missing
    to verify it; ``notes`` are what else a reader should know.

    ``exactness`` says whether it was reproduced to the last bit or within the tolerance, if it was; ``largest_difference`` is the largest
    relative one, 0 when all bits are the same. ``runs`` and ``steps`` were simulated again; ``episodes`` are seeds of the full episodes
    that were compared, too. ``reproduced`` and ``stated``: fields that were reproduced, or merely stated (``coverage``).
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
    sha256: str = ""
    """SHA-256 of the file that was verified; empty unless it was reproduced."""
    created: str = ""
    """When it states that it was made; empty unless it was reproduced."""

    @property
    def exit_code(self) -> int:
        """0 reproduced, 1 refuted, 2 cannot be verified here, 3 cannot be verified before the round is over."""
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
    return reproduced, tuple(field for fields in _CLAIMS.values() for field in fields if field not in absent)


def stated_words(fields: Collection[str]) -> Sequence[str]:
    """Fields that a result merely states, in words, as groups."""
    return [words for words, group in _CLAIMS.items() if any(field in fields for field in group)]


@dataclass(frozen=True)
class Difference:
    """A value that differs: what kind of value, and which one in words."""

    cause: str
    words: str


@dataclass(frozen=True)
class Agreement:
    """What was compared so far: the ``largest`` relative difference and the ``first`` value of which a bit differs.

    ``first_large`` is the first value that differs by more than the tolerance.
    """

    largest: float = 0.0
    first: Difference | None = None
    first_large: Difference | None = None

    @property
    def exact(self) -> bool:
        """Whether all bits were the same."""
        return self.first is None

    def add(self, cause: str, recorded: Floats, simulated: Floats, words: tuple[str, ...], where: str) -> Agreement:
        """Compare tables ``(steps, columns)``, of which ``words`` name the columns; step 1 is the first row.

        Differences are relative to the largest value of their column.
        """
        differs = ~same_bits(recorded, simulated)
        if not differs.any():
            return self
        with np.errstate(all="ignore"):  # what is not finite counts as infinitely far apart
            size = np.max(np.abs(np.concatenate([recorded, simulated])), axis=0)
            relative = np.abs(np.subtract(recorded, simulated, dtype=np.float64)) / np.where(size > 0.0, size, 1.0)
            apart = np.where(differs, np.nan_to_num(relative, nan=np.inf, posinf=np.inf), 0.0)

        def first(which: NDArray[np.bool_]) -> Difference | None:
            if not which.any():
                return None
            step, column = (int(index) for index in np.argwhere(which)[0])
            place = f"step {step + 1}, {words[column]}" if len(recorded) > 1 else words[column]
            return Difference(cause, f"{where}, {place}: recorded {recorded[step, column]!s}, found {simulated[step, column]!s}")

        return Agreement(max(self.largest, float(apart.max())), self.first or first(differs), self.first_large or first(apart > TOLERANCE))

    def verdict(self, *, same_arithmetic: bool, origin: str) -> Refused | None:
        """Why this is not reproduced; ``None`` when it is. ``origin`` says what the result states of its machine."""
        if self.first is None:
            return None
        if same_arithmetic:
            reason = (
                f"{self.first.words}. The recorded actions do not lead there. The machine is not the cause, because other numbers of "
                "whole runs are the same to the last bit."
            )
            return Refused("refuted", self.first.cause, reason)
        if self.first_large is None:
            return None
        large = self.first_large
        if self.largest <= CHAOS:
            reason = (
                f"{large.words}. The largest relative difference is {self.largest:.1e}, more than {TOLERANCE:g}: an adaptive step on "
                f"another machine can make it, and so can a change by hand. {origin} Verify on the machine that made the result."
            )
            return Refused("unknown", "other_machine", reason)
        reason = f"{large.words}. The recorded actions do not lead there, and differences between machines are smaller."
        return Refused("refuted", large.cause, reason)


def same_bits(one: Floats, other: Floats) -> NDArray[np.bool_]:
    """Bit patterns, so that 0.0 and -0.0 differ and nan equals nan."""
    if one.dtype != other.dtype:
        return np.asarray(one == other)
    whole = np.uint64 if one.dtype.itemsize == 8 else np.uint32
    return np.asarray(np.ascontiguousarray(one).view(whole) == np.ascontiguousarray(other).view(whole))


SUFFIX: Final = ".proof.json"
SCHEMA: Final = "glbench/proof"
_LARGEST = MIB
_KEY = "proof.key"


class Proof(Record):
    """What `glbench verify` reproduced of one result file.

    ``result_sha256`` is that of the whole file, so that nothing in it can change under the note. ``reproduced`` and ``stated`` name fields
    of the result; notes of schema version 1 lack them, and call ``exactness`` ``proved``.
    """

    schema_name: Literal["glbench/proof"] = Field(default=SCHEMA, alias="schema")
    schema_version: Literal[1, 2] = 2
    result: Word
    result_sha256: Digest
    results_digest: Digest
    record_digest: Digest
    exactness: Exactness = Field(validation_alias=AliasChoices("exactness", "proved"))
    largest_difference: Annotated[float, Field(ge=0, le=TOLERANCE)]
    runs: Count
    steps: Count
    full_episodes: Annotated[tuple[Count, ...], FailFast()]
    reproduced: tuple[Word, ...] = ()
    stated: tuple[Word, ...] = ()
    glbench: Word
    machine: Machine
    seal: Digest | None = None
    """HMAC-SHA256 over the other fields with this user's key, without which the note counts for nothing outside the released results."""


def proof_path(result: Path) -> Path:
    """``<agent>.proof.json`` beside ``<agent>.json``."""
    return result.with_name(result.name.removesuffix(".json") + SUFFIX)


def save_proof(verdict: Verdict) -> Path | None:
    """Write the note of a verdict beside its result, or remove one that the verdict contradicts; the path if one was written.

    A file that changed since it was read for the verdict gets none. Raises ``GlbenchError`` when the folder cannot be written.
    """
    path = proof_path(verdict.path)
    if verdict.exactness is None:
        if verdict.outcome == "refuted":
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                refuse(f"Cannot remove {path}, which the verdict contradicts: {error.strerror or error}.", GlbenchError, error)
        return None
    result, content = load_with_bytes(verdict.path)
    if result.record is None or sha256_of(verdict.path, content) != verdict.sha256:
        return None
    proof = Proof(
        result=verdict.path.name, result_sha256=verdict.sha256, results_digest=result.results_digest,
        record_digest=result.record.digest, exactness=verdict.exactness, largest_difference=verdict.largest_difference, runs=verdict.runs,
        steps=verdict.steps, full_episodes=verdict.episodes, reproduced=verdict.reproduced, stated=verdict.stated, glbench=__version__,
        machine=this_machine(),
    )  # fmt: skip
    proof = proof.model_copy(update={"seal": _seal(proof, create=True)})
    write_atomically(path, proof.model_dump_json(by_alias=True, indent=2) + "\n")
    return path


def read_proof(result: Path) -> Proof | None:
    """The note on exactly this result file; ``None`` when there is none, or it is of other content."""
    try:
        proof = Proof.model_validate_json(read_regular(proof_path(result), _LARGEST))
        return proof if proof.result_sha256 == sha256_of(result, read_regular(result, LARGEST_RESULT)) else None
    except (OSError, ValidationError):
        return None


def was_reproduced(result: Path) -> bool:
    """Whether `glbench verify` of this user reproduced exactly this result file, or it came reproduced with glbench.

    A note that came along with somebody else's result proves nothing: anyone can write one.
    """
    proof = read_proof(result)
    if proof is None:
        return False
    seal = _seal(proof, create=False)
    return is_released(result) or (seal is not None and proof.seal is not None and hmac.compare_digest(seal, proof.seal))


def _seal(proof: Proof, *, create: bool) -> str | None:
    """The seal that this user's key gives ``proof``; ``None`` where there is no key and none can, or is to, be made."""
    try:
        file = user_data_folder() / _KEY
        if create and not file.exists():
            file.parent.mkdir(parents=True, exist_ok=True)
            handle, name = tempfile.mkstemp(dir=file.parent)  # readable by its owner alone
            try:
                with os.fdopen(handle, "wb") as stream:
                    stream.write(secrets.token_bytes(32))
                with contextlib.suppress(FileExistsError):  # of two processes that make a key at once the first one's stays
                    os.link(name, file)
            finally:
                Path(name).unlink()
        key = read_regular(file, _LARGEST)
    except (OSError, GlbenchError):
        return None
    return hmac.new(key, proof.model_dump_json(exclude={"seal"}).encode(), "sha256").hexdigest()


def sha256_of(path: Path, content: bytes) -> str:
    """SHA-256 of the content of a result file, with the line ends of Unix."""
    return hashlib.sha256(with_unix_line_ends(path.name, content)).hexdigest()
