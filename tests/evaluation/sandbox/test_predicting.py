"""Inside, an agent finds its own task without seeds and weather, and predicts with the compiled kernel."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest

from glbench.control import Climatology
from glbench.evaluation import TimeLimits, prepare
from glbench.evaluation.sandbox.frames import Prints
from glbench.kernel import Kernel, available
from glbench.tasks import get_task
from tests.evaluation.agent_files import AgentWriter

PREDICT = """
def reset(self, card, n_runs):
    from glbench.control import Climatology, Outlook, StageReward, StateEstimator
    from glbench.kernel import Kernel
    from glbench.tasks import get_task
    self.n, self.task = n_runs, get_task(card.id)
    self.kernel = Kernel(self.task.model_value, self.task.step_seconds, preset="fast")
    self.stage = StageReward(self.task)
    climatology = Climatology.read(os.path.join(os.path.dirname(__file__), "climatology.json"))
    self.outlook, self.estimator = Outlook(self.task, climatology), StateEstimator(self.task)
    self.outlook.reset(n_runs), self.estimator.reset(n_runs)
    self.told = False

def act(self, observations):
    self.outlook.update(observations)
    x = self.estimator.update(observations, self.outlook.past)
    if not self.told:
        self.told = True
        self.tell(x)
    return np.zeros((self.n, 6))

def tell(self, x):
    import json
    ahead, u = self.outlook.ahead(4), np.full((self.n, 4, 6), 0.3)
    p = self.estimator.parameters
    states = self.kernel.rollout(x, u, ahead.d, p)
    values, slopes = self.stage.gradient(states, u, ahead.calendar)
    lines = self.kernel.linearise(x, u[:, 0], ahead.d[:, 0], p, inputs=("x", "u"))
    _, gradient = self.kernel.rollout_adjoint(x, u, ahead.d, p, slopes.states)
    folder = os.environ["GLBENCH_KERNELS"]
    held = os.listdir(folder)
    try:
        open(os.path.join(folder, held[0]), "r+b")
        written = True
    except OSError:
        written = False
    try:
        self.task.record()
        weather = True
    except Exception as error:
        weather = type(error).__name__
    print("SEEN " + json.dumps({
        "backend": self.kernel.backend, "reward": float(values.reward.sum()), "slope": float(np.abs(gradient.u + slopes.controls).sum()),
        "dx": list(lines.dx.shape), "held": held, "written": written, "weather": weather, "task": self.task.id,
        "first_seed": self.task.evaluation.first_seed, "text": json.dumps(self.task.as_tables()), "sealed": self.task.sealed,
    }))
"""


@pytest.mark.skipif("compiled" not in available(), reason="no compiled kernel here")
def test_an_agent_plans_with_its_task(write_agent: AgentWriter, needs_sandbox: None, tmp_path: Path) -> None:
    task = get_task("Spring-v1").replace({"id": "my/TwoSteps-v1", "weather.days": 1, "scenario.salt": "grain"})
    kernel = Kernel(task.model_value, task.step_seconds, preset="fast")
    kernel.differentiator()
    file = write_agent(PREDICT)
    folder = tmp_path / "planner"
    folder.mkdir()
    (folder / "agent.py").write_text(file.read_text(encoding="utf-8"), encoding="utf-8")
    Climatology.of(task).write(folder / "climatology.json")
    evaluation = prepare(task, folder, runs=1, out=None, sandbox="bubblewrap", limits=TimeLimits(start=300.0, step=60.0))
    evaluation = dataclasses.replace(evaluation, prints=Prints(2**24))
    result = evaluation.run()
    assert result.summary.ok == 1, result.runs[0].reason
    (line,) = [line for line in evaluation.prints.text().splitlines() if line.startswith("SEEN ")]
    seen = json.loads(line.removeprefix("SEEN "))

    assert seen["task"] == task.id
    assert seen["backend"] == "compiled"
    assert seen["dx"] == [1, 35, 35]
    assert seen["slope"] > 0.0
    # What was compiled outside is found, and cannot be written to; no other library is there, and none was built.
    libraries = [name for name in seen["held"] if name.endswith(".so")]
    assert len(libraries) == 4  # for steps and for derivatives, of the task's model and of that without meters, which planners use
    assert sum("sensitivities" in name for name in libraries) == 2
    assert sum("-judged-" in name for name in libraries) == 2
    assert not seen["written"]
    assert seen["weather"] != True  # noqa: E712  an error's name would be true
    assert (seen["first_seed"], seen["sealed"]) == (0, "")
    assert "grain" not in seen["text"]
    assert "10000" not in seen["text"]
