"""Parameters: the table, the named sets, overrides, derived entries and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

from glbench.errors import ParameterError, ShapeError, UnknownNameError
from glbench.model import (
    PARAMETER_NAMES,
    PARAMETER_SETS,
    PARAMETERS,
    crop_parameter_set,
    default_parameters,
    parameter_group,
    recompute_derived,
)
from glbench.model.greenlight import SHARES
from glbench.model.parameter_table import ParameterInfo
from glbench.model.units import same_unit
from tests.model.conditions import reference_points

DERIVED = [info for info in PARAMETERS if info.is_derived]


def value(vector: np.ndarray[tuple[int], np.dtype[np.float64]], name: str) -> float:
    return float(vector[PARAMETER_NAMES.index(name)])


def test_the_table_is_complete() -> None:
    assert len(PARAMETERS) == len(set(PARAMETER_NAMES)) == 208
    for info in PARAMETERS:
        assert info.unit
        assert info.meaning
        assert info.source
        assert info.check in ("fraction", "positive", "nonnegative", "negative", "any")
        assert info.used in ("yes", "always", "derived", "inactive", "no")
        assert ("benchmark" in info.values) != info.is_derived
    assert len(DERIVED) == 20


def test_the_benchmark_has_the_parameters_of_the_reference_points() -> None:
    np.testing.assert_array_equal(default_parameters(), reference_points().of("day").p[0])


@pytest.mark.parametrize("info", DERIVED, ids=lambda info: info.name)
def test_derived_entries_follow_the_formula_in_the_table(info: ParameterInfo) -> None:
    generator = np.random.default_rng(1)
    p = default_parameters() * generator.uniform(0.9, 1.1, 208)
    entries = dict(zip(PARAMETER_NAMES, recompute_derived(p).tolist(), strict=True))

    formula = info.formula.replace("^", "**")
    by_table = eval(formula, {"exp": math.exp, "pi": math.pi}, entries)  # the formula is the table's own

    assert entries[info.name] == pytest.approx(by_table, rel=1e-14)


def test_an_override_is_carried_through_to_the_derived_entries() -> None:
    higher = default_parameters(overrides={"hAir": 5.0, "laiMax": 2.66})

    assert value(higher, "capAir") == pytest.approx(5.0 * 1.2 * 1000)
    assert value(higher, "capTop") == pytest.approx(1.2 * 1.2 * 1000)
    assert value(higher, "capCo2Top") == pytest.approx(1.2)
    assert value(higher, "cLeafMax") == pytest.approx(1e5)
    assert value(higher, "capFlr") == value(default_parameters(), "capFlr")


def test_derived_entries_of_many_rows_are_computed_at_once() -> None:
    rows = np.tile(default_parameters(), (3, 1))
    rows[:, PARAMETER_NAMES.index("sla")] = [2e-5, 3e-5, 4e-5]

    computed = recompute_derived(rows)

    np.testing.assert_allclose(computed[:, PARAMETER_NAMES.index("cLeafMax")], [1.5e5, 1e5, 7.5e4])
    with pytest.raises(ShapeError, match=r"shape \(207,\); expected \(208,\)"):
        recompute_derived(rows[0, 1:])


def test_every_named_set_is_possible() -> None:
    for name in PARAMETER_SETS:
        assert np.isfinite(default_parameters(name)).all()


def test_only_the_published_thermal_screen_uses_more_light_than_there_is() -> None:
    for name in PARAMETER_SETS:
        entries = dict(zip(PARAMETER_NAMES, default_parameters(name).tolist(), strict=True))
        excess = {shares.parts for shares in SHARES if sum(entries[part] for part in shares.parts) > 1 + 1e-9}
        published = {
            "benchmark": {("tauThScrPar", "rhoThScrPar"), ("tauThScrNir", "rhoThScrNir")},
            "hps_2020": {("tauThScrPar", "rhoThScrPar")},
            "led_2020": {("tauThScrPar", "rhoThScrPar")},
        }
        assert excess == published.get(name, set())


def test_the_sets_of_the_author_are_other_houses() -> None:
    assert value(default_parameters("hps_2020"), "thetaLampMax") == 110
    assert value(default_parameters("hps_2020"), "epsGroPipe") == 0.88
    assert value(default_parameters("led_2021"), "aFlr") == 40000
    assert value(default_parameters("led_2021"), "cFruitMax") == 3e5
    # The author's tables do not name it: the number of the equation, as in the benchmark.
    assert value(default_parameters("led_2021"), "minWind") == 0.25


def test_lamps_of_one_set_fit_into_the_house_of_another() -> None:
    lamps = parameter_group("lamps", "hps_2021")

    mixed = default_parameters("benchmark", lamps)

    changed = {name for name in PARAMETER_NAMES if value(mixed, name) != value(default_parameters(), name)}
    assert changed <= set(lamps)
    assert {"thetaLampMax", "etaLampPar", "zetaLampPar", "etaLampCool"} <= changed


def test_the_28_uncertain_crop_parameters_are_crop_properties() -> None:
    narrow, wide = crop_parameter_set("crop28"), crop_parameter_set("crop34")

    assert len(narrow) == 28
    assert wide == PARAMETER_NAMES[128:162]
    assert set(wide) - set(narrow) == {"globJtUmol", "t25k", "mCh2o", "mCo2", "parJtoUmolSun", "cLeafMax"}


@pytest.mark.parametrize("given", [110, 110.0, np.float64(110), "110", "110 W m-2", "110 W/m2", (110, "W m^-2"), (110, "W·m⁻²")])
def test_a_value_may_state_its_unit(given: object) -> None:
    assert value(default_parameters(overrides={"thetaLampMax": given}), "thetaLampMax") == 110  # type: ignore[dict-item]


@pytest.mark.parametrize(
    ("one", "other"),
    [("degC", "°C"), ("m2/m2", "-"), ("", "-"), ("umol J-1", "µmol/J"), ("m s-1 K-0.66", "m/s/K^0.66"), ("°C day", "day °C")],
)
def test_units_are_compared_by_meaning(one: str, other: str) -> None:
    assert same_unit(one, other)


@pytest.mark.parametrize(("one", "other"), [("kW", "W"), ("W", "W m-2"), ("m2", "m-2"), ("%", "-"), ("degC", "K"), ("s", "S")])
def test_other_units_are_not_converted(one: str, other: str) -> None:
    assert not same_unit(one, other)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"aCov": math.nan}, "aCov .* cannot be nan m2: it must be finite and above 0"),
        ({"hFlr": -0.02}, "hFlr .* cannot be -0.02 m: it must be finite and above 0"),
        ({"lPipe": math.inf}, "lPipe .* cannot be inf m m-2"),
        ({"tauRfPar": 1.2}, "tauRfPar .* between 0 and 1"),
        ({"tauRfPar": 0.9}, r"More than all of PAR on the roof.*tauRfPar 0.9 \+ rhoRfPar 0.13 = 1.03"),
        ({"etaLampPar": 0.5}, "More than all of the lamps' power"),
        ({"rhoThScrPar": 0.3}, r"tauThScrPar 0.75 \+ rhoThScrPar 0.3 = 1.05"),
        ({"hGh": 5.5}, r"hAir \(5.7\) must be below hGh \(5.5\): the main air lies below the ridge"),
        ({"phiPipeI": 0.06}, r"phiPipeI \(0.06\) must be below phiPipeE \(0.051\)"),
        ({"tCanMin": 40.0}, r"tCanMin \(40\) must be below tCanMax \(34\)"),
        ({"aRoof": 0.0}, "the model needs vents"),
        ({"lPipe": 0.0}, "capPipe .* cannot be 0 J K-1 m-2.* It follows from others: capPipe = .*lPipe"),
        ({"sRsSlope": 1.0}, "sRsSlope .* below 0"),
        ({"thetaLampMax": "116 kW m-2"}, "thetaLampMax .* is in W m-2, not in 'kW m-2'. Convert the value first"),
        ({"tauRfPar": (57, "%")}, "tauRfPar .* is in -, not in '%'"),
        ({"thetaLampMax": "a lot"}, "give a number in its unit .W m-2., or a text such as '116 W m-2'"),
        ({"thetaLampMax": True}, "thetaLampMax cannot be True"),
        ({"thetaLampMax": None}, "thetaLampMax cannot be None"),
        ({"capAir": 7000.0}, "capAir = hAir.rhoAirCap.cPAir, which gives 6840 J K-1 m-2. Change hAir or rhoAirCap or cPAir"),
        ({"cLeafMax": 1e5}, "Change laiMax or sla instead"),
    ],
)
def test_impossible_values_are_refused(overrides: dict[str, object], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        default_parameters(overrides=overrides)  # type: ignore[arg-type]


def test_a_derived_value_that_agrees_with_its_formula_is_accepted() -> None:
    given = default_parameters(overrides={"laiMax": 2.66, "cLeafMax": 1e5, "tauThScrPar": 0.75})

    assert value(given, "cLeafMax") == pytest.approx(1e5, rel=1e-15)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: default_parameters(overrides={"thetaLampmax": 1.0}), "no parameter 'thetaLampmax'.*'thetaLampMax'"),
        (lambda: default_parameters("benchmrk"), "no parameter set 'benchmrk'.*'benchmark'"),
        (lambda: parameter_group("lamp"), "no group of parameters 'lamp'.*'lamps'"),
        (lambda: crop_parameter_set("crop27"), "no set of crop parameters 'crop27'.*'crop28'"),
    ],
)
def test_unknown_names_are_answered_with_the_nearest(call: object, message: str) -> None:
    with pytest.raises(UnknownNameError, match=message):
        call()  # type: ignore[operator]


def test_the_vector_handed_out_is_not_shared() -> None:
    default_parameters()[0] = 99.0

    assert default_parameters()[0] == 5.0
