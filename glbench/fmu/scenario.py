"""Which seasons an FMU may show, and which task it was made from."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass

from glbench.errors import TaskError, did_you_mean, refuse
from glbench.tasks import TaskSpec, get_task

LARGEST_SEED = 2**53  # FMI 2.0 has no integers of 64 bits: a seed is a real number, exact up to here


@dataclass(frozen=True)
class FmuSetup:
    """What an FMU was exported with: its task by id and digest, start values of its parameters, and the version of glbench.

    ``definition`` is the task as JSON (``TaskSpec.attachment``), if it does not come with glbench; otherwise empty.
    """

    task: str
    digest: str
    definition: str
    seed: int
    split: str
    version: str

    @property
    def fingerprint(self) -> str:
        """SHA-256 [hex] of all of it: FMUs with other content differ in it."""
        return hashlib.sha256(json.dumps(asdict(self)).encode("utf-8")).hexdigest()

    def find_task(self) -> TaskSpec:
        """The task. Raises ``TaskError`` when it is another one here than where the FMU was exported, and as ``get_task``."""
        task = TaskSpec.of_attachment(json.loads(self.definition)) if self.definition else get_task(self.task)
        if task.digest != self.digest:
            msg = (
                f"This FMU was exported by glbench {self.version} from {self.task} with the digest {self.digest[:12]}; here that task "
                f"has the digest {task.digest[:12]}. Export the FMU again with the glbench that is installed here."
            )
            raise TaskError(msg)
        return task


def splits_of(task: TaskSpec) -> tuple[str, ...]:
    """The splits whose seasons an FMU may show; ``("",)`` for a task without any. Raises ``TaskError`` when it has only a test split."""
    if task.splits is None:
        return ("",)
    names = tuple(name for name in task.splits.names if name != "test")
    if not names:
        msg = (
            f"{task.id} has only test seasons, which score agents and are not exported. "
            f"Export a task with training seasons, such as {task.base or 'glbench/Spring-v1'}."
        )
        raise TaskError(msg)
    return names


def task_in_season(task: TaskSpec, split: str, seed: float) -> TaskSpec:
    """``task`` with the scenarios of ``split``, when an FMU may show the season of ``seed`` there.

    Raises ``TaskError`` for a test season, an unknown split, or a seed that is not a whole number from 0 to 2**53.
    """
    names = splits_of(task)
    if not (0 <= seed <= LARGEST_SEED and seed == int(seed)):
        refuse(f"The seed {seed!r} is not a whole number from 0 to {LARGEST_SEED:,}.", TaskError)
    if split not in names:
        if names == ("",):
            msg = f"{task.id} has no splits, so there is no split '{split}': leave it empty."
        elif split == "test":
            msg = (
                f"The test seasons of {task.id} score agents and are not exported. Take a season of the split {' or '.join(names)}; "
                "`glbench evaluate` scores an agent in the test seasons."
            )
        else:
            msg = f"{task.id} has no split '{split}' to export.{did_you_mean(split, names, list_few=False)} It has {', '.join(names)}."
        raise TaskError(msg)
    if split:
        return task.in_split(split)
    if seed in task.evaluation.seeds:
        seeds = task.evaluation.seeds
        msg = (
            f"{task.id} has no splits and scores the runs with the seeds {seeds[0]} to {seeds[-1]}: the seed {int(seed)} is not exported. "
            "Take a seed outside these."
        )
        raise TaskError(msg)
    return task
