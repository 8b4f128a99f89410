"""Sealed rounds (held-out draws, commit and reveal): a host evaluates with draws of the test split that are secret until the round is over.

The draws are keyed by a secret: a salt of 256 random bits and, where the round has weather of its own, what identifies that weather. Its
SHA-256, the commitment, is published first and the secret last, so that everybody can see that the host changed nothing in between.
``docs/maintain.md`` says how a host runs a round.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
import os
import re
import secrets
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from glbench.errors import GlbenchError, refuse
from glbench.untrusted import MIB, quoted, read_regular

SALT_BYTES: Final = 32
SCHEMA: Final = "glbench/round"
SCHEMA_VERSION: Final = 1
_FIRST_LINE: Final = "glbench round 1"
_CLOSES: Final = "closes "
_EXAMPLE: Final = "2027-03-01T18:00+01:00"
_HEX: Final = re.compile(r"[0-9a-f]{64}")
_FIRST_YEAR, _LAST_YEAR = 1600, 9999
_MOST_YEARS = 200
_HEAD: Final = """\
# The secret of a round of glbench. Nobody may see this file before the round is over. Then publish it: it opens the commitment.
"""


@dataclass(frozen=True)
class SealedWeather:
    """Weather that a host keeps to himself until the round is over."""

    digest: str
    """SHA-256 of the record, as ``glbench weather list`` shows it."""
    years: tuple[int, ...]
    """Years of the record that take the place of those of the test split."""


@dataclass(frozen=True)
class Round:
    """The secret of a round."""

    salt: str = field(repr=False)
    """256 random bits as 64 hexadecimal digits, not shown by ``repr``."""
    weather: SealedWeather | None = None
    """The round's own weather; ``None`` where it is the task's."""
    closes: dt.datetime | None = None
    """Closing time with its time zone, in whole seconds; a result made later is late. ``None``: the round never closes."""

    def __post_init__(self) -> None:
        """Raises ``GlbenchError`` when the salt, the digest, the years or the closing time cannot be those of a round."""
        # The wrong salt is not repeated: a right one with a typo would end up in a log.
        if not isinstance(self.salt, str) or not _HEX.fullmatch(self.salt):
            refuse("The salt of a round has 64 hexadecimal digits in small letters. `glbench round new` makes one.", GlbenchError)
        closes = self.closes
        if closes is not None and (
            not isinstance(closes, dt.datetime)
            or closes.utcoffset() is None
            or closes.microsecond
            or closes.year in (dt.MINYEAR, dt.MAXYEAR)  # in UTC it may be in no year that there is
        ):
            msg = (
                f"The closing time needs a time zone, whole seconds and a year from 2 to 9998, such as {_EXAMPLE}; "
                f"got {quoted(str(closes))}."
            )
            raise GlbenchError(msg)
        if self.weather is None:
            return
        digest, years = self.weather.digest, self.weather.years
        if not isinstance(digest, str) or not _HEX.fullmatch(digest):
            refuse(f"The weather of a round is named by the 64 hexadecimal digits of its SHA-256; got {quoted(digest)}.", GlbenchError)
        usable = all(type(year) is int and _FIRST_YEAR <= year <= _LAST_YEAR for year in years)
        if not usable or not 1 <= len(years) <= _MOST_YEARS or list(years) != sorted(set(years)):
            refuse(f"The years of a round's weather ascend and occur once, such as 2019, 2020; got {quoted(str(years))}.", GlbenchError)

    @classmethod
    def new(cls, weather: SealedWeather | None = None, closes: dt.datetime | None = None) -> Round:
        """A round with a salt from the operating system's source of random numbers."""
        return cls(secrets.token_hex(SALT_BYTES), weather, closes)

    @property
    def closing_words(self) -> str:
        """``2027-03-01 17:00:00 UTC``; empty without a closing time."""
        return "" if self.closes is None else f"{self.closes.astimezone(dt.UTC):%Y-%m-%d %H:%M:%S} UTC"

    def is_late(self, when: dt.datetime | str) -> bool:
        """Whether ``when``, as a result states it, is after the closing time. Text that is not a time with a zone counts as late."""
        if self.closes is None:
            return False
        try:
            return (dt.datetime.fromisoformat(when) if isinstance(when, str) else when) > self.closes
        except (ValueError, TypeError):
            return True

    @property
    def secret(self) -> str:
        """What the draws are keyed by: lines without an end of line after the last one.

        ``glbench round 1``, the salt; if the round has its own weather, the digest of that weather, and its years separated by spaces;
        if it has a closing time, ``closes`` and that time in UTC, such as ``closes 2027-03-01T17:00:00Z``.
        """
        lines = [_FIRST_LINE, self.salt]
        if self.weather is not None:
            lines += [self.weather.digest, " ".join(str(year) for year in self.weather.years)]
        if self.closes is not None:
            lines.append(f"{_CLOSES}{_utc(self.closes)}")
        return "\n".join(lines)

    @property
    def commitment(self) -> str:
        """SHA-256 [hex] of ``secret`` in ASCII: published before the round, and named by its results."""
        return commitment_of(self.secret)

    def to_toml(self) -> str:
        """The text of the round's file."""
        text = f'{_HEAD}schema = "{SCHEMA}"\nschema_version = {SCHEMA_VERSION}\ncommitment = "{self.commitment}"\nsalt = "{self.salt}"\n'
        if self.closes is not None:
            text += f"closes = {_utc(self.closes)}\n"
        if self.weather is not None:
            text += f'\n[weather]\ndigest = "{self.weather.digest}"\nyears = {json.dumps(self.weather.years)}\n'
        return text


def _utc(time: dt.datetime) -> str:
    return f"{time.astimezone(dt.UTC):%Y-%m-%dT%H:%M:%SZ}"


def commitment_of(secret: str) -> str:
    """SHA-256 [hex] of a secret, which may be published."""
    return hashlib.sha256(secret.encode()).hexdigest()


def weather_of(secret: str) -> SealedWeather | None:
    """The weather that a round's secret names, if any. Raises ``GlbenchError`` when it looks like a round's secret and is none."""
    first, *lines = secret.split("\n")
    if first != _FIRST_LINE:  # a plain salt
        return None
    if len(lines) > 1 and lines[-1].startswith(_CLOSES):
        lines.pop()
    if len(lines) not in (1, 3) or (len(lines) == 3 and not re.fullmatch(r"\d{4}( \d{4})*", lines[2])):
        msg = "This is not the secret of a round: that has two lines, two more with its own weather, one more with a closing time."
        raise GlbenchError(msg)
    weather = SealedWeather(lines[1], tuple(int(year) for year in lines[2].split(" "))) if len(lines) == 3 else None
    return Round(lines[0], weather).weather


def write_round(sealed: Round, path: Path) -> None:
    """Write a round's file for its owner alone. Raises ``GlbenchError`` when there is one, maybe the only copy, or it cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(sealed.to_toml())
            file.flush()
            os.fsync(file.fileno())
    except FileExistsError as error:
        refuse(f"{path} is there already, and may be the only copy of a secret. Choose another file.", GlbenchError, error)
    except OSError as error:
        refuse(f"Cannot write {path}: {error.strerror or error}. Choose a folder that you may write to.", GlbenchError, error)


def read_round(path: Path | str) -> Round:
    """The round of a file that ``glbench round new`` wrote, or that a host has published.

    Raises ``GlbenchError`` when the file is missing, no round's, or its salt and weather do not give its commitment.
    """
    path = Path(path)
    try:
        content = tomllib.loads(read_regular(path, MIB).decode())
    except FileNotFoundError as error:
        refuse(f"There is no round's file {path}. `glbench round new` makes one.", GlbenchError, error)
    except OSError as error:
        refuse(f"Cannot read the round's file {path}: {error.strerror or error}.", GlbenchError, error)
    except (ValueError, RecursionError) as error:
        msg = f"{path} is not a round's file: it is not TOML."  # no words of the parser, which would quote the secret
        raise GlbenchError(msg) from error
    try:
        sealed, commitment = _round_of(content)
    except GlbenchError as error:
        refuse(f"{path}: {error}", GlbenchError, error)
    if sealed.commitment != commitment:
        msg = (
            f"{path}: salt, closing time and weather give the commitment {sealed.commitment}, and the file says {quoted(commitment)}. "
            "One of them was changed."
        )
        raise GlbenchError(msg)
    return sealed


def _round_of(content: dict[str, Any]) -> tuple[Round, object]:
    """The round that the tables of a file define, and the commitment that they state."""
    if content.get("schema") != SCHEMA or content.get("schema_version") != SCHEMA_VERSION:
        refuse(f"this is not a round's file of this glbench: its schema is not '{SCHEMA}' {SCHEMA_VERSION}.", GlbenchError)
    weather = content.get("weather")
    odd = set(content) - {"schema", "schema_version", "commitment", "salt", "closes", "weather"}
    if odd or "commitment" not in content or "salt" not in content:
        msg = f"a round's file has schema, schema_version, commitment, salt, closes and [weather]; odd: {', '.join(sorted(odd)) or 'none'}."
        raise GlbenchError(msg)
    if weather is None:
        return Round(content["salt"], None, content.get("closes")), content["commitment"]
    if not isinstance(weather, dict) or set(weather) != {"digest", "years"} or not isinstance(weather["years"], list):
        refuse("[weather] has the digest of a record and a list of years.", GlbenchError)
    own = SealedWeather(weather["digest"], tuple(weather["years"]))
    return Round(content["salt"], own, content.get("closes")), content["commitment"]


def closing_time(text: str) -> dt.datetime:
    """Parse a time such as ``2027-03-01T18:00+01:00``. Raises ``GlbenchError`` when it is none, has no time zone, or is in the past."""
    try:
        closes = dt.datetime.fromisoformat(text.strip())
    except ValueError:
        closes = None
    if closes is None or closes.utcoffset() is None:
        refuse(f"A closing time needs date, time and time zone, such as {_EXAMPLE}; got {quoted(text)}.", GlbenchError)
    if closes <= dt.datetime.now(dt.UTC):
        refuse(f"The closing time {text} is in the past. Choose a later one.", GlbenchError)
    return closes.replace(microsecond=0)


def round_weather(name: str, years: Sequence[int]) -> SealedWeather:
    """The weather ``name`` as a round's own. Raises ``GlbenchError`` when there is no such record, it lacks a year, or no year is named."""
    from glbench.weather import SeasonGenerator, load_weather  # not at the top: task files are read without the weather

    record = load_weather(name)
    in_order = tuple(sorted(set(years)))
    SeasonGenerator(record, in_order)  # which needs whole years
    return SealedWeather(record.digest, in_order)
