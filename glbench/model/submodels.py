"""The submodels of a greenhouse: a climate, a crop in it, and additions.

A submodel is a frozen dataclass. It declares its states, controls and parameters once; its equations are methods that take
records of floats, NumPy arrays or CasADi symbols. Everything else has a default, mostly "none".
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple, TypeAlias

from glbench.errors import GlbenchError
from glbench.model.actuators import Actuators
from glbench.model.bounds import Horizon
from glbench.model.disturbances import Disturbances
from glbench.model.expressions import Expr
from glbench.model.model import Capacity, Flow, ObservedColumn, Record, Signal, Stock
from glbench.model.parameter_checks import Order, Shares
from glbench.model.parameter_table import ParameterInfo, declared_table
from glbench.model.surroundings import AirExchange, CropExchange, Surroundings


class Nothing(NamedTuple):
    """A record without entries: of a submodel without states, controls or parameters."""


class Submodel(ABC):
    """A part of a model; fields of its records ``State``, ``Controls``, ``Parameters`` are ``Variable``, ``Quantity``, ``Parameter``."""

    name: ClassVar[str]
    State: ClassVar[type[Any]] = Nothing
    Controls: ClassVar[type[Any]] = Nothing
    Parameters: ClassVar[type[Any]] = Nothing
    shares: ClassVar[tuple[Shares, ...]] = ()
    """Parameters whose sum cannot exceed 1."""
    orders: ClassVar[tuple[Order, ...]] = ()
    """Parameters of which one must be below the other."""
    observation_modules: ClassVar[Mapping[str, str]] = {}
    """Names of the observation modules that ``observed`` knows, with a sentence each."""

    @property
    def table(self) -> tuple[ParameterInfo, ...]:
        """Its parameters in the order of their record; a submodel with a table in a file reads that instead."""
        return declared_table(self.Parameters)

    def derived(self, p: Record) -> Record:
        """Parameters with every derived entry computed from the base entries."""
        return p

    def refuse(self, values: Mapping[str, float]) -> None:  # noqa: B027 -- most have nothing to refuse
        """Raise ParameterError for values that contradict each other in another way than ``shares`` and ``orders`` say."""

    def capacities(self, p: Mapping[str, float]) -> tuple[Capacity, ...]:
        """What controls deliver at 1, from the parameters by public name.

        A control without an entry delivers a fraction of 1, named as the control without ``u_``. An entry for a control of an
        earlier part replaces what that part says of it: an addition that stands behind a control says what it now means.
        """
        return ()

    def flows(self) -> tuple[Flow, ...]:
        """Amounts that a ledger can price."""
        return ()

    def stocks(self) -> tuple[Stock, ...]:
        """Amounts that stand in the greenhouse, which a ledger can value."""
        return ()

    def signals(self) -> tuple[Signal, ...]:
        """What the viewer draws. A signal of the path of an earlier part's replaces that, as capacities do."""
        return ()

    def bounds(self, horizon: Horizon) -> Mapping[str, tuple[float, float]]:
        """Finite bounds of its states, by public name."""
        return {}

    def observed(self, module: str, horizon: Horizon) -> tuple[ObservedColumn, ...] | None:
        """Columns of an observation module; None for one it does not know."""
        return None


class Climate(Submodel):
    """Air, construction and equipment around a crop."""

    air: ClassVar[tuple[str, str, str]]
    """States of the main air: temperature [°C], CO2 density [mg m-3], vapour pressure [Pa]."""
    singular: ClassVar[tuple[str, str] | None] = None
    """Two states whose difference the rates depend on like a root."""
    canopy: ClassVar[str | None] = None
    """State of the plants that the climate has: the temperature of the canopy."""
    variant_name: str = "author"

    @abstractmethod
    def actuators(self, u: Record, p: Record) -> Actuators:
        """What the actuators bring in."""

    @abstractmethod
    def processes(self, lai: Expr, act: Actuators, x: Record, u: Record, d: Disturbances, p: Record) -> Record:
        """All fluxes of the climate at a leaf area index: a record of records."""

    @abstractmethod
    def surroundings(self, lai: Expr, x: Record, fluxes: Record, p: Record) -> Surroundings:
        """What the crop sees."""

    @abstractmethod
    def rates(self, x: Record, fluxes: Record, uptake: CropExchange, p: Record) -> Record:
        """Time derivatives of the climate's states."""

    def without(self, rates: Record, fluxes: Record, extraction: AirExchange, p: Record) -> Record:
        """``rates`` less what an addition takes from the main air. Raises ``GlbenchError`` when the climate does not say how."""
        msg = (
            f"{self.name} has no method `without`, so no addition can take heat, vapour or CO2 from its air. "
            "Write one that returns its rates less what is taken, as GreenLightClimate does."
        )
        raise GlbenchError(msg)

    @abstractmethod
    def start(self, d: Disturbances, air_temperature: float, p: Record) -> Record:
        """State at the start of an episode: air and surfaces at one temperature [°C]."""


CropStart: TypeAlias = Callable[[float, Record], Record]
"""State of a crop at the start, from the temperature of the air [°C] and the crop's nominal parameters."""


class Crop(Submodel):
    """Plants. They show the climate a leaf area, and take CO2 from its air."""

    parameters_after: ClassVar[str | None] = None
    """Public name of the climate's parameter after which the crop's stand in the vector; None: after all others."""

    @abstractmethod
    def leaf_area_index(self, x: Record, p: Record) -> Expr:
        """Leaf area index that the climate works with [m2 m-2]."""

    @abstractmethod
    def processes(self, x: Record, s: Surroundings, p: Record) -> Record:
        """All fluxes of the crop: a record of records, among them ``crop``, a :class:`CropExchange`."""

    @abstractmethod
    def rates(self, x: Record, s: Surroundings, fluxes: Record, p: Record) -> Record:
        """Time derivatives of the crop's states."""

    @abstractmethod
    def starts(self) -> Mapping[str, CropStart]:
        """States that an episode can start from, by the word in task files."""


class Around(NamedTuple):
    """Everything of a greenhouse that an addition may read."""

    climate: Record
    """Fluxes of the climate: a record of records."""
    crop: Record
    """Fluxes of the crop: a record of records."""
    surroundings: Surroundings
    controls: Record
    """All controls of the model."""
    disturbances: Disturbances


class Addition(Submodel):
    """Another part: an energy system, an irrigation, a pest.

    It reads everything, may change what the actuators bring in, and may take heat, vapour and CO2 from the main air.
    """

    def supply(self, act: Actuators, x: Record, u: Record, p: Record) -> Actuators:
        """What the actuators bring in, with this part in between; ``u`` are all controls of the model."""
        return act

    def processes(self, x: Record, around: Around, p: Record) -> Record:
        """Its fluxes: one annotated record."""
        return Nothing()

    def exchange(self, x: Record, around: Around, fluxes: Record, p: Record) -> AirExchange | None:
        """What it takes from the main air; None: nothing, and no equation of the climate changes."""
        return None

    def rates(self, x: Record, around: Around, fluxes: Record, p: Record) -> Record:
        """Time derivatives of its states."""
        return Nothing()

    def start(self, d: Disturbances, air_temperature: float, p: Record) -> Record:
        """Its state at the start of an episode."""
        return Nothing()
