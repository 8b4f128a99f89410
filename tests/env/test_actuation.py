"""From actions to controls."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glbench.env import Simulation
from glbench.env.actuation import ACTUATIONS, ActionReader, make_actuation, register_actuation
from glbench.errors import ActionError, TaskError, UnknownNameError
from glbench.tasks import Action, TaskSpec, get_task, task_card
from tests.env.stepping import StillKernel

MakeTask = Callable[..., TaskSpec]
SET_POINT = ('kind = "rate"', 'kind = "set_point"')
TWO_CONTROLS = ('controls = ["uBoil", "uCo2", "uThScr", "uVent", "uLamp", "uBlScr"]', 'controls = ["uVent", "uBoil"]')


RATE = make_actuation(get_task("Schiphol2010-Delta00-v1"))


def rows(*values: list[float]) -> np.ndarray:
    return np.array(values, dtype=np.float64)


def test_an_action_of_one_moves_a_control_by_a_tenth() -> None:
    moved = RATE(rows([0.0, 0.5, 0.95, 0.05, 1.0, 0.3]), rows([1.0, 1.0, 1.0, -1.0, -0.5, 0.0]))
    assert moved[0] == pytest.approx([0.1, 0.6, 1.0, 0.0, 0.95, 0.3], abs=1e-15)


@given(st.lists(st.floats(0, 1), min_size=6, max_size=6), st.lists(st.floats(-1, 1), min_size=6, max_size=6))
def test_a_control_stays_between_0_and_1_and_moves_by_at_most_max_change(u: list[float], a: list[float]) -> None:
    moved = RATE(rows(u), rows(a))
    assert moved.min() >= 0.0
    assert moved.max() <= 1.0
    assert np.abs(moved - rows(u)).max() <= 0.1 + 1e-15


def test_a_set_point_is_approached_by_max_change_and_then_met_exactly(make_task: MakeTask) -> None:
    move = make_actuation(make_task(SET_POINT))
    wanted = rows([1.0, 0.0, 0.33, 0.55, 0.5, 0.0])
    moved = move(rows([0.0, 1.0, 0.3, 0.7, 0.5, 0.05]), wanted)
    assert moved[0] == pytest.approx([0.1, 0.9, 0.33, 0.6, 0.5, 0.0], abs=1e-15)
    assert moved[0, 2] == 0.33  # within reach: the very number asked for


def test_controls_that_are_not_granted_stay_at_0(make_task: MakeTask) -> None:
    move = make_actuation(make_task(TWO_CONTROLS))
    # Order of the task: vents, then boiler.
    assert move(np.zeros((1, 6)), rows([1.0, 0.5]))[0].tolist() == [0.05, 0.0, 0.0, 0.1, 0.0, 0.0]


def test_neither_controls_nor_actions_are_changed() -> None:
    u, a = np.full((2, 6), 0.95), np.ones((2, 6))
    RATE(u, a)
    assert (u == 0.95).all()
    assert (a == 1.0).all()


@pytest.fixture(scope="module")
def read() -> ActionReader:
    return ActionReader.of_task(get_task("Schiphol2010-Delta00-v1"))


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (np.nan, r"action 2 \('uThScr'\) of row 1 is nan, which is not a finite number"),
        (np.inf, r"action 2 \('uThScr'\) of row 1 is inf, which is not a finite number"),
        (1.5, r"action 2 \('uThScr'\) of row 1 is 1.5, outside its bounds -1 to 1"),
        (-1.00001, r"action 2 \('uThScr'\) of row 1 is -1.00001, outside its bounds -1 to 1"),
    ],
)
def test_an_impossible_action_is_named_with_row_place_and_value(read: ActionReader, value: float, words: str) -> None:
    actions = np.zeros((3, 6))
    actions[1, 2] = value
    with pytest.raises(ActionError, match=words):
        read(actions, 3)


@pytest.mark.parametrize("given_actions", [np.zeros(6), np.zeros((3, 5)), np.zeros((2, 6)), 0.5, [[0.0] * 6] * 4])
def test_a_wrong_shape_is_named_together_with_the_right_one(read: ActionReader, given_actions: object) -> None:
    with pytest.raises(ActionError, match=r"have shape .*Expected shape \(3, 6\): one row a run, in each uBoil, uCo2"):
        read(given_actions, 3)


def test_words_are_no_actions(read: ActionReader) -> None:
    with pytest.raises(ActionError, match="are not real numbers"):
        read([["open"] * 6], 1)


def test_numbers_of_a_type_that_numpy_does_not_know_are_called_so(read: ActionReader) -> None:
    """JAX's type comes as an array of numpy, PyTorch's as what numpy cannot read."""
    bfloat16 = np.zeros((3, 6), pytest.importorskip("ml_dtypes").bfloat16)
    with pytest.raises(ActionError, match=r"NumPy does not know numbers of type bfloat16: make them float32 first, with .float\(\)"):
        read(bfloat16, 3)


def test_what_float32_rounding_puts_outside_is_the_bound_itself(read: ActionReader) -> None:
    assert read(np.full((1, 6), np.nextafter(np.float32(1.0), np.float32(2.0))), 1).max() == 1.0
    assert read(np.full((1, 6), -1.0 - 9e-7), 1).min() == -1.0


@pytest.mark.parametrize("n", [1, 7, 64])
def test_a_negative_zero_is_a_zero(make_task: MakeTask, n: int) -> None:
    read = ActionReader.of_task(make_task(SET_POINT))
    assert not np.signbit(read(np.full((n, 6), -0.0), n)).any()


def test_rows_that_have_ended_are_not_looked_at(read: ActionReader) -> None:
    actions = np.zeros((2, 6))
    actions[1] = np.nan
    assert np.isfinite(read(actions, 2, np.array([False, True]))).all()
    with pytest.raises(ActionError, match="row 1"):
        read(actions, 2, np.array([True, False]))


def test_the_caller_keeps_its_own_array(read: ActionReader) -> None:
    actions = np.zeros((1, 6))
    read(actions, 1)[:] = 7.0
    assert (actions == 0.0).all()


@pytest.mark.usefixtures("own_words")
def test_a_kind_of_ones_own_works_from_a_task_file(make_task: MakeTask) -> None:
    register_actuation("test_direct", "the action is the control", lambda task: lambda controls, actions: actions.copy())
    move = make_actuation(make_task(('kind = "rate"', 'kind = "test_direct"')))
    assert move(np.zeros((1, 6)), np.full((1, 6), 0.7))[0].tolist() == [0.7] * 6
    with pytest.raises(TaskError, match="test_direct"):
        register_actuation("test_direct", "again", lambda task: lambda controls, actions: actions)


@pytest.mark.usefixtures("own_words")
def test_a_kind_of_ones_own_chooses_its_bounds(make_task: MakeTask) -> None:
    register_actuation("test_degrees", "an angle", lambda task: lambda controls, actions: actions / 90.0, low=-90.0, high=90.0)
    task = make_task(('kind = "rate"', 'kind = "test_degrees"'))
    assert {(action.low, action.high) for action in task_card(task).actions} == {(-90.0, 90.0)}
    assert ActionReader.of_task(task)(np.full((1, 6), 45.0), 1).max() == 45.0
    with pytest.raises(TaskError, match="cannot lie between 1 and 0"):
        register_actuation("test_other", "an angle", lambda task: lambda controls, actions: actions, low=1.0, high=0.0)


@pytest.mark.usefixtures("own_words")
def test_a_kind_of_ones_own_has_other_actions_than_controls(make_task: MakeTask, still: StillKernel) -> None:
    register_actuation(
        "test_two",
        "one number for heat, one for everything else",
        lambda task: lambda controls, actions: np.hstack([actions[:, :1] / 80.0, actions[:, 1:].repeat(5, axis=1)]),
        actions=lambda controls: (Action("pipe", 0.0, 80.0, "degC", "pipe"), Action("rest", 0.0, 0.5)),
    )
    task = make_task(('kind = "rate"', 'kind = "test_two"'))
    card = task_card(task)
    assert card.action_names == ("pipe", "rest")
    assert [bound.tolist() for bound in card.action_bounds] == [[0.0, 0.0], [80.0, 0.5]]
    simulation = Simulation(task, 1, still)
    simulation.reset([1])
    simulation.step([[40.0, 0.25]])
    assert simulation.u[0].tolist() == [0.5, 0.25, 0.25, 0.25, 0.25, 0.25]
    with pytest.raises(ActionError, match="'rest'"):
        simulation.step([[40.0, 0.75]])


@pytest.mark.usefixtures("own_words")
@pytest.mark.parametrize(
    ("moved", "said"),
    [(np.zeros((2, 1)), r"'test_own' of .* shape \(2, 1\); it must be \(2, 6\)"), (np.full((2, 6), np.nan), "not finite numbers")],
)
def test_a_kind_that_returns_no_controls_of_each_run_is_refused(
    moved: np.ndarray, said: str, make_task: MakeTask, still: StillKernel
) -> None:
    register_actuation("test_own", "numbers", lambda task: lambda controls, actions: moved)
    simulation = Simulation(make_task(('kind = "rate"', 'kind = "test_own"')), 2, still)
    simulation.reset([1, 2])
    with pytest.raises(TaskError, match=said):
        simulation.step(np.zeros((2, 6)))


def test_an_unknown_kind_is_refused_with_the_nearest() -> None:
    with pytest.raises(UnknownNameError, match="Did you mean 'set_point'"):
        ACTUATIONS["setpoint"]
