"""The viewer's program: a window, a page for the browser, a picture without a screen. It listens on this machine only."""

from __future__ import annotations

import importlib
import os
import re
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self
from urllib.parse import quote

from glbench.children import Child
from glbench.errors import GlbenchError
from glbench.resources import write_atomically

LOOPBACK = "127.0.0.1"
"""Without being told, the viewer's server listens on all interfaces: anybody in the network could send to it."""
PICTURE_SIZE = (1920, 1080)
_START_SECONDS = 20.0
_LOAD_SECONDS = 30.0
_SETTLE_SECONDS = 0.4
_SAME_PICTURES = 2
_TERMINAL_CODES = re.compile(r"\x1b\[[0-9;]*m")
_CANNOT_DRAW = ("render context", "graphics adapter", "NoSuitableAdapter")
_RENDERER = "Pictures and windows need Vulkan or OpenGL; without a graphics card: `apt-get install mesa-vulkan-drivers` (Debian, Ubuntu)."


def load_rerun() -> Any:
    """The module ``rerun``.

    Raises
    ------
    GlbenchError
        When it is not installed; it says how to install it.
    """
    try:
        return importlib.import_module("rerun")
    except ImportError as error:
        msg = (
            "The viewer is not installed: it needs the package rerun-sdk. "
            'Install it with `pip install "glbench[view]"`, or in a checkout with `uv sync --inexact --extra view`.'
        )
        raise GlbenchError(msg) from error


def load_blueprint() -> Any:
    """The module ``rerun.blueprint``; raises as ``load_rerun`` does."""
    load_rerun()
    return importlib.import_module("rerun.blueprint")


def viewer_program() -> Path:
    """The viewer's program, which comes with rerun-sdk.

    Raises
    ------
    GlbenchError
        Without the package, or when its program is missing.
    """
    load_rerun()
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
            msg = f"The port {port} is taken. Choose another with --port, or leave it out."
            raise GlbenchError(msg) from error
    return port


def has_screen() -> bool:
    """Whether a window can be opened: on Linux, whether a display is announced."""
    if not sys.platform.startswith("linux"):
        return True
    return any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"))


def open_window(recording: Path) -> None:
    """Open the viewer with ``recording`` and wait until it is closed.

    Raises
    ------
    GlbenchError
        Without the package, without a screen, or when the viewer fails.
    """
    program = viewer_program()
    require_screen()
    with Viewer(program, [str(recording), *_listening(free_port())]) as viewer:
        viewer.wait()


def window_for_stream() -> str:
    """Open a viewer that waits for a stream; the address to connect to. It stays open until a person closes it.

    Raises
    ------
    GlbenchError
        Without the package, without a screen, or when the viewer does not start.
    """
    program = viewer_program()
    require_screen()
    port = free_port()
    with Viewer(
        program, [*_listening(port), "--hide-welcome-screen", "--expect-data-soon", "--detach-process"]
    ) as viewer:
        viewer.await_port(port, may_end=True)
    return stream_address(port)


@contextmanager
def page_for_browser(recording: Path | None, port: int | None = None) -> Iterator[tuple[str, str]]:
    """Serve the viewer as a page of this machine; its address, and the address that streams are sent to.

    ``recording`` is shown; without one, what is streamed. The page is at ``port`` and its data at the next one; by default both
    are any free ones.

    Raises
    ------
    GlbenchError
        Without the package, when a port is taken, or when the server does not start.
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
    """Write a PNG of the viewer showing ``recording``; needs no screen, but something that draws.

    Parameters
    ----------
    recording
        A recording (.rrd).
    picture
        The file to write.
    size
        Width and height in pixels.

    Raises
    ------
    GlbenchError
        Without the package, when nothing on this machine can draw, or when the file cannot be written.
    """
    program = viewer_program()
    port = free_port()
    arguments = [
        str(recording),
        *_listening(port),
        "--headless",
        "--hide-welcome-screen",
        "--window-size",
        f"{size[0]}x{size[1]}",
    ]
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
        self._said = tempfile.TemporaryFile()  # noqa: SIM115  closed on leaving
        # A window that outlives this process belongs to no one: its program starts another process and ends.
        start: type[subprocess.Popen[Any]] = subprocess.Popen if "--detach-process" in arguments else Child
        self._process = start(
            [str(program), *arguments], stdin=subprocess.DEVNULL, stdout=self._said, stderr=self._said
        )

    def wait(self) -> None:
        """Wait until it ends; a GlbenchError when it ends with an error."""
        if self._process.wait() != 0:
            what = "The viewer ended with an error"
            raise self.failure(what)

    def await_port(self, port: int, *, may_end: bool = False) -> None:
        """Wait until it, or what it left behind where it ``may_end``, listens on ``port``."""
        until = time.monotonic() + _START_SECONDS
        while time.monotonic() < until and (
            self._process.poll() is None or (may_end and self._process.returncode == 0)
        ):
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
        self._said.seek(0)
        said = _TERMINAL_CODES.sub("", self._said.read().decode(errors="replace"))
        if any(words in said for words in _CANNOT_DRAW):
            return GlbenchError(f"{what}: nothing on this machine can draw. {_RENDERER}")
        lines = [line.strip() for line in said.splitlines() if "rror" in line or "panic" in line]
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
        self._said.close()
