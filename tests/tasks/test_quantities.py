"""What a task shows: names, order, units, bounds; and the card that tells an agent about them."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from glbench.errors import TaskError, UnknownNameError
from glbench.model import CONTROL_NAMES, LETTUCE, STATE_NAMES, TOMATO, VARIANTS, bounds
from glbench.model.units import same_unit
from glbench.report.task_words import definition_in_words
from glbench.tasks import MODEL_VARIANTS, OBSERVATION_MODULES, PAPER_TASK, PREPROCESSINGS, Registry, Word, get_task, list_tasks, task_card
from glbench.tasks import quantities as q
from glbench.tasks.ledger import MONEY
from glbench.vision import Library
from glbench.weather import PREPROCESSINGS as WEATHER_PREPROCESSINGS
from glbench.weather.series import SAMPLED

Vary = Callable[..., Path]

PAPER_COLUMNS = [
    ("air_temperature", "degC"), ("co2", "ppm"), ("relative_humidity", "%"), ("pipe_temperature", "degC"),
    ("fruit_dry_mass", "kg m-2"), ("canopy_temperature_24h", "degC"), ("temperature_sum", "degC day"),
    ("sin_hour_of_day", "-"), ("cos_hour_of_day", "-"), ("sin_day_of_year", "-"), ("cos_day_of_year", "-"),
    ("boiler", "W m-2"), ("co2_supply", "mg m-2 s-1"), ("thermal_screen", "-"),
    ("vents", "-"), ("lamps", "W m-2"), ("blackout_screen", "-"),
    ("global_radiation", "W m-2"), ("outdoor_temperature", "degC"), ("outdoor_relative_humidity", "%"),
    ("outdoor_co2", "ppm"), ("wind_speed", "m s-1"),
]  # fmt: skip


def context(
    days: int = 60, forecast_steps: int = 0, forecast_hours: tuple[int, ...] = (), holds: tuple[tuple[str, float], ...] = (), **prices: Any
) -> q.ObservationContext:
    parameters = get_task(PAPER_TASK).parameters_by_name()
    return q.ObservationContext(days * 96, 900.0, forecast_steps, parameters, TOMATO, forecast_hours, holds, **prices)


def test_the_papers_22_values_come_in_its_order_and_units() -> None:
    assert [(column.name, column.unit) for column in get_task(PAPER_TASK).observed()] == PAPER_COLUMNS


def test_the_controls_reach_the_papers_capacities() -> None:
    at_one = {c.name: (c.at_one, c.unit) for c in task_card(get_task(PAPER_TASK)).controls}
    assert at_one == {
        "uBoil": (130.0, "W m-2"), "uCo2": (5.0, "mg m-2 s-1"), "uThScr": (1.0, "-"),
        "uVent": (1.0, "-"), "uLamp": (116.0, "W m-2"), "uBlScr": (1.0, "-"),
    }  # fmt: skip


def test_every_module_has_finite_bounds_units_and_different_names(shipped_words: dict[str, list[str]]) -> None:
    tomato = context(
        forecast_steps=3,
        forecast_hours=(1, 24),
        holds=(("uLamp", 30.0),),
        prices=(("power", "EUR kWh-1", -0.1, 0.4),),
        day_ahead=("power",),
        day_ahead_hours=(1, 12),
        scheduled_controls=("uBlScr",),
    )
    lettuce = dataclasses.replace(tomato, model=LETTUCE, library=Library.open("lettuce"))
    for name in shipped_words["observation module"]:
        columns = OBSERVATION_MODULES[name].quantities(lettuce if name == q.CAMERA else tomato)
        assert columns
        assert len({column.name for column in columns}) == len(columns)
        for column in columns:
            assert math.isfinite(column.low)
            assert math.isfinite(column.high)
            assert column.low < column.high
            assert column.unit
            assert column.meaning


def test_the_published_codes_263_columns_can_be_asked_for(vary: Vary) -> None:
    modules = (
        '"published_indoor_climate", "published_crop", "control_fractions", "weather", "step_counter", '
        '"published_time", "published_forecast"'
    )
    path = vary(
        '"indoor_climate", "crop", "time", "controls", "weather"', modules,
        "[actuation]", "[observation.forecast]\nsteps = 48\n[actuation]",
        'timing = "current"', 'timing = "published"',
    )  # fmt: skip
    names = [column.name for column in get_task(path).observed()]
    assert len(names) == 263
    assert names[:4] == ["co2", "air_temperature", "relative_humidity", "pipe_temperature"]
    assert names[18:23] == ["step_counter", "sin_day_of_year", "cos_day_of_year", "sin_hour_of_day", "cos_hour_of_day"]
    assert names[25] == "outdoor_vapour_pressure_ahead_1"
    assert names[-1] == "wind_speed_ahead_48"


def test_the_full_state_has_the_names_of_the_model_in_its_order() -> None:
    columns = OBSERVATION_MODULES["full_state"].quantities(context())
    assert tuple(column.name for column in columns) == STATE_NAMES
    assert {column.unit for column in columns} == {"mg m-3", "degC", "Pa", "mg m-2", "degC day", "day"}


def test_at_the_hottest_bound_the_cover_gives_off_more_than_anything_can_supply() -> None:
    """1500 W m-2 of sun at 60 degC, all of it absorbed, with boiler and lamps; no wind, sky as warm as the air."""
    p = get_task(PAPER_TASK).parameters_by_name()
    supplied = 1500.0 + p["pBoil"] / p["aFlr"] + p["thetaLampMax"]
    emissivity = 1.0 - p["tauRfFir"] - p["rhoRfFir"]
    radiated = emissivity * 5.67e-8 * ((bounds.HOTTEST + 273.15) ** 4 - (60.0 + 273.15) ** 4)
    convected = p["aCov"] / p["aFlr"] * p["cHecOut1"] * (bounds.HOTTEST - 60.0)
    assert radiated + convected > 1.3 * supplied


def test_the_highest_co2_is_a_dose_that_never_stops_in_a_house_that_hardly_leaks() -> None:
    # 60 days: 5 mg m-2 s-1 x 5 184 000 s / 5.7 m = 4.547e6 mg m-3, less than the leaks' balance 5/(0.1 x 3e-5 x 0.25)
    assert bounds.highest_co2_density(context(60).horizon) == 4.8e6
    # ten years: 5/7.5e-7 = 6.667e6 mg m-3 is the balance with the leaks, whatever the time
    assert bounds.highest_co2_density(context(3660).horizon) == 6.9e6


def test_the_card_tells_what_an_agent_may_know_and_neither_weather_nor_seeds() -> None:
    card = task_card(get_task(PAPER_TASK))
    assert (card.steps, card.step_seconds, card.clock, card.place.timezone) == (5760, 900.0, "UTC", "Europe/Amsterdam")
    assert card.action_names == CONTROL_NAMES
    assert {(action.low, action.high) for action in card.actions} == {(-1.0, 1.0)}
    assert (card.actuation, card.max_change, card.delta, card.half_width) == ("rate", 0.1, 0.1, 0.1)
    assert [(c.name, c.unit, c.low, c.high, c.scale) for c in card.constraints] == [
        ("air_temperature", "degC", 15.0, 34.0, 15.0),
        ("co2", "ppm", 300.0, 1600.0, 2500.0),
        ("relative_humidity", "%", 50.0, 85.0, 15.0),
    ]
    assert card.prices.electricity == 0.3
    told = json.dumps(dataclasses.asdict(dataclasses.replace(card, definition="")), default=str)
    assert "seed" not in told
    assert len(told) < 10000  # no series hides in it
    definition = json.loads(card.definition)
    assert definition["evaluation"]["first_seed"] == 0  # the file has to have one
    assert "666" not in card.definition
    assert len(card.definition) < 10000


def test_set_points_are_asked_for_between_0_and_1(vary: Vary) -> None:
    task = get_task(vary('kind = "rate"', 'kind = "set_point"', '"uBoil", "uCo2", ', '"uCo2", '))
    card = task_card(task)
    assert {(action.low, action.high) for action in card.actions} == {(0.0, 1.0)}
    assert len(card.actions) == 5
    assert len(card.controls) == 6


def test_the_vocabulary_has_the_words_of_model_and_weather() -> None:
    assert set(MODEL_VARIANTS.names) == set(VARIANTS)
    assert set(PREPROCESSINGS.names) == {*WEATHER_PREPROCESSINGS, SAMPLED}


def test_a_registry_takes_a_new_word_once_and_names_the_nearest() -> None:
    words: Registry[Word] = Registry("colour")
    words.add(Word("green", "as leaves"))
    assert "green" in words
    assert words["green"].meaning == "as leaves"
    with pytest.raises(TaskError, match="There is a colour called 'green' already"):
        words.add(Word("green", "as money"))
    with pytest.raises(UnknownNameError, match=r"There is no colour called 'gren'. Did you mean 'green'\?"):
        words["gren"]


def test_every_price_has_its_unit_and_fresh_fruit_is_not_called_carbohydrate() -> None:
    lines = {line.split(":")[0]: line for name in ("Spring-v1", "SpringEnergy-v1") for line in get_task(name).ledger.lines()}
    assert lines["+ revenue_harvest"] == (
        "+ revenue_harvest: 15.38 times the carbohydrate of the fruit harvested [kg m-2] x 1.6 EUR kg-1"
    ), "6.5 % dry matter"
    assert lines["+ revenue_buffer"].startswith("+ revenue_buffer: heat in the buffer [kWh m-2] x 0.042 EUR kWh-1"), "MJ"
    assert lines["- cost_engine"] == "- cost_engine: time that the engine runs [h] x 0.0003 EUR m-2 h-1"
    heads = next(item for item in get_task("Lettuce-v1").ledger.items if item.name == "revenue")
    assert heads.price_unit == "EUR"
    for task in list_tasks():
        for item in task.ledger.items:
            assert same_unit(f"{item.price_unit} {item.amount_unit}", MONEY), (task.id, item.name)
    rows = {row[0]: row[2] for one in definition_in_words(get_task("SpringEnergy-v1")) if one.heading == "Prices" for row in one.rows}
    assert rows["Wear of the engine"] == "0.0003 EUR per m2 and h"
