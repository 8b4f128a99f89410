"""The organisers' accounting, and controllers in the archive's season."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from docs import realism_board
from glbench.errors import ArchiveError
from glbench.realism import HOUSES, Archive, read_archive, read_settings
from glbench.realism.board import Board, board, season_task, weather_record
from glbench.realism.houses import parameters
from glbench.realism.inputs import outdoors
from glbench.realism.money import PRICES, account_of, read_prices, settle
from glbench.weather import load_weather, preprocessing
from glbench.weather.store import save_weather
from tests.realism.made import Made

SETTINGS, PAGE = read_settings(), read_prices()
CLOCK = SETTINGS.place.clock


@pytest.fixture(autouse=True)
def own_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLBENCH_DATA", str(tmp_path / "data"))


@pytest.fixture
def made() -> Made:
    made = Made()
    made.sold()
    table = made.indoors()
    table["t_ventlee_vip"] = 24.0
    made.climate["Anna"] = table
    return made


@pytest.fixture
def archive(made: Made, tmp_path: Path) -> Archive:
    return read_archive(made.write(tmp_path / "archive"))


def test_a_compartment_is_counted_to_the_cent(archive: Archive) -> None:
    anna = account_of(archive, archive.compartments[0], PAGE)
    # 10 February: 0.3 kg at 8 degrees Brix, between 4.50 and 3.50 EUR kg-1; 12 February: 0.4 kg, and 0.1 kg of class B, at 9, between 4.20
    # and 2.80.
    assert anna.income == pytest.approx(0.3 * 4.00 + (0.4 + 0.05) * 3.85)
    assert anna.cost_electricity == pytest.approx(3 * (1.2 * 0.08 + 0.5 * 0.04))
    assert anna.cost_heat == pytest.approx(6.0 * 0.0083)
    assert anna.cost_co2 == pytest.approx(0.15 * 0.08)
    assert anna.labour == pytest.approx((3 + 3 + 4) * 0.0085), "before the first count as counted first"
    assert anna.plants == pytest.approx(1.5 * 2.20)
    assert round(anna.net(), 2) == -0.86
    assert round(anna.net(0.5), 2) == round(-0.8623 - 0.5 * 2.9325, 2)
    assert (anna.fruit, anna.electricity, anna.heat) == pytest.approx((0.8, 5.1, 6.0))


def test_co2_has_two_steps() -> None:
    nothing = dict.fromkeys(("fruit", "electricity", "heat", "income", "cost_electricity", "labour", "plants"), 0.0)
    costs = [settle(PAGE, name="any", co2=co2, **nothing).cost_co2 for co2 in (12.0, 12.5)]
    assert costs == pytest.approx([0.96, 0.96 + 0.10])


def test_prices_follow_the_date_and_the_sugar() -> None:
    dates = np.array(["2020-01-14", "2020-01-15", "2019-12-20"], dtype="datetime64[D]")
    assert PAGE.of_fruit(dates, 10.0) == pytest.approx([5.00, 5.20, 2.50]), "December has the year's last price"
    assert PAGE.of_fruit(dates, 6.0) == pytest.approx([3.00, 3.50, 1.10])
    assert PAGE.of_fruit(dates[:2], np.array([8.0, 9.0])) == pytest.approx([4.00, 4.775])


def test_a_page_of_prices_is_checked(tmp_path: Path) -> None:
    page, text = tmp_path / "prices.toml", PRICES.read_text(encoding="utf-8")
    for before, after in (("heat = 0.0083", "heat = -1.0"), ("01-15 =", "13-15 ="), ("[fruit]", "[fruits]")):
        assert before in text
        page.write_text(text.replace(before, after), encoding="utf-8")
        with pytest.raises(ArchiveError, match=r"The prices .* cannot be used: .* explains each entry"):
            read_prices(page)


def test_what_was_not_counted_is_named(made: Made, tmp_path: Path) -> None:
    del made.crop["Bert"]
    other = read_archive(made.write(tmp_path / "other"))
    with pytest.raises(ArchiveError, match=r"Bert: net profit needs TSS in TomQuality.csv, and stem_dens and plant_dens"):
        account_of(other, other.compartments[1], PAGE)
    with pytest.raises(ArchiveError, match=r"Bert: net profit"):
        board(other, [HOUSES["mixed_2020"]], SETTINGS, PAGE, [])


def test_the_task_has_the_archives_season(archive: Archive) -> None:
    house, outside = HOUSES["mixed_2020"], outdoors(archive, CLOCK, SETTINGS.place.co2)
    record = weather_record(outside, preprocessing.to_utc_seconds(archive.first, CLOCK), CLOCK)
    save_weather(record, "made")
    task = season_task(archive, house, SETTINGS, PAGE, "made", (0.09, 8.0)).scored
    own = parameters(house, SETTINGS)
    assert np.array_equal(task.parameters()[: own.size], own)
    (season,) = task.scenario.seasons
    rows = task.season(season, 1).values[: outside.steps]
    for name in ("iGlob", "tOut", "vpOut", "wind", "tSky", "co2Out"):
        place = preprocessing.COLUMNS.index(name)
        assert rows[:, place].mean() == pytest.approx(outside.of(name).mean(), abs=0.01, rel=2e-3), name
    names = task.model_value.state_names
    start = dict(zip(names, task.initial_state().tolist(), strict=True))
    assert start["cLeaf"] == pytest.approx(1e3 * SETTINGS.plants.dry_mass * SETTINGS.plants.leaves)
    items = {one.name: one for one in (*task.ledger.earned, *task.ledger.paid)}
    assert items["cost_heat"].price == pytest.approx(3.6 * 0.0083)
    assert items["revenue_harvest"].factor == pytest.approx(1e-6 / 0.09)
    earlier, hours = load_weather("schiphol"), 24 * 200
    eight_years = round(8 * 365.25) * 86400
    past = (record.begin - eight_years - earlier.begin) // 3600
    assert record.values("wind_speed")[:hours] == pytest.approx(earlier.values("wind_speed")[past : past + hours], abs=1e-3)


def test_rows_of_the_board(archive: Archive) -> None:
    told: list[tuple[str, int, int]] = []
    rows = board(
        archive, [HOUSES["mixed_2020"]], SETTINGS, PAGE, ["rule_based_tuned", "grower", "mpc_true"], progress=lambda *at: told.append(at)
    )
    assert [(one.name, one.house) for one in rows.accounts] == [
        ("Anna", None), ("Bert", None), ("Anna", "mixed_2020"), ("rule_based_tuned", "mixed_2020"), ("grower", "mixed_2020"),
    ]  # fmt: skip
    growers, rules, grower = rows.accounts[2:]
    assert len(rows.refused) == 1
    assert rows.refused[0].startswith("mpc_true has no row in mixed_2020: ")
    assert growers.labour == rules.labour == rows.accounts[0].labour
    for one in (rules, grower):
        assert one.fruit_ratio is None, "no fruit in three days"
        assert (one.fruit, one.income, one.electricity) == pytest.approx((0.0, 0.0, 0.0)), "nor lamps"
        assert one.heat > 0.5
        assert one.cost_heat == pytest.approx(0.0083 * one.heat)
    assert rules.heat != grower.heat
    power = 81.0 + 25.3 + 0.5 * 7.27
    assert growers.electricity == pytest.approx(3 * 12.0 * power / 1000.0)
    assert growers.cost_electricity == pytest.approx(growers.electricity * rows.accounts[0].cost_electricity / 5.1)
    assert rows.brix == pytest.approx((0.3 * 8.0 + 0.5 * 9.0) / 0.8)
    assert {words for words, at, of in told if at == of} == {f"mixed_2020: {name}" for name in ("Anna", "rule_based_tuned", "grower")}
    assert Board.model_validate_json(rows.model_dump_json()) == rows
    page = realism_board.tables(rows)
    anna = page["board-measured"].splitlines()[2]
    assert anna.startswith("| Anna, measured | 0.8 kg: 2.93 | 5 kWh: -0.35 | 6 MJ: -0.05 | ")
    assert anna.endswith(" | -3.30 | **-0.86** |")
    lines = page["board-houses"].splitlines()
    assert lines[1].startswith("| --- | --- | ---: | ---: |")
    assert lines[2].startswith("| `mixed_2020` | Anna by its own set points, simulated | 0.0 kg: 0.00 | ")
    assert lines[3].startswith("| `mixed_2020` | `rule_based_tuned`, simulated | 0.0 kg: 0.00 | 0 kWh: 0.00 | ")


def test_without_indoor_climate_there_is_no_board(made: Made, tmp_path: Path) -> None:
    made.climate.clear()
    with pytest.raises(ArchiveError, match="No compartment has indoor climate"):
        board(read_archive(made.write(tmp_path / "other")), [], SETTINGS, PAGE, [])


def test_densities_are_as_counted_last(made: Made, tmp_path: Path) -> None:
    made.crop["Anna"] = pd.DataFrame({"Time": made.crop["Anna"]["Time"], "stem_dens": [np.nan, 4.0], "plant_dens": [1.5, 1.5]})
    del made.quality["Anna"]
    anna = read_archive(made.write(tmp_path / "other")).compartments[0]
    assert anna.stems is not None
    assert anna.stems.tolist() == [4.0, 4.0, 4.0]
    assert anna.brix is None
    assert anna.class_b is not None
    assert anna.class_b.tolist() == [0.0, 0.0, 0.1]
    assert json.loads(json.dumps(anna.harvest.tolist())) == pytest.approx([0.3, 0.0, 0.5])
