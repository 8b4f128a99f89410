"""What both kinds of environment have from Gymnasium: spaces, options of ``reset``, seeds and the generators that draw them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from operator import index
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from glbench.env.actuation import action_bounds
from glbench.env.snapshot import Snapshot
from glbench.errors import GlbenchError, ShapeError, did_you_mean, refuse
from glbench.tasks import Normalisation, TaskSpec, get_task
from glbench.tasks.record import PREVIEW

if TYPE_CHECKING:
    from gymnasium.envs.registration import EnvSpec

Vectors: TypeAlias = "spaces.Space[NDArray[np.float32]]"
"""A ``Box`` of float32 (Gymnasium's annotations do not say which numbers a box holds)."""

STATE = "state"
"""Option of ``reset``: a snapshot to continue from."""
RESET_MASK = "reset_mask"
"""Option of a vector environment's ``reset``: the rows to reset."""

LARGEST_SEED = 2**64 - 1
DRAWN_BELOW = 2**63
"""Seeds that the caller leaves out are drawn below this number."""
GENERATOR_WORDS = 6


def the_task(task: TaskSpec | str) -> TaskSpec:
    """A task from itself, its id, or the path of its file."""
    return task if isinstance(task, TaskSpec) else get_task(task)


def task_of_environment(task: TaskSpec | str, split: str | None = None, overrides: Mapping[str, Any] | None = None) -> TaskSpec:
    """The task with what ``overrides`` changes, in ``split``; where none is named, for training.

    A task with only a test split gives previews (``TaskSpec.in_split``) unless ``split`` is ``"test"``.

    Raises ``TaskError`` when there is no such split, none is named and all years are real and scored, or the overrides make no task.
    """
    spec = the_task(task)
    if overrides is not None:
        spec = spec.replace(overrides)
    if split is None and spec.preview is not None:
        split = PREVIEW
    if split is not None:
        return spec.in_split(split)
    spec.check_training()
    return spec


def observation_space(task: TaskSpec, normalisation: Normalisation | None = None) -> Vectors:
    """Observed columns of a task with their finite bounds, float32, as ``normalisation`` shows them."""
    columns = task.observed()
    bounds = [np.array([getattr(column, side) for column in columns], np.float32) for side in ("low", "high")]
    low, high = bounds if normalisation is None else map(normalisation, bounds)
    return cast("Vectors", spaces.Box(low, high, dtype=np.float32))


def action_space(task: TaskSpec) -> Vectors:
    """Actions of a task with the bounds of its card, float32."""
    low, high = action_bounds(task)
    return cast("Vectors", spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32))


class WithHorizon:
    """An environment whose registered spec has the steps of an episode of its task.

    Gymnasium's wrappers read the horizon there. The registry leaves it out: ``make`` would add a ``TimeLimit``, which reports the end of a
    season as truncated as well, and cuts seasons that ``overrides`` makes longer.
    """

    task: TaskSpec
    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:  # Gymnasium declares an attribute, which ``make`` sets
        """The registered spec with the horizon of the task as ``max_episode_steps``; ``None`` without ``make`` or ``make_vec``."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = None if spec is None else replace(spec, max_episode_steps=self.task.steps)


def check_names(options: Mapping[str, Any] | None, names: tuple[str, ...]) -> Mapping[str, Any]:
    """``options``, none as an empty mapping. Raises ``GlbenchError`` for an option that is not among ``names``."""
    options = options or {}
    for name in options:
        if name not in names:
            refuse(f"reset has no option called '{name}'.{did_you_mean(name, names)}", GlbenchError)
    return options


def state_option(options: Mapping[str, Any], seed: object) -> Snapshot | None:
    """The snapshot to continue from, if any. Raises ``GlbenchError`` when it is none, or a seed or another option comes with it."""
    snapshot = options.get(STATE)
    if snapshot is None:
        return None
    if not isinstance(snapshot, Snapshot):
        refuse(f"The option 'state' is a {type(snapshot).__name__}; expected what snapshot() or Snapshot.from_bytes gave.", GlbenchError)
    if seed is not None or options.get(RESET_MASK) is not None:
        refuse("A snapshot brings its own seeds and rows: call reset with the option 'state' and nothing else.", GlbenchError)
    return snapshot


def mask_option(options: Mapping[str, Any], n: int) -> NDArray[np.bool_]:
    """The rows to reset, ``(n,)``; all without the option. Raises ``ShapeError`` when the mask has another shape or type, or no row."""
    mask = options.get(RESET_MASK)
    if mask is None:
        return np.ones(n, dtype=np.bool_)
    if not isinstance(mask, np.ndarray) or mask.shape != (n,) or mask.dtype != np.bool_ or not mask.any():
        refuse(f"The option 'reset_mask' must be an array of {n} booleans, at least one of them true; it is {mask!r}.", ShapeError)
    return mask


def checked_seed(seed: object) -> int:
    """``seed`` as a plain ``int``. Raises ``GlbenchError`` when it is not a whole number from 0 to 2**64 - 1."""
    try:
        number = -1 if isinstance(seed, bool) else index(seed)  # type: ignore[arg-type]  # raises if it is no integer
    except TypeError:
        number = -1
    if not 0 <= number <= LARGEST_SEED:
        refuse(f"The seed {seed!r} is not a whole number from 0 to 2**64 - 1.", GlbenchError)
    return number


def draw_seed(generator: np.random.Generator) -> int:
    """A random seed for an episode."""
    return int(generator.integers(DRAWN_BELOW))


def pack_generator(generator: np.random.Generator) -> NDArray[np.uint64]:
    """State of a PCG64 generator (the kind Gymnasium makes) as six words."""
    state = generator.bit_generator.state
    inner = state["state"]
    words = [*_halves(inner["state"]), *_halves(inner["inc"]), int(state["has_uint32"]), int(state["uinteger"])]
    return np.array(words, dtype=np.uint64)


def unpack_generator(words: NDArray[np.uint64]) -> np.random.Generator:
    """The generator that ``pack_generator`` read."""
    state_high, state_low, increment_high, increment_low, has_uint32, uinteger = (int(word) for word in words)
    bits = np.random.PCG64()
    bits.state = {
        "bit_generator": "PCG64",
        "state": {"state": state_high << 64 | state_low, "inc": increment_high << 64 | increment_low},
        "has_uint32": has_uint32,
        "uinteger": uinteger,
    }
    return np.random.Generator(bits)


def _halves(number: int) -> tuple[int, int]:
    return number >> 64, number & 0xFFFFFFFFFFFFFFFF
