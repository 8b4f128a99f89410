"""Reading an episode back, bit by bit the same; also what is left of a file that was cut."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from glbench.episodes.columns import Column, Group, Moment
from glbench.episodes.episode import Episode, Table
from glbench.episodes.header import Provenance, RunFacts
from glbench.episodes.mcap_scan import Scan, scan
from glbench.episodes.wire import Layout, layout_from
from glbench.episodes.writing import FORMAT, PROVENANCE, RUN, TASK
from glbench.errors import EpisodeError

if TYPE_CHECKING:
    import pandas as pd

Record = TypeVar("Record", bound=BaseModel)


def read(path: Path | str) -> pd.DataFrame:
    """One episode as a table: one row a step, columns with units in ``frame.attrs["units"]``; see ``Episode.to_frame``.

    Raises
    ------
    EpisodeError
        When the file is missing, cut, damaged, or no episode.
    """
    return read_episode(path).to_frame()


def read_episode(path: Path | str, *, partial: bool = False) -> Episode:
    """Read the episode in ``path``. With ``partial``, also what is left of a file that is cut; ``episode.problem`` says so.

    Raises
    ------
    EpisodeError
        When the file is missing or no episode; without ``partial`` also when it is cut or damaged.
    """
    path = Path(path)
    found = scan(path)
    if found.problem is not None and not partial:
        msg = f"{path}: {found.problem}. `glbench episodes recover {path}` makes a file of what is left."
        raise EpisodeError(msg)
    words = found.metadata.get("glbench episode")
    if words is None or words.get("format") != FORMAT:
        kind = (
            "is no episode of glbench"
            if words is None
            else f"has the episode format {words.get('format')!r}, not {FORMAT!r}"
        )
        msg = f"{path} {kind}{f' ({found.problem})' if found.problem else ''}."
        raise EpisodeError(msg)
    provenance = _attached(path, found, PROVENANCE, Provenance)
    run = _attached(path, found, RUN, RunFacts)
    if TASK not in found.attachments:
        raise EpisodeError(_too_short(path, TASK, found))
    return _episode(path, found, provenance, run)


def _attached(path: Path, found: Scan, name: str, kind: type[Record]) -> Record:
    data = found.attachments.get(name)
    if data is None:
        raise EpisodeError(_too_short(path, name, found))
    try:
        return kind.model_validate_json(data)
    except ValidationError as error:
        first = error.errors()[0]
        msg = f"{path}: the attached {name} is invalid ({'.'.join(map(str, first['loc']))}: {first['msg']})."
        raise EpisodeError(msg) from error


def _too_short(path: Path, name: str, found: Scan) -> str:
    return f"{path} lacks the attachment {name}{f': {found.problem}' if found.problem else ''}. Nothing can be read from it."


def _episode(path: Path, found: Scan, provenance: Provenance, run: RunFacts) -> Episode:
    channels = [(channel, _layout(path, found, channel)) for channel in found.channels.values()]
    groups = tuple(_group(channel, layout) for channel, layout in channels)
    begun = [pair for pair, group in zip(channels, groups, strict=True) if group.at_start]
    if not found.chunks or not begun:
        msg = f"{path} holds no steps{f': {found.problem}' if found.problem else ''}."
        raise EpisodeError(msg)
    (first, *_), chunks = _blocks(path, found.chunks[:1], begun), list(_blocks(path, found.chunks[1:], channels))
    if not len(next(iter(first.values()))):
        msg = f"{path} holds no steps: {found.problem}."
        raise EpisodeError(msg)
    tables: dict[str, Table] = {}
    numbers: list[NDArray[np.uint32]] = []
    times = [first[begun[0][0].id]["log_time"][:1]]
    for (channel, layout), group in zip(channels, groups, strict=True):
        parts = [layout.values(block[channel.id]) for block in chunks]
        tables[group.name] = np.concatenate([np.empty((0, group.width), layout.number), *parts])
        numbers.append(np.concatenate([np.empty(0, np.uint32), *(block[channel.id]["sequence"] for block in chunks)]))
        if group.at_start and len(times) == 1:
            times += [block[channel.id]["log_time"] for block in chunks]
    steps = len(next(iter(tables.values())))
    if any((sequence != np.arange(1, steps + 1)).any() for sequence in numbers):
        msg = f"{path}: the steps are not numbered 1, 2, 3 ...: steps are missing or in another order."
        raise EpisodeError(msg)
    start = {
        group.name: layout.values(first[channel.id])[0]
        for (channel, layout), group in zip(channels, groups, strict=True)
        if group.at_start
    }
    utc = np.concatenate(times).astype("datetime64[ns]")
    return Episode(provenance, run, found.attachments[TASK], groups, tables, start, utc, found.problem)


def _layout(path: Path, found: Scan, channel: Channel) -> Layout:
    schema = found.schemas.get(channel.schema_id)
    if schema is None or schema.encoding != "protobuf":
        msg = f"{path}: the topic {channel.topic} is not described as protobuf. It was not written by glbench."
        raise EpisodeError(msg)
    return layout_from(schema.data, schema.name)


def _group(channel: Channel, layout: Layout) -> Group:
    about = channel.metadata
    columns = tuple(
        Column(name, about.get(f"unit.{name}", "?"), about.get(f"meaning.{name}", "")) for name in layout.fields
    )
    moment: Moment = "start" if about.get("moment") == "start" else "end"
    name = about.get("group", channel.topic.strip("/"))
    return Group(name, channel.topic, layout.name, moment, about.get("at_start") == "true", columns)


def _blocks(
    path: Path, chunks: list[bytes], channels: list[tuple[Channel, Layout]]
) -> Iterator[dict[int, NDArray[np.void]]]:
    """Messages of every chunk by channel. A torn chunk gives the steps that are whole in it."""
    block = np.dtype([(str(channel.id), layout.record) for channel, layout in channels])
    for data in chunks:
        rows = np.frombuffer(data[: len(data) // block.itemsize * block.itemsize], dtype=block)
        for channel, layout in channels:
            messages = rows[str(channel.id)]
            expected = layout.record.itemsize - 9
            if (
                (messages["opcode"] != Opcode.MESSAGE).any()
                or (messages["channel"] != channel.id).any()
                or (messages["length"] != expected).any()
            ):
                msg = f"{path}: the messages do not lie as glbench writes them. Was it written, or changed, by another program?"
                raise EpisodeError(msg)
        yield {channel.id: rows[str(channel.id)] for channel, _ in channels}
