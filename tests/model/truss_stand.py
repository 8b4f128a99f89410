"""The crop with trusses alone, in a climate that a test chooses: integrated by Runge and Kutta's method, with counters of what left it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace
from typing import Any, NamedTuple

import casadi
import numpy as np

from glbench.model.crop.health import rotting
from glbench.model.crop.trusses import CrewControls, TrussParameters, TrussState, TrussTomato
from glbench.model.paper import TOMATO_2
from tests.model.conditions import Array

STEP, STEPS = 1800.0, 48
COUNTERS = ("picked", "harvest", "aborted", "rotten", "rotten_mass", "assimilates")
"""Fruits picked [m-2], what they weigh [mg m-2], fruits aborted and rotten [m-2], rotten fruit and leaves, sugar made [mg m-2]."""
STATES = TrussState._fields
NUMBERS = [STATES.index(f"n_fruit{j}") for j in range(1, 34)]
MASSES = [STATES.index(f"c_fruit{j}") for j in range(1, 34)]


class Day(NamedTuple):
    """A day of a stand: constant but for the light, and for a night that may be humid."""

    temperature: float = 20.0
    """[°C], of canopy and air."""
    absorbed: float = 350.0
    """PAR that the crop absorbs while it is light [umol m-2 s-1]."""
    light_hours: float = 16.0
    night_humidity: float = 75.0
    """Relative humidity from 20:00 to 6:00 [%]; 75 % in the day."""
    co2: float = 1300.0
    """[mg m-3]."""
    away: float = 0.0
    prune: float = 0.0
    top: float = 0.0

    def inputs(self) -> Array:
        """A row each half hour."""
        hour = (np.arange(STEPS) + 0.5) / 2
        light = np.where(hour < self.light_hours, self.absorbed, 0.0)
        humidity = np.where((hour < 6) | (hour > 20), self.night_humidity, 75.0)
        pressure = 0.01 * humidity * 610.78 * np.exp(17.2694 * self.temperature / (self.temperature + 238.3))
        rest = (self.temperature, self.co2, self.away, self.prune, self.top)
        return np.column_stack([light, pressure, *(np.full(STEPS, value) for value in rest)])


@dataclass(frozen=True)
class Course:
    """States at the end of each day, the first before them (days + 1, states), and what has been counted (days + 1, counters)."""

    x: Array
    counted: Array

    def of(self, name: str) -> Array:
        values: Array = self.counted[:, COUNTERS.index(name)] if name in COUNTERS else self.x[:, STATES.index(name)]
        return values

    @property
    def fruits(self) -> Array:
        """On the plants, ripe ones among them [m-2]."""
        number: Array = self.x[:, NUMBERS].sum(axis=1) + self.of("n_ripe")
        return number


@cache
def _one_day(overrides: tuple[tuple[str, float], ...]) -> Any:
    """States and counters after a day, from those before and its inputs. Leaves stay as they are: a crew picks as many as grow."""
    crop, x, w = TrussTomato(), casadi.SX.sym("x", len(STATES)), casadi.SX.sym("w", 7)
    p_all = TOMATO_2.parameters.record(*TOMATO_2.parameters.default(overrides=dict(overrides)))
    p = TrussParameters(*(getattr(p_all, name) for name in TrussParameters._fields))
    light, vapour, temperature, co2, away, prune, top = casadi.vertsplit(w)
    state = TrussState(*casadi.vertsplit(x))
    sun = light / p.par_jto_umol_sun
    surroundings: Any = SimpleNamespace(
        lai=crop.leaf_area_index(state, p),
        light=SimpleNamespace(r_par_gh_sun=sun, r_par_gh_lamp=0.0, r_par_sun_can=sun, r_par_lamp_can=0.0, r_par_int_lamp_can=0.0),
        x=SimpleNamespace(t_can=temperature, t_air=temperature, vp_air=vapour, co2_air=co2),
        p=p_all,
        u=CrewControls(away, prune, 0.0, top),
    )
    fluxes = crop.processes(state, surroundings, p)
    rates = crop.rates(state, surroundings, fluxes, p)._replace(c_leaf=0.0)
    loss, young = rotting(state.mould, p), sum(x[i] for i in NUMBERS[:7])
    counters = (
        (1 - away) * state.n_ripe / 7200,
        fluxes.fruit.mc_fruit_har,
        crop._aborting(state, p) * young,
        loss * (sum(x[i] for i in NUMBERS) + state.n_ripe),
        fluxes.fruit.mc_fruit_rot + fluxes.leaves.mc_leaf_rot,
        fluxes.photosynthesis.mc_air_buf,
    )
    slope = casadi.Function("slope", [x, w], [casadi.vertcat(*rates, *counters)])
    y, n = casadi.MX.sym("y", len(STATES) + len(COUNTERS)), len(STATES)
    held = casadi.MX.sym("w", 7)
    k1 = slope(y[:n], held)
    k2 = slope((y + STEP / 2 * k1)[:n], held)
    k3 = slope((y + STEP / 2 * k2)[:n], held)
    k4 = slope((y + STEP * k3)[:n], held)
    return casadi.Function("step", [y, held], [y + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + k4)]).mapaccum("day", STEPS)


def mature(**values: float) -> Array:
    """A bearing crop at 20 °C."""
    p = TOMATO_2.parameters.record(*TOMATO_2.parameters.default())
    state = TrussTomato().starts()["mature_crop"](19.0, p)._replace(**{"t_can24": 20.0} | values)
    return np.array([float(value) for value in state])


def grow(days: Sequence[Day], start: Array | None = None, **overrides: float) -> Course:
    """A stand through some days, with other parameters by public name."""
    one_day = _one_day(tuple(sorted(overrides.items())))
    y = np.concatenate([mature() if start is None else start, np.zeros(len(COUNTERS))])
    rows, inputs = [y], {day: day.inputs().T for day in set(days)}
    for day in days:
        y = one_day(y, inputs[day]).full()[:, -1]
        rows.append(y)
    courses = np.array(rows)
    return Course(courses[:, : len(STATES)], courses[:, len(STATES) :])
