"""Names, units and meanings of the quantities of the model, read from the records that hold them.

A record is a ``NamedTuple`` whose fields are annotated with a :class:`Quantity`. Code writes ``r_can_cov_in``; the name in
vectors, tables and files is the literature's ``rCanCovIn``. :func:`public_name` is the whole rule.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, get_type_hints


@dataclass(frozen=True)
class Quantity:
    """Unit and meaning, as written beside a field."""

    unit: str
    meaning: str


@dataclass(frozen=True)
class Variable(Quantity):
    """A state: what the integrators need to know of it, besides unit and meaning."""

    scale: float = 10.0
    """Typical size, in the state's unit."""
    small: float = 0.1
    """Size below which its value means little for the other states: errors are judged relative to this much at least."""
    sharper: float = 1.0
    balance: float = 1.0
    """``sharper`` and ``balance``: factors on its tolerance: in the presets that weigh all states evenly, and in those that are weighed
    against CVODES."""
    fast: bool = False
    """Whether it settles within a minute or so: an error made long before the end of a step is forgotten at its end."""
    follower: bool = False
    """Whether it is slow, and its rate depends on other states only through followers and the rates of other states. The compiled kernel
    holds it while the others move, and lets it follow at the end of the step."""


@dataclass(frozen=True)
class NamedQuantity:
    """One entry of a table of quantities."""

    name: str
    """Public name, for example ``tAir``."""
    attribute: str
    """Name of the field in the equations, for example ``t_air``."""
    unit: str
    """Unit in words of the International System, for example ``W m-2``; ``-`` for none."""
    meaning: str
    """One phrase."""


@dataclass(frozen=True)
class NamedVariable(NamedQuantity):
    """One entry of a table of states; the fields after ``meaning`` are those of :class:`Variable`."""

    scale: float
    small: float
    sharper: float
    balance: float
    fast: bool
    follower: bool


def public_name(attribute: str) -> str:
    """Literature's name of a field: ``r_can_cov_in`` becomes ``rCanCovIn``."""
    head, *tail = attribute.split("_")
    return head + "".join(part[:1].upper() + part[1:] for part in tail)


def states_of(record: type[Any]) -> tuple[NamedVariable, ...]:
    """Table of the annotated states of ``record``, in the order of its fields."""
    return tuple(
        NamedVariable(public_name(attribute), attribute, **{f.name: getattr(note, f.name) for f in fields(note)})
        for attribute, hint in get_type_hints(record, include_extras=True).items()
        for note in getattr(hint, "__metadata__", ())
        if isinstance(note, Variable)
    )


def table_of(record: type[Any]) -> tuple[NamedQuantity, ...]:
    """Table of the annotated fields of ``record``, in the order of its fields."""
    return tuple(
        NamedQuantity(public_name(attribute), attribute, note.unit, note.meaning)
        for attribute, hint in get_type_hints(record, include_extras=True).items()
        for note in getattr(hint, "__metadata__", ())
        if isinstance(note, Quantity)
    )
