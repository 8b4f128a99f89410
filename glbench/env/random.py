"""Random numbers that are a function of an address (the counter-based generator Philox4x32-10, vectorised), and AR(1) processes.

An ordinary generator remembers how often it was asked; the value that a run receives then depends on what else was drawn
before it. A counter-based generator has no memory. It turns a key (whose stream) and a counter (which draw) into four words
of 32 random bits, so that any draw can be had at any time, in any order, in any batch, with the same bits.

Source: Salmon, Moraes, Dror and Shaw (2011), "Parallel random numbers: as easy as 1, 2, 3", SC'11, doi 10.1145/2063384.2063405.
Tested against the known-answer vectors of the Random123 library.
"""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Words = NDArray[np.uint64]
"""Unsigned 32-bit words, each in 64 bits so that products of two of them do not overflow."""

ROUNDS = 10
UNIFORMS_PER_BLOCK = 2
UNIFORMS_PER_NORMAL = 3
"""Uniform numbers that an approximately normal number is made of."""

_MULTIPLIERS = np.array([0xD2511F53, 0xCD9E8D57], dtype=np.uint64)
_WEYL = np.array([0x9E3779B9, 0xBB67AE85], dtype=np.uint64)
_MASK = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)


def philox4x32(counter: ArrayLike, key: ArrayLike) -> Words:
    """Four random 32-bit words for each counter under its key.

    ``counter`` has four words, ``(4, ...)``, ``key`` two, ``(2, ...)``, whose trailing axes are broadcast against those of ``counter``.
    Returns ``(4, ...)``, uint64, each value below 2**32.
    """
    words = np.asarray(counter, dtype=np.uint64)
    round_key = np.asarray(key, dtype=np.uint64)
    shape = np.broadcast_shapes(words.shape[1:], round_key.shape[1:])
    axes = (1,) * len(shape)
    round_key = round_key.reshape(2, *(1,) * (len(shape) - round_key.ndim + 1), *round_key.shape[1:])
    multipliers, weyl = _MULTIPLIERS.reshape(2, *axes), _WEYL.reshape(2, *axes)

    # Words 0 and 2 are multiplied, words 1 and 3 are mixed in: both pairs go through a round as one array.
    multiplied = np.empty((2, *shape), dtype=np.uint64)
    mixed = np.empty((2, *shape), dtype=np.uint64)
    multiplied[:] = words[0::2]
    mixed[:] = words[1::2]
    product = np.empty_like(multiplied)
    high = np.empty_like(multiplied)
    for number in range(ROUNDS):
        if number:
            round_key = (round_key + weyl) & _MASK
        np.multiply(multiplied, multipliers, out=product)
        np.right_shift(product, _HALF, out=high)
        # The high halves change places, are mixed with the other pair and the key, and are multiplied next.
        np.bitwise_xor(high[::-1], mixed, out=multiplied)
        np.bitwise_xor(multiplied, round_key, out=multiplied)
        np.bitwise_and(product[::-1], _MASK, out=mixed)
    return np.stack([multiplied[0], mixed[0], multiplied[1], mixed[1]])


def key_of(label: str) -> tuple[int, int]:
    """Key of the stream that belongs to ``label``: the first 64 bits of the SHA-256 of its UTF-8 text, as two words."""
    digest = hashlib.sha256(label.encode("utf-8")).digest()
    return int.from_bytes(digest[:4], "big"), int.from_bytes(digest[4:8], "big")


def uniforms(keys: Words, steps: NDArray[np.int64], count: int) -> NDArray[np.float64]:
    """Uniform numbers in [0, 1) with 53 random bits, addressed by key, step and position.

    ``keys`` has one key a row, ``(n, 2)``, and ``steps`` says which draws of each row, ``(n, m)``: counter word 0, not negative and below
    2**32. Of the ``count`` numbers of a draw 2b and 2b + 1 come from counter word 1 = b; words 2 and 3 stay 0. Returns ``(n, m, count)``.
    """
    blocks = -(-count // UNIFORMS_PER_BLOCK)
    n, m = steps.shape
    counter = np.zeros((4, n, m, blocks), dtype=np.uint64)
    counter[0] = steps[:, :, None]
    counter[1] = np.arange(blocks, dtype=np.uint64)
    words = philox4x32(counter, keys.T[:, :, None, None])
    # 27 bits of one word and 26 of the next make the 53 bits of a double's mantissa.
    leading = (words[0::2] >> np.uint64(5)).astype(np.float64)
    trailing = (words[1::2] >> np.uint64(6)).astype(np.float64)
    numbers = (leading * 67108864.0 + trailing) * 2.0**-53
    return np.moveaxis(numbers, 0, -1).reshape(n, m, blocks * UNIFORMS_PER_BLOCK)[:, :, :count]


def approx_normal(a: Any, b: Any, c: Any) -> Any:
    """A number with mean 0 and standard deviation 1 from three uniform ones: nearly normal, and never beyond 3.

    Their sum has mean 3/2 and variance 3/12. Only additions and a product: the same bits everywhere, in tapes as well.
    """
    return (a + b + c - 1.5) * 2.0


def ar1_paths(key: NDArray[np.uint64], length: int, persistence: NDArray[np.float64]) -> NDArray[np.float64]:
    """Paths a(t) = phi a(t - 1) + sqrt(1 - phi**2) w(t), with w approximately normal and a(0) = w(0); mean 0 and standard deviation 1.

    ``key`` is that of the stream of random numbers, ``(1, 2)``, ``persistence`` phi of each path ``(paths,)``. Returns ``(length, paths)``.
    """
    count = len(persistence)
    numbers = uniforms(key, np.arange(length, dtype=np.int64)[None], UNIFORMS_PER_NORMAL * count)[0]
    a, b, c = numbers.reshape(length, count, UNIFORMS_PER_NORMAL).transpose(2, 0, 1)
    shocks = approx_normal(a, b, c)
    paths = np.empty((length, count))
    for path in range(count):
        phi = float(persistence[path])
        fresh = float(np.sqrt(1.0 - phi * phi))
        value = float(shocks[0, path])
        values = [value]
        for shock in shocks[1:, path].tolist():
            value = phi * value + fresh * shock
            values.append(value)
        paths[:, path] = values
    return paths
