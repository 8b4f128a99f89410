"""What an episode record holds: eight groups of columns, each with name, unit and meaning.

Steps are numbered from 1; step 0 is the start. Step k lasts from t(k-1) to t(k). Groups of the moment ``"start"`` act during the whole
step and carry the time of its start; groups of the moment ``"end"`` are measured when it is over and carry the time of its end.
A column's name occurs once among all groups.

All groups of one moment are parts of one message: two messages a step, not eight. MCAP keeps an index entry of 16 bytes for each
message, uncompressed, which readers want to have; with a message for each group it was a quarter of a file.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from glbench.env import QUANTITIES
from glbench.model import CONTROLS, DISTURBANCES, STATES

Moment = Literal["start", "end"]
TOPICS: dict[Moment, str] = {"start": "/inputs", "end": "/outcome"}
"""Topics of a record: what acts during a step, and the result at its end."""
MESSAGES = {"/inputs": "Inputs", "/outcome": "Outcome"}
"""Message type of each topic."""


@dataclass(frozen=True)
class Column:
    """One column: ``name``, ``unit``, and ``meaning`` in words."""

    name: str
    unit: str
    meaning: str


@dataclass(frozen=True)
class Group:
    """Columns that belong together: a message type of their own, which is a part of the message of their topic.

    ``field`` is the name of that part. ``at_start`` is true for groups that also have a sample at step 0, before anything was done.
    """

    name: str
    field: str
    message: str
    moment: Moment
    at_start: bool
    columns: tuple[Column, ...]

    @property
    def topic(self) -> str:
        """Topic of the record in which the group stands."""
        return TOPICS[self.moment]

    @property
    def path(self) -> str:
        """Where Foxglove finds the group: topic and part, as in ``/outcome.climate``."""
        return f"{self.topic}.{self.field}"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns, in order."""
        return tuple(column.name for column in self.columns)

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.columns)


CROP_STATES: tuple[str, ...] = ("tCan", "tCan24", "cBuf", "cLeaf", "cStem", "cFruit", "tCanSum")
"""States of the group ``crop``."""

OTHER_STATES: tuple[str, ...] = tuple(state.name for state in STATES if state.name not in CROP_STATES)
"""States of the group ``state``: all that are not the crop's, so that no number stands in a file twice."""

ECONOMICS: tuple[str, ...] = (
    "reward", "epi", "revenue", "cost_heat", "cost_electricity", "cost_co2",
    "heat", "electricity", "co2_dosed", "fruit_fresh",
)  # fmt: skip
"""Columns of the group ``economics``: amounts of one step, not sums since the start."""

VIOLATIONS: tuple[str, ...] = (
    "penalty",
    *(quantity.name for quantity in QUANTITIES if quantity.name.startswith(("violation_", "hours_outside_"))),
)
"""Quantities of the group ``violations``."""

_QUANTITY = {quantity.name: quantity for quantity in QUANTITIES}
_STATE = {state.name: state for state in STATES}


def _of_quantities(names: Iterable[str]) -> tuple[Column, ...]:
    return tuple(Column(name, _QUANTITY[name].unit, _QUANTITY[name].meaning) for name in names)


CLIMATE = Group(
    "climate", "climate", "Climate", "end", True,
    (
        Column("air_temperature", "degC", "air temperature"),
        Column("co2", "ppm", "CO2 of the indoor air"),
        Column("relative_humidity", "%", "relative humidity of the indoor air"),
    ),
)  # fmt: skip
CROP = Group(
    "crop", "crop", "Crop", "end", True,
    tuple(Column(name, _STATE[name].unit, _STATE[name].meaning) for name in CROP_STATES),
)  # fmt: skip
CONTROL = Group(
    "controls", "controls", "Controls", "start", False,
    tuple(Column(control.name, "-", control.meaning) for control in CONTROLS),
)  # fmt: skip
WEATHER = Group(
    "weather", "weather", "Weather", "start", False,
    tuple(Column(item.name, item.unit, item.meaning) for item in DISTURBANCES),
)  # fmt: skip
ECONOMY = Group("economics", "economics", "Economics", "end", False, _of_quantities(ECONOMICS))
VIOLATION = Group("violations", "violations", "Violations", "end", False, _of_quantities(VIOLATIONS))
STATE = Group(
    "state", "model_state", "ModelState", "end", True,
    tuple(Column(name, _STATE[name].unit, _STATE[name].meaning) for name in OTHER_STATES),
)  # fmt: skip


def action_group(names: Iterable[str], *, controls: bool) -> Group:
    """Group of what the agent answered: one column a control it drives.

    ``controls`` is true for privileged controllers, which set the controls themselves.
    """
    what = "control asked for" if controls else "action"
    meaning = {control.name: control.meaning for control in CONTROLS}
    columns = tuple(Column(f"action_{name}", "-", f"{what}: {meaning[name]}") for name in names)
    return Group("action", "agent_action", "AgentAction", "start", False, columns)


def groups_of(action: Group) -> tuple[Group, ...]:
    """All groups, in the order in which they stand in a step: what acts first, then what came of it."""
    return (action, CONTROL, WEATHER, CLIMATE, CROP, STATE, ECONOMY, VIOLATION)
