"""The table of docs/realism-tables.md about other set points, with a made archive."""

from __future__ import annotations

from pathlib import Path

import pytest

from docs import realism_setpoints as setpoints
from glbench.realism import read_archive, read_settings
from tests.realism.made import Made

SETTINGS = read_settings()


def test_a_change_changes_its_entries_alone() -> None:
    drier = setpoints.CHANGES["drier"].of(SETTINGS)
    assert drier.humidity_deficit.day == SETTINGS.humidity_deficit.day + 0.5
    assert drier.humidity_deficit.night == SETTINGS.humidity_deficit.night + 0.5
    assert drier.model_copy(update={"humidity_deficit": SETTINGS.humidity_deficit}) == SETTINGS
    assert setpoints.CHANGES[setpoints.ASSUMED].of(SETTINGS) == SETTINGS
    assert setpoints.CHANGES["colder"].of(SETTINGS) == SETTINGS, "shifted by the argument of compare"


def test_a_warmer_house_needs_more_heat_and_a_colder_one_less(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(setpoints, "CHANGES", {name: setpoints.CHANGES[name] for name in (setpoints.ASSUMED, "warmer", "colder")})
    found = setpoints.measured(read_archive(Made(days=2).write(tmp_path)), SETTINGS)
    heat = {name: sums["heat"] for name, sums in found["changes"].items()}
    assert heat["colder"] < heat[setpoints.ASSUMED] < heat["warmer"]
    assert setpoints.change(found, "warmer", "heat") == pytest.approx(100.0 * (heat["warmer"] / heat[setpoints.ASSUMED] - 1.0))
    for sums in found["changes"].values():
        sums["fruit"] += 1.0  # none is ripe after two days
    page = "a\n<!-- setpoints -->\nold\n<!-- end -->\nb\n"
    rows = setpoints.filled(page, found).splitlines()
    assert (rows[0], rows[-1], len(rows)) == ("a", "b", 2 + 2 + 2 + 3)
