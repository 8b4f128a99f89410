"""Air as growers know it: the model's formulas, the same bits in every batch."""

from __future__ import annotations

import numpy as np
import pytest

from glbench.env.air import read_air
from glbench.model import co2_ppm, relative_humidity


def parcels(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    return rng.uniform(-20, 60, n), rng.uniform(300, 4000, n), rng.uniform(100, 6000, n)


def test_it_evaluates_the_models_own_formulas() -> None:
    temperature, density, pressure = parcels(200)
    air = read_air(temperature, density, pressure)
    assert (air[0] == temperature).all()
    assert air[1] == pytest.approx(co2_ppm(temperature, density), rel=1e-14)
    assert air[2] == pytest.approx(np.clip(relative_humidity(temperature, pressure), 0, 100), rel=1e-13)


def test_400_ppm_weigh_732_mg_a_cubic_metre_at_20_degrees() -> None:
    assert read_air(np.array([20.0]), np.array([731.82]), np.array([2325.98]))[1:, 0] == pytest.approx([400.0, 100.0], rel=1e-5)


def test_supersaturated_air_shows_100_percent() -> None:
    assert read_air(np.array([20.0]), np.array([700.0]), np.array([2600.0]))[2, 0] == 100.0


@pytest.mark.parametrize("n", [1, 7, 30, 64])
def test_a_row_has_the_same_bits_in_every_batch_and_layout(n: int) -> None:
    temperature, density, pressure = parcels(64)
    every = read_air(temperature, density, pressure)
    assert (read_air(temperature[:n], density[:n], pressure[:n]) == every[:, :n]).all()
    columns = np.stack([temperature, density, pressure], axis=1)[64 - n :][::-1]  # strided, reversed
    assert (read_air(columns[:, 0], columns[:, 1], columns[:, 2]) == every[:, 64 - n :][:, ::-1]).all()
