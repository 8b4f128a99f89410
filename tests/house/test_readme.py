"""The Python examples of README and docs/architecture.md run as they stand, and their commands exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from glbench.cli.app import main

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
ARCHITECTURE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", README + ARCHITECTURE, re.DOTALL)


def test_there_are_examples():
    assert len(EXAMPLES) >= 2


@pytest.mark.parametrize("source", EXAMPLES)
def test_an_example_runs_as_it_stands(source, capsys):
    namespace: dict[str, object] = {}
    exec(compile(source, "README.md", "exec"), namespace)
    for name in ("env", "envs"):
        if name in namespace:
            namespace[name].close()
    assert capsys.readouterr().out.strip()


@pytest.mark.parametrize(
    "command", ["tasks list", "tasks show", "tasks check", "tasks lock", "evaluate", "leaderboard", "weather list", "weather fetch"]
)
def test_a_command_of_the_readme_explains_itself(command, capsys):
    with pytest.raises(SystemExit) as left:
        main([*command.split(), "--help"])
    assert left.value.code == 0
    assert "Usage" in capsys.readouterr().out


def test_the_documents_name_the_test_command_that_continuous_integration_runs_with_pytorch():
    ci = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    contributing = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    workflow = (ROOT / ".github" / "workflows" / "tests.yml").read_text(encoding="utf-8")
    command = "uv run --group dev pytest -n auto --dist worksteal\n"
    assert command in README
    assert command.replace("dev", "all") in ci.replace("--locked ", "")
    assert command.strip() in contributing
    assert command.strip().replace("dev", "all") in contributing
    assert "run: bash .ci/run\n" in workflow
