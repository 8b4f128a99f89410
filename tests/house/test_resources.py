"""Where folders are, also for users who have none."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from glbench import resources
from glbench.agents import read_baseline
from glbench.agents.baselines import shipped_digest, shipped_sight
from glbench.errors import GlbenchError, SubmissionError
from glbench.resources import cache_folder, data_folder, data_package, left_out, user_data_folder


@pytest.mark.parametrize(
    ("folder", "variable", "base"), [(cache_folder, "GLBENCH_CACHE", "XDG_CACHE_HOME"), (user_data_folder, "GLBENCH_DATA", "XDG_DATA_HOME")]
)
def test_without_a_home_folder_it_says_what_to_set(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, folder: object, variable: str, base: str
) -> None:
    assert callable(folder)
    for name in (variable, base):
        monkeypatch.delenv(name, raising=False)

    def nowhere() -> Path:
        msg = "Could not determine home directory."
        raise RuntimeError(msg)

    monkeypatch.setattr(Path, "home", nowhere)
    with pytest.raises(GlbenchError, match=f"no home folder: set HOME, or {variable}"):
        folder()
    monkeypatch.setenv(variable, str(tmp_path))
    assert folder() == tmp_path


@pytest.fixture
def wheel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package as a wheel lays it out, with its own part of the data: ``ppo`` has its card and no weights."""
    ppo, data = data_folder("baselines") / "ppo", tmp_path / "glbench" / "_data"
    card = data / "baselines" / "ppo" / "card.toml"
    card.parent.mkdir(parents=True)
    card.write_bytes((ppo / "card.toml").read_bytes())
    (data / "tasks").mkdir()
    stated = {"version": "7.8.9", "sha256": "ab" * 32, "left_out": {"ppo": "cd" * 32}}
    (data / "data.json").write_text(json.dumps(stated), encoding="utf-8")
    monkeypatch.setattr(resources, "_PACKAGE", tmp_path / "glbench")
    return tmp_path


def install_data(site: Path, sha256: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Put a package ``glbench_data`` of that digest, with weights of ``ppo``, where Python finds it."""
    package = site / "elsewhere" / "glbench_data"
    (package / "baselines").mkdir(parents=True)
    (package / "baselines" / "ppo").symlink_to(Path(__file__).resolve().parents[2] / "baselines" / "ppo")
    (package / "__init__.py").touch()
    (package / "manifest.json").write_text(json.dumps({"version": "7.8.9", "sha256": sha256}), encoding="utf-8")
    monkeypatch.syspath_prepend(str(package.parent))
    return package


def test_a_checkout_lacks_nothing() -> None:
    assert data_package() is None
    assert left_out() == {}


def test_a_wheel_alone_has_its_own_part_and_says_what_to_install(wheel: Path) -> None:
    assert data_folder("baselines") == wheel / "glbench" / "_data" / "baselines"
    assert set(left_out()) == {"ppo"}
    with pytest.raises(SubmissionError, match=r"'ppo'.*not part of this installation.*pip install glbench-data==7\.8\.9"):
        read_baseline("ppo")


def test_what_leaderboards_ask_of_a_baseline_needs_no_weights(wheel: Path) -> None:
    assert shipped_digest("ppo") == "cd" * 32
    assert shipped_sight("ppo") == "observations"


def test_the_data_package_of_this_wheel_is_found_wherever_it_is(wheel: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = install_data(wheel, "ab" * 32, monkeypatch)
    assert data_folder("baselines") == package / "baselines"
    assert data_folder("tasks") == wheel / "glbench" / "_data" / "tasks"
    assert left_out() == {}
    assert shipped_digest("ppo") == read_baseline("ppo").digest


@pytest.mark.parametrize("damage", ["another version", "no manifest", "no json"])
def test_a_data_package_that_is_another_is_not_taken(wheel: Path, monkeypatch: pytest.MonkeyPatch, damage: str) -> None:
    package = install_data(wheel, "ef" * 32 if damage == "another version" else "ab" * 32, monkeypatch)
    if damage == "no manifest":
        (package / "manifest.json").unlink()
    if damage == "no json":
        (package / "manifest.json").write_text("{", encoding="utf-8")
    assert data_folder("baselines") == wheel / "glbench" / "_data" / "baselines"
    assert "glbench_data" not in sys.modules
    with pytest.raises(SubmissionError, match="pip install glbench-data"):
        read_baseline("ppo")
