"""What the process of a sandboxed agent sees of the disk: its own files, Python with its libraries, glbench without its data.

Nothing is visible that is not listed here. Folders with weather, tasks (they hold the seeds), results and other submissions are covered
wherever they would show through, as they do when glbench is installed among the libraries or a submission is the checkout itself.
"""

from __future__ import annotations

import os
import shutil
import stat
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from glbench.agents import Identity
from glbench.agents.isolation import is_part_of_submission
from glbench.errors import GlbenchError, SubmissionError
from glbench.resources import DataFolder, cache_folder, data_folder, user_data_folder

CODE: Final = Path("/opt/glbench")
"""Where glbench is inside the sandbox: a place of its file system, on no machine."""
SUBMISSION: Final = Path("/submission")
"""Where the submission is inside."""

_SYSTEM = ("usr", "bin", "sbin", "lib", "lib32", "lib64", "nix/store")
_SETTINGS = ("ld.so.cache", "ld.so.conf", "ld.so.conf.d", "alternatives")
_LIBRARIES = {"site-packages", "dist-packages"}
_HIDDEN_DATA: tuple[DataFolder, ...] = ("tasks", "weather", "submissions", "reports/released/results")
_PACKAGE = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Bound:
    """A file or folder of this machine, and where it is inside."""

    outside: Path
    inside: Path


def interpreter() -> Path:
    """The Python program itself, behind all links and virtual environments."""
    return Path(sys.executable).resolve()


def libraries() -> tuple[Path, ...]:
    """Folders with installed packages, in the order in which they are searched."""
    return tuple(path for path in map(Path, sys.path) if path.name in _LIBRARIES and path.is_dir())


def arguments(submission: Identity, staging: Callable[[], Path]) -> list[str]:
    """Arguments for bubblewrap that make the files visible; ``staging`` makes an empty folder for copies, where some are needed."""
    own = _own_files(submission, staging)
    bounds = [*_python(), Bound(_PACKAGE, CODE / "glbench"), *own]
    covered = [inside for bound in bounds for inside in _secrets_below(bound)]
    lines = [
        *_system(),
        *_ways_to(bounds),
        *(_bind(bound) for bound in bounds),
        *(["--tmpfs", str(path)] for path in covered),
        *_data(),
    ]
    lines += [["--remount-ro", str(path)] for path in covered]
    lines += [line for bound in own for path in _no_parts_of_submission(bound.outside) for line in _hidden(path, bound)]
    return [word for line in lines for word in line]


def in_package(file: Path) -> Path:
    """Path inside of a file of glbench."""
    return CODE / "glbench" / file.resolve().relative_to(_PACKAGE)


def place_inside(submission: Identity) -> Path:
    """Path of the submission inside."""
    return SUBMISSION / submission.path.name


def _system() -> Iterator[list[str]]:
    for name in _SYSTEM:
        path = Path("/") / name
        if path.is_symlink():
            yield ["--symlink", str(path.readlink()), str(path)]
        elif path.is_dir():
            yield ["--ro-bind", str(path), str(path)]
    for name in _SETTINGS:
        yield ["--ro-bind-try", f"/etc/{name}", f"/etc/{name}"]


def _python() -> Iterator[Bound]:
    """The interpreter with its standard library, and the installed packages, at the same paths as outside."""
    base = Path(sys.base_prefix).resolve()
    for path in (interpreter(), base / "lib", base / "lib64", *libraries()):
        if path.exists() and not any(path.is_relative_to(f"/{name}") for name in _SYSTEM):
            yield Bound(path, path)


def _data() -> Iterator[list[str]]:
    """Of glbench's data the settings of the built-in controllers, and an empty folder of tasks."""
    if (_PACKAGE / "_data").is_dir():
        root = CODE / "glbench" / "_data"
    else:
        root = CODE
        yield ["--ro-bind", str(_PACKAGE.parent / "pyproject.toml"), str(CODE / "pyproject.toml")]  # marks a checkout
    yield ["--dir", str(root / "tasks")]
    yield ["--ro-bind", str(data_folder("baselines")), str(root / "baselines")]


def _own_files(submission: Identity, staging: Callable[[], Path]) -> list[Bound]:
    inside = place_inside(submission)
    if not submission.files:
        _refuse_links_out(submission.path)
        return [Bound(_readable(submission.path, staging), inside)]
    return [Bound(_readable(file, staging), inside.with_name(file.name)) for file in submission.files]


def _refuse_links_out(folder: Path) -> None:
    for link in (item for item in folder.rglob("*") if item.is_symlink() and is_part_of_submission(item, folder)):
        if link.readlink().is_absolute() or not link.resolve().is_relative_to(folder):
            msg = f"{link} is a link that leads out of the submission's folder, and out of its sandbox. Copy the file."
            raise SubmissionError(msg)


def _readable(path: Path, staging: Callable[[], Path]) -> Path:
    """``path``, or a copy of it that another user may read: an evaluation that runs as root starts its agents as somebody else."""
    if os.geteuid() != 0 or all(_others_may_read(item) for item in (path, *path.rglob("*"))):
        return path
    copy = staging() / path.name
    try:
        if path.is_dir():
            shutil.copytree(path, copy, symlinks=True)
        else:
            shutil.copy(path, copy)
        for item in (copy, *copy.rglob("*")):
            if not item.is_symlink():
                item.chmod(0o755 if item.is_dir() else 0o644)
    except OSError as error:
        msg = f"The submission {path} cannot be copied for its sandbox: {error}. Make its files readable for all: chmod -R a+rX {path}."
        raise GlbenchError(msg) from error
    return copy


def _others_may_read(path: Path) -> bool:
    mode = path.lstat().st_mode
    needed = stat.S_IROTH | (stat.S_IXOTH if stat.S_ISDIR(mode) else 0)
    return stat.S_ISLNK(mode) or mode & needed == needed


def _ways_to(bounds: list[Bound]) -> Iterator[list[str]]:
    """The folders above, which bubblewrap would make for its own user only."""
    above = {folder for bound in bounds for folder in bound.inside.parents if folder != Path("/")}
    yield from (["--perms", "0755", "--dir", str(folder)] for folder in sorted(above))


def _secrets_below(bound: Bound) -> Iterator[Path]:
    """Folders inside that must be covered because ``bound`` brings them along."""
    outside = bound.outside.resolve()
    secrets = {*_data_folders(), user_data_folder().resolve(), cache_folder().resolve()}
    for secret in sorted(secrets):
        if secret.is_dir() and secret.is_relative_to(outside) and secrets.isdisjoint(secret.parents):
            yield bound.inside / secret.relative_to(outside)


def _data_folders() -> Iterator[Path]:
    # An editable installation leaves a second copy of the data among the libraries.
    yield from ((path / "glbench" / "_data").resolve() for path in libraries())
    yield from (data_folder(name).resolve() for name in _HIDDEN_DATA)
    yield (_PACKAGE / "_data").resolve()


def _no_parts_of_submission(folder: Path) -> Iterator[Path]:
    """Hidden files and caches in a submission's folder: its digest does not cover them, so the agent does not see them."""
    for place, folders, files in os.walk(folder):
        hidden = [name for name in folders if name.startswith(".") or name == "__pycache__"]
        folders[:] = [name for name in folders if name not in hidden]
        yield from (Path(place) / name for name in [*hidden, *(file for file in files if file.startswith("."))])


def _bind(bound: Bound) -> list[str]:
    return ["--ro-bind", str(bound.outside), str(bound.inside)]


def _hidden(path: Path, within: Bound) -> list[list[str]]:
    inside = str(within.inside / path.relative_to(within.outside))
    if path.is_symlink():
        return []  # a link to a place that is not there
    return [["--tmpfs", inside], ["--remount-ro", inside]] if path.is_dir() else [["--ro-bind", "/dev/null", inside]]
