"""Reading MCAP files from the front, as far as they go: also those whose writer was killed.

The seeking readers want the summary at the end of the file, which a killed writer never wrote. This one takes record by record, checks
the checksums, and says where and why it stopped. Files may be hostile: what they expand to is limited.
"""

from __future__ import annotations

import io
import struct
import zlib
from dataclasses import dataclass, field
from pathlib import Path

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Footer, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

from glbench.errors import EpisodeError
from glbench.untrusted import MIB, read_pieces, read_regular

LARGEST_FILE = 2048 * MIB
"""Larger than any record that glbench writes."""
_LARGEST_CONTENT = 128 * MIB
_LARGEST_RATIO = 32
"""Messages of a file take at most 128 MiB, or 32 times as much as the file. Those of 30 runs of 5760 steps take 6 MiB, 1 to 4 times
as much as their file, because rewards hardly compress."""
_LARGEST_WINDOW = 8 * MIB
_CONTENT = frozenset({Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.DATA_END})
_HEAD = struct.Struct("<BQ")
_MAGIC_SIZE = len(MCAP0_MAGIC)
_CHUNK_HEAD = 8 + 8 + 8 + 4


@dataclass
class Scan:
    """What a file holds. ``problem`` says in words why reading stopped before the end; ``None`` for a whole file.

    ``chunks`` are the messages, chunk by chunk, uncompressed; of a chunk that was cut, as much as can be had.
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    chunks: list[bytes] = field(default_factory=list)
    problem: str | None = None
    size: int = 0
    """Bytes of the file."""
    room: int = _LARGEST_CONTENT
    """Bytes that may still be added to ``chunks``."""
    closed: bool = False
    """Whether the end of the content was seen; only the summary may follow."""


def scan(path: Path) -> Scan:
    """Read ``path`` from the front to its end, or to where it is cut or damaged.

    Raises
    ------
    EpisodeError
        When there is no such file, it cannot be read, or it is no MCAP file at all.
    """
    try:
        data = read_regular(path, LARGEST_FILE)
    except FileNotFoundError as error:
        msg = (
            f"There is no record {path}. Records are not kept in the repository: evaluate the agent again "
            "(`glbench evaluate`), which leaves one."
        )
        raise EpisodeError(msg) from error
    except OSError as error:
        msg = f"Cannot read the record {path}: {error.strerror or error}."
        raise EpisodeError(msg) from error
    if data[:_MAGIC_SIZE] != MCAP0_MAGIC:
        msg = f"{path} is no MCAP file: it does not begin with MCAP's magic bytes."
        raise EpisodeError(msg)
    return scan_bytes(data)


def scan_bytes(data: bytes) -> Scan:
    """Read the bytes of a file that begins with MCAP's magic bytes; see ``scan``."""
    found = Scan(size=len(data), room=largest_content(len(data)))
    position, ended = _MAGIC_SIZE, False
    while position < len(data):
        if ended:
            whole = data[position:] == MCAP0_MAGIC
            found.problem = None if whole else f"the file is cut off, or goes on, behind its footer at byte {position}"
            return found
        if position + _HEAD.size > len(data):
            break
        opcode, length = _HEAD.unpack_from(data, position)
        body = position + _HEAD.size
        if body + length > len(data):
            if opcode == Opcode.CHUNK and not found.closed:
                found.chunks.append(_torn_chunk(data[body:], found.room))
            break
        try:
            found.problem = _take(found, data, position, opcode, length)
        except (McapError, struct.error, ValueError):
            found.problem = f"the record at byte {position} is damaged"
        if found.problem is not None:
            return found
        ended = opcode == Opcode.FOOTER
        position = body + length
    found.problem = f"the file is cut off after {len(data)} bytes"
    return found


def _take(found: Scan, data: bytes, position: int, opcode: int, length: int) -> str | None:
    """Take one whole record into ``found``; a sentence when it is damaged."""
    if found.closed and opcode in _CONTENT:
        return f"content follows the end of the content, at byte {position}"
    body = data[position + _HEAD.size : position + _HEAD.size + length]
    stream = ReadDataStream(io.BytesIO(body))
    if opcode == Opcode.SCHEMA:
        schema = Schema.read(stream)
        found.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = Channel.read(stream)
        found.channels[channel.id] = channel
    elif opcode == Opcode.METADATA:
        metadata = Metadata.read(stream)
        found.metadata[metadata.name] = metadata.metadata
    elif opcode == Opcode.ATTACHMENT:
        if zlib.crc32(body[:-4]) != int.from_bytes(body[-4:], "little"):
            return f"an attachment at byte {position} does not match its checksum"
        attachment = Attachment.read(stream)
        found.attachments[attachment.name] = attachment.data
    elif opcode == Opcode.CHUNK:
        chunk = Chunk.read(stream)
        if chunk.uncompressed_size > found.room:
            return f"the chunk at byte {position} expands to more than a record of this size can hold"
        messages = _messages(chunk)
        if messages is None:
            return f"the chunk at byte {position} does not match its checksum"
        found.chunks.append(messages)
        found.room -= len(messages)
    elif opcode == Opcode.DATA_END:
        found.closed = True
        if zlib.crc32(data[:position]) != DataEnd.read(stream).data_section_crc:
            return "the content does not match its checksum"
    elif opcode == Opcode.FOOTER:
        footer = Footer.read(stream)
        end = position + _HEAD.size + length - 4
        if zlib.crc32(data[footer.summary_start : end]) != footer.summary_crc:
            return "the summary at the end of the file does not match its checksum"
    return None


def largest_content(size: int) -> int:
    """Bytes that the content of a file of ``size`` bytes may expand to."""
    return max(_LARGEST_CONTENT, _LARGEST_RATIO * size)


def _messages(chunk: Chunk) -> bytes | None:
    try:
        data = _decompressed(chunk.data, chunk.uncompressed_size + 1)
    except zstandard.ZstdError:
        return None
    return data if len(data) == chunk.uncompressed_size and zlib.crc32(data) == chunk.uncompressed_crc else None


def _decompressed(packed: bytes, most: int) -> bytes:
    """What ``packed`` expands to, ``most`` bytes of it. The size that it states itself is not believed."""
    with _decompressor().stream_reader(packed) as reader:
        return read_pieces(reader.read, most)


def _decompressor() -> zstandard.ZstdDecompressor:
    return zstandard.ZstdDecompressor(max_window_size=_LARGEST_WINDOW)


def _torn_chunk(data: bytes, room: int) -> bytes:
    """As much of the messages of a chunk without an end as its compression gives back, at most ``room`` bytes."""
    if len(data) < _CHUNK_HEAD + 4:
        return b""
    name_length = int.from_bytes(data[_CHUNK_HEAD : _CHUNK_HEAD + 4], "little")
    packed = data[_CHUNK_HEAD + 4 + name_length + 8 :]
    pieces: list[bytes] = []

    def keep(size: int) -> bytes:
        pieces.append(reader.read(size))
        return pieces[-1]

    try:
        with _decompressor().stream_reader(packed) as reader:
            read_pieces(keep, room)
    except zstandard.ZstdError:  # what came before it is good
        pass
    return b"".join(pieces)
