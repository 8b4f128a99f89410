"""Schema 2: any model, a ledger, prices that change, scenarios."""

from __future__ import annotations

import datetime as dt
import json
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from glbench.env import Simulation, make_accounts
from glbench.env.rewards import make_reward
from glbench.episodes.header import definition_json, task_of
from glbench.errors import TaskError
from glbench.model import paper
from glbench.tasks import ParameterGroup, PriceTable, Season, StartGroup, TaskSpec, get_task, library, task_card
from tests.tasks.toy import TASK, Toy

Write = Callable[[str], Path]

HARVEST = """
base = "glbench/Schiphol2010-Delta10-v1"
schema = 2
id = "mylab/Harvest-v1"
title = "Fruit is paid when it is harvested"

[model]
id = "greenlight-tomato-harvest-1.0.0"
parameters = "hps_2020"

[ledger.revenue]
flow = "fruit_harvested"
amount = "fruit_harvested_fresh"
label = "Harvest"

[ledger.standing]
side = "earned"
stock = "fruit"
amount = "fruit_standing"
unit = "kg m-2"
factor = 1.5384615384615384e-05
price = { value = 1.6, unit = "EUR kg-1" }

[reward]
modules = ["epi", "scaled_penalty"]
"""


@pytest.fixture(autouse=True)
def toy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paper, "_MODELS", {**paper._MODELS, "toy-1.0.0": {"author": Toy()}})


@pytest.fixture
def toys(write: Write) -> Callable[..., TaskSpec]:
    """The toy's task, with pieces of its text replaced, given as pairs of old and new."""

    def made(*pieces: str) -> TaskSpec:
        text = TASK
        for old, new in zip(pieces[::2], pieces[1::2], strict=True):
            assert old in text
            text = text.replace(old, new)
        return get_task(write(text))

    return made


def test_a_task_of_another_model_is_resolved(toys: Callable[..., TaskSpec]) -> None:
    task = toys()
    assert (task.model_value.id, task.steps, task.locked) == ("toy-1.0.0", 72, False)
    assert task.parameters().tolist() == [1e-6, 1e-3]
    assert task.initial_state().tolist() == [0.1, 5.0]
    assert [column.name for column in task.observed()][:2] == ["mass", "tap"]
    assert [q.name for q in task.quantities] == [
        "reward", "epi", "growth", "cost_water", "penalty", "water", "mass_gained", "actuator_travel",
    ]  # fmt: skip
    assert task.evaluation.metric == "epi"
    card = task_card(task)
    assert (card.model, card.prices, card.constraints, card.delta) == ("toy-1.0.0", None, (), 0.0)
    assert [item.name for item in card.ledger] == ["growth", "cost_water"]
    assert pickle.loads(pickle.dumps(task)).digest == task.digest


def test_a_stock_gains_what_it_is_worth_at_the_end_minus_at_the_start(toys: Callable[..., TaskSpec]) -> None:
    """0.2 -> 0.3 kg at 1 EUR kg-1 now and 2 EUR kg-1 in the next step: 0.3 x 2 - 0.2 x 1 = 0.4 EUR; 3600 s of 0.0005 kg s-1 water."""
    task = toys()
    accounts = make_accounts(task)
    before, after, controls = np.array([[0.2, 5.0]]), np.array([[0.3, 6.0]]), np.array([[0.5]])
    now, later = np.array([[1.0]]), np.array([[2.0]])
    table = accounts.quantities(before, after, controls, np.zeros((3, 1)), now, later)
    step = dict(zip(accounts.names, table[:, 0].tolist(), strict=True))
    assert step["growth"] == pytest.approx(0.4)
    assert step["mass_gained"] == pytest.approx(0.1)
    assert step["cost_water"] == pytest.approx(1.8 * 0.01)
    assert step["epi"] == pytest.approx(0.4 - 0.018)
    assert step["penalty"] == 0.0
    calendar = task.disturbances()
    prices = task.price_tables[task.ledger.price_tables[0]].values(calendar.times, calendar.hour_of_day)
    assert prices.shape == (73,)
    assert set(prices[8:20]) == {2.0}
    masses = np.linspace(0.1, 0.7, 73)
    gained = sum(
        accounts.of_step([m, 0.0], [n, 0.0], [0.0], (), [p], [q])["growth"]
        for m, n, p, q in zip(masses, masses[1:], prices, prices[1:], strict=False)
    )
    assert gained == pytest.approx(masses[-1] * prices[-1] - masses[0] * prices[0])


def test_prices_hold_from_their_day_to_the_next_over_the_turn_of_the_year() -> None:
    table = PriceTable("EUR kg-1", dated=((1, 15, 3.5), (6, 1, 2.0)))
    times = np.array(["2010-01-14T23:00", "2010-01-15T00:00", "2010-05-31T23:00", "2010-06-01T00:00", "2011-01-01T00:00"], "datetime64[s]")
    hours = np.array([23.0, 0.0, 23.0, 0.0, 0.0])
    assert table.values(times, hours).tolist() == [2.0, 3.5, 3.5, 2.0, 2.0]
    ahead = (hours + 1.0) % 24.0  # the clock is an hour ahead of UTC: the day begins an hour earlier
    assert table.values(times, ahead).tolist() == [3.5, 3.5, 2.0, 2.0, 2.0]


def test_a_series_of_prices_may_stand_in_a_file(toys: Callable[..., TaskSpec], tmp_path: Path) -> None:
    (tmp_path / "market.csv").write_text("time,price\n2010-05-01T00:00,1.0\n2010-05-02T06:00,4.0\n", encoding="utf-8")
    hourly = next(line for line in TASK.splitlines() if line.startswith("hourly"))
    task = toys(hourly, 'file = "market.csv"')
    weather = task.disturbances()
    prices = task.price_tables["market"].values(weather.times, weather.hour_of_day)
    assert (prices == np.where(weather.times < np.datetime64("2010-05-02T06:00"), 1.0, 4.0)).all()
    (tmp_path / "market.csv").write_text("time,price\n2010-05-01T00:00,5.0\n", encoding="utf-8")
    assert set(get_task(task.source).price_tables["market"].values(weather.times, weather.hour_of_day)) == {5.0}
    (tmp_path / "market.csv").write_text("time,cost\n", encoding="utf-8")
    with pytest.raises(TaskError, match=r"\[price_tables.market\] file: .*market.csv has no line of titles above rows of values"):
        toys(hourly, 'file = "market.csv"', "Water a toy", "Water it")


def test_a_task_is_read_again_only_when_one_of_its_files_changes(write: Write, tmp_path: Path) -> None:
    base = write('base = "glbench/Schiphol2010-Delta10-v1"\nschema = 2\nid = "mylab/Base-v1"\ntitle = "Base"\n')
    own = tmp_path / "own.toml"
    own.write_text(f'base = "{base.name}"\nid = "mylab/Own-v1"\ntitle = "Own"\n', encoding="utf-8")
    first = get_task(own)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(library, "read_tables", None)
        assert get_task(own) is first
    base.write_text(base.read_text(encoding="utf-8") + "weather.days = 5\n", encoding="utf-8")
    assert get_task(own).weather.days == 5


def test_a_record_brings_the_task_back(toys: Callable[..., TaskSpec], write: Write) -> None:
    for task in (toys(), get_task(write(HARVEST))):
        again = task_of(definition_json(task))
        assert again == task
        assert again.digest == task.digest
    json.loads(definition_json(task))
    with pytest.raises(TaskError, match="changed copy"):
        definition_json(task.model_copy(update={"title": "Another"}))


def test_a_base_of_schema_1_is_converted(write: Write) -> None:
    task, base = get_task(write(HARVEST)), get_task("Schiphol2010-Delta10-v1")
    assert [item.name for item in task.ledger.items] == ["revenue", "standing", "cost_co2", "cost_electricity", "cost_heat"]
    same = get_task(write(HARVEST.split("[model]")[0].replace("Harvest-v1", "Same-v1")))
    assert {(i.name, i.flow, i.amount, i.factor, i.price) for i in same.ledger.items} == {
        (i.name, i.flow, i.amount, i.factor, i.price) for i in base.ledger.items
    }
    assert {q.name for q in same.quantities} - {"actuator_travel"} == {q.name for q in base.quantities}
    assert same.scenario.groups == (ParameterGroup("crop", base.uncertain_parameters(), "uniform", 0.1, "step"),)
    assert (same.uncertainty.delta, same.uncertainty.redraw) == (0.1, "step")
    one, other = make_accounts(base), make_accounts(same)
    assert (one.lowest_epi, one.highest_epi) == pytest.approx((other.lowest_epi, other.highest_epi), rel=1e-14)


def test_schema_1_cannot_have_a_base_of_schema_2(write: Write, tmp_path: Path) -> None:
    (tmp_path / "base.toml").write_text(TASK, encoding="utf-8")
    with pytest.raises(TaskError, match="has schema 2, which schema 1 cannot say"):
        get_task(write('base = "base.toml"\nschema = 1\nid = "a/B-v1"\ntitle = "x"\n'))
    own = write('base = "base.toml"\nid = "a/B-v1"\ntitle = "x"\nweather.days = 2\n')
    assert get_task(own).steps == 48


def test_the_harvest_is_paid_when_the_fruit_load_is_full(write: Write) -> None:
    """With cFruitMax = 300000 mg m-2 a full plant is picked: growth earns nothing any more, the harvest does."""
    task = get_task(write(HARVEST))
    model, p = task.model_value, task.parameters()
    most = p[model.parameter_names.index("cFruitMax")]
    assert most == 300000.0
    noon = 50
    weather = task.disturbances().values[noon]
    full = task.initial_state().copy()
    full[model.state_index("cFruit")] = 1.02 * most
    controls = np.zeros(6)
    rates = model.rhs(full, controls, weather, p)
    after = full + 900.0 * rates
    accounts = make_accounts(task)
    step = dict(zip(accounts.names, accounts.quantities(full[None], after[None], controls[None], np.zeros((3, 1)))[:, 0], strict=True))
    picked = after[model.state_index("sumMcFruitHar")]
    assert picked > 0.0
    assert step["revenue"] == pytest.approx(picked * 1e-6 / 0.065 * 1.6)
    assert step["standing"] < 0.0  # growth paid this, and nothing more, before
    assert step["revenue"] + step["standing"] == pytest.approx((rates[model.state_index("cFruit")] * 900.0 + picked) * 1e-6 / 0.065 * 1.6)


def test_a_scenario_is_read(write: Write) -> None:
    text = (
        HARVEST
        + """
[scenario]
family = "harvest"
salt = "2026"
years = [2009, 2011]
start_within_days = 14
parameters = [{ name = "leaves", parameters = ["sla", "laiMax"], half_width = 0.2, redraw = "day" }]
start = [{ states = ["cFruit"], half_width = 0.1 }]
"""
    )
    scenario = get_task(write(text)).scenario
    assert (scenario.family, scenario.salt, scenario.start_within_days, scenario.legacy) == ("harvest", "2026", 14, False)
    assert scenario.seasons == tuple(Season("schiphol", dt.date(year, 3, 1)) for year in (2009, 2011))
    assert scenario.groups == (ParameterGroup("leaves", ("sla", "laiMax"), "uniform", 0.2, "day"),)
    assert scenario.start_groups == (StartGroup("start 0", ("cFruit",), "uniform", 0.1),)
    legacy = get_task("Schiphol2010-Delta10-v1").scenario
    assert (legacy.legacy, len(legacy.seasons), legacy.groups[0].redraw) == (True, 1, "step")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('flow = "water"', 'flow = "watter"', "[ledger.cost_water] toy-1.0.0 has no flow 'watter'. Did you mean 'water'?"),
        ('stock = "mass"', 'stock = "fruit"', "[ledger.growth] toy-1.0.0 has no stock 'fruit'. Known: mass."),
        ('stock = "mass"', 'stock = "mass"\nflow = "water"', "[ledger.growth] It must name either a flow or a stock"),
        ('price = "market"', 'price = "markt"', "There is no price table 'markt'. Did you mean 'market'?"),
        ('"EUR kg-1" }', '"EUR kWh-1" }', "A price in EUR kWh-1 times an amount in kg m-2 is not in EUR m-2."),
        ("price = { value = 0.01, unit", "price = { value = 0.01, units", "Write the price with its unit"),
        ('side = "paid"', 'side = "bought"', '[ledger.cost_water] side = "bought" is not allowed. It must be "earned" or "paid".'),
        ('side = "paid"\nflow', 'side = "paid"\nflows', "'flows' is not a key of [ledger.cost_water]. Did you mean 'flow'?"),
        ("hourly = [1, 1,", "hourly = [1,", "[price_tables.market] hourly must have 24 prices, one an hour; it has 23."),
        (
            "hourly = [1, 1,", "hourly = [1, nan,",
            "[price_tables.market] hourly, hour 1 = nan is not allowed. It must be a finite number: hourly is 24 numbers, one an hour.",
        ),
        ("hourly = [1, 1,", 'hourly = [1, "x",', '[price_tables.market] hourly, hour 1 = "x" is not allowed. It must be a finite number'),
        ("price = { value = 0.01", "price = { value = nan", "[ledger.cost_water] price = nan is not allowed. price must be { value"),
        (
            'family = "toys"', 'family = "toys"\nyears = [2010, "x"]',
            '[scenario] years, entry 1 = "x" is not allowed. years must be a list of years.',
        ),
        ('family = "toys"', 'family = "toys"\nyears = [2010, 1887]', "covers 2008-01-01 00:00 to 2013-01-01 00:00 UTC, but 1887-"),
        ("hourly = ", 'from_day = { "02-31" = 1.0 }\nhourly = ', "must have exactly one of hourly"),
        ('id = "toy-1.0.0"', 'id = "toy-1.0.1"', "[model] There is no version 1.0.1 of the model 'toy'. Known: 1.0.0."),
        ('"uTap"', '"uTab"', "[actuation] There is no control called 'uTab'. Did you mean 'uTap'?"),
        ('"scales"', '"scale"', "[observation] toy-1.0.0 has no observation module 'scale'. Did you mean 'scales' or 'schedule'?"),
        ('"scales"', '"crop"', "toy-1.0.0 has no observation module 'crop'."),
        ('"seedling"', '"seed"', "[initial_state] toy-1.0.0 has no start 'seed'. Did you mean 'seedling'?"),
        ('["epi"]', '["scaled_epi"]', ""),
        ('family = "toys"', "", "[scenario] lacks the key 'family'"),
        ('family = "toys"', 'family = "toys"\nyears = [2010]\nseasons = [{ start = 2010-05-01 }]', "both seasons and years"),
        (
            'family = "toys"',
            'family = "toys"\nstart = [{ states = ["mas"], half_width = 0.1 }]',
            "[scenario.start] toy-1.0.0 has no state 'mas'. Did you mean 'mass'?",
        ),
        ("[reward]", '[constraints.co2]\nlow = 1.0\nhigh = 2.0\nunit = "ppm"\n[reward]', "needs the violation that costs 1 a step"),
        (
            "[reward]",
            '[constraints.co2]\nlow = 1.0\nhigh = 2.0\nunit = "ppm"\n[reward]\npenalty_scale = { co2 = { value = 1.0, unit = "ppm" } }',
            "[constraints] toy-1.0.0 has no air whose climate could be limited.",
        ),
        ("[ledger.cost_water]", "[ledger.penalty]", "'penalty' is the name of two columns."),
    ],
)  # fmt: skip
def test_a_mistake_is_told_in_words(toys: Callable[..., TaskSpec], old: str, new: str, words: str) -> None:
    if not words:  # the reward is made with the environment
        task = toys(old, new)
        with pytest.raises(TaskError, match="'scaled_epi' needs a profit that counts as 0"):
            make_reward(task, make_accounts(task))
        return
    with pytest.raises(TaskError) as caught:
        toys(old, new)
    assert words in str(caught.value)
    assert "mine.toml" in str(caught.value)


def test_a_profit_can_be_scaled_between_stated_bounds(toys: Callable[..., TaskSpec]) -> None:
    task = toys('modules = ["epi"]', 'modules = ["scaled_epi"]\nepi_scale = { low = -0.1, high = 0.3, unit = "EUR m-2" }')
    accounts = make_accounts(task)
    assert (accounts.lowest_epi, accounts.highest_epi) == (-0.1, 0.3)


def season(task: TaskSpec) -> dict[str, np.ndarray]:
    """Quantities of every step of a season under controls that repeat from day to day, one array each."""
    simulation = Simulation(task, 1, "fast")
    simulation.reset([1])
    names = task.model_value.control_names
    days = np.zeros((task.steps_per_day, 1, len(names)))
    hours = np.arange(task.steps_per_day) * task.step_seconds / 3600.0
    for name, values in (
        ("uBoil", np.where((hours < 7) | (hours > 19), 0.35, 0.1)),
        ("uCo2", np.where((hours > 7) & (hours < 19), 0.5, 0.0)),
        ("uLamp", np.where(hours < 18, 1.0, 0.0)),
        ("uVent", np.where((hours > 9) & (hours < 17), 0.1, 0.02)),
        ("uTap", np.where(hours < 12, 0.5, 0.0)),
    ):
        if name in names:
            days[:, 0, names.index(name)] = values
    steps = [simulation.step_controls(days[k % task.steps_per_day]).quantities for k in range(task.steps)]
    return {name: np.array([step[name][0] for step in steps]) for name in steps[0]}


def test_revenue_goes_on_after_day_30_where_the_harvest_is_paid(write: Write) -> None:
    """hps_2020: once a plant carries 300000 mg m-2 its fruit does not get heavier, and growth alone earns nothing."""
    text = HARVEST.replace("Delta10", "Delta00")
    paid = season(get_task(write(text)))
    growth = season(get_task(write(text.split("[ledger.revenue]")[0] + '[reward]\nmodules = ["epi", "scaled_penalty"]\n')))
    late = slice(30 * 96, None)
    assert growth["revenue"][late].sum() < 0.1
    assert paid["revenue"][late].sum() > 5.0
    np.testing.assert_allclose(paid["standing"], growth["revenue"], atol=1e-6)
    np.testing.assert_allclose(paid["epi"] - growth["epi"], paid["revenue"], atol=1e-6)


def test_a_season_of_another_model_with_prices_over_time(toys: Callable[..., TaskSpec]) -> None:
    task = toys()
    steps = season(task)
    assert steps["water"].sum() == pytest.approx(3 * 12 * 3600 * 1e-3 * 0.5)
    assert steps["epi"].sum() == pytest.approx(steps["growth"].sum() - steps["cost_water"].sum())
    gained = steps["mass_gained"].sum()
    assert gained > 0.01
    assert steps["growth"].sum() == pytest.approx(gained * 1.0, rel=1e-9)  # begins and ends at midnight, at 1 EUR kg-1
    assert (steps["reward"] == steps["epi"]).all()


def test_the_order_of_keys_in_a_file_changes_no_sum_and_no_digest() -> None:
    task = get_task("Lettuce-v1")
    written = task.as_tables()
    turned = TaskSpec.from_tables({**written, "ledger": dict(reversed(list(written["ledger"].items())))})

    assert turned.ledger == task.ledger
    assert turned.digest == task.digest
    assert [q.name for q in turned.quantities] == [q.name for q in task.quantities]
