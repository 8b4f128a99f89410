"""Nobody waits for what a command does not need, nor for a computation that ends in "this is not installed"."""

from __future__ import annotations

import subprocess
import sys

import pytest

LARGE = ("scipy", "pandas", "pyarrow", "torch", "plotly", "jinja2", "matplotlib", "pvlib", "rerun", "jax")
_COMPUTING = (
    "glbench.kernel.make_kernel",
    "glbench.leaderboard.collect.own_and_released_results",
    "glbench.tasks.spec.TaskSpec.disturbances",
)
_PROGRAM = """
import sys
from glbench.cli.app import app
app(sys.argv[1].split(), standalone_mode=False)
print(*sorted({name for name in sys.modules}), file=sys.stderr)
"""

_WITHOUT = """
import sys
from pkgutil import resolve_name

sys.modules[sys.argv[1]] = None

def compute(*_, **__):
    raise SystemExit("something was computed")

for place in sys.argv[3:]:
    owner, _, name = place.rpartition(".")
    setattr(resolve_name(owner), name, compute)

from glbench_command import main

sys.argv = ["glbench", *sys.argv[2].split()]
main()
"""


def loaded_by(command: str) -> set[str]:
    """Modules that a command has loaded when it ends."""
    done = subprocess.run([sys.executable, "-c", _PROGRAM, command], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return set(done.stderr.splitlines()[-1].split())


def test_a_list_of_tasks_loads_no_large_package():
    assert not loaded_by("tasks list") & {*LARGE, "glbench.env", "glbench.leaderboard.statistics"}


def test_a_leaderboard_loads_neither_weather_nor_what_draws():
    assert not loaded_by("leaderboard") & ({*LARGE, "scipy.stats"} - {"scipy", "pyarrow"})


@pytest.mark.parametrize(
    ("command", "extra", "module"),
    [
        ("report", "report", "jinja2"),
        ("report --complete", "report", "plotly"),
        ("story RESULT.json --page page.html", "report", "jinja2"),
        ("evaluate rule_based_fair --live", "view", "rerun"),
        ("evaluate rule_based_fair --engine ray", "ray", "ray"),
        ("view RESULT.mcap", "view", "rerun"),
        ("train ppo --wandb", "wandb", "wandb"),
        ("train ppo --seeds 0-1 --engine ray", "ray", "ray"),
        ("train sac", "train", "torch"),
        ("sweep --config CONFIG.yml", "train", "optuna"),
        ("sweep --config CONFIG.yml --wandb", "wandb", "wandb"),
        ("sweep --config CONFIG.yml --engine ray", "ray", "ray"),
        ("export POLICY.zip", "train", "torch"),
        ("export fmu Spring-v1 -o spring.fmu", "fmu", "pythonfmu"),
        ("weather generate --out season.parquet --picture season.png", "video", "matplotlib"),
        ("serve", "serve", "fastapi"),
        ("serve Spring-v1 --port 0", "serve", "uvicorn"),
        ("episodes export rule_based_fair --minari a/b-v0", "minari", "minari"),
    ],
)
def test_what_is_not_installed_is_said_before_anything_is_computed(command, extra, module, tmp_path):
    for file in ("RESULT.json", "RESULT.mcap", "CONFIG.yml", "POLICY.zip"):
        (tmp_path / file).write_text("")
    before = sorted(tmp_path.iterdir())
    done = subprocess.run(
        [sys.executable, "-c", _WITHOUT, module, command, *_COMPUTING],
        capture_output=True, text=True, timeout=300, cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert f"glbench[{extra}]" in done.stderr
    assert "something was computed" not in done.stderr
    assert sorted(tmp_path.iterdir()) == before
