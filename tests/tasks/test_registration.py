"""``import glbench`` is light and makes the tasks known to Gymnasium, whichever of the two is imported first."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.envs.registration import find_highest_version
from gymnasium.utils.env_checker import check_env

from glbench import registration
from glbench.tasks import PAPER_TASK, list_drafts, list_tasks, register_tasks

HEAVY = ("casadi", "pandas", "pydantic", "pvlib", "pyarrow", "scipy", "torch", "rich", "typer")


def run(program: str) -> str:
    """What ``program`` prints in a fresh process."""
    done = subprocess.run([sys.executable, "-W", "error", "-c", program], check=False, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_importing_glbench_loads_nothing_heavy() -> None:
    program = f"import sys, glbench; print([name for name in {HEAVY} if name in sys.modules])"
    assert run(program) == "[]"


@pytest.mark.parametrize("imports", ["import glbench, gymnasium", "import gymnasium, glbench"])
def test_both_orders_of_import_register_every_task_without_the_model(imports: str) -> None:
    program = f"import sys; {imports}; print(sum(name.startswith('glbench/') for name in gymnasium.registry), 'casadi' in sys.modules)"
    published = {one.id.rpartition("-v")[0] for one in list_tasks()}
    drafts = [one for one in list_drafts() if one.id.rpartition("-v")[0] not in published]
    assert run(program) == f"{len(list_tasks()) + len(drafts)} False"


def test_a_draft_does_not_make_a_published_task_out_of_date() -> None:
    newest: dict[str, int] = {}
    for task in list_tasks():
        name, _, version = task.id.removeprefix("glbench/").rpartition("-v")
        newest[name] = max(newest.get(name, 0), int(version))
    assert {name: find_highest_version("glbench", name) for name in newest} == newest


def test_a_spec_leads_to_the_environments_and_leaves_the_horizon_to_them() -> None:
    spec = gymnasium.spec(PAPER_TASK)
    assert spec.entry_point == "glbench.env:GreenhouseEnv"
    assert spec.vector_entry_point == "glbench.env:GreenhouseVectorEnv"
    assert spec.kwargs == {"task": PAPER_TASK}
    assert spec.max_episode_steps is None
    assert (spec.order_enforce, spec.disable_env_checker) == (True, False)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(name for name in gymnasium.registry if name.startswith("glbench/")))
def test_every_id_makes_an_environment_that_says_how_long_it_is(name: str) -> None:
    """Warnings are errors here, those of Gymnasium's checkers too."""
    made = gymnasium.make(name, kernel="fast")
    steps = made.unwrapped.task.steps  # type: ignore[attr-defined]
    check_env(made.unwrapped)
    timed = wrappers.RecordEpisodeStatistics(wrappers.TimeAwareObservation(made, normalize_time=True))
    timed.reset(seed=1)
    for k in range(1, 4):
        observation, *_ = timed.step(np.zeros(made.action_space.shape or (), np.float32))
        assert observation[-1] == np.float32(k / steps)
    rows = gymnasium.make_vec(name, num_envs=2, kernel="fast")
    for spec in (made.spec, timed.spec, rows.spec):
        assert spec is not None
        assert spec.max_episode_steps == steps


def test_the_horizon_is_that_of_the_season_and_ends_it_once() -> None:
    day = {"weather.days": 1}
    made = gymnasium.make("glbench/Lettuce-v1", overrides=day, kernel="fast")
    again = gymnasium.make("glbench/Lettuce-v1", overrides={"weather.days": 61}, kernel="fast")
    rows = gymnasium.make_vec("glbench/Lettuce-v1", num_envs=1, overrides=day, kernel="fast")
    assert [one.spec.max_episode_steps for one in (made, again, rows) if one.spec] == [96, 61 * 96, 96]
    made.reset(seed=1)
    ends = [made.step(np.zeros(made.action_space.shape or (), np.float32))[2:4] for _ in range(96)]
    assert ends == [(False, False)] * 95 + [(True, False)]
    assert copy.deepcopy(made).spec == made.spec == pickle.loads(pickle.dumps(made)).spec


def test_registering_again_changes_nothing() -> None:
    before = dict(gymnasium.registry)
    register_tasks()
    assert dict(gymnasium.registry) == before


def test_a_file_that_is_being_edited_does_not_keep_the_package_from_loading(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "half.toml").write_text("id = ", encoding="utf-8")
    (tmp_path / "none.toml").write_text("days = 1", encoding="utf-8")
    (tmp_path / "good.toml").write_text('id = "glbench/Good-v1"', encoding="utf-8")
    monkeypatch.setattr(registration, "data_folder", lambda _name: tmp_path)
    assert registration.task_ids() == {"glbench/Good-v1": tmp_path / "good.toml"}
