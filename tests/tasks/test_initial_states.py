"""The word in ``[initial_state] kind`` decides what stands in the greenhouse."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from glbench.tasks import INITIAL_STATES, InitialState, get_task
from tests.tasks.names import SHORT_ID


def test_a_start_of_ones_own_is_used(vary: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(INITIAL_STATES, "_entries", dict(INITIAL_STATES._entries))
    INITIAL_STATES.add(InitialState("test_lukewarm", "all at the air's temperature", lambda d, air, p: np.full(28, air + d[0])))
    task = get_task(vary("mature_crop", "test_lukewarm", 'id = "mylab/', 'id = "test_start/'))
    assert task.initial_state().tolist() == [16.5] * 28
    assert task.fingerprint().start != get_task(SHORT_ID).fingerprint().start
