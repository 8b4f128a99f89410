"""Named sets of parameters, overrides on them, and the checks that both pass.

A set is a column of a table of parameters. The benchmark's set stands alone; the author's houses refine it. A part of a set
(another lamp, another cultivar) is a mapping of names to values, given as overrides.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glbench.errors import ParameterError, ShapeError, UnknownNameError, did_you_mean, refuse
from glbench.model.parameter_checks import Order, Shares, check_together, check_value
from glbench.model.parameter_table import BENCHMARK, DRAWN_SETS, ParameterInfo
from glbench.model.units import same_unit

Override: TypeAlias = float | str | tuple[float, str]
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
            ParameterSet("bleiswijk_2020", "Compartment with both lamps, fitted to a measured season in Bleiswijk (docs/realism.md)."),
        )
    }
)
"""Every named set. Where the author's houses have no value of their own (minWind, t25k, ...), the benchmark's holds."""


@dataclass(frozen=True, eq=False)
class ParameterValues:
    """The values that the parameters of a model can have.

    ``table`` has the parameters in the order of the vector, ``record`` their record, as the equations name them. ``formulas`` completes a
    record: every derived entry computed from the base entries. ``shares``, ``orders`` and ``refuse`` are what must hold between them.
    """

    table: tuple[ParameterInfo, ...]
    record: type[Any]
    formulas: Callable[[Any], Any]
    shares: tuple[Shares, ...]
    orders: tuple[Order, ...]
    refuse: Callable[[Mapping[str, float]], None]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Public names, in the order of the vector."""
        return tuple(info.name for info in self.table)

    def default(self, set_name: str = BENCHMARK, overrides: Mapping[str, Override] | None = None) -> NDArray[np.float64]:
        """Parameter vector of a named set, with overrides and with the derived entries computed from the base entries.

        Raises ``UnknownNameError`` when there is no such set or parameter, with the nearest name, and ``ParameterError`` when a
        value is impossible, has the wrong unit, or contradicts the formula of a derived entry.

        ``set_name`` is one of ``PARAMETER_SETS``. A value of ``overrides`` may state its unit, ``"116 W m-2"`` or ``(116, "W m-2")``; the
        unit is then compared with the table's. A derived entry (``capAir``, ``cLeafMax``, ...) may be given only when it agrees with its
        formula. Returns ``(parameters,)``, in the order of the table; a new array at every call.
        """
        _require_set(set_name)
        values = {name: _number(self.info(name), value) for name, value in (overrides or {}).items()}
        base = {info.name: _own_value(info, set_name) for info in self.table}
        vector = self.complete(list((base | values).values()))
        self._check_derived(values, vector)
        changed = [name for name, value in values.items() if value != base[name]]
        check_together(self.table, vector.tolist(), changed, self.shares, self.orders)
        self.refuse(dict(zip(self.names, vector.tolist(), strict=True)))
        return vector

    def group(self, group: str, set_name: str = BENCHMARK) -> dict[str, float]:
        """Base entries of one part of a named set, to be used as overrides on another set.

        ``group`` is a part of the greenhouse: ``"lamps"``, ``"crop"``, ``"house"``, ``"roof"``, ``"thermal_screen"``, ... (field ``group``
        of the table); ``set_name`` one of ``PARAMETER_SETS``. ``values.default("benchmark", values.group("lamps", "hps_2020"))`` is the
        benchmark with other lamps. Raises ``UnknownNameError`` when there is no such group or set.
        """
        _require_set(set_name)
        members = {info.name: _own_value(info, set_name) for info in self.table if info.group == group and not info.is_derived}
        if not members:
            groups = dict.fromkeys(info.group for info in self.table)
            refuse(f"There is no group of parameters '{group}'.{did_you_mean(group, groups)}", UnknownNameError)
        return members

    def drawn_set(self, name: str) -> tuple[str, ...]:
        """Names of the parameters of a set of uncertain ones, in the order of the vector.

        ``crop28`` is the recommended reading of the benchmark's 28 parameters; ``crop34`` is what the published code perturbs, including
        conversions, molar masses, a reference temperature and the derived ``cLeafMax``. After a draw from either, ``cLeafMax`` must be
        computed anew (``complete``). Raises ``UnknownNameError`` when there is no such set.
        """
        sets = {entry: tuple(info.name for info in self.table if entry in info.drawn_in) for entry in DRAWN_SETS}
        sets = {entry: members for entry, members in sets.items() if members}
        if name not in sets:
            refuse(f"There is no set of crop parameters '{name}'.{did_you_mean(name, sets)}", UnknownNameError)
        return sets[name]

    def complete(self, parameters: ArrayLike) -> NDArray[np.float64]:
        """Copy of parameter vectors ``(parameters,)`` or ``(n, parameters)`` with the derived entries computed from the base entries.

        Raises ``ShapeError`` when the last axis has another length.
        """
        p = np.asarray(parameters, dtype=np.float64)
        if p.ndim == 0 or p.shape[-1] != len(self.table):
            refuse(f"Parameters have shape {p.shape}; expected ({len(self.table)},) or (n, {len(self.table)}).", ShapeError)
        return np.stack(self.formulas(self.record(*np.moveaxis(p, -1, 0))), axis=-1)

    def info(self, name: str) -> ParameterInfo:
        """Row of the table. Raises ``UnknownNameError`` when there is no such parameter; the message names the nearest."""
        if name not in self.names:
            refuse(f"The model has no parameter '{name}'.{did_you_mean(name, self.names)}", UnknownNameError)
        return self.table[self.names.index(name)]

    def _check_derived(self, values: Mapping[str, float], vector: NDArray[np.float64]) -> None:
        """Refuse a derived entry that contradicts the base entries."""
        for name, value in values.items():
            info = self.info(name)
            computed = float(vector[self.names.index(name)])
            if info.is_derived and not math.isclose(value, computed, rel_tol=DERIVED_TOLERANCE):
                bases = [word for word in dict.fromkeys(re.findall(r"[A-Za-z]\w*", info.formula)) if word in self.names]
                msg = (
                    f"Parameter {name} cannot be {value:g} {info.unit}: it follows from others, "
                    f"{name} = {info.formula}, which gives {computed:g} {info.unit}. "
                    f"Change {' or '.join(bases)} instead."
                )
                raise ParameterError(msg)


def _own_value(info: ParameterInfo, set_name: str) -> float:
    """Value of a base entry in a set; not a number for a derived entry, which is computed later."""
    return info.values.get(set_name, info.values.get(BENCHMARK, math.nan))


def _require_set(name: str) -> None:
    if name not in PARAMETER_SETS:
        refuse(f"There is no parameter set '{name}'.{did_you_mean(name, PARAMETER_SETS)}", UnknownNameError)


def _number(info: ParameterInfo, override: Override) -> float:
    """Value of an override in the table's unit."""
    value, unit = _split(info, override)
    if unit is not None and not same_unit(unit, info.unit):
        refuse(f"Parameter {info.name} ({info.meaning}) is in {info.unit}, not in '{unit}'. Convert the value first.", ParameterError)
    check_value(info, value)
    return value


def _split(info: ParameterInfo, override: Override) -> tuple[float, str | None]:
    """Number and unit of an override, the unit None when not stated."""
    number: object = override
    unit: str | None = None
    if isinstance(override, tuple) and len(override) == 2:
        number, unit = override
    elif isinstance(override, str):
        number, _, rest = override.strip().partition(" ")
        unit = rest.strip() or None
    # A truth value is an integer to Python, but no measurement.
    if isinstance(number, int | float | str | np.number) and not isinstance(number, bool):
        with contextlib.suppress(TypeError, ValueError):
            return float(number), unit
    msg = (
        f"Parameter {info.name} cannot be {override!r}: "
        f"give a number in its unit ({info.unit}), or a text such as '{info.values.get(BENCHMARK, 1):g} {info.unit}'."
    )
    raise ParameterError(msg)
