"""Arrays, and checks of untrusted ones: actions must be real numbers; ``.npz`` files must have bounded size and contain no code."""

from __future__ import annotations

import io
import math
import re
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from glbench.errors import refuse
from glbench.untrusted import MIB, parse_json, quoted, read_pieces, read_regular

Floats = NDArray[np.float64]
_MOST_ENTRIES: Final = 1000
_KINDS: Final = {"<f4", "<f8", "<u2", "<i8", "<u8", "|u1"}
_NUMPY_ERRORS: Final = (ValueError, SyntaxError, TypeError, RecursionError, MemoryError, OverflowError, tokenize.TokenError)
"""What numpy raises for a damaged header."""


def real_numbers(value: object) -> NDArray[Any] | None:
    """``value`` as an array of real numbers, or ``None`` if it is not one.

    Refused are complex numbers, dates, text, booleans, objects (such as integers beyond 64 bits), unequal rows and masked entries.
    """
    parts = (value, *value) if isinstance(value, list | tuple) else (value,)
    try:
        # numpy makes numbers of booleans and of masked entries that are among numbers.
        entries = (one for part in parts for one in (part if isinstance(part, list | tuple) else (part,)))
        converted = any(
            isinstance(one, bool | np.bool_) or (isinstance(one, np.ndarray) and (one.dtype == np.bool_ or np.ma.is_masked(one)))
            for one in entries
        )
        array = None if converted else np.asarray(value)
    except Exception:  # whatever a stranger's array or list raises: it is no array of numbers
        return None
    return None if array is None or array.dtype.kind not in "fiu" else array


def unknown_type(value: object) -> str:
    """A sentence about the number type of an array, tensor or list of them if NumPy does not know it, such as bfloat16; else nothing."""
    try:
        while isinstance(value, list | tuple) and value:
            value = value[0]
        kind = str(getattr(value, "dtype", "")).removeprefix("torch.")
    except Exception:  # whatever a stranger's type raises when it is looked at
        return ""
    if not re.fullmatch(r"bfloat\d+|float[468]_\w+|u?int[24]", kind):
        return ""
    return f'NumPy does not know numbers of type {kind}: make them float32 first, with .float() in PyTorch, .astype("float32") in JAX.'


def packed(**arrays: Any) -> bytes:
    """Arrays, numbers, texts and tuples of texts as the bytes of an ``.npz`` file; equal ones give equal bytes."""
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, **{name: np.asarray(value) for name, value in arrays.items()})
    return file.getvalue()


class ArrayFile:
    """The arrays of a file. Its methods raise a ``ValueError`` that names the entry if it is missing or has another type."""

    def __init__(self, arrays: dict[str, NDArray[Any]]) -> None:
        self._arrays = arrays

    @classmethod
    def at(cls, file: Path, largest: int = 64 * MIB) -> ArrayFile:
        """The arrays in ``file``, which takes at most ``largest`` bytes, packed and unpacked.

        Raises ``OSError``, ``ValueError`` when the file cannot be read, is larger, or holds anything else. Messages go on after "it".
        """
        return cls.of(read_regular(file, largest), largest)

    @classmethod
    def of(cls, data: bytes, largest: int = 64 * MIB) -> ArrayFile:
        """The same from the bytes of a file. Errors as for ``at``."""
        try:
            with zipfile.ZipFile(io.BytesIO(data)) as archive:
                entries = archive.infolist()
                if len(entries) > _MOST_ENTRIES or sum(entry.file_size for entry in entries) > largest:
                    refuse(f"it unpacks to more than {largest // MIB} MiB or {_MOST_ENTRIES:,} arrays")
                if len({entry.filename.removesuffix(".npy") for entry in entries}) < len(entries):
                    refuse("an array occurs twice")
                if any(entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for entry in entries):
                    refuse("it is packed in another way than numpy packs. Save it again with numpy.savez_compressed")
                return cls({entry.filename.removesuffix(".npy"): _array(archive, entry) for entry in entries})
        except (zipfile.BadZipFile, zipfile.LargeZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
            refuse("it is not an .npz archive, or is damaged", ValueError, error)

    def __contains__(self, name: str) -> bool:
        return name in self._arrays

    def count(self, beginning: str) -> int:
        """Number of arrays whose names begin with ``prefix``."""
        return sum(name.startswith(beginning) for name in self._arrays)

    def check_format(self, number: int) -> None:
        """Refuse a file whose entry ``format`` is another number."""
        if self.integer("format") != number:
            refuse(f"it has format {self.integer('format')}; this version of glbench reads format {number}")

    def text(self, name: str) -> str:
        """A text."""
        return str(self._texts(name, 0))

    def texts(self, name: str) -> tuple[str, ...]:
        """A row of texts."""
        return tuple(self._texts(name, 1))

    def integer(self, name: str) -> int:
        """A whole number."""
        array = self._entry(name, 0)
        if array.dtype.kind == "f":
            refuse(f"'{name}' is not a whole number")
        return int(array)

    def number(self, name: str) -> float:
        """A number, finite."""
        return float(self.floats(name, 0))

    def floats(self, name: str, dimensions: int, kind: Any = np.float64) -> NDArray[Any]:
        """An array of finite numbers, as ``kind``."""
        array = self._entry(name, dimensions)
        with np.errstate(over="ignore"):
            cast: NDArray[Any] = array.astype(kind)
        if array.dtype.kind != "f" or not np.isfinite(cast).all():
            refuse(f"'{name}' has entries that are not finite floating-point numbers")
        return cast

    def integers(self, name: str, dimensions: int, kind: Any) -> NDArray[Any]:
        """An array of whole numbers, which is one of ``kind`` already."""
        array = self._entry(name, dimensions)
        if array.dtype != np.dtype(kind):
            refuse(f"'{name}' has the type {array.dtype} instead of {np.dtype(kind)}")
        return array

    def table(self, name: str) -> dict[str, Any]:
        """The object of a JSON text."""
        table = parse_json(self.text(name))
        if not isinstance(table, dict):
            refuse(f"'{name}' is not a table")
        return table

    def _texts(self, name: str, dimensions: int) -> Any:
        array = self._entry(name, dimensions, text=True)
        try:
            "".join(array.ravel().tolist()).encode()
            return array.tolist()
        except ValueError as error:
            refuse(f"'{name}' has invalid characters", ValueError, error)

    def _entry(self, name: str, dimensions: int, *, text: bool = False) -> NDArray[Any]:
        array = self._arrays.get(name)
        if array is None:
            refuse(f"it has no '{name}'")
        if array.ndim != dimensions or (array.dtype.kind == "U") != text:
            expected = f"{'text' if text else 'numbers'} with {dimensions} dimensions"
            refuse(f"'{name}' is an array of {array.dtype} with shape {quoted(array.shape)}; expected {expected}")
        return array


def checked_facts(facts: object) -> dict[str, str | int | float]:
    """A table of texts and finite numbers. Raises ``ValueError`` when it is none."""
    if not isinstance(facts, dict):
        refuse(f"{quoted(facts)} is not a table")
    for name, value in facts.items():
        if not isinstance(value, str | int | float) or (isinstance(value, float) and not math.isfinite(value)):
            refuse(f"{quoted(name)} is {quoted(value)}, which is neither text nor a finite number")
    return facts


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> NDArray[Any]:
    """Read an entry; refuse a header that states more data than the entry has."""
    with archive.open(entry) as packed:  # in pieces: an entry may unpack to more than it says
        content = io.BytesIO(read_pieces(packed.read, entry.file_size))
    try:
        version = npy.read_magic(content)
        read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, by_columns, dtype = read_header(content)
        rest = len(content.getbuffer()) - content.tell()
        fits = dtype.itemsize > 0 and math.prod(shape) * dtype.itemsize == rest and min(shape, default=0) >= 0
    except _NUMPY_ERRORS as error:
        refuse(f"its entry {quoted(entry.filename)} is not an array of plain numbers or text", ValueError, error)
    if not fits or (dtype.kind != "U" and dtype.str not in _KINDS):
        refuse(f"its entry {quoted(entry.filename)} is not an array of plain numbers or text, or is incomplete")
    array: NDArray[Any] = np.frombuffer(content.read(), dtype=dtype)
    return array.reshape(shape, order="F" if by_columns else "C").copy(order="K")
