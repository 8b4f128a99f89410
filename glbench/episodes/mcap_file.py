"""MCAP files: writing them in bulk, reading them as far as they go, and messages as rows of a table.

**Messages** are protobuf with every field always present, so that all messages of a topic have one length. That makes a message a row of
a numpy table: thousands are written or read in one go, and any protobuf reader understands them. The fields are ``optional``, because
plain proto3 fields leave zeros out. A message has a part for each group of columns, which is a message itself.

**Writing.** The framing of all records but messages is the ``mcap`` library's; messages come as prepared bytes, because one call a
message would take longer than the simulation did. No clock is read: two files with the same content have the same bytes.

**Reading.** The library's readers want the summary at the end of the file, which a killed writer never wrote, or parse every index. Here
records are read one by one from the front, checksums are checked, and the result says where and why reading stopped. Files may be
hostile: what they expand to is limited.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import numpy as np
import zstandard
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from mcap import records as mcap_records
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from glbench.errors import EpisodeError, refuse
from glbench.untrusted import MIB, read_pieces, read_regular

PACKAGE = "glbench"  # Profile and library of the files, and package of their message types
MESSAGE_HEAD = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8")]
)  # fmt: skip
FRAME = struct.Struct("<BQ")  # Opcode and length, with which every record begins and which its length leaves out

_KINDS: dict[int, np.dtype[np.floating]] = {
    FieldDescriptorProto.TYPE_DOUBLE: np.dtype("<f8"),
    FieldDescriptorProto.TYPE_FLOAT: np.dtype("<f4"),
}
_WIRE_TYPE = {8: 1, 4: 5}  # Protobuf's wire type of numbers of 8 and 4 bytes
_NESTED = 2  # Protobuf's wire type of a message within a message

_QUICK = zstandard.ZstdCompressionParameters.from_level(6)
_THOROUGH = zstandard.ZstdCompressionParameters(
    window_log=17, chain_log=14, hash_log=15, search_log=1, min_match=3, target_length=8, strategy=zstandard.STRATEGY_BTOPT
)
"""Finds the runs of three bytes (end of a number, key of the next) that the quick way misses: 8 % smaller in three times the time."""
_DENSE = 0.6
"""Share of its size that a chunk has after the quick way, above which the thorough one is taken: then an episode of 5760 steps
stays below 3 MB whatever the agent does. Baselines are at 0.47 to 0.56, controls at random at 0.62 to 0.68."""
_INDEX_HEAD = struct.Struct("<BQHI")
_INDEX_ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])

LARGEST_FILE = 2048 * MIB  # Larger than any record that glbench writes
_LARGEST_CONTENT = 128 * MIB
_LARGEST_RATIO = 32
"""Messages of a file take at most 128 MiB, or 32 times as much as the file. Those of 30 runs of 5760 steps take 6 MiB, 1 to 4 times
as much as their file, because rewards hardly compress."""
_LARGEST_WINDOW = 8 * MIB
_CONTENT = frozenset({Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.DATA_END})


@dataclass(frozen=True)
class Part:
    """One part of a message: its field's name and number, its own message type, and its numbers, all float64 or all float32."""

    field: str
    index: int
    message: str
    names: tuple[str, ...]
    number: np.dtype[np.floating]

    def place(self, index: int) -> str:
        """Name of the number ``index`` in the table of messages."""
        return f"{self.field}.{index}"


class Layout:
    """How the messages of one type are laid out in memory: a blank one, in which numbers and the head's entries have their places."""

    def __init__(self, name: str, parts: Sequence[Part]) -> None:
        self.name, self.parts = name, tuple(parts)
        body = bytearray()
        places: dict[str, tuple[np.dtype[np.generic], int]] = {
            key: (MESSAGE_HEAD[key], MESSAGE_HEAD.fields[key][1])  # type: ignore[index]
            for key in ("channel", "sequence", "log_time", "publish_time")
        }
        for part in self.parts:
            size = part.number.itemsize
            keys = [_key(number, _WIRE_TYPE[size]) for number in range(1, len(part.names) + 1)]
            body += _key(part.index, _NESTED) + _varint(sum(map(len, keys)) + size * len(keys))
            for index, key in enumerate(keys):
                body += key
                places[part.place(index)] = (part.number, MESSAGE_HEAD.itemsize + len(body))
                body += bytes(size)
        frame = FRAME.pack(Opcode.MESSAGE, MESSAGE_HEAD.itemsize - FRAME.size + len(body))
        self._blank = np.frombuffer(frame + bytes(MESSAGE_HEAD.itemsize - FRAME.size) + body, np.uint8)
        self.size = len(self._blank)
        formats, offsets = zip(*places.values(), strict=True)
        self._numbers = np.dtype({"names": list(places), "formats": formats, "offsets": offsets, "itemsize": self.size})

    def some(self, fields: Sequence[str]) -> Layout:
        """The layout of messages that have only the parts ``fields``."""
        return Layout(self.name, [part for part in self.parts if part.field in fields])

    def messages(
        self, channel: int, sequence: NDArray[np.uint32], time: NDArray[np.uint64], tables: Mapping[str, NDArray[np.floating]]
    ) -> NDArray[np.uint8]:
        """Messages with ``tables[field]`` ``(n, columns)``, step numbers and times [ns] ``(n,)``: their bytes, ``(n, size)``."""
        rows = np.tile(self._blank, (len(sequence), 1))
        numbers = self.table(rows)
        numbers["channel"], numbers["sequence"], numbers["log_time"], numbers["publish_time"] = channel, sequence, time, time
        for part in self.parts:
            for index in range(len(part.names)):
                numbers[part.place(index)] = tables[part.field][:, index]
        return rows

    def table(self, rows: NDArray[np.uint8]) -> NDArray[np.void]:
        """Messages ``(n, size)`` as a table ``(n,)`` of their numbers and the entries of their heads."""
        return rows.view(self._numbers)[:, 0]

    def fits(self, rows: NDArray[np.uint8], channel: int) -> bool:
        """Whether ``rows`` ``(n, size)`` are messages of this layout on ``channel``: without their numbers, they are all blank."""
        bare = rows.copy()
        numbers = self.table(bare)
        here = bool((numbers["channel"] == channel).all())
        for name in self._numbers.names or ():
            numbers[name] = 0
        return here and bool((bare == self._blank).all())

    def values(self, rows: NDArray[np.uint8], field: str) -> NDArray[np.floating]:
        """The numbers ``(n, columns)`` of one part of the messages ``(n, size)``."""
        part = next(part for part in self.parts if part.field == field)
        numbers, table = self.table(rows), np.empty((len(rows), len(part.names)), dtype=part.number)
        for index in range(len(part.names)):
            table[:, index] = numbers[part.place(index)]
        return table

    def descriptor(self) -> bytes:
        """The message type as a serialised FileDescriptorSet, which is how MCAP describes protobuf."""
        file = FileDescriptorProto(name=f"{PACKAGE}/{self.name}.proto", package=PACKAGE, syntax="proto3")
        whole = file.message_type.add(name=self.name)
        for part in self.parts:
            _add_field(whole, part.field, part.index, FieldDescriptorProto.TYPE_MESSAGE).type_name = f".{PACKAGE}.{part.message}"
            message = file.message_type.add(name=part.message)
            kind = next(kind for kind, number in _KINDS.items() if number == part.number)
            for number, name in enumerate(part.names, start=1):
                _add_field(message, name, number, kind)
        serialised: bytes = FileDescriptorSet(file=[file]).SerializeToString(deterministic=True)
        return serialised


def layout_from(descriptor: bytes, full_name: str) -> Layout:
    """Layout that a file's own description of a message type tells.

    Raises ``EpisodeError`` when there is no such message type, or it is not made of parts whose fields are numbers of one type.
    """
    types = {
        f"{file.package}.{message.name}": message for file in FileDescriptorSet.FromString(descriptor).file for message in file.message_type
    }
    parts: list[Part] = []
    for item in types[full_name].field if full_name in types else ():
        part = types.get(item.type_name.lstrip("."))
        kinds = {inner.type for inner in part.field} if part is not None else set()
        if part is None or len(kinds) != 1 or not kinds <= set(_KINDS):
            parts = []
            break
        parts.append(Part(item.name, item.number, part.name, tuple(inner.name for inner in part.field), _KINDS[kinds.pop()]))
    if not parts:
        msg = f"The record describes no message type '{full_name}' made of groups of numbers. It was not written by glbench."
        raise EpisodeError(msg)
    return Layout(full_name.rpartition(".")[2], parts)


def _add_field(message: DescriptorProto, name: str, number: int, kind: int) -> FieldDescriptorProto:
    index = len(message.oneof_decl)
    message.oneof_decl.add(name=f"_{name}")
    optional = FieldDescriptorProto.LABEL_OPTIONAL
    return message.field.add(name=name, number=number, type=kind, label=optional, proto3_optional=True, oneof_index=index)


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


Index = Mapping[int, tuple[NDArray[np.uint64], NDArray[np.uint64]]]
"""Times [ns] and places within the chunk of the messages of each channel."""


class McapWriter:
    """An MCAP file that grows chunk by chunk. ``finish`` makes it whole; without it, what was flushed can be recovered."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._position = self._checksum = 0
        self._schemas: list[mcap_records.Schema] = []
        self._channels: list[mcap_records.Channel] = []
        self._chunks: list[mcap_records.ChunkIndex] = []
        self._attachments: list[mcap_records.AttachmentIndex] = []
        self._metadata: list[mcap_records.MetadataIndex] = []
        self._counts: dict[int, int] = {}
        self._append(MCAP0_MAGIC)
        self._write(mcap_records.Header(PACKAGE, PACKAGE))

    def schema(self, name: str, data: bytes) -> int:
        """Add a message type of protobuf; its number."""
        self._schemas.append(mcap_records.Schema(id=len(self._schemas) + 1, name=name, encoding="protobuf", data=data))
        self._write(self._schemas[-1])
        return len(self._schemas)

    def channel(self, topic: str, schema: int, metadata: Mapping[str, str]) -> int:
        """Add a channel of protobuf messages; its number."""
        self._channels.append(mcap_records.Channel(len(self._channels) + 1, topic, "protobuf", dict(metadata), schema))
        self._write(self._channels[-1])
        self._counts[len(self._channels)] = 0
        return len(self._channels)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a table of words."""
        offset = self._position
        length = self._write(mcap_records.Metadata(name=name, metadata=dict(values)))
        self._metadata.append(mcap_records.MetadataIndex(offset, length, name))

    def attachment(self, name: str, data: bytes) -> None:
        """Add a JSON file within the file."""
        kind, offset = "application/json", self._position
        length = self._write(mcap_records.Attachment(0, 0, name, kind, data))
        self._attachments.append(mcap_records.AttachmentIndex(offset, length, 0, 0, len(data), name, kind))

    def chunk(self, messages: bytes, index: Index) -> None:
        """Add a chunk of messages, with their index, and hand it to the system."""
        offset = self._position
        started = min(int(times.min()) for times, _ in index.values())
        ended = max(int(times.max()) for times, _ in index.values())
        packed = zstandard.ZstdCompressor(compression_params=_QUICK).compress(messages)
        if len(packed) > _DENSE * len(messages):
            packed = zstandard.ZstdCompressor(compression_params=_THOROUGH).compress(messages)
        length = self._write(mcap_records.Chunk("zstd", packed, ended, started, zlib.crc32(messages), len(messages)))
        places = {}
        for channel, (times, offsets) in index.items():
            places[channel] = self._position
            entries = np.empty(len(times), dtype=_INDEX_ENTRY)
            entries["time"], entries["offset"] = times, offsets
            head = _INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, entries.nbytes + 6, channel, entries.nbytes)
            self._append(head + entries.tobytes())
            self._counts[channel] += len(times)
        index_length = self._position - offset - length
        self._chunks.append(
            mcap_records.ChunkIndex(length, offset, "zstd", len(packed), ended, index_length, places, started, len(messages))
        )
        self._file.flush()

    def finish(self) -> None:
        """Write what makes the file whole: the end mark and the summary."""
        self._write(mcap_records.DataEnd(self._checksum))
        start, summary, offsets = self._position, RecordBuilder(), []
        for opcode, records in self._summary():
            began = summary.count
            for record in records:
                record.write(summary)
            offsets.append(mcap_records.SummaryOffset(opcode, start + began, summary.count - began))
        offset_start = start + summary.count
        for offset in offsets:
            offset.write(summary)
        text: bytes = summary.end()  # type: ignore[no-untyped-call]
        footer = _bytes_of(mcap_records.Footer(start, offset_start, 0))[:-4]
        self._append(text + footer + zlib.crc32(footer, zlib.crc32(text)).to_bytes(4, "little") + MCAP0_MAGIC)
        self._file.flush()

    def _summary(self) -> list[tuple[int, Sequence[mcap_records.McapRecord]]]:
        statistics = mcap_records.Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_end_time=max((chunk.message_end_time for chunk in self._chunks), default=0),
            message_start_time=min((chunk.message_start_time for chunk in self._chunks), default=0),
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        return [
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        ]

    def _write(self, record: mcap_records.McapRecord) -> int:
        return self._append(_bytes_of(record))

    def _append(self, data: bytes) -> int:
        self._file.write(data)
        self._checksum = zlib.crc32(data, self._checksum)
        self._position += len(data)
        return len(data)


def _bytes_of(record: mcap_records.McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


@dataclass
class Scan:
    """What a file holds. ``problem`` says in words why reading stopped before the end; ``None`` for a whole file.

    ``chunks`` are the messages, chunk by chunk, uncompressed; of a chunk that was cut, what its compression gives back.
    """

    size: int
    """Bytes of the file."""
    schemas: dict[int, mcap_records.Schema] = field(default_factory=dict)
    channels: dict[int, mcap_records.Channel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    chunks: list[bytes] = field(default_factory=list)
    problem: str | None = None

    @property
    def largest_content(self) -> int:
        """Bytes that the content of the file may expand to."""
        return max(_LARGEST_CONTENT, _LARGEST_RATIO * self.size)


def scan(path: Path) -> Scan:
    """Read ``path`` to its end, or to where it is cut or damaged. Raises ``EpisodeError`` when it is missing, unreadable, no MCAP file."""
    try:
        data = read_regular(path, LARGEST_FILE)
    except FileNotFoundError as error:
        msg = (
            f"There is no record {path}. Records are not kept in the repository: evaluate the agent again "
            "(`glbench evaluate`), which leaves one."
        )
        raise EpisodeError(msg) from error
    except OSError as error:
        refuse(f"Cannot read the record {path}: {error.strerror or error}.", EpisodeError, error)
    if not data.startswith(MCAP0_MAGIC):
        refuse(f"{path} is no MCAP file: it does not begin with MCAP's magic bytes.", EpisodeError)
    return scan_bytes(data)


def scan_bytes(data: bytes) -> Scan:
    """Read the bytes of a file that begins with MCAP's magic bytes; see ``scan``."""
    content, position, closed = Scan(len(data)), len(MCAP0_MAGIC), False
    while position + FRAME.size <= len(data):
        opcode, length = FRAME.unpack_from(data, position)
        end = position + FRAME.size + length
        if closed and opcode in _CONTENT:
            content.problem = f"content follows the end of the content, at byte {position}"
        elif end > len(data) and opcode != Opcode.CHUNK:
            break
        else:
            try:
                content.problem = _take(content, data, position, opcode, length)
            except (McapError, struct.error, ValueError, OverflowError):
                content.problem = f"the record at byte {position} is damaged"
        if end > len(data):
            break
        if opcode == Opcode.FOOTER and content.problem is None and data[end:] != MCAP0_MAGIC:
            content.problem = f"the file is cut off, or continues behind its footer at byte {end}"
        if content.problem is not None or opcode == Opcode.FOOTER:
            return content
        closed, position = closed or opcode == Opcode.DATA_END, end
    content.problem = f"the file is cut off after {len(data)} bytes"
    return content


def _take(content: Scan, data: bytes, position: int, opcode: int, length: int) -> str | None:
    """Take one record into ``content``; a sentence when it is damaged."""
    body = data[position + FRAME.size : position + FRAME.size + length]
    stream = ReadDataStream(io.BytesIO(body))
    if opcode == Opcode.SCHEMA:
        schema = mcap_records.Schema.read(stream)
        content.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = mcap_records.Channel.read(stream)
        content.channels[channel.id] = channel
    elif opcode == Opcode.METADATA:
        metadata = mcap_records.Metadata.read(stream)
        content.metadata[metadata.name] = metadata.metadata
    elif opcode == Opcode.ATTACHMENT:
        if zlib.crc32(body[:-4]) != int.from_bytes(body[-4:], "little"):
            return f"an attachment at byte {position} does not match its checksum"
        attachment = mcap_records.Attachment.read(stream)
        content.attachments[attachment.name] = attachment.data
    elif opcode == Opcode.CHUNK:
        return _take_chunk(content, mcap_records.Chunk.read(stream), position, torn=len(body) < length)
    elif opcode == Opcode.DATA_END and zlib.crc32(data[:position]) != mcap_records.DataEnd.read(stream).data_section_crc:
        return "the content does not match its checksum"
    elif opcode == Opcode.FOOTER:
        footer = mcap_records.Footer.read(stream)
        if zlib.crc32(data[footer.summary_start : position + FRAME.size + length - 4]) != footer.summary_crc:
            return "the summary at the end of the file does not match its checksum"
    return None


def _take_chunk(content: Scan, chunk: mcap_records.Chunk, position: int, *, torn: bool) -> str | None:
    """Take the messages of a chunk; of a torn one, as many as its compression gives back."""
    room = content.largest_content - sum(map(len, content.chunks))
    if chunk.uncompressed_size > room:
        return f"the chunk at byte {position} expands to more than a record of this size can hold"
    # The size that is stated is not believed.
    messages = _expanded(chunk.data, chunk.uncompressed_size + 1)
    if not torn and (len(messages) != chunk.uncompressed_size or zlib.crc32(messages) != chunk.uncompressed_crc):
        return f"the chunk at byte {position} does not match its checksum"
    content.chunks.append(messages)
    return None


def _expanded(packed: bytes, most: int) -> bytes:
    """What ``packed`` expands to, ``most`` bytes of it; of damaged bytes, what comes before the damage."""
    pieces: list[bytes] = []

    def keep(size: int) -> bytes:
        try:
            pieces.append(reader.read(size))
        except zstandard.ZstdError:
            return b""
        return pieces[-1]

    with zstandard.ZstdDecompressor(max_window_size=_LARGEST_WINDOW).stream_reader(packed) as reader:
        return read_pieces(keep, most)
