"""Verification record beside a result: file digest, verdict, machine and tolerance."""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import os
import secrets
import tempfile
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import AliasChoices, ConfigDict, FailFast, Field, ValidationError

from glbench import __version__
from glbench.errors import GlbenchError
from glbench.evaluation import load_result, provenance
from glbench.evaluation.files import LARGEST_RESULT
from glbench.evaluation.records import Digest, Machine, Record
from glbench.fields import Count, Word
from glbench.resources import is_released, user_data_folder, write_atomically
from glbench.untrusted import MIB, read_regular
from glbench.verification.verdict import TOLERANCE, Exactness, Verdict

SUFFIX: Final = ".proof.json"
SCHEMA: Final = "glbench/proof"
_LARGEST = MIB
_KEY = "proof.key"


class Proof(Record):
    """What `glbench verify` reproduced of one result file.

    ``result_sha256`` is that of the whole file, so that nothing in it can change under the note. ``reproduced`` and ``stated`` name fields
    of the result; notes of schema version 1 lack them, and call ``exactness`` ``proved``.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, populate_by_name=True)

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

    Raises
    ------
    GlbenchError
        When the folder cannot be written.
    """
    path = proof_path(verdict.path)
    if verdict.exactness is None:
        if verdict.outcome == "refuted":
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                msg = f"Cannot remove {path}, which the verdict contradicts: {error.strerror or error}."
                raise GlbenchError(msg) from error
        return None
    result = load_result(verdict.path)
    assert result.record is not None
    proof = Proof(
        result=verdict.path.name,
        result_sha256=_sha256(verdict.path),
        results_digest=result.results_digest,
        record_digest=result.record.digest,
        exactness=verdict.exactness,
        largest_difference=verdict.largest_difference,
        runs=verdict.runs,
        steps=verdict.steps,
        full_episodes=verdict.episodes,
        reproduced=verdict.reproduced,
        stated=verdict.stated,
        glbench=__version__,
        machine=provenance.machine(),
    )
    proof = proof.model_copy(update={"seal": _seal(proof, create=True)})
    write_atomically(path, proof.model_dump_json(by_alias=True, indent=2) + "\n")
    return path


def read_proof(result: Path) -> Proof | None:
    """The note on exactly this result file; ``None`` when there is none, or it is of other content."""
    try:
        proof = Proof.model_validate_json(read_regular(proof_path(result), _LARGEST))
        return proof if proof.result_sha256 == _sha256(result) else None
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
    return is_released(result) or (
        seal is not None and proof.seal is not None and hmac.compare_digest(seal, proof.seal)
    )


def _seal(proof: Proof, *, create: bool) -> str | None:
    """The seal that this user's key gives ``proof``; ``None`` where there is no key and none can, or is to, be made."""
    try:
        file = user_data_folder() / _KEY
        if create and not file.exists():
            file.parent.mkdir(parents=True, exist_ok=True)
            handle, name = tempfile.mkstemp(dir=file.parent)  # readable by its owner alone
            try:
                with os.fdopen(handle, "wb") as opened:
                    opened.write(secrets.token_bytes(32))
                with contextlib.suppress(
                    FileExistsError
                ):  # of two processes that make a key at once the first one's stays
                    os.link(name, file)
            finally:
                Path(name).unlink()
        key = read_regular(file, _LARGEST)
    except (OSError, GlbenchError):
        return None
    return hmac.new(key, proof.model_dump_json(exclude={"seal"}).encode(), "sha256").hexdigest()


def _sha256(path: Path) -> str:
    return hashlib.sha256(read_regular(path, LARGEST_RESULT)).hexdigest()
