"""Where folders are, also for users who have none."""

from __future__ import annotations

from pathlib import Path

import pytest

from glbench.errors import GlbenchError
from glbench.resources import cache_folder, user_data_folder


@pytest.mark.parametrize(
    ("folder", "variable", "base"),
    [(cache_folder, "GLBENCH_CACHE", "XDG_CACHE_HOME"), (user_data_folder, "GLBENCH_DATA", "XDG_DATA_HOME")],
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
