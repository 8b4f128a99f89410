"""Fits to a made house whose numbers are known: what they find, how they go on, and what they say."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from glbench.errors import ArchiveError, GlbenchError, ParameterError
from glbench.realism.free_run import Error
from glbench.realism.houses import MODEL, model
from glbench.realism.identify import SHIPPED_PAGE, Fit, FitPage, Problem, identify, make_split, report_text
from glbench.settings import read_settings, validated
from tests.realism.measured import BASE, HOUSE, NOISE, SETTINGS, changed, season

TRUE = {"vents": 0.6, "house_leak": 2.5, "pipes": 1.3}
NAMES = {"vents": ["cDgh"], "house_leak": ["cLeakage"], "pipes": ["lPipe", "lGroPipe"]}


def page(**parameters: dict[str, object]) -> FitPage:
    return validated(FitPage, {"weights": NOISE, "parameters": parameters}, "the page", Path("page.toml"), ArchiveError)


def problem(days: int, fit_page: FitPage, **factors: float) -> Problem:
    return Problem(HOUSE, BASE, SETTINGS.plants, fit_page, season(days, changed(**factors)))


def ignore(number: int, points: float) -> None:
    assert number >= 0
    assert points >= 0.0


@pytest.fixture(scope="module")
def made() -> Problem:
    factors = {name: TRUE[entry] for entry, names in NAMES.items() for name in names}
    return problem(70, page(**{entry: {"multiplies": names, "prior": 2.0} for entry, names in NAMES.items()}), **factors)


@pytest.fixture(scope="module")
def fits(made: Problem, tmp_path_factory: pytest.TempPathFactory) -> tuple[Fit, ...]:
    splits = [make_split(made.season, text) for text in ("weeks", "date:2020-02-10")]
    return identify(made, splits, tmp_path_factory.mktemp("fit") / "state.json", ignore)


@pytest.mark.slow
def test_the_factors_of_a_made_house_come_back(made: Problem, fits: tuple[Fit, ...]) -> None:
    for fit in fits:
        assert fit.settled
        for one in fit.estimates:
            assert one.value == pytest.approx(TRUE[one.name], rel=0.05)
            assert one.low <= TRUE[one.name] <= one.high
            assert one.high / one.low < 1.25
            assert one.bound == ""
        for part in (fit.split.fitted, fit.split.test):
            for channel, noise in NOISE.items():
                assert fit.after[part][channel].rmse == pytest.approx(noise, rel=0.1)
                assert fit.before[part][channel].rmse > 1.5 * noise
    assert [(fit.split.fitted, fit.split.test) for fit in fits] == [("even weeks", "odd weeks"), ("before 2020-02-10", "from 2020-02-10")]
    assert not np.array_equal(fits[0].z, fits[1].z)
    after = {part: {**errors, "co2": Error(rmse=np.nan, bias=np.nan, readings=0)} for part, errors in fits[0].after.items()}
    report = report_text(made, [fits[0]._replace(after=after)], "Anna")
    assert re.search(r"\| odd weeks, held out \| after \| \S+ \(\S+\) \| \S+ \(\S+\) \| - \|", report), "CO2 that was not measured"


def test_a_fit_that_is_killed_goes_on_to_the_same_bits(tmp_path: Path) -> None:
    made, state = problem(21, page(vents={"multiplies": ["cDgh"]}), cDgh=0.7), tmp_path / "state.json"
    splits = [make_split(made.season, "weeks")]
    fits = identify(made, splits, tmp_path / "whole.json", ignore)

    def kill(number: int, points: float) -> None:
        if points > 1.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        identify(made, splits, state, kill)
    first = json.loads(state.read_text())["points"]["weeks"]
    assert len(first) == 1
    computed: list[float] = []
    again = identify(made, splits, state, lambda number, points: computed.append(points))
    assert again[0].estimates == fits[0].estimates
    assert again[0].z.tobytes() == fits[0].z.tobytes()
    assert min(computed) > 1.0, "the first point is not computed again"
    computed.clear()
    assert identify(made, splits, state, lambda number, points: computed.append(points))[0].estimates == fits[0].estimates
    assert not computed
    other = problem(21, page(vents={"multiplies": ["cDgh"]}), cDgh=0.8)
    with pytest.raises(ArchiveError, match=r"state\.json is damaged, or belongs to a fit of other data, numbers or house"):
        identify(other, splits, state, ignore)
    state.write_text('{"points": [')
    with pytest.raises(ArchiveError, match="is damaged"):
        identify(made, splits, state, ignore)


def test_a_bound_that_binds_is_named(tmp_path: Path) -> None:
    narrow = page(leak={"multiplies": ["cLeakage"], "highest": 1.5}, pipes={"multiplies": ["lPipe", "lGroPipe"]})
    tight = problem(21, narrow, cLeakage=4.0)
    leak, pipes = identify(tight, [make_split(tight.season, "weeks")], tmp_path / "state.json", ignore)[0].estimates
    assert leak.bound == "highest"
    assert leak.value == pytest.approx(1.5, rel=0.01)
    assert pipes.bound == ""


def test_a_value_can_start_at_0(tmp_path: Path) -> None:
    entry: dict[str, object] = {"sets": ["etaLampCool"], "start": 0.05, "lowest": 0.0, "highest": 0.5, "prior": 0.3}
    names = model(MODEL).parameters.names
    cooled = BASE.copy()
    cooled[names.index("etaLampCool")] = 0.4
    one = Problem(HOUSE, BASE, SETTINGS.plants, page(cooling=entry), season(21, cooled))
    estimate = identify(one, [make_split(one.season, "weeks")], tmp_path / "state.json", ignore)[0].estimates[0]
    assert estimate.value == pytest.approx(0.4, abs=0.02)


def test_splits() -> None:
    made = season(35, BASE)
    weeks = make_split(made, "weeks")
    assert weeks.steps[: 7 * 48].all()
    assert not weeks.steps[7 * 48 : 14 * 48].any()
    date = make_split(made, "date")
    assert (date.name, date.fitted, date.test) == ("date:2020-02-01", "before 2020-02-01", "from 2020-02-01")
    assert date.steps.sum() == 26 * 48
    for text, words in (
        ("months", "There is no split 'months'. Write weeks, date, or date:2020-03-01"),
        ("date:soon", "There is no split 'date:soon'"),
        ("weeks:2", "There is no split 'weeks:2'"),
        ("date:2020-01-08", "leaves 1 of the weeks of .* to fit and 5 to test"),
        ("date:2020-03-08", "leaves 5 of the weeks of .* to fit and 0 to test"),
    ):
        with pytest.raises(ArchiveError, match=words):
            make_split(made, text)


@pytest.mark.parametrize(
    ("entry", "error", "words"),
    [
        ({}, ArchiveError, "either in multiplies or in sets"),
        ({"multiplies": ["cDgh"], "lowest": 1.2}, ArchiveError, "begins at 1, so its lowest 1.2 must be below and its highest 5 above"),
        ({"multiplies": ["cDgh"], "lowest": 0.0}, ArchiveError, "A factor begins at 1, and its lowest is above 0"),
        ({"multiplies": ["cDgh"], "start": 1.1}, ArchiveError, "begins at 1.1, so .* A factor begins at 1"),
        ({"multiplies": ["cDhg"]}, GlbenchError, "no parameter 'cDhg'. Did you mean 'cDgh'"),
        ({"multiplies": ["capAir"]}, ArchiveError, "cannot fit capAir: it follows from others"),
        ({"multiplies": ["etaLampCool"]}, ArchiveError, "cannot fit etaLampCool: it is 0; use sets"),
        ({"multiplies": ["cDgh", "cDgh"]}, ArchiveError, "cannot fit cDgh: it is fitted twice"),
        ({"multiplies": ["tauRfPar"], "highest": 1.6}, ParameterError, "cannot go to its highest, 1.6: More than all of"),
        ({"sets": ["cDgh"], "lowest": 0.5, "highest": 1.0}, ArchiveError, "begins at 0.35, so its lowest 0.5 must be below"),
    ],
)
def test_what_cannot_be_fitted_is_refused_at_once(entry: dict[str, object], error: type[GlbenchError], words: str) -> None:
    with pytest.raises(error, match=words):
        Problem(HOUSE, BASE, SETTINGS.plants, page(number=entry), season(1, BASE))


def test_the_shipped_page_can_be_fitted() -> None:
    shipped = read_settings(FitPage, SHIPPED_PAGE, "the page", ArchiveError, toml=True)
    one = Problem(HOUSE, BASE, SETTINGS.plants, shipped, season(1, BASE))
    assert len(one.names) == 11
    page_of_docs = (Path(__file__).parents[2] / "docs" / "identify.md").read_text(encoding="utf-8")
    for name, entry in shipped.parameters.items():
        numbers = f"{entry.lowest:g} | {entry.highest:g} | {entry.prior:g}"
        assert f"| `{name}` | {', '.join(f'`{one}`' for one in entry.multiplies)} | {numbers} | {entry.meaning} |\n" in page_of_docs
    table = model(MODEL).parameters
    assert one.overrides(0.0 * one.start) == {
        name: value
        for name, value in zip(table.names, BASE.tolist(), strict=True)
        if value != dict(zip(table.names, table.default(HOUSE.parameters).tolist(), strict=True))[name]
    }
