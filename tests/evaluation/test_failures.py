"""Whatever an agent does becomes a recorded, priced result with its reason in words."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.env.kernels import shared_kernel
from glbench.errors import SubmissionError
from glbench.evaluation import Result, TimeLimits, evaluate
from glbench.evaluation.runners import AgentRunner, Decision
from glbench.kernel import StepFailure
from glbench.tasks import TaskSpec
from tests.evaluation.agent_files import AgentWriter

Floats = NDArray[np.float64]

GOOD = """
def act(self, observations):
    self.calls += 1
    self.memory = np.tanh(observations[:, :6].astype(float) / 50.0 - 0.4)
    return self.memory
"""
ZEROS = "actions = np.zeros((self.n, 6))"


def reason(result: Result, row: int) -> str:
    words = result.runs[row].reason
    assert words is not None
    return words


def ends(result: Result) -> list[tuple[str, int]]:
    return [(run.status, run.steps) for run in result.runs]


def test_an_exception_in_a_batched_agent_ends_all_runs_and_names_the_line(day_task: TaskSpec, write_agent: AgentWriter) -> None:
    path = write_agent(
        f"""
        def act(self, observations):
            self.calls += 1
            if self.calls == 6:
                raise ValueError("no idea at <object at 0x7f3a5c0d11f0>")
            {ZEROS}
            return actions
        """
    )
    line = 1 + path.read_text(encoding="utf-8").splitlines().index('            raise ValueError("no idea at <object at 0x7f3a5c0d11f0>")')
    result = evaluate(day_task, path)

    assert ends(result) == [("crashed", 5)] * 3
    assert reason(result, 0) == f"ValueError: no idea at <object at 0x...> (agent_under_test.py:{line} in act)"


def test_missing_steps_are_priced_and_resources_are_only_what_was_used(day_task: TaskSpec, write_agent: AgentWriter) -> None:
    healthy = f"""
        def act(self, observations):
            self.calls += 1
            {ZEROS}
            actions[:, 0] = 1.0
            {{}}
            return actions
        """
    whole = evaluate(day_task, write_agent(healthy.format("pass")))
    broken = evaluate(day_task, write_agent(healthy.format("if self.calls > 23: actions[1, 2] = np.nan")))
    last = 23.0 / 24.0

    price = day_task.evaluation.failed_step
    run, complete = broken.runs[1], whole.runs[1]
    assert (run.status, run.steps) == ("invalid_action", 23)
    assert broken.runs[0] == whole.runs[0]
    assert 0.0 < run.metrics["heat"] < complete.metrics["heat"]
    assert run.metrics["heat"] == pytest.approx(complete.metrics["heat"] * last, rel=0.05)
    # The full run is the broken one, with a true last step in place of the priced one.
    true_last_step = complete.metrics["reward"] - (run.metrics["reward"] - price.reward)
    assert -1.5 < true_last_step < 1.5
    assert run.metrics["penalty"] >= price.penalty
    assert broken.summary.statuses == {"ok": 2, "invalid_action": 1}


def test_a_run_that_never_starts_costs_all_of_its_steps(day_task: TaskSpec, write_agent: AgentWriter) -> None:
    result = evaluate(day_task, write_agent("def reset(self, task, n_runs):\n    1 / 0\ndef act(self, observations):\n    pass"))
    price = day_task.evaluation.failed_step

    assert ends(result) == [("crashed", 0)] * 3
    assert reason(result, 0).startswith("ZeroDivisionError: division by zero (agent_under_test.py:")
    assert result.runs[0].metrics["reward"] == 24 * price.reward
    assert result.runs[0].metrics["epi"] == 24 * price.epi
    assert result.runs[0].metrics["penalty"] == 24 * price.penalty
    assert result.runs[0].metrics["heat"] == 0.0


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        ("actions[1, 3] = np.nan", "the action for uVent is nan, which is not a finite number"),
        ("actions[1, 0] = np.inf", "the action for uBoil is inf, which is not a finite number"),
        ("actions[1, 4] = 1.5", "the action for uLamp is 1.5, outside its bounds -1 to 1"),
        ("actions = [*actions]; actions[1] = actions[1][:5]", "act returned an array of shape (1, 5)"),
        ("actions = [*actions]; actions[1] = None", "act returned a list"),
        ("actions = actions.tolist(); actions[1] = ['a'] * 6", "act returned a list"),
    ],
)
def test_a_bad_row_ends_its_own_run_and_the_others_go_on_unchanged(
    day_task: TaskSpec, write_agent: AgentWriter, spoil: str, words: str
) -> None:
    act = """
        def act(self, observations):
            self.calls += 1
            {zeros}
            actions[:, 0] = 0.3
            if self.calls == 4:
                {spoil}
            return actions
        """
    clean = evaluate(day_task, write_agent(act.format(zeros=ZEROS, spoil="pass")))
    result = evaluate(day_task, write_agent(act.format(zeros=ZEROS, spoil=spoil)))

    assert ends(result) == [("ok", 24), ("invalid_action", 3), ("ok", 24)]
    assert words in reason(result, 1)
    assert (result.runs[0], result.runs[2]) == (clean.runs[0], clean.runs[2])


@pytest.mark.parametrize(
    "returned",
    ["None", "np.zeros(6)", "np.zeros((self.n, 5))", "np.zeros((self.n + 1, 6))", "'full power'", "{}", "np.zeros((self.n, 6), complex)"],
)
def test_a_wrong_shape_or_type_as_a_whole_ends_all_runs(day_task: TaskSpec, write_agent: AgentWriter, returned: str) -> None:
    result = evaluate(day_task, write_agent(f"def act(self, observations):\n    return {returned}"))

    assert ends(result) == [("invalid_action", 0)] * 3
    assert "expected (3, 6)" in reason(result, 0)


def test_leaving_python_is_a_crash_like_any_other(day_task: TaskSpec, write_agent: AgentWriter) -> None:
    result = evaluate(day_task, write_agent("def act(self, observations):\n    sys.exit(0)"))

    assert ends(result) == [("crashed", 0)] * 3
    assert reason(result, 0).startswith("SystemExit: 0 (agent_under_test.py:")


@pytest.mark.slow
@pytest.mark.parametrize(
    "hang", ["while True: pass", "time.sleep(1000)", "while True:\n            try: time.sleep(1)\n            except Exception: pass"]
)
def test_an_endless_act_is_stopped(day_task: TaskSpec, write_agent: AgentWriter, hasty: TimeLimits, hang: str) -> None:
    path = write_agent(
        f"def act(self, observations):\n    self.calls += 1\n    if self.calls == 3:\n        {hang}\n    return np.zeros((self.n, 6))"
    )
    began = time.monotonic()
    result = evaluate(day_task, path, limits=hasty)

    assert time.monotonic() - began < 120.0
    assert ends(result) == [("timed_out", 2)] * 3
    assert reason(result, 0) == "act (for all runs) took longer than its limit of 4.5 s"


def test_an_endless_single_run_ends_alone(day_task: TaskSpec, write_agent: AgentWriter, hasty: TimeLimits) -> None:
    path = write_agent(
        """
        def reset(self, task):
            Agent.made = getattr(Agent, "made", 0) + 1
            self.number, self.calls = Agent.made, 0
        def act(self, observation):
            self.calls += 1
            while self.number == 2 and self.calls == 3: pass
            return np.zeros(6)
        """,
        single=True,
    )
    result = evaluate(day_task, path, limits=hasty)

    assert ends(result) == [("ok", 24), ("timed_out", 2), ("ok", 24)]
    assert reason(result, 1) == "act took longer than its limit of 1.5 s"


def test_what_one_single_run_agent_does_ends_its_own_run_only(day_task: TaskSpec, write_agent: AgentWriter) -> None:
    path = write_agent(
        """
        def reset(self, task):
            Agent.made = getattr(Agent, "made", 0) + 1
            self.number, self.calls = Agent.made, 0
        def act(self, observation):
            self.calls += 1
            if self.number == 1 and self.calls == 2: raise RuntimeError("first")
            if self.number == 2 and self.calls == 3: return "second"
            if self.number == 3 and self.calls == 4: return np.zeros(7)
            return np.zeros(6)
        """,
        single=True,
    )
    result = evaluate(day_task, path, runs=4)

    assert ends(result) == [("crashed", 1), ("invalid_action", 2), ("invalid_action", 3), ("ok", 24)]
    assert reason(result, 0).startswith("RuntimeError: first (agent_under_test.py:")
    assert "act returned str" in reason(result, 1)
    assert "run 0" not in reason(result, 1)


def test_decisions_that_are_slow_in_total_end_the_run(day_task: TaskSpec, write_agent: AgentWriter) -> None:
    path = write_agent("def act(self, observations):\n    time.sleep(0.5)\n    return np.zeros((self.n, 6))")
    result = evaluate(day_task, path, runs=1, limits=TimeLimits(run=3.0))

    assert result.runs[0].status == "timed_out"
    assert 1 <= result.runs[0].steps <= 6
    assert reason(result, 0) == "the run's decisions together took longer than their limit of 3 s"


def test_a_decision_counts_for_no_more_than_its_limit(
    day_task: TaskSpec, write_agent: AgentWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    decide = AgentRunner.decide

    def as_if_stopped(self: AgentRunner, *inputs: Any) -> Decision:
        decision = decide(self, *inputs)
        return replace(decision, seconds=decision.seconds + 1000.0)

    monkeypatch.setattr(AgentRunner, "decide", as_if_stopped)
    path = write_agent("def act(self, observations):\n    return np.zeros((self.n, 6))")
    result = evaluate(day_task, path, runs=1, limits=TimeLimits(step=10.0, run=300.0))
    assert ends(result) == [("ok", 24)]


def test_an_agent_that_cannot_be_made_is_an_error_and_no_result(day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path) -> None:
    path = write_agent()
    path.write_text(path.read_text(encoding="utf-8").replace("    return Agent()", "    raise OSError('no weights')"), encoding="utf-8")

    with pytest.raises(SubmissionError, match="no weights"):
        evaluate(day_task, path, out=tmp_path / "reports")
    assert not list((tmp_path / "reports").rglob("*.json"))


@pytest.mark.slow
def test_making_an_agent_has_a_time_limit(day_task: TaskSpec, write_agent: AgentWriter, hasty: TimeLimits) -> None:
    path = write_agent()
    path.write_text(path.read_text(encoding="utf-8").replace("    return Agent()", "    time.sleep(1000)"), encoding="utf-8")

    with pytest.raises(SubmissionError, match=r"make_agent took longer than its limit of 4 s"):
        evaluate(day_task, path, limits=hasty)


@pytest.fixture
def stepped_rows(day_task: TaskSpec, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many runs each call stepped, by a kernel that cannot integrate the eighth step of the third run."""
    kernel = shared_kernel(day_task.model_value, day_task.step_seconds)
    whole = kernel.try_step
    calls: list[int] = []

    def fails_once(x: Floats, u: Floats, d: Floats, p: Floats) -> tuple[Floats, list[StepFailure]]:
        calls.append(len(x))
        if len(calls) != 8:
            return whole(x, u, d, p)
        stepped, failed = whole(x, u, d, p)
        stepped[2] = x[2]
        return stepped, [*failed, StepFailure(2, "substeps exhausted at model time 0.3 days")]

    monkeypatch.setattr(kernel, "try_step", fails_once)
    monkeypatch.setattr(kernel, "environments", lambda program, n: None)  # else nobody would ask for a step of states only
    return calls


@pytest.mark.usefixtures("stepped_rows")
def test_a_run_that_ended_in_the_simulation_is_not_asked_again(day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path) -> None:
    asked = tmp_path / "asked.txt"
    act = f"""
    def act(self, observation):
        with open({str(asked)!r}, "a") as file:
            print(id(self), file=file)
        return np.zeros(6)
    """
    result = evaluate(day_task, write_agent(act, single=True))
    assert ends(result) == [("ok", 24), ("ok", 24), ("simulation_failed", 7)]
    assert sorted(Counter(asked.read_text(encoding="utf-8").split()).values()) == [8, 24, 24]


def test_a_step_that_cannot_be_integrated_ends_its_run(
    day_task: TaskSpec, write_agent: AgentWriter, stepped_rows: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    result = evaluate(day_task, write_agent(GOOD))

    assert ends(result) == [("ok", 24), ("ok", 24), ("simulation_failed", 7)]
    assert reason(result, 2) == "substeps exhausted at model time 0.3 days"
    assert stepped_rows == [3] * 8 + [2] * 16, "a run that ended is not simulated any further"

    # It is priced like a run that ended after the same seven steps for another reason.
    monkeypatch.undo()
    spoilt = write_agent(
        GOOD.replace("return self.memory", "return np.where((self.calls == 8) & (np.arange(3) == 2)[:, None], 9, self.memory)")
    )
    assert evaluate(day_task, spoilt).runs[2].metrics == result.runs[2].metrics


@pytest.mark.parametrize(
    "act",
    [
        "return self.answer(observations).tolist()",
        "return [row for row in self.answer(observations)]",
        "print('thinking'); return self.answer(observations)",
        "actions = self.answer(observations); observations[:] = np.nan; return actions",
        "actions = self.answer(observations); observations.sort(); np.seterr(all='ignore'); return actions",
        "self.kept = self.answer(observations, getattr(self, 'kept', None)); return self.kept",
    ],
    ids=["lists", "list of arrays", "prints", "spoils its observations", "sorts its observations", "returns one array again and again"],
)
def test_odd_habits_change_nothing(day_task: TaskSpec, write_agent: AgentWriter, act: str) -> None:
    answer = """
        def answer(self, observations, out=None):
            return np.tanh(observations[:, :6].astype(float) / 100.0 - 0.3, out=out)
        def act(self, observations):
            {}
        """
    plain = evaluate(day_task, write_agent(answer.format("return self.answer(observations)")))

    assert evaluate(day_task, write_agent(answer.format(act))).runs == plain.runs


def test_single_precision_actions_are_taken(day_task: TaskSpec, write_agent: AgentWriter) -> None:
    path = write_agent("def act(self, observations):\n    return np.full((self.n, 6), 1.0, dtype=np.float32) / np.float32(3)")
    rounded = float(np.float32(1) / np.float32(3))
    same = write_agent(f"def act(self, observations):\n    return np.full((self.n, 6), {rounded!r})", name="double")

    assert evaluate(day_task, path).runs == evaluate(day_task, same).runs


def test_an_agent_that_changes_the_working_directory_does_not_move_the_result(
    day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = write_agent("def act(self, observations):\n    os.chdir('/')\n    return np.zeros((self.n, 6))")
    evaluate(day_task, path, out="reports")

    assert (tmp_path / "reports" / "results" / "Day-v1" / "agent_under_test.json").is_file()


def test_an_error_whose_class_breaks_when_it_is_looked_at_is_named(day_task: TaskSpec, write_agent: AgentWriter) -> None:
    hostile = """
        def act(self, observations):
            class Meta(type):
                def __getattribute__(cls, name): raise RuntimeError(name)
            class Hostile(Exception, metaclass=Meta): pass
            raise Hostile
        """
    result = evaluate(day_task, write_agent(hostile))

    assert ends(result) == [("crashed", 0)] * 3
    assert reason(result, 0) == "Hostile"


def test_what_looks_different_every_time_is_looked_at_once(day_task: TaskSpec, write_agent: AgentWriter) -> None:
    """Otherwise it could show zeros to who checks and something else to who simulates."""
    turning = """
        def act(self, observations):
            class Turning:
                looks = 0
                def __array__(self, dtype=None, copy=None):
                    self.looks += 1
                    return np.full((3, 6), 0.0 if self.looks == 1 else np.nan)
            return Turning()
        """
    still = "def act(self, observations):\n    return np.zeros((3, 6))\n"
    result = evaluate(day_task, write_agent(turning))

    assert ends(result) == [("ok", 24)] * 3
    assert result.runs == evaluate(day_task, write_agent(still)).runs
