"""Records and viewer of another crop, whose runs have seasons of their own; and that nothing of the tomatoes is different."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from glbench.env import Simulation, run_weather
from glbench.episodes import (
    Episode,
    actions_path,
    episode_bytes,
    episode_path,
    episodes_folder,
    read,
    read_episode,
    read_log,
    recover,
    replayed_episodes,
)
from glbench.episodes.recorder import Trace, bytes_a_step
from glbench.episodes.rerun_recording import card, local, save_recording, show_together, shown_of
from glbench.episodes.signals import signals_of
from glbench.errors import EpisodeError, GlbenchError, TaskError
from glbench.evaluation import evaluate, result_path
from glbench.model import get_model
from glbench.tasks import TaskSpec, get_task
from tests.episodes.day import RANDOM, write_lettuce_task
from tests.episodes.rerun_runs import read_recording
from tests.evaluation.agent_files import agent_writer

PUBLISHED = "Schiphol2010-Delta10-v1"
RECORDED_OF_TOMATOES = "d499ece3b539a4b7"
DRAWN_OF_TOMATOES = "0f449677790a2695"


@dataclass(frozen=True)
class Lettuce:
    task: TaskSpec
    result: Path
    files: tuple[Path, ...]

    @property
    def episodes(self) -> list[Episode]:
        return [read_episode(file) for file in self.files]


@pytest.fixture(scope="module")
def lettuce(tmp_path_factory: pytest.TempPathFactory) -> Lettuce:
    """Three recorded runs of three days."""
    folder = tmp_path_factory.mktemp("lettuce")
    task = get_task(write_lettuce_task(folder, days=3))
    result = evaluate(task, agent_writer(folder)(RANDOM, "wavy"), out=folder, episodes="all")
    path = result_path(folder, task.id, "wavy")
    return Lettuce(task, path, tuple(episode_path(episodes_folder(path), run.seed) for run in result.runs))


def test_a_record_has_the_columns_and_units_of_its_own_model(lettuce: Lettuce) -> None:
    frame = read(lettuce.files[0])
    model = get_model("greenlight-lettuce-1.0.0")
    assert set(model.state_names) < set(frame.columns)
    assert not [name for name in frame.columns if "fruit" in name.lower() or name == "cLeaf"]
    units = frame.attrs["units"]
    assert [units[name] for name in ("xN", "head", "leaf_area_index", "heads_gained")] == [
        "kg m-2", "g", "m2 m-2", "m-2",
    ]  # fmt: skip
    groups = {group.name: group.names for group in lettuce.episodes[0].groups}
    assert groups["crop"] == ("tCan", "xN", "xS")
    assert groups["derived"] == (
        *("par_today", "radiation_today", "head", "leaf_area_index"),
        *("vapour_pressure_deficit", "humidity_deficit"),
    )
    assert 2.0 < frame.attrs["start"]["derived"]["head"] < 4.0
    # 24 states of the model, six meters of violations
    assert bytes_a_step(lettuce.task) == 8 * (30 + 6 + 3 + len(lettuce.task.quantities))


def test_what_is_derived_follows_from_the_recorded_states(lettuce: Lettuce) -> None:
    episode = lettuce.episodes[0]
    model, nominal = lettuce.task.model_value, lettuce.task.parameters()
    head = next(signal for signal in model.signals() if signal.path == "crop/head")
    assert head.of is not None
    again = head.of(model.State(*episode.states.T), model.Parameters(*nominal.tolist()))
    assert np.asarray(again)[1:].tobytes() == np.ascontiguousarray(episode["head"]).tobytes()


def test_deficits_and_light_of_a_record_follow_from_its_other_columns(lettuce: Lettuce) -> None:
    episode = lettuce.episodes[1]
    temperature, humidity = episode["air_temperature"], episode["relative_humidity"]
    lacking = 610.78 * np.exp(17.2694 * temperature / (temperature + 238.3)) * (1.0 - humidity / 100.0)
    assert np.allclose(episode["vapour_pressure_deficit"], lacking / 1000.0, rtol=1e-12)
    assert np.allclose(episode["humidity_deficit"], lacking * 18.01528 / (8.3144598 * (temperature + 273.15)), rtol=1e-12)
    hours, sun = episode["hour_of_day"], 0.0
    weather = run_weather(lettuce.task, episode.run.seed)
    assert hours.tolist() == weather.hour_of_day[1 : episode.steps + 1].tolist()
    for step in range(episode.steps):
        sun = 0.0 if hours[step] == 0.0 else sun + episode["iGlob"][step] * 3600.0 / 1e4
        assert episode["radiation_today"][step] == pytest.approx(sun, rel=1e-12)
    assert episode["par_today"].max() > 1.0
    assert episode.start["derived"][:2].tolist() == [0.0, 0.0]


def test_the_light_of_a_record_is_what_agents_observe(tmp_path: Path) -> None:
    more = (('"weather_forecast"]', '"weather_forecast", "vapour_deficit", "light_today"]'),)
    task = get_task(write_lettuce_task(tmp_path, days=2, more=more)).replace(sensors=None)
    simulation = Simulation(task, 1, "fast")
    simulation.reset([10000])
    trace, observed = Trace(simulation), []
    for action in np.random.default_rng(1).uniform(-0.2, 0.6, (task.steps, 1, 6)):
        trace.add(simulation, simulation.step(action))
        observed.append(simulation.observe()[0, -4:])
    weather, signals = run_weather(task, 10000), signals_of(task)
    derived = signals.derived(
        {
            "control": trace.u[:, 0], "disturbance": weather.values[: task.steps], "air": trace.air[:, :, 0], "state": trace.x[:, 0],
            "clock": weather.hour_of_day[: task.steps + 1, None],
        }
    )  # fmt: skip
    names = [one.name for one in signals.vector("derived")]
    columns = [quantity.name for quantity in task.observed()][-4:]
    shown = derived[1:, [names.index(name) for name in columns]].astype(np.float32)
    assert shown[:, 2:].tobytes() == np.array(observed)[:, 2:].tobytes()  # sums, to the bit
    assert np.allclose(shown[:, :2], np.array(observed)[:, :2], rtol=1e-6)  # numpy's exp is not the C library's


def test_records_of_earlier_versions_are_shown_without_what_they_lack(lettuce: Lettuce) -> None:
    whole = shown_of(lettuce.episodes[:1])
    trajectory = whole.trajectories[0]
    later = ("vapour_pressure_deficit", "par_today", "hour_of_day")
    earlier = replace(trajectory, columns={k: v for k, v in trajectory.columns.items() if k not in later})
    shown = show_together(lettuce.task, [earlier])
    paths = {curve.path for curve in shown.signals.curves}
    assert {curve.path for curve in whole.signals.curves} - paths == {"climate/vapour_pressure_deficit", "climate/par_today"}
    assert shown.signals.overview == whole.signals.overview
    assert "clock" not in card(shown)
    without = replace(trajectory, columns={k: v for k, v in trajectory.columns.items() if k != "co2"})
    with pytest.raises(GlbenchError, match="lacks co2"):
        show_together(lettuce.task, [without])


def test_the_clock_that_changes_is_told_with_its_day(lettuce: Lettuce) -> None:
    trajectory = shown_of(lettuce.episodes[:1]).trajectories[0]
    times = np.datetime64("2010-03-27T23:00", "ns") + np.arange(5) * np.timedelta64(1, "h")
    columns = {name: values[:4] for name, values in trajectory.columns.items()}
    columns["hour_of_day"] = np.array([1.0, 3.0, 4.0, 5.0])  # the ends of the steps; summer time begins at 1 o'clock UTC
    changed = replace(trajectory, times=times, columns=columns)
    assert "clock is UTC+1 h, from 28 March on UTC+2 h." in card(show_together(lettuce.task, [changed]))
    moments = local(changed, "hour_of_day")
    assert moments is not None
    assert [str(moment)[:16] for moment in moments] == [
        *("2010-03-28T00:00", "2010-03-28T01:00", "2010-03-28T03:00", "2010-03-28T04:00", "2010-03-28T05:00"),
    ]  # fmt: skip


def test_the_card_tells_how_far_the_clock_of_the_place_is_ahead(lettuce: Lettuce) -> None:
    assert "times are UTC, the greenhouse's clock is UTC+1 h." in card(shown_of(lettuce.episodes[:1]))


def test_the_times_and_the_weather_of_a_record_are_those_of_its_run(lettuce: Lettuce) -> None:
    starts = set()
    for episode in lettuce.episodes:
        weather = run_weather(lettuce.task.scored, episode.run.seed)
        assert (episode.times == weather.times[: episode.steps + 1]).all()
        assert episode.tables["weather"].tobytes() == weather.values[: episode.steps].tobytes()
        starts.add(str(episode.times[0]))
    assert len(starts) == 3


def test_a_replay_in_another_split_than_the_records_is_refused(lettuce: Lettuce) -> None:
    log = read_log(actions_path(lettuce.result))
    with pytest.raises(EpisodeError, match=r"other rewards than recorded.*log\.task\(\)\.scored"):
        list(replayed_episodes(log.task(), log, range(1)))


def test_a_record_is_recovered_and_replayed_to_the_bit(lettuce: Lettuce, tmp_path: Path) -> None:
    data = lettuce.files[0].read_bytes()
    (tmp_path / "torn.mcap").write_bytes(data[: len(data) * 2 // 3])
    left = recover(tmp_path / "torn.mcap", tmp_path / "left.mcap")
    whole = lettuce.episodes[0]
    assert 0 < left.steps < whole.steps
    assert read_episode(tmp_path / "left.mcap").states.tobytes() == whole.states[: left.steps + 1].tobytes()
    log = read_log(actions_path(lettuce.result))
    assert log.final_states.shape == (3, 30)
    for file, episode in zip(lettuce.files, replayed_episodes(log.task().scored, log, range(3)), strict=True):
        assert episode_bytes(episode) == file.read_bytes()
        assert episode.provenance.versions["model"] == "greenlight-lettuce-judged-1.0.0"


def test_the_viewer_speaks_of_heads_and_not_of_fruit(lettuce: Lettuce) -> None:
    shown = shown_of(lettuce.episodes[:1])
    headings = [curve.heading for curve in shown.signals.curves]
    assert {"Fresh mass of a head [g]", "Leaf area index [m² m⁻²]", "Revenue of the heads at full price, summed [EUR m⁻²]"} <= set(headings)
    assert "crop/head" in shown.signals.overview[0]
    words = card(shown)
    assert "heads at full price 0.4 EUR each; CO₂ 0.08 EUR/kg; lamp electricity 0.04 to 0.08 EUR/kWh; heat 0.03 EUR/kWh" in words
    assert "heads at full price per m²" in words
    assert not [text for text in (words, *headings) if "fruit" in text.lower() or "tomato" in text.lower()]


def test_runs_of_several_seasons_are_drawn_on_the_dates_of_the_first(lettuce: Lettuce, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="the viewer (rerun-sdk) is not installed")
    episodes = lettuce.episodes
    shown = shown_of(episodes)
    assert all((one.times == episodes[0].times).all() for one in shown.trajectories)
    for one, episode in zip(shown.trajectories, episodes, strict=True):
        midnight = episode.times[0].astype("datetime64[h]").item()
        assert one.began is not None
        assert 0 < (np.datetime64(one.began, "h") - np.datetime64(midnight, "h")).astype(int) <= 2  # of the Dutch clock
        assert f"seed {one.seed}, from {one.began:%-d %B %Y}" in card(shown)
    save_recording(shown, tmp_path / "runs.rrd")
    curves = read_recording(tmp_path / "runs.rrd").curves
    for label, episode in zip(shown.labels, episodes, strict=True):
        found = next(curve for path, curve in curves.items() if path.startswith("/weather/temperature/") and str(episode.run.seed) in path)
        assert found.values.tobytes() == np.ascontiguousarray(episode["tOut"]).tobytes(), label


def test_two_columns_of_a_record_cannot_have_one_name(tmp_path: Path) -> None:
    more = (('flow = "co2_dosed"', 'flow = "co2_dosed"\namount = "co2"'),)
    task = get_task(write_lettuce_task(tmp_path, days=3, more=more))
    with pytest.raises(TaskError, match="'co2' is the name of two columns of a record"):
        signals_of(task)


def test_what_is_recorded_and_drawn_of_tomatoes_stays_as_it_was() -> None:
    signals = signals_of(get_task(PUBLISHED))
    added = {one.name for one in signals.recorded if one.group in ("clock", "derived")}  # of a later version, beside what was there
    assert added == {*("hour_of_day", "par_today", "radiation_today"), *("vapour_pressure_deficit", "humidity_deficit")}
    recorded = [(one.group, one.name, one.unit, one.meaning, one.source, one.index) for one in signals.recorded if one.name not in added]
    drawn = [
        (page.title, c.path, c.title, c.unit, c.columns, c.form, c.factor, c.moment, c.limits, c.shared, c.slow, c.span)
        for page in signals.pages
        for c in page.curves
        if added.isdisjoint(c.columns)
    ]
    assert _digest(recorded) == RECORDED_OF_TOMATOES
    assert _digest([*drawn, signals.overview, signals.prices]) == DRAWN_OF_TOMATOES


def _digest(rows: list[tuple[object, ...]]) -> str:
    return hashlib.sha256(repr(rows).encode()).hexdigest()[:16]


def test_days_are_chosen_on_the_greenhouses_clock(lettuce: Lettuce) -> None:
    shown = shown_of(lettuce.episodes[:1])
    clock = local(shown.longest, shown.signals.clock)
    assert clock is not None
    first, second, last = (clock[step].astype("datetime64[D]").item() for step in (0, 24, -1))
    start, end = replace(shown, first_day=second, days=1).closeup()
    assert (start, end) == (shown.times[24], shown.times[48])
    assert replace(shown, first_day=first, days=1).closeup() == (shown.times[0], shown.times[24])
    with pytest.raises(GlbenchError, match=f"{last} is not a day of what is shown, which lasts from {first} to {last}"):
        replace(shown, first_day=last).closeup()


def test_the_card_tells_the_score_with_its_unit(lettuce: Lettuce) -> None:
    shown = shown_of(lettuce.episodes[:1])
    assert f"score {shown.longest.columns['reward'].sum():.2f} EUR/m²" in card(shown)
