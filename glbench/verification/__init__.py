"""Reproducing results from their records: the agent is not needed, only task, seeds and recorded actions.

``verify(path)`` gives a ``Verdict``; ``docs/verification.md`` says what it covers and what it does not.
"""

from glbench.verification.proof import SUFFIX, TOLERANCE, Proof, Verdict, proof_path, read_proof, save_proof, stated_words, was_reproduced
from glbench.verification.proving import verify

__all__ = ["SUFFIX", "TOLERANCE", "Proof", "Verdict", "proof_path", "read_proof", "save_proof", "stated_words", "verify", "was_reproduced"]
