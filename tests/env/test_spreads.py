"""Measured widths: the law of the draws, their caps, joint draws and heat, what a task may say, and that nothing else depends on them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from glbench.control.estimator import StateEstimator
from glbench.env import GreenhouseEnv, Simulation
from glbench.env.scenario import RunScenarios
from glbench.env.uncertainty import log_heat, spread_multipliers, stream_key
from glbench.errors import TaskError
from glbench.kernel import why_not_compiled
from glbench.model import TOMATO, paper
from glbench.report.task_words import definition_in_words, for_growers
from glbench.tasks import TaskSpec, get_task
from glbench.tasks.spreads import HEAT, Spread, SpreadRow, read_spread
from tests.env.checking import check_env_for_stable_baselines3
from tests.tasks import toy

GROUP = '[[scenario.parameters]]\nname = "house"\nspread = "measured"\nredraw = "episode"\n'
TASK = """
base = "glbench/SpringYears-v1"
id = "mylab/Measured-v1"
title = "{title}"

[weather]
days = 3

[scenario]
family = "mylab/Measured"

"""
N = 4000
KEYS = np.array([[number, 7] for number in range(N)], np.uint64)
MEASURED = read_spread("measured")
NAMES = [row.parameter for row in MEASURED.rows]
Own = Callable[..., TaskSpec]


@pytest.fixture
def own(tmp_path: Path) -> Own:
    """A task of one's own with a group of parameters."""

    def made(group: str = GROUP, title: str = "Another house in every run") -> TaskSpec:
        path = tmp_path / "own.toml"
        path.write_text(TASK.format(title=title) + group, encoding="utf-8")
        return get_task(path)

    return made


def free(*rows: SpreadRow, factor: float = 1.0) -> Spread:
    """A spread of which no house is refused, unless its rows say how heat follows."""
    return Spread("free", factor, rows)


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_logarithms_have_mean_0_and_the_standard_deviation_of_the_table_times_the_factor(factor: float) -> None:
    rows = [row._replace(low=1e-3, high=1e3, heat_elasticity=0.0) for row in MEASURED.rows]
    logs = np.log(spread_multipliers(free(*rows, factor=factor), KEYS))
    sizes = factor * np.array([row.log_sd for row in rows])
    assert np.abs(logs.mean(axis=0) / sizes).max() < 4.0 / math.sqrt(N)
    assert np.abs(logs.std(axis=0) / sizes - 1.0).max() < 4.0 / math.sqrt(2 * N)
    ordered = np.sort(logs / sizes, axis=0)
    normal = np.array([-1.2816, -0.6745, 0.0, 0.6745, 1.2816])
    assert np.abs(ordered[[N // 10, N // 4, N // 2, 3 * N // 4, 9 * N // 10]] - normal[:, None]).max() < 0.12


def test_no_multiplier_is_beyond_its_caps() -> None:
    row = SpreadRow("x", "x", 0.5, 0.8, 1.6, 0.0)
    drawn = spread_multipliers(free(row), KEYS)[:, 0]
    assert (drawn.min(), drawn.max()) == (0.8, 1.6)
    assert 0.28 < (drawn == 0.8).mean() < 0.38  # ln 0.8 is 0.45 standard deviations below
    real = spread_multipliers(replace(MEASURED, factor=2.0), KEYS)
    low, high = np.array([(row.low, row.high) for row in MEASURED.rows]).T
    assert (real >= low).all()
    assert (real <= high).all()


def test_parameters_of_one_draw_share_its_number_and_others_do_not() -> None:
    drawn = dict(zip(NAMES, np.log(spread_multipliers(MEASURED, KEYS)).T, strict=True))
    assert (drawn["cHecOut1"] == drawn["cHecOut2"]).all()
    assert (drawn["lPipe"] == drawn["lGroPipe"]).all()
    alone = [drawn[name] for name in ("cDgh", "hVent", "cWgh", "kThScr", "cLeakage", "cHecOut1", "cHecIn", "rSMin", "etaGlobAir")]
    correlation = np.corrcoef(alone) - np.eye(len(alone))
    assert np.abs(correlation).max() < 0.25  # houses that are refused make some


def test_a_house_is_drawn_again_while_its_heat_is_outside() -> None:
    hot = SpreadRow("x", "x", 0.5, 0.01, 100.0, 1.0)
    spread = free(hot)
    drawn = np.log(spread_multipliers(spread, KEYS)[:, 0])
    unlimited = np.log(spread_multipliers(free(hot._replace(heat_elasticity=0.0)), KEYS)[:, 0])
    least, most = np.log(HEAT)
    within = (unlimited >= least) & (unlimited <= most)
    assert 0.2 < within.mean() < 0.9
    assert (drawn[within] == unlimited[within]).all()
    assert (drawn >= least).all()
    assert (drawn <= most).all()
    assert len(np.unique(drawn)) > 0.99 * N  # drawn again, not moved to the limit
    again = KEYS[~within][:1]
    assert spread_multipliers(spread, again)[0, 0] == np.exp(drawn[~within][0])


def test_after_32_attempts_the_last_house_is_moved_to_the_limit_and_keeps_its_direction() -> None:
    rows = (SpreadRow("x", "x", 0.3, 0.01, 100.0, 400.0), SpreadRow("y", "y", 0.1, 0.01, 100.0, -300.0))
    logs = np.log(spread_multipliers(free(*rows), KEYS[:200]))
    heat = log_heat(free(*rows), logs)
    at_limit = np.isclose(heat, np.log(HEAT[0])) | np.isclose(heat, np.log(HEAT[1]))
    assert at_limit.mean() > 0.6
    assert (heat >= np.log(HEAT[0]) - 1e-9).all()
    assert (heat <= np.log(HEAT[1]) + 1e-9).all()


def test_the_shipped_spread_keeps_heat_within_the_limits() -> None:
    for factor in (0.5, 1.0, 2.0):
        spread = replace(MEASURED, factor=factor)
        heat = np.exp(log_heat(spread, np.log(spread_multipliers(spread, KEYS))))
        assert heat.min() >= HEAT[0] * (1.0 - 1e-9)
        assert heat.max() <= HEAT[1] * (1.0 + 1e-9)


def test_a_run_has_the_same_house_alone_and_in_any_batch(own: Own) -> None:
    task = own(GROUP + "factor = 2.0\n")
    seeds = list(range(9))
    together = RunScenarios(task).draw(seeds).parameters
    assert together is not None
    for seed in (0, 5, 8):
        one = RunScenarios(task).draw([seed]).parameters
        assert one is not None
        assert (one[0] == together[seed]).all()
    turned = RunScenarios(task).draw(seeds[::-1]).parameters
    assert turned is not None
    assert (turned[::-1] == together).all()
    keys = np.array([stream_key(task.scenario, seed, "parameters house") for seed in seeds], np.uint64)
    places = [task.model_value.parameter_names.index(name) for name in NAMES]
    assert (together[:, places] == task.parameters()[places] * spread_multipliers(replace(MEASURED, factor=2.0), keys)).all()
    others = [place for place, name in enumerate(task.model_value.parameter_names) if name not in NAMES]
    changed = {task.model_value.parameter_names[place] for place in others if (together[:, place] != task.parameters()[place]).any()}
    assert all(task.model_value.parameters.info(name).is_derived for name in changed)
    assert changed, "what follows from the pipes' length is computed again"


@pytest.mark.skipif(bool(why_not_compiled(TOMATO)), reason="needs the compiled kernel")
def test_the_compiled_step_serves_a_task_with_the_spread_and_gives_the_bits_of_numpy(own: Own) -> None:
    task, seeds, rows = own(), [3, 4, 5], []
    for fused in (True, False):
        simulation = Simulation(task, 3, "fast", fused=fused)
        simulation.reset(seeds)
        assert simulation.fused is fused
        for step in range(12):
            result = simulation.step(np.full((3, len(task.actions)), 0.1 * (step % 5)))
        rows.append((result.table.copy(), simulation.x.copy()))
    assert (rows[0][0] == rows[1][0]).all()
    assert (rows[0][1] == rows[1][1]).all()


def test_the_digest_holds_the_factor_and_the_numbers_of_the_table(own: Own, monkeypatch: pytest.MonkeyPatch) -> None:
    digests = [own(GROUP + line).digest for line in ("", "factor = 1.0\n", "factor = 0.5\n", "factor = 2.0\n")]
    assert digests[0] == digests[1]
    assert len(set(digests)) == 3
    wider = (MEASURED.rows[0]._replace(log_sd=0.5), *MEASURED.rows[1:])
    monkeypatch.setattr("glbench.tasks.tables.read_spread", lambda name, factor=1.0: Spread(name, factor, wider))
    assert own(title="The same, but for the numbers of the table").digest not in digests


@pytest.mark.parametrize(
    ("group", "message"),
    [
        (GROUP.replace("measured", "mesured"), r"spread called 'mesured'. Did you mean 'measured'\?"),
        (GROUP + "factor = 0.0\n", "factor = 0.0 is not allowed. It must be a factor above 0, up to 2"),
        (GROUP + "factor = 2.5\n", "factor = 2.5 is not allowed. It must be a factor above 0, up to 2"),
        (GROUP.replace("episode", "step"), 'houses, which do not change during a run: write redraw = "episode"'),
        (GROUP.replace("episode", "day"), 'write redraw = "episode"'),
        (GROUP + 'parameters = ["cDgh"]\n', "leave parameters out, or spread"),
        (GROUP + "half_width = 0.1\n", "leave half_width out, or spread"),
        (GROUP + 'parameters = ["cDgh"]\nhalf_width = 0.1\n', "leave parameters and half_width out, or spread"),
        (GROUP.replace('spread = "measured"', 'parameters = ["cDgh"]\nhalf_width = 0.1\nfactor = 2.0'), "factor scales a spread"),
        (GROUP.replace('redraw = "episode"', ""), "redraw"),
        (GROUP + GROUP.replace('"house"', '"again"'), "'cDgh' is in two groups"),
        (GROUP + '\n[model.overrides]\netaGlobAir = { value = 0.7, unit = "-" }\n', "etaGlobAir .* cannot be 1.9"),
    ],
)
def test_what_cannot_be_drawn_is_refused_in_words(own: Own, group: str, message: str) -> None:
    with pytest.raises(TaskError, match=message):
        _ = own(group).digest


def test_a_model_without_these_parameters_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(paper, "_MODELS", {**paper._MODELS, "toy-1.0.0": {"author": toy.Toy()}})
    path = tmp_path / "toy.toml"
    path.write_text(toy.TASK + GROUP, encoding="utf-8")
    with pytest.raises(TaskError, match=r"\[scenario.parameters\] There is no parameter called 'cDgh'"):
        _ = get_task(path).digest


def test_a_task_tells_in_words_what_is_drawn(own: Own) -> None:
    task = own(GROUP + "factor = 0.5\n")
    lines = " ".join(line for section in definition_in_words(task) for line in section.lines)
    assert "spread 'measured' with factor 0.5, a season's heat within 0.5 to 1.5 times that of the nominal house" in lines
    assert "hVent 0.68 to 1.47 times" in lines
    assert all(name in lines for name in NAMES)
    rows = {row[0]: row[1] for section in for_growers(task) for row in section.rows}
    assert rows["height of one vent opening"] == "0.68 to 1.47 times"


def test_an_estimator_knows_how_far_houses_lie_apart(own: Own) -> None:
    task = own(GROUP + "factor = 2.0\n")
    estimator = StateEstimator(task)
    assert (estimator.parameters > -1e300).all()
    places = [task.model_value.parameter_names.index(row.parameter) for row in MEASURED.rows]
    farther = estimator._episode.complete(estimator._episode.spread[None])[0, places] / task.parameters()[places]
    np.testing.assert_allclose(np.log(farther), [2.0 * row.log_sd for row in MEASURED.rows], rtol=1e-12)


def test_a_draft_of_ones_own_keeps_the_contract_of_an_environment(own: Own) -> None:
    task = own()
    assert task.model_id == "greenlight-tomato-harvest-1.0.0"
    name = "tests/measured-of-a-test"
    gymnasium.register(name, lambda render_mode=None: GreenhouseEnv(task, render_mode=render_mode), disable_env_checker=True)
    try:
        check_env(gymnasium.make(name, render_mode="ansi").unwrapped)
        check_env_for_stable_baselines3(GreenhouseEnv(task), warn=True)
    finally:
        gymnasium.registry.pop(name)
