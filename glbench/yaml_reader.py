"""Reader for untrusted YAML: names and values only, of bounded size, every name once."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import yaml

from glbench.errors import GlbenchError, refuse
from glbench.untrusted import decimal_point, quoted, read_regular

_LARGEST_FILE: Final = 64 * 1024
_DEEPEST: Final = 20
_MOST_VALUES: Final = 10_000  # Largest number of values with aliases expanded: nested aliases can multiply to billions
_MOST_DIGITS: Final = 30
_TAG: Final = "tag:yaml.org,2002:"
_RULE: Final = (
    "Every line is 'name: value' and begins at the left edge. Lines below a name are indented alike; brackets and quotes are closed."
)


class _RefusedError(Exception):
    """An error in a line, counted from 0."""

    def __init__(self, reason: str, mark: Any = None) -> None:
        super().__init__(reason)
        self.line: int | None = mark if isinstance(mark, int) else getattr(mark, "line", None)


def read_yaml(file: Path, what: str, error_type: type[GlbenchError]) -> dict[str, Any]:
    """The names and values in the YAML file ``file``: text, numbers, true or false, nothing, and lists and tables of them.

    Follows YAML 1.1, except that dates and times of day stay text. ``what`` names the file in messages, such as ``"the rules"``. Raises an
    ``error_type``, with the line, when the file cannot be read, is larger than 64 KiB, is not UTF-8 or not YAML, is nested deeper than 20
    levels, or has a name twice, a name that is not text, a tag, a number that has a decimal comma, more than 30 digits or is not finite, or
    more than 10,000 values with aliases expanded.
    """
    text = ""
    cause: Exception
    try:
        text = read_regular(file, _LARGEST_FILE).decode("utf-8-sig")
        return _content(text)
    except OSError as error:
        where, reason, cause = "", f"{error.strerror or error}. Check the path.", error
    except UnicodeDecodeError as error:
        where, reason, cause = "", f"byte {error.start + 1:,} is not UTF-8. Save the file as UTF-8 text.", error
    except _RefusedError as error:
        lines = text.splitlines()
        where = "" if error.line is None else f" at line {error.line + 1}, {quoted(''.join(lines[error.line : error.line + 1]))}"
        reason, cause = f"{error}", error
    msg = f"Cannot read {what} {file}{where}: {reason}"
    raise error_type(msg) from cause


def _content(text: str) -> dict[str, Any]:
    strange = yaml.reader.Reader.NON_PRINTABLE.search(text)
    if strange is not None:
        msg = f"the character U+{ord(strange[0]):04X} is not allowed."
        raise _RefusedError(msg, text.count("\n", 0, strange.start()))
    loader = _Loader(text)
    try:
        node = loader.get_single_node()
    except yaml.MarkedYAMLError as error:
        tab = "\\t" in (error.problem or "")
        raise _RefusedError(
            "it begins with a tab. Use spaces." if tab else f"it is not valid YAML. {_RULE}", error.problem_mark or error.context_mark
        ) from error
    except (ValueError, OverflowError) as error:  # such as "\\UFFFFFFFF", or a version of 5,000 digits
        msg = f"it is not valid YAML. {_RULE}"
        raise _RefusedError(msg, loader.line) from error
    if not isinstance(node, yaml.MappingNode):
        raise _RefusedError("it is empty." if node is None else f"it is not a table of names and values. {_RULE}")
    return dict(loader.value(node))


class _Loader(yaml.SafeLoader):
    """Limits nesting, refuses tags, and counts values with aliases expanded."""

    yaml_implicit_resolvers = {  # noqa: RUF012  as the class above has it
        first: [(tag, form) for tag, form in forms if tag.removeprefix(_TAG) not in ("timestamp", "value")]
        for first, forms in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = self._values = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Compose a node; refuse tags and deep nesting."""
        event: yaml.Event = self.peek_event()  # type: ignore[no-untyped-call]
        if getattr(event, "tag", None) is not None:
            msg = "it has a tag ('!...'). Leave it out: values are text, numbers, lists and tables."
            raise _RefusedError(msg, event.start_mark)
        self._go_deeper(event.start_mark)
        node: yaml.Node | None = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def value(self, node: yaml.Node) -> Any:
        """The value of ``node``."""
        self._values += 1
        if self._values > _MOST_VALUES:
            msg = f"it has more than {_MOST_VALUES:,} values with its aliases ('*name') expanded."
            raise _RefusedError(msg, node.start_mark)
        if isinstance(node, yaml.ScalarNode):
            return self._scalar(node)
        self._go_deeper(node.start_mark)
        built = self._table(node) if isinstance(node, yaml.MappingNode) else [self.value(item) for item in node.value]
        self._depth -= 1
        return built

    def _go_deeper(self, mark: Any) -> None:
        self._depth += 1
        if self._depth > _DEEPEST:
            msg = f"it is nested more than {_DEEPEST} levels deep."
            raise _RefusedError(msg, mark)

    def _table(self, node: yaml.MappingNode) -> dict[str, Any]:
        table: dict[str, Any] = {}
        lines: dict[str, int] = {}
        for key, item in node.value:
            name, line = self.value(key), key.start_mark.line
            if not isinstance(name, str):
                msg = f"the name {quoted(name)} is not text. Put it in quotes."
                raise _RefusedError(msg, line)
            if name in table:
                refuse(f"it has {quoted(name)} twice, in lines {lines[name] + 1} and {line + 1}. Keep one of them.", _RefusedError)
            table[name], lines[name] = self.value(item), line
        merged = table.pop("<<", {})
        for more in merged if isinstance(merged, list) else [merged]:
            if not isinstance(more, dict):
                msg = "'<<' takes tables, and this is not one."
                raise _RefusedError(msg, node.start_mark)
            table = {**more, **table}
        return table

    def _scalar(self, node: yaml.ScalarNode) -> Any:
        kind, text = node.tag.removeprefix(_TAG), node.value
        if kind == "merge":
            return text
        if kind in ("int", "float") and ":" in text:  # 6:30 is 390 to YAML 1.1
            return text
        if kind == "str" and node.style is None and (advice := decimal_point(text)) and text in advice:
            msg = f"a number has a decimal point: {advice}. A list has brackets, and text has quotes."
            raise _RefusedError(msg, node.start_mark)
        try:
            value = self.yaml_constructors[node.tag](self, node) if len(text) <= _MOST_DIGITS or kind == "str" else math.nan
        except (ValueError, OverflowError):  # such as 0x_
            value = math.nan
        if isinstance(value, str) and any("\ud800" <= letter <= "\udfff" for letter in value):
            msg = "it has half a character (\\ud800 to \\udfff). Write the whole character."
            raise _RefusedError(msg, node.start_mark)
        if isinstance(value, float) and not math.isfinite(value):
            msg = f"{quoted(text)} is not a finite number with at most {_MOST_DIGITS} characters."
            raise _RefusedError(msg, node.start_mark)
        return value
