"""What is sent to another machine: task and agent, with everything that must match on both machines, and files that the other may lack."""

from __future__ import annotations

import hashlib
import os
import platform
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from glbench import __version__
from glbench.agents.identity import baseline_names, files_of_folder, identify
from glbench.env.kernels import shared_kernel
from glbench.episodes.header import definition_json, task_of
from glbench.errors import GlbenchError, SubmissionError
from glbench.execution import write_files
from glbench.kernel import built_libraries, why_not_compiled
from glbench.resources import Scratch, cache_folder, write_atomically
from glbench.tasks import TaskSpec
from glbench.weather import user_file

_CACHE = "travelled"
"""Cache folder for files received from another machine."""
_FEATURES = ("flags", "Features")
"""Linux's name for the line that lists a processor's features, on x86-64 and on AArch64."""


@dataclass(frozen=True)
class PackedTask:
    """A task in one of its splits, and what would change numbers if it differed: its digest, the kernel, the version of glbench."""

    definition: bytes
    split: str
    digest: str
    kernel: Mapping[str, str | float]
    version: str = __version__
    sealed: str = field(default="", repr=False)
    """The secret of the round, if there is one: it is sent to the workers, but never written by them."""

    @classmethod
    def of(cls, task: TaskSpec) -> PackedTask:
        """Pack a task."""
        kernel = shared_kernel(task.model_value, task.step_seconds).describe()
        return cls(definition_json(task), task.split or "", task.digest, kernel, sealed=task.sealed)

    def unpack(self) -> TaskSpec:
        """The task.

        Raises
        ------
        GlbenchError
            When this machine's numbers would differ from those of the machine that packed it.
        """
        if self.version != __version__:
            msg = f"The worker has glbench {__version__}, this machine {self.version}. Install the same version on all machines."
            raise GlbenchError(msg)
        task = task_of(self.definition)
        task = task.in_split(self.split, self.sealed) if self.split else task
        if self.digest != task.digest:
            msg = "The worker's weather, parameters or model differ from those of this machine: the task has a different digest there."
            raise GlbenchError(msg)
        kernel = shared_kernel(task.model_value, task.step_seconds).describe()
        if dict(self.kernel) != kernel:
            reason = why_not_compiled(task.model_value) or f"It has {kernel}."
            msg = f"The worker's kernel differs from this machine's, which would change the numbers. {reason}"
            raise GlbenchError(msg)
        return task


@dataclass(frozen=True)
class PackedAgent:
    """An agent to be sent: the name of a baseline, or the files of a submission. ``name`` is that of its file or folder."""

    name: str
    files: tuple[tuple[str, bytes], ...] = ()
    is_folder: bool = False

    @classmethod
    def of(cls, ref: str) -> PackedAgent:
        """Pack the agent ``ref``.

        Raises
        ------
        SubmissionError
            When its files cannot be read.
        """
        if ref in baseline_names():
            return cls(ref)
        path = Path(ref).expanduser().resolve()
        identity = identify(path)
        own = identity.files if identity is not None else ()
        root = path.parent if own else path
        try:
            files = [(file.relative_to(root).as_posix(), file.read_bytes()) for file in own or files_of_folder(path)]
        except OSError as error:
            msg = f"The submission {path} cannot be packed: {error}. Check that its files exist and may be read."
            raise SubmissionError(msg) from error
        return cls(path.name, tuple(files), is_folder=not own)

    @contextmanager
    def unpack(self) -> Iterator[str]:
        """The agent as ``prepare`` takes it; the files are gone afterwards."""
        if not self.files:
            yield self.name
            return
        scratch = Scratch()
        try:
            root = scratch.folder() / self.name if self.is_folder else scratch.folder()
            write_files(root, dict(self.files))
            yield str(scratch.folder() / self.name)
        finally:
            scratch.remove()


@dataclass(frozen=True)
class Payload:
    """Files of this machine that tasks need: weather that the user imported, and the compiled kernels.

    Attributes
    ----------
    weather, kernels
        By the names that the files need.
    processor
        Features of the processor that the kernels were compiled for.
    """

    weather: Mapping[str, bytes]
    kernels: Mapping[str, bytes]
    processor: frozenset[str]

    @classmethod
    def of(cls, tasks: Iterable[TaskSpec], *, for_plans: bool = False) -> Payload:
        """What ``tasks`` need; ``for_plans`` kernels are built first, derivatives included.

        Raises
        ------
        GlbenchError
            When a file cannot be read, or a task's weather is not there.
        """
        from glbench.control.stage import judged_at_the_end  # not at the top: it brings the optimisers

        weather, kernels = dict[str, Path](), dict[str, Path]()
        for task in tasks:
            for name in {task.record().name, task.season_record().name}:
                file = user_file(name)
                if file is not None:
                    weather[file.name] = file
            # Planning leaves out the meters of violations (docs/control.md), which makes it a different model.
            for model in (task.model_value, judged_at_the_end(task).model_value):
                kernels |= built_libraries(model, for_plans=for_plans)
        try:
            return cls(
                {name: file.read_bytes() for name, file in sorted(weather.items())},
                {name: file.read_bytes() for name, file in sorted(kernels.items())},
                processor(),
            )
        except OSError as error:
            msg = f"Cannot pack the files that the workers need: {error}. Check that the file exists and may be read."
            raise GlbenchError(msg) from error

    def unpack(self) -> None:
        """Make this process use the files. Kernels are used only if the processor has all features that they may use.

        They are kept in the cache under their digest, and all processes of a machine share them.
        """
        if self.weather:
            os.environ["GLBENCH_DATA"] = str(_cached({f"weather/{name}": file for name, file in self.weather.items()}))
        if self.kernels and self.processor <= processor():
            os.environ["GLBENCH_KERNELS"] = str(_cached(self.kernels))


def _cached(files: Mapping[str, bytes]) -> Path:
    """The folder in the cache that holds ``files``."""
    digest = hashlib.sha256()
    for name, content in files.items():
        digest.update(f"{name} {hashlib.sha256(content).hexdigest()}\n".encode())
    folder = cache_folder() / _CACHE / digest.hexdigest()[:20]
    for name, content in files.items():
        file = folder / name
        if not file.is_file() or file.read_bytes() != content:
            write_atomically(file, content)
    return folder


@cache
def processor() -> frozenset[str]:
    """The kind of system and processor, and the processor's features as far as the system lists them."""
    facts = {sys.platform, platform.machine()}
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:  # another system: only the very same processor will do
        return frozenset({*facts, platform.processor(), platform.node()})
    features = next((line for line in lines if line.startswith(_FEATURES)), "")
    return frozenset({*facts, *features.partition(":")[2].split()})
