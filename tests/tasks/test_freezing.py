"""What is added to glbench leaves every published task as it is: digests, lock, and what is computed from them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
import pytest

from glbench.env import make_accounts
from glbench.env.behaviour import behaviour, read_behaviour
from glbench.env.rewards import REWARDS, register_reward
from glbench.model import TOMATO, Meter, compose, get_model, paper, register_model
from glbench.model.parameter_table import ParameterInfo
from glbench.model.quantities import Variable
from glbench.model.submodels import Addition
from glbench.tasks import (
    INITIAL_STATES,
    METRICS,
    OBSERVATION_MODULES,
    REWARD_MODULES,
    InitialState,
    LedgerItem,
    ObservationModule,
    Quantity,
    TaskSpec,
    Word,
    get_task,
    list_tasks,
    read_lock,
    schema1,
    serialisation,
    tables,
)
from glbench.tasks.ledger import Ledger
from tests.tasks.names import SHORT_ID


@pytest.fixture(autouse=True)
def fresh(forget: Callable[[], None], monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Registered words and models are forgotten after a test; tasks are read anew in it."""
    monkeypatch.setattr(paper, "_MODELS", {name: dict(variants) for name, variants in paper._MODELS.items()})
    for registry in (OBSERVATION_MODULES, REWARD_MODULES, METRICS, INITIAL_STATES):
        monkeypatch.setattr(registry, "_entries", dict(registry._entries))
    monkeypatch.setattr(REWARDS, "_makers", dict(REWARDS._makers))
    forget()
    yield
    forget()


class TankState(NamedTuple):
    tank: Annotated[Any, Variable("kWh m-2", "heat in a tank", scale=1.0, small=0.01)]


class TankParameters(NamedTuple):
    tank_loss: Any


@dataclass(frozen=True)
class Tank(Addition):
    """One more state, and one more parameter."""

    name: ClassVar[str] = "tank"
    State: ClassVar[type[Any]] = TankState
    Parameters: ClassVar[type[Any]] = TankParameters
    table: ClassVar[tuple[ParameterInfo, ...]] = (
        ParameterInfo(
            "tankLoss", "tank_loss", "s-1", "losses", "made up", "tank", "positive", "", "yes", frozenset({"crop28"}), {"benchmark": 1e-6}
        ),
    )  # fmt: skip

    def rates(self, x: Any, around: Any, fluxes: Any, p: Any) -> TankState:
        return TankState(-p.tank_loss * x.tank)

    def start(self, d: Any, air_temperature: float, p: Any) -> TankState:
        return TankState(1.0)


def add_a_state_and_a_parameter(monkeypatch: pytest.MonkeyPatch) -> None:
    model = register_model(compose(TOMATO.climate, TOMATO.crop, Tank()))
    assert (len(model.states), len(model.table)) == (len(TOMATO.states) + 1, len(TOMATO.table) + 1)


def add_a_model_of_the_next_version(monkeypatch: pytest.MonkeyPatch) -> None:
    meter = Meter("mc_fruit_har", "picked", "mg m-2", "picked", "Picked")
    register_model(compose(TOMATO.climate, TOMATO.crop, meters=(meter,), version="1.1.0"))
    assert get_model("greenlight-tomato-1.1.0").id != TOMATO.id


def add_an_optional_key(monkeypatch: pytest.MonkeyPatch) -> None:
    class Weather(tables.WeatherTable):
        altitude: float = 0.0

    class File(schema1.TaskFile1):
        weather: Weather
        sensors: str = "perfect"

    monkeypatch.setattr(serialisation, "TaskFile1", File)


def add_a_metric_and_words(monkeypatch: pytest.MonkeyPatch) -> None:
    METRICS.add(Word("yield", "fruit"))
    INITIAL_STATES.add(InitialState("seedling", "a seedling", lambda d, air, p: np.zeros(28)))
    register_reward("test_freezing", "fruit", lambda task, accounts: lambda step: step["fruit_fresh"])


def add_an_observation_module(monkeypatch: pytest.MonkeyPatch) -> None:
    column = Quantity("vpd", "kPa", 0.0, 100.0, "vapour pressure deficit")
    OBSERVATION_MODULES.add(ObservationModule("test_vpd", "vapour pressure deficit", lambda context: (column,)))


def add_a_ledger_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """To the ledger of other tasks: that of the paper is as it is."""
    more = LedgerItem("cost_gas", "heat", "gas", "m3 m-2", 0.1, 0.5, -1, label="Gas")
    task = get_task(SHORT_ID)
    ledger = Ledger((*task.ledger.items, more))
    other = task.model_copy(update={"id": "mylab/Gas-v1"})
    vars(other)["ledger"] = ledger
    assert "cost_gas" in make_accounts(other).names
    assert "cost_gas" not in make_accounts(task).names


@pytest.mark.parametrize(
    "add",
    [
        add_a_state_and_a_parameter,
        add_a_model_of_the_next_version,
        add_an_optional_key,
        add_a_metric_and_words,
        add_an_observation_module,
        add_a_ledger_line,
    ],
    ids=lambda add: add.__name__,
)
def test_an_addition_changes_no_published_task(
    add: Callable[[pytest.MonkeyPatch], None], monkeypatch: pytest.MonkeyPatch, forget: Callable[[], None]
) -> None:
    add(monkeypatch)
    forget()
    lock = read_lock()
    found = {task.id: get_task(task.id) for task in list_tasks()}
    assert set(found) == set(lock)
    assert len(found) >= 22
    for task_id, task in found.items():
        assert isinstance(task, TaskSpec)
        assert task.fingerprint() == lock[task_id].fingerprint
        assert task.locked
    now, then = behaviour(found[f"glbench/{SHORT_ID}"]), read_behaviour()[f"glbench/{SHORT_ID}"]
    assert set(now) == set(then)
    for name, number in then.items():
        assert now[name].value == pytest.approx(number, rel=1e-9, abs=1e-9 * now[name].size)


def test_an_optional_key_changes_no_digest_of_schema_2(
    monkeypatch: pytest.MonkeyPatch, write: Callable[[str], Any], forget: Callable[[], None]
) -> None:
    text = f'base = "glbench/{SHORT_ID}"\nschema = 2\nid = "mylab/Two-v1"\ntitle = "Two"\n'
    path = write(text)
    digest = get_task(path).digest

    class File(tables.TaskFile2):
        sensors: str = "perfect"

    monkeypatch.setattr(serialisation, "TaskFile2", File)
    forget()
    again = get_task(path)
    assert isinstance(again.file, File)
    assert again.digest == digest
    noisy = get_task(write(text + 'sensors = "noisy"\n'))
    assert noisy.digest != digest


@pytest.mark.parametrize(
    "line",
    [
        "ledger.cost_heat.price = { value = 0.1, unit = \"EUR kWh-1\" }",
        'scenario.salt = "another"',
        "scenario.years = [2010, 2011]",
        "scenario.start_within_days = 1",
        'model.id = "greenlight-tomato-harvest-1.0.0"',
        'model.parameters = "led_2020"',
        "model.overrides.thetaLampMax = { value = 80.0, unit = \"W m-2\" }",
        'evaluation.metric = "profit"',
        "weather.co2_ppm = 410.0",
    ],
)  # fmt: skip
def test_what_acts_is_in_the_digest_of_schema_2(write: Callable[[str], Any], line: str) -> None:
    text = f'base = "glbench/{SHORT_ID}"\nschema = 2\nid = "mylab/Two-v1"\ntitle = "Two"\n'
    assert get_task(write(text)).digest != get_task(write(text + line + "\n")).digest


def test_the_rows_of_every_season_are_in_the_digest_of_schema_2(
    write: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch, forget: Callable[[], None]
) -> None:
    """Unlike schema 1, which covers the hourly figures."""
    path = write(f'base = "glbench/{SHORT_ID}"\nschema = 2\nid = "mylab/Two-v1"\ntitle = "Two"\nscenario.years = [2010, 2011]\n')
    before = get_task(path).fingerprint()
    season = TaskSpec.season

    def warmer(task: TaskSpec, one: Any, extra_rows: int = 0) -> Any:
        import dataclasses

        rows = season(task, one, extra_rows)
        values = rows.values.copy()
        values[-1, 1] += 0.01 * (one.start.year == 2011)
        return dataclasses.replace(rows, values=values)

    monkeypatch.setattr(TaskSpec, "season", warmer)
    forget()
    after = get_task(path).fingerprint()
    assert before.weather != after.weather
    assert before.definition == after.definition
