"""A Ray cluster of three machines in one: that of the command, which works not at all, and two others, in namespaces of their own.

The others have the same installation, and no other folder in common, neither with each other nor with the first: each has its own
home, its own temporary folder and shared memory. To end one is to end all its processes at once, as a power cut does.
"""

from __future__ import annotations

import json
import os
import secrets
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import glbench
from glbench.resources import cache_folder, user_data_folder

_PATIENCE_SECONDS = 400.0
_CHECKOUT = Path(glbench.__file__).resolve().parents[1]
_START = """
import time
from ray._private import services
look = services.get_node

def look_long(*arguments):
    # Ray itself gives its processes half a minute to start.
    deadline = time.monotonic() + 200.0
    while True:
        try:
            return look(*arguments)
        except RuntimeError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.5)

services.get_node = look_long
from ray.scripts.scripts import main
main()
"""
_RAY = (sys.executable, "-c", _START, "start")
_COMMON = (
    "--disable-usage-stats", "--node-ip-address=127.0.0.1", "--object-store-memory=100000000",
    "--include-log-monitor=false", "--block",
)  # fmt: skip
_AT_HOME = "/tmp/home"


class MachinesError(Exception):
    """The machines do not start in time: this one is too busy."""


class Machines:
    """The cluster; ``folder`` is the home of the command, and holds the homes of the others, who cannot see it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.command_folder = folder / "command"
        self.command_folder.mkdir()
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self._port = free.getsockname()[1]
        self.address = f"127.0.0.1:{self._port}"
        kept = {name: value for name, value in os.environ.items() if not name.startswith(("GLBENCH_", "RAY_", "XDG_"))}
        self._ray = {
            "RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32), "RAY_ENABLE_UV_RUN_RUNTIME_ENV": "0",
            "RAY_enable_worker_prestart": "0", "RAY_worker_niceness": "0",
            "RAY_health_check_period_ms": "500", "RAY_health_check_initial_delay_ms": "1000",
            "RAY_agent_register_timeout_ms": "300000", "RAY_worker_register_timeout_seconds": "300", "OMP_NUM_THREADS": "1",
        }  # fmt: skip
        self.environment = {
            **kept, **self._ray, "PYTHONPATH": str(_CHECKOUT), "GLBENCH_DATA": str(folder / "command" / "data"),
            "GLBENCH_CACHE": str(cache_folder()),
        }  # fmt: skip
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def home(self, name: str) -> Path:
        """The home of a machine, as seen from outside."""
        return self.folder / name

    def start(self, name: str) -> None:
        """Start the machine ``a`` or ``b``, with one core, or the ``head``."""
        head = ("--head", f"--port={self._port}", "--num-cpus=0", "--include-dashboard=false")
        other = (f"--address={self.address}", "--num-cpus=1", "--temp-dir=/tmp/ray", "--resources", json.dumps({name: 1}))
        if name == "head":
            # A short path: those of Unix sockets may have 107 characters.
            command = [*_RAY, *head, f"--temp-dir=/tmp/glbench-ray-{os.getpid()}", *_COMMON]
        else:
            command = [*self._walls(name), *_RAY, *other, *_COMMON]
        with (self.folder / f"{name}.log").open("wb") as log:
            self._running[name] = subprocess.Popen(command, stdout=log, stderr=log, env=self.environment)

    def _walls(self, name: str) -> list[str]:
        home = self.home(name)
        shutil.rmtree(home, ignore_errors=True)
        home.mkdir()
        ours = {Path("/tmp"), Path("/dev/shm"), self.folder, cache_folder(), user_data_folder()}
        hidden = [word for place in sorted(ours) if place.is_dir() for word in ("--tmpfs", str(place))]
        return [
            "bwrap", "--die-with-parent", "--unshare-pid", "--ro-bind", "/", "/", "--dev", "/dev", "--proc", "/proc", *hidden,
            "--bind", str(home), _AT_HOME, "--chdir", _AT_HOME, "--setenv", "HOME", _AT_HOME,
            "--unsetenv", "GLBENCH_DATA", "--unsetenv", "GLBENCH_CACHE",
        ]  # fmt: skip

    def wait_for(self, *names: str) -> None:
        """Wait until machines are there.

        Raises
        ------
        MachinesError
            When they do not come.
        """
        deadline = time.monotonic() + _PATIENCE_SECONDS
        while not all(b"Ray runtime started" in (self.folder / f"{name}.log").read_bytes() for name in names):
            if any(self._running[name].poll() is not None for name in names) or time.monotonic() > deadline:
                raise MachinesError(self._logs())
            time.sleep(0.2)

    def _logs(self) -> str:
        return "\n".join((self.folder / f"{name}.log").read_text(errors="replace")[-600:] for name in self._running)

    def python(self, *arguments: str, timeout: float = 900.0) -> subprocess.CompletedProcess[str] | None:
        """Run Python on the machine of the command; ``None`` when it takes too long."""
        try:
            return subprocess.run(
                [sys.executable, *arguments], cwd=self.command_folder, env=self.environment, capture_output=True, text=True,
                check=False, timeout=timeout,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return None

    def begun(self, *arguments: str) -> subprocess.Popen[str]:
        """Begin to run Python there."""
        return subprocess.Popen(
            [sys.executable, *arguments], cwd=self.command_folder, env=self.environment, stdout=subprocess.PIPE,
            stderr=subprocess.PIPE, text=True,
        )  # fmt: skip

    def end(self, name: str) -> None:
        """End a machine at once, with all its processes."""
        machine = self._running.pop(name)
        machine.kill()
        machine.wait()

    def close(self) -> None:
        """End all machines."""
        for name in [name for name in self._running if name != "head"]:
            self.end(name)
        head = self._running.pop("head", None)
        if head is not None:
            head.terminate()
            head.wait(90.0)
        shutil.rmtree(f"/tmp/glbench-ray-{os.getpid()}", ignore_errors=True)


@contextmanager
def two_machines(folder: Path) -> Iterator[Machines]:
    """The cluster, with both machines at work.

    Raises
    ------
    MachinesError
        When they do not start.
    """
    machines = Machines(folder)
    try:
        machines.start("head")
        machines.wait_for("head")
        machines.start("a")
        machines.start("b")
        machines.wait_for("a", "b")
        yield machines
    finally:
        machines.close()
