"""A grower's rules for lamps at hourly prices, engine, boiler and heat buffer, on top of the tuned rules of the climate.

The climate is that of ``glbench.agents.tuned_rules``, which says how much heat and CO2 are wanted. Lamps are on while power costs less
than the fruit that it makes. The engine runs in hours in which power is worth more than a price that rises as the buffer fills, and
falls before a cold night; the boiler burns by day for the CO2 in its flue gas, and gives heat when the buffer is empty.
``baselines/rule_based_energy`` holds the numbers, and explains each. The rules look at observations and the task card alone.

All arithmetic goes element by element over arrays of shape (n,), as in the tuned rules.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glbench.agents.energy_rule_settings import EnergyRulePages, EnergyRuleSettings
from glbench.agents.rule_based_fair import clock_from
from glbench.agents.tuned_rules import TunedRulesAgent
from glbench.errors import ShapeError, SubmissionError
from glbench.tasks.set_points import BLACKOUT, BOILER, DOSING, LAMPS, VENTS, WORKED

if TYPE_CHECKING:
    from glbench.tasks import TaskCard

Array = NDArray[np.float64]

_ENGINE, _PIPES = "engine", "pipe_heat"
"""What two controls of an energy system deliver: power, and heat for the pipes. Where they are, the boiler's heat goes into the buffer."""
POWER, BOUGHT, FRUIT = "price_power", "price_power_bought", "price_fruit"
_AHEAD, _NIGHT, _SHARE = f"{POWER}_in_", "outdoor_temperature_in_12h", "buffer_share"
_WARM_NIGHT = 18.0
"""A night that is no colder [degC] needs no heat."""
_GROWTH = "revenue_growth"
"""Item of the ledger that tells what fruit is worth, where its price does not change."""
_RUNNING = 0.01
"""The engine counts as running above this load."""


class EnergyRulesAgent(TunedRulesAgent):
    """Rules for a greenhouse whose power has a price for every hour; an ``Agent``.

    ``rules`` are pages of numbers, of which the task chooses one, or numbers for every run, one a run.
    """

    def __init__(self, rules: EnergyRulePages | Sequence[EnergyRuleSettings]) -> None:
        super().__init__(() if isinstance(rules, EnergyRulePages) else rules)
        self.rules = rules

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """Forget what was measured; ``n_runs`` runs of ``task`` begin.

        Raises
        ------
        SubmissionError
            When the task does not show the price of power or another quantity that the rules need, or no page is for it.
        ShapeError
            When there are numbers for another count of runs.
        """
        rules = self.rules
        given = [rules.numbers_for(task.id)] * n_runs if isinstance(rules, EnergyRulePages) else rules
        self.settings = given
        super().reset(replace(task, actions=tuple(one for one in task.actions if one.name in WORKED)), n_runs)
        self._task = task
        self._more: Any = SimpleNamespace(
            **{name: np.array([getattr(one, name) for one in given]) for name in EnergyRuleSettings.model_fields}
        )
        self._columns = {name: place for place, name in enumerate(task.observation_names)}
        self._controls = {one.name: (one.quantity, one.at_one) for one in task.controls if one.at_one > 0.0}
        self._ahead = tuple(name for name in self._columns if name.startswith(_AHEAD))
        self._fruit = next(
            (one.price for one in task.ledger if one.name == _GROWTH and not isinstance(one.price, str)), 0.0
        )
        machines = tuple(one.name for what in (_ENGINE, _PIPES) for one in task.controls if one.quantity == what)
        self._stored = len(machines) == len((_ENGINE, _PIPES)) and set(machines) <= set(task.action_names)
        self._engine, self._pipes = machines if self._stored else ("", "")
        shown = (POWER, *((_SHARE,) if self._stored else ()))
        unknown = [name for name in task.action_names if name not in (*WORKED, self._engine, self._pipes)]
        missing = [name for name in shown if name not in self._columns]
        if unknown or missing:
            what = (
                f"does not show {', '.join(missing)}"
                if missing
                else f"has the control {', '.join(unknown)}, which they do not know"
            )
            msg = f"The energy rules work lamps, engine and buffer at an hourly price of power, and {task.id} {what}."
            raise SubmissionError(msg)
        self._lit = np.zeros(n_runs)

    def act(self, observations: NDArray[np.float32], /) -> Array:
        """Actions (n_runs, actions) towards the controls that the rules ask for.

        Raises
        ------
        ShapeError
            When there are not as many rows as runs were announced to ``reset``.
        """
        if len(observations) != self._runs:
            msg = f"act got observations of {len(observations)} runs, reset was called with {self._runs}. Call reset first."
            raise ShapeError(msg)
        rows = observations.T.astype(np.float64, order="C")
        seen = {name: rows[place] for name, place in self._columns.items()}
        now = {name: seen[quantity] / at_one for name, (quantity, at_one) in self._controls.items() if quantity in seen}
        wanted = self._climate(seen, now)
        if self._stored:
            wanted |= self._energy(seen, now, wanted)
        calm = np.zeros(self._runs)
        asked = np.stack([wanted[name] if name in now else calm for name in self._task.action_names])
        if self._task.actuation == "rate":
            there = np.stack([now.get(name, calm) for name in self._task.action_names])
            asked = np.minimum(np.maximum((asked - there) / self._task.max_change, -1.0), 1.0)
        return asked.T

    def _climate(self, seen: dict[str, Array], now: dict[str, Array]) -> dict[str, Array]:
        """What the tuned rules ask for under sun and lamps, with the lamps by the price of power."""
        n, sun = self._more, seen["global_radiation"]
        self._lit = now.get(LAMPS, self._lit)
        wanted = self._wanted({**seen, "global_radiation": sun + n.lamps_light * self._lit}, now[VENTS])
        worth = n.lamps_fruit * seen.get(FRUIT, self._fruit)
        hour, _ = clock_from(seen)
        allowed = (hour >= n.lamps_from) & (hour < n.lamps_until) & (sun < n.lamps_radiation)
        wanted[LAMPS] = np.where(allowed & (self._cost(seen, now) < worth), 1.0, 0.0)
        wanted[BLACKOUT] = np.zeros(self._runs)  # closed above lamps it would keep the vapour in
        return wanted

    def _cost(self, seen: dict[str, Array], now: dict[str, Array]) -> Array:
        """What the lamps' power costs [EUR kWh-1]: what it would be sold for while the engine runs."""
        if BOUGHT not in seen:
            return seen[POWER]
        running = now[self._engine] > _RUNNING if self._engine in now else False
        return np.where(running, seen[POWER], seen[BOUGHT])

    def _energy(self, seen: dict[str, Array], now: dict[str, Array], wanted: dict[str, Array]) -> dict[str, Array]:
        """Engine, boiler, pipes and CO2, from the heat and the CO2 that the climate asks for."""
        n, share = self._more, seen[_SHARE]
        heat, dose = wanted[BOILER], wanted[DOSING]
        running = now[self._engine] > _RUNNING
        worth = np.where(wanted[LAMPS] > 0.0, seen.get(BOUGHT, seen[POWER]), seen[POWER])
        runs = np.where(
            (worth > self._threshold(seen) - np.where(running, n.engine_stay, 0.0)) & (share < n.buffer_full), 1.0, 0.0
        )
        free = n.boiler_flue * now[BOILER] + n.engine_flue * now[self._engine]
        for_co2 = np.maximum(n.boiler_co2 * dose - n.engine_flue * runs, 0.0) / n.boiler_flue
        for_heat = np.where(share < n.buffer_low, heat - n.engine_heat * runs, 0.0)
        boiler = np.maximum(np.where(share < n.buffer_full, for_co2, 0.0), for_heat)
        return {
            self._engine: runs,
            BOILER: np.minimum(np.maximum(boiler, 0.0), 1.0),
            self._pipes: heat,
            DOSING: np.minimum(dose, free + n.co2_bought),
        }

    def _threshold(self, seen: dict[str, Array]) -> Array:
        """Price of power [EUR kWh-1] that the engine runs above."""
        n, filled = self._more, seen[_SHARE] / 100.0
        price: Array = n.engine_price + n.engine_full * filled
        if _NIGHT in seen:
            price = price - n.engine_cold * np.maximum(_WARM_NIGHT - seen[_NIGHT], 0.0)
        if self._ahead:
            dearest = np.max([seen[name] for name in self._ahead], axis=0)
            price = price + n.engine_wait * filled * np.maximum(dearest - price, 0.0)
        return price

    def _shares(self, hour: Array, day: Array, radiation: Array, *others: Array) -> Any:
        """As for the tuned rules, but lit hours are no evening, and the screen opens by the sun alone."""
        n = self._numbers
        shares = super()._shares(hour, day, radiation, *others)
        bright = (radiation - self._more.lamps_light * self._lit - n.screen_light_from) / n.screen_light_span
        evening = shares.evening * (1.0 - self._lit)
        return shares._replace(evening=evening, bright=np.minimum(np.maximum(bright, 0.0), 1.0))
