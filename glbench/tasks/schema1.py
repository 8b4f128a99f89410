"""Schema 1 of task files: the tomato greenhouse of the GreenLight-Gym paper, read into the record of schema 2.

``TaskFile1`` checks the tables of such a file; ``PaperTaskFile`` is the record that the rest of glbench uses. It keeps
the tables as written in the file, for the digest (``glbench.tasks.digest``) and for records of runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar, get_args

from pydantic import BeforeValidator, Field, PrivateAttr, model_validator

from glbench.errors import refuse
from glbench.quantities import FLOWS
from glbench.tasks import vocabulary as words
from glbench.tasks.fields import ClimateQuantityTable, Limits, Override, Table, in_unit, limits_in, list_of, one_of, sorted_overrides
from glbench.tasks.ledger import LIMITED, Ledger, LedgerItem
from glbench.tasks.quantities import PAPER_MODEL
from glbench.tasks.tables import (
    PROCESS_COMPUTER,
    Conventions,
    ModelTable,
    ParameterGroupTable,
    PricesTable,
    ScenarioTable,
    TaskFile,
    TaskFile2,
    UncertaintyTable,
)

_KG_PER_MG = 1e-6


class PaperModelTable(Table):
    """``[model]``: the equations, the set of parameters, and single parameters that differ from the set."""

    variant: Annotated[str, one_of(words.MODEL_VARIANTS)] = Field(description="a variant of the equations")
    parameters: str = Field(min_length=1, description='the name of a parameter set in quotes, such as "benchmark"')
    overrides: Annotated[tuple[Override, ...], BeforeValidator(sorted_overrides)] = Field(
        default=(), description="a table of parameters, each with value and unit"
    )


class PaperInitialStateTable(Table):
    """``[initial_state]``: the state of the greenhouse when the period starts."""

    kind: Annotated[str, one_of(words.INITIAL_STATES)] = Field(description="a start")
    air_temperature: Annotated[float, in_unit("degC")] = Field(
        ge=-20.0, le=50.0, description='a temperature of -20 to 50 degC: { value = 16.5, unit = "degC" }'
    )


class PaperForecastTable(Table):
    """``[observation.forecast]``: how far ahead the weather is shown."""

    steps: int = Field(ge=1, le=2000, description="a whole number of steps, 1 to 2000")


class PaperObservationTable(Table):
    """``[observation]``: what an agent sees, and from which moment."""

    modules: Annotated[tuple[str, ...], list_of(words.OBSERVATION_MODULES.kind, "time", words.OBSERVATION_MODULES)] = Field(
        description="a list of observation modules"
    )
    timing: Literal["current", "published"] = Field(description='"current" or "published"')
    forecast: PaperForecastTable | None = None

    @model_validator(mode="after")
    def _forecast_is_granted_and_shown(self) -> Self:
        registry = words.OBSERVATION_MODULES
        forecasts = [name for name in self.modules if name in registry and registry[name].is_forecast]
        if forecasts and self.forecast is None:
            refuse(f"'{forecasts[0]}' is among the modules, so say how far it looks: add [observation.forecast] with steps = 48.")
        if self.forecast is not None and not forecasts:
            refuse('There is a table [observation.forecast], but no forecast among the modules: add "forecast" to them.')
        return self


class PaperConstraintsTable(ClimateQuantityTable):
    """``[constraints]``: the climate to stay within, checked after every step."""

    air_temperature: Annotated[Limits, limits_in(LIMITED["air_temperature"])]
    co2: Annotated[Limits, limits_in(LIMITED["co2"])]
    relative_humidity: Annotated[Limits, limits_in(LIMITED["relative_humidity"])]


class PaperPenaltyScales(ClimateQuantityTable):
    """Violation that costs 1 per step, for each constraint."""

    air_temperature: Annotated[float, in_unit(LIMITED["air_temperature"])] = Field(gt=0.0, description="above 0 degC")
    co2: Annotated[float, in_unit(LIMITED["co2"])] = Field(gt=0.0, description="above 0 ppm")
    relative_humidity: Annotated[float, in_unit(LIMITED["relative_humidity"])] = Field(gt=0.0, description="above 0 %")


class PaperRewardTable(Table):
    """``[reward]``: the sum of these modules is the reward of a step."""

    modules: Annotated[tuple[str, ...], list_of(words.REWARD_MODULES.kind, "epi", words.REWARD_MODULES)] = Field(
        description="a list of reward modules"
    )
    penalty_scale: PaperPenaltyScales


class TaskFile1(TaskFile):
    """Schema 1: the tomato greenhouse of the paper, one season, prices of four things."""

    schema_version: Literal[1] = Field(alias="schema", description="1 or 2")
    model: PaperModelTable
    initial: PaperInitialStateTable = Field(alias="initial_state")
    uncertainty: UncertaintyTable
    observation: PaperObservationTable
    constraints: PaperConstraintsTable
    prices: PricesTable
    reward: PaperRewardTable

    @model_validator(mode="after")
    def _has_no_computer(self) -> Self:
        if self.actuation.kind == PROCESS_COMPUTER:
            refuse("[actuation] A process computer needs a task of schema 2: add schema = 2 to a file with a base.")
        return self


_SHARED = frozenset(TaskFile1.model_fields) & frozenset(TaskFile2.model_fields) - {"schema_version", "model"}
"""Tables that both schemas have; those of schema 2 have more keys."""

AnyTable = TypeVar("AnyTable", bound=Table)


class PaperTaskFile(TaskFile2):
    """A task of schema 1 as a record of schema 2."""

    conventions: ClassVar[Conventions] = Conventions(
        keys_by_task=True,
        draws_table="uncertainty",
        seasons_table="weather",
        extra_quantities=(),
        paper_words=True,
        profiles_deficits=False,
        names_model=False,
        shows_delta=True,
        freezes_draws=False,
    )

    schema_version: Literal[1] = Field(alias="schema")  # type: ignore[assignment]

    _file: TaskFile1 = PrivateAttr()

    @classmethod
    def of_content(cls, content: Mapping[str, Any]) -> Self:
        """The record of the tables of a file of schema 1."""
        return cls.of_file(TaskFile1.model_validate(content))

    @classmethod
    def of_file(cls, file: TaskFile1) -> Self:
        """The record of the tables of a file, checked or not."""
        noise = file.uncertainty
        group = ParameterGroupTable.model_construct(
            name="uncertainty", parameters=noise.parameters, distribution=noise.distribution, half_width=noise.half_width,
            redraw=noise.redraw,
        )  # fmt: skip
        record = cls.model_construct(
            schema_version=1,
            model=_as(ModelTable, file.model, id=PAPER_MODEL),
            scenario=ScenarioTable.model_construct(family=file.id, parameters=(group,)),
            **{name: _as_field(TaskFile2, name, getattr(file, name)) for name in _SHARED},
        )
        record._file = file
        return record

    def content(self, source: str) -> dict[str, Any]:
        """The tables as a file of schema 1 writes them."""
        tables = tables_of_attachment(self.attachment(source))
        tables["weather"]["start"] = self.weather.start
        return tables

    def attachment(self, source: str) -> dict[str, Any]:
        """The tables as records of runs have them: numbers without their units, overrides as pairs of value and unit."""
        plain = self.plain(mode="json", by_alias=True)
        plain["model"]["overrides"] = {name: [value, unit] for name, value, unit in self._file.model.overrides}
        return plain

    def with_tables(self, update: Mapping[str, Any]) -> PaperTaskFile:
        """A copy with other tables, of either schema, which are not checked."""
        tables = {name: _as_field(TaskFile1, name, table) for name, table in update.items()}
        return self.of_file(self._file.model_copy(update=tables))

    def plain(self, **options: Any) -> dict[str, Any]:
        """The content of the file of schema 1 as plain values."""
        return self._file.model_dump(**options)

    def paper_ledger(self) -> Ledger:
        """The ledger of the GreenLight-Gym paper, at the file's prices."""
        return paper_v1(self.prices)

    @property
    def prices(self) -> PricesTable:
        """The table ``[prices]``."""
        return self._file.prices

    @property
    def uncertainty(self) -> UncertaintyTable:
        """The table ``[uncertainty]``."""
        return self._file.uncertainty


def _as(kind: type[AnyTable], table: Table, **more: Any) -> AnyTable:
    """``table`` as a table ``kind`` of the other schema, unchecked; missing keys come from ``more`` or have their defaults."""
    shared = {name: _as_field(kind, name, getattr(table, name)) for name in kind.model_fields if hasattr(table, name)}
    return kind.model_construct(**shared | more)


def _as_field(owner: type[Table], name: str, value: Any) -> Any:
    """``value`` as the field ``name`` of ``owner``: converted to the right kind of table if the field is a table."""
    annotation = owner.model_fields[name].annotation if name in owner.model_fields else None
    for kind in (annotation, *get_args(annotation)):
        if isinstance(kind, type) and issubclass(kind, Table) and isinstance(value, Table):
            return value if type(value) is kind else _as(kind, value)
    return value


_UNITS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "initial_state": {"air_temperature": "degC"},
        "prices": {
            "fruit": "EUR kg-1", "dry_matter_content": "kg kg-1", "co2": "EUR kg-1", "heat": "EUR kWh-1", "electricity": "EUR kWh-1",
        },
        "penalty_scale": {"air_temperature": "degC", "co2": "ppm", "relative_humidity": "%"},
        "failed_step": {"epi": "EUR m-2"},
        "time_limits": {"start": "s", "step": "s", "run": "s"},
    }
)  # fmt: skip
"""Keys of schema 1 that have a unit in the file and are plain numbers in a task."""


def tables_of_attachment(plain: Mapping[str, Any]) -> dict[str, Any]:
    """Plain values of a task of schema 1, overrides as pairs of value and unit, in the form of a file: numbers with their units.

    Raises ``KeyError`` or ``TypeError`` or ``ValueError`` or ``AttributeError`` when the values do not define a task.
    """
    tables = {key: dict(value) if isinstance(value, Mapping) else value for key, value in plain.items()}
    tables["model"]["overrides"] = {name: {"value": value, "unit": unit} for name, (value, unit) in plain["model"]["overrides"].items()}
    for table, owner in (
        ("initial_state", tables),
        ("prices", tables),
        ("penalty_scale", tables["reward"]),
        ("failed_step", tables["evaluation"]),
        ("time_limits", tables["evaluation"]),
    ):
        units = _UNITS[table]
        if owner.get(table) is None:  # a task that limits no time
            owner.pop(table, None)
            continue
        owner[table] = {key: {"value": value, "unit": units[key]} if key in units else value for key, value in owner[table].items()}
    tables["observation"] = {key: value for key, value in tables["observation"].items() if value is not None}
    return tables


def paper_v1(prices: PricesTable) -> Ledger:
    """The ledger of the GreenLight-Gym paper (2025): growth of the fruit's dry mass, sold fresh, minus heat, electricity and CO2."""
    fresh = _KG_PER_MG / prices.dry_matter_content
    heat, electricity, co2 = (
        LedgerItem(
            f"cost_{name}", flow, flow, FLOWS[flow].unit, 1.0, price, -1, label=FLOWS[flow].item_label,
            meaning=FLOWS[flow].price_of, amount_meaning=FLOWS[flow].meaning,
        )
        for name, flow, price in (
            ("heat", "heat", prices.heat), ("electricity", "electricity", prices.electricity), ("co2", "co2_dosed", prices.co2),
        )
    )  # fmt: skip
    return Ledger(
        (
            LedgerItem(
                "revenue", "fruit_growth", "fruit_fresh", "kg m-2", fresh, prices.fruit, 1, label="Fruit",
                meaning="value of the fresh fruit grown, when it grows and not when it is picked",
                amount_meaning="fresh fruit grown: dry increment divided by the dry matter content",
                amount_label="Fruit grown, fresh", goods="tomatoes",
            ),
            heat,
            electricity,
            co2,
        ),
        "economic performance: revenue minus the costs of heat, electricity and CO2",
    )  # fmt: skip
