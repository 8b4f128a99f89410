"""A task and some of its scenarios, laid out for the compiled calls (native/door.cpp) and opened under a name.

A call names its door instead of holding addresses. The name is made of the content, so that programs which JAX compiled and stored are
found again by another process, and never meet another task.
"""

from __future__ import annotations

import ctypes
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.env.accounts import REWARD
from glbench.env.actuation import recorded_actuation
from glbench.env.info import info_quantities
from glbench.env.numpy_environments import NO_PARTS
from glbench.env.observations import python_part
from glbench.env.program import info_columns, make_program
from glbench.env.rewards import REWARDS
from glbench.env.scenario import RunScenarios
from glbench.env.uncertainty import UNIFORM
from glbench.errors import TaskError, UnknownNameError, did_you_mean, refuse
from glbench.jax.library import DoorPointers, library
from glbench.kernel import make_kernel, why_not_compiled
from glbench.kernel.compiled.environment import CompiledEnvironments, Entry, entry_of
from glbench.kernel.environment import Program
from glbench.tasks import TaskSpec

GOLDEN = 0.6180339887498949  # Steps of this size, modulo 1, spread any number of points evenly over an interval

_OPEN: dict[str, object] = {}
"""What the library holds addresses of: a program that JAX compiled may call a door as long as the process lives."""


@dataclass(frozen=True)
class Door:
    """What the calls need, and the sizes of what they return. They find the door by ``name``.

    An environment has so many numbers of ``states``, ``controls`` and ``memory``, an observation ``columns``, an action ``actions``; an
    episode may begin at ``places`` places of each of ``scenarios`` scenarios.
    """

    name: str
    states: int
    controls: int
    memory: int
    columns: int
    actions: int
    scenarios: int
    places: int

    @property
    def words(self) -> int:
        """Words of 32 bits in which a call keeps states, controls and memory."""
        return 2 * (self.states + self.controls + self.memory)


def open_door(task: TaskSpec, seeds: Sequence[int], places: int, preset: str, workers: int, info: Sequence[str]) -> Door:
    """Open the door of ``task`` with the scenarios of ``seeds``; one that is open already is used again.

    Raises ``TaskError`` for a task that the compiled step cannot serve, with the parts that it cannot, ``UnknownNameError`` for a name in
    ``info`` that nothing has, and ``CompiledUnavailable`` when the library for JAX cannot be built.
    """
    choices = (*(quantity.name for quantity in info_quantities(task)[1:]), *task.model_value.state_names)  # the seed is no column
    for quantity in info:
        if quantity not in choices:
            refuse(f"{task.id} has no quantity or state '{quantity}' for info.{did_you_mean(quantity, choices)}", UnknownNameError)
    program, parts = make_program(task)
    if parts is not NO_PARTS:
        of_python = [f"the actuation '{task.actuation.kind}'"] if recorded_actuation(task) is None else []
        of_python += [f"the reward '{name}'" for name in task.reward.modules if not REWARDS.recorded(name)]
        of_python += [f"the observation '{name}'" for name in task.observation.modules if python_part(name) is not None]
        distributions = {group.distribution for group in task.scenario.groups} - {UNIFORM}
        of_python += [f"the distribution '{name}'" for name in sorted(distributions)]
        raise _not_served(task, f"{', '.join(of_python) or 'what follows from its uncertain parameters'} is Python")
    environments = make_kernel(task.model_value, task.step_seconds, workers=workers, preset=preset).environments(program, 1)
    if not isinstance(environments, CompiledEnvironments):
        raise _not_served(task, why_not_compiled(task.model_value) or "its program is too large for the compiled kernel")
    facts = (task.id, task.digest, task.split, task.sealed, tuple(seeds), places, preset, workers, tuple(info))
    name = f"{task.id} {preset} {hashlib.sha256(repr(facts).encode()).hexdigest()[:24]}"
    if name not in _OPEN:
        columns = [choices.index(quantity) for quantity in info]
        pointers, owners = _make_pointers(task, program, entry_of(environments), seeds, places, columns)
        library().glb_door_open(name.encode(), ctypes.addressof(pointers))
        _OPEN[name] = pointers, owners
    states, controls = environments.x.shape[1], environments.u.shape[1]
    return Door(name, states, controls, program.memory, program.columns, len(program.actions.low), len(seeds), places)


def _make_pointers(
    task: TaskSpec, program: Program, entry: Entry, seeds: Sequence[int], places: int, columns: Sequence[int]
) -> tuple[DoorPointers, object]:
    """The door's structure, with the columns of the table for ``info``, and the owners of its arrays, which must live as long as it."""
    scenarios = RunScenarios(task)
    scenes = scenarios.draw(seeds)
    # Steps at which episodes may begin: the first, then some that all together spread over the season evenly.
    points = np.arange(len(seeds) * places).reshape(len(seeds), places) * GOLDEN % 1.0
    at: NDArray[np.int64] = np.floor(points * program.steps).astype(np.int64)
    at[:, 0] = 0
    rows = np.take_along_axis(scenes.days, at // program.day, axis=1) + at % program.day
    starts = [scenarios.start_states(seeds, rows[:, place]) for place in range(places)]
    starts[0] = scenes.states
    arrays: dict[str, NDArray[Any]] = {
        "low": program.actions.low,
        "high": program.actions.high,
        "start": np.stack(starts, axis=1),
        "at": at,
        "sequence": scenes.days,
        "first": scenes.first,
        "key": scenes.keys,
        "parameter": program.nominal if scenes.parameters is None else scenes.parameters,
        "trait": scenes.traits,
        "in_force": task.initial_controls,
        "remembered": scenarios.memory_layout.start,
        "show": np.array(columns, np.int64),
    }
    arrays = {key: np.ascontiguousarray(array) for key, array in arrays.items()}
    pointers = DoorPointers(
        run=entry.function, settings=entry.settings, program=entry.program,
        states=scenes.states.shape[1], controls=len(task.model_value.controls), actions=len(program.actions.low),
        memory=program.memory, keys=program.keys, days=program.days, traits=program.traits, parameters=entry.parameters,
        columns=program.columns, width=program.width, shared_parameters=scenes.parameters is None,
        scenarios=len(seeds), places=places, reward=info_columns(task) + REWARD, shown=len(columns),
    )  # fmt: skip
    for key, array in arrays.items():
        setattr(pointers, key, array.ctypes.data)
    return pointers, (entry, program, scenarios.pool, arrays)


def _not_served(task: TaskSpec, reason: str) -> TaskError:
    advice = "Use glbench.env.GreenhouseVectorEnv, which steps every task on every machine."
    return TaskError(f"glbench.jax cannot step {task.id}: {reason.removesuffix('.')}. {advice}")
