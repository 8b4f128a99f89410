"""The viewer's program: a window, a page for the browser, a picture without a screen, and one run of an evaluation while it is simulated.

It listens on this machine only.
"""

from __future__ import annotations

import importlib
import logging
import os
import re
import socket
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from urllib.parse import quote

import numpy as np

from glbench.arrays import Floats
from glbench.children import Child
from glbench.env import Simulation, StepResult, run_weather
from glbench.episodes import rerun_recording
from glbench.episodes.signals import Source, signals_of
from glbench.errors import GlbenchError, refuse
from glbench.resources import write_atomically
from glbench.tasks import TaskSpec

logger = logging.getLogger(__name__)

_SEND_SECONDS = 0.2
_FLUSH_SECONDS = 5.0

LOOPBACK = "127.0.0.1"  # Without being told, the viewer's server listens on all interfaces: anybody in the network could send to it
PICTURE_SIZE = (1920, 1080)
_START_SECONDS = 20.0
_LOAD_SECONDS = 30.0
_SETTLE_SECONDS = 0.4
_SAME_PICTURES = 2
_TERMINAL_CODES = re.compile(r"\x1b\[[0-9;]*m")
_CANNOT_DRAW = ("render context", "graphics adapter", "NoSuitableAdapter")
_RENDERER = "Pictures and windows need Vulkan or OpenGL; without a graphics card: `apt-get install mesa-vulkan-drivers` (Debian, Ubuntu)."


def viewer_program() -> Path:
    """The viewer's program, which comes with rerun-sdk. Raises ``GlbenchError`` without the package, or when its program is missing."""
    rerun_recording.load_rerun()
    folder = Path(str(importlib.import_module("rerun_cli").__file__)).parent
    names = ("Rerun.app/Contents/MacOS/Rerun", "rerun", "rerun.exe")
    for name in names:
        if (folder / name).is_file():
            return folder / name
    msg = f"rerun-sdk is installed, but its viewer is not in {folder}. Install it again: `pip install --force-reinstall rerun-sdk`."
    raise GlbenchError(msg)


def free_port() -> int:
    """A port of this machine that nobody listens on."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        port: int = probe.getsockname()[1]
        return port


def _unused(port: int) -> int:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, port))
        except OSError as error:
            refuse(f"The port {port} is taken. Choose another with --port, or leave it out.", GlbenchError, error)
    return port


def has_screen() -> bool:
    """Whether a window can be opened: on Linux, whether a display is announced."""
    if not sys.platform.startswith("linux"):
        return True
    return any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"))


def open_window(recording: Path) -> None:
    """Open the viewer and wait until it is closed. Raises ``GlbenchError`` without the package or a screen, or when the viewer fails."""
    program = viewer_program()
    require_screen()
    with Viewer(program, [str(recording), *_listening(free_port())]) as viewer:
        viewer.wait()


def window_for_stream() -> str:
    """Open a viewer that waits for a stream; the address to connect to. It stays open until a person closes it.

    Raises ``GlbenchError`` without the package, without a screen, or when the viewer does not start.
    """
    program = viewer_program()
    require_screen()
    port = free_port()
    with Viewer(program, [*_listening(port), "--hide-welcome-screen", "--expect-data-soon", "--detach-process"]) as viewer:
        viewer.await_port(port, may_end=True)
    return stream_address(port)


@contextmanager
def page_for_browser(recording: Path | None, port: int | None = None) -> Iterator[tuple[str, str]]:
    """Serve the viewer as a page of this machine; its address, and the address that streams are sent to.

    ``recording`` is shown; without one, what is streamed. The page is at ``port`` and its data at the next one; by default both are any
    free ones. Raises ``GlbenchError`` without the package, when a port is taken, or when the server does not start.
    """
    program = viewer_program()
    page, data = (free_port(), free_port()) if port is None else (_unused(port), _unused(port + 1))
    files = [] if recording is None else [str(recording)]
    with Viewer(program, [*files, "--serve-web", *_listening(data), "--web-viewer-port", str(page)]) as server:
        server.await_port(page)
        server.await_port(data)
        stream = stream_address(data)
        yield f"http://{LOOPBACK}:{page}?url={quote(stream, safe='')}", stream


def stream_address(port: int) -> str:
    """Where a viewer on this machine takes streams."""
    return f"rerun+http://{LOOPBACK}:{port}/proxy"


def take_picture(recording: Path, picture: Path, size: tuple[int, int] = PICTURE_SIZE) -> None:
    """Write a PNG of the viewer showing ``recording`` (.rrd), ``size`` pixels wide and high; needs no screen, but something that draws.

    Raises ``GlbenchError`` without the package, when nothing on this machine can draw, or when the file cannot be written.
    """
    program = viewer_program()
    port = free_port()
    arguments = [str(recording), *_listening(port), "--headless", "--hide-welcome-screen", "--window-size", f"{size[0]}x{size[1]}"]
    with Viewer(program, arguments) as viewer:
        viewer.await_port(port)
        client = importlib.import_module("rerun.experimental").ViewerClient(stream_address(port))
        try:
            image = _settled(client)
        except Exception as error:
            what = f"The viewer took no picture ({error})"
            raise viewer.failure(what) from error
    write_atomically(picture, image)


def _settled(client: Any) -> bytes:
    """A picture in which nothing moves any more: data arrive, and plots find their ranges, over several frames."""
    until = time.monotonic() + _LOAD_SECONDS
    same, image = 0, b""
    while same < _SAME_PICTURES and time.monotonic() < until:
        time.sleep(_SETTLE_SECONDS)
        earlier, image = image, bytes(client.take_screenshot())
        same = same + 1 if image == earlier else 0
    return image


def _listening(port: int) -> list[str]:
    return ["--bind", LOOPBACK, "--port", str(port)]


def require_screen() -> None:
    """Raise a GlbenchError that names the other ways when no window can be opened."""
    if not has_screen():
        msg = "There is no screen here to open a window on. Use --web for a page in the browser, or --save FILE.rrd and open it elsewhere."
        raise GlbenchError(msg)


class Viewer:
    """The viewer's process, with what it says kept in a file: a pipe that nobody reads would stop it."""

    def __init__(self, program: Path, arguments: Sequence[str]) -> None:
        self._output = tempfile.TemporaryFile()  # noqa: SIM115  closed on leaving
        # A window that outlives this process belongs to no one: its program starts another process and ends.
        start: type[subprocess.Popen[Any]] = subprocess.Popen if "--detach-process" in arguments else Child
        self._process = start([str(program), *arguments], stdin=subprocess.DEVNULL, stdout=self._output, stderr=self._output)

    def wait(self) -> None:
        """Wait until it ends; a GlbenchError when it ends with an error."""
        if self._process.wait() != 0:
            what = "The viewer ended with an error"
            raise self.failure(what)

    def await_port(self, port: int, *, may_end: bool = False) -> None:
        """Wait until it, or what it left behind where it ``may_end``, listens on ``port``."""
        until = time.monotonic() + _START_SECONDS
        while time.monotonic() < until and (self._process.poll() is None or (may_end and self._process.returncode == 0)):
            try:
                socket.create_connection((LOOPBACK, port), timeout=0.2).close()
            except OSError:
                time.sleep(0.05)
            else:
                return
        what = "The viewer did not start"
        raise self.failure(what)

    def failure(self, what: str) -> GlbenchError:
        """An error with the reason, as far as the viewer gave one."""
        self._output.seek(0)
        output = _TERMINAL_CODES.sub("", self._output.read().decode(errors="replace"))
        if any(words in output for words in _CANNOT_DRAW):
            return GlbenchError(f"{what}: nothing on this machine can draw. {_RENDERER}")
        lines = [line.strip() for line in output.splitlines() if "rror" in line or "panic" in line]
        reason = f": {lines[-1][:300]}" if lines else ", and does not say why"
        return GlbenchError(f"{what}{reason}. {_RENDERER}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        """End it, if it has not ended."""
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(timeout=5.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._output.close()


class LiveView:
    """Streams the run in ``row`` of an evaluation to the viewer at ``address`` (see ``rerun_viewer``), several times a second.

    Closing the viewer does not disturb the evaluation. After an interruption it shows the steps, and counts its sums, from there on.
    """

    def __init__(self, task: TaskSpec, controller: str, seed: int, address: str, row: int = 0) -> None:
        rerun = rerun_recording.load_rerun()
        self._task, self._controller, self._seed, self._row = task, controller, seed, row
        weather = run_weather(task, seed)
        self._times = weather.times[: task.steps + 1].astype("datetime64[ns]")
        self._signals = signals = signals_of(task)
        self._tables: dict[Source, Floats] = {
            source: np.zeros((task.steps, len(signals.vector(source)))) for source in ("state", "derived", "control", "air", "quantity")
        }
        self._weather = weather.values[: task.steps]
        self._clock = weather.hour_of_day[: task.steps + 1, None]
        sources = {**self._tables, "disturbance": self._weather, "clock": self._clock[1:]}
        self._columns = {
            one.name: sources[one.source][:, one.index] for one in signals.recorded if one.name in (*signals.needed, signals.clock)
        }
        self._started = False
        self._steps = self._sent = 0
        self._sent_at = time.monotonic()
        # A name of its own: evaluations of one process would else be mixed into one recording.
        self._stream = rerun.RecordingStream(rerun_recording.APPLICATION, recording_id=uuid.uuid4())
        self._stream.connect_grpc(address)
        runs = self._run_set(0)
        rerun_recording.send_frame(self._stream, runs)
        self._stream.send_blueprint(rerun_recording.blueprint(runs, live=True), make_active=True, make_default=True)

    def add(self, simulation: Simulation, outcome: StepResult) -> None:
        """Keep the step that was just simulated, and send the new steps several times a second."""
        step = int(simulation.k[self._row]) - 1
        if step < self._steps or step < 0:
            return  # this run has ended, others go on
        if not self._started:
            self._started, self._sent = True, step
            rerun_recording.send_limits(self._stream, self._run_set(0), [step])
        row, tables = self._row, self._tables
        tables["state"][step], tables["control"][step] = simulation.x[row], simulation.u[row]
        tables["air"][step], tables["quantity"][step] = simulation.air[:, row], outcome.table[:, row]
        self._steps = step + 1
        if time.monotonic() - self._sent_at >= _SEND_SECONDS or self._steps == self._task.steps:
            self._send()

    def close(self) -> None:
        """Send the rest and disconnect."""
        if self._steps > self._sent:
            self._send()
        rerun_recording.send_text(self._stream, "card", rerun_recording.card(self._run_set(self._steps)))
        try:
            self._stream.flush(timeout_sec=_FLUSH_SECONDS)
        except RuntimeError as error:
            logger.warning("The viewer was closed before the end (%s). The evaluation does not depend on it.", error)
        self._stream.disconnect()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, place: TracebackType | None) -> None:
        self.close()

    def _send(self) -> None:
        steps, tables = self._steps, self._tables
        vectors: dict[Source, Floats] = {source: tables[source][:steps] for source in ("state", "air", "control")}
        vectors |= {"disturbance": self._weather[:steps], "clock": self._clock[: steps + 1]}
        tables["derived"][:steps] = self._signals.derived(vectors)
        runs = self._run_set(steps)
        rerun_recording.send_trajectories(self._stream, runs, self._sent)
        # Sent as far as the curves reach, and no further: the viewer follows the latest time that it knows of.
        rerun_recording.send_limits(self._stream, runs, [self._steps])
        self._sent, self._sent_at = self._steps, time.monotonic()

    def _run_set(self, steps: int) -> rerun_recording.RunSet:
        """The run so far."""
        columns = {name: column[:steps] for name, column in self._columns.items()}
        trajectory = rerun_recording.Trajectory(self._controller, self._seed, self._times[: steps + 1], columns)
        return rerun_recording.RunSet(self._task, (trajectory,), (self._controller,), self._signals)
