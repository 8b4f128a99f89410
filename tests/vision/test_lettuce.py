"""Beds of lettuce as triangles, and their pictures."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import vision_render
from glbench.extras import missing
from glbench.vision.lettuce import PLANTS, bed
from glbench.vision.mesh import Mesh, joined, of_grids

MASSES = (3.0, 30.0, 100.0, 300.0, 600.0)


def width(mesh: Mesh) -> float:
    """How far the bed reaches from its middle [m]."""
    return float(np.abs(mesh.vertices[:, :2]).max())


def test_the_same_state_gives_the_same_triangles_and_another_variation_others() -> None:
    one, heads = bed(200.0, 3)
    again, _ = bed(200.0, 3)
    other, others = bed(200.0, 4)
    assert np.array_equal(one.vertices, again.vertices)
    assert np.array_equal(one.colours, again.colours)
    assert one.vertices.shape != other.vertices.shape or not np.allclose(one.vertices, other.vertices)
    assert not np.allclose(heads, others)


def test_plants_of_a_variation_stay_themselves_as_they_grow() -> None:
    (_, small), (_, large) = bed(50.0, 1), bed(400.0, 1)
    assert small / 50.0 == pytest.approx(large / 400.0)


def test_heads_vary_as_the_planting_says() -> None:
    relative = np.concatenate([bed(300.0, variation)[1] for variation in range(8)]) / 300.0
    assert relative.mean() == pytest.approx(1.0, abs=0.03)
    assert relative.std() == pytest.approx(0.10, abs=0.02)
    assert np.ptp(bed(300.0, 0, cv_head=0.0)[1]) == 0.0


def test_heavier_heads_have_more_leaf_and_are_wider_and_higher() -> None:
    beds = [bed(mass, 0)[0] for mass in MASSES]
    for measure in (lambda mesh: mesh.area, width, lambda mesh: mesh.vertices[:, 2].max()):
        sizes = [measure(mesh) for mesh in beds]
        assert sizes == sorted(sizes)
    assert 0.2 < beds[3].area / PLANTS < 0.5, "a head of 300 g has some 0.2 to 0.5 m2 of leaf"
    assert all(np.isfinite(mesh.vertices).all() and mesh.colours.min() >= 0.0 and mesh.colours.max() <= 1.0 for mesh in beds)


def test_a_grid_becomes_triangles_of_its_area() -> None:
    x, y = np.meshgrid(np.linspace(0.0, 2.0, 4), np.linspace(0.0, 3.0, 5), indexing="ij")
    square = of_grids(np.stack([x, y, 0.0 * x], axis=-1)[None], np.ones((1, 4, 5, 3)))
    assert joined([square, square]).area == pytest.approx(2 * 6.0)
    assert np.abs(vision_render.normals(square)) == pytest.approx(np.broadcast_to([0.0, 0.0, 1.0], (20, 3)))


@pytest.mark.slow
@pytest.mark.skipif(bool(missing("mitsuba")), reason="needs the extra vision")
def test_the_same_state_gives_the_same_pixels() -> None:
    renderer = vision_render.Renderer("scalar_rgb", size=24, samples=(2, 2, 2))
    parts, _ = vision_render.lettuce_scene(60.0, 2)
    (one, cover), (again, _) = (renderer.parts(parts, vision_render.ABOVE, seed=5) for _ in range(2))
    assert np.array_equal(one, again)
    assert 0.35 < cover < 0.65
    pictures = [vision_render.under(light, one).astype(int) for light in range(3)]
    assert np.abs(pictures[0] - pictures[2]).mean() > 3.0, "light changes the picture"
