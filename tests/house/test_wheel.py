"""The built wheel is whole: the main job runs from it, outside the checkout, with the data that it carries."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Wheel built from the checkout."""
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)],
        cwd=ROOT,
        check=True,
        capture_output=True,
        timeout=120,
    )
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the wheel's files, as an installer lays them out."""
    folder = tmp_path_factory.mktemp("site")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
    return folder


def run_installed(installed: Path, cwd: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """``python -m glbench ...`` with the wheel's package before the checkout's, in the folder ``cwd``."""
    environment = {**os.environ, "PYTHONPATH": str(installed), "XDG_DATA_HOME": str(cwd / "data")}
    return subprocess.run(
        [sys.executable, "-m", "glbench", *arguments],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def test_the_wheel_carries_tasks_weather_baselines_examples_and_released_results(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    for start in (
        "tasks/lock.toml",
        "weather/manifest.toml",
        "baselines/rule_based/",
        "submissions/my_agent.py",
        "reports/results/",
    ):
        assert any(name.startswith(f"glbench/_data/{start}") for name in names), start
    assert "glbench/py.typed" in names
    assert not [name for name in names if name.endswith(".pyc") or "/tests/" in name]


def test_the_package_in_use_is_the_wheels(installed, tmp_path):
    code = "import glbench; print(glbench.__file__)"
    environment = {**os.environ, "PYTHONPATH": str(installed)}
    shown = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    assert Path(shown.stdout.strip()).is_relative_to(installed)


def test_the_published_tasks_hold_in_the_installed_package(installed, tmp_path):
    done = run_installed(installed, tmp_path, "tasks", "check")
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_newcomers_agent_is_evaluated_and_ranked_from_the_installed_package(installed, tmp_path):
    (tmp_path / "my_agent.py").write_bytes((ROOT / "submissions" / "my_agent.py").read_bytes())
    short = (ROOT / "tasks" / "schiphol2010-delta10-v1.toml").read_text()
    short = short.replace('id = "glbench/Schiphol2010-Delta10-v1"', 'id = "mine/OneDay-v1"').replace(
        "days = 60", "days = 1"
    )
    (tmp_path / "one-day.toml").write_text(short)
    done = run_installed(
        installed, tmp_path, "evaluate", "my_agent.py", "rule_based", "--task", "one-day.toml", "--runs", "2"
    )
    assert done.returncode == 0, done.stdout + done.stderr
    ranked = run_installed(installed, tmp_path, "leaderboard", "--task", "mine/OneDay-v1", "--json", "--write")
    assert ranked.returncode == 0, ranked.stdout + ranked.stderr
    rows = json.loads(ranked.stdout)
    assert {row["agent"] for row in rows} == {"my_agent", "rule_based"}
    assert (tmp_path / "reports" / "leaderboard.md").is_file()
