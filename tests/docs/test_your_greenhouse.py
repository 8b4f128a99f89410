"""The page about your own greenhouse shows what its commands print."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from glbench.cli import greenhouse, tasks
from glbench.cli.console import messages, output

PAGE = Path(__file__).parents[2] / "docs" / "your-greenhouse.md"
ODD = 'base = "glbench/Spring-v1"\nid = "my/Odd-v1"\ntitle = "A boiler"\n[model.overrides]\npBoil = {value = 2e6, unit = "W"}\n'


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    for console in (output, messages):
        console.cache_clear()
    return tmp_path


def block(name: str) -> str:
    return PAGE.read_text(encoding="utf-8").split(f"<!-- {name} -->\n```console\n")[1].split("\n```\n<!-- end -->")[0]


def printed(app: object, *arguments: str) -> str:
    result = CliRunner().invoke(app, list(arguments))  # type: ignore[arg-type]
    assert result.exit_code == 0, result.output
    return "\n".join(line.rstrip() for line in result.stdout.splitlines()).strip("\n")


def test_the_check_of_the_example_is_what_the_command_prints(folder: Path) -> None:
    text = PAGE.read_text(encoding="utf-8")
    (folder / "greenhouse.toml").write_text(re.findall(r"```toml\n(.*?)```", text, re.DOTALL)[0], encoding="utf-8")
    assert block("check") == f"$ glbench greenhouse check greenhouse.toml\n{printed(greenhouse.app, 'check', 'greenhouse.toml')}"


def test_the_doubt_is_what_the_command_prints(folder: Path) -> None:
    (folder / "odd.toml").write_text(ODD, encoding="utf-8")
    lines = printed(tasks.app, "check", "odd.toml").splitlines()
    doubt = lines[: next(at for at, line in enumerate(lines) if "Weather of the first" in line)]
    assert block("doubt") == "\n".join(["$ glbench tasks check odd.toml", *doubt])
