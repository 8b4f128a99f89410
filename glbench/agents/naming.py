"""Names of agents, recipes and authors that could be mistaken for each other. It imports the standard library alone: CI runs it so."""

from __future__ import annotations

import re
import unicodedata

_SEED = re.compile(r"(?<=.)[\W_]*s[e3][e3]d[\W_]*[0-9]{1,10}$", re.IGNORECASE)
_SEED_IN_SKELETON = re.compile(r"(?<=.)seed[0-9oleastbzg]*$")
_DOUBLED = re.compile(r"([^\W\d_e])\1+")  # A letter more than once in a row; not the e, so that ``seed`` stays a word of its own
_LOOKALIKES = str.maketrans(
    "\u0430\u0432\u0441\u0501\u0435\u043d\u04bb\u0456\u0458\u043a\u04cf\u043c\u043e\u0440\u051b\u0455\u0442\u0443\u04af\u0475\u051d\u0445"
    "\u03b1\u03b2\u03b5\u03b7\u03b9\u03ba\u03bd\u03bf\u03c1\u03c4\u03c5\u03c7\u03b3\u03c9\u03bc\u0131\u0142\u00f8\u0111\u0127\u0261\u0251\u0585\u057d\u0570",
    "abcdehhijklmopqstyyvwxabenikvoptuxywuilodhgaouh",
)
"""Cyrillic, Greek, Armenian and extended Latin letters, and the Latin letters that they look like."""
_DIGITS = str.maketrans("0123456789i", "olzeasbtbgl")
"""Digits and the letter i, and the letters that they can replace: p0licy1 and policyi become policyl."""


def skeleton(name: str) -> str:
    """A name reduced to what readers notice: without capitals, accents, punctuation and doubled letters, with look-alikes replaced."""
    letters = unicodedata.normalize("NFKD", unicodedata.normalize("NFKC", name).casefold()).translate(_LOOKALIKES)
    plain = "".join(letter for letter in letters if letter.isalnum())
    plain = plain.replace("rn", "m").replace("vv", "w").replace("cl", "d").replace("c1", "d")
    return _DOUBLED.sub(r"\1", plain).translate(_DIGITS)


def without_seed(name: str) -> str:
    """``NAME`` for ``NAME_seed3`` or ``NAME-seed3``; other names unchanged."""
    return _SEED.sub("", name)


def skeletons(name: str) -> frozenset[str]:
    """Skeletons of a name with and without seed endings, also those in letters: names that share a skeleton look alike."""
    rest = skeleton(name)
    forms = {rest}
    while (shorter := _SEED_IN_SKELETON.sub("", rest)) != rest:
        rest = shorter
        forms.add(rest)
    return frozenset(forms)
