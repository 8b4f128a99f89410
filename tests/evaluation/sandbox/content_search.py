"""Searches files by content for number series that nobody in a sandbox may have, whatever the file's name, form or unit.

A series is known by windows of 24 numbers. A window is found where numbers rise and fall in the same order and fit it after a change of
scale and origin, so that degC, K, tenths of degC and plans on another scale are all found. Numbers are read from text (columns split by
separators, columns of fixed width, or all numbers in their order), from arrays in Parquet, Arrow, HDF5, npy and npz, and from raw bytes as
little-endian numbers at every offset; zip, tar, gzip, bzip2, xz and zstd are unpacked. Digests of results are searched as text.

It needs numpy alone, so that an agent can carry it into its sandbox.
"""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import os
import re
import stat
import tarfile
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

WINDOW = 24
"""Numbers of a window."""
_TOLERANCE = 4e-3
"""How far a number may lie from the window's, as a share of its range: units are rounded."""
_MOST_ALIKE = 8
_TABLE = 1 << 22
_LOOKS = (5, 11, 17, 2, 20)
"""Places of a window at which numbers are compared first; few that do not fit get past them."""
_LARGEST = 256 << 20
_CHUNK = 1 << 16
"""Numbers at a time, so that they stay in the processor's cache."""
_LARGE_ARRAY, _LARGEST_ARRAY = 1 << 22, 1 << 26
"""Numbers of an array that is searched along its last axis only, and of one that is not searched."""
_SKIPPED = {
    b"\x7fELF": "program", b"BC\xc0\xde": "program", b"JM\x01\x00": "program", b"!<arch>\n": "program", b"\xca\xfe\xba\xbe": "program",
    b"\xda\xda\xfe\xca": "program", b"\xa2\xab\x0b\xf0": "program",
    b"\x89PNG": "picture", b"GIF8": "picture", b"\xff\xd8\xff": "picture", b"OTTO": "font", b"\x00\x01\x00\x00\x00": "font",
    b"wOF2": "font", b"wOFF": "font", b"ttcf": "font",
}  # fmt: skip
"""Beginnings of files of machine code (the last two: Java's modules and its archive of loaded classes), pictures and fonts; Python's
compiled modules are told by the rest of their magic number."""
_BINARY = ("<f8", "<f4", "<i8", "<i4", "<i2")
_NUMBER = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_FIRST = frozenset(bytes([letter]) for letter in b"+-.0123456789")
"""What a number begins with."""
_PAIR = re.compile(rb'"([^"\n]{1,80})"\s*:\s*([-+]?\d+\.?\d*(?:[eE][-+]?\d+)?)')
_DIGEST = re.compile(rb"[0-9a-f]{64,}")
_HEX = np.zeros(256, dtype=np.bool_)
_HEX[list(b"0123456789abcdef")] = True
_CONTROL = bytes([*range(9), *range(14, 32)])
_DIGITS = np.zeros(256, dtype=np.bool_)
_DIGITS[ord("0") : ord("9") + 1] = True
_BLANK = np.zeros(256, dtype=np.bool_)
_BLANK[list(b" \t\r\n,;|")] = True
_BLOCK = 512


@dataclass(frozen=True)
class Needles:
    """What to search for: windows ``(n, WINDOW)`` and of which series each is, digests, and first seeds with the number of runs."""

    windows: NDArray[np.float32]
    of: NDArray[np.int32]
    names: tuple[str, ...]
    digests: frozenset[bytes]
    seeds: tuple[tuple[int, int], ...]

    @classmethod
    def collect(cls, series: Iterable[tuple[str, Any, int]], digests: Iterable[str], seeds: Iterable[tuple[int, int]]) -> Needles:
        """Windows of ``(name, numbers, stride)``: of every stretch of ``stride`` numbers the one that says most, if any says enough."""
        windows, of, names = [], [], []
        for name, numbers, stride in series:
            every = np.lib.stride_tricks.sliding_window_view(np.asarray(numbers, dtype=np.float64), WINDOW)
            turns = np.sum(np.diff(np.sign(np.diff(every)), axis=1) != 0, axis=1)
            moves = np.sum(np.diff(every) != 0, axis=1)
            levels = np.sum(np.diff(np.sort(every, axis=1)) != 0, axis=1) + 1
            score = np.where((moves >= 14) & (turns >= 5) & (levels >= 8), moves + turns, 0)
            for start in range(0, len(every), stride):
                best = start + int(np.argmax(score[start : start + stride]))
                if score[best]:
                    windows.append(every[best])
                    of.append(len(names))
            names.append(name)
        stacked = np.array(windows, dtype=np.float32).reshape(-1, WINDOW)
        return cls(stacked, np.array(of, dtype=np.int32), tuple(names), frozenset(map(str.encode, digests)), tuple(sorted(set(seeds))))

    def save(self, file: Path) -> None:
        """Write what ``load`` reads."""
        np.savez_compressed(
            file, windows=self.windows, of=self.of, names=np.array(self.names), digests=np.array(sorted(self.digests), dtype="S64"),
            seeds=np.array(self.seeds, dtype=np.int64).reshape(-1, 2),
        )  # fmt: skip

    @classmethod
    def load(cls, file: Path) -> Needles:
        """The needles of a file."""
        with np.load(file) as data:
            seeds = tuple((int(first), int(runs)) for first, runs in data["seeds"])
            return cls(data["windows"], data["of"], tuple(data["names"]), frozenset(data["digests"].tolist()), seeds)


@dataclass
class Search:
    """A search and what it has found: pairs of a file (with the member, for an archive) and the name of the series."""

    needles: Needles
    found: set[tuple[str, str]] = field(default_factory=set)
    looked: Counter[str] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        windows = self.needles.windows.astype(np.float64)
        patterns = _patterns(windows)[:, 0]
        order = np.argsort(patterns, kind="stable")
        # Some ups and downs, such as up and down in turns, are those of many windows and of much else: a few of them will do.
        order = order[np.arange(len(order)) - np.searchsorted(patterns[order], patterns[order]) < _MOST_ALIKE]
        self._patterns, self._windows, self._of = patterns[order], _on_one_scale(windows[order]), self.needles.of[order]
        self._lowest, self._highest = self._windows.argmin(axis=1), self._windows.argmax(axis=1)
        self._table = np.zeros(_TABLE, dtype=np.bool_)
        self._table[self._patterns % _TABLE] = True
        self._seed_bytes = [
            (np.arange(first, first + runs).astype(kind).tobytes(), np.array([first + runs]).astype(kind).tobytes())
            for first, runs in self.needles.seeds
            for kind in ("<u2", "<u4", "<u8")
        ]
        firsts = "|".join(str(first) for first, _ in self.needles.seeds)
        self._seed = re.compile(rf"seeds?\W{{1,8}}(?:{firsts})\b".encode()) if firsts else None

    def folder(self, root: Path, leave_out: Iterable[Path] = ()) -> None:
        """Search all files below ``root``, but those below ``leave_out``."""
        left, waiting, seen = set(leave_out), [root], set()
        while waiting:
            place = waiting.pop()
            if place in left:
                continue
            try:
                status = place.lstat()
                if stat.S_ISDIR(status.st_mode):
                    waiting += place.iterdir()
                elif stat.S_ISREG(status.st_mode) and (status.st_dev, status.st_ino) not in seen:
                    seen.add((status.st_dev, status.st_ino))
                    self.file(place)
            except OSError:
                self.looked["unreadable"] += 1

    def file(self, path: Path) -> None:
        """Search a file."""
        with path.open("rb") as file:
            head = file.read(16)
            kind = _kind(head)
            # Python makes room for as many bytes as it is asked for.
            size = min(os.fstat(file.fileno()).st_size, _LARGEST)
            data = b"" if kind is not None else head + file.read(size)
        self.looked[kind or "searched"] += 1
        self.content(str(path), data)

    def content(self, name: str, data: bytes, depth: int = 0) -> None:
        """Search bytes, and what they hold where they are an archive."""
        if len(data) < 40 or _kind(data[:16]) is not None:
            return
        self._texts(name, data)
        try:
            for what, inner in _unpacked(data):
                if isinstance(inner, bytes):
                    if depth < 4:
                        self.content(f"{name}!{what}", inner, depth + 1)
                else:
                    self._array(f"{name}!{what}", inner)
        except _DAMAGED:
            self.looked["damaged"] += 1

    def _texts(self, name: str, data: bytes) -> None:
        if any(digest in self.needles.digests for digest in _digests(data)):
            self.found.add((name, "a released result"))
        if self._seed is not None and self._seed.search(data):
            self.found.add((name, "seeds"))
        for seeds, following in self._seed_bytes:
            place = data.find(seeds) + len(seeds)
            # A table of characters goes on.
            if place >= len(seeds) and data[place : place + len(following)] != following:
                self.found.add((name, "seeds"))
        if _is_text(data):
            for series in _numbers_of_text(data):
                self._series(name, series)
        elif not any(data.startswith(magic) for magic in _ARCHIVES):
            for series in _numbers_of_bytes(data):
                self._series(name, series)

    def _array(self, name: str, array: NDArray[Any]) -> None:
        if array.dtype.kind not in "iuf" or array.size < WINDOW:
            return
        if array.size > _LARGEST_ARRAY:
            self.looked["large array"] += 1
            return
        values = array.astype(np.float64)
        for first, runs in self.needles.seeds:
            if values.shape == (runs,) and np.array_equal(values, np.arange(first, first + runs)):
                self.found.add((name, "seeds"))
        for axis in range(values.ndim):
            if values.shape[axis] >= WINDOW and (values.size < _LARGE_ARRAY or axis == values.ndim - 1):
                self._series(name, np.moveaxis(values, axis, -1).reshape(-1))

    def _series(self, name: str, series: NDArray[Any]) -> None:
        for start in range(0, len(series) - WINDOW + 1, _CHUNK):
            part = series[start : start + _CHUNK + WINDOW - 1]
            patterns = _patterns(part)
            places = np.flatnonzero(self._table[patterns % _TABLE])
            if len(places):
                first, end = (np.searchsorted(self._patterns, patterns[places], side) for side in ("left", "right"))
                alike = end - first
                rows = np.arange(alike.sum()) + np.repeat(first - np.cumsum(alike) + alike, alike)
                self._compare(name, part, np.repeat(places, alike), rows)

    def _compare(self, name: str, part: NDArray[Any], places: NDArray[np.intp], rows: NDArray[np.intp]) -> None:
        """Look whether the numbers from ``places`` on fit the windows ``rows``."""
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            for look in _LOOKS:
                low = part[places + self._lowest[rows]].astype(np.float64)
                scale = part[places + self._highest[rows]].astype(np.float64) - low
                number = (part[places + look].astype(np.float64) - low) / scale
                # The lowest, the highest and this one may all be away from the window's.
                fits = np.abs(number - self._windows[rows, look]) < 5.0 * _TOLERANCE
                if not fits.any():
                    return
                places, rows = places[fits], rows[fits]
            numbers = np.lib.stride_tricks.sliding_window_view(part, WINDOW)[places].astype(np.float64)
            away = np.abs(_on_one_scale(numbers) - self._windows[rows]).max(axis=1)
        for row in rows[away < _TOLERANCE]:
            self.found.add((name, self.needles.names[self._of[row]]))


def _patterns(numbers: NDArray[Any]) -> NDArray[np.uint32]:
    """In which order numbers ``(..., n)`` rise and fall, for each window: digits to base 3, modulo 2**32."""
    before, after = numbers[..., :-1], numbers[..., 1:]
    with np.errstate(invalid="ignore"):
        one = (after > before).view(np.uint8) - (after < before).view(np.uint8) + np.uint8(1)
    two = one[..., :-1] * np.uint8(3) + one[..., 1:]
    four = two[..., :-2] * np.uint8(9) + two[..., 2:]
    eight = four[..., :-4] * np.uint16(81) + four[..., 4:]
    sixteen = eight[..., :-8] * np.uint32(6561) + eight[..., 8:]
    windows = numbers.shape[-1] - WINDOW + 1
    twenty = sixteen[..., :windows] * np.uint32(81) + four[..., 16 : 16 + windows]
    most = twenty * np.uint32(9) + two[..., 20 : 20 + windows]
    return np.asarray(most * np.uint32(3) + one[..., 22 : 22 + windows])


def _on_one_scale(windows: Floats) -> Floats:
    """Windows ``(n, WINDOW)`` from 0 to 1."""
    lowest = windows.min(axis=1, keepdims=True)
    return np.asarray((windows - lowest) / (windows.max(axis=1, keepdims=True) - lowest))


_ARCHIVES = (b"PK\x03\x04", b"\x1f\x8b", b"BZh", b"\xfd7zXZ", b"\x28\xb5\x2f\xfd", b"PAR1", b"ARROW1", b"\x89HDF", b"\x93NUMPY")
_DAMAGED: tuple[type[Exception], ...] = (
    OSError, EOFError, ValueError, TypeError, KeyError, RuntimeError, NotImplementedError, zipfile.BadZipFile, zlib.error, lzma.LZMAError,
    tarfile.TarError,
)  # fmt: skip


def _kind(head: bytes) -> str | None:
    """What makes a file nothing to search."""
    if head[2:4] == b"\r\n" and head[4:8] in {bytes([flag, 0, 0, 0]) for flag in range(4)}:
        return "compiled module"
    return next((kind for magic, kind in _SKIPPED.items() if head.startswith(magic)), None)


def _unpacked(data: bytes) -> Iterator[tuple[str, bytes | NDArray[Any]]]:
    """What an archive or a table holds: bytes of its members, or arrays."""
    if data.startswith(b"PK\x03\x04"):
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for member in archive.infolist():
                if not member.is_dir() and member.file_size <= _LARGEST:
                    with archive.open(member) as file:
                        head = file.read(16)
                        if _kind(head) is None:
                            yield member.filename, head + file.read()
    elif data.startswith(b"\x93NUMPY"):
        yield "array", np.load(io.BytesIO(data), allow_pickle=False)
    elif data[257:262] == b"ustar":
        with tarfile.open(fileobj=io.BytesIO(data)) as archive:
            for part in archive:
                file = archive.extractfile(part) if part.isreg() else None
                if file is not None:
                    yield part.name, file.read(_LARGEST)
    elif data.startswith((b"PAR1", b"ARROW1")):
        yield from _tables(data)
    elif data.startswith(b"\x89HDF"):
        yield from _hdf(data)
    else:
        packings: Mapping[bytes, Callable[[bytes], bytes]] = {
            b"\x1f\x8b": lambda packed: gzip.GzipFile(fileobj=io.BytesIO(packed)).read(_LARGEST),
            b"BZh": lambda packed: bz2.BZ2File(io.BytesIO(packed)).read(_LARGEST),
            b"\xfd7zXZ": lzma.decompress,
            b"\x28\xb5\x2f\xfd": _zstandard,
        }
        for magic, unpack in packings.items():
            if data.startswith(magic):
                yield "content", unpack(data)


def _zstandard(packed: bytes) -> bytes:
    import zstandard

    with zstandard.ZstdDecompressor().stream_reader(io.BytesIO(packed)) as reader:
        return bytes(reader.read(_LARGEST))


def _tables(data: bytes) -> Iterator[tuple[str, NDArray[Any]]]:
    import pyarrow as pa
    import pyarrow.ipc
    import pyarrow.parquet as pq

    table = pq.read_table(io.BytesIO(data)) if data.startswith(b"PAR1") else pa.ipc.open_file(io.BytesIO(data)).read_all()
    for name, column in zip(table.column_names, table.columns, strict=True):
        if pa.types.is_integer(column.type) or pa.types.is_floating(column.type):
            yield name, column.combine_chunks().cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)


def _hdf(data: bytes) -> Iterator[tuple[str, NDArray[Any]]]:
    import h5py

    arrays: list[tuple[str, NDArray[Any]]] = []
    with h5py.File(io.BytesIO(data), "r") as file:
        file.visititems(lambda name, item: arrays.append((name, item[()])) if isinstance(item, h5py.Dataset) and item.shape else None)
    yield from arrays


def _is_text(data: bytes) -> bool:
    head = data[:1024]
    return b"\0" not in data[:4096] and len(head) - len(head.translate(None, _CONTROL)) < 8


def _digests(data: bytes) -> Iterator[bytes]:
    """All stretches of 64 hexadecimal digits."""
    # Such a stretch holds a whole block of 32.
    blocks = np.frombuffer(data, np.uint8, len(data) // 32 * 32)
    if _HEX[blocks].reshape(-1, 32).all(axis=1).any():
        for match in _DIGEST.finditer(data):
            stretch = match.group()
            yield from (stretch[start : start + 64] for start in range(len(stretch) - 63))


def _numbers_of_text(data: bytes) -> Iterator[Floats]:
    """Series of numbers from where a text is mostly digits, and of each key of a JSON text."""
    if data[:64].lstrip()[:1] in {b"{", b"["}:
        by_key: dict[bytes, list[float]] = {}
        for key, number in _PAIR.findall(data):
            by_key.setdefault(key, []).append(float(number))
        yield from (np.array(numbers) for numbers in by_key.values() if len(numbers) >= WINDOW)
    letters = np.frombuffer(data, dtype=np.uint8)
    whole = len(letters) // _BLOCK * _BLOCK
    blocks = [letters[:whole].reshape(-1, _BLOCK), letters[None, whole:]]
    dense = np.concatenate(
        [_DIGITS[block].sum(axis=1) * 4 > np.maximum(block.shape[1] - _BLANK[block].sum(axis=1), 40) for block in blocks if block.size]
    )
    dense[:-1] |= dense[1:]
    edges = np.flatnonzero(np.diff(np.concatenate([[False], dense, [False]]).astype(np.int8)))
    for first, end in edges.reshape(-1, 2):
        region = data[max(0, first - 1) * _BLOCK : (end + 1) * _BLOCK]
        yield from _numbers_of_region(region)


def _numbers_of_region(region: bytes) -> Iterator[Floats]:
    yield np.array(list(map(float, _NUMBER.findall(region))))
    lines = [line for line in region.replace(b"\r", b"").split(b"\n")[1:-1] if line.strip()]
    if len(lines) < WINDOW:
        return
    typical = lines[len(lines) // 2]
    mark = max((b",", b";", b"\t", b"|"), key=typical.count)
    separator = mark if mark in typical else None
    fields = [line.split(separator) for line in lines]
    width = Counter(map(len, fields)).most_common(1)[0][0]
    if 1 < width <= 512:
        rows = np.array([row for row in fields if len(row) == width])
        for column in rows.T:
            yield _as_floats(column)
    length = Counter(map(len, lines)).most_common(1)[0][0]
    even = [line for line in lines if len(line) == length]
    if length <= 512 and len(even) > 0.9 * len(lines):
        letters = np.frombuffer(b"".join(even), dtype=np.uint8).reshape(len(even), length)
        for size in (3, 4, 5):
            for start in range(length - size + 1):
                part = letters[:, start : start + size]
                numeric = _DIGITS[part] | (part == ord(" ")) | (part == ord("-"))
                if numeric.all(axis=1).mean() > 0.95:
                    yield _as_floats(np.ascontiguousarray(part).view(f"S{size}").ravel())


def _as_floats(texts: NDArray[Any]) -> Floats:
    """Numbers of a column of texts; NaN where there is none."""
    try:
        with np.errstate(over="ignore"):
            return texts.astype(np.float64)
    except ValueError:
        numbers = np.full(len(texts), np.nan)
        for row, text in enumerate(texts.tolist()):
            word = text.strip().strip(b'"')
            if word[:1] in _FIRST and _NUMBER.fullmatch(word):
                numbers[row] = float(word)
        return numbers


def _numbers_of_bytes(data: bytes) -> Iterator[NDArray[Any]]:
    """Bytes as numbers, at every offset."""
    for offset in range(8):
        moved = data[offset:]  # numpy is slow with numbers across the borders of words
        for kind in _BINARY:
            size = np.dtype(kind).itemsize
            if offset < size:
                yield np.frombuffer(moved, kind, len(moved) // size)
