"""Light that counts for the length of a day: dimmed lamps count less, so that a plan is led from bright nights to dark ones."""

from __future__ import annotations

from glbench.model.crop.health import DIM, light_on


def test_darkness_is_no_light_and_lamps_are_nearly_full_light() -> None:
    assert light_on(0.0) == 0.0
    assert light_on(DIM) == 0.5
    assert 0.95 < light_on(200.0) < 1.0


def test_dimming_shortens_the_day_everywhere() -> None:
    for photons in (1.0, 10.0, 50.0, 200.0):
        slope = (light_on(photons + 0.1) - light_on(photons - 0.1)) / 0.2
        assert slope > 1e-4, photons
