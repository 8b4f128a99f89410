"""Which conclusions about rules, learning and predictive control survive when the experiment changes? A study of factors.

    python benchmarks/factors.py cells                       # the cells of the design
    python benchmarks/factors.py run --work FOLDER           # trains and evaluates what is missing; may be interrupted
    python benchmarks/factors.py table --work FOLDER         # FOLDER/factors.md and FOLDER/factors.json, of what is there

`benchmarks/factors.toml` is the design; docs/factors.md explains it. The work folder holds tasks, trainings, results and tables. Tasks
have ids of their own, `factors/...`, and share seasons and draws with their base, so that cells can be compared run by run.
"""

from __future__ import annotations

import argparse
import datetime as dt
import itertools
import json
import math
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import reduce
from pathlib import Path
from typing import Any, Self

import numpy as np
from pydantic import Field, model_validator

from glbench import __version__
from glbench.errors import GlbenchError, TaskError, did_you_mean, refuse
from glbench.evaluation import Progress, Result, load_result, prepare, protect, result_path
from glbench.evaluation.evaluation import TRIALS, VALIDATION
from glbench.evaluation.jobs import Job, Options, Payload, divide_jobs
from glbench.evaluation.records import usable_cores
from glbench.execution import Executor, RayExecutor, local_executor
from glbench.extras import require
from glbench.resources import write_atomically
from glbench.settings import Table, read_settings, validated
from glbench.tasks import TaskSpec, get_task
from glbench.tasks.inheritance import as_written
from glbench.training.compiled_settings import CompiledSettings, read_compiled_settings
from glbench.training.multi_seed import outcome_of, submit_training

DESIGN, NAMESPACE, SAVED = Path(__file__).with_suffix(".toml"), "factors", "design.json"
SAME = ("split", "steps", "evaluations", "recipes")  # of the design, for as long as a work folder is used
_WHOLE, _TICK = 10**9, 60.0  # Characters of a value in a task file; seconds between two lines about a long job


class Change(Table):
    """What a level changes: tables and keys of the task, keys of its groups of drawn parameters, and the length of trainings."""

    without: tuple[str, ...] = ()
    task: dict[str, Any] = Field(default_factory=dict)
    groups: dict[str, dict[str, Any]] = Field(default_factory=dict)
    steps: float = Field(default=1.0, gt=0.0, description="above 0")


class Factor(Table):
    """A factor; ``centre`` is the level of the base."""

    title: str
    centre: str
    levels: dict[str, Change]

    @property
    def is_budget(self) -> bool:
        """Whether it changes trainings alone."""
        return all(level == Change(steps=level.steps) for level in self.levels.values())


class Corners(Table):
    """A two-level fraction: the low and high level of every factor; ``generators`` are columns of signs that are products of others."""

    levels: dict[str, tuple[str, str]]
    generators: dict[str, tuple[str, ...]] = Field(default_factory=dict)

    def signs(self) -> list[dict[str, int]]:
        """For each corner the signs of its factors: -1 low, +1 high."""
        free = [name for name in self.levels if name not in self.generators]
        rows = [dict(zip(free, signs, strict=True)) for signs in itertools.product((-1, 1), repeat=len(free))]
        whole = [row | {name: math.prod(row[one] for one in product) for name, product in self.generators.items()} for row in rows]
        return [{name: row[name] for name in self.levels} for row in whole]


class Base(Table):
    """A task whose factors are changed; ``agents`` are baselines by kind, and ``agent_runs`` how many runs they play at most."""

    task: str
    agents: dict[str, str]
    agent_runs: dict[str, int] = Field(default_factory=dict)
    factors: dict[str, Factor]
    corners: Corners = Corners(levels={})


class Design(Table):
    """The whole study; ``benchmarks/factors.toml`` says what the keys mean."""

    split: str = Field(pattern="^(validation|test)$", description="validation or test")
    runs: int = Field(ge=2, description="2 or more")
    trainings: int = Field(ge=1, description="1 or more")
    steps: int = Field(ge=1, description="1 or more")
    evaluations: int = Field(ge=1, description="1 or more")
    pairs: tuple[tuple[str, str], ...]
    recipes: dict[str, str]
    bases: dict[str, Base]

    @model_validator(mode="after")
    def _names_are_known(self) -> Self:
        for name, base in self.bases.items():
            kinds, corners = {*self.recipes, *base.agents}, base.corners
            for kind in [*itertools.chain(*self.pairs), *base.agent_runs]:
                if kind not in kinds:
                    refuse(f"bases.{name} has no agent '{kind}', which is compared.{did_you_mean(kind, kinds)}")
            named_levels = [(factor, one.centre) for factor, one in base.factors.items()]
            for factor, level in named_levels + [(factor, level) for factor, levels in corners.levels.items() for level in levels]:
                levels = base.factors[factor].levels if factor in base.factors else {}
                if level not in levels:
                    refuse(f"bases.{name}: the factor '{factor}' has no level '{level}'.{did_you_mean(level, levels)}")
            if {*itertools.chain(*corners.generators.values())} - ({*corners.levels} - {*corners.generators}):
                refuse(f"bases.{name}.corners: a generator is a product of factors of the corners that have none themselves")
        return self


@dataclass(frozen=True)
class Cell:
    """One level of every factor. Cells that differ in the budget alone share a ``task``; ``signs`` are those of a corner."""

    base: str
    name: str
    task: str
    levels: Mapping[str, str]
    signs: Mapping[str, int] | None = None

    @property
    def key(self) -> str:
        return f"{self.base}.{self.name}"


def cells_of(design: Design) -> dict[str, Cell]:
    """All cells by name: of each base the centre, then one factor at a time, then the corners."""
    cells = []
    for name, base in design.bases.items():
        centre = {factor: one.centre for factor, one in base.factors.items()}
        cells.append(Cell(name, "centre", f"{name}.centre", centre))
        for factor, one in base.factors.items():
            for level in (level for level in one.levels if level != one.centre):
                task = "centre" if one.is_budget else f"{factor}-{level}"
                cells.append(Cell(name, f"{factor}-{level}", f"{name}.{task}", centre | {factor: level}))
        for signs in base.corners.signs() if base.corners.levels else ():
            bits = {factor: str(int(sign > 0)) for factor, sign in signs.items()}
            levels = centre | {factor: base.corners.levels[factor][int(bit)] for factor, bit in bits.items()}
            task = "".join(bit for factor, bit in bits.items() if not base.factors[factor].is_budget)
            cells.append(Cell(name, f"corner-{''.join(bits.values())}", f"{name}.corner-{task}", levels, signs))
    return {cell.key: cell for cell in cells}


def choose(cells: Mapping[str, Cell], text: str | None) -> list[Cell]:
    """The cells of a list of names and patterns such as ``spring.draw-*``; all without one. Raises ``GlbenchError`` when one names none."""
    keys = set[str]()
    for pattern in (part.strip() for part in ("*" if text is None else text).split(",")):
        matches = {key for key in cells if fnmatchcase(key, pattern)}
        if not matches:
            refuse(f"There is no cell '{pattern}'.{did_you_mean(pattern, cells)} `cells` lists them.", GlbenchError)
        keys |= matches
    return [cell for key, cell in cells.items() if key in keys]


def task_file(design: Design, cell: Cell) -> str:
    """The task file of a cell: what differs from the base. Raises ``TaskError`` when two levels change the same key."""
    base = design.bases[cell.base]
    changes = [base.factors[factor].levels[level] for factor, level in cell.levels.items()]
    tables, of_groups = reduce(_merged, [one.task for one in changes]), reduce(_merged, [one.groups for one in changes])
    if of_groups:
        task = get_task(base.task)
        groups = {str(group.get("name")): group for group in task.file.content(task.source)["scenario"]["parameters"]}
        for name in of_groups:
            if name not in groups:
                refuse(f"{base.task} draws no group '{name}'.{did_you_mean(name, groups)}", TaskError)
        tables = _merged(tables, {"scenario": {"parameters": [group | of_groups.get(name, {}) for name, group in groups.items()]}})
    words = ", ".join(f"{factor} {level}" for factor, level in cell.levels.items() if not base.factors[factor].is_budget)
    top = {"base": base.task, "id": f"{NAMESPACE}/{cell.task}-v1", "title": f"{Path(base.task).stem}: {words}"}
    without = list(dict.fromkeys(name for one in changes for name in one.without))
    lines = [f"{key} = {as_written(value, _WHOLE)}" for key, value in (top | {"without": without} | tables).items()]
    return "\n".join(["# A cell of a study of factors, written by benchmarks/factors.py.", *lines, ""])


def _merged(one: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    both = dict(one)
    for key, value in other.items():
        if key in both and not (isinstance(value, Mapping) and isinstance(both[key], Mapping)):
            refuse(f"Two factors change '{key}' of the task. Let one of them do it.", TaskError)
        both[key] = _merged(both[key], value) if key in both else value
    return both


def steps_of(design: Design, cell: Cell) -> int:
    """Environment steps of a training in a cell."""
    factors = design.bases[cell.base].factors
    return round(design.steps * math.prod(factors[factor].levels[level].steps for factor, level in cell.levels.items()))


def in_split_of_evaluations(task: TaskSpec, split: str) -> TaskSpec:
    """A task in the split of evaluations. Raises ``TaskError`` when it has no such split."""
    return task.scored if split == "test" else task.in_split(split)


def agent_name(design: Design, cell: Cell, kind: str, seed: int = 0) -> str:
    """Name of an agent in results: that of a training has its steps, because cells share tasks."""
    return f"{kind}-{steps_of(design, cell)}-seed{seed}" if kind in design.recipes else design.bases[cell.base].agents[kind]


def read_result(design: Design, work: Path, task_id: str, agent: str) -> Result | None:
    """The result of an agent, if any. glbench keeps trials, with fewer runs than the task has, in another folder. Of two results of the
    agent's latest version, this is the one with more runs."""
    folders = [work / VALIDATION] if design.split == "validation" else [work, work / TRIALS]
    files = [result_path(folder, task_id, agent) for folder in folders]
    results = [load_result(file) for file in files if file.is_file()]
    latest = max(results, key=lambda result: result.created, default=None)
    return latest and max((one for one in results if one.agent.digest == latest.agent.digest), key=lambda result: len(result.runs))


def read_design(source: Path, changes: Mapping[str, Any] | None = None) -> Design:
    """The design in a TOML file, with ``changes`` of its numbers. Raises ``GlbenchError`` when there is none, or it is wrong."""
    design = read_settings(Design, source, "the design", GlbenchError, toml=True)
    return validated(Design, design.model_dump() | dict(changes or {}), "the design", source, GlbenchError)


def saved_design(work: Path) -> Design:
    """The design that a work folder was last used with. Raises ``GlbenchError`` when there is none."""
    file = work / SAVED
    if not file.is_file():
        refuse(f"There is no study in {work}. Begin one with `python benchmarks/factors.py run --work {work}`.", GlbenchError)
    return validated(Design, json.loads(file.read_text(encoding="utf-8")), "the design", file, GlbenchError)


@dataclass(frozen=True)
class Study:
    """A design, the file it is from, and its work folder."""

    design: Design
    source: Path
    work: Path

    def check(self) -> None:
        """Raise ``GlbenchError`` when the work folder is of another study, or a recipe is missing."""
        before = saved_design(self.work) if (self.work / SAVED).is_file() else self.design
        other = [f"{key} = {getattr(before, key)}" for key in SAME if getattr(before, key) != getattr(self.design, key)]
        if other:
            refuse(f"{self.work} holds a study with {', '.join(other)}. Say the same, or choose another folder with --work.", GlbenchError)
        for name in self.design.recipes:
            if not self.recipe(name).is_file():
                refuse(f"The recipe '{name}' is missing: there is no {self.recipe(name)}.", GlbenchError)

    def recipe(self, name: str) -> Path:
        """File of the settings of a recipe."""
        return self.source.resolve().parent / self.design.recipes[name]

    def tasks(self, cells: Iterable[Cell]) -> dict[str, TaskSpec]:
        """The tasks of cells by name, in their training split; writes their files.

        Raises ``GlbenchError`` when one is no task, or the folder holds another one of its name.
        """
        texts = {self.work / "tasks" / f"{cell.task}.toml": task_file(self.design, cell) for cell in cells}
        for file, text in texts.items():
            if file.is_file() and file.read_text(encoding="utf-8") != text:
                refuse(f"{file} was made by another design. Choose another folder with --work.", GlbenchError)
        for file, text in texts.items():
            write_atomically(file, text)
        return {file.stem: get_task(file) for file in texts}

    def settings(self, cell: Cell, recipe: str) -> CompiledSettings:
        """Settings of a training: those of the base, of the cell's length. Raises ``TrainingError`` when they are impossible."""
        steps = steps_of(self.design, cell)
        settings = read_compiled_settings(self.recipe(recipe), get_task(self.design.bases[cell.base].task), steps)
        plan = settings.evaluation.model_copy(update={"every": math.ceil(steps / self.design.evaluations)})
        return settings.model_copy(update={"evaluation": plan})


@dataclass
class Log:
    """Prints a line for each job that ends, and one a minute about a job under way; keeps ``failures``."""

    total: int
    number: int = 0
    last: float = 0.0
    failures: list[str] = field(default_factory=list)

    def ended(self, words: str, error: object = None) -> None:
        """A job ended, with an error or without."""
        self.number += 1
        self.failures += [] if error is None else [f"{words}: {error}"]
        self._say(f"{self.number}/{self.total}  {words}" + ("" if error is None else f": {error}"))

    def goes_on(self, words: str) -> None:
        """A job goes on."""
        if time.monotonic() - self.last > _TICK:
            self._say(f"      {words}")

    def _say(self, words: str) -> None:
        self.last = time.monotonic()
        say(f"{dt.datetime.now():%H:%M:%S}  {words}")


def say(words: str) -> None:
    """Print a line at once."""
    sys.stdout.write(words + "\n")
    sys.stdout.flush()


Trainings = Mapping[Path, tuple[Cell, str, int]]  # cell, recipe and seed by folder
Agents = Mapping[tuple[str, str], tuple[Cell, str, int]]  # cell, reference and runs by task and agent


def run(study: Study, cells: Sequence[Cell], workers: int, ray: str | None = None) -> int:
    """Train and evaluate what is missing in cells; the exit code. A failure stops nothing else, and is tried again the next time.

    With one worker cell by cell; with several all trainings first, then all evaluations. ``ray`` is the address of a cluster, or empty.
    """
    require("The study of factors", "jax", "jax")
    study.check()
    design, tasks = study.design, study.tasks(cells)
    trainings, agents = dict[Path, tuple[Cell, str, int]](), dict[tuple[str, str], tuple[Cell, str, int]]()
    for cell in cells:
        base = design.bases[cell.base]
        for kind, ref in base.agents.items():
            if not any(one.base == cell.base and other == ref for one, other, _ in agents.values()):
                prepare(in_split_of_evaluations(tasks[cell.task], design.split), ref, runs=1).check_start()
            agents.setdefault((cell.task, ref), (cell, ref, min(design.runs, base.agent_runs.get(kind, design.runs))))
        for recipe, seed in itertools.product(design.recipes, range(design.trainings)):
            folder = study.work / "trainings" / cell.task / agent_name(design, cell, recipe, seed)
            trainings.setdefault(folder, (cell, recipe, seed))
            agents.setdefault((cell.task, folder.name), (cell, str(folder), design.runs))
            study.settings(cell, recipe)
    write_atomically(study.work / SAVED, design.model_dump_json(indent=1) + "\n")
    log = Log(len(trainings) + len(agents))
    say(f"{len(cells)} cells with {len(tasks)} tasks in {study.work}: {len(trainings)} trainings, {len(agents)} evaluations")
    with ExitStack() as stack:
        executor = local_executor(workers)
        if ray is not None:
            executor = RayExecutor(ray or None, workers, Payload.of({task.digest: task for task in tasks.values()}.values()).unpack)
        stack.enter_context(executor)
        for group in [[cell] for cell in cells] if executor.workers == 1 else [cells]:
            _train(study, {folder: one for folder, one in trainings.items() if one[0] in group}, executor, tasks, log)
            _evaluate(study, {key: one for key, one in agents.items() if one[0] in group}, executor, tasks, log)
    for words in log.failures:
        say(f"failed: {words}")
    return 1 if log.failures else 0


def _train(study: Study, trainings: Trainings, executor: Executor, tasks: Mapping[str, TaskSpec], log: Log) -> None:
    from glbench.training.compiled import train_compiled  # needs JAX, which lists and tables do without

    def submit(folder: Path) -> Any:
        cell, recipe, seed = trainings[folder]
        return submit_training(executor, train_compiled, tasks[cell.task], study.settings(cell, recipe), folder, seed=seed, resume=True)

    for folder, future in executor.map_as_completed(submit, trainings):
        words = f"{trainings[folder][0].task}  {folder.name}"
        try:
            outcome = outcome_of(future, folder)
        except GlbenchError as error:
            log.ended(words, error)
        else:
            state = "was trained" if outcome.already_done else "trained"
            log.ended(f"{words}: {state}, {outcome.steps:,} steps, best {outcome.best_reward:.2f} in validation seasons")


def _evaluate(study: Study, agents: Agents, executor: Executor, tasks: Mapping[str, TaskSpec], log: Log) -> None:
    missing = []
    for (name, agent), (_, ref, runs) in agents.items():
        task = in_split_of_evaluations(tasks[name], study.design.split)
        try:
            start = protect(ref, "none")
            if _holds(read_result(study.design, study.work, task.id, agent), task, start.agent.digest, runs):
                log.ended(f"{name}  {agent}: was evaluated")
            else:
                missing.append(Job(task, ref, start, Options(study.work, runs)))
        except GlbenchError as error:
            log.ended(f"{name}  {agent}", error)

    def report(job: Job, progress: Progress) -> None:
        log.goes_on(f"{job.task.short_id}  {job.agent_name}: step {progress.step:,} of {progress.steps:,}")

    for outcome in divide_jobs(executor, missing, report):
        words = f"{outcome.job.task.short_id}  {outcome.job.agent_name}"
        if outcome.result is None:
            log.ended(words, outcome.reason)
        else:
            values = outcome.result.values(outcome.job.task.evaluation.metric)
            seconds = outcome.result.evaluation.wall_seconds
            log.ended(f"{words}: {np.mean(values):.2f} EUR/m2, mean of {len(values)} runs, {seconds:,.0f} s")


def _holds(result: Result | None, task: TaskSpec, agent: str, runs: int) -> bool:
    """Whether a result is of this version of glbench, this task and split and the agent with this digest, and has ``runs`` runs or more."""
    if result is None or len(result.evaluation.seeds) < runs:
        return False
    its = (result.task.digest, result.task.split, result.evaluation.seeds[0], result.agent.digest, result.versions.glbench)
    return its == (task.digest, task.split, task.evaluation.first_seed, agent, __version__)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; its exit code."""
    parser = argparse.ArgumentParser(prog="factors.py", description=(__doc__ or "").partition("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    listing, doing, tabling = (commands.add_parser(name) for name in ("cells", "run", "table"))
    for command in (listing, doing):
        command.add_argument("--design", type=Path, default=DESIGN, help="default: benchmarks/factors.toml")
    for command in (doing, tabling):
        command.add_argument("--work", type=Path, required=True, help="folder of tasks, trainings, results and tables")
    doing.add_argument("--cells", help="names and patterns, such as spring.centre,spring.draw-*; default: all")
    doing.add_argument("--split", choices=("validation", "test"), help="instead of the design's, as all numbers here")
    tabling.add_argument("--add", type=Path, nargs="+", default=[], metavar="FILE", help="factors.json of other folders")
    for name in ("trainings", "runs", "steps"):
        doing.add_argument(f"--{name}", type=int)
    doing.add_argument("--workers", type=int, default=usable_cores(), help="jobs at a time; default: all cores")
    doing.add_argument("--ray", nargs="?", const="", metavar="ADDRESS", help="on this Ray cluster, or on one that is started here")
    options = parser.parse_args(arguments)
    try:
        if options.command == "cells":
            for key, cell in cells_of(read_design(options.design)).items():
                say(f"{key:24} {', '.join(f'{name} {level}' for name, level in cell.levels.items())}")
            return 0
        if options.command == "table":
            from benchmarks.factors_table import write_tables

            say(write_tables(options.work, options.add))
            return 0
        if options.workers < 1:
            refuse(f"--workers is {options.workers}: it must be at least 1.", GlbenchError)
        changes = {key: value for key in ("split", "trainings", "runs", "steps") if (value := getattr(options, key)) is not None}
        design = read_design(options.design, changes)
        return run(Study(design, options.design, options.work), choose(cells_of(design), options.cells), options.workers, options.ray)
    except GlbenchError as error:
        sys.stderr.write(f"factors.py: {error}\n")
        return 1
    except KeyboardInterrupt:
        sys.stderr.write("Interrupted. The same command continues: what is finished is not repeated.\n")
        return 130


if __name__ == "__main__":
    sys.path.insert(0, str(DESIGN.parents[1]))  # a script sees its own folder only
    sys.exit(main())
