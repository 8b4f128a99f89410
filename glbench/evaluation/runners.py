"""Who decides: a batched agent, one agent a run, or a privileged controller, behind one small interface.

A driver shows its agent the inputs of a step, checks the answer and applies it to the simulation. Inputs are what a checkpoint records,
so that the agent can be brought back by showing it the same inputs again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from glbench.agents import Agent, LoadedAgent, PerRunAgent, PrivilegedController
from glbench.agents.actions import read_actions
from glbench.env import Simulation, StepResult
from glbench.errors import SubmissionError
from glbench.evaluation.limits import Answer, Failure, TimeLimits, guarded
from glbench.model import CONTROL_NAMES
from glbench.tasks import Action, TaskCard, TaskSpec

Inputs = NDArray[np.float32] | NDArray[np.float64]
Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Decision:
    """What the agent decided in one step.

    ``actions`` has shape ``(n, m)``, zero where there is none; ``failures`` names the rows that went wrong; ``seconds`` ``(n,)`` is the
    time that each run's decision took (of a batched agent: an equal share).
    """

    actions: Array
    failures: tuple[Failure, ...]
    seconds: Array


class AgentRunner(Protocol):
    """An agent in its harness."""

    def start(self) -> tuple[Failure, ...]:
        """Make the agent ready for the first step."""

    def inputs(self, simulation: Simulation, observations: NDArray[np.float32]) -> Inputs:
        """What the agent is shown in this step, one row a run; an array of its own."""

    def ask(self, step: int, inputs: Inputs, alive: Mask) -> None:
        """Put the question of ``decide`` to the agent already, where it thinks elsewhere; the call to ``decide`` follows."""

    def decide(self, step: int, inputs: Inputs, alive: Mask) -> Decision:
        """Ask the agent. Rows that are not alive keep their place; their answers are ignored."""

    def apply(self, simulation: Simulation, actions: Array) -> StepResult:
        """Do what was decided."""

    def close(self) -> None:
        """Let go of whatever the agent holds outside this process."""


def make_runner(agent: LoadedAgent, task: TaskSpec, card: TaskCard, n: int, limits: TimeLimits) -> AgentRunner:
    """A fresh agent for ``n`` runs of ``task`` in the harness that fits it.

    Raises
    ------
    SubmissionError
        When the agent cannot be made.
    """
    first = _made(agent, card, limits)
    if isinstance(first, PerRunAgent):
        others = [_made(agent, card, limits) for _ in range(n - 1)]
        return PerRunRunner([first, *others], card, limits)  # type: ignore[list-item]
    # What the loader says counts, not what the object looks like: a submission is never privileged.
    if agent.privileged:
        return PrivilegedRunner(cast(PrivilegedController, first), task, card, n, limits)
    return BatchRunner(cast(Agent, first), card, n, limits)


def _made(agent: LoadedAgent, card: TaskCard, limits: TimeLimits) -> Agent | PrivilegedController:
    answer = guarded(lambda: agent.make(card), limits.start, "make_agent", through=(KeyboardInterrupt, SubmissionError))
    if answer.value is None:
        reason = answer.failure.reason if answer.failure else "make_agent returned nothing"
        msg = f"The agent '{agent.name}' cannot be made: {reason}."
        raise SubmissionError(msg)
    return answer.value


class Observing:
    """What agents that see observations and act through the task's actuation have in common."""

    def inputs(self, simulation: Simulation, observations: NDArray[np.float32]) -> Inputs:
        """Show the observations."""
        return observations.copy()

    def ask(self, step: int, inputs: Inputs, alive: Mask) -> None:
        """Nothing yet: the agent lives in this process."""

    def apply(self, simulation: Simulation, actions: Array) -> StepResult:
        """Take a step with actions, through the actuation."""
        return simulation.step(actions)

    def close(self) -> None:
        """Nothing to do: the agent lives in this process."""


class BatchRunner(Observing):
    """One agent that decides for all runs at once: what breaks its call ends all runs, a bad row ends one."""

    def __init__(self, agent: Agent, card: TaskCard, n: int, limits: TimeLimits) -> None:
        self._agent, self._card, self._n, self._limits = agent, card, n, limits

    def start(self) -> tuple[Failure, ...]:
        """Reset the agent."""
        answer = guarded(lambda: self._agent.reset(self._card, self._n), self._limits.start, "reset")
        return (answer.failure,) if answer.failure else ()

    def decide(self, step: int, inputs: Inputs, alive: Mask) -> Decision:
        """Ask for the actions of all runs."""
        n = self._n
        # A copy: an agent that works in its observations must not change what is recorded or what the simulation holds.
        shown = inputs.astype(np.float32)
        deciding = int(np.count_nonzero(alive))
        answer = guarded(
            lambda: read_actions(self._agent.act(shown), self._card, n),
            self._limits.step * deciding,
            "act (for all runs)",
        )
        return _batch_decision(answer, alive, (n, len(self._card.actions)))


class PerRunRunner(Observing):
    """One agent a run, each asked by itself: whatever one of them does ends its own run only."""

    def __init__(self, agents: list[PerRunAgent], card: TaskCard, limits: TimeLimits) -> None:
        self._agents, self._card, self._limits = agents, card, limits

    def start(self) -> tuple[Failure, ...]:
        """Reset the agent."""
        failures = []
        for row, agent in enumerate(self._agents):
            answer = guarded(lambda agent=agent: agent.reset(self._card, 1), self._limits.start, "reset")  # type: ignore[misc]
            failures += [replace(answer.failure, row=row)] if answer.failure else []
        return tuple(failures)

    def decide(self, step: int, inputs: Inputs, alive: Mask) -> Decision:
        """Ask for the actions of all runs."""
        n = len(self._agents)
        rows: list[Array] = [np.zeros(len(self._card.actions))] * n
        seconds = np.zeros(n)
        failures = []
        for row in np.flatnonzero(alive):
            agent, shown = self._agents[row], inputs[row : row + 1].astype(np.float32)
            answer = guarded(lambda agent=agent, shown=shown: agent.act(shown)[0], self._limits.step, "act")  # type: ignore[misc]
            seconds[row] = answer.seconds
            if answer.value is not None:
                rows[row] = answer.value
            if answer.failure:
                # The adapter counts its own runs, of which it has one here.
                failures.append(
                    replace(answer.failure, row=int(row), reason=answer.failure.reason.replace(" in run 0", ""))
                )
        actions, problems = read_actions(rows, self._card, n)
        return Decision(actions, (*failures, *invalid_rows(problems, alive)), seconds)


class PrivilegedRunner:
    """A controller of glbench that sees states and disturbances and sets the controls themselves."""

    def __init__(
        self, controller: PrivilegedController, task: TaskSpec, card: TaskCard, n: int, limits: TimeLimits
    ) -> None:
        self._controller, self._card, self._n, self._limits = controller, card, n, limits
        self._applied = replace(card, actions=tuple(Action(name, 0.0, 1.0) for name in CONTROL_NAMES))
        self._weather = task.disturbances(extra_rows=task.observation.forecast_steps)

    def start(self) -> tuple[Failure, ...]:
        """Reset the agent."""
        answer = guarded(lambda: self._controller.reset(self._card, self._n), self._limits.start, "reset")
        return (answer.failure,) if answer.failure else ()

    def inputs(self, simulation: Simulation, observations: NDArray[np.float32]) -> Inputs:
        """Show the states."""
        return np.array(simulation.x, dtype=np.float64)

    def ask(self, step: int, inputs: Inputs, alive: Mask) -> None:
        """Nothing yet: the controller lives in this process."""

    def decide(self, step: int, inputs: Inputs, alive: Mask) -> Decision:
        """Ask for the actions of all runs."""
        n, weather = self._n, self._weather
        d, hour, day = weather.values[step], float(weather.hour_of_day[step]), float(weather.day_of_year[step])
        deciding = int(np.count_nonzero(alive))
        shown = inputs.astype(np.float64)
        answer = guarded(
            lambda: read_actions(self._controller.controls(shown, d, hour, day), self._applied, n),
            self._limits.step * deciding,
            "controls (for all runs)",
        )
        return _batch_decision(answer, alive, (n, len(self._applied.actions)))

    def apply(self, simulation: Simulation, actions: Array) -> StepResult:
        """Take a step with controls, past the actuation."""
        return simulation.step_controls(actions)

    def close(self) -> None:
        """Nothing to do: the controller lives in this process."""


def _batch_decision(answer: Answer[tuple[Array, dict[int, str]]], alive: Mask, shape: tuple[int, int]) -> Decision:
    seconds = answer.seconds / np.count_nonzero(alive) * alive
    if answer.value is None:
        return Decision(np.zeros(shape), (answer.failure,) if answer.failure else (), seconds)
    actions, problems = answer.value
    return Decision(actions, invalid_rows(problems, alive), seconds)


def invalid_rows(problems: Mapping[int, str], alive: Mask) -> tuple[Failure, ...]:
    """Failures of the runs that are alive and whose action has a problem."""
    return tuple(Failure(row, "invalid_action", reason) for row, reason in problems.items() if alive[row])
