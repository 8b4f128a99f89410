"""The bytes of a topic's messages: protobuf with every field always present, so that all messages of a topic have one length.

That makes a message a row of a numpy table: thousands are written or read in one go, and any protobuf reader understands them. The
fields are ``optional``, because plain proto3 fields leave zeros out. A message has a part for each group of columns, which is a
message itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from mcap.opcode import Opcode
from numpy.typing import NDArray

from glbench.episodes.columns import MESSAGES, Group
from glbench.errors import EpisodeError

PACKAGE = "glbench"
_DOUBLE, _FLOAT = FieldDescriptorProto.TYPE_DOUBLE, FieldDescriptorProto.TYPE_FLOAT
_PART = FieldDescriptorProto.TYPE_MESSAGE
_KINDS: dict[int, str] = {_DOUBLE: "<f8", _FLOAT: "<f4"}
_WIRE_TYPE = {8: 1, 4: 5}
"""Protobuf's wire type of numbers of 8 and 4 bytes."""
_NESTED = 2
"""Protobuf's wire type of a message within a message."""
_HEAD: list[tuple[str, str]] = [
    ("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8"),
]  # fmt: skip
_LENGTH_SIZE = 9
"""Bytes of opcode and length, which a record's length leaves out."""


@dataclass(frozen=True)
class Part:
    """One part of a message: its field's name and number, its own message type, and its numbers, all float64 or all float32."""

    field: str
    index: int
    message: str
    names: tuple[str, ...]
    number: np.dtype[np.floating]

    @property
    def size(self) -> int:
        """Bytes of the part, without its own key and length."""
        return sum(len(_key(k, _WIRE_TYPE[self.number.itemsize])) for k in self._numbers) + self.number.itemsize * len(
            self.names
        )

    @property
    def _numbers(self) -> range:
        return range(1, len(self.names) + 1)

    def place(self, number: int) -> str:
        """Name of the table's column that holds field ``number``."""
        return f"{self.field}.{number}"

    def constants(self) -> dict[str, bytes]:
        """Bytes that are the same in every message, by the table's columns: keys and the length."""
        keys = {f"{self.place(k)}:key": _key(k, _WIRE_TYPE[self.number.itemsize]) for k in self._numbers}
        return {f"{self.field}:head": _key(self.index, _NESTED) + _varint(self.size), **keys}

    def columns(self) -> list[tuple[str, str]]:
        """The table's columns, in the order of the bytes."""
        kinds = {name: f"V{len(value)}" for name, value in self.constants().items()}
        head = f"{self.field}:head"
        listed = [(head, kinds[head])]
        for k in self._numbers:
            key = f"{self.place(k)}:key"
            listed += [(key, kinds[key]), (self.place(k), _KINDS[_kind(self.number)])]
        return listed


@dataclass(frozen=True)
class Layout:
    """The parts of one message type, and how a message, with MCAP's head, lies in memory."""

    name: str
    parts: tuple[Part, ...]
    record: np.dtype[np.void]

    def some(self, fields: Sequence[str]) -> Layout:
        """The layout of messages that have only the parts ``fields``."""
        return _layout(self.name, tuple(part for part in self.parts if part.field in fields))

    def messages(
        self,
        channel: int,
        sequence: NDArray[np.uint32],
        time: NDArray[np.uint64],
        tables: Mapping[str, NDArray[np.floating]],
    ) -> NDArray[np.void]:
        """Messages with ``tables[field]`` ``(n, columns)``, step numbers and times [ns] ``(n,)``, as rows of a table ``(n,)``."""
        rows = np.empty(len(sequence), dtype=self.record)
        rows["opcode"], rows["channel"] = Opcode.MESSAGE, channel
        rows["length"] = self.record.itemsize - _LENGTH_SIZE
        rows["sequence"], rows["log_time"], rows["publish_time"] = sequence, time, time
        for part in self.parts:
            for name, constant in part.constants().items():
                rows[name] = np.void(constant)
            for index in range(len(part.names)):
                rows[part.place(index + 1)] = tables[part.field][:, index]
        return rows

    def fits(self, rows: NDArray[np.void], channel: int) -> bool:
        """Whether ``rows`` ``(n,)`` are messages of this layout on ``channel``."""
        heads = (rows["opcode"] == Opcode.MESSAGE) & (rows["channel"] == channel)
        heads &= rows["length"] == self.record.itemsize - _LENGTH_SIZE
        bodies = (
            (rows[name] == np.void(constant)).all()
            for part in self.parts
            for name, constant in part.constants().items()
        )
        return bool(heads.all()) and all(bodies)

    def values(self, rows: NDArray[np.void], field: str) -> NDArray[np.floating]:
        """The numbers ``(n, columns)`` of one part of the messages ``(n,)``."""
        part = next(part for part in self.parts if part.field == field)
        table = np.empty((len(rows), len(part.names)), dtype=part.number)
        for index in range(len(part.names)):
            table[:, index] = rows[part.place(index + 1)]
        return table


def layout_of(topic: str, groups: Sequence[Group], action: np.dtype[np.floating]) -> Layout:
    """Layout of ``topic`` with the parts ``groups``; raw actions are of type ``action`` (float64 or float32), all else float64."""
    parts = (
        Part(group.field, index, group.message, group.names, action if group.name == "action" else np.dtype("<f8"))
        for index, group in enumerate(groups, start=1)
    )
    return _layout(MESSAGES[topic], tuple(parts))


def descriptor_of(layout: Layout) -> bytes:
    """The message type as a serialised FileDescriptorSet, which is how MCAP describes protobuf."""
    file = FileDescriptorProto(name=f"{PACKAGE}/{layout.name}.proto", package=PACKAGE, syntax="proto3")
    whole = file.message_type.add(name=layout.name)
    for part in layout.parts:
        field = _add_field(whole, part.field, part.index, _PART)
        field.type_name = f".{PACKAGE}.{part.message}"
        message = file.message_type.add(name=part.message)
        for number, name in enumerate(part.names, start=1):
            _add_field(message, name, number, _kind(part.number))
    serialised: bytes = FileDescriptorSet(file=[file]).SerializeToString(deterministic=True)
    return serialised


def layout_from(descriptor: bytes, full_name: str) -> Layout:
    """Layout that a file's own description of a message type tells.

    Raises
    ------
    EpisodeError
        When there is no such message type, or it is not made of parts whose fields are numbers of one type.
    """
    types = {
        f"{file.package}.{message.name}": message
        for file in FileDescriptorSet.FromString(descriptor).file
        for message in file.message_type
    }
    parts: list[Part] = []
    for field in types[full_name].field if full_name in types else ():
        part = types.get(field.type_name.lstrip("."))
        kinds = {inner.type for inner in part.field} if part is not None else set()
        if part is None or len(kinds) != 1 or not kinds <= set(_KINDS):
            parts = []
            break
        names = tuple(inner.name for inner in part.field)
        parts.append(Part(field.name, field.number, part.name, names, np.dtype(_KINDS[kinds.pop()])))
    if not parts:
        msg = f"The record describes no message type '{full_name}' made of groups of numbers. It was not written by glbench."
        raise EpisodeError(msg)
    return _layout(full_name.rpartition(".")[2], tuple(parts))


def _layout(name: str, parts: tuple[Part, ...]) -> Layout:
    return Layout(name, parts, np.dtype(_HEAD + [column for part in parts for column in part.columns()]))


def _add_field(message: DescriptorProto, name: str, number: int, kind: int) -> FieldDescriptorProto:
    index = len(message.oneof_decl)
    message.oneof_decl.add(name=f"_{name}")
    optional = FieldDescriptorProto.LABEL_OPTIONAL
    field: FieldDescriptorProto = message.field.add(
        name=name, number=number, type=kind, label=optional, proto3_optional=True, oneof_index=index
    )
    return field


def _kind(number: np.dtype[np.floating]) -> int:
    kind: int = _DOUBLE if number.itemsize == 8 else _FLOAT
    return kind


def _key(number: int, wire_type: int) -> bytes:
    """Protobuf's key of a field."""
    return _varint(number << 3 | wire_type)


def _varint(value: int) -> bytes:
    """Protobuf's number of as many bytes as it needs, seven bits each."""
    parts = bytearray()
    while value >= 0x80:
        parts.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*parts, value])
