"""The state of running episodes as a record of arrays that can be stored, sent to another process, and continued from."""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.errors import ResultError

_FORMAT = 1
_GENERATOR_WORDS = 6


def no_generators() -> NDArray[np.uint64]:
    """What ``Snapshot.generators`` holds where no environment draws seeds for the next episodes."""
    return np.empty((0, _GENERATOR_WORDS), dtype=np.uint64)


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Everything that the rest of ``n`` episodes depends on, besides task and actions.

    Weather and parameter draws are not in it: they follow from task, seed and step. The same actions after ``restore``
    give the same bits as without it, in this process or another.

    Attributes
    ----------
    task_id, task_digest
        The task it belongs to.
    states, controls
        Model states ``(n, 28)`` and controls in force ``(n, 6)``, fractions.
    steps, seeds, ended
        Steps taken, episode seeds and whether the episode has ended, each ``(n,)``.
    generators
        Where the seeds of the next episodes come from: states of the environments' ``np_random``, ``(n, 6)`` words, or
        ``(0, 6)`` when there are none.
    """

    task_id: str
    task_digest: str
    states: NDArray[np.float64]
    controls: NDArray[np.float64]
    steps: NDArray[np.int64]
    seeds: NDArray[np.uint64]
    ended: NDArray[np.bool_]
    generators: NDArray[np.uint64]

    @property
    def n(self) -> int:
        """Number of rows."""
        return len(self.states)

    def take(self, rows: int | list[int] | NDArray[np.intp]) -> Snapshot:
        """Some of the rows, in the order given; the same row may be taken several times, to try several ways from it."""
        chosen = np.atleast_1d(np.asarray(rows, dtype=np.intp))
        picked: dict[str, Any] = {
            name: getattr(self, name)[chosen] for name in ("states", "controls", "steps", "seeds", "ended")
        }
        if len(self.generators):
            picked["generators"] = self.generators[chosen]
        return replace(self, **picked)

    def to_bytes(self) -> bytes:
        """The snapshot as the bytes of an ``.npz`` file without pickles; equal snapshots give equal bytes."""
        file = io.BytesIO()
        arrays = {field.name: np.asarray(getattr(self, field.name)) for field in fields(self)}
        np.savez(file, allow_pickle=False, format=np.int64(_FORMAT), **arrays)
        return file.getvalue()

    @classmethod
    def from_bytes(cls, data: bytes) -> Snapshot:
        """Read what ``to_bytes`` wrote.

        Raises
        ------
        ResultError
            When the bytes are damaged or no snapshot.
        """
        try:
            with np.load(io.BytesIO(data), allow_pickle=False) as file:
                if int(file["format"]) != _FORMAT:
                    msg = f"The snapshot has format {int(file['format'])}; this version of glbench reads format {_FORMAT}."
                    raise ResultError(msg)
                values: dict[str, Any] = {field.name: file[field.name] for field in fields(cls)}
        except (KeyError, ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
            msg = f"These {len(data)} bytes are no snapshot, or a damaged one: {error}. Take a new one with snapshot()."
            raise ResultError(msg) from error
        for name in ("task_id", "task_digest"):
            values[name] = str(values[name])
        return cls(**values)


def pack_generator(generator: np.random.Generator) -> NDArray[np.uint64]:
    """State of a PCG64 generator (the kind Gymnasium uses) as six words."""
    state = generator.bit_generator.state
    inner = state["state"]
    words = [*_halves(inner["state"]), *_halves(inner["inc"]), int(state["has_uint32"]), int(state["uinteger"])]
    return np.array(words, dtype=np.uint64)


def unpack_generator(words: NDArray[np.uint64]) -> np.random.Generator:
    """The generator that ``pack_generator`` read."""
    a, b, c, d, has_uint32, uinteger = (int(word) for word in words)
    bits = np.random.PCG64()
    bits.state = {
        "bit_generator": "PCG64",
        "state": {"state": a << 64 | b, "inc": c << 64 | d},
        "has_uint32": has_uint32,
        "uinteger": uinteger,
    }
    return np.random.Generator(bits)


def _halves(number: int) -> tuple[int, int]:
    return number >> 64, number & 0xFFFFFFFFFFFFFFFF
