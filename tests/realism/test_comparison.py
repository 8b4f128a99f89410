"""Houses, the simulated season, and how it is compared."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from glbench.errors import ArchiveError, ResultError, UnknownNameError
from glbench.realism import (
    HOUSES,
    SHIPPED,
    Archive,
    Comparison,
    Season,
    choose_houses,
    compare,
    read_archive,
    read_comparison,
    read_settings,
    simulate,
)
from glbench.realism.houses import model, parameters
from glbench.realism.inputs import outdoors
from tests.realism.made import FIRST, Made

SETTINGS = read_settings()


def value(house: str, name: str) -> float:
    values = model(HOUSES[house].model).parameters
    return float(parameters(HOUSES[house], SETTINGS)[values.names.index(name)])


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Archive:
    return read_archive(Made(days=2).write(tmp_path_factory.mktemp("archive")))


@pytest.fixture(scope="module")
def compared(archive: Archive) -> tuple[Comparison, tuple[Season, ...]]:
    return compare(archive, choose_houses(("paper", "paper_uncooled")), SETTINGS)


def test_all_houses_have_the_measured_lamps_and_a_harvest() -> None:
    assert {value(name, "thetaLampMax") for name in HOUSES} == {143.0}
    assert {value(name, "cFruitMax") for name in HOUSES} == {300000.0}


def test_only_the_paper_cools_its_lamps() -> None:
    assert {name: value(name, "etaLampCool") for name in HOUSES} == {name: 0.63 * (name == "paper") for name in HOUSES}
    changed = parameters(HOUSES["paper"], SETTINGS) != parameters(HOUSES["paper_uncooled"], SETTINGS)
    assert np.array(model().parameters.names)[changed].tolist() == ["etaLampCool"]


def test_mixed_lamps_give_the_light_of_both() -> None:
    share = 81.0 / 143.0
    par = {name: value(name, "etaLampPar") for name in ("hps_2021", "led_2021", "mixed_2021")}
    photons = {name: par[name] * value(name, "zetaLampPar") for name in par}  # umol J-1
    for mixed in (par, photons):
        assert mixed["mixed_2021"] == pytest.approx(share * mixed["hps_2021"] + (1.0 - share) * mixed["led_2021"])
    house = np.array([info.group != "lamps" and not info.is_derived for info in model().parameters.table])
    mine, theirs = (parameters(HOUSES[name], SETTINGS) for name in ("mixed_2021", "led_2021"))
    assert np.array_equal(mine[house], theirs[house]), "nothing but the lamps differs"


def test_unknown_houses_are_refused() -> None:
    with pytest.raises(UnknownNameError, match=r"no parameter set 'led_2012' to compare. Did you mean 'led_2021'"):
        choose_houses(("led_2012",))
    assert choose_houses(()) == tuple(HOUSES.values())


def test_houses_with_the_same_name_are_refused(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "identified.toml").write_text(
            'name = "fit"\ndescription = "a page"\n[model]\nid = "greenlight-tomato-harvest-1.0.0"\nparameters = "hps_2020"\n'
        )
    pages = [str(tmp_path / folder / "identified.toml") for folder in ("a", "b")]
    assert choose_houses(pages[:1])[0].name == "fit"
    with pytest.raises(ArchiveError, match="Two of these sets have the same name: fit, fit"):
        choose_houses(pages)


def test_a_season_uses_the_measured_light_and_co2_and_keeps_warm(archive: Archive, compared: tuple[Comparison, tuple[Season, ...]]) -> None:
    for season in compared[1]:
        for place, one in enumerate(archive.compartments):
            assert season.lamps[:, place] == pytest.approx(one.high + one.low, rel=1e-12)
            assert season.co2[:, place] == pytest.approx(one.co2, rel=1e-12)
        assert np.all(season.heat > 0.0)
        assert np.all((season.air_temperature > 15.0) & (season.air_temperature < 25.0))


def test_cooled_lamps_need_more_heat(compared: tuple[Comparison, tuple[Season, ...]]) -> None:
    cooled, uncooled = compared[1]
    assert np.all(cooled.heat > uncooled.heat)


def test_the_boilers_heat_leaves_the_pipes_by_the_formula_of_the_organisers(
    archive: Archive, compared: tuple[Comparison, tuple[Season, ...]]
) -> None:
    comparison, seasons = compared
    for house, season in zip(comparison.houses, seasons, strict=True):
        assert season.pipe_heat == pytest.approx(season.heat, rel=0.25), "two days: pipes store heat over midnight"
        assert season.pipe_heat.sum() == pytest.approx(season.heat.sum(), rel=0.15)
        assert house.pipe_heat == pytest.approx(season.pipe_heat.sum(axis=0).mean())
    old = comparison.model_dump(exclude={"houses": {0: {"compartments": {0: {"heat": {"by_pipes"}}}}}})
    assert math.isnan(Comparison.model_validate(old).houses[0].pipe_heat), "files of earlier versions are read"


def test_a_warmer_house_needs_more_heat(archive: Archive, compared: tuple[Comparison, tuple[Season, ...]]) -> None:
    outside = outdoors(archive, SETTINGS.place.clock, SETTINGS.place.co2)
    warmer = simulate(archive, outside, HOUSES["paper"], SETTINGS, warmer=2.0)
    assert np.all(warmer.heat > compared[1][0].heat)
    assert np.all(warmer.air_temperature > compared[1][0].air_temperature + 0.5)


def test_a_compartment_is_simulated_alone_as_beside_others(archive: Archive, compared: tuple[Comparison, tuple[Season, ...]]) -> None:
    alone = dataclasses.replace(archive, compartments=archive.compartments[1:])
    outside = outdoors(alone, SETTINGS.place.clock, SETTINGS.place.co2)
    assert np.array_equal(simulate(alone, outside, HOUSES["paper"], SETTINGS).heat[:, 0], compared[1][0].heat[:, 1])


def test_sums_days_and_months(archive: Archive, compared: tuple[Comparison, tuple[Season, ...]]) -> None:
    comparison, (season, _) = compared
    house = comparison.houses[0]
    anna = house.compartments[0]
    difference = season.heat[:, 0] - archive.compartments[0].heat
    assert anna.heat.measured == pytest.approx(4.0)
    assert anna.heat.bias == pytest.approx(difference.mean())
    assert anna.heat.rmse == pytest.approx(math.sqrt((difference**2).mean()))
    assert anna.heat.correlation is None, "the measured days are alike"
    assert anna.heat.bias_by_month == {"2020-02": pytest.approx(anna.heat.bias)}
    assert anna.harvest.measured == pytest.approx(0.8)
    assert (anna.harvest.measured_from, anna.harvest.simulated_from) == (FIRST, None)
    assert anna.harvest.bias_by_month["2020-02"] == pytest.approx(anna.harvest.simulated - 0.8)
    measured = np.column_stack([one.heat for one in archive.compartments])
    assert house.heat_rmse == pytest.approx(math.sqrt(((season.heat - measured) ** 2).mean()))
    assert house.heat_ratio == pytest.approx(season.heat.sum() / measured.sum())
    assert comparison.heat_spread == pytest.approx(0.5), "2 and 3 MJ: each is 0.5 from their mean"
    assert comparison.months == ("2020-02",)


def test_what_is_stored_comes_back_and_holds_no_day(tmp_path: Path, compared: tuple[Comparison, tuple[Season, ...]]) -> None:
    path = tmp_path / "comparison.json"
    path.write_text(compared[0].model_dump_json(indent=1) + "\n", encoding="utf-8")
    assert read_comparison(path) == compared[0]
    lists = [len(one.model_dump()["heat"]) for one in compared[0].houses[0].compartments]
    assert lists == [7, 7]
    assert not any(isinstance(value, list) for value in compared[0].houses[0].compartments[0].heat.model_dump().values())
    path.write_text("{}")
    with pytest.raises(ResultError, match="is no comparison with measurements"):
        read_comparison(path)


def test_a_page_of_settings_is_checked(tmp_path: Path) -> None:
    page, text = tmp_path / "page.toml", SHIPPED.read_text(encoding="utf-8")
    for before, after, words in (
        ("day = 19.5", "day = 95.0", r"'heating.day' is 95 degC; it must be from 0 to 30 degC"),
        ("[screen]", "[screens]", r"'screen' is missing; there is no setting 'screens'. Did you mean 'screen'"),
        ("hps = 81.0", "hps = 'many'", r"'lamps.hps' is 'many', which is not a number"),
        ("high_until = 23.0", "high_until = 7.0", r"'lamps': high_from = 7 must be below high_until = 7"),
        ("[place]", "[place", r"it is no valid TOML"),
    ):
        assert before in text
        page.write_text(text.replace(before, after), encoding="utf-8")
        with pytest.raises(ArchiveError, match=words):
            read_settings(page)
    with pytest.raises(ArchiveError, match="it cannot be read"):
        read_settings(tmp_path / "none.toml")


def test_the_page_has_the_set_points_of_the_grower() -> None:
    from glbench.agents.grower import read_grower_settings
    from glbench.resources import data_folder

    grower = read_grower_settings(data_folder("baselines") / "grower" / "settings.toml")
    for table in ("heating", "ventilation", "humidity_deficit", "screen"):
        assert getattr(SETTINGS, table) == getattr(grower, table)
    assert SETTINGS.periods.pre_night == grower.periods.pre_night_before_sunset + grower.periods.night_after_sunset
