"""What an agent earns and how it fails is the same in a sandbox as without one, to the last bit and word."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from glbench.errors import SubmissionError
from glbench.evaluation import Progress, Result, TimeLimits, evaluate, prepare
from glbench.resources import data_folder
from glbench.tasks import TaskSpec
from tests.evaluation.agent_files import GOOD, AgentWriter
from tests.evaluation.sandbox.conftest import Prepare, ends

ZEROS = "actions = np.zeros((self.n, 6)); self.calls += 1"
PATIENT = TimeLimits(start=120.0, step=30.0, run=600.0)

BATCHED = {
    "remembers": GOOD,
    "lists": f"def act(self, o):\n    {ZEROS}\n    return actions.tolist()",
    "float32": f"def act(self, o):\n    {ZEROS}\n    return (actions + 1 / 3).astype(np.float32)",
    "transposed": "def act(self, o):\n    return np.asfortranarray(np.tanh(o[:, :6].astype(float) / 99))",
    "prints": f"def act(self, o):\n    {ZEROS}\n    print('hm')\n    return actions",
    "spoils its observations": f"def act(self, o):\n    {ZEROS}\n    actions += 0.1\n    o[:] = np.nan\n    return actions",
    "raises": f"def act(self, o):\n    {ZEROS}\n    if self.calls == 6: raise ValueError('<object at 0x7f3a5c0d11f0>')\n    return actions",
    "raises something odd": "class Odd(BaseException): pass\ndef act(self, o):\n    raise self.Odd('odd')",
    "leaves Python": "def act(self, o):\n    sys.exit(3)",
    "interrupts": f"def act(self, o):\n    {ZEROS}\n    if self.calls == 3: raise TimeoutError\n    return actions",
    "nan in one row": f"def act(self, o):\n    {ZEROS}\n    if self.calls == 4: actions[1, 3] = np.nan\n    return actions",
    "out of bounds": f"def act(self, o):\n    {ZEROS}\n    if self.calls == 4: actions[2, 4] = 1.5\n    return actions",
    "one row too short": f"def act(self, o):\n    {ZEROS}\n    actions = [*actions]\n    actions[1] = actions[1][:5]\n    return actions",
    "one row of text": f"def act(self, o):\n    {ZEROS}\n    actions = actions.tolist()\n    actions[1] = ['a'] * 6\n    return actions",
    "nothing": "def act(self, o):\n    return None",
    "text": "def act(self, o):\n    return 'full power'",
    "wrong shape": "def act(self, o):\n    return np.zeros((self.n + 1, 6))",
    "complex": "def act(self, o):\n    return np.zeros((self.n, 6), complex)",
    "objects": "def act(self, o):\n    return np.full((self.n, 6), None)",
    "reset raises": "def reset(self, task, n_runs):\n    1 / 0\ndef act(self, o):\n    pass",
    "reset leaves Python": "def reset(self, task, n_runs):\n    sys.exit('enough')\ndef act(self, o):\n    pass",
}
SINGLE_HEAD = (
    "def reset(self, task):\n    Agent.made = getattr(Agent, 'made', 0) + 1\n"
    "    self.number, self.calls = Agent.made, 0\n"
    "def act(self, o):\n    self.calls += 1\n"
)
SINGLE = {
    "all is well": "    return np.tanh(o[:6].astype(float) / 50.0) / self.number",
    "one raises": "    if (self.number, self.calls) == (2, 5): raise RuntimeError('second')\n    return np.zeros(6)",
    "one answers in words": "    return 'words' if (self.number, self.calls) == (2, 3) else np.zeros(6)",
    "one is too long": "    return np.zeros(7 if (self.number, self.calls) == (3, 3) else 6)",
    "one is nan": "    return np.full(6, np.nan if (self.number, self.calls) == (1, 2) else 0.2)",
    "all are too long": "    return np.zeros(7)",
    "one never returns": "    while (self.number, self.calls) == (2, 3): pass\n    return np.zeros(6)",
}


@pytest.mark.parametrize("body", BATCHED.values(), ids=BATCHED)
def test_a_batched_agent_ends_as_it_does_unsandboxed(day_task: TaskSpec, write_agent: AgentWriter, sandboxed: Prepare, body: str) -> None:
    path = write_agent(body)

    assert sandboxed(path).run().runs == evaluate(day_task, path, limits=PATIENT).runs


@pytest.mark.slow
@pytest.mark.parametrize("body", SINGLE.values(), ids=SINGLE)
def test_agents_for_single_runs_end_as_they_do_unsandboxed(
    day_task: TaskSpec, write_agent: AgentWriter, sandboxed: Prepare, body: str
) -> None:
    path = write_agent(SINGLE_HEAD + body, single=True)
    limits = TimeLimits(start=120.0, step=2.0, run=600.0)

    assert sandboxed(path, limits=limits).run().runs == evaluate(day_task, path, limits=limits).runs


def test_the_digest_is_the_same_and_the_result_says_how_the_agent_ran(
    day_task: TaskSpec, write_agent: AgentWriter, sandboxed: Prepare, good_result: Result
) -> None:
    result = sandboxed(write_agent()).run()

    assert result.results_digest == good_result.results_digest
    assert result.agent == good_result.agent
    assert result.evaluation.sandbox == "bubblewrap"
    assert good_result.evaluation.sandbox == "unsandboxed"
    assert evaluate(day_task, "rule_based_fair", sandbox="bubblewrap", runs=1).evaluation.sandbox == "built-in"


@pytest.mark.parametrize("name", ["my_agent", "constant_setpoints", "pi_controller"])
def test_the_examples_earn_the_same(day_task: TaskSpec, sandboxed: Prepare, name: str) -> None:
    path = data_folder("submissions") / f"{name}.py"

    assert sandboxed(path).run().results_digest == evaluate(day_task, path).results_digest


def test_a_folder_with_modules_and_weights_finds_them(day_task: TaskSpec, sandboxed: Prepare, tmp_path: Path) -> None:
    folder = tmp_path / "anna"
    (folder / "deeper").mkdir(parents=True)
    np.save(folder / "deeper" / "weights.npy", np.full(6, 0.25))
    (folder / "helper.py").write_text("SCALE = 0.5\n", encoding="utf-8")
    (folder / "agent.py").write_text(
        "from pathlib import Path\nimport numpy as np\nimport helper\n"
        "class A:\n"
        "    def reset(self, task, n):\n"
        "        from . import helper as again\n"
        "        self.w = np.load(Path(__file__).parent / 'deeper' / 'weights.npy') * again.SCALE\n"
        "        self.n = n\n"
        "    def act(self, o):\n        return np.tile(self.w * helper.SCALE, (self.n, 1))\n"
        "def make_agent(task):\n    return A()\n",
        encoding="utf-8",
    )
    folder.chmod(0o700)

    assert sandboxed(folder).run().results_digest == evaluate(day_task, folder).results_digest


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("    return Agent()", "    raise OSError('no weights')"), "no weights"),
        (("    return Agent()", "    return 7"), "object of type int without"),
        (("def make_agent", "def make_agnet"), "Did you mean 'make_agnet'"),
        (("import numpy", "import nunpy"), "No module named 'nunpy'"),
        (("class Agent:", "class Agent"), "is no valid Python"),
    ],
)
def test_what_cannot_be_made_is_told_in_the_same_words(
    day_task: TaskSpec, write_agent: AgentWriter, sandboxed: Prepare, change: tuple[str, str], words: str
) -> None:
    path = write_agent()
    path.write_text(path.read_text(encoding="utf-8").replace(*change), encoding="utf-8")

    with pytest.raises(SubmissionError, match=words) as inside:
        sandboxed(path).run()
    with pytest.raises(SubmissionError) as here:
        evaluate(day_task, path)
    assert str(inside.value) == str(here.value)


class StopError(Exception):
    """Stands for Ctrl-C."""


@pytest.mark.parametrize("single", [False, True])
def test_an_interrupted_evaluation_goes_on_with_the_same_bits(
    day_task: TaskSpec, write_agent: AgentWriter, sandboxed: Prepare, tmp_path: Path, single: bool
) -> None:
    body = SINGLE_HEAD + SINGLE["one raises"] if single else GOOD
    path = write_agent(body, single=single)

    def stop(standing: Progress) -> None:
        if standing.step == 11 and not standing.replaying:
            raise StopError

    with pytest.raises(StopError):
        sandboxed(path, out=tmp_path, checkpoint_seconds=0.0).run(stop)
    resumed = sandboxed(path, out=tmp_path).run()

    assert resumed.evaluation.resumed_at_step == 11
    assert resumed.runs == evaluate(day_task, path).runs


def test_a_stored_result_without_sandbox_does_not_pass_for_one_with(
    day_task: TaskSpec, write_agent: AgentWriter, sandboxed: Prepare, tmp_path: Path
) -> None:
    path = write_agent()
    evaluate(day_task, path, out=tmp_path)

    assert sandboxed(path, out=tmp_path).stored is None
    sandboxed(path, out=tmp_path).run()
    assert sandboxed(path, out=tmp_path).stored is not None
    limits = TimeLimits(start=120.0, step=10.0, run=600.0)
    assert prepare(day_task, path, out=tmp_path, limits=limits).stored is not None
    assert prepare(day_task, path, out=tmp_path).stored is None, "made under other limits"


@pytest.mark.slow
def test_limits_in_the_task_hold_for_the_agent(day_task_file: Path, write_agent: AgentWriter, needs_sandbox: None, tmp_path: Path) -> None:
    seconds = {"start": 120.0, "step": 1.0, "run": 600.0}
    lines = "".join(f'{name} = {{ value = {value}, unit = "s" }}\n' for name, value in seconds.items())
    task = tmp_path / "hasty.toml"
    task.write_text(day_task_file.read_text(encoding="utf-8") + "\n[evaluation.time_limits]\n" + lines, encoding="utf-8")
    slow = write_agent(
        "def act(self, o):\n    self.calls += 1\n    time.sleep(1000.0 * (self.calls == 3))\n    return np.zeros((self.n, 6))"
    )
    result = evaluate(task, slow, sandbox="bubblewrap")

    assert ends(result) == [("timed_out", 2)] * 3
    assert result.runs[0].reason == "act (for all runs) took longer than its limit of 3 s"
    assert result.evaluation.limits == {f"{name}_seconds": value for name, value in seconds.items()}
