"""Writing an episode: as a whole, or piece by piece while it happens."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Self

import numpy as np
from numpy.typing import NDArray

from glbench.episodes.columns import TOPICS, Group
from glbench.episodes.episode import Episode, Table
from glbench.episodes.header import Provenance, RunFacts, as_words, canonical
from glbench.episodes.mcap_stream import McapStream
from glbench.episodes.wire import PACKAGE, Layout, descriptor_of, layout_of
from glbench.errors import EpisodeError
from glbench.resources import write_atomically

FORMAT = "2"
PROVENANCE, RUN, TASK = "provenance.json", "run.json", "task.json"
_PIECES = 48
_SHORTEST, _LONGEST = 4, 96


def chunk_steps(steps: int) -> int:
    """Steps of one chunk, the part of a file that a killed writer may lose: about a fiftieth of the episode, a day at most."""
    return min(_LONGEST, max(_SHORTEST, steps // _PIECES))


class EpisodeWriter:
    """Writes one episode into a binary file, chunk by chunk, as a context manager.

    What was written is handed to the system chunk by chunk: a killed writer loses the chunk it was at.

    Parameters
    ----------
    file
        A binary file, open for writing.
    provenance, run, definition
        As in ``Episode``; ``run.steps`` is the number of steps that are to come.
    groups
        The groups of columns.
    action
        float32 or float64: the type of the raw actions.
    """

    def __init__(
        self,
        file: IO[bytes],
        provenance: Provenance,
        run: RunFacts,
        definition: bytes,
        groups: tuple[Group, ...],
        action: np.dtype[np.floating],
    ) -> None:
        self._groups = groups
        self._step = 0
        self._stream = stream = McapStream(file)
        stream.metadata("glbench episode", {"format": FORMAT, **as_words(provenance, run)})
        stream.attachment(PROVENANCE, "application/json", canonical(provenance))
        stream.attachment(RUN, "application/json", canonical(run))
        stream.attachment(TASK, "application/json", definition)
        self._layouts: dict[str, tuple[int, Layout]] = {}
        for moment, topic in TOPICS.items():
            parts = [group for group in groups if group.moment == moment]
            layout = layout_of(topic, parts, action)
            schema = stream.schema(f"{PACKAGE}.{layout.name}", "protobuf", descriptor_of(layout))
            about: dict[str, str] = {"moment": moment}
            for group in parts:
                about |= {f"group.{group.field}": group.name, f"at_start.{group.field}": str(group.at_start).lower()}
                about |= {f"unit.{column.name}": column.unit for column in group.columns}
                about |= {f"meaning.{column.name}": column.meaning for column in group.columns}
            self._layouts[topic] = (stream.channel(topic, schema, "protobuf", about), layout)

    def remark(self, name: str, words: Mapping[str, str]) -> None:
        """Add a table of words to the file."""
        self._stream.metadata(name, words)

    def begin(self, time: np.datetime64, start: Mapping[str, Table]) -> None:
        """Write step 0: the values ``(columns,)`` of the groups that have some, at ``time`` (UTC)."""
        begun = [group for group in self._groups if group.at_start]
        (topic,) = {group.topic for group in begun}
        channel, layout = self._layouts[topic]
        tables = {group.field: start[group.name][np.newaxis] for group in begun}
        times = _nanoseconds(np.array([time]))
        self._chunk({topic: layout.some(list(tables)).messages(channel, np.zeros(1, np.uint32), times, tables)})

    def steps(self, times: NDArray[np.datetime64], tables: Mapping[str, Table]) -> None:
        """Write the next n steps as one chunk: ``times`` ``(n + 1,)`` at their starts and ends, ``tables`` ``(n, columns)``."""
        count = len(times) - 1
        moments = _nanoseconds(times)
        numbers = np.arange(self._step + 1, self._step + count + 1, dtype=np.uint32)
        fields = {group.field: tables[group.name] for group in self._groups}
        rows = {}
        for moment, topic in TOPICS.items():
            channel, layout = self._layouts[topic]
            rows[topic] = layout.messages(channel, numbers, moments[:-1] if moment == "start" else moments[1:], fields)
        self._chunk(rows)
        self._step += count

    def close(self) -> None:
        """Write what makes the file whole."""
        self._stream.finish()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()

    def _chunk(self, rows: Mapping[str, NDArray[np.void]]) -> None:
        """Put the messages side by side, step after step, and write them."""
        count = len(next(iter(rows.values())))
        block = np.empty(count, dtype=[(name, table.dtype) for name, table in rows.items()])
        index = {}
        for name, table in rows.items():
            block[name] = table
            place = block.dtype.fields[name][1]  # type: ignore[index]
            offsets = np.arange(count, dtype=np.uint64) * block.itemsize + place
            index[self._layouts[name][0]] = (table["log_time"], offsets)
        self._stream.chunk(block.tobytes(), index)


def episode_bytes(episode: Episode) -> bytes:
    """The file of ``episode``: the same bytes for the same episode."""
    buffer = io.BytesIO()
    write_into(buffer, episode)
    return buffer.getvalue()


def write_into(file: IO[bytes], episode: Episode, remarks: Mapping[str, Mapping[str, str]] | None = None) -> None:
    """Write the steps that ``episode`` has into a binary file, with further tables of words."""
    action = np.dtype(episode.tables["action"].dtype)
    length = chunk_steps(episode.provenance.task.steps)
    with EpisodeWriter(file, episode.provenance, episode.run, episode.definition, episode.groups, action) as writer:
        for name, words in (remarks or {}).items():
            writer.remark(name, words)
        writer.begin(episode.times[0], episode.start)
        for first in range(0, episode.steps, length):
            last = min(first + length, episode.steps)
            writer.steps(
                episode.times[first : last + 1], {name: table[first:last] for name, table in episode.tables.items()}
            )


def write_episode(path: Path, episode: Episode) -> None:
    """Write ``episode`` to ``path``, whole or not at all.

    Raises
    ------
    EpisodeError
        When it is not whole itself: recovered episodes are written with ``recover``.
    GlbenchError
        When the file cannot be written.
    """
    if episode.steps != episode.run.steps:
        msg = f"The episode has {episode.steps} steps, and its run {episode.run.steps}. Write it with `recover`, which says so in the file."
        raise EpisodeError(msg)
    write_atomically(path, episode_bytes(episode))


def _nanoseconds(times: NDArray[np.datetime64]) -> NDArray[np.uint64]:
    return times.astype("datetime64[ns]").astype(np.uint64)
