"""What is measured: each subject is some stepping that can be repeated, and the reference it is set against."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from glbench.errors import UnknownNameError, did_you_mean
from glbench.kernel import Kernel, make_kernel
from glbench.model import TOMATO, default_parameters
from glbench.speed.clock import Timed, processor_time, timed, wall_time
from glbench.speed.workloads import Controls, Course, course, points

STEP_SECONDS = 900.0
PAPER_SECONDS = 300.0
PAPER_START = dt.date(2009, 10, 1)
PAPER_DAYS = 10.0
TASK = "glbench/Schiphol2010-Delta10-v1"

GROUPS = {
    "step": "the model alone, one greenhouse",
    "batch": "the model alone, 512 greenhouses at once",
    "rows": "cost of a step against the size of the batch",
    "threads": "4,096 greenhouses on one and two threads (time on the wall)",
    "horizon": "cost of a step against the length of the season",
    "paper": "the setting of the paper: steps of 300 s, 10 days from 1 October 2009",
    "paper-batch": "the same steps, 512 greenhouses at once",
    "env": "the Gymnasium environment: 22 observations, reward, info, parameters redrawn at every step",
    "vector": "the vector environment",
}


@dataclass(frozen=True)
class Subject:
    """Something to measure.

    Attributes
    ----------
    name : str
        Group, then what tells it from the others of the group.
    title : str
        In words.
    step_seconds : float
        Length of its steps [s]; the reference has the same.
    controls : str
        How controls move, for it and for the reference.
    make : callable
        Prepares it.
    follows_course : bool
        Whether the reference, too, steps the course of the paper's setting instead of scattered points.
    quick : bool
        Whether ``--quick`` measures it.
    """

    name: str
    title: str
    step_seconds: float
    controls: Controls
    make: Callable[[], Timed]
    follows_course: bool = False
    quick: bool = False

    @property
    def group(self) -> str:
        """Key of ``GROUPS``."""
        return self.name.split("/", 1)[0]


def paper_course() -> Course:
    """Ten days from 1 October 2009 in steps of 300 s: the setting of the paper's comparison, with Schiphol's weather."""
    return course("walk", PAPER_SECONDS, PAPER_START, PAPER_DAYS)


def _alone(preset: str, controls: Controls, seconds: float) -> Callable[[], Timed]:
    def make() -> Timed:
        kernel = Kernel(TOMATO, seconds, preset=preset)
        chosen, p = points(controls, seconds), default_parameters()
        steps = [kernel.bind(chosen.x[i], chosen.u[i], chosen.d[i], p, np.empty(28)) for i in range(256)]

        def work() -> int:
            for step in steps:
                step()
            return len(steps)

        return timed(work)

    return make


def _many(preset: str, controls: Controls, seconds: float, rows: int, threads: int = 1) -> Callable[[], Timed]:
    def make() -> Timed:
        kernel = make_kernel(TOMATO, seconds, preset=preset, workers=threads)
        chosen, p = points(controls, seconds), default_parameters()
        # Every size steps the same points, those of one call at a time, or more of them than there are.
        parts = chosen.parts(rows) if rows < len(chosen.x) else (chosen.resized(rows),)

        def work() -> int:
            for part in parts:
                kernel.step(part.x, part.u, part.d, p)
            return rows * len(parts)

        return timed(work, processor_time if threads == 1 else wall_time)

    return make


def _on_the_wall(make: Callable[[], Timed]) -> Callable[[], Timed]:
    def on_the_wall() -> Timed:
        made = make()
        return Timed(made.work, wall_time, made.repeats)

    return on_the_wall


def _along(followed: Callable[[], Course], seconds: float, preset: str) -> Callable[[], Timed]:
    def make() -> Timed:
        kernel, one, p = Kernel(TOMATO, seconds, preset=preset), followed(), default_parameters()

        x, u, d = np.empty(one.start.shape), one.controls[0].copy(), one.weather[0].copy()
        step = kernel.bind(x, u, d, p, x)

        def work() -> int:
            x[...] = one.start
            for u[...], d[...] in zip(one.controls, one.weather, strict=True):
                step()
            return len(one.controls)

        return timed(work)

    return make


def _season(days: float) -> Callable[[], Timed]:
    return _along(lambda: course("walk", STEP_SECONDS, dt.date(2010, 3, 1), days), STEP_SECONDS, "standard")


def _environment(preset: str) -> Callable[[], Timed]:
    def make() -> Timed:
        from glbench.env import GreenhouseEnv

        env = GreenhouseEnv(TASK, kernel=Kernel(TOMATO, STEP_SECONDS, preset=preset))
        generator = np.random.default_rng(0)
        actions = generator.uniform(-1.0, 1.0, (960, *(env.action_space.shape or ()))).astype(np.float32)
        seeds = iter(range(10**6))
        env.reset(seed=next(seeds))

        def work() -> int:
            for action in actions:
                _, _, terminated, truncated, _ = env.step(action)
                if terminated or truncated:
                    env.reset(seed=next(seeds))
            return len(actions)

        return timed(work)

    return make


def _vector(count: int, preset: str, threads: int = 1) -> Callable[[], Timed]:
    def make() -> Timed:
        from glbench.env import GreenhouseVectorEnv

        kernel = make_kernel(TOMATO, STEP_SECONDS, preset=preset, workers=threads)
        envs = GreenhouseVectorEnv(TASK, count, kernel=kernel)
        generator = np.random.default_rng(0)
        steps = max(16, min(192, 8192 // count))
        actions = generator.uniform(-1.0, 1.0, (steps, *envs.action_space.shape)).astype(np.float32)  # type: ignore[misc]
        envs.reset(seed=0)

        def work() -> int:
            for action in actions:
                envs.step(action)
            return steps * count

        return timed(work, processor_time if threads == 1 else wall_time)

    return make


def _subjects() -> tuple[Subject, ...]:
    walk: Controls = "walk"
    kinds: tuple[Controls, ...] = ("walk", "jump")
    found = []
    for controls in kinds:
        for preset in ("standard", "reference", "fast"):
            end, words = f"{preset}/{controls}", f"{preset}, controls {controls}"
            quick = preset == "standard"
            alone = _alone(preset, controls, STEP_SECONDS)
            batch = _many(preset, controls, STEP_SECONDS, 512)
            found.append(Subject(f"step/{end}", words, STEP_SECONDS, controls, alone, quick=quick))
            found.append(Subject(f"batch/{end}", words, STEP_SECONDS, controls, batch, quick=quick))
    for rows in (1, 8, 64, 512, 4096):
        many = _many("standard", walk, STEP_SECONDS, rows)
        found.append(Subject(f"rows/{rows}", f"{rows:,} greenhouses", STEP_SECONDS, walk, many))
    for threads in (1, 2):
        shared = _on_the_wall(_many("standard", walk, STEP_SECONDS, 4096, threads))
        found.append(Subject(f"threads/{threads}", f"threads: {threads}", STEP_SECONDS, walk, shared))
    found += [Subject(f"horizon/{days}", f"days: {days}", STEP_SECONDS, walk, _season(days)) for days in (1, 10, 60)]
    for preset in ("standard", "reference"):
        along = _along(paper_course, PAPER_SECONDS, preset)
        found.append(
            Subject(
                f"paper/{preset}",
                f"{preset}",
                PAPER_SECONDS,
                walk,
                along,
                follows_course=True,
                quick=preset == "standard",
            )
        )
        batch = _many(preset, walk, PAPER_SECONDS, 512)
        found.append(Subject(f"paper-batch/{preset}", preset, PAPER_SECONDS, walk, batch))
    for preset in ("standard", "reference"):
        one = _environment(preset)
        found.append(Subject(f"env/{preset}", preset, STEP_SECONDS, walk, one, quick=preset == "standard"))
    for count in (8, 64, 512, 4096):
        words = f"{count:,} environments, standard"
        found.append(
            Subject(f"vector/{count}", words, STEP_SECONDS, walk, _vector(count, "standard"), quick=count == 512)
        )
    return tuple(sorted(found, key=lambda one: list(GROUPS).index(one.group)))


SUBJECTS: tuple[Subject, ...] = _subjects()


def choose_subjects(names: Sequence[str] = (), *, quick: bool = False) -> tuple[Subject, ...]:
    """Subjects by name or by group; all of them, or the quick ones, without names.

    Raises
    ------
    UnknownNameError
        When there is no such subject or group.
    """
    if not names:
        return tuple(one for one in SUBJECTS if one.quick or not quick)
    known = {one.name for one in SUBJECTS} | set(GROUPS)
    for name in names:
        if name not in known:
            msg = (
                f"There is nothing to measure called '{name}'.{did_you_mean(name, known)} Groups: {', '.join(GROUPS)}."
            )
            raise UnknownNameError(msg)
    return tuple(one for one in SUBJECTS if one.name in names or one.group in names)
