"""Rows of tomatoes as triangles, and what is counted on them."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.vision_render import OWN_ROWS, ROWS, STATES, fruits_of, tomato_scene, tomato_states
from glbench.vision.mesh import Mesh, tubes
from glbench.vision.tomato import LENGTH, PITCH, RIPE, STEMS, row

FULL = fruits_of(1.0, 110.0, 10.0)


def redness(mesh: Mesh) -> np.ndarray:
    """Reflectance in red over that in green, of each vertex."""
    return np.asarray(mesh.colours[:, 0] / mesh.colours[:, 1])


def test_the_same_state_gives_the_same_triangles_and_another_variation_others() -> None:
    one, again, other = row(3.0, FULL, 2), row(3.0, FULL, 2), row(3.0, FULL, 3)
    for name in ("leaves", "stems", "fruit"):
        mesh = getattr(one, name)
        assert np.array_equal(mesh.vertices, getattr(again, name).vertices)
        assert np.array_equal(mesh.colours, getattr(again, name).colours)
        assert np.isfinite(mesh.vertices).all()
        assert mesh.colours.min() >= 0.0
        assert mesh.colours.max() <= 1.0
    assert not np.array_equal(one.fruits, other.fruits)


@pytest.mark.parametrize("index", [0.3, 1.2, 3.0, 4.5])
def test_a_row_has_the_leaf_area_it_is_asked_for(index: float) -> None:
    assert row(index, FULL, 1).leaves.area / (LENGTH * PITCH) == pytest.approx(index)


def test_stems_have_about_the_fruits_of_the_crop_and_differ() -> None:
    rows = [row(3.0, FULL, variation) for variation in range(12)]
    fruits, ripe = (np.stack([getattr(one, name) for one in rows]) for name in ("fruits", "ripe"))
    assert fruits.shape == (12, round(LENGTH * PITCH * STEMS))
    assert STEMS * fruits.mean() == pytest.approx(120.0, rel=0.03)
    assert STEMS * ripe.mean() == pytest.approx(10.0, rel=0.1)
    assert 0.05 < fruits.std() / fruits.mean() < 0.15
    assert (ripe <= fruits).all()


def test_ripe_fruits_are_red_and_hang_lowest() -> None:
    mesh = row(3.0, FULL, 0).fruit
    red, height = redness(mesh) > 3.0, mesh.vertices[:, 2]
    assert 0.05 < red.mean() < 0.25
    assert height[red].mean() < height[~red].mean() - 0.4
    unripe = row(3.0, fruits_of(0.6, 110.0, 0.0), 0)
    assert unripe.ripe.sum() == 0
    assert redness(unripe.fruit).max() < 3.0


def test_a_young_crop_is_low_and_has_flowers_alone() -> None:
    young, old = row(0.4, fruits_of(0.0, 110.0, 0.0), 0), row(3.0, FULL, 0)
    assert young.fruits.sum() == 0
    assert len(young.fruit.vertices) > 0
    assert young.leaves.vertices[:, 2].max() < 1.5
    assert 2.3 < old.leaves.vertices[:, 2].max() < 3.0
    assert old.leaves.vertices[:, 2].min() > old.fruit.vertices[:, 2].min(), "the lowest fruits hang where leaves were taken off"


def test_plants_of_a_variation_stay_themselves_as_they_grow() -> None:
    one, other = (row(index, FULL, 4) for index in (2.9, 3.0))
    assert np.array_equal(one.fruits, other.fruits)
    assert np.array_equal(one.fruit.vertices, other.fruit.vertices), "the fruits alone decide how tall these plants are"


def test_fruits_by_stage_add_up() -> None:
    assert FULL.sum() == pytest.approx(120.0)
    assert FULL[round(RIPE * len(FULL)) :].sum() == pytest.approx(10.0)
    half = fruits_of(0.5, 110.0, 0.0)
    assert half.sum() == pytest.approx(55.0)
    assert not half[20:].any()


def test_scenes_shown_are_of_rows_that_the_encoder_never_sees() -> None:
    states = tomato_states()
    variations = np.array([variation for variation, _, _ in states])
    assert np.array_equal(variations[:OWN_ROWS], np.arange(OWN_ROWS))
    assert {*variations[OWN_ROWS:]}.isdisjoint(variations[:OWN_ROWS])
    assert np.array_equal(np.bincount(variations[OWN_ROWS:] - OWN_ROWS), np.full(ROWS, STATES))
    indices = np.array([index for _, index, _ in states])
    assert 0.3 <= indices.min() < 0.4
    assert 4.0 < indices.max() <= 4.5


def test_a_scene_has_the_row_and_what_is_around_it() -> None:
    parts, one = tomato_scene(2.0, FULL, 5)
    assert [*parts] == ["leaves", "fruit", "stems", "house"]
    assert parts["leaves"][0].area == pytest.approx(2 * one.leaves.area), "another row stands behind"


def test_a_tube_is_as_long_and_thick_as_it_is_asked_for() -> None:
    ends = np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 2.0]], [[1.0, 0.0, 0.0], [4.0, 0.0, 0.0]]])
    mesh = tubes(ends, 0.1, (0.1, 0.2, 0.3))
    assert mesh.area == pytest.approx(5.0 * 4.0 * 0.1 * np.sqrt(2.0))
    assert mesh.vertices[:, 2].max() == pytest.approx(2.0)
    assert np.abs(mesh.vertices[:, 1]).max() == pytest.approx(0.1)
