"""From a path or a name to an agent that can be run (``load_agent``); and submissions to start from.

A submission is a Python file with a function ``make_agent(task)``, a saved policy, or a folder with one of the two (``identity.py`` tells
them apart). A baseline is a name; its data are in ``baselines/<name>``. A submission's file is run as a module without leaving traces: no
bytecode in its folder, no names in the way of others. This keeps submissions apart from each other; it is no sandbox.
"""

from __future__ import annotations

import contextlib
import inspect
import shlex
import shutil
import sys
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib.machinery import ModuleSpec
from importlib.util import module_from_spec
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal, get_args

from glbench.agents import identity
from glbench.agents.protocol import Agent, PerRunAgent, PrivilegedController, ScenarioController, Sight, SingleRunAgent
from glbench.errors import GlbenchError, SubmissionError, did_you_mean, last_line, refuse
from glbench.resources import data_folder, with_unix_line_ends, write_atomically

if TYPE_CHECKING:
    from glbench.agents.baselines import Baseline
    from glbench.tasks import TaskCard


_LONGEST_LINE = 120
_NEVER_SHADOWED = sys.stdlib_module_names | {"glbench"}


def import_file(file: Path, name: str, folder: Path | None) -> ModuleType:
    """Execute ``file`` as a new module called ``name`` and return it.

    ``folder`` is the submission's folder when it is one; its other modules can then be imported, by ``from . import helper`` at
    any time and by ``import helper`` while the submission is being loaded. Raises ``SubmissionError`` when the file is no valid Python, or
    raises. The message holds the last line of the traceback and the place.
    """
    try:
        code = compile(file.read_bytes(), str(file), "exec", dont_inherit=True)
    except (SyntaxError, ValueError) as error:
        refuse(f"{file.name} is no valid Python: {last_line(error)}{_place_of_syntax_error(error, file)}.", SubmissionError, error)
    except (MemoryError, RecursionError) as error:
        refuse(f"{file.name} is no valid Python: it is nested too deeply, or too large ({last_line(error)}).", SubmissionError, error)
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
        refuse(f"{file.name} fails while it is loaded: {describe_error(error, folder or file)}.{hint}", SubmissionError, error)
    return module


@contextlib.contextmanager
def at_home(folder: Path | None) -> Iterator[None]:
    """Let ``import helper`` find the modules of a submission's ``folder``, and forget them again; never write bytecode."""
    wrote_no_bytecode, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    own: set[str] = set()
    if folder is not None:  # names of the standard library and glbench keep their meaning
        names = {file.stem for file in folder.glob("*.py")} | {item.name for item in folder.iterdir() if item.is_dir()}
        own = {name for name in names if name.isidentifier() and name not in _NEVER_SHADOWED}
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
    own = [frame for frame in frames if within in (Path(frame.filename), *Path(frame.filename).parents)]
    if not frames:
        return last_line(error)
    frame = (own or list(frames))[-1]
    return f"{last_line(error)} ({Path(frame.filename).name}:{frame.lineno}, in {frame.name})"


def _place_of_syntax_error(error: SyntaxError | ValueError, file: Path) -> str:
    if not isinstance(error, SyntaxError) or error.lineno is None:
        return ""
    line = (error.text or "").strip()
    short = line if len(line) <= _LONGEST_LINE else f"{line[: _LONGEST_LINE - 4]} ..."
    return f" ({file.name}:{error.lineno}" + (f": {short})" if short else ")")


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


def python_maker(submission: identity.Identity) -> Callable[[TaskCard], Agent]:
    """What a submission's file makes agents with. Raises ``SubmissionError`` when it is wrong, raises, or lacks ``make_agent(task)``."""
    file, folder = submission.entry, submission.folder
    module = import_file(file, f"_glbench_submission_{submission.digest[:16]}", folder)
    make_agent: Any = getattr(module, "make_agent", None)
    if make_agent is None:
        functions = [name for name, item in vars(module).items() if callable(item) and not name.startswith("_")]
        near = did_you_mean("make_agent", functions) if functions else ""
        refuse(f"{file.name} has no function make_agent(task).{near} Add one that returns your agent.", SubmissionError)
    if not callable(make_agent):
        msg = f"make_agent in {file.name} is {_a(make_agent)}, expected a function make_agent(task) that returns your agent."
        raise SubmissionError(msg)
    _check_call(make_agent, f"make_agent in {file.name}", "make_agent(task)", 1)

    def call(task: TaskCard) -> object:
        try:
            with at_home(folder):
                agent: object = make_agent(task)
                return agent
        except (Exception, SystemExit) as error:
            refuse(f"make_agent in {file.name} fails: {describe_error(error, folder or file)}.", SubmissionError, error)

    def make(task: TaskCard) -> Agent:
        agent = call(task)
        if getattr(agent, "single_run", False):
            return PerRunAgent(lambda task: _as_single(call(task), file), first=_as_single(agent, file))
        _check_agent(agent, file, 2, "reset(task, n_runs)", "act(observations)")
        if not isinstance(agent, Agent):
            raise SubmissionError(_lacks(agent, file, "reset(task, n_runs) and act(observations)"))
        return agent

    return make


def _as_single(agent: object, file: Path) -> SingleRunAgent:
    _check_agent(agent, file, 1, "reset(task)", "act(observation)")
    if not isinstance(agent, SingleRunAgent):
        raise SubmissionError(_lacks(agent, file, "single_run = True, reset(task) and act(observation)"))
    return agent


def _check_agent(agent: object, file: Path, reset_arguments: int, reset: str, act: str) -> None:
    if getattr(agent, "privileged", False):
        msg = f"The agent of {file.name} says 'privileged': submissions see {identity.OBSERVATIONS_ONLY} only. Remove the attribute."
        raise SubmissionError(msg)
    missing = [form for form in (reset, act) if not callable(getattr(agent, form.partition("(")[0], None))]
    if isinstance(agent, type) or missing:
        raise SubmissionError(_lacks(agent, file, " and ".join(missing) or "an instance"))
    owner = f"of the agent {type(agent).__name__} in {file.name}"
    _check_call(agent.reset, f"reset {owner}", reset, reset_arguments)  # type: ignore[attr-defined]
    _check_call(agent.act, f"act {owner}", act, 1)  # type: ignore[attr-defined]


def _lacks(agent: object, file: Path, missing: str) -> str:
    if agent is None:
        return f"make_agent in {file.name} returns nothing. End it with 'return' and your agent."
    if isinstance(agent, type):
        return f"make_agent in {file.name} returns the class {agent.__name__}, expected an instance: return {agent.__name__}(...)."
    return f"make_agent in {file.name} returns {_a(agent)} without {missing}. See docs/submit.md for what an agent has."


def _check_call(function: Callable[..., object], what: str, form: str, arguments: int) -> None:
    """Refuse a function that cannot be called with that many positional arguments."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # functions of compiled modules may have no signature; the call itself will tell
        return
    try:
        signature.bind(*[None] * arguments)
    except TypeError as error:
        refuse(f"{what} has the wrong signature {signature}: it is called as {form}.", SubmissionError, error)


def _a(thing: object) -> str:
    return f"an object of type {type(thing).__name__}"


@dataclass(frozen=True)
class LoadedAgent:
    """An agent, ready to be made for a task."""

    name: str
    """Name in results: the baseline's, or that of the submission's file or folder."""
    kind: Literal["submission", "baseline"]
    digest: str
    """SHA-256 (hex) over the submission's files; for a baseline over its settings and the version of its controller."""
    sees: Sight
    """Only controllers of glbench see more than observations."""
    information: str
    """What it sees, in words."""
    make: Callable[[TaskCard], Agent | PrivilegedController | ScenarioController] = field(repr=False)
    """Makes the agent for a task; raises ``SubmissionError`` when that fails."""
    submission: identity.Identity | None = None
    """Its files, form and card; ``None`` for a controller of glbench."""
    training: identity.Training | None = None
    """Recipe and seed from its card; ``None`` without a recipe, and for shipped baselines, whose recipes glbench knows."""

    @property
    def privileged(self) -> bool:
        """Whether it sees more than observations."""
        return self.sees != "observations"

    @property
    def acts(self) -> Literal["actions", "controls"]:
        """What it decides: actions, or controls past the task's actuation."""
        return "controls" if self.sees == "state" else "actions"


def load_agent(ref: str | Path) -> LoadedAgent:
    """Load the agent that ``ref`` names. Of a Python submission the file is run; a saved policy is opened when the agent is made.

    Raises ``SubmissionError`` when there is no such thing, or it cannot be loaded; the message says what to do. ``ref`` is the name of a
    baseline, or the path of a submission: a Python file, a saved policy, or a folder with ``agent.py``, with a saved policy, or with
    ``card.toml`` (custom settings for a built-in controller).
    """
    if isinstance(ref, str) and ref in identity.baseline_names():
        return _baseline(ref, ref, "baseline")
    path = find_submission(ref)
    if identity.is_built_in(path):
        return _baseline(path, identity.name_of(path), "submission")
    submission = identity.read_identity(path)
    if submission.form == "python":
        make = python_maker(submission)
    else:

        def make(task: TaskCard) -> Agent:
            # Not at the top: the process of an agent in Python does not need them.
            from glbench.agents.saved_policies import onnx_agent, torchscript_agent
            from glbench.agents.sb3 import sb3_agent

            return {"sb3": sb3_agent, "torchscript": torchscript_agent, "onnx": onnx_agent}[submission.form](submission, task)

    return LoadedAgent(
        submission.name, "submission", submission.digest, "observations", identity.OBSERVATIONS_ONLY, make, submission, submission.training
    )


def find_submission(ref: str | Path) -> Path:
    """The file or folder ``ref``, which is not a name of a baseline. Raises ``SubmissionError`` when there is no such thing."""
    path = identity.path_of(ref)
    if path.is_dir() or path.is_file():
        return path
    if str(ref).startswith(("http://", "https://")):
        msg = (
            f"{ref} is an address, and an agent behind an address gets no score: the sandbox has no network, and nobody knows what such an "
            f"agent sees. `glbench serve` lets it act in seasons that are not scored. {identity.EXPECTED}."
        )
        raise SubmissionError(msg)
    if path.suffix in identity.FORMS or len(path.parts) > 1:
        beside = [item.name for item in path.parent.iterdir() if item.suffix in identity.FORMS] if path.parent.is_dir() else []
        near = did_you_mean(path.name, beside, list_few=False)
        msg = f"There is no file or folder {path}.{near} {identity.EXPECTED}."
        if (data_folder("submissions") / path.name).is_file():
            msg = (
                f"There is no file {path}. An example of that name comes with glbench: "
                f"`glbench submit new {shlex.quote(str(path.parent))} --kind example` writes it, and the other examples."
            )
        raise SubmissionError(msg)
    names = identity.baseline_names()
    msg = (
        f"'{ref}' is neither a file or folder here nor a baseline.{did_you_mean(str(ref), names, list_few=False)} "
        f"Baselines: {', '.join(names)}. A submission is named by its path, such as submissions/my_agent.py."
    )
    raise SubmissionError(msg)


def _baseline(ref: str | Path, name: str, kind: Literal["submission", "baseline"]) -> LoadedAgent:
    # Not at the top: a submission can be loaded without what the built-in controllers need.
    from glbench.agents.baselines import read_baseline

    baseline: Baseline = read_baseline(ref)
    training = baseline.training if kind == "submission" else None
    return LoadedAgent(name, kind, baseline.digest, baseline.sees, baseline.information, baseline.make, training=training)


Kind = Literal["rule", "sb3", "torch", "mpc"]
KINDS: tuple[Kind, ...] = get_args(Kind)
EXAMPLE_KIND = "example"  # What ``glbench submit new --kind`` calls the example submissions, each of which is a file
_NAME = "template-name"
_OWN_NAMES = ("submission.toml", "README.md")  # Files of a template that contain its name


def new_submission(folder: Path, kind: Kind) -> tuple[Path, ...]:
    """Write a submission of that ``kind`` into a new ``folder``, whose name becomes the submission's, and return the files.

    Raises ``SubmissionError`` when the folder exists, or its name cannot be an agent's, and ``GlbenchError`` when it cannot be written.
    """
    if folder.exists():
        refuse(f"{folder} is there already, and nothing is overwritten. Choose another name, or move it away.", SubmissionError)
    name = identity.name_of(folder)
    source = data_folder("submissions") / "templates" / kind
    files = []
    try:
        for file in sorted(item for item in source.iterdir() if item.is_file()):
            text = file.read_text(encoding="utf-8")
            target = folder / file.name
            write_atomically(target, text.replace(_NAME, name) if file.name in _OWN_NAMES else text)
            files.append(target)
    except GlbenchError:
        # Half a template would be in the way of the next attempt.
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return tuple(files)


def copy_examples(folder: Path) -> tuple[Path, ...]:
    """Write the example submissions into ``folder``, ``my_agent.py`` among them, and return the files.

    Raises ``SubmissionError`` when another file of one of their names is there, and ``GlbenchError`` when they cannot be written.
    """
    sources = sorted(data_folder("submissions").glob("*.py"))
    targets = tuple(folder / source.name for source in sources)
    for source, target in zip(sources, targets, strict=True):
        if target.exists() and not (target.is_file() and _text(target) == _text(source)):
            refuse(f"{target} is there already, and nothing is overwritten. Choose another folder, or move it away.", SubmissionError)
    for source, target in zip(sources, targets, strict=True):
        write_atomically(target, _text(source))
    return targets


def _text(file: Path) -> bytes:
    return with_unix_line_ends(file.name, file.read_bytes())
