"""The search for plans: one scenario a job, on this machine's cores or a Ray cluster; each plan is saved as soon as it is found.

``replay_plans`` says what plans earn in the ordinary simulation.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from glbench import __version__
from glbench.agents.identity import CARD_FILE
from glbench.agents.plans import PlanBook, read_book
from glbench.arrays import Floats
from glbench.bounds.commitment import redispatched
from glbench.control import Iteration, Scenario, plan_season
from glbench.env import Simulation, StepResult
from glbench.errors import EpisodeError, GlbenchError, SubmissionError, refuse
from glbench.evaluation import Progress, Protected, prepare
from glbench.evaluation.jobs import PackedTask, Payload
from glbench.execution import Executor, JobContext, RayExecutor, local_executor
from glbench.resources import write_atomically
from glbench.tasks import TaskSpec

_ENGINES = ("local", "ray")


METHOD = "sequential convex programming"

Listener = Callable[[int, Iteration], None]
"""Called after every iteration, with the seed of the plan."""


class PlanValue(NamedTuple):
    """Sums over a run, as in an evaluation; ``epi`` is the profit [EUR m-2], ``penalty`` the penalty for violations."""

    reward: float
    epi: float
    penalty: float


def replay_plans(task: TaskSpec, book: PlanBook, seeds: Sequence[int]) -> dict[int, PlanValue]:
    """What the plans of ``book`` earn in the runs with ``seeds``, as evaluations count. Raises ``EpisodeError`` when a step fails."""
    simulation = Simulation(task, len(seeds))
    simulation.reset(list(seeds))
    actions = np.stack([book.plan(seed) for seed in seeds], axis=1)
    sums = np.zeros((len(PlanValue._fields), len(seeds)))
    for step, action in enumerate(actions):
        outcome = simulation.step(action)
        if outcome.failed:
            first = outcome.failed[0]
            refuse(f"Step {step + 1} of the plan for the seed {seeds[first.row]} cannot be simulated: {first.reason}.", EpisodeError)
        sums += [outcome.quantities[name] for name in PlanValue._fields]
    return {seed: PlanValue(*column) for seed, column in zip(seeds, sums.T.tolist(), strict=True)}


@dataclass(frozen=True, eq=False)
class PlanJob:
    """Everything a worker needs to plan the runs with ``seeds``, which have identical conditions; ``start`` names the first agent."""

    task: PackedTask
    seeds: tuple[int, ...]
    controls: Floats
    start: str
    iterations: int


def make_plan(context: JobContext, job: PlanJob) -> PlanBook:
    """A book with the plan; each ``Iteration`` is sent to the listener.

    Raises ``GlbenchError`` when there is no plan, or this machine's numbers would differ from those of the machine that packed the task.
    """
    task, seed = job.task.unpack(), job.seeds[0]
    plan = plan_season(Scenario.of(task, seed), job.controls, iterations=job.iterations, watch=context.send, dispatch=redispatched)
    book = PlanBook.of(task, job.seeds, plan.actions(), {"method": METHOD, "iterations": job.iterations})
    return book.with_about(glbench=__version__, **replay_plans(task, book, [seed])[seed]._asdict())


@dataclass(frozen=True)
class PlanOutcome:
    """A plan made now or, if ``stored``, in an earlier search; ``reason`` says why there is none."""

    seeds: tuple[int, ...]
    value: PlanValue | None
    stored: bool = False
    reason: str = ""
    how: tuple[object, object] = (None, None)  # name of the starting agent, and iterations

    @classmethod
    def of_book(cls, seeds: tuple[int, ...], book: PlanBook, *, stored: bool = False) -> PlanOutcome:
        """The outcome for the runs with ``seeds``, which share the plan in ``book``."""
        about = book.about_run(seeds[0])
        value = PlanValue(*(float(about[name]) for name in PlanValue._fields))
        return cls(seeds, value, stored, how=(about.get("start"), about.get("iterations")))


@dataclass(frozen=True)
class Search:
    """A search for plans for the runs of ``seeds`` of a task, in the split that it is in, with perfect information.

    Each plan starts from the controls of the agent ``start`` and takes ``iterations`` of ``glbench.control.plan_season``. It is saved in
    ``folder``, as ``<seed>.npz``; finished plans are skipped. ``workers`` processes plan here, or on the Ray cluster at ``address``.
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
        object.__setattr__(self, "groups", group_by_conditions(self.task, self.seeds))

    def place(self, seeds: Sequence[int]) -> Path:
        """Where the plan of a group is saved: under the name of its first run, or of the one that it was first made for."""
        files = [self.folder / f"{seed}.npz" for seed in seeds]
        return next((file for file in files if file.is_file()), files[0])

    def stored(self) -> list[PlanOutcome]:
        """The plans found earlier. The file of a plan that was made for fewer runs is written again, for all runs with the same conditions.

        Raises ``GlbenchError`` when a plan was made for another version of the task, or its file is damaged.
        """
        outcomes = []
        for seeds in self.groups:
            file = self.place(seeds)
            if file.is_file():
                try:
                    book = read_book(file)
                except SubmissionError as error:
                    way_out = "" if isinstance(error.__cause__, OSError) else " Remove the file to plan these runs again."
                    refuse(f"{error}{way_out}", GlbenchError, error)
                reason = book.why_not(self.task)
                if reason is not None:
                    refuse(f"The plans in {file} are not for {self.task.id}: {reason}. Choose another folder with --out.", GlbenchError)
                if not {*seeds} <= {*book.runs}:  # made for fewer runs with the same conditions
                    book = replace(book, runs={**book.runs, **dict.fromkeys(seeds, book.runs[int(file.stem)])})
                    book.save(file)
                outcomes.append(PlanOutcome.of_book(seeds, book, stored=True))
        return outcomes

    def save_card(self) -> None:
        """Write the card with which the folder of plans can be evaluated as an agent that sees everything; errors as of ``save_card``."""
        about = "Plans optimised with perfect information; each file says from which agent's actions, and in how many iterations."
        save_card(self.folder, f"Plans for {self.task.id}", about)

    def jobs(self, progress: Callable[[Progress], None] | None = None) -> list[PlanJob]:
        """The remaining plans to search for, each with the controls of the starting agent, which is evaluated in these runs."""
        stored = {outcome.seeds for outcome in self.stored()}
        groups = [seeds for seeds in self.groups if seeds not in stored]
        if not groups:
            return []
        controls = agent_controls(self.task, self.start, [seeds[0] for seeds in groups], progress)
        task, name = PackedTask.of(self.task), self.start.agent.name
        return [PlanJob(task, seeds, u, name, self.iterations) for seeds, u in zip(groups, controls, strict=True)]

    def run(self, jobs: Sequence[PlanJob], *, engine: str = "local", listener: Listener | None = None) -> Iterator[PlanOutcome]:
        """Search for plans, and save each at once. Raises ``GlbenchError`` when there is no such engine, or a plan cannot be written."""
        if engine not in _ENGINES:
            refuse(f"There is no engine '{engine}'. It is one of {', '.join(_ENGINES)}.", GlbenchError)
        if not jobs:
            return
        executor: Executor
        if engine == "ray":
            cores = None if self.address is not None else self.workers
            executor = RayExecutor(self.address, cores, Payload.of([self.task], for_plans=True).unpack)
        else:
            executor = local_executor(min(self.workers, len(jobs)))

        listen = listener or (lambda seed, iteration: None)
        with executor:
            futures = {executor.submit(make_plan, job, listener=partial(listen, job.seeds[0])): job for job in jobs}
            for future in executor.as_completed():
                job = futures[future]
                try:
                    book: PlanBook = future.result()
                except GlbenchError as error:
                    yield PlanOutcome(job.seeds, None, reason=str(error))
                    continue
                book = book.with_about(start=job.start)
                book.save(self.place(job.seeds))
                yield PlanOutcome.of_book(job.seeds, book)


def save_card(folder: Path, title: str, description: str) -> None:
    """Write the card that makes a folder of plans an agent. Raises ``GlbenchError`` when it cannot be written."""
    lines = {"title": title, "controller": "plans", "settings": ".", "description": description, "made": "glbench bound"}
    text = "".join(f"{key} = {json.dumps(value, ensure_ascii=False)}\n" for key, value in lines.items())
    write_atomically(folder / CARD_FILE, f"{text}sources = []\n")


def group_by_conditions(task: TaskSpec, seeds: Sequence[int]) -> tuple[tuple[int, ...], ...]:
    """The seeds, grouped so that the runs of a group have identical conditions and one plan serves them all."""
    groups: dict[str, list[int]] = {}
    for seed in seeds:
        scenario, digest = Scenario.of(task, seed), hashlib.sha256()
        delivery = scenario.delivery
        maps = () if delivery is None else (delivery.carry, delivery.gain)
        for values in (scenario.x0, scenario.u_before, scenario.d, scenario.p, scenario.calendar, *maps):
            digest.update(values.tobytes())
        groups.setdefault(digest.hexdigest(), []).append(seed)
    return tuple(tuple(group) for group in groups.values())


class _ControlsRecorder:
    """Records the commands of each step."""

    def __init__(self) -> None:
        self.controls: list[Floats] = []

    def add(self, simulation: Simulation, outcome: StepResult) -> None:
        """Record the commands of a step."""
        self.controls.append(simulation.commands)


def agent_controls(task: TaskSpec, agent: Protected, seeds: Sequence[int], progress: Callable[[Progress], None] | None = None) -> Floats:
    """The controls of an agent in the runs of ``task`` with ``seeds``, ``(n, steps, controls)``: what it told the actuators.

    Raises ``GlbenchError`` when the agent cannot be evaluated, or one of its runs fails.
    """
    evaluation = replace(prepare(task.scored, agent), task=task, seeds=tuple(seeds), workers=1)
    recorder = _ControlsRecorder()
    result = evaluation.compute(progress, recorder).result
    if result.failed:
        run = result.failed[0]
        msg = f"'{agent.agent.name}' fails in the run with the seed {run.seed}: {run.reason}. Begin with another agent (--start)."
        raise GlbenchError(msg)
    return np.stack(recorder.controls, axis=1)
