"""What a person reads whose settings cannot be used: file, setting, value, bounds, or the nearest name."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import pytest
from pydantic import BaseModel, Field, ValidationError, field_validator

from glbench.errors import ArchiveError, SubmissionError, TrainingError
from glbench.settings import Table, first_problems, read_settings, readable_errors, table_at, validated


class Lamps(Table):
    from_: Annotated[float, Field(alias="from", ge=0.0, le=24.0)]
    power: float = Field(default=0.0, ge=0.0, le=200.0, json_schema_extra={"unit": "W m-2"})


class Settings(Table):
    lamps: Lamps
    zones: dict[str, Lamps] = Field(default_factory=dict)
    count: int = 1
    rest: dict[str, float] = Field(default_factory=dict)

    @field_validator("count")
    @classmethod
    def _odd(cls, count: int) -> int:
        if count % 2 == 0:
            msg = "CO2 sensors are odd in number"
            raise ValueError(msg)
        return count


def errors_of(content: dict[str, object], inline: str = "") -> str:
    with pytest.raises(ValidationError) as caught:
        Settings.model_validate(content)
    return readable_errors(caught.value, Settings, inline)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({}, "'lamps' is missing."),
        ({"lamps": {"from": 30}}, "'lamps.from' is 30; it must be from 0 to 24."),
        ({"lamps": {"from": 1, "power": -1}}, "'lamps.power' is -1 W m-2; it must be from 0 to 200 W m-2."),
        ({"lamps": {"from": "1,5"}}, "'lamps.from' is '1,5', which is not a number: write 1.5, not 1,5."),
        ({"lamps": {"from": 1, "powr": 1}}, "there is no setting 'lamps.powr'. Did you mean 'power'?"),
        ({"lamps": {"from": 1}, "zones": {"a": {"from": 25}}}, "'zones.a.from' is 25; it must be from 0 to 24."),
        ({"lamps": {"from": 1}, "count": 2}, "'count': CO2 sensors are odd in number."),
        ({"lamps": {"from": 1}, "count": "two"}, "'count': input should be a valid integer, unable to parse string as an integer."),
        ({"count": 2}, "'lamps' is missing; 'count': CO2 sensors are odd in number."),
    ],
)  # fmt: skip
def test_a_mistake_is_told_in_words(content: dict[str, object], words: str) -> None:
    assert errors_of(content) == words


def test_a_table_that_files_write_inline_is_not_named() -> None:
    content = {"lamps": {"from": 1}, "rest": {"tau": "abc"}}
    assert errors_of(content) == "'rest.tau' is 'abc', which is not a number."
    assert errors_of(content, "rest") == "'tau' is 'abc', which is not a number."


def test_the_table_of_a_place_is_found_also_among_several() -> None:
    assert table_at(Settings, ()) is Settings
    assert table_at(Settings, ("lamps",)) is table_at(Settings, ("zones", "a")) is Lamps
    assert table_at(Settings, ("lamps", "from")) is None


def test_a_record_is_told_by_its_first_problems() -> None:
    class Record(BaseModel):
        a: int
        b: int
        c: int

    with pytest.raises(ValidationError) as caught:
        Record.model_validate({})
    assert first_problems(caught.value) == "a: Field required"
    assert first_problems(caught.value, 2) == "a: Field required; b: Field required; and 1 more"


def test_files_are_yaml_or_toml(tmp_path: Path) -> None:
    page, table = tmp_path / "a.yml", tmp_path / "a.toml"
    page.write_text("lamps: {from: 6}\n", encoding="utf-8")
    table.write_text("[lamps]\nfrom = 6\n", encoding="utf-8")
    assert read_settings(Settings, page, "the page") == read_settings(Settings, table, "the page", toml=True)
    table.write_text("[lamps\n", encoding="utf-8")
    with pytest.raises(ArchiveError, match=r"The page .*a\.toml cannot be used: it is no valid TOML \(.*\)\. See there\."):
        read_settings(Settings, table, "the page", ArchiveError, toml=True, advice="See there.")
    with pytest.raises(SubmissionError, match="Cannot read the page"):
        read_settings(Settings, tmp_path / "none.yml", "the page")
    with pytest.raises(TrainingError, match=r"The page .*a\.yml cannot be used: 'lamps' is missing\.$"):
        validated(Settings, {}, "the page", page, TrainingError)
