"""Weather records by name: those shipped with the package, and those in the user's own data folder.

Shipped records are Parquet tables, KNMI's in its own whole numbers, the others in canonical ones; ``weather/manifest.toml`` says where they
come from and locks the SHA-256 of their canonical values. A user's record is one canonical Parquet file, with description and digest.
"""

from __future__ import annotations

import contextlib
import datetime as dt
import io
import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from glbench.errors import UnknownNameError, WeatherError, did_you_mean, refuse
from glbench.resources import data_folder, user_data_folder, write_atomically
from glbench.weather.knmi import native_rows
from glbench.weather.record import QUANTITIES, SCHEMA, SLOT_SECONDS, IntArray, Origin, Place, WeatherInfo, WeatherRecord, assemble
from glbench.weather.trace import TRACE, load_trace

if TYPE_CHECKING:
    import pyarrow as pa

MANIFEST = "manifest.toml"
METADATA_KEY = b"glbench.weather"
NAME = re.compile(r"[a-z0-9][a-z0-9_.-]{0,63}")


def load_weather(name: str) -> WeatherRecord:
    """Weather record ``name``: a shipped one, such as ``"schiphol"``, that of an extra, or one imported or fetched by the user.

    Raises ``UnknownNameError`` when there is no such record; names the nearest. Raises ``WeatherError`` when the record's file is damaged
    or was changed, and ``GlbenchError`` when its extra is not installed.
    """
    if not isinstance(name, str):
        refuse(f"A weather record is asked for by its name, such as 'schiphol'; got {name!r}.", UnknownNameError)
    shipped = _manifest(data_folder("weather"))
    if name in shipped:
        return _load_shipped(name, data_folder("weather"))
    if name == TRACE:
        return load_trace()
    own = _user_files()
    if name in own and own[name].is_file():
        return read_stored(own[name])
    near = did_you_mean(name, [*shipped, TRACE, *own])
    msg = f"There is no weather record '{name}'.{near} Add one with `glbench weather import` or `glbench weather fetch`."
    raise UnknownNameError(msg)


def find_weather(digest: str) -> str:
    """Name of the weather record with that SHA-256, as a host seals for a round. Raises ``UnknownNameError`` when it is not here."""
    for name, entry in sorted(_manifest(data_folder("weather")).items()):
        if entry["digest"] == digest:
            return name
    for name, path in _user_files().items():
        with contextlib.suppress(WeatherError):  # one that is damaged is not asked for
            if _metadata(path)["digest"] == digest:
                return name
    msg = (
        f"There is no weather record with the SHA-256 {digest}. Import it with `glbench weather import`, with its own place and time zone; "
        "whoever made the round has it."
    )
    raise UnknownNameError(msg)


def list_weather() -> list[WeatherInfo]:
    """What every record is, shipped ones first, then the user's own in order of name. Reads no values of the user's."""
    folder = data_folder("weather")
    infos = [
        _info(name, _described(load_weather(name)), "shipped", folder / entry["file"]) for name, entry in sorted(_manifest(folder).items())
    ]
    return infos + [_info(name, _metadata(path), "yours", path) for name, path in _user_files().items()]


def user_folder() -> Path:
    """Folder of the user's own records."""
    return user_data_folder() / "weather"


def user_file(name: str) -> Path | None:
    """File of the user's own record ``name``; ``None`` for one that comes with glbench or with an extra."""
    return None if name == TRACE or name in _manifest(data_folder("weather")) else user_folder() / f"{name}.parquet"


def save_weather(record: WeatherRecord, name: str, *, overwrite: bool = False) -> Path:
    """Store ``record`` under ``name`` in the user's data folder, whole or not at all; returns the file's path.

    Raises ``WeatherError`` when the name is not usable, is a shipped record's, or is taken and ``overwrite`` is false.
    """
    path = check_new_name(name, overwrite=overwrite)
    write_record(replace(record, name=name), path)
    return path


def write_record(record: WeatherRecord, path: Path) -> None:
    """Write ``record`` as a canonical Parquet file with its description, whole or not at all; ``read_weather`` reads it again."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    ends = record.begin + SLOT_SECONDS * np.arange(1, record.hours + 1, dtype=np.int64)
    columns: dict[str, Any] = {"slot_end": pa.array(ends, type=pa.timestamp("s", tz="UTC"))}
    columns |= {name: pa.array(counts, type=pa.int64()) for name, counts in record.counts.items()}
    table = pa.table(columns).replace_schema_metadata({METADATA_KEY: json.dumps(_described(record)).encode()})
    sink = io.BytesIO()
    pq.write_table(table, sink, compression="zstd")
    write_atomically(path, sink.getvalue())


def write_csv(record: WeatherRecord, path: Path) -> None:
    """Write ``record`` as a CSV in the documented form, whole or not at all; ``read_weather`` makes the same record of it."""
    ends = (record.begin + SLOT_SECONDS * np.arange(1, record.hours + 1, dtype=np.int64)).astype("datetime64[s]")
    # The fewest digits that give the whole number of thousandths (of radiation: J m-2 in the hour) again.
    columns = [[repr(value) for value in record.values(name).tolist()] for name in record.counts]
    place = record.place
    comments = {
        "station": place.station,
        "latitude": repr(place.latitude),
        "longitude": repr(place.longitude),
        "altitude": repr(place.altitude),
        "timezone": place.timezone,
        "source": record.source,
        "licence": record.licence,
        **{f"timing {name}": timing for name, timing in record.timing.items()},
        **({"typical year": "yes"} if record.typical_year else {}),
        **{f"note {number}": note for number, note in enumerate(record.notes, 1)},
    }
    titles = ["slot_end [UTC]", *(f"{name} [{QUANTITIES[name].unit}]" for name in record.counts)]
    lines = [f"# {key}: {' '.join(value.split())}" for key, value in comments.items()]
    rows = (",".join(row) for row in zip(np.datetime_as_string(ends, unit="m", timezone="UTC").tolist(), *columns, strict=True))
    write_atomically(path, "\n".join([*lines, ",".join(titles), *rows]) + "\n")


def check_new_name(name: str, *, overwrite: bool = False) -> Path:
    """File for a new record ``name``. Raises ``WeatherError`` as ``save_weather`` does."""
    if not NAME.fullmatch(name):
        msg = f"'{name}' cannot name a weather record: use up to 64 lower-case letters, digits, and . _ - (the first a letter or digit)."
        raise WeatherError(msg)
    if name == TRACE or name in _manifest(data_folder("weather")):
        refuse(f"'{name}' is the name of a shipped weather record, which never changes. Choose another name.", WeatherError)
    path = user_folder() / f"{name}.parquet"
    if path.exists() and not overwrite:
        refuse(f"There is a weather record '{name}' already ({path}). Choose another name, or replace it with --replace.", WeatherError)
    return path


def _described(record: WeatherRecord) -> dict[str, Any]:
    """What a user's Parquet file says of its record."""
    return {
        "schema": SCHEMA, "name": record.name, "place": asdict(record.place), "begin": record.begin, "hours": record.hours,
        "timing": dict(record.timing), "source": record.source, "licence": record.licence, "typical_year": record.typical_year,
        "notes": list(record.notes), "digest": record.digest,
    }  # fmt: skip


def _info(name: str, described: Mapping[str, Any], origin: Literal["shipped", "yours"], path: Path) -> WeatherInfo:
    first = dt.datetime.fromtimestamp(described["begin"], tz=dt.UTC)
    last = first + dt.timedelta(hours=described["hours"])
    more = {key: described[key] for key in ("hours", "digest")}
    return WeatherInfo(**_origin(name, described), first=first, last=last, origin=origin, path=path, **more)


def _origin(name: str, described: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of ``Origin`` that a description gives to the record ``name``."""
    texts = {key: described[key] for key in ("source", "licence", "typical_year")}
    return {**texts, "name": name, "place": Place(**described["place"]), "notes": tuple(described["notes"])}


def _user_files() -> dict[str, Path]:
    files = sorted(user_folder().glob("*.parquet"), key=lambda path: path.stem)
    return {path.stem: path for path in files if NAME.fullmatch(path.stem)}


def _manifest(folder: Path) -> Mapping[str, dict[str, Any]]:
    path = folder / MANIFEST
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        return MappingProxyType({str(name): entry for name, entry in content["record"].items()})
    except (OSError, ValueError, RecursionError, KeyError) as error:
        refuse(f"Cannot read {path}: {error}. Install glbench again, or restore the file.", WeatherError, error)


@lru_cache(maxsize=8)
def _load_shipped(name: str, folder: Path) -> WeatherRecord:
    entry = _manifest(folder)[name]
    path = folder / entry["file"]
    try:
        if entry["format"] == "canonical":
            record = _canonical(path, name)
        else:  # KNMI's own whole numbers
            table = _parquet_table(path)
            columns = {field: _integers(table, field) for field in table.column_names}
            place = Place(entry["station"], entry["latitude"], entry["longitude"], entry["altitude"], entry["timezone"])
            record = assemble(native_rows(str(path), columns), Origin(name, place, entry["source"], entry["licence"]))
    except (ValueError, TypeError, NotImplementedError, WeatherError) as error:
        raise _changed(path, folder, f"unreadable: {error.__cause__ or error}") from error
    if record.digest != entry["digest"]:
        raise _changed(path, folder, f"locked {entry['digest'][:12]}..., found {record.digest[:12]}...")
    return record


def _integers(table: Any, name: str) -> IntArray:
    """Column of whole numbers. By way of DLPack: Arrow's ``to_numpy`` would load pandas, which takes half a second."""
    column = table.column(name).combine_chunks()
    if column.null_count:
        refuse(f"column {name} has {column.null_count} missing values")
    return np.from_dlpack(column).astype(np.int64)


def _changed(path: Path, folder: Path, evidence: str) -> WeatherError:
    msg = (
        f"{path} no longer holds the values that {folder / MANIFEST} locks ({evidence}). Shipped weather never changes: "
        "restore the file or install glbench again, and bring your own weather in with `glbench weather import`."
    )
    return WeatherError(msg)


def read_stored(path: Path, name: str | None = None) -> WeatherRecord:
    """Record of a canonical Parquet file, as ``save_weather`` and ``write_record`` write it; named after the file by default.

    Raises ``WeatherError`` when the file is damaged, or its values are not those that its description locks.
    """
    record = _canonical(path, name or path.stem)
    described = _metadata(path)
    if record.digest != described["digest"]:
        raise _damaged(path, f"its digest should be {described['digest'][:12]}..., found {record.digest[:12]}...")
    return record


def _canonical(path: Path, name: str) -> WeatherRecord:
    table = _parquet_table(path)
    described = _metadata(path)
    counts: dict[str, IntArray] = {}
    for quantity in described["timing"]:
        if quantity not in QUANTITIES or quantity not in table.column_names:
            raise _damaged(path, f"column {quantity} is missing or unknown")
        column = _integers(table, quantity)
        column.setflags(write=False)
        counts[quantity] = column
    timing = MappingProxyType(described["timing"])
    return WeatherRecord(**_origin(name, described), begin=described["begin"], counts=MappingProxyType(counts), timing=timing)


def _metadata(path: Path) -> dict[str, Any]:
    import pyarrow.parquet as pq

    with _readable(path):
        metadata = pq.read_schema(path).metadata or {}
    try:
        described = json.loads(metadata[METADATA_KEY])
    except (KeyError, ValueError) as error:
        raise _damaged(path, "it carries no description") from error
    needed = ("schema", "place", "begin", "hours", "timing", "source", "licence", "typical_year", "notes", "digest")
    missing = [key for key in needed if key not in described]
    if missing:
        raise _damaged(path, f"its description lacks {', '.join(missing)}")
    if described["schema"] != SCHEMA:
        raise _damaged(path, f"its schema is {described['schema']}, this glbench reads {SCHEMA}")
    return dict(described)


def _parquet_table(path: Path) -> pa.Table:
    import pyarrow.parquet as pq

    with _readable(path):
        return pq.ParquetFile(path).read()


@contextlib.contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Turn what Arrow cannot read into the error of a damaged record."""
    import pyarrow as pa

    try:
        yield
    except (OSError, pa.ArrowException) as error:
        raise _damaged(path, str(error)) from error


def _damaged(path: Path, evidence: str) -> WeatherError:
    return WeatherError(f"{path} is not a usable weather record: {evidence}. Delete it and make, import or fetch it again.")
