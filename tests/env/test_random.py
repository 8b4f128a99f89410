"""The counter-based generator: known answers, addresses, uniformity."""

from __future__ import annotations

import numpy as np
import pytest

from glbench.env.random import key_of, philox4x32, uniforms

# Random123 1.14, tests/kat_vectors, lines "philox4x32 10": counter, key, answer.
KNOWN_ANSWERS = [
    ("00000000 00000000 00000000 00000000", "00000000 00000000", "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
    ("ffffffff ffffffff ffffffff ffffffff", "ffffffff ffffffff", "408f276d 41c83b0e a20bc7c6 6d5451fd"),
    ("243f6a88 85a308d3 13198a2e 03707344", "a4093822 299f31d0", "d16cfe09 94fdcceb 5001e420 24126ea1"),
]


def words(text: str) -> np.ndarray:
    return np.array([int(word, 16) for word in text.split()], dtype=np.uint64)


@pytest.mark.parametrize(("counter", "key", "answer"), KNOWN_ANSWERS)
def test_it_gives_the_answers_of_random123(counter: str, key: str, answer: str) -> None:
    assert (philox4x32(words(counter), words(key)) == words(answer)).all()


def test_many_counters_at_once_give_the_answers_of_one() -> None:
    counters = np.stack([words(c) for c, _, _ in KNOWN_ANSWERS], axis=1)
    keys = np.stack([words(k) for _, k, _ in KNOWN_ANSWERS], axis=1)
    answers = np.stack([words(a) for _, _, a in KNOWN_ANSWERS], axis=1)
    assert (philox4x32(counters, keys) == answers).all()


def test_one_key_serves_many_counters() -> None:
    counters = np.stack([words(c) for c, _, _ in KNOWN_ANSWERS], axis=1).reshape(4, 3, 1)
    answers = philox4x32(counters, words(KNOWN_ANSWERS[2][1]))
    assert answers.shape == (4, 3, 1)
    assert (answers[:, 2, 0] == words(KNOWN_ANSWERS[2][2])).all()


def test_a_uniform_is_made_of_27_bits_of_one_word_and_26_of_the_next() -> None:
    a, b, c, d = (int(word, 16) for word in KNOWN_ANSWERS[0][2].split())
    drawn = uniforms(np.zeros((1, 2), np.uint64), np.zeros((1, 1), np.int64), 2)
    by_hand = [((a >> 5) * 2**26 + (b >> 6)) / 2**53, ((c >> 5) * 2**26 + (d >> 6)) / 2**53]
    assert drawn[0, 0].tolist() == by_hand


def test_the_largest_words_stay_below_one() -> None:
    assert ((2**27 - 1) * 67108864.0 + (2**26 - 1)) * 2.0**-53 < 1.0


def test_a_draw_depends_on_its_address_alone() -> None:
    keys = np.array([key_of("a"), key_of("b"), key_of("c")], dtype=np.uint64)
    steps = np.arange(20, dtype=np.int64)[None, :].repeat(3, axis=0)
    together = uniforms(keys, steps, 28)
    for row in range(3):
        for step in (0, 7, 19):
            alone = uniforms(keys[row : row + 1], np.array([[step]], np.int64), 28)
            assert (alone[0, 0] == together[row, step]).all()
    # Asking for fewer numbers gives the first of them.
    assert (uniforms(keys, steps, 5) == together[:, :, :5]).all()


def test_rows_steps_and_positions_are_all_different() -> None:
    keys = np.array([key_of(str(i)) for i in range(10)], dtype=np.uint64)
    drawn = uniforms(keys, np.arange(50, dtype=np.int64)[None, :].repeat(10, axis=0), 28)
    assert np.unique(drawn).size == drawn.size


def test_a_hundred_thousand_draws_look_uniform() -> None:
    keys = np.array([key_of("uniform?")], dtype=np.uint64)
    drawn = uniforms(keys, np.arange(3600, dtype=np.int64)[None, :], 28).ravel()
    expected = drawn.size / 20
    chi_square = ((np.histogram(drawn, bins=20, range=(0.0, 1.0))[0] - expected) ** 2 / expected).sum()
    assert 0.0 <= drawn.min() < drawn.max() < 1.0
    assert chi_square < 43.8  # 99.9 % of the chi-square distribution with 19 degrees of freedom
    assert abs(np.corrcoef(drawn[:-1], drawn[1:])[0, 1]) < 0.01


def test_a_key_is_the_start_of_a_sha256() -> None:
    # SHA-256 of "abc" starts with ba7816bf 8f01cfea (FIPS 180-2, appendix B.1).
    assert key_of("abc") == (0xBA7816BF, 0x8F01CFEA)
