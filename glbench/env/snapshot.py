"""The state of running episodes as a record of arrays that can be stored, sent to another process, and continued from."""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.errors import ResultError, refuse

_FORMAT = 3
_SINCE = {"memory": 2, "split": 3}
"""The format that brought a field; all others were there from the first."""


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Everything that the rest of ``n`` episodes depends on, besides task and actions.

    Weather, parameters and draws are not in it: they follow from task, seed and step. The same actions after ``restore``
    give the same bits as without it, in this process or another.
    """

    task_id: str
    task_digest: str
    """``task_id`` and ``task_digest``: the task it belongs to."""
    states: NDArray[np.float64]
    controls: NDArray[np.float64]
    """``states`` and ``controls``: model states ``(n, s)`` and controls in force ``(n, c)``, fractions."""
    steps: NDArray[np.int64]
    seeds: NDArray[np.uint64]
    ended: NDArray[np.bool_]
    """``steps``, ``seeds`` and ``ended``: steps taken, episode seeds and whether the episode has ended, each ``(n,)``."""
    generators: NDArray[np.uint64]
    """Where the seeds of the next episodes come from: states of the environments' ``np_random``, ``(n, 6)`` words; ``(0, 6)`` for none."""
    memory: NDArray[np.float64]
    """What runs keep from step to step besides states and controls, ``(n, m)``: nothing (m = 0) in most tasks."""
    split: str = ""
    """The split whose scenarios the runs are in, and of a secret salt its digest; "" for a task without splits."""

    @property
    def n(self) -> int:
        """Number of rows."""
        return len(self.states)

    def take(self, rows: int | list[int] | NDArray[np.intp]) -> Snapshot:
        """Some of the rows, in the order given; the same row may be taken several times, to try several ways from it."""
        places = np.atleast_1d(np.asarray(rows, dtype=np.intp))
        picked: dict[str, Any] = {name: getattr(self, name)[places] for name in ("states", "controls", "steps", "seeds", "ended", "memory")}
        if len(self.generators):
            picked["generators"] = self.generators[places]
        return replace(self, **picked)

    def to_bytes(self) -> bytes:
        """The snapshot as the bytes of an ``.npz`` file without pickles; equal snapshots give equal bytes."""
        file = io.BytesIO()
        arrays = {field.name: np.asarray(getattr(self, field.name)) for field in fields(self)}
        np.savez(file, allow_pickle=False, format=np.int64(_FORMAT), **arrays)
        return file.getvalue()

    @classmethod
    def from_bytes(cls, data: bytes) -> Snapshot:
        """Read what ``to_bytes`` wrote. Raises ``ResultError`` when the bytes are damaged or no snapshot."""
        try:
            with np.load(io.BytesIO(data), allow_pickle=False) as file:
                version = int(file["format"])
                if not 1 <= version <= _FORMAT:
                    refuse(f"The snapshot has format {version}; this version of glbench reads formats 1 to {_FORMAT}.", ResultError)
                names = [field.name for field in fields(cls) if version >= _SINCE.get(field.name, 1)]
                values: dict[str, Any] = {name: file[name] for name in names}
                values.setdefault("memory", np.zeros((len(values["states"]), 0)))
                values.setdefault("split", "")
        except (KeyError, ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
            msg = f"These {len(data)} bytes are no snapshot, or a damaged one: {error}. Take a new one with snapshot()."
            raise ResultError(msg) from error
        for name in ("task_id", "task_digest", "split"):
            values[name] = str(values[name])
        return cls(**values)
