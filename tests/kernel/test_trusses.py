"""The crop with trusses stepped: accuracy beside CVODES, bits, what closes over a season, the crew, derivatives."""

from __future__ import annotations

import datetime as dt
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from glbench.kernel import Kernel, Rows, available, state_scale, why_not_compiled
from glbench.kernel.cvodes import paper_cvodes
from glbench.model import relative_humidity
from glbench.model.crop.stages import STAGES
from glbench.model.paper import TOMATO_2
from glbench.weather import disturbances, load_weather
from tests.kernel.known_steps import Array

MODEL = TOMATO_2
SCALE = state_scale(MODEL)
BACKENDS = ("compiled", "casadi", "cvodes")
X, U, D = ({name: place for place, name in enumerate(names)} for names in (MODEL.state_names, MODEL.control_names, MODEL.disturbance_names))
N, C = ([X[f"{kind}Fruit{stage}"] for stage in range(1, STAGES + 1)] for kind in "nc")
FIRST = (dt.date(2010, 1, 8), dt.date(2010, 4, 9), dt.date(2010, 7, 2), dt.date(2010, 10, 8))
"""Winter, spring, summer and autumn; all Fridays."""
DAYS, STEPS = 30, 96
RETURNS = 28
"""The step of a day in which the crew comes to work, at 7:00."""


@cache
def kernel_of(backend: str, preset: str = "reference", seconds: float = 900.0, threads: int = 1) -> Kernel:
    if backend not in available(MODEL):
        pytest.skip(why_not_compiled(MODEL))
    return Kernel(MODEL, seconds, backend=backend, preset=preset, threads=threads)


class Season(NamedTuple):
    """States before each step and after the last, controls and weather (steps, seasons, ...) of four seasons."""

    x: Array
    u: Array
    d: Array


def work(x: Array, d: Array, step: int) -> Array:
    """What a plain grower does: set points of temperature and humidity, lamps from 2:00 to 20:00, a crew on five days a week."""
    hour, day = step % STEPS / 4, step // STEPS
    air, light = x[:, X["tAir"]], d[:, D["iGlob"]]
    humidity = relative_humidity(air, x[:, X["vpAir"]])
    u = np.zeros((len(x), len(U)))
    u[:, U["uBoil"]] = np.clip((np.where(light > 10, 20.0, 17.5) - air) / 3, 0, 1)
    u[:, U["uVent"]] = np.clip(np.maximum((air - 23) / 5, (humidity - 83) / 10), 0, 1)
    u[:, U["uThScr"]] = np.where(light > 10, 0.0, 0.9)
    u[:, U["uCo2"]] = np.where((light > 10) & (u[:, U["uVent"]] < 0.3), 0.5, 0.0)
    u[:, U["uLamp"]] = np.where((2 <= hour < 20) & (light < 200), 1.0, 0.0)
    u[:, U["uAway"]] = float((day + 4) % 7 > 4 or not 7 <= hour < 15)
    return u


@cache
def season(**overrides: float) -> Season:
    record, p = load_weather("schiphol"), MODEL.parameters.default(overrides=overrides)
    steps = DAYS * STEPS
    weather = np.stack([disturbances(record, start=first, steps=steps, step_seconds=900.0).values for first in FIRST], axis=1)
    x, kernel = np.stack([MODEL.start("mature_crop", row, 18.0, p) for row in weather[0]]), kernel_of("compiled")
    states, controls = [x], []
    for step, d in enumerate(weather):
        controls.append(work(x, d, step))
        x = kernel.step(x, controls[-1], d, p[None])
        states.append(x)
    return Season(np.array(states), np.array(controls), weather)


@cache
def steps_of_the_season() -> tuple[Rows, list[str]]:
    """Forty-four steps of all seasons, and what they are."""
    course, generator = season(), np.random.default_rng(0)
    picks: list[tuple[int, int, str, dict[str, float]]] = []
    for row in range(len(FIRST)):
        picks += [(int(step), row, "any", {}) for step in generator.integers(3 * STEPS, DAYS * STEPS, 6)]
        picks += [((7 * week + 3) * STEPS + RETURNS, row, "Monday", {}) for week in (1, 2, 3)]
        topped, pruned = (int(step) for step in generator.integers(3 * STEPS, DAYS * STEPS, 2))
        picks += [(topped, row, "topped", {"uTop": 1.0}), (pruned, row, "pruned", {"uPrune": 0.5, "uDefoliate": 0.4})]
    place = np.array([(step, row) for step, row, _, _ in picks]).T
    x, u, d = (table[tuple(place)].copy() for table in (course.x[:-1], course.u, course.d))
    for k, (*_, changes) in enumerate(picks):
        for name, value in changes.items():
            u[k, U[name]] = value
    return Rows(x, u, d, MODEL.parameters.default()[None]), [kind for _, _, kind, _ in picks]


def size_of_errors(ours: Array, exact: Array) -> dict[str, float]:
    """Largest error of each state as a share of its scale."""
    return dict(zip(MODEL.state_names, (np.abs(ours - exact) / SCALE).max(axis=0).tolist(), strict=True))


# Accuracy


@cache
def exact_step(seconds: float) -> Array:
    after: Array = kernel_of("cvodes", "tight", seconds).step(*steps_of_the_season()[0])
    return after


def test_the_steps_are_of_all_kinds() -> None:
    rows, kinds = steps_of_the_season()
    monday = np.array([kind == "Monday" for kind in kinds])
    assert (rows.u[monday, U["uAway"]] == 0.0).all()
    assert (rows.x[monday, X["nRipe"]] > 2.0).all()  # what ripened at the weekend
    assert (exact_step(900.0)[monday, X["nRipe"]] < 0.95 * rows.x[monday, X["nRipe"]]).all()
    assert rows.d[:, D["tOut"]].min() < 2.0 < 20.0 < rows.d[:, D["tOut"]].max()
    assert rows.x[:, X["wetHours"]].max() > 3.0


@pytest.mark.parametrize("seconds", [300.0, 900.0])
def test_a_step_is_exact_to_a_millionth_of_the_scales(seconds: float) -> None:
    """The followers are held while the others move, and move with their means."""
    errors = size_of_errors(kernel_of("compiled", "reference", seconds).step(*steps_of_the_season()[0]), exact_step(seconds))
    assert {name: size for name, size in errors.items() if size > 1e-6} == {}


@pytest.mark.parametrize("seconds", [300.0, 900.0])
def test_the_standard_preset_is_as_good_as_cvodes_as_the_paper_runs_it(seconds: float) -> None:
    """Or exact to a millionth: states as slow as fruits are nearly exact with CVODES."""
    rows, _ = steps_of_the_season()
    integrator = paper_cvodes(MODEL, 1e-6, seconds)
    theirs = np.array([integrator(x0=x, p=np.r_[u, d])["xf"].full().ravel() for x, u, d in zip(rows.x, rows.u, rows.d, strict=True)])
    paper = size_of_errors(theirs, exact_step(seconds))
    ours = size_of_errors(kernel_of("compiled", "standard", seconds).step(*rows), exact_step(seconds))
    assert {name: size for name, size in ours.items() if size > max(1e-6, paper[name])} == {}
    moving = [state.name for state in MODEL.states if not state.follower]
    assert max(ours[name] for name in moving) < max(paper[name] for name in moving)


@pytest.mark.parametrize(("preset", "limit"), [("standard", 2e-4), ("fast", 2e-3)])
def test_the_other_presets_are_near(preset: str, limit: float) -> None:
    errors = size_of_errors(kernel_of("compiled", preset).step(*steps_of_the_season()[0]), exact_step(900.0))
    assert max(errors.values()) < limit


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("preset", ["reference", "standard", "fast"])
def test_a_row_has_the_same_bits_alone_and_in_a_batch(backend: str, preset: str) -> None:
    rows, _ = steps_of_the_season()
    n = 17 if backend == "compiled" else 3
    rows = Rows(rows.x[:n], rows.u[:n], rows.d[:n], rows.p)
    kernel = kernel_of(backend, preset)
    whole = kernel.step(*rows)
    alone = [kernel.step(x, u, d, rows.p[0]) for x, u, d in zip(*rows[:3], strict=True)]
    assert np.stack(alone).tobytes() == whole.tobytes()
    assert kernel_of(backend, preset, threads=2).step(*rows).tobytes() == whole.tobytes()


# What closes


def test_nothing_grows_apart_over_a_season() -> None:
    """Sum of the stages and ripe fruit against all fruit; both are stepped."""
    x = season().x
    apart = (x[..., C].sum(axis=-1) + x[..., X["cRipe"]]) / x[..., X["cFruit"]] - 1
    assert np.abs(apart).max() < 1e-4
    assert np.abs(np.diff(apart, axis=0)).max() < 1e-6


def test_fruits_of_a_season_are_on_the_plants_picked_aborted_or_rotten() -> None:
    """What is lost by the trapezium rule over steps, what is picked from ripe fruits before and after a step, by the solution for it."""
    x, u, p = season().x, season().u, dict(zip(MODEL.parameter_names, MODEL.parameters.default(), strict=True))
    share = np.maximum(p["abortMax"] - p["abortSlope"] * x[..., X["sourceSink"]], 0)
    aborted = -np.log(1 - share) / (100 / 1.934 * 86400 * 7 / STAGES) * x[..., N[:7]].sum(axis=-1)
    faster = 1 + x[..., X["mould"]] / (p["mouldShare"] + x[..., X["mould"]] / 20)
    rotten = faster * x[..., X["mould"]] / (p["tauMould"] * 86400) * (x[..., N].sum(axis=-1) + x[..., X["nRipe"]])
    before, after, left = x[:-1, :, X["nRipe"]], x[1:, :, X["nRipe"]], np.exp(-900 / 7200)
    ripening = (after - before * left) / (1 - left) / 7200
    picked = np.where(u[..., U["uAway"]] == 0, 900 * ripening - (after - before), 0.0)
    gone = picked.sum(axis=0) + sum(900 * (rate[1:] + rate[:-1]).sum(axis=0) / 2 for rate in (aborted, rotten))
    there = x[..., N].sum(axis=-1) + x[..., X["nRipe"]]
    np.testing.assert_allclose(x[-1, :, X["nSet"]], there[-1] - there[0] + gone, rtol=2e-5)
    assert (gone > 40).all()


def test_fruits_that_nobody_picks_and_nothing_takes_are_those_that_were_set() -> None:
    """To 2e-9 of the fruits: those in stages follow, ripe ones move with the climate, and what goes over is held within the step."""
    rows, _ = steps_of_the_season()
    x, u, p = rows.x.copy(), rows.u.copy(), MODEL.parameters.default(overrides={"growthMould": 0.0, "abortMax": 0.0, "abortSlope": 0.0})
    x[:, X["mould"]], u[:, U["uAway"]] = 0.0, 1.0
    fruits = [*N, X["nRipe"]]
    for _ in range(8):
        before, x = x, kernel_of("compiled").step(x, u, rows.d, p[None])
        gained = (x - before)[:, fruits].sum(axis=1)
        np.testing.assert_allclose(gained, (x - before)[:, X["nSet"]], rtol=0, atol=2e-9 * before[:, fruits].sum(axis=1).max())
        assert (gained > 0).any()


def test_what_is_picked_is_metered() -> None:
    x = season().x
    harvest = x[-1, :, X["sumMcFruitHar"]]
    fresh = 1e-6 * harvest / MODEL.parameters.default()[MODEL.parameter_names.index("dmFruit")]
    assert ((fresh > 2.0) & (fresh < 12.0)).all()  # kg m-2 in a month, from a crop that bears at its start
    week = 7 * STEPS
    fade = np.exp(-np.arange(DAYS * STEPS)[::-1] / week)[:, None]
    kept = (np.diff(x[..., X["sumMcFruitHar"]], axis=0) * fade).sum(axis=0)
    np.testing.assert_allclose(x[-1, :, X["cWeek"]], kept, rtol=2e-3)


# The crew


def test_a_crew_that_is_away_picks_neither_fruit_nor_leaves() -> None:
    rows, _ = steps_of_the_season()
    u = rows.u.copy()
    u[:, U["uAway"]] = 1.0
    x = rows.x.copy()
    x[:, X["cLeaf"]] = 1.2e5
    after = kernel_of("compiled").step(x, u, rows.d, rows.p)
    assert (after[:, X["sumMcFruitHar"]] == x[:, X["sumMcFruitHar"]]).all()
    assert (after[:, X["cLeaf"]] > 0.999 * x[:, X["cLeaf"]]).all()
    u[:, U["uAway"]] = 0.0
    there = kernel_of("compiled").step(x, u, rows.d, rows.p)
    assert (there[:, X["cLeaf"]] < 1.01e5).all()
    ripe = rows.x[:, X["nRipe"]] > 2.0
    assert (there[ripe, X["nRipe"]] < 0.9 * after[ripe, X["nRipe"]]).all()


def test_a_topped_crop_full_of_mould_can_be_stepped_to_its_end() -> None:
    """Ten weeks from October in a wet house, with as few leaves as a crew leaves: photosynthesis has a pole at none."""
    steps, p = 70 * STEPS, MODEL.parameters.default()
    weather = disturbances(load_weather("schiphol"), start=FIRST[-1], steps=steps, step_seconds=900.0).values
    x, u, mould = MODEL.start("mature_crop", weather[0], 18.0, p), np.zeros(len(U)), []
    u[[U[name] for name in ("uThScr", "uDefoliate", "uTop")]] = 1.0
    for d in weather:
        u[U["uBoil"]] = np.clip((16.0 - x[X["tAir"]]) / 3, 0, 1)
        x = kernel_of("compiled", "fast").step(x, u, d, p)
        mould.append(x[X["mould"]])
    assert max(mould) > 0.01
    assert 0.25 < x[X["cLeaf"]] * p[MODEL.parameter_names.index("sla")] < 0.6


# Derivatives


@pytest.mark.slow
def test_derivatives_of_a_step_are_those_of_finite_differences() -> None:
    """Compiling them takes minutes where it has not been done."""
    every, kinds = steps_of_the_season()
    pick = [kinds.index("Monday"), kinds.index("pruned")]
    rows = Rows(*(table[pick].copy() for table in every[:3]), every.p)
    rows.u[:, 6:] = np.random.default_rng(2).uniform(0.2, 0.8, (2, 4))
    lines, kernel = kernel_of("compiled").linearise(*rows), kernel_of("compiled", "tight")
    wanted = [("x", X[name]) for name in ("nFruit3", "cFruit20", "cRipe", "wetHours", "injury", "sourceSink", "tCan24")]
    for key, column in (*wanted, *(("u", U[name]) for name in ("uAway", "uPrune", "uTop"))):
        by = 1e-4 * (SCALE[column] if key == "x" else 1.0)
        moved = []
        for sign in (1.0, -1.0):
            table = getattr(rows, key).copy()
            table[:, column] += sign * by
            moved.append(kernel.step(*rows._replace(**{key: table})))
        expected = (moved[0] - moved[1]) / (2e-4) / SCALE
        jacobian = (lines.dx if key == "x" else lines.du)[:, :, column] * (by / 1e-4) / SCALE
        assert np.abs(jacobian - expected).max() < 1e-5 * max(1.0, np.abs(expected).max()), (key, column)
        assert np.abs(expected).max() > 1e-4, (key, column)
