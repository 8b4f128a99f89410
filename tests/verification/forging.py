"""Forging results as someone would who knows glbench well: digests, summaries and checksums are repaired afterwards."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from glbench.episodes import ActionLog, log_bytes, read_log
from glbench.evaluation.records import AgentRecord, RunResult, results_digest, summarise

Document = dict[str, Any]


def record_of(result: Path) -> Path:
    return result.with_name(f"{result.stem}.actions.mcap")


def rewrite(result: Path, change: Callable[[Document], None], *, repair: bool = True) -> None:
    """Change the result file; with ``repair`` its summary and its digest follow."""
    document = json.loads(result.read_text())
    change(document)
    if repair:
        runs = tuple(RunResult.model_validate_json(json.dumps(run)) for run in document["runs"])
        agent = AgentRecord.model_validate_json(json.dumps(document["agent"]))
        document["evaluation"]["seeds"] = [run.seed for run in runs]
        document["evaluation"]["runs"] = len(runs)
        document["summary"] = json.loads(summarise(runs).model_dump_json())
        document["results_digest"] = results_digest(document["task"]["digest"], agent, runs)
    result.write_text(json.dumps(document))


def rewrite_record(result: Path, change: Callable[[ActionLog], ActionLog], *, repair: bool = True) -> None:
    """Change the recorded actions; with ``repair`` the result names the digest of what was made of them."""
    log = change(read_log(record_of(result)))
    record_of(result).write_bytes(log_bytes(log))
    if repair:
        rewrite(result, lambda document: document["record"].update(digest=log.digest))


def changed(values: np.ndarray, place: Any, value: float) -> np.ndarray:
    """A copy of ``values`` with one of them changed."""
    copy = values.copy()
    copy[place] = value
    return copy


def perturb(result: Path, factor: float) -> None:
    """Multiply every reward, final state and metric, as the arithmetic of another machine might: each run sums up to its metrics."""
    log = read_log(record_of(result))
    rewards = log.rewards * factor
    rewrite_record(result, lambda log: replace(log, rewards=rewards, final_states=log.final_states * factor))

    def follow(document: Document) -> None:
        for row, run in enumerate(document["runs"]):
            run["metrics"] = {name: value * factor for name, value in run["metrics"].items()}
            run["metrics"]["reward"] = float(np.add.accumulate(rewards[:, row])[-1])

    rewrite(result, follow)
