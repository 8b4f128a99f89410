"""The rules against independently computed points, by hand, and in the extremes."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glbench.agents import RuleInputs, RuleSettings, read_rule_settings, rule_controls
from glbench.agents.rules import privileged_inputs, smooth_action, within
from glbench.errors import ShapeError, SubmissionError

POINTS = np.load(Path(__file__).parents[1] / "golden" / "agents_rule_based_points.npz")
YAML = Path(__file__).parents[2] / "baselines" / "rule_based" / "rule_based.yml"
FIELDS = [field.name for field in dataclasses.fields(RuleInputs)]


@pytest.fixture
def dim_afternoon() -> RuleInputs:
    """One run at 14:00 of a dull day, 17 degC inside, well below every limit."""
    values = {
        "air_temperature": 17.0, "relative_humidity": 70.0, "co2": 500.0, "radiation": 100.0, "outdoor_temperature": 8.0,
        "day_radiation_sum": 4.0, "is_day": 1.0, "is_day_smooth": 1.0, "hour_of_day": 14.0, "day_of_year": 70.0,
    }  # fmt: skip
    return RuleInputs(**{name: np.array([value]) for name, value in values.items()})


def with_values(inputs: RuleInputs, **values: float) -> RuleInputs:
    return dataclasses.replace(inputs, **{name: np.array([value]) for name, value in values.items()})


def by_name(controls: np.ndarray) -> dict[str, float]:
    return dict(zip(("boiler", "co2", "screen", "vents", "lamps", "blackout"), controls[0].tolist(), strict=True))


@pytest.mark.parametrize(("rule", "oracle"), [("code", "u_glgym2"), ("author", "u_author")])
def test_both_published_variants_agree_with_the_oracle(published: RuleSettings, rule: str, oracle: str) -> None:
    settings = published.model_copy(update={"thermal_screen_rule": rule, "lamp_rule": rule})
    inputs = privileged_inputs(POINTS["x"], POINTS["d"], POINTS["hour"], POINTS["day_of_year"])
    np.testing.assert_allclose(rule_controls(inputs, settings), POINTS[oracle], rtol=0, atol=1e-12)


def test_the_variants_differ_in_the_thermal_screen_and_in_nothing_else(published: RuleSettings) -> None:
    author = published.model_copy(update={"thermal_screen_rule": "author", "lamp_rule": "author"})
    inputs = privileged_inputs(POINTS["x"], POINTS["d"], POINTS["hour"], POINTS["day_of_year"])
    change = np.abs(rule_controls(inputs, published) - rule_controls(inputs, author)).max(axis=0)
    assert change[2] > 0.9
    assert np.all(np.delete(change, 2) < 1e-12)


def test_the_lamp_rules_differ_only_when_humidity_may_switch_lamps_off(published: RuleSettings, dim_afternoon: RuleInputs) -> None:
    # Humidity limit 85 % + 0 %: at 95 % the code's rule switches off by day too, the author's only at night.
    code = published.model_copy(update={"blackout_extra_humidity": 0.0})
    author = code.model_copy(update={"lamp_rule": "author"})
    humid_day = with_values(dim_afternoon, relative_humidity=95.0, air_temperature=21.0)
    humid_night = with_values(humid_day, is_day=0.0, is_day_smooth=0.0)
    assert by_name(rule_controls(humid_day, code))["lamps"] < 0.01
    assert by_name(rule_controls(humid_day, author))["lamps"] > 0.99
    assert by_name(rule_controls(humid_night, author))["lamps"] < 0.01


def share_of_band(value: float, set_point: float, band: float) -> float:
    return float(smooth_action(np.array([value]) - set_point, 2.0 / band * np.log(100.0), band / 2.0, 0.0, 1.0)[0])


@pytest.mark.parametrize(("value", "expected"), [(20.0, 0.01), (21.0, 0.5), (22.0, 0.99)])
def test_the_band_begins_with_one_percent_and_ends_with_ninety_nine(value: float, expected: float) -> None:
    # 1/(1 + exp(-ln 100 * ...)): at the set point 1/(1 + 100) = 0.0099, in the middle 1/2, at the end 100/101 = 0.990.
    assert share_of_band(value, 20.0, 2.0) == pytest.approx(expected, abs=2e-4)


@given(st.floats(-1e6, 1e6), st.floats(-1e4, 1e4), st.sampled_from([-100.0, -1.0, -0.5, 1e-3, 4.0]))
def test_no_distance_from_the_set_point_overflows(value: float, set_point: float, band: float) -> None:
    with np.errstate(all="raise", under="ignore"):
        share = share_of_band(value, set_point, band)
    assert 0.0 <= share <= 1.0


def test_windows_exclude_their_ends_and_go_over_midnight() -> None:
    hours = np.array([0.0, 0.25, 12.0, 18.0, 20.0, 23.75])
    assert within(0.0, 18.0, hours).tolist() == [0, 1, 1, 0, 0, 0]
    assert within(20.0, 6.0, hours).tolist() == [1, 1, 0, 0, 0, 1]


def test_a_dim_cool_afternoon_is_heated_lit_and_given_co2(published: RuleSettings, dim_afternoon: RuleInputs) -> None:
    asked = by_name(rule_controls(dim_afternoon, published))
    assert min(asked["boiler"], asked["co2"], asked["lamps"]) > 0.99
    assert max(asked["vents"], asked["screen"], asked["blackout"]) < 0.01


@pytest.mark.parametrize(
    "change",
    [{"hour_of_day": 0.0}, {"hour_of_day": 18.0}, {"radiation": 400.0}, {"day_radiation_sum": 10.0}, {"air_temperature": 28.0}],
    ids=["first instant of the day", "end of the lamp hours", "sun", "bright day", "heat"],
)
def test_lamps_are_off(published: RuleSettings, dim_afternoon: RuleInputs, change: dict[str, float]) -> None:
    assert by_name(rule_controls(with_values(dim_afternoon, **change), published))["lamps"] < 1e-4


def test_the_blackout_screen_follows_the_lamps_at_night_and_can_be_absent(published: RuleSettings, dim_afternoon: RuleInputs) -> None:
    night = with_values(dim_afternoon, is_day=0.0, is_day_smooth=0.0, hour_of_day=4.0)
    asked = by_name(rule_controls(night, published))
    assert asked["blackout"] == asked["lamps"] > 0.99
    without = published.model_copy(update={"blackout_screen": False})
    assert by_name(rule_controls(night, without))["blackout"] == 0.0


def test_a_hot_humid_greenhouse_is_vented_unless_it_is_too_cold_to_open(published: RuleSettings, dim_afternoon: RuleInputs) -> None:
    humid = {"relative_humidity": 95.0}
    assert by_name(rule_controls(with_values(dim_afternoon, air_temperature=30.0), published))["vents"] > 0.9
    assert by_name(rule_controls(with_values(dim_afternoon, air_temperature=20.0, **humid), published))["vents"] > 0.9
    assert by_name(rule_controls(with_values(dim_afternoon, air_temperature=17.0, **humid), published))["vents"] < 0.01


@pytest.mark.parametrize(("on", "off", "hour", "boiler"), [(20.0, 6.0, 2.0, 1.0), (20.0, 6.0, 12.0, 0.0), (6.0, 6.0, 6.0, 0.0)])
def test_the_lamp_climate_follows_windows_over_midnight_and_empty_ones(
    published: RuleSettings, dim_afternoon: RuleInputs, on: float, off: float, hour: float, boiler: float
) -> None:
    # 18 degC lies between the set points: heated in the lamp climate (19.5 degC), not heated at night (16.5 degC).
    settings = published.model_copy(update={"lamps_on": on, "lamps_off": off})
    inputs = with_values(dim_afternoon, is_day=0.0, is_day_smooth=0.0, hour_of_day=hour, air_temperature=18.0)
    assert by_name(rule_controls(inputs, settings))["boiler"] == pytest.approx(boiler, abs=0.01)


def test_a_run_gets_the_same_bits_alone_and_in_a_batch(published: RuleSettings) -> None:
    x, d, hour, day = (POINTS[name] for name in ("x", "d", "hour", "day_of_year"))
    together = rule_controls(privileged_inputs(x, d, hour, day), published)
    for size in (1, 2, 3, 7, 33):
        parts = [
            rule_controls(privileged_inputs(*(values[i : i + size] for values in (x, d, hour, day))), published)
            for i in range(0, len(x), size)
        ]
        assert np.array_equal(np.concatenate(parts), together)


def test_one_disturbance_row_serves_all_runs_of_the_same_weather() -> None:
    shared = privileged_inputs(POINTS["x"][:3], POINTS["d"][0], 5.0, 60.0)
    each = privileged_inputs(POINTS["x"][:3], np.tile(POINTS["d"][0], (3, 1)), 5.0, 60.0)
    assert all((getattr(shared, name) == np.broadcast_to(getattr(each, name), 3)).all() for name in FIELDS)


def test_weather_shared_by_all_runs_gives_each_the_bits_of_its_own(published: RuleSettings) -> None:
    for d, hour, day in zip(POINTS["d"], POINTS["hour"].tolist(), POINTS["day_of_year"].tolist(), strict=True):
        x = POINTS["x"][:5]
        shared = rule_controls(privileged_inputs(x, d, hour, day), published)
        each = privileged_inputs(x, np.tile(d, (5, 1)), np.full(5, hour), np.full(5, day))
        assert shared.tobytes() == rule_controls(each, published).tobytes()


def test_states_of_another_shape_are_refused() -> None:
    with pytest.raises(ShapeError, match=r"states of shape \(n, 28\).*got \(28,\) and \(10,\)"):
        privileged_inputs(POINTS["x"][0], POINTS["d"][0], 0.0, 0.0)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda text: text.replace("heating_day: 19.5", "heating_dya: 19.5"), r"no setting 'heating_dya'\. Did you mean 'heating_day'"),
        (lambda text: text.replace("heating_day: 19.5", ""), "'heating_day' is missing"),
        (lambda text: text.replace("heating_band: -1.0", "heating_band: 0"), "'heating_band'.*width 0"),
        (lambda text: text.replace("lamps_off: 18.0", "lamps_off: 25"), "'lamps_off' is 25; it must be from 0 to 24"),
        (lambda text: text.replace("heating_day: 19.5", "heating_day: 48"), "'heating_day' is 48 degC; it must be from 0 to 30 degC"),
        (lambda text: text.replace("co2_day: 800.0", "co2_day: 8000"), "'co2_day' is 8000 ppm; it must be from 0 to 1600 ppm"),
        (lambda text: text.replace("heating_day: 19.5", "heating_day: warm"), "'heating_day'.*number"),
        (lambda text: text.replace("lamp_rule: code", "lamp_rule: mine"), "'lamp_rule'.*'code' or 'author'"),
        (lambda text: "- 1\n- 2\n", "name: value"),
        (lambda text: "a: [", "not valid YAML"),
    ],
)  # fmt: skip
def test_settings_that_make_no_sense_are_explained(write, change, complaint) -> None:  # type: ignore[no-untyped-def]
    path = write("rules.yml", change(YAML.read_text(encoding="utf-8")))
    with pytest.raises(SubmissionError, match=complaint) as caught:
        read_rule_settings(path)
    assert str(path) in str(caught.value)


def test_missing_settings_are_explained(tmp_path: Path) -> None:
    with pytest.raises(SubmissionError, match=r"Cannot read the rule settings .*none\.yml"):
        read_rule_settings(tmp_path / "none.yml")
