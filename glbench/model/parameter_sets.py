"""Named sets of parameters, overrides on them, and the checks that both pass.

A set is a column of parameters.csv. The benchmark's set stands alone; the author's houses refine it. A part of a set
(another lamp, another cultivar) is a mapping of names to values, given as overrides.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from glbench.errors import ParameterError, UnknownNameError, did_you_mean
from glbench.model.derived import recompute_derived
from glbench.model.parameter_checks import check_together, check_value
from glbench.model.parameter_table import BENCHMARK, PARAMETER_NAMES, PARAMETERS, ParameterInfo
from glbench.model.units import same_unit

Given: TypeAlias = float | str | tuple[float, str]
"""An override: a number in the table's unit, ``"116 W m-2"``, or ``(116, "W m-2")``."""

DERIVED_TOLERANCE = 1e-9
"""Relative difference up to which a given derived entry counts as consistent with its formula."""


@dataclass(frozen=True)
class ParameterSet:
    """A named set: a complete greenhouse with its lamps and its crop."""

    name: str
    description: str


PARAMETER_SETS: Mapping[str, ParameterSet] = MappingProxyType(
    {
        entry.name: entry
        for entry in (
            ParameterSet(BENCHMARK, "The benchmark's greenhouse: 144 m2 compartment with LED lamps, no fruit harvest."),
            ParameterSet("hps_2020", "Compartment with high-pressure sodium lamps, Katzin et al. (2020)."),
            ParameterSet("led_2020", "The same compartment with LED lamps, Katzin et al. (2020)."),
            ParameterSet("hps_2021", "Modern 4 ha greenhouse with high-pressure sodium lamps, Katzin (2021)."),
            ParameterSet("led_2021", "Modern 4 ha greenhouse with LED lamps, Katzin (2021)."),
        )
    }
)
"""Every named set. Where the author's houses have no value of their own (minWind, t25k, ...), the benchmark's holds."""


def default_parameters(set_name: str = BENCHMARK, overrides: Mapping[str, Given] | None = None) -> NDArray[np.float64]:
    """Parameter vector of a named set, with overrides and with the derived entries computed from the base entries.

    Parameters
    ----------
    set_name
        One of ``PARAMETER_SETS``.
    overrides
        Values by parameter name. A value may state its unit, ``"116 W m-2"`` or ``(116, "W m-2")``; the unit is then
        compared with the table's. A derived entry (``capAir``, ``cLeafMax``, ...) may be given only when it agrees with
        its formula.

    Returns
    -------
    ndarray
        Shape (208,), in the order of ``PARAMETERS``; a new array at every call.

    Raises
    ------
    UnknownNameError
        When there is no such set or parameter; the message names the nearest.
    ParameterError
        When a value is impossible, has the wrong unit, or contradicts the formula of a derived entry.
    """
    _require_set(set_name)
    given = {name: _number(_info(name), value) for name, value in (overrides or {}).items()}
    base = {info.name: _own_value(info, set_name) for info in PARAMETERS}
    vector = recompute_derived(list((base | given).values()))
    _check_derived(given, vector)
    check_together(PARAMETERS, vector.tolist(), [name for name, value in given.items() if value != base[name]])
    return vector


def parameter_group(group: str, set_name: str = BENCHMARK) -> dict[str, float]:
    """Base entries of one part of a named set, to be used as overrides on another set.

    ``default_parameters("benchmark", parameter_group("lamps", "hps_2020"))`` is the benchmark with other lamps.

    Parameters
    ----------
    group
        A part of the greenhouse: ``"lamps"``, ``"crop"``, ``"house"``, ``"roof"``, ``"thermal_screen"``, ... (field
        ``group`` of ``PARAMETERS``).
    set_name
        One of ``PARAMETER_SETS``.

    Raises
    ------
    UnknownNameError
        When there is no such group or set.
    """
    _require_set(set_name)
    members = {
        info.name: _own_value(info, set_name) for info in PARAMETERS if info.group == group and not info.is_derived
    }
    if not members:
        groups = dict.fromkeys(info.group for info in PARAMETERS)
        msg = f"There is no group of parameters '{group}'.{did_you_mean(group, groups)}"
        raise UnknownNameError(msg)
    return members


def crop_parameter_set(name: str) -> tuple[str, ...]:
    """Names of the crop parameters that are uncertain, in the order of the vector.

    ``crop28`` is the recommended reading of the benchmark's 28 parameters; ``crop34`` is what the published code
    perturbs, including conversions, molar masses, a reference temperature and the derived ``cLeafMax``. After a draw from
    either, ``cLeafMax`` must be computed anew (``recompute_derived``).

    Raises
    ------
    UnknownNameError
        When there is no such set.
    """
    sets = {
        "crop28": tuple(info.name for info in PARAMETERS if info.in_crop28),
        "crop34": tuple(info.name for info in PARAMETERS if info.in_crop34),
    }
    if name not in sets:
        msg = f"There is no set of crop parameters '{name}'.{did_you_mean(name, sets)}"
        raise UnknownNameError(msg)
    return sets[name]


def _own_value(info: ParameterInfo, set_name: str) -> float:
    """Value of a base entry in a set; not a number for a derived entry, which is computed later."""
    return info.values.get(set_name, info.values.get(BENCHMARK, math.nan))


def _require_set(name: str) -> None:
    if name not in PARAMETER_SETS:
        msg = f"There is no parameter set '{name}'.{did_you_mean(name, PARAMETER_SETS)}"
        raise UnknownNameError(msg)


def _info(name: str) -> ParameterInfo:
    if name not in PARAMETER_NAMES:
        msg = f"The model has no parameter '{name}'.{did_you_mean(name, PARAMETER_NAMES)}"
        raise UnknownNameError(msg)
    return PARAMETERS[PARAMETER_NAMES.index(name)]


def _number(info: ParameterInfo, given: Given) -> float:
    """Value of an override in the table's unit."""
    value, unit = _split(info, given)
    if unit is not None and not same_unit(unit, info.unit):
        msg = f"Parameter {info.name} ({info.meaning}) is in {info.unit}, not in '{unit}'. Convert the value first."
        raise ParameterError(msg)
    check_value(info, value)
    return value


def _split(info: ParameterInfo, given: Given) -> tuple[float, str | None]:
    """Number and unit of an override, the unit None when not stated."""
    number: object = given
    unit: str | None = None
    if isinstance(given, tuple) and len(given) == 2:
        number, unit = given
    elif isinstance(given, str):
        number, _, rest = given.strip().partition(" ")
        unit = rest.strip() or None
    # A truth value is an integer to Python, but no measurement.
    if isinstance(number, int | float | str | np.number) and not isinstance(number, bool):
        with contextlib.suppress(TypeError, ValueError):
            return float(number), unit
    msg = (
        f"Parameter {info.name} cannot be {given!r}: "
        f"give a number in its unit ({info.unit}), or a text such as '{info.values.get(BENCHMARK, 1):g} {info.unit}'."
    )
    raise ParameterError(msg)


def _check_derived(given: Mapping[str, float], vector: NDArray[np.float64]) -> None:
    """Refuse a derived entry that contradicts the base entries."""
    for name, value in given.items():
        info = _info(name)
        computed = float(vector[PARAMETER_NAMES.index(name)])
        if info.is_derived and not math.isclose(value, computed, rel_tol=DERIVED_TOLERANCE):
            bases = [
                word for word in dict.fromkeys(re.findall(r"[A-Za-z]\w*", info.formula)) if word in PARAMETER_NAMES
            ]
            msg = (
                f"Parameter {name} cannot be {value:g} {info.unit}: it follows from others, "
                f"{name} = {info.formula}, which gives {computed:g} {info.unit}. "
                f"Change {' or '.join(bases)} instead."
            )
            raise ParameterError(msg)
