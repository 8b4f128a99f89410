"""The tasks that come with glbench."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from glbench.cli.tasks import _lacks_data
from glbench.env import Simulation
from glbench.registration import draft_files, task_files
from glbench.tasks import PAPER_TASK, TaskSpec, get_suite, get_task, list_drafts, list_suites, list_tasks, read_lock
from glbench.tasks.library import check_file_name
from tests.support import shipped_tasks

DELTAS = (0.0, 0.05, 0.10, 0.15, 0.20, 0.25, 0.30)
FILES = task_files()


@pytest.mark.parametrize("path", FILES, ids=[path.stem for path in FILES])
def test_a_shipped_task_loads_and_has_the_digest_of_the_lock(path: Path) -> None:
    if _lacks_data(path):
        pytest.skip("the extra with its weather is not installed")
    task = get_task(path)
    check_file_name(task, path)
    assert task.digest == read_lock()[task.id].digest
    assert task.locked


def test_every_entry_of_the_lock_has_its_file() -> None:
    assert {entry.file for entry in read_lock().values()} == {path.name for path in FILES}


def test_the_papers_suites_are_the_two_families_in_order_of_their_uncertainty() -> None:
    suites = list_suites()
    assert {"control", "energy", "transfer"} <= suites.keys()
    assert suites["control"] == ("glbench/GreenhouseReal-v1",)
    assert "glbench/Spring-v1" in suites["control-2025"]
    paper = {
        "paper": tuple(f"glbench/Schiphol2010-Delta{100 * delta:02.0f}-v1" for delta in DELTAS),
        "paper-code": tuple(f"glbench/Schiphol2010Code-Delta{100 * delta:02.0f}-v1" for delta in DELTAS),
    }
    assert {name: suites[name] for name in paper} == paper
    for suite in paper:
        assert tuple(task.uncertainty.delta for task in get_suite(suite)) == DELTAS


def test_the_default_task_has_ten_percent() -> None:
    task = get_task(PAPER_TASK)
    assert (task.id, task.uncertainty.delta, task.suites) == ("glbench/Schiphol2010-Delta10-v1", 0.10, ("paper",))


def test_the_short_form_of_an_id_is_enough() -> None:
    assert get_task("Schiphol2010-Delta10-v1") == get_task(PAPER_TASK)


@pytest.mark.parametrize("suite", ["paper", "paper-code"])
def test_the_paper_fixes_horizon_weather_limits_prices_and_evaluation(suite: str) -> None:
    for task in get_suite(suite):
        assert (task.steps, task.step_seconds) == (5760, 900.0)
        assert task.weather.start.isoformat() == "2010-03-01"
        assert (task.weather.preprocessing, task.weather.co2_ppm) == ("paper", 400.0)
        limits = {name: (limit.low, limit.high, limit.unit) for name, limit in task.constraints.items()}
        assert limits == {"air_temperature": (15.0, 34.0, "degC"), "co2": (300.0, 1600.0, "ppm"), "relative_humidity": (50.0, 85.0, "%")}
        assert dict(task.reward.penalty_scale.items()) == {"air_temperature": 15.0, "co2": 2500.0, "relative_humidity": 15.0}
        prices = task.prices
        assert (prices.fruit, prices.dry_matter_content) == (1.6, 0.065)
        assert (prices.co2, prices.heat, prices.electricity) == (0.3, 0.09, 0.3)
        assert list(task.evaluation.seeds) == list(range(666, 696))
        assert (task.actuation.kind, task.actuation.max_change) == ("rate", 0.1)
        assert (task.uncertainty.redraw, task.observation.timing) == ("step", "current")


def test_the_first_row_is_the_first_of_march_and_one_row_follows_the_last_step() -> None:
    weather = get_task(PAPER_TASK).disturbances()
    assert weather.values.shape == (5761, 10)
    assert (weather.hour_of_day[0], weather.day_of_year[0]) == (0.0, 59.0)
    assert str(weather.times[0]) == "2010-03-01T00:00:00"
    assert str(weather.times[-1]) == "2010-04-30T00:00:00"


def test_a_forecast_adds_rows_and_changes_none() -> None:
    task = get_task(PAPER_TASK)
    longer = task.disturbances(extra_rows=48)
    assert len(longer.values) == 5761 + 48
    np.testing.assert_array_equal(longer.values[:5761], task.disturbances().values)


def test_the_families_differ_in_equations_width_and_parameters_only() -> None:
    for paper, code in zip(get_suite("paper"), get_suite("paper-code"), strict=True):
        assert (paper.model.variant, code.model.variant) == ("author", "gl_gym2")
        assert paper.uncertainty.half_width == paper.uncertainty.delta
        assert code.uncertainty.half_width == 0.5 * code.uncertainty.delta
        assert (len(paper.uncertain_parameters()), len(code.uncertain_parameters())) == (28, 34)
        differing = {
            table: {key for key in entries if entries[key] != code.definition()[table][key]}
            for table, entries in paper.definition().items()
            if isinstance(entries, dict)
        }
        assert {table: keys for table, keys in differing.items() if keys} == {
            "model": {"variant"},
            "uncertainty": {"half_width_factor", "parameters"},
        }


def test_a_failed_step_costs_the_lowest_epi_and_a_penalty_of_three() -> None:
    for task in (*get_suite("paper"), *get_suite("paper-code")):
        p, prices = task.parameters_by_name(), task.prices
        hours = task.step_seconds / 3600
        heat = p["pBoil"] / p["aFlr"] * hours / 1000 * prices.heat
        light = p["thetaLampMax"] * hours / 1000 * prices.electricity
        co2 = p["phiExtCo2"] / p["aFlr"] * task.step_seconds * 1e-6 * prices.co2
        failed = task.evaluation.failed_step
        assert failed.epi == pytest.approx(-(heat + light + co2), rel=1e-12)
        assert (failed.reward, failed.penalty) == (-3.0, 3.0)


def test_what_a_task_hands_out_cannot_be_changed() -> None:
    task = get_task(PAPER_TASK)
    for array in (task.parameters(), task.initial_state(), task.disturbances().values):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0
    with pytest.raises(AttributeError, match="frozen"):
        task.id = "mylab/Other-v1"


def test_a_list_of_tasks_needs_neither_weather_nor_digest(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(TaskSpec, "record", refuse)
    monkeypatch.setattr(TaskSpec, "fingerprint", refuse)
    assert len(list_tasks()) == len(FILES)


def test_drafts_can_be_used_and_are_not_published() -> None:
    drafts = list_drafts()

    assert "glbench/SpringSetpoints-v1" in {task.id for task in drafts}
    assert [f"{task.short_id.lower()}.toml" for task in drafts] == [path.name for path in draft_files()]
    for task in drafts:
        assert task.id not in {published.id for published in list_tasks()}
        if task in shipped_tasks():  # its weather is installed
            assert get_task(task.short_id).digest == task.digest
            assert not task.locked


def test_the_lettuce_draft_draws_season_start_and_crop_for_each_run() -> None:
    simulation = Simulation("Lettuce-v1", 6)

    simulation.reset(range(6))

    assert simulation.fused
    assert len({str(moment)[:10] for moment in simulation.time}) > 3
    assert len({row.tobytes() for row in simulation.d}) == 6, "each in a season of its own"
    heads = [column.name for column in simulation.task.observed()].index("head_fresh_mass")
    assert np.ptp(simulation.observe()[:, heads]) > 0.1
    assert [quantity.name for quantity in simulation.task.quantities][:6] == [
        "reward", "epi", "revenue", "cost_co2", "cost_electricity", "cost_heat",
    ]  # fmt: skip
