"""Whether an agent is sandboxed: strangers' code always, or it is not run."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from glbench.agents import identify, load_agent
from glbench.errors import GlbenchError, SandboxError, SubmissionError
from glbench.evaluation import evaluate, prepare, protect
from glbench.evaluation.sandbox import bubblewrap
from glbench.evaluation.sandbox.choosing import EXAMPLES
from glbench.resources import data_folder
from glbench.tasks import TaskSpec
from tests.evaluation.agent_files import AgentWriter


@pytest.fixture
def without_bubblewrap(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A machine on which bubblewrap is not installed."""
    # Only bubblewrap: without a compiler, this process would keep the slow kernel for all tests to come.
    which = shutil.which
    monkeypatch.setattr(shutil, "which", lambda name, *rest: None if name == "bwrap" else which(name, *rest))
    bubblewrap._tried.cache_clear()
    yield
    bubblewrap._tried.cache_clear()


@pytest.mark.usefixtures("without_bubblewrap")
@pytest.mark.parametrize("choice", ["auto", "bubblewrap"])
def test_without_bubblewrap_strangers_code_is_not_run_and_it_says_what_to_do(
    day_task: TaskSpec, write_agent: AgentWriter, choice: str
) -> None:
    path = write_agent()
    path.write_text("raise SystemExit('it was run')", encoding="utf-8")

    with pytest.raises(SandboxError, match=r"'agent_under_test' was not run.*apt-get install bubblewrap.*--sandbox none"):
        prepare(day_task, path, sandbox=choice)  # type: ignore[arg-type]


@pytest.mark.usefixtures("without_bubblewrap")
def test_without_bubblewrap_an_unchanged_example_is_run_and_the_result_says_so(day_task: TaskSpec, tmp_path: Path) -> None:
    example = data_folder("submissions") / "my_agent.py"
    changed = tmp_path / "my_agent.py"
    changed.write_text(example.read_text(encoding="utf-8") + "\n# changed\n", encoding="utf-8")

    assert evaluate(day_task, example, runs=1, sandbox="auto").evaluation.sandbox == "unsandboxed"
    with pytest.raises(SandboxError):
        protect(example, "bubblewrap")
    with pytest.raises(SandboxError):
        protect(changed, "auto")


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_digests_of_the_examples_are_those_of_their_files(name: str) -> None:
    submission = identify(data_folder("submissions") / f"{name}.py")

    assert submission is not None
    assert EXAMPLES[name] == submission.digest, "an example changed: write its new digest into EXAMPLES"


@pytest.mark.usefixtures("without_bubblewrap")
@pytest.mark.parametrize("choice", ["auto", "bubblewrap", "none"])
def test_built_in_controllers_need_no_sandbox(choice: str, tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    for name in ("card.toml", "rule_based.yml"):
        shutil.copy(data_folder("baselines") / "rule_based" / name, folder)

    assert protect("rule_based", choice).protection == "built-in"  # type: ignore[arg-type]
    assert protect(folder, choice).protection == "built-in"  # type: ignore[arg-type]


def test_an_agent_that_was_loaded_here_cannot_be_sandboxed(write_agent: AgentWriter) -> None:
    loaded = load_agent(write_agent())

    assert protect(loaded, "none").protection == "unsandboxed"
    with pytest.raises(SubmissionError, match="loaded into this process already"):
        protect(loaded, "bubblewrap")


def test_an_unknown_choice_is_answered_with_the_nearest(write_agent: AgentWriter) -> None:
    with pytest.raises(GlbenchError, match="Did you mean 'bubblewrap'"):
        protect(write_agent(), "bubblewarp")  # type: ignore[arg-type]


def test_another_system_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    bubblewrap._tried.cache_clear()
    reason = bubblewrap.why_no_sandbox()
    bubblewrap._tried.cache_clear()

    assert reason is not None
    assert "Linux only" in reason
    assert "--sandbox none" in reason


def test_what_bubblewrap_says_against_it_is_repeated(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, write_agent: AgentWriter) -> None:
    fake = tmp_path / "bin" / "bwrap"
    fake.parent.mkdir()
    fake.write_text("#!/bin/sh\necho 'bwrap: setting up uid map: Permission denied' >&2\nexit 1\n", encoding="utf-8")
    fake.chmod(0o755)
    monkeypatch.setenv("PATH", str(fake.parent))
    bubblewrap._tried.cache_clear()
    monkeypatch.setattr(bubblewrap, "ENVIRONMENT_OF_BUBBLEWRAP", {"PATH": f"{fake.parent}:/usr/bin:/bin"})
    try:
        with pytest.raises(SandboxError, match=r"setting up uid map: Permission denied.*docs/threat-model.md"):
            protect(write_agent(), "bubblewrap")
    finally:
        bubblewrap._tried.cache_clear()


def test_identifying_a_submission_runs_nothing_of_it(write_agent: AgentWriter) -> None:
    path = write_agent()
    loaded = load_agent(path)
    submission = identify(path)

    assert submission is not None
    assert (submission.name, submission.digest, submission.information) == (loaded.name, loaded.digest, loaded.information)
    path.write_text("raise SystemExit('it was run')", encoding="utf-8")
    assert identify(path) is not None
    assert identify("rule_based") is None
    assert identify(path.with_name("nowhere.py")) is None
