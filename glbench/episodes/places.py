"""Where records lie, beside the result that they belong to."""

from __future__ import annotations

from pathlib import Path

ACTIONS_SUFFIX = ".actions.mcap"


def actions_path(result: Path) -> Path:
    """``<agent>.actions.mcap`` beside ``<agent>.json``."""
    return result.with_name(result.name.removesuffix(".json") + ACTIONS_SUFFIX)


def episodes_folder(result: Path) -> Path:
    """Folder of the full episodes of a result.

    ``<out>/episodes/<task>/<agent>`` for a result ``<out>/results/<task>/<agent>.json``; for a result elsewhere a folder beside it.
    """
    name = result.name.removesuffix(".json")
    if result.parent.parent.name == "results":
        return result.parent.parent.parent / "episodes" / result.parent.name / name
    return result.with_name(f"{name}.episodes")


def episode_path(folder: Path, seed: int) -> Path:
    """``<folder>/seed-<seed>.mcap``."""
    return folder / f"seed-{seed}.mcap"
