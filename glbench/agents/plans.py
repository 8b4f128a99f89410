"""Recorded actions: perfect-information plans, one file per task, and recordings of other agents; with the controllers that replay them.

A plan is the actions of a whole run. They are kept as whole numbers (uint16) on a scale from the lower to the upper bound of each
action, so coarse that the file is small: a run of 5,760 steps takes about 20 kB. Where actions are changes (rate actuation), what rounding
one leaves over goes into the next, so that the controls stay within a ten-thousandth of the plan's.

A recording holds the actions that another agent took in one run. What it earns, compared with that agent, tells what feedback is worth
in a task. ``glbench episodes recording`` makes one of any agent that acts through the task's actuation.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glbench.agents.controllers import controller
from glbench.agents.protocol import check_runs
from glbench.arrays import ArrayFile, Floats, checked_facts, packed
from glbench.errors import ShapeError, SubmissionError, refuse
from glbench.resources import write_atomically
from glbench.untrusted import reason_of

if TYPE_CHECKING:
    from glbench.tasks import TaskCard, TaskSpec


FORMAT = 1
HALF_SCALE = 1000  # Numbers from the middle of an action's bounds to either of them; the middle, which is 0 for a change, is exact
_LARGEST = 256 * 2**20  # Size of the unpacked arrays [bytes]: a year of minutes with six actions has 13 MB
_ADVICE = "`glbench bound` writes books of plans."


@dataclass(frozen=True, eq=False)
class PlanBook:
    """Plans for some runs of a task. Runs in which the same is given share one.

    ``split`` is the one whose runs these are, empty for a task without. ``names``, ``low`` and ``high`` are those of the actions;
    ``actuation`` is how the task turns them into controls. ``runs`` gives the place of the plan by the seed of a run. ``actions``
    ``(plans, actions, steps)``, uint16, go from 0 for the lower bound to ``2 * HALF_SCALE`` for the upper one. ``about`` says how each was
    made and what it earns.
    """

    task_id: str
    task_digest: str
    split: str
    names: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    actuation: str
    runs: Mapping[int, int]
    actions: NDArray[np.uint16]
    about: tuple[Mapping[str, str | int | float], ...]

    def __post_init__(self) -> None:
        if self.actions.ndim != 3 or self.actions.shape[:2] != (len(self.about), len(self.names)):
            refuse(f"{len(self.about)} plans of {len(self.names)} actions cannot have the shape {self.actions.shape}", ShapeError)
        _check_bounds(self.names, self.low, self.high)
        if self.actions.size and self.actions.max() > 2 * HALF_SCALE:
            refuse(f"it has a number above {2 * HALF_SCALE}", ShapeError)
        if set(self.runs.values()) != set(range(len(self.about))):
            refuse("its runs and its plans do not belong together", ShapeError)

    @classmethod
    def of(cls, task: TaskSpec, seeds: Sequence[int], actions: ArrayLike, about: Mapping[str, str | int | float]) -> PlanBook:
        """A book with one plan ``(steps, actions)`` for the runs of ``task`` with ``seeds``. Raises ``ShapeError`` for another shape."""
        low, high = (np.array([getattr(action, side) for action in task.actions]) for side in ("low", "high"))
        plan = np.asarray(actions, dtype=np.float64)
        if plan.shape != (task.steps, len(low)) or not np.isfinite(plan).all():
            refuse(f"A plan for {task.id} has finite actions of the shape ({task.steps}, {len(low)}); got {plan.shape}.", ShapeError)
        numbers = _rounded(2.0 * (plan - low) / (high - low) - 1.0, carry=task.actuation.kind == "rate")
        return cls(
            task.id,
            task.digest,
            task.split or "",
            tuple(action.name for action in task.actions),
            tuple(low.tolist()),
            tuple(high.tolist()),
            task.actuation.kind,
            dict.fromkeys(seeds, 0),
            np.ascontiguousarray(numbers.T)[None],
            (dict(about),),
        )

    @property
    def seeds(self) -> tuple[int, ...]:
        """Of all runs, in their order."""
        return tuple(sorted(self.runs))

    def plan(self, seed: int) -> Floats:
        """Actions of the run with ``seed``, ``(steps, actions)``."""
        low, high = np.array(self.low), np.array(self.high)
        shares = self.actions[self.runs[seed]].T.astype(np.float64) / HALF_SCALE
        actions: Floats = np.clip(low + 0.5 * (high - low) * shares, low, high)
        return actions

    def about_run(self, seed: int) -> Mapping[str, str | int | float]:
        """How the plan of a run was made, and what it earns."""
        return self.about[self.runs[seed]]

    def with_about(self, **more: str | int | float) -> PlanBook:
        """The same plans, about which there is more to say."""
        return replace(self, about=tuple({**about, **more} for about in self.about))

    def only(self, seeds: Sequence[int]) -> PlanBook:
        """The plans of some of the runs."""
        places = sorted({self.runs[seed] for seed in seeds})
        return replace(
            self,
            runs={seed: places.index(self.runs[seed]) for seed in seeds},
            actions=self.actions[places],
            about=tuple(self.about[place] for place in places),
        )

    def merged(self, other: PlanBook) -> PlanBook:
        """These plans, but for the runs of ``other`` its plans. Raises ``SubmissionError`` when the two are of different tasks."""
        if self.same_task != other.same_task:
            msg = f"Plans of {self.task_id} ({self.task_digest[:12]}) and of {other.task_id} ({other.task_digest[:12]}) do not go together."
            raise SubmissionError(msg)
        stay = [seed for seed in self.seeds if seed not in other.runs]
        if not stay:
            return other
        mine = self.only(stay)
        return replace(
            mine,
            runs={**mine.runs, **{seed: place + len(mine.about) for seed, place in other.runs.items()}},
            actions=np.concatenate([mine.actions, other.actions]),
            about=(*mine.about, *other.about),
        )

    @property
    def same_task(self) -> tuple[object, ...]:
        """What has to be equal for two books to be of the same task."""
        return self.task_id, self.task_digest, self.split, self.names, self.low, self.high, self.actuation

    def why_not(self, task: TaskSpec) -> str | None:
        """Why the plans are not for ``task``, in words; ``None`` when they are."""
        if task.salt_commitment is not None:
            return "its draws are secret, and plans are made for known ones"
        if (self.task_id, self.task_digest) != (task.id, task.digest):
            return f"they are for {self.task_id} with the digest {self.task_digest[:12]}, and its digest is {task.digest[:12]}"
        if self.split != (task.split or ""):
            return f"they are for the {self.split or 'only'} split, and this is the {task.split or 'only'} one"
        return None

    def to_bytes(self) -> bytes:
        """The book as the bytes of its file; equal books give equal bytes."""
        facts = {
            "task": self.task_id,
            "digest": self.task_digest,
            "split": self.split,
            "actuation": self.actuation,
            "about": [dict(about) for about in self.about],
        }
        seeds = self.seeds
        return packed(
            format=np.int64(FORMAT),
            facts=json.dumps(facts, sort_keys=True),
            names=self.names,
            low=self.low,
            high=self.high,
            seeds=np.array(seeds, dtype=np.uint64),
            places=np.array([self.runs[seed] for seed in seeds], dtype=np.int64),
            actions=self.actions.astype("<u2"),
        )

    def save(self, file: Path) -> None:
        """Write the book. Raises ``GlbenchError`` when it cannot be written."""
        write_atomically(file, self.to_bytes())


def read_book(file: Path) -> PlanBook:
    """The book of plans in ``file``. Raises ``SubmissionError`` when it cannot be read or is none."""
    try:
        arrays = ArrayFile.at(file, _LARGEST)
        arrays.check_format(FORMAT)
        facts = arrays.table("facts")
        about = facts.pop("about", None)
        seeds, places = arrays.integers("seeds", 1, np.uint64).tolist(), arrays.integers("places", 1, np.int64).tolist()
        if (
            not {"task", "digest", "split", "actuation"} <= set(checked_facts(facts))
            or not isinstance(about, list)
            or not len(set(seeds)) == len(seeds) == len(places)
        ):
            msg = "it does not state task, digest, split and actuation, or a seed occurs twice or has no plan"
            raise ShapeError(msg)  # noqa: TRY301
        return PlanBook(
            task_id=str(facts["task"]),
            task_digest=str(facts["digest"]),
            split=str(facts["split"]),
            names=arrays.texts("names"),
            low=tuple(arrays.floats("low", 1).tolist()),
            high=tuple(arrays.floats("high", 1).tolist()),
            actuation=str(facts["actuation"]),
            runs=dict(zip(seeds, places, strict=True)),
            actions=arrays.integers("actions", 3, np.uint16),
            about=tuple(checked_facts(one) for one in about),
        )
    except FileNotFoundError as error:
        refuse(f"There is no {file}. {_ADVICE}", SubmissionError, error)
    except (ValueError, OSError, ShapeError) as error:
        refuse(f"{file} is no book of plans, or a damaged one: {reason_of(error)}. {_ADVICE}", SubmissionError, error)


@dataclass(frozen=True)
class PlanFolder:
    """A folder with books of plans. A book is for the task with the digest that it states, whatever its file name."""

    folder: Path

    @property
    def files(self) -> tuple[Path, ...]:
        """All books, in the order of their names."""
        return tuple(sorted(self.folder.glob("*.npz")))

    def book(self, task: TaskSpec) -> PlanBook | None:
        """The plans whose task digest is that of ``task``; ``None`` if there are none. Errors as for ``read_book``."""
        place = self.place(task)
        usual = [place] if place.is_file() else []
        for files in (usual, [file for file in self.files if file != place]):
            books = [book for book in map(read_book, files) if book.task_digest == task.digest]
            fitting = [book for book in books if book.same_task == books[0].same_task]
            if fitting:
                return reduce(PlanBook.merged, fitting)
        return None

    def place(self, task: TaskSpec) -> Path:
        """Where the plans for ``task`` are stored: ``<Task>.npz`` for a published task, ``<Task>-<digest>.npz`` for any other."""
        return self.folder / f"{task.short_id}{'' if task.locked else f'-{task.digest[:12]}'}.npz"


@controller(
    "plans",
    read=PlanFolder,
    version="6b6f0390984d19449fd387b60c40cf7131b2f3b9ed54977e7b7b33a5565fd81c",
    sees="scenario",
    information="privileged: everything that is given in a run, its draws and the weather to come; acts through the task's actuation",
)
class PlanController:
    """Carries out the plan of each run, whatever happens in it."""

    privileged = True

    def __init__(self, plans: PlanFolder) -> None:
        self._plans = plans
        self._actions: Floats = np.zeros((0, 0, 0))
        self._step = 0

    def reset(self, task: TaskSpec, seeds: Sequence[int], /) -> None:
        """Take the plans of these runs. Raises ``SubmissionError`` when there are none for the task or for one of the seeds."""
        book = self._plans.book(task)
        reason = f"there are none for its digest {task.digest[:12]}" if book is None else book.why_not(task)
        split = f" --split {task.split}" if task.split not in (None, "test") else ""
        search = f"glbench bound {task.short_id if task.locked else task.source}{split}"
        if book is None or reason is not None:
            refuse(f"There are no plans for {task.id}: {reason}. `{search}` searches for some.", SubmissionError)
        missing = [seed for seed in seeds if seed not in book.runs]
        if missing:
            msg = (
                f"There is no plan for the run of {task.id} with the seed {missing[0]}"
                f"{f', nor for {len(missing) - 1} others' if len(missing) > 1 else ''}. "
                f"`{search} --scenario {missing[0]}` searches for one."
            )
            raise SubmissionError(msg)
        self._actions = np.stack([book.plan(seed) for seed in seeds], axis=1)
        self._step = 0

    def act(self, x: Floats, /) -> Floats:
        """The next action of every plan ``(n, actions)``; the states are not looked at."""
        action: Floats = self._actions[self._step].copy()
        self._step += 1
        return action


def _rounded(shares: Floats, *, carry: bool) -> NDArray[np.uint16]:
    """Shares from -1 to 1, ``(steps, actions)``, as numbers; ``carry``: what is left over goes into the next step's."""
    numbers = np.empty(shares.shape, dtype=np.uint16)
    rest = np.zeros(shares.shape[1])
    for step, share in enumerate(shares):
        exact = HALF_SCALE * share + rest
        whole = np.clip(np.rint(exact), -HALF_SCALE, HALF_SCALE)
        numbers[step] = whole + HALF_SCALE
        if carry:
            rest = exact - whole
    return numbers


@dataclass(frozen=True, eq=False)
class Recording:
    """Actions of one run, in the order in which they were taken.

    ``actions`` ``(steps, actions)``, float32, are all finite, of at least one step. ``names``, ``low`` and ``high`` are the controls that
    the columns drive, and their bounds; ``actuation`` is how the task turned them into controls. ``about`` says whose actions they are, for
    people: agent and its digest, task and its digest, seed.
    """

    actions: NDArray[np.float32]
    names: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    actuation: str
    about: dict[str, str | int]

    def __post_init__(self) -> None:
        if self.actions.ndim != 2 or not len(self.actions) or self.actions.shape[1] != len(self.names):
            refuse(f"a recording of {len(self.names)} actions cannot have the shape {self.actions.shape}", ShapeError)
        _check_bounds(self.names, self.low, self.high)
        if not np.isfinite(self.actions).all():
            refuse("it has actions that are not finite", ShapeError)

    def why_not(self, task: TaskCard) -> str | None:
        """Why it cannot be replayed in ``task``, in words; ``None`` when it can."""
        mine, theirs = _words(self.names, self.actuation), _words(task.action_names, task.actuation)
        if mine != theirs:
            return f"it holds {mine}, and {task.id} takes {theirs}"
        bounds = tuple((action.low, action.high) for action in task.actions)
        return f"its actions have other bounds than those of {task.id}" if bounds != tuple(zip(self.low, self.high, strict=True)) else None

    def to_bytes(self) -> bytes:
        """The recording as the bytes of its file; equal recordings give equal bytes."""
        return packed(
            format=np.int64(FORMAT),
            actions=self.actions,
            names=self.names,
            low=self.low,
            high=self.high,
            actuation=self.actuation,
            about=json.dumps(self.about, sort_keys=True),
        )


def read_recording(file: Path) -> Recording:
    """The recording in ``file``. Raises ``SubmissionError`` when it cannot be read or is not a recording."""
    advice = "`glbench episodes recording` writes one."
    try:
        arrays = ArrayFile.at(file, _LARGEST)
        arrays.check_format(FORMAT)
        return Recording(
            actions=arrays.floats("actions", 2, np.float32),
            names=arrays.texts("names"),
            low=tuple(arrays.floats("low", 1).tolist()),
            high=tuple(arrays.floats("high", 1).tolist()),
            actuation=arrays.text("actuation"),
            about=checked_facts(arrays.table("about")),  # type: ignore[arg-type]
        )
    except (ValueError, OSError, ShapeError) as error:
        refuse(f"{file} is not a recording of actions, or is damaged: {reason_of(error)}. {advice}", SubmissionError, error)


@controller(
    "recording",
    read=read_recording,
    version="48d93ad361af231dfd67a11e7d5f40524077a85aeb162f7c54ef9de0f0b72588",
    information="nothing: replays recorded actions",
)
class RecordingAgent:
    """Takes the recorded actions in their order in every run; past their end it holds the last one."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._runs = 0
        self._step = 0

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """Begin again with the first action. Raises ``SubmissionError`` when ``task`` takes other actions than the recorded ones."""
        reason = self._recording.why_not(task)
        if reason is not None:
            refuse(f"The recording does not fit this task: {reason}. Record an agent on a task with the same actions.", SubmissionError)
        self._runs, self._step = n_runs, 0

    def act(self, observations: NDArray[np.float32], /) -> Floats:
        """The next action for every run, ``(n_runs, actions)``; of ``observations`` only the number of rows is looked at.

        Raises ``ShapeError`` when there are not as many rows as runs were announced to ``reset``.
        """
        check_runs(observations, self._runs)
        actions = self._recording.actions
        action = actions[min(self._step, len(actions) - 1)].astype(np.float64)
        self._step += 1
        return np.tile(action, (self._runs, 1))


def _check_bounds(names: Sequence[str], low: Sequence[float], high: Sequence[float]) -> None:
    sides = list(zip(low, high, strict=False))
    if not len(low) == len(high) == len(names) or not all(lower < upper for lower, upper in sides):
        refuse("an action lacks a lower or an upper bound, or its lower bound is not below its upper bound", ShapeError)


def _words(names: tuple[str, ...], actuation: str) -> str:
    return f"{actuation} actions of {', '.join(names)}"
