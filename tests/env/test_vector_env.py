"""The vector environment: each row is an environment, to the bit."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from glbench.env import GreenhouseEnv, GreenhouseVectorEnv
from glbench.errors import ActionError, GlbenchError, ShapeError, UnknownNameError
from glbench.tasks import TaskSpec
from tests.env.stepping import StillKernel, walk


def some_fail() -> StillKernel:
    """Rows whose boiler runs at more than 0.95 fail."""
    kernel = StillKernel()
    inner = kernel.try_step

    def try_step(x, u, d, p):  # type: ignore[no-untyped-def]
        kernel.failing = lambda states: u[:, 0] > 0.95
        return inner(x, u, d, p)

    kernel.try_step = try_step  # type: ignore[method-assign]
    return kernel


def assert_same_info(ours: dict[str, object], theirs: dict[str, object]) -> None:
    assert set(ours) == set(theirs)
    for name, value in theirs.items():
        if isinstance(value, dict):
            assert_same_info(ours[name], value)  # type: ignore[arg-type]
        elif name == "final_obs":
            for a, b in zip(ours[name], value, strict=True):  # type: ignore[call-overload]
                assert (a is None and b is None) or (a == b).all()
        else:
            assert np.asarray(ours[name]).tolist() == np.asarray(value).tolist(), name


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_it_behaves_like_gymnasiums_vector_of_single_environments(day: TaskSpec, mode: AutoresetMode) -> None:
    """Over several episodes, of which some end early by a failed step: observations, rewards, flags and infos."""
    single = SyncVectorEnv([lambda: GreenhouseEnv(day, some_fail())] * 4, autoreset_mode=mode)
    native = GreenhouseVectorEnv(day, 4, kernel=some_fail(), autoreset_mode=mode)
    assert native.observation_space == single.observation_space
    assert native.action_space == single.action_space
    assert native.single_action_space == single.single_action_space
    first, info = native.reset(seed=30)
    theirs, their_info = single.reset(seed=30)
    assert (first == theirs).all()
    assert_same_info(info, their_info)
    actions = walk(9, 250, 4)
    actions[:, 2:, 0] += 0.15  # makes the boiler of rows 2 and 3 climb until they fail
    ended = np.zeros(4, dtype=int)
    for action in np.clip(actions, -1, 1):
        ours, theirs_step = native.step(action), single.step(action)
        for a, b in zip(ours[:4], theirs_step[:4], strict=True):
            assert a.dtype == b.dtype
            assert (a == b).all()
        assert_same_info(ours[4], theirs_step[4])
        ended += ours[2]
    assert ended[0] == ended[1] == 2
    assert ended[2:].max() > 2
    assert not ours[3].any()


def test_make_vec_makes_the_native_one() -> None:
    made = gymnasium.make_vec("glbench:glbench/Schiphol2010-Delta10-v1", num_envs=8, vectorization_mode="vector_entry_point")
    assert isinstance(made, GreenhouseVectorEnv)
    assert made.num_envs == 8
    assert made.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    observations, _ = made.reset(seed=1)
    assert made.observation_space.contains(observations)
    observations, rewards, terminated, truncated, info = made.step(made.action_space.sample())
    assert made.observation_space.contains(observations)
    assert rewards.shape == (8,)
    assert terminated.dtype == truncated.dtype == np.bool_
    assert info["epi"].shape == (8,)
    assert info["_epi"].all()
    made.close()


def test_rows_of_the_real_greenhouse_equal_single_environments(day: TaskSpec) -> None:
    native = GreenhouseVectorEnv(day, 3)
    native.reset(seed=[11, 5, 11])
    actions = walk(2, 5, 3)
    actions[:, 2] = actions[:, 0]
    rows = [native.step(action) for action in actions]
    for row, seed in enumerate((11, 5, 11)):
        single = GreenhouseEnv(day)
        single.reset(seed=seed)
        for step, action in zip(rows, actions[:, row], strict=True):
            observation, reward, *_ = single.step(action)
            assert (step[0][row] == observation).all()
            assert step[1][row] == reward
    assert (rows[-1][0][0] == rows[-1][0][2]).all()
    assert (rows[-1][0][0] != rows[-1][0][1]).any()


def test_several_cores_give_the_same_bits(day: TaskSpec) -> None:
    alone, pooled = GreenhouseVectorEnv(day, 3), GreenhouseVectorEnv(day, 3, workers=2)
    try:
        alone.reset(seed=1)
        pooled.reset(seed=1)
        for action in walk(2, 3, 3):
            ours, theirs = alone.step(action), pooled.step(action)
            assert (ours[0] == theirs[0]).all()
            assert (ours[1] == theirs[1]).all()
    finally:
        pooled.close()


def test_in_mode_next_step_the_step_after_the_end_only_resets(day: TaskSpec, still: StillKernel) -> None:
    environment = GreenhouseVectorEnv(day, 2, kernel=still)
    start, _ = environment.reset(seed=1)
    for action in walk(2, 96, 2):
        last = environment.step(action)
    assert last[2].tolist() == [True, True]
    calls = len(still.calls)
    observations, rewards, terminated, _, info = environment.step(np.full((2, 6), np.nan))
    assert len(still.calls) == calls
    assert (observations == start).all()
    assert (rewards.tolist(), terminated.tolist(), info["step"].tolist()) == ([0.0, 0.0], [False, False], [0, 0])
    assert info["_seed"].all()
    assert "epi" not in info


def test_in_mode_disabled_the_user_resets_by_a_mask(day: TaskSpec, still: StillKernel) -> None:
    environment = GreenhouseVectorEnv(day, 2, kernel=still, autoreset_mode="Disabled")
    environment.reset(seed=1)
    environment.step(walk(1, 1, 2)[0])
    _, info = environment.reset(seed=[50, None], options={"reset_mask": np.array([True, False])})
    assert info["seed"].tolist() == [50, 0]
    assert info["_seed"].tolist() == [True, False]
    assert environment.simulation.seeds.tolist() == [50, 2]
    assert environment.simulation.k.tolist() == [0, 1]
    for action in walk(2, 95, 2):
        last = environment.step(action)
    assert last[2].tolist() == [False, True]
    with pytest.raises(GlbenchError, match=r"rows \[1\] have ended. Reset them with the option 'reset_mask'"):
        environment.step(np.zeros((2, 6)))
    environment.reset(options={"reset_mask": np.array([False, True])})
    assert environment.step(np.zeros((2, 6)))[2].tolist() == [True, False]


@pytest.mark.parametrize("number", [0, -1, 2.5, "2", None, True])
def test_an_impossible_number_of_environments_is_refused(day: TaskSpec, number: object) -> None:
    with pytest.raises(ShapeError, match="a whole number of runs, at least one"):
        GreenhouseVectorEnv(day, number)  # type: ignore[arg-type]


@pytest.mark.parametrize("mask", [np.array([1, 0]), np.array([True]), np.array([False, False]), [True, False]])
def test_an_impossible_mask_is_refused(day: TaskSpec, still: StillKernel, mask: object) -> None:
    environment = GreenhouseVectorEnv(day, 2, kernel=still)
    environment.reset(seed=1)
    with pytest.raises(ShapeError, match="'reset_mask' must be an array of 2 booleans"):
        environment.reset(options={"reset_mask": mask})


def test_seeds_count_up_from_the_first_or_are_listed(day: TaskSpec, still: StillKernel) -> None:
    environment = GreenhouseVectorEnv(day, 3, kernel=still)
    assert environment.reset(seed=7)[1]["seed"].tolist() == [7, 8, 9]
    drawn = environment.reset()[1]["seed"].tolist()
    assert environment.reset(seed=[1, 2, 3])[1]["seed"].tolist() == [1, 2, 3]
    environment.reset(seed=7)
    assert environment.reset()[1]["seed"].tolist() == drawn
    assert environment.np_random_seed == (7, 8, 9)
    with pytest.raises(ShapeError, match="2 seeds for 3 environments"):
        environment.reset(seed=[1, 2])


def test_a_bad_action_is_named_with_its_row(day: TaskSpec, still: StillKernel) -> None:
    environment = GreenhouseVectorEnv(day, 3, kernel=still)
    environment.reset(seed=1)
    actions = np.zeros((3, 6), dtype=np.float32)
    actions[2, 1] = np.nan
    with pytest.raises(ActionError, match=r"action 1 \('uCo2'\) of row 2 is nan"):
        environment.step(actions)


def test_what_was_returned_is_not_overwritten(day: TaskSpec, still: StillKernel) -> None:
    environment = GreenhouseVectorEnv(day, 2, kernel=still)
    environment.reset(seed=1)
    step = environment.step(walk(2, 1, 2)[0])
    kept = [array.copy() for array in (*step[:4], step[4]["boiler"])]
    for action in walk(3, 100, 2):
        environment.step(action)
    assert all((a == b).all() for a, b in zip((*step[:4], step[4]["boiler"]), kept, strict=True))


def test_it_renders_a_panel_a_row(day: TaskSpec, still: StillKernel) -> None:
    environment = GreenhouseVectorEnv(day, 2, kernel=still, render_mode="ansi")
    environment.reset(seed=1)
    environment.step(walk(2, 1, 2)[0])
    panels = environment.render()
    assert panels is not None
    assert len(panels) == 2
    assert "step 1 of 96" in panels[1]


def test_a_kernel_and_workers_exclude_each_other(day: TaskSpec, still: StillKernel) -> None:
    with pytest.raises(GlbenchError, match="not both"):
        GreenhouseVectorEnv(day, 2, kernel=still, workers=2)


def test_an_unknown_autoreset_mode_is_refused_with_the_nearest(day: TaskSpec) -> None:
    with pytest.raises(UnknownNameError, match="Did you mean 'NextStep'"):
        GreenhouseVectorEnv(day, 2, autoreset_mode="next_step")
