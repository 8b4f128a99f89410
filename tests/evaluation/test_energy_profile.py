"""The energy part of profiles: there where the model has an energy system, with sums that are those of the result."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from glbench.errors import ResultError
from glbench.evaluation import Result, evaluate, load_result
from glbench.evaluation.profiles import Profile, load_profile, make_profile, profile_path
from glbench.evaluation.profiles.record import unpack
from glbench.evaluation.saving import recorded_actions
from glbench.model.equipment import ENERGY_FLOWS
from tests.energy import energy_task, write_rules

DAYS = 2


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, Path]:
    folder = tmp_path_factory.mktemp("profile")
    task = energy_task({"id": "test/Energy-v1", "weather.days": DAYS, "evaluation.runs": 2})
    evaluate(task, write_rules(folder, "engine", stores=True, engine=True), out=folder)
    path = folder / "results" / "Energy-v1" / "engine.json"
    return load_result(path), path


def energy(stored: tuple[Result, Path]) -> dict[str, np.ndarray]:
    profile = load_profile(*stored)
    assert profile is not None
    return {name: unpack(packed) for name, packed in profile.document["energy"]["columns"].items()}


def test_the_hours_of_the_mean_day_add_up_to_the_amounts_of_the_result(stored):
    columns = energy(stored)
    assert {*ENERGY_FLOWS, "engine_gas", "heat_lost", "stored"} == columns.keys()
    for name in ("gas", "electricity_sold", "electricity_bought", "co2_bought"):
        assert columns[name].shape == (24,)
        assert columns[name].sum() == pytest.approx(np.mean(stored[0].values(name)) / DAYS, rel=1e-3, abs=1e-6), name
    assert columns["gas"].sum() > 0.5
    assert columns["electricity_sold"].sum() > 0.1


def test_energy_is_kept(stored):
    of = {name: values.sum() for name, values in energy(stored).items()}
    burnt = of["gas"] - of["engine_gas"]
    assert of["heat"] == pytest.approx(0.95 * burnt, rel=2e-3)
    assert of["electricity_made"] == pytest.approx(0.4 * of["engine_gas"], rel=2e-3)
    assert of["engine_heat"] == pytest.approx(0.5 * of["engine_gas"], rel=2e-3)
    profile = load_profile(*stored)
    task, log = energy_task({"weather.days": DAYS}), recorded_actions(*stored)
    assert profile is not None
    left = of["heat"] + of["engine_heat"] - of["heat_to_pipes"] - of["heat_dumped"] - of["heat_lost"]
    store = task.model_value.state_index("eBuf")
    start = 0.5 * task.parameters_by_name()["eBufMax"]  # drawn around it
    assert DAYS * left == pytest.approx((log.final_states[:, store].mean() - start) / 3.6, abs=0.1)


def test_prices_are_those_at_which_something_flowed(stored):
    profile = load_profile(*stored)
    assert profile is not None
    (prices,) = profile.document["energy"]["prices"].values()
    hourly = energy_task().price_tables["power"].hourly
    sold = energy(stored)["electricity_sold"]
    for hour, price in enumerate(prices["values"]):
        assert (price is None) == (sold[hour] == 0.0)
        if price is not None:
            assert price * prices["resolution"] == pytest.approx(hourly[hour], rel=1e-3)


def test_replaying_gives_the_same_bytes(stored):
    result, path = stored
    task = recorded_actions(result, path).task().scored_in(result.task.split)
    again = make_profile(task, result, recorded_actions(result, path), None)
    assert again.to_bytes() == profile_path(path).read_bytes()


def changed(stored: tuple[Result, Path], tmp_path: Path, energy: object) -> Profile | None:
    """The profile with another energy part, or without one, as one that no result names."""
    result, path = stored
    document = json.loads(load_profile(result, path).text)
    document.pop("energy")
    if energy is not None:
        document["energy"] = energy
    copy = tmp_path / path.name
    profile_path(copy).write_bytes(Profile(document).to_bytes())
    return load_profile(result.model_copy(update={"profile": None}), copy)


def test_a_profile_of_an_earlier_version_has_no_energy_and_is_read(stored, tmp_path):
    profile = changed(stored, tmp_path, None)
    assert profile is not None
    assert "energy" not in profile.document


def test_energy_of_other_columns_is_refused(stored, tmp_path):
    with pytest.raises(ResultError, match=r"its 'energy' has other columns, days or hours"):
        changed(stored, tmp_path, {"columns": {"gas": {"resolution": 1.0, "values": [0] * 24}}, "prices": {}})
