"""The engine 'ray' gives the digests of the local one, does lost parts again, and stops nothing for one failure."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from glbench.errors import GlbenchError
from glbench.evaluation import load_result, protect
from glbench.evaluation.jobs import Job, LocalEngine, Options, Outcome
from glbench.tasks import TaskSpec
from tests.evaluation.agent_files import AgentWriter

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="Ray is not installed"),
    # Ray leaves files and sockets for the end of the process.
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]

SINGLE = """
def act(self, observation):
    self.memory = 0.5 * self.memory + 0.01 * float(observation[0])
    return np.full(6, np.tanh(self.memory))
"""


def test_ray_computes_what_this_machine_computes_also_after_a_lost_worker(
    day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path
) -> None:
    from glbench.evaluation.jobs import RayEngine

    flag = tmp_path / "was-here"
    lost = f"""
    def act(self, observations):
        self.calls += 1
        if self.calls == 9 and not os.path.exists({str(flag)!r}):
            open({str(flag)!r}, "w").close()
            os._exit(1)
        return np.tanh(observations[:, :6].astype(float) / 50.0)
    """
    agents = [
        write_agent(name="batch"),
        write_agent(SINGLE, name="single", single=True),
        write_agent(lost, name="lost"),
        write_agent("def act(self, observations):\n    return None\n", name="wrong"),
        write_agent("def reset(self, task, n_runs):\n    pass\n", name="unmade"),
    ]
    refs = [*map(str, agents), "rule_based"]

    def jobs(out: str) -> list[Job]:
        options = Options(tmp_path / out, workers=2)
        return [Job(day_task, ref, protect(ref, "none"), options) for ref in refs]

    told: list[tuple[str, int]] = []
    engine = RayEngine(cores=2)
    try:
        by_ray: list[Outcome] = list(engine.run(jobs("ray"), lambda job, standing: told.append((job.agent_name, standing.step))))
    except GlbenchError as error:
        if "timed out during startup" not in str(error):
            raise
        pytest.skip("Ray's own processes do not start within its half minute on this machine")
    assert flag.exists()
    assert {outcome.job.agent_name for outcome in by_ray} == {"batch", "single", "lost", "wrong", "unmade", "rule_based"}
    here = {outcome.job.agent_name: outcome for outcome in LocalEngine().run(jobs("local"), lambda *_: None)}
    for outcome in by_ray:
        name = outcome.job.agent_name
        if name == "unmade":
            assert outcome.result is None
            assert outcome.reason == here[name].reason
            continue
        result, other = outcome.result, here[name].result
        assert result is not None
        assert other is not None
        assert result.results_digest == other.results_digest
        assert result.record == other.record
        assert load_result(tmp_path / "ray" / "results" / "Day-v1" / f"{name}.json") == result
    assert next(o for o in by_ray if o.job.agent_name == "single").result.evaluation.workers == 2  # type: ignore[union-attr]
    assert list(tmp_path.rglob(".seen-*")) == []
    assert all(0 <= step <= 24 for _, step in told)
