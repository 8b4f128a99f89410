"""The checkers of Gymnasium and, where it is installed, of Stable-Baselines3."""

from __future__ import annotations

from typing import Any

import gymnasium
import pytest
from gymnasium.utils.env_checker import check_env

from glbench.env import GreenhouseEnv
from glbench.tasks import TaskSpec


def check_env_for_stable_baselines3(env: gymnasium.Env[Any, Any], *, warn: bool) -> None:
    """What ``check_env`` of Stable-Baselines3 does; without it the test ends here, skipped, with all before it tested."""
    from stable_baselines3.common.env_checker import check_env

    check_env(env, warn=warn)


def check_that_both_are_silent(task: TaskSpec, warnings: pytest.WarningsRecorder, split: str = "training") -> None:
    """Neither checker raises or warns for the environment of a task in a split."""
    name = "tests/environment-of-a-test"

    def make(**options: Any) -> GreenhouseEnv:
        return GreenhouseEnv(task, kernel="fast", split=split, **options)

    gymnasium.register(name, entry_point=make, disable_env_checker=True)
    try:
        check_env(gymnasium.make(name, render_mode="ansi").unwrapped)
        check_env_for_stable_baselines3(make(), warn=True)
    finally:
        gymnasium.registry.pop(name)
    assert [str(warning.message) for warning in warnings] == []
