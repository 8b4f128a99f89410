"""Runs that are computed apart and put together are the evaluation in one piece, to the last digest."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from glbench.episodes.definition import definition_json
from glbench.evaluation import Progress, prepare
from glbench.evaluation.engines.ray import Order, Parcel, Refusal, divided, may_be_divided, put_together, work
from glbench.evaluation.preparing import Evaluation
from glbench.evaluation.saving import Computed
from glbench.tasks import TaskSpec
from tests.evaluation.agent_files import AgentWriter
from tests.support import lettuce_task

SINGLE = """
def act(self, observation):
    self.memory = 0.5 * self.memory + 0.01 * float(observation[0])
    if self.memory > 0.34: raise RuntimeError("too warm")
    return np.full(6, np.tanh(self.memory))
"""


def order_of(evaluation: Evaluation, agent: Path, seeds: tuple[int, ...]) -> Order:
    return Order(
        definition_json(evaluation.task),
        Parcel.of(str(agent)),
        seeds,
        len(seeds) < len(evaluation.seeds),
        evaluation.protection,
        evaluation.task.digest,
        evaluation.agent.digest,
        evaluation.kernel,
        "0.1.0",
        None,
        None,
    )


def nothing(_: Progress) -> None:
    return None


@pytest.mark.parametrize(("runs", "parts", "sizes"), [(30, 4, [8, 8, 7, 7]), (3, 8, [1, 1, 1]), (5, 1, [5])])
def test_runs_are_divided_evenly_and_in_order(runs: int, parts: int, sizes: list[int]) -> None:
    seeds = tuple(range(100, 100 + runs))
    chunks = divided(seeds, parts)
    assert [len(chunk) for chunk in chunks] == sizes
    assert tuple(seed for chunk in chunks for seed in chunk) == seeds


@pytest.mark.parametrize("parts", [1, 2, 3])
def test_parts_put_together_have_the_bits_of_the_whole(
    day_task: TaskSpec, write_agent: AgentWriter, parts: int
) -> None:
    agent = write_agent(SINGLE, single=True)
    evaluation = prepare(day_task, agent)
    whole = evaluation.compute()
    computed = [work(order_of(evaluation, agent, seeds), nothing) for seeds in divided(evaluation.seeds, parts)]
    assert all(isinstance(part, Computed) for part in computed)
    joined = put_together(evaluation, computed)  # type: ignore[arg-type]
    assert joined.result.results_digest == whole.result.results_digest
    assert joined.result.runs == whole.result.runs
    assert joined.log.digest == whole.log.digest


def test_parts_of_a_task_with_a_season_for_each_run_have_the_bits_of_the_whole(write_agent: AgentWriter) -> None:
    agent = write_agent(SINGLE, single=True)
    evaluation = prepare(lettuce_task(), agent)
    whole = evaluation.compute()
    computed = [work(order_of(evaluation, agent, seeds), nothing) for seeds in divided(evaluation.seeds, 2)]
    assert all(isinstance(part, Computed) for part in computed)
    joined = put_together(evaluation, computed)  # type: ignore[arg-type]
    assert joined.result.results_digest == whole.result.results_digest
    assert joined.log.digest == whole.log.digest


def test_an_agent_for_all_runs_is_never_divided(day_task: TaskSpec, write_agent: AgentWriter) -> None:
    agent = write_agent()
    evaluation = prepare(day_task, agent)
    assert may_be_divided(evaluation), "its source speaks of single runs; the agent itself decides"
    refused = work(order_of(evaluation, agent, evaluation.seeds[:1]), nothing)
    assert isinstance(refused, Refusal)
    assert refused.joint


def test_a_worker_that_would_compute_other_numbers_refuses(day_task: TaskSpec, write_agent: AgentWriter) -> None:
    agent = write_agent()
    evaluation = prepare(day_task, agent)
    order = order_of(evaluation, agent, evaluation.seeds)
    for change, words in (
        ({"version": "0.0.1"}, "Install the same version"),
        ({"task_digest": "0" * 64}, "the task has another digest there"),
        ({"agent_digest": "0" * 64}, "another digest than it was sent with"),
        ({"kernel": {"backend": "abacus"}}, "would change the numbers"),
    ):
        refused = work(replace(order, **change), nothing)
        assert isinstance(refused, Refusal)
        assert words in refused.reason


def test_a_folder_arrives_with_the_digest_it_was_sent_with(tmp_path: Path, write_agent: AgentWriter) -> None:
    from glbench.agents import identify

    folder = tmp_path / "mine"
    (folder / "parts").mkdir(parents=True)
    write_agent().rename(folder / "agent.py")
    (folder / "parts" / "weights.bin").write_bytes(b"\x00\xff")
    sent = identify(folder)
    with Parcel.of(str(folder)).unpacked() as arrived:
        received = identify(arrived)
        assert sent is not None
        assert received is not None
        assert (received.name, received.digest) == (sent.name, sent.digest)
    assert not Path(arrived).exists()
