"""Pictures of runs show what the record holds, within the task's limits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

pytest.importorskip("matplotlib", reason="matplotlib is not installed: no pictures")
from matplotlib.colors import to_hex

from glbench.episodes import Episode, plots, read, read_episode
from glbench.errors import EpisodeError


@pytest.fixture(scope="module")
def episode(episode_file: Path) -> Episode:
    return read_episode(episode_file)


def renamed(episode: Episode, agent: str) -> Episode:
    facts = episode.provenance.agent.model_copy(update={"name": agent})
    return replace(episode, provenance=episode.provenance.model_copy(update={"agent": facts}))


def test_the_climate_lies_over_its_limits(episode: Episode) -> None:
    figure = plots.climate(episode)
    shown = {axes.get_ylabel().partition("\n")[0]: axes for axes in figure.axes}
    assert list(shown) == ["Air temperature", "Relative humidity", "CO₂"]
    np.testing.assert_array_equal(shown["CO₂"].lines[0].get_ydata(), episode["co2"])
    (band,) = shown["CO₂"].patches
    limits = episode.task().constraints.co2
    assert (band.get_y(), band.get_y() + band.get_height()) == pytest.approx((limits.low, limits.high))
    assert figure.axes[-1].get_xlabel() == "time (UTC)"


def test_controls_are_steps_from_the_start_of_each_step(episode: Episode) -> None:
    figure = plots.controls(episode)
    line = figure.axes[0].lines[0]
    assert line.get_drawstyle() == "steps-post"
    np.testing.assert_array_equal(pd.to_datetime(line.get_xdata()), pd.to_datetime(episode.times[:-1]))
    assert len(figure.axes) == len(episode.task().model_value.control_names)


def test_days_cut_the_run_and_runs_of_other_seasons_share_the_day(episode: Episode) -> None:
    later = replace(renamed(episode, "later"), times=episode.times + np.timedelta64(365, "D"))
    figure = plots.climate(episode, later, days=(0.25, 0.5))
    first, second = figure.axes[0].lines
    assert len(first.get_xdata()) == episode.steps // 4
    np.testing.assert_array_equal(first.get_xdata(), second.get_xdata())
    assert first.get_xdata()[0] > 0.25
    assert first.get_xdata()[-1] == 0.5
    assert figure.axes[-1].get_xlabel() == "day of the run"
    assert to_hex(first.get_color()) != to_hex(second.get_color())
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["wavy", "later"]
    with pytest.raises(EpisodeError, match="no step between day 5 and day 6; the first has 1 days"):
        plots.climate(episode, days=(5.0, 6.0))


def test_money_is_summed_and_ends_at_the_metric(episode: Episode) -> None:
    figure = plots.money(episode, renamed(episode, "other"))
    assert [axes.get_title() for axes in figure.axes] == ["wavy", "other"]
    total, *parts = figure.axes[0].lines
    assert total.get_ydata()[-1] == pytest.approx(episode["epi"].sum())
    labels = [line.get_label() for line in parts]
    assert any("heat" in label.lower() for label in labels)
    assert not any("summed" in label for label in labels)


def test_a_typical_day_is_the_mean_of_all_days_at_an_hour(episode: Episode) -> None:
    twice = replace(
        episode,
        times=np.concatenate([episode.times, episode.times[1:] + np.timedelta64(1, "D")]),
        tables={name: np.concatenate([table, table + 1.0 * (name == "climate")]) for name, table in episode.tables.items()},
    )
    axes = plots.typical_day(twice).axes[0]
    line = axes.lines[0]
    order = np.argsort(episode["hour_of_day"])
    np.testing.assert_allclose(line.get_xdata(), np.round(episode["hour_of_day"][order], 6))
    np.testing.assert_allclose(line.get_ydata(), episode["air_temperature"][order] + 0.5)
    controls = next(one for one in plots.typical_day(episode).axes if "Vent" in one.get_title() or "vent" in one.get_title())
    assert controls.lines[0].get_xdata()[0] == 0.0  # what acts from midnight on


def test_a_notebook_gets_a_picture_always_the_same(episode: Episode) -> None:
    first, again = (plots.climate(episode)._repr_png_() for _ in range(2))
    assert first.startswith(b"\x89PNG")
    assert first == again


def test_no_episode_and_two_tasks_are_refused(episode: Episode) -> None:
    with pytest.raises(EpisodeError, match="There is no episode to draw"):
        plots.money()
    other = episode.provenance.task.model_copy(update={"id": "test/Other-v1"})
    of_other = replace(episode, provenance=episode.provenance.model_copy(update={"task": other}))
    with pytest.raises(EpisodeError, match=r"these are of test/Day-v1, test/Other-v1"):
        plots.climate(episode, of_other)


def test_a_table_by_time(episode_file: Path, episode: Episode) -> None:
    by_time, by_step = read(episode_file, by="time"), read(episode_file)
    assert by_time.index.name == "time"
    assert str(by_time.index.tz) == "UTC"
    np.testing.assert_array_equal(by_time.index.tz_localize(None).to_numpy(), episode.times[1:])
    pd.testing.assert_frame_equal(by_time.reset_index(drop=True), by_step.reset_index(drop=True))
    assert by_time.attrs == by_step.attrs
    assert by_time.attrs["units"]["co2"] == "ppm"
    with pytest.raises(EpisodeError, match="indexed by 'step' or by 'time'; got 'hour'"):
        episode.to_frame("hour")  # type: ignore[arg-type]
