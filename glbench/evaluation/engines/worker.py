"""What a remote worker does: unpack agent and task, compute the runs that it was given, give back numbers or a reason."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from glbench import __version__
from glbench.episodes.definition import task_of
from glbench.errors import GlbenchError
from glbench.evaluation.engines.parcels import Parcel
from glbench.evaluation.job import Evaluation, JointAgentError
from glbench.evaluation.lockstep import Progress
from glbench.evaluation.preparing import prepare
from glbench.evaluation.sandbox.choosing import Protection
from glbench.evaluation.saving import Computed
from glbench.kernel import why_not_compiled


@dataclass(frozen=True)
class Order:
    """Runs of an agent on a task, and everything that has to be the same there.

    ``checkpoints`` is a folder on the machine that sent the order, and ``mark`` a file in it: where both are seen, the two machines share
    their disk and checkpoints are worth writing. ``is_part`` says that these are only some of the evaluation's runs.
    """

    definition: bytes
    parcel: Parcel
    seeds: tuple[int, ...]
    is_part: bool
    protection: Protection
    task_digest: str
    agent_digest: str
    kernel: dict[str, str | float]
    version: str
    checkpoints: Path | None
    mark: Path | None


@dataclass(frozen=True)
class Refusal:
    """Why there are no numbers, in words. ``joint``: the agent decides for all runs at once, so they cannot be divided."""

    reason: str
    joint: bool = False


def work(order: Order, progress: Callable[[Progress], None]) -> Computed | Refusal:
    """Do what was ordered. Errors of glbench come back as words, everything else is raised."""
    # Numerical libraries would start a thread a core in each of several workers on one machine, and round by their number.
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))
    try:
        with order.parcel.unpacked() as ref:
            evaluation = _prepared(order, ref)
            different = _differences(order, evaluation)
            if different is not None:
                return Refusal(different)
            computed = evaluation.compute(progress)
    except JointAgentError as error:
        return Refusal(str(error), joint=True)
    except GlbenchError as error:
        return Refusal(str(error))
    return replace(computed, trace=None)


def _prepared(order: Order, ref: str) -> Evaluation:
    evaluation = prepare(
        task_of(order.definition),
        ref,
        runs=len(order.seeds),
        first_seed=order.seeds[0],
        sandbox="bubblewrap" if order.protection == "bubblewrap" else "none",
    )
    shared = order.checkpoints is not None and order.mark is not None and order.mark.is_file()
    return replace(evaluation, checkpoints=order.checkpoints if shared else None, is_part=order.is_part)


def _differences(order: Order, evaluation: Evaluation) -> str | None:
    """Why this machine's numbers would be others than those of the machine that sent the order."""
    if order.version != __version__:
        return f"The worker has glbench {__version__}, this machine {order.version}. Install the same version on all machines."
    if order.task_digest != evaluation.task.digest:
        return "The worker's weather, parameters or model differ from those of this machine: the task has another digest there."
    if order.agent_digest != evaluation.agent.digest:
        return "The agent arrived with another digest than it was sent with. Did its files change while it was packed?"
    if order.kernel != evaluation.kernel:
        reason = why_not_compiled() or f"It has {evaluation.kernel}."
        return f"The worker's kernel is another one than this machine's, which would change the numbers. {reason}"
    return None
