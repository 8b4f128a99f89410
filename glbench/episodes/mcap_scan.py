"""Reading MCAP files from the front, as far as they go: also those whose writer was killed.

The seeking readers want the summary at the end of the file, which a killed writer never wrote. This one takes record by record, checks
the checksums, and says where and why it stopped.
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


def scan(path: Path) -> Scan:
    """Read ``path`` from the front to its end, or to where it is cut or damaged.

    Raises
    ------
    EpisodeError
        When there is no such file, it cannot be read, or it is no MCAP file at all.
    """
    try:
        data = path.read_bytes()
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
    found = Scan()
    position, ended = _MAGIC_SIZE, False
    while position < len(data):
        if ended and data[position:] == MCAP0_MAGIC:
            return found
        if position + _HEAD.size > len(data):
            break
        opcode, length = _HEAD.unpack_from(data, position)
        body = position + _HEAD.size
        if body + length > len(data):
            if opcode == Opcode.CHUNK:
                found.chunks.append(_torn_chunk(data[body:]))
            break
        try:
            found.problem = _take(found, data, position, opcode, length)
        except (McapError, struct.error, UnicodeDecodeError):
            found.problem = f"the record at byte {position} is damaged"
        if found.problem is not None:
            return found
        ended = opcode == Opcode.FOOTER
        position = body + length
    found.problem = f"the file is cut off after {len(data)} bytes"
    return found


def _take(found: Scan, data: bytes, position: int, opcode: int, length: int) -> str | None:
    """Take one whole record into ``found``; a sentence when it is damaged."""
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
        messages = _messages(Chunk.read(stream))
        if messages is None:
            return f"the chunk at byte {position} does not match its checksum"
        found.chunks.append(messages)
    elif opcode == Opcode.DATA_END:
        if zlib.crc32(data[:position]) != DataEnd.read(stream).data_section_crc:
            return "the content does not match its checksum"
    elif opcode == Opcode.FOOTER:
        footer = Footer.read(stream)
        end = position + _HEAD.size + length - 4
        if zlib.crc32(data[footer.summary_start : end]) != footer.summary_crc:
            return "the summary at the end of the file does not match its checksum"
    return None


def _messages(chunk: Chunk) -> bytes | None:
    try:
        data = zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=chunk.uncompressed_size)
    except zstandard.ZstdError:
        return None
    return data if zlib.crc32(data) == chunk.uncompressed_crc else None


def _torn_chunk(data: bytes) -> bytes:
    """As much of the messages of a chunk without an end as its compression gives back."""
    if len(data) < _CHUNK_HEAD + 4:
        return b""
    name_length = int.from_bytes(data[_CHUNK_HEAD : _CHUNK_HEAD + 4], "little")
    packed = data[_CHUNK_HEAD + 4 + name_length + 8 :]
    try:
        return zstandard.ZstdDecompressor().decompressobj().decompress(packed)
    except zstandard.ZstdError:
        return b""
