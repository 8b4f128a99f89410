"""The files of this machine that an agent in the sandbox can see: an allow-list.

The file system inside starts empty. It gets

- copies of the files that the submission's digest covers, made while the digest is computed again;
- the source of glbench, the pages of its rules by observations (``_RULES``), and the compiled kernels of the task's model;
- Python, its standard library, and the installed packages on the search path;
- programs, libraries and headers of the system, and its time zones (``SYSTEM``).

All other data of glbench are missing: weather, tasks, plans, recordings, policies, results and submissions. If a folder of packages
or of the system contains such data, ``_covered`` puts an empty folder in their place.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

from glbench.agents import Identity
from glbench.agents.identity import digest_of
from glbench.errors import GlbenchError, SubmissionError, refuse
from glbench.resources import DataFolder, cache_folder, data_folder, user_data_folder

CODE: Final = Path("/opt/glbench")  # Path of glbench inside the sandbox; it exists on no machine
SUBMISSION: Final = Path("/submission")  # Path of the submission inside
KERNELS: Final = CODE / "kernels"  # Path of compiled kernels inside
SYSTEM: Final = (
    "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/usr/bin", "/usr/sbin", "/usr/lib", "/usr/lib32", "/usr/lib64", "/usr/libexec",
    "/usr/include", "/usr/local/bin", "/usr/local/lib", "/usr/local/lib64", "/usr/share/zoneinfo", "/nix/store",
    "/etc/ld.so.cache", "/etc/ld.so.conf", "/etc/ld.so.conf.d", "/etc/alternatives",
)  # fmt: skip
"""Files and folders of the system, at the same places inside."""
_LIBRARIES = ("site-packages", "dist-packages")
_DATA_OF_PACKAGES = ("glbench", "glbench_data", "pvlib/data", "lettuce_greenhouse_gym/data")
"""Folders of packages that stay empty. glbench is visible at ``CODE``, without its data; the others contain weather of tasks."""
_RULES = (
    "grower/card.toml", "grower/settings.toml", "rule_based/rule_based.yml", "rule_based_fair/card.toml",
    "rule_based_tuned/card.toml", "rule_based_tuned/rules", "rule_based_energy/card.toml", "rule_based_energy/rules",
)  # fmt: skip
"""Cards and settings of the rules that a submission may build on, below the folder of baselines."""
_PACKAGE = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Bound:
    """A file or folder of this machine, with links resolved, and its path inside."""

    outside: Path
    inside: Path


def interpreter() -> Path:
    """The Python program itself, behind all links and virtual environments."""
    return Path(sys.executable).resolve()


def libraries() -> tuple[Path, ...]:
    """Folders with installed packages, in the order in which they are searched."""
    return tuple(path for path in map(Path, sys.path) if path.name in _LIBRARIES and path.is_dir())


def in_package(file: Path) -> Path:
    """Path inside of a file of glbench."""
    return CODE / "glbench" / file.resolve().relative_to(_PACKAGE)


def place_inside(submission: Identity) -> Path:
    """Path of the submission inside."""
    return SUBMISSION / submission.path.name


def visible_files(submission: Identity, staging: Callable[[], Path], kernels: Mapping[str, Path] | None = None) -> list[str]:
    """Arguments for bubblewrap that make the files of ``submission`` visible, as copies.

    ``staging`` makes a folder for the copies and returns its path; ``kernels`` are the compiled kernels by their names inside, and the rest
    of the cache stays hidden. Raises ``SubmissionError`` when the submission contains data of glbench or of the user, or changed after its
    digest was computed, and ``GlbenchError`` when its files cannot be copied.
    """
    covered = _covered()
    bounds = _visible_files(covered)
    binds = [*bounds, _copies(submission, staging), *_marks_and_kernels(kernels or {})]
    empty = sorted(set(_empty(bounds, covered)))
    words = {path: ["--symlink", str(path.readlink()), str(path)] for path in _system() if path.is_symlink()}
    words |= {bound.inside: ["--ro-bind", str(bound.outside), str(bound.inside)] for bound in binds}
    words |= {path: ["--tmpfs", str(path)] for path in empty}
    folders = {above for path in words for above in path.parents[:-1]} | {_data_inside() / "tasks", KERNELS}
    # By default bubblewrap makes folders that only its own user can read.
    words |= {folder: ["--perms", "0755", "--dir", str(folder)] for folder in folders - words.keys()}
    lines = [words[path] for path in sorted(words, key=lambda path: (len(path.parts), path))]
    return [word for line in [*lines, *(["--remount-ro", str(path)] for path in empty)] for word in line]


def is_visible(file: Path, submission: Identity) -> bool:
    """Whether ``file`` of this machine is visible inside, whatever its permissions."""
    file = file.resolve()
    covered = _covered()
    return _is_below(file, _visible_files(covered), covered) or file in submission.all_files()


def _system() -> Iterator[Path]:
    yield from filter(Path.exists, map(Path, SYSTEM))


def _visible_files(covered: set[Path]) -> list[Bound]:
    """The visible files of the system, of Python and of glbench, except the folders ``covered``."""
    bounds = [Bound(path, path) for path in _system() if not path.is_symlink()]
    base = Path(sys.base_prefix).resolve()
    for path in (interpreter(), base / "lib", base / "lib64", *libraries()):
        of_system = any(path.is_relative_to(place) for place in SYSTEM) and _is_below(path.resolve(), bounds, covered)
        if path.exists() and not of_system:
            bounds.append(Bound(path.resolve(), path))
    baselines = data_folder("baselines").resolve()
    rules = [Bound(baselines / name, _data_inside() / "baselines" / name) for name in _RULES]
    return [*bounds, Bound(_PACKAGE, CODE / "glbench"), *rules]


def _is_below(file: Path, bounds: Iterable[Bound], covered: Iterable[Path]) -> bool:
    return any(
        file.is_relative_to(bound.outside)
        and not any(file.is_relative_to(folder) and bound.outside in folder.parents for folder in covered)
        for bound in bounds
    )


def _covered() -> set[Path]:
    """Folders that stay empty inside where something above them is visible."""
    usable = {path.resolve() for path in libraries()}
    folders = {path / place for path in usable for place in _DATA_OF_PACKAGES} | _own_data()
    return {folder for folder in folders if folder.is_dir()} | (_installations(SYSTEM, sys.base_prefix) - usable)


@cache
def _installations(system: tuple[str, ...], base: str) -> frozenset[Path]:
    """Package folders of all Python installations below visible folders."""
    roots = [*(Path(place) for place in system if "lib" in Path(place).name), Path(base) / "lib", Path(base) / "lib64"]
    pythons = [folder for root in roots if root.is_dir() for folder in root.iterdir() if folder.name.startswith("python")]
    places = [folder / name for folder in pythons for name in _LIBRARIES]
    return frozenset(place.resolve() for place in places if place.is_dir())


def _own_data() -> set[Path]:
    """Folders with data of glbench and of the user."""
    own = _PACKAGE / "_data"
    checkout = set() if own.is_dir() else {_PACKAGE.parent}
    names: tuple[DataFolder, ...] = ("tasks", "baselines", "weather", "submissions", "reports/released/results")
    shipped = {data_folder(name).resolve() for name in names}
    return checkout | shipped | {own, user_data_folder().resolve(), cache_folder().resolve()}


def _empty(bounds: Iterable[Bound], covered: set[Path]) -> Iterator[Path]:
    """Folders that must be empty inside; nested ones only if something visible is between them."""
    inside_of: dict[Path, list[Path]] = {}
    for bound in bounds:
        inside_of.setdefault(bound.outside, []).append(bound.inside)
    for folder in covered:
        for above in folder.parents:
            yield from (inside / folder.relative_to(above) for inside in inside_of.get(above, ()))
            if above in covered:
                break


def _data_inside() -> Path:
    """Path of glbench's data inside: in the package of a wheel, or beside the package of a checkout."""
    return CODE / "glbench" / "_data" if (_PACKAGE / "_data").is_dir() else CODE


def _marks_and_kernels(kernels: Mapping[str, Path]) -> Iterator[Bound]:
    yield from (Bound(file, KERNELS / name) for name, file in kernels.items())
    shipped, checkout = _PACKAGE / "_data" / "kernel", _PACKAGE.parent / "pyproject.toml"
    if shipped.is_dir():
        yield Bound(shipped, _data_inside() / "kernel")
    if _data_inside() == CODE:
        yield Bound(checkout, CODE / "pyproject.toml")  # by which glbench knows a checkout


def _copies(submission: Identity, staging: Callable[[], Path]) -> Bound:
    """Copies of the submission's files."""
    place = place_inside(submission)
    try:
        files = submission.all_files()
        for folder in _own_data():
            if folder.is_relative_to(submission.path) and any(file.is_relative_to(folder) for file in files):
                msg = f"The folder {submission.path} contains {folder}, which no agent may see. Put the agent into a separate folder."
                raise SubmissionError(msg)
        root = staging() / "submission"
        if submission.folder is not None:
            root /= place.name
        root.mkdir(parents=True)
        digest = digest_of(files, submission.root, root)
    except OSError as error:
        refuse(f"The submission {submission.path} cannot be copied for its sandbox: {error}.", GlbenchError, error)
    if digest != submission.digest:
        msg = f"The files of {submission.path} were changed after its evaluation began. Leave them as they are until it ends."
        raise SubmissionError(msg)
    return Bound(root, place if submission.folder is not None else place.parent)
