"""A model with meters on its climate: how far the air was outside limits, added up over time.

The end of a control step says little of the step: air can leave its limits and come back within it. The meters are states
whose rates are the distances below and above the limits, so that the difference of a meter over a step, divided by the step's
length, is the time mean of the distance. The limits are parameters, so that one compiled kernel serves the limits of every task.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from operator import attrgetter
from types import MappingProxyType
from typing import Annotated, Any, Literal

from glbench.errors import GlbenchError, refuse
from glbench.model.air import co2_ppm, relative_humidity
from glbench.model.disturbances import Disturbances
from glbench.model.expressions import Expr, fmax
from glbench.model.greenhouse import record_of, typed_record
from glbench.model.model import Evaluation, Model, Record, Start
from glbench.model.parameter_table import BENCHMARK, ParameterInfo
from glbench.model.quantities import Variable, public_name
from glbench.quantities import AIR, pretty_unit

Side = Literal["low", "high"]
SIDES: tuple[Side, ...] = ("low", "high")

NO_LIMIT = 1e9
"""Limit that is never reached: minus this for a low one, this for a high one, in the unit of the quantity."""

_WEIGHTLESS = 2.0**100
"""Size of the meters as the integrators take it: so large that no error of theirs shortens a substep."""

_UNITS = {name: pretty_unit(entry.unit) for name, entry in AIR.items()}
_WORDS = {"air_temperature": "temperature", "co2": "CO2", "relative_humidity": "relative humidity"}
_SIDES: Mapping[Side, tuple[str, str]] = {"low": ("lowest", "below"), "high": ("highest", "above")}
_PLACES: tuple[tuple[str, Side], ...] = tuple((name, side) for name in _UNITS for side in SIDES)


def limit_parameter(name: str, side: Side) -> str:
    """Public name of the parameter that holds a limit: ``lowestAirTemperature`` for ``air_temperature`` and ``low``."""
    return public_name(f"{_SIDES[side][0]}_{name}")


def violation_meter(name: str, side: Side) -> str:
    """Public name of the state that adds up the violations of that limit: ``belowAirTemperature`` [°C s]."""
    return public_name(f"{_SIDES[side][1]}_{name}")


def _limit(name: str, side: Side) -> ParameterInfo:
    attribute = f"{_SIDES[side][0]}_{name}"
    return ParameterInfo(
        name=public_name(attribute),
        attribute=attribute,
        unit=_UNITS[name],
        meaning=f"{_SIDES[side][0]} {_WORDS[name]} of the main air that is no violation",
        source="[constraints] of the task",
        group="limits",
        check="any",
        formula="",
        used="yes",
        drawn_in=frozenset(),
        values=MappingProxyType({BENCHMARK: -NO_LIMIT if side == "low" else NO_LIMIT}),
    )


_LIMITS = tuple(_limit(name, side) for name, side in _PLACES)
_METERS = typed_record(
    "Violations",
    {
        f"{_SIDES[side][1]}_{name}": Annotated[
            Any,
            Variable(
                f"{_UNITS[name]} s",
                f"{_WORDS[name]} of the main air {_SIDES[side][1]} its limit, added up over time",
                scale=_WEIGHTLESS,
                small=_WEIGHTLESS,
            ),
        ]
        for name, side in _PLACES
    },
)


def _of_base(member: str) -> Any:
    """A member that is that of the model without meters."""
    return property(attrgetter(f"base.{member}"))


@dataclass(frozen=True)
class WithViolationMeters(Model):
    """The model ``base`` with six more states and six more parameters, after its own; made by :func:`with_violation_meters`.

    Nothing depends on the meters and no error of theirs counts, so the other states take the course that they take without them. The
    meters are no :class:`~glbench.model.Addition`: those are parts of a composed greenhouse, and their states precede its clock.
    """

    base: Model

    version = _of_base("version")
    variant = _of_base("variant")
    Controls = _of_base("Controls")
    Disturbances = _of_base("Disturbances")
    air = _of_base("air")
    air_of = _of_base("air_of")
    singular = _of_base("singular")
    crop_states = _of_base("crop_states")
    shares = _of_base("shares")
    orders = _of_base("orders")
    observation_modules = _of_base("observation_modules")
    refuse = _of_base("refuse")
    capacities = _of_base("capacities")
    flows = _of_base("flows")
    stocks = _of_base("stocks")
    bounds = _of_base("bounds")
    observed = _of_base("observed")
    signals = _of_base("signals")

    @property
    def name(self) -> str:
        return f"{self.base.name}-judged"

    @cached_property
    def State(self) -> type[Any]:  # type: ignore[override]  # noqa: N802 -- a class
        return record_of("State", (self.base.State, _METERS))

    @cached_property
    def Parameters(self) -> type[Any]:  # type: ignore[override]  # noqa: N802 -- a class
        return namedtuple("Parameters", [info.attribute for info in self.table])

    @property
    def table(self) -> tuple[ParameterInfo, ...]:
        return (*self.base.table, *_LIMITS)

    def equations(self, x: Record, u: Record, d: Record, p: Record) -> Evaluation:
        """Evaluate the model, and the distances of its main air from the limits; relative humidity is not cut off at 100 %."""
        evaluation = self.base.equations(self.base.State(*x[: len(self.base.states)]), u, d, self._own(p))
        temperature, density, pressure = self.base.air_of(*(x[self.base.state_index(name)] for name in self.base.air or ()))
        air = {
            "air_temperature": temperature,
            "co2": co2_ppm(temperature, density),
            "relative_humidity": relative_humidity(temperature, pressure),
        }
        limits = dict(zip(_PLACES, p[len(self.base.table) :], strict=True))
        outside = (_distance(air[name], limits[name, side], side) for name, side in _PLACES)
        return Evaluation(self.State(*evaluation.derivative, *outside), evaluation.fluxes)

    def derived(self, p: Record) -> Record:
        return self.Parameters(*self.base.derived(self._own(p)), *p[len(self.base.table) :])

    def starts(self) -> Mapping[str, Start]:
        return {word: self._start(start) for word, start in self.base.starts().items()}

    def _start(self, start: Start) -> Start:
        def with_meters(d: Disturbances, air_temperature: float, p: Record) -> Record:
            return self.State(*start(d, air_temperature, self._own(p)), *(0.0 for _ in _PLACES))

        return with_meters

    def _own(self, p: Record) -> Record:
        """The parameters of the model without meters."""
        return self.base.Parameters(*p[: len(self.base.table)])


def _distance(value: Expr, limit: Expr, side: Side) -> Expr:
    return fmax(0.0, limit - value if side == "low" else value - limit)


def with_violation_meters(model: Model) -> WithViolationMeters:
    """The same model with meters on how far air temperature [°C s], CO2 [ppm s] and relative humidity [% s] are outside limits.

    The limits are parameters (``limit_parameter``) with values that are never reached, the meters states (``violation_meter``), both after
    those of ``model``. Raises ``GlbenchError`` when the model has no air or a step of its own, or a name like a meter's or a limit's.
    """
    return model if isinstance(model, WithViolationMeters) else _with_violation_meters(model)


@lru_cache(maxsize=64)
def _with_violation_meters(model: Model) -> WithViolationMeters:
    if model.air is None:
        refuse(f"{model.id} has no air whose climate could be judged: its `air` is None. Name its states there.", GlbenchError)
    if model.step_map is not None:
        msg = 'has a step of its own, so the air within a step is not known: judge the end of each step (judged = "end").'
        refuse(f"{model.id} {msg}", GlbenchError)
    metered = WithViolationMeters(model)
    states = (model.state_names, [violation_meter(*place) for place in _PLACES])
    parameters = (model.parameter_names, [info.name for info in _LIMITS])
    for kind, (own, added) in {"state": states, "parameter": parameters}.items():
        for name in added:
            if name in own:
                msg = f"{model.id} has a {kind} called '{name}', as the meters of its violations have. Give it another name."
                raise GlbenchError(msg)
    return metered
