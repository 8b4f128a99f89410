"""Task files as plain tables: read within limits, and merged with the file that they name as their base.

``base = "glbench/Schiphol2010-Delta10-v1"`` (a shipped task) or ``base = "winter.toml"`` (a file beside it) at the top of a task file
inherits all of that task but id, title, description and suites. What the file itself says replaces the base's, key by key. The
result is checked, digested and recorded like a complete file: a result can be checked without the base. A base of
schema 1 under a file of schema 2 is converted first. ``without = ["sensors", "splits.training"]`` leaves tables and keys of the base
out. ``[splits]`` with years takes the place of the base's as a whole: the years that are stated are all there are. Prices in a file
beside the task (``file = "gas.csv"``) are taken over as a series.

``TaskSpec.replace`` merges tasks in the same way (``inherit``), in Python.
"""

from __future__ import annotations

import logging
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from glbench.errors import TaskError, UnknownNameError, did_you_mean, refuse
from glbench.registration import task_files, task_ids
from glbench.resources import data_folder
from glbench.tasks.price_files import read_prices
from glbench.untrusted import MIB, read_regular, real_path, reason_of, toml_fault

BASE, WITHOUT = "base", "without"
NOT_INHERITED = ("id", "title", "description", "suites")
"""Keys that are not inherited."""
SPLITS = "splits"
"""The table that takes the place of the base's as soon as it states years; all others are merged key by key."""
_SCHEDULE = "schedule"
"""The list whose entries take the place of the base's for the same control; all other lists take that of the whole."""
LONGEST_CHAIN = 8
"""Files that a task may be made of."""

PRICE_FILE_KEYS = ("clock", "column", "file_unit")
"""Keys beside the ``file`` of a price table: the clock of its stamps, the title of its prices, and their unit."""

_LARGEST_FILE = MIB
_DEEPEST = 8
_LARGEST_INTEGER = 2**63
_LONGEST_VALUE = 80
_LONGEST_CHANGE = 2000

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Change:
    """A key that differs from the base: its full name, and both values as files write them; ``None`` for one that is not there."""

    key: str
    value: str | None
    before: str | None


@dataclass(frozen=True)
class TaskTables:
    """What a task file defines."""

    content: Mapping[str, Any]
    """All tables and keys, those of the base included."""
    base: str | None = None
    """The base as the file names it; ``None`` without one."""
    changes: tuple[Change, ...] = ()
    """What differs from the base."""
    files: tuple[Path, ...] = ()
    """The file of the base, of the base's base and so on, and files of prices."""

    def __hash__(self) -> int:
        return hash(repr(self.content))


def read_tables(path: Path, above: tuple[Path, ...] = ()) -> TaskTables:
    """The tables of the task file ``path`` and of its bases, merged.

    ``above`` are the files that led here.

    Raises ``TaskError`` when a file cannot be read, is not TOML, or is based on itself. Raises ``UnknownNameError`` for an unknown base.
    """
    files = (*above, real_path(path))
    source = shown_path(path)
    if real_path(path) in above:
        chain = " -> ".join(file.name for file in files)
        refuse(f"{source} is its own base ({chain}). Remove 'base' from one of these files.", TaskError)
    if len(files) > LONGEST_CHAIN:
        refuse(f"{source} is the base of a base of a base, {LONGEST_CHAIN} times over. Write one of these tasks out.", TaskError)
    text = ""
    try:
        text = read_regular(path, _LARGEST_FILE).decode("utf-8-sig").replace("\r\n", "\n")
        content = tomllib.loads(text)
    except FileNotFoundError:
        msg = f"There is no task file {source}. `glbench tasks list` shows the tasks that are there."
        raise TaskError(msg) from None
    except (OSError, UnicodeDecodeError) as error:
        refuse(f"Cannot read the task file {source}: {reason_of(error)}. Give a .toml file or the id of a task.", TaskError, error)
    except tomllib.TOMLDecodeError as error:
        msg = f"{source} is no valid TOML: {toml_fault(error, text)}. Correct that line; tasks/ has files to compare with."
        raise TaskError(msg) from error
    except (RecursionError, ValueError) as error:  # nested without end; a number of thousands of digits
        refuse(f"{source} is not a task file: it holds a number or a nesting that no task has. Is it the right file?", TaskError, error)
    check_plain(content, source)
    base = content.pop(BASE, None)
    if base is None:
        prices = take_over_prices(content, path.parent, source)
        if WITHOUT in content:
            msg = f"{source}: without = {as_written(content[WITHOUT])} says what of a base is left out, and there is no base. Add one."
            raise TaskError(msg)
        if "model" not in content:
            msg = (
                f'{source} names no base and is no whole task. Add base = "glbench/GreenhouseReal-v1", or the tables of docs/task-file.md.'
            )
            raise TaskError(msg)
        return TaskTables(content, files=prices)
    if not isinstance(base, str):
        refuse(f"{source}: base = {as_written(base)} is neither the id of a task nor a file beside this one, in quotes.", TaskError)
    try:
        under = path.parent / base if base.endswith(".toml") else shipped_file(base)
    except UnknownNameError as error:
        msg = f"{source}: base = {as_written(base)}: {error}"
        raise UnknownNameError(msg) from None
    below = read_tables(under, files)
    prices = take_over_prices(content, path.parent, source, below.content)
    return inherit(below.content, content, base, source, (*prices, real_path(under), *below.files))


def inherit(below: Mapping[str, Any], content: Mapping[str, Any], base: str, source: str, files: tuple[Path, ...] = ()) -> TaskTables:
    """The tables ``content`` over ``below``, those of the task ``base``; ``source`` is what messages call the result.

    Raises ``TaskError`` when ``content`` has an older schema than its base, or leaves out what its base does not have.
    """
    own = dict(content)
    schemas = below.get("schema"), own.get("schema", below.get("schema"))
    if schemas == (2, 1):
        msg = f"{source}: base = {as_written(base)} has schema 2, which schema 1 cannot say. Write schema = 2, or leave it out."
        raise TaskError(msg)
    if schemas == (1, 2):
        below = as_schema_2(below)
    inherited = {key: value for key, value in below.items() if key not in NOT_INHERITED}
    merged, names = inherited, own.pop(WITHOUT, [])
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        msg = f'{source}: without = {as_written(names)} must be a list of tables or keys of the base: ["sensors", "splits.training"].'
        raise TaskError(msg)
    for name in names:
        merged = _without(merged, name.split("."), f'{source}: {as_written(base)} has no "{name}" to leave out.')
    splits = own.get(SPLITS)
    if isinstance(splits, Mapping) and any(isinstance(one, Mapping) and "years" in one for one in splits.values()):
        merged = {key: value for key, value in merged.items() if key != SPLITS}
    _check_parts(merged, own, base, source)
    if _SCHEDULE in own and _SCHEDULE in merged:
        own[_SCHEDULE] = _with_other_controls(merged[_SCHEDULE], own[_SCHEDULE])
    merged = _merged(merged, own)
    reward = own.get("reward")
    for one, other in (("penalty_scale", "violation_price"), ("violation_price", "penalty_scale")):
        if isinstance(reward, dict) and one in reward and other not in reward:  # violations cost points or money
            merged["reward"].pop(other, None)
    before = dict(_leaves(inherited))
    changes = [
        Change(key, _whole(value), _whole(before[key]) if key in before else None)
        for key, value in _leaves(merged)
        if key not in NOT_INHERITED and before.get(key) != value
    ]
    changes += [Change(key, None, _whole(value)) for key, value in _missing(inherited, merged)]
    return TaskTables(merged, base, tuple(changes), files)


_NEW_PART = {"ledger": "side", "price_tables": "unit"}
"""Tables whose parts have names of their own, and the key that every new part states."""


def _check_parts(inherited: Mapping[str, Any], own: Mapping[str, Any], base: str, source: str) -> None:
    """Refuse keys of a part that the base does not have, unless they make a new one."""
    for table, key in _NEW_PART.items():
        names, parts = inherited.get(table), own.get(table)
        if not isinstance(names, Mapping) or not isinstance(parts, Mapping):
            continue
        for name, part in parts.items():
            if name not in names and isinstance(part, Mapping) and key not in part:
                near = did_you_mean(name, names, list_few=False)
                msg = (
                    f"{source}: {as_written(base)} has no {table}.{name}.{near} It has {', '.join(names) or 'none'}. A new one also needs "
                    f"'{key}' and what docs/task-file.md lists."
                )
                raise TaskError(msg)


def _without(table: Mapping[str, Any], path: Sequence[str], refusal: str) -> dict[str, Any]:
    """``table`` without the key at ``path``."""
    key, *rest = path
    if key not in table or (rest and not isinstance(table[key], Mapping)):
        refuse(f"{refusal}{did_you_mean(key, table)}", TaskError)
    others = {name: value for name, value in table.items() if name != key}
    return {**others, key: _without(table[key], rest, refusal)} if rest else others


def as_schema_2(content: Mapping[str, Any]) -> dict[str, Any]:
    """The tables of a task of schema 1, converted to schema 2; what is missing or wrong is left for the check of the tables."""
    others = {key: value for key, value in content.items() if key not in ("prices", "uncertainty")}
    model, prices, noise = (table if isinstance(table := content.get(key), dict) else {} for key in ("model", "prices", "uncertainty"))
    dry = prices.get("dry_matter_content")
    dry_value = dry.get("value") if isinstance(dry, dict) else None
    fresh = 1e-6 / dry_value if isinstance(dry_value, int | float) and dry_value > 0 else 1e-6
    revenue = {"side": "earned", "flow": "fruit_growth", "amount": "fruit_fresh", "unit": "kg m-2", "factor": fresh}
    ledger = {"revenue": {**revenue, "price": prices.get("fruit"), "label": "Fruit"}}
    for price, flow in (("heat", "heat"), ("electricity", "electricity"), ("co2", "co2_dosed")):
        ledger[f"cost_{price}"] = {"side": "paid", "flow": flow, "price": prices.get(price)}
    scenario: dict[str, Any] = {"family": str(content.get("id", "base"))}
    delta, factor = noise.get("delta", 0.0), noise.get("half_width_factor", 1.0)
    if isinstance(delta, int | float) and isinstance(factor, int | float) and delta * factor > 0:
        group = {key: noise[key] for key in ("parameters", "distribution", "redraw") if key in noise}
        scenario["parameters"] = [{"name": "crop", "half_width": delta * factor, **group}]
    pinned = {"id": "greenlight-tomato-1.0.0", **model}
    return {**others, "schema": 2, "model": pinned, "ledger": ledger, "scenario": scenario}


def take_over_prices(content: Mapping[str, Any], folder: Path, source: str, below: Mapping[str, Any] | None = None) -> tuple[Path, ...]:
    """Replace ``file = "gas.csv"`` of a price table by the series in that file of ``folder``; the files of prices.

    The keys of ``PRICE_FILE_KEYS`` beside it say how to read the file.

    A table that states no unit has that of the base, whose tables are ``below``.

    Raises ``TaskError`` when a file cannot be read, is not one of prices, or has to replace the prices of the base.
    """
    tables, files = content.get("price_tables"), []
    inherited = (below or {}).get("price_tables", {})
    for name, table in tables.items() if isinstance(tables, dict) else ():
        if not isinstance(table, dict) or "file" not in table:
            continue
        how = {key: table.pop(key, None) for key in ("file", *PRICE_FILE_KEYS)}
        file = folder / str(how.pop("file"))
        base_table = inherited.get(name, {})
        other = [key for key in ("hourly", "from_day", "series", "market", "of") if key in base_table]
        without = content.get(WITHOUT)
        left_out = without if isinstance(without, list) else []
        if other and not {f"price_tables.{name}", f"price_tables.{name}.{other[0]}"} & {str(one) for one in left_out}:
            msg = (
                f"{source}: [price_tables.{name}] of the base has a {other[0]}, which the file must replace. Add "
                f'without = ["price_tables.{name}.{other[0]}"] at the top of the task.'
            )
            raise TaskError(msg)
        files.append(real_path(file))
        try:
            prices = read_prices(file, table.get("unit", base_table.get("unit")), **how)
        except TaskError as error:
            refuse(f"{source}: [price_tables.{name}] file: {error}", TaskError, error)
        table["series"] = prices.series()
        for doubt in prices.doubts:
            logger.warning("%s: [price_tables.%s] %s: %s.", source, name, file.name, doubt)
    return tuple(files)


def shipped_file(name: str) -> Path:
    """File of the shipped task with this id or short form. Raises ``UnknownNameError`` when there is none; names the nearest."""
    ids = task_ids()
    by_short_form = {task_id.partition("/")[2]: task_id for task_id in ids}
    full_id = name if name in ids else by_short_form.get(name)
    if full_id is not None:
        return ids[full_id]
    expected = f"{name.rpartition('/')[2].lower()}.toml"
    unreadable = [path for path in task_files() if path.name == expected and path not in ids.values()]
    if unreadable:
        return unreadable[0]
    near = did_you_mean(name, ids if "/" in name else by_short_form)
    msg = f"There is no task '{name}'.{near} `glbench tasks list` shows all; a file of your own ends in .toml."
    raise UnknownNameError(msg)


def shown_path(path: Path) -> str:
    """``path`` as messages name it: ``tasks/x.toml`` for shipped files, relative to the working folder where possible."""
    resolved = real_path(path)
    for folder, prefix in ((data_folder("tasks").resolve(), "tasks/"), (Path.cwd(), "")):
        if resolved.is_relative_to(folder):
            return prefix + resolved.relative_to(folder).as_posix()
    return str(path)


def as_written(value: object, longest: int = _LONGEST_VALUE) -> str:
    """A value as TOML would write it, shortened to ``longest`` characters, without characters that steer a terminal."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        text = '"' + "".join(letter if letter.isprintable() else f"\\u{ord(letter):04x}" for letter in value) + '"'
    elif isinstance(value, Mapping):
        text = "{ " + ", ".join(f"{key} = {as_written(inner, longest)}" for key, inner in value.items()) + " }"
    elif isinstance(value, list):
        text = "[" + ", ".join(as_written(inner, longest) for inner in value) + "]"
    else:
        text = str(value)
    return text if len(text) <= longest else text[: longest - 3] + "..."


def check_plain(content: Mapping[str, Any], source: str) -> None:
    """Refuse numbers and nestings that what reads the task later would stumble over. Raises ``TaskError``, which names the key."""
    inside: list[tuple[str, object, int]] = [("the file", content, 0)]
    while inside:
        key, value, depth = inside.pop()
        if depth > _DEEPEST:
            refuse(f"{source}: {key} is nested more than {_DEEPEST} deep, which nothing in a task is.", TaskError)
        if isinstance(value, int) and not -_LARGEST_INTEGER <= value < _LARGEST_INTEGER:
            refuse(f"{source}: {key} is a whole number beyond 64 bits. Correct it.", TaskError)
        if isinstance(value, dict):
            inside += [(str(name), inner, depth + 1) for name, inner in value.items()]
        elif isinstance(value, list):
            inside += [(key, inner, depth + 1) for inner in value]


def _merged(base: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """``own`` over ``base``, table by table."""
    merged = dict(base)
    for key, value in own.items():
        below = merged.get(key)
        merged[key] = _merged(below, value) if isinstance(below, dict) and isinstance(value, dict) else value
    return merged


def _with_other_controls(below: object, own: object) -> object:
    """The entries of a schedule, after those of the base for controls that have none; ``own`` itself when it is no list of entries."""
    if not isinstance(below, list) or not isinstance(own, list) or not all(isinstance(entry, Mapping) for entry in [*below, *own]):
        return own
    controls = [entry.get("control") for entry in own]
    return [*(entry for entry in below if entry.get("control") not in controls), *own]


def _missing(base: Mapping[str, Any], merged: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, object]]:
    """Tables and keys of ``base`` that are not in ``merged``; of a table that is missing as a whole, the table alone."""
    for key, value in base.items():
        if key not in merged:
            yield f"{prefix}{key}", value
        elif isinstance(value, dict) and isinstance(merged[key], dict) and "unit" not in value:
            yield from _missing(value, merged[key], f"{prefix}{key}.")


def _whole(value: object) -> str:
    """A value that a task changes, up to the length of 24 hourly prices and more."""
    return as_written(value, _LONGEST_CHANGE)


def _leaves(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, object]]:
    """Full names of keys and their values; a number with its unit is one value."""
    for key, value in table.items():
        if isinstance(value, dict) and "unit" not in value:
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
