"""Names, units and meanings of the quantities of the model, read from the records that hold them.

A record is a ``NamedTuple`` whose fields are annotated with a :class:`Quantity`. Code writes ``r_can_cov_in``; the name in
vectors, tables and files is the literature's ``rCanCovIn``. :func:`public_name` is the whole rule.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, get_type_hints


@dataclass(frozen=True)
class Quantity:
    """Unit and meaning, as written beside a field."""

    unit: str
    meaning: str


@dataclass(frozen=True)
class NamedQuantity:
    """One entry of a table of quantities.

    Attributes
    ----------
    name
        Public name, for example ``tAir``.
    attribute
        Name of the field in the equations, for example ``t_air``.
    unit
        Unit in words of the International System, for example ``W m-2``; ``-`` for none.
    meaning
        One phrase.
    """

    name: str
    attribute: str
    unit: str
    meaning: str


def public_name(attribute: str) -> str:
    """Literature's name of a field: ``r_can_cov_in`` becomes ``rCanCovIn``."""
    head, *tail = attribute.split("_")
    return head + "".join(part[:1].upper() + part[1:] for part in tail)


def table_of(record: type[Any]) -> tuple[NamedQuantity, ...]:
    """Table of the annotated fields of ``record``, in the order of its fields."""
    return tuple(
        NamedQuantity(public_name(attribute), attribute, note.unit, note.meaning)
        for attribute, hint in get_type_hints(record, include_extras=True).items()
        for note in getattr(hint, "__metadata__", ())
        if isinstance(note, Quantity)
    )
