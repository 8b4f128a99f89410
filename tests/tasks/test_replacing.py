"""A task changed in Python is the task of a file that names the same base and says the same."""

from __future__ import annotations

import datetime as dt
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from glbench.env import GreenhouseEnv, GreenhouseVectorEnv, Simulation
from glbench.episodes.header import definition_json, task_of
from glbench.errors import TaskError
from glbench.evaluation import evaluate, result_path
from glbench.tasks import TaskSpec, get_task
from glbench.training.season_search import SearchSettings, search
from glbench.verification import verify

Write = Callable[[str], Path]
PAPER, SPRING = "glbench/Schiphol2010-Delta10-v1", "glbench/Spring-v1"
TEST_ALONE = {"splits.test": {"years": [2012], "seasons": 3}}
ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("base", "text", "changes"),
    [
        (
            PAPER,
            'weather.start = 2011-03-01\nprices.heat = { value = 0.12, unit = "EUR kWh-1" }',
            {"weather.start": "2011-03-01", "prices.heat.value": 0.12},
        ),
        (PAPER, "[weather]\ndays = 30", {"weather": {"days": np.int64(30)}}),
        (
            PAPER,
            'schema = 2\nwithout = ["scenario.parameters"]\nscenario.years = [2010, 2011]',
            {"schema": 2, "scenario": {"parameters": None, "years": (2010, 2011)}},
        ),
        (SPRING, 'without = ["sensors"]\nweather.days = 30', {"weather.days": 30, "sensors": None}),
        (
            SPRING,
            'without = ["sensors"]\n[sensors.co2]\nnoise = { value = 5.0, unit = "ppm" }',
            {"without": ["sensors"], "sensors.co2.noise": {"value": 5.0, "unit": "ppm"}},
        ),
        (SPRING, "[splits.test]\nseasons = 7", {"splits.test.seasons": 7}),
        (SPRING, "[splits.test]\nyears = [2012]\nseasons = 3", TEST_ALONE),
    ],
)
def test_a_changed_task_is_that_of_a_file_with_its_base(base: str, text: str, changes: dict[str, Any], write: Write) -> None:
    ours = get_task(base).replace(changes, id="mylab/Own-v1", title="Own")
    theirs = get_task(write(f'base = "{base}"\nid = "mylab/Own-v1"\ntitle = "Own"\n{text}\n'))
    assert ours.definition() == theirs.definition()
    assert (ours.digest, ours.base, ours.changes) == (theirs.digest, theirs.base, theirs.changes)
    assert ours.split == theirs.split
    assert ours.digest != get_task(base).digest


def test_keys_with_dots_tables_in_tables_and_keywords_mean_the_same() -> None:
    base = get_task(PAPER)
    one = base.replace({"weather.days": 30, "weather.start": dt.date(2011, 3, 1)})
    assert one == base.replace({"weather": {"days": 30}}, weather={"start": "2011-03-01"})
    assert one == base.replace(weather={"days": 30, "start": "2011-03-01"})
    assert one.weather.days == 30
    assert base.weather.days == 60, "the base stays what it is"


def test_without_an_id_a_changed_task_is_mine() -> None:
    task = get_task(SPRING).replace({"weather.days": 30})
    assert (task.id, task.title, task.suites) == ("my/Spring-v1", f"{get_task(SPRING).title}, changed", ())
    assert not task.locked
    again = task.replace({"weather.days": 20})
    assert (again.id, again.base, [change.key for change in again.changes]) == ("my/Spring-v1", "my/Spring-v1", ["weather.days"])


@pytest.mark.parametrize("split", ["training", "validation", "test"])
def test_the_split_stays(split: str) -> None:
    assert get_task(SPRING).in_split(split).replace({"weather.days": 30}).split == split


def test_of_splits_without_years_the_numbers_alone_change() -> None:
    base = get_task(SPRING).splits
    found = get_task(SPRING).replace({"splits.test.seasons": 7, "splits.validation": None}).splits
    assert base is not None
    assert found is not None
    assert (found.training, found.validation) == (base.training, None)
    assert (found.test.years, found.test.seasons) == (base.test.years, 7)


@pytest.mark.parametrize(
    ("base", "changes", "words"),
    [
        (PAPER, {"weather.days": 0}, "my/Schiphol2010-Delta10-v1 (base glbench/Schiphol2010-Delta10-v1): [weather] days = 0 is"),
        (PAPER, {"weather.dayz": 10}, "'dayz' is not a key of [weather]. Did you mean 'days'?"),
        (PAPER, {"wether.days": 10}, "'wether' is not a key or table of a task. Did you mean 'weather'?"),
        (PAPER, {"prices.heat": 0.1}, '[prices] heat = 0.1: Write it with its unit: { value = ..., unit = "EUR kWh-1" }.'),
        (PAPER, {"prices.heat": {"value": 3, "unit": "EUR MJ-1"}}, 'Its unit is "EUR kWh-1", not "EUR MJ-1"'),
        (PAPER, {"weather.days": 10, "weather": {"days": 3}}, "weather.days is given twice"),
        (PAPER, {"weather.days": 10, "weather": 3}, "weather is given twice"),
        (PAPER, {"sensors": None}, '"glbench/Schiphol2010-Delta10-v1" has no "sensors" to leave out'),
        (PAPER, {"weather.dais": None}, 'has no "weather.dais" to leave out. Did you mean \'days\'?'),
        (PAPER, {"weather.days": None}, "[weather] lacks the key 'days'"),
        (PAPER, {"id": SPRING}, "'glbench/Spring-v1' is the id of a task that comes with glbench"),
        (PAPER, {"id": PAPER}, 'replace(..., id="my/Schiphol2010-Delta10-v1")'),
        (PAPER, {"id": "Own"}, "must be an id in quotes with a namespace and a version"),
        (PAPER, {"weather.start": "1 March"}, 'start = "1 March" is not allowed. It must be the first day'),
        (PAPER, {"weather.start": "2035-03-01"}, "2035-03-01 00:00 to 2035-04-30 00:15 UTC was asked for"),
        (PAPER, {"weather.source": "nowhere"}, "There is no weather record 'nowhere'"),
        (PAPER, {"weather.days": object()}, "weather.days is a value of the type object"),
        (PAPER, {"weather.days": 10**30}, "days is a whole number beyond 64 bits"),
        (PAPER, {3: 4}, "3 is not a key of a task"),
        (PAPER, {"weather..days": 4}, "'weather..days' is not a key of a task"),
        (PAPER, {"base": SPRING}, "'base' is not a key or table of a task"),
        (PAPER, {"price_tables.gas": {"unit": "EUR kWh-1", "file": "nothing.csv"}}, 'Cannot read nothing.csv: No such file or directory'),
        (SPRING, {"schema": 1}, "has schema 2, which schema 1 cannot say"),
        (SPRING, {"splits.training.years": [2011]}, "the table [splits.test] is missing"),
        (
            SPRING,
            {"splits.training": {"years": [2011], "seasons": 2}, "splits.test": {"years": [2011], "seasons": 2}},
            "[splits] training and test share the year 2011: no season that scores may be seen before.",
        ),
        (SPRING, {"splits": None}, "my/Spring-v1 (base glbench/Spring-v1): [scenario] generated = true needs [splits]"),
        (
            SPRING,
            {"splits.test": {"years": [2019], "seasons": 3}},
            "my/Spring-v1: [splits.test] The year 2019 is not wholly in weather 'schiphol'",
        ),
        (SPRING, {"splits.test.seasons": 0}, "[splits.test] seasons = 0 is not allowed"),
        (SPRING, {"sensors.co2.noise": {"value": 1.0, "unit": "degC"}}, '[sensors.co2] noise = { value = 1.0, unit = "degC" }: Its'),
        (SPRING, {"observation.forecast": None}, "'weather_forecast' is among the modules, so say how far it looks"),
        (SPRING, {"observation.forecast.error": "huge"}, "There is no level of forecast errors called 'huge'"),
        (SPRING, {"scenario.co2_range": None, "scenario.generated": False}, "but they are not generated"),
        (SPRING, {"without": "sensors"}, 'without = "sensors" must be a list of tables or keys of the base'),
    ],
)  # fmt: skip
def test_a_mistake_is_told_with_key_and_value(base: str, changes: dict[Any, Any], words: str) -> None:
    with pytest.raises(TaskError) as caught:
        get_task(base).replace(changes)
    assert words in str(caught.value)
    assert len(str(caught.value)) < 500


def test_changes_are_a_mapping() -> None:
    with pytest.raises(TaskError, match=r"a mapping such as .*; got \['weather'\]"):
        get_task(PAPER).replace(["weather"])  # type: ignore[arg-type]


def test_leaving_out_needs_a_base(write: Write, own_text: str) -> None:
    with pytest.raises(TaskError, match="there is no base"):
        get_task(write(f'without = ["sensors"]\n{own_text}'))


def test_what_is_left_out_is_among_the_changes() -> None:
    changes = get_task(SPRING).replace({"sensors": None, "splits.training": None, "splits.validation": None}).changes
    assert [(change.key, change.value) for change in changes] == [
        ("splits.training", None), ("splits.validation", None), ("sensors", None),
    ]  # fmt: skip
    assert all(change.before for change in changes)


@pytest.mark.parametrize("make", [gymnasium.make, gymnasium.make_vec])
def test_gymnasium_takes_overrides(make: Callable[..., Any]) -> None:
    env = make(SPRING, overrides={"weather.days": 2, "sensors": None}, split="validation", kernel="fast")
    task = env.unwrapped.task
    assert task == get_task(SPRING).replace({"weather.days": 2}, sensors=None).in_split("validation")
    assert (task.split, task.sensors, task.steps) == ("validation", None, 192)
    env.reset(seed=3)
    assert env.spec.to_json(), "a spec with overrides can be written"
    env.close()


def test_environments_of_equal_changes_share_one_task() -> None:
    one, other = (GreenhouseEnv(SPRING, overrides={"weather.days": 2}) for _ in range(2))
    assert one.task is other.task
    assert pickle.loads(pickle.dumps(one.task)) == one.task


def test_environments_of_a_test_alone_show_seasons_that_are_not_scored() -> None:
    task = get_task(SPRING).replace(TEST_ALONE)
    assert (task.split, task.scored is task, task.chosen_on is task) == ("test", True, True)
    for make in (GreenhouseEnv, GreenhouseVectorEnv):
        for preview in (make(task).task, make(SPRING, overrides=TEST_ALONE).task):
            assert (preview.split, preview.season_years) == ("preview", (2008, 2009, 2010))
        assert make(SPRING, overrides=TEST_ALONE, split="test").task == task
    with pytest.raises(TaskError, match="has no split 'training'"):
        GreenhouseEnv(task, split="training")
    assert Simulation(task, 1, "fast").task is task, "what evaluates asks for no split"


def test_nothing_is_trained_on_a_test_alone(tmp_path: Path) -> None:
    task, policy = get_task(SPRING).replace(TEST_ALONE), tmp_path / "policy.npz"
    policy.touch()
    with pytest.raises(TaskError, match="has no training split"):
        search(task, SearchSettings.of(policy), tmp_path / "tuned")
    assert not (tmp_path / "tuned").exists()


@pytest.mark.parametrize("base", [PAPER, SPRING])
def test_a_record_brings_a_changed_task_back(base: str) -> None:
    task = get_task(base).replace({"weather.days": 2, "evaluation.runs": 2})
    again = task_of(definition_json(task))
    assert (again.digest, again.definition()) == (task.digest, task.definition())
    assert again.replace({"weather.days": 3}).steps == 3 * 96, "what a record brings back can be changed"
    assert TaskSpec.from_tables(task.as_tables()).digest == task.digest


def test_an_unchecked_copy_of_schema_1_can_be_changed_and_one_of_schema_2_says_why_not() -> None:
    paper, spring = (get_task(base) for base in (PAPER, SPRING))
    days = {"weather": paper.weather.model_copy(update={"days": 3})}
    assert paper.model_copy(days).replace({"evaluation.runs": 2}).steps == 3 * 96
    with pytest.raises(TaskError, match=r"changed copy of a task.*Make it with replace"):
        spring.model_copy(days).replace({"evaluation.runs": 2})


@pytest.mark.parametrize("base", [PAPER, SPRING])
def test_a_result_of_a_changed_task_verifies(base: str, tmp_path: Path) -> None:
    days = {"weather.days": 1, "evaluation.runs": 2}
    task = get_task(base).replace(days | ({"sensors": None, "splits.test.seasons": 2} if base == SPRING else {}))
    result = evaluate(task, ROOT / "submissions" / "do_nothing.py", out=tmp_path)
    assert result.task.digest == task.digest
    assert verify(result_path(tmp_path, task.id, result.agent.name)).outcome == "reproduced"
