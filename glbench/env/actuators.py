"""Actuators that are not ideal: vents, screens and valves that lag, stick, fail, or deliver less than their commands.

An action moves the command c of a control, a fraction, within bounds and rate limit. In step k an actuator delivers

    d(k) = 0                                                     while it has failed
    d(k) = d(k - 1)                                              while it sticks
    d(k) = d(k - 1) + (1 - exp(-h / T)) (m(k) c(k) - d(k - 1))   otherwise, with d(-1) = 0

over a step of h seconds with the lag T: a first-order lag, as motors and valves are usually modelled, with the position at the end of
the step counted for all of it. m is what it can deliver at most: 1 - s, with a shortfall s drawn evenly once a run between 0 and the
stated one, times a factor that falls in a straight line from 1 at one wind speed to a share at a higher one.

Faults are Markov chains of two states, the textbook model of a unit that is repaired (such as doi 10.1007/978-3-030-76904-8, chapter 6):
one begins with the chance h / (mean time between faults) in each step, and ends with the chance h / (mean time of a fault).

The kernel steps and the ledger charges what is delivered. Agents are shown the command only. docs/uncertainty.md has a picture.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from typing import Any, ClassVar

import numpy as np

from glbench.arrays import Floats
from glbench.env.actuation import recorded_actuation
from glbench.env.memory_layout import DrawPlaces, MemoryLayout
from glbench.env.process_computer import below, select, share
from glbench.errors import TaskError, refuse
from glbench.kernel.tape import Recorder, Tape
from glbench.tasks import TaskSpec
from glbench.tasks.tables import WindLimitTable
from glbench.weather import COLUMNS

PART = "actuators"
"""The actuators' part of a run's memory."""
WIND = COLUMNS.index("wind")

_COMMAND, _STICKS, _FAILS = "command", "sticks", "fails"


@dataclass(frozen=True)
class Actuator:
    """An actuator that is not ideal."""

    name: str
    place: int
    """``name`` and ``place``: its control, and the control's place among those of the model."""
    carry: float
    """Share of what it delivered that is in what it delivers a step later: exp(-h / T), 0 without a lag."""
    shortfall: float
    """The largest one that a run can draw."""
    wind: WindLimitTable | None
    """What wind takes from it; ``None`` without a limit."""
    faults: Mapping[str, tuple[float, float]]
    """For "sticks" and "fails", if it does: chance in a step that the fault begins, and that it lasts."""

    def most(self, trait: Any, wind_speed: Any) -> Any:
        """What it can deliver at most, from 1 - s of the run (1 without a shortfall) and the wind speed [m s-1]."""
        if self.wind is None:
            return trait
        return trait * (1.0 - (1.0 - self.wind.share) * share(wind_speed, self.wind.above, self.wind.full))

    def delivered(self, before: Any, command: Any, most: Any, faults: Mapping[str, Any]) -> Any:
        """What it delivers in a step, after ``before`` in the step before; ``faults`` are 1 or 0."""
        moved = self.carry * before + (1.0 - self.carry) * (most * command)
        if _STICKS in faults:
            moved = select(faults[_STICKS], before, moved)
        return moved * (1.0 - faults[_FAILS]) if _FAILS in faults else moved


def fault(before: Any, number: Any, chances: tuple[float, float]) -> Any:
    """Whether there is a fault in a step, 1 or 0, from whether there was one in the step before and a uniform number."""
    begins, lasts = chances
    return below(number, before * (lasts - begins) + begins)


@dataclass(frozen=True)
class Actuators:
    """The actuators of a task that are not ideal, in the order of its controls."""

    actuators: tuple[Actuator, ...]

    STREAM: ClassVar[str] = "actuators"
    TRAIT_STREAM: ClassVar[str] = "actuator shortfalls"

    @staticmethod
    def of(task: TaskSpec) -> Actuators:
        """The actuators of a task; nothing where all are ideal.

        Raises ``TaskError`` when the kind of actuation is a registered one: Python, which does not tell a command from its delivery.
        """
        if task.actuators and recorded_actuation(task) is None:
            refuse(f"{task.source}: [actuators] go with the kinds of actuation that glbench ships, not '{task.actuation.kind}'.", TaskError)
        actuators = []
        for name in (name for name in task.actuation.controls if name in task.actuators):
            table, place = task.actuators[name], task.model_value.control_names.index(name)
            carry = float(np.exp(-task.step_seconds / (60.0 * table.lag_minutes))) if table.lag_minutes else 0.0
            kinds = {_STICKS: table.sticks, _FAILS: table.fails}
            faults = {kind: one.chances(task.step_seconds) for kind, one in kinds.items() if one is not None}
            actuators.append(Actuator(name, place, carry, table.shortfall, table.wind, faults))
        return Actuators(tuple(actuators))

    @cached_property
    def short(self) -> tuple[Actuator, ...]:
        """Those with a shortfall, in the order of the traits."""
        return tuple(actuator for actuator in self.actuators if actuator.shortfall)

    @property
    def numbers(self) -> int:
        """Random numbers needed in a step."""
        return sum(len(actuator.faults) for actuator in self.actuators)

    @property
    def trait_numbers(self) -> int:
        """Random numbers needed once a run."""
        return len(self.short)

    @property
    def trait_count(self) -> int:
        """What each actuator with a shortfall delivers at most."""
        return len(self.short)

    def traits(self, numbers: Floats) -> Floats:
        """1 - s of each actuator with a shortfall, ``(n, trait_count)``, from as many uniform numbers."""
        traits: Floats = 1.0 - numbers * np.array([actuator.shortfall for actuator in self.short])
        return traits

    def initial_memory(self) -> dict[str, float]:
        """Numbers kept from step to step, with start values: of each actuator its command, and whether it has which fault."""
        return {f"{what} {actuator.name}": 0.0 for actuator in self.actuators for what in (_COMMAND, *actuator.faults)}

    def command_places(self, layout: MemoryLayout) -> dict[int, int]:
        """Place in the memory of the command of each control, by the control's place."""
        return {actuator.place: layout.of(PART)[f"{_COMMAND} {actuator.name}"] for actuator in self.actuators}

    def commands(self, recorder: Recorder, controls: Sequence[Any], layout: MemoryLayout) -> list[Any]:
        """Commands in force, recorded: those of the memory, and of ideal actuators ``controls``, all of the model's."""
        places = self.command_places(layout)
        return [recorder.input("memory", places[index]) if index in places else control for index, control in enumerate(controls)]

    def record(self, recorder: Recorder, commands: Mapping[str, Any], layout: MemoryLayout, draws: DrawPlaces) -> None:
        """Record what is delivered of new ``commands`` in a step, as controls, and the memory for the next one."""
        memory, numbers = layout.of(PART), count(draws.noise)
        for actuator in self.actuators:
            faults = {}
            for kind, chances in actuator.faults.items():
                place = memory[f"{kind} {actuator.name}"]
                faults[kind] = fault(recorder.input("memory", place), recorder.input("noise", next(numbers)), chances)
                recorder.output("memory", place, faults[kind])
            trait = recorder.input("trait", draws.trait + self.short.index(actuator)) if actuator.shortfall else 1.0
            most = actuator.most(trait, recorder.input("weather", WIND))
            before, command = recorder.input("controls", actuator.place), commands[actuator.name]
            recorder.output("controls", actuator.place, actuator.delivered(before, command, most, faults))
            recorder.output("memory", memory[f"{_COMMAND} {actuator.name}"], command)

    def tape(self, layout: MemoryLayout, draws: DrawPlaces) -> Tape:
        """The same as a tape by itself, of commands that are ``given`` for all controls of the model."""
        with Recorder() as recorder:
            self.record(recorder, {one.name: recorder.input("given", one.place) for one in self.actuators}, layout, draws)
        return recorder.tape()
