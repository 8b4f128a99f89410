"""A submission in Python: its file is run, its ``make_agent(task)`` checked and called, and what comes out of it checked."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from glbench.agents.identity import OBSERVATIONS_ONLY
from glbench.agents.isolation import at_home, describe_error, import_file
from glbench.agents.protocol import Agent, PerRunAgent, SingleRunAgent
from glbench.errors import SubmissionError, did_you_mean

if TYPE_CHECKING:
    from glbench.agents.identity import Identity
    from glbench.tasks import TaskCard


def python_maker(submission: Identity) -> Callable[[TaskCard], Agent]:
    """Run the submission's file and return what makes its agent for a task.

    Raises
    ------
    SubmissionError
        When the file is no valid Python, raises, or has no ``make_agent(task)``.
    """
    file, folder = submission.entry, submission.folder
    module = import_file(file, f"_glbench_submission_{submission.digest[:16]}", folder)
    return _maker(_make_agent_of(module, file), file, folder)


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
