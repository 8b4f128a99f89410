"""The model as functions of numbers: one point or a batch of rows, evaluated by CasADi.

Inputs are x (28), u (6), d (10) and p (208), each with or without a leading batch axis; rows are independent, and a row
gives the same bits alone and in any batch.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, lru_cache
from typing import Any, Literal, TypeAlias, get_type_hints

import casadi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from glbench.errors import ShapeError, UnknownNameError, did_you_mean
from glbench.model.balances import Fluxes
from glbench.model.controls import CONTROL_NAMES, Controls
from glbench.model.disturbances import DISTURBANCE_NAMES, Disturbances
from glbench.model.greenlight import GreenLight, greenlight
from glbench.model.parameter_table import PARAMETER_NAMES
from glbench.model.parameters import Parameters
from glbench.model.quantities import NamedQuantity, table_of
from glbench.model.states import STATE_NAMES, State
from glbench.model.variants import get_variant

Array: TypeAlias = NDArray[np.float64]
Symbolic: TypeAlias = Literal["SX", "MX"]

INPUTS: dict[str, tuple[str, ...]] = {
    "x": STATE_NAMES,
    "u": CONTROL_NAMES,
    "d": DISTURBANCE_NAMES,
    "p": PARAMETER_NAMES,
}
"""Names of the entries of each input vector."""

AUXILIARIES: tuple[NamedQuantity, ...] = tuple(
    entry for record in get_type_hints(Fluxes).values() for entry in table_of(record)
)
"""Name, unit and meaning of every quantity that :func:`auxiliaries` gives."""


@cache
def _symbolic_model(variant: str, symbolic: str) -> tuple[dict[str, Any], GreenLight]:
    """Symbols of the inputs, and the model evaluated with them."""
    kinds: dict[str, Callable[..., Any]] = {"SX": casadi.SX.sym, "MX": casadi.MX.sym}
    if symbolic not in kinds:
        msg = f"There is no kind of CasADi symbols '{symbolic}'.{did_you_mean(symbolic, kinds)}"
        raise UnknownNameError(msg)
    vectors = {name: kinds[symbolic](name, len(entries)) for name, entries in INPUTS.items()}
    x, u, d, p = (casadi.vertsplit(vector) for vector in vectors.values())
    return vectors, greenlight(State(*x), Controls(*u), Disturbances(*d), Parameters(*p), get_variant(variant))


def _function(name: str, vectors: dict[str, Any], output: Any, output_name: str) -> casadi.Function:
    """CasADi function of the four inputs in which no expression occurs twice."""
    shared = casadi.cse(casadi.densify(output))
    return casadi.Function(name, list(vectors.values()), [shared], list(vectors), [output_name])


@cache
def build_rhs(variant: str = "author", symbolic: Symbolic = "SX") -> casadi.Function:
    """CasADi function ``rhs`` of x, u, d, p that gives ``dxdt``, the time derivative of the state.

    Parameters
    ----------
    variant
        One of ``VARIANTS``.
    symbolic
        Kind of CasADi symbols inside: scalar ``SX`` (fast, for code generation) or matrix ``MX``.

    Raises
    ------
    UnknownNameError
        When there is no such variant or kind.
    """
    vectors, model = _symbolic_model(variant, symbolic)
    return _function("rhs", vectors, casadi.vertcat(*model.derivative), "dxdt")


@cache
def build_auxiliaries(variant: str = "author") -> casadi.Function:
    """CasADi function of x, u, d, p that gives all quantities of ``AUXILIARIES``, in that order, as one vector."""
    vectors, model = _symbolic_model(variant, "SX")
    return _function("auxiliaries", vectors, casadi.vertcat(*(v for record in model.fluxes for v in record)), "aux")


@cache
def build_jacobian(wrt: str = "x", variant: str = "author") -> casadi.Function:
    """CasADi function of x, u, d, p that gives the derivative of ``dxdt`` to one of the inputs, a dense (28, m) matrix.

    Raises
    ------
    UnknownNameError
        When ``wrt`` is none of the inputs or there is no such variant.
    """
    if wrt not in INPUTS:
        msg = f"The model has no input '{wrt}'.{did_you_mean(wrt, INPUTS)}"
        raise UnknownNameError(msg)
    vectors, model = _symbolic_model(variant, "SX")
    derivative = casadi.jacobian(casadi.vertcat(*model.derivative), vectors[wrt])
    return _function(f"jacobian_{wrt}", vectors, derivative, "jacobian")


def rhs(x: ArrayLike, u: ArrayLike, d: ArrayLike, p: ArrayLike, variant: str = "author") -> Array:
    """Time derivative of the state.

    Parameters
    ----------
    x, u, d, p
        State (28), controls (6), disturbances (10) and parameters (208) in the order and units of ``STATES``,
        ``CONTROLS``, ``DISTURBANCES`` and ``PARAMETERS``. Each may have a leading batch axis; those without one apply to
        every row.
    variant
        One of ``VARIANTS``: ``author``, the model author's equations, or ``gl_gym2``, those of the published code.

    Returns
    -------
    ndarray
        Shape (28,), or (n, 28) when any input has a batch axis; unit of the state per second.

    Raises
    ------
    ShapeError
        When an input has another shape, other batch sizes than the rest, or values that are not finite.
    UnknownNameError
        When there is no such variant.
    """
    return _evaluate(build_rhs(variant), x, u, d, p)[..., 0]


def auxiliaries(x: ArrayLike, u: ArrayLike, d: ArrayLike, p: ArrayLike, variant: str = "author") -> dict[str, Array]:
    """Every quantity computed on the way to the time derivative, by its public name.

    Parameters and errors as for :func:`rhs`.

    Returns
    -------
    dict of str to ndarray
        For each entry of ``AUXILIARIES`` an array of shape () or (n,), in the unit given there.
    """
    values = _evaluate(build_auxiliaries(variant), x, u, d, p)[..., 0]
    return {entry.name: values[..., index] for index, entry in enumerate(AUXILIARIES)}


def jacobian(x: ArrayLike, u: ArrayLike, d: ArrayLike, p: ArrayLike, wrt: str = "x", variant: str = "author") -> Array:
    """Derivative of the time derivative of the state to one of the inputs.

    Parameters and errors as for :func:`rhs`. The equations are written so that it is finite wherever there are leaves
    (cLeaf above 0), also at equal temperatures, calm, darkness and fully closed or open screens.

    Parameters
    ----------
    wrt
        The input to differentiate to: ``"x"``, ``"u"``, ``"d"`` or ``"p"``.

    Returns
    -------
    ndarray
        Shape (28, m) or (n, 28, m), with m the length of that input.
    """
    return _evaluate(build_jacobian(wrt, variant), x, u, d, p)


def _evaluate(function: casadi.Function, *inputs: ArrayLike) -> Array:
    """Value of a function with one output matrix: shape (rows, columns) or (n, rows, columns)."""
    arrays = _checked(inputs)
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


def _checked(inputs: tuple[ArrayLike, ...]) -> list[Array]:
    """Inputs as arrays of floats, after a check of shape and finiteness."""
    arrays = []
    sizes: dict[str, int] = {}
    for (name, entries), value in zip(INPUTS.items(), inputs, strict=True):
        try:
            array = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError) as error:
            msg = f"Input {name} is not an array of numbers: {error}."
            raise ShapeError(msg) from error
        if array.ndim not in (1, 2) or array.shape[-1] != len(entries):
            msg = f"Input {name} has shape {array.shape}; expected ({len(entries)},) or (n, {len(entries)})."
            raise ShapeError(msg)
        if not np.isfinite(array).all():
            *row, column = (int(index) for index in np.argwhere(~np.isfinite(array))[0])
            where = f" of row {row[0]}" if row else ""
            msg = f"Input {name} is not finite: {entries[column]}{where} is {array[*row, column]}."
            raise ShapeError(msg)
        if array.ndim == 2:
            sizes[name] = array.shape[0]
        arrays.append(array)
    if len(set(sizes.values())) > 1:
        counts = ", ".join(f"{name} has {size}" for name, size in sizes.items())
        msg = f"The inputs have different numbers of rows: {counts}. Give each the same number, or no batch axis."
        raise ShapeError(msg)
    return arrays
