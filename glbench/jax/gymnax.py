"""The environment for gymnax 1.x: its base class, spaces and parameters, and six values a step."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

import jax
import jax.numpy as jnp

from glbench.errors import GlbenchError, refuse
from glbench.jax.environment import Environment, Params, State

_NEEDS = (
    'glbench.jax.GymnaxEnvironment needs gymnax 1.0 or newer, {}. Install it with `pip install "gymnax>=1" six`; '
    "glbench.jax.Environment works without."
)

try:
    from gymnax.environments import environment as gymnax_environment
    from gymnax.environments import spaces

    from flax import struct  # isort: skip  # gymnax brings it
except ModuleNotFoundError as error:
    _missing = str(error.name)
    _why = "which is not installed" if _missing.startswith("gymnax") else f"which needs {_missing}"
    raise GlbenchError(_NEEDS.format(_why)) from error

if version("gymnax").startswith("0."):
    raise GlbenchError(_NEEDS.format(f"and {version('gymnax')} is installed"))


@struct.dataclass
class GymnaxState(gymnax_environment.EnvState):  # type: ignore[misc]  # gymnax has no types
    """One environment: ``time``, the steps since its episode began, int32, and the ``State`` of ``Environment``."""

    greenhouse: State


@struct.dataclass
class GymnaxParams(gymnax_environment.EnvParams):  # type: ignore[misc]
    """Scenarios of the episodes, and the step that truncates them: see ``glbench.jax.Params``."""

    first: Any = 0
    count: Any = 1


class GymnaxEnvironment(gymnax_environment.Environment):  # type: ignore[misc]
    """A task as an environment of gymnax 1.x; ``step`` returns observation, state, reward, terminated, truncated and info.

    ``terminated``: the season ended, or the step could not be integrated. ``truncated``: the episode reached ``max_steps_in_episode``
    before. In both cases ``step`` begins the next episode; the last observation is in ``info["final_observation"]``. ``task`` and
    ``options`` are as for ``glbench.jax.Environment``, with its errors; it is inside as ``greenhouse``, and gives the same bits.
    """

    def __init__(self, task: Any, preset: str = "fast", **options: Any) -> None:
        super().__init__()
        self.greenhouse = Environment(task, preset, **options)

    @property
    def task(self) -> Any:
        """The task."""
        return self.greenhouse.task

    @property
    def name(self) -> str:
        """The task's id."""
        return self.greenhouse.name

    @property
    def default_params(self) -> GymnaxParams:
        """Parameters for whole seasons in any of the scenarios."""
        return GymnaxParams(max_steps_in_episode=self.task.steps, count=len(self.greenhouse.seeds))

    @property
    def num_actions(self) -> int:
        """Number of controls in an action."""
        return self.greenhouse.num_actions

    @property
    def obs_shape(self) -> tuple[int, ...]:
        """``(columns,)``."""
        return self.greenhouse.obs_shape

    def action_space(self, params: GymnaxParams | None = None) -> spaces.Box:
        """Bounds of the actions; ``step`` clips actions to them."""
        box = self.greenhouse.action_space()
        return spaces.Box(jnp.asarray(box.low), jnp.asarray(box.high), box.shape, jnp.float32)

    def observation_space(self, params: GymnaxParams | None = None) -> spaces.Box:
        """Bounds of the observed columns; the columns are ``task.observed()``."""
        box = self.greenhouse.observation_space()
        return spaces.Box(jnp.asarray(box.low), jnp.asarray(box.high), box.shape, jnp.float32)

    def state_space(self, params: GymnaxParams | None = None) -> spaces.Dict:
        """The steps of an episode; the state of the greenhouse is opaque (``greenhouse.unpack``)."""
        return spaces.Dict({"time": spaces.Discrete(self.task.steps + 1)})

    def reset(self, key: jax.Array, params: GymnaxParams | None = None) -> tuple[jax.Array, GymnaxState]:
        """Begin an episode in a random scenario, at one of its start steps; return an observation ``(columns,)`` float32 and the state."""
        observation, state = self.greenhouse.reset(key, self._scenarios(params))
        return observation, GymnaxState(jnp.int32(0), state)

    def reset_env(self, key: jax.Array, params: GymnaxParams | None = None) -> tuple[jax.Array, GymnaxState]:
        """Begin an episode in a random scenario at its first step, as ``step`` does when an episode has ended."""
        observation, state = self.greenhouse.reset_env(key, self._scenarios(params))
        return observation, GymnaxState(jnp.int32(0), state)

    def step_env(
        self, key: jax.Array, state: GymnaxState, action: jax.Array, params: GymnaxParams | None = None
    ) -> tuple[jax.Array, GymnaxState, jax.Array, jax.Array, dict[str, jax.Array]]:
        """Take one step without beginning a new episode; return observation, state, reward, terminated and info."""
        observation, after, reward, terminated, info = self.greenhouse.step_env(key, state.greenhouse, action)
        return observation, GymnaxState(state.time + 1, after), reward, terminated, info

    def is_truncated(self, state: GymnaxState, params: GymnaxParams) -> jax.Array:
        """Whether the episode reached ``max_steps_in_episode`` before its season ended."""
        return jnp.logical_and(state.time >= params.max_steps_in_episode, ~state.greenhouse.ended)

    def is_terminated(self, state: GymnaxState, params: GymnaxParams | None = None) -> jax.Array:
        """Whether the season has ended, or a step could not be integrated."""
        return state.greenhouse.ended

    def observe(self, key: jax.Array, state: GymnaxState, action: jax.Array | None, params: GymnaxParams | None = None) -> jax.Array:
        """Not available: the compiled step gives the observation. Always raises ``GlbenchError``."""
        refuse("glbench computes observations in the compiled step. Use those that reset and step return.", GlbenchError)

    @staticmethod
    def _scenarios(params: GymnaxParams | None) -> Params | None:
        return None if params is None else Params(params.first, params.count)
