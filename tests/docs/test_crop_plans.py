"""What the measurements of plans and rules with a crop of trusses say."""

from __future__ import annotations

import json

import numpy as np
import pytest

from docs import crop_plans


@pytest.fixture(scope="module")
def results() -> dict[str, dict[str, object]]:
    return json.loads(crop_plans.FILE.read_text(encoding="utf-8"))  # type: ignore[no-any-return]


def test_lamps_pay_all_day_for_the_published_crop_and_not_for_a_crop_of_trusses(results: dict[str, dict[str, object]]) -> None:
    windows = results["windows"]
    profit = windows["profit"]
    assert windows["split"] == "training"
    assert isinstance(profit, dict)
    assert np.argmax(profit["published"]) == 0
    assert 4 <= crop_plans.WINDOWS[int(np.argmax(profit["trusses"]))] <= 7


def test_plans_keep_dark_hours_for_a_crop_of_trusses_only(results: dict[str, dict[str, object]]) -> None:
    crops = results["plans"]["crops"]
    assert isinstance(crops, dict)
    assert crops["trusses"]["hours_off"] > crops["published"]["hours_off"] + 1.0


def test_dry_air_pays_with_mould_and_humid_air_without(results: dict[str, dict[str, object]]) -> None:
    crops = results["humidity"]["crops"]
    assert results["humidity"]["split"] == "validation"
    assert isinstance(crops, dict)
    assert (np.diff(crops["published"]["profit"]) > 0.0).all()
    best = int(np.argmax(crops["trusses"]["profit"]))
    assert crop_plans.SET_POINTS[best] <= 84
    assert crops["trusses"]["humid"][best] < 50.0
    assert crops["trusses"]["profit"][-1] < crops["trusses"]["profit"][best] - 0.5


def test_tables_have_a_line_for_each_measurement(results: dict[str, dict[str, object]]) -> None:
    tables = crop_plans.tables(results)
    assert [len(table.splitlines()) for table in tables.values()] == [2 + len(crop_plans.WINDOWS), 4, 2 + len(crop_plans.SET_POINTS)]
