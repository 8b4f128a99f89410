"""Agents in a round: what they can read (nothing of the secret), and what one gains that knows the public draws (nothing)."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from glbench.agents import identify
from glbench.env.scenario import RunScenarios
from glbench.evaluation import prepare
from glbench.evaluation.sandbox.bubblewrap import why_no_sandbox
from glbench.evaluation.sandbox.frames import Prints
from glbench.evaluation.sandbox.visible import is_visible
from glbench.resources import data_folder, user_data_folder
from glbench.tasks import Round, TaskSpec
from tests.cli.command_line import Command
from tests.evaluation.agent_files import AgentWriter
from tests.rounds.conftest import SECRET
from tests.rounds.tiny import write_tiny

RUNS = 60
NO_SANDBOX = why_no_sandbox()
needs_sandbox = pytest.mark.skipif(NO_SANDBOX is not None, reason=str(NO_SANDBOX))

SEARCH = """
def act(self, observations):
    return np.zeros((self.n, 6))
def reset(self, task, n_runs):
    self.n = n_runs
    import gc, json
    wanted = [WANTED]  # a fragment of the salt: enough to recognise it, and itself no secret of the round
    own = __file__
    found, looked = [], 0
    def look(place, content):
        for text in wanted:
            if text.encode() in content:
                found.append(place)
    for place, folders, files in os.walk("/"):
        folders[:] = [f for f in folders if place != "/" or f not in ("usr", "dev", "proc", "sys")]
        if place.startswith(tuple(p for p in sys.path if p.endswith("-packages"))):
            folders[:] = []
            continue
        for name in files:
            path = os.path.join(place, name)
            if path == own:
                continue
            try:
                with open(path, "rb") as file:
                    look(path, file.read(4_000_000))
                looked += 1
            except OSError:
                pass
    look("environment", repr(dict(os.environ)).encode())
    look("arguments", repr(sys.argv + sys.orig_argv).encode())
    processes = [number for number in os.listdir("/proc") if number.isdigit()]
    for number in processes:
        for what in ("environ", "cmdline", "maps", "mountinfo"):
            try:
                with open(f"/proc/{number}/{what}", "rb") as file:
                    content = file.read()
            except OSError:
                continue
            look(f"/proc/{number}/{what}", content)
            if b"round.toml" in content:
                found.append(f"the file's name in /proc/{number}/{what}")
    texts = [value for thing in gc.get_objects() if type(thing) is dict for value in list(thing.values()) if type(value) is str]
    for text in texts:
        if text not in wanted:
            look("memory", text.encode(errors="replace"))
    print("SEEN " + json.dumps({"found": found, "looked": looked, "processes": len(processes)}))
"""

CLAIRVOYANT = """
KNOWS, FIRST_SEED, FAMILY, SALT = {knows}, 10000, "test/Tiny", "test"

def reset(self, task, n_runs):
    from glbench.env.random import key_of, uniforms
    self.n = n_runs
    self.air = task.observation_names.index("air_temperature")
    self.boiler, self.vents = (task.action_names.index(name) for name in ("uBoil", "uVent"))
    # Row i of the batch is the run with the task's first seed + i: that is published, and so is this arithmetic.
    label = "glbench\\n{{}}\\n{{}}\\n{{}}\\nsensor offsets"
    keys = np.array([key_of(label.format(self.FAMILY, self.SALT, self.FIRST_SEED + run)) for run in range(n_runs)], np.uint64)
    numbers = uniforms(keys, np.zeros((n_runs, 1), np.int64), 4)[:, 0]
    self.bias = (numbers[:, :3].sum(axis=1) - 1.5) * 2.0 * 6.0
    print("BIAS " + str(self.bias.tolist()))

def act(self, observations):
    air = observations[:, self.air].astype(float) - (self.bias if self.KNOWS else 0.0)
    actions = np.zeros((self.n, 6))
    actions[:, self.boiler] = np.clip((19.0 - air) * 0.5, -1.0, 1.0)
    actions[:, self.vents] = np.clip((air - 26.0) * 0.2, -1.0, 1.0)
    return actions
"""


@needs_sandbox
def test_a_sandboxed_agent_finds_no_salt_in_files_environment_arguments_processes_or_memory(
    tiny: TaskSpec, tmp_path: Path, write_agent: AgentWriter
) -> None:
    """The whole command, as a host runs it, with the round's file beside the results."""
    sealed = Round.new()
    (tmp_path / "secret").mkdir()
    file = tmp_path / "secret" / "round.toml"
    file.write_text(sealed.to_toml(), encoding="utf-8")
    (tmp_path / "agents").mkdir()
    agent = write_agent(SEARCH.replace("[WANTED]", f"[{sealed.salt[:20]!r}]"))
    agent = agent.rename(tmp_path / "agents" / agent.name)
    command = [
        sys.executable, "-m", "glbench", "evaluate", str(agent), "--task", str(write_tiny(tmp_path)), "--round", str(file),
        "--runs", "1", "--sandbox", "bubblewrap", "--out", str(tmp_path / "reports"), "--show-prints",
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, "COLUMNS": "1000"})
    assert done.returncode == 0, done.stderr
    said = done.stdout + done.stderr
    assert "SEEN {" in said, said
    (line,) = [line for line in said.splitlines() if "SEEN {" in line]
    seen = json.loads(line.partition("SEEN ")[2])
    assert seen["found"] == []
    assert seen["looked"] > 100
    assert seen["processes"] >= 1
    assert sealed.salt not in done.stdout + done.stderr


@needs_sandbox
def test_the_search_finds_what_is_there(tiny: TaskSpec, write_agent: AgentWriter) -> None:
    """The test above can fail: a fragment that stands in a file of glbench is found."""
    agent = write_agent(SEARCH.replace("[WANTED]", "['Sealed rounds (held-out draws']"))
    evaluation = prepare(tiny, agent, runs=1, sandbox="bubblewrap")
    evaluation = dataclasses.replace(evaluation, prints=Prints(2**20))
    result = evaluation.run()
    assert result.summary.ok == 1, result.failed
    (line,) = [line for line in evaluation.prints.text().splitlines() if line.startswith("SEEN ")]
    assert "/opt/glbench/glbench/tasks/sealed.py" in json.loads(line.removeprefix("SEEN "))["found"]


def test_a_round_file_where_an_agent_would_see_it_is_told(write_agent: AgentWriter, tmp_path: Path) -> None:
    agent = write_agent()
    identity = identify(agent)
    assert identity is not None
    hidden = [
        tmp_path / "round.toml",
        user_data_folder() / "round.toml",
        Path("/usr/share/round.toml"),
        data_folder("baselines") / "round.toml",
        data_folder("baselines") / "best_known" / "plans" / "Spring-v1.npz",
    ]
    shown = [
        agent,
        Path("/usr/lib/round.toml"),
        Path(np.__file__).parent / "round.toml",
        data_folder("baselines") / "rule_based_tuned" / "rules" / "round.toml",
    ]
    assert [is_visible(file, identity) for file in hidden] == [False] * 5
    assert [is_visible(file, identity) for file in shown] == [True] * 4


@needs_sandbox
def test_a_round_file_in_the_folder_of_a_submission_is_refused(glbench: Command, write_agent: AgentWriter, tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    write_agent().rename(folder / "agent.py")
    (folder / "round.toml").write_text(SECRET.to_toml(), encoding="utf-8")
    answer = glbench(
        "evaluate", folder, "--task", write_tiny(tmp_path), "--round", folder / "round.toml", "--sandbox", "bubblewrap",
        "--out", tmp_path / "reports",
    )  # fmt: skip
    assert answer.code == 1
    assert "would see" in answer.err
    assert SECRET.salt not in answer.out + answer.err


def test_without_a_sandbox_nothing_of_a_stranger_runs_in_a_round(glbench: Command, write_agent: AgentWriter, tmp_path: Path) -> None:
    (tmp_path / "round.toml").write_text(SECRET.to_toml(), encoding="utf-8")
    answer = glbench(
        "evaluate", write_agent(), "--task", write_tiny(tmp_path), "--round", tmp_path / "round.toml", "--sandbox", "none",
        "--out", tmp_path / "reports",
    )  # fmt: skip
    assert answer.code == 1
    assert "--sandbox bubblewrap only" in answer.err


def earned(task: TaskSpec, agent: Path) -> tuple[float, list[float]]:
    """Mean reward of a sandboxed agent, and the biases that it computed."""
    evaluation = dataclasses.replace(prepare(task, agent, runs=RUNS, sandbox="bubblewrap"), prints=Prints(2**20))
    result = evaluation.run()
    assert not result.failed, result.failed
    (line,) = [line for line in evaluation.prints.text().splitlines() if line.startswith("BIAS ")]
    return result.summary.mean["reward"], json.loads(line.removeprefix("BIAS "))


@needs_sandbox
def test_an_agent_that_knows_the_public_draws_gains_by_them_and_nothing_in_a_round(tiny: TaskSpec, write_agent: AgentWriter) -> None:
    knowing = write_agent(CLAIRVOYANT.format(knows=True), "knowing")
    blind = write_agent(CLAIRVOYANT.format(knows=False), "blind")
    seeds = list(range(10000, 10000 + RUNS))

    public = tiny.scored
    with_draws, computed = earned(public, knowing)
    assert computed == RunScenarios(public).draw(seeds).traits[:, 0].tolist(), "it knows every bit of them"
    gain = with_draws - earned(public, blind)[0]

    gains = []
    for salt in range(4):
        task = tiny.in_split("test", Round(f"{salt:064x}").secret)
        score, guessed = earned(task, knowing)
        assert guessed == computed
        true = RunScenarios(task).draw(seeds).traits[:, 0]
        assert not np.isclose(true, guessed, atol=1e-3).any()
        gains.append(score - earned(task, blind)[0])
    assert gain > 0.005
    assert np.mean(gains) < 0.0
    assert max(gains) < gain


@needs_sandbox
@pytest.mark.parametrize("single", [False, True])
def test_an_agent_can_know_which_run_it_is_in(tiny: TaskSpec, write_agent: AgentWriter, single: bool) -> None:
    """By its row, or by the order in which agents for single runs are made: a salt is what helps, not hiding the number."""
    body = """
    made = 0
    def reset(self, task{more}):
        Agent.made += 1
        self.n, self.row = {n}, Agent.made - 1
    def act(self, observations):
        return np.full({shape}, 0.0) + {row} / 100.0
    """
    filled = (
        body.format(more="", n="1", shape="6", row="self.row")
        if single
        else body.format(more=", n_runs", n="n_runs", shape="(self.n, 6)", row="np.arange(self.n)[:, None]")
    )
    evaluation = prepare(tiny, write_agent(filled, single=single), sandbox="bubblewrap")
    log = evaluation.compute().log
    assert log.actions[0, :, 0].tolist() == pytest.approx([row / 100.0 for row in range(6)])
