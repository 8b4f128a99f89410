"""The record of every run of an evaluation in one small file: raw actions and rewards, step by step, and the final states.

It is all that a verification needs, because actions and seeds determine everything else; full episodes are made from it by replaying.
"""

from __future__ import annotations

import hashlib
import io
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass
from mcap.opcode import Opcode
from numpy.typing import NDArray
from pydantic import FailFast, Field, ValidationError

from glbench.episodes.episode import PROVENANCE, TASK
from glbench.episodes.header import Facts, Provenance, RunFacts, as_words, canonical, task_of
from glbench.episodes.mcap_file import FRAME, McapWriter, Scan, scan
from glbench.errors import EpisodeError, TaskError, refuse
from glbench.tasks import TaskSpec
from glbench.untrusted import refuse_crowd, visible

LOG_FORMAT = "1"
_RUNS = "runs.json"
_TITLE = "glbench actions"
_BLOCK = 96
_MOST_RUNS = 65_535  # MCAP numbers its channels with 16 bits
_MESSAGE = struct.Struct("<BQHIQQ")  # Head of an MCAP message: opcode, length, channel, sequence, and its time [ns] twice
_TYPE = "glbench.RunPart"
_BYTES, _NUMBERS = (
    FieldDescriptorProto.TYPE_BYTES,
    {"float32": FieldDescriptorProto.TYPE_FLOAT, "float64": FieldDescriptorProto.TYPE_DOUBLE},
)


class RunTable(Facts):
    """How each run ended, in the order of the seeds."""

    runs: Annotated[tuple[RunFacts, ...], FailFast(), Field(min_length=1, max_length=_MOST_RUNS)]


@dataclass(frozen=True, eq=False)
class ActionLog:
    """Raw actions and rewards of all runs of an evaluation.

    ``actions`` ``(steps, n, m)`` are what the agent answered: float32 if that holds them exactly, else float64. ``rewards`` are those of
    every step ``(steps, n)``; both are 0 after a run's end. ``final_states`` ``(n, states)`` are those at the end of each run.
    ``definition`` is the task's, as JSON; ``provenance`` and ``runs`` say where the log comes from and how each run ended.
    """

    provenance: Provenance
    definition: bytes
    runs: tuple[RunFacts, ...]
    actions: NDArray[np.floating]
    rewards: NDArray[np.float64]
    final_states: NDArray[np.float64]

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of the runs."""
        return tuple(run.seed for run in self.runs)

    def task(self) -> TaskSpec:
        """The task, from the definition in the record."""
        return task_of(self.definition)

    @cached_property
    def digest(self) -> str:
        """SHA-256 [hex] over all content; it does not depend on how the file is compressed."""
        sha = hashlib.sha256()
        for part in (canonical(self.provenance), canonical(RunTable(runs=self.runs)), self.definition):
            sha.update(len(part).to_bytes(8, "little") + part)
        sha.update(self.actions.dtype.name.encode())
        for row, run in enumerate(self.runs):
            sha.update(np.ascontiguousarray(self.actions[: run.actions, row]).tobytes())
            sha.update(np.ascontiguousarray(self.rewards[: run.steps, row]).tobytes())
            sha.update(np.ascontiguousarray(self.final_states[row]).tobytes())
        return sha.hexdigest()


def exactly(actions: NDArray[np.float64]) -> NDArray[np.floating]:
    """``actions`` as float32 if no bit is lost, else as they are."""
    narrow = actions.astype(np.float32)
    return narrow if (narrow == actions).all() else actions


def log_bytes(log: ActionLog) -> bytes:
    """The file of ``log``: MCAP, the same bytes for the same content."""
    buffer = io.BytesIO()
    writer, number = McapWriter(buffer), log.actions.dtype.name
    facts = {"format": LOG_FORMAT, **as_words(log.provenance), "runs": str(len(log.runs)), "actions_as": number}
    writer.metadata(_TITLE, facts)
    writer.attachment(PROVENANCE, canonical(log.provenance))
    writer.attachment(_RUNS, canonical(RunTable(runs=log.runs)))
    writer.attachment(TASK, log.definition)
    schema = writer.schema(_TYPE, _fields(number).SerializeToString(deterministic=True))
    columns = {"columns": " ".join(log.provenance.agent.columns), "order": "column by column, each over the steps of the part"}
    channels = [writer.channel(f"/runs/{run.seed}", schema, columns) for run in log.runs]
    start = int(np.datetime64(log.provenance.task.start, "ns").astype(np.int64))
    step_ns = int(log.provenance.task.step_seconds * 1e9)
    part, longest = _part_class(), max((run.actions for run in log.runs), default=0)
    for first in range(0, max(longest, 1), _BLOCK):
        messages, places, position = [], {}, 0
        time = start + first * step_ns
        for row, (run, channel) in enumerate(zip(log.runs, channels, strict=True)):
            last, final = min(first + _BLOCK, run.actions), first + _BLOCK >= run.actions
            if first and first >= run.actions:
                continue
            message = part(first_step=first + 1)
            message.actions = np.ascontiguousarray(log.actions[first:last, row].T).tobytes()
            message.rewards = np.ascontiguousarray(log.rewards[first : min(last, run.steps), row]).tobytes()
            message.final_state = log.final_states[row].tobytes() if final else b""
            data = _framed(channel, first + 1, time, message.SerializeToString(deterministic=True))
            places[channel] = (np.array([time], np.uint64), np.array([position], np.uint64))
            messages.append(data)
            position += len(data)
        writer.chunk(b"".join(messages), places)
    writer.finish()
    return buffer.getvalue()


def is_action_log(path: Path | str) -> bool:
    """Whether ``path`` holds the actions of an evaluation, not one episode. Raises ``EpisodeError`` when it is missing, or no MCAP file."""
    return _TITLE in scan(Path(path)).metadata


def read_log(path: Path | str) -> ActionLog:
    """Read the actions of an evaluation. Raises ``EpisodeError`` if it is missing, cut, damaged, of another kind or model."""
    path = Path(path)
    content = scan(path)
    words = content.metadata.get(_TITLE)
    if words is None or words.get("format") != LOG_FORMAT:
        msg = f"{path} is not a file of recorded actions of this glbench{f' ({content.problem})' if content.problem else ''}."
        raise EpisodeError(msg)
    if content.problem is not None:
        refuse(f"{path}: {content.problem}. Evaluate again with `glbench evaluate ... --fresh`.", EpisodeError)
    try:
        for name in (PROVENANCE, _RUNS):
            refuse_crowd(content.attachments[name])
        provenance = Provenance.model_validate_json(content.attachments[PROVENANCE])
        return _log(content, provenance, RunTable.model_validate_json(content.attachments[_RUNS]).runs, words["actions_as"])
    except TaskError as error:
        refuse(f"{path} is of a task that cannot be made here. {visible(str(error))}", EpisodeError, error)
    except (KeyError, ValueError, IndexError, OverflowError, struct.error, DecodeError, ValidationError) as error:
        refuse(f"{path} is not a whole file of recorded actions ({visible(' '.join(str(error).split())[:200])}).", EpisodeError, error)


def _log(content: Scan, provenance: Provenance, runs: tuple[RunFacts, ...], number: str) -> ActionLog:
    steps, width = provenance.task.steps, len(provenance.agent.columns)
    if number not in _NUMBERS:
        refuse(f"actions are kept as {' or '.join(_NUMBERS)}")
    kind = np.dtype(number)
    if steps * len(runs) * (width * kind.itemsize + 8) > content.largest_content:
        refuse(f"it announces {len(runs)} runs of {steps} steps, far more than it can hold")
    actions = np.zeros((steps, len(runs), width), kind)
    rewards = np.zeros((steps, len(runs)))
    final = np.zeros((len(runs), len(task_of(content.attachments[TASK]).model_value.states)))
    places = {f"/runs/{run.seed}": row for row, run in enumerate(runs)}
    rows = {topic.id: places[topic.topic] for topic in content.channels.values()}
    counted = np.zeros((2, len(runs)), dtype=np.int64)
    part = _part_class()
    started: set[int] = set()
    ended: set[int] = set()
    for chunk in content.chunks:
        for channel, data in _unframed(chunk):
            row, message = rows[channel], part.FromString(data)
            first = message.first_step - 1
            table = np.frombuffer(message.actions, kind).reshape(width, -1).T
            gained = np.frombuffer(message.rewards, np.float64)
            follows = first == counted[0, row] and (first == counted[1, row] or not len(gained))
            if not follows or (not len(table) and row in started):
                refuse(f"the parts of the run with seed {runs[row].seed} do not follow each other")
            started.add(row)
            actions[first : first + len(table), row] = table
            rewards[first : first + len(gained), row] = gained
            counted[:, row] += len(table), len(gained)
            if message.final_state:
                state = np.frombuffer(message.final_state, np.float64)
                if len(state) != final.shape[1]:
                    refuse(f"a final state has {len(state)} values, not {final.shape[1]}")
                final[row] = state
                ended.add(row)
    for row, run in enumerate(runs):
        if row not in ended:
            refuse(f"the run with seed {run.seed} has no final state")
        if tuple(counted[:, row]) != (run.actions, run.steps):
            refuse(
                f"the run with seed {run.seed} has {counted[0, row]} of {run.actions} actions and {counted[1, row]} of {run.steps} rewards"
            )
    return ActionLog(provenance, content.attachments[TASK], runs, actions, rewards, final)


def _framed(channel: int, sequence: int, time: int, data: bytes) -> bytes:
    return _MESSAGE.pack(Opcode.MESSAGE, _MESSAGE.size - FRAME.size + len(data), channel, sequence, time, time) + data


def _unframed(chunk: bytes) -> Iterator[tuple[int, bytes]]:
    position = 0
    while position < len(chunk):
        opcode, length, channel, *_ = _MESSAGE.unpack_from(chunk, position)
        begin, position = position + _MESSAGE.size, position + FRAME.size + length
        if opcode != Opcode.MESSAGE or position < begin:
            refuse("its chunks hold something else than messages")
        yield channel, chunk[begin:position]


def _fields(number: str | None) -> FileDescriptorSet:
    """Message type of one part of a run. ``number`` is that of the actions; without it all lists are bytes.

    A packed list of numbers and the same numbers as bytes are one and the same on the wire. Files describe the lists as what they
    are; reading and writing takes them as bytes, which numpy understands.
    """
    file = FileDescriptorProto(name="glbench/RunPart.proto", package="glbench", syntax="proto3")
    message = file.message_type.add(name="RunPart")
    message.field.add(name="first_step", number=1, type=FieldDescriptorProto.TYPE_UINT32, label=FieldDescriptorProto.LABEL_OPTIONAL)
    for index, name in enumerate(("actions", "rewards", "final_state"), start=2):
        if number is None:
            message.field.add(name=name, number=index, type=_BYTES, label=FieldDescriptorProto.LABEL_OPTIONAL)
        else:
            kind = _NUMBERS[number if name == "actions" else "float64"]
            message.field.add(name=name, number=index, type=kind, label=FieldDescriptorProto.LABEL_REPEATED)
    return FileDescriptorSet(file=[file])


@cache
def _part_class() -> Any:
    pool = DescriptorPool()
    pool.Add(_fields(None).file[0])
    return GetMessageClass(pool.FindMessageTypeByName(_TYPE))
