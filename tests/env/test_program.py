"""A program with everything a run can have of its own, around a model of two states: compiled and with numpy, to the same bits."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from glbench.env.numpy_environments import NumpyEnvironments
from glbench.env.random import key_of, uniforms
from glbench.kernel import Kernel, why_not_compiled
from glbench.kernel.environment import ActionBounds, Environments, Lookup, ParameterNoise, Program
from glbench.kernel.tape import Recorder, Tape
from tests.kernel.toy import TANK

pytestmark = pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))

N, STEPS, DAY, AHEAD = 11, 12, 4, 3
POOL = 60
INFLOW, OUTFLOW, UPTAKE, LEAK = range(4)
ARRAYS = ("x", "u", "k", "ended", "keys", "days", "first", "parameters", "traits", "memory")
MONEY, DRIFT, HELD = 3, 4, 5
"""Columns of the table."""

generator = np.random.default_rng(3)
WEATHER = generator.uniform(0.0, 1e-3, (POOL, 1))
PRICES = generator.uniform(1.0, 2.0, (POOL, 1))
CALENDAR = np.hstack([np.arange(POOL)[:, None] % DAY * 24.0 / DAY, np.arange(POOL)[:, None] / DAY, PRICES])
WEATHER_TABLE = np.ascontiguousarray(WEATHER, dtype=np.float32)
CLOCK_TABLE = np.ascontiguousarray(CALENDAR[:, :2], dtype=np.float32)


def actuation() -> Tape:
    """The tap goes half way to the action; it sticks by a trait, jitters, and closes when it rains or at a high level."""
    with Recorder() as r:
        action, tap, jitter = r.input("given", 0), r.input("controls", 0), r.input("noise", 0)
        moved = tap + (action - tap) * 0.5 * r.input("trait", 0) + (jitter - 0.5) * 0.1
        moved = moved - 20.0 * r.input("weather", 0) - 0.01 * r.input("before", 0) + 0.001 * r.input("calendar", 0)
        r.output("controls", 0, np.minimum(np.maximum(moved, 0.0), 1.0))
        r.output("memory", 0, r.input("memory", 0) + np.sign(action))  # how often it was told to open
    return r.tape()


def update() -> Tape:
    """A drift of the level's sensor, and the salt as it was measured last: every other step by a noise."""
    with Recorder() as r:
        r.output("memory", 1, r.input("memory", 1) * 0.9 + (r.input("noise", 1) - 0.5) * 0.2)
        measured = np.sign(np.maximum(r.input("noise", 2) - 0.5, 0.0))
        held = r.input("memory", 2)
        r.output("memory", 2, held + measured * (r.input("after", 1) - held))
    return r.tape()


def outcome() -> Tape:
    with Recorder() as r:
        after, before = r.input("after", 0), r.input("before", 0)
        for column, value in enumerate(
            [
                r.input("counter", 0),
                r.input("calendar", 0),
                r.input("calendar", 1),
                after * r.input("calendar", 2) - before * r.input("calendar_before", 2),  # a stock, each at the price of its moment
                r.input("memory", 1),
                r.input("memory", 2),
                r.input("memory", 0) * r.input("trait", 1),
                r.input("controls", 0),
            ]
        ):
            r.output("table", column, value)
        r.output("observation", 0, after + r.input("memory", 1) + 0.01 * r.input("noise", 3))
        r.output("observation", 1, r.input("weather", 0))
    return r.tape()


def followers() -> Tape:
    with Recorder() as r:
        r.output("parameters", UPTAKE, r.input("drawn", INFLOW) * 0.1 + r.input("drawn", OUTFLOW) * r.input("drawn", LEAK))
    return r.tape()


def program(lag: int = 0, own_parameters: bool = True) -> Program:
    bounds = ActionBounds(np.array([-1e-6]), np.array([1.0 + 1e-6]), np.zeros(1), np.ones(1))
    return Program(
        actuation=actuation(), update=update(), outcome=outcome(), followers=followers(), actions=bounds, controls=bounds, steps=STEPS,
        weather=WEATHER, day=DAY, days=(STEPS + 1 + AHEAD + DAY - 1) // DAY, calendar=CALENDAR, lag=lag,
        nominal=TANK.parameters.default(), own_parameters=own_parameters,
        parameter_noise=(ParameterNoise(np.array([INFLOW, OUTFLOW], np.int32), 0.2),
                         ParameterNoise(np.array([OUTFLOW], np.int32), 0.4, DAY)),
        streams=(1, 3), traits=2, memory=3,
        lookups=(Lookup(WEATHER_TABLE, 2, AHEAD, ahead=1), Lookup(CLOCK_TABLE, 2 + AHEAD, clocked=True)),
        columns=2 + AHEAD + 2, width=8, info_columns=3, charges={MONEY: -7.0},
    )  # fmt: skip


def start(environments: Environments, rows: list[int], seeds: list[int], *, own: bool = True) -> None:
    """Start rows with scenarios that are functions of the seed."""
    for row, seed in zip(rows, seeds, strict=True):
        rng = np.random.default_rng(seed)
        environments.x[row] = rng.uniform(0.5, 2.0, 2)
        environments.u[row], environments.k[row], environments.ended[row] = 0.0, 0, False
        environments.keys[row] = [key_of(f"{seed} {stream}") for stream in range(4)]
        environments.days[row] = rng.permutation(POOL // DAY)[: environments.days.shape[1]] * DAY
        environments.first[row] = rng.integers(POOL - STEPS)
        if own:
            environments.parameters[row] = TANK.parameters.default() * rng.uniform(0.5, 1.5, 4)
        environments.traits[row] = rng.normal(1.0, 0.1, 2)
        environments.memory[row] = [0.0, rng.normal(0.0, 0.1), 0.0]
    environments.observe()


@pytest.fixture(scope="module")
def kernel() -> Kernel:
    return Kernel(TANK, 600.0, backend="compiled", preset="fast")


def pair(kernel: Kernel, made: Program, n: int = N) -> Iterator[Environments]:
    compiled = kernel.environments(made, n)
    assert compiled is not None
    yield compiled
    yield NumpyEnvironments(made, n, kernel, 2)


def everything(environments: Environments, row: slice | int = slice(None)) -> list[bytes]:
    arrays: list[np.ndarray[Any, Any]] = [
        getattr(environments, name)
        for name in ("x", "u", "k", "ended", "memory", "observations", "table")
    ]  # fmt: skip
    return [np.ascontiguousarray(array[row]).tobytes() for array in arrays]


def take(environments: Environments, action: np.ndarray[Any, Any], *, directly: bool = False) -> int:
    (environments.direct_controls if directly else environments.actions)[:] = action
    return environments.step_controls() if directly else environments.step()


def actions(steps: int, n: int = N) -> np.ndarray[Any, Any]:
    """Column i is the same for every n."""
    return np.stack([np.random.default_rng([5, row]).uniform(0.0, 1.0, (steps, 1)) for row in range(n)], axis=1)


@pytest.mark.parametrize(("lag", "own"), [(0, True), (1, True), (0, False)])
def test_both_give_the_same_bits_after_every_step_and_reset(kernel: Kernel, lag: int, own: bool) -> None:
    both = tuple(pair(kernel, program(lag, own)))
    for environments in both:
        start(environments, list(range(N)), list(range(100, 100 + N)), own=own)
    assert everything(both[0]) == everything(both[1])
    for number, action in enumerate(actions(STEPS + 4)):
        failed = [take(environments, action, directly=number == 3) for environments in both]
        assert failed == [0, 0]
        assert everything(both[0]) == everything(both[1])
        if number == 5:
            for environments in both:
                start(environments, [2, 7], [900, 901], own=own)
            assert everything(both[0]) == everything(both[1])
    assert both[0].ended.tolist() == [row not in (2, 7) for row in range(N)]
    assert both[0].k.tolist() == [STEPS if row not in (2, 7) else 10 for row in range(N)]


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("n", [1, 8, 40])
def test_a_run_has_the_bits_it_has_alone(n: int, threads: int) -> None:
    kernel = Kernel(TANK, 600.0, backend="compiled", preset="fast", threads=threads)
    many, alone = kernel.environments(program(), n), kernel.environments(program(), 1)
    assert many is not None
    assert alone is not None
    start(many, list(range(n)), list(range(n)))
    start(alone, [0], [n - 1])
    for action in actions(STEPS, n):
        take(many, action)
        take(alone, action[n - 1 :])
        assert everything(many, slice(n - 1, n)) == everything(alone)


def test_states_controls_steps_and_memory_are_all_that_a_run_needs_to_go_on(kernel: Kernel) -> None:
    made = program()
    first = tuple(pair(kernel, made))
    for environments in first:
        start(environments, list(range(N)), list(range(N)))
        for action in actions(5):
            take(environments, action)
    for old, new in zip(reversed(first), pair(kernel, made), strict=True):  # from each way to the other one
        start(new, list(range(N)), list(range(N)))
        for name in ("x", "u", "k", "ended", "memory"):
            getattr(new, name)[:] = getattr(old, name)
        new.observe()
        assert new.observations.tobytes() == old.observations.tobytes()
        for action in actions(4):
            take(new, action)
            take(old, action)
        assert everything(new) == everything(old)


def test_a_stock_is_valued_at_the_price_of_its_moment(kernel: Kernel) -> None:
    for environments in pair(kernel, program()):
        start(environments, list(range(N)), list(range(N)))
        for step, action in enumerate(actions(3)):
            before = environments.x.copy()
            take(environments, action)
            now = CALENDAR[environments.first + step + 1, 2]
            then = CALENDAR[environments.first + step, 2]
            assert environments.table[:, MONEY].tolist() == (environments.x[:, 0] * now - before[:, 0] * then).tolist()


def test_weather_follows_the_runs_own_days_also_in_the_forecast(kernel: Kernel) -> None:
    for environments in pair(kernel, program()):
        start(environments, [0, 1], [5, 6])
        for action in actions(STEPS):
            take(environments, action)
            for row in (0, 1):
                k = int(environments.k[row])
                rows = [int(environments.days[row, step // DAY]) + step % DAY for step in range(k, k + 1 + AHEAD)]
                assert environments.observations[row, 1 : 2 + AHEAD].tolist() == WEATHER_TABLE[rows, 0].tolist()
                clock = CLOCK_TABLE[int(environments.first[row]) + k]
                assert environments.observations[row, 2 + AHEAD :].tolist() == clock.tolist()


def test_a_drift_persists_and_a_measurement_is_held(kernel: Kernel) -> None:
    for environments in pair(kernel, program()):
        start(environments, list(range(N)), list(range(N)))
        drift, held = environments.memory[:, 1].copy(), environments.memory[:, 2].copy()
        for step, action in enumerate(actions(6)):
            take(environments, action)
            numbers = uniforms(environments.keys[:, 3], np.full((N, 1), step + 1), 3)[:, 0]
            drift = drift * 0.9 + (numbers[:, 0] - 0.5) * 0.2
            held = np.where(numbers[:, 1] > 0.5, environments.x[:, 1], held)
            assert environments.table[:, DRIFT].tolist() == drift.tolist()
            assert np.allclose(environments.table[:, HELD], held, rtol=1e-15, atol=0.0)
        assert np.unique(held).size == N


def test_a_failed_step_leaves_the_memory_and_costs_its_charge(kernel: Kernel) -> None:
    results = []
    for environments in pair(kernel, program()):
        start(environments, list(range(N)), list(range(N)))
        take(environments, actions(1)[0])
        environments.x[4, 0] = np.inf
        memory = environments.memory[:, 1:].copy()
        if isinstance(environments, NumpyEnvironments):
            environments._kernel = _Refusing(kernel)
        assert take(environments, actions(1)[0]) == 1
        assert environments.table[4, MONEY] == -7.0
        assert environments.ended.tolist() == [row == 4 for row in range(N)]
        assert environments.memory[4, 1:].tolist() == memory[4].tolist()
        assert (environments.memory[:4, 1] != memory[:4, 0]).all()
        results.append([array[:4].tobytes() for array in (environments.x, environments.memory, environments.table)])
    assert results[0] == results[1]


class _Refusing:
    """A kernel that is not asked to step what is not finite: it raises for it instead of reporting a row."""

    def __init__(self, kernel: Kernel) -> None:
        self._kernel = kernel

    def try_step(self, x: Any, u: Any, d: Any, p: Any) -> Any:
        from glbench.kernel import StepFailure

        bad = ~np.isfinite(x).all(axis=1)
        after, failed = self._kernel.try_step(np.where(bad[:, None], 1.0, x), u, d, p)
        assert failed == []
        after[bad] = x[bad]
        return after, [StepFailure(row, "the state is not finite") for row in np.flatnonzero(bad).tolist()]


def test_values_out_of_bounds_are_refused_and_nothing_is_done(kernel: Kernel) -> None:
    for environments in pair(kernel, program()):
        start(environments, list(range(N)), list(range(N)))
        before = everything(environments)
        for bad in (1.1, np.nan):
            action = actions(1)[0]
            action[9] = bad
            assert take(environments, action) == -1
            assert everything(environments) == before
        environments.ended[9] = True
        assert take(environments, action) == 0
