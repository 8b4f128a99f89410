"""What a person reads who wrote a page of settings that cannot be used."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from glbench.agents.baselines import read_baseline
from glbench.agents.loading import load_agent
from glbench.errors import SubmissionError
from glbench.evaluation.submitting import check_submission
from glbench.resources import data_folder


@pytest.fixture
def rules(tmp_path: Path) -> Path:
    """A copy of the tuned rules."""
    return Path(shutil.copytree(data_folder("baselines") / "rule_based_tuned", tmp_path / "my_rules"))


def refused(folder: Path) -> str:
    with pytest.raises(SubmissionError) as caught:
        read_baseline(folder)
    return str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("heating_night: 16.57", "heating_night: 60", "'heating_night' is 60 degC; it must be from 12 to 20 degC"),
        ("heating_night: 16.57", "heating_night: 15,5", "a number has a decimal point: write 15.5, not 15,5. A list"),
        ("heating_night: 16.57", "heating_night: warm", "'heating_night' is 'warm', which is not a number."),
        ("heating_night: 16.57", "heating_nigth: 16.57", "there is no setting 'heating_nigth'. Did you mean 'heating_night'"),
        ("heating_night: 16.57", "  heating_night: 16.57", "spring.yml at line 12, '  heating_night: 16.57"),
        ("heating_night: 16.57", "heating_night 16.57", "Every line is 'name: value' and begins at the left edge."),
        ("vents_cold_less: ", "vents_cold_less: 7 #", "'vents_cold_less' is 7; it must be from 0 to 0.95"),
    ],
)  # fmt: skip
def test_a_mistake_on_a_page_of_rules_is_told(rules: Path, old: str, new: str, said: str) -> None:
    page = rules / "rules" / "spring.yml"
    text = page.read_text(encoding="utf-8")
    assert old in text
    page.write_text(text.replace(old, new), encoding="utf-8")
    assert said in refused(rules)


def test_a_name_that_is_given_twice_is_refused_with_both_lines(rules: Path) -> None:
    page = rules / "rules" / "spring.yml"
    lines = page.read_text(encoding="utf-8").splitlines()
    first = next(number for number, line in enumerate(lines, start=1) if line.startswith("heating_night"))
    page.write_text("\n".join([*lines, "heating_night: 18.0", ""]), encoding="utf-8")
    assert f"has 'heating_night' twice, in lines {first} and {len(lines) + 1}. Keep one of them." in refused(rules)


def test_a_misspelt_field_of_a_growers_page_is_told_with_the_nearest(tmp_path: Path) -> None:
    folder = Path(shutil.copytree(data_folder("baselines") / "grower", tmp_path / "mine"))
    page = folder / "settings.toml"
    text = page.read_text(encoding="utf-8")
    assert "radiation_limit" in text
    page.write_text(text.replace("radiation_limit", "radiation_limt", 1), encoding="utf-8")
    said = refused(folder)
    assert "radiation_limt'. Did you mean 'radiation_limit'" in said
    assert "Field required" not in said


def test_a_folder_of_settings_is_checked_without_code(rules: Path) -> None:
    report = check_submission(rules, "Spring-v1")
    assert report.ok
    assert "rule_based_tuned; no code to run" in report.facts["loading"]
    page = rules / "rules" / "spring.yml"
    page.write_text(page.read_text(encoding="utf-8").replace("heating_night: 16.57", "heating_night: 60"), encoding="utf-8")
    (finding,) = check_submission(rules, "Spring-v1").problems
    assert "'heating_night' is 60 degC" in finding.text


def test_a_task_that_the_settings_do_not_serve_is_a_problem(rules: Path) -> None:
    assert not check_submission(rules, "SpringSetpoints-v1").ok


def test_a_page_that_is_named_alone_leads_to_its_folder(rules: Path) -> None:
    with pytest.raises(SubmissionError, match=r"is a page of settings. Name the folder .*: glbench evaluate \S*my_rules$"):
        load_agent(rules / "rules" / "spring.yml")
