"""The crop with trusses: against a second implementation, what closes, derivatives, and what growers know of their crops, as numbers."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import erlang

from glbench.model import Horizon, get_model
from glbench.model.crop.stages import STAGES
from glbench.model.crop.trusses import TrussParameters, TrussState
from glbench.model.paper import TOMATO_2, TOMATO_2_COMPARTMENT, TOMATO_2_COMPARTMENT_ENERGY, TOMATO_2_ENERGY, TOMATO_2_HEAT_PUMP
from glbench.model.parameter_checks import check_value
from glbench.model.quantities import public_name
from tests.model.conditions import Array, Inputs, reference_points
from tests.model.truss_oracle import Climate, Stand
from tests.model.truss_stand import MASSES, NUMBERS, Course, Day, grow, mature

MODEL = TOMATO_2
PLAIN = get_model("greenlight-tomato-season-1.0.0")
MODELS = (TOMATO_2, TOMATO_2_COMPARTMENT, TOMATO_2_COMPARTMENT_ENERGY, TOMATO_2_ENERGY, TOMATO_2_HEAT_PUMP)
POINTS = reference_points().inputs
OWN_STATES = tuple(public_name(name) for name in TrussState._fields)
OWN_PARAMETERS = tuple(name for name in MODEL.parameter_names if name not in PLAIN.parameter_names)
N, C = (tuple(f"{kind}Fruit{stage}" for stage in range(1, STAGES + 1)) for kind in "nc")
HANDS = ("uAway", "uPrune", "uDefoliate", "uTop")


def drawn(n: int = 200, seed: int = 21, **fixed: Any) -> Inputs:
    """Rows of inputs: stored greenhouses with crops of all kinds, some values the same in all."""
    generator = np.random.default_rng(seed)
    pick = generator.choice(len(POINTS.x), n)
    plain = dict(zip(reference_names("state"), POINTS.x[pick].T, strict=True))
    uniform = lambda low, high: generator.uniform(low, high, n)  # noqa: E731
    sometimes = lambda values, share=0.3: np.where(generator.random(n) < share, values, 0.0)  # noqa: E731
    # Empty crops, dense ones, and those between; fruits lighter and heavier than they could be; some drawn by a task.
    load = generator.choice([0.0, 1e-3, 0.3, 1.0, 4.0], n)[:, None]
    number = load * generator.uniform(0.0, 6.0, (n, STAGES))
    mass = number * generator.uniform(0.0, 9e3, (n, STAGES))
    ripe = sometimes(uniform(0.0, 4e4), 0.5)
    crop = {
        **dict(zip(N, number.T, strict=True)),
        **dict(zip(C, mass.T, strict=True)),
        "cRipe": ripe,
        "nRipe": ripe / 8e3,
        "cFruit": (mass.sum(axis=1) + ripe) * generator.choice([1.0, 0.8, 1.2], n),
        "cBuf": uniform(-50.0, 25e3),
        "cLeaf": uniform(1e4, 1.3e5),
        "tCan24": uniform(-2.0, 36.0),
        "tCanSum": generator.choice([-80.0, -5.0, 5.0, 400.0, 3000.0], n),
        "tFruit": plain["tAir"] + uniform(-4.0, 1.0),
        "photoperiod": uniform(0.0, 1.0),
        "injury": sometimes(uniform(0.0, 1.0), 0.5),
        "sourceSink": uniform(0.0, 1.0),
        "wetHours": uniform(0.0, 40.0),
        "mould": sometimes(uniform(0.0, 1.0), 0.5),
        "cWeek": uniform(0.0, 2e5),
        "trusses": uniform(0.0, 30.0),
    }
    states = plain | {name: np.zeros(n) for name in MODEL.state_names if name not in plain} | crop | fixed
    hands = {name: sometimes(generator.choice([1.0, 0.4], n), 0.4) for name in HANDS} | fixed
    benchmark = dict(zip(MODEL.parameter_names, MODEL.parameters.default(), strict=True))
    values = dict(zip(reference_names("parameter"), POINTS.p[pick].T, strict=True))
    # A share stays below 1: where all young fruits abort at once, their rate is infinite.
    values |= {name: benchmark[name] * uniform(0.9, 1.1) for name in OWN_PARAMETERS} | fixed
    table = lambda names, columns: np.column_stack([np.broadcast_to(columns[name], n) for name in names])  # noqa: E731
    u = np.hstack([POINTS.u[pick], table(HANDS, hands)])
    return Inputs(table(MODEL.state_names, states), u, POINTS.d[pick], table(MODEL.parameter_names, values))


def reference_names(kind: str) -> tuple[str, ...]:
    """Of the stored points, which are of the published model."""
    published = get_model("greenlight-tomato-1.0.0")
    return published.state_names if kind == "state" else published.parameter_names


def column(values: Array, name: str) -> Array:
    """Column of a table of states, of controls or of parameters."""
    names = next(names for names in (MODEL.state_names, MODEL.control_names, MODEL.parameter_names) if len(names) == values.shape[1])
    return values[:, names.index(name)]


AT = drawn()
RATES = MODEL.rhs(*AT)
FLUXES = MODEL.auxiliary_values(*AT)


# The parts


def test_the_models_are_named_and_put_together_as_the_others() -> None:
    parts = ("", "-compartment", "-compartment-energy", "-energy", "-heat-pump")
    assert [model.id for model in MODELS] == [f"greenlight-tomato-2{part}-1.0.0" for part in parts]
    assert {get_model(model.id) for model in MODELS} == set(MODELS)
    assert MODEL.state_names == (*PLAIN.state_names[:21], *OWN_STATES, *PLAIN.state_names[-3:])
    assert len(MODEL.states) == 111
    for model in MODELS:
        assert set(HANDS) <= set(model.control_names)
        assert set(OWN_STATES) <= set(model.state_names)
        paths = [signal.path for signal in model.signals()]
        assert len(set(paths)) == len(paths)


def test_the_table_is_complete_and_possible() -> None:
    assert set(OWN_PARAMETERS) < {public_name(name) for name in TrussParameters._fields}
    for info in MODEL.table:
        if info.name in OWN_PARAMETERS:
            assert info.meaning
            assert info.source
            for value in info.values.values():
                check_value(info, value)


@pytest.mark.parametrize("model", MODELS, ids=str)
@pytest.mark.parametrize("start", ["mature_crop", "young_crop"])
@pytest.mark.parametrize("parameters", ["benchmark", "bleiswijk_2020"])
def test_a_season_starts_finite_within_bounds_and_with_its_fruits_in_stages(model: Any, start: str, parameters: str) -> None:
    p = model.parameters.default(parameters)
    x = model.start(start, POINTS.d[0], 18.0, p)
    state = dict(zip(model.state_names, x.tolist(), strict=True))
    rates = model.rhs(x[None], np.full((1, len(model.controls)), 0.5), POINTS.d[:1], p[None])
    assert np.isfinite(rates).all()
    assert state["cFruit"] == pytest.approx(sum(state[name] for name in C), rel=1e-12)
    assert (sum(state[name] for name in N) > 50) == (start == "mature_crop")
    values = dict(zip(model.parameter_names, p.tolist(), strict=True))
    bounds = model.bounds(Horizon(5760, 900.0, values))
    assert set(bounds) >= set(OWN_STATES)
    for name in OWN_STATES:
        low, high = bounds[name]
        assert low <= state[name] <= high, name


def test_observation_modules_give_what_they_say() -> None:
    values = dict(zip(MODEL.parameter_names, MODEL.parameters.default().tolist(), strict=True))
    horizon, state, p = Horizon(5760, 900.0, values), MODEL.State(*AT.x.T), MODEL.Parameters(*AT.p.T)
    columns = [seen for module in ("registration", "crop_health") for seen in MODEL.observed(module, horizon) or ()]
    assert [seen.name for seen in columns] == [
        "trusses", "fruits", "fruits_per_truss", "head_diameter", "picked_in_week", "ripe_fruit",
        "light_hours", "light_injury", "wet_hours", "mould",
    ]  # fmt: skip
    worth = {seen.name: np.asarray(seen.of(state, p) if seen.of else column(AT.x, seen.source) * seen.factor) for seen in columns}
    np.testing.assert_allclose(worth["fruits"], AT.x[:, [MODEL.state_index(name) for name in (*N, "nRipe")]].sum(axis=1), rtol=1e-12)
    np.testing.assert_allclose(worth["light_hours"], 24 * column(AT.x, "photoperiod"), rtol=1e-12)
    np.testing.assert_allclose(worth["head_diameter"], 5 + 10 * column(AT.x, "sourceSink"), rtol=1e-12)
    np.testing.assert_allclose(worth["ripe_fruit"], 1e-6 * column(AT.x, "cRipe") / column(AT.p, "dmFruit"), rtol=1e-12)
    for seen in columns:
        if seen.name != "fruits_per_truss":
            assert (worth[seen.name] >= seen.low).all(), seen.name
            assert (worth[seen.name] <= seen.high).all(), seen.name


# The oracle


def stands(at: Inputs, fluxes: Any) -> list[Stand]:
    names = (MODEL.state_names, MODEL.control_names, MODEL.parameter_names)
    p = lambda name: column(at.p, name)  # noqa: E731
    lamps = p("zetaLampPar") * fluxes["rParLampCan"] + p("zetaIntLampPar") * fluxes["rParIntLampCan"]
    absorbed = p("parJtoUmolSun") * fluxes["rParSunCan"] + lamps
    above = p("parJtoUmolSun") * fluxes["rParGhSun"] + p("zetaLampPar") * fluxes["rParGhLamp"]
    climate = np.column_stack([*(column(at.x, name) for name in ("tCan", "tAir", "vpAir", "co2Air")), absorbed, above])
    rows = zip(at.x.tolist(), at.u.tolist(), at.p.tolist(), climate.tolist(), strict=True)
    return [Stand(*(dict(zip(n, v, strict=True)) for n, v in zip(names, row[:3], strict=True)), Climate(*row[3])) for row in rows]


def test_the_rates_are_those_of_a_second_implementation() -> None:
    """To 1e-9 of what a state gains and loses, at 200 points: cold, hot, dark, without fruit, dense, topped, injured, mouldy."""
    differences: dict[str, float] = {}
    for row, stand in enumerate(stands(AT, FLUXES)):
        for name, terms in stand.terms().items():
            size = sum(map(abs, terms))
            difference = abs(RATES[row, MODEL.state_index(name)] - sum(terms))
            differences[name] = max(differences.get(name, 0.0), difference / size if size else float(difference > 0))
    assert set(OWN_STATES) <= set(differences)
    assert {name: size for name, size in differences.items() if size > 1e-9} == {}
    mean, light, away = column(AT.x, "tCan24"), AT.d[:, MODEL.disturbance_names.index("iGlob")], column(AT.u, "uAway")
    empty = AT.x[:, [MODEL.state_index(name) for name in N]].sum(axis=1) == 0
    for some in (mean < 2, mean > 30, light == 0, empty, away == 1, column(AT.u, "uTop") == 1, column(AT.x, "injury") > 0):
        assert 5 < some.sum() < len(AT.x) - 5


def full_load(**fixed: Any) -> Inputs:
    """Crops whose fruits take exactly Vanthoor's flow, without injury, mould and work beyond that of the published crop."""
    at = drawn(mould=0.0, injury=0.0, **dict.fromkeys(HANDS, 0.0), **fixed)
    load, numbers = MODEL.auxiliary_values(*at)["sinkLoad"], [MODEL.state_index(name) for name in N]
    keep = load > 1e-3
    at = Inputs(*(rows[keep] for rows in at))
    at.x[:, numbers] /= load[keep, None]
    return at


def test_with_its_parts_off_and_a_full_load_it_is_the_published_crop() -> None:
    at = full_load()
    rates, fluxes = dict(zip(MODEL.state_names, MODEL.rhs(*at).T, strict=True)), MODEL.auxiliary_values(*at)
    keep = [MODEL.state_index(name) for name in PLAIN.state_names]
    shared = [MODEL.parameter_names.index(name) for name in PLAIN.parameter_names]
    plain = PLAIN.rhs(at.x[:, keep], at.u[:, :6], at.d, at.p[:, shared])
    expected = dict(zip(PLAIN.state_names, plain.T, strict=True))
    theirs = PLAIN.auxiliary_values(at.x[:, keep], at.u[:, :6], at.d, at.p[:, shared])
    assert len(at.x) > 80
    for name in ("mcAirBuf", "mcBufLeaf", "mcBufStem", "mcLeafHar", "mcOrgAir", "hBufOrg", "photoGross"):
        np.testing.assert_array_equal(fluxes[name], theirs[name], err_msg=name)
    np.testing.assert_allclose(fluxes["mcBufFruit"], theirs["mcBufFruit"], rtol=1e-12)
    for name in (*PLAIN.state_names[:21], "cLeaf", "cStem", "tCan24", "tCanSum", "sumMcExtAir", "time"):
        if name not in {"co2Air"}:
            np.testing.assert_array_equal(rates[name], expected[name], err_msg=name)
    size = fluxes["mcAirBuf"] + theirs["mcBufFruit"] + fluxes["mcOrgAir"]
    for name in ("cBuf", "co2Air"):
        assert (np.abs(rates[name] - expected[name]) <= 1e-11 * (size + np.abs(expected[name]))).all()


# What closes


def closes(one: Array, parts: list[Array]) -> None:
    """A sum, to 1e-9 of its terms."""
    size = np.abs(one) + sum(np.abs(part) for part in parts)
    assert (np.abs(one - sum(parts)) <= 1e-9 * size).all()


def rate(name: str) -> Array:
    return column(RATES, name)


def test_carbon_is_in_the_crop_in_the_air_or_has_left() -> None:
    f, per = FLUXES, column(AT.p, "mCo2") / column(AT.p, "mCh2o")
    crop = [rate(name) for name in ("cBuf", "cLeaf", "cStem", "cFruit")]
    lost = [f[name] for name in ("mcLeafHar", "mcLeafRot", "mcFruitHar", "mcFruitAbort", "mcFruitRot")]
    closes(f["mcAirBuf"], [*crop, f["mcBufAir"], f["mcOrgAir"], *lost])
    air = [column(AT.p, f"capCo2{part}") * rate(f"co2{part}") for part in ("Air", "Top")]
    closes(f["mcExtAir"], [*air, *(per * part for part in (*crop, *lost)), f["mcAirOut"], f["mcTopOut"]])


def test_the_stages_and_ripe_fruit_gain_what_all_fruit_gains() -> None:
    at = Inputs(AT.x.copy(), *AT[1:])
    stages = [MODEL.state_index(name) for name in C]
    at.x[:, MODEL.state_index("cFruit")] = at.x[:, stages].sum(axis=1) + column(at.x, "cRipe")
    rates = MODEL.rhs(*at)
    closes(column(rates, "cFruit"), [*rates[:, stages].T, column(rates, "cRipe")])


def test_fruits_that_were_set_are_on_the_plants_picked_aborted_or_rotten() -> None:
    number = [column(AT.x, name) for name in N]
    mould = column(AT.x, "mould")
    rotting = mould / column(AT.p, "tauMould") / 86400 * (1 + mould / (column(AT.p, "mouldShare") + mould / 20))
    abort = np.array([stand.aborting() for stand in stands(AT, FLUXES)])
    picked = (1 - column(AT.u, "uAway")) * column(AT.x, "nRipe") / 7200
    gone = [picked, rotting * (sum(number) + column(AT.x, "nRipe")), abort * sum(number[:7])]
    closes(rate("nSet"), [*(rate(name) for name in (*N, "nRipe")), *gone])


# Leaves


def test_a_topped_crop_keeps_its_leaves_and_stems() -> None:
    """It grows what they respire, where it could grow as much, and loses leaves to crew and mould alone."""
    at = drawn(uTop=1.0, uAway=1.0, mould=0.0)
    rates, fluxes, usual_growth = (
        MODEL.rhs(*at),
        MODEL.auxiliary_values(*at),
        MODEL.auxiliary_values(*drawn(uTop=0.0, uAway=1.0, mould=0.0)),
    )
    for organ in ("Leaf", "Stem"):
        enough = usual_growth[f"mcBuf{organ}"] > fluxes[f"mc{organ}Air"]
        assert 40 < enough.sum() < 160
        assert np.abs(column(rates, f"c{organ}")[enough] / fluxes[f"mc{organ}Air"][enough]).max() < 1e-12
        assert (column(rates, f"c{organ}")[~enough] < 0).all()
    assert not column(rates, "nSet").any()
    assert not column(rates, "trusses").any()


@pytest.mark.parametrize(("leaves", "lost"), [(0.05, 0.0), (0.1, 0.0), (0.15, 0.1), (0.2, 0.2), (0.8, 0.8)])
def test_mould_never_takes_the_last_leaves(leaves: float, lost: float) -> None:
    """Shares of the largest leaf area: that of a crop, and what of it mould takes in its time at most."""
    at = drawn(mould=1.0)
    at.x[:, MODEL.state_index("cLeaf")] = leaves * column(at.p, "cLeafMax")
    share = column(at.p, "tauMould") * 86400 / (1 + 1 / (column(at.p, "mouldShare") + 1 / 20))
    taken = MODEL.auxiliary_values(*at)["mcLeafRot"] * share / column(at.p, "cLeafMax")
    np.testing.assert_allclose(taken, lost, rtol=1e-9, atol=1e-12)


def test_a_crew_leaves_half_of_the_leaves() -> None:
    """Picked at half of the largest rate where the leaves are half of the largest area, whatever more is asked for."""
    for asked in (0.5, 0.8, 1.0):
        at = drawn(uDefoliate=asked, uAway=0.0)
        at.x[:, MODEL.state_index("cLeaf")] = 0.5 * column(at.p, "cLeafMax")
        np.testing.assert_allclose(MODEL.auxiliary_values(*at)["mcLeafHar"], 5e4, rtol=1e-9)


# Derivatives


@pytest.mark.parametrize("wrt", ["x", "u", "d", pytest.param("p", marks=pytest.mark.slow)])
def test_derivatives_equal_those_by_a_complex_step(wrt: str) -> None:
    """Away from a closed screen and from equal air and floor, where a derivative has two sides; see tests/model/test_derivatives.py."""
    screens = AT.u[:, [MODEL.control_names.index(name) for name in ("uThScr", "uBlScr")]]
    two_sided = (np.diff(screens)[:, 0] == 0) | (screens == 1).any(axis=1) | (column(AT.x, "tFlr") == column(AT.x, "tAir"))
    inside = np.flatnonzero(~two_sided)
    at = Inputs(*(rows[inside[:24]] for rows in AT))
    computed, step = MODEL.jacobian(*at, wrt=wrt), 1e-30
    assert np.isfinite(computed).all()
    for place in range(computed.shape[-1]):
        shifted = {name: values.astype(complex) for name, values in zip("xudp", at, strict=True)}
        shifted[wrt][:, place] += 1j * step
        kinds = (MODEL.State, MODEL.Controls, MODEL.Disturbances, MODEL.Parameters)
        records = (record(*shifted[name].T) for record, name in zip(kinds, "xudp", strict=True))
        derivative = MODEL.equations(*records).derivative
        expected = np.array([np.broadcast_to(row, len(at.x)) for row in derivative]).T.imag / step
        size = np.abs(computed[:, :, place]) + np.abs(computed).max(axis=(0, 2)) * 1e-9
        assert (np.abs(computed[:, :, place] - expected) / (size + 1e-300)).max() < 1e-6


# What growers know, as numbers

SHARES = [0.1, 0.5, 0.9]
WEEKS = 15


@cache
def usual() -> Course:
    """Fifteen weeks at 20 °C in 16 hours of light."""
    return grow([Day()] * 7 * WEEKS)


def by_week(course: Course, name: str) -> Array:
    counts: Array = np.diff(course.of(name)[::7])
    return counts


def against_usual(course: Course, name: str) -> Array:
    """Week by week, as a share of what a crop has at 20 °C."""
    share: Array = by_week(course, name) / by_week(usual(), name)[: (len(course.x) - 1) // 7]
    return share


@pytest.mark.parametrize("temperature", [17.0, 20.0])
def test_the_fruits_of_a_day_ripen_as_those_of_50_stages(temperature: float) -> None:
    """Days when 10, 50 and 90 % of them are ripe, from the middle of the day on which they were set."""
    start = mature(t_can24=temperature, c_fruit=0.0)
    start[[*NUMBERS, *MASSES]] = 0.0
    days = [Day(temperature), *[Day(temperature, top=1.0)] * 99]
    course = grow(days, start, abortMax=0.0, growthMould=0.0)
    ripe = (course.of("picked") + course.of("n_ripe")) / course.of("n_set")[-1]
    dates = np.interp(SHARES, ripe, np.arange(len(ripe))) - 0.5
    life = 100 / (0.1 * temperature - 0.066)  # days
    chain, fifty = (erlang(stages, scale=life / stages).ppf(SHARES) for stages in (STAGES, 50))
    np.testing.assert_allclose(dates, chain, atol=0.05)
    np.testing.assert_allclose(chain / fifty - 1, [-0.048, -0.003, 0.037], atol=5e-4)
    np.testing.assert_allclose(dates, fifty, rtol=0.05)
    # The median is picked 50 to 60 days after set at 20 °C, and later when it is colder.
    picked = np.interp(0.5, course.of("picked") / course.of("n_set")[-1], np.arange(len(ripe))) - 0.5
    low, high = {20.0: (50.0, 54.0), 17.0: (59.0, 63.0)}[temperature]
    assert low < picked < high


def test_fewer_stages_miss_those_dates() -> None:
    early = [erlang(stages, scale=1 / stages).ppf(0.1) / erlang(50, scale=1 / 50).ppf(0.1) - 1 for stages in (STAGES - 1, STAGES)]
    assert early[0] < -0.05 < early[1]


def test_a_crop_in_balance_sets_aborts_and_picks_as_many_fruits() -> None:
    course, one = usual(), slice(-2, -1)
    fruits_set, picked, aborted = (by_week(course, name)[one][0] for name in ("n_set", "picked", "aborted"))
    assert fruits_set == pytest.approx(picked + aborted, rel=0.01)
    assert 15 < fruits_set < 9 * 2.5 * 1.02  # a truss of nine flowers a week on each of 2.5 stems, De Koning (1994)
    assert 0.1 < aborted / fruits_set < 0.2
    assert 100 < course.fruits[-1] < 130
    closes(course.of("n_set"), [course.fruits - course.fruits[0], *(course.of(name) for name in ("picked", "aborted", "rotten"))])
    weight = by_week(course, "harvest")[one][0] / picked  # mg
    assert 6e3 < weight < 1e4


def test_a_hot_week_costs_set_and_shows_in_what_is_picked_six_to_eight_weeks_later() -> None:
    course = grow([*[Day()] * 14, *[Day(30.0)] * 7, *[Day()] * 7 * (WEEKS - 3)])
    assert against_usual(course, "n_set")[2] < 0.35
    np.testing.assert_allclose(against_usual(course, "n_set")[3:], 1.0, atol=0.06)  # fewer fruits leave more for the next
    picked = against_usual(course, "picked")
    assert int(np.argmin(picked)) in (8, 9, 10)
    assert picked.min() < 0.75
    assert (picked[3:6] > 0.95).all()
    assert picked[-1] > 0.95


def test_a_dark_week_aborts_young_fruits_and_a_dark_day_few() -> None:
    week, day = (grow([*[Day()] * 14, *[Day(absorbed=20.0)] * dark, *[Day()] * (84 - dark)]) for dark in (7, 1))
    assert against_usual(week, "aborted")[2] > 2.5
    assert against_usual(day, "aborted")[2] < 1.6
    assert against_usual(week, "n_set")[2] < 0.3
    assert week.of("source_sink")[21] < 0.1 < 0.6 < usual().of("source_sink")[21]
    assert int(np.argmin(against_usual(week, "picked"))) in (8, 9, 10)


def test_long_light_injures_and_nights_heal() -> None:
    injury = {hours: grow([Day(absorbed=5600.0 / hours, light_hours=hours)] * 42).of("injury") for hours in (17.0, 18.0, 20.0, 24.0)}
    lost = {hours: 0.65 * course for hours, course in injury.items()}
    assert lost[17.0][-1] < 0.015
    assert lost[18.0][-1] < 0.06
    assert 0.1 < lost[20.0][21] < 0.25
    assert 0.45 < lost[24.0][21] < 0.55
    assert 0.3 < lost[24.0][12] < 0.45
    # Sugar falls with it: injured leaves use less of strong light and of weak.
    bright, usual_light = (grow([Day(light_hours=hours)] * 21 + [Day()] * 28) for hours in (24.0, 16.0))
    made = np.diff(bright.of("assimilates"))[21:] / np.diff(usual_light.of("assimilates"))[21:]
    assert made[0] < 0.7
    assert (np.diff(made) > 0).all()
    healing = bright.of("injury")[[42, 49]]  # when the long days are forgotten
    assert healing[1] / healing[0] == pytest.approx(np.exp(-7 / 28), rel=1e-3)


def test_ten_humid_nights_in_a_row_cost_more_than_twice_as_much_as_ten_apart() -> None:
    wet, dry = Day(night_humidity=97.0), Day()
    row = grow([wet] * 10 + [dry] * 80).of("rotten_mass")[-1]
    apart = grow([wet, *[dry] * 6] * 10 + [dry] * 20).of("rotten_mass")[-1]
    assert row > 2 * apart
    costs = [grow([wet] * nights + [dry] * 30).of("rotten_mass")[-1] for nights in range(4)]
    assert (np.diff(costs, 2) > 0).all()
    assert grow([wet] * 10, growthMould=0.0).of("rotten_mass")[-1] == 0.0


def test_a_crew_that_comes_on_two_days_a_week_picks_nearly_as_much() -> None:
    away = grow([Day(away=float(day % 7 not in (1, 6))) for day in range(7 * WEEKS)])
    picked = [np.diff(away.of("picked"))[day::7].mean() for day in range(7)]
    assert max(picked[day] for day in (0, 2, 3, 4, 5)) == 0.0
    assert min(picked[1], picked[6]) > 3.0
    for name in ("picked", "harvest"):
        assert 0.97 < away.of(name)[-1] / usual().of(name)[-1] <= 1.0


def test_pruned_trusses_carry_fewer_and_heavier_fruits() -> None:
    pruned = grow([Day(prune=0.5)] * 7 * WEEKS)
    assert 0.5 <= against_usual(pruned, "n_set")[-1] < 0.6
    assert against_usual(pruned, "picked")[-1] < 0.65
    weight = against_usual(pruned, "harvest") / against_usual(pruned, "picked")
    assert weight[-1] > 1.2
    assert weight[0] == pytest.approx(1.0, abs=0.02)


def test_a_topped_crop_sets_no_fruit_and_is_picked_empty() -> None:
    topped = grow([*[Day()] * 14, *[Day(top=1.0)] * 84])
    assert (by_week(topped, "n_set")[2:] == 0.0).all()
    assert (np.diff(topped.of("trusses"))[14:] == 0.0).all()
    picked = by_week(topped, "picked")
    assert (picked[2:6] > 0.9 * by_week(usual(), "picked")[2:6]).all()
    assert picked[11:].sum() < 5.0
    assert topped.fruits[-1] < 0.5
