"""Where the data folders are, in a checkout and in an installed wheel; and how files are written.

The folders ``tasks``, ``baselines``, ``weather``, ``submissions`` and ``reports`` stand beside the package in a checkout and
inside it (``glbench/_data``) in a wheel. Nothing in them is ever imported as a module of the package. A wheel holds neither large
policies and plans, nor the profiles of released results, nor pictures: these are in a second package, ``glbench-data``.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, Final, Literal

from glbench.errors import GlbenchError, refuse
from glbench.untrusted import real_path, reason_of

if TYPE_CHECKING:
    import filelock

DataFolder = Literal["tasks", "baselines", "weather", "submissions", "reports/released/results", "images"]

_PACKAGE = Path(__file__).resolve().parent

_SCRATCH: Final = "glbench-scratch-"
_IN_USE: Final = ".in-use"
_ABANDONED_SECONDS: Final = 60.0  # Younger folders may not have their lock yet

TEXT_SUFFIXES = frozenset(
    f".{suffix}"
    for words in ("c cc cfg cpp css csv h hpp html in ini ipynb j2 js json jsonl", "md py pyi rst sh toml txt xml yaml yml")
    for suffix in words.split()
)
TEXT_NAMES = frozenset({"COPYING", "LICENCE", "LICENSE", "NOTICE", "README"})
LARGEST_TEXT = 16 * 2**20  # Largest text file whose line endings are normalised for its digest [bytes]


@dataclass(frozen=True)
class DataPackage:
    """The package with all baselines and released results, ``glbench-data``, as this wheel was built with."""

    version: str
    sha256: str
    """``version`` and ``sha256``: of the package that belongs to this wheel."""
    left_out: Mapping[str, str]
    """Baselines whose policies or plans are only there, and their digests."""
    tasks: Sequence[str] = ()
    """Tasks, without their namespace, whose released results are only there."""
    folder: Path | None = None
    """Where it is installed; None where it is not, or where another version is."""


def data_folder(name: DataFolder) -> Path:
    """Folder of the shipped data ``name``: the checkout's own, else that of ``glbench-data``, else the part of it in the wheel."""
    packaged, beside = _PACKAGE / "_data" / name, data_package()
    if beside is not None and beside.folder is not None and (beside.folder / name).is_dir():
        return beside.folder / name
    if packaged.is_dir():
        return packaged
    if name == "images" and lacks_pictures():
        raise GlbenchError(how_to_get_data("The library of pictures is") + ".")
    checkout = _PACKAGE.parent / ("glbench-data/images" if name == "images" else name)
    if checkout.is_dir() and (_PACKAGE.parent / "pyproject.toml").is_file():
        return checkout
    msg = (
        f"glbench's data folder '{name}' is neither at {packaged} nor at {checkout}. "
        "The installation is incomplete: install glbench again, or run from a complete checkout."
    )
    raise GlbenchError(msg)


def lacks_pictures() -> bool:
    """Whether the pictures of the crop are in ``glbench-data``, and that is not installed."""
    beside = data_package()
    return beside is not None and beside.folder is None


def data_package() -> DataPackage | None:
    """The package with all of the data; None where nothing is missing without it, as in a checkout."""
    return _data_package(_PACKAGE / "_data" / "data.json")


@cache
def _data_package(manifest: Path) -> DataPackage | None:
    try:
        package = DataPackage(**json.loads(manifest.read_bytes()))
    except FileNotFoundError:
        return None
    spec = importlib.util.find_spec("glbench_data")
    if spec is None or spec.origin is None:
        return package
    folder = Path(spec.origin).parent
    try:
        its_sha256 = json.loads((folder / "manifest.json").read_bytes())["sha256"]
    except (OSError, ValueError, KeyError):
        return package
    return replace(package, folder=folder) if its_sha256 == package.sha256 else package


def left_out() -> Mapping[str, str]:
    """Baselines whose policies or plans are not installed here, and their digests."""
    package = data_package()
    return {} if package is None or package.folder is not None else package.left_out


def where_results_are(task_ids: Iterable[str]) -> str:
    """A sentence on the released results of these tasks that are not installed here, with a space before it; empty if all are."""
    package = data_package()
    if package is None or package.folder is not None or not {task_id.rpartition("/")[2] for task_id in task_ids} & {*package.tasks}:
        return ""
    return f" {how_to_get_data('The released ones are')}"


def how_to_get_data(what: str = "It is") -> str:
    """What to do where something of ``glbench-data`` is asked for, and missing; ``what`` begins the sentence."""
    package = data_package()
    assert package is not None, "nothing of a checkout is in another package"
    return f"{what} in the package glbench-data {package.version}, which is not installed: pip install glbench-data=={package.version}"


def is_released(path: Path) -> bool:
    """Whether ``path`` is one of the results that came with glbench: read-only data, renewed by a release alone."""
    return real_path(path).is_relative_to(data_folder("reports/released/results").resolve())


def user_data_folder() -> Path:
    """Folder for what users add (weather); ``GLBENCH_DATA`` overrides the platform's. Raises ``GlbenchError`` without it and a home."""
    return _user_folder("GLBENCH_DATA", "XDG_DATA_HOME", ".local/share")


def cache_folder() -> Path:
    """Folder for things that can be made again; ``GLBENCH_CACHE`` overrides the platform's default. Errors as for ``user_data_folder``."""
    return _user_folder("GLBENCH_CACHE", "XDG_CACHE_HOME", ".cache")


def _user_folder(variable: str, of_platform: str, usual: str) -> Path:
    """The folder that ``variable`` names; otherwise below the platform's or the ``usual`` one in the user's home."""
    override, base = os.environ.get(variable), os.environ.get(of_platform)
    if override:
        return Path(override).expanduser()
    try:
        return (Path(base) if base else Path.home() / usual) / "glbench"
    except RuntimeError as error:
        # A folder for all users, such as /tmp, will not do: compiled kernels are loaded from there.
        refuse(f"This user has no home folder: set HOME, or {variable}, to a folder that only this user may write to.", GlbenchError, error)


@contextlib.contextmanager
def signal_handlers_kept(numbers: Iterable[int]) -> Iterator[dict[int, Any]]:
    """Handlers of signals, which are put back afterwards; none in another thread than the main one, which alone may set handlers.

    A handler that was not set from Python cannot be put back, and is left out.
    """
    is_main = threading.current_thread() is threading.main_thread()
    handlers = {number: signal.getsignal(number) for number in numbers} if is_main else {}
    handlers = {number: handler for number, handler in handlers.items() if handler is not None}
    try:
        yield handlers
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def standard_output_to(descriptor: int) -> Iterator[None]:
    """What code in C writes to standard output goes to another open file."""
    sys.stdout.flush()
    copy = os.dup(1)
    os.dup2(descriptor, 1)
    try:
        yield
    finally:
        os.dup2(copy, 1)
        os.close(copy)


def write_atomically(path: Path, data: bytes | str) -> None:
    """Write ``data`` to ``path`` so that a reader sees the old file or the new one, never a part.

    Raises ``GlbenchError`` when the folder cannot be made or written to (missing permission, full disk, a file in the way).
    """
    import tempfile  # not at the top: sandboxed agents, who write nothing, would wait for it

    payload = data.encode("utf-8") if isinstance(data, str) else data
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".partial", dir=path.parent)
        temporary = Path(name)
        with os.fdopen(handle, "wb") as file:
            file.write(payload)
            file.flush()
            os.fsync(file.fileno())
        # mkstemp makes files private; results are meant to be shared like any other file.
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(path)
    except OSError as error:
        refuse(f"Cannot write {path}: {reason_of(error)}. Choose a folder that you may write to, or free some space.", GlbenchError, error)
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


class Scratch:
    """A folder of this user alone for temporary files, made when asked for; if its process is killed, the next one removes it."""

    def __init__(self) -> None:
        self._folder: Path | None = None
        self._lock: filelock.BaseFileLock | None = None

    def folder(self) -> Path:
        """The folder."""
        import tempfile

        import filelock

        if self._folder is None:
            _remove_abandoned(Path(tempfile.gettempdir()))
            self._folder = Path(tempfile.mkdtemp(prefix=_SCRATCH))
            self._lock = filelock.FileLock(self._folder / _IN_USE)
            self._lock.acquire()
        return self._folder

    def remove(self) -> None:
        """Remove the folder, if there is one."""
        import shutil

        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
        if self._lock is not None:
            self._lock.release()
        self._folder = self._lock = None


def _remove_abandoned(place: Path) -> None:
    """Remove the scratch folders of processes that were killed: their locks are free."""
    import shutil

    import filelock

    for folder in place.glob(f"{_SCRATCH}*"):
        with contextlib.suppress(OSError, filelock.Timeout):  # another user's, or in use
            if time.time() - folder.stat().st_mtime > _ABANDONED_SECONDS and (folder / _IN_USE).is_file():
                with filelock.FileLock(folder / _IN_USE, blocking=False):
                    shutil.rmtree(folder, ignore_errors=True)


def is_text(name: str) -> bool:
    """Whether the file ``name`` is text, judged by its suffix."""
    path = PurePosixPath(name)
    return path.suffix.lower() in TEXT_SUFFIXES or path.name in TEXT_NAMES


def with_unix_line_ends(name: str, content: bytes) -> bytes:
    """``content`` of the file ``name`` as digests cover it: in text, CRLF and CR become LF, so that git's line endings change no digest.

    Files that are not text, have a null byte or have more than ``LARGEST_TEXT`` bytes stay unchanged.
    """
    if not is_text(name) or len(content) > LARGEST_TEXT or b"\r" not in content or b"\0" in content:
        return content
    return content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")


def sha256_of_files(root: Path, files: list[Path]) -> str:
    """SHA-256 over names (relative to ``root``) and contents of ``files``, independent of their order and of the line ends of text."""
    digest = hashlib.sha256()
    for file in sorted(files, key=lambda f: f.relative_to(root).as_posix()):
        name = file.relative_to(root).as_posix().encode("utf-8")
        content = with_unix_line_ends(file.name, file.read_bytes())
        digest.update(len(name).to_bytes(8, "big") + name + len(content).to_bytes(8, "big") + content)
    return digest.hexdigest()
