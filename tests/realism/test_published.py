"""Reading the published archive: both layouts, what is filled, and what is refused with which words."""

from __future__ import annotations

import datetime as dt
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from glbench.errors import ArchiveError
from glbench.realism import read_archive
from tests.realism.made import FIRST, Made


def test_both_layouts_say_the_same(tmp_path: Path) -> None:
    made = Made()
    one, other = (read_archive(made.write(tmp_path / "flat")), read_archive(made.write_as_published(tmp_path / "folders")))
    assert (one.first, one.days) == (other.first, other.days) == (FIRST, 3)
    assert np.array_equal(one.weather.rows, other.weather.rows)
    for name, values in one.weather.columns.items():
        assert np.array_equal(values, other.weather.columns[name]), name
    for mine, theirs in zip(one.compartments, other.compartments, strict=True):
        assert mine.name == theirs.name
        for column in ("heat", "high", "low", "co2", "harvest"):
            assert np.array_equal(getattr(mine, column), getattr(theirs, column)), column
        assert mine.dry_matter == theirs.dry_matter
    assert one.notes == other.notes == ()


def test_sums_of_a_compartment(tmp_path: Path) -> None:
    anna, bert = read_archive(Made().write(tmp_path)).compartments
    assert (anna.name, bert.name) == ("Anna", "Bert")
    assert anna.heat.tolist() == [2.0, 2.0, 2.0]
    assert bert.high.tolist() == pytest.approx([1.8, 1.8, 1.8])
    assert anna.harvest.tolist() == pytest.approx([0.3, 0.0, 0.5]), "both classes"
    assert anna.dry_matter == pytest.approx(0.085)


def test_blanks_tabs_and_empty_columns_of_the_published_files_are_read(tmp_path: Path) -> None:
    folder = Made().write(tmp_path)
    days = [43871, 43872, 43873]
    (folder / "Anna_Resources.csv").write_text(
        "%Time ,Heat_cons,ElecHigh, ElecLow,CO2_cons,Irr,,\n" + "".join(f"{day},1.5, 1,\t0.5,0.04,0.2,,\n" for day in days)
    )
    (folder / "Anna_TomQuality.csv").write_text("%time,\tFlavour,\tWeight\tDMC_fruit\n43871,\t74,\t7.77,\tnan\n43873,\t78,\t8.9,\t9.5\n")
    anna = read_archive(folder).compartments[0]
    assert (anna.heat.tolist(), anna.low.tolist(), anna.dry_matter) == ([1.5] * 3, [0.5] * 3, 0.095)


def test_a_few_missing_days_are_filled_and_noted(tmp_path: Path) -> None:
    made = Made(days=6)
    table = made.resources["Anna"]
    table.loc[[2, 3], "Heat_cons"] = np.nan
    table.loc[4, "Heat_cons"] = 5.0
    made.resources["Bert"] = made.resources["Bert"].drop(index=3)
    archive = read_archive(made.write(tmp_path))
    assert archive.compartments[0].heat.tolist() == pytest.approx([2.0, 2.0, 3.0, 4.0, 5.0, 2.0])
    assert "Anna_Resources.csv: Heat_cons of 2 of 6 days filled linearly." in archive.notes
    assert "Bert_Resources.csv: ElecHigh of 1 of 6 days filled linearly." in archive.notes


@pytest.mark.parametrize("rows", [[1, 2, 3, 4], [0], [7]], ids=["four in a row", "the first", "the last"])
def test_more_missing_days_are_refused(tmp_path: Path, rows: list[int]) -> None:
    made = Made(days=8)
    made.resources["Anna"].loc[rows, "CO2_cons"] = np.nan
    begin = FIRST + dt.timedelta(days=rows[0])
    with pytest.raises(ArchiveError, match=rf"CO2_cons is missing on {len(rows)} days in a row from {begin}"):
        read_archive(made.write(tmp_path))


def test_a_harvest_dated_before_the_season_counts_on_the_next_date(tmp_path: Path) -> None:
    made = Made()
    days = made.resources["Anna"]["Time"].tolist()
    made.production["Anna"] = pd.DataFrame({"time": [days[0] - 360, days[1], days[2] + 1], "ProdA": [0.2, 0.4, 0.9], "ProdB": 0.0})
    archive = read_archive(made.write(tmp_path))
    assert archive.compartments[0].harvest.tolist() == pytest.approx([0.0, 0.6, 0.0])
    before, after = archive.notes
    assert "a harvest is dated 2019-02-15, before the season; it is counted on 2020-02-11" in before
    assert "the harvest of 2020-02-13, after the last day, is left out" in after


def test_compartments_of_different_days_are_cut_to_what_they_share(tmp_path: Path) -> None:
    made = Made(days=5)
    made.resources["Bert"] = made.resources["Bert"].iloc[1:4]
    archive = read_archive(made.write(tmp_path))
    assert (archive.first, archive.days) == (FIRST + dt.timedelta(days=1), 3)
    assert all(one.heat.size == 3 for one in archive.compartments)
    assert "2020-02-11 to 2020-02-13" in archive.notes[0]


def test_without_measured_dry_matter_the_page_of_settings_says_it(tmp_path: Path) -> None:
    made = Made()
    del made.quality["Anna"]
    made.quality["Bert"]["DMC_fruit"] = np.nan
    archive = read_archive(made.write(tmp_path))
    assert [one.dry_matter for one in archive.compartments] == [None, None]
    assert len(archive.notes) == 2
    assert "Anna: no dry matter content was measured" in archive.notes[0]


def drop_a_column(made: Made) -> None:
    made.resources["Anna"] = made.resources["Anna"].rename(columns={"Heat_cons": "Heat_con"})


def drop_time(made: Made) -> None:
    made.weather = made.weather.rename(columns={"time": "when"})


def a_word(made: Made) -> None:
    made.resources["Bert"] = made.resources["Bert"].astype({"ElecLow": object})
    made.resources["Bert"].loc[1, "ElecLow"] = "much"


def impossible(made: Made) -> None:
    made.weather.loc[7, "Tout"] = 999.0


def a_day_twice(made: Made) -> None:
    made.resources["Anna"].loc[1, "Time"] = made.resources["Anna"].loc[0, "Time"]


def five_minutes_twice(made: Made) -> None:
    made.weather.loc[13, "time"] = made.weather.loc[12, "time"]


def no_day_in_common(made: Made) -> None:
    made.resources["Anna"]["Time"] += 100


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (drop_a_column, r"Anna_Resources.csv has no column 'Heat_cons'. Did you mean 'Heat_con'"),
        (drop_time, r"Weather.parquet has no column 'time' .* It has when, Iglob"),
        (a_word, r"Bert_Resources.csv, row 3: ElecLow is 'much', which is not a number"),
        (impossible, r"Weather.parquet, row 9: Tout is 999, outside -60 to 60"),
        (a_day_twice, r"Anna_Resources.csv has 2020-02-10 \(day 43871\) twice"),
        (five_minutes_twice, r"two rows for the five minutes at 2020-02-10 01:00"),
        (no_day_in_common, r"no day in common \(Anna: 2020-05-20 to 2020-05-22; Bert: 2020-02-10 to 2020-02-12\)"),
    ],
)
def test_what_is_wrong_is_said_with_file_and_place(tmp_path: Path, spoil: object, words: str) -> None:
    made = Made()
    spoil(made)  # type: ignore[operator]
    with pytest.raises(ArchiveError, match=words):
        read_archive(made.write(tmp_path))


def test_missing_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(ArchiveError, match="There is no folder"):
        read_archive(tmp_path / "nowhere")
    with pytest.raises(ArchiveError, match=r"has no weather: expected Weather.csv or Weather.parquet"):
        read_archive(tmp_path)
    folder = Made().write(tmp_path)
    (folder / "Bert_Production.csv").unlink()
    with pytest.raises(ArchiveError, match=r"There is no Bert_Production.csv beside"):
        read_archive(folder)
    for path in folder.glob("*_Resources.csv"):
        path.unlink()
    with pytest.raises(ArchiveError, match=r"has no compartment: no NAME/Resources.csv and no NAME_Resources.csv"):
        read_archive(folder)


def test_two_files_of_one_compartment_are_refused(tmp_path: Path) -> None:
    folder = Made().write(tmp_path)
    (folder / "Anna").mkdir()
    (folder / "Anna" / "Resources.csv").write_bytes((folder / "Anna_Resources.csv").read_bytes())
    with pytest.raises(ArchiveError, match=re.escape("Compartment 'Anna' has two files")):
        read_archive(folder)
