"""Followers: slow states that the compiled kernel holds while the others move, and lets follow at the end of a step."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
import pytest

from docs import follower_error
from glbench.env.scenario import run_weather
from glbench.env.simulation import Simulation
from glbench.episodes import read_log
from glbench.evaluation import evaluate
from glbench.kernel import Kernel, Rows, available, make_kernel, state_scale, why_not_compiled
from glbench.kernel.compiled import CompiledStepper, CompiledUnavailable
from glbench.model import Evaluation, get_model
from glbench.model.expressions import Expr
from glbench.model.quantities import Variable
from glbench.tasks import get_task
from tests.kernel.chain import CHAIN, chain_model, chain_rows
from tests.kernel.known_steps import KnownSteps
from tests.kernel.toy import Decay, Tank, tank_rows

pytestmark = pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))

SCALE = state_scale(CHAIN)
FOLLOWERS = [i for i, state in enumerate(CHAIN.states) if state.follower]
PARAMETERS = ["ripening", "steepness", "loss", "setting", "exchange", "aPipe"]
SUPPLY, RIPE = CHAIN.state_index("supply"), CHAIN.state_index("ripe")
MASSES = [CHAIN.state_index(f"c{j}") for j in range(4)]


@pytest.fixture(scope="module")
def rows(steps_900: KnownSteps) -> Rows:
    return chain_rows(steps_900, 60)


@pytest.fixture(scope="module")
def few(steps_900: KnownSteps) -> Rows:
    """Rows whose derivatives finite differences can see: no two screens as far closed, no screen and no vent at its end."""
    few = chain_rows(steps_900, 3)
    return few._replace(u=0.9 * few.u + [0.03, 0.05, 0.02, 0.04, 0.05, 0.06])


@pytest.mark.parametrize("seconds", [300, 900])
def test_a_step_agrees_with_cvodes_which_integrates_all(steps_300: KnownSteps, steps_900: KnownSteps, seconds: int) -> None:
    rows = chain_rows({300: steps_300, 900: steps_900}[seconds], 25)
    expected = Kernel(CHAIN, float(seconds), backend="cvodes").step(*rows)
    found = Kernel(CHAIN, float(seconds), backend="compiled").step(*rows)
    assert (np.abs(expected - rows.x)[:, FOLLOWERS] / SCALE[FOLLOWERS]).max() > 1e-3
    assert (np.abs(found - expected) / SCALE).max() < 1e-6


def test_what_leaves_the_last_stage_arrives_where_it_goes(rows: Rows) -> None:
    p = CHAIN.parameters.default(overrides={"loss": 0.0})[None]
    for preset in ("reference", "fast"):
        change = Kernel(CHAIN, 900.0, backend="compiled", preset=preset).step(*rows._replace(p=p)) - rows.x
        gained = change[:, MASSES].sum(axis=1) + change[:, RIPE]
        np.testing.assert_allclose(gained, change[:, SUPPLY], rtol=1e-9, atol=1e-8)
        assert change[:, RIPE].max() > 1.0


@pytest.mark.parametrize("preset", ["reference", "fast"])
def test_a_row_has_the_same_bits_wherever_it_is_stepped(rows: Rows, preset: str) -> None:
    kernel = Kernel(CHAIN, 900.0, backend="compiled", preset=preset)
    whole = kernel.step(*rows)
    alone = np.stack([kernel.step(x, u, d, rows.p[0]) for x, u, d in zip(*rows[:3], strict=True)])
    assert alone.tobytes() == whole.tobytes()
    assert Kernel(CHAIN, 900.0, backend="compiled", preset=preset, threads=3).step(*rows).tobytes() == whole.tobytes()
    order = np.random.default_rng(1).permutation(60)
    assert kernel.step(*(table[order] for table in rows[:3]), rows.p).tobytes() == whole[order].tobytes()
    own = np.tile(rows.p, (60, 1))
    for count in (2, 3, 7, 59):
        assert kernel.step(*(table[:count] for table in rows[:3]), own[:count]).tobytes() == whole[:count].tobytes()
    x = rows.x.copy()
    kernel.step_into(x, *rows[1:], x)
    assert x.tobytes() == whole.tobytes()


@pytest.mark.parametrize("width", [1, 2, pytest.param(8, marks=pytest.mark.slow)])
def test_lanes_change_no_bit(rows: Rows, width: int) -> None:
    out, expected = np.empty_like(rows.x), Kernel(CHAIN, 900.0, backend="compiled", preset="fast").step(*rows)
    assert not CompiledStepper(CHAIN, 900.0, preset="fast", width=width).step_rows(*rows, out).any()
    assert out.tobytes() == expected.tobytes()


def test_a_follower_that_is_not_finite_fails_its_row_and_no_other(rows: Rows) -> None:
    kernel, x = Kernel(CHAIN, 900.0, backend="compiled"), rows.x.copy()
    expected = kernel.step(*rows)
    x[[7, 41], MASSES[1]] = -100.0  # its losses divide by zero
    start = x.copy()
    after, failures = kernel.try_step(x, *rows[1:])
    assert [failure.row for failure in failures] == [7, 41]
    assert "c1 is not finite at the end of the step" in failures[0].reason
    kernel.advance(Rows(x, *rows[1:]))
    others = np.setdiff1d(np.arange(60), [7, 41])
    for result in (after, kernel.advance(Rows(x, *rows[1:]))[0]):
        assert result[[7, 41]].tobytes() == start[[7, 41]].tobytes()
        assert result[others].tobytes() == expected[others].tobytes()
    status = CompiledStepper(CHAIN, 900.0).step_rows(x, *rows[1:], x)
    assert np.flatnonzero(status).tolist() == [7, 41]
    assert x[[7, 41]].tobytes() == start[[7, 41]].tobytes()


def test_a_follower_whose_rate_reads_a_state_is_refused_with_both_names() -> None:
    with pytest.raises(CompiledUnavailable, match=r"n0 is a follower, and its rate reads tAir, which is none\. .*Add a state whose rate"):
        CompiledStepper(chain_model(stray=True), 900.0)
    assert available(chain_model(stray=True))[0] == "casadi"


def test_matrices_are_those_of_finite_differences(few: Rows) -> None:
    kernel = Kernel(CHAIN, 900.0, backend="compiled", preset="tight")
    lines = kernel.linearise(*few, parameters=PARAMETERS)
    assert lines.x_next.tobytes() == kernel.step(*few).tobytes()
    numbers = [CHAIN.parameter_names.index(name) for name in PARAMETERS]
    crop = [i for i, name in enumerate(CHAIN.state_names) if name in ("tCan24", "cBuf", "development", "supply", "ripe", "store")]
    cases = [("x", j, lines.dx[:, :, j], 1e-4 * SCALE[j]) for j in (*crop, *FOLLOWERS)]
    cases += [("u", 4, lines.du[:, :, 4], 1e-4), ("d", 0, lines.dd[:, :, 0], 1e-3)]
    cases += [("p", j, lines.dp[:, :, k], 1e-3 * few.p[0, j]) for k, j in enumerate(numbers)]
    for key, j, jacobian, by in cases:
        up, down = getattr(few, key).copy(), getattr(few, key).copy()
        up[:, j] += by
        down[:, j] -= by
        expected = (kernel.step(*few._replace(**{key: up})) - kernel.step(*few._replace(**{key: down}))) / (2.0 * by) / SCALE
        assert np.abs(expected).max() > 0.0, (key, j)
        assert np.abs(jacobian / SCALE - expected).max() < 2e-5 * np.abs(expected).max(), (key, j)


def test_matrices_agree_with_those_of_cvodes(few: Rows) -> None:
    found = Kernel(CHAIN, 900.0, backend="compiled", preset="tight").linearise(*few, parameters=PARAMETERS)
    expected = Kernel(CHAIN, 900.0, backend="casadi").linearise(*few, parameters=PARAMETERS)
    for key, size in (("dx", SCALE), ("du", 1.0), ("dd", 1.0), ("dp", few.p[0][[CHAIN.parameter_names.index(n) for n in PARAMETERS]])):
        ours, theirs = (getattr(of, key) * size / SCALE[:, None] for of in (found, expected))
        assert np.abs(ours - theirs).max() < 1e-4 * np.abs(theirs).max(), key
        at = np.abs(ours - theirs)[:, FOLLOWERS]
        assert at.max() < 2e-3 * np.abs(theirs[:, FOLLOWERS]).max(), key


@pytest.mark.parametrize("preset", ["reference", "fast"])
def test_reverse_is_the_transpose_of_forward(few: Rows, preset: str) -> None:
    kernel, generator = Kernel(CHAIN, 900.0, backend="compiled", preset=preset, threads=2), np.random.default_rng(5)
    weights = generator.normal(size=few.x.shape) / SCALE
    lines = kernel.linearise(*few, parameters=CHAIN.parameter_names)
    _, gradient = kernel.adjoint(*few, weights, parameters=True)
    assert gradient.p is not None
    for ours, jacobian in ((gradient.x, lines.dx), (gradient.u, lines.du), (gradient.d, lines.dd), (gradient.p, lines.dp)):
        expected = np.einsum("ni,nij->nj", weights, jacobian)
        np.testing.assert_allclose(ours, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())
    _, alone = Kernel(CHAIN, 900.0, backend="compiled", preset=preset).adjoint(*(table[0] for table in few), weights[0])
    assert alone.x.tobytes() == gradient.x[0].tobytes()


def test_directions_that_move_only_followers_or_only_clocks(few: Rows) -> None:
    kernel, lines = (Kernel(CHAIN, 900.0, backend="compiled") for _ in range(2))
    matrix = lines.linearise(*few, inputs=("x",)).dx
    seeds = np.zeros((3, len(CHAIN.states)))
    seeds[0, FOLLOWERS] = 0.3
    seeds[1, CHAIN.state_index("time")] = 2.0
    seeds[2, [RIPE, FOLLOWERS[0]]] = 1.0, -0.5
    _, tangents = kernel.forward(*few, dx=seeds[None])
    np.testing.assert_allclose(tangents, np.einsum("nij,kj->nki", matrix, seeds), rtol=1e-12, atol=1e-12)
    assert (tangents[:, 1] == seeds[1]).all()
    _, one = kernel.forward(*few, dx=seeds[0])
    assert one.tobytes() == np.ascontiguousarray(tangents[:, 0]).tobytes()


def test_trajectories_are_steps_one_after_the_other(few: Rows) -> None:
    kernel, steps = Kernel(CHAIN, 900.0, backend="compiled", preset="fast"), 5
    u, d = (np.repeat(table[:, None], steps, axis=1) for table in (few.u, few.d))
    states = kernel.rollout(few.x, u, d, few.p[0])
    x = few.x
    for step in range(steps):
        x = kernel.step(x, *few[1:])
        assert x.tobytes() == np.ascontiguousarray(states[:, step + 1]).tobytes()
    weights = np.random.default_rng(2).normal(size=states.shape) / SCALE
    again, gradient = kernel.rollout_adjoint(few.x, u, d, few.p[0], weights, parameters=True)
    assert again.tobytes() == states.tobytes()
    costate = weights[:, -1]
    for step in reversed(range(steps)):
        _, one = kernel.adjoint(states[:, step], *few[1:], costate)
        costate = weights[:, step] + one.x
        np.testing.assert_allclose(gradient.costates[:, step], costate, rtol=1e-12, atol=1e-14)
    path = kernel.linearise_trajectory(few.x, u, d, few.p[0])
    assert path.x.tobytes() == states.tobytes()
    np.testing.assert_allclose(path.pull(weights).u, gradient.u, rtol=1e-9, atol=1e-12)


class SaltState(NamedTuple):
    level: Annotated[Expr, Variable("m", "water in the tank", scale=1.0, small=1e-3)]
    salt: Annotated[Expr, Variable("kg m-2", "salt in the tank", scale=2.0, small=1e-3, follower=True)]
    drained: Annotated[Expr, Variable("kg m-2", "salt drained so far", scale=2.0, small=1e-3)]


@dataclass(frozen=True)
class SaltTank(Tank):
    """A tank whose salt follows, driven by no state, and nothing but followers and inputs drains."""

    State: ClassVar[type[Any]] = SaltState
    name: ClassVar[str] = "salt-tank"  # type: ignore[assignment]

    def equations(self, x: Any, u: Any, d: Any, p: Any) -> Evaluation:
        level, salt = super().equations(x, u, d, p).derivative
        return Evaluation(SaltState(level, 0.01 * salt, 1e-4 * x.salt * p.uptake), ())


def test_a_follower_may_have_no_driver_and_a_clock_may_read_followers() -> None:
    model, tanks = SaltTank(), tank_rows(70)
    rows = Rows(np.hstack([tanks.x, np.zeros((70, 1))]), *tanks[1:])
    kernel, exact = Kernel(model, 900.0, backend="compiled"), Kernel(model, 900.0, backend="cvodes").step(*rows)
    found = kernel.step(*rows)
    assert np.abs(found - exact)[:, :2].max() < 1e-6
    np.testing.assert_allclose(found[:, 2], 900.0 * 1e-4 * rows.x[:, 1] * rows.p[0, 2], rtol=1e-12)
    lines = kernel.linearise(*rows, parameters=model.parameter_names)
    _, gradient = kernel.adjoint(*rows, np.array([0.3, 1.0, -2.0]), parameters=True)
    for ours, jacobian in ((gradient.x, lines.dx), (gradient.u, lines.du), (gradient.d, lines.dd), (gradient.p, lines.dp)):
        np.testing.assert_allclose(ours, np.einsum("i,nij->nj", [0.3, 1.0, -2.0], jacobian), rtol=1e-10, atol=1e-13)
    leaking = rows._replace(p=np.array([[*rows.p[0, :3], 1e-4]]))  # by the library of the full model
    assert (kernel.step(*leaking)[:, 0] < found[:, 0]).all()
    assert kernel.step(*leaking)[:, 1].tobytes() == found[:, 1].tobytes()


@dataclass(frozen=True)
class SlowDecay(Decay):
    """One state that follows nothing."""

    State: ClassVar[type[Any]] = NamedTuple("State", [("amount", Annotated[Expr, Variable("kg", "amount", follower=True)])])


def test_a_model_with_nothing_to_integrate_is_left_to_casadi() -> None:
    with pytest.raises(CompiledUnavailable, match="no state to integrate"):
        CompiledStepper(SlowDecay(), 900.0)


def test_a_follower_changes_no_digest() -> None:
    assert chain_model(33).digest == chain_model(33, follower=False).digest


def test_hard_steps_of_the_default_task_are_right_to_what_pages_say(tmp_path: Path) -> None:
    """Between 1e-6 and 1e-5 of a state's typical size (docs/kernel-compiled.md), where docs/follower_error.py found the largest error."""
    task, hard = get_task("GreenhouseReal-v1").in_split("validation"), json.loads(follower_error.FIGURES.read_text())
    one = max(hard, key=lambda entry: float(entry["largest"]))
    evaluate(task, one["agent"], out=tmp_path, runs=one["seed"] - task.evaluation.first_seed + 1, episodes="none")
    (record,) = tmp_path.rglob("*.actions.mcap")
    actions, model = read_log(record).actions[:, -1], get_model("greenlight-tomato-2-compartment-1.0.0")
    simulation, weather = Simulation(task, 1), run_weather(task, one["seed"]).values
    simulation.reset([one["seed"]])
    p = simulation.scenarios.draw([one["seed"]]).parameters
    assert p is not None
    together, worst = make_kernel(model, 900.0, backend="casadi", preset="tight"), 0.0
    for step, action in enumerate(actions[: one["step"] + 8]):
        before = simulation.x[0, : len(model.states)]
        simulation.step(action[None])
        if step > one["step"] - 8:
            after = together.step(before, simulation.u[0], weather[step], p[0, : len(model.parameter_names)])
            worst = max(worst, float((np.abs(simulation.x[0, : len(model.states)] - after) / state_scale(model)).max()))
    assert 1e-6 < worst < 1e-5
    assert worst == pytest.approx(one["largest"], rel=0.1)
