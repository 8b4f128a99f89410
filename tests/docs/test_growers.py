"""docs/growers.md: its tables are those of the measurement, its commands run, and it takes ten minutes to read."""

from __future__ import annotations

import datetime as dt
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from docs import growers_table
from glbench.resources import data_folder
from glbench.tasks import get_task
from glbench.weather import load_weather

DOCS = Path(__file__).resolve().parents[2] / "docs"
RELEASED = DOCS.parent / "reports" / "released" / "results"
PAGE = (DOCS / "growers.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"```console\n(.*?)```", PAGE, flags=re.DOTALL)
(TASK,) = re.findall(r"```toml\n(.*?)```", PAGE, flags=re.DOTALL)


def test_the_page_holds_the_measurements_of_the_task_as_it_is() -> None:
    found = growers_table.read()
    assert growers_table.filled(PAGE, found) == PAGE
    assert found["digest"] == get_task(found["task"]).digest
    assert list(found["strategies"]) == list(growers_table.STRATEGIES)
    for strategy in found["strategies"].values():
        picked = sum(strategy["weeks"]["fruit_picked [kg m-2]"])
        assert picked == pytest.approx(growers_table.mean(strategy, "fruit_picked"), rel=0.02), "weeks add up to the season"


def test_the_page_takes_ten_minutes_to_read() -> None:
    words = [word for word in PAGE.split() if any(map(str.isalnum, word))]  # without the bars of tables
    assert len(words) <= 1350


def test_the_lines_shown_are_those_of_the_page_of_rules() -> None:
    rules = (data_folder("baselines") / "rule_based_greenhouse" / "rules" / "greenhousereal.yml").read_text(encoding="utf-8")
    (shown,) = re.findall(r"```text\n(.*?)```", PAGE, flags=re.DOTALL)
    assert [line for line in shown.splitlines() if line not in rules] == []


def write_export(path: Path) -> None:
    """An export as a climate computer writes it: rows of 10 minutes, semicolons, decimal commas, 13 days of 2024."""
    record = load_weather("schiphol")
    start, lines = (
        dt.datetime(2024, 4, 30, 0, 0),
        ["Datum tijd;Straling buiten (W/m2);Temperatuur buiten (°C);RV buiten (%);Windsnelheid (m/s)"],
    )
    hours = record.frame.iloc[24 * 120 : 24 * 134]
    for row in range(6 * len(hours)):
        hour = hours.iloc[row // 6]
        columns = ("global_radiation", "air_temperature", "relative_humidity", "wind_speed")
        cells = ";".join(f"{hour[name]:.1f}".replace(".", ",") for name in columns)
        lines.append(f"{start + row * dt.timedelta(minutes=10):%d-%m-%Y %H:%M};{cells}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def test_no_fruit_is_picked_in_two_months_of_a_bearing_crop() -> None:
    """As docs/greenhouse-words.md says of "Fruit picked 0.00"."""
    results = [json.loads(file.read_text(encoding="utf-8")) for file in (RELEASED / "Spring-v1").glob("*tuned.json")]
    picked = [run["metrics"]["fruit_picked"] for result in results for run in result["runs"]]
    assert picked
    assert max(picked) < 0.005


@pytest.mark.slow
def test_the_commands_run_one_after_the_other(tmp_path: Path) -> None:
    (tmp_path / "baselines").symlink_to(data_folder("baselines"))
    (tmp_path / "own.toml").write_text(TASK, encoding="utf-8")
    write_export(tmp_path / "export.csv")
    commands = "".join(COMMANDS).replace("--runs 4", "--runs 1").replace("--runs 8", "--runs 2")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "GLBENCH_DATA": str(tmp_path / "data"), "COLUMNS": "120"}
    ran = subprocess.run(["bash", "-ec", commands], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, f"{ran.stdout[-2000:]}{ran.stderr[-2000:]}"
    assert "heat as natural gas" in ran.stdout.lower()
    assert "Heat" in (tmp_path / "unlit.html").read_text(encoding="utf-8")
    changed = (tmp_path / "unlit" / "rules" / "fullseason.yml").read_text(encoding="utf-8")
    assert "\nlamps_fruit: 0.0 " in changed
    assert "\nheating_night: 14.0 " in (tmp_path / "my_rules" / "rules" / "greenhousereal.yml").read_text(encoding="utf-8")
