"""One agent a run and one agent for all runs are the same to an evaluation; actions are judged run by run."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.agents import Agent, FairRuleBasedAgent, PerRunAgent, RuleSettings, SingleRunAgent, action_problems
from glbench.errors import ActionError, ShapeError
from glbench.tasks import TaskCard


class UnknownToNumpy:
    """As a tensor of PyTorch in bfloat16."""

    dtype = "torch.bfloat16"

    def __array__(self, dtype: object = None, copy: object = None) -> NDArray[np.float32]:
        raise TypeError("Got unsupported ScalarType BFloat16")


class Counting:
    """Integrates its first observation: an agent whose memory shows mixed-up runs."""

    single_run = True

    def reset(self, task: TaskCard) -> None:
        self.total = 0.0

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float64]:
        self.total += float(observation[0])
        observation[:] = -1.0  # must not reach anybody else
        return np.full(6, self.total)


class CountingBatch:
    """The same for all runs at once."""

    def reset(self, task: TaskCard, n_runs: int) -> None:
        self.total = np.zeros(n_runs)

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.float64]:
        self.total = self.total + observations[:, 0]
        return np.repeat(self.total[:, None], 6, axis=1)


def test_one_agent_a_run_acts_like_one_agent_for_all(card: TaskCard) -> None:
    single: Agent = PerRunAgent(lambda task: Counting())
    batch: Agent = CountingBatch()
    observations = np.random.default_rng(1).normal(size=(5, 3, 22)).astype(np.float32)
    for agent in (single, batch):
        agent.reset(card, 3)
    for step in observations:
        before = step.copy()
        assert np.array_equal(single.act(step), batch.act(step))
        assert np.array_equal(step, before)


def test_a_reset_makes_new_agents_and_the_first_one_is_used_once(card: TaskCard) -> None:
    made: list[Counting] = []

    def make(task: TaskCard) -> SingleRunAgent:
        made.append(Counting())
        return made[-1]

    first = Counting()
    agent = PerRunAgent(make, first)
    agent.reset(card, 2)
    assert agent.agents == (first, made[0])
    agent.reset(card, 2)
    assert agent.agents == (made[1], made[2])


@pytest.mark.parametrize(
    ("answer", "complaint"),
    [
        (np.zeros((1, 6)), r"shape \(1, 6\) in run 0"),
        (None, "returned NoneType in run 0"),
        ("warm", "returned str in run 0"),
        ([1.0, [2.0]], "returned list in run 0"),
    ],
)
def test_an_answer_that_is_no_row_of_numbers_names_its_run(card: TaskCard, answer: object, complaint: str) -> None:
    class Odd(Counting):
        def act(self, observation: NDArray[np.float32]) -> NDArray[np.float64]:
            return answer  # type: ignore[return-value]

    agent = PerRunAgent(lambda task: Odd())
    agent.reset(card, 2)
    with pytest.raises(ActionError, match=complaint):
        agent.act(np.zeros((2, 22), dtype=np.float32))


def test_answers_of_different_lengths_are_refused(card: TaskCard) -> None:
    class Growing(Counting):
        def act(self, observation: NDArray[np.float32]) -> NDArray[np.float64]:
            return np.zeros(6 if observation[0] < 0.5 else 5)

    agent = PerRunAgent(lambda task: Growing())
    agent.reset(card, 2)
    with pytest.raises(ActionError, match=r"different lengths: \[5, 6\]"):
        agent.act(np.array([[0.0] * 22, [1.0] * 22], dtype=np.float32))


def test_observations_of_another_number_of_runs_are_refused(card: TaskCard, published: RuleSettings) -> None:
    agents: list[Agent] = [PerRunAgent(lambda task: Counting()), FairRuleBasedAgent(published)]
    for agent in agents:
        with pytest.raises(ShapeError, match=r"of 3 runs, reset was called with 0\. Call reset first"):
            agent.act(np.zeros((3, 22), dtype=np.float32))
        agent.reset(card, 2)
        with pytest.raises(ShapeError, match="of 3 runs, reset was called with 2"):
            agent.act(np.zeros((3, 22), dtype=np.float32))


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.int64, list])
def test_numbers_within_bounds_are_good_actions(card: TaskCard, kind: type) -> None:
    actions: object = [[0] * 6, [1] * 6, [-1] * 6] if kind is list else np.array([[0] * 6, [1] * 6, [-1] * 6], dtype=kind)
    assert action_problems(actions, card, 3) == {}


def test_float32_rounding_at_a_bound_is_no_problem(card: TaskCard) -> None:
    assert action_problems(np.full((2, 6), np.nextafter(np.float32(1.0), np.float32(2.0))), card, 2) == {}


def test_a_bad_value_is_the_problem_of_its_own_run(card: TaskCard) -> None:
    actions = np.zeros((4, 6))
    actions[1, 3], actions[2, 0], actions[3, 5] = np.nan, 1.5, -np.inf
    problems = action_problems(actions, card, 4)
    assert sorted(problems) == [1, 2, 3]
    assert problems[1] == "the action for uVent is nan, which is not a finite number"
    assert problems[2] == "the action for uBoil is 1.5, outside its bounds -1 to 1"
    assert "uBlScr is -inf" in problems[3]


@pytest.mark.parametrize(
    ("returned", "complaint"),
    [
        (np.zeros((2, 5)), "shape (2, 5); expected (2, 6): one row a run, in it uBoil, uCo2"),
        (np.zeros(6), "shape (6,)"),
        (None, "a NoneType, which are no plain numbers"),
        (UnknownToNumpy(), "a UnknownToNumpy. NumPy does not know numbers of type bfloat16: make them float32 first"),
        ([UnknownToNumpy()] * 2, "a list. NumPy does not know numbers of type bfloat16"),
        ("warm", "a str"),
        (np.zeros((2, 6), dtype=complex), "an array of complex128"),
        (np.zeros((2, 6), dtype=bool), "an array of bool"),
        ([[0.0] * 6, [0.0] * 5], "rows that differ in length"),
    ],
)
def test_a_wrong_whole_is_the_problem_of_every_run(card: TaskCard, returned: object, complaint: str) -> None:
    problems = action_problems(returned, card, 2)
    assert sorted(problems) == [0, 1]
    assert complaint in problems[0]
