"""A model as a value: its variables with names and units, and its equations as functions of numbers.

Everything above this room takes a :class:`Model` and asks it for its states and their names, its starts, its flows and stocks,
and the columns that can be observed. :func:`glbench.model.compose` makes a greenhouse of submodels; anything else with states
and rates can be a model as well, as a subclass.

Models are frozen dataclasses: equal when their fields are, picklable, and usable as keys.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Literal, NamedTuple, TypeAlias

import casadi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from glbench.errors import ShapeError, UnknownNameError, did_you_mean, refuse
from glbench.model.air import Air
from glbench.model.bounds import Horizon
from glbench.model.digest import digest_of
from glbench.model.disturbances import Disturbances
from glbench.model.expressions import Expr, if_else, simplification
from glbench.model.parameter_checks import Order, Shares
from glbench.model.parameter_sets import ParameterValues
from glbench.model.parameter_table import ParameterInfo
from glbench.model.quantities import NamedQuantity, NamedVariable, states_of, table_of

Array: TypeAlias = NDArray[np.float64]
Symbolic: TypeAlias = Literal["SX", "MX"]
Record: TypeAlias = Any
"""A ``NamedTuple`` of expressions: what its fields are is known to the model that made it."""


class Evaluation(NamedTuple):
    """One evaluation of a model."""

    derivative: Record
    """Time derivative of the state [unit of the state per second], a record like the state."""
    fluxes: Record
    """Everything computed on the way: a record of records, one a process."""


class Step(NamedTuple):
    """A control step as flows see it: numbers of one run, arrays of many, or values recorded for the compiled kernel."""

    before: Record
    """State at the start of the step."""
    after: Record
    """State at its end."""
    controls: Record
    parameters: Record
    """Nominal values."""
    seconds: float
    """Length of the step [s]."""
    controls_before: Record = None
    """Controls of the step before, or those before the first: for what a change of controls brings, such as a start."""


@dataclass(frozen=True)
class Flow:
    """An amount per m2 of floor that is used, made or harvested in a control step: what a ledger can price.

    ``label`` is the heading in tables and plots, where ``counted`` follows it, such as "at full price". ``amount`` is that of a step, of
    numbers, arrays or CasADi's symbols: it is recorded for the kernel. It may use arithmetic, powers, comparisons, ``np.minimum``,
    ``np.maximum``, ``np.sign``, and ``exp``, ``sqrt`` and ``if_else`` of ``glbench.model.expressions``. ``potential`` is the amount at the
    rate that the parameters allow at best, where there is one: what a profit can be scaled by. ``total`` is the amount since the start,
    where a state meters it: a price can depend on it.
    """

    name: str
    unit: str
    meaning: str
    label: str
    amount: Callable[[Step], Expr]
    potential: Callable[[Step], Expr] | None = None
    total: Callable[[Record], Expr] | None = None
    counted: str = ""


@dataclass(frozen=True)
class Stock:
    """An amount per m2 of floor that stands in the greenhouse: what a ledger can value at the start and at the end.

    The ``amount`` is made from state and nominal parameters. It may use what that of a :class:`Flow` may, which also has the other fields.
    """

    name: str
    unit: str
    meaning: str
    label: str
    amount: Callable[[Record, Record], Expr]
    counted: str = ""


@dataclass(frozen=True)
class Capacity:
    """What the control ``name`` of the model is, and what it delivers at 1: the ``capacity`` of ``quantity``, as observations name it."""

    name: str
    quantity: str
    unit: str
    capacity: float
    meaning: str
    label: str = ""


@dataclass(frozen=True)
class ObservedColumn:
    """A column of an observation that the model supplies.

    ``source`` is the public name of a state, or ``air_temperature``, ``co2``, ``relative_humidity`` of the main air; ``factor`` leads from
    its unit to ``unit``. ``low`` and ``high`` are finite bounds. Three stand instead of a source, and may use what the amount of a
    :class:`Flow` may: ``of``, the column from state and nominal parameters; ``of_air``, the column from the main air as the task's sensors
    show it, errors included, which never sees the true state; and ``today``, a rate [``unit`` s-1] from controls, disturbances and nominal
    parameters in force, of which the column is the sum since midnight by the task's clock, or since the start.
    """

    name: str
    unit: str
    meaning: str
    source: str
    low: float
    high: float
    factor: float = 1.0
    of: Callable[[Record, Record], Expr] | None = None
    of_air: Callable[[Air], Expr] | None = None
    today: Callable[[Record, Record, Record], Expr] | None = None


@dataclass(frozen=True)
class Signal:
    """A series that the viewer and the report draw under a label: a state, a control or a disturbance times a factor.

    ``path`` is ``group/quantity``. Instead of ``source``, ``of`` gives the series from state and nominal parameters, and ``today`` a rate
    [``unit`` s-1] from controls, disturbances and nominal parameters, whose sum since midnight by the task's clock is drawn.
    """

    path: str
    label: str
    unit: str
    source: str
    factor: float = 1.0
    of: Callable[[Record, Record], Expr] | None = None
    today: Callable[[Record, Record, Record], Expr] | None = None


@dataclass(frozen=True)
class StepMap:
    """A control step that belongs to the model: Runge-Kutta steps of equal length, then every state is limited to its range.

    ``method`` is the classical method of fourth order (``rk4``), with ``parts`` steps. Controls, disturbances and parameters are held.
    ``low`` and ``high`` are the range of each state [unit of the state].
    """

    low: tuple[float, ...]
    high: tuple[float, ...]
    parts: int = 4
    method: Literal["rk4"] = "rk4"

    def digest(self, rates: str) -> str:
        """SHA-256 [hex] of the map, made of that of its ``rates``."""
        limits = (limit.hex() for limit in (*self.low, *self.high))
        return hashlib.sha256("\n".join((rates, self.method, str(self.parts), *limits)).encode("ascii")).hexdigest()


Start: TypeAlias = Callable[[Disturbances, float, Record], Record]
"""State at the start from the first row of the weather, the temperature of air and surfaces [°C] and the nominal parameters."""


class Model(ABC):
    """A model of a greenhouse, or of anything that weather and controls drive.

    A subclass is a frozen dataclass, so that equal models are one. It names itself, its records and its parameters, and gives the
    equations; the rest follows, or has a default that says "none".
    """

    State: type[Any]
    """Record of the states, annotated with ``Variable``."""
    Controls: type[Any]
    """Record of the controls, fractions of an installed capacity, annotated with ``Quantity``."""
    Disturbances: type[Any] = Disturbances
    """Record of the disturbances: the ten columns of the weather."""
    Parameters: type[Any]
    """Record of the parameters; ``table`` says the rest about them."""

    INPUTS: ClassVar[tuple[str, ...]] = ("x", "u", "d", "p")

    @property
    @abstractmethod
    def name(self) -> str:
        """Name without version, such as ``greenlight-tomato``."""

    @property
    @abstractmethod
    def version(self) -> str:
        """Version of the equations, such as ``1.0.0``. It changes when a result may change."""

    @property
    @abstractmethod
    def table(self) -> tuple[ParameterInfo, ...]:
        """The parameters in the order of the vector."""

    @abstractmethod
    def equations(self, x: Record, u: Record, d: Record, p: Record) -> Evaluation:
        """Evaluate the model for floats, NumPy arrays (one entry a row) or CasADi symbols."""

    # What a model may leave as it is.

    @property
    def variant(self) -> str:
        """Which reading of the equations, where there are several."""
        return "author"

    @property
    def step_map(self) -> StepMap | None:
        """The control step, where it is part of the model; None where a kernel integrates the rates as accurately as it is asked to."""
        return None

    @property
    def air(self) -> tuple[str, str, str] | None:
        """States of the main air: its temperature, CO2 and vapour, in the units that ``air_of`` takes; None without an air."""
        return None

    def air_of(self, temperature: Expr, co2: Expr, vapour: Expr) -> tuple[Expr, Expr, Expr]:
        """Temperature [°C], CO2 density [mg m-3] and vapour pressure [Pa] of the main air, from its states. They may use arithmetic."""
        return temperature, co2, vapour

    @property
    def singular(self) -> tuple[str, str] | None:
        """Two states whose difference the rates depend on like a root."""
        return None

    @property
    def crop_states(self) -> tuple[str, ...]:
        """Public names of the states of plants, which a record shows apart from the others."""
        return ()

    @property
    def shares(self) -> tuple[Shares, ...]:
        """Parameters whose sum cannot exceed 1."""
        return ()

    @property
    def orders(self) -> tuple[Order, ...]:
        """Parameters of which one must be below the other."""
        return ()

    def derived(self, p: Record) -> Record:
        """Parameters with every derived entry computed from the base entries."""
        return p

    def refuse(self, values: Mapping[str, float]) -> None:  # noqa: B027 -- most have nothing to refuse
        """Raise ParameterError for a complete set of values that contradict each other in another way than shares and orders."""

    def starts(self) -> Mapping[str, Start]:
        """States that an episode can start from, by the word in task files."""
        return {}

    def capacities(self, p: Mapping[str, float]) -> tuple[Capacity, ...]:
        """What each control delivers at 1, in the order of the controls."""
        return tuple(Capacity(c.name, c.attribute.removeprefix("u_"), c.unit, 1.0, c.meaning) for c in self.controls)

    def flows(self) -> tuple[Flow, ...]:
        """Amounts that a ledger can price."""
        return ()

    def stocks(self) -> tuple[Stock, ...]:
        """Amounts that stand in the greenhouse."""
        return ()

    def bounds(self, horizon: Horizon) -> Mapping[str, tuple[float, float]]:
        """Finite bounds of the states by public name, for whatever controls and weather; those that are missing have wide ones."""
        return {}

    def observed(self, module: str, horizon: Horizon) -> tuple[ObservedColumn, ...] | None:
        """Columns of the observation module of that name; None for one that this model does not have."""
        return None

    @property
    def observation_modules(self) -> Mapping[str, str]:
        """Names of the observation modules that ``observed`` knows, with a sentence each."""
        return {}

    def signals(self) -> tuple[Signal, ...]:
        """What the viewer draws of states and controls, in this order."""
        return ()

    # What follows.

    @property
    def id(self) -> str:
        """Name and version: ``greenlight-tomato-1.0.0``."""
        return f"{self.name}-{self.version}"

    @cached_property
    def states(self) -> tuple[NamedVariable, ...]:
        """The states, in the order of the vector."""
        return states_of(self.State)

    @cached_property
    def controls(self) -> tuple[NamedQuantity, ...]:
        """The controls, in the order of the vector."""
        return table_of(self.Controls)

    @cached_property
    def disturbances(self) -> tuple[NamedQuantity, ...]:
        """The disturbances, in the order of the vector."""
        return table_of(self.Disturbances)

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """Public names of the states."""
        return tuple(entry.name for entry in self.states)

    @cached_property
    def control_names(self) -> tuple[str, ...]:
        """Public names of the controls."""
        return tuple(entry.name for entry in self.controls)

    @cached_property
    def disturbance_names(self) -> tuple[str, ...]:
        """Public names of the disturbances."""
        return tuple(entry.name for entry in self.disturbances)

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """Public names of the parameters."""
        return tuple(entry.name for entry in self.table)

    @cached_property
    def names(self) -> Mapping[str, tuple[str, ...]]:
        """Names of the entries of each input vector."""
        vectors = (self.state_names, self.control_names, self.disturbance_names, self.parameter_names)
        return dict(zip(self.INPUTS, vectors, strict=True))

    @cached_property
    def sizes(self) -> Mapping[str, int]:
        """Lengths of the input vectors ``x``, ``u``, ``d``, ``p``."""
        return {key: len(names) for key, names in self.names.items()}

    @cached_property
    def parameters(self) -> ParameterValues:
        """Named sets of values, overrides, checks, derived entries."""
        return ParameterValues(self.table, self.Parameters, self.derived, self.shares, self.orders, self.refuse)

    @cached_property
    def auxiliaries(self) -> tuple[NamedQuantity, ...]:
        """Name, unit and meaning of every quantity computed on the way to the rates."""
        fluxes = _symbolic_model(self, "SX")[1].fluxes
        return tuple(entry for record in fluxes for entry in table_of(type(record)))

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the equations, and of the step where it is part of the model: 64 hexadecimal digits.

        It changes with any equation, with any bit of a constant and with the order of inputs and outputs. It does not change
        with names, with the order of evaluation or with the machine.
        """
        rates = digest_of(self.rhs_function())
        return rates if self.step_map is None else self.step_map.digest(rates)

    def state_index(self, name: str) -> int:
        """Place of a state in the vector. Raises ``UnknownNameError`` when there is none of that name; the message names the nearest."""
        try:
            return self.state_names.index(name)
        except ValueError:
            msg = f"{self.id} has no state '{name}'.{did_you_mean(name, self.state_names)}"
            raise UnknownNameError(msg) from None

    def start(self, kind: str, first: ArrayLike, air_temperature: float, p: ArrayLike) -> Array:
        """State ``(states,)`` at the start of an episode.

        ``kind`` is one of ``starts``, ``first`` the first row of the weather ``(disturbances,)``, ``air_temperature`` that of air and
        surfaces [°C], ``p`` the nominal parameters. Raises ``UnknownNameError`` when there is no such start, ``ShapeError`` when an input
        has another shape or is not finite.
        """
        starts = self.starts()
        if kind not in starts:
            refuse(f"{self.id} has no start '{kind}'.{did_you_mean(kind, starts)}", UnknownNameError)
        row = np.asarray(first, dtype=np.float64)
        if row.shape != (len(self.disturbances),) or not np.isfinite(row).all() or not np.isfinite(air_temperature):
            msg = (
                f"The initial state needs one finite row of {len(self.disturbances)} disturbances "
                f"({', '.join(self.disturbance_names)}) and a finite air temperature; "
                f"got shape {row.shape}, {row.tolist() if row.size <= 10 else '...'} and {air_temperature} °C."
            )
            raise ShapeError(msg)
        values = np.asarray(p, dtype=np.float64)
        if values.shape != (len(self.table),):
            refuse(f"The initial state needs {len(self.table)} nominal parameters; got shape {values.shape}.", ShapeError)
        state = starts[kind](self.Disturbances(*row.tolist()), float(air_temperature), self.Parameters(*values.tolist()))
        if len(state) != len(self.states):
            refuse(f"The start '{kind}' of {self.id} gives {len(state)} values for {len(self.states)} states.", ShapeError)
        start = np.array(state, dtype=np.float64)
        self._refuse_not_finite(start, f"The start '{kind}' of {self.id} gives")
        return start

    def check_rates(self, x: ArrayLike, d: ArrayLike, p: ArrayLike) -> None:
        """Raises ``ShapeError``, with model, state and value, when a rate is not finite in the state ``x`` with all controls at 0."""
        rates = self.rhs(x, np.zeros(len(self.controls)), d, p)
        self._refuse_not_finite(rates, f"At the start, with all controls at 0, the equations of {self.id} give as rate of")

    def _refuse_not_finite(self, values: Array, opening: str) -> None:
        for name, value in zip(self.state_names, values.tolist(), strict=True):
            if not np.isfinite(value):
                refuse(f"{opening} {name} = {value}, which is not a finite number.", ShapeError)

    def rhs_function(self, symbolic: Symbolic = "SX") -> casadi.Function:
        """CasADi function ``rhs`` of x, u, d, p that gives ``dxdt``, the time derivative of the state.

        ``symbolic`` is the kind of CasADi symbols inside: scalar ``SX`` (fast, for code generation) or matrix ``MX``.
        """
        return _rhs_function(self, symbolic)

    def step_function(self, seconds: float) -> casadi.Function:
        """CasADi function ``step`` of x, u, d, p that gives ``x_next``, the state after a control step of ``seconds`` [s].

        Raises ``ShapeError`` when the step is no part of the model (``step_map``).
        """
        if self.step_map is None:
            refuse(f"{self.id} has rates and no step of its own: glbench.kernel.Kernel integrates them.", ShapeError)
        return _step_function(self, self.step_map, seconds)

    def auxiliaries_function(self) -> casadi.Function:
        """CasADi function of x, u, d, p that gives all quantities of ``auxiliaries``, in that order, as one vector."""
        return _auxiliaries_function(self)

    def jacobian_function(self, wrt: str = "x") -> casadi.Function:
        """CasADi function of x, u, d, p: ``dxdt`` by one of the inputs, a dense matrix. Raises ``UnknownNameError`` for another ``wrt``."""
        if wrt not in self.INPUTS:
            refuse(f"The model has no input '{wrt}'.{did_you_mean(wrt, self.INPUTS)}", UnknownNameError)
        return _jacobian_function(self, wrt)

    def rhs(self, x: ArrayLike, u: ArrayLike, d: ArrayLike, p: ArrayLike) -> Array:
        """Time derivative of the state.

        State ``x``, controls ``u``, disturbances ``d`` and parameters ``p`` are in the order and units of ``states``, ``controls``,
        ``disturbances`` and ``table``. Each may have a leading batch axis; those without one apply to every row. Rows are independent, and
        has the same bits in any batch. Returns ``(states,)``, or ``(n, states)`` when any input has a batch axis; unit of the state per
        second. Raises ``ShapeError`` when an input has another shape, other batch sizes than the rest, or values that are not finite.
        """
        return evaluate_rows(self.names, self.rhs_function(), x, u, d, p)[..., 0]

    def auxiliary_values(self, x: ArrayLike, u: ArrayLike, d: ArrayLike, p: ArrayLike) -> dict[str, Array]:
        """Every quantity computed on the way to the time derivative, by its public name.

        For each entry of ``auxiliaries`` an array of shape () or (n,), in the unit given there. Inputs and errors are as for :meth:`rhs`.
        """
        values = evaluate_rows(self.names, self.auxiliaries_function(), x, u, d, p)[..., 0]
        return {entry.name: values[..., index] for index, entry in enumerate(self.auxiliaries)}

    def jacobian(self, x: ArrayLike, u: ArrayLike, d: ArrayLike, p: ArrayLike, wrt: str = "x") -> Array:
        """Derivative of the time derivative of the state to the input ``wrt``: ``"x"``, ``"u"``, ``"d"`` or ``"p"``.

        Its shape is ``(states, m)`` or ``(n, states, m)``, with m the length of that input. Inputs and errors are as for :meth:`rhs`.
        """
        return evaluate_rows(self.names, self.jacobian_function(wrt), x, u, d, p)

    def __getstate__(self) -> dict[str, Any]:
        """The fields: what follows from them is computed anew by who takes a copy."""
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]

    def __str__(self) -> str:
        return self.id


@lru_cache(maxsize=32)
@simplification(on=True)
def _symbolic_model(model: Model, symbolic: str) -> tuple[dict[str, Any], Evaluation]:
    kinds: dict[str, Callable[..., Any]] = {"SX": casadi.SX.sym, "MX": casadi.MX.sym}
    if symbolic not in kinds:
        refuse(f"There is no kind of CasADi symbols '{symbolic}'.{did_you_mean(symbolic, kinds)}", UnknownNameError)
    vectors = {name: kinds[symbolic](name, len(entries)) for name, entries in model.names.items()}
    x, u, d, p = (casadi.vertsplit(vector) for vector in vectors.values())
    records = model.State(*x), model.Controls(*u), model.Disturbances(*d), model.Parameters(*p)
    return vectors, model.equations(*records)


@lru_cache(maxsize=32)
@simplification(on=True)
def _rhs_function(model: Model, symbolic: Symbolic) -> casadi.Function:
    vectors, evaluation = _symbolic_model(model, symbolic)
    return _function("rhs", vectors, casadi.vertcat(*evaluation.derivative), "dxdt")


@lru_cache(maxsize=32)
@simplification(on=True)
def _step_function(model: Model, step: StepMap, seconds: float) -> casadi.Function:
    vectors, rate, length = _symbolic_model(model, "SX")[0], model.rhs_function(), seconds / step.parts
    x, *inputs = vectors.values()
    for _ in range(step.parts):
        first = rate(x, *inputs)
        second = rate(x + length / 2 * first, *inputs)
        third = rate(x + length / 2 * second, *inputs)
        last = rate(x + length * third, *inputs)
        x = x + length / 6 * (first + 2 * second + 2 * third + last)
    # Unlike a minimum of a maximum this keeps what is not a number, which is reported as a failure.
    limits = zip(casadi.vertsplit(x), step.low, step.high, strict=True)
    after = [if_else(state < low, low, if_else(state > high, high, state)) for state, low, high in limits]
    return _function("step", vectors, casadi.vertcat(*after), "x_next")


@lru_cache(maxsize=32)
@simplification(on=True)
def _auxiliaries_function(model: Model) -> casadi.Function:
    vectors, evaluation = _symbolic_model(model, "SX")
    return _function("auxiliaries", vectors, casadi.vertcat(*(v for record in evaluation.fluxes for v in record)), "aux")


@lru_cache(maxsize=32)
@simplification(on=True)
def _jacobian_function(model: Model, wrt: str) -> casadi.Function:
    vectors, evaluation = _symbolic_model(model, "SX")
    derivative = casadi.jacobian(casadi.vertcat(*evaluation.derivative), vectors[wrt])
    return _function(f"jacobian_{wrt}", vectors, derivative, "jacobian")


def _function(name: str, vectors: dict[str, Any], output: Any, output_name: str) -> casadi.Function:
    """CasADi function of the four inputs in which no expression occurs twice."""
    shared = casadi.cse(casadi.densify(output))
    return casadi.Function(name, list(vectors.values()), [shared], list(vectors), [output_name])


def evaluate_rows(names: Mapping[str, Sequence[str]], function: casadi.Function, *inputs: ArrayLike) -> Array:
    """Value of a function of x, u, d, p with one output matrix: shape (rows, columns), or (n, rows, columns) of a batch.

    ``names`` are ``Model.names``. A row has the same bits alone and in any batch. Raises ``ShapeError`` as ``Model.rhs`` does.
    """
    arrays = _checked(names, inputs)
    sizes = {array.shape[0] for array in arrays if array.ndim == 2}
    n = sizes.pop() if sizes else 1
    rows, columns = function.size_out(0)
    values = np.empty((n, columns, rows))  # CasADi stores matrices by columns
    if n:
        stacked = [np.ascontiguousarray(np.broadcast_to(array, (n, array.shape[-1]))) for array in arrays]
        buffer, evaluate = _over_rows(function, n).buffer()
        for index, array in enumerate(stacked):
            buffer.set_arg(index, array.data)  # type: ignore[call-arg]
        buffer.set_res(0, values.data)  # type: ignore[call-arg]
        evaluate()
    by_row = values.transpose(0, 2, 1)
    return by_row if any(array.ndim == 2 for array in arrays) else by_row[0]


@lru_cache(maxsize=64)
def _over_rows(function: casadi.Function, n: int) -> casadi.Function:
    """The function for n rows; kept, because making it takes longer than evaluating it."""
    return function.map(n)


def refuse_expression(what: str, value: object) -> None:
    """Raises ``ShapeError`` for a CasADi expression in place of numbers, and names the functions that take one."""
    if isinstance(value, casadi.SX | casadi.MX):
        msg = (
            f"{what} is a CasADi expression ({type(value).__name__}), and numbers are expected. For expressions call the model's CasADi "
            "functions, such as model.rhs_function()(x, u, d, p): see docs/casadi.md."
        )
        raise ShapeError(msg)


def _checked(names: Mapping[str, Sequence[str]], inputs: tuple[ArrayLike, ...]) -> list[Array]:
    """Inputs as arrays of floats, after a check of shape and finiteness."""
    arrays = []
    sizes: dict[str, int] = {}
    for (name, entries), value in zip(names.items(), inputs, strict=True):
        refuse_expression(f"Input {name}", value)
        try:
            array = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError) as error:
            refuse(f"Input {name} is not an array of numbers: {error}.", ShapeError, error)
        if array.ndim not in (1, 2) or array.shape[-1] != len(entries):
            refuse(f"Input {name} has shape {array.shape}; expected ({len(entries)},) or (n, {len(entries)}).", ShapeError)
        if not np.isfinite(array).all():
            *row, column = (int(index) for index in np.argwhere(~np.isfinite(array))[0])
            where = f" of row {row[0]}" if row else ""
            refuse(f"Input {name} is not finite: {entries[column]}{where} is {array[*row, column]}.", ShapeError)
        if array.ndim == 2:
            sizes[name] = array.shape[0]
        arrays.append(array)
    if len(set(sizes.values())) > 1:
        counts = ", ".join(f"{name} has {size}" for name, size in sizes.items())
        refuse(f"The inputs have different numbers of rows: {counts}. Give each the same number, or no batch axis.", ShapeError)
    return arrays
