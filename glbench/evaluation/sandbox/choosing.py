"""Whether an agent is sandboxed, and what its result says about that."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, NoReturn

from glbench.agents import Identity, LoadedAgent, identify, load_agent
from glbench.errors import GlbenchError, SandboxError, SubmissionError, did_you_mean, refuse
from glbench.tasks import TaskCard

SandboxChoice = Literal["auto", "bubblewrap", "none"]
CHOICES: Final[tuple[SandboxChoice, ...]] = ("auto", "bubblewrap", "none")
Protection = Literal["bubblewrap", "unsandboxed", "built-in"]
"""How a result says that its agent ran: in a sandbox, without one, or as a part of glbench itself."""

EXAMPLES: Final = {
    "constant_setpoints": "c5778deb9e96998d9bf25b3d69352d45fec6043365b0cdf9d85d44599dbc2699",
    "do_nothing": "e34b67062b3766e7a1b86cda789d2c914d3dd79903644492001428d24363ba7f",
    "energy_agent": "d63c9893025d52df52f5ec737098d3e0edfa8da2c51a41914489ad3cb3c2874f",
    "my_agent": "ba408deb1c674625d6159ecae8a43357fe56eabb27f2be95b7513351d89098e3",
    "pi_controller": "5dc7c819766dfdaa818e9ad939e5852b9a82a9aa233aa8321f9cb6ff7b578c1a",
    "setpoints": "19428558fcc2e51e20502b4346ffcd377cd2811675b516e49417f2baf3d07b59",
}
"""Examples that come with glbench, by name, and the digests that they have as long as nobody changed them."""


@dataclass(frozen=True)
class Protected:
    """An agent and how it runs; ``submission`` is what goes into the sandbox, ``None`` where there is none."""

    agent: LoadedAgent
    protection: Protection
    submission: Identity | None


def protect(agent: LoadedAgent | str | Path, choice: SandboxChoice) -> Protected:
    """Decide how ``agent`` runs, and load it in this process only if it is to run in it.

    ``"bubblewrap"`` puts every submission into a sandbox, and ``"none"`` none. ``"auto"`` does what ``"bubblewrap"`` does, but where there
    can be no sandbox it lets examples of glbench run that nobody changed. Built-in controllers are glbench's own code and never sandboxed.
    Raises ``SandboxError`` when there can be no sandbox and one is needed; it says why and what to do. Raises ``SubmissionError`` when
    there is no such agent, or it was loaded into this process already.
    """
    _check_choice(choice)
    if isinstance(agent, LoadedAgent):
        return _loaded(agent, choice)
    submission = identify(agent)
    if submission is None or protection_of(submission, choice) != "bubblewrap":
        return _loaded(load_agent(agent), "none")
    outside = LoadedAgent(
        submission.name, "submission", submission.digest, "observations", submission.information, _not_here, submission, submission.training
    )
    return Protected(outside, "bubblewrap", submission)


def protection_of(submission: Identity, choice: SandboxChoice) -> Protection:
    """How ``submission`` runs by this choice on this machine; see ``protect``.

    Raises ``SandboxError`` when there can be no sandbox and one is needed; it says why and what to do.
    """
    _check_choice(choice)
    if choice == "none":
        return "unsandboxed"
    from glbench.evaluation.sandbox.bubblewrap import usable_mode, why_no_sandbox

    if choice == "auto" and why_no_sandbox() is not None and EXAMPLES.get(submission.name) == submission.digest:
        return "unsandboxed"
    try:
        usable_mode()
    except SandboxError as error:
        refuse(f"'{submission.name}' was not run. {error}", SandboxError, error)
    return "bubblewrap"


def keep_out_of_sight(round_file: Path, agents: Iterable[Protected]) -> None:
    """Raises ``SandboxError`` when the file of a round is in a folder that the sandbox shows, where an agent could find it."""
    from glbench.evaluation.sandbox.visible import is_visible

    for agent in agents:
        if agent.submission is not None and is_visible(round_file, agent.submission):
            msg = f"'{agent.agent.name}' would see {round_file} in its sandbox. Keep the file of a round in a separate folder."
            raise SandboxError(msg)


def _check_choice(choice: str) -> None:
    if choice not in CHOICES:
        refuse(f"There is no sandbox '{choice}'.{did_you_mean(choice, CHOICES)}", GlbenchError)


def _loaded(agent: LoadedAgent, choice: SandboxChoice) -> Protected:
    owner = getattr(agent.make, "__self__", None)
    if owner is not None:
        from glbench.agents.baselines import Baseline

        if isinstance(owner, Baseline):  # with custom settings, too: the code is glbench's
            return Protected(agent, "built-in", None)
    if choice != "none":
        msg = (
            f"The code of '{agent.name}' was loaded into this process already, so that no sandbox can hold it. Name the agent by its path."
        )
        raise SubmissionError(msg)
    return Protected(agent, "unsandboxed", None)


def _not_here(task: TaskCard) -> NoReturn:
    refuse(f"The agent for {task.id} lives in a sandbox and cannot be made in this process.", SubmissionError)
