"""The checker of Stable-Baselines3, where that is installed."""

from __future__ import annotations

from typing import Any

import gymnasium


def check_env_for_stable_baselines3(env: gymnasium.Env[Any, Any], *, warn: bool) -> None:
    """What ``check_env`` of Stable-Baselines3 does; without it the test ends here, skipped, with all before it tested."""
    from stable_baselines3.common.env_checker import check_env

    check_env(env, warn=warn)
