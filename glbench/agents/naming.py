"""Which names of agents, recipes and authors could be mistaken for each other. Needs the standard library alone."""

from __future__ import annotations

import re
import unicodedata

_SEED = re.compile(r"(?<=.)[\W_]*s[e3][e3]d[\W_]*[0-9]{1,10}$", re.IGNORECASE)
_SEED_IN_SKELETON = re.compile(r"(?<=.)seed[0-9oleastb]*$")
_LOOKALIKES = str.maketrans(
    "\u0430\u0432\u0441\u0501\u0435\u043d\u04bb\u0456\u0458\u043a\u04cf\u043c\u043e\u0440\u051b\u0455\u0442\u0443\u04af\u0475\u051d\u0445"
    "\u03b1\u03b2\u03b5\u03b7\u03b9\u03ba\u03bd\u03bf\u03c1\u03c4\u03c5\u03c7\u03b3\u03c9\u03bc\u0131\u0142\u00f8\u0111\u0127\u0261\u0251\u0585\u057d\u0570",
    "abcdehhijklmopqstyyvwxabenikvoptuxywuilodhgaouh",
)
"""Letters of Cyrillic, Greek, Armenian and extended Latin to those of Latin that they look like."""
_DIGITS = str.maketrans("0134578i", "oleastbl")
"""Digits, and the i, to the letters that they stand for in place of: p0licy1 is policyl, and so is policyi."""


def skeleton(name: str) -> str:
    """Letters of a name without what readers overlook: capitals, accents, punctuation, digits and foreign letters that look alike."""
    letters = unicodedata.normalize("NFKD", unicodedata.normalize("NFKC", name).casefold()).translate(_LOOKALIKES)
    plain = "".join(letter for letter in letters if letter.isalnum())
    return plain.translate(_DIGITS).replace("rn", "m").replace("vv", "w")


def without_seed(name: str) -> str:
    """The name of the recipe of which ``NAME_seed3`` or ``NAME-seed3`` is a training; other names as they are."""
    return _SEED.sub("", name)


def skeletons(name: str) -> frozenset[str]:
    """Skeletons of a name and of what is left without the seeds of trainings at its end, also those in letters or with more after them.

    Names that share one look alike.
    """
    rest = skeleton(name)
    found = {rest}
    while (shorter := _SEED_IN_SKELETON.sub("", rest)) != rest:
        rest = shorter
        found.add(rest)
    return frozenset(found)
