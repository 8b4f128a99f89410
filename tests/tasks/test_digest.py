"""The digest changes with everything that could change a result, and with nothing else."""

from __future__ import annotations

import hashlib
import pickle
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import rfc8785

import glbench.model
from glbench.tasks import PAPER_TASK, get_task

Vary = Callable[..., Path]


def nine(value: float) -> float:
    """``value`` with nine significant digits."""
    return float(f"{value:.9g}")


def test_the_digest_is_the_sha256_of_canonical_json() -> None:
    task = get_task(PAPER_TASK)
    parts: dict[str, Any] = {
        "definition": task.definition(),
        "parameters": {name: nine(value) for name, value in task.parameters_by_name().items()},
        "start": [nine(value) for value in task.initial_state()],
        "observation": [[q.name, q.unit, nine(q.low), nine(q.high)] for q in task.observed()],
        "weather": task.disturbances().digest,
        "model": {"version": glbench.model.MODEL_VERSION, "variant": "author", "digest": glbench.model.model_digest("author")},
    }
    assert task.digest == hashlib.sha256(rfc8785.dumps(parts)).hexdigest()
    assert task.fingerprint().definition == hashlib.sha256(rfc8785.dumps(parts["definition"])).hexdigest()


def test_comments_layout_prose_and_the_order_of_keys_do_not_matter(vary: Vary, own_text: str, write: Callable[[str], Path]) -> None:
    digest = get_task(vary()).digest
    bare = "\n".join(line.partition(" #")[0] for line in own_text.splitlines() if not line.startswith("#"))
    assert get_task(write(bare)).digest == digest
    assert get_task(vary('title = "', 'title = "Also: ', 'suites = ["paper"]', 'suites = ["mine"]')).digest == digest
    assert get_task(vary("Grow tomatoes", "Raise tomatoes")).digest == digest
    lines = bare.splitlines()
    days, step = (next(i for i, line in enumerate(lines) if line.startswith(key)) for key in ("days", "step_seconds"))
    lines[days], lines[step] = lines[step], lines[days]
    assert get_task(write("\n".join(lines))).digest == digest
    prices = bare.index("[prices]")
    reward = bare.index("[reward]")
    moved = bare[:prices] + bare[reward:] + "\n" + bare[prices:reward]
    assert tomllib.loads(moved) == tomllib.loads(bare)
    assert get_task(write(moved)).digest == digest
    assert get_task(vary("low = 15.0, high = 34.0", "high = 34, low = 15")).digest == digest


@pytest.mark.parametrize(
    ("old", "new", "part"),
    [
        ("delta = 0.10", "delta = 0.11", "definition"),
        ("first_seed = 666", "first_seed = 667", "definition"),
        ("mylab/", "otherlab/", "definition"),
        ("2010-03-01", "2010-03-02", "weather"),
        ("days = 60", "days = 59", "weather"),
        ("co2_ppm = 400.0", "co2_ppm = 420.0", "weather"),
        ('"paper"         #', '"conserving" #', "weather"),
        ('"author"', '"gl_gym2"', "model"),
        ('"benchmark"', '"led_2020"', "parameters"),
        ("value = 16.5", "value = 18.5", "start"),
        ('"time", "controls"', '"controls", "time"', "observation"),
    ],
)
def test_every_change_of_the_problem_changes_the_digest_and_its_part(vary: Vary, old: str, new: str, part: str) -> None:
    before, after = get_task(vary()).fingerprint(), get_task(vary(old, new)).fingerprint()
    assert before.digest != after.digest
    assert before.definition != after.definition
    assert getattr(before, part) != getattr(after, part)


def test_the_rows_of_a_forecast_belong_to_the_digest(vary: Vary) -> None:
    granted = '"weather", "forecast"]\nforecast = { steps = 4 }'
    before, after = get_task(vary()), get_task(vary('"weather"]', granted))
    assert before.fingerprint().weather != after.fingerprint().weather


def test_a_fresh_process_finds_the_same_digest() -> None:
    program = f"from glbench.tasks import get_task; print(get_task({PAPER_TASK!r}).digest)"
    printed = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True, env={"PYTHONHASHSEED": "12345"})
    assert printed.stdout.strip() == get_task(PAPER_TASK).digest


def test_a_task_survives_pickling_with_its_digest() -> None:
    task = get_task(PAPER_TASK)
    copy = pickle.loads(pickle.dumps(task))
    assert copy == task
    assert copy.digest == task.digest


def test_a_changed_copy_does_not_keep_the_digest_of_the_original() -> None:
    task = get_task(PAPER_TASK)
    copy = task.model_copy(update={"uncertainty": task.uncertainty.model_copy(update={"delta": 0.5})})
    assert copy.digest != task.digest
    assert not copy.locked
