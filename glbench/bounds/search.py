"""The search for plans: one scenario at a time, on this machine's cores or a Ray cluster; each plan is saved as soon as it is found."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glbench.agents.identity import CARD_FILE
from glbench.agents.plans import read_book
from glbench.bounds.replay import Earned
from glbench.bounds.workers import Listener, PlanJob, here, on_ray
from glbench.control import Scenario
from glbench.env import Simulation, StepResult
from glbench.errors import GlbenchError
from glbench.evaluation import prepare
from glbench.evaluation.engines.cluster import Cluster
from glbench.evaluation.engines.luggage import PackedTask
from glbench.resources import write_atomically

if TYPE_CHECKING:
    from glbench.evaluation import Progress, Protected
    from glbench.tasks import TaskSpec

Floats = NDArray[np.float64]

_ENGINES = ("local", "ray")


@dataclass(frozen=True)
class Found:
    """A plan found now or, if ``stored``, in an earlier search; ``reason`` says why there is none."""

    seeds: tuple[int, ...]
    earned: Earned | None
    stored: bool = False
    reason: str = ""


@dataclass(frozen=True)
class Search:
    """A search for plans for runs of a task, with perfect information.

    Attributes
    ----------
    task
        The task, in the split whose runs are to be planned.
    seeds
        Seeds of the runs.
    start
        The agent whose controls each plan starts from.
    folder
        Where each plan is saved, as ``<seed>.npz``. Finished plans are skipped.
    iterations
        Iterations of ``glbench.control.plan_season``.
    workers
        Number of processes.
    address
        Address of the Ray cluster to plan on; without one, a cluster is started on this machine.

    Raises
    ------
    GlbenchError
        When the task has machines that are off or on, which the planner does not know.
    """

    task: TaskSpec
    seeds: tuple[int, ...]
    start: Protected
    folder: Path
    iterations: int = 35
    workers: int = 1
    address: str | None = None
    groups: tuple[tuple[int, ...], ...] = field(init=False)
    """Seeds of the runs; runs with identical conditions are grouped together."""

    def __post_init__(self) -> None:
        if self.task.on_off:
            msg = (
                f"{self.task.id} has machines that are off or on ({', '.join(self.task.on_off)}). The planner moves controls "
                "continuously, so such a task cannot be planned. The best run of an agent can be handed in: "
                "glbench bound --submit RESULT.json."
            )
            raise GlbenchError(msg)
        object.__setattr__(self, "groups", alike(self.task, self.seeds))

    def place(self, seeds: Sequence[int]) -> Path:
        """Where the plan of a group is saved."""
        return self.folder / f"{seeds[0]}.npz"

    def stored(self) -> list[Found]:
        """The plans found earlier.

        Raises
        ------
        GlbenchError
            When a plan was made for another version of the task, or its file is damaged.
        """
        found = []
        for seeds in self.groups:
            file = self.place(seeds)
            if file.is_file():
                book = read_book(file)
                reason = book.why_not(self.task)
                if reason is not None:
                    msg = f"The plans in {file} are not for {self.task.id}: {reason}. Choose another folder with --out."
                    raise GlbenchError(msg)
                about = book.about_run(seeds[0])
                found.append(Found(seeds, Earned(*(float(about[name]) for name in Earned._fields)), stored=True))
        return found

    def save_card(self) -> None:
        """Write the card with which the folder of plans can be evaluated as an agent that sees everything.

        Raises
        ------
        GlbenchError
            When it cannot be written.
        """
        lines = {
            "title": f"Plans for {self.task.id}",
            "controller": "plans",
            "settings": ".",
            "description": f"Plans optimised from the actions of {self.start.agent.name}, with {self.iterations} iterations each.",
            "made": "glbench bound",
        }
        text = "".join(f"{key} = {json.dumps(value, ensure_ascii=False)}\n" for key, value in lines.items())
        write_atomically(self.folder / CARD_FILE, f"{text}sources = []\n")

    def orders(self, progress: Callable[[Progress], None] | None = None) -> list[PlanJob]:
        """The remaining plans to search for, each with the controls of the starting agent, which is evaluated in these runs."""
        done = {found.seeds for found in self.stored()}
        left = [seeds for seeds in self.groups if seeds not in done]
        if not left:
            return []
        controls = begun(self.task, self.start, [seeds[0] for seeds in left], progress)
        task, name = PackedTask.of(self.task), self.start.agent.name
        return [PlanJob(task, seeds, u, name, self.iterations) for seeds, u in zip(left, controls, strict=True)]

    def run(
        self, orders: Sequence[PlanJob], *, engine: str = "local", listener: Listener | None = None
    ) -> Iterator[Found]:
        """Search for plans, and save each one as soon as it is found.

        Raises
        ------
        GlbenchError
            When the engine does not exist, or a plan cannot be written.
        """
        if engine not in _ENGINES:
            msg = f"There is no engine '{engine}'. It is one of {', '.join(_ENGINES)}."
            raise GlbenchError(msg)
        if engine == "ray":
            planned = on_ray(orders, Cluster(self.address, self.workers), self.task, listener)
        else:
            planned = here(orders, self.workers, listener)
        for order, given in planned:
            if isinstance(given, str):
                yield Found(order.seeds, None, reason=given)
                continue
            book = given.with_about(start=order.start)
            book.save(self.place(order.seeds))
            about = book.about_run(order.seeds[0])
            yield Found(order.seeds, Earned(*(float(about[name]) for name in Earned._fields)))


def alike(task: TaskSpec, seeds: Sequence[int]) -> tuple[tuple[int, ...], ...]:
    """The seeds, grouped so that the runs of a group have identical conditions and one plan serves them all."""
    groups: dict[str, list[int]] = {}
    for seed in seeds:
        given, digest = Scenario.of(task, seed), hashlib.sha256()
        for values in (given.x0, given.u_before, given.d, given.p, given.calendar):
            digest.update(values.tobytes())
        groups.setdefault(digest.hexdigest(), []).append(seed)
    return tuple(tuple(group) for group in groups.values())


class _Controls:
    """Observes an agent's steps and records the controls."""

    def __init__(self) -> None:
        self.taken: list[Floats] = []

    def add(self, simulation: Simulation, outcome: StepResult) -> None:
        """Record the controls of a step."""
        self.taken.append(np.array(simulation.u))


def begun(
    task: TaskSpec, agent: Protected, seeds: Sequence[int], progress: Callable[[Progress], None] | None = None
) -> Floats:
    """The controls of an agent in the runs of ``task`` with ``seeds``, ``(n, steps, controls)``.

    Raises
    ------
    GlbenchError
        When the agent cannot be evaluated, or one of its runs fails.
    """
    prepared = prepare(task.scored, agent)
    looking_on = _Controls()
    result = replace(prepared, task=task, seeds=tuple(seeds), workers=1).compute(progress, looking_on).result
    if result.failed:
        run = result.failed[0]
        msg = f"'{agent.agent.name}' fails in the run with the seed {run.seed}: {run.reason}. Begin with another agent (--start)."
        raise GlbenchError(msg)
    return np.stack(looking_on.taken, axis=1)
