"""Parts of an evaluation: some of its runs, computed elsewhere, and the whole that they are put together to.

Only agents for single runs are divided. An agent that decides for all runs at once keeps them together, whatever it does with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from glbench.episodes.action_log import exactly
from glbench.evaluation.job import Evaluation
from glbench.evaluation.records import EvaluationRecord, Result, results_digest, summarise
from glbench.evaluation.saving import Computed


def divided(seeds: tuple[int, ...], parts: int) -> list[tuple[int, ...]]:
    """``seeds`` in at most that many parts of nearly the same size, in their order."""
    sizes = [len(chunk) for chunk in np.array_split(np.arange(len(seeds)), min(parts, len(seeds)))]
    ends = np.cumsum(sizes).tolist()
    return [seeds[end - size : end] for size, end in zip(sizes, ends, strict=True)]


def may_be_divided(evaluation: Evaluation) -> bool:
    """Whether the agent may be one for single runs, as far as its source tells; the worker looks at the agent itself."""
    submission = evaluation.submission or evaluation.agent.submission
    if submission is None or submission.form != "python":
        return False
    return any(b"single_run" in file.read_bytes() for file in submission.all_files() if file.suffix == ".py")


def put_together(evaluation: Evaluation, parts: Sequence[Computed]) -> Computed:
    """The whole of ``parts``, which are in the order of the seeds: the same runs, bits and digests as in one piece."""
    if len(parts) == 1:
        return replace(parts[0], trace=None)
    first = parts[0]
    log = replace(
        first.log,
        runs=tuple(run for part in parts for run in part.log.runs),
        actions=exactly(np.concatenate([part.log.actions.astype(np.float64) for part in parts], axis=1)),
        rewards=np.concatenate([part.log.rewards for part in parts], axis=1),
        final_states=np.concatenate([part.log.final_states for part in parts], axis=0),
    )
    runs = tuple(run for part in parts for run in part.result.runs)
    whole = first.result.model_copy(
        update={
            "runs": runs,
            "summary": summarise(runs),
            "evaluation": _evaluation_record(evaluation, [part.result for part in parts]),
            "results_digest": results_digest(first.result.task.digest, first.result.agent, runs),
            "created": max(part.result.created for part in parts),
        }
    )
    # Copying checks nothing; what is put together must be as consistent as what was computed in one piece.
    printed = "\n".join(part.printed for part in parts if part.printed)
    return Computed(Result.model_validate_json(whole.to_json()), log, printed=printed)


def _evaluation_record(evaluation: Evaluation, results: Sequence[Result]) -> EvaluationRecord:
    records = [result.evaluation for result in results]
    steps = sum(run.steps for result in results for run in result.runs)
    seconds, wall = sum(record.decision_seconds for record in records), max(record.wall_seconds for record in records)
    resumed = [record.resumed_at_step for record in records if record.resumed_at_step is not None]
    return records[0].model_copy(
        update={
            "runs": len(evaluation.seeds),
            "seeds": evaluation.seeds,
            "workers": len(results),
            "wall_seconds": wall,
            "steps_per_second": steps / wall,
            "decision_seconds": seconds,
            "decision_milliseconds": 1e3 * seconds / max(steps, 1),
            "resumed_at_step": min(resumed) if resumed else None,
        }
    )
