"""The viewer's recording holds what the episode holds, to the bit, with units, limits and words."""

from __future__ import annotations

import datetime as dt
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glbench.episodes.rerun_recording import (
    PALETTE,
    Trajectory,
    _Layout,
    card,
    load_rerun,
    provenance_words,
    save_recording,
    show_together,
    shown_of,
    trajectory_of,
    weeks_card,
    with_two_ticks,
)
from glbench.episodes.signals import signals_of
from glbench.errors import GlbenchError
from glbench.evaluation import load_result
from glbench.tasks import get_task
from tests.episodes.rerun_runs import Recording, Runs, make_runs, read_recording

pytest.importorskip("rerun", reason="the viewer (rerun-sdk) is not installed")

GREENHOUSE = signals_of(get_task("Schiphol2010-Delta10-v1"))


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Runs:
    return make_runs(tmp_path_factory.mktemp("runs"))


@pytest.fixture(scope="module")
def recording(runs: Runs, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = tmp_path_factory.mktemp("rrd") / "one.rrd"
    episode = runs.episode()
    save_recording(shown_of([episode]), path, provenance_words([episode]))
    return read_recording(path)


def _course(task_file: Path, controller: str = "one", seed: int = 1, steps: int = 96, **columns: np.ndarray) -> Trajectory:
    times = get_task(task_file).disturbances().times[: steps + 1].astype("datetime64[ns]")
    return Trajectory(controller, seed, times, {name: np.zeros(steps) for name in GREENHOUSE.needed} | columns)


def test_plain_curves_are_the_columns_of_the_record_bit_for_bit(runs: Runs, recording: Recording) -> None:
    episode = runs.episode()
    plain = {
        "/climate/air_temperature/rule_based": "air_temperature",
        "/climate/relative_humidity/rule_based": "relative_humidity",
        "/climate/co2/rule_based": "co2",
        "/climate/pipe_temperature/rule_based": "tPipe",
        "/weather/global_radiation": "iGlob",
        "/weather/temperature": "tOut",
    }
    for entity, column in plain.items():
        assert recording.curves[entity].values.tobytes() == np.ascontiguousarray(episode[column]).tobytes(), entity


def test_every_curve_follows_from_the_record_at_the_records_steps_and_times(runs: Runs, recording: Recording) -> None:
    episode = runs.episode()
    columns = trajectory_of(episode).columns
    for signal in GREENHOUSE.curves:
        curve = recording.curves[f"/{signal.path}" if signal.shared else f"/{signal.path}/rule_based"]
        assert curve.values.tobytes() == np.ascontiguousarray(signal.values(columns)).tobytes(), signal.path
        assert (curve.steps == np.arange(1, episode.steps + 1)).all()
        expected = episode.times[:-1] if signal.moment == "start" else episode.times[1:]
        assert (curve.times == expected).all(), signal.path


def test_sums_end_at_the_metrics_of_the_result(runs: Runs, recording: Recording) -> None:
    run = load_result(runs.rule_based).runs[0]
    ends = {
        "money/epi": "epi",
        "money/revenue": "revenue",
        "money/cost_heat": "cost_heat",
        "money/cost_electricity": "cost_electricity",
        "money/cost_co2": "cost_co2",
        "money/reward": "reward",
        "crop/fruit_fresh": "yield",
        "violations/penalty": "penalty",
        "violations/hours": "hours_outside_limits",
    }
    for path, metric in ends.items():
        assert recording.curves[f"/{path}/rule_based"].values[-1] == run.metrics[metric], metric


def test_violations_are_positive_above_the_limits_and_negative_below(runs: Runs, recording: Recording) -> None:
    humidity = runs.episode()["relative_humidity"]
    beyond = recording.curves["/violations/relative_humidity/rule_based"].values
    assert np.array_equal(beyond > 0, humidity > 85.0)
    assert np.array_equal(beyond < 0, humidity < 50.0)
    assert (beyond != 0).any()


def test_every_series_names_its_unit(recording: Recording) -> None:
    for signal in GREENHOUSE.curves:
        entity = f"/{signal.path}" if signal.shared else f"/{signal.path}/rule_based"
        (name,) = recording.styles[entity]["SeriesLines:names"]
        assert name == f"{signal.title if signal.shared else 'rule_based'} [{signal.unit}]"


def test_controls_and_weather_are_drawn_as_steps_and_the_rest_as_lines(recording: Recording) -> None:
    from rerun.components import InterpolationMode

    steps = {signal.path for signal in GREENHOUSE.curves if signal.path.startswith(("controls/", "weather/"))}
    steps.remove("weather/radiation_today")  # a sum, known at the end of a step
    for signal in GREENHOUSE.curves:
        entity = f"/{signal.path}" if signal.shared else f"/{signal.path}/rule_based"
        drawn = InterpolationMode.StepAfter if signal.path in steps else InterpolationMode.Linear
        assert recording.styles[entity]["SeriesLines:interpolation_mode"] == [drawn.value], signal.path


def test_bands_reach_from_limit_to_limit_over_the_whole_episode(runs: Runs, recording: Recording) -> None:
    # Relative humidity from 50 to 85 %: the middle is 67.5, half the width 17.5, its square 306.25.
    band = recording.curves["/climate/relative_humidity/limits"]
    assert band.values.tolist() == [67.5, 67.5]
    assert band.times.tolist() == runs.episode().times[[0, -1]].tolist()
    assert recording.styles["/climate/relative_humidity/limits"]["Measurements:names"] == ["limits 50 to 85 [%]"]


def test_the_recording_says_where_it_comes_from(runs: Runs, recording: Recording) -> None:
    words = recording.styles["/__properties/glbench"]
    episode = runs.episode()
    assert [episode.provenance.task.digest] in words.values()
    assert any(episode.provenance.agent.digest in str(value) and "seed 666" in str(value) for value in words.values())


def test_the_card_tells_the_task_and_who_is_who(runs: Runs) -> None:
    shown = shown_of([runs.episode(), runs.episode(666, "steady")])
    text = card(shown)
    task = shown.task
    for words in (task.title, "air temperature **15 to 34 °C**", "relative humidity **50 to 85 %**", "CO₂ **300 to 1600 ppm**"):
        assert words in text
    assert "heat 0.09 EUR/kWh" in text
    assert "4 days, a decision every 60 minutes" in text
    assert "**rule_based** (orange), seed 666" in text
    assert "**steady** (sky blue), seed 666" in text


def test_a_table_of_weeks_tells_kilowatt_hours_gas_and_money(runs: Runs) -> None:
    shown = shown_of([runs.episode(), runs.episode(666, "steady")])
    text = weeks_card(shown)
    assert "**steady**" in text
    assert "Heat as natural gas [m³ m⁻²]" in text
    assert f"{runs.episode()['epi'].sum():.2f}".replace("-", "−") in text
    assert "[mol m⁻² d⁻¹]" in text
    bare = replace(shown, trajectories=(_course(runs.task_file), *shown.trajectories[1:]))
    assert "lacks what a table of weeks needs" in weeks_card(bare)


def test_a_run_that_ended_early_is_shown_with_its_reason(runs: Runs, tmp_path: Path) -> None:
    short = _course(runs.task_file, "failing", steps=20)
    shown = show_together(get_task(runs.task_file), [trajectory_of(runs.episode()), replace(short, remark="act raised ValueError")])
    save_recording(shown, tmp_path / "two.rrd")
    curves = read_recording(tmp_path / "two.rrd").curves
    assert len(curves["/climate/co2/failing"].values) == 20
    assert len(curves["/climate/co2/rule_based"].values) == len(curves["/weather/wind"].values) == 96
    assert "ended after step 20: act raised ValueError" in card(shown)


def test_the_days_shown_first_are_those_with_most_violations(runs: Runs) -> None:
    penalty = np.zeros(96)
    penalty[30], penalty[60] = 2.0, 3.0  # on the second and on the third of four days
    shown = show_together(get_task(runs.task_file), [_course(runs.task_file, penalty=penalty)])
    start, end = shown.closeup()
    assert (str(start)[:10], str(end)[:10]) == ("2010-03-02", "2010-03-04")


def test_other_days_can_be_chosen(runs: Runs) -> None:
    shown = shown_of([runs.episode()])
    start, end = replace(shown, first_day=dt.date(2010, 3, 4), days=3).closeup()
    assert (str(start)[:13], str(end)[:13]) == ("2010-03-04T00", "2010-03-05T00")  # as far as the four days go
    with pytest.raises(GlbenchError, match="2010-03-05 is not a day of what is shown, which lasts from 2010-03-01 to 2010-03-05"):
        replace(shown, first_day=dt.date(2010, 3, 5)).closeup()


def test_an_episode_shorter_than_the_days_is_shown_whole(runs: Runs) -> None:
    trajectory = _course(runs.task_file, steps=5)
    assert show_together(get_task(runs.task_file), [trajectory]).closeup() == (trajectory.times[0], trajectory.times[5])


def test_one_controller_twice_is_told_apart_by_its_seeds(runs: Runs) -> None:
    assert shown_of([runs.episode(666), runs.episode(667)]).labels == ("rule_based (seed 666)", "rule_based (seed 667)")


def test_what_cannot_be_shown_together_is_refused_in_words(runs: Runs) -> None:
    task, trajectory = get_task(runs.task_file), _course(runs.task_file)
    with pytest.raises(GlbenchError, match="nothing to show"):
        shown_of([])
    with pytest.raises(GlbenchError, match=r"one \(seed 1\) is there twice"):
        show_together(task, [trajectory, trajectory])
    with pytest.raises(GlbenchError, match="At most 6 runs"):
        show_together(task, [replace(trajectory, seed=seed) for seed in range(7)])
    with pytest.raises(GlbenchError, match="'one' with seed 1 has no steps"):
        show_together(task, [_course(runs.task_file, steps=0)])
    episode = runs.episode()
    facts = episode.provenance.task.model_copy(update={"digest": "0" * 64})
    other = replace(episode, provenance=episode.provenance.model_copy(update={"task": facts}))
    with pytest.raises(GlbenchError, match="another version of it"):
        shown_of([episode, other])


def test_without_the_package_the_message_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(GlbenchError, match=r'pip install "glbench\[view\]"'):
        load_rerun()


def test_every_curve_has_a_place_of_its_own_and_the_overview_knows_its_curves() -> None:
    paths = [curve.path for curve in GREENHOUSE.curves]
    assert len(set(paths)) == len(paths)
    assert {path for column in GREENHOUSE.overview for path in column} <= set(paths)
    assert {name for curve in GREENHOUSE.curves for name in curve.columns} <= {one.name for one in GREENHOUSE.recorded}


@given(low=st.floats(-1e5, 1e5), width=st.floats(1e-3, 1e5), margin=st.floats(0.0, 0.4))
def test_a_range_of_values_shows_everything_and_two_ticks(low: float, width: float, margin: float) -> None:
    high = low + width
    first, last = with_two_ticks(low, high, margin)
    assert first <= low < high <= last
    decade = 10.0 ** np.floor(np.log10(high - low))
    ticks = np.floor(last / decade + 1e-6) - np.ceil(first / decade - 1e-6) + 1
    assert ticks >= 2


def test_a_constant_curve_gets_a_range_too() -> None:
    low, high = with_two_ticks(0.0, 0.0, 0.04)
    assert low < 0.0 < high


@pytest.mark.parametrize("path", ["crop/fruit_fresh", "climate/pipe_temperature", "money/epi"])
def test_noise_gets_no_scale_of_its_own(runs: Runs, path: str) -> None:
    (curve,) = [curve for curve in GREENHOUSE.curves if curve.path == path]
    for size, is_noise in ((1e-125, True), (1e-3, False)):
        course = _course(runs.task_file, **{name: np.full(96, size) for name in curve.columns})
        values = _Layout(show_together(get_task(runs.task_file), [course]), live=False)._values(curve)
        assert (values == (-1.0, 1.0)) is is_noise


@pytest.mark.parametrize(
    "cone",
    [
        pytest.param([[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]], id="without red cones"),
        pytest.param([[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]], id="without green cones"),
        pytest.param([[1.256, -0.077, -0.179], [-0.078, 0.931, 0.148], [0.005, 0.691, 0.304]], id="without blue cones"),
    ],
)
def test_colours_stay_apart_for_colour_blind_eyes(cone: list[list[float]]) -> None:
    # How dichromats see a colour: Machado, Oliveira and Fernandes (2009), severity 1, in linear light.
    light = (np.array([colour.rgb for colour in PALETTE]) / 255.0) ** 2.2
    seen = np.clip(light @ np.array(cone).T, 0.0, 1.0) ** (1 / 2.2)
    distances = np.linalg.norm(seen[:, None] - seen[None, :], axis=-1)
    assert distances[np.triu_indices(len(PALETTE), 1)].min() > 0.15
