"""A grower's rules for lamps at hourly prices, engine, boiler and heat buffer, on top of the tuned rules of the climate.

The climate is that of ``glbench.agents.tuned_rules``, which says how much heat and CO2 are wanted. Lamps are on while power costs less
than the fruit that it makes. The engine runs in hours in which power is worth more than a price that rises as the buffer fills, and
falls before a cold night; the boiler burns by day for the CO2 in its flue gas, and gives heat when the buffer is empty.
``baselines/rule_based_energy`` holds the numbers, and explains each. The rules look at observations and the task card alone.

All arithmetic goes element by element over arrays of shape (n,), as in the tuned rules.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from glbench.agents.controllers import clock_from, controller
from glbench.agents.tuned_rules import NEEDED, TunedRulesAgent, TunedRuleSettings, number, read_rule_pages
from glbench.arrays import Floats
from glbench.errors import SubmissionError, refuse
from glbench.tasks.set_points import BLACKOUT, BOILER, DOSING, LAMPS, VENTS, WORKED

if TYPE_CHECKING:
    from glbench.tasks import TaskCard


_ENGINE, _PIPES = "engine", "pipe_heat"
"""What two controls of an energy system deliver: power, and heat for the pipes. Where they are, the boiler's heat goes into the buffer."""
POWER, BOUGHT, FRUIT = "price_power", "price_power_bought", "price_fruit"
_AHEAD, _NIGHT, _SHARE = f"{POWER}_in_", "outdoor_temperature_in_12h", "buffer_share"
_WARM_NIGHT = 18.0  # A night that is no colder [degC] needs no heat
_GROWTH = "revenue_growth"  # Item of the ledger that tells what fruit is worth, where its price does not change
_RUNNING = 0.01  # The engine counts as running above this load


class EnergyRuleSettings(TunedRuleSettings):
    """Numbers of the rules for lamps at hourly prices, engine, boiler and buffer, besides those of the climate.

    "Load" is a fraction of what is installed. Numbers of machines that a task lacks are not used. A page names the tasks that it is for.
    """

    title: ClassVar[str] = "energy rules"
    scope_key: ClassVar[str] = "tasks"

    lamps_from: float = number(0.0, 24.0, "h", "of the day they may be on (not tuned)", section="Lamps", tuned=False)
    lamps_until: float = number(0.0, 24.0, "h", "of the same day they go off (not tuned)", tuned=False)
    lamps_radiation: float = number(0.0, 1000.0, "W m-2", "they are off from here on; 0: they are never on")
    lamps_fruit: float = number(0.0, 0.5, "kg kWh-1", "they are on while power costs less than so much fruit")
    lamps_light: float = number(0.0, 500.0, "W m-2", "of radiation that they count as, for heating and CO2")

    engine_price: float = number(-0.05, 0.4, "EUR kWh-1", "it runs while power is worth more, buffer empty", section="Engine")
    engine_full: float = number(0.0, 0.4, "EUR kWh-1", "more with a full buffer (in proportion with others)")
    engine_cold: float = number(0.0, 0.01, "EUR kWh-1 K-1", "less for each degree below 18 degC of the coming night")
    engine_wait: float = number(0.0, 1.0, "-", "more by this part of what a dearer hour is above it, in proportion with the buffer")
    engine_stay: float = number(0.0, 0.05, "EUR kWh-1", "less while it runs")

    buffer_full: float = number(0.0, 100.0, "%", "engine and boiler fill it up to here", section="Buffer and boiler")
    buffer_low: float = number(0.0, 50.0, "%", "below it the boiler gives the heat that is asked for")
    boiler_co2: float = number(0.0, 2.0, "-", "of the CO2 wanted by day the boiler burns this part for its flue gas")
    co2_bought: float = number(0.0, 1.0, "share", "of the supply at most is bought, besides what is in the flue gas")

    boiler_flue: float = number(
        0.1, 20.0, "-", "CO2 in the flue gas of the boiler at full load, in full supplies", section="Machines (not tuned)", tuned=False
    )
    engine_flue: float = number(0.1, 20.0, "-", "the same of the engine", tuned=False)
    engine_heat: float = number(0.0, 5.0, "-", "heat of the engine at full load, in full loads of the boiler", tuned=False)


@controller(
    "rule_based_energy",
    read=partial(read_rule_pages, kind=EnergyRuleSettings),
    version="0da9d380f7e6d1bab7a9fb3838ca97426982100d4c8f299686ddc7f7ab5344c3",
)
class EnergyRulesAgent(TunedRulesAgent):
    """Rules for a greenhouse whose power has a price for every hour; an ``Agent``.

    ``settings`` are pages of numbers, of which the task chooses one, or numbers for every run, one a run.
    """

    title = "the energy rules"
    kind = EnergyRuleSettings

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """Forget what was measured; ``n_runs`` runs of ``task`` begin.

        Raises ``SubmissionError`` when the task does not show the price of power or another quantity that the rules need, or no page is for
        it, and ``ShapeError`` when there are numbers for another count of runs.
        """
        super().reset(task, n_runs)
        self._hours_ahead = tuple(name for name in task.observation_names if name.startswith(_AHEAD))
        self._fruit = next((one.price for one in task.ledger if one.name == _GROWTH and not isinstance(one.price, str)), 0.0)
        self._lit = np.zeros(n_runs)

    def _find_columns(self, task: TaskCard, n_runs: int) -> None:
        self.check_actuation(task)
        controls, columns = [one.name for one in task.controls], task.observation_names
        machines = tuple(one.name for what in (_ENGINE, _PIPES) for one in task.controls if one.quantity == what)
        self._stored = len(machines) == len((_ENGINE, _PIPES)) and set(machines) <= set(task.action_names)
        self._engine, self._pipes = machines if self._stored else ("", "")
        unknown = [name for name in task.action_names if name not in (*WORKED, self._engine, self._pipes)]
        required = (POWER, *((_SHARE,) if self._stored else ()))
        missing = [name for name in required if name not in columns]
        if unknown or missing or VENTS not in controls:
            what = f"has the control {', '.join(unknown)}, which they do not know" if unknown else f"lacks {VENTS}"
            what = f"does not show {', '.join(missing)}" if missing else what
            refuse(f"The energy rules work lamps, engine and buffer at an hourly price of power, and {task.id} {what}.", SubmissionError)
        self._installed = [one.name for one in task.controls if one.at_one > 0.0 and one.quantity in columns]
        self.begin(task, n_runs, (*NEEDED, *required), optional=columns, positions=(VENTS, *self._installed))

    def decide(self, readings: dict[str, Floats], positions: dict[str, Floats], /) -> Floats:
        """Actions (n_runs, actions) towards the controls that the rules ask for."""
        n, sun, power = self._numbers, readings["global_radiation"], readings[POWER]
        self._lit = positions.get(LAMPS, self._lit)
        lit = {**readings, "global_radiation": sun + n.lamps_light * self._lit}
        controls = self._rules(lit, positions[VENTS])
        # What the lamps' power costs [EUR kWh-1] is what it would be sold for while the engine runs.
        cost = power
        if BOUGHT in readings:
            running = positions[self._engine] > _RUNNING if self._engine in self._installed else False
            cost = np.where(running, power, readings[BOUGHT])
        hour, _ = clock_from(readings)
        allowed = (hour >= n.lamps_from) & (hour < n.lamps_until) & (sun < n.lamps_radiation)
        worth = n.lamps_fruit * readings.get(FRUIT, self._fruit)
        controls[LAMPS] = np.where(allowed & (cost < worth), 1.0, 0.0)
        controls[BLACKOUT] = self._calm  # closed above lamps it would keep the vapour in
        if self._stored:
            controls |= self._energy(readings, positions, controls)
        return self.towards({name: controls[name] if name in self._installed else self._calm for name in self.task.action_names}, positions)

    def _energy(self, readings: dict[str, Floats], positions: dict[str, Floats], controls: dict[str, Floats]) -> dict[str, Floats]:
        """Engine, boiler, pipes and CO2, from the heat and the CO2 that the climate asks for."""
        n, share, power = self._numbers, readings[_SHARE], readings[POWER]
        filled = share / 100.0
        # Price of power [EUR kWh-1] that the engine runs above.
        price: Floats = n.engine_price + n.engine_full * filled
        if _NIGHT in readings:
            price = price - n.engine_cold * np.maximum(_WARM_NIGHT - readings[_NIGHT], 0.0)
        if self._hours_ahead:
            dearest = np.max([readings[name] for name in self._hours_ahead], axis=0)
            price = price + n.engine_wait * filled * np.maximum(dearest - price, 0.0)
        price = price - np.where(positions[self._engine] > _RUNNING, n.engine_stay, 0.0)
        worth = np.where(controls[LAMPS] > 0.0, readings.get(BOUGHT, power), power)
        runs = np.where((worth > price) & (share < n.buffer_full), 1.0, 0.0)

        heat, dose = controls[BOILER], controls[DOSING]
        free = n.boiler_flue * positions[BOILER] + n.engine_flue * positions[self._engine]
        for_co2 = np.maximum(n.boiler_co2 * dose - n.engine_flue * runs, 0.0) / n.boiler_flue
        for_heat = np.where(share < n.buffer_low, heat - n.engine_heat * runs, 0.0)
        boiler = np.maximum(np.where(share < n.buffer_full, for_co2, 0.0), for_heat)
        return {
            self._engine: runs,
            BOILER: np.minimum(np.maximum(boiler, 0.0), 1.0),
            self._pipes: heat,
            DOSING: np.minimum(dose, free + n.co2_bought),
        }

    def _shares(self, hour: Floats, day: Floats, radiation: Floats, *others: Floats) -> Any:
        """As for the tuned rules, but lit hours are no evening, and the screen opens by the sun alone."""
        n = self._numbers
        shares = super()._shares(hour, day, radiation, *others)
        bright = (radiation - n.lamps_light * self._lit - n.screen_light_from) / n.screen_light_span
        evening = shares.evening * (1.0 - self._lit)
        return shares._replace(evening=evening, bright=np.minimum(np.maximum(bright, 0.0), 1.0))
