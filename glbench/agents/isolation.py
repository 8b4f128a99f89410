"""Running a submission's file as a module without leaving traces: no bytecode in its folder, no names in the way of others.

This keeps submissions apart from each other; it is no sandbox. A submission runs with the rights of the person who runs it.
"""

from __future__ import annotations

import contextlib
import sys
import traceback
from collections.abc import Iterator
from importlib.machinery import ModuleSpec
from importlib.util import module_from_spec
from pathlib import Path
from types import ModuleType

from glbench.errors import SubmissionError

_CACHE = "__pycache__"
_LONGEST_LINE = 120
_NEVER_SHADOWED = sys.stdlib_module_names | {"glbench"}


def import_file(file: Path, name: str, folder: Path | None) -> ModuleType:
    """Execute ``file`` as a new module called ``name`` and return it.

    ``folder`` is the submission's folder when it is one; its other modules can then be imported, by ``from . import helper`` at
    any time and by ``import helper`` while the submission is being loaded.

    Raises
    ------
    SubmissionError
        When the file is no valid Python, or raises. The message holds the last line of the traceback and the place.
    """
    try:
        code = compile(file.read_bytes(), str(file), "exec", dont_inherit=True)
    except (SyntaxError, ValueError) as error:
        msg = f"{file.name} is no valid Python: {last_line(error)}{_place_of_syntax_error(error, file)}."
        raise SubmissionError(msg) from error
    except (MemoryError, RecursionError) as error:
        msg = f"{file.name} is no valid Python: it is nested too deeply, or too large ({last_line(error)})."
        raise SubmissionError(msg) from error
    spec = ModuleSpec(name, loader=None, origin=str(file), is_package=folder is not None)
    if folder is not None:
        spec.submodule_search_locations = [str(folder)]
    module = module_from_spec(spec)
    module.__file__ = str(file)
    # Under its own name the module stays findable, which dataclasses and pickle need; the name holds the submission's digest.
    sys.modules[name] = module
    try:
        with at_home(folder):
            exec(code, module.__dict__)
    except (Exception, SystemExit) as error:
        for loaded in [key for key in sys.modules if key == name or key.startswith(f"{name}.")]:
            del sys.modules[loaded]
        hint = _hint_about_neighbours(error, file, folder)
        msg = f"{file.name} fails while it is loaded: {describe_error(error, folder or file)}.{hint}"
        raise SubmissionError(msg) from error
    return module


@contextlib.contextmanager
def at_home(folder: Path | None) -> Iterator[None]:
    """Let ``import helper`` find the modules of a submission's ``folder``, and forget them again; never write bytecode."""
    wrote_no_bytecode, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    own = _own_modules(folder) if folder is not None else frozenset[str]()
    others = {name: module for name, module in sys.modules.items() if name.partition(".")[0] in own}
    for name in others:
        del sys.modules[name]
    path = str(folder)
    if folder is not None:
        sys.path.insert(0, path)
    try:
        yield
    finally:
        sys.dont_write_bytecode = wrote_no_bytecode
        if folder is not None:
            with contextlib.suppress(ValueError):  # the submission may have changed sys.path itself
                sys.path.remove(path)
        for name in [name for name in sys.modules if name.partition(".")[0] in own]:
            del sys.modules[name]
        sys.modules.update(others)


def describe_error(error: BaseException, within: Path) -> str:
    """``ValueError: message (agent.py, line 42, in act)``: last line of a traceback and the deepest place in a submission.

    ``within`` is the submission's file or folder. Without a frame in it, the deepest place anywhere is named.
    """
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if _is_within(Path(frame.filename), within)]
    if not frames:
        return last_line(error)
    frame = (own or list(frames))[-1]
    return f"{last_line(error)} ({Path(frame.filename).name}:{frame.lineno}, in {frame.name})"


def last_line(error: BaseException) -> str:
    """Type and message of an error on one line."""
    lines = [line.strip() for line in "".join(traceback.format_exception_only(error)).splitlines() if line.strip()]
    return lines[-1].rstrip(".") if lines else type(error).__name__


def is_part_of_submission(file: Path, folder: Path) -> bool:
    """Whether a file in a submission's folder belongs to it: hidden files and Python's caches do not."""
    return not any(part.startswith(".") or part == _CACHE for part in file.relative_to(folder).parts)


def _own_modules(folder: Path) -> frozenset[str]:
    """Names of the modules in ``folder``; names of the standard library and glbench keep their meaning."""
    names = {file.stem for file in folder.glob("*.py")} | {item.name for item in folder.iterdir() if item.is_dir()}
    return frozenset(name for name in names if name.isidentifier() and name not in _NEVER_SHADOWED)


def _is_within(file: Path, place: Path) -> bool:
    return file == place or place in file.parents


def _place_of_syntax_error(error: SyntaxError | ValueError, file: Path) -> str:
    if not isinstance(error, SyntaxError) or error.lineno is None:
        return ""
    line = (error.text or "").strip()
    shown = line if len(line) <= _LONGEST_LINE else f"{line[: _LONGEST_LINE - 4]} ..."
    return f" ({file.name}:{error.lineno}" + (f": {shown})" if shown else ")")


def _hint_about_neighbours(error: BaseException, file: Path, folder: Path | None) -> str:
    """What to do when a single file imports the file beside it."""
    if not isinstance(error, ModuleNotFoundError) or not error.name:
        return ""
    top = error.name.partition(".")[0]
    beside = file.parent / f"{top}.py"
    if folder is None and (beside.is_file() or (file.parent / top).is_dir()):
        return (
            f" A submission that is one file cannot import its neighbours. Put {file.name} (as agent.py) and '{top}' "
            "together into a folder and submit the folder."
        )
    return f" Install '{top}' into this environment, or do without it."
