"""Units as written in the tables, compared by meaning: ``W/m2`` is ``W m-2``, ``m²`` is ``m2``."""

from __future__ import annotations

import re

_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_SPELLINGS = {"degC": "°C", "℃": "°C", "deg": "°", "µmol": "umol", "μmol": "umol", "days": "day", "d": "day"}
_FACTOR = re.compile(r"(?P<divided>/?)\s*(?P<symbol>[^\s\d/*·^()+-]+)\^?(?P<exponent>[+-]?\d+(?:\.\d+)?)?")
_NO_UNIT = frozenset({"", "-", "1", "–"})


def parse_unit(text: str) -> dict[str, float]:
    """Exponent of every symbol in a unit, as ``{"W": 1, "m": -2}``; empty for a plain number. A ``/`` applies to the symbol after it."""
    plain = text.translate(_SUPERSCRIPTS).strip()
    if plain in _NO_UNIT:
        return {}
    exponents: dict[str, float] = {}
    for factor in _FACTOR.finditer(plain):
        symbol = _SPELLINGS.get(factor["symbol"], factor["symbol"])
        exponent = float(factor["exponent"] or 1)
        exponents[symbol] = exponents.get(symbol, 0) + (-exponent if factor["divided"] else exponent)
    return {symbol: exponent for symbol, exponent in exponents.items() if exponent}


def same_unit(one: str, other: str) -> bool:
    """Whether two texts mean the same unit. Nothing is converted: ``kW`` is not ``W``."""
    return parse_unit(one) == parse_unit(other)
