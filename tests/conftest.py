"""For every test: no time limits but its own, children get their signals as a terminal gives them, and none is left behind.

Without PyTorch (group ``dev``) whatever imports it is skipped, and named in one line at the end. The group ``all`` has it.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

import glbench
from tests.support import checkout_with_few_results

settings.register_profile("busy", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("busy")

_SUBREAPER = 36
_ENDING_SECONDS = 60.0
_SERVERS = ("multiprocessing.resource_tracker import main", "multiprocessing.forkserver import main")
"""Python's own helpers, of which it starts one each and which end with it."""


_JAX_CACHE = {
    "JAX_COMPILATION_CACHE_MAX_SIZE": "1000000000",  # with a limit, processes take turns at the cache
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
}


def pytest_configure(config: pytest.Config) -> None:
    """Let children start with the signals' own meanings, also under nohup, or in the background of a script, where SIGINT is ignored.

    A handler is not inherited by another program, and what is ignored is; so what is ignored here gets a handler that does nothing.
    And keep compiled modules, whatever the environment says: each of the thousand processes that tests start would compile them again.
    """
    sys.dont_write_bytecode = False
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) == signal.SIG_IGN:
            signal.signal(number, lambda *_: None)
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        # What JAX has compiled in one test serves the others, and their processes: half of the time of those that train with it.
        folder = tempfile.mkdtemp(prefix="glbench-tests-jax-")
        config.add_cleanup(lambda: shutil.rmtree(folder, ignore_errors=True))
        os.environ.update({**_JAX_CACHE, "JAX_COMPILATION_CACHE_DIR": folder})


_HAS_PYTORCH = importlib.util.find_spec("torch") is not None
_OF_PYTORCH = ("torch", "stable_baselines3", "sb3_contrib", "tensorboard")
_NO_PYTORCH = "PyTorch is not installed"


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector: pytest.Collector) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Skip a file that imports PyTorch where there is none."""
    report = yield
    call = getattr(report, "call", None)
    if report.failed and call is not None and _is_for_want_of_pytorch(call.excinfo):
        report.outcome, report.longrepr = "skipped", (str(collector.path), 1, f"Skipped: {_NO_PYTORCH}")
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Skip a test that imports PyTorch where there is none."""
    report = yield
    if report.failed and _is_for_want_of_pytorch(call.excinfo):
        report.outcome = "skipped"
        report.longrepr = (str(item.path), item.location[1] or 0, f"Skipped: {_NO_PYTORCH}")
    return report


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Name what was not tested for want of PyTorch."""
    if _HAS_PYTORCH:
        return
    skipped = [
        report.nodeid
        for report in terminalreporter.stats.get("skipped", [])
        if any(word in str(report.longrepr).rpartition("Skipped:")[2] for word in ("orch", "aseline", "'train'"))
    ]
    files = sorted({name.partition("::")[0] for name in skipped})
    if files:
        terminalreporter.write_line(f"Not tested, or in part, for want of PyTorch (`uv run --group all pytest` has it): {', '.join(files)}")


def _is_for_want_of_pytorch(excinfo: pytest.ExceptionInfo[BaseException] | None) -> bool:
    error = None if excinfo is None else excinfo.value
    while error is not None and not isinstance(error, ModuleNotFoundError):
        error = error.__cause__
    return not _HAS_PYTORCH and error is not None and (error.name or "").partition(".")[0] in _OF_PYTORCH


@pytest.fixture(scope="session", autouse=True)
def _no_process_is_left_behind() -> Iterator[None]:
    """Fail where a process that a test started, directly or not, goes on when all tests are done."""
    if not sys.platform.startswith("linux"):
        yield
        return
    # Children of processes that have ended become this one's.
    ctypes.CDLL(None).prctl(_SUBREAPER, 1, 0, 0, 0)
    before = _descendants()
    yield
    deadline = time.monotonic() + _ENDING_SECONDS
    # Two looks: one may miss a process whose parent ends just then.
    while (left := (_descendants() | _descendants()).items() - before.items()) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not left, f"processes were left behind: {left}"


@pytest.fixture(scope="session")
def _few(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return checkout_with_few_results(tmp_path_factory.mktemp("few"))


@pytest.fixture
def few_released(_few: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let few results have come with glbench, where a test is not about them: to rank all takes ten seconds, and a page of all twenty."""
    monkeypatch.setattr("glbench.resources._PACKAGE", _few)


@pytest.fixture
def all_released(few_released: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a file whose tests use ``few_released``: this one is about all."""
    monkeypatch.setattr("glbench.resources._PACKAGE", Path(glbench.__file__).parent)


def _descendants() -> dict[int, str]:
    """Command lines of the processes that this one started, and that those did; without any that have ended."""
    parents: dict[int, int] = {}
    for place in Path("/proc").glob("[0-9]*"):
        try:
            state, parent = (place / "stat").read_text(errors="replace").rpartition(") ")[2].split()[:2]
        except OSError:  # it ended while we looked
            continue
        if state != "Z":
            parents[int(place.name)] = int(parent)
    found, waiting = dict[int, str](), [os.getpid()]
    while waiting:
        parent = waiting.pop()
        children = [pid for pid, its_parent in parents.items() if its_parent == parent]
        waiting += children
        found |= {pid: _command_line(pid) for pid in children}
    return {pid: line for pid, line in found.items() if not any(server in line for server in _SERVERS)}


def _command_line(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")[:200]
    except OSError:
        return "ended"
