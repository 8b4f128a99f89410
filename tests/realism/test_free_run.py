"""The free run: what drives it, lanes side by side, and its errors."""

from __future__ import annotations

import dataclasses
import datetime as dt

import numpy as np
import pytest

from glbench.errors import ArchiveError, StepError
from glbench.kernel import Kernel
from glbench.model import TOMATO_2, relative_humidity
from glbench.realism.free_run import CHANNELS, drive, free_run
from glbench.realism.houses import model
from glbench.realism.identify import make_split
from glbench.realism.season import young_crop
from tests.realism.measured import BASE, FIRST, HOUSE, NOISE, SETTINGS, changed, indoor, outside, season

GREENLIGHT = model(HOUSE.model)
SPLIT = dt.date(2020, 1, 15)


def with_columns(days: int, **columns: object) -> object:
    made = indoor(days)
    return dataclasses.replace(made, columns={**made.columns, **columns})


def test_controls_follow_the_actuators() -> None:
    made = drive(indoor(2), outside(2), FIRST)
    noon, night = 2 * 12, 2 * 2
    assert made.step_seconds == 1800.0
    assert made.shares["uVent"][noon] == pytest.approx((20.0 + 0.0) / 200.0)
    assert made.shares["uVent"][noon + 48] == pytest.approx((30.0 + 10.0) / 200.0), "lee and wind count as their mean"
    assert (made.shares["uThScr"][noon], made.shares["uThScr"][night]) == (0.0, 1.0)
    assert made.dose[noon] == pytest.approx(0.004e6 / 3600.0)
    assert np.isnan(made.pipes["tGroPipe"][noon])
    assert made.pipes["tGroPipe"][night] == 35.0


def test_an_actuator_without_reading_keeps_its_last_one() -> None:
    lamps = indoor(1).columns["lamps"].copy()
    lamps[2 * 10 : 2 * 20] = np.nan  # they go off at 14 h
    lamps[:2] = np.nan
    made = drive(with_columns(1, lamps=lamps, vents_wind=np.full(48, np.nan)), outside(1), FIRST)
    assert np.all(made.lamps[2 * 10 : 2 * 20] == 143.0)
    assert np.all(made.lamps[:2] == 0.0)
    assert np.all(made.lamps[2 * 20 :] == 0.0)
    assert made.shares["uVent"][24] == 0.2, "one vent counts alone"


def test_a_step_is_that_of_the_kernel_with_the_measured_pipes() -> None:
    made = drive(indoor(1), outside(1), FIRST)
    run = free_run(GREENLIGHT, BASE, made, SETTINGS.plants, steps=3)
    x = young_crop(GREENLIGHT, made.weather[0], BASE, SETTINGS.plants, 19.0)
    assert run.climate["air_temperature"][0, 0] == 19.0
    for step in range(2):
        x[GREENLIGHT.state_index("tPipe")] = made.pipes["tPipe"][step]
        x[GREENLIGHT.state_index("tGroPipe")] = 35.0
        u = dict.fromkeys(GREENLIGHT.control_names, 0.0) | {name: share[step] for name, share in made.shares.items()}
        x = Kernel(GREENLIGHT, 1800.0, preset="fast").step(x, list(u.values()), made.weather[step], BASE)
    assert run.climate["air_temperature"][2, 0] == x[GREENLIGHT.state_index("tAir")]
    assert run.climate["humidity"][2, 0] == relative_humidity(x[GREENLIGHT.state_index("tAir")], x[GREENLIGHT.state_index("vpAir")])
    assert len(run.climate["co2"]) == 3


def test_a_set_has_the_same_bits_alone_and_beside_others() -> None:
    made = drive(indoor(2), outside(2), FIRST)
    others = np.stack([BASE, changed(cLeakage=3.0), changed(thetaLampMax=2.0)])
    together = free_run(GREENLIGHT, others, made, SETTINGS.plants)
    for lane, p in enumerate(others):
        alone = free_run(GREENLIGHT, p, made, SETTINGS.plants)
        for channel in CHANNELS:
            assert np.array_equal(together.climate[channel][:, lane], alone.climate[channel][:, 0])
    first, leaky, dim = np.moveaxis(together.climate["air_temperature"], 1, 0)
    assert leaky.mean() < first.mean() - 0.1
    assert np.abs(dim - first).max() < 0.5, "twice the lamps at half their share are the measured power"


def test_errors_are_told_apart_by_week_month_hour_and_date() -> None:
    true = season(16, BASE)
    run = free_run(GREENLIGHT, np.stack([BASE, changed(cLeakage=10.0)]), true, SETTINGS.plants)
    table, whole, split = run.table(), run.errors(), make_split(true, f"date:{SPLIT}")
    for channel, noise in NOISE.items():
        assert whole[channel].rmse == pytest.approx(noise, rel=0.1), "what is left is the sensors' noise"
        assert abs(whole[channel].bias) < 0.2 * noise
    assert whole["humidity"].readings == whole["co2"].readings - 40
    assert table["months"] == {"2020-01": whole}
    assert (split.fitted, split.test) == ("before 2020-01-15", "from 2020-01-15")
    assert [run.errors(0, steps)["co2"].readings for steps in (split.steps, ~split.steps)] == [9 * 48, 7 * 48]
    assert [one["co2"].readings for one in table["weeks"].values()] == [9 * 48, 7 * 48]
    assert list(table["hours"])[:2] == ["0-3", "3-6"]
    assert [one["co2"].readings for one in table["hours"].values()] == [3 * 32] * 8
    leaky = free_run(GREENLIGHT, changed(cLeakage=10.0), true, SETTINGS.plants).errors()
    assert leaky["air_temperature"].bias < -0.5
    assert leaky["air_temperature"].rmse > 2.0 * whole["air_temperature"].rmse


def test_what_cannot_be_run_is_refused() -> None:
    made = drive(indoor(2), outside(2), FIRST)
    with pytest.raises(ArchiveError, match=r"Made: the climate has 96 rows and the weather 144 steps"):
        drive(indoor(2), outside(3), FIRST)
    with pytest.raises(ArchiveError, match=r"Made: no plausible reading of humidity, so nothing can be compared. Check the unit"):
        drive(with_columns(2, humidity=np.full(96, np.nan)), outside(2), FIRST)
    with pytest.raises(ArchiveError, match=r"lamps took up to 143 W/m2 \(thetaLampMax\), but the parameter set has 71.5"):
        free_run(GREENLIGHT, changed(thetaLampMax=0.5), made, SETTINGS.plants)
    with pytest.raises(ArchiveError, match=r"Up to 1\.111 mg/m2/s CO2 was dosed \(phiExtCo2/aFlr\), but the parameter set has 0.5"):
        free_run(GREENLIGHT, changed(phiExtCo2=0.1), made, SETTINGS.plants)


def test_a_set_that_cannot_be_integrated_leaves_the_others_alone() -> None:
    made = drive(indoor(2), outside(2), FIRST)
    broken = changed(capLeaf=1e-300)
    run = free_run(GREENLIGHT, np.stack([broken, BASE]), made, SETTINGS.plants)
    assert list(run.failures) == [0]
    assert "step " in run.failures[0]
    assert np.isnan(run.climate["co2"][-1, 0])
    assert np.array_equal(run.climate["co2"][:, 1], free_run(GREENLIGHT, BASE, made, SETTINGS.plants).climate["co2"][:, 0])
    with pytest.raises(StepError, match="No parameter set could be integrated"):
        free_run(GREENLIGHT, broken, made, SETTINGS.plants)


def test_a_crop_with_stages_is_planted_as_its_model_says_without_fruit() -> None:
    p = TOMATO_2.parameters.default()
    x = dict(zip(TOMATO_2.state_names, young_crop(TOMATO_2, outside(1).values[0], p, SETTINGS.plants, 19.0), strict=True))
    assert x["cFruit"] == sum(x[f"cFruit{stage}"] for stage in range(1, 34)) == 0.0
    assert x["tCanSum"] < 0.0, "it does not flower yet"
    assert x["tAir"] == 19.0
