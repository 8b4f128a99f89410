"""What a public copy runs (`.github`, `.ci`): pinned, with the least rights, and no code of others outside of the sandbox."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from glbench.cli.app import main
from glbench.evaluation.sandbox.choosing import EXAMPLES
from glbench.tasks import DEFAULT_TASK, get_task, list_suites

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
    return {("on" if key is True else key): value for key, value in content.items()}  # YAML 1.1 takes `on` for a truth value


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
            assert not [line for line in commands(content) if re.search(r"\b(uv|uvx|python|pip|npm|make)\b|\.ci/", line)]


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
        checkout = commands(rest).index('git checkout --quiet "$HEAD" -- submissions')  # nothing but submissions
        assert commands(rest)[checkout - 1] == "git rm -rq submissions", "what the pull request deletes is gone"
        known = re.compile(
            r'git (fetch|checkout) .*|git rm -rq submissions|\.ci/changed-submissions "\$BASE" "\$HEAD" \| tee changed\.txt'
            r"|\[ -s changed\.txt \] \|\| \{ echo .*; exit 1; \}|xargs -r -d '\\n' \.ci/submission < changed\.txt"
            r"|sed -E 's/[^']*' changed\.txt > posted/names|grep -ro '\"results_digest\": \"\[0-9a-f\]\*\"' .*"
            r"|(COLUMNS=120 NO_COLOR=1 )?uv run --no-sync glbench leaderboard .*|head -c \d+ reports/leaderboard\.md .*"
        )
        assert [line for line in commands(rest) if not known.fullmatch(line)] == []


def test_a_submission_is_evaluated_in_the_sandbox_and_with_the_installed_packages() -> None:
    script = (ROOT / ".ci" / "submission").read_text(encoding="utf-8")
    assert re.findall(r"run evaluate .*", script) == [
        'run evaluate "$@" "${what[@]}" "${draws[@]}" --sandbox bubblewrap --episodes none --out "$out"'
    ]
    assert set(re.findall(r"uv run (\S+)", script)) == {"--no-sync"}
    assert "sandbox none" not in script


def test_the_labels_and_names_that_the_workflows_wait_for_fit_together() -> None:
    evaluate, report = (read(WORKFLOWS[f"submission-{what}.yml"]) for what in ("evaluate", "report"))
    assert report["on"]["workflow_run"]["workflows"] == [evaluate["name"]]
    uploaded = {step["with"]["name"] for step in evaluate["jobs"]["evaluate"]["steps"] if "upload-artifact" in step.get("uses", "")}
    assert uploaded == {"posted", "results"}
    assert 'gh run download "$RUN" --name posted --dir posted' in commands(report["jobs"]["post"])
    assert "label `evaluate`" in (ROOT / ".github" / "pull_request_template.md").read_text(encoding="utf-8")


def report(folder: Path, conclusion: str, **files: str) -> str:
    """What the workflow posts after an evaluation that ended like that and left these files."""
    (folder / "posted").mkdir()
    for name, text in files.items():
        (folder / "posted" / name).write_text(text)
    stand_in(folder, "gh", "true")
    (_, step) = read(WORKFLOWS["submission-report.yml"])["jobs"]["post"]["steps"]
    own = {"PATH": f"{folder}:{os.environ['PATH']}", "GH_REPO": "a/b", "CONCLUSION": conclusion, "PAGE": "https://x.org"}
    done = subprocess.run(["bash", "-eo", "pipefail", "-c", step["run"]], cwd=folder, env=own, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    return (folder / "comment.md").read_text()


def stand_in(folder: Path, name: str, *lines: str) -> None:
    """A program of that name in ``folder``, in bash."""
    (folder / name).write_text("\n".join(("#!/usr/bin/env bash", *lines, "")))
    (folder / name).chmod(0o755)


def test_the_report_of_a_success_names_what_was_evaluated_if_its_name_is_plain(tmp_path: Path) -> None:
    names = "anna\nben_2\n@everybody\n[x](https://y.org)\n"
    text = report(tmp_path, "success", number="12", names=names, **{"leaderboard.txt": "1 anna ~~~~~~ 7\n"})
    assert text.startswith("Evaluated in the sandbox and reproduced from its record: anna ben_2. ")
    assert "everybody" not in text
    assert "y.org" not in text
    assert "~~~~~~text\n1 anna ~~~ 7\n" in text


@pytest.mark.parametrize("conclusion", ["failure", "cancelled", "timed_out"])
def test_the_report_of_a_failure_is_one_sentence_of_our_own(tmp_path: Path, conclusion: str) -> None:
    text = report(tmp_path, conclusion, number="12", names="anna\n", **{"leaderboard.txt": "1 anna"})
    assert text.startswith("There is no result: ")
    assert "[This run](https://x.org)" in text
    assert "anna" not in text


def test_the_number_for_the_report_is_kept_when_an_evaluation_fails() -> None:
    steps = read(WORKFLOWS["submission-evaluate.yml"])["jobs"]["evaluate"]["steps"]
    number = next(i for i, step in enumerate(steps) if "posted/number" in step.get("run", ""))
    fetched = next(i for i, step in enumerate(steps) if "git fetch" in step.get("run", ""))
    assert number < fetched
    (posted,) = (step for step in steps if step.get("with", {}).get("name") == "posted")
    assert posted["if"] == "always()"


def test_a_pull_request_without_a_submission_is_no_success(tmp_path: Path) -> None:
    steps = read(WORKFLOWS["submission-evaluate.yml"])["jobs"]["evaluate"]["steps"]
    (line,) = (line for step in steps for line in step.get("run", "").splitlines() if "No submission changed" in line)
    for text, code in (("", 1), ("submissions/anna.py\n", 0)):
        (tmp_path / "changed.txt").write_text(text)
        assert subprocess.run(["bash", "-ec", line], cwd=tmp_path, capture_output=True, check=False).returncode == code


def test_the_page_of_a_run_has_the_digests_of_its_results(tmp_path: Path) -> None:
    steps = read(WORKFLOWS["submission-evaluate.yml"])["jobs"]["evaluate"]["steps"]
    (line,) = (line for step in steps for line in step.get("run", "").splitlines() if line.startswith("grep -ro"))
    folder = tmp_path / "reports" / "results" / "Spring-v1"
    folder.mkdir(parents=True)
    released = next((ROOT / "reports/released/results/Spring-v1").glob("my_agent.json"))
    (folder / "anna.json").write_bytes(released.read_bytes())
    own = {"GITHUB_STEP_SUMMARY": str(tmp_path / "summary"), "PATH": os.environ["PATH"]}
    subprocess.run(["bash", "-eo", "pipefail", "-c", line], cwd=tmp_path, env=own, check=True)
    digest = json.loads(released.read_bytes())["results_digest"]
    assert (tmp_path / "summary").read_text() == f'    reports/results/Spring-v1/anna.json:"results_digest": "{digest}"\n'


def uv_commands() -> list[list[str]]:
    """Every ``uv run`` and what follows it, in workflows and scripts."""
    lines = [line for _, _, content in jobs() for line in commands(content)]
    lines += [line.strip() for file in SCRIPTS for line in file.read_text(encoding="utf-8").splitlines()]
    lines += [f"uv run glbench {line.removeprefix('run ')}" for line in lines if re.match(r"run [a-z]+ ", line)]
    found = [re.sub(r'\$\{what\[@\]\}|\$\{?\w+\}?|"\$@"', "x", line[line.index("uv run") :]) for line in lines if "uv run " in line]
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
        assert part["attributes"]["value" if part["type"] == "markdown" else "options" if part["type"] == "checkboxes" else "label"]


def git(folder: Path, *words: str) -> str:
    own = {"GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_SYSTEM": os.devnull, "PATH": os.environ["PATH"], "HOME": str(folder)}
    who = ["-c", "user.name=a", "-c", "user.email=a@example.org"]
    return subprocess.run(["git", *who, *words], cwd=folder, env=own, check=True, capture_output=True, text=True).stdout.strip()


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A repository with two submissions, a baseline and a released result."""
    for name in (
        "submissions/anna.py",
        "submissions/anna.toml",
        "submissions/ben/agent.py",
        "baselines/grower/card.toml",
        "reports/released/results/Spring-v1/carl.json",
        "glbench.py",
    ):
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
    return subprocess.run(["bash", str(script), base, "HEAD"], cwd=copy, capture_output=True, text=True, timeout=60, check=False)


def test_changed_submissions_are_found_and_nothing_else(copy: Path) -> None:
    base = git(copy, "rev-parse", "HEAD")
    for name in ("submissions/ben/weights.npz", "submissions/anna.toml", "submissions/new.py", "glbench.py", "submissions/notes.md"):
        (copy / name).write_text("second\n")
    assert changed(copy, base).stdout.split() == ["submissions/anna.py", "submissions/ben", "submissions/new.py"]


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("-out.py", "is refused"),
        ("a b.py", "is refused"),
        ("grower.py", "is the name of a baseline"),
        ("alone.toml", "belongs to no submission"),
        ("carl.py", "has a released result"),
        ("Carl.py", "has a released result"),
        *((f"{name}.py", "is the name of an example") for name in EXAMPLES),
    ],
)
def test_names_that_could_do_harm_are_refused(copy: Path, name: str, reason: str) -> None:
    base = git(copy, "rev-parse", "HEAD")
    (copy / "submissions" / name).write_text("second\n")
    result = changed(copy, base)
    assert result.returncode != 0
    assert reason in result.stderr


CARD = 'name = "x"\nauthors = ["{author}"]\nlicence = "MIT"\ninformation = ["observations"]\nseed = {seed}\nrecipe = "{recipe}"\n'


@pytest.mark.parametrize(
    ("name", "known"),
    [
        ("Anna.py", "anna"),
        ("an-na.py", "anna"),
        ("ann4.py", "anna"),
        ("anna_seed1.py", "anna"),
        ("anna.SEED-2.py", "anna"),
        ("8en.py", "ben"),
        ("Gr0wer.py", "grower"),
        ("grower_seed3.py", "grower"),
        ("grower_seed12345678901.py", "grower"),
        ("grower_seedl.py", "grower"),
        ("grower_5eed-II.py", "grower"),
        ("grower_seed7_.py", "grower"),
        ("grower_seed.py", "grower"),
        ("car1.py", "carl"),
        ("cari_seed2.py", "carl"),
    ],
)
def test_names_that_look_like_those_of_others_are_refused(copy: Path, name: str, known: str, monkeypatch: pytest.MonkeyPatch) -> None:
    base = git(copy, "rev-parse", "HEAD")
    (copy / "submissions" / name).write_text("second\n")
    result = changed(copy, base)
    assert (result.returncode, result.stdout) == (1, "")
    assert f"'{name[:-3]}' looks like '{known}'" in result.stderr
    monkeypatch.setenv("SAME_OWNER", f"x {name[:-3]}")
    (copy / "submissions" / name).write_text("third\n")
    assert changed(copy, base).stdout.split() == [f"submissions/{name}"]


def with_card(copy: Path, name: str, author: str, recipe: str, seed: int = 1) -> None:
    (copy / "submissions" / f"{name}.py").write_text(f"# {name}\n")
    (copy / "submissions" / f"{name}.toml").write_text(CARD.format(author=author, seed=seed, recipe=recipe), "utf-8")


@pytest.mark.parametrize(
    ("author", "recipe", "refused"),
    [
        ("Anna A.", "anna-ppo", True),
        ("anna a", "Anna.PP0", True),
        ("\u0410nna A.", "anna-ppo", True),  # a Cyrillic letter
        ("Anna A.", "other", False),
        ("Eve", "anna-ppo", False),  # is not joined, because the authors differ
    ],
)
def test_nobody_adds_a_training_to_a_recipe_of_others(copy: Path, author: str, recipe: str, *, refused: bool) -> None:
    with_card(copy, "first", "Anna A.", "anna-ppo", 0)
    git(copy, "add", "-A")
    git(copy, "commit", "-qm", "Anna's")
    base = git(copy, "rev-parse", "HEAD")
    with_card(copy, "new", author, recipe)
    result = changed(copy, base)
    assert (result.returncode, "which submissions/first.py already has" in result.stderr) == (int(refused), refused)


def test_a_recipe_of_a_folder_of_settings_belongs_to_its_name(copy: Path) -> None:
    def folder(name: str) -> None:
        (copy / "submissions" / name).mkdir()
        (copy / "submissions" / name / "card.toml").write_text('title = "x"\n[training]\nrecipe = "ppo-1"\nseed = 1\n')

    folder("mine-seed0")
    git(copy, "add", "-A")
    git(copy, "commit", "-qm", "mine")
    base = git(copy, "rev-parse", "HEAD")
    folder("other-seed0")
    result = changed(copy, base)
    assert "'other-seed0' states the recipe 'ppo-1', which submissions/mine-seed0 already has" in result.stderr


def test_trainings_of_one_recipe_come_together(copy: Path) -> None:
    base = git(copy, "rev-parse", "HEAD")
    for seed in (0, 1):
        with_card(copy, f"mine_seed{seed}", "Anna A.", "mine", seed)
    assert changed(copy, base).stdout.split() == ["submissions/mine_seed0.py", "submissions/mine_seed1.py"]
    (copy / "submissions" / "mine_seed2.py").write_text("")
    result = changed(copy, base)
    assert (result.returncode, result.stdout) == (1, "")
    assert "'mine_seed0' and 'mine_seed2' look alike. Give them different names or, if they are trainings of one recipe" in result.stderr


@pytest.mark.parametrize("place", ["submissions/eve", "submissions/ben/weights.npz", "submissions"])
def test_links_are_refused_wherever_they_are(copy: Path, tmp_path_factory: pytest.TempPathFactory, place: str) -> None:
    base = git(copy, "rev-parse", "HEAD")
    if (copy / place).is_dir():
        shutil.rmtree(copy / place)
    (copy / place).symlink_to(tmp_path_factory.mktemp("outside"))
    result = changed(copy, base)
    assert result.returncode != 0
    assert result.stdout == ""
    assert f"Links and submodules are refused, because they name what is somewhere else: {place}." in result.stderr


def test_a_submodule_is_refused(copy: Path) -> None:
    base = git(copy, "rev-parse", "HEAD")
    git(copy, "update-index", "--add", "--cacheinfo", f"160000,{base},submissions/eve")
    git(copy, "commit", "-qm", "second")
    script = [str(ROOT / ".ci" / "changed-submissions"), base]
    result = subprocess.run(["bash", *script], cwd=copy, capture_output=True, text=True, check=False)
    assert (result.returncode, result.stdout) == (1, "")
    assert "Links and submodules are refused" in result.stderr


def test_a_deleted_part_changes_its_submission_and_a_deleted_submission_is_none(copy: Path) -> None:
    base = git(copy, "rev-parse", "HEAD")
    (copy / "submissions" / "anna.toml").unlink()
    shutil.rmtree(copy / "submissions" / "ben")
    result = changed(copy, base)
    assert (result.returncode, result.stdout.split()) == (0, ["submissions/anna.py"])


def submission(folder: Path, *saved: str, **settings: str) -> tuple[subprocess.CompletedProcess[str], list[str]]:
    """Run ``.ci/submission`` where an evaluation leaves the results ``saved``; and the commands of glbench that it ran."""
    (folder / "submissions").mkdir()
    (folder / "submissions" / "anna.py").write_text("")
    results = " ".join(f"reports/results/{name}" for name in saved)
    made = f"for file in {results}; do mkdir -p $(dirname $file); touch $file; done"
    stand_in(folder, "uv", 'echo "${@:4}" >> ran', f'[ "$4" != evaluate ] || {{ mkdir -p reports/results; {made}; }}')
    done = subprocess.run(
        ["bash", str(ROOT / ".ci" / "submission"), "submissions/anna.py"],
        cwd=folder,
        env={"PATH": f"{folder}:{os.environ['PATH']}", **settings},
        capture_output=True,
        text=True,
        check=False,
    )
    return done, (folder / "ran").read_text().splitlines()


def test_a_submission_without_a_result_of_its_name_is_no_success(tmp_path: Path) -> None:
    done, ran = submission(tmp_path, "Spring-v1/target.json")
    assert done.returncode == 1
    assert "There is no result of 'anna' in reports/results" in done.stderr
    assert not [line for line in ran if line.startswith(("verify", "leaderboard", "badge"))]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({}, f"badge anna --task {DEFAULT_TASK}"),
        ({"TASK": "tasks/own.toml"}, "badge anna --task tasks/own.toml"),
        ({"SUITE": "paper"}, "badge anna"),
    ],
    ids=["default", "file", "suite"],
)
def test_a_badge_is_drawn_whatever_names_the_task(tmp_path: Path, settings: dict[str, str], words: str) -> None:
    done, ran = submission(tmp_path, "Own-v1/anna.json", **settings)
    assert done.returncode == 0, done.stderr
    assert "verify reports/results/Own-v1/anna.json" in ran
    assert f"{words} --out reports --file reports/anna.badge.svg" in ran


@pytest.mark.parametrize(
    ("settings", "fresh"),
    [({}, True), ({"SUITE": "control"}, True), ({"SUITE": "paper"}, False), ({"TASK": "Schiphol2010-Delta10-v1"}, False)],
)
def test_every_submission_is_evaluated_with_fresh_draws_but_in_the_suite_paper(
    tmp_path: Path, settings: dict[str, str], fresh: bool
) -> None:
    _, ran = submission(tmp_path, "Own-v1/anna.json", **settings)
    (command,) = (line for line in ran if line.startswith("evaluate"))
    assert ("--fresh-draws" in command) == fresh


def test_only_the_suites_that_are_left_out_have_no_fresh_draws() -> None:
    for name, tasks in list_suites().items():
        sealed = {task for task in tasks if get_task(task).splits is not None}
        assert sealed == (set() if name in ("paper", "paper-code", "lettuce-classic") else set(tasks)), name


def ruff(*words: str, text: str) -> int:
    name = words[-1]
    command = [sys.executable, "-m", "ruff", *words[:-1], "--force-exclude", "--stdin-filename", name, "-"]
    return subprocess.run(command, cwd=ROOT, input=text, capture_output=True, text=True, check=False).returncode


@pytest.mark.parametrize("name", ["submissions/eve.py", "submissions/eve/deep/agent.py"])
def test_the_style_of_others_fails_no_check(name: str) -> None:
    text = "import os,sys\nclass  A:\n  pass\n"
    assert ruff("check", "baselines/eve.py", text=text) != 0
    assert ruff("format", "--check", "baselines/eve.py", text=text) != 0
    assert ruff("check", name, text=text) == 0
    assert ruff("format", "--check", name, text=text) == 0


def test_the_linters_still_look_at_every_example_and_template() -> None:
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    (ours,) = re.findall(r"^ours=\(.*\)$", script, re.MULTILINE)
    listed = subprocess.run(["bash", "-c", f'{ours}; printf "%s\n" "${{ours[@]}}"'], cwd=ROOT, capture_output=True, text=True, check=True)
    templates = {file.relative_to(ROOT).as_posix() for file in (ROOT / "submissions/templates").rglob("*.py")}
    assert set(listed.stdout.split()) == templates | {f"submissions/{name}.py" for name in EXAMPLES}
    lines = ['check . "${ours[@]}"', "format --check .", 'format --check --line-length 120 "${ours[@]}"']
    assert re.findall(r"ruff (.*?)(?:  #.*)?$", script, re.MULTILINE) == lines


def test_the_page_for_reports_in_private_names_no_address_and_links_to_what_is_there() -> None:
    page, maintain = (ROOT / name for name in ("SECURITY.md", "docs/maintain.md"))
    text = page.read_text(encoding="utf-8")
    assert "Use GitHub's private vulnerability reporting" in text
    assert not re.search(r"\S@\S|mailto|https?:", text)
    for file, _, anchor in (target.partition("#") for target in re.findall(r"\]\(([^)]+)\)", text)):
        headings = re.findall(r"^#+ (.*)$", (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE)
        assert not anchor or anchor in [heading.lower().replace(" ", "-") for heading in headings]
    assert "`SECURITY.md`" in maintain.read_text(encoding="utf-8")
