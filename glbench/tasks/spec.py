"""A task: everything that fixes a problem to the last bit, as one frozen record that mirrors its file."""

from __future__ import annotations

import unicodedata
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, Field, PrivateAttr

from glbench.tasks.bases import Change
from glbench.tasks.quantities import Capacity, ObservationContext, Quantity, capacities
from glbench.tasks.tables import (
    ActuationTable,
    ConstraintsTable,
    EvaluationTable,
    InitialStateTable,
    ModelTable,
    ObservationTable,
    PricesTable,
    RewardTable,
    Table,
    UncertaintyTable,
    WeatherTable,
)

if TYPE_CHECKING:
    from glbench.model import Model
    from glbench.tasks.digest import Fingerprint
    from glbench.tasks.scenario import Scenario
    from glbench.weather import Disturbances, WeatherRecord

FloatArray = npt.NDArray[np.float64]

PROSE = frozenset({"title", "description", "suites"})
"""Fields that explain or file a task and do not change it: they stay out of its digest."""


def _text(given: object) -> object:
    """Text for people, which stands in terminals and on pages: without characters that steer them."""
    strange = next((letter for letter in given if not _can_be_shown(letter)), None) if isinstance(given, str) else None
    if strange is not None:
        msg = f"It holds the character U+{ord(strange):04X}, which cannot be shown. Take it out."
        raise ValueError(msg)
    return given


def _can_be_shown(letter: str) -> bool:
    return letter.isprintable() or letter in "\n\t" or unicodedata.category(letter) == "Zs"


def _one_line(given: object) -> object:
    if isinstance(given, str) and len(given.splitlines()) > 1:
        msg = "It must be one line."
        raise ValueError(msg)
    return _text(given)


def _suite_names(given: object) -> tuple[str, ...]:
    if not isinstance(given, list | tuple) or not all(isinstance(name, str) and name for name in given):
        msg = 'It must be a list of names, such as ["paper"].'
        raise ValueError(msg)
    return tuple(str(_one_line(name)) for name in given)


class TaskSpec(Table):
    """A task as its file defines it.

    The tables of the file are fields of the same name; ``[initial_state]`` is the field ``initial`` and ``schema`` is
    ``schema_version``. Numbers written with a unit in the file are plain floats in that unit here. What follows from the
    definition (parameters, weather, start, digest) is computed on demand and remembered for the life of the process.
    """

    schema_version: Literal[1] = Field(alias="schema", description="1")
    id: str = Field(
        pattern=r"^[A-Za-z0-9_-]+/[A-Za-z0-9_.-]+-v[1-9][0-9]*$",
        description='an id in quotes with a namespace and a version, such as "mylab/Winter2011-v1"',
    )
    title: Annotated[str, BeforeValidator(_one_line)] = Field(min_length=1, description="a title in quotes")
    description: Annotated[str, BeforeValidator(_text)] = Field(default="", description="text in quotes")
    suites: Annotated[tuple[str, ...], BeforeValidator(_suite_names)] = Field(default=(), description="a list of names")
    weather: WeatherTable
    model: ModelTable
    initial: InitialStateTable = Field(alias="initial_state")
    uncertainty: UncertaintyTable
    observation: ObservationTable
    actuation: ActuationTable
    constraints: ConstraintsTable
    prices: PricesTable
    reward: RewardTable
    evaluation: EvaluationTable

    _source: str = PrivateAttr(default="the task")
    _base: str | None = PrivateAttr(default=None)
    _changes: tuple[Change, ...] = PrivateAttr(default=())

    @property
    def source(self) -> str:
        """The file the task was read from, as error messages name it."""
        return self._source

    @property
    def base(self) -> str | None:
        """The task that its file names as its base: an id or a file; ``None`` where the file is written out."""
        return self._base

    @property
    def changes(self) -> tuple[Change, ...]:
        """What its file changes in the base."""
        return self._changes

    @property
    def model_value(self) -> Model:
        """The model.

        Raises
        ------
        UnknownNameError
            When there is no such variant.
        """
        from glbench.model import tomato  # not at the top: task files are read without the model

        return tomato(self.model.variant)

    @property
    def short_id(self) -> str:
        """The id without its namespace, such as ``Schiphol2010-Delta10-v1``."""
        return self.id.partition("/")[2]

    @property
    def scenario(self) -> Scenario:
        """What a run draws: season, start, parameters."""
        from glbench.tasks.scenario import scenario_of

        return scenario_of(self)

    @property
    def steps(self) -> int:
        """Number of control steps of an episode."""
        return self.weather.steps

    @property
    def step_seconds(self) -> float:
        """Length of a control step [s]."""
        return float(self.weather.step_seconds)

    def parameters(self) -> FloatArray:
        """Nominal parameter vector (208,), read-only, in the model's units, overrides applied and derived ones recomputed.

        Raises
        ------
        TaskError
            When the set or an overridden parameter is unknown, or a value is impossible; it names file and table.
        """
        from glbench.tasks.resolve import resolved_parameters

        return resolved_parameters(self)

    def parameters_by_name(self) -> dict[str, float]:
        """``parameters()`` as a dictionary."""
        from glbench.model import PARAMETER_NAMES

        return dict(zip(PARAMETER_NAMES, self.parameters().tolist(), strict=True))

    def uncertain_parameters(self) -> tuple[str, ...]:
        """Names of the parameters that are drawn anew, in the model's order for a set, else as listed."""
        from glbench.tasks.resolve import resolved_uncertain_parameters

        return resolved_uncertain_parameters(self)

    def record(self) -> WeatherRecord:
        """The weather record that the task uses."""
        from glbench.tasks.resolve import resolved_record

        return resolved_record(self)

    def disturbances(self, extra_rows: int = 0) -> Disturbances:
        """Weather rows for the whole episode: ``steps + 1 + extra_rows`` rows, remembered.

        Row k acts on step k; the row after the last step is there because it is observed at the end. A forecast of n steps
        needs ``extra_rows=n``.

        Raises
        ------
        TaskError
            When there is no such record or it does not cover the period; it names file and table.
        """
        from glbench.tasks.resolve import resolved_disturbances

        return resolved_disturbances(self, self.steps + 1 + extra_rows)

    def initial_state(self) -> FloatArray:
        """State at the start (28,), read-only, in the model's units."""
        from glbench.tasks.resolve import resolved_initial_state

        return resolved_initial_state(self)

    def capacities(self) -> tuple[Capacity, ...]:
        """What each of the six controls delivers at 1, with its unit."""
        return capacities(self.parameters_by_name())

    def observed(self) -> tuple[Quantity, ...]:
        """Columns of the observation, in order, with units and finite bounds.

        Raises
        ------
        TaskError
            When two modules show a quantity of the same name.
        """
        from glbench.tasks.resolve import resolved_observation

        return resolved_observation(self)

    def observation_context(self) -> ObservationContext:
        """What the columns of observation modules may depend on."""
        return ObservationContext(
            self.steps, self.step_seconds, self.observation.forecast_steps, self.parameters_by_name()
        )

    def definition(self) -> dict[str, Any]:
        """The definition without prose, as plain JSON values: the part of the digest that comes from the file."""
        plain: dict[str, Any] = self.model_dump(mode="json", by_alias=True, exclude=set(PROSE))
        if self.evaluation.time_limits is None:
            del plain["evaluation"]["time_limits"]  # a task that says nothing about time has the digest it always had
        plain["model"]["overrides"] = {name: [value, unit] for name, value, unit in self.model.overrides}
        return plain

    def fingerprint(self) -> Fingerprint:
        """The digest and the parts it is made of, remembered."""
        from glbench.tasks.digest import fingerprint

        return fingerprint(self)

    @property
    def digest(self) -> str:
        """SHA-256 [hex] over definition, parameters, observed columns, weather and model; see docs/tasks.md."""
        return self.fingerprint().digest

    @property
    def locked(self) -> bool:
        """Whether this very task is published: its id stands in tasks/lock.toml with this digest."""
        from glbench.tasks.lock import read_lock

        entry = read_lock().get(self.id)
        return entry is not None and entry.digest == self.digest

    def __repr__(self) -> str:
        return f"<TaskSpec {self.id}>"

    __str__ = __repr__
