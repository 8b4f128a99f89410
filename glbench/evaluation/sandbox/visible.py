"""What the process of a sandboxed agent sees of the disk: its own files, Python with its libraries, glbench without its data.

Nothing is visible that is not listed here. Of a submission it is copies of the files that its digest covers, made while the digest is
computed again. Folders with weather, tasks (they hold the seeds), results and other submissions are covered wherever they would show
through, as they do when glbench is installed among the libraries; a submission's folder that holds them is refused.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from glbench.agents import Identity
from glbench.agents.contents import digest_of
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
    """Arguments for bubblewrap that make the files visible; ``staging`` makes a folder for the copies of the submission's files."""
    bounds = [*_python(), Bound(_PACKAGE, CODE / "glbench"), _own_files(submission, staging)]
    covered = [inside for bound in bounds for inside in _secrets_below(bound)]
    lines = [
        *_system(),
        *_ways_to(bounds),
        *(_bind(bound) for bound in bounds),
        *(["--tmpfs", str(path)] for path in covered),
        *_data(),
    ]
    lines += [["--remount-ro", str(path)] for path in covered]
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


def _own_files(submission: Identity, staging: Callable[[], Path]) -> Bound:
    """Copies of the submission's files."""
    place = place_inside(submission)
    try:
        files = submission.all_files()
        for secret in _secrets():
            if secret.is_relative_to(submission.path) and any(file.is_relative_to(secret) for file in files):
                msg = f"The folder {submission.path} holds {secret}, which no agent may see. Put the agent into a folder of its own."
                raise SubmissionError(msg)
        root = staging() / "submission"
        if submission.folder is not None:
            root /= place.name
        root.mkdir(parents=True)
        digest = digest_of(files, submission.root, root)
    except OSError as error:
        msg = f"The submission {submission.path} cannot be copied for its sandbox: {error}."
        raise GlbenchError(msg) from error
    if digest != submission.digest:
        msg = f"The files of {submission.path} were changed after its evaluation began. Leave them as they are until it ends."
        raise SubmissionError(msg)
    return Bound(root, place if submission.folder is not None else place.parent)


def _ways_to(bounds: list[Bound]) -> Iterator[list[str]]:
    """The folders above, which bubblewrap would make for its own user only."""
    above = {folder for bound in bounds for folder in bound.inside.parents if folder != Path("/")}
    yield from (["--perms", "0755", "--dir", str(folder)] for folder in sorted(above))


def _secrets_below(bound: Bound) -> Iterator[Path]:
    """Folders inside that must be covered because ``bound`` brings them along."""
    outside = bound.outside.resolve()
    for secret in _secrets():
        if secret.is_relative_to(outside):
            yield bound.inside / secret.relative_to(outside)


def _secrets() -> list[Path]:
    """Folders that no agent may see, none of which lies in another."""
    # An editable installation leaves a second copy of the data among the libraries.
    folders = {(path / "glbench" / "_data").resolve() for path in libraries()}
    folders |= {data_folder(name).resolve() for name in _HIDDEN_DATA}
    folders |= {(_PACKAGE / "_data").resolve(), user_data_folder().resolve(), cache_folder().resolve()}
    return [folder for folder in sorted(folders) if folder.is_dir() and folders.isdisjoint(folder.parents)]


def _bind(bound: Bound) -> list[str]:
    return ["--ro-bind", str(bound.outside), str(bound.inside)]
