"""Seeds of episodes, and the generators that draw the next ones."""

from __future__ import annotations

from operator import index

import numpy as np
from numpy.typing import NDArray

from glbench.errors import GlbenchError

LARGEST_SEED = 2**64 - 1
DRAWN_BELOW = 2**63
"""Seeds that nobody gave are drawn below this number."""
GENERATOR_WORDS = 6


def checked_seed(seed: object) -> int:
    """``seed`` as a plain ``int``.

    Raises
    ------
    GlbenchError
        When it is not a whole number from 0 to 2**64 - 1.
    """
    try:
        number = -1 if isinstance(seed, bool) else index(seed)  # type: ignore[arg-type]  # raises for what is no integer
    except TypeError:
        number = -1
    if not 0 <= number <= LARGEST_SEED:
        msg = f"The seed {seed!r} is not a whole number from 0 to 2**64 - 1."
        raise GlbenchError(msg)
    return number


def draw_seed(generator: np.random.Generator) -> int:
    """The seed of an episode that was not given one."""
    return int(generator.integers(DRAWN_BELOW))


def no_generators() -> NDArray[np.uint64]:
    """What a snapshot holds where no environment draws seeds: ``(0, 6)``."""
    return np.empty((0, GENERATOR_WORDS), dtype=np.uint64)


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
