"""The real viewer: it listens on this machine only, takes streams, and draws a picture without a screen."""

from __future__ import annotations

import io
import socket
import sys
import time
import urllib.request
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glbench.env import Simulation
from glbench.episodes import rerun_viewer
from glbench.episodes.rerun_recording import PALETTE, save_recording, show_together, shown_of, trajectory_of
from glbench.episodes.rerun_viewer import LiveView
from glbench.episodes.signals import signals_of
from glbench.errors import GlbenchError
from glbench.tasks import get_task
from tests.episodes.day import write_lettuce_task
from tests.episodes.rerun_runs import Runs, make_runs, read_recording

pytest.importorskip("rerun", reason="the viewer (rerun-sdk) is not installed")

GREENHOUSE = signals_of(get_task("Schiphol2010-Delta10-v1"))


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Runs:
    return make_runs(tmp_path_factory.mktemp("runs"))


@contextmanager
def stream_into(file: Path) -> Iterator[str]:
    """A viewer without a window that writes what is streamed to it into ``file``; gives its address."""
    port = rerun_viewer.free_port()
    listening = ["--bind", rerun_viewer.LOOPBACK, "--port", str(port)]
    with rerun_viewer.Viewer(rerun_viewer.viewer_program(), ["--save", str(file), *listening]) as viewer:
        viewer.await_port(port)
        yield rerun_viewer.stream_address(port)
        _await_quiet(file)


def _await_quiet(file: Path) -> None:
    """Wait until ``file`` has stopped growing: what was streamed is written a moment later."""
    sizes = [0, -1]
    while len(set(sizes[-5:])) > 1:
        time.sleep(0.4)
        sizes.append(file.stat().st_size)


def _stream(runs: Runs, address: str, first: int = 0) -> None:
    """The recorded run of ``rule_based`` again, watched from step ``first`` on."""
    episode, task = runs.episode(), get_task(runs.task_file)
    simulation = Simulation(task, 2)
    simulation.reset([666, 667])
    controls = np.repeat(np.asarray(episode.tables["controls"])[:, np.newaxis], 2, axis=1)
    for step in range(first):
        simulation.step_controls(controls[step])
    with LiveView(task, "rule_based", 666, address) as live:
        for step in range(first, task.steps):
            live.add(simulation, simulation.step_controls(controls[step]))


def test_what_is_streamed_is_what_is_recorded(runs: Runs, tmp_path: Path) -> None:
    with stream_into(tmp_path / "live.rrd") as address:
        _stream(runs, address)
    live = read_recording(tmp_path / "live.rrd")
    save_recording(shown_of([runs.episode()]), tmp_path / "recorded.rrd")
    recorded = read_recording(tmp_path / "recorded.rrd")
    for signal in GREENHOUSE.curves:
        entity = f"/{signal.path}" if signal.shared else f"/{signal.path}/rule_based"
        assert live.curves[entity].values.tobytes() == recorded.curves[entity].values.tobytes(), entity
        assert (live.curves[entity].times == recorded.curves[entity].times).all()
    (card,) = live.styles["/card"]["TextDocument:text"]
    assert "EPI" in card
    assert "running" not in card


def test_a_live_run_of_another_crop_has_its_own_season_and_series(tmp_path: Path) -> None:
    task = get_task(write_lettuce_task(tmp_path, days=3))
    simulation = Simulation(task, 2)
    simulation.reset([10_000, 10_001])
    began = simulation.time[1]
    heads = []
    with stream_into(tmp_path / "live.rrd") as address, LiveView(task, "one", 10_001, address, row=1) as live:
        for _ in range(task.steps):
            live.add(simulation, simulation.step(np.full((2, 6), 0.01)))
            heads.append(simulation.task.model_value.signals()[-4].of(*_records(simulation, 1)))
    curves = read_recording(tmp_path / "live.rrd").curves
    assert curves["/crop/head/one"].values.tolist() == heads
    assert curves["/weather/temperature"].times[0] == began.astype("datetime64[ns]")


def _records(simulation: Simulation, row: int) -> tuple[Any, Any]:
    """State and nominal parameters of a run by name."""
    model = simulation.task.model_value
    return model.State(*simulation.x[row].tolist()), model.Parameters(*simulation.p_nominal.tolist())


def test_two_evaluations_are_two_recordings(runs: Runs, tmp_path: Path) -> None:
    from rerun.chunk import RrdReader

    with stream_into(tmp_path / "live.rrd") as address:
        _stream(runs, address)
        _stream(runs, address)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="RRD file has no footer")
        assert len(RrdReader(tmp_path / "live.rrd").recordings()) == 2


def test_an_evaluation_that_goes_on_is_shown_from_where_it_goes_on(runs: Runs, tmp_path: Path) -> None:
    with stream_into(tmp_path / "live.rrd") as address:
        _stream(runs, address, first=50)
    curve = read_recording(tmp_path / "live.rrd").curves["/climate/co2/rule_based"]
    assert curve.steps.tolist() == list(range(51, 97))
    assert curve.values.tobytes() == np.ascontiguousarray(runs.episode()["co2"][50:]).tobytes()


def test_a_run_that_ends_early_ends_its_live_view(runs: Runs, tmp_path: Path) -> None:
    task = get_task(runs.task_file)
    simulation = Simulation(task, 2)
    simulation.reset([666, 667])
    with stream_into(tmp_path / "live.rrd") as address, LiveView(task, "one", 666, address) as live:
        for step in range(10):
            if step == 4:
                simulation.end([0])
            live.add(simulation, simulation.step(np.zeros((2, 6))))
    assert len(read_recording(tmp_path / "live.rrd").curves["/money/epi/one"].values) == 4


def test_a_viewer_that_is_closed_does_not_stop_the_evaluation(runs: Runs, caplog: pytest.LogCaptureFixture) -> None:
    task = get_task(runs.task_file)
    simulation = Simulation(task, 1)
    simulation.reset([666])
    with page_for_test() as address:
        live = LiveView(task, "one", 666, address)
        live.add(simulation, simulation.step(np.zeros((1, 6))))
    live.add(simulation, simulation.step(np.zeros((1, 6))))
    live.close()
    assert "The viewer was closed before the end" in caplog.text


@contextmanager
def page_for_test() -> Iterator[str]:
    with rerun_viewer.page_for_browser(None) as (_, address):
        yield address


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads the kernel's table of listening sockets")
def test_the_page_and_its_data_are_served_on_this_machine_only(runs: Runs, tmp_path: Path) -> None:
    save_recording(shown_of([runs.episode()]), tmp_path / "one.rrd")
    with rerun_viewer.page_for_browser(tmp_path / "one.rrd") as (page, stream):
        with urllib.request.urlopen(page.partition("?")[0], timeout=120) as answer:
            assert answer.status == 200
        ports = {int(page.split(":")[2].partition("?")[0]), int(stream.split(":")[2].partition("/")[0])}
        assert _listening_addresses(ports) == {"127.0.0.1"}
    assert _listening_addresses(ports) == set()


def test_a_port_that_is_taken_is_said_to_be_taken() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(GlbenchError, match=f"The port {port} is taken"), rerun_viewer.page_for_browser(None, port):
            pass


def _listening_addresses(ports: set[int]) -> set[str]:
    """Addresses on which somebody listens at ``ports``."""
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text(encoding="ascii").splitlines()[1:]:
            fields = line.split()
            host, port = fields[1].split(":")
            if fields[3] == "0A" and int(port, 16) in ports:
                found.add(socket.inet_ntoa(bytes.fromhex(host)[::-1]) if table == "tcp" else host)
    return found


@pytest.mark.slow
def test_a_picture_of_the_real_viewer_shows_both_controllers_and_the_limits(runs: Runs, tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image", reason="Pillow, which reads the picture, is not installed")
    episodes = [runs.episode(), runs.episode(666, "steady")]
    save_recording(shown_of(episodes), tmp_path / "two.rrd", plain=True)
    try:
        rerun_viewer.take_picture(tmp_path / "two.rrd", tmp_path / "two.png", (1280, 800))
    except GlbenchError as error:
        if "nothing on this machine can draw" in str(error):
            pytest.skip("no renderer here: nothing on this machine can draw (Debian: apt-get install mesa-vulkan-drivers)")
        raise
    picture = image.open(io.BytesIO((tmp_path / "two.png").read_bytes()))
    assert picture.size == (1280, 800)
    pixels = np.asarray(picture.convert("RGB")).astype(int)
    for colour in PALETTE[:2]:
        assert _like(pixels, colour.rgb) > 300, f"hardly any {colour.name} is drawn"
    red, green, blue = np.moveaxis(pixels, -1, 0)
    band = (green > red + 10) & (green > blue + 10) & (green < 90)
    assert band.sum() > 20_000, "the bands of the limits are not drawn"


def _like(pixels: np.ndarray, rgb: tuple[int, int, int]) -> int:
    """Number of pixels of about this colour."""
    return int((np.abs(pixels - np.array(rgb)).max(axis=-1) < 12).sum())


def test_where_nothing_can_draw_it_says_what_to_install(runs: Runs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("VK_ICD_FILENAMES", "VK_DRIVER_FILES", "LIBGL_DRIVERS_PATH", "__EGL_VENDOR_LIBRARY_FILENAMES"):
        monkeypatch.setenv(name, "/there/is/none")
    monkeypatch.setenv("WGPU_BACKEND", "vulkan")
    task = get_task(runs.task_file)
    save_recording(show_together(task, [trajectory_of(runs.episode())]), tmp_path / "one.rrd")
    with pytest.raises(GlbenchError, match="mesa-vulkan-drivers"):
        rerun_viewer.take_picture(tmp_path / "one.rrd", tmp_path / "none.png")
    assert not (tmp_path / "none.png").exists()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="screens are announced by variables on Linux only")
def test_without_a_screen_the_other_ways_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(GlbenchError, match=r"--web .* --save"):
        rerun_viewer.open_window(tmp_path / "any.rrd")
