"""Tables and pictures that a script makes are what it makes today."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pandas import read_csv

from benchmarks.factors import DESIGN, read_design
from docs import (
    accuracy_table,
    compartment_table,
    energy_story,
    estimator_table,
    factors_figures,
    follower_error,
    fresh_draws_table,
    ladder_table,
    lettuce_classic_table,
    measured_columns,
    realism_board,
    realism_figure,
    realism_setpoints,
    speed_figure,
    spread_measured,
    springs_table,
    study_figures,
    training_curve_table,
    uncertainty_figures,
    weather_table,
    what_the_best_does,
)
from docs.tables import END
from glbench.agents.views import VIEWS
from glbench.env.generated import CO2_PERSISTENCE, GOLDEN
from glbench.model import PARAMETER_SETS
from glbench.realism import houses as realism
from glbench.realism import read_settings
from glbench.realism.money import read_prices
from glbench.speed import read_record
from glbench.tasks import get_task
from glbench.tasks.spreads import SPREADS_FILE
from glbench.weather import Blocks, load_weather
from glbench.weather.comparison import Figure

DOCS = Path(__file__).resolve().parents[2] / "docs"
MEASUREMENTS = DOCS / "measurements"
KS = "Kolmogorov-Smirnov distance [-]"


def test_the_spread_is_what_the_parameter_sets_and_the_simulated_seasons_say() -> None:
    kept = spread_measured.read()
    assert SPREADS_FILE.read_text(encoding="utf-8") == spread_measured.file_text(
        spread_measured.rows_of(kept["multipliers"], kept["elasticities"])
    )
    up, down, names = np.array(kept["up"]), np.array(kept["down"]), list(kept["elasticities"])
    sizes = np.array([max(row.log_sd, 0.05) for row in spread_measured.rows_of(kept["multipliers"], {})])
    assert np.log(up / down) / (2.0 * sizes) == pytest.approx([kept["elasticities"][name] for name in names])
    page = (DOCS / "uncertainty.md").read_text(encoding="utf-8")
    assert spread_measured.filled(page) == page


@pytest.mark.skipif(spread_measured.HOUSE not in PARAMETER_SETS, reason="the measured house is no shipped set")
def test_the_spread_has_the_distances_of_the_measured_house() -> None:
    assert spread_measured.multipliers() == spread_measured.read()["multipliers"]


def test_the_page_of_speed_holds_the_measurements() -> None:
    record = read_record(MEASUREMENTS / "speed.json")
    page = (DOCS / "speed.md").read_text(encoding="utf-8")
    assert speed_figure.filled(page, record) == page
    assert speed_figure.picture(record) == (DOCS / "images" / "speed.svg").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_study_holds_the_released_results() -> None:
    study = study_figures.Study.read()
    for page, fill, tables in (("study", study_figures.filled, study.short), ("study-tables", study_figures.filled_tables, study.parts)):
        written = (DOCS / f"{page}.md").read_text(encoding="utf-8")
        assert fill(written, study) == written
        assert written.count(END) == len(tables), "a table of the page that the study does not make"
    written = "".join((DOCS / f"{page}.md").read_text(encoding="utf-8") for page in ("study", "study-tables"))
    for file, drawing in study_figures.pictures(study).items():
        assert file.read_text(encoding="utf-8") == drawing
        assert f"(images/{file.name})" in written


def test_the_table_of_unseen_springs_holds_the_measurements() -> None:
    page = (DOCS / "training.md").read_text(encoding="utf-8")
    assert springs_table.filled(page, springs_table.read()) == page


def test_the_page_of_factors_holds_what_was_played() -> None:
    figures, page = factors_figures.read(factors_figures.FIGURES), factors_figures.PAGE.read_text(encoding="utf-8")
    assert factors_figures.filled(page, figures) == page
    assert factors_figures.picture(figures) == factors_figures.PICTURE.read_text(encoding="utf-8")
    design, kept = read_design(DESIGN).model_dump(mode="json"), figures["design"]
    assert kept == design | {"trainings": kept["trainings"], "runs": kept["runs"]}  # a part of the shipped design
    for base in figures["bases"].values():
        for cell in base["cells"].values():
            for pair, one in cell["pairs"].items():
                means = [np.mean(np.array(cell["agents"][kind]["values"])[:, : one["runs"]]) for kind in pair.split(" - ")]
                assert means[0] - means[1] == pytest.approx(one["value"])


def test_the_picture_of_the_leaderboard_has_all_agents() -> None:
    board = read_csv(DOCS.parent / "reports" / "released" / "leaderboard.csv")
    agents = set(board.loc[board["task"] == "glbench/GreenhouseReal-v1", "entry"])
    drawn = (DOCS / "images" / "leaderboard.svg").read_text(encoding="utf-8")
    assert len(agents) > 10
    assert not {agent for agent in agents if agent not in drawn}
    means = board[board["task"] == "glbench/GreenhouseReal-v1"].groupby("entry")["reward_mean"].mean()
    assert [f"{mean:.3f}" for mean in means if f"{mean:.3f}" not in drawn] == []  # all trainings of a recipe count


def test_the_learning_curves_are_those_of_the_shipped_trainings() -> None:
    page = (DOCS / "training.md").read_text(encoding="utf-8")
    assert training_curve_table.filled(page) == page


def test_the_ladders_are_those_that_were_measured() -> None:
    page = (DOCS / "ladder.md").read_text(encoding="utf-8")
    assert ladder_table.filled(page, ladder_table.read()) == page


def test_the_returns_of_the_classic_lettuce_are_the_released_ones() -> None:
    page = lettuce_classic_table.PAGE.read_text(encoding="utf-8")
    assert lettuce_classic_table.filled(page) == page


def test_every_view_is_explained() -> None:
    page = (DOCS / "ladder.md").read_text(encoding="utf-8")
    assert all(f"| `{name}` |" in page for name in VIEWS)


def test_the_table_of_trajectories_holds_the_measurements() -> None:
    page = (DOCS / "sensitivities.md").read_text(encoding="utf-8")
    assert speed_figure.filled(page, read_record(MEASUREMENTS / "trajectories.json")) == page


def test_the_table_of_accuracy_holds_the_measurement() -> None:
    page = (DOCS / "kernel-compiled.md").read_text(encoding="utf-8")
    assert accuracy_table.filled(page, (MEASUREMENTS / "accuracy.txt").read_text(encoding="utf-8")) == page


def test_the_table_of_the_compartment_holds_its_parameters() -> None:
    page = (DOCS / "compartment.md").read_text(encoding="utf-8")
    assert compartment_table.filled(page) == page


def test_the_errors_of_followers_are_those_measured():
    page = follower_error.PAGE.read_text(encoding="utf-8")
    assert follower_error.filled(page) == page


def test_the_table_of_generated_seasons_holds_the_measurements() -> None:
    page = (DOCS / "weather.md").read_text(encoding="utf-8")
    measured = weather_table.read()
    assert weather_table.filled(page, measured) == page
    for name in ("training", "again", "test"):
        missed = {figure["name"] for figure in measured[name]["figures"] if not Figure(**figure).within_limits}
        known = {f"size of changes at joints, {what}, {KS}" for what in ("relative humidity", "wind speed")}
        assert missed == (known if name == "again" else set()), f"the page says what the generator misses: {name}"
        assert measured[name]["digest"] == load_weather("schiphol").digest


def test_the_tables_of_the_estimator_hold_the_measurements() -> None:
    page = (DOCS / "control.md").read_text(encoding="utf-8")
    measured = json.loads((MEASUREMENTS / "estimator.json").read_text(encoding="utf-8"))
    assert estimator_table.filled(page, measured) == page


def test_the_table_of_fresh_draws_holds_the_measurements() -> None:
    page, measured = (DOCS / "statistics.md").read_text(encoding="utf-8"), fresh_draws_table.read()
    assert fresh_draws_table.filled(page, measured) == page
    assert [name for name, _ in fresh_draws_table.AGENTS] == list(measured)
    assert {name for name, one in measured.items() if one["marked"]} == {"carries_plans"}


def test_the_page_of_realism_tables_holds_what_was_compared() -> None:
    page = (DOCS / "realism-tables.md").read_text(encoding="utf-8")
    comparison, air = realism_figure.measured(), realism_figure.measured_climate()
    assert realism_figure.filled(page, comparison, air) == page
    models = list(dict.fromkeys(house.model for house in realism.HOUSES.values()))
    assert comparison.digest == ", ".join(realism.model(name).digest for name in models), "the model has changed: compare anew"
    assert list(air.models) == models
    assert comparison.settings == air.settings == read_settings()
    for houses in (comparison.houses, *(compartment.houses for compartment in air.compartments)):
        assert [house.name for house in houses] == list(realism.HOUSES)
    assert "Reference is driven by its own set points." in comparison.notes, "as the page says"
    assert [one.name for one in air.compartments] == ["Reference"], "as the page says"


def test_the_table_of_the_air_names_every_set_and_tells_errors_apart() -> None:
    air = realism_figure.measured_climate()
    rows = realism_figure.climate(air).splitlines()
    for channel in realism_figure.CHANNELS:
        closest = min(air.compartments[0].houses, key=lambda house: house.overall[channel].rmse)
        assert closest.name == realism_figure.FITTED, "as the page says"
    first = [row.split(" | ")[0].lstrip("| ") for row in rows]
    assert [name.strip("`") for name in first if name.startswith("`")] == list(realism.HOUSES)
    assert len([name for name in first if name.endswith(" h")]) == 8
    assert [name for name in first if name.endswith("weeks")] == ["even weeks", "odd weeks"]
    assert len({row.count("|") for row in rows}) == 1


def test_the_board_holds_what_was_earned() -> None:
    page, board = (DOCS / "realism-board.md").read_text(encoding="utf-8"), realism_board.read()
    assert realism_board.filled(page, board) == page
    assert board.prices == read_prices(), "the prices have changed: play again"


def test_the_page_of_measured_data_has_every_column() -> None:
    page = (DOCS / "measured-data.md").read_text(encoding="utf-8")
    assert measured_columns.filled(page) == page


def test_the_table_of_other_set_points_holds_what_was_simulated() -> None:
    page, found = (DOCS / "realism-tables.md").read_text(encoding="utf-8"), realism_setpoints.read()
    assert realism_setpoints.filled(page, found) == page
    assert found["digest"] == realism.model().digest, "the model has changed: simulate anew"
    assert found["settings"] == read_settings().model_dump()
    closest = min(one["heat_rmse"] for one in found["changes"].values())
    assert closest > realism_figure.measured().heat_spread, "no row is as close to single days as growers are to each other"


def test_the_page_of_uncertainty_holds_the_sizes_of_its_task() -> None:
    page = (DOCS / "uncertainty.md").read_text(encoding="utf-8")
    assert uncertainty_figures.filled(page, get_task(str(uncertainty_figures.TASK))) == page
    assert f"φ = {CO2_PERSISTENCE:g}\n" in page
    assert f"(u + {GOLDEN:.6f} n)" in page
    assert f"blocks of {Blocks().shortest} to {Blocks().longest} days" in page
    for picture in (DOCS / "images").glob("uncertainty-*.png"):
        assert f"(images/{picture.name})" in page


def test_the_energy_story_tells_what_the_released_results_hold() -> None:
    page, of_task = (DOCS / "energy-story.md").read_text(encoding="utf-8"), energy_story.outcomes()
    assert energy_story.filled(page, of_task) == page
    assert f"(images/{energy_story.PICTURE.name})" in page
    for of_agents in of_task.values():  # what its sentences say
        rewards = [one.mean("reward") for one in of_agents]
        assert rewards == sorted(rewards)
    rules, learned, control, plan = of_task["glbench/WinterLED-v1"]
    assert max(one.mean("revenue_harvest", "revenue_growth") for one in (rules, learned, control)) < plan.mean(
        "revenue_harvest", "revenue_growth"
    )
    less = rules.by_hour("electricity", 150) - learned.by_hour("electricity", 150)
    assert less[18:23].min() > less[:18].max()
    assert np.abs(less[13:16]).max() < 0.001  # kWh m-2 an hour
    assert learned.mean("penalty") == pytest.approx(control.mean("penalty"), rel=0.05)
    assert all(max(rules.mean(name), control.mean(name), plan.mean(name)) < learned.mean(name) for name in ("heat", "co2_dosed"))
    assert (control.by_hour("electricity", 150) < rules.by_hour("electricity", 150)).all()
    assert 2 * (rules.mean("penalty") - control.mean("penalty")) > control.mean("reward") - rules.mean("reward")
    assert round(rules.mean("hours_relative_humidity_high") / control.mean("hours_relative_humidity_high")) == 3
    assert plan.ratio("cost_electricity", "electricity") == pytest.approx(control.ratio("cost_electricity", "electricity"), abs=0.002)
    rules, learned, control, plan = of_task["glbench/SpringEnergy-v1"]
    assert learned.mean("fruit_gained") == pytest.approx(control.mean("fruit_gained"), rel=0.02)
    assert all(max(rules.mean(name), control.mean(name), plan.mean(name)) < learned.mean(name) for name in ("electricity_bought", "gas"))
    assert (learned.by_hour("engine_hours", 60)[[*range(19, 24), *range(8)]] > 0.96).all()
    assert max(one.mean("co2_bought") for one in (control, plan)) < 0.5 * rules.mean("co2_bought")
    assert 3 * control.ratio("cost_power", "electricity_bought") < control.ratio("revenue_power", "electricity_sold")
    fruit, sales = ([one.mean(name) for one in (rules, control)] for name in ("revenue_growth", "revenue_power"))
    assert fruit[1] - fruit[0] > 5 * (sales[0] - sales[1])
    bought, engine, stored = (
        [one.by_hour(name, 60) for one in (rules, control, plan, learned)]
        for name in ("electricity_bought", "engine_hours", "buffer_gained")
    )
    assert 12 <= bought[1].argmax() < 16
    assert 1.75 < bought[1][13:16].sum() / bought[0][13:16].sum() < 2.0
    assert all(12 <= hours.argmin() < 18 for hours in engine)
    emptied = [next(hour for hour in range(16, 24) if hours[hour] < 0) for hours in stored]
    assert emptied[1] - emptied[0] == emptied[2] - emptied[0] == 2
    assert emptied[3] == emptied[0]
    rules, learned, control, _ = of_task["glbench/FullSeason-v1"]
    assert learned.mean("electricity") == pytest.approx(control.mean("electricity"), rel=0.05)
    assert learned.ratio("cost_electricity", "electricity") < 0.95 * control.ratio("cost_electricity", "electricity")
    assert all(control.mean(name) < learned.mean(name) for name in ("heat", "co2_dosed"))
    fruit, power = (
        [one.mean(*names) for one in (rules, control)] for names in (("revenue_harvest", "revenue_growth"), ("cost_electricity",))
    )
    assert fruit[1] - fruit[0] > 2 * (power[1] - power[0])
    assert control.mean("heat") == pytest.approx(0.8 * rules.mean("heat"), rel=0.05)
    rules, learned, control, plan = of_task["glbench/FullSeasonEnergy-v1"]
    assert 2.0 < learned.mean("electricity_sold") / rules.mean("electricity_sold") < 2.25
    assert learned.mean("electricity_bought") < rules.mean("electricity_bought")
    assert max(rules.mean("gas"), control.mean("gas"), plan.mean("gas")) < learned.mean("gas")
    assert all(rules.mean(name) < learned.mean(name) for name in ("hours_relative_humidity_high", "hours_air_temperature_low"))
    assert learned.mean("penalty") < rules.mean("penalty")
    assert control.mean("gas") < rules.mean("gas")
    assert round(control.mean("electricity_sold") / rules.mean("electricity_sold")) == 3
    assert control.mean("electricity_bought") < rules.mean("electricity_bought")
    assert control.mean("co2_bought") < 0.25 * rules.mean("co2_bought")
    assert control.mean("penalty") < 0.05 * rules.mean("penalty")


@pytest.mark.slow
def test_the_page_of_the_best_plan_tells_what_the_plans_do() -> None:
    page = (DOCS / "what-the-best-does.md").read_text(encoding="utf-8")
    assert what_the_best_does.filled(page, what_the_best_does.all_seasons()) == page
    for picture in (DOCS / "images").glob("best-*.png"):
        assert f"(images/{picture.name})" in page
