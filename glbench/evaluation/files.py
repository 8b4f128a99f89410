"""Files of an evaluation: where results are stored, writing them whole or not at all, reading them as hostile."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from pydantic import ValidationError

from glbench.errors import GlbenchError, ResultError, refuse
from glbench.evaluation.records import SCHEMA_NAME, SCHEMA_VERSION, Result
from glbench.resources import write_atomically
from glbench.settings import first_problems
from glbench.untrusted import MIB, parse_json, quoted, read_regular, reason_of

_MOST_PROBLEMS = 3
LARGEST_RESULT = 32 * MIB  # A run takes less than 1.5 kB, and a task has at most 10,000


class SavingError(GlbenchError):
    """An evaluation was finished, and not everything of it could be written. ``result`` is what came out."""

    def __init__(self, message: str, result: Result) -> None:
        super().__init__(message)
        self.result = result


def short_task_id(task_id: str) -> str:
    """Name of a task's folder: its id without the namespace, ``Schiphol2010-Delta10-v1``."""
    return task_id.rpartition("/")[2]


def result_path(out: Path, task_id: str, agent_name: str) -> Path:
    """``<out>/results/<task>/<agent>.json``."""
    return out / "results" / short_task_id(task_id) / f"{agent_name}.json"


def save_result(result: Result, out: Path) -> Path:
    """Write ``result`` atomically to its place below ``out``; its path. Raises ``GlbenchError`` when the folder cannot be written."""
    path = result_path(out, result.task.id, result.agent.name)
    write_atomically(path, result.to_json())
    return path


def load_result(path: Path | str) -> Result:
    """Read a result file and check that it is whole and consistent.

    Raises ``ResultError`` when the file is missing, is no JSON, has another schema, lacks runs, or does not match its own digest.
    """
    return load_with_bytes(path)[0]


def load_with_bytes(path: Path | str) -> tuple[Result, bytes]:
    """As ``load_result``, with the bytes of the file that the result was read from."""
    if not isinstance(path, Path | str):
        refuse(f"A result is read from its file (a path); got {path!r}.", ResultError)
    path = Path(path)
    try:
        content = read_regular(path, LARGEST_RESULT)
        text = content.decode()
    except FileNotFoundError as error:
        refuse(f"There is no result file {path}. Make one with `glbench evaluate`.", ResultError, error)
    except (OSError, UnicodeDecodeError) as error:
        refuse(f"Cannot read the result file {path}: {reason_of(error)}.", ResultError, error)
    _check_schema(path, text)
    try:
        return Result.model_validate_json(text), content
    except ValidationError as error:
        msg = f"{path} is no valid result: {first_problems(error, _MOST_PROBLEMS)}. Evaluate again with `glbench evaluate ... --fresh`."
        raise ResultError(msg) from error


def ensure_writable(folder: Path) -> None:
    """Make ``folder`` and try to write there: found out before the long run, not after it. Raises ``GlbenchError`` when that fails."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=".can-write-", suffix=".partial", dir=folder)
        os.close(handle)
        Path(name).unlink(missing_ok=True)  # who begins beside us may have cleared it away
    except OSError as error:
        msg = f"Cannot write into {folder}: {reason_of(error)}. Nothing was computed. Choose a folder that you can write to."
        raise GlbenchError(msg) from error


def _check_schema(path: Path, text: str) -> None:
    """Say plainly that a file is of another kind or age, before its hundred missing fields are listed."""
    try:
        document = parse_json(text)
    except ValueError as error:
        reason = f"is no valid JSON ({reason_of(error)}). It was cut or edited" if text.strip() else "is empty"
        refuse(f"{path} {reason}; evaluate again with `glbench evaluate ... --fresh`.", ResultError, error)
    name = document.get("schema") if isinstance(document, dict) else None
    if name != SCHEMA_NAME:
        refuse(f"{path} is not a result of glbench: its 'schema' is {quoted(name)} and should be '{SCHEMA_NAME}'.", ResultError)
    number = document.get("schema_version", 1)
    if number != SCHEMA_VERSION:
        msg = (
            f"{path} has result schema version {quoted(number)}; this glbench reads version {SCHEMA_VERSION}. "
            "Update glbench, or use the one that wrote it."
        )
        raise ResultError(msg)
