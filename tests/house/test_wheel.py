"""The built wheel is small and whole: the main job runs from it, outside the checkout, with the data that it carries.

The other wheel, glbench-data, holds all baselines and results, and the two belong together.
"""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from glbench.agents import read_baseline
from glbench.evaluation.sandbox import visible
from glbench.evaluation.sandbox.bubblewrap import why_no_sandbox
from glbench.tasks import list_tasks
from tests.evaluation.sandbox.needles import shipped_needles
from tests.evaluation.sandbox.walking import sight_of, write_walker
from tests.support import write_day_task

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
LARGEST = 8_500_000
"""Size of a wheel that anybody installs at once [bytes]."""


def build(project: Path, folder: Path) -> Path:
    """The wheel of the project in that folder of the checkout."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=project, check=True, capture_output=True, timeout=900)
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Wheel built from the checkout."""
    return build(ROOT, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def data_wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel with all baselines and results."""
    return build(ROOT / "glbench-data", tmp_path_factory.mktemp("data"))


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
        [sys.executable, "-m", "glbench", *arguments], cwd=cwd, env=environment, capture_output=True, text=True, timeout=300, check=False
    )


def test_the_wheel_carries_tasks_weather_baselines_examples_and_released_results(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    for start in (
        "tasks/lock.toml",
        "weather/manifest.toml",
        "baselines/rule_based/",
        "submissions/my_agent.py",
        "reports/released/results/",
    ):
        assert any(name.startswith(f"glbench/_data/{start}") for name in names), start
    assert "glbench/py.typed" in names
    assert "glbench/report/assets/page.html.j2" in names
    assert not [name for name in names if name.endswith(".pyc") or "/tests/" in name]


def test_the_wheel_is_small(wheel):
    assert wheel.stat().st_size < LARGEST


def test_the_data_wheel_holds_all_baselines_and_results_and_is_the_one_that_the_wheel_names(wheel, data_wheel):
    assert data_wheel.name.endswith("-py3-none-any.whl")
    with zipfile.ZipFile(wheel) as own, zipfile.ZipFile(data_wheel) as data:
        stated = json.loads(own.read("glbench/_data/data.json"))
        assert json.loads(data.read("glbench_data/manifest.json"))["sha256"] == stated["sha256"]
        for name in ("baselines", "reports/released/results", "images"):
            folder = ROOT / "glbench-data" / name if name == "images" else ROOT / name
            files = {
                f"{name}/{file.relative_to(folder).as_posix()}"
                for file in folder.rglob("*")
                if file.is_file() and file.suffix not in {".pyc", ".mcap"}
            }
            packed = {file.removeprefix("glbench_data/") for file in data.namelist()}
            assert files == {file for file in packed if file.startswith(f"{name}/")}
        for file in ("baselines/ppo/weights/delta10.npz", "reports/released/results/Spring-v1/mpc.profile.json.gz"):
            assert data.read(f"glbench_data/{file}") == (ROOT / file).read_bytes()
            assert f"glbench/_data/{file}" not in own.namelist()
        elsewhere = ("results/Transfer-", "results/Schiphol2010Code-", "_data/images/")
        assert not [name for name in own.namelist() if any(part in name for part in elsewhere)]
    versions = [
        tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
        for project in (ROOT, ROOT / "glbench-data")
    ]
    assert versions == [stated["version"]] * 2
    assert stated["left_out"] == {name: read_baseline(name).digest for name in stated["left_out"]}
    assert {"best_known", "ppo", "sac"} <= set(stated["left_out"])


BUDGETS = """
from glbench.leaderboard import collect_results
from glbench.leaderboard.training_data import budget_of
from glbench.leaderboard.regret import can_be_best_known
from glbench.resources import data_folder
for item in collect_results([data_folder("reports/released/results") / "Schiphol2010-Delta10-v1"]):
    print(item.result.agent.name, item.result.results_digest, budget_of(item.result), can_be_best_known(item.result.agent))
"""


def test_a_leaderboard_says_the_same_of_released_agents_whose_weights_are_not_installed(installed, tmp_path):
    said = {}
    for place in (installed, ROOT):
        environment = {**os.environ, "PYTHONPATH": str(place)}
        command = [sys.executable, "-c", BUDGETS]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True, timeout=300)
        said[place] = done.stdout
    assert said[installed] == said[ROOT]
    assert "ppo_tuned" in said[ROOT]


def test_an_agent_with_large_weights_acts_once_the_data_are_installed(installed, data_wheel, tmp_path):
    job = ("evaluate", "ppo", "--task", "Schiphol2010-Delta10-v1", "--runs", "1", "--seed", "10000000000")
    refused = run_installed(installed, tmp_path, *job)
    assert refused.returncode == 1
    assert "pip install glbench-data==" in " ".join(refused.stderr.split())
    site = Path(shutil.copytree(installed, tmp_path / "site"))
    with zipfile.ZipFile(data_wheel) as archive:
        archive.extractall(site)
    done = run_installed(site, tmp_path, *job)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_leaderboard_of_results_that_are_not_installed_says_where_they_are(installed, tmp_path):
    for selection, words in (
        (("--task", "Transfer-Miami-v1"), "There are no results of a task"),
        (("--suite", "transfer"), "No task of the suite"),
        (("--suite", "paper-code"), "No task of the suite"),
        (("--suite", "lettuce-classic"), "No task of the suite"),
    ):
        done = run_installed(installed, tmp_path, "leaderboard", *selection)
        said = " ".join(done.stderr.split())
        assert words in said
        assert "pip install glbench-data==" in said


@pytest.mark.usefixtures("carried")
def test_the_wheel_carries_the_kernels_of_all_published_tasks_and_no_other(wheel):
    carried = {
        re.sub(r"(-(author|gl_gym2))-.*", r"\1", Path(name).name)
        for name in zipfile.ZipFile(wheel).namelist()
        if name.startswith("glbench/_data/kernel/") and name.endswith(".so")
    }
    assert carried == {f"{task.model_value.id}-{task.model_value.variant}" for task in list_tasks()}


STEP = """
import hashlib, numpy as np
from glbench.model import TOMATO
from glbench.kernel import Kernel
from glbench.tasks import get_task
task = get_task("glbench/Schiphol2010-Delta00-v1")
kernel = Kernel(TOMATO, 900.0)
x = task.initial_state()
for d in task.disturbances().values[:96]:
    x = kernel.step(x, np.full(6, 0.3), d, task.parameters())
print(kernel.backend, hashlib.sha256(x.tobytes()).hexdigest(), kernel.describe().get("compiler_flags", ""))
"""


def step_a_day(site: Path, cwd: Path, **environment: str) -> tuple[str, str, str]:
    """Backend, digest of the states after a day, and compiler flags, with the package in ``site`` and an empty cache."""
    variables = {**os.environ, "PYTHONPATH": str(site), "GLBENCH_CACHE": str(cwd / "cache"), **environment}
    command = [sys.executable, "-c", STEP]
    done = subprocess.run(command, cwd=cwd, env=variables, capture_output=True, text=True, check=True, timeout=300)
    backend, digest, flags = done.stdout.rstrip("\n").split(" ", 2)
    return backend, digest, flags


@pytest.fixture
def carried(wheel: Path) -> None:
    """Skip where the wheel could not carry a compiled kernel."""
    if not any(name.endswith(".so") for name in zipfile.ZipFile(wheel).namelist()):
        pytest.skip("the wheel carries no compiled kernel: no C++ compiler here, or not Linux")


@pytest.mark.usefixtures("carried")
def test_without_a_compiler_the_kernel_of_the_wheel_is_used_and_has_the_bits_of_one_compiled_here(installed, tmp_path):
    no_compiler = {"PATH": str(tmp_path), "CXX": "", "CC": ""}
    backend, digest, flags = step_a_day(installed, tmp_path, **no_compiler)
    assert backend == "compiled"
    assert "-march=native" not in flags
    assert not (tmp_path / "cache").exists()
    assert step_a_day(ROOT, tmp_path)[:2] == ("compiled", digest)


@pytest.mark.usefixtures("carried")
def test_a_damaged_kernel_of_the_wheel_is_not_loaded(installed, tmp_path):
    site = tmp_path / "site"
    shutil.copytree(installed, site)
    for library in (site / "glbench/_data/kernel").glob("*.so"):
        library.write_bytes(library.read_bytes()[:-1] + b"?")
    no_compiler = {"PATH": str(tmp_path), "CXX": "", "CC": ""}
    assert step_a_day(site, tmp_path, **no_compiler)[0] == "casadi"


@pytest.mark.usefixtures("carried")
def test_a_wheel_with_a_compiled_kernel_says_for_which_machines_it_is(wheel):
    assert wheel.name.endswith(f"-py3-none-linux_{platform.machine()}.whl")


def test_a_wheel_built_without_a_compiler_is_for_every_machine(tmp_path):
    environment = {**os.environ, "PATH": str(tmp_path), "CXX": "", "CC": ""}
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path / "out")]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True, timeout=300)
    (path,) = (tmp_path / "out").glob("*.whl")
    assert path.name.endswith("-py3-none-any.whl")
    assert "no compiled kernel" in done.stdout + done.stderr


def test_the_package_in_use_is_the_wheels(installed, tmp_path):
    code = "import glbench; print(glbench.__file__)"
    environment = {**os.environ, "PYTHONPATH": str(installed)}
    shown = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True, timeout=300
    )
    assert Path(shown.stdout.strip()).is_relative_to(installed)


def test_the_published_tasks_hold_in_the_installed_package(installed, tmp_path):
    done = run_installed(installed, tmp_path, "tasks", "check")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "is missing: lettuceharvestimages-v1" in " ".join(done.stderr.split())


def test_a_newcomers_agent_is_evaluated_and_ranked_from_the_installed_package(installed, tmp_path):
    installed = Path(shutil.copytree(installed, tmp_path / "site"))
    for released in (installed / "glbench/_data/reports/released/results").iterdir():
        if not released.name.endswith("Delta10-v1"):  # to rank all takes long, and they are the checkout's
            shutil.rmtree(released)
    (tmp_path / "my_agent.py").write_bytes((ROOT / "submissions" / "my_agent.py").read_bytes())
    short = (ROOT / "tasks" / "schiphol2010-delta10-v1.toml").read_text()
    short = short.replace('id = "glbench/Schiphol2010-Delta10-v1"', 'id = "mine/OneDay-v1"').replace("days = 60", "days = 1")
    (tmp_path / "one-day.toml").write_text(short)
    done = run_installed(installed, tmp_path, "evaluate", "my_agent.py", "rule_based", "--task", "one-day.toml", "--runs", "2")
    assert done.returncode == 0, done.stdout + done.stderr
    ranked = run_installed(installed, tmp_path, "leaderboard", "--task", "mine/OneDay-v1", "--json", "--write")
    assert ranked.returncode == 0, ranked.stdout + ranked.stderr
    rows = json.loads(ranked.stdout)
    assert {row["agent"] for row in rows} == {"my_agent", "rule_based"}
    assert (tmp_path / "reports" / "leaderboard.md").is_file()


def test_a_sandboxed_agent_finds_no_data_in_the_installed_packages(wheel, data_wheel, tmp_path):
    """Both wheels in a folder of packages, as pip leaves them; the walker opens every file of glbench, glbench-data and pvlib."""
    reason = why_no_sandbox()
    if reason is not None:
        pytest.skip(reason)
    site = tmp_path / "lib" / "python3" / "site-packages"
    for file in (wheel, data_wheel):
        with zipfile.ZipFile(file) as archive:
            archive.extractall(site)
    shown = [str(bound.outside) for bound in visible._visible_files(set()) if bound.outside not in visible.libraries()]
    packages = [file for library in visible.libraries() for file in library.iterdir() if not file.name.startswith(("pvlib", "glbench"))]
    walker = write_walker(tmp_path, shipped_needles(), [*shown, *packages])
    job = ("evaluate", str(walker), "--task", str(write_day_task(tmp_path)), "--runs", "1", "--sandbox", "bubblewrap", "--show-prints")
    done = run_installed(site, tmp_path, *job)
    assert done.returncode == 0, done.stdout + done.stderr
    found, looked = sight_of(done.stdout + done.stderr)
    assert found == []
    assert looked["searched"] > 400
