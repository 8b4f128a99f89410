"""A short task, evaluated runs of it, and reading recordings of the viewer back."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.episodes import Episode, read_episode
from glbench.evaluation import evaluate
from glbench.evaluation.files import result_path
from glbench.tasks import get_task
from tests.support import write_short_task

STEADY = (
    "import numpy as np\n"
    "class Steady:\n"
    "    def reset(self, task, n_runs):\n        self.n = n_runs\n"
    "    def act(self, observations):\n        return np.full((self.n, 6), 0.01)\n"
    "def make_agent(task):\n    return Steady()\n"
)


@dataclass(frozen=True)
class Runs:
    """Results of two controllers on the short task; of the second, only the run with seed 666 is a full episode."""

    folder: Path
    task_file: Path
    rule_based: Path
    steady: Path

    def episode_file(self, seed: int = 666, agent: str = "rule_based") -> Path:
        """File of a recorded run."""
        return self.folder / "episodes" / "Short-v1" / agent / f"seed-{seed}.mcap"

    def episode(self, seed: int = 666, agent: str = "rule_based") -> Episode:
        """A recorded run."""
        return read_episode(self.episode_file(seed, agent))


def make_runs(folder: Path) -> Runs:
    """Four days in hourly steps, three runs each."""
    task_file, agent = write_short_task(folder, "Short", days=4), folder / "steady.py"
    agent.write_text(STEADY, encoding="utf-8")
    task = get_task(task_file)
    evaluate(task, "rule_based", out=folder, episodes="all")
    evaluate(task, agent, out=folder, episodes="666")
    paths = [result_path(folder, task.id, name) for name in ("rule_based", "steady")]
    return Runs(folder, task_file, *paths)


@dataclass(frozen=True)
class Curve:
    """A curve as it stands in a recording."""

    steps: NDArray[np.int64]
    times: NDArray[np.datetime64]
    values: NDArray[np.float64]


@dataclass(frozen=True)
class Recording:
    """A recording, read back with the viewer's own reader."""

    curves: dict[str, Curve]
    styles: dict[str, dict[str, Any]]
    """Constant components by path and name, such as ``SeriesLines:names``."""


def read_recording(path: Path) -> Recording:
    """Everything that is in a recording."""
    from rerun.chunk import RrdReader

    parts: dict[str, list[Curve]] = {}
    styles: dict[str, dict[str, Any]] = {}
    with warnings.catch_warnings():
        # A file that a viewer writes from a stream has no table of contents at its end; nothing else is missing.
        warnings.filterwarnings("ignore", message="RRD file has no footer")
        reader = RrdReader(path)
    for chunk in reader.stream():
        batch, entity = chunk.to_record_batch(), str(chunk.entity_path)
        names = set(batch.schema.names)
        value = next((name for name in ("Scalars:scalars", "Measurements:values") if name in names), None)
        if value is None or "step" not in names:
            styles.setdefault(entity, {}).update(
                {name: batch.column(name).to_pylist()[-1] for name in names if not name.startswith("rerun.")}
            )
            continue
        parts.setdefault(entity, []).append(
            Curve(
                batch.column("step").to_numpy(zero_copy_only=False).astype(np.int64),
                batch.column("time").to_numpy(zero_copy_only=False).astype("datetime64[ns]"),
                np.array([row[0] for row in batch.column(value).to_pylist()], dtype=np.float64),
            )
        )
    return Recording({entity: _joined(curves) for entity, curves in parts.items()}, styles)


def _joined(curves: list[Curve]) -> Curve:
    order = np.argsort(np.concatenate([curve.steps for curve in curves]), kind="stable")
    return Curve(
        np.concatenate([curve.steps for curve in curves])[order],
        np.concatenate([curve.times for curve in curves])[order],
        np.concatenate([curve.values for curve in curves])[order],
    )
