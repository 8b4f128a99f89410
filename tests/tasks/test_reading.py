"""Mistakes in a task file are told in words: file, table, key, value, and what is allowed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from glbench.errors import TaskError, UnknownNameError
from glbench.tasks import get_task

Vary = Callable[..., Path]
START_TABLE = "[initial_state]"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("days = 60", "", "[weather] lacks the key 'days': a whole number of days"),
        ("days = 60", "days = 0", "[weather] days = 0 is not allowed. It must be a whole number of days, 1 to"),
        ("days = 60", "days = 1.5", "[weather] days = 1.5 is not allowed. It must be a whole number"),
        ("days = 60", 'days = "sixty"', '[weather] days = "sixty" is not allowed. It must be a whole number'),
        ("days = 60", "days = true", "[weather] days = true is not allowed. It must be a whole number"),
        ("step_seconds = 900", "step_seconds = 700", "[weather] step_seconds = 700 does not divide a day"),
        ("step_seconds", "step_second", "'step_second' is not a key of [weather]. Did you mean 'step_seconds'?"),
        ("start = 2010-03-01", 'start = "1 March"', '[weather] start = "1 March" is not allowed. It must be the first day'),
        ("start = 2010-03-01", "start = 2010-03-01T06:00:00", "It must be the first day, without quotes"),
        ('"paper"         #', '"papper" #', "There is no preprocessing called 'papper'. Did you mean 'paper'?"),
        ("co2_ppm = 400.0", "co2_ppm = -400.0", "[weather] co2_ppm = -400.0 is not allowed. It must be CO2 outside in ppm"),
        ("[weather]", "[wether]", "'wether' is not a key or table of a task. Did you mean 'weather'?"),
        ("[weather]", "[wether]", "the table [weather] is missing."),
        ('variant = "author"', 'variant = "auther"', "There is no model variant called 'auther'. Did you mean 'author'?"),
        ("value = 16.5, ", "value = nan, ", "[initial_state] air_temperature = nan is not allowed"),
        ('{ value = 16.5, unit = "degC" }', "16.5", "air_temperature = 16.5: Write it with its unit:"),
        ('16.5, unit = "degC"', '290.0, unit = "K"', 'Its unit is "degC", not "K": convert the value'),
        ("delta = 0.10", "delta = -0.1", "[uncertainty] delta = -0.1 is not allowed. It must be a fraction from 0"),
        ("delta = 0.10", "delta = 1.5", "[uncertainty] delta = 1.5 is not allowed. It must be a fraction from 0"),
        ("delta = 0.10", "delta = 10", "[uncertainty] delta = 10 is not allowed. It must be a fraction from 0"),
        ('redraw = "step"', 'redraw = "day"', '[uncertainty] redraw = "day" is not allowed. It must be "step" or "episode"'),
        ('"uniform"', '"normal"', "There is no distribution called 'normal'."),
        ('"crop", "time"', '"crops", "time"', "There is no observation module called 'crops'. Did you mean 'crop' or"),
        ('"crop", "time"', '"time", "time"', "'time' is listed twice."),
        ('"weather"]', '"weather", "forecast"]', "say how far it looks: add [observation.forecast] with steps = 48."),
        ("[actuation]", "[observation.forecast]\nsteps = 4\n[actuation]", "but no forecast among the modules"),
        ('"uBoil", "uCo2"', '"uBoiler", "uCo2"', "There is no control called 'uBoiler'. Did you mean 'uBoil'"),
        ('kind = "rate"', 'kind = "setpoint"', "There is no kind of actuation called 'setpoint'. Did you mean 'set_point'?"),
        ("low = 15.0, high = 34.0", "low = 34.0, high = 15.0", "[constraints.air_temperature] low = 34 must be below high"),
        ('high = 1600.0, unit = "ppm"', 'high = 1600.0, unit = "mg m-3"', '[constraints.co2] Its unit is "ppm", not "mg m-3"'),
        ('value = 0.09, unit = "EUR kWh-1"', 'value = 25, unit = "EUR GJ-1"', '[prices] heat = { value = 25, unit = "EUR GJ-1" }'),
        ('"scaled_epi", "scaled_penalty"', '"scaled_epy"', "no reward module called 'scaled_epy'. Did you mean 'scaled_epi' or"),
        ("runs = 30", "runs = 0", "[evaluation] runs = 0 is not allowed. It must be a whole number, 1 to"),
        ('metric = "reward"', 'metric = "yield"', "There is no metric called 'yield'."),
        ("penalty = 3.0", "", "[evaluation.failed_step] lacks the key 'penalty'"),
        ("schema = 1", "schema = 3", "schema = 3 is not allowed. It must be 1 or 2."),
        ('id = "mylab/', 'id = "', "It must be an id in quotes with a namespace and a version"),
        (START_TABLE, "[model.overrides]\nhAir = 5.0\n" + START_TABLE, 'Write hAir with its unit: hAir = { value = ..., unit'),
        ("value = 0.09, unit", "value = 0,09, unit", 'unit = "EUR kWh-1" }\': write 0.09, not 0,09. Correct that line'),
        ("[prices]", "[prices", "is no valid TOML: Expected ']' at the end of a table declaration (at line"),
    ],
)  # fmt: skip
def test_a_mistake_in_the_file_is_told_in_words(vary: Vary, old: str, new: str, words: str) -> None:
    path = vary(old, new)
    with pytest.raises(TaskError) as caught:
        get_task(path)
    assert words in str(caught.value)
    assert str(caught.value).startswith(str(path))
    assert "validation error" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"schiphol"', '"skiphol"', "[weather] There is no weather record 'skiphol'. Did you mean 'schiphol'?"),
        ("2010-03-01", "2007-12-31", "[weather] Weather 'schiphol' covers 2008-01-01"),
        ("2010-03-01", "2012-12-01", "29.01 days after its end are missing"),
        ('"benchmark"', '"bench"', "[model] There is no parameter set 'bench'. Did you mean 'benchmark'?"),
        ('"crop28"', '"crop29"', "[uncertainty] There is no set of crop parameters 'crop29'. Did you mean 'crop28'"),
        ('"crop28"', '["sla", "rgFruits"]', "[uncertainty] There is no parameter called 'rgFruits'. Did you mean 'rgFruit'"),
        ('"crop28"', '["cLeafMax"]', "follows from other parameters (cLeafMax = laiMax/sla)"),
        (
            START_TABLE,
            '[model.overrides]\nhAirr = { value = 5.0, unit = "m" }\n' + START_TABLE,
            "[model] The model has no parameter 'hAirr'. Did you mean 'hAir'",
        ),
        (
            START_TABLE,
            '[model.overrides]\nhAir = { value = 5.0, unit = "W" }\n' + START_TABLE,
            "[model] Parameter hAir (height of the main air, below the screens) is in m, not in 'W'.",
        ),
        (
            '"crop", "time"',
            '"published_crop", "crop", "time"',
            "[observation] 'canopy_temperature_24h' of 'crop' is shown by another module already.",
        ),
    ],
)  # fmt: skip
def test_what_model_or_weather_cannot_give_is_told_with_file_and_table(vary: Vary, old: str, new: str, words: str) -> None:
    path = vary(old, new)
    with pytest.raises(TaskError) as caught:
        get_task(path)
    assert words in str(caught.value)
    assert str(caught.value).startswith(str(path))


def test_all_mistakes_are_told_at_once(vary: Vary) -> None:
    with pytest.raises(TaskError, match="has 3 mistakes") as caught:
        get_task(vary("days = 60", "days = 0", "delta = 0.10", "delta = 2", "runs = 30", "run = 30\nruns = 3"))
    for words in ("days = 0", "delta = 2", "'run' is not a key of [evaluation]"):
        assert words in str(caught.value)


def test_a_file_that_is_not_there_or_not_text_is_said_to_be(tmp_path: Path) -> None:
    with pytest.raises(TaskError, match=r"There is no task file .*none\.toml"):
        get_task(tmp_path / "none.toml")
    broken = tmp_path / "broken.toml"
    broken.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(TaskError, match="Cannot read the task file"):
        get_task(broken)


def test_an_unknown_id_gets_the_nearest() -> None:
    with pytest.raises(UnknownNameError, match=r"Did you mean .*'glbench/Schiphol2010-Delta10-v1'"):
        get_task("glbench/Schiphol2010-Delta10-v2")
    with pytest.raises(UnknownNameError, match=r"Did you mean 'Schiphol2010-Delta10-v1'"):
        get_task("Schipol2010-Delta10-v1")


def test_ones_own_file_is_a_task_that_is_not_locked(vary: Vary) -> None:
    task = get_task(str(vary("days = 60", "days = 7", "runs = 30", "runs = 3")))
    assert (task.id, task.steps, task.locked) == ("mylab/Schiphol2010-Delta10-v1", 672, False)
    assert len(task.digest) == 64


def test_overridden_parameters_reach_the_vector_and_what_follows_from_them(vary: Vary) -> None:
    path = vary(START_TABLE, '[model.overrides]\nthetaLampMax = { value = 80, unit = "W m-2" }\n' + START_TABLE)
    task = get_task(path)
    assert task.parameters_by_name()["thetaLampMax"] == 80.0
    lamps = next(quantity for quantity in task.observed() if quantity.name == "lamps")
    assert lamps.high == 80.0
