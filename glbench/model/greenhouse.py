"""Greenhouse models composed of submodels, and meters that add up fluxes."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import chain
from keyword import iskeyword
from typing import Annotated, Any, get_type_hints

from glbench.errors import GlbenchError, did_you_mean, refuse
from glbench.model.balances import DAY
from glbench.model.bounds import Horizon
from glbench.model.disturbances import Disturbances
from glbench.model.expressions import Expr
from glbench.model.model import Capacity, Evaluation, Flow, Model, ObservedColumn, Record, Signal, Start, Step, Stock
from glbench.model.parameter_checks import Order, Shares
from glbench.model.parameter_table import ParameterInfo
from glbench.model.quantities import Variable, public_name, states_of, table_of
from glbench.model.states import Clock
from glbench.model.submodels import Addition, Around, Climate, Crop, Submodel
from glbench.model.units import parse_unit


@dataclass(frozen=True)
class Meter:
    """A state that adds up a flux, so that what flows within a control step is known exactly.

    ``flux`` is its name in the equations, such as ``mc_fruit_har``: the meter is the state ``sum_mc_fruit_har``. ``flow`` is the name of
    the flow that a ledger can price, such as ``fruit_harvested``. ``unit``, ``meaning`` and ``label`` are of the amount of a step; ``unit``
    is that of the flux without ``s-1`` (``J m-2`` for ``W m-2``), and no other. ``scale`` and ``small`` are as for ``Variable``.
    """

    flux: str
    flow: str
    unit: str
    meaning: str
    label: str
    scale: float = 1e5
    small: float = 100.0

    @property
    def attribute(self) -> str:
        """Name of the state in the equations."""
        return f"sum_{self.flux}"

    def amount(self, step: Step) -> Expr:
        """What flowed in a step."""
        return self.total(step.after) - self.total(step.before)

    def total(self, states: Record) -> Expr:
        """What has flowed since the start."""
        return getattr(states, self.attribute)


@dataclass(frozen=True)
class Greenhouse(Model):
    """A greenhouse with its crop; made by :func:`compose`. The states are those of climate, crop, additions and meters, and a clock."""

    climate: Climate
    crop: Crop
    additions: tuple[Addition, ...] = ()
    meters: tuple[Meter, ...] = ()
    stated_version: str = "1.0.0"
    stated_name: str = ""

    @property
    def name(self) -> str:
        return self.stated_name or "-".join(part.name for part in self.parts)

    @property
    def version(self) -> str:
        return self.stated_version

    @property
    def variant(self) -> str:
        return self.climate.variant_name

    @cached_property
    def parts(self) -> tuple[Submodel, ...]:
        """The submodels."""
        return (self.climate, self.crop, *self.additions)

    @cached_property
    def State(self) -> type[Any]:  # type: ignore[override]  # noqa: N802 -- a class
        return record_of("State", (*(part.State for part in self.parts), self._metered, Clock))

    @cached_property
    def Controls(self) -> type[Any]:  # type: ignore[override]  # noqa: N802 -- a class
        return record_of("Controls", tuple(part.Controls for part in self.parts))

    @cached_property
    def Parameters(self) -> type[Any]:  # type: ignore[override]  # noqa: N802 -- a class
        return namedtuple("Parameters", [info.attribute for info in self.table])

    @cached_property
    def table(self) -> tuple[ParameterInfo, ...]:
        rows = [*self.climate.table]
        after = self.crop.parameters_after
        place = len(rows) if after is None else 1 + [info.name for info in rows].index(after)
        rows[place:place] = self.crop.table
        return tuple(chain(rows, *(part.table for part in self.additions)))

    @property
    def air(self) -> tuple[str, str, str]:
        return self.climate.air

    @property
    def singular(self) -> tuple[str, str] | None:
        return self.climate.singular

    @property
    def crop_states(self) -> tuple[str, ...]:
        return (*((self.climate.canopy,) if self.climate.canopy else ()), *(state.name for state in states_of(self.crop.State)))

    @property
    def shares(self) -> tuple[Shares, ...]:
        return tuple(chain.from_iterable(part.shares for part in self.parts))

    @property
    def orders(self) -> tuple[Order, ...]:
        return tuple(chain.from_iterable(part.orders for part in self.parts))

    def equations(self, x: Record, u: Record, d: Record, p: Record) -> Evaluation:
        """Evaluate the model. Units and signs are in docs/nomenclature.md. Source: Katzin (2021) on top of Vanthoor (2011)."""
        climate, crop = self.climate, self.crop
        (x_climate, x_crop, *x_added), (p_climate, p_crop, *p_added) = self._states_of(x), self._parameters_of(p)
        added = tuple(zip(self.additions, x_added, p_added, strict=True))
        lai = crop.leaf_area_index(x_crop, p_crop)
        climate_controls = climate.Controls(*u[: len(climate.Controls._fields)])
        act = climate.actuators(climate_controls, p_climate)
        for part, own, values in added:
            act = part.supply(act, own, u, values)
        around = climate.processes(lai, act, x_climate, climate_controls, d, p_climate)
        own_controls = crop.Controls(*u[len(climate_controls) : len(climate_controls) + len(crop.Controls._fields)])
        surroundings = climate.surroundings(lai, x_climate, around, p_climate)._replace(u=own_controls)
        grown = crop.processes(x_crop, surroundings, p_crop)
        everything = Around(around, grown, surroundings, u, d)
        others = [part.processes(own, everything, values) for part, own, values in added]
        names = (*around._fields, *grown._fields, *(part.name for part in self.additions))
        records = (*around, *grown, *others)
        home = _homes(names, tuple(type(record) for record in records), self.meters)
        of_climate = climate.State(*_values(climate, "rates", climate.rates(x_climate, around, grown.crop, p_climate)))
        for (part, own, values), fluxes in zip(added, others, strict=True):
            extraction = part.exchange(own, everything, fluxes, values)
            if extraction is not None:
                of_climate = climate.without(of_climate, around, extraction, p_climate)
        rates = [
            *of_climate,
            *_values(crop, "rates", crop.rates(x_crop, surroundings, grown, p_crop)),
            *chain.from_iterable(
                _values(part, "rates", part.rates(own, everything, fluxes, values))
                for (part, own, values), fluxes in zip(added, others, strict=True)
            ),
        ]
        metered = [getattr(records[home[meter.flux]], meter.flux) for meter in self.meters]
        return Evaluation(self.State(*rates, *metered, 1 / DAY), namedtuple("Fluxes", names)(*records))

    def derived(self, p: Record) -> Record:
        changed: dict[str, Any] = {}
        for part, own in zip(self.parts, self._parameters_of(p), strict=True):
            changed |= part.derived(own)._asdict()
        return p._replace(**changed)

    def refuse(self, values: Mapping[str, float]) -> None:
        for part in self.parts:
            part.refuse(values)

    def starts(self) -> Mapping[str, Start]:
        return {word: self._start(word) for word in self.crop.starts()}

    def _start(self, word: str) -> Start:
        def start(d: Disturbances, air_temperature: float, p: Record) -> Record:
            p_climate, p_crop, *p_added = self._parameters_of(p)
            added = (_values(part, "start", part.start(d, air_temperature, own)) for part, own in zip(self.additions, p_added, strict=True))
            return self.State(
                *_values(self.climate, "start", self.climate.start(d, air_temperature, p_climate)),
                *_values(self.crop, "starts", self.crop.starts()[word](air_temperature, p_crop)),
                *chain.from_iterable(added),
                *(0.0 for _ in self.meters),
                0.0,
            )

        return start

    def capacities(self, p: Mapping[str, float]) -> tuple[Capacity, ...]:
        capacities = {capacity.name: capacity for capacity in super().capacities(p)}
        for part in self.parts:
            for capacity in part.capacities(p):
                if capacity.name not in capacities:
                    msg = (
                        f"`capacities` of {part.name} speaks of a control '{capacity.name}', which {self.id} does not have."
                        f"{did_you_mean(capacity.name, capacities)}"
                    )
                    raise GlbenchError(msg)
                capacities[capacity.name] = capacity
        _once("capacity", ((one.name, [one.quantity]) for one in capacities.values()))
        return tuple(capacities.values())

    def flows(self) -> tuple[Flow, ...]:
        metered = (Flow(m.flow, m.unit, m.meaning, m.label, m.amount, total=m.total) for m in self.meters)
        return (*chain.from_iterable(part.flows() for part in self.parts), *metered)

    def stocks(self) -> tuple[Stock, ...]:
        return tuple(chain.from_iterable(part.stocks() for part in self.parts))

    def signals(self) -> tuple[Signal, ...]:
        """Those of the parts; one of a path that an earlier part has takes its place."""
        return tuple({signal.path: signal for part in self.parts for signal in part.signals()}.values())

    def bounds(self, horizon: Horizon) -> Mapping[str, tuple[float, float]]:
        bounds: dict[str, tuple[float, float]] = {"time": (0.0, horizon.days * (1.0 + 1e-6))}
        for part in self.parts:
            bounds |= part.bounds(horizon)
        return bounds

    @property
    def observation_modules(self) -> Mapping[str, str]:
        modules: dict[str, str] = {}
        for part in self.parts:
            modules |= part.observation_modules
        return modules

    def observed(self, module: str, horizon: Horizon) -> tuple[ObservedColumn, ...] | None:
        for part in self.parts:
            columns = part.observed(module, horizon)
            if columns is not None:
                return columns
        return None

    @cached_property
    def _metered(self) -> type[Any]:
        notes = {m.attribute: Variable(m.unit, m.meaning, scale=m.scale, small=m.small) for m in self.meters}
        return typed_record("Metered", {attribute: Annotated[Any, note] for attribute, note in notes.items()})

    def _states_of(self, x: Record) -> Iterator[Record]:
        """The state of each submodel."""
        place = 0
        for part in self.parts:
            count = len(part.State._fields)
            yield part.State(*x[place : place + count])
            place += count

    def _parameters_of(self, p: Record) -> Iterator[Record]:
        """The parameters of each submodel."""
        for part in self.parts:
            yield part.Parameters(*(getattr(p, attribute) for attribute in part.Parameters._fields))

    def __reduce__(self) -> tuple[Any, ...]:
        """Made anew from its submodels: the records of a composed model exist in this process only."""
        return _composed, (self.climate, self.crop, self.additions, self.meters, self.stated_version, self.stated_name)


def compose(
    climate: Climate, crop: Crop, *additions: Addition, meters: tuple[Meter, ...] = (), version: str = "1.0.0", name: str = ""
) -> Greenhouse:
    """A greenhouse model of these submodels.

    Additions may read all fluxes, and stand between the actuators and the climate. ``meters`` are fluxes that are added up over each
    control step, to be priced by a ledger. ``version`` is that of the whole: it changes when a result may change. ``name`` is by default
    those of the submodels, joined by hyphens. Equal arguments give the same greenhouse.

    Raises ``GlbenchError`` when two submodels have one name, or states, controls, parameters, flows or stocks of one name.
    """
    return _composed(climate, crop, additions, meters, version, name)


@lru_cache(maxsize=64)
def _composed(
    climate: Climate, crop: Crop, additions: tuple[Addition, ...], meters: tuple[Meter, ...], version: str, name: str
) -> Greenhouse:
    model = Greenhouse(climate, crop, additions, meters, version, name)
    _check_part_names(model.parts)
    metered = [(f"the meter of '{meter.flux}'", meter) for meter in meters]
    for kind in ("State", "Controls", "Parameters"):
        owned = [(part.name, [public_name(field) for field in getattr(part, kind)._fields]) for part in model.parts]
        if kind == "State":
            owned += [(owner, [public_name(meter.attribute)]) for owner, meter in metered]
            owned.append(("the clock", [public_name(field) for field in Clock._fields]))
        _once(kind.lower().removesuffix("s"), owned)
    flows = [(part.name, [flow.name for flow in part.flows()]) for part in model.parts]
    _once("flow", [*flows, *((owner, [meter.flow]) for owner, meter in metered)])
    _once("stock", [(part.name, [stock.name for stock in part.stocks()]) for part in model.parts])
    return model


def _check_part_names(parts: tuple[Submodel, ...]) -> None:
    names: set[str] = set()
    for part in parts:
        name = getattr(part, "name", None)
        if not isinstance(name, str) or not name:
            refuse(f'{type(part).__name__} has no name. Give its class a line such as `name: ClassVar[str] = "water"`.', GlbenchError)
        if isinstance(part, Addition) and (not name.isidentifier() or iskeyword(name) or name.startswith("_")):
            msg = f"An addition is called '{name}', which cannot be the name of a field. Use letters, digits and underscores."
            raise GlbenchError(msg)
        if name in names:
            refuse(f"Two parts of the model are called '{name}'. Give one of them another name.", GlbenchError)
        names.add(name)


def _once(kind: str, owned: Iterable[tuple[str, Iterable[str]]]) -> dict[str, str]:
    """Who has each name; refuses a name that two have, or one has twice."""
    owners: dict[str, str] = {}
    for owner, names in owned:
        for name in names:
            if name in owners:
                who = f"{owner} has twice" if owners[name] == owner else f"{owner} and {owners[name]} both have"
                msg = f"{who} a {kind} called '{name}'. Give one of them another name."
                raise GlbenchError(msg[:1].upper() + msg[1:] if owner.startswith("the ") else msg)
            owners[name] = owner
    return owners


def _values(part: Submodel, method: str, values: Any) -> tuple[Expr, ...]:
    """What a method returned for the states of a part, in their order."""
    fields = part.State._fields
    names = ", ".join(public_name(field) for field in fields)
    if fields and getattr(type(part), method, None) is getattr(Addition, method, None):
        msg = f"{part.name} has states ({names}) and no method `{method}`. Write one that returns {part.State.__name__}(...)."
        raise GlbenchError(msg)
    if not isinstance(values, tuple) or len(values) != len(fields) or getattr(values, "_fields", fields) != fields:
        got = f"{type(values).__name__} of {len(values)} values" if isinstance(values, tuple) else repr(values)
        expected = f"{part.State.__name__} of {len(fields)}" + (f" ({names})" if fields else "")
        refuse(f"`{method}` of {part.name} returns {got}; expected {expected}.", GlbenchError)
    return values


@lru_cache(maxsize=64)
def _homes(names: tuple[str, ...], records: tuple[type[Any], ...], meters: tuple[Meter, ...]) -> Mapping[str, int]:
    """Place of the record that has each flux, after a check of names and of the meters' units."""
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        refuse(f"Two records of fluxes are called '{twice}'. Give one of the parts, or of the processes, another name.", GlbenchError)
    for name, record in zip(names, records, strict=True):
        if not hasattr(record, "_fields"):
            msg = (
                f"The fluxes of a crop are a record of records, and those of an addition one record; '{name}' is a bare value. "
                "Put it into a NamedTuple."
            )
            raise GlbenchError(msg)
    owners = _once("flux", zip(names, (record._fields for record in records), strict=True))
    units = {entry.attribute: entry.unit for record in records for entry in table_of(record)}
    for flux, owner in owners.items():
        if flux not in units:
            msg = f"The flux '{flux}' of {owner} has no unit. Annotate it: {flux}: Annotated[Expr, Quantity(unit, meaning)]."
            raise GlbenchError(msg)
    for meter in meters:
        if meter.flux not in owners:
            msg = f"No process has a flux '{meter.flux}' that a meter could add up.{did_you_mean(meter.flux, owners, list_few=False)}"
            raise GlbenchError(msg)
        expected = _in_seconds(f"{units[meter.flux]} s")
        if _in_seconds(meter.unit) != expected:
            text = " ".join(symbol if power == 1 else f"{symbol}{power:g}" for symbol, power in expected.items()) or "-"
            msg = (
                f"The meter of '{meter.flux}' is in {meter.unit}, but adds up {units[meter.flux]} over seconds: its unit is {text}. "
                "A ledger line turns it into another with `amount`, `unit` and `factor`."
            )
            raise GlbenchError(msg)
    return {flux: names.index(owner) for flux, owner in owners.items()}


def _in_seconds(unit: str) -> dict[str, float]:
    """Exponents of a unit, with watts as joules per second."""
    exponents = parse_unit(unit)
    watts = exponents.pop("W", 0.0)
    for symbol, power in (("J", watts), ("s", -watts)):
        exponents[symbol] = exponents.get(symbol, 0.0) + power
    return {symbol: power for symbol, power in exponents.items() if power}


def record_of(name: str, records: tuple[type[Any], ...]) -> type[Any]:
    """A record with the annotated fields of several, in their order."""
    fields: dict[str, Any] = {}
    for record in records:
        fields |= get_type_hints(record, include_extras=True)
    return typed_record(name, fields)


def typed_record(name: str, fields: Mapping[str, Any]) -> type[Any]:
    """A record of these annotated fields."""
    make: Any = namedtuple  # the fields are known at run time only
    record: type[Any] = make(name, list(fields))
    record.__annotations__ = dict(fields)
    return record
