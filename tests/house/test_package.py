"""Habits of the package that no single room can promise."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import glbench
from tests.docs.quoted import text_of

ROOT = Path(__file__).resolve().parents[2]


def test_importing_the_package_loads_nothing_heavy():
    code = "import sys, glbench; print(*sorted({m.split('.')[0] for m in sys.modules}))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=300).stdout.split()
    assert not {"casadi", "pandas", "pyarrow", "torch", "pvlib", "scipy", "typer", "rich"} & set(loaded)


def test_the_version_is_that_of_the_project_file_and_the_citation():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert glbench.__version__ == project
    assert re.search(rf"^version: {re.escape(project)}$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert f"## {project}" in (ROOT / "CHANGELOG.md").read_text()


def test_the_architecture_page_has_every_room_and_the_order_of_imports():
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rooms = {init.parent.name for init in (ROOT / "glbench").glob("*/__init__.py")}
    table = page.split("## Rooms")[1].split("## Commands")[0]
    assert set(re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)) == rooms
    contract = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"][0]
    order = re.findall(r"^    (cli > .*(?:\n +> .*)*)", table, re.MULTILINE)
    assert " ".join(order[0].split()) == " > ".join(contract["layers"]).replace("glbench.", "")


@pytest.mark.parametrize(
    "document",
    sorted(p.relative_to(ROOT).as_posix() for p in [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("docs/**/*.ipynb")]),
)
def test_links_between_documents_lead_somewhere(document):
    text = text_of(ROOT / document)
    for target in re.findall(r"\]\((?!https?:|mailto:|#)([^)#\s]+)", text):
        assert ((ROOT / document).parent / target).exists(), f"{document} points to {target}"
