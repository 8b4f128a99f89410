"""The viewer beside a running evaluation: one run, streamed while it is simulated."""

from __future__ import annotations

import logging
import time
import uuid
from typing import TYPE_CHECKING

import numpy as np

from glbench.env import Simulation, StepResult, run_weather
from glbench.episodes.rerun_course import Shown, Trajectory
from glbench.episodes.rerun_recording import (
    APPLICATION,
    send_card,
    send_frame,
    send_layout,
    send_limits,
    send_trajectories,
)
from glbench.episodes.rerun_viewer import load_rerun
from glbench.episodes.signals import Floats, Source, signals_of
from glbench.tasks import TaskSpec

if TYPE_CHECKING:
    from types import TracebackType
    from typing import Self

logger = logging.getLogger(__name__)

_SEND_SECONDS = 0.2
_FLUSH_SECONDS = 5.0


class LiveView:
    """Streams one run of an evaluation to a viewer, several times a second.

    Closing the viewer does not disturb the evaluation. After an interruption it shows the steps from there on, and its sums count from
    there.

    Parameters
    ----------
    task, controller, seed
        What is run.
    row
        The run that is shown, among those of the simulation.
    address
        Where the viewer takes streams (see ``rerun_viewer``).
    """

    def __init__(self, task: TaskSpec, controller: str, seed: int, address: str, row: int = 0) -> None:
        rerun = load_rerun()
        self._task, self._controller, self._seed, self._row = task, controller, seed, row
        weather = run_weather(task, seed)
        self._times = weather.times[: task.steps + 1].astype("datetime64[ns]")
        self._signals = signals = signals_of(task)
        self._tables: dict[Source, Floats] = {
            source: np.zeros((task.steps, len(signals.vector(source))))
            for source in ("state", "derived", "control", "air", "quantity")
        }
        self._weather = weather.values[: task.steps]
        self._clock = weather.hour_of_day[: task.steps + 1, None]
        known = {**self._tables, "disturbance": self._weather, "clock": self._clock[1:]}
        self._columns = {
            one.name: known[one.source][:, one.index]
            for one in signals.recorded
            if one.name in (*signals.needed, signals.clock)
        }
        self._begun = False
        self._done = self._sent = 0
        self._sent_at = time.monotonic()
        # A name of its own: evaluations of one process would else be mixed into one recording.
        self._stream = rerun.RecordingStream(APPLICATION, recording_id=uuid.uuid4())
        self._stream.connect_grpc(address)
        shown = self._shown(0)
        send_frame(self._stream, shown)
        send_layout(self._stream, shown, live=True)

    def add(self, simulation: Simulation, outcome: StepResult) -> None:
        """Keep the step that was just simulated, and send the new steps several times a second."""
        step = int(simulation.k[self._row]) - 1
        if step < self._done or step < 0:
            return  # this run has ended, others go on
        if not self._begun:
            self._begun, self._sent = True, step
            send_limits(self._stream, self._shown(0), [step])
        row, tables = self._row, self._tables
        tables["state"][step], tables["control"][step] = simulation.x[row], simulation.u[row]
        tables["air"][step], tables["quantity"][step] = simulation.air[:, row], outcome.table[:, row]
        self._done = step + 1
        if time.monotonic() - self._sent_at >= _SEND_SECONDS or self._done == self._task.steps:
            self._send()

    def close(self) -> None:
        """Send the rest and disconnect."""
        if self._done > self._sent:
            self._send()
        send_card(self._stream, self._shown(self._done))
        try:
            self._stream.flush(timeout_sec=_FLUSH_SECONDS)
        except RuntimeError as error:
            logger.warning("The viewer was closed before the end (%s). The evaluation does not depend on it.", error)
        self._stream.disconnect()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, place: TracebackType | None
    ) -> None:
        self.close()

    def _send(self) -> None:
        done, tables = self._done, self._tables
        vectors: dict[Source, Floats] = {source: tables[source][:done] for source in ("state", "air", "control")}
        vectors |= {"disturbance": self._weather[:done], "clock": self._clock[: done + 1]}
        tables["derived"][:done] = self._signals.derived(vectors)
        shown = self._shown(done)
        send_trajectories(self._stream, shown, self._sent)
        # Sent as far as the curves reach, and no further: the viewer follows the latest time that it knows of.
        send_limits(self._stream, shown, [self._done])
        self._sent, self._sent_at = self._done, time.monotonic()

    def _shown(self, steps: int) -> Shown:
        """The run so far."""
        columns = {name: column[:steps] for name, column in self._columns.items()}
        trajectory = Trajectory(self._controller, self._seed, self._times[: steps + 1], columns)
        return Shown(self._task, (trajectory,), (self._controller,), self._signals)
