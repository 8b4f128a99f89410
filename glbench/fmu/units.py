"""Units in the notation of Modelica and FMI (``W.m-2``), with what they are in SI base units."""

from __future__ import annotations

from glbench.model.units import parse_unit

_ENERGY, _POWER, _PRESSURE = {"kg": 1, "m": 2, "s": -2}, {"kg": 1, "m": 2, "s": -3}, {"kg": 1, "m": -1, "s": -2}
_SYMBOLS: dict[str, tuple[float, dict[str, int]]] = {
    "kg": (1.0, {"kg": 1}), "g": (1e-3, {"kg": 1}), "mg": (1e-6, {"kg": 1}),
    "m": (1.0, {"m": 1}), "cm": (1e-2, {"m": 1}),
    "s": (1.0, {"s": 1}), "min": (60.0, {"s": 1}), "h": (3600.0, {"s": 1}), "day": (86400.0, {"s": 1}),
    "mol": (1.0, {"mol": 1}), "umol": (1e-6, {"mol": 1}),
    "K": (1.0, {"K": 1}), "°C": (1.0, {"K": 1}),
    "J": (1.0, _ENERGY), "MJ": (1e6, _ENERGY), "kWh": (3.6e6, _ENERGY), "W": (1.0, _POWER), "kW": (1e3, _POWER),
    "Pa": (1.0, _PRESSURE), "kPa": (1e3, _PRESSURE),
    "%": (1e-2, {}), "ppm": (1e-6, {}),
}  # fmt: skip
"""Factor to SI and exponents of the base units of each symbol; money is not among them."""
_ZERO_CELSIUS = 273.15


def fmi_unit(unit: str) -> str:
    """The name of ``unit`` in an FMU: ``mg.m-2.s-1`` for ``mg m-2 s-1``, ``degC`` for degrees Celsius; empty for none."""
    exponents = parse_unit(unit)
    return ".".join(
        ("degC" if symbol == "°C" else symbol) + ("" if exponent == 1 else f"{exponent:g}") for symbol, exponent in exponents.items()
    )


def base_unit(unit: str) -> dict[str, str] | None:
    """The attributes of FMI's ``BaseUnit``: exponents, factor, offset; ``None`` for a unit that SI does not have, such as EUR m-2."""
    exponents = parse_unit(unit)
    if not exponents.keys() <= _SYMBOLS.keys() or any(exponent % 1 for exponent in exponents.values()):
        return None
    factor, bases = 1.0, dict[str, int]()
    for symbol, exponent in exponents.items():
        scale, dimensions = _SYMBOLS[symbol]
        factor *= scale**exponent
        for base, power in dimensions.items():
            bases[base] = bases.get(base, 0) + int(exponent) * power
    attributes = {base: str(power) for base, power in bases.items() if power}
    if factor != 1.0:
        attributes["factor"] = f"{factor:.12g}"
    if exponents == {"°C": 1.0}:
        attributes["offset"] = str(_ZERO_CELSIUS)
    return attributes
