"""The bytes of a group's messages: protobuf with every field always present, so that all messages of a group have one length.

That makes a message a row of a numpy table: thousands are written or read in one go, and any protobuf reader understands them. The
fields are ``optional``, because plain proto3 fields leave zeros out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from mcap.opcode import Opcode
from numpy.typing import NDArray

from glbench.episodes.columns import Group
from glbench.errors import EpisodeError

PACKAGE = "glbench"
_DOUBLE, _FLOAT = FieldDescriptorProto.TYPE_DOUBLE, FieldDescriptorProto.TYPE_FLOAT
_KINDS: dict[int, tuple[str, int]] = {_DOUBLE: ("<f8", 1), _FLOAT: ("<f4", 5)}
"""Type of a field -> type of the number, and protobuf's wire type."""
_HEAD: list[tuple[str, str]] = [
    ("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8"),
]  # fmt: skip
_HEAD_SIZE = np.dtype(_HEAD).itemsize
_LENGTH_SIZE = 9
"""Bytes of opcode and length, which a record's length leaves out."""


@dataclass(frozen=True)
class Layout:
    """Fields of one message type and how a message, with MCAP's head, lies in memory."""

    name: str
    fields: tuple[str, ...]
    number: np.dtype[np.floating]
    """float64, or float32: the type of all fields."""
    record: np.dtype[np.void]

    def messages(
        self, channel: int, sequence: NDArray[np.uint32], time: NDArray[np.uint64], values: NDArray[np.floating]
    ) -> NDArray[np.void]:
        """Messages with ``values`` ``(n, fields)``, step numbers and times [ns] ``(n,)``, as rows of a table ``(n,)``."""
        rows = np.empty(len(values), dtype=self.record)
        rows["opcode"], rows["channel"] = Opcode.MESSAGE, channel
        rows["length"] = self.record.itemsize - _LENGTH_SIZE
        rows["sequence"], rows["log_time"], rows["publish_time"] = sequence, time, time
        for number in range(1, len(self.fields) + 1):
            tag = _tag(number, _KINDS[_DOUBLE if self.number.itemsize == 8 else _FLOAT][1])
            rows[f"tag{number}"] = int.from_bytes(tag, "little")
            rows[f"value{number}"] = values[:, number - 1]
        return rows

    def values(self, rows: NDArray[np.void]) -> NDArray[np.floating]:
        """The numbers ``(n, fields)`` of messages ``(n,)``."""
        table = np.empty((len(rows), len(self.fields)), dtype=self.number)
        for number in range(1, len(self.fields) + 1):
            table[:, number - 1] = rows[f"value{number}"]
        return table


def layout_of(group: Group, number: np.dtype[np.floating]) -> Layout:
    """Layout of ``group`` with fields of type ``number`` (float64 or float32)."""
    return _layout(group.message, group.names, number)


def descriptor_of(group: Group, layout: Layout) -> bytes:
    """The message type of ``group`` as a serialised FileDescriptorSet, which is how MCAP describes protobuf."""
    file = FileDescriptorProto(name=f"{PACKAGE}/{group.message}.proto", package=PACKAGE, syntax="proto3")
    message = file.message_type.add(name=group.message)
    kind = _DOUBLE if layout.number.itemsize == 8 else _FLOAT
    for index, name in enumerate(group.names):
        message.field.add(
            name=name,
            number=index + 1,
            type=kind,
            label=FieldDescriptorProto.LABEL_OPTIONAL,
            proto3_optional=True,
            oneof_index=index,
        )
        message.oneof_decl.add(name=f"_{name}")
    serialised: bytes = FileDescriptorSet(file=[file]).SerializeToString(deterministic=True)
    return serialised


def layout_from(descriptor: bytes, full_name: str) -> Layout:
    """Layout that a file's own description of a message type tells.

    Raises
    ------
    EpisodeError
        When there is no such message type, or its fields are not numbers of one type.
    """
    files = FileDescriptorSet.FromString(descriptor).file
    for file in files:
        for message in file.message_type:
            if f"{file.package}.{message.name}" == full_name:
                kinds = {field.type for field in message.field}
                if len(kinds) == 1 and kinds <= set(_KINDS):
                    number = np.dtype(_KINDS[kinds.pop()][0])
                    return _layout(message.name, tuple(field.name for field in message.field), number)
    msg = f"The record describes no message type '{full_name}' made of numbers of one kind. It was not written by glbench."
    raise EpisodeError(msg)


def _layout(name: str, fields: tuple[str, ...], number: np.dtype[np.floating]) -> Layout:
    kind = number.str if number.itemsize == 8 else "<f4"
    parts = list(_HEAD)
    for index in range(1, len(fields) + 1):
        parts += [(f"tag{index}", "u1" if index < 16 else "<u2"), (f"value{index}", kind)]
    return Layout(name, fields, np.dtype(kind), np.dtype(parts))


def _tag(number: int, wire_type: int) -> bytes:
    """Protobuf's key of a field: number and wire type as a varint of one or two bytes (numbers below 2048)."""
    key = number << 3 | wire_type
    return bytes([key]) if key < 0x80 else bytes([key & 0x7F | 0x80, key >> 7])
