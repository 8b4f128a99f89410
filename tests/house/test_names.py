"""Names are nouns: no variable, argument, attribute, function or class of glbench is a bare participle."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import glbench

PACKAGE = Path(glbench.__file__).parent

PARTICIPLES = frozenset(
    {
        "asked", "begun", "brought", "chosen", "done", "drawn", "found", "given", "gone", "granted", "held", "kept", "known", "left",
        "made", "meant", "put", "said", "seen", "shown", "stated", "stood", "taken", "told", "wanted", "written",
    }
)  # fmt: skip
"""``found`` says nothing about what was found. A name has the noun: ``columns``, ``nearest_name``, ``result``."""

EXCEPTIONS = {
    ("agents/baselines.py", "made"): "key of card.toml of baselines",
    ("control/season.py", "written"): "EndValue.written, which docs/control.md shows",
    ("evaluation/rollout.py", "asked"): "key of checkpoints",
    ("execution.py", "put"): "the present tense: to put files into a store",
    ("jax/environment.py", "done"): "part of gymnax's interface",
    ("leaderboard/tables.py", "left"): "the side",
    ("report/story.py", "_LEFT"): "the side",
    ("verification/proof.py", "stated"): "key of verification notes",
}
"""Names that stay, by file and name, and why: mostly keys of file formats, which stay readable."""

REMAINING = {"bounds": 1, "evaluation": 4}
"""Places that are still to be named, by room. The numbers may only fall."""


def names_in(path: Path) -> Iterator[tuple[int, str]]:
    """Line and name of everything that a file gives a name to: arguments, variables, attributes, functions and classes."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.attr
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.lineno, node.name


def bare_participles(path: Path) -> list[tuple[int, str]]:
    return [(line, name) for line, name in names_in(path) if name.strip("_").lower() in PARTICIPLES]


@pytest.fixture(scope="module")
def places() -> list[tuple[str, int, str]]:
    """File, line and name of every bare participle in the package."""
    return [
        (path.relative_to(PACKAGE).as_posix(), line, name)
        for path in sorted(PACKAGE.rglob("*.py"))
        for line, name in bare_participles(path)
    ]


def test_bare_participles_are_recognised(tmp_path: Path) -> None:
    file = tmp_path / "names.py"
    file.write_text(
        "def found(given, task):\n    _kept = written_rows = given\n    task.seen = _kept\n    return Shown\nclass Told: pass\n"
    )
    assert sorted(bare_participles(file)) == [(1, "found"), (1, "given"), (2, "_kept"), (3, "seen"), (5, "Told")]


def test_no_name_is_a_bare_participle(places: list[tuple[str, int, str]]) -> None:
    by_room: dict[str, list[str]] = {}
    for file, line, name in places:
        if (file, name) not in EXCEPTIONS:
            by_room.setdefault(file.partition("/")[0], []).append(f"glbench/{file}:{line}: {name}")
    excess = [place for room, listed in by_room.items() if len(listed) > REMAINING.get(room, 0) for place in listed]
    assert not excess, "name these after what they are:\n" + "\n".join(excess)


def test_every_exception_is_needed(places: list[tuple[str, int, str]]) -> None:
    assert not EXCEPTIONS.keys() - {(file, name) for file, _, name in places}
