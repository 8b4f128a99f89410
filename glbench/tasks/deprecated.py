"""Published tasks that nobody should begin with any more: ``tasks/deprecated.toml`` says why, and what to use.

A deprecated task stays as it is, digest included: it runs, its results load and can be reproduced. A warning says so, once a process.
"""

from __future__ import annotations

import logging
import tomllib
from collections.abc import Mapping

from pydantic import BaseModel, ConfigDict, Field

from glbench.errors import TaskError
from glbench.registration import DEPRECATED_NAME
from glbench.tasks.lock import lock_path

logger = logging.getLogger(__name__)


class Deprecation(BaseModel):
    """Why a published task should not be used for new work."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    since: str
    """Version of glbench, such as "0.2.0"."""
    reason: str = Field(min_length=10)
    """One sentence without a full stop at its end, such as "its forecast shows the weather of the next day exactly"."""
    use: str | None = None
    """Id of the task to use instead; ``None`` where there is none."""

    def in_words(self, task_id: str) -> str:
        """The sentence that users read."""
        instead = f" Use {self.use}." if self.use is not None else ""
        return f"{task_id} is deprecated since glbench {self.since}: {self.reason}.{instead}"


def read_deprecated() -> Mapping[str, Deprecation]:
    """Deprecated tasks by id.

    Raises
    ------
    TaskError
        When the file cannot be used.
    """
    path = lock_path().with_name(DEPRECATED_NAME)
    if not path.is_file():
        return {}
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
        return {task_id: Deprecation.model_validate(entry) for task_id, entry in data.items()}
    except (OSError, ValueError, RecursionError) as error:
        msg = f"{path} cannot be used: {error}. Restore the file; docs/maintain.md describes its entries."
        raise TaskError(msg) from error


def tell_if_deprecated(task_id: str) -> None:
    """Log a warning when ``task_id`` is deprecated.

    Raises
    ------
    TaskError
        When the list of deprecated tasks cannot be used.
    """
    found = read_deprecated().get(task_id)
    if found is not None:
        logger.warning("%s", found.in_words(task_id))
