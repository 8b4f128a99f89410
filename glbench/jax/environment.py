"""The environment for JAX: the five values of gymnax before 1.0 around one compiled call for any number of rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from glbench.env.kernels import check_kernel
from glbench.env.spaces import action_space, checked_seed, observation_space, task_of_environment
from glbench.errors import ActionError, ShapeError, refuse, whole_number
from glbench.jax.door import open_door
from glbench.jax.library import RESET, STEP
from glbench.tasks import Normalisation, TaskSpec

SEEDS = range(64)  # Scenarios of an environment that was given none


@dataclass(frozen=True, eq=False)
class Box:
    """A space as gymnax has them: vectors between two bounds, each ``(m,)`` float32."""

    low: NDArray[np.float32]
    high: NDArray[np.float32]

    @property
    def shape(self) -> tuple[int, ...]:
        """``(m,)``."""
        return self.low.shape

    @property
    def dtype(self) -> np.dtype[np.float32]:
        """float32."""
        return self.low.dtype

    def sample(self, key: jax.Array) -> jax.Array:
        """A vector, drawn uniformly ``(m,)``."""
        return jax.random.uniform(key, self.shape, jnp.float32, self.low, self.high)

    def contains(self, x: jax.Array) -> jax.Array:
        """Whether all numbers of ``x`` ``(m,)`` lie within the bounds."""
        return jnp.all((x >= self.low) & (x <= self.high))


class State(NamedTuple):
    """One environment; with ``vmap`` each has further axes in front.

    ``step`` is the steps taken, ``scenario`` the number of the scenario in the environment's ``seeds``, both int32; ``ended`` says whether
    the episode has ended. ``numbers`` ``(words,)`` uint32 are the state of the model, controls in force and memory: halves of float64
    numbers, which JAX need not understand. ``Environment.unpack`` reads them.
    """

    step: jax.Array
    scenario: jax.Array
    ended: jax.Array
    numbers: jax.Array

    @property
    def time(self) -> jax.Array:
        """Steps taken, as gymnax calls them."""
        return self.step


@partial(jax.tree_util.register_dataclass, data_fields=["first", "count", "max_steps_in_episode"], meta_fields=[])
@dataclass(frozen=True)
class Params:
    """Scenarios of the episodes, and the step that ends them early. May be traced and mapped.

    Each new episode draws one of ``count`` scenarios from number ``first`` on: ``Params(first=5, count=1)`` always begins the scenario of
    ``seeds[5]``. An episode ends with its season, or after ``max_steps_in_episode`` steps if that is earlier.
    """

    first: Any = 0
    count: Any = 1
    max_steps_in_episode: Any = field(default=None, compare=False)

    def replace(self, **changes: Any) -> Params:
        """The same with ``changes``."""
        return replace(self, **changes)


class Environment:
    """A task for JAX, with the signature of gymnax before 1.0; pure functions that work under ``jit``, ``scan`` and ``vmap``.

    PureJaxRL and rejax 0.1.3 unpack its five values. For gymnax 1.x there is ``GymnaxEnvironment``.

    ``vmap`` over n rows makes one call of the compiled kernel with n rows. Observations, rewards, ends and states have the bits of
    ``glbench.env.GreenhouseVectorEnv`` with the same kernel. The calls run on the CPU and cannot be differentiated. Raises ``TaskError``
    for a task with parts that the compiled kernel does not know, with their names, and ``GlbenchError`` for unknown names, seeds that are
    none, and where there is no compiler.

    ``task`` is an id, the path of a task file, or the task itself; where it has splits, its training split unless it is in another one.
    ``preset`` is that of the kernel: ``"fast"`` for training; scores are made with ``"reference"``. ``seeds`` are scenarios that episodes
    can be in, drawn here: weather, start, parameters, sensors; a generated season takes some 50 ms to make. ``places`` says at how many
    places of each season ``reset`` may begin; 1 is its start alone. With more, environments that are reset together spread over seasons and
    hours of day. An episode that begins late ends with its season, and the next one begins at the start.

    ``info`` is what ``info`` tells of a step besides ``failed`` and ``discount``: names as in ``info`` of the other environments
    (``glbench.env.info_quantities``) and of states of the model. ``workers`` are cores that share the rows of a call, to the same bits;
    ``split``, ``overrides`` and ``normalise`` are as for ``GreenhouseVectorEnv``.
    """

    def __init__(
        self,
        task: TaskSpec | str,
        preset: str = "fast",
        *,
        seeds: Sequence[int] = SEEDS,
        places: int = 1,
        info: Sequence[str] = ("epi", "penalty"),
        workers: int = 1,
        split: str | None = None,
        overrides: Mapping[str, Any] | None = None,
        normalise: bool = False,
    ) -> None:
        self.task = task_of_environment(task, split, overrides)
        self._normalisation = Normalisation.of(self.task.observed()) if normalise else None
        check_kernel(preset, self.task)
        self.seeds = tuple(checked_seed(seed) for seed in seeds)
        if not self.seeds:
            refuse("An environment has at least one scenario: give it a seed or more.", ShapeError)
        if whole_number(places, "The number of places") < 1:
            refuse(f"An episode begins at one place of its season or more, not at {places}.", ShapeError)
        self.info = tuple(info)
        self._door = open_door(self.task, self.seeds, places, preset, workers, self.info)
        spaces = observation_space(self.task, self._normalisation), action_space(self.task)
        self._observations, self._actions = (Box(box.low, box.high) for box in spaces)  # type: ignore[attr-defined]

    @property
    def name(self) -> str:
        """The task's id."""
        return self.task.id

    @property
    def default_params(self) -> Params:
        """Parameters for whole seasons in any of the scenarios."""
        return Params(0, len(self.seeds), self.task.steps)

    @property
    def num_actions(self) -> int:
        """How many numbers an action has."""
        return self._door.actions

    @property
    def obs_shape(self) -> tuple[int, ...]:
        """``(columns,)``."""
        return self._observations.shape

    def observation_space(self, params: Params | None = None) -> Box:
        """Bounds of the observed columns; the columns are ``task.observed()``."""
        return self._observations

    def action_space(self, params: Params | None = None) -> Box:
        """Bounds of the actions; ``step`` brings what lies outside to the nearest bound."""
        return self._actions

    def reset(self, key: jax.Array, params: Params | None = None) -> tuple[jax.Array, State]:
        """Begin an episode in a random scenario, at one of its places: the observation ``(columns,)`` float32, and the environment."""
        if self._door.places == 1:
            return self.reset_env(key, params)
        key, key_place = jax.random.split(key)
        return self._begin(self._scenario(key, params), jax.random.randint(key_place, (), 0, self._door.places))

    def reset_env(self, key: jax.Array, params: Params | None = None) -> tuple[jax.Array, State]:
        """Begin an episode in a random scenario, at its start: what ``step`` does when one has ended."""
        return self._begin(self._scenario(key, params), jnp.zeros((), jnp.int32))

    def step(
        self, key: jax.Array, state: State, action: jax.Array, params: Params | None = None
    ) -> tuple[jax.Array, State, jax.Array, jax.Array, dict[str, jax.Array]]:
        """Take one step with an action ``(m,)``; when the episode ends, also by ``params.max_steps_in_episode``, begin the next.

        Raises ``jax.errors.JaxRuntimeError`` for an action that is not finite. Under ``jit`` that may wait for a later result.

        Observation and state are those of the new episode where one has begun; reward, ``done`` and ``info`` are those of the step. Reward
        and ``info`` are float32, or float64 where JAX has 64 bits switched on. ``info["failed"]`` says that the step could not be
        integrated, which ends the episode, ``info["discount"]`` is 0 where the season or a failure ended it, else 1.
        """
        key_cut, key_end = jax.random.split(key)
        observation, state, reward, done, info = self._step(state, action, self._scenario(key_end, params), autoreset=True)
        limit = None if params is None else params.max_steps_in_episode
        if limit is not None and not (isinstance(limit, int) and limit >= self.task.steps):
            cut = ~done & (state.step >= limit)
            start = self.reset_env(key_cut, params)
            observation, state = jax.tree.map(partial(jnp.where, cut), start, (observation, state))
            done |= cut
        return observation, state, reward, done, info

    def step_env(
        self, key: jax.Array, state: State, action: jax.Array, params: Params | None = None
    ) -> tuple[jax.Array, State, jax.Array, jax.Array, dict[str, jax.Array]]:
        """As ``step``, but an environment whose season has ended stays as it is: its quantities are 0."""
        return self._step(state, action, state.scenario, autoreset=False)

    def is_terminal(self, state: State, params: Params | None = None) -> jax.Array:
        """Whether the episode has ended; never after ``step``."""
        return state.ended

    def discount(self, state: State, params: Params | None = None) -> jax.Array:
        """0 for an episode that has ended, else 1."""
        return jnp.where(state.ended, 0.0, 1.0)

    def unpack(self, state: State) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """State of the model ``(..., s)``, controls in force ``(..., c)`` and memory ``(..., m)`` of environments, outside of ``jit``."""
        numbers = np.array(state.numbers).view(np.float64)
        x, u, memory = np.split(numbers, np.cumsum([self._door.states, self._door.controls]), axis=-1)
        return x, u, memory

    def _scenario(self, key: jax.Array, params: Params | None) -> jax.Array:
        params = self.default_params if params is None else params
        first, count = (jnp.asarray(number, jnp.int32) for number in (params.first, params.count))
        return first + jax.random.randint(key, (), 0, count, jnp.int32)

    def _begin(self, scenario: jax.Array, place: jax.Array) -> tuple[jax.Array, State]:
        door = self._door
        kinds = (_of((), jnp.int32), _of((), jnp.bool_), _of((door.words,), jnp.uint32), _of((door.columns,), jnp.float32))
        call = jax.ffi.ffi_call(RESET, kinds, vmap_method="broadcast_all")
        step, ended, numbers, observation = call(scenario, jnp.asarray(place, jnp.int32), name=door.name)
        return self._normalise(observation), State(step, scenario, ended, numbers)

    def _step(
        self, state: State, action: jax.Array, fresh: jax.Array, *, autoreset: bool
    ) -> tuple[jax.Array, State, jax.Array, jax.Array, dict[str, jax.Array]]:
        door, real = self._door, jax.dtypes.canonicalize_dtype(np.float64)
        try:
            action = jnp.asarray(action)
        except (TypeError, ValueError, OverflowError) as error:
            refuse(f"An action of {self.task.id} is an array of real numbers, and this {type(action).__name__} is not.", ActionError, error)
        if not jnp.issubdtype(action.dtype, jnp.floating) and not jnp.issubdtype(action.dtype, jnp.integer):
            refuse(f"An action of {self.task.id} is an array of real numbers, not of {action.dtype}.", ActionError)
        action = action.astype(real)
        if action.shape != (door.actions,):
            msg = f"An action of {self.task.id} has the shape ({door.actions},), not {action.shape}. Map over rows with jax.vmap."
            raise ShapeError(msg)
        kinds = (
            *(_of((), jnp.int32), _of((), jnp.int32), _of((), jnp.bool_), _of((door.words,), jnp.uint32)),
            *(_of((door.columns,), jnp.float32), _of((), real), _of((), jnp.bool_), _of((), jnp.bool_)),
            _of((len(self.info),), real),
        )
        call = jax.ffi.ffi_call(STEP, kinds, vmap_method="broadcast_all")
        *now, observation, reward, done, failed, values = call(*state, action, fresh, name=door.name, autoreset=autoreset)
        info = {name: values[place] for place, name in enumerate(self.info)}
        info |= {"failed": failed, "discount": jnp.where(done, 0.0, 1.0)}
        return self._normalise(observation), State(*now), reward, done, info

    def _normalise(self, observation: jax.Array) -> jax.Array:
        return observation if self._normalisation is None else self._normalisation(observation)


def _of(shape: tuple[int, ...], kind: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(shape, kind)  # type: ignore[no-untyped-call]
