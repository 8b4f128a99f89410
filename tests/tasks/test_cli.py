"""``glbench tasks list | show | check | lock``."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from glbench.cli.console import messages, output
from glbench.cli.tasks import app
from glbench.env import run_weather
from glbench.errors import TaskError, UnknownNameError
from glbench.model import GreenLightClimate, VanthoorTomato, compose, paper, register_model
from glbench.resources import data_folder
from glbench.tasks import DEFAULT_TASK, get_task, list_tasks, references
from tests.tasks.names import FILE, SHORT_ID

Vary = Callable[..., Path]


@pytest.fixture(autouse=True)
def wide(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A terminal of 200 columns, for these tests alone: the consoles remember the width they were made for."""
    monkeypatch.setenv("COLUMNS", "200")
    for console in (output, messages):
        console.cache_clear()
    yield
    for console in (output, messages):
        console.cache_clear()


def run(*arguments: str) -> Result:
    return CliRunner().invoke(app, list(arguments))


def machine(*arguments: str) -> Any:
    result = run(*arguments, "--json")
    return json.loads(result.stdout)


def test_list_shows_every_task_in_words_under_its_suite(published: Path) -> None:
    result = run("list")
    assert result.exit_code == 0
    assert "Suite paper\n60 days from 1 March 2010, step 15 min, weather 'schiphol', prepared 'paper'" in result.stdout
    row = next(line for line in result.stdout.splitlines() if SHORT_ID in line)
    digest = get_task(SHORT_ID).digest
    assert " ".join(row.split()) == f"{SHORT_ID} Schiphol, spring 2010, crop ±10 % 10 % {digest[:8]}"


def test_list_shows_suite_by_suite_and_the_default_task_first() -> None:
    listed = machine("list")
    assert listed[0]["id"] == DEFAULT_TASK
    suites = [tuple(entry["suites"]) for entry in listed]
    assert suites == sorted(suites, key=suites.index), "tasks of a suite stand together"
    assert not any(suites[suites.index(()) :] if () in suites else ()), "those in no suite come last"
    shown = run("list").stdout
    (first,), default = listed[0]["suites"], DEFAULT_TASK.rpartition("/")[2]
    assert shown.index(f"Suite {first}\n") < shown.index(default) < shown.index("Suite paper\n")
    assert shown.index("Spring-v1") < shown.index("SpringMismatch-v1") < shown.index("Suite paper\n")
    assert [shown.count(f"Suite {name}\n") for name in (first, "energy", "transfer")] == [1, 1, 1]
    tests = {entry["id"]: (entry.get("splits") or {}).get("test") for entry in listed}
    assert tests["glbench/Spring-v1"] == {"years": [2011, 2012], "seasons": 100}
    transfer = {entry["id"] for entry in machine("list", "--suite", "transfer")}
    assert transfer == {task.id for task in list_tasks() if "transfer" in task.suites} != set()


def test_list_for_machines_has_ids_periods_and_digests(published: Path) -> None:
    listed = machine("list")
    assert [entry["id"] for entry in listed] == [f"glbench/{SHORT_ID}", "glbench/Schiphol2010Code-Delta30-v1"]
    assert listed[0] == listed[0] | {
        "days": 60, "step_seconds": 900.0, "steps": 5760, "delta": 0.1, "half_width": 0.1, "weather": "schiphol",
        "start": "2010-03-01", "locked": True, "digest": get_task(SHORT_ID).digest,
    }  # fmt: skip
    assert listed[1]["half_width"] == 0.15


def test_list_can_be_narrowed_to_a_suite(published: Path) -> None:
    assert [entry["id"] for entry in machine("list", "--suite", "paper")] == [f"glbench/{SHORT_ID}"]
    with pytest.raises(UnknownNameError, match=r"There is no suite 'papers'. Did you mean 'paper'"):
        CliRunner().invoke(app, ["list", "--suite", "papers"], catch_exceptions=False)


def test_show_explains_period_limits_prices_and_reward_with_units() -> None:
    result = run("show", SHORT_ID)
    assert result.exit_code == 0
    for words in (
        "60 days, from 1 March 2010 00:00 to 30 April 2010 00:00, clock UTC (Europe/Amsterdam is UTC+1 h and later UTC+2 h)",
        "one decision every 15 min, 5760 in all.",
        "KNMI 240, Amsterdam Schiphol, 52.318 N, 4.79 E",
        "at every step each of 28 parameters is its nominal value times 1 + e, e uniform within ±10 %",
        "What the agent sees: 22 values",
        "130 W m-2",
        "0.5 mg m-2 s-1",
        "1600 ppm",
        "0.09 EUR per kWh",
        "reward = scaled_epi + scaled_penalty",
        "lowest -0.012975 EUR m-2",
        "highest 0.00726646 EUR m-2",
        "30 runs with the seeds 666 to 695",
    ):
        assert words in result.stdout


def test_show_tells_seasons_draws_sensors_forecast_and_what_violations_cost() -> None:
    shown = " ".join(run("show", "Spring-v1").stdout.split())
    for words in (
        "60 days from 15 February, up to 28 days later, another for every season, clock Europe/Amsterdam",
        "CO2 outside wanders between 390 and 420 ppm.",
        "Training: 256 seasons, put together from days of 2008, 2009 and 2010.",
        "Validation, to choose between agents: 30 other seasons, put together from days of 2008, 2009 and 2010.",
        "Test, which scores: 100 seasons, put together from days of 2011 and 2012.",
        "Uncertain, drawn once a run, 'leaf' (uniform, ±10 %): laiMax, sla.",
        "Drawn at the start, 'start' (uniform, ±20 %): cLeaf, cFruit, cBuf.",
        "CO2: noise 30 ppm at every step, bias 30 ppm for a run (both standard deviations), drift of up to 60 ppm by the end.",
        "Each hangs at its last value every 10 days for 1 h, both on average.",
        "Forecast by the hour, 1, 2, 3, 6, 12, 18, 24 h ahead; errors 'medium': errors that grow with the hours ahead",
        "Price of a violation",
        "0.0054 EUR m-2 degC-1 h-1",
    ):
        assert words in shown


def test_show_tells_a_test_alone_and_what_is_left_out(tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    own.write_text(
        """
        base = "glbench/Spring-v1"
        id = "mylab/Own-v1"
        title = "The real spring of 2012"
        without = ["sensors", "scenario.generated", "scenario.co2_range"]
        splits.test.years = [2012]
        """,
        encoding="utf-8",
    )
    shown = " ".join(run("show", str(own)).stdout.split())
    for words in (
        "sensors is left out (there { ",
        "splits.training is left out (there { years = [2008, 2009, 2010], seasons = 256 })",
        "splits.test.years = [2012] (there [2011, 2012])",
        "Test, which scores: the seasons of 2012.",
        "Nothing can be learned here: agents come from glbench/Spring-v1.",
        "drawn evenly for every run",
    ):
        assert words in shown
    assert "Sensors inside" not in shown
    result = run("check", str(own))
    assert (result.exit_code, "valid, not published" in result.stdout) == (0, True)


def test_show_tells_every_price_and_every_season(vary: Vary, tmp_path: Path) -> None:
    hours = ", ".join(["0.04"] * 7 + ["0.08"] * 16 + ["0.04"])
    own = tmp_path / "own.toml"
    own.write_text(
        f"""
        base = "glbench/{SHORT_ID}"
        schema = 2
        id = "mylab/Own-v1"
        title = "Prices of the hour"
        weather.days = 5
        scenario.years = [2010, 2011, 2012]
        scenario.start_within_days = 14
        ledger.cost_heat.price = "heat"
        ledger.cost_electricity.price = "power"
        ledger.cost_co2.price = "co2"
        price_tables.heat = {{ unit = "EUR kWh-1", hourly = [{hours}] }}
        price_tables.power = {{ unit = "EUR kWh-1", from_day = {{ "01-15" = 0.2, "10-01" = 0.3 }} }}
        price_tables.co2 = {{ unit = "EUR kg-1", series = [{{ time = 2010-01-01T00:00:00, price = 0.25 }}] }}
        reward.modules = ["epi", "scaled_penalty"]
        """,
        encoding="utf-8",
    )
    shown = " ".join(run("show", str(own)).stdout.split())
    assert "5 days from 1 March 2010, 2011 or 2012, up to 14 days later, drawn evenly for every run" in shown
    assert "Price 'heat' [EUR kWh-1]: 00:00 to 07:00 0.04, 07:00 to 23:00 0.08, 23:00 to 24:00 0.04." in shown
    assert "Price 'power' [EUR kWh-1]: from 15 January 0.2, from 1 October 0.3." in shown
    assert "Price 'co2' [EUR kg-1]: from 2010-01-01 00:00 UTC 0.25." in shown
    assert f"hourly = [{hours}]" in shown
    assert "..." not in shown


def test_a_scaled_profit_without_bounds_is_told_by_check(tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    own.write_text(
        f"""
        base = "glbench/{SHORT_ID}"
        schema = 2
        id = "mylab/Own-v1"
        title = "Fruit on the plants is sold"
        ledger.standing = {{ side = "earned", stock = "fruit", price = {{ value = 1e-6, unit = "EUR mg-1" }} }}
        """,
        encoding="utf-8",
    )
    result = run("check", str(own))
    assert result.exit_code == 1
    assert "'scaled_epi' needs a profit that counts as 0" in result.stdout


def test_show_for_machines_holds_card_definition_and_digests() -> None:
    shown = machine("show", SHORT_ID)
    task = get_task(SHORT_ID)
    assert shown["digest"] == shown["fingerprint"]["digest"] == task.digest
    assert shown["definition"] == task.definition()
    assert len(shown["card"]["observations"]) == 22
    assert shown["uncertain_parameters"] == list(task.uncertain_parameters())


def test_check_accepts_published_tasks(published: Path) -> None:
    result = run("check")
    assert result.exit_code == 0
    assert result.stdout.count("as published") == 2
    assert [entry["ok"] for entry in machine("check")] == [True, True]


def test_drafts_are_listed_and_checked(published: Path) -> None:
    drafts = published / "drafts"
    drafts.mkdir()
    text = (published / FILE).read_text(encoding="utf-8")
    (drafts / "winter-v1.toml").write_text(text.replace(SHORT_ID, "Winter-v1"), encoding="utf-8")
    assert re.search(r"Winter-v1 .* draft", run("list").stdout)
    assert [(entry["id"].rpartition("/")[2], entry["locked"]) for entry in machine("list")] == [
        (SHORT_ID, True), ("Winter-v1", False), ("Schiphol2010Code-Delta30-v1", True),
    ], "each in its suite"  # fmt: skip
    assert re.search(r"ok +glbench/Winter-v1  \w{8}  draft, valid", run("check").stdout)
    (drafts / "winter-v1.toml").write_text(text.replace("days = 60", "days = 0"), encoding="utf-8")
    result = run("check")
    assert result.exit_code == 1
    assert "drafts/winter-v1.toml" in result.stdout


def test_check_finds_changed_new_and_lost_tasks_and_leaves_with_1(published: Path) -> None:
    text = (published / FILE).read_text(encoding="utf-8")
    (published / FILE).write_text(text.replace("delta = 0.10", "delta = 0.12"), encoding="utf-8")
    (published / "winter-v1.toml").write_text(text.replace(SHORT_ID, "Winter-v1"), encoding="utf-8")
    (published / "schiphol2010code-delta30-v1.toml").unlink()
    result = run("check")
    assert result.exit_code == 1
    assert f"tasks/{FILE} no longer matches tasks/lock.toml" in result.stdout
    assert "tasks/winter-v1.toml is not locked yet. Publish it with `glbench tasks lock`." in result.stdout
    assert "its file tasks/schiphol2010code-delta30-v1.toml is gone" in result.stdout
    assert run("check", "--json").exit_code == 1
    assert [entry["ok"] for entry in machine("check")] == [False, False, False]


def test_check_asks_for_a_namespace_of_ones_own(vary: Vary) -> None:
    shown = run("check", str(vary("mylab/Schiphol2010-Delta10-v1", "glbench/Own-v1"))).stdout
    assert "valid, not published; use a namespace of your own: glbench/" in " ".join(shown.split())


def test_check_shows_the_first_weather_of_ones_own_file(vary: Vary) -> None:
    path = vary("2010-03-01", "2011-06-01", "days = 60", "days = 5")
    result = run("check", str(path))
    assert result.exit_code == 0
    assert "valid, not published\n" in result.stdout
    assert "2011-06-01 00:15" in result.stdout
    assert "02:15" in result.stdout, "on the grower's clock"


def test_check_shows_the_weather_of_the_year_that_is_tested(tmp_path: Path) -> None:
    path = tmp_path / "spring2012.toml"
    path.write_text(
        'base = "glbench/GreenhouseReal-v1"\nid = "mylab/Spring2012-v1"\ntitle = "Spring 2012"\n'
        'without = ["scenario.generated", "scenario.co2_range"]\nsplits.test.years = [2012]\n',
        encoding="utf-8",
    )
    shown = run("check", str(path)).stdout
    first = run_weather(get_task(path).scored, 10000)
    assert "of the first test season" in shown
    assert str(first.times[1]).replace("T", " ")[:16] in shown
    assert str(first.times[1]).startswith("2012-")


def test_check_tells_the_mistakes_of_ones_own_file(vary: Vary) -> None:
    path = vary("days = 60", "days = 0")
    result = run("check", str(path), SHORT_ID)
    assert result.exit_code == 1
    assert "[weather] days = 0 is not allowed" in result.stdout
    entry = machine("check", str(path))[0]
    assert (entry["ok"], entry["task"]) == (False, str(path))


def test_lock_adds_what_is_new_and_says_so(published: Path) -> None:
    text = (published / FILE).read_text(encoding="utf-8")
    (published / "winter-v1.toml").write_text(text.replace(SHORT_ID, "Winter-v1"), encoding="utf-8")
    assert "locked glbench/Winter-v1" in run("lock").stdout
    assert machine("lock") == []
    assert "Nothing to do: all 3 tasks are locked" in run("lock").stderr


def test_lock_refuses_to_change_an_entry(published: Path) -> None:
    text = (published / FILE).read_text(encoding="utf-8")
    (published / FILE).write_text(text.replace("delta = 0.10", "delta = 0.12"), encoding="utf-8")
    with pytest.raises(TaskError, match="Published tasks never change"):
        CliRunner().invoke(app, ["lock"], catch_exceptions=False)


@dataclass(frozen=True)
class Withered(VanthoorTomato):
    """A tomato whose fruit changes at no finite rate."""

    def rates(self, x: Any, s: Any, fluxes: Any, p: Any) -> Any:
        return super().rates(x, s, fluxes, p)._replace(c_fruit=(x.c_fruit - x.c_fruit) / (x.c_fruit * 0.0))


def test_check_names_a_rate_that_is_not_finite_at_the_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paper, "_MODELS", dict(paper._MODELS))
    register_model(compose(GreenLightClimate(), Withered(), name="withered"))
    task = tmp_path / "withered.toml"
    task.write_text(
        'base = "glbench/Schiphol2010-Delta10-v1"\nschema = 2\nid = "mylab/Withered-v1"\ntitle = "withered"\n'
        '[model]\nid = "withered-1.0.0"\n',
        encoding="utf-8",
    )

    result = run("check", str(task))

    assert result.exit_code == 1
    assert "[initial_state] At the start" in result.stdout
    assert "the equations of withered-1.0.0 give as rate of cFruit = " in result.stdout


def test_references_are_written_again_as_they_are_shipped_with_the_best_known_runs(tmp_path, monkeypatch):
    shipped = data_folder("tasks")
    shutil.copy(shipped / "references.toml", tmp_path)
    monkeypatch.setattr(references, "references_path", lambda: tmp_path / "references.toml")
    monkeypatch.setattr(references, "best_known_path", lambda task_id: tmp_path / "best_known" / f"{task_id.rpartition('/')[2]}.json")
    references.read_references.cache_clear()
    done = CliRunner().invoke(app, ["references", "--write", "--out", str(data_folder("reports/released/results").parent)])
    references.read_references.cache_clear()
    assert done.exit_code == 0, done.output
    names = ["references.toml", *(f"best_known/{path.name}" for path in (shipped / "best_known").iterdir())]
    assert len(names) > 1
    for name in names:
        assert (tmp_path / name).read_bytes() == (shipped / name).read_bytes(), name
