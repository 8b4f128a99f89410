"""Digests are over canonical JSON: the bytes of the package rfc8785, whatever the value."""

from __future__ import annotations

import json

import pytest
import rfc8785
from hypothesis import example, given
from hypothesis import strategies as st

from glbench.canonical import canonical_json
from glbench.resources import data_folder

WHOLE = st.integers(-(2**53) + 1, 2**53 - 1)
FLOATS = st.floats(allow_nan=False, allow_infinity=False)
TEXTS = st.text(st.characters(exclude_categories=["Cs"]))
VALUES = st.recursive(
    st.none() | st.booleans() | WHOLE | FLOATS | TEXTS,
    lambda parts: st.lists(parts) | st.dictionaries(TEXTS, parts) | st.tuples(parts, parts),
)


@given(VALUES)
@example([0.0, -0.0, 1.0, 1e-4, 9.999e-5, 1e-6, 1e-7, 1e15, 1e16, 1e20, 1e21, 5e-324, 1.7976931348623157e308])
@example({'\x7f\x00\x1f"\\/\n': '\x7f\x00\x1f"\\/\n', "\ue000": 1, "\U0001f600": 2, "é": 3, "e": 4})
def test_it_has_the_bytes_of_the_package(value):
    assert canonical_json(value) == rfc8785.dumps(value)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 2**53, {1: 2}, "\ud800"])
def test_what_json_cannot_hold_is_refused(value):
    with pytest.raises(rfc8785.CanonicalizationError):
        canonical_json([value])


@pytest.mark.slow
def test_every_released_result_has_the_bytes_of_the_package():
    files = sorted(data_folder("reports/released/results").rglob("*.json"))
    assert len(files) > 300
    for path in files:
        value = json.loads(path.read_text(encoding="utf-8"))
        assert canonical_json(value) == rfc8785.dumps(value), path
