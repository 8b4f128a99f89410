"""Reading an episode back, bit by bit the same; also what is left of a file that was cut."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from google.protobuf.message import DecodeError
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
from glbench.untrusted import one_line, quoted, refuse_crowd, visible

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
            else f"has the episode format {words.get('format')!r}, not {FORMAT!r}. Make it anew from the recorded actions "
            "(`glbench episodes make RESULT`), or read it with the glbench that wrote it"
        )
        msg = f"{path} {kind}{f' ({found.problem})' if found.problem else ''}."
        raise EpisodeError(msg)
    provenance = _attached(path, found, PROVENANCE, Provenance)
    run = _attached(path, found, RUN, RunFacts)
    if TASK not in found.attachments:
        raise EpisodeError(_too_short(path, TASK, found))
    try:
        return _episode(path, found, provenance, run)
    except (ValueError, KeyError, IndexError, TypeError, OverflowError, StopIteration, DecodeError) as error:
        msg = f"{path} does not hold an episode as glbench writes it ({visible(' '.join(str(error).split())[:200])})."
        raise EpisodeError(msg) from error


def _attached(path: Path, found: Scan, name: str, kind: type[Record]) -> Record:
    data = found.attachments.get(name)
    if data is None:
        raise EpisodeError(_too_short(path, name, found))
    try:
        refuse_crowd(data)
        return kind.model_validate_json(data)
    except ValidationError as error:
        first = error.errors()[0]
        msg = f"{path}: the attached {name} is invalid ({visible('.'.join(map(str, first['loc'])))}: {first['msg']})."
        raise EpisodeError(msg) from error
    except ValueError as error:
        msg = f"{path}: the attached {name} is invalid: {error}."
        raise EpisodeError(msg) from error


def _too_short(path: Path, name: str, found: Scan) -> str:
    return f"{path} lacks the attachment {name}{f': {found.problem}' if found.problem else ''}. Nothing can be read from it."


def _episode(path: Path, found: Scan, provenance: Provenance, run: RunFacts) -> Episode:
    topics = [(channel, _layout(path, found, channel)) for channel in found.channels.values()]
    groups = {group.name: (channel, layout, group) for channel, layout in topics for group in _groups(channel, layout)}
    if "action" not in groups:
        msg = f"{path} holds no actions. It was not written by glbench."
        raise EpisodeError(msg)
    begun = {name: row for name, row in groups.items() if row[2].at_start}
    if not found.chunks or not begun:
        msg = f"{path} holds no steps{f': {found.problem}' if found.problem else ''}."
        raise EpisodeError(msg)
    channel, layout, _ = next(iter(begun.values()))
    first_layout = layout.some([group.field for _, _, group in begun.values()])
    first = _rows(path, found.chunks[:1], [(channel, first_layout)])[channel.id]
    if not len(first):
        msg = f"{path} holds no steps: {found.problem}."
        raise EpisodeError(msg)
    rows = _rows(path, found.chunks[1:], topics)
    steps = len(rows[channel.id])
    if any((messages["sequence"] != np.arange(1, steps + 1)).any() for messages in rows.values()):
        msg = f"{path}: the steps are not numbered 1, 2, 3 ...: steps are missing or in another order."
        raise EpisodeError(msg)
    tables: dict[str, Table] = {
        name: layout.values(rows[channel.id], group.field) for name, (channel, layout, group) in groups.items()
    }
    start = {name: first_layout.values(first, group.field)[0] for name, (_, _, group) in begun.items()}
    utc = np.concatenate([first["log_time"], rows[channel.id]["log_time"]]).astype("datetime64[ns]")
    listed = tuple(group for _, _, group in groups.values())
    return Episode(provenance, run, found.attachments[TASK], listed, tables, start, utc, found.problem)


def _layout(path: Path, found: Scan, channel: Channel) -> Layout:
    schema = found.schemas.get(channel.schema_id)
    if schema is None or schema.encoding != "protobuf":
        msg = f"{path}: the topic {channel.topic} is not described as protobuf. It was not written by glbench."
        raise EpisodeError(msg)
    return layout_from(schema.data, schema.name)


def _groups(channel: Channel, layout: Layout) -> list[Group]:
    """The groups of columns of one topic."""
    about = channel.metadata
    moment: Moment = "start" if about.get("moment") == "start" else "end"
    groups = []
    for part in layout.parts:
        columns = tuple(
            Column(name, about.get(f"unit.{name}", "?"), about.get(f"meaning.{name}", "")) for name in part.names
        )
        at_start = about.get(f"at_start.{part.field}") == "true"
        for column in columns:
            one_line(column.name + column.unit + column.meaning)
            if not column.name.isidentifier():  # in a spreadsheet it could be a formula
                msg = f"a column is called {quoted(column.name)}"
                raise ValueError(msg)
        groups.append(
            Group(about.get(f"group.{part.field}", part.field), part.field, part.message, moment, at_start, columns)
        )
    return groups


def _rows(path: Path, chunks: list[bytes], topics: list[tuple[Channel, Layout]]) -> dict[int, NDArray[np.void]]:
    """Messages of all chunks by channel. A torn chunk gives the steps that are whole in it."""
    step = np.dtype([(str(channel.id), layout.record) for channel, layout in topics])
    data = b"".join(chunk[: len(chunk) // step.itemsize * step.itemsize] for chunk in chunks)
    rows = np.frombuffer(data, dtype=step)
    for channel, layout in topics:
        if not layout.fits(rows[str(channel.id)], channel.id):
            msg = f"{path}: the messages do not lie as glbench writes them. Was it written, or changed, by another program?"
            raise EpisodeError(msg)
    return {channel.id: rows[str(channel.id)] for channel, _ in topics}
