"""A greenhouse with a chain of fruit stages, of which each is slow: what follows, and what drives it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np

from glbench.kernel import Rows
from glbench.model import TOMATO, Addition, Around, Model, compose
from glbench.model.balances import DAY
from glbench.model.crop.tomato import VanthoorTomato
from glbench.model.expressions import Expr, exp
from glbench.model.greenhouse import typed_record
from glbench.model.greenlight import GreenLightClimate
from glbench.model.parameter_table import Parameter, declared_table
from glbench.model.quantities import Variable
from tests.kernel.known_steps import KnownSteps


class ChainParameters(NamedTuple):
    ripening: Annotated[Expr, Parameter("s-1", "development of fruit where growth is not inhibited", 0.02 / DAY, check="nonnegative")]
    steepness: Annotated[Expr, Parameter("-", "how much the sink of a stage changes with development", 2.0, check="nonnegative")]
    loss: Annotated[Expr, Parameter("s-1", "fruit lost", 1e-8, check="nonnegative")]
    setting: Annotated[Expr, Parameter("m-2 s-1", "fruit set", 5e-6, check="nonnegative")]
    exchange: Annotated[Expr, Parameter("s-1", "how fast the store follows the fruit", 5e-7, check="nonnegative")]


def _state(stages: int, *, follower: bool) -> type[Any]:
    number = Variable("m-2", "fruit of a stage", scale=10.0, small=0.1, follower=follower)
    mass = Variable("mg m-2", "CH2O in the fruit of a stage", scale=1e4, small=100.0, follower=follower)
    return typed_record(
        "ChainState",
        {
            "development": Annotated[Any, Variable("-", "development of fruit since the start", scale=1.0, small=1e-3)],
            "supply": Annotated[Any, Variable("mg m-2", "CH2O given to the fruit", scale=1e5, small=100.0)],
            **{f"n_{j}": Annotated[Any, number] for j in range(stages)},
            **{f"c_{j}": Annotated[Any, mass] for j in range(stages)},
            "ripe": Annotated[Any, Variable("mg m-2", "CH2O that left the last stage", scale=1e5, small=100.0)],
            "store": Annotated[Any, Variable("mg m-2", "follows what is in all fruit, faster when it is warm", scale=1e5, small=100.0)],
        },
    )


_STATES = {(stages, follower): _state(stages, follower=follower) for stages in (4, 33) for follower in (True, False)}


@dataclass(frozen=True)
class Chain(Addition):
    """Fruit that go from stage to stage with their development, and share what the buffer gives by sinks that depend on its rate."""

    stages: int = 4
    follower: bool = True
    stray: bool = False  # whether the first follower reads the temperature of the air, which none may

    name: ClassVar[str] = "chain"
    Parameters: ClassVar[type[Any]] = ChainParameters
    table = tuple(replace(info, drawn_in=frozenset({"crop28"})) for info in declared_table(ChainParameters))

    @property
    def State(self) -> type[Any]:  # type: ignore[override]  # noqa: N802 -- a class
        return _STATES[self.stages, self.follower]

    def rates(self, x: Any, around: Around, fluxes: Any, p: ChainParameters) -> Any:
        stages, climate = range(self.stages), around.surroundings.x
        n, c = ([getattr(x, f"{key}_{j}") for j in stages] for key in "nc")
        development = p.ripening * around.crop.inhibition.h_t_can24
        supply = around.crop.allocation.mc_buf_fruit
        passing, total = self.stages * development, sum(c[1:], c[0])
        sinks = [number * exp(-p.steepness * j / self.stages * (1 + DAY * development)) for j, number in enumerate(n)]
        share = supply / sum(sinks[1:], sinks[0])
        lost = p.loss * (1 + around.controls.u_lamp + 0.01 * around.disturbances.i_glob)
        first = p.setting * (1 + 1e-3 * climate.t_air) if self.stray else p.setting
        numbers = [first - passing * n[0], *(passing * (n[j - 1] - n[j]) for j in stages[1:])]
        masses = [
            (passing * c[j - 1] if j else 0.0) - passing * c[j] + share * sinks[j] - lost * c[j] * c[j] / (c[j] + 100.0) for j in stages
        ]
        store = p.exchange * (total - x.store) * climate.t_air / 20
        return self.State(development, supply, *numbers, *masses, passing * c[-1], store)

    def start(self, d: Any, air_temperature: float, p: ChainParameters) -> Any:
        return self.State(0.0, 0.0, *(5.0 + j for j in range(self.stages)), *(2e3 * (j + 1) for j in range(self.stages)), 0.0, 1e4)


def chain_model(stages: int = 4, *, follower: bool = True, stray: bool = False) -> Model:
    """The tomato greenhouse with a chain; without ``follower`` all its states are integrated."""
    return compose(GreenLightClimate(), VanthoorTomato(), Chain(stages, follower, stray), version=f"1.0.0-{stages}{follower:d}{stray:d}")


CHAIN = chain_model()


def chain_rows(steps: KnownSteps, n: int, model: Model = CHAIN, seed: int = 3) -> Rows:
    """Known steps with fruit of all kinds in the stages, and controls that are not at their ends."""
    generator, p = np.random.default_rng(seed), model.parameters.default()
    pick = np.linspace(0, len(steps.x) - 1, n).astype(int)
    x = np.empty((n, len(model.states)))
    x[:] = model.start("mature_crop", steps.d[0], 18.0, p)
    for i, name in enumerate(TOMATO.state_names):
        x[:, model.state_index(name)] = steps.x[pick, i]
    fruit = [i for i, name in enumerate(model.state_names) if name[:1] in "nc" and name[1:].isdigit()]
    x[:, fruit] *= generator.uniform(0.5, 1.5, (n, 1)) * generator.uniform(0.9, 1.1, (n, len(fruit)))
    x[:, model.state_index("development")] = generator.uniform(0.0, 0.5, n)
    return Rows(x, 0.9 * steps.u[pick] + 0.04, steps.d[pick], p[None])
