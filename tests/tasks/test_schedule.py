"""Schedules in task files: when entries apply, what is refused, what is said of them, and that other tasks stay as they were."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glbench.errors import TaskError
from glbench.report.task_words import definition_in_words, for_growers
from glbench.serve.card import card
from glbench.tasks import TaskSpec, get_task, task_card
from glbench.tasks.prices import local_times
from glbench.tasks.schedule import ScheduleEntry, schedule_rows

CONTROLS = ["uBoil", "uCo2", "uThScr", "uVent", "uLamp"]
FILE = """
base = "glbench/Spring-v1"
schema = 2
id = "mylab/Picking-v1"
title = "The screen by the calendar"

[weather]
days = 10

[scenario]
start_within_days = 0

[actuation]
controls = ["uBoil", "uCo2", "uThScr", "uVent", "uLamp"]

[[schedule]]
control = "uBlScr"
value = 1.0
"""


def entry(**keys: Any) -> ScheduleEntry:
    return ScheduleEntry.model_validate({"control": "uBlScr", "value": 1.0, **keys})


def at(one: ScheduleEntry, *moments: str) -> list[bool]:
    applies: list[bool] = one.applies(np.array(moments, "datetime64[s]")).tolist()
    return applies


def checked(folder: Path, lines: str) -> TaskSpec:
    path = folder / "task.toml"
    path.write_text(FILE + lines, encoding="utf-8")
    return get_task(path)


def test_an_entry_without_conditions_always_applies() -> None:
    assert at(entry(), "2010-01-01T00:00", "2010-07-15T12:00", "2010-12-31T23:59:59") == [True, True, True]


def test_hours_are_half_open() -> None:
    picking = entry(hours=[7.0, 15.5])
    assert at(picking, "2010-05-03T06:45", "2010-05-03T07:00", "2010-05-03T15:15", "2010-05-03T15:30") == [False, True, True, False]
    assert at(entry(hours=[0.0, 24.0]), "2010-05-03T00:00", "2010-05-03T23:45") == [True, True]
    assert at(entry(hours=[22, 0]), "2010-05-03T22:00", "2010-05-03T23:45", "2010-05-04T00:00") == [True, True, False]


def test_weekdays_are_those_of_the_calendar() -> None:
    days = [f"2010-05-{day:02d}T12:00" for day in range(3, 10)]  # a Monday to a Sunday
    assert at(entry(weekdays=["monday", "thursday"]), *days) == [True, False, False, True, False, False, False]
    assert at(entry(weekdays=["sunday"]), *days) == [False] * 6 + [True]


def test_hours_after_midnight_belong_to_the_day_before() -> None:
    night = entry(weekdays=["monday"], hours=[22.0, 6.0])
    moments = ["2010-05-03T05:45", "2010-05-03T21:45", "2010-05-03T22:00", "2010-05-04T05:45", "2010-05-04T06:00", "2010-05-04T22:00"]
    assert at(night, *moments) == [False, False, True, True, False, False]
    last = entry(hours=[22.0, 6.0], **{"from": "05-01", "until": "05-03"})
    assert at(last, "2010-05-01T05:00", "2010-05-01T22:00", "2010-05-04T05:00", "2010-05-04T22:00") == [False, True, True, False]


def test_both_dates_count_and_may_turn_the_year() -> None:
    autumn = entry(**{"from": "09-15", "until": "12-31"})
    assert at(autumn, "2010-09-14T23:45", "2010-09-15T00:00", "2010-12-31T23:45", "2011-01-01T00:00") == [False, True, True, False]
    winter = entry(**{"from": "11-01", "until": "02-28"})
    moments = ["2010-10-31T12:00", "2010-11-01T00:00", "2011-01-01T00:00", "2011-02-28T23:45", "2011-03-01T00:00"]
    assert at(winter, *moments) == [False, True, True, True, False]
    assert at(entry(**{"from": "09-15"}), "2010-09-15T00:00", "2010-12-31T23:45", "2011-01-01T00:00") == [True, True, False]
    assert at(entry(until="03-01"), "2012-02-29T12:00", "2012-03-01T23:45", "2012-03-02T00:00") == [True, True, False]


def test_the_clock_is_that_of_the_task() -> None:
    """07:00 to 15:00 in Amsterdam are 05:00 to 13:00 UTC in summer and 06:00 to 14:00 UTC in winter."""
    utc = np.datetime64("2010-03-27T00:00", "s") + np.arange(72) * np.timedelta64(3600, "s")
    ahead = np.where(utc < np.datetime64("2010-03-28T01:00"), 1, 2)
    hour_of_day = ((utc - utc.astype("datetime64[D]")).astype(np.int64) // 3600 + ahead) % 24.0
    rows = schedule_rows([entry(hours=[7.0, 15.0])], local_times(utc, hour_of_day))[:, 0]
    assert [f"{moment}"[8:13] for moment in utc[np.flatnonzero(np.diff(rows) == 1.0) + 1]] == ["27T06", "28T05", "29T05"]
    assert rows.sum() == 24


def test_a_file_with_a_schedule_is_a_task_of_its_own(tmp_path: Path) -> None:
    task = checked(tmp_path, 'weekdays = ["monday"]\nhours = [7.0, 15.0]\nfrom = "02-16"\nafter_day = 2\n')
    assert dict(task.scheduled_places) == {"uBlScr": 5}
    (one,) = task.definition()["schedule"]
    assert one == {
        "control": "uBlScr", "value": 1.0, "weekdays": ["monday"], "hours": [7.0, 15.0], "from": [2, 16], "after_day": 2,
    }  # fmt: skip
    other = task.replace({"schedule": [{"control": "uBlScr", "value": 0.5}]})
    assert len({task.digest, other.digest, task.replace({"schedule": None}).digest}) == 3
    assert "schedule" not in get_task("Spring-v1").definition()
    assert dict(other.replace({"schedule": None}).scheduled_places) == {}
    again = task_card(task).task()
    assert again.schedule == task.schedule
    assert TaskSpec.of_attachment(json.loads(json.dumps(task.attachment()))).digest == task.digest


def test_a_schedule_of_your_own_keeps_that_of_the_base_for_other_controls() -> None:
    base = get_task("GreenhouseReal-v1")
    crew = base.definition()["schedule"]
    controls = [name for name in base.actuation.controls if name != "uBlScr"]
    dark = {"control": "uBlScr", "value": 1.0, "hours": [20.0, 6.0]}
    own = base.replace({"actuation.controls": controls, "schedule": [dark]})
    assert [entry["control"] for entry in own.definition()["schedule"]] == ["uAway", "uAway", "uBlScr"]
    assert own.definition()["schedule"][:2] == crew

    replaced = own.replace({"schedule": [{"control": "uAway", "value": 0.5}]})
    assert [(entry["control"], entry["value"]) for entry in replaced.definition()["schedule"]] == [("uBlScr", 1.0), ("uAway", 0.5)]


def test_the_schedule_is_told_to_people_and_agents(tmp_path: Path) -> None:
    lines = 'weekdays = ["monday", "thursday"]\nhours = [7.0, 15.5]\nfrom = "02-16"\nuntil = "05-31"\nafter_day = 2\n'
    task = checked(tmp_path, lines + '[[schedule]]\ncontrol = "uBlScr"\nvalue = 0.25\nhours = [0.0, 1.0]\n')
    when = "Monday and Thursday, 07:00 to 15:30, 16 February to 31 May, from 2 days after the start of the run"
    (section,) = (one for one in definition_in_words(task) if one.heading == "What the agent does")
    assert f"By the schedule uBlScr is 1: {when}." in section.lines
    assert "By the schedule uBlScr is 0.25: 00:00 to 01:00." in section.lines
    assert next(row for row in section.rows if row[1] == "uBlScr")[3] == "scheduled"
    (section,) = (one for one in for_growers(task) if one.heading == "What the agent controls")
    assert any(f"100 %, {when}." in line for line in section.lines)
    assert entry().in_words() == "always"


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ('hours = [7.0, 25.0]', r"\[schedule\.0\] hours = \[7, 25\]: hours of a day lie between 0 and 24"),
        ('hours = [7.0, 7.0]', r"hours = \[7, 7\]: an entry with these never applies"),
        ('hours = [7.0]', "hours"),
        ('weekdays = ["mondey"]', r"There is no weekday called 'mondey'. Did you mean 'monday'\?"),
        ('weekdays = ["monday", "monday"]', "'monday' is listed twice"),
        ("weekdays = []", "must be a list of names of weekdays"),
        ('from = "02-30"', "'02-30' is not a day of the year"),
        ("until = 1231", "'1231' is not a day of the year"),
        ("after_day = -1", "after_day = -1 is not allowed"),
        ("after_days = 3", "'after_days' is not a key of .* Did you mean 'after_day'"),
        ('from = "09-15"', r"\[\[schedule\]\] entry 1 \(uBlScr, 15 September to 31 December\) never applies: a run has 10 days"),
        ("after_day = 10", r"entry 1 \(uBlScr, from 10 days after the start of the run\) never applies"),
        ("hours = [7.1, 7.2]", "entry 1 .*07:06 to 07:12.* never applies"),
        ('[[schedule]]\ncontrol = "uBlSc"\nvalue = 1.0', r"\[\[schedule\]\] There is no control called 'uBlSc'. Did you mean 'uBlScr'"),
        ('[[schedule]]\ncontrol = "uBoil"\nvalue = 1.0', r"\[\[schedule\]\] 'uBoil' is in \[actuation\] controls: the agent moves it"),
        ('[[schedule]]\ncontrol = "uBlScr"\nvalue = 1.5', "value = 1.5 is not allowed. It must be a fraction from 0 to 1"),
    ],
)  # fmt: skip
def test_mistakes_are_said_in_words(lines: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(TaskError, match=words):
        checked(tmp_path, lines + "\n")


def test_an_entry_near_the_end_of_the_latest_run_applies(tmp_path: Path) -> None:
    """Runs of 10 days begin on 15 February; those that may begin a week later reach 3 March."""
    dates = 'from = "03-02"\nuntil = "03-02"\n'
    with pytest.raises(TaskError, match="never applies"):
        checked(tmp_path, dates)
    text = FILE.replace("start_within_days = 0", "start_within_days = 7") + dates
    (tmp_path / "late.toml").write_text(text, encoding="utf-8")
    assert get_task(tmp_path / "late.toml").schedule[0].first == (3, 2)


def test_a_schedule_belongs_to_schema_2(tmp_path: Path) -> None:
    path = tmp_path / "old.toml"
    old = 'base = "glbench/Schiphol2010-Delta10-v1"\nid = "mylab/Old-v1"\ntitle = "Old"\n[[schedule]]\ncontrol = "uLamp"\nvalue = 1.0\n'
    path.write_text(old, encoding="utf-8")
    with pytest.raises(TaskError, match="'schedule' is not a key or table of a task"):
        get_task(path)


def test_the_http_card_has_the_schedule(tmp_path: Path) -> None:
    document: Mapping[str, Any] = card(checked(tmp_path, 'from = "02-16"\nhours = [7.0, 15.0]\n'), ())
    (one,) = document["schedule"]
    assert (one["control"], one["value"], one["hours"], one["from"], one["until"]) == ("uBlScr", 1.0, (7.0, 15.0), (2, 16), (12, 31))
