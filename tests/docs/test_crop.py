"""docs/crop.md: its tables are those of the measurements, and the experiments show what the page says."""

from __future__ import annotations

from pathlib import Path

import pytest

from docs import crop_effects, crop_table
from glbench.model.paper import TOMATO_2
from glbench.tasks import get_task

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "crop.md").read_text(encoding="utf-8")
FOUND, EFFECTS = crop_table.read(), crop_effects.read()


def test_the_page_holds_the_measurements_of_the_task_as_it_is() -> None:
    assert crop_table.filled(PAGE, FOUND) == PAGE
    assert FOUND["digest"] == get_task(FOUND["task"]).digest
    assert (FOUND["split"], tuple(FOUND["seeds"])) == (crop_table.SPLIT, crop_table.SEEDS)
    assert set(FOUND["year"]) == set(crop_table.WAYS)


def test_the_cold_spots_are_those_of_the_sets() -> None:
    place = TOMATO_2.parameter_names.index("dtColdSpot")
    for name, spot in crop_effects.COLD_SPOTS.items():
        assert TOMATO_2.parameters.default(name)[place] == spot


@pytest.mark.parametrize("temperature", [f"{one:g}" for one in crop_effects.COLD])
def test_dates_of_a_cohort_are_within_a_twentieth_of_vanthoors(temperature: str) -> None:
    few, many = EFFECTS["ripening"][temperature].values()
    assert few == pytest.approx(many, rel=0.05)
    assert few == pytest.approx(crop_effects.ripening(float(temperature), crop_effects.STAGES))


def test_a_hot_and_a_dark_week_cost_fruit_weeks_later() -> None:
    weeks = EFFECTS["weeks"]
    week = crop_effects.CHANGED[0] // crop_effects.WEEK
    for name in ("hot", "dark"):
        changed, plain = weeks[name], weeks["plain"]
        assert changed["set"][week] < 0.3 * plain["set"][week]
        assert all(changed["picked"][week + later] < 0.85 * plain["picked"][week + later] for later in (6, 7))
        assert changed["picked"][week + 9] > 0.95 * plain["picked"][week + 9]


def test_long_light_and_nights_in_a_row_cost_more() -> None:
    sugar = {int(hours): one["sugar"] for hours, one in EFFECTS["hours"].items()}
    assert max(sugar, key=sugar.__getitem__) == 18
    assert sugar[20] < sugar[17]
    assert sugar[24] < sugar[14]
    nights = EFFECTS["nights"]
    assert nights["in a row"]["lost"] > 2.0 * nights["apart"]["lost"] > 0.0
    held = EFFECTS["held"]
    assert held["bleiswijk_2020"]["91"] < 0.01 < held["benchmark"]["85"]
