"""Short tasks."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from glbench.tasks import TaskSpec, get_task
from tests.env.conftest import own_words as own_words
from tests.support import write_day_task

# Several tests share the machine: JAX's threads would wait for each other.
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")


@pytest.fixture(scope="session")
def day(tmp_path_factory: pytest.TempPathFactory) -> TaskSpec:
    """The default task, cut to one day of 24 steps."""
    folder: Path = tmp_path_factory.mktemp("tasks")
    return get_task(write_day_task(folder))
