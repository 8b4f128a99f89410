"""What is measured: each subject is some stepping that can be repeated. All step states, controls and weather of real seasons."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Literal

import numpy as np

from glbench.arrays import Floats
from glbench.errors import UnknownNameError, did_you_mean
from glbench.kernel import Kernel, make_kernel
from glbench.model import TOMATO, default_parameters, initial_state
from glbench.tasks import DEFAULT_TASK
from glbench.weather import disturbances, load_weather

Controls = Literal["walk", "jump"]
Horizon = Literal["rollout", "adjoint", "linearise", "push", "pull"]
Work = Callable[[], int]  # Does something and says how many steps it took

STEP_SECONDS = 900.0
PAPER_SECONDS = 300.0
PAPER_START = dt.date(2009, 10, 1)
PAPER_DAYS = 10.0
TASK = "glbench/Schiphol2010-Delta10-v1"
LARGEST_CHANGE = 0.1  # Of a control in one step, when controls walk
_SEASON_DAYS = 2

GROUPS = {
    "step": "the model alone, one greenhouse",
    "batch": "the model alone, 512 greenhouses at once",
    "rows": "cost of a step against the size of the batch",
    "threads": "4,096 greenhouses on one and two threads (time on the wall)",
    "horizon": "cost of a step against the length of the season",
    "trajectory": "a whole horizon in one call, fast (CVODES: plain steps)",
    "paper": "the setting of the paper: steps of 300 s, 10 days from 1 October 2009",
    "paper-batch": "the same steps, 512 greenhouses at once",
    "env": "the Gymnasium environment: 22 observations, reward, info, parameters redrawn at every step",
    "vector": "the vector environment",
}


@dataclass(frozen=True)
class Season:
    """Consecutive steps of one greenhouse: controls (steps, controls), weather (steps, disturbances), state at the start (states,)."""

    controls: Floats
    weather: Floats
    start: Floats


@dataclass(frozen=True)
class Points:
    """Steps that have nothing to do with one another: states (n, states), controls (n, controls), weather (n, disturbances)."""

    x: Floats
    u: Floats
    d: Floats

    def parts(self, rows: int) -> tuple[Points, ...]:
        """The same points, ``rows`` at a time; what is left over is left out. More than there are: all of them, repeated."""
        if rows >= len(self.x):
            return (Points(*(np.ascontiguousarray(np.resize(a, (rows, a.shape[1]))) for a in (self.x, self.u, self.d))),)
        starts = range(0, len(self.x) - rows + 1, rows)
        return tuple(Points(self.x[i : i + rows], self.u[i : i + rows], self.d[i : i + rows]) for i in starts)


def controls_of(kind: Controls, steps: int, seed: int) -> Floats:
    """Controls (steps, controls) that walk by at most ``LARGEST_CHANGE`` a step within 0..1, or jump: 0 or 1, redrawn at every step."""
    generator, count = np.random.default_rng([seed, ("walk", "jump").index(kind)]), len(TOMATO.control_names)
    if kind == "jump":
        return generator.integers(0, 2, (steps, count)).astype(np.float64)
    changes = generator.uniform(-LARGEST_CHANGE, LARGEST_CHANGE, (steps, count))
    controls, now = np.empty_like(changes), generator.uniform(0.0, 1.0, count)
    for step, change in enumerate(changes):
        controls[step] = now = np.minimum(np.maximum(now + change, 0.0), 1.0)
    return controls


@cache
def season(kind: Controls, step_seconds: float, start: dt.date, days: float, seed: int = 0) -> Season:
    """A greenhouse at Schiphol from ``start``, with a grown crop, under controls of that kind."""
    steps = round(days * 86400.0 / step_seconds)
    weather = disturbances(load_weather("schiphol"), start=start, steps=steps, step_seconds=step_seconds).values
    return Season(controls_of(kind, steps, seed), weather, initial_state(weather[0], 16.5, default_parameters()))


paper_season = partial(season, "walk", PAPER_SECONDS, PAPER_START, PAPER_DAYS)
"""Ten days from 1 October 2009 in steps of 300 s: the setting of the paper's comparison, with Schiphol's weather."""


@cache
def points(kind: Controls, step_seconds: float, count: int = 512, seed: int = 0) -> Points:
    """``count`` steps out of all months of a year, with the states that controls of that kind lead to."""
    kernel = Kernel(TOMATO, step_seconds, preset="standard")
    parameters = default_parameters()
    steps: list[tuple[Floats, Floats, Floats]] = []
    for month in range(1, 13):
        one = season(kind, step_seconds, dt.date(2010, month, 1), _SEASON_DAYS, seed + month)
        x = one.start
        for u, d in zip(one.controls, one.weather, strict=True):
            steps.append((x, u, d))
            x = kernel.step(x, u, d, parameters)
    pick = np.random.default_rng(seed).choice(len(steps), count, replace=len(steps) < count)
    return Points(*(np.stack([steps[i][k] for i in pick]) for k in range(3)))


@dataclass(frozen=True)
class Subject:
    """Something to measure, which ``make`` prepares: ``name`` is the group, then what tells it from the others of the group.

    The reference has the same ``step_seconds``; ``controls`` is how controls move, for both. ``follows_season``: the reference, too, steps
    the season of the paper's setting instead of scattered points. ``quick``: ``--quick`` measures it. ``on_the_wall``: time on the wall
    counts, as for what several threads share, and not processor time.
    """

    name: str
    title: str
    make: Callable[[], Work]
    step_seconds: float = STEP_SECONDS
    controls: Controls = "walk"
    follows_season: bool = False
    quick: bool = False
    on_the_wall: bool = False

    @property
    def group(self) -> str:
        """Key of ``GROUPS``."""
        return self.name.split("/", 1)[0]


def _alone(preset: str, controls: Controls) -> Work:
    """One greenhouse, one call a step."""
    kernel, start, p = Kernel(TOMATO, STEP_SECONDS, preset=preset), points(controls, STEP_SECONDS), default_parameters()
    steps = [kernel.bind(start.x[i], start.u[i], start.d[i], p, np.empty_like(start.x[i])) for i in range(256)]

    def work() -> int:
        for step in steps:
            step()
        return len(steps)

    return work


def _many(preset: str, controls: Controls, rows: int, seconds: float = STEP_SECONDS, threads: int = 1) -> Work:
    """Many greenhouses a call; every size steps the same points."""
    kernel = make_kernel(TOMATO, seconds, preset=preset, workers=threads)
    parts, p = points(controls, seconds).parts(rows), default_parameters()

    def work() -> int:
        for part in parts:
            kernel.step(part.x, part.u, part.d, p)
        return rows * len(parts)

    return work


def _along(preset: str, seconds: float, start: dt.date, days: float) -> Work:
    """One greenhouse through a season."""
    kernel, one, p = Kernel(TOMATO, seconds, preset=preset), season("walk", seconds, start, days), default_parameters()
    x, u, d = np.empty(one.start.shape), one.controls[0].copy(), one.weather[0].copy()
    step = kernel.bind(x, u, d, p, x)

    def work() -> int:
        x[...] = one.start
        for u[...], d[...] in zip(one.controls, one.weather, strict=True):
            step()
        return len(one.controls)

    return work


def _trajectory(call: Horizon, days: int) -> Work:
    """A horizon of one greenhouse a call; sweeps over Jacobians that are there."""
    kernel = Kernel(TOMATO, STEP_SECONDS, preset="fast")
    one = season("walk", STEP_SECONDS, dt.date(2010, 3, 1), days)
    inputs = one.start, one.controls, one.weather, default_parameters()
    weights = np.ones((len(one.controls) + 1, len(one.start)))
    calls: dict[str, Callable[[], object]] = {
        "rollout": lambda: kernel.rollout(*inputs),
        "adjoint": lambda: kernel.rollout_adjoint(*inputs, weights),
        "linearise": lambda: kernel.linearise_trajectory(*inputs),
    }
    if call in ("push", "pull"):
        path = kernel.linearise_trajectory(*inputs)
        calls |= {"push": lambda: path.push(one.controls), "pull": lambda: path.pull(weights)}

    def work() -> int:
        calls[call]()
        return len(one.controls)

    return work


def _environment(preset: str) -> Work:
    from glbench.env import GreenhouseEnv

    env = GreenhouseEnv(TASK, kernel=Kernel(TOMATO, STEP_SECONDS, preset=preset))
    generator, seeds = np.random.default_rng(0), iter(range(10**6))
    actions = generator.uniform(-1.0, 1.0, (960, *(env.action_space.shape or ()))).astype(np.float32)
    env.reset(seed=next(seeds))

    def work() -> int:
        for action in actions:
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset(seed=next(seeds))
        return len(actions)

    return work


def _vector(count: int, task: str = TASK) -> Work:
    from glbench.env import GreenhouseVectorEnv

    envs = GreenhouseVectorEnv(task, count, kernel="standard")
    steps = max(16, min(192, 8192 // count))
    shape = (steps, *(envs.action_space.shape or ()))
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, shape).astype(np.float32)
    envs.reset(seed=0)

    def work() -> int:
        for action in actions:
            envs.step(action)
        return steps * count

    return work


def _subjects() -> Iterator[Subject]:
    kinds: tuple[Controls, ...] = ("walk", "jump")
    pairs = [(kind, preset) for kind in kinds for preset in ("standard", "reference", "fast")]
    for kind, preset in pairs:
        end, words, quick = f"{preset}/{kind}", f"{preset}, controls {kind}", preset == "standard"
        yield Subject(f"step/{end}", words, partial(_alone, preset, kind), controls=kind, quick=quick)
        yield Subject(f"batch/{end}", words, partial(_many, preset, kind, 512), controls=kind, quick=quick)
    for rows in (1, 8, 64, 512, 4096):
        yield Subject(f"rows/{rows}", f"{rows:,} greenhouses", partial(_many, "standard", "walk", rows))
    for threads in (1, 2):
        shared = partial(_many, "standard", "walk", 4096, threads=threads)
        yield Subject(f"threads/{threads}", f"threads: {threads}", shared, on_the_wall=True)
    for days in (1, 10, 60):
        season = partial(_along, "standard", STEP_SECONDS, dt.date(2010, 3, 1), days)
        yield Subject(f"horizon/{days}", f"days: {days}", season)
    horizons: tuple[tuple[Horizon, int, str], ...] = (
        ("rollout", 1, "rollout, 96 steps"),
        ("linearise", 1, "Jacobians (x and u), 96 steps"),
        ("linearise", 60, "Jacobians (x and u), 5,760 steps"),
        ("adjoint", 60, "gradient of a rollout, 5,760 steps"),
        ("push", 60, "push over Jacobians, 5,760 steps"),
        ("pull", 60, "pull over Jacobians, 5,760 steps"),
    )
    for call, days, words in horizons:
        yield Subject(f"trajectory/{call}-{days}", words, partial(_trajectory, call, days))
    for preset in ("standard", "reference"):
        quick = preset == "standard"
        along = partial(_along, preset, PAPER_SECONDS, PAPER_START, PAPER_DAYS)
        yield Subject(f"paper/{preset}", preset, along, PAPER_SECONDS, follows_season=True, quick=quick)
        together = partial(_many, preset, "walk", 512, PAPER_SECONDS)
        yield Subject(f"paper-batch/{preset}", preset, together, PAPER_SECONDS)
        yield Subject(f"env/{preset}", preset, partial(_environment, preset), quick=quick)
    for count in (8, 64, 512, 4096):
        words = f"{count:,} environments, standard"
        yield Subject(f"vector/{count}", words, partial(_vector, count), quick=count == 512)
    words = "512 environments of the default task, standard"
    yield Subject("vector/512-default", words, partial(_vector, 512, DEFAULT_TASK), quick=True)


SUBJECTS: tuple[Subject, ...] = tuple(sorted(_subjects(), key=lambda one: list(GROUPS).index(one.group)))


def choose_subjects(names: Sequence[str] = (), *, quick: bool = False) -> tuple[Subject, ...]:
    """Subjects by name or by group; without names all, or the quick ones. Raises ``UnknownNameError`` when there is no such one."""
    if not names:
        return tuple(one for one in SUBJECTS if one.quick or not quick)
    choices = {one.name for one in SUBJECTS} | set(GROUPS)
    for name in names:
        if name not in choices:
            msg = f"There is nothing to measure called '{name}'.{did_you_mean(name, choices)} Groups: {', '.join(GROUPS)}."
            raise UnknownNameError(msg)
    return tuple(one for one in SUBJECTS if one.name in names or one.group in names)
