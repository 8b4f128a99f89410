"""The equations against two independent evaluations of the model."""

from __future__ import annotations

import numpy as np
import pytest

from glbench.model import AUXILIARIES, VARIANTS, auxiliaries, build_rhs, rhs
from glbench.model.paper import Controls, Disturbances, Parameters, State, greenlight
from glbench.model.variants import get_variant
from tests.model.conditions import Inputs, reference_points

POINTS = reference_points()


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("category", list(dict.fromkeys(POINTS.category.tolist())))
def test_derivative_equals_the_reference(variant: str, category: str) -> None:
    reference = POINTS.derivative[variant][POINTS.category == category]

    computed = rhs(*POINTS.of(category), variant=variant)

    assert (np.abs(computed - reference) / (np.abs(reference) + POINTS.rate_scale)).max() < 1e-10


def test_variants_differ_where_the_published_code_does() -> None:
    author, code = (rhs(*POINTS.inputs, variant=variant) for variant in VARIANTS)

    scaled = np.abs(author - code) / (np.abs(author) + POINTS.rate_scale)

    assert 0.1 < scaled.max() < 1


@pytest.mark.parametrize("name", list(POINTS.auxiliaries))
def test_auxiliary_equals_the_reference(name: str) -> None:
    # Where all temperatures are equal, the smooth forms leave a flow of 2e-5 m s-1 through open screens; nothing differs
    # between the two sides then, so no derivative of a state depends on it.
    rows = POINTS.category != "initial_state"
    reference = POINTS.auxiliaries[name][rows]

    computed = auxiliaries(*POINTS.inputs)[name][rows]

    assert (np.abs(computed - reference) / (np.abs(reference) + POINTS.auxiliary_scale[name])).max() < 1e-9


def test_auxiliaries_have_unique_names_units_and_meanings() -> None:
    assert len({entry.name for entry in AUXILIARIES}) == len(AUXILIARIES)
    assert all(entry.unit and entry.meaning for entry in AUXILIARIES)
    assert set(auxiliaries(*(rows[0] for rows in POINTS.inputs))) == {entry.name for entry in AUXILIARIES}


@pytest.mark.parametrize("variant", VARIANTS)
def test_numbers_give_the_same_as_symbols(variant: str) -> None:
    computed = rhs(*POINTS.inputs, variant=variant)

    by_numpy = greenlight(*_records(POINTS.inputs), get_variant(variant)).derivative
    by_floats = greenlight(*_records(Inputs(*(rows[3].tolist() for rows in POINTS.inputs))), get_variant(variant))

    for row, column in zip(computed.T, by_numpy, strict=True):
        np.testing.assert_allclose(row, column, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(computed[3], by_floats.derivative, rtol=1e-9, atol=1e-15)


def test_matrix_symbols_give_the_same_as_scalar_symbols() -> None:
    point = [rows[7] for rows in POINTS.inputs]

    np.testing.assert_allclose(np.array(build_rhs("author", "MX")(*point)), np.array(build_rhs("author", "SX")(*point)), rtol=1e-12)


def test_a_row_gives_the_same_bits_alone_and_in_a_batch() -> None:
    batch = rhs(*POINTS.inputs)

    for index in range(0, len(batch), 13):
        x, u, d, p = (rows[index] for rows in POINTS.inputs)
        np.testing.assert_array_equal(rhs(x, u, d, p), batch[index])


def test_inputs_without_a_batch_axis_apply_to_every_row() -> None:
    x, u, d, p = POINTS.of("day")

    shared = rhs(x, u[0], d[0], p[0])

    first = Inputs(*(np.repeat(rows[:1], len(x), axis=0) for rows in (x, u, d, p)))
    np.testing.assert_array_equal(shared, rhs(x, first.u, first.d, first.p))
    assert rhs(x[:0], u[0], d[0], p[0]).shape == (0, 28)
    assert rhs(x[:1], u[0], d[0], p[0]).shape == (1, 28)
    assert rhs(x[0], u[0], d[0], p[0]).shape == (28,)


def _records(inputs: Inputs) -> tuple[State, Controls, Disturbances, Parameters]:
    x, u, d, p = (np.asarray(rows).T for rows in inputs)
    return State(*x), Controls(*u), Disturbances(*d), Parameters(*p)
