"""``import glbench`` is light and makes the tasks known to Gymnasium, whichever of the two is imported first."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import gymnasium
import pytest

from glbench import registration
from glbench.tasks import PAPER_TASK, list_drafts, list_tasks, register_tasks

HEAVY = ("casadi", "pandas", "pydantic", "pvlib", "pyarrow", "scipy", "torch", "rich", "typer")


def run(program: str) -> str:
    """What ``program`` prints in a fresh process."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program], check=False, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_importing_glbench_loads_nothing_heavy() -> None:
    program = f"import sys, glbench; print([name for name in {HEAVY} if name in sys.modules])"
    assert run(program) == "[]"


@pytest.mark.parametrize("imports", ["import glbench, gymnasium", "import gymnasium, glbench"])
def test_both_orders_of_import_register_every_task_without_the_model(imports: str) -> None:
    program = (
        f"import sys; {imports}; "
        "print(sum(name.startswith('glbench/') for name in gymnasium.registry), 'casadi' in sys.modules)"
    )
    assert run(program) == f"{len(list_tasks()) + len(list_drafts())} False"


def test_a_spec_leads_to_the_environments_and_leaves_the_horizon_to_them() -> None:
    spec = gymnasium.spec(PAPER_TASK)
    assert spec.entry_point == "glbench.env:GreenhouseEnv"
    assert spec.vector_entry_point == "glbench.env:GreenhouseVectorEnv"
    assert spec.kwargs == {"task": PAPER_TASK}
    assert spec.max_episode_steps is None
    assert (spec.order_enforce, spec.disable_env_checker) == (True, False)


def test_registering_again_changes_nothing() -> None:
    before = dict(gymnasium.registry)
    register_tasks()
    assert dict(gymnasium.registry) == before


def test_a_file_that_is_being_edited_does_not_keep_the_package_from_loading(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "half.toml").write_text("id = ", encoding="utf-8")
    (tmp_path / "none.toml").write_text("days = 1", encoding="utf-8")
    (tmp_path / "good.toml").write_text('id = "glbench/Good-v1"', encoding="utf-8")
    monkeypatch.setattr(registration, "data_folder", lambda _name: tmp_path)
    assert registration.task_ids() == {"glbench/Good-v1": tmp_path / "good.toml"}
