"""Fixtures of the leaderboard's tests."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from glbench.evaluation.files import save_result
from glbench.evaluation.records import Result
from glbench.leaderboard import StoredResult
from tests.leaderboard.synthetic import make_result


@pytest.fixture
def store(tmp_path: Path) -> Callable[..., StoredResult]:
    """Function that saves a made-up result below ``tmp_path/<folder>`` and returns it with its path."""

    def save(agent: str, rewards: list[float], folder: str = "reports", **keywords: object) -> StoredResult:
        result: Result = make_result(agent, rewards, **keywords)  # type: ignore[arg-type]
        return StoredResult(save_result(result, tmp_path / folder), result)

    return save
