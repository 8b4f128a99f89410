"""From a path or a name to an agent that can be run: ``load_agent``.

A submission is a Python file with a function ``make_agent(task)``, or a folder with such a file called ``agent.py`` and whatever
it needs (weights, settings, further modules). A baseline is a name; its data lie in ``baselines/<name>``.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Literal

from glbench.agents.identity import AGENT_FILE, CARD_FILE, OBSERVATIONS_ONLY, baseline_names, name_of, submission_digest
from glbench.agents.isolation import at_home, describe_error, import_file
from glbench.agents.protocol import Agent, PerRunAgent, PrivilegedController, SingleRunAgent
from glbench.errors import SubmissionError, did_you_mean

if TYPE_CHECKING:
    from glbench.agents.baselines import Baseline
    from glbench.tasks import TaskCard


@dataclass(frozen=True)
class LoadedAgent:
    """An agent, ready to be made for a task."""

    name: str
    """Name in results: the baseline's, or that of the submission's file or folder."""
    kind: Literal["submission", "baseline"]
    digest: str
    """SHA-256 (hex) over the submission's files; for a baseline over its settings and the code of its rules."""
    privileged: bool
    """Whether it is a ``PrivilegedController``; submissions never are."""
    information: str
    """What it sees, in words."""
    make: Callable[[TaskCard], Agent | PrivilegedController] = field(repr=False)
    """Makes the agent for a task; raises ``SubmissionError`` when that fails."""


def load_agent(ref: str | Path) -> LoadedAgent:
    """Load the agent that ``ref`` names.

    Parameters
    ----------
    ref : str or Path
        Name of a baseline, path of a Python file, or path of a folder with ``agent.py`` (a submission) or with ``card.toml``
        (settings of one's own for a built-in controller).

    Raises
    ------
    SubmissionError
        When there is no such thing, or it cannot be loaded; the message says what to do.
    """
    if isinstance(ref, str) and ref in baseline_names():
        return _baseline(_read_baseline(ref), ref, "baseline")
    path = Path(ref).expanduser()
    if path.is_dir():
        if (path / CARD_FILE).is_file() and not (path / AGENT_FILE).is_file():
            return _baseline(_read_baseline(path), name_of(path), "submission")
        return _submission(path / AGENT_FILE, path)
    if path.is_file():
        return _submission(path, None)
    raise SubmissionError(_nothing_there(str(ref), path))


def _read_baseline(ref: str | Path) -> Baseline:
    # Not at the top: a submission can be loaded without what the built-in controllers need.
    from glbench.agents.baselines import read_baseline

    return read_baseline(ref)


def _baseline(baseline: Baseline, name: str, kind: Literal["submission", "baseline"]) -> LoadedAgent:
    return LoadedAgent(name, kind, baseline.digest, baseline.privileged, baseline.information, baseline.make)


def _submission(file: Path, folder: Path | None) -> LoadedAgent:
    if not file.is_file():
        msg = f"The folder {file.parent} is no submission: it has no {AGENT_FILE}. Put make_agent(task) into a file of that name."
        raise SubmissionError(msg)
    if file.suffix != ".py":
        msg = f"{file} is no Python file. A submission is a .py file with make_agent(task), or a folder with {AGENT_FILE}."
        raise SubmissionError(msg)
    name = name_of(folder or file)
    # Resolved, so that an agent that reads its weights beside __file__ still finds them after a change of directory.
    file, folder = file.resolve(), folder.resolve() if folder is not None else None
    try:
        digest = submission_digest(file, folder)
    except OSError as error:
        msg = f"The submission {name} cannot be read: {error}. Check that its files exist and may be read."
        raise SubmissionError(msg) from error
    module = import_file(file, f"_glbench_submission_{digest[:16]}", folder)
    make_agent = _make_agent_of(module, file)
    return LoadedAgent(name, "submission", digest, False, OBSERVATIONS_ONLY, _maker(make_agent, file, folder))


def _make_agent_of(module: ModuleType, file: Path) -> Callable[[TaskCard], object]:
    make_agent = getattr(module, "make_agent", None)
    if make_agent is None:
        functions = [name for name, item in vars(module).items() if callable(item) and not name.startswith("_")]
        near = did_you_mean("make_agent", functions) if functions else ""
        msg = f"{file.name} has no function make_agent(task).{near} Add one that returns your agent."
        raise SubmissionError(msg)
    if not callable(make_agent):
        msg = f"make_agent in {file.name} is {_a(make_agent)}, expected a function make_agent(task) that returns your agent."
        raise SubmissionError(msg)
    _check_call(make_agent, f"make_agent in {file.name}", "make_agent(task)", 1)
    function: Callable[[TaskCard], object] = make_agent
    return function


def _maker(make_agent: Callable[[TaskCard], object], file: Path, folder: Path | None) -> Callable[[TaskCard], Agent]:
    def call(task: TaskCard) -> object:
        try:
            with at_home(folder):
                return make_agent(task)
        except (Exception, SystemExit) as error:
            msg = f"make_agent in {file.name} fails: {describe_error(error, folder or file)}."
            raise SubmissionError(msg) from error

    def make_single(task: TaskCard) -> SingleRunAgent:
        return _as_single(call(task), file)

    def make(task: TaskCard) -> Agent:
        made = call(task)
        if getattr(made, "single_run", False):
            return PerRunAgent(make_single, first=_as_single(made, file))
        return _as_agent(made, file)

    return make


def _as_agent(made: object, file: Path) -> Agent:
    _check_agent(made, file, 2, "reset(task, n_runs)", "act(observations)")
    if not isinstance(made, Agent):
        raise SubmissionError(_lacks(made, file, "reset(task, n_runs) and act(observations)"))
    return made


def _as_single(made: object, file: Path) -> SingleRunAgent:
    _check_agent(made, file, 1, "reset(task)", "act(observation)")
    if not isinstance(made, SingleRunAgent):
        raise SubmissionError(_lacks(made, file, "single_run = True, reset(task) and act(observation)"))
    return made


def _check_agent(made: object, file: Path, reset_arguments: int, reset: str, act: str) -> None:
    if getattr(made, "privileged", False):
        msg = f"The agent of {file.name} says 'privileged': submissions see {OBSERVATIONS_ONLY} only. Remove the attribute."
        raise SubmissionError(msg)
    missing = [form for form in (reset, act) if not callable(getattr(made, form.partition("(")[0], None))]
    if isinstance(made, type) or missing:
        raise SubmissionError(_lacks(made, file, " and ".join(missing) or "an instance"))
    owner = f"of the agent {type(made).__name__} in {file.name}"
    _check_call(made.reset, f"reset {owner}", reset, reset_arguments)  # type: ignore[attr-defined]
    _check_call(made.act, f"act {owner}", act, 1)  # type: ignore[attr-defined]


def _lacks(made: object, file: Path, missing: str) -> str:
    if made is None:
        return f"make_agent in {file.name} returns nothing. End it with 'return' and your agent."
    if isinstance(made, type):
        return f"make_agent in {file.name} returns the class {made.__name__}, expected an instance: return {made.__name__}(...)."
    return f"make_agent in {file.name} returns {_a(made)} without {missing}. See docs/submit.md for what an agent has."


def _check_call(function: Callable[..., object], what: str, form: str, arguments: int) -> None:
    """Refuse a function that cannot be called with that many positional arguments."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # functions of compiled modules may have no signature; the call itself will tell
        return
    try:
        signature.bind(*[None] * arguments)
    except TypeError as error:
        msg = f"{what} has the wrong signature {signature}: it is called as {form}."
        raise SubmissionError(msg) from error


def _a(thing: object) -> str:
    return f"an object of type {type(thing).__name__}"


def _nothing_there(ref: str, path: Path) -> str:
    known = baseline_names()
    if path.suffix == ".py" or len(path.parts) > 1:
        beside = [item.name for item in path.parent.glob("*.py")] if path.parent.is_dir() else []
        near = did_you_mean(path.name, beside) if beside else ""
        return f"There is no file or folder {path}.{near} A submission is a .py file, or a folder with {AGENT_FILE}."
    return (
        f"'{ref}' is neither a file or folder here nor a baseline.{did_you_mean(ref, known)} "
        f"Baselines: {', '.join(known)}. A submission is named by its path, such as submissions/my_agent.py."
    )
