"""Seasons of a task that others act in: sessions, each with a greenhouse of its own. Time advances only when a step is asked for.

Not safe for several threads at once: ``app`` calls everything here from one thread, so that no session can disturb another.
"""

from __future__ import annotations

import hashlib
import itertools
import logging
import math
import re
import secrets
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glbench import __version__
from glbench.env import Simulation
from glbench.env.actuation import ROUNDING
from glbench.env.kernels import shared_kernel
from glbench.errors import GlbenchError, did_you_mean
from glbench.evaluation.metrics import StepMetrics, metrics_of
from glbench.quantities import VIOLATION
from glbench.serve import messages
from glbench.tasks import TaskSpec
from glbench.tasks.prices import local_times
from glbench.tasks.record import FIRST_TRAINING_SEED, PREVIEW
from glbench.untrusted import quoted

if TYPE_CHECKING:
    from glbench.episodes import Episode

logger = logging.getLogger(__name__)

MOST_SESSIONS = 16
IDLE_MINUTES = 60.0

NO_SCORES = (
    "To score an agent, hand it in as a file: `glbench evaluate my_agent.py` runs it in the sandbox, which shows it observations only and "
    "has no network. What acts over HTTP can see anything, so it gets no score."
)

_AHEAD = re.compile(r"(?P<quantity>.+)_(?:in_(?P<hours>\d+)h|ahead_(?P<steps>\d+))")  # Names of columns that forecast


class RequestError(GlbenchError):
    """A request that cannot be met: HTTP ``status``, what is wrong, what to do, and the field and value if there is one."""

    def __init__(self, status: int, what: str, advice: str, field: str | None = None, value: object = None) -> None:
        super().__init__(f"{what} {advice}")
        self.status = status
        shown_value = None if field is None else quoted(value)
        self.problem = messages.Problem(what=what, field=field, value=shown_value, do=advice)


class Session:
    """A season of ``task`` that somebody acts in."""

    def __init__(self, task: TaskSpec, name: str, split: str, seed: int) -> None:
        self.task, self.name, self.split, self.seed = task, name, split, seed
        self.simulation = Simulation(task, 1)
        self.last_use = 0.0
        self._columns, self._metrics = tuple(column.name for column in task.observed()), StepMetrics(task)
        self._violations = [(row, quantity.name) for row, quantity in enumerate(task.quantities) if quantity.name.startswith(VIOLATION)]
        self._totals, self._actions, self._failure = np.zeros(len(self._metrics.names)), list[NDArray[np.float64]](), ""
        self._observation = self.simulation.reset([seed])[0]
        from glbench.episodes import Trace

        self._trace = Trace(self.simulation)

    @property
    def steps(self) -> int:
        """Steps that were simulated."""
        return len(self._actions) - bool(self._failure)

    @property
    def ended(self) -> bool:
        """Whether the season is over."""
        return bool(self.simulation.over)

    def step(self, request: messages.StepRequest) -> messages.StepAnswer:
        """Take steps with one action. Raises ``RequestError``, and takes none, when the season is over, or action or count impossible."""
        if self.ended:
            what = f"The season of this session is over after {len(self._actions)} steps."
            raise RequestError(409, what, f"Start another: POST /v1/sessions/{self.name}/reset.")
        if request.steps > self.task.steps_per_day:
            what = f"{request.steps} steps at once are too many."
            advice = f"Take at most those of a day, {self.task.steps_per_day}, and repeat the request."
            raise RequestError(422, what, advice, "steps", request.steps)
        action = read_action(self.task, request)
        rewards, sums, distances, count = 0.0, np.zeros_like(self._totals), np.zeros(len(self._violations)), 0
        while count < request.steps and not self.ended:
            outcome = self.simulation.step(action[None])
            count += 1
            self._actions.append(action)
            self._trace.add(self.simulation, outcome)
            values = self._metrics(outcome.table)[:, 0]
            self._failure = outcome.failed[0].reason if outcome.failed else ""
            rewards, sums = rewards + float(outcome.rewards[0]), sums + values
            self._totals += values
            distances += outcome.table[[row for row, _ in self._violations], 0]
            self._observation = outcome.observations[0]
        names = [name.removeprefix(VIOLATION) for _, name in self._violations]
        return messages.StepAnswer(
            **self._standing(),
            steps_taken=count,
            reward=rewards,
            reward_unit=self.task.quantities[0].unit,
            account=dict(zip(self._metrics.names, sums.tolist(), strict=True)),
            violations=dict(zip(names, (distances / count).tolist(), strict=True)),
            failure=self._failure or None,
        )

    def observe(self) -> messages.FullObservation:
        """What an agent sees now."""
        units = {column.name: column.unit for column in self.task.observed()}
        return messages.FullObservation(**self._standing(), units=units)

    def _standing(self) -> dict[str, Any]:
        vector = self._observation.tolist()
        return {
            "session": self.name,
            "split": self.split,
            "seed": self.seed,
            "step": len(self._actions),
            "steps": self.task.steps,
            "terminated": self.ended,
            "time": self._moment(),
            "observation": dict(zip(self._columns, vector, strict=True)),
            "vector": vector,
        }

    def _moment(self) -> messages.Moment:
        hour = float(self.simulation.hour_of_day[0])
        (local,) = local_times(self.simulation.time, np.array([hour])).astype("datetime64[s]").tolist()
        return messages.Moment(
            date=f"{local.day} {local:%B}", clock=f"{local:%H:%M}", hour_of_day=hour, day_of_year=float(self.simulation.day_of_year[0])
        )

    def forecast(self) -> messages.Forecast:
        """The columns of the observation that look ahead, by quantity."""
        ahead: dict[str, messages.Ahead] = {}
        for column, value in zip(self.task.observed(), self._observation.tolist(), strict=True):
            match = _AHEAD.fullmatch(column.name)
            if match is None:
                continue
            hours = float(match["hours"] or int(match["steps"]) * self.task.step_seconds / 3600.0)
            meaning = column.meaning.rpartition(",")[0] or column.meaning
            entry = ahead.setdefault(match["quantity"], messages.Ahead(unit=column.unit, meaning=meaning, hours_ahead=[], values=[]))
            entry.hours_ahead.append(hours)
            entry.values.append(value)
        if ahead:
            note = "A forecast by the hour is issued at every full hour and holds until the next one. It errs as the task says."
        else:
            note = f"Agents of {self.task.id} get no forecast, so there is none here."
        return messages.Forecast(session=self.name, time=self._moment(), forecast=ahead, note=note)

    def account(self) -> messages.Account:
        """Sums of the season so far, with units and meanings."""
        listed = metrics_of(self.task)
        return messages.Account(
            session=self.name,
            step=len(self._actions),
            account=dict(zip(self._metrics.names, self._totals.tolist(), strict=True)),
            units={metric.name: metric.unit for metric in listed},
            meanings={metric.name: metric.meaning for metric in listed},
        )

    def episode(self) -> Episode:
        """The record of the season so far, as an evaluation writes it; the agent is called ``served``."""
        from glbench.agents.loading import LoadedAgent
        from glbench.episodes import RunFacts, provenance_of
        from glbench.errors import SubmissionError

        def make(_: object) -> Any:
            raise SubmissionError(NO_SCORES)

        actions = np.array(self._actions).reshape(-1, len(self.task.actions))
        agent = LoadedAgent(
            name="served",
            kind="submission",
            digest=hashlib.sha256(actions.tobytes()).hexdigest(),
            sees="observations",
            information="what it was sent over HTTP; its program is not known, and the digest is that of its actions",
            make=make,
        )
        run = RunFacts(
            seed=self.seed,
            status="simulation_failed" if self._failure else "ok",
            reason=self._failure or None,
            steps=self.steps,
            actions=len(self._actions),
        )
        provenance = provenance_of(self.task, agent, shared_kernel(self.task.model_value, self.task.step_seconds).describe())
        return self._trace.episode(self.task, 0, provenance, run, actions)

    def record(self) -> tuple[str, bytes]:
        """Name and content of the file of a season that is over; RequestError before."""
        from glbench.episodes import episode_bytes

        if not self.ended:
            what = "The season is not over, and its record holds the true climate, which an agent may not know."
            raise RequestError(409, what, "Take the remaining steps first, or start the server with --episodes FOLDER.")
        return f"{self.label}.mcap", episode_bytes(self.episode())

    @property
    def label(self) -> str:
        """Task, split and seed, for names of files."""
        return f"{self.task.short_id}-{self.split}-seed-{self.seed}"


def read_action(task: TaskSpec, request: messages.StepRequest) -> NDArray[np.float64]:
    """The action of a request, ``(m,)``. Raises ``RequestError`` unless it is one, with the right names and numbers within bounds."""
    in_units = request.action is None
    field, entries = ("values", request.values) if in_units else ("action", request.action)
    if (request.action is None) == (request.values is None):
        what = "A step needs an action." if in_units else "The request has both 'action' and 'values'."
        raise RequestError(422, what, "Give either 'action' or 'values'.", "action")
    names = [action.name for action in task.actions]
    example = f"Give all of {', '.join(names)}: an object by name, or a list in this order. GET /v1/task explains them."
    if isinstance(entries, int | float) and len(names) == 1:  # MATLAB writes a list of one number as the number
        entries = [entries]
    if isinstance(entries, Mapping):
        for name in entries:
            if name not in names:
                what = f"There is no action {quoted(name)}.{did_you_mean(name, names)}"
                raise RequestError(422, what, example, f"{field}.{name[:40]}", entries[name])
        absent = [name for name in names if name not in entries]
        if absent:
            raise RequestError(422, f"{field} lacks {', '.join(absent)}.", example, field, entries)
        entries = [entries[name] for name in names]
    if not isinstance(entries, Sequence) or isinstance(entries, str):
        raise RequestError(422, f"{field} is neither an object nor a list of numbers.", example, field, entries)
    if len(entries) != len(names):
        what = f"{field} has {len(entries)} entries; the task has {len(names)} actions."
        raise RequestError(422, what, example, field, entries)
    action = np.zeros(len(names))
    for place, (one, entry) in enumerate(zip(task.actions, entries, strict=True)):
        low, high, unit = (one.lowest, one.highest, one.unit) if in_units else (one.low, one.high, "-")
        bounds = f"{low:g} to {high:g}" + ("" if unit == "-" else f" {unit}")
        where = f"{field}.{one.name}"
        if isinstance(entry, bool) or not isinstance(entry, int | float):
            raise RequestError(422, f"{where} is not a number.", f"Give a number from {bounds}.", where, entry)
        if isinstance(entry, float) and not math.isfinite(entry):
            raise RequestError(422, f"{where} is not finite.", f"Give a number from {bounds}.", where, entry)
        if not low - ROUNDING <= entry <= high + ROUNDING:  # also of an integer that is too large for a float
            advice = f"Limit it to {bounds} before the step; nothing was simulated."
            raise RequestError(422, f"{where} is outside its range, {bounds}.", advice, where, entry)
        limited = min(max(float(entry), low), high)  # what rounding added
        action[place] = one.of(limited) if in_units else entry
    return action


class Sessions:
    """The open sessions of ``task``: at most ``most``, each closed after ``idle_minutes`` without use.

    Seasons without a seed of their own get ``first_seed``, the next one, and so on. With ``folder`` the episode of every session with a
    step is written there when the session ends. ``clock`` gives seconds. ``at_end`` is how many were open when all were closed. Raises
    ``TaskError`` when the task has only scored seasons.
    """

    def __init__(
        self,
        task: TaskSpec,
        *,
        most: int = MOST_SESSIONS,
        idle_minutes: float = IDLE_MINUTES,
        first_seed: int = FIRST_TRAINING_SEED,
        folder: Path | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if task.preview is None:
            task.check_training()
        names = () if task.splits is None else task.splits.names
        self.splits = (PREVIEW,) if task.preview is not None else tuple(name for name in names if name != "test")
        self.splits = self.splits or ("training",)
        self.task, self.most, self.idle_minutes = task, most, idle_minutes
        self._seeds, self._folder, self._clock = itertools.count(first_seed), folder, clock
        self._open: dict[str, Session] = {}
        self.at_end = self.unsaved = 0

    def start(self, request: messages.SeasonRequest, name: str | None = None) -> Session:
        """Start a season, in a new session or in ``name``. Raises ``RequestError`` for a split not served, or too many open sessions."""
        self.close_idle()
        split = self.splits[0] if request.split is None else request.split
        if split not in self.splits:
            what = f"{self.task.id} is not served in a split {quoted(split)}.{did_you_mean(split, self.splits)}"
            if split == "test":
                what = "The test split is for scores: nobody may try or tune an agent in its seasons, so they are not served."
            advice = f"Use {' or '.join(map(repr, self.splits))}. {NO_SCORES}"
            raise RequestError(403 if split == "test" else 422, what, advice, "split", split)
        if name is None and len(self._open) >= self.most:
            advice = (
                f"Close one (DELETE /v1/sessions/ID), wait until one was idle for {self.idle_minutes:g} min, or start the server with a "
                "larger --sessions."
            )
            raise RequestError(429, f"{self.most} sessions are open, which is the limit.", advice)
        previous = None if name is None else self.get(name)
        seed = next(self._seeds) if request.seed is None else request.seed
        session = Session(self._of_split(split), name or secrets.token_hex(8), split, seed)
        session.last_use = self._clock()
        if previous is not None:
            self._write(previous)
        self._open[session.name] = session
        return session

    def _of_split(self, split: str) -> TaskSpec:
        return self.task if self.task.splits is None else self.task.in_split(split)

    def get(self, name: str) -> Session:
        """The open session of that name; RequestError when there is none."""
        self.close_idle()
        if name not in self._open:
            what = f"There is no session {quoted(name)}: it was never started, was closed, or was idle for {self.idle_minutes:g} min."
            raise RequestError(404, what, "Start one: POST /v1/sessions.", "session", name)
        self._open[name].last_use = self._clock()
        return self._open[name]

    def close(self, name: str) -> messages.Account:
        """Close a session, after its episode is written."""
        session = self.get(name)
        path = self._write(session)
        del self._open[name]
        return session.account().model_copy(update={"episode": None if path is None else str(path)})

    def close_idle(self) -> None:
        """Close the sessions that were not used for too long."""
        oldest = self._clock() - 60.0 * self.idle_minutes
        for name in [name for name, session in self._open.items() if session.last_use < oldest]:
            self._try_to_close(name)

    def close_all(self) -> None:
        """Close every session; ``unsaved`` counts those whose episode could not be written."""
        self.at_end = len(self._open)
        for name in list(self._open):
            self._try_to_close(name)
        self.unsaved = len(self._open)

    def _try_to_close(self, name: str) -> None:
        """Close a session; one whose episode cannot be written stays open, and the log says why."""
        try:
            self._write(self._open[name])
        except (GlbenchError, OSError) as error:
            self._open[name].last_use = self._clock()
            logger.warning("Session %s stays open: %s", name, error)
        else:
            del self._open[name]

    def prepare(self) -> None:
        """Compile and draw what the first season needs, so that it starts at once."""
        Session(self._of_split(self.splits[0]), "", "", FIRST_TRAINING_SEED)

    def health(self) -> messages.Health:
        """What is running."""
        self.close_idle()
        return messages.Health(
            status="ok",
            glbench=__version__,
            task=self.task.id,
            digest=self.task.digest,
            splits=list(self.splits),
            sessions=len(self._open),
            most_sessions=self.most,
            idle_minutes=self.idle_minutes,
        )

    def _write(self, session: Session) -> Path | None:
        if self._folder is None or session.steps == 0:
            return None
        from glbench.episodes import write_episode

        path = next(path for n in itertools.count(1) if not (path := self._folder / f"{session.label}-{n}.mcap").exists())
        write_episode(path, session.episode())
        return path
