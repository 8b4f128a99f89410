"""``check_submission`` finds what an evaluation would find, at once and in words."""

from __future__ import annotations

import ast
import re
import time
from pathlib import Path

import pytest

from glbench.agents.identity import read_identity
from glbench.agents.loading import new_submission
from glbench.errors import SubmissionError
from glbench.evaluation.limits import TimeLimits
from glbench.evaluation.sandbox import bubblewrap
from glbench.evaluation.sandbox.bubblewrap import why_no_sandbox
from glbench.evaluation.submitting import CHECKS, Report, check, check_submission, findings
from glbench.evaluation.submitting.check import _no_answer

pytestmark = pytest.mark.slow

SECONDS = 30.0  # an upper bound: a good agent needs a fraction of it, on a busy machine too
CARD = 'name = "x"\nauthors = ["A"]\nlicence = "MIT"\ninformation = ["observations"]\n'
HEAD = """
import os, time
import numpy as np
class Agent:
    def reset(self, task, n_runs): self.n, self.calls = n_runs, 0
    def act(self, observations):
        self.calls += 1
        actions = np.zeros((self.n, 6))
"""
TAIL = """
        return actions
def make_agent(task):
    return Agent()
"""


@pytest.fixture(params=["bubblewrap", "none"])
def sandbox(request: pytest.FixtureRequest) -> str:
    """Both places where an agent is checked; in a sandbox where there can be one."""
    reason = why_no_sandbox()
    if request.param == "bubblewrap" and reason is not None:
        pytest.skip(reason)
    return str(request.param)


def looked_at(folder: Path, task: Path, act: str, sandbox: str, *, before: str = "", seconds: float = SECONDS) -> Report:
    file = folder / "mine.py"
    lines = "".join(f"        {line}\n" for line in act.splitlines())
    file.write_text(before + HEAD + lines + TAIL, encoding="utf-8")
    file.with_suffix(".toml").write_text(CARD, encoding="utf-8")
    return check_submission(file, task, seconds=seconds, sandbox=sandbox)  # type: ignore[arg-type]


def test_a_good_submission_passes_every_check(tmp_path: Path, day_task_file: Path, sandbox: str) -> None:
    new_submission(tmp_path / "mine", "rule")
    report = check_submission(tmp_path / "mine", day_task_file, seconds=SECONDS, sandbox=sandbox)  # type: ignore[arg-type]
    assert report.findings == ()
    assert report.ok
    assert report.checked == set(CHECKS)
    assert report.facts["files"].startswith("3 files")
    assert re.search(r"ms a decision of one run, .*; at most .* for \d+ runs of \d+ steps", report.facts["time"])
    assert ("sandbox (bubblewrap)" if sandbox == "bubblewrap" else "unsandboxed") in report.facts["loading"]


@pytest.mark.parametrize(
    ("act", "subject", "words"),
    [
        ("if self.calls == 5: actions[2, 3] = np.nan", "decisions", "In step 5, run 3 of 4: the action for uVent is nan"),
        ("actions = actions[:, :5]", "decisions", "In step 1, every run: act returned an array of shape (4, 5)"),
        ("if self.calls == 3: actions += 1.5", "decisions", "outside its bounds -1 to 1"),
        ("if self.calls == 4: raise ValueError('no idea')", "decisions", "act fails in step 4: ValueError: no idea (mine.py:"),
        ("if self.calls == 4:\n    print('the end', flush=True)\n    os._exit(3)", "decisions", 'exit code 3. Its last words: "the end"'),
        ("actions += np.random.uniform()", "repeatable", "decided differently in step 1"),
        ("actions += 0.5 * (observations[:, 2:3] > observations[:, 2].mean())", "rows", "rows learn of each other"),
        ("self.kept = getattr(self, 'kept', []) + [np.ones(2**18)]", "memory", "Memory grows by"),
        ("open('notes.txt', 'a').close()", "surroundings", "It writes to notes.txt"),
        ("import socket\ntry: socket.socket().connect(('127.0.0.1', 9))\nexcept OSError: pass", "surroundings", "It connects to "),
        ("print('x' * 9000)", "printing", "KiB in this short run"),
    ],
    ids=["nan", "shape", "bounds", "raises", "exits", "random", "rows", "leak", "writes", "network", "prints"],
)  # fmt: skip
def test_what_is_wrong_is_told_under_its_subject(
    tmp_path: Path, day_task_file: Path, monkeypatch: pytest.MonkeyPatch, sandbox: str, act: str, subject: str, words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    task = day_task_file
    if subject == "memory":  # a day of 24 steps cannot grow beyond any limit; a season can
        task = tmp_path / "season.toml"
        text = day_task_file.read_text(encoding="utf-8")
        task.write_text(text.replace("days = 1", "days = 300").replace("Day-v1", "Season-v1"), encoding="utf-8")
    report = looked_at(tmp_path, task, act, sandbox)
    assert not report.ok
    assert [finding.subject for finding in report.problems] == [subject]
    assert words in report.problems[0].text


def test_an_agent_that_hangs_costs_its_time_and_no_more(
    tmp_path: Path, day_task_file: Path, sandbox: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(check, "_SHORTEST_START", 12.0)
    began = time.monotonic()
    before = "while True:\n    try: __import__('time').sleep(9)\n    except BaseException: pass\n"
    report = looked_at(tmp_path, day_task_file, "pass", sandbox, before=before, seconds=10.0)
    assert [finding.subject for finding in report.problems] == ["loading"]
    assert "It did not come back within 12 s while its file was loaded" in report.problems[0].text
    assert "The limit of an evaluation is 5 min." in report.problems[0].text
    assert "loading" in report.checked
    assert "time" not in report.checked
    assert time.monotonic() - began < 240


def test_loading_takes_nothing_from_the_time_of_the_steps(tmp_path: Path, day_task_file: Path) -> None:
    report = looked_at(tmp_path, day_task_file, "time.sleep(0.02)", "none", before="import time; time.sleep(6.0)\n", seconds=5.0)
    assert report.ok, report.findings
    assert not [finding for finding in report.findings if finding.subject == "time"], "all steps fitted in"


@pytest.mark.parametrize(("first", "later", "ok"), [(5.0, 0.01, True), (0.0, 4.4, False)], ids=["plans first", "slow"])
def test_the_pace_is_that_of_later_decisions(tmp_path: Path, day_task_file: Path, first: float, later: float, ok: bool) -> None:
    """In a season of 9,600 steps, for all four runs of which decisions are made at once."""
    task = tmp_path / "season.toml"
    text = day_task_file.read_text(encoding="utf-8")
    task.write_text(text.replace("days = 1", "days = 400").replace("Day-v1", "Season-v1"), encoding="utf-8")
    act = f"time.sleep({first} if self.calls == 1 else {later})"
    report = looked_at(tmp_path, task, act, "none", seconds=4.0)
    assert report.ok is ok, report.findings
    if ok:
        pace, begun = map(float, re.findall(r"([\d.e+]+) ms", report.facts["time"]))
        assert pace < 500.0 < 1250.0 <= begun, "a busy machine takes longer, never less than the agent sleeps"
    else:
        (finding,) = report.problems
        assert "All decisions of a run would take 2.9 h: " in finding.text
        assert "s for the first one and 1.1 s for each other one, the mean of" in finding.text


def test_a_decision_that_the_check_cannot_wait_for_is_judged_by_the_limits_and_the_pace() -> None:
    """40 s for four runs, in tasks that allow 60 s and 10 s a decision."""
    for before, steps, limit, level in (
        ([], 9600, 60.0, "note"),  # the first one says nothing of the others
        ([0.1, 0.1], 9600, 60.0, "problem"),
        ([0.1, 0.1], 960, 60.0, "note"),
        ([], 960, 10.0, "problem"),
    ):
        assert _no_answer(40.0, 4, before, steps, TimeLimits(step=limit)).level == level, (before, steps, limit)


def test_findings_of_all_files_come_together(tmp_path: Path, day_task_file: Path) -> None:
    folder = tmp_path / "mine"
    new_submission(folder, "rule")
    card = (folder / "submission.toml").read_text(encoding="utf-8")
    (folder / "submission.toml").write_text(card.replace("licence", "license"), encoding="utf-8")
    report = check_submission(folder, day_task_file)
    assert {finding.subject for finding in report.problems} == {"card"}
    assert len(report.problems) == 2, "the missing key and the unknown one"
    (folder / "submission.toml").write_text(card, encoding="utf-8")
    (folder / "helper.py").write_text("import no_such_library\ntry:\n    import another_one\nexcept ImportError:\n    pass\n")
    report = check_submission(folder, day_task_file)
    texts = [finding.text for finding in report.of("packages")]
    assert any("helper.py:1 imports 'no_such_library', which is not installed here" in text for text in texts)
    assert any("'another_one'" in text and "within try" in text for text in texts)


def test_sources_are_parsed_once_and_walked_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However deeply ``try`` is nested, and however many files there are."""
    new_submission(tmp_path / "mine", "rule")
    nested = "".join(f"{' ' * depth}try:\n" for depth in range(90)) + f"{' ' * 90}import another_one\n"
    nested += "".join(f"{' ' * depth}except E: pass\n" for depth in reversed(range(90)))
    (tmp_path / "mine" / "helper.py").write_text(nested + "import no_such_library\n")
    walked: list[object] = []
    of = ast.iter_child_nodes
    monkeypatch.setattr(ast, "iter_child_nodes", lambda node: walked.append(node) or of(node))
    imports = findings.imports_of(read_identity(tmp_path / "mine"))
    places = [id(node) for node in walked if hasattr(node, "lineno")]  # Python shares those without a line
    assert len(places) == len(set(places))
    assert {(name, guarded) for _, name, _, guarded in imports} >= {("another_one", True), ("no_such_library", False)}
    monkeypatch.setattr(findings, "_ALL_SOURCES", 0)
    assert findings.imports_of(read_identity(tmp_path / "mine")) == []


def test_without_a_card_the_report_says_what_is_lost_and_is_good_nevertheless(tmp_path: Path, day_task_file: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(HEAD + TAIL, encoding="utf-8")
    report = check_submission(file, day_task_file, seconds=SECONDS)
    assert report.ok
    assert [(finding.subject, finding.level) for finding in report.findings] == [("card", "note")]
    assert "There is no card (mine.toml beside the file)" in report.findings[0].text


def test_what_is_no_submission_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SubmissionError, match="There is no file or folder"):
        check_submission(tmp_path / "nothing.py")


def test_where_there_is_no_sandbox_files_are_looked_at_and_nothing_is_run(
    tmp_path: Path, day_task_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "mine.py"
    file.write_text("import no_such_library\nraise SystemExit('it was run')\n", encoding="utf-8")
    monkeypatch.setattr(bubblewrap, "_tried", lambda: ("There is no bubblewrap: install it, or give --sandbox none.", None))
    report = check_submission(file, day_task_file)
    assert {finding.subject for finding in report.problems} == {"packages"}
    file.write_text("raise SystemExit('it was run')\n", encoding="utf-8")
    report = check_submission(file, day_task_file)
    assert [finding.text for finding in report.problems] == [
        "'mine' was not run. There is no bubblewrap: install it, or give --sandbox none."
    ]


SHARED = """
import numpy as np
MADE = []
class Agent:
    single_run = True
    def reset(self, task): MADE.append(self); self.number = len(MADE)
    def act(self, observation): {act}
def make_agent(task): return Agent()
"""


@pytest.mark.parametrize(
    ("act", "subject", "words"),
    [
        ("return np.full(6, 0.01 * self.number)", "rows", "rows learn of each other"),
        ("return np.full(6, np.nan if self.number == 3 else 0.0)", "decisions", "In step 1, run 3 of 4"),
    ],
    ids=["counts", "one fails"],
)
def test_agents_for_single_runs_are_told_from_each_other(
    tmp_path: Path, day_task_file: Path, sandbox: str, act: str, subject: str, words: str
) -> None:
    file = tmp_path / "mine.py"
    file.write_text(SHARED.format(act=act), encoding="utf-8")
    report = check_submission(file, day_task_file, seconds=SECONDS, sandbox=sandbox)  # type: ignore[arg-type]
    assert [finding.subject for finding in report.problems] == [subject]
    assert words in report.problems[0].text


def test_one_slow_run_is_told_by_its_own_limit(tmp_path: Path, day_task_file: Path) -> None:
    if why_no_sandbox() is not None:
        pytest.skip(str(why_no_sandbox()))
    file = tmp_path / "mine.py"
    act = "__import__('time').sleep(60.0 * (self.number == 2)); return np.zeros(6)"
    file.write_text(SHARED.format(act=act), encoding="utf-8")
    report = check_submission(file, day_task_file, seconds=20.0)
    assert any("for one run in step 1" in finding.text for finding in report.of("time")), report.findings


def test_a_link_out_of_the_folder_is_a_finding_and_no_crash(tmp_path: Path, day_task_file: Path) -> None:
    if why_no_sandbox() is not None:
        pytest.skip(str(why_no_sandbox()))
    folder = tmp_path / "mine"
    new_submission(folder, "rule")
    (folder / "link.txt").symlink_to(day_task_file)
    report = check_submission(folder, day_task_file)
    assert [finding.subject for finding in report.problems] == ["files"]
    assert "link.txt is a link that leads out of the submission's folder" in report.problems[0].text
