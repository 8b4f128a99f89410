"""Rewards: the sum of named parts.

A part is made once for a task and then called in every step with a ``StepOutcome``. The reward of a step is the sum of the
task's parts, in the task's order. To add one, write a function that makes it and register it under a name:

    def fruit_only(task: TaskSpec, accounts: Accounts) -> RewardPart:
        return lambda outcome: outcome["fruit_fresh"]

    register_reward("fruit_only", "fresh fruit grown [kg m-2]", fruit_only)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from glbench.arrays import Floats
from glbench.env.accounts import Accounts
from glbench.env.registries import PartRegistry
from glbench.errors import TaskError, UnknownNameError, did_you_mean, refuse
from glbench.tasks import TaskSpec
from glbench.tasks.vocabulary import REWARD_MODULES


@dataclass(frozen=True, eq=False)
class StepOutcome:
    """What a reward may look at: the step's quantities, and the true states and controls behind them.

    ``table`` holds the quantities ``(quantities, n)``, called ``names``; ``outcome["epi"]`` is one of them, ``(n,)``. ``before`` and
    ``after`` are the states ``(n, states)``, ``controls`` the fractions ``(n, controls)``, ``air`` the air temperature [degC], CO2 [ppm]
    and relative humidity [%] at the end of the step ``(3, n)``.
    """

    table: Floats
    before: Floats
    after: Floats
    controls: Floats
    air: Floats
    names: tuple[str, ...]

    def __getitem__(self, name: str) -> Floats:
        """One quantity of the step, ``(n,)``."""
        try:
            row = self.names.index(name)
        except ValueError:
            msg = f"A step has no quantity called '{name}'.{did_you_mean(name, self.names)}"
            raise UnknownNameError(msg) from None
        values: Floats = self.table[row]
        return values


RewardPart = Callable[[StepOutcome], Floats]
"""Contribution to the reward, ``(n,)``. Row i may depend on row i of the outcome only."""

MakeReward = Callable[["TaskSpec", "Accounts"], RewardPart]
"""Makes a part for a task; the accounts hold its prices, limits and the bounds of its EPI."""

REWARDS: PartRegistry[MakeReward] = PartRegistry("reward module", REWARD_MODULES)


def register_reward(name: str, meaning: str, make: MakeReward) -> None:
    """Make a reward part known under ``name``, here and in task files. Raises ``TaskError`` when the name is taken."""
    REWARDS.register(name, meaning, make)


def make_reward(task: TaskSpec, accounts: Accounts) -> RewardPart:
    """The sum of the task's parts. Raises ``UnknownNameError`` for a name without a part, with the nearest known one."""
    first, *others = [_part(task, name, accounts) for name in task.reward.modules]

    def total(outcome: StepOutcome) -> Floats:
        reward = first(outcome)
        for part in others:
            reward = reward + part(outcome)
        return reward

    return total


def _part(task: TaskSpec, name: str, accounts: Accounts) -> RewardPart:
    """A part of the reward; the result of a registered one must have one number a run."""
    part = REWARDS[name](task, accounts)
    if REWARDS.recorded(name):
        return part

    def checked(outcome: StepOutcome) -> Floats:
        reward = np.asarray(part(outcome), dtype=np.float64)
        expected = (outcome.table.shape[1],)
        if reward.shape != expected:
            msg = (
                f"The reward module '{name}' of {task.id} returned an array of shape {reward.shape}; it must be {expected}: "
                "a number for every run."
            )
            raise TaskError(msg)
        return reward

    return checked


def _scaled_epi(task: TaskSpec, accounts: Accounts) -> RewardPart:
    lowest = accounts.lowest_epi
    span = accounts.highest_epi - lowest
    if span == 0.0:
        refuse(f"{task.id} scales the EPI, but all its prices are 0. Give it prices, or take another reward module.", TaskError)
    return lambda outcome: (outcome["epi"] - lowest) / span


def _penalties(task: TaskSpec, accounts: Accounts) -> RewardPart:
    violations = [name for name in accounts.names if name.startswith("violation_")]
    if not violations:
        return _scaled_penalty(task, accounts)

    def minus_violations(outcome: StepOutcome) -> Floats:
        total: Any = 0.0
        for name in violations:  # one by one: the order of the sum must not depend on the batch
            total = total - outcome[name]
        minus: Floats = total
        return minus

    return minus_violations


def _scaled_penalty(task: TaskSpec, accounts: Accounts) -> RewardPart:
    return lambda outcome: -outcome["penalty"]


for _name, _make in (
    ("epi", lambda task, accounts: lambda outcome: outcome["epi"]),
    ("scaled_epi", _scaled_epi),
    ("penalties", _penalties),
    ("scaled_penalty", _scaled_penalty),
):
    REWARDS.provide(_name, _make, recorded=True)  # arithmetic on the step's quantities, and nothing else
