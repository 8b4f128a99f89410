"""Seasons of agents as a learner in the Gymnasium environment would have met them: observations, actions, rewards, ends.

For offline learning. The seasons come from the training split, or from seeds that no task is scored with, so that they reveal nothing
that is held out. ``glbench.evaluation.minari_dataset`` writes them as a Minari dataset.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glbench.env import Simulation
from glbench.errors import GlbenchError, SubmissionError, TaskError
from glbench.evaluation.limits import Failure, TimeLimits
from glbench.evaluation.runners import AgentRunner, SandboxedAgent, make_runner, sandboxed_runner
from glbench.evaluation.sandbox.choosing import Protected
from glbench.evaluation.sandbox.frames import SandboxLimits
from glbench.evaluation.sandbox.process import Prints
from glbench.tasks import TaskSpec, task_card

FIRST_SEED = 40_000_000_000
"""Default seed of the first run; trainings, their evaluations and searches use smaller seeds."""
_FIRST_FREE_SEED = 10_000_000_000
"""Seeds from here on are for learning: no task can be scored with them (docs/training.md)."""
_LAST_SEED = 2**53
_TOGETHER = 32
"""Seasons that are stepped together: enough for the kernel's speed, few enough for any memory."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One season of T steps, with the types and, for the same seed and actions, the bits of the Gymnasium environment.

    Attributes
    ----------
    agent
        Name of the agent that acted.
    seed
        Seed of the season, which ``reset`` takes.
    observations
        ``(T + 1, columns)`` float32, from the first to the one after the last step.
    actions
        ``(T, m)`` float32, as they were taken: with the noise, within their bounds.
    rewards
        ``(T,)`` float64.
    terminations
        ``(T,)``; true in the last step only.
    profit
        Sum of the season's EPI [EUR m-2].
    """

    agent: str
    seed: int
    observations: NDArray[np.float32]
    actions: NDArray[np.float32]
    rewards: NDArray[np.float64]
    terminations: NDArray[np.bool_]
    profit: float


def check_learnable(task: TaskSpec, first_seed: int, seasons: int) -> None:
    """Refuse seasons that are held out.

    Raises
    ------
    TaskError
        When ``task`` is in a split other than training, or has no training split.
    GlbenchError
        When a task could be scored with one of the seeds.
    """
    task.check_training()
    if task.split not in (None, "training"):
        msg = f"{task.id} is in its {task.split} split, which is held out: datasets for learning come from the training split."
        raise TaskError(msg)
    if not _FIRST_FREE_SEED <= first_seed <= first_seed + seasons <= _LAST_SEED:
        msg = (
            f"Seeds {first_seed:,} to {first_seed + seasons - 1:,} are not for learning: tasks are scored with smaller seeds. "
            f"Use seeds from {_FIRST_FREE_SEED:,} to {_LAST_SEED:,}."
        )
        raise GlbenchError(msg)


def check_agent(task: TaskSpec, agent: Protected, seed: int) -> None:
    """Refuse an agent that cannot begin a season of ``task``, or whose decisions are not actions of the environment.

    Raises
    ------
    SubmissionError
        For a controller that sets controls past the task's actuation, and for an agent that fails.
    """
    if agent.agent.acts == "controls":
        msg = (
            f"'{agent.agent.name}' sets controls past the task's actuation: what it does is not an action of the environment, so nothing "
            "can be learned from it there. Use an agent that acts, such as rule_based_fair or rule_based_tuned."
        )
        raise SubmissionError(msg)
    with closing(_runner(agent, task, [seed])) as runner:
        _refuse(runner.start(), agent.agent.name, [seed])


def trajectories(
    task: TaskSpec,
    agent: Protected,
    seeds: Sequence[int],
    *,
    noise: float = 0.0,
    progress: Callable[[int], None] | None = None,
) -> Iterator[Trajectory]:
    """Seasons of ``agent`` on ``task``, one for each of ``seeds``, in their order; the bits do not depend on the other seeds.

    Parameters
    ----------
    task, agent, seeds
        Who acts where; ``check_learnable`` and ``check_agent`` say what can be learned from.
    noise
        Standard deviation of Gaussian noise on every action, in halves of its range, which belongs to the season's seed. The agent
        sees its effect, and the noisy action is kept.
    progress
        Called after every step with the number of seasons that took it.

    Raises
    ------
    SubmissionError
        When the agent fails: data from a broken agent are useless.
    """
    for first in range(0, len(seeds), _TOGETHER):
        together = list(seeds[first : first + _TOGETHER])
        with closing(_runner(agent, task, together)) as runner:
            yield from _seasons(task, runner, agent.agent.name, together, noise, progress or (lambda _: None))


def _runner(agent: Protected, task: TaskSpec, seeds: Sequence[int]) -> AgentRunner:
    limits = TimeLimits.of_table(task.evaluation.time_limits)
    if agent.submission is None:
        return make_runner(agent.agent, task, task_card(task), seeds, limits)
    return sandboxed_runner(
        SandboxedAgent.of(agent.submission, task, len(seeds), limits, SandboxLimits(), Prints()),
    )


def _seasons(
    task: TaskSpec, runner: AgentRunner, name: str, seeds: list[int], noise: float, progress: Callable[[int], None]
) -> Iterator[Trajectory]:
    simulation, (low, high) = Simulation(task, len(seeds)), task_card(task).action_bounds
    steps, n, m = task.steps, len(seeds), len(low)
    added = [noise * (high - low) / 2.0 * _standard_noise(seed, steps, m) for seed in seeds] if noise else None
    actions = np.zeros((n, steps, m), dtype=np.float32)
    rewards, ends, profits = np.zeros((n, steps)), np.zeros((n, steps), dtype=np.bool_), np.zeros(n)
    taken = np.zeros(n, dtype=np.int64)
    shown = simulation.reset(seeds)
    observations = np.empty((n, steps + 1, shown.shape[1]), dtype=np.float32)
    observations[:, 0] = shown
    _refuse(runner.start(), name, seeds)
    for step in range(steps):
        alive = ~simulation.ended
        inputs = runner.inputs(simulation, shown)
        runner.ask(step, inputs, alive)
        decision = runner.decide(step, inputs, alive)
        _refuse(decision.failures, name, seeds)
        wanted = decision.actions if added is None else decision.actions + np.array([one[step] for one in added])
        actions[:, step] = np.clip(wanted, low, high)
        result = simulation.step(actions[:, step])
        shown = result.observations
        observations[:, step + 1], rewards[:, step], ends[:, step] = shown, result.rewards, result.terminated
        profits += np.where(alive, result.quantities["epi"], 0.0)
        taken += alive
        progress(int(alive.sum()))
        if simulation.ended.all():
            break
    for row, seed in enumerate(seeds):
        until = int(taken[row])  # fewer than all where a step could not be simulated, which ends a season
        yield Trajectory(
            name,
            seed,
            observations[row, : until + 1],
            actions[row, :until],
            rewards[row, :until],
            ends[row, :until],
            float(profits[row]),
        )


def _standard_noise(seed: int, steps: int, m: int) -> NDArray[np.float64]:
    return np.random.default_rng(seed).standard_normal((steps, m))


def _refuse(failures: Sequence[Failure], name: str, seeds: Sequence[int]) -> None:
    for failure in failures:
        where = "all seasons" if failure.row is None else f"the season of seed {seeds[failure.row]}"
        msg = f"'{name}' failed in {where}: {failure.reason}. Nothing was written."
        raise SubmissionError(msg)
