"""Runners call agents: batched, one per run, or privileged; in this process or in a sandbox.

A runner shows its agent the inputs of a step, checks the answer and applies it to the simulation. Inputs are what a checkpoint records,
so that the agent can be brought back by showing it the same inputs again.

What an agent in this process may do, a sandboxed one may, and nothing more. What breaks a call of a batched agent ends all runs, a bad row
ends one, and the end of a sandboxed process ends all runs, too. Of agents for single runs each is asked by itself, and whatever one of
them does ends its own run only. In a sandbox they share one process; when one of them ends it, a new process brings the others back by
showing them again what they had seen.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from glbench.agents import Agent, LoadedAgent, PerRunAgent, PrivilegedController, ScenarioController
from glbench.agents.protocol import ROUNDING, read_actions, value_problems
from glbench.arrays import Floats
from glbench.env import Simulation, StepResult
from glbench.errors import SubmissionError, refuse
from glbench.evaluation.limits import Failure, TimeLimits, guarded
from glbench.model import get_model
from glbench.tasks import Action, TaskCard, TaskSpec
from glbench.tasks.quantities import PAPER_MODEL

Inputs = NDArray[np.float32] | Floats
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Decision:
    """What the agent decided in one step.

    ``actions`` has shape ``(n, m)``, zero where there is none; ``failures`` names the rows that went wrong; ``seconds`` ``(n,)`` is the
    time that each run's decision took (of a batched agent: an equal share).
    """

    actions: Floats
    failures: tuple[Failure, ...]
    seconds: Floats


class AgentRunner(ABC):
    """An agent in its harness, for ``n`` runs; ``card`` holds names and bounds of what it decides."""

    one_by_one = False
    """Whether each run has its own agent, with separate calls and time limits."""

    def __init__(self, card: TaskCard, n: int, limits: TimeLimits) -> None:
        self.card, self.n, self.limits = card, n, limits
        self.shape = (n, len(card.actions))
        low, high = card.action_bounds
        self._low, self._high = low - ROUNDING, high + ROUNDING

    @abstractmethod
    def start(self) -> tuple[Failure, ...]:
        """Make the agent ready for the first step."""

    def inputs(self, simulation: Simulation, observations: NDArray[np.float32]) -> Inputs:
        """What the agent is shown in this step, one row a run; an array of its own."""
        return observations.copy()

    def ask(self, step: int, inputs: Inputs, alive: Mask) -> None:  # noqa: B027 -- most have nothing to do ahead
        """Put the question of ``decide`` to the agent already, where it thinks elsewhere; the call to ``decide`` follows."""

    def decide(self, step: int, inputs: Inputs, alive: Mask) -> Decision:
        """Ask the agent. Rows that are not alive keep their place; their answers are ignored.

        Here, and nowhere else in an evaluation, the values that an agent gave are compared with their bounds.
        """
        decision = self._decided(step, inputs, alive)
        if ((decision.actions >= self._low) & (decision.actions <= self._high)).all():
            return decision
        problems = value_problems(decision.actions, self.card)
        actions = decision.actions.copy()
        actions[list(problems)] = 0.0
        return replace(decision, actions=actions, failures=(*decision.failures, *invalid_actions(problems, alive)))

    @abstractmethod
    def _decided(self, step: int, inputs: Inputs, alive: Mask) -> Decision:
        """What the agent says, whatever the values."""

    def apply(self, simulation: Simulation, actions: Floats) -> StepResult:
        """Take a step with what was decided: with actions, through the actuation."""
        return simulation.step(actions)

    def close(self) -> None:  # noqa: B027 -- an agent in this process holds nothing outside
        """Let go of whatever the agent holds outside this process."""


def make_runner(agent: LoadedAgent, task: TaskSpec, card: TaskCard, seeds: Sequence[int], limits: TimeLimits) -> AgentRunner:
    """A fresh agent for runs of ``task`` with ``seeds``, in this process. Raises ``SubmissionError`` when it cannot be made."""
    first, n = _make_agent(agent, card, limits), len(seeds)
    if isinstance(first, PerRunAgent):
        others = [_make_agent(agent, card, limits) for _ in range(n - 1)]
        return PerRunRunner([first, *others], card, limits)  # type: ignore[list-item]
    # What the loader says counts, not what the object looks like: a submission is never privileged.
    runner: BatchRunner
    if agent.sees == "scenario":
        runner = ScenarioRunner(cast(ScenarioController, first), task, card, seeds, limits)
    elif agent.sees == "state":
        runner = PrivilegedRunner(cast(PrivilegedController, first), task, card, n, limits)
    else:
        runner = BatchRunner(cast(Agent, first), card, n, limits)
    if agent.submission is None:  # a controller of glbench that does not fit the task is refused before its runs
        runner.through = (KeyboardInterrupt, SubmissionError)
    return runner


def _make_agent(agent: LoadedAgent, card: TaskCard, limits: TimeLimits) -> Agent | PrivilegedController | ScenarioController:
    answer = guarded(lambda: agent.make(card), limits.start, "make_agent", through=(KeyboardInterrupt, SubmissionError))
    if answer.value is None:
        reason = answer.failure.reason if answer.failure else "make_agent returned nothing"
        refuse(f"The agent '{agent.name}' cannot be made: {reason}.", SubmissionError)
    return answer.value


class BatchRunner(AgentRunner):
    """One agent that decides for all runs at once."""

    _call = "act (for all runs)"

    def __init__(self, agent: Agent, card: TaskCard, n: int, limits: TimeLimits) -> None:
        super().__init__(card, n, limits)
        self._agent: Any = agent
        self._task = card
        self.through: tuple[type[BaseException], ...] = (KeyboardInterrupt,)
        """Errors of ``reset`` that end the evaluation instead of its runs."""

    def start(self) -> tuple[Failure, ...]:
        """Reset the agent. Raises ``SubmissionError``, and no run fails, when it is a controller of glbench that does not fit the task."""
        answer = guarded(self._reset, self.limits.start, "reset", through=self.through)
        return (answer.failure,) if answer.failure else ()

    def _reset(self) -> None:
        self._agent.reset(self._task, self.n)

    def _decided(self, step: int, inputs: Inputs, alive: Mask) -> Decision:
        deciding = int(np.count_nonzero(alive))
        # A copy: an agent that works in its observations must not change what is recorded or what the simulation holds.
        own = inputs.copy()
        answer = guarded(lambda: read_actions(self._returned(step, own), self.card, self.n), self.limits.step * deciding, self._call)
        seconds: Floats = np.where(alive, answer.seconds / deciding, 0.0)
        if answer.value is None:
            return Decision(np.zeros(self.shape), (answer.failure,) if answer.failure else (), seconds)
        actions, problems = answer.value
        return Decision(actions, invalid_actions(problems, alive), seconds)

    def _returned(self, step: int, inputs: Inputs) -> object:
        return self._agent.act(inputs.astype(np.float32, copy=False))


class PrivilegedRunner(BatchRunner):
    """A controller of glbench that sees states and disturbances and sets the controls themselves.

    What it sees is the truth, whatever the task's sensors and forecasts show to agents: it is in a class of its own.
    """

    _call = "controls (for all runs)"

    def __init__(self, controller: PrivilegedController, task: TaskSpec, card: TaskCard, n: int, limits: TimeLimits) -> None:
        controls = tuple(Action(name, 0.0, 1.0) for name in task.model_value.control_names)
        super().__init__(cast(Agent, controller), replace(card, actions=controls), n, limits)
        self._task = card
        # A model with the paper's states and more, such as meters, is seen as the paper's; any other with all its states.
        own, paper = task.model_value.state_names, get_model(PAPER_MODEL).state_names
        self._places = [own.index(name) for name in (paper if set(paper) <= set(own) else own)]
        self._states = len(self._places)
        scenario = task.scenario
        one_season = len(scenario.seasons) == 1 and not scenario.start_within_days and scenario.generated is None
        # One row of weather for all runs where they share it: controllers compute what follows from it once.
        self._weather = task.disturbances(extra_rows=task.observation.forecast_steps) if one_season else None

    def inputs(self, simulation: Simulation, observations: NDArray[np.float32]) -> Inputs:
        """Show the states, and behind them weather and clock where each run has its own."""
        states = np.array(simulation.x[:, self._places], dtype=np.float64)
        if self._weather is not None:
            return states
        clock = simulation.hour_of_day[:, None], simulation.day_of_year[:, None]
        return np.concatenate([states, simulation.d, *clock], axis=1)

    def apply(self, simulation: Simulation, actions: Floats) -> StepResult:
        """Take a step with controls, past the actuation."""
        return simulation.step_controls(actions)

    def _returned(self, step: int, inputs: Inputs) -> object:
        weather = self._weather
        if weather is None:
            x, d, hours, days = np.split(inputs, [self._states, inputs.shape[1] - 2, inputs.shape[1] - 1], axis=1)
            return self._agent.controls(x, d, hours[:, 0], days[:, 0])
        hour, day = float(weather.hour_of_day[step]), float(weather.day_of_year[step])
        return self._agent.controls(inputs, weather.values[step], hour, day)


class ScenarioRunner(BatchRunner):
    """A controller of glbench that knows everything that is given in its runs and is shown the true states."""

    def __init__(self, controller: ScenarioController, task: TaskSpec, card: TaskCard, seeds: Sequence[int], limits: TimeLimits) -> None:
        super().__init__(cast(Agent, controller), card, len(seeds), limits)
        self._runs = task, tuple(seeds)

    def _reset(self) -> None:
        self._agent.reset(*self._runs)

    def inputs(self, simulation: Simulation, observations: NDArray[np.float32]) -> Inputs:
        """Show the states."""
        return np.array(simulation.x, dtype=np.float64)

    def _returned(self, step: int, inputs: Inputs) -> object:
        return self._agent.act(inputs)


class PerRunRunner(AgentRunner):
    """One agent a run, each asked by itself."""

    one_by_one = True

    def __init__(self, agents: list[PerRunAgent], card: TaskCard, limits: TimeLimits) -> None:
        super().__init__(card, len(agents), limits)
        self._agents = agents

    def start(self) -> tuple[Failure, ...]:
        """Reset the agents."""
        failures = []
        for row, agent in enumerate(self._agents):
            answer = guarded(lambda agent=agent: agent.reset(self.card, 1), self.limits.start, "reset")  # type: ignore[misc]
            failures += [replace(answer.failure, row=row)] if answer.failure else []
        return tuple(failures)

    def _decided(self, step: int, inputs: Inputs, alive: Mask) -> Decision:
        rows: list[Floats] = [np.zeros(self.shape[1])] * self.n
        seconds, failures = np.zeros(self.n), []
        for row in np.flatnonzero(alive).tolist():
            agent, own = self._agents[row], inputs[row : row + 1].astype(np.float32)
            answer = guarded(lambda agent=agent, own=own: agent.act(own)[0], self.limits.step, "act")  # type: ignore[misc]
            seconds[row] = answer.seconds
            if answer.value is not None:
                rows[row] = answer.value
            if answer.failure:
                # The adapter counts its own runs, of which it has one here.
                failures.append(replace(answer.failure, row=row, reason=answer.failure.reason.replace(" in run 0", "")))
        actions, problems = read_actions(rows, self.card, self.n)
        return Decision(actions, (*failures, *invalid_actions(problems, alive)), seconds)


def invalid_actions(problems: dict[int, str], alive: Mask) -> tuple[Failure, ...]:
    """Failures of the runs that are alive and whose action has a problem."""
    return tuple(Failure(row, "invalid_action", reason) for row, reason in problems.items() if alive[row])
