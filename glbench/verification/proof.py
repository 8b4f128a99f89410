"""The proof beside a result: a small file that says what was proved, of which very file."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Final, Literal

from pydantic import ConfigDict, Field, ValidationError

from glbench import __version__
from glbench.evaluation import load_result, provenance
from glbench.evaluation.records import Count, Digest, Machine, Record
from glbench.resources import write_atomically
from glbench.verification.verdict import Exactness, Verdict

SUFFIX: Final = ".proof.json"
SCHEMA: Final = "glbench/proof"


class Proof(Record):
    """What `glbench verify` proved of one result file.

    ``result_sha256`` is that of the whole file, so that nothing in it can change under the proof.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, populate_by_name=True)

    schema_name: Literal["glbench/proof"] = Field(default=SCHEMA, alias="schema")
    schema_version: Literal[1] = 1
    result: str
    result_sha256: Digest
    results_digest: Digest
    record_digest: Digest
    proved: Exactness
    largest_difference: float
    runs: Count
    steps: Count
    full_episodes: tuple[Count, ...]
    glbench: str
    machine: Machine


def proof_path(result: Path) -> Path:
    """``<agent>.proof.json`` beside ``<agent>.json``."""
    return result.with_name(result.name.removesuffix(".json") + SUFFIX)


def save_proof(verdict: Verdict) -> Path | None:
    """Write the proof of a verdict beside its result, or remove one that the verdict contradicts; the path if one was written.

    Raises
    ------
    GlbenchError
        When the folder cannot be written.
    """
    path = proof_path(verdict.path)
    if verdict.exactness is None:
        if verdict.outcome == "refuted":
            path.unlink(missing_ok=True)
        return None
    result = load_result(verdict.path)
    assert result.record is not None
    proof = Proof(
        result=verdict.path.name,
        result_sha256=_sha256(verdict.path),
        results_digest=result.results_digest,
        record_digest=result.record.digest,
        proved=verdict.exactness,
        largest_difference=verdict.largest_difference,
        runs=verdict.runs,
        steps=verdict.steps,
        full_episodes=verdict.episodes,
        glbench=__version__,
        machine=provenance.machine(),
    )
    write_atomically(path, proof.model_dump_json(by_alias=True, indent=2) + "\n")
    return path


def read_proof(result: Path) -> Proof | None:
    """The proof of exactly this result file; ``None`` when there is none, or it is of other content."""
    try:
        proof = Proof.model_validate_json(proof_path(result).read_bytes())
        return proof if proof.result_sha256 == _sha256(result) else None
    except (OSError, ValidationError):
        return None


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
