"""Runs that are computed apart and put together are the evaluation in one piece, to the last digest."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from glbench.env import Simulation
from glbench.errors import GlbenchError
from glbench.evaluation import prepare, protect
from glbench.evaluation.checkpoint import take_over
from glbench.evaluation.evaluation import Evaluation, JointAgentError
from glbench.evaluation.jobs import (
    Job,
    LocalEngine,
    Options,
    Outcome,
    PackedAgent,
    PackedTask,
    Payload,
    RunsJob,
    compute_runs,
    divide_jobs,
    join_parts,
    may_be_divided,
    split_seeds,
)
from glbench.evaluation.saving import Computed
from glbench.execution import JobContext, ProcessExecutor, read_files
from glbench.kernel import built_libraries, why_not_compiled
from glbench.tasks import TaskSpec, get_task
from glbench.weather import load_weather, save_weather
from tests.evaluation.agent_files import AgentWriter
from tests.support import lettuce_task

SINGLE = """
def act(self, observation):
    self.memory = 0.5 * self.memory + 0.01 * float(observation[0])
    if self.memory > 0.34: raise RuntimeError("too warm")
    return np.full(6, np.tanh(self.memory))
"""


def order_of(evaluation: Evaluation, agent: Path, seeds: tuple[int, ...]) -> RunsJob:
    is_part = len(seeds) < len(evaluation.seeds)
    packed = PackedTask.of(evaluation.task)
    return RunsJob(packed, PackedAgent.of(str(agent)), seeds, is_part, evaluation.protection, evaluation.agent.digest)


def compute(job: RunsJob) -> Computed:
    return compute_runs(JobContext(None, lambda progress: None), job)


@pytest.mark.parametrize(("runs", "parts", "sizes"), [(30, 4, [8, 8, 7, 7]), (3, 8, [1, 1, 1]), (5, 1, [5])])
def test_runs_are_divided_evenly_and_in_order(runs: int, parts: int, sizes: list[int]) -> None:
    seeds = tuple(range(100, 100 + runs))
    chunks = split_seeds(seeds, parts)
    assert [len(chunk) for chunk in chunks] == sizes
    assert tuple(seed for chunk in chunks for seed in chunk) == seeds


@pytest.mark.parametrize("parts", [1, 2, 3])
def test_parts_put_together_have_the_bits_of_the_whole(day_task: TaskSpec, write_agent: AgentWriter, parts: int) -> None:
    agent = write_agent(SINGLE, single=True)
    evaluation = prepare(day_task, agent)
    whole = evaluation.compute()
    computed = [compute(order_of(evaluation, agent, seeds)) for seeds in split_seeds(evaluation.seeds, parts)]
    joined = join_parts(evaluation, computed)
    assert joined.result.results_digest == whole.result.results_digest
    assert joined.result.runs == whole.result.runs
    assert joined.log.digest == whole.log.digest


def test_parts_of_a_task_with_a_season_for_each_run_have_the_bits_of_the_whole(write_agent: AgentWriter) -> None:
    agent = write_agent(SINGLE, single=True)
    evaluation = prepare(lettuce_task(), agent)
    whole = evaluation.compute()
    computed = [compute(order_of(evaluation, agent, seeds)) for seeds in split_seeds(evaluation.seeds, 2)]
    joined = join_parts(evaluation, computed)
    assert joined.result.results_digest == whole.result.results_digest
    assert joined.log.digest == whole.log.digest


def test_an_agent_for_all_runs_is_never_divided(day_task: TaskSpec, write_agent: AgentWriter) -> None:
    agent = write_agent()
    evaluation = prepare(day_task, agent)
    assert may_be_divided(evaluation), "its source speaks of single runs; the agent itself decides"
    with pytest.raises(JointAgentError):
        compute(order_of(evaluation, agent, evaluation.seeds[:1]))


def test_a_worker_that_would_compute_other_numbers_refuses(day_task: TaskSpec, write_agent: AgentWriter) -> None:
    agent = write_agent()
    evaluation = prepare(day_task, agent)
    order = order_of(evaluation, agent, evaluation.seeds)
    for change, words in (
        ({"version": "0.0.1"}, "Install the same version"),
        ({"digest": "0" * 64}, "the task has a different digest there"),
        ({"kernel": {"backend": "abacus"}}, "would change the numbers"),
    ):
        with pytest.raises(GlbenchError, match=words):
            compute(replace(order, task=replace(order.task, **change)))  # type: ignore[arg-type]
    with pytest.raises(GlbenchError, match="a different digest from the one it was sent with"):
        compute(replace(order, agent_digest="0" * 64))


def test_a_folder_arrives_with_the_digest_it_was_sent_with(tmp_path: Path, write_agent: AgentWriter) -> None:
    from glbench.agents import identify

    folder = tmp_path / "mine"
    (folder / "parts").mkdir(parents=True)
    write_agent().rename(folder / "agent.py")
    (folder / "parts" / "weights.bin").write_bytes(b"\x00\xff")
    sent = identify(folder)
    with PackedAgent.of(str(folder)).unpack() as arrived:
        received = identify(arrived)
        assert sent is not None
        assert received is not None
        assert (received.name, received.digest) == (sent.name, sent.digest)
    assert not Path(arrived).exists()


def test_an_order_keeps_its_split(write_agent: AgentWriter) -> None:
    spring, agent = (get_task("Spring-v1").replace(id="test/ADay-v1", weather={"days": 1}), write_agent(SINGLE, single=True))
    digests = {}
    for split in ("validation", "test"):
        evaluation = prepare(spring.in_split(split), agent, runs=2)
        computed = compute(order_of(evaluation, agent, evaluation.seeds))
        assert computed.result.task.split == split
        digests[split] = computed.result.results_digest
        assert digests[split] == evaluation.compute().result.results_digest
    assert digests["validation"] != digests["test"]


def test_weather_and_kernels_of_the_user_are_used_where_they_arrive(
    day_task_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GLBENCH_DATA", str(tmp_path / "here"))
    monkeypatch.setenv("GLBENCH_KERNELS", "")
    save_weather(load_weather("schiphol"), "ours")
    text = day_task_file.read_text(encoding="utf-8").replace('source = "schiphol"', 'source = "ours"')
    (tmp_path / "ours.toml").write_text(text, encoding="utf-8")
    task = get_task(tmp_path / "ours.toml")
    Simulation(task, 1)  # its kernel is built now, if it was not
    payload = Payload.of([task])
    assert list(payload.weather) == ["ours.parquet"]
    assert any(name.endswith(".so") for name in payload.kernels) == (why_not_compiled() is None)

    monkeypatch.setenv("GLBENCH_CACHE", str(tmp_path / "there"))
    monkeypatch.setenv("GLBENCH_DATA", str(tmp_path / "nothing"))
    replace(payload, processor=payload.processor | {"an instruction of tomorrow"}).unpack()
    assert load_weather("ours").digest == load_weather("schiphol").digest
    assert os.environ["GLBENCH_KERNELS"] == "", "a kernel that this processor may not run is left alone"
    payload.unpack()
    if payload.kernels:
        assert {name for name, _ in built_libraries(task.model_value, task.parameters()).items()} == set(payload.kernels)
        folder = Path(os.environ["GLBENCH_KERNELS"])
        assert folder.is_relative_to(tmp_path / "there")
        assert {file.name: file.read_bytes() for file in folder.iterdir()} == payload.kernels


def test_a_checkpoint_from_elsewhere_takes_the_place_of_the_one_before(tmp_path: Path) -> None:
    first = {"dialogue-00000000-00000004.npz": b"a", "dialogue-00000004-00000008.npz": b"b", "snapshot.npz": b"8"}
    then = {"dialogue-00000000-00000004.npz": b"a", "dialogue-00000004-00000009.npz": b"c", "snapshot.npz": b"9"}
    for files in (first, then):
        take_over(tmp_path / "checkpoint", files)
        assert read_files(tmp_path / "checkpoint") == files


def test_processes_compute_what_this_process_computes(day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path) -> None:
    agents = [
        write_agent(name="batch"),
        write_agent(SINGLE, name="single", single=True),
        write_agent("def reset(self, task, n_runs):\n    pass\n", name="unmade"),
    ]
    refs = [*map(str, agents), "rule_based"]

    def jobs(out: str) -> list[Job]:
        return [Job(day_task, ref, protect(ref, "none"), Options(tmp_path / out, workers=1)) for ref in refs]

    def by_name(outcomes: Iterator[Outcome]) -> dict[str, Outcome]:
        return {outcome.job.agent_name: outcome for outcome in outcomes}

    reports: list[tuple[str, int]] = []
    here = by_name(LocalEngine().run(jobs("here"), lambda *_: None))
    with ProcessExecutor(2) as executor:
        there = by_name(divide_jobs(executor, jobs("there"), lambda job, progress: reports.append((job.agent_name, progress.step))))
    assert here.keys() == there.keys()
    for name, outcome in there.items():
        other = here[name].result
        if other is None:
            assert outcome.result is None
            assert outcome.reason == here[name].reason
        else:
            assert outcome.result is not None
            assert outcome.result.results_digest == other.results_digest
            assert outcome.result.record == other.record
    single = there["single"].result
    assert single is not None
    assert single.evaluation.workers == 2
    assert {name for name, _ in reports} >= {"batch", "single", "rule_based"}
    assert not list((tmp_path / "there").rglob("snapshot.npz")), "checkpoints are removed"
