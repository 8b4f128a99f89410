"""Writes a task's greenhouse as an FMU: PythonFMU packs a small program, which runs the glbench of the importing machine."""

from __future__ import annotations

import json
import re
import sys
import tempfile
from importlib import metadata
from pathlib import Path

from glbench import __version__
from glbench.errors import TaskError, refuse
from glbench.extras import require
from glbench.fmu.scenario import FmuSetup, splits_of, task_in_season
from glbench.registration import task_ids
from glbench.resources import write_atomically
from glbench.tasks import TaskSpec

_PROGRAM = '''"""The greenhouse of {task} as an FMU, written by glbench export fmu."""

import sys

import pythonfmu

# For every instance PythonFMU 0.7.0 releases a reference to these names that it did not take: hold one for each.
vars(pythonfmu).setdefault("held", []).append(globals())

try:
    from glbench.fmu.scenario import FmuSetup
    from glbench.fmu.slave import GreenhouseSlave
except ImportError as error:
    FmuSetup, PROBLEM = dict, (
        "This FMU needs glbench {version} in the Python that runs it, Python "
        f"{{sys.version.partition(' ')[0]}} in {{sys.prefix}}, where it cannot be imported ({{error}}). "
        "Install it there, as the README of glbench says. In a tool that is no Python program, name its packages in PYTHONPATH."
    )

    class GreenhouseSlave(pythonfmu.Fmi2Slave):
        def __init__(self, **options):
            raise RuntimeError(PROBLEM)

        def do_step(self, current_time, step_size):
            return False


class {name}(GreenhouseSlave):
    setup = {setup!r}
'''


def export_fmu(task: TaskSpec, file: Path, *, seed: int = 1, split: str | None = None, replace: bool = False) -> None:
    """Write the greenhouse of ``task`` to ``file``, with the ending ``.fmu``, as an FMU for FMI 2.0 co-simulation.

    ``seed`` and ``split`` are start values of its parameters, which an importer can change; without a split it is validation if the task
    has it, else training. Raises ``GlbenchError`` without PythonFMU; for another ending, a file that is there unless ``replace``, a test
    season or an impossible seed; when the file cannot be written.
    """
    require("An FMU", "fmu", "pythonfmu")
    if file.suffix != ".fmu":
        refuse(f"{file} should end with .fmu.", TaskError)
    if file.exists() and not replace:
        refuse(f"{file} exists already. Choose another name, or replace it with --replace.", TaskError)
    splits = splits_of(task)
    split = ("validation" if "validation" in splits else splits[0]) if split is None else split
    task_in_season(task, split, seed)
    from pythonfmu.builder import FmuBuilder

    name = re.sub(r"\W|^(?=\d)", "_", task.short_id)  # it becomes a class in Python
    definition = "" if task.id in task_ids() else json.dumps(task.attachment(), ensure_ascii=True)
    setup = FmuSetup(task.id, task.digest, definition, int(seed), split, __version__)
    program = _PROGRAM.format(name=name, task=task.id, setup=setup, version=__version__)
    module = f"{name}_{setup.fingerprint[:12]}"  # importers load several into one Python: each is a module of its own
    path = list(sys.path)
    with tempfile.TemporaryDirectory(prefix="glbench-fmu-") as scratch:
        source, documentation = Path(scratch, "source"), Path(scratch, "documentation")
        (documentation / "licenses").mkdir(parents=True)
        source.mkdir()
        (source / f"{module}.py").write_text(program, encoding="utf-8")
        # The licence asks to be passed on with the program.
        licence = metadata.distribution("pythonfmu").read_text("licenses/LICENSE") or "PythonFMU: MIT licence"
        (documentation / "licenses" / "pythonfmu.txt").write_text(licence, encoding="utf-8")
        try:
            built = FmuBuilder.build_FMU(
                source / f"{module}.py", Path(scratch, "greenhouse.fmu"), documentation_folder=documentation,
                canHandleVariableCommunicationStepSize=False, canGetAndSetFMUstate=True, canSerializeFMUstate=True,
            )  # fmt: skip
        finally:  # PythonFMU imports the program, and leaves its folder on the path
            sys.path[:] = path
            sys.modules.pop(module, None)
        write_atomically(file, built.read_bytes())
