"""Pictures of a run, and that taking them changes nothing."""

from __future__ import annotations

import copy
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import gymnasium
import matplotlib as mpl
import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.env import GreenhouseEnv, GreenhouseVectorEnv, rendering, run_weather
from glbench.env.history import RecentHistory
from glbench.env.picture import Picture
from glbench.errors import GlbenchError
from glbench.kernel import StepFailure
from glbench.model import humidity_deficit, vapour_pressure_deficit
from glbench.tasks import TaskSpec
from tests.env.stepping import StillKernel, walk
from tests.support import lettuce_task

MakeTask = Callable[..., TaskSpec]
ID = "glbench:glbench/Schiphol2010-Delta10-v1"


def texts(environment: GreenhouseEnv) -> list[str]:
    """Everything written in the picture last drawn."""
    assert environment._camera is not None
    figure = environment._camera._pictures[0]._figure
    found = figure.findobj(mpl.text.Text)
    return [text.get_text() for text in found if isinstance(text, mpl.text.Text) and text.get_visible()]


def drawn(environment: GreenhouseEnv) -> NDArray[np.uint8]:
    picture = environment.render()
    assert isinstance(picture, np.ndarray)
    return picture


def test_a_picture_is_640_by_480_and_shows_what_happened(day: TaskSpec) -> None:
    environment = GreenhouseEnv(day, render_mode="rgb_array")
    environment.reset(seed=1)
    first = drawn(environment)
    assert (first.shape, first.dtype) == ((480, 640, 3), np.uint8)
    assert np.array_equal(drawn(environment), first)
    for action in walk(2, 30, 1)[:, 0]:
        *_, info = environment.step(action)
    later = drawn(environment)
    assert later.shape == first.shape
    assert (later != first).any(axis=2).mean() > 0.005
    assert (first != 255).any(axis=2).mean() > 0.05
    told = texts(environment)
    assert f"{day.short_id}   2010-03-01 07:30 UTC" in told
    assert {"step 30 of 96", "seed 1"} <= set(told)
    assert f"{info['air_temperature']:.1f} °C" in told


def test_the_words_of_a_picture_do_not_overlap() -> None:
    environment = GreenhouseEnv("Schiphol2010Code-Delta10-v1", render_mode="rgb_array")
    environment.reset(seed=2**64 - 1)  # an episode without a seed of one's own has 19 digits as a rule
    for action in walk(3, 30, 1)[:, 0]:
        environment.step(action)
    drawn(environment)
    assert environment._camera is not None
    figure = environment._camera._pictures[0]._figure
    boxes = [(text.get_text(), text.get_window_extent()) for text in figure.texts]
    boxes += [(label.get_text(), label.get_window_extent()) for axes in figure.axes for label in axes.get_xticklabels()]
    overlapping = [
        (one, other)
        for i, (one, box) in enumerate(boxes)
        for other, beside in boxes[:i]
        if one and other and box.overlaps(beside) and {one, other} != {"now"}
    ]
    assert not overlapping


def test_what_is_outside_its_limits_is_one_red_line() -> None:
    environment = GreenhouseEnv("Schiphol2010-Delta10-v1", render_mode="rgb_array")
    environment.reset(seed=1)
    for _ in range(12):
        environment.step(np.zeros(6, np.float32))
    drawn(environment)
    assert environment._camera is not None
    air = environment._camera._pictures[0]._climate[0]
    values = np.asarray(air.line.get_ydata(), dtype=float)
    outside = (values < 15.0) | (values > 34.0)
    assert 0 < outside.sum() < len(values)
    assert air.broken.get_linestyle() == "-"
    assert np.array_equal(np.asarray(air.broken.get_ydata(), dtype=float), np.where(outside, values, np.nan), equal_nan=True)


def test_limits_controls_and_units_are_the_tasks(make_task: MakeTask) -> None:
    task = make_task(
        ('controls = ["uBoil", "uCo2", "uThScr", "uVent", "uLamp", "uBlScr"]', 'controls = ["uBoil", "uVent"]'),
        ("air_temperature = { low = 15.0", "air_temperature = { low = 11.5"),
    )
    environment = GreenhouseEnv(task, render_mode="rgb_array")
    environment.reset(seed=1)
    environment.step(np.ones(2, dtype=np.float32))
    drawn(environment)
    told = texts(environment)
    assert "Air temperature (11.5 to 34 °C)" in told
    assert {"Boiler", "13 W/m²", "Vents", "10%"} <= set(told)
    assert "Lamps" not in told


def test_the_money_is_the_sum_of_the_epi_so_far(day: TaskSpec) -> None:
    environment = GreenhouseEnv(day, render_mode="rgb_array")
    environment.reset(seed=1)
    total = sum(environment.step(action)[4]["epi"] for action in walk(2, 20, 1)[:, 0])
    drawn(environment)
    assert f"{total:+.3f} EUR/m²" in texts(environment)
    environment.reset(options={"state": environment.snapshot()})
    drawn(environment)
    assert {"EPI since step 20", "+0.000 EUR/m²"} <= set(texts(environment))


def test_a_control_is_drawn_from_the_start_to_the_end_of_its_step(day: TaskSpec) -> None:
    environment = GreenhouseEnv(day, kernel=StillKernel(), render_mode="rgb_array")
    environment.reset(seed=1)
    for _ in range(2):
        environment.step(np.ones(6, dtype=np.float32))
    drawn(environment)
    assert environment._camera is not None
    (outline,) = environment._camera._pictures[0]._lanes[0].get_paths()
    hours, heights = outline.vertices[1:6].T
    assert hours.tolist() == [-0.5, -0.5, -0.25, -0.25, 0.0]
    assert (0.8 - heights).tolist() == pytest.approx([0.0, 0.08, 0.08, 0.16, 0.16])  # 0.8 is the height of a full lane


def test_a_history_forgets_what_is_older_than_two_days() -> None:
    history = RecentHistory(0, 900.0)
    for step in range(400):
        history.add([float(step)] * 9, 0.5)
    table = history.table()
    assert table.shape == (193, 10)
    assert table[[0, -1], 0].tolist() == [207.0, 399.0]
    assert table[-1, -1] == 200.0


@pytest.mark.parametrize("mode", ["ansi", "rgb_array"])
def test_rendering_changes_no_bit(day: TaskSpec, mode: str) -> None:
    plain, shown = GreenhouseEnv(day), GreenhouseEnv(day, render_mode=mode)
    assert plain.reset(seed=1)[1] == shown.reset(seed=1)[1]
    for action in walk(2, 12, 1)[:, 0]:
        one, other = plain.step(action), shown.step(action)
        shown.render()
        assert (one[0].tobytes(), *one[1:]) == (other[0].tobytes(), *other[1:])
    assert plain.reset()[1] == shown.reset()[1]


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_every_row_has_a_picture_that_is_the_single_environments(day: TaskSpec, mode: str) -> None:
    still = StillKernel()
    rows = GreenhouseVectorEnv(day, 2, kernel=still, render_mode="rgb_array", autoreset_mode=mode)
    plain = GreenhouseVectorEnv(day, 2, kernel=still, autoreset_mode=mode)
    single = GreenhouseEnv(day, kernel=still, render_mode="rgb_array")
    rows.reset(seed=4)
    plain.reset(seed=4)
    single.reset(seed=5)
    for k, action in enumerate(walk(3, day.steps + 3, 2)):
        one, other = rows.step(action), plain.step(action)
        assert [part.tobytes() for part in one[:4]] == [part.tobytes() for part in other[:4]]
        if k < day.steps - 1:
            single.step(action[1])
        if k in (0, day.steps - 2):
            pictures = rows.render()
            assert pictures is not None
            assert np.array_equal(pictures[1], drawn(single))
            assert not np.array_equal(pictures[0], pictures[1])
    assert len(rows.render() or ()) == 2
    assert rows._camera is not None
    assert rows._camera._histories[0].first_step == 0
    assert len(rows._camera._histories[0].table()) == (3 if mode == "NextStep" else 4)


def test_a_picture_does_not_depend_on_matplotlibs_global_state(day: TaskSpec) -> None:
    def picture() -> NDArray[np.uint8]:
        environment = GreenhouseEnv(day, render_mode="rgb_array")
        environment.reset(seed=1)
        return drawn(environment)

    expected = picture()
    before = mpl.get_backend(), dict(mpl.rcParams)
    assert np.array_equal(picture(), expected)
    assert (mpl.get_backend(), dict(mpl.rcParams)) == before


@pytest.mark.slow
def test_what_is_kept_between_pictures_is_not_seen(day: TaskSpec) -> None:
    environment = GreenhouseEnv(day, render_mode="rgb_array")
    environment.reset(seed=1)
    for action in walk(2, 25, 1)[:, 0]:
        environment.step(action)
        last = drawn(environment)
    camera = environment._camera
    assert camera is not None
    assert np.array_equal(Picture(day)(camera._histories[0], environment.simulation, 0), last)


def test_an_environment_that_draws_can_be_copied(day: TaskSpec) -> None:
    environment = GreenhouseEnv(day, render_mode="rgb_array")
    environment.reset(seed=1)
    environment.step(np.ones(6, dtype=np.float32))
    expected = drawn(environment)
    twin = copy.deepcopy(environment)
    assert np.array_equal(drawn(twin), expected)
    twin.step(np.ones(6, dtype=np.float32))
    assert np.array_equal(drawn(environment), expected)


def test_there_is_nothing_to_draw_before_the_first_reset(day: TaskSpec) -> None:
    for environment in (GreenhouseEnv(day, render_mode="rgb_array"), GreenhouseVectorEnv(day, render_mode="rgb_array")):
        with pytest.raises(GlbenchError, match="call reset first"):
            environment.render()


@pytest.fixture
def no_matplotlib(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "glbench.env.picture", None)
    rendering._warn_without_matplotlib.cache_clear()
    yield
    rendering._warn_without_matplotlib.cache_clear()


@pytest.mark.usefixtures("no_matplotlib")
def test_without_matplotlib_there_is_one_warning_and_an_environment_that_works(day: TaskSpec, tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match=r"needs matplotlib, .*pip install 'glbench\[video\]'") as warned:
        environment = GreenhouseEnv(day, render_mode="rgb_array")
    assert warned[0].filename == __file__
    GreenhouseVectorEnv(day, 2, render_mode="rgb_array")  # a second warning would fail the test
    environment.reset(seed=1)
    environment.step(np.ones(6, dtype=np.float32))
    with pytest.raises(GlbenchError, match=r"pip install 'glbench\[video\]'"):
        environment.render()
    recorded = gymnasium.wrappers.RecordVideo(environment, str(tmp_path / "videos"), disable_logger=True)
    with pytest.raises(GlbenchError, match=r"pip install 'glbench\[video\]'"):
        recorded.reset(seed=1)


def test_without_matplotlib_gymnasiums_check_finds_nothing_wrong() -> None:
    code = (
        "import sys; sys.modules['matplotlib'] = None\n"
        "import warnings, gymnasium\n"
        "from gymnasium.utils.env_checker import check_env\n"
        f"environment = gymnasium.make({ID!r}, kernel='fast').unwrapped\n"
        "print(environment.metadata['render_modes'])\n"
        "check_env(environment)\n"
        "warnings.simplefilter('ignore')\n"
        f"asked = gymnasium.make({ID!r}, render_mode='rgb_array', kernel='fast')\n"
        "asked.reset(seed=1)\n"
        "try:\n    asked.render()\nexcept Exception as error:\n    print(error)\n"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=300)
    modes, error = told.stdout.splitlines()
    assert modes == "['ansi']"
    assert "pip install 'glbench[video]'" in error
    assert "matplotlib" not in told.stderr
    assert GreenhouseEnv.metadata["render_modes"] == ["ansi", "rgb_array"]  # with matplotlib, as here


def test_nothing_of_matplotlib_is_loaded_for_an_environment_that_does_not_draw() -> None:
    code = (
        "import sys, numpy as np, gymnasium\n"
        f"environment = gymnasium.make({ID!r})\n"
        "environment.reset(seed=1); environment.step(np.zeros(6, np.float32))\n"
        "print([name for name in sys.modules if name.startswith('matplotlib')])\n"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=300)
    assert told.stdout.strip() == "[]"


def test_a_picture_shows_deficits_light_and_local_time() -> None:
    environment = GreenhouseEnv(lettuce_task(), kernel=StandingKernel(), render_mode="rgb_array")
    environment.reset(seed=1)
    action, info = np.zeros(6, np.float32), {}
    action[4] = 1.0
    for _ in range(14):
        *_, info = environment.step(action)
    drawn(environment)
    temperature, humidity = info["air_temperature"], info["relative_humidity"]
    (title,) = [text for text in texts(environment) if " UTC" in text]
    assert title.endswith("2010-03-07 13:00 UTC, 14:00 local")
    (told,) = [text for text in texts(environment) if "deficit" in text]
    weather = run_weather(environment.simulation.task, 1)
    radiation = weather.values[:14, 0].sum() * 3600.0 / 1e4
    assert f"Vapour pressure deficit {vapour_pressure_deficit(temperature, humidity):.2f} kPa" in told
    assert f"Humidity deficit {humidity_deficit(temperature, humidity):.2f} g/m³" in told
    assert f"Radiation today {radiation:.0f} J/cm²" in told
    assert "PAR today " in told
    panel = GreenhouseEnv(lettuce_task(), kernel=StandingKernel(), render_mode="ansi")
    panel.reset(seed=1)
    words = str(panel.render())
    assert "2010-03-06 23:00 UTC, 00:00 local, step 0" in words
    assert "vapour pressure deficit" in words


def test_light_of_a_picture_is_that_of_the_day_and_unknown_until_midnight(make_task: MakeTask) -> None:
    task = make_task(days=2)
    environment = GreenhouseEnv(task, kernel=StillKernel(), render_mode="rgb_array")
    environment.reset(seed=1)
    for _ in range(60):
        environment.step(np.zeros(6, np.float32))
    snapshot = environment.snapshot()
    environment.reset(options={"state": snapshot})
    drawn(environment)
    assert not [text for text in texts(environment) if "today" in text]
    weather = task.disturbances().values[:, 0]
    for _ in range(80):
        environment.step(np.zeros(6, np.float32))
    drawn(environment)
    (told,) = [text for text in texts(environment) if "today" in text]
    assert f"Radiation today {weather[96:140].sum() * 900.0 / 1e4:.0f} J/cm²" in told


class StandingKernel:
    """Nothing moves, in any model."""

    def try_step(self, x: NDArray[np.float64], *_: object) -> tuple[NDArray[np.float64], list[StepFailure]]:
        return x.copy(), []
