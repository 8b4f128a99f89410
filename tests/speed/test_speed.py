"""The speed measurements measure what they say. None of these tests judges a time."""

from __future__ import annotations

import signal

import numpy as np
import pytest
from typer.testing import CliRunner

from glbench.cli.app import app
from glbench.errors import GlbenchError, ResultError, UnknownNameError
from glbench.speed import SUBJECTS, choose_subjects, measure, read_record, save_record
from glbench.speed.run import _PEAK, Comparisons, Reference, Timed, _run
from glbench.speed.subjects import GROUPS, LARGEST_CHANGE, Points, Season, Subject, controls_of, points, season


class Ticks:
    """A clock that work moves on by hand."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


class FixedReference:
    """Takes two seconds for each of its five steps."""

    compiled = True

    def __init__(self, ticks: Ticks) -> None:
        self.ticks = ticks

    def scattered(self, _points):
        def work() -> int:
            self.ticks.now += 10.0
            return 5

        return work


def test_a_ratio_is_reference_over_subject_for_one_step(monkeypatch):
    ticks = Ticks()
    monkeypatch.setattr("glbench.speed.run.timed", lambda work: Timed(work, 3, ticks))

    def half_a_second_a_step() -> int:
        ticks.now += 2.0
        return 4

    subject = Subject("step/x", "x", lambda: half_a_second_a_step)
    found = Comparisons({900.0: FixedReference(ticks)}, rounds=3).compare(subject)
    assert found.ratio == found.ratio_low == found.ratio_high == pytest.approx(4.0)
    assert found.microseconds == pytest.approx(0.5e6)
    assert found.steps_per_second == pytest.approx(2.0)


def test_every_subject_has_a_name_of_its_own_and_a_known_group():
    names = [one.name for one in SUBJECTS]
    assert len(set(names)) == len(names)
    assert {one.group for one in SUBJECTS} == set(GROUPS)


def test_subjects_are_chosen_by_group_or_name_and_unknown_ones_named():
    assert {one.group for one in choose_subjects(["vector"])} == {"vector"}
    assert [one.name for one in choose_subjects(["rows/64"])] == ["rows/64"]
    with pytest.raises(UnknownNameError, match="vector"):
        choose_subjects(["vectr"])


def test_walking_controls_stay_within_bounds_and_change_little():
    controls = controls_of("walk", 500, seed=3)
    assert controls.min() >= 0.0
    assert controls.max() <= 1.0
    assert np.abs(np.diff(controls, axis=0)).max() <= LARGEST_CHANGE + 1e-12


def test_jumping_controls_are_open_or_closed():
    assert set(np.unique(controls_of("jump", 100, seed=3))) == {0.0, 1.0}


def test_points_are_states_of_real_seasons_in_all_months():
    chosen = points("walk", 900.0, 64)
    assert chosen.x.shape == (64, 28)
    assert chosen.d[:, 1].min() < 5.0  # degC: winter
    assert chosen.d[:, 1].max() > 18.0  # degC: summer


def test_the_setting_of_the_paper_is_ten_days_of_300_s():
    import datetime as dt

    assert len(season("walk", 300.0, dt.date(2009, 10, 1), 10.0).controls) == 2880


@pytest.mark.slow
def test_a_measurement_is_saved_and_read_again(tmp_path):
    record = measure(choose_subjects(["rows/64"]), rounds=1, processes=False)
    assert record.find("rows/64").ratio > 0.0
    save_record(record, tmp_path / "speed.json")
    assert read_record(tmp_path / "speed.json") == record


def test_a_file_that_is_no_record_is_refused_with_the_command_that_makes_one(tmp_path):
    (tmp_path / "speed.json").write_text("{}")
    with pytest.raises(ResultError, match="glbench bench"):
        read_record(tmp_path / "speed.json")


def test_the_peak_memory_of_a_process_is_its_own_and_not_its_parents():
    held = np.ones(25_000_000)  # 200 MB that a plain interpreter does not need
    assert _run(f"{_PEAK}\nprint(peak())") < held.nbytes / 2**20 / 2


@pytest.mark.parametrize("name", ["scattered", "season"])
def test_an_interruption_waits_for_the_reference(name):
    """CVODES would report it as a step that it cannot integrate."""
    steps = []

    def integrator(**_inputs):
        if not steps:
            signal.raise_signal(signal.SIGINT)
        steps.append(1)
        return {"xf": 0.0}

    rows = np.zeros((5, 1))
    reference = Reference(integrator, compiled=False)
    work = reference.scattered(Points(rows, rows, rows)) if name == "scattered" else reference.season(Season(rows, rows, np.zeros(1)))
    with pytest.raises(KeyboardInterrupt):
        work()
    assert len(steps) == (5 if name == "scattered" else 1), "a long season ends with the current step"


def test_a_folder_for_the_figures_is_refused_before_anything_is_measured(tmp_path, monkeypatch):
    monkeypatch.setattr("glbench.speed.measure", lambda *_, **__: pytest.fail("measured"))
    (tmp_path / "folder.json").mkdir()
    (tmp_path / "file").write_text("", encoding="utf-8")
    for out, words in ((".", "should end with .json"), ("folder.json", "is a folder"), ("file/speed.json", "Cannot write into")):
        done = CliRunner().invoke(app, ["bench", "step", "--out", str(tmp_path / out)])
        assert isinstance(done.exception, GlbenchError)
        assert words in str(done.exception)
