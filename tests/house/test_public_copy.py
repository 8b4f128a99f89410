"""What a public copy runs (`.github`, `.ci`): pinned, with the least rights, and no code of others outside of the sandbox."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from glbench.cli.app import main

ROOT = Path(__file__).resolve().parents[2]
WORKFLOWS = {file.name: file for file in sorted((ROOT / ".github" / "workflows").glob("*.yml"))}
FORMS = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))
SCRIPTS = sorted(file for file in (ROOT / ".ci").iterdir() if file.is_file())

MAY_WRITE = {
    ("docs.yml", "publish"): {"pages": "write", "id-token": "write"},
    ("submission-report.yml", "post"): {"actions": "read", "pull-requests": "write"},
}
"""The jobs that may do more than read the repository, and what for: to publish the site, and to post a comment."""


def read(file: Path) -> dict[str, Any]:
    content: dict[Any, Any] = yaml.safe_load(file.read_text(encoding="utf-8"))
    return {
        ("on" if key is True else key): value for key, value in content.items()
    }  # YAML 1.1 takes `on` for a truth value


def jobs() -> Iterator[tuple[str, str, dict[str, Any]]]:
    for name, file in WORKFLOWS.items():
        for job, content in read(file)["jobs"].items():
            yield name, job, content


def commands(job: Mapping[str, Any]) -> list[str]:
    """Lines that the job's steps run, continued ones joined."""
    text = "\n".join(step["run"] for step in job["steps"] if "run" in step)
    return [line.strip() for line in re.sub(r"\\\n\s*", " ", text).splitlines() if line.strip()]


@pytest.mark.parametrize("file", [*WORKFLOWS.values(), *FORMS], ids=lambda file: file.name)
def test_every_file_is_readable(file: Path) -> None:
    assert read(file)


@pytest.mark.parametrize("name", sorted(WORKFLOWS))
def test_actions_are_pinned_to_a_commit_and_say_their_version(name: str) -> None:
    text = WORKFLOWS[name].read_text(encoding="utf-8")
    used = re.findall(r"uses: (.*)", text)
    wrong = [one for one in used if not re.fullmatch(r"[\w.-]+/[\w./-]+@[0-9a-f]{40} # v\d+(\.\d+)*", one)]
    assert not wrong


def test_an_action_is_pinned_to_the_same_commit_everywhere() -> None:
    pins: dict[str, set[str]] = {}
    for file in WORKFLOWS.values():
        for action, commit in re.findall(r"uses: ([^@\s]+)@(.*)", file.read_text(encoding="utf-8")):
            pins.setdefault(action, set()).add(commit)
    assert {action: commits for action, commits in pins.items() if len(commits) > 1} == {}


def test_jobs_have_the_rights_that_they_need_and_no_others() -> None:
    for name, file in WORKFLOWS.items():
        assert read(file)["permissions"] in ({}, {"contents": "read"}), f"{name}: what a job may do stands with the job"
    for name, job, content in jobs():
        rights = content.get("permissions", {"contents": "read"})
        assert rights == MAY_WRITE.get((name, job), {"contents": "read"}), f"{name}, {job}"


def test_a_job_with_a_token_that_writes_runs_no_code_of_a_checkout() -> None:
    for name, job, content in jobs():
        if (name, job) in MAY_WRITE:
            used = [step.get("uses", "").partition("@")[0] for step in content["steps"]]
            assert not {"actions/checkout", "actions/download-artifact", "astral-sh/setup-uv"} & set(used)
            assert not [
                line for line in commands(content) if re.search(r"\b(uv|uvx|python|pip|npm|make)\b|\.ci/", line)
            ]


def test_a_checkout_leaves_no_token_behind() -> None:
    for name, job, content in jobs():
        for step in content["steps"]:
            if step.get("uses", "").startswith("actions/checkout@"):
                assert step["with"]["persist-credentials"] is False, f"{name}, {job}"


def test_nothing_from_outside_is_pasted_into_a_command() -> None:
    for name, job, content in jobs():
        pasted = [line for line in commands(content) if "${{" in line]
        assert not pasted, f"{name}, {job}: hand it over in `env`, where a shell does not read it as a command"


def test_no_workflow_uses_a_secret() -> None:
    assert [name for name, file in WORKFLOWS.items() if "secrets." in file.read_text(encoding="utf-8")] == []


def with_rights_of_the_main_branch() -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Jobs that GitHub starts with the rights of the main branch, while somebody else wrote what they are about."""
    for name, job, content in jobs():
        if {"pull_request_target", "workflow_run", "issue_comment"} & set(read(WORKFLOWS[name])["on"]):
            yield name, job, content


def test_code_of_a_pull_request_runs_in_the_sandbox_only() -> None:
    found = list(with_rights_of_the_main_branch())
    assert {name for name, _, _ in found} == {"submission-evaluate.yml", "submission-report.yml"}
    for name, job, content in found:
        steps = content["steps"]
        for step in steps:
            options = step.get("with", {})
            if step.get("uses", "").startswith("actions/checkout@"):
                assert options["ref"] == "${{ github.sha }}", f"{name}, {job}: the main branch, nothing else"
            assert options.get("enable-cache", False) is False, "a cache would be that of the main branch"
        taken = [i for i, step in enumerate(steps) if "pull/$NUMBER/head" in step.get("run", "")]
        if not taken:
            continue
        (first,) = taken
        rest = {"steps": steps[first:]}
        assert 'git checkout --quiet "$HEAD" -- submissions' in commands(rest), "nothing but submissions is taken"
        known = re.compile(
            r'git (fetch|checkout) .*|\.ci/changed-submissions "\$BASE" "\$HEAD" \| tee changed\.txt'
            r"|xargs -r -d '\\n' \.ci/submission < changed\.txt|mkdir posted|echo \"\$NUMBER\" > posted/number"
            r"|(COLUMNS=120 NO_COLOR=1 )?uv run --no-sync glbench leaderboard .*|head -c \d+ reports/leaderboard\.md .*"
        )
        assert [line for line in commands(rest) if not known.fullmatch(line)] == []


def test_a_submission_is_evaluated_in_the_sandbox_and_with_the_installed_packages() -> None:
    script = (ROOT / ".ci" / "submission").read_text(encoding="utf-8")
    assert re.findall(r"run evaluate .*", script) == [
        'run evaluate "$@" "${what[@]}" --sandbox bubblewrap --episodes none --out "$out"'
    ]
    assert set(re.findall(r"uv run (\S+)", script)) == {"--no-sync"}
    assert "sandbox none" not in script


def test_the_labels_and_names_that_the_workflows_wait_for_fit_together() -> None:
    evaluate, report = (read(WORKFLOWS[f"submission-{what}.yml"]) for what in ("evaluate", "report"))
    assert report["on"]["workflow_run"]["workflows"] == [evaluate["name"]]
    uploaded = {
        step["with"]["name"]
        for step in evaluate["jobs"]["evaluate"]["steps"]
        if "upload-artifact" in step.get("uses", "")
    }
    assert uploaded == {"posted", "results"}
    assert 'gh run download "$RUN" --name posted --dir posted' in commands(report["jobs"]["post"])
    assert "label `evaluate`" in (ROOT / ".github" / "pull_request_template.md").read_text(encoding="utf-8")


def uv_commands() -> list[list[str]]:
    """Every ``uv run`` and what follows it, in workflows and scripts."""
    lines = [line for _, _, content in jobs() for line in commands(content)]
    lines += [line.strip() for file in SCRIPTS for line in file.read_text(encoding="utf-8").splitlines()]
    lines += [f"uv run glbench {line.removeprefix('run ')}" for line in lines if re.match(r"run [a-z]+ ", line)]
    found = [
        re.sub(r'\$\{what\[@\]\}|\$\{?\w+\}?|"\$@"', "x", line[line.index("uv run") :])
        for line in lines
        if "uv run " in line
    ]
    return [shlex.split(re.split(r" [>|<&;]", line)[0].rstrip(";} ")) for line in found if not line.startswith("#")]


@pytest.mark.parametrize("command", uv_commands(), ids=" ".join)
def test_every_command_that_is_run_exists(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    words = command[2:]
    while words[0].startswith("-"):
        words = words[2:] if words[0] in {"--group", "--extra"} else words[1:]
    if words[0] == "glbench":
        groups = {"submit", "tasks", "round", "weather", "episodes"}
        name = words[1:3] if words[1] in groups else words[1:2]
        if name == ["x"]:
            return  # `run`, the function that the others call
        with pytest.raises(SystemExit) as left:
            main([*name, "--help"])
        text = capsys.readouterr().out
        assert left.value.code == 0
        assert [option for option in words if option.startswith("--") and option not in text] == []
    elif words[:2] == ["python", "-m"]:
        assert (ROOT / words[2].replace(".", "/") / "__main__.py").is_file()
    else:
        assert words[0] in {"python", "pytest", "ruff", "mypy", "lint-imports"}


@pytest.mark.parametrize("file", [form for form in FORMS if form.name != "config.yml"], ids=lambda file: file.name)
def test_a_form_asks_each_question_once(file: Path) -> None:
    form = read(file)
    assert {"name", "description", "body"} <= set(form)
    ids = [part["id"] for part in form["body"] if part["type"] != "markdown"]
    assert len(ids) == len(set(ids)) > 0
    for part in form["body"]:
        assert part["type"] in {"markdown", "textarea", "input", "checkboxes"}
        assert part["attributes"][
            "value" if part["type"] == "markdown" else "options" if part["type"] == "checkboxes" else "label"
        ]


def git(folder: Path, *words: str) -> str:
    own = {
        "GIT_CONFIG_GLOBAL": os.devnull,
        "GIT_CONFIG_SYSTEM": os.devnull,
        "PATH": os.environ["PATH"],
        "HOME": str(folder),
    }
    who = ["-c", "user.name=a", "-c", "user.email=a@example.org"]
    return subprocess.run(
        ["git", *who, *words], cwd=folder, env=own, check=True, capture_output=True, text=True
    ).stdout.strip()


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A repository with two submissions and a baseline."""
    for name in ("submissions/anna.py", "submissions/ben/agent.py", "baselines/grower/card.toml", "glbench.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("first\n")
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", "-A")
    git(tmp_path, "commit", "-qm", "first")
    return tmp_path


def changed(copy: Path, base: str) -> subprocess.CompletedProcess[str]:
    git(copy, "add", "-A")
    git(copy, "commit", "-qm", "second")
    script = ROOT / ".ci" / "changed-submissions"
    return subprocess.run(
        ["bash", str(script), base, "HEAD"], cwd=copy, capture_output=True, text=True, timeout=60, check=False
    )


def test_changed_submissions_are_found_and_nothing_else(copy: Path) -> None:
    base = git(copy, "rev-parse", "HEAD")
    for name in (
        "submissions/ben/weights.npz",
        "submissions/anna.toml",
        "submissions/new.py",
        "glbench.py",
        "submissions/notes.md",
    ):
        (copy / name).write_text("second\n")
    assert changed(copy, base).stdout.split() == ["submissions/anna.py", "submissions/ben", "submissions/new.py"]


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("-out.py", "is refused"),
        ("a b.py", "is refused"),
        ("grower.py", "is the name of a baseline"),
        ("alone.toml", "belongs to no submission"),
    ],
)
def test_names_that_could_do_harm_are_refused(copy: Path, name: str, reason: str) -> None:
    base = git(copy, "rev-parse", "HEAD")
    (copy / "submissions" / name).write_text("second\n")
    result = changed(copy, base)
    assert result.returncode != 0
    assert reason in result.stderr
