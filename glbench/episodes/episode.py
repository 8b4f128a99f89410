"""An episode: what happened in one run, step by step, with where it comes from. In memory, as a file, and back, bit by bit the same.

The file is written as a whole, or piece by piece while it happens; what is left of a file that was cut can be read, too.
"""

from __future__ import annotations

import io
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, TYPE_CHECKING, Any, Literal, Protocol, Self, TypeVar

import numpy as np
from google.protobuf.message import DecodeError
from mcap.records import Channel
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from glbench.arrays import Floats
from glbench.env.weather_pool import CLOCK
from glbench.episodes.header import Provenance, RunFacts, as_words, canonical, task_of
from glbench.episodes.mcap_file import PACKAGE, Layout, McapWriter, Part, Scan, layout_from, scan
from glbench.episodes.signals import ACTION, MESSAGES, TOPICS, Column, Group, Line, Moment, Signals, Source, signals_of
from glbench.errors import EpisodeError, did_you_mean, refuse
from glbench.resources import write_atomically
from glbench.settings import first_problems
from glbench.tasks.prices import local_times
from glbench.untrusted import html_of, one_line, quoted, refuse_crowd, visible

if TYPE_CHECKING:
    import pandas as pd

    from glbench.tasks import TaskSpec

Table = NDArray[np.floating]
Record = TypeVar("Record", bound=BaseModel)

FORMAT = "2"
PROVENANCE, RUN, TASK = "provenance.json", "run.json", "task.json"
_WORDS, _RECOVERY = "glbench episode", "glbench recovery"
_PIECES = 48
_SHORTEST, _LONGEST = 4, 96
"""Steps of one chunk, the part of a file that a killed writer may lose: about a fiftieth of the episode, a day at most."""


@dataclass(frozen=True, eq=False)
class Episode:
    """One run: where it comes from, how it ended, and its numbers.

    ``definition`` is the task as JSON; ``task()`` makes the task of it. ``groups`` are those of the columns, with units and meanings.
    ``tables`` holds the values ``(steps, columns)`` by name of the group, float64; raw actions may be float32. ``start`` holds those at
    step 0 ``(columns,)`` of the groups that have some. ``times`` is UTC at the start and at the end of every step, ``(steps + 1,)``
    datetime64[ns]. ``problem`` says in words that the file was cut or damaged and this is what could be recovered; else it is ``None``.
    """

    provenance: Provenance
    run: RunFacts
    definition: bytes
    groups: tuple[Group, ...]
    tables: Mapping[str, Table]
    start: Mapping[str, Table]
    times: NDArray[np.datetime64]
    problem: str | None = None

    @property
    def steps(self) -> int:
        """Number of steps that are there."""
        return len(self.times) - 1

    @property
    def complete(self) -> bool:
        """Whether nothing is missing: neither was the file cut, nor does it hold fewer steps than the run had."""
        return self.problem is None and self.steps == self.run.steps

    def __getitem__(self, name: str) -> Table:
        """One column, ``(steps,)``. Raises ``EpisodeError`` when there is no such column, with the nearest known one."""
        for group in self.groups:
            if name in group.names:
                return self.tables[group.name][:, group.names.index(name)]
        msg = f"An episode has no column '{name}'.{did_you_mean(name, self.names)}"
        raise EpisodeError(msg)

    @property
    def states(self) -> Table:
        """The model's states at the start and at the end of every step, ``(steps + 1, states)``, in the model's order and units."""
        names = self.task().model_value.state_names
        return np.stack([np.concatenate([[self._start_value(name)], self[name]]) for name in names], axis=1)

    @property
    def local_times(self) -> NDArray[np.datetime64]:
        """The same moments as ``times`` on the clock of the greenhouse, ``(steps + 1,)`` datetime64[s]; summer time as the task has it.

        Raises ``EpisodeError`` when the record has no clock.
        """
        return local_times(self.times, np.concatenate([[self._start_value(CLOCK[0])], self[CLOCK[0]]]))

    def _start_value(self, name: str) -> float:
        for group in self.groups:
            if group.name in self.start and name in group.names:
                return float(self.start[group.name][group.names.index(name)])
        msg = f"An episode has no value of '{name}' at its start."
        raise EpisodeError(msg)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all columns."""
        return tuple(name for group in self.groups for name in group.names)

    def _repr_html_(self) -> str:
        """What a notebook shows: task, agent and run, and the columns by group."""
        facts: list[tuple[str, object]] = [
            ("task", self.provenance.task.id),
            ("agent", self.provenance.agent.name),
            ("run", f"seed {self.run.seed}, {self.run.status}, {self.steps} of {self.run.steps} steps"),
            ("from, to (UTC)", f"{str(self.times[0])[:16]}, {str(self.times[-1])[:16]}"),
        ]
        rows = [(group.name, ", ".join(f"{one.name} [{one.unit}]" for one in group.columns)) for group in self.groups]
        return html_of("An episode", facts, ("group", "columns"), rows)

    def task(self) -> TaskSpec:
        """The task, from the definition in the record."""
        return task_of(self.definition)

    def to_frame(self, by: Literal["step", "time"] = "step") -> pd.DataFrame:
        """One row a step: ``utc_start`` and ``utc_end``, then every column.

        The index is ``by`` the number of the ``"step"``, from 1, or the ``"time"`` in UTC at its end, when the climate was as the row says;
        controls and weather of the row act until then, from ``utc_start`` on. ``frame.attrs`` holds units and meanings by column, the
        values at step 0 under ``"start"``, and task, agent and seed. Raises ``EpisodeError`` when ``by`` is neither.
        """
        import pandas as pd

        if by not in ("step", "time"):
            refuse(f"The rows of an episode are indexed by 'step' or by 'time'; got {by!r}.", EpisodeError)

        columns: dict[str, Any] = {"utc_start": self.times[:-1], "utc_end": self.times[1:]}
        for group in self.groups:
            columns |= {name: self.tables[group.name][:, index] for index, name in enumerate(group.names)}
        index = pd.RangeIndex(1, self.steps + 1, name="step")
        frame = pd.DataFrame(columns, index=index if by == "step" else pd.DatetimeIndex(self.times[1:], tz="UTC", name="time"))
        listed = [column for group in self.groups for column in group.columns]
        starting = {
            group.name: dict(zip(group.names, self.start[group.name].tolist(), strict=True))
            for group in self.groups
            if group.name in self.start
        }
        frame.attrs.update(
            task=self.provenance.task.id,
            agent=self.provenance.agent.name,
            seed=self.run.seed,
            status=self.run.status,
            steps=self.run.steps,
            units={column.name: column.unit for column in listed},
            meanings={column.name: column.meaning for column in listed},
            start=starting,
        )
        return frame


class EpisodeWriter:
    """Writes one episode into a binary file that is open for writing, as a context manager.

    What was written is handed to the system chunk by chunk: a killed writer loses the chunk it was at. ``provenance``, ``run`` and
    ``definition`` are as in ``Episode``, with ``run.steps`` steps to come; ``action`` is the type of raw actions, float32 or float64.
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
        self._groups, self._step = groups, 0
        self._file = writer = McapWriter(file)
        writer.metadata(_WORDS, {"format": FORMAT, **as_words(provenance, run)})
        writer.attachment(PROVENANCE, canonical(provenance))
        writer.attachment(RUN, canonical(run))
        writer.attachment(TASK, definition)
        self._layouts: dict[str, tuple[int, Layout]] = {}
        for moment, topic in TOPICS.items():
            parts = [group for group in groups if group.moment == moment]
            layout = layout_of(topic, parts, action)
            about: dict[str, str] = {"moment": moment}
            for group in parts:
                about |= {f"group.{group.field}": group.name, f"at_start.{group.field}": str(group.at_start).lower()}
                about |= {f"unit.{column.name}": column.unit for column in group.columns}
                about |= {f"meaning.{column.name}": column.meaning for column in group.columns}
            schema = writer.schema(f"{PACKAGE}.{layout.name}", layout.descriptor())
            self._layouts[topic] = (writer.channel(topic, schema, about), layout)

    def remark(self, name: str, words: Mapping[str, str]) -> None:
        """Add a table of words to the file."""
        self._file.metadata(name, words)

    def begin(self, time: np.datetime64, start: Mapping[str, Table]) -> None:
        """Write step 0: the values ``(columns,)`` of the groups that have some, at ``time`` (UTC)."""
        starting = [group for group in self._groups if group.at_start]
        (topic,) = {group.topic for group in starting}
        channel, layout = self._layouts[topic]
        tables = {group.field: start[group.name][np.newaxis] for group in starting}
        times = _nanoseconds(np.array([time]))
        messages = layout.some(list(tables)).messages(channel, np.zeros(1, np.uint32), times, tables)
        self._chunk({topic: (messages, times)})

    def steps(self, times: NDArray[np.datetime64], tables: Mapping[str, Table]) -> None:
        """Write the next n steps as one chunk: ``times`` ``(n + 1,)`` at their starts and ends, ``tables`` ``(n, columns)``."""
        count = len(times) - 1
        moments = _nanoseconds(times)
        numbers = np.arange(self._step + 1, self._step + count + 1, dtype=np.uint32)
        fields = {group.field: tables[group.name] for group in self._groups}
        columns = {}
        for moment, topic in TOPICS.items():
            channel, layout = self._layouts[topic]
            at = moments[:-1] if moment == "start" else moments[1:]
            columns[topic] = (layout.messages(channel, numbers, at, fields), at)
        self._chunk(columns)
        self._step += count

    def close(self) -> None:
        """Write what makes the file whole."""
        self._file.finish()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is None:
            self.close()

    def _chunk(self, columns: Mapping[str, tuple[NDArray[np.uint8], NDArray[np.uint64]]]) -> None:
        """Put the messages ``(n, size)`` of each topic side by side, step after step, and write them; with their times [ns]."""
        block = np.concatenate([messages for messages, _ in columns.values()], axis=1)
        index, place = {}, 0
        for topic, (messages, times) in columns.items():
            offsets = np.arange(len(block), dtype=np.uint64) * block.shape[1] + place
            index[self._layouts[topic][0]] = (times, offsets)
            place += messages.shape[1]
        self._file.chunk(block.tobytes(), index)


def layout_of(topic: str, groups: Sequence[Group], action: np.dtype[np.floating]) -> Layout:
    """Layout of ``topic`` with the parts ``groups``; raw actions are of type ``action`` (float64 or float32), all else float64."""
    double = np.dtype("<f8")
    parts = (
        Part(group.field, index, group.message, group.names, action if group.name == ACTION else double)
        for index, group in enumerate(groups, start=1)
    )
    return Layout(MESSAGES[topic], tuple(parts))


def episode_bytes(episode: Episode) -> bytes:
    """The file of ``episode``: the same bytes for the same episode."""
    buffer = io.BytesIO()
    write_into(buffer, episode)
    return buffer.getvalue()


def write_into(file: IO[bytes], episode: Episode, remarks: Mapping[str, Mapping[str, str]] | None = None) -> None:
    """Write the steps that ``episode`` has into a binary file, with further tables of words."""
    action = np.dtype(episode.tables[ACTION].dtype)
    length = min(_LONGEST, max(_SHORTEST, episode.provenance.task.steps // _PIECES))
    with EpisodeWriter(file, episode.provenance, episode.run, episode.definition, episode.groups, action) as writer:
        for name, words in (remarks or {}).items():
            writer.remark(name, words)
        writer.begin(episode.times[0], episode.start)
        for first in range(0, episode.steps, length):
            last = min(first + length, episode.steps)
            writer.steps(episode.times[first : last + 1], {name: table[first:last] for name, table in episode.tables.items()})


def write_episode(path: Path, episode: Episode) -> None:
    """Write ``episode`` to ``path``, whole or not at all.

    Raises ``EpisodeError`` for an episode cut short (write that with ``recover``), ``GlbenchError`` when the file cannot be written.
    """
    if episode.steps != episode.run.steps:
        msg = f"The episode has {episode.steps} steps, and its run {episode.run.steps}. Write it with `recover`, which says so in the file."
        raise EpisodeError(msg)
    write_atomically(path, episode_bytes(episode))


def _nanoseconds(times: NDArray[np.datetime64]) -> NDArray[np.uint64]:
    return times.astype("datetime64[ns]").astype(np.uint64)


def read(path: Path | str, by: Literal["step", "time"] = "step") -> pd.DataFrame:
    """One episode as a table: one row a step, columns with units in ``frame.attrs["units"]``; see ``Episode.to_frame``.

    Raises ``EpisodeError`` when the file is missing, cut, damaged, or no episode, or when ``by`` is neither ``"step"`` nor ``"time"``.
    """
    return read_episode(path).to_frame(by)


def read_episode(path: Path | str, *, partial: bool = False) -> Episode:
    """Read the episode in ``path``. With ``partial``, also what is left of a file that is cut; ``episode.problem`` says so.

    Raises ``EpisodeError`` when the file is missing or no episode; without ``partial`` also when it is cut or damaged.
    """
    path = Path(path)
    content = scan(path)
    if content.problem is not None and not partial:
        command = f"glbench episodes recover {shlex.quote(str(path))}"
        refuse(f"{path}: {content.problem}. `{command}` makes a file of what is left.", EpisodeError)
    words = content.metadata.get(_WORDS)
    if words is None or words.get("format") != FORMAT:
        kind = (
            "is not a glbench episode"
            if words is None
            else f"has the episode format {words.get('format')!r}, not {FORMAT!r}. Make it again from the recorded actions "
            "(`glbench episodes make RESULT`), or read it with the glbench that wrote it"
        )
        refuse(f"{path} {kind}{f' ({content.problem})' if content.problem else ''}.", EpisodeError)
    provenance = _attached(path, content, PROVENANCE, Provenance)
    run = _attached(path, content, RUN, RunFacts)
    if TASK not in content.attachments:
        raise EpisodeError(_too_short(path, TASK, content))
    try:
        return _episode(path, content, provenance, run)
    except (ValueError, KeyError, IndexError, TypeError, OverflowError, StopIteration, DecodeError) as error:
        msg = f"{path} does not hold an episode as glbench writes it ({visible(' '.join(str(error).split())[:200])})."
        raise EpisodeError(msg) from error


def _attached(path: Path, content: Scan, name: str, kind: type[Record]) -> Record:
    data = content.attachments.get(name)
    if data is None:
        raise EpisodeError(_too_short(path, name, content))
    try:
        refuse_crowd(data)
        return kind.model_validate_json(data)
    except ValidationError as error:
        refuse(f"{path}: the attached {name} is invalid ({first_problems(error)}).", EpisodeError, error)
    except ValueError as error:
        refuse(f"{path}: the attached {name} is invalid: {error}.", EpisodeError, error)


def _too_short(path: Path, name: str, content: Scan) -> str:
    return f"{path} lacks the attachment {name}{f': {content.problem}' if content.problem else ''}. Nothing can be read from it."


def _episode(path: Path, content: Scan, provenance: Provenance, run: RunFacts) -> Episode:
    topics = [(channel, _layout(path, content, channel)) for channel in content.channels.values()]
    groups = {group.name: (channel, layout, group) for channel, layout in topics for group in _groups(channel, layout)}
    if ACTION not in groups:
        refuse(f"{path} holds no actions. It was not written by glbench.", EpisodeError)
    starting = {name: row for name, row in groups.items() if row[2].at_start}
    if not content.chunks or not starting:
        refuse(f"{path} holds no steps{f': {content.problem}' if content.problem else ''}.", EpisodeError)
    channel, layout, _ = next(iter(starting.values()))
    first_layout = layout.some([group.field for _, _, group in starting.values()])
    first = _rows(path, content.chunks[:1], [(channel, first_layout)])[channel.id]
    if not len(first):
        refuse(f"{path} holds no steps: {content.problem}.", EpisodeError)
    rows = _rows(path, content.chunks[1:], topics)
    steps = len(rows[channel.id])
    tops = {channel.id: layout.table(rows[channel.id]) for channel, layout in topics}
    if any((messages["sequence"] != np.arange(1, steps + 1)).any() for messages in tops.values()):
        refuse(f"{path}: the steps are not numbered 1, 2, 3 ...: steps are missing or in another order.", EpisodeError)
    tables: dict[str, Table] = {name: layout.values(rows[channel.id], group.field) for name, (channel, layout, group) in groups.items()}
    start = {name: first_layout.values(first, group.field)[0] for name, (_, _, group) in starting.items()}
    utc = np.concatenate([first_layout.table(first)["log_time"], tops[channel.id]["log_time"]]).astype("datetime64[ns]")
    listed = tuple(group for _, _, group in groups.values())
    return Episode(provenance, run, content.attachments[TASK], listed, tables, start, utc, content.problem)


def _layout(path: Path, content: Scan, channel: Channel) -> Layout:
    schema = content.schemas.get(channel.schema_id)
    if schema is None or schema.encoding != "protobuf":
        refuse(f"{path}: the topic {channel.topic} is not described as protobuf. It was not written by glbench.", EpisodeError)
    return layout_from(schema.data, schema.name)


def _groups(channel: Channel, layout: Layout) -> list[Group]:
    """The groups of columns of one topic."""
    about = channel.metadata
    moment: Moment = "start" if about.get("moment") == "start" else "end"
    groups = []
    for part in layout.parts:
        columns = tuple(Column(name, about.get(f"unit.{name}", "?"), about.get(f"meaning.{name}", "")) for name in part.names)
        at_start = about.get(f"at_start.{part.field}") == "true"
        for column in columns:
            one_line(column.name + column.unit + column.meaning)
            if not column.name.isidentifier():  # in a spreadsheet it could be a formula
                refuse(f"a column is called {quoted(column.name)}")
        groups.append(Group(about.get(f"group.{part.field}", part.field), part.field, part.message, moment, at_start, columns))
    return groups


def _rows(path: Path, chunks: list[bytes], topics: list[tuple[Channel, Layout]]) -> dict[int, NDArray[np.uint8]]:
    """Messages ``(steps, size)`` of all chunks by channel. A torn chunk gives the steps that are whole in it."""
    size = sum(layout.size for _, layout in topics)
    data = b"".join(chunk[: len(chunk) // size * size] for chunk in chunks)
    table = np.frombuffer(data, dtype=np.uint8).reshape(-1, size)
    rows, place = {}, 0
    for channel, layout in topics:
        rows[channel.id] = np.ascontiguousarray(table[:, place : place + layout.size])
        place += layout.size
        if not layout.fits(rows[channel.id], channel.id):
            refuse(f"{path}: the messages do not lie as glbench writes them. Was it written, or changed, by another program?", EpisodeError)
    return rows


def recover(path: Path | str, out: Path | str) -> Episode:
    """Write what can be read of ``path`` to ``out`` and return it. The new file says how many steps it lacks.

    Raises ``EpisodeError`` when nothing can be read, and ``GlbenchError`` when ``out`` cannot be written.
    """
    episode = read_episode(path, partial=True)
    buffer = io.BytesIO()
    words = {"steps": str(episode.steps), "of": str(episode.run.steps), "problem": episode.problem or "none"}
    write_into(buffer, episode, {_RECOVERY: words})
    write_atomically(Path(out), buffer.getvalue())
    return episode


Places = NDArray[np.integer[Any]]
_DAYS = 7
ACTING: tuple[Source, ...] = ("control", "disturbance")  # Sources of what light follows from


class Recorded(Protocol):
    """Columns of a run by name, ``(steps,)`` each: an episode, or a dictionary of them."""

    def __getitem__(self, name: str, /) -> NDArray[np.floating[Any]]: ...


def sums_by(run: Recorded, signals: Signals, places: Places, count: int) -> Floats:
    """Sums of the accounts of ``signals`` over the steps of each of ``count`` ``places`` ``(steps,)``: ``(count, lines)``."""
    return np.stack([np.bincount(places, line_values(run, signals, one), count) for one in signals.accounts], axis=1)


def line_values(run: Recorded, signals: Signals, line: Line) -> Floats:
    """What a line of the accounts has in each step, ``(steps,)``."""
    if line.formula is None:
        return np.asarray(run[line.column], dtype=np.float64) * line.factor
    vectors = {of: np.stack([run[one.name] for one in signals.vector(of)], axis=1) for of in ACTING}
    return line.formula({of: np.asarray(values, dtype=np.float64) for of, values in vectors.items()})


def local_days(local: NDArray[np.datetime64]) -> Places:
    """On which day of the run each step begins, ``(steps,)``; the first day is 0.

    ``local`` are the moments on the clock of the greenhouse, ``(steps + 1,)``. The hour by which a run ends after midnight because summer
    time has begun belongs to its last day.
    """
    days = (local[:-1].astype("datetime64[D]") - local[0].astype("datetime64[D]")).astype(np.int64)
    most = max(1, round(float((local[-1] - local[0]) / np.timedelta64(1, "D"))))
    content: Places = np.minimum(days, most - 1)
    return content


@dataclass(frozen=True, eq=False)
class Weeks:
    """The accounts of a run by week: ``sums`` ``(weeks, lines)``, of light the mean of a day.

    ``first`` is the first day of each week on the clock of the greenhouse, ``(weeks,)`` datetime64[D]. ``days`` is how many days each has,
    ``(weeks,)``; the last one may have fewer than seven.
    """

    first: NDArray[np.datetime64]
    days: Places
    sums: Floats


def weeks_of(run: Recorded, signals: Signals, local: NDArray[np.datetime64]) -> Weeks:
    """The accounts of a run by week; ``local`` as for ``local_days``."""
    days = local_days(local)
    if not len(days):
        refuse("The run has no steps to show.", EpisodeError)
    weeks = days // _DAYS
    count = int(weeks[-1]) + 1
    lengths = np.bincount(np.unique(days) // _DAYS, minlength=count)
    sums = sums_by(run, signals, weeks, count)
    sums[:, [line.kind == "light" for line in signals.accounts]] /= lengths[:, None]
    return Weeks(local[0].astype("datetime64[D]") + np.arange(count) * np.timedelta64(_DAYS, "D"), lengths, sums)


def by_week(episode: Episode) -> pd.DataFrame:
    """The accounts of a run as a DataFrame, one row a week, indexed by its first day on the clock of the greenhouse.

    It has the ``days`` of the week, and a column for each line of the accounts: light is the mean of a day [mol m-2 d-1], all else the sum
    of the week, which for a last week of fewer days is not scaled up. ``frame.attrs`` holds ``units`` and ``titles`` by column. Heat is
    also given as natural gas: 31.65 MJ m-3, its lower heating value. Raises ``EpisodeError`` when the record lacks a column that it needs.
    """
    import pandas as pd

    signals = signals_of(episode.task())
    weeks = weeks_of(episode, signals, episode.local_times)
    index = pd.DatetimeIndex(weeks.first, name="week")
    frame = pd.DataFrame(weeks.sums, columns=[line.name for line in signals.accounts], index=index)
    frame.insert(0, "days", weeks.days)
    frame.attrs["units"] = {one.name: one.unit + (" d-1" if one.kind == "light" else "") for one in signals.accounts}
    frame.attrs["titles"] = {one.name: one.title for one in signals.accounts}
    return frame
